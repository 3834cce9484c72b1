"""Estimate how large each change between two sets of recordings is: values before and after, with intervals.

Holds the smallest share that counts as a change (5 %), and the reservations in words.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import fdtri, stdtrit

from dynident.array_types import FloatArray
from dynident.diagnosis.diagnosis_result import Change, ChangedValue, RankedEffect
from dynident.diagnosis.outcome_reasons import describe_place
from dynident.diagnosis.search.search_state import Finding
from dynident.effects import Column, EffectChoice, get_effect
from dynident.estimation import Statistics
from dynident.identification import Identification
from dynident.number_format import format_number
from dynident.robot.robot_model import Robot

_NOTICED = 0.05
"""Share of what a parameter was before from which on anybody would call it another one."""

_MASS, _MOMENTS = "Mp", ("MXp", "MYp", "MZp")


@dataclass(frozen=True, eq=False)
class Estimates:
    """Estimated parameters of a model, with their uncertainty.

    Parameters
    ----------
    robot : Robot
        The robot, as its description gives it.
    columns : tuple of Column
        Columns of the model.
    values : (c,)
        Estimated parameters of the columns.
    statistics : Statistics
        Covariance and degrees of freedom of the estimates.
    """

    robot: Robot
    columns: tuple[Column, ...]
    values: FloatArray
    statistics: Statistics

    @classmethod
    def from_identification(cls, identification: Identification) -> Estimates:
        """Take the estimates of an identified model."""
        model = identification.model
        return cls(model.robot, model.kept, identification.values, identification.statistics)

    def compute_interval(self, k: int) -> tuple[float, float]:
        """Return the 95 % interval of a parameter."""
        half = float(self.statistics.half_widths()[k])
        return float(self.values[k]) - half, float(self.values[k]) + half


def yield_changes(estimates: Estimates, finding: Finding, ranked: RankedEffect) -> Iterator[Change]:
    """Yield a finding as changes, joint by joint, where the difference is large enough to be called one.

    Parameters
    ----------
    estimates : Estimates
        Estimates of a model with the columns of the change.
    finding : Finding
        The finding, with the names that the data cannot tell from it.
    ranked : RankedEffect
        The same finding in the ranking.
    """
    base = estimates.robot.joint_names[: estimates.robot.n_base]
    for joint in ranked.choice.joints or ("",):
        values = _list_changed_values(estimates, ranked.choice, joint)
        if not values or not _is_noticeable(values[0]) or _may_be_zero(estimates, ranked.choice, joint, values[0]):
            continue
        others = [scored.candidate.choice for scored in finding.equal]
        names = [name for other in others for name in _list_equivalents(other, ranked.choice, joint)]
        choice = replace(ranked.choice, joints=(joint,) if joint else ())
        # What changes together is reported together: friction grows in all its parts.
        for effect in get_effect(choice.effect).changes_with:
            values += _list_changed_values(estimates, replace(choice, effect=effect, shape=()), joint)
        yield Change(
            choice=choice,
            main=values[0],
            more=tuple(values[1:]),
            p_value=ranked.p_value,
            evidence=f"{_word_change(choice, values[0], describe_carrier(estimates.robot, choice))} "
            f"{ranked.evidence}{_word_gain_reservation(estimates.robot, choice)}"
            f"{_word_temperature_reservation(estimates, choice, joint)}",
            equivalent=tuple(dict.fromkeys(names)),
            carrier=describe_carrier(estimates.robot, choice) if joint in base else "",
        )


def _is_noticeable(value: ChangedValue) -> bool:
    return value.before is None or abs(value.value) >= _NOTICED * abs(value.before)


def _may_be_zero(estimates: Estimates, choice: EffectChoice, joint: str, main: ChangedValue) -> bool:
    """Return whether the data do not tell the difference from zero: then it is something without a name.

    Several parameters of one cause are tested together: where the motion is short each alone may make up for the
    others.
    """
    low, high = main.interval
    if not low <= 0.0 <= high:
        return False
    own = [
        k
        for k, column in enumerate(estimates.columns)
        if (column.effect, column.runs, column.link) == (choice.effect, choice.runs, joint)
    ]
    # A mass is what a mass is said to be; the rest of its inertia may be anything.
    return len(own) < 2 or get_effect(choice.effect).in_some_runs or not _differ_from_zero(estimates, own)


def _differ_from_zero(estimates: Estimates, own: Sequence[int]) -> bool:
    """Test several parameters at once against zero (Wald), with the smallest degrees of freedom of any of them."""
    index = np.array(own, dtype=np.intp)
    covariance = estimates.statistics.covariance[np.ix_(index, index)]
    scale = np.sqrt(np.maximum(np.diag(covariance), np.finfo(float).tiny))
    z = estimates.values[index] / scale
    # The pseudo-inverse leaves out directions that the data do not determine, in units in which all parameters are
    # alike.
    form = float(z @ np.linalg.pinv(covariance / np.outer(scale, scale), rcond=1e-9, hermitian=True) @ z)
    freedom = float(estimates.statistics.freedom[index].min())
    # Hotelling's T²: with an estimated covariance of few degrees of freedom, a joint test of several parameters has
    # fewer of them than a test of one.
    hotelling_freedom = freedom - len(own) + 1.0
    if hotelling_freedom <= 0.0:
        return False
    return form * hotelling_freedom / (freedom * len(own)) >= float(fdtri(len(own), hotelling_freedom, 0.95))


def _word_gain_reservation(robot: Robot, choice: EffectChoice) -> str:
    """Word the reservation that the size of a mass depends on the drive gains, where torque is current times a gain."""
    if not get_effect(choice.effect).in_some_runs or all(drive.gain in (None, 1.0) for drive in robot.drives):
        return ""
    return (
        " Its size depends on the drive gains: if all of them are wrong by some factor, the size is wrong by the "
        "same factor, and its interval does not include this. A recording with a known mass would show the gains."
    )


def _word_temperature_reservation(estimates: Estimates, choice: EffectChoice, joint: str) -> str:
    """Word at which temperature a difference of friction holds, where the joint's friction depends on it."""
    warm = any(column.link == joint and get_effect(column.effect).needs_temperature for column in estimates.columns)
    if not (warm and get_effect(choice.effect).is_friction):
        return ""
    return " Its friction depends on the temperature: the difference holds at the temperatures of the later recordings."


