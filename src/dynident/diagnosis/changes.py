"""What differs between two sets of recordings of the same robot: each finding as a number with its interval."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

from dynident.diagnosis.changed_values import Estimates, changes_at
from dynident.diagnosis.comparing.content import common_content
from dynident.diagnosis.result import Change, FrictionDifference, RankedEffect
from dynident.diagnosis.search.state import Finding
from dynident.effects import effect_by_id
from dynident.effects.catalogue import is_change
from dynident.errors import DynidentError
from dynident.identification import Identification, identify_model
from dynident.identification.choices import PriorName
from dynident.identification.equations.checks import check_runs, check_temperature
from dynident.identification.equations.data import motions_and_friction
from dynident.progress import Progress, silent
from dynident.recordings import Recording


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
        Where one of the two sets is nothing but such tests, or a recording is in both.
    """
    later = motions_and_friction(recordings)[0]
    try:
        earlier = motions_and_friction(baseline)[0]
    except DynidentError as error:
        raise DynidentError(error.detail, pointer="/baseline_ids", title=error.title) from error
    _check_apart(earlier, later)
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
        identification.estimate.next_reference(),
        progress,
    )
    return both, everything, since


def _check_apart(earlier: Sequence[Recording], later: Sequence[Recording]) -> None:
    """Raise where the same samples are on both sides: a day does not differ from itself."""
    copies = [one for one in common_content(earlier, later) if one.kind == "copied"]
    if copies:
        told = "; ".join(f"{one.held_out} is on both sides (the samples are those of {one.fitted})" for one in copies)
        raise DynidentError(
            f"{told}: give earlier recordings as before, later ones as after",
            pointer="/baseline_ids",
            title="One recording on both sides",
        )


def _kept(prior: PriorName | None) -> PriorName | None:
    """The entropic prior goes with the feasible estimator alone; as numbers the description serves any."""
    return None if prior is None else "description"


def changes_of(
    grown: Identification, picks: Sequence[Finding], ranked: Sequence[RankedEffect], since: tuple[str, ...]
) -> tuple[Change, ...]:
    """The findings that the later runs have, joint by joint, with the values that the model with all of them has.

    Parameters
    ----------
    grown : the model with everything in it that was found, and friction that may differ
    picks, ranked : of equal length, in the same order
    since : labels of the later runs
    """
    estimates = Estimates.of(grown)
    found: list[Change] = []
    for pick, one in zip(picks, ranked, strict=True):
        if is_change(one.choice, since):
            found += changes_at(estimates, pick, one)
    return tuple(found)


def summary_of(changes: Sequence[Change], friction: Sequence[FrictionDifference]) -> str:
    """What changed, in a sentence, and how much friction may have become without that being seen."""
    bound = _bound_of({joint for one in changes for joint in one.choice.joints}, friction)
    if not changes:
        return f"Nothing that these recordings can show has changed since the baseline.{bound}"
    parts = [
        f"{effect_by_id(one.choice.effect).title}{f' on {one.choice.joints[0]}' if one.choice.joints else ''} "
        f"({one.main.parameter} {one.main.value:+.3g}{'' if one.main.unit == '-' else f' {one.main.unit}'})"
        for one in changes
    ]
    return f"Since the baseline this has changed: {'; '.join(parts)}.{bound}"


def _bound_of(changed: Collection[str], friction: Sequence[FrictionDifference]) -> str:
    """The least and the most that friction of joints with no change may differ by."""
    bounds = sorted(
        (max(abs(end) for end in one.interval) / one.before, one.joint)
        for one in friction
        if one.joint not in changed and one.before > 0.0
    )
    if not bounds:
        return ""
    (least, best), (most, worst) = bounds[0], bounds[-1]
    if best == worst:
        return f" The friction of {best} differs by no more than {most:.1%}."
    others = " of the other joints" if changed else ""
    return f" Friction{others} differs by no more than {least:.1%} ({best}) to {most:.1%} ({worst})."
