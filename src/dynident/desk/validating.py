"""Whether a model is to be trusted."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import overload

from dynident.desk.identifying import as_model
from dynident.desk.model import Model
from dynident.desk.recordings import SomeRecordings, as_recordings
from dynident.desk.texts import text_table
from dynident.html import block, paragraph, table
from dynident.identification import Identification
from dynident.progress import Progress, part, silent
from dynident.validation import (
    LARGEST_ERROR,
    Judged,
    Verdict,
    together,
    validate_cross,
    validate_direct,
    validate_inertia_matrix,
)
from dynident.verdict import Outcome

_COLUMNS = ("validation", "verdict", "why")
_WORDS = {"pass": "✓ pass", "fail": "✕ fail", "not_evaluated": "– not evaluated"}


@dataclass(frozen=True)
class Validation(Outcome):
    """One test of a model: its `kind`, how it ended and why, in `judged`, and what was tried in words."""

    title: str

    @property
    def verdict(self) -> Verdict:
        """pass, fail or not_evaluated."""
        return self.judged.verdict


@dataclass(frozen=True, eq=False)
class Validations(Sequence[Validation]):
    """Several tests of one model; `verdict` of all together: one that fails makes all fail."""

    items: tuple[Validation, ...]

    @property
    def verdict(self) -> Verdict:
        """pass, fail or not_evaluated."""
        return together([(one.title, one.judged) for one in self.items]).verdict

    def __len__(self) -> int:
        return len(self.items)

    def __iter__(self) -> Iterator[Validation]:
        return iter(self.items)

    @overload
    def __getitem__(self, index: int) -> Validation: ...
    @overload
    def __getitem__(self, index: slice) -> Validations: ...
    def __getitem__(self, index: int | slice) -> Validation | Validations:
        return Validations(self.items[index]) if isinstance(index, slice) else self.items[index]

    def __repr__(self) -> str:
        return text_table(f"Validations({self.verdict})", _COLUMNS, self._rows(), len(self.items), right_from=3)

    def _repr_html_(self) -> str:
        return block(
            paragraph(f"Validations: {_WORDS[self.verdict]}", strong=True), table(_COLUMNS, self._rows(), right_from=3)
        )

    def _rows(self) -> list[tuple[str, ...]]:
        return [(one.title, _WORDS[one.verdict], one.judged.reason) for one in self.items]


def validate(
    model: Model | Identification,
    validation: SomeRecordings | None = None,
    *,
    limit: float = LARGEST_ERROR,
    seed: int = 0,
    progress: Progress = silent,
) -> Validations:
    """Try a model on its own recordings, on others, and its inertia matrix over the whole joint range (§12.7).

    `dynident.validation` has more: a known load, a simulator against a recording, all methods in one table.

    Parameters
    ----------
    model : Model
    validation : recordings, optional
        What no parameter saw; the model's own validation recordings where nothing is said.
    limit : float
        Largest relative torque error over all joints that passes.
    seed : int
        Of the postures among which the worst one is sought.

    Raises
    ------
    DynidentError
        For a limit that is not above zero, or another robot's recordings.
    """
    known = as_model(model)
    tried = known.validation if validation is None else as_recordings(validation)
    found = known.identification
    none = Judged("not_evaluated", "There are no such recordings.")
    direct = cross = none
    if known.recordings:
        direct = validate_direct(found, known.recordings.recordings, limit, part(progress, 0.0, 0.3)).judged
    if tried:
        cross = validate_cross(found, tried.recordings, limit, part(progress, 0.3, 0.6)).judged
    inertia = validate_inertia_matrix(found, seed=seed, progress=part(progress, 0.6, 1.0)).judged
    return Validations(
        (
            Validation("direct", direct, "direct: on the identification's own data"),
            Validation("cross", cross, "cross: on data that no parameter saw"),
            Validation("inertia_matrix", inertia, "inertia matrix over the joint range"),
        )
    )
