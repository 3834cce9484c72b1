"""Choices of effects by name, and the default ones; the effects themselves are not loaded for them."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(frozen=True)
class EffectChoice:
    """A chosen effect.

    Parameters
    ----------
    effect : str
        Id in the catalogue.
    joints : tuple of str
        Joints that it acts on; empty for the effect's default joints.
    shape : tuple of (str, float)
        Shape constants.
    runs : tuple of str
        Labels of the runs that it is in; empty for all runs.
    """

    effect: str
    joints: tuple[str, ...] = ()
    shape: tuple[tuple[str, float], ...] = field(default=())
    runs: tuple[str, ...] = field(default=())

    def __repr__(self) -> str:
        # Imported here: the catalogue, which has the words for constants, loads CasADi.
        from dynident.effects.text_format import format_effect

        runs = f", runs={self.runs!r}" if self.runs else ""
        return f"EffectChoice({format_effect(self)}{runs})"

    @property
    def shape_values(self) -> dict[str, float]:
        """The chosen shape constants by name."""
        return dict(self.shape)


DEFAULT_EFFECTS: tuple[EffectChoice, ...] = tuple(
    EffectChoice(name) for name in ("rigid_body", "rotor_inertia", "coulomb", "viscous")
)
"""Effects that every robot has."""
LINKS: EffectChoice = EffectChoice("rigid_body")
OFFSETS: EffectChoice = EffectChoice("offset")
JOINT_FRICTION: tuple[EffectChoice, ...] = (EffectChoice("coulomb"), EffectChoice("viscous"), OFFSETS)
"""Effects on one joint that moves alone, at constant speed, without load."""


def choose_payload(run: str) -> EffectChoice:
    """Return the choice of a payload in one run only.

    Parameters
    ----------
    run : str
        Label of the run.

    Returns
    -------
    EffectChoice
        The effect `payload` on its default joint.
    """
    return EffectChoice("payload", runs=(run,))
