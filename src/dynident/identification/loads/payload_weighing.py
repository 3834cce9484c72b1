"""Estimate a payload's mass from runs without and with it, and decide whether that can be trusted.

The standard deviation of the mass covers noise only. What misleads is something else: friction and offsets that are not
the same in both runs, after a pause, warmer, on another day. Where the motion shows the payload well, the mass hardly
changes when the loaded run may have friction and offsets of its own (as in a test of Hausman 1978: both estimates agree
if the simpler model is right). Where it does not, the payload's gravity and these constants stand for one another, and
any mass is possible: then there is no number to report.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import hypot

from dynident.effects import JOINT_FRICTION, EffectChoice
from dynident.estimation import EstimationError
from dynident.estimation.parameter_covariance import NORMAL_95
from dynident.identification.loads.drive_gains import DriveGains, PayloadEstimate, payload_mass
from dynident.identification.loads.payloads_of_recordings import PLAIN_EFFECTS
from dynident.recordings import Preprocessing, Recording
from dynident.robot import Robot

# Difference of both masses that is allowed beside their noise, and largest half-width of the interval, as shares of the
# mass.
_AGREE, _CERTAIN = 0.1, 0.25


@dataclass(frozen=True)
class PayloadVerdict:
    """Whether a payload can be weighed by these runs, and why; its mass where it can.

    Parameters
    ----------
    identifiable : bool
        Whether the runs tell the mass.
    reason : str
        The reason, as a clause.
    mass : float or None
        The mass in kg; None where it is not identifiable.
    interval : tuple of float or None
        Ends in kg of the interval that holds the mass in 95 of 100 cases by both estimates.
    alike : PayloadEstimate
        The mass if friction and offsets are the same in all runs.
    apart : PayloadEstimate or None
        The mass if the loaded run has friction and offsets of its own; None where the runs do not determine these.
    """

    identifiable: bool
    reason: str
    mass: float | None
    interval: tuple[float, float] | None
    alike: PayloadEstimate
    apart: PayloadEstimate | None


def payload_from_pair(
    robot: Robot,
    unloaded: Sequence[Recording],
    loaded: Recording,
    *,
    gains: DriveGains | None = None,
    effects: Sequence[EffectChoice] = PLAIN_EFFECTS,
    preprocessing: Preprocessing | None = None,
) -> PayloadVerdict:
    """Weigh a payload, or say why these runs do not tell its mass.

    Parameters
    ----------
    robot : Robot
        The robot that was recorded.
    unloaded : sequence of Recording
        Recordings without the payload.
    loaded : Recording
        The recording with the payload.
    gains : DriveGains, optional
        Identified drive gains, with their uncertainty.
    effects : sequence of EffectChoice
        The model besides the payload.
    preprocessing : Preprocessing, optional
        Filters; from the data where left out.

    Returns
    -------
    PayloadVerdict
        The mass with its interval, or the reason why there is none.

    Raises
    ------
    DynidentError
        Where the recordings do not determine even the simpler model.
    """

    def weigh(own: tuple[EffectChoice, ...]) -> PayloadEstimate:
        return payload_mass(robot, unloaded, loaded, gains=gains, effects=(*effects, *own), preprocessing=preprocessing)

    alike = weigh(())
    # The second model gives the loaded run friction and offsets of its own.
    own = tuple(replace(choice, runs=(loaded.name,)) for choice in JOINT_FRICTION)
    try:
        with_own = weigh(own)
    except EstimationError as error:
        reason = f"with separate friction and offsets the loaded run does not determine the payload: {error.detail}"
        return _not_identifiable(reason, alike, None)
    return compare_estimates(alike, with_own)


def compare_estimates(alike: PayloadEstimate, apart: PayloadEstimate) -> PayloadVerdict:
    """Compare two estimates of one mass: with the friction of all runs alike, and with the loaded run's own.

    Parameters
    ----------
    alike, apart : PayloadEstimate
        Estimates of the mass with common friction, and with friction of the loaded run's own.

    Returns
    -------
    PayloadVerdict
        The mass where both agree and are certain enough.
    """
    deviation = hypot(alike.standard_deviation, apart.standard_deviation)
    between = abs(alike.mass - apart.mass)
    both = (
        f"{_write_mass(alike)} if friction and offsets are the same in all runs, {_write_mass(apart)} if the loaded "
        "run has separate friction and offsets"
    )
    # More than noise and a tenth apart: the mass depends on which model is right, and nothing tells that.
    if between > NORMAL_95 * deviation + _AGREE * abs(alike.mass):
        return _not_identifiable(
            f"the mass is not identifiable from this motion: the estimates are {both}. Its gravity looks like a "
            "change of friction or offset here; in the loaded run move the joints that lift it further, and more "
            "slowly",
            alike,
            apart,
        )
    if alike.mass <= 0 or apart.mass <= 0:
        return _not_identifiable(f"the data show no payload: {both}", alike, apart)
    widest = max(alike.standard_deviation, apart.standard_deviation)
    if NORMAL_95 * widest > _CERTAIN * alike.mass:
        return _not_identifiable(
            "the mass is not identifiable from this motion: its uncertainty is more than a quarter of its value "
            f"({both}); move the joints that lift it further, or record for longer",
            alike,
            apart,
        )
    # The union of both intervals: whichever model is right, the interval holds the mass.
    interval = min(alike.interval[0], apart.interval[0]), max(alike.interval[1], apart.interval[1])
    return PayloadVerdict(True, f"the runs agree: {both}", alike.mass, interval, alike, apart)


def _not_identifiable(reason: str, alike: PayloadEstimate, with_own: PayloadEstimate | None) -> PayloadVerdict:
    return PayloadVerdict(False, reason, None, None, alike, with_own)


def _write_mass(estimate: PayloadEstimate) -> str:
    return f"{estimate.mass:.3g} ± {NORMAL_95 * estimate.standard_deviation:.2g} kg"
