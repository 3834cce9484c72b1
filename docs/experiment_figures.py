"""Draw the figures of experiments.md: `python docs/experiment_figures.py`."""

from __future__ import annotations

from pathlib import Path

from dynident.excitation import DesignRequest, TrajectoryRequest, design_experiment
from dynident.reports.figures.design import draw_design
from dynident.robot import robot_from_library

FIGURES = Path(__file__).resolve().parent / "figures"
SHOWN = {
    "experiment_fourier": ("ur10", DesignRequest(starts=2)),
    "experiment_points": (
        "ur10",
        DesignRequest(starts=1, trajectory=TrajectoryRequest(family="point_to_point", points=8)),
    ),
    "experiment_set": (
        "scara",
        DesignRequest(kind="sequential", trajectory=TrajectoryRequest(sets="link_by_link", duration=4.0)),
    ),
}


def main() -> None:
    """Design, draw, write."""
    for name, (robot_name, request) in SHOWN.items():
        robot = robot_from_library(robot_name)
        figure = draw_design(design_experiment(robot, request), robot)
        (FIGURES / f"{name}.svg").write_text(f"{figure}\n", encoding="utf-8")


if __name__ == "__main__":
    main()
