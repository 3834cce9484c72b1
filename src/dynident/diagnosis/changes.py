"""What differs between two sets of recordings of the same robot: each finding as a number with its interval."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np
from scipy.special import stdtrit

from dynident.diagnosis.result import Change, ChangedValue, RankedEffect
from dynident.diagnosis.search.state import Finding
from dynident.effects import EffectChoice, effect_by_id
from dynident.effects.catalogue import is_change
from dynident.errors import DynidentError
from dynident.identification import Identification, extend, identify_model
from dynident.identification.checks import check_runs, check_temperature
from dynident.identification.choices import PriorName
from dynident.identification.data import parted
from dynident.progress import Progress, silent
from dynident.recordings import Recording

_NOTICED = 0.05
"""Share of what a parameter was before from which on anybody would call it another one."""

_MASS, _MOMENTS = "Mp", ("MXp", "MYp", "MZp")


def together(
    identification: Identification,
    baseline: Sequence[Recording],
    recordings: Sequence[Recording],
    progress: Progress = silent,
) -> tuple[Identification, tuple[Recording, ...], tuple[str, ...]]:
    """The model identified on all recordings as if nothing had changed; these, the baseline first; the later runs.

    The later ones have names of their own among them: runs are told apart by their names. Tests of single joints are
    left out, and with them the strategies and estimators that need more than the rows of both.

    Raises
    ------
    DynidentError
        Where one of the two sets is nothing but such tests.
    """
    later = parted(recordings)[0]
    try:
        earlier = parted(baseline)[0]
    except DynidentError as error:
        raise DynidentError(error.detail, pointer="/baseline_ids", title=error.title) from error
    taken = {recording.name for recording in earlier}
    renamed = [replace(one, name=f"{one.name} (later)") if one.name in taken else one for one in later]
    since = tuple(dict.fromkeys(label for recording in renamed for label in recording.run_labels))
    everything = (*earlier, *renamed)
    effects = identification.choices.effects
    check_temperature(effects, everything, ())
    check_runs(effects, everything)
    both = identify_model(
        identification.model,
        everything,
        (),
        replace(identification.choices, strategy="global", estimator="wls", prior=_kept(identification.choices.prior)),
        identification.preprocessing,
        identification.next_reference(),
        progress,
    )
    return both, everything, since


def _kept(prior: PriorName | None) -> PriorName | None:
    """The entropic prior goes with the feasible estimator alone; as numbers the description serves any."""
    return None if prior is None else "description"


def changes_of(
    grown: Identification, picks: Sequence[Finding], ranked: Sequence[RankedEffect], since: tuple[str, ...]
) -> tuple[Change, ...]:
    """The findings that the later runs have, joint by joint, with the values that the model with all of them has.

    Parameters
    ----------
    grown : the model with everything in it that was found
    picks, ranked : of equal length, in the same order
    since : labels of the later runs
    """
    found: list[Change] = []
    for pick, one in zip(picks, ranked, strict=True):
        if is_change(one.choice, since):
            found += _changes(grown, pick, one)
    return tuple(found)


def with_companions(
    grown: Identification, recommended: Sequence[EffectChoice], since: tuple[str, ...], recordings: Sequence[Recording]
) -> Identification:
    """The model with what usually changes along in it: else a value makes up for what was too small to be a finding."""
    there = {(choice.effect, joint) for choice in recommended if is_change(choice, since) for joint in choice.joints}
    missing = {(other, joint) for effect, joint in there for other in effect_by_id(effect).changes_with} - there
    known = {(choice.effect) for choice in grown.choices.effects if not choice.runs}
    wanted = [EffectChoice(effect, (joint,), (), since) for effect, joint in sorted(missing) if effect in known]
    for choice in wanted:
        # What the data do not determine, or the model has already, says no more of the others.
        with suppress(DynidentError):
            grown = extend(grown, [choice], recordings)
    return grown


def _changes(grown: Identification, pick: Finding, one: RankedEffect) -> Iterator[Change]:
    for joint in one.choice.joints or ("",):
        values = _values(grown, one.choice, joint)
        if not values or not _noticed(values[0]):
            continue
        others = [item.candidate.choice for item in pick.equal]
        names = [name for other in others for name in _told(other, one.choice, joint)]
        choice = replace(one.choice, joints=(joint,) if joint else ())
        for effect in effect_by_id(choice.effect).changes_with:
            values += _values(grown, replace(choice, effect=effect, shape=()), joint)
        yield Change(
            choice=choice,
            main=values[0],
            more=tuple(values[1:]),
            p_value=one.p_value,
            evidence=f"{_said(choice, values[0])} {one.evidence}{_in_units_of(grown, choice)}",
            equivalent=tuple(dict.fromkeys(names)),
        )


def _noticed(value: ChangedValue) -> bool:
    return value.before is None or abs(value.value) >= _NOTICED * abs(value.before)


def _in_units_of(grown: Identification, choice: EffectChoice) -> str:
    """What the size of a mass rests on, where torque is current times a gain."""
    if not effect_by_id(choice.effect).in_some_runs or all(
        drive.gain in (None, 1.0) for drive in grown.model.robot.drives
    ):
        return ""
    return (
        " Its size is in units of the drive gains: if all of them are off by some share, so is it, and its interval "
        "does not say so. A known mass would tell the gains."
    )


def _told(other: EffectChoice, choice: EffectChoice, joint: str) -> list[str]:
    if other.effect != choice.effect:
        return [other.effect]
    return [name for name in other.joints if name != joint]


def _values(grown: Identification, choice: EffectChoice, joint: str) -> list[ChangedValue]:
    """The parameters of a change; what says how large it is comes first, of a mass itself or its first moment."""
    parameters, kept = grown.parameters, grown.model.kept
    found = []
    for k, (one, column) in enumerate(zip(parameters, kept, strict=True)):
        if (column.effect, column.runs, column.link) == (choice.effect, choice.runs, joint):
            before = next(
                (
                    other.value
                    for other, plain in zip(parameters, kept, strict=True)
                    if (plain.effect, plain.parameter, plain.link, plain.runs)
                    == (column.effect, column.parameter, joint, ())
                ),
                None,
            )
            found.append((k, column.parameter, ChangedValue(one.name, one.value, one.unit, one.interval, before)))
    if effect_by_id(choice.effect).in_some_runs:
        moment = _moment(grown, [k for k, name, _ in found if name in _MOMENTS])
        # A mass that only the joints before it feel is known as part of others.
        mass = [value for _, name, value in found if name == _MASS and value.interval[0] * value.interval[1] > 0]
        first = [*mass, *([moment] if moment else [])]
        return [*first, *(value for _, _, value in found if value not in first)]
    surest = sorted(found, key=lambda item: -_sureness(item[2]))
    return [value for _, _, value in surest]


def _sureness(value: ChangedValue) -> float:
    return abs(value.value) / max(value.interval[1] - value.interval[0], np.finfo(float).tiny)


def _moment(grown: Identification, moments: Sequence[int]) -> ChangedValue | None:
    """The size of a first moment, m l, from its components; its deviation is that along its direction."""
    if not moments:
        return None
    index = np.array(moments, dtype=np.intp)
    components = grown.values[index]
    size = float(np.linalg.norm(components))
    direction = components / max(size, np.finfo(float).tiny)
    covariance = grown.statistics.covariance[np.ix_(index, index)]
    deviation = float(np.sqrt(max(float(direction @ covariance @ direction), 0.0)))
    half = float(stdtrit(grown.statistics.freedom[index].min(), 0.975)) * deviation
    return ChangedValue("m l", size, "kg m", (size - half, size + half))


def _said(choice: EffectChoice, value: ChangedValue) -> str:
    place = f" on {', '.join(choice.joints)}" if choice.joints else ""
    low, high = value.interval
    unit = "" if value.unit == "-" else f" {value.unit}"
    was = "" if value.before is None else f", {value.before:.3g} before"
    return (
        f"{effect_by_id(choice.effect).title}{place}: {value.parameter} differs by {value.value:+.3g}{unit} "
        f"({low:+.3g} to {high:+.3g}{was})."
    )


def summary_of(changes: Sequence[Change]) -> str:
    """What changed, in a sentence."""
    if not changes:
        return "Nothing that these recordings can show has changed since the baseline."
    parts = [
        f"{effect_by_id(one.choice.effect).title}{f' on {one.choice.joints[0]}' if one.choice.joints else ''} "
        f"({one.main.parameter} {one.main.value:+.3g}{'' if one.main.unit == '-' else f' {one.main.unit}'})"
        for one in changes
    ]
    return f"Since the baseline this has changed: {'; '.join(parts)}."
