"""`EffectChoice` (effect, joints, shape constants, runs) and the default effects; loads no effect."""

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

    def __post_init__(self) -> None:
        # Whoever gives lists, or a dictionary, gets a choice with a hash as well.
        object.__setattr__(self, "joints", tuple(self.joints))
        object.__setattr__(self, "shape", tuple(dict(self.shape).items()))
        object.__setattr__(self, "runs", tuple(self.runs))

    def __repr__(self) -> str:
        runs = f", runs={self.runs!r}" if self.runs else ""
        return f"EffectChoice({self.to_text()}{runs})"

    def to_text(self, digits: str = ".6g") -> str:
        """Return the choice as text that `text_format.parse_effects` reads, without its runs.

        Parameters
        ----------
        digits : str
            Format of the shape constants that are numbers.
        """
        # Imported here: the catalogue, which has the words for constants, loads CasADi.
        from dynident.effects.catalogue import get_constant_word

        joints = f"@{'+'.join(self.joints)}" if self.joints else ""
        constants = (
            (name, get_constant_word(self.effect, name, value) or format(value, digits)) for name, value in self.shape
        )
        shape = ",".join(f"{name}={text}" for name, text in constants)
        return f"{self.effect}{joints}{':' + shape if shape else ''}"

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
ANGLE_FRICTION: tuple[EffectChoice, ...] = tuple(
    EffectChoice("position_dependent_friction", shape=(("k", cycles),)) for cycles in (1.0, 2.0)
)
"""Friction that depends on the angle of a revolute joint, once and twice a turn."""


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
