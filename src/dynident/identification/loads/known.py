"""The known load of a request."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from dynident.asking import said


@dataclass(frozen=True)
class KnownLoad:
    """The load that drive gains are told by."""

    mass: float | None = said(
        "Mass of the known load, where the measurements do not state it",
        default=None,
        unit="kg",
        at_least=1e-6,
        at_most=1e6,
    )
    centre: tuple[float, float, float] | None = said(
        "Centre of the known load in the last joint's frame, where known",
        default=None,
        unit="m",
        at_least=-100,
        at_most=100,
    )

    def over(self, own: Mapping[str, object] | None) -> Mapping[str, object] | None:
        """What is stated of a recording's payload: `own` by itself, or this over it."""
        stated = {"mass": self.mass, "centre": self.centre}
        given = {name: value for name, value in stated.items() if value is not None}
        return {**(own or {}), **given} if given else own