def _list_equivalents(other: EffectChoice, choice: EffectChoice, joint: str) -> list[str]:
    if other.effect != choice.effect:
        return [other.effect]
    return [name for name in other.joints if name != joint]


def _list_changed_values(estimates: Estimates, choice: EffectChoice, joint: str) -> list[ChangedValue]:
    """List the parameters of a change; the one that says how large it is comes first.

    For a load that is the mass itself, or else the size of its first moment.
    """
    entries = []
    for k, column in enumerate(estimates.columns):
        if (column.effect, column.runs, column.link) == (choice.effect, choice.runs, joint):
            value = ChangedValue(
                column.name,
                float(estimates.values[k]),
                column.unit,
                estimates.compute_interval(k),
                _find_value_before(estimates, column),
            )
            entries.append((k, column.parameter, value))
    if get_effect(choice.effect).in_some_runs:
        moment = _compute_moment(estimates, [k for k, name, _ in entries if name in _MOMENTS])
        # A mass that only the joints before it feel is known as part of others.
        mass = [value for _, name, value in entries if name == _MASS and value.interval[0] * value.interval[1] > 0]
        first = [*mass, *([moment] if moment else [])]
        return [*first, *(value for _, _, value in entries if value not in first)]
    # Of several parameters the one with the narrowest interval for its size represents the change.
    surest = sorted(entries, key=lambda entry: -_compute_relative_certainty(entry[2]))
    return [value for _, _, value in surest]


def _find_value_before(estimates: Estimates, column: Column) -> float | None:
    """Return what the parameter was before a change, earlier changes included; None where the model has no value."""
    place = (column.effect, column.parameter, column.link)
    own = [
        (other.runs, float(value))
        for other, value in zip(estimates.columns, estimates.values, strict=True)
        if (other.effect, other.parameter, other.link) == place
    ]
    # A column for all runs is what the parameter was; without one the model has no value from before.
    if all(runs for runs, _ in own):
        return None
    return sum(value for runs, value in own if not runs or len(runs) > len(column.runs))


def _compute_relative_certainty(value: ChangedValue) -> float:
    return abs(value.value) / max(value.interval[1] - value.interval[0], np.finfo(float).tiny)


def _compute_moment(estimates: Estimates, moments: Sequence[int]) -> ChangedValue | None:
    """Return the size of a first moment, m l, from its components; its deviation is that along its direction."""
    if not moments:
        return None
    index = np.array(moments, dtype=np.intp)
    components = estimates.values[index]
    size = float(np.linalg.norm(components))
    direction = components / max(size, np.finfo(float).tiny)
    covariance = estimates.statistics.covariance[np.ix_(index, index)]
    # The size is linear in the components along its own direction: the delta method, with its deviation from their
    # covariance.
    deviation = float(np.sqrt(max(float(direction @ covariance @ direction), 0.0)))
    half = float(stdtrit(estimates.statistics.freedom[index].min(), 0.975)) * deviation
    return ChangedValue("m l", size, "kg m", (size - half, size + half))


def describe_carrier(robot: Robot, choice: EffectChoice) -> str:
    """Return the names of an effect's joints in words; of what sits on the floating base the name of its link."""
    links = {joint.name: joint.link or joint.name for joint in robot.joints[: robot.n_base]}
    return describe_place([links.get(name, name) for name in choice.joints])


def _word_change(choice: EffectChoice, value: ChangedValue, carrier: str) -> str:
    place = f" on {carrier}" if choice.joints else ""
    low, high = value.interval
    unit = "" if value.unit == "-" else value.unit
    change = f"{'+' if value.value > 0.0 else ''}{format_number(value.value)} {unit}".rstrip()
    interval = f"{format_number(low)} to {format_number(high)} {unit}".rstrip()
    was = "" if value.before is None else f"; {format_number(value.before)} {unit}".rstrip() + " before"
    together = " No single parameter differs significantly from zero; together they do." if low <= 0.0 <= high else ""
    return (
        f"{get_effect(choice.effect).title}{place}: {value.parameter} differs by {change} ({interval}{was}).{together}"
    )
