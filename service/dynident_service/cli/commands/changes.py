"""`dynident changes`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from dynident_service.cli.files import READABLE_FILE
from dynident_service.cli.options import ModelArgument, OutputOptions, Reading, file_option


def changes(
    model: ModelArgument,
    before: Annotated[list[Path], file_option("--before", help="Earlier measurement; may be repeated."), READABLE_FILE],
    after: Annotated[list[Path], file_option("--after", help="Later measurement; may be repeated."), READABLE_FILE],
    reading: Reading,
    result: OutputOptions,
) -> None:
    """Say what has changed in a robot between two sets of measurements.

    The motions may differ. --out writes the diagnosis, changes included, as JSON.
    """
    from dynident.advice import advise
    from dynident.diagnosis import examine
    from dynident_service.adapters.diagnoses import describe_diagnosis
    from dynident_service.cli import inputs, output, result_tables

    identification = inputs.load_model(model)
    robot = identification.model.robot
    with inputs.read_recordings("compare the days", [*before, *after], robot, reading, share=0.3) as data:
        # All files are read together, so that equal names are told apart.
        earlier, later = data.recordings[: len(before)], data.recordings[len(before) :]
        diagnosis = advise(examine(identification, later, baseline=earlier, progress=data.progress))
    output.write_result(
        result,
        "diagnosis",
        lambda: describe_diagnosis(diagnosis, robot.name),
        lambda console: result_tables.show_changes(console, diagnosis, robot),
    )
