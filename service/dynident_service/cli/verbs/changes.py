"""`dynident changes`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from dynident_service.cli.files import TO_READ
from dynident_service.cli.options import ModelArgument, Reading, Result, of_file


def changes(
    model: ModelArgument,
    before: Annotated[list[Path], of_file("--before", help="Earlier measurement; may be repeated."), TO_READ],
    after: Annotated[list[Path], of_file("--after", help="Later measurement; may be repeated."), TO_READ],
    reading: Reading,
    result: Result,
) -> None:
    """Say what has changed in a robot between two sets of measurements.

    The motions may differ. --out writes the diagnosis, changes included, as JSON.
    """
    from dynident.advice import advise
    from dynident.diagnosis import examine
    from dynident_service.adapters.diagnoses import describe_diagnosis
    from dynident_service.cli import inputs, shown, telling

    identification = inputs.model_of(model)
    robot = identification.model.robot
    with inputs.read("compare the days", [*before, *after], robot, reading, share=0.3) as data:
        earlier, later = data.recordings[: len(before)], data.recordings[len(before) :]
        diagnosis = advise(examine(identification, later, baseline=earlier, progress=data.progress))
    telling.tell(
        result,
        "diagnosis",
        lambda: describe_diagnosis(diagnosis, robot.name),
        lambda console: shown.show_changes(console, diagnosis, robot),
    )
