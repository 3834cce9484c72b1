"""Validations of a model in a file, on measurements in files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import get_args

from pydantic import ValidationError

from dynident.errors import DynidentError
from dynident.estimation.bootstrap import DRAWS
from dynident.identification import Identification
from dynident.progress import Progress, part
from dynident.recordings import Recording
from dynident.validation import (
    LARGEST_ERROR,
    Method,
    filters_by_simulation,
    validate_bootstrap,
    validate_cross,
    validate_direct,
    validate_inertia_matrix,
    validate_methods,
    validate_payload,
    validate_simulation,
)
from dynident.validation.filters import LONGEST as LONGEST_FOR_FILTERS
from dynident.validation.simulation import LONGEST
from dynident_service.adapters import validations as adapter
from dynident_service.cli import inputs
from dynident_service.models.validations import ValidationKind, ValidationResult

_TITLE = "Unusable option"
_OF_THE_MODEL: tuple[ValidationKind, ...] = ("inertia_matrix", "bootstrap")


@dataclass(frozen=True)
class Asked:
    """What the options of a validation say."""

    kind: ValidationKind
    methods: tuple[Method, ...] | None = None
    limit: float | None = None
    cutoffs: tuple[float, ...] | None = None
    longest: float | None = None
    mass: float | None = None
    draws: int | None = None
    seed: int = 0


def kind_of(name: str) -> ValidationKind:
    """The kind of validation of that name."""
    for kind in get_args(ValidationKind):
        if name == kind:
            found: ValidationKind = kind
            return found
    raise DynidentError(
        f"there is no validation {name!r}; choose from: {', '.join(get_args(ValidationKind))}",
        pointer="KIND",
        title=_TITLE,
    )


def stored_validation(path: Path) -> ValidationResult:
    """Read what `dynident validate --out` wrote.

    Raises
    ------
    DynidentError
        Where the file is not there or holds no validation.
    """
    try:
        return ValidationResult.model_validate_json(inputs.read_text(path))
    except ValidationError as error:
        detail = f"{path.name} holds no validation; give what `dynident validate --out` wrote"
        raise DynidentError(detail, pointer="--validated", title="Unusable file") from error


def check(asked: Asked, n_measurements: int, n_held_out: int) -> None:
    """Raise `DynidentError` where measurements are missing, or options stand there that the kind does not take."""
    for option, kinds in _TAKEN_BY.items():
        if getattr(asked, option) is not None and asked.kind not in kinds:
            raise DynidentError(f"{asked.kind} takes no --{option}", pointer=f"--{option}", title=_TITLE)
    if asked.draws is not None and not 99 <= asked.draws <= 9999:
        raise DynidentError(
            f"--draws is {asked.draws}; give 99 to 9999, or leave it out for {DRAWS}", pointer="--draws", title=_TITLE
        )
    if asked.kind in _OF_THE_MODEL and n_measurements:
        raise DynidentError(f"{asked.kind} takes no measurement", pointer="MEASUREMENT", title=_TITLE)
    if asked.kind not in _OF_THE_MODEL and not n_measurements:
        raise DynidentError(f"{asked.kind} needs a measurement", pointer="MEASUREMENT", title=_TITLE)
    if asked.kind == "filters" and n_measurements > 1:
        raise DynidentError("filters are chosen on one measurement; give one", pointer="MEASUREMENT", title=_TITLE)
    if asked.kind == "payload" and not n_held_out:
        raise DynidentError("payload needs the runs without it, too", pointer="--unloaded", title=_TITLE)
    if n_held_out and asked.kind not in ("methods", "payload"):
        raise DynidentError(f"{asked.kind} takes no --validation", pointer="--validation", title=_TITLE)


def run(
    identification: Identification,
    asked: Asked,
    recordings: Sequence[Recording],
    held_out: Sequence[Recording],
    progress: Progress,
) -> ValidationResult:
    """Make the validation that was asked for."""
    names = [recording.name for recording in recordings]
    limit = LARGEST_ERROR if asked.limit is None else asked.limit
    match asked.kind:
        case "direct":
            return adapter.describe_torque(
                "direct", validate_direct(identification, recordings, limit, progress), names
            )
        case "cross":
            return adapter.describe_torque("cross", validate_cross(identification, recordings, limit, progress), names)
        case "inertia_matrix":
            return adapter.describe_inertia_matrix(
                validate_inertia_matrix(identification, seed=asked.seed, progress=progress)
            )
        case "bootstrap":
            draws = DRAWS if asked.draws is None else asked.draws
            return adapter.describe_bootstrap(
                validate_bootstrap(identification, draws=draws, seed=asked.seed, progress=progress)
            )
        case "methods":
            return adapter.describe_methods(
                validate_methods(identification, recordings, held_out, asked.methods, progress)
            )
        case "simulation":
            longest = LONGEST if asked.longest is None else asked.longest
            shares = [part(progress, k / len(names), (k + 1) / len(names)) for k in range(len(names))]
            found = [
                validate_simulation(identification, recording, limit, longest, share)
                for recording, share in zip(recordings, shares, strict=True)
            ]
            return adapter.describe_simulations(found, names)
        case "filters":
            chosen = filters_by_simulation(
                identification,
                recordings[0],
                cutoffs=asked.cutoffs,
                longest=LONGEST_FOR_FILTERS if asked.longest is None else asked.longest,
                seed=asked.seed,
                progress=progress,
            )
            return adapter.describe_filters(chosen)
        case "payload":
            weighed = [validate_payload(identification, held_out, one, asked.mass) for one in recordings]
            return adapter.describe_payloads(weighed, names)


_TAKEN_BY: dict[str, tuple[ValidationKind, ...]] = {
    "methods": ("methods",),
    "limit": ("direct", "cross", "simulation"),
    "cutoffs": ("filters",),
    "longest": ("simulation", "filters"),
    "mass": ("payload",),
    "draws": ("bootstrap",),
}
