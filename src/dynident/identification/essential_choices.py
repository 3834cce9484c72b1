"""Options of the search for the essential parameters."""

from __future__ import annotations

from dataclasses import dataclass

from dynident.asking import declare_field


@dataclass(frozen=True)
class EssentialChoices:
    """How far the backward elimination of parameters goes."""

    ratio: float = declare_field(
        "Largest over smallest relative standard deviation to end at (§12.7)", default=10.0, above=1, at_most=1e6
    )
