"""Validation by a known load: does the model give its mass? Passes within 5 % or its interval."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from dynident.effects import EffectChoice, get_effect
from dynident.errors import DynidentError
from dynident.identification import Identification, PayloadVerdict, payload_from_pair
from dynident.identification.identification_choices import KnownLoad
from dynident.identification.loads.drive_gains import DriveGains, identify_gains
from dynident.identification.loads.payloads_of_recordings import read_known_payload
from dynident.identification.thresholds import ValidationOutcome
from dynident.number_format import format_percent
from dynident.recordings import Recording
from dynident.schema.fields import check_value

# Off by more than this share is wrong, whatever the interval; by less is right: gains are hardly known better.
_AS_STATED = 0.05


@dataclass(frozen=True, eq=False)
class PayloadValidation:
    """The load of one recording: its stated mass, and what it weighs by the runs without and with it.

    Parameters
    ----------
    name : str
        Name of the recording with the load.
    stated : float
        Stated mass in kg.
    weighed : PayloadVerdict
        The mass that the runs give, with its interval.
    gains : DriveGains or None
        What the drive gains would have to be for the stated mass; None where the runs do not determine them.
    judged : ValidationOutcome
        Whether the two masses agree, and the reason.
    """

    name: str
    stated: float
    weighed: PayloadVerdict
    gains: DriveGains | None
    judged: ValidationOutcome


def validate_payload(
    identification: Identification, unloaded: Sequence[Recording], loaded: Recording, mass: float | None = None
) -> PayloadValidation:
    """Weigh a known load from runs without and with it, and compare with its stated mass.

    Parameters
    ----------
    identification : Identification
        The identified model. Its effects and filters are used; effects that need a load or belong to some runs alone
        are left out.
    unloaded : sequence of Recording
        Runs without the load, such as those of the identification.
    loaded : Recording
        The run with the load.
    mass : float, optional
        Mass of the load in kg, where the recording's metadata do not state it.

    Returns
    -------
    PayloadValidation
        The stated and the weighed mass, and whether they agree.

    Raises
    ------
    DynidentError
        Where no usable mass is stated, there is no run without the load, or the runs do not determine the model.
    """
    check_value(KnownLoad, "mass", mass)
    stated = read_known_payload(loaded).mass if mass is None else mass
    effects = tuple(choice for choice in identification.choices.effects if _is_usable_effect(choice))
    robot, filters = identification.model.robot, identification.preprocessing
    weighed = payload_from_pair(robot, unloaded, loaded, effects=effects, preprocessing=filters)
    # The mass is given with the call where the recording does not state it.
    known = replace(loaded, payload={**(loaded.payload or {}), "mass": stated})
    try:
        # The gains explain a wrong mass, but the comparison does not need them.
        gains = identify_gains(robot, unloaded, [known], effects=effects, preprocessing=filters)
    except DynidentError:
        gains = None
    return PayloadValidation(loaded.name, stated, weighed, gains, _judge_mass(stated, weighed))


def _is_usable_effect(choice: EffectChoice) -> bool:
    effect = get_effect(choice.effect)
    return not (effect.needs_load or effect.in_some_runs or choice.runs)


def _judge_mass(stated: float, weighed: PayloadVerdict) -> ValidationOutcome:
    if weighed.mass is None or weighed.interval is None:
        return ValidationOutcome("not_evaluated", f"The load of {stated:.4g} kg cannot be weighed: {weighed.reason}.")
    low, high = weighed.interval
    off = weighed.mass - stated
    text = f"The load weighs {weighed.mass:.3f} kg ({low:.3f} to {high:.3f}); its stated mass is {stated:.4g} kg"
    # Right within its uncertainty, or as near as gains are usually known.
    if low <= stated <= high or abs(off) <= _AS_STATED * stated:
        return ValidationOutcome("pass", f"{text}.")
    return ValidationOutcome(
        "fail",
        f"{text}, {format_percent(abs(off) / stated, decimals=1)} {'less' if off > 0 else 'more'}: the drive gains are "
        f"probably too {'high' if off > 0 else 'low'} by the same share, or the recorded torque is not the joint "
        "torque.",
    )
