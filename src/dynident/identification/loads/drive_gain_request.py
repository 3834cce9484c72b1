"""The request field of a known load: its mass, centre and inertia."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from dynident.schema.fields import Request, declare_field


@dataclass(frozen=True)
class KnownLoad(Request):
    """A known load, from which drive gains are identified."""

    mass: float | None = declare_field(
        "Mass of the known load, if the measurements do not state it",
        default=None,
        unit="kg",
        at_least=1e-6,
        at_most=1e6,
    )
    centre: tuple[float, float, float] | None = declare_field(
        "Centre of the known load in the last joint's frame, if known",
        default=None,
        unit="m",
        at_least=-100,
        at_most=100,
    )

    def override_payload(self, own: Mapping[str, object] | None) -> Mapping[str, object] | None:
        """Return the payload of a recording's metadata with the values of this load in place of its own.

        Parameters
        ----------
        own : mapping, optional
            What the recording states.
        """
        stated = {"mass": self.mass, "centre": self.centre}
        present = {name: value for name, value in stated.items() if value is not None}
        return {**(own or {}), **present} if present else own
