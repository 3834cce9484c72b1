"""All methods on the recordings of a real arm, and the table of docs/methods.md.

    python benchmarks/methods_on_an_arm.py

A UR10e in ../shared/data: identified from a motion of 30 s, friction apart from sweeps of three joints; held out are
moves from point to point and another motion of 50 s, standstill and all. The errors are those on the rows where each
joint moves. Writes the table between its two marks; takes a minute.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Mapping
from pathlib import Path

from common import RECORDINGS

import dynident as dy
from dynident.identification import Identification
from dynident.recordings import Recording
from dynident.validation import Method, MethodResult, available_methods, validate_methods

PAGE = Path(__file__).resolve().parents[1] / "docs" / "methods.md"
BEGIN, END = "<!-- python benchmarks/methods_on_an_arm.py -->", "<!-- end of the table -->"
ARM = RECORDINGS / "ur10e"
GAINS = (14.87, 13.26, 11.13, 10.62, 11.03, 11.47)
HEAD = "| method | point to point | by joint | 50 s | by joint | $d$ |\n|---|---|---|---|---|---|"
Results = Mapping[Method, MethodResult]


def main() -> None:
    if not ARM.is_dir():
        sys.exit(f"there are no recordings in {ARM}")
    robot = dy.load_robot(ARM / "robot.urdf", drive_gains=GAINS)
    fit, moves, longer = (
        dy.read_recordings(ARM / f"{name}.parquet", robot=robot)
        for name in ("id_30s_12harm", "val_ptp10", "id_50s_12harm")
    )
    sweeps = dy.read_recordings(
        *(ARM / f"joint{j}_sweep.parquet" for j in (1, 2, 3)),
        robot=robot,
        metadata=dy.RecordingMetadata(role="friction"),
    )
    model = dy.identify(robot, fit, effects=["default", "offset"]).identification
    tried = [run.recordings[0] for run in (moves, longer)]
    both = [of_all(model, list(fit.recordings), list(sweeps.recordings), one) for one in tried]
    rows = "\n".join(row(method, both[0][method], both[1][method]) for method in both[0] if method in both[1])
    text = PAGE.read_text(encoding="utf-8")
    new = f"{BEGIN}\n{HEAD}\n{rows}\n{END}"
    PAGE.write_text(re.sub(f"{re.escape(BEGIN)}.*?{re.escape(END)}", lambda _: new, text, flags=re.DOTALL), "utf-8")
    print(rows)


def of_all(model: Identification, fit: list[Recording], sweeps: list[Recording], held_out: Recording) -> Results:
    """Every method's result that there is; the runs of single joints are for the strategy that asks for them alone."""
    methods = available_methods(model.choices)
    apart = [one for one in methods if one.strategy == "separate_friction"]
    found = validate_methods(model, fit, [held_out], [one for one in methods if one not in apart]).results
    # What they are held against stands before them, as it does above.
    found += validate_methods(model, [*fit, *sweeps], [held_out], [methods[0], *apart]).results[1:]
    by_method = {one.method: one for one in found if one.held_out_moving is not None}
    return {method: by_method[method] for method in methods if method in by_method}


def row(method: Method, moves: MethodResult, longer: MethodResult) -> str:
    """One row of the table, in per cent."""
    cells = [method.words]
    for one in (moves, longer):
        errors = one.held_out_moving
        assert errors is not None
        cells += [f"{100 * errors.relative_total:.2f}", " · ".join(f"{100 * share:.1f}" for share in errors.relative)]
    assert moves.distance_rms is not None
    return f"| {' | '.join([*cells, f'{moves.distance_rms:.1f}'])} |"


if __name__ == "__main__":
    main()
