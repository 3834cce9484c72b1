"""Which effects somebody chose, and those that every robot has: by name, before anything knows what they are."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(frozen=True)
class EffectChoice:
    """An effect that somebody chose, on some joints (all that it may sit on where empty), with shape constants.

    `runs` are the labels of the runs that it is in; it is in all of them where there are none.
    """

    effect: str
    joints: tuple[str, ...] = ()
    shape: tuple[tuple[str, float], ...] = field(default=())
    runs: tuple[str, ...] = field(default=())

    def __repr__(self) -> str:
        # Kinds have their words in the catalogue, which those who only choose need not wait for.
        from dynident.effects.written import effect_text

        runs = f", runs={self.runs!r}" if self.runs else ""
        return f"EffectChoice({effect_text(self)}{runs})"

    @property
    def shape_values(self) -> dict[str, float]:
        """The chosen shape constants by name."""
        return dict(self.shape)


DEFAULT_EFFECTS: tuple[EffectChoice, ...] = tuple(
    EffectChoice(name) for name in ("rigid_body", "rotor_inertia", "coulomb", "viscous")
)
"""Every robot has them."""
LINKS: EffectChoice = EffectChoice("rigid_body")
OFFSETS: EffectChoice = EffectChoice("offset")
JOINT_FRICTION: tuple[EffectChoice, ...] = (EffectChoice("coulomb"), EffectChoice("viscous"), OFFSETS)
"""What one joint's torque consists of where it moves alone and at constant speed."""


def load_in(run: str) -> EffectChoice:
    """What the tool carries in the run with that label alone."""
    return EffectChoice("payload", runs=(run,))
