"""`dynident validate`: run validations of a model."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Any

import typer

from dynident.validation.validation_request import TRIALS, Stated, build_trial
from dynident_service.cli.input_checks_and_writes import READABLE_FILE
from dynident_service.cli.request_options import RequestOptions, TypedValues, find_option
from dynident_service.cli.shared_options import (
    ModelArgument,
    OutputOptions,
    Reading,
    SomeFiles,
    Validation,
    file_option,
)


@dataclass(frozen=True)
class FurtherInputs:
    """Further input files besides the measurements."""

    validation: Validation
    methods: Annotated[
        list[str] | None,
        typer.Option(
            "--methods",
            metavar="MODEL/STRATEGY/ESTIMATOR,…",
            help="For methods: the methods to compare; filtered or sequential/ols is enough. All available ones by "
            "default.",
            show_default=False,
        ),
    ] = None
    unloaded: Annotated[SomeFiles, file_option("--unloaded", help="For payload: runs without the load.")] = None


def validate(
    model: ModelArgument,
    kind: Annotated[str, typer.Argument(metavar="KIND", help=f"One of: {TRIALS.format_help()}.", show_default=False)],
    request_options: Annotated[TypedValues, RequestOptions(Stated)],
    further: FurtherInputs,
    reading: Reading,
    result: OutputOptions,
    measurements: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="[MEASUREMENT]…",
            help="direct, methods, filters: what the model was identified from; cross: what it has not seen; "
            "simulation: the motion; payload: runs with the load.",
            show_default=False,
        ),
        READABLE_FILE,
    ] = None,
) -> None:
    """Test whether an identified model can be trusted.

    The result is pass, fail or not evaluated, with the reason; the exit code is 1 after fail.
    --out writes the result as JSON.
    """
    from dynident.errors import DynidentError
    from dynident_service.cli import argument_loading, command_output, typed_validations

    identification = argument_loading.load_model(model)
    options: Any = request_options.build_request(Stated, methods=typed_validations.parse_methods(further.methods or []))
    try:
        trial = build_trial(
            kind, {option_field.name: getattr(options, option_field.name) for option_field in fields(options)}
        )
    except DynidentError as error:
        # The kind is an argument; all else are options.
        place = "KIND" if error.pointer == "/kind" else find_option(Stated, error.pointer)
        raise DynidentError(error.detail, pointer=place, title="Unusable option") from error
    paths = measurements or []
    others = [*further.validation, *(further.unloaded or [])]
    typed_validations.check_recording_counts(trial, len(paths), len(others))
    robot = identification.model.robot
    with argument_loading.read_recordings("validate", paths, robot, reading, others, share=0.3) as data:
        outcome = typed_validations.run_validation(
            identification, trial, data.recordings, data.other_recordings, data.progress
        )
    command_output.write_result(
        result,
        "result",
        lambda: outcome,
        lambda console: typed_validations.show_validation(console, outcome, robot),
    )
    if outcome.verdict == "fail":
        raise typer.Exit(1)
