"""Validations of a model in a file, on measurements in files, and the methods that are compared, as they are typed."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from dynident.errors import DynidentError
from dynident.identification import Identification
from dynident.identification.choices import STEPS
from dynident.identification.methods.bases import ESTIMATORS, MODELS, PRIORS, STRATEGIES
from dynident.progress import Progress
from dynident.recordings import Recording
from dynident.schema.fields import NamedValues
from dynident.validation import Method
from dynident.validation.request import Methods, Trial, ValidationData
from dynident_service.adapters.validations import describe_validation
from dynident_service.cli.files import read_text
from dynident_service.models.validations import ValidationResult

_TITLE = "Unusable option"


def load_validation(path: Path) -> ValidationResult:
    """Read what `dynident validate --out` wrote.

    Raises
    ------
    DynidentError
        Where the file is not there or holds no validation.
    """
    try:
        return ValidationResult.model_validate_json(read_text(path))
    except ValidationError as error:
        detail = f"{path.name} holds no validation; give what `dynident validate --out` wrote"
        raise DynidentError(detail, pointer="--validated", title="Unusable file") from error


def check_recording_counts(trial: Trial, n_measurements: int, n_held_out: int) -> None:
    """Raise `DynidentError` where measurements are missing, or stand there that the kind does not take."""
    kind = trial.name
    if trial.of_model_alone and n_measurements:
        raise DynidentError(f"{kind} takes no measurement", pointer="MEASUREMENT", title=_TITLE)
    if not trial.of_model_alone and not n_measurements:
        raise DynidentError(f"{kind} needs a measurement", pointer="MEASUREMENT", title=_TITLE)
    if kind == "filters" and n_measurements > 1:
        raise DynidentError("filters are chosen on one measurement; give one", pointer="MEASUREMENT", title=_TITLE)
    if kind == "payload" and not n_held_out:
        raise DynidentError("payload needs the runs without it, too", pointer="--unloaded", title=_TITLE)
    if n_held_out and kind not in ("methods", "payload"):
        raise DynidentError(f"{kind} takes no --validation", pointer="--validation", title=_TITLE)


def run_validation(
    identification: Identification,
    trial: Trial,
    recordings: Sequence[Recording],
    held_out: Sequence[Recording],
    progress: Progress,
) -> ValidationResult:
    """Make a validation."""
    # Methods are tried on what was held out; what is given first is what they learn from.
    tested, others = (held_out, recordings) if isinstance(trial, Methods) else (recordings, held_out)
    outcome = trial.judge(ValidationData(identification, tested, others, progress))
    return describe_validation(trial, outcome, [recording.name for recording in tested])


def parse_methods(arguments: list[str]) -> tuple[Method, ...] | None:
    """Parse methods as `model/strategy/estimator`, each left out or a word of its kind: `filtered`,
    `sequential/ols`, ….

    Raises
    ------
    DynidentError
        With the word that is none of these.
    """
    texts = [item.strip() for text in arguments for item in text.split(",") if item.strip()]
    return tuple(_parse_method(text) for text in texts) or None


def _parse_method(text: str) -> Method:
    words_by_kind: dict[str, Any] = {}
    for word in text.split("/"):
        kind = next((name for name, words in _KINDS.items() if word in words.names), None)
        if kind is None or kind in words_by_kind:
            choices = "; ".join(f"{name}: {', '.join(words.names)}" for name, words in _KINDS.items())
            raise DynidentError(
                f"cannot read {word!r} in {text!r}; write words of these kinds with / between, one of each at most "
                f"({choices})",
                pointer="--methods",
                title=_TITLE,
            )
        words_by_kind[kind] = word
    # Steps have a meaning in the sequential strategy alone.
    if "steps" in words_by_kind:
        words_by_kind.setdefault("strategy", "sequential")
    return Method(**words_by_kind)


_KINDS: dict[str, NamedValues] = {
    "model": MODELS,
    "strategy": STRATEGIES,
    "steps": STEPS,
    "estimator": ESTIMATORS,
    "prior": PRIORS,
}
