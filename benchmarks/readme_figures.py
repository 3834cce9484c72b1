"""The errors in the README's first table, from the recordings of real robots beside the project.

    python benchmarks/readme_figures.py [--arms 1]

Each arm is identified with links, rotors, Coulomb and viscous friction and offsets, diagnosed on the same data, and
extended by what the diagnosis recommends. Errors are rms of the residual over rms of the filtered torque, all joints
together, on recordings that no parameter saw:

* moving: rows in which a joint moves;
* all: all rows, where one at rest counts with its distance to what friction may hold (README);
* raw: all rows against the predicted torque itself, as if friction had a direction at rest.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from common import RECORDINGS

import dynident as dy
from dynident.diagnosis import compare
from dynident.identification import Identification
from dynident.recordings import RecordedJoints, Recording, RecordingMetadata, import_recording

EFFECTS = ("default", "offset")


@dataclass(frozen=True)
class Arm:
    """A robot, the file and windows that it is identified from, and those that it is judged on."""

    title: str
    folder: str
    fit: tuple[str, tuple[tuple[float, float], ...]]
    held: tuple[str, tuple[tuple[float, float], ...]]
    gains: tuple[float, ...] | None = None


ARMS = (
    Arm("Universal Robots UR10", "ur10", ("exciting_traj", ((0.0, 18.0),)), ("exciting_traj", ((18.0, 27.5),))),
    Arm(
        "Universal Robots UR10e",
        "ur10e",
        ("id_30s_12harm", ()),
        ("val_ptp10", ()),
        (14.87, 13.26, 11.13, 10.62, 11.03, 11.47),
    ),
    Arm("Stäubli TX40", "tx40", ("all", ((0.02, 5.0),)), ("all", ((5.0, 7.65),))),
)


def errors_of(found: Identification, held: Recording) -> tuple[float, float, float]:
    """Relative held-out errors: of moving rows, of all, and of all against the predicted torque itself."""
    assert found.held_out is not None
    assert found.held_out_moving is not None
    comparison = compare(found, held)
    raw = np.sqrt(np.mean((comparison.measured - comparison.predicted) ** 2) / np.mean(comparison.measured**2))
    return found.held_out_moving.relative_total, found.held_out.relative_total, float(raw)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--arms", type=int, default=len(ARMS), help="how many of the table's rows")
    chosen = ARMS[: parser.parse_args().arms]
    if not RECORDINGS.is_dir():
        sys.exit(f"no recordings of real robots at {RECORDINGS}")
    print(f"{'':24s} {'links, friction, offsets':>26s}   {'with what the diagnosis named':>30s}")
    print(
        f"{'held-out error in %':24s} {'moving':>8s} {'all':>8s} {'raw':>8s}   {'moving':>8s} {'all':>8s} {'raw':>8s}"
    )
    for arm in chosen:
        folder = RECORDINGS / arm.folder
        robot = dy.load_robot(folder / "robot.urdf")
        joints = RecordedJoints(robot.joint_names, gains=arm.gains)
        with tempfile.TemporaryDirectory() as scratch:
            fit, held = (
                import_recording(
                    folder / f"{name}.parquet",
                    Path(scratch) / f"{place}.parquet",
                    joints,
                    metadata=RecordingMetadata(name=f"{name}_{place}", windows=windows),
                )[0]
                for place, (name, windows) in enumerate((arm.fit, arm.held))
            )
            plain = dy.identify(robot, [fit], validation=[held], effects=EFFECTS)
            found = dy.diagnose(plain)
            grown = plain.extend(found)
            rows = [errors_of(model.identification, held) for model in (plain, grown)]
        numbers = "   ".join(" ".join(f"{100 * value:8.2f}" for value in row) for row in rows)
        named = ", ".join(dict.fromkeys(choice.effect for choice in found.recommended))
        print(f"{arm.title:24s} {numbers}   {named}")


if __name__ == "__main__":
    main()
