"""Request of a diagnosis."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from dynident.schema.fields import check_ranges, declare_field

DEFAULT_MOST_EFFECTS = 12
"""Two for each joint of a usual arm: a search ends where nothing more passes, this only bounds how long it takes."""


@dataclass(frozen=True)
class DiagnosisChoices:
    """Which effects may be missing in a model, and how many are recommended at most.

    Parameters
    ----------
    candidates : tuple of str, optional
        Ids of the effects that may be missing; the whole catalogue where left out.
    max_effects : int
        Largest number of effects that are recommended.
    """

    candidates: tuple[str, ...] | None = declare_field(
        "Ids of the effects to try; the whole catalogue if not given", default=None, fewest=1
    )
    max_effects: int = declare_field(
        "Largest number of recommended effects", default=DEFAULT_MOST_EFFECTS, at_least=1, at_most=100
    )

    def __post_init__(self) -> None:
        check_ranges(self)
        check_candidates(self.candidates or ())


def check_candidates(names: Sequence[str]) -> None:
    """Raise `DynidentError`, with the place in the list, for a name that is no effect of the catalogue."""
    if names:
        # The catalogue takes a second to load.
        from dynident.effects import get_effect

        for index, name in enumerate(names):
            get_effect(name, f"/candidates/{index}")
