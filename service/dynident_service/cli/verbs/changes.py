"""`dynident changes`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from dynident_service.cli.files import TO_READ
from dynident_service.cli.options import ModelArgument, Reading, Result

_Before = Annotated[
    list[Path],
    typer.Option("--before", metavar="FILE", help="Earlier measurement; may be repeated.", show_default=False),
    TO_READ,
]
_After = Annotated[
    list[Path],
    typer.Option("--after", metavar="FILE", help="Later measurement; may be repeated.", show_default=False),
    TO_READ,
]


def changes(
    model: ModelArgument,
    before: _Before,
    after: _After,
    reading: Reading,
    result: Result,
) -> None:
    """Say what has changed in a robot between two sets of measurements.

    The motions may differ. --out writes the diagnosis, changes included, as JSON.
    """
    from dynident.advice import advise
    from dynident.diagnosis import examine
    from dynident.progress import part
    from dynident_service.adapters.diagnoses import describe_diagnosis
    from dynident_service.cli import inputs, shown, telling, terminal
    from dynident_service.models.common import plain

    identification = inputs.model_of(model)
    robot = identification.model.robot
    with (
        terminal.progress_bar("compare the days") as progress,
        inputs.loaded([*before, *after], robot, reading, part(progress, 0.0, 0.3)) as (given, _),
    ):
        recordings = inputs.recordings_of(given)
        examined = examine(
            identification,
            recordings[len(before) :],
            baseline=recordings[: len(before)],
            progress=part(progress, 0.3, 1.0),
        )
        found = advise(examined)
    telling.tell(
        result,
        "diagnosis",
        lambda: plain(describe_diagnosis(found, robot.name)),
        lambda console: shown.show_changes(console, found, robot),
    )
