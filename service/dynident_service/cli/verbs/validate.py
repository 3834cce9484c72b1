"""`dynident validate`."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Any

import typer

from dynident.validation.request import TRIALS, Stated, trial_of
from dynident_service.cli.asked import Asks, Typed
from dynident_service.cli.files import TO_READ
from dynident_service.cli.options import ModelArgument, Reading, Result, SomeFiles, Validation, of_file


@dataclass(frozen=True)
class Beside:
    """What is given beside the measurements."""

    validation: Validation
    methods: Annotated[
        list[str] | None,
        typer.Option(
            "--methods",
            metavar="MODEL/STRATEGY/ESTIMATOR,…",
            help="For methods: which; filtered or sequential/ols is enough. All that are available if left out.",
            show_default=False,
        ),
    ] = None
    unloaded: Annotated[SomeFiles, of_file("--unloaded", help="For payload: runs without the load.")] = None


def validate(
    model: ModelArgument,
    kind: Annotated[str, typer.Argument(metavar="KIND", help=f"One of: {TRIALS.told()}.", show_default=False)],
    request_options: Annotated[Typed, Asks(Stated)],
    further: Beside,
    reading: Reading,
    result: Result,
    measurements: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="[MEASUREMENT]…",
            help="direct, methods, filters: what the model was identified from; cross: what it has not seen; "
            "simulation: the motion; payload: runs with the load.",
            show_default=False,
        ),
        TO_READ,
    ] = None,
) -> None:
    """Try whether an identified model is to be trusted.

    Ends with pass, fail or not evaluated and the reason; exit code 1 after fail. --out writes the result as JSON.
    """
    from dynident.errors import DynidentError
    from dynident_service.cli import inputs, shown_validations, telling, validating

    identification = inputs.model_of(model)
    options: Any = request_options.request(Stated, methods=validating.methods_of(further.methods or []))
    try:
        trial = trial_of(
            kind, {option_field.name: getattr(options, option_field.name) for option_field in fields(options)}
        )
    except DynidentError as error:
        option = error.pointer.replace("/kind", "KIND").replace("/", "--")
        raise DynidentError(error.detail, pointer=option, title="Unusable option") from error
    paths = measurements or []
    others = [*further.validation, *(further.unloaded or [])]
    validating.check(trial, len(paths), len(others))
    robot = identification.model.robot
    with inputs.read("validate", paths, robot, reading, others, share=0.3) as data:
        outcome = validating.run(identification, trial, data.recordings, data.other_recordings, data.progress)
    telling.tell(
        result,
        "result",
        lambda: outcome,
        lambda console: shown_validations.show_validation(console, outcome, robot),
    )
    if outcome.verdict == "fail":
        raise typer.Exit(1)
