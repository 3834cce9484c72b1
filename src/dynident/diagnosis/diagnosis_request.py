"""The request of a diagnosis: its fields with their ranges, and the default level and number of effects."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from dynident.diagnosis.decision_levels import RULES, DecisionRules
from dynident.errors import DynidentError
from dynident.robot.limits_and_drives import HARDWARE, check_hardware
from dynident.schema.fields import Request, declare_field

if TYPE_CHECKING:
    from dynident.recordings import Recording

DEFAULT_MOST_EFFECTS = int(RULES.max_effects)
"""Contacts do not count: they are events of a recording, not effects of the arm."""

DEFAULT_SIGNIFICANCE = RULES.significance


@dataclass(frozen=True)
class DiagnosisChoices(Request):
    """Which effects may be missing in a model, and how many are recommended at most.

    Parameters
    ----------
    candidates : tuple of str, optional
        Ids of the effects that may be missing; the whole catalogue where left out.
    max_effects : int
        Largest number of effects that are recommended, contacts not counted.
    significance : float
        Probability that anything at all is named where nothing is missing: the largest p-value of a finding among all
        that is tried together.
    has, has_not : tuple of str
        Parts that the robot has or does not have, beside those that the robot states: effects of parts that it does not
        have are not tried unless `candidates` lists them, and about parts that nobody has told of the diagnosis asks.
    """

    candidates: tuple[str, ...] | None = declare_field(
        "Ids of the effects to try; the whole catalogue if not given", default=None, fewest=1
    )
    max_effects: int = declare_field(
        "Largest number of recommended effects; contacts do not count",
        default=DEFAULT_MOST_EFFECTS,
        at_least=1,
        at_most=100,
    )
    significance: float = declare_field(
        "Largest p-value of a finding: the probability that an effect is named although nothing is missing",
        default=DEFAULT_SIGNIFICANCE,
        at_least=0.001,
        at_most=0.2,
    )
    has: tuple[str, ...] = declare_field(
        f"Parts that the robot has, besides those stated with it: {', '.join(HARDWARE)}",
        default=(),
    )
    has_not: tuple[str, ...] = declare_field(
        "Parts that the robot does not have, besides those stated with it", default=()
    )

    @property
    def hardware(self) -> dict[str, bool]:
        """Whether the robot has a part, by the part's name."""
        return {**dict.fromkeys(self.has, True), **dict.fromkeys(self.has_not, False)}

    @property
    def rules(self) -> DecisionRules:
        """The levels of the decision, with those that the request sets."""
        return DecisionRules(significance=self.significance, max_effects=self.max_effects)

    def __post_init__(self) -> None:
        super().__post_init__()
        check_candidates(self.candidates or ())
        check_hardware(self.has, self.has_not)


def check_candidates(names: Sequence[str]) -> None:
    """Raise `DynidentError`, with the place in the list, for a name that is no effect of the catalogue."""
    if names:
        # The catalogue takes a second to load.
        from dynident.effects import get_effect

        for index, name in enumerate(names):
            get_effect(name, f"/candidates/{index}")


def check_recordings(recordings: Sequence[Recording]) -> None:
    """Check that what is missing in a model shows in the recordings.

    Raises
    ------
    DynidentError
        For poses at rest, and torques that were computed from commands.
    """
    # Whoever asks for the fields of a request alone needs no NumPy.
    from dynident.recordings.pose_recordings import has_poses

    if any(has_poses(recording) for recording in recordings):
        raise DynidentError(
            "poses at rest show only gravity and constant torques, which the model has already; record a motion and "
            "identify from it to find other effects",
            pointer="/recordings",
            title="Poses at rest",
        )
    if any(recording.torque_from_commands for recording in recordings):
        raise DynidentError(
            "no torque was recorded: it was computed from the servos' commands. A supply voltage that drops under "
            "load, play between motor and encoder and late commands change the true torque as effects of the arm "
            "would, and these would get their names. Record the currents of the servos (Present_Current) to find what "
            "the model lacks",
            pointer="/recordings",
            title="No measured torque",
        )
