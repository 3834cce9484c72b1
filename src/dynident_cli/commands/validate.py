"""`dynident validate`: run validations of a model."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from dynident.validation.validation_request import TRIALS, Stated, build_trial
from dynident_cli.option_parsers import READABLE_FILE
from dynident_cli.request_options import RequestOptions, TypedValues, find_option
from dynident_cli.shared_options import (
    ModelArgument,
    OutputOptions,
    Reading,
    SomeFiles,
    Validation,
    file_option,
)

if TYPE_CHECKING:
    from dynident.schema.fields import NamedValues
    from dynident.validation import Method
    from dynident.validation.validation_request import Trial


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
    unloaded: Annotated[SomeFiles, file_option("--unloaded", help="For payload: recordings without the load.")] = None


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
            metavar="RECORDING",
            help="direct, methods, filters: the identification recordings; cross: held-out recordings; simulation, "
            "drift: the motion to simulate; collision: held-out recordings without contacts; payload: recordings with "
            "the load.",
            show_default=False,
        ),
        READABLE_FILE,
    ] = None,
) -> None:
    """Test whether an identified model can be trusted.

    The result is pass, fail or not evaluated, with the reason; the exit code is 1 after fail.
    --out writes the result as JSON.
    """
    from dynident.api.model_identification import load_model
    from dynident.errors import DynidentError
    from dynident.validation.validation_request import Methods, ValidationData
    from dynident_cli import argument_loading, command_output, contract_documents, printed_results

    identification = load_model(model).identification
    options: Any = request_options.build_request(Stated, methods=parse_methods(further.methods or []))
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
    check_recording_counts(trial, len(paths), len(others))
    robot = identification.model.robot
    with argument_loading.read_recordings("validate", paths, robot, reading, others, share=0.3) as data:
        recordings, held_out, progress = data
        # Methods are tried on what was held out; what is given first is what they learn from.
        tested, rest = (held_out, recordings) if isinstance(trial, Methods) else (recordings, held_out)
        judged = trial.judge(ValidationData(identification, tested.recordings, rest.recordings, progress))
    outcome = contract_documents.describe_validation(trial, judged, tested.names)
    command_output.write_result(
        result,
        "result",
        lambda: contract_documents.to_document(outcome),
        lambda console: printed_results.show_validation(console, outcome, robot),
    )
    if outcome.verdict == "fail":
        raise typer.Exit(1)


_TITLE = "Unusable option"


def check_recording_counts(trial: Trial, n_measurements: int, n_held_out: int) -> None:
    """Raise `DynidentError` where measurements are missing, or stand there that the kind does not take."""
    from dynident.errors import DynidentError

    kind = trial.name
    if trial.of_model_alone and n_measurements:
        raise DynidentError(f"{kind} takes no recording", pointer="RECORDING", title=_TITLE)
    if not trial.of_model_alone and not n_measurements:
        raise DynidentError(f"{kind} needs a recording", pointer="RECORDING", title=_TITLE)
    if kind == "filters" and n_measurements > 1:
        raise DynidentError("filters needs exactly one recording", pointer="RECORDING", title=_TITLE)
    if kind == "payload" and not n_held_out:
        raise DynidentError(
            "payload also needs the runs without the load: --unloaded", pointer="--unloaded", title=_TITLE
        )
    if n_held_out and kind not in ("methods", "payload"):
        raise DynidentError(f"{kind} takes no --validation", pointer="--validation", title=_TITLE)


def parse_methods(arguments: list[str]) -> tuple[Method, ...] | None:
    """Parse methods as `model/strategy/estimator`.

    Each of the three may be left out: `filtered`, `sequential/ols`. Refuse the word that is none of these.
    """
    texts = [item.strip() for text in arguments for item in text.split(",") if item.strip()]
    return tuple(_parse_method(text) for text in texts) or None


def _parse_method(text: str) -> Method:
    from dynident.errors import DynidentError
    from dynident.identification.identification_choices import STEPS
    from dynident.identification.methods.base_classes import ESTIMATORS, MODELS, PRIORS, STRATEGIES
    from dynident.validation import Method

    kinds: dict[str, NamedValues] = {
        "model": MODELS,
        "strategy": STRATEGIES,
        "steps": STEPS,
        "estimator": ESTIMATORS,
        "prior": PRIORS,
    }
    words_by_kind: dict[str, Any] = {}
    for word in text.split("/"):
        kind = next((name for name, words in kinds.items() if word in words.names), None)
        if kind is None or kind in words_by_kind:
            choices = "; ".join(f"{name}: {', '.join(words.names)}" for name, words in kinds.items())
            raise DynidentError(
                f"cannot read {word!r} in {text!r}; write words of these kinds, separated by /, at most one of "
                f"each ({choices})",
                pointer="--methods",
                title=_TITLE,
            )
        words_by_kind[kind] = word
    # Steps have a meaning in the sequential strategy alone.
    if "steps" in words_by_kind:
        words_by_kind.setdefault("strategy", "sequential")
    return Method(**words_by_kind)
