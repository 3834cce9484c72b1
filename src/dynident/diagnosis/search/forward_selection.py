"""Search for what is missing: add the best effect that passes all tests, until none does."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from dynident.diagnosis.candidates.accumulate import PhasedProducts
from dynident.diagnosis.candidates.pool import Candidate, Pool
from dynident.diagnosis.candidates.significance import ScoredCandidate
from dynident.diagnosis.search.identifiability import is_determined, is_main_explanation
from dynident.diagnosis.search.model_comparison import compare_names
from dynident.diagnosis.search.per_joint_constants import split_groups
from dynident.diagnosis.search.pruning import prune_findings
from dynident.diagnosis.search.revisit import ProductSource, is_of_position, merge_findings, revisit_findings
from dynident.diagnosis.search.selection import select_candidate
from dynident.diagnosis.search.state import Finding, State, estimate_residual_noise, score_all
from dynident.effects import get_effect
from dynident.progress import Progress

# Waves a turn below which a polynomial of the position says much the same.
_FEW_WAVES = 6.0


def search_findings(
    data: PhasedProducts,
    pool: Pool,
    state: State,
    first: list[ScoredCandidate],
    most: int,
    rows: ProductSource,
    progress: Progress,
) -> tuple[tuple[Finding, ...], bool]:
    """Add the best effect that passes all tests, again and again, until none does; then drop what became superfluous.

    After an effect that is a first-order sensitivity all columns are made anew: those of the plain model are about
    torque that it predicted wrongly for want of this effect, and what they leave would be taken for something else.
    Names that take much of the same error are weighed with their shape constants between those of the grid.
    What the residual has but a faint trace of is asked about once something was found on its joint, and what was found
    before it once more. What two findings over the position of a joint say, one that says as much takes the name of.
    Joints of a group whose constants the data tell apart are told with their own.
    Where neither the model nor that with its first finding predicts parts of the motion from the others, nothing is
    found but what explains most of the error where it was fitted.

    Parameters
    ----------
    data : PhasedProducts
        Products of all columns.
    pool : Pool
        Model and candidates.
    state : State
        The model that the search starts from, with the contacts that disturb it.
    first : list of ScoredCandidate
        All candidates, scored beside that model.
    most : int
        Largest number of findings.
    rows : ProductSource
        Gives products of further columns.
    progress : Progress
        Called with the fraction done and a message; may raise to cancel.

    Returns
    -------
    tuple of Finding, bool
        The findings, and whether one was given up because the motion does not determine the model.
    """
    firm = is_determined(data.select_for_model(state.base), state)
    judged, undetermined, contacts = first, False, state.picks
    remaining, asleep = [scored.candidate for scored in first], pool.faint
    while len(state.picks) < most:
        progress(len(state.picks) / most, f"{len(state.picks)} effects found, {len(remaining)} candidates")
        choice = select_candidate(data, pool, state, judged)
        if choice is None:
            break
        # The grid is coarse: before a name is settled, its rivals are tried with finer constants.
        chosen, equal = compare_names(rows.model, pool, state, choice, judged, rows.gather_products)
        finding = Finding(chosen, equal, chosen.p, _list_neighbour_columns(pool, chosen.candidate, state.base))
        base = state.base + finding.columns
        if get_effect(chosen.candidate.effect).first_order:
            rows = rows.add_findings((*state.picks, finding))
            data = rows.gather_products(pool)
        # What one run has and the others have not keeps the plain model from predicting a part of it, too.
        grown = replace(state, base=base, noise=estimate_residual_noise(data, base), picks=contacts)
        firm = firm or is_determined(data.select_for_model(base), grown)
        undetermined = not firm and not is_main_explanation(data, state, chosen)
        if undetermined:
            break
        state = replace(grown, picks=(*state.picks, finding))
        reached = [pool.observation.robot.joint_names[j] for j in chosen.joints]
        # What the constants of a function of the position are off by looks like a wave, too: that is no trace of one.
        known = {name for pick in state.picks if is_of_position(pick) for name in pick.judged.candidate.joints}
        hidden = set(reached) - known
        awake = [candidate for candidate in pool.candidates if candidate in asleep and set(candidate.joints) <= hidden]
        remaining, asleep = remaining + awake, asleep.difference(awake)
        # What the chosen effect says is no candidate on its joints any more.
        remaining = [c for c in remaining if not _is_superseded(c, chosen.candidate, reached)]
        if not remaining:
            break
        judged = score_all(data, pool, state.base, remaining, state.noise)
    # The order matters: names are settled before findings of one name are merged, and only then is anything dropped or
    # split.
    state = merge_findings(rows, data, pool, revisit_findings(rows, data, pool, state))
    return split_groups(data, pool, prune_findings(data, pool, state)).picks, undetermined


def _is_superseded(candidate: Candidate, chosen: Candidate, reached: Sequence[str]) -> bool:
    """Return whether a candidate is the chosen one in other words: the same effect on a joint that it already has.

    `reached` are the joints that the chosen one acts on.
    """
    if candidate.columns == chosen.columns:
        return True
    if candidate.effect in get_effect(chosen.effect).covers and _is_slow_wave(candidate):
        return set(candidate.joints) <= set(reached)
    if candidate.effect != chosen.effect or bool(candidate.runs) != bool(chosen.runs):
        return False
    if get_effect(candidate.effect).in_some_runs:
        return bool(set(candidate.runs) & set(chosen.runs)) or candidate.runs == chosen.runs
    if get_effect(candidate.effect).proposal != "grid":
        same = candidate.joints == chosen.joints and candidate.shape == chosen.shape
        return same and (not chosen.runs or candidate.runs == chosen.runs)
    return not candidate.joints or bool(set(candidate.joints) & set(chosen.joints))


def _is_slow_wave(candidate: Candidate) -> bool:
    """Return whether a function of the position has so few waves that a polynomial says much the same."""
    if get_effect(candidate.effect).proposal != "angle_spectrum":
        return True
    return max(value for _, value in candidate.shape) < _FEW_WAVES


def _list_neighbour_columns(pool: Pool, chosen: Candidate, base: tuple[int, ...]) -> tuple[int, ...]:
    """List columns of the nearest other shape constants, one constant changed at a time."""
    specs = [spec.name for spec in get_effect(chosen.effect).shapes if spec.refined is not None]
    mine = dict(chosen.shape)
    kin = [c for c in pool.candidates if c.effect == chosen.effect and set(chosen.joints) <= set(c.joints)]
    columns: list[int] = []
    for name in specs:
        rest = {key: value for key, value in mine.items() if key != name}
        others = [(dict(c.shape)[name], c) for c in kin if {k: v for k, v in c.shape if k != name} == rest]
        above = min((value for value, _ in others if value > mine[name]), default=None)
        below = max((value for value, _ in others if value < mine[name]), default=None)
        near = [c for value, c in others if value in (above, below)]
        columns += [k for neighbour in near for k in neighbour.columns if _is_on_joints(pool, k, chosen)]
    return tuple(k for k in dict.fromkeys(columns) if k not in base and k not in chosen.columns)


def _is_on_joints(pool: Pool, column: int, candidate: Candidate) -> bool:
    return not candidate.joints or pool.observation.columns[column].link in candidate.joints
