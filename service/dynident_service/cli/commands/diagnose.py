"""`dynident diagnose`."""

from __future__ import annotations

from typing import Annotated

from dynident.diagnosis.request import DiagnosisChoices
from dynident_service.cli.options import Measurements, ModelArgument, OutputOptions, Reading
from dynident_service.cli.request_options import RequestOptions, TypedValues


def diagnose(
    model: ModelArgument,
    measurements: Measurements,
    reading: Reading,
    request_options: Annotated[TypedValues, RequestOptions(DiagnosisChoices)],
    result: OutputOptions,
) -> None:
    """Name the physics that a model is missing.

    Give the measurements that it was identified from. --out writes the diagnosis as JSON.
    """
    from dynident.advice import advise
    from dynident.diagnosis import examine
    from dynident_service.adapters.diagnoses import describe_diagnosis
    from dynident_service.cli import inputs, output, result_tables

    identification = inputs.load_model(model)
    robot = identification.model.robot
    choices = request_options.build_request(DiagnosisChoices)
    with inputs.read_recordings("diagnose", measurements, robot, reading, share=0.3) as data:
        examined = examine(
            identification,
            data.recordings,
            candidates=choices.candidates,
            most_effects=choices.max_effects,
            progress=data.progress,
        )
        diagnosis = advise(examined)
    output.write_result(
        result,
        "diagnosis",
        lambda: describe_diagnosis(diagnosis, robot.name),
        lambda console: result_tables.show_diagnosis(console, diagnosis, robot),
    )
