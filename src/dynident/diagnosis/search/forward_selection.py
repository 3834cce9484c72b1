"""Forward selection: add the best candidate that passes the rules until none does; revise and merge earlier findings.

Holds which two findings become one effect on several joints.

Later findings lead back to earlier ones: these get another name, or two findings become one effect.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

from dynident.diagnosis.candidates.candidate_pool import Candidate, Pool
from dynident.diagnosis.decision_levels import RULES
from dynident.diagnosis.outcome_reasons import Reason
from dynident.diagnosis.search.comparison_of_rivals import (
    compare_names,
    explains_as_much,
    list_other_names,
    list_starts,
    refine_grid,
)
from dynident.diagnosis.search.finding_refinement import changes_prediction, split_groups
from dynident.diagnosis.search.identifiability_and_invisible_effects import is_determined, is_main_explanation
from dynident.diagnosis.search.next_finding import select_candidate
from dynident.diagnosis.search.physical_plausibility import is_physically_possible
from dynident.diagnosis.search.pruning import prune_findings
from dynident.diagnosis.search.search_state import (
    Finding,
    Loss,
    ProductSource,
    ScoredFamily,
    SearchRecord,
    State,
    score_all,
    score_family,
)
from dynident.effects import EffectChoice, get_effect
from dynident.identification.shape_search import list_between
from dynident.progress import Progress
from dynident.regressors.model_structure import Model


def merge_findings_on_joint(rows: ProductSource, state: State) -> State:
    """Merge several findings on a joint into one, where that one explains as much."""
    for several in _group_by_joint(state.findings):
        state = _merge_group(rows, state, several)
    return state


def _group_by_joint(findings: Sequence[Finding]) -> list[list[Finding]]:
    """Group findings that are functions of the position of the same joint, in the same runs."""
    places: dict[object, list[Finding]] = {}
    for finding in findings:
        mine = finding.judged.candidate
        if is_of_position(finding) and len(mine.joints) == 1:
            places.setdefault((mine.joints, mine.runs), []).append(finding)
    return [findings for findings in places.values() if len(findings) > 1]


def _merge_group(rows: ProductSource, state: State, several: Sequence[Finding]) -> State:
    without_them = state.drop_findings(several)
    # One effect is the better explanation only if it has no more parameters and constants than all of them together.
    most = sum(finding.judged.freedom for finding in several)
    judged = score_all(without_them, _list_single_curves(without_them, several))
    judged = [scored for scored in judged if scored.freedom <= most]
    parents = {finer: scored for scored in list_starts(judged) for finer in list_between(scored.candidate.choice)}
    theirs = [finding.judged.candidate.choice for finding in several]
    # The columns of the search without them are the finer pool's first.
    finer = refine_grid(rows, without_them, [*theirs, *parents])
    columns = tuple(
        k
        for column_candidate in finer.pool.candidates
        if column_candidate.choice in theirs
        for k in column_candidate.columns
    )
    first = several[0].judged.candidate
    together = Candidate(first.effect, first.joints, (), columns, first.runs)
    singles = [candidate for candidate in finer.pool.candidates if candidate.choice in parents]
    # The findings as one candidate, so that it can be compared with each single effect.
    both, *each = score_all(finer, [together, *singles])
    as_good = [option for option in each if explains_as_much(option, both) and is_physically_possible(finer, option)]
    best = max(as_good, key=lambda scored: scored.total_gain, default=None)
    if best is None:
        return state
    # That something is there was tested for each of them; the new name takes over the surest test.
    p = min(finding.p for finding in several)
    equal = [parents[scored.candidate.choice] for scored in list_other_names(best, as_good)]
    new = Finding(replace(parents[best.candidate.choice], p=p), tuple(equal), p)
    findings = [new if finding is several[0] else finding for finding in state.findings]
    remaining = tuple(finding for finding in findings if finding is new or finding not in several)
    return replace(state, base=without_them.base + new.columns, findings=remaining)


def _list_single_curves(beside: State, several: Sequence[Finding]) -> list[Candidate]:
    """List curves over the position of that joint; none so general that it explains whatever was found."""
    mine = several[0].judged.candidate
    names = {finding.judged.candidate.effect for finding in several}
    candidates = []
    for candidate in beside.pool.candidates:
        effect = get_effect(candidate.effect)
        alike = candidate.joints == mine.joints and candidate.runs == mine.runs and effect.of_position
        if alike and not names & set(effect.covers) and not set(candidate.columns) & set(beside.base):
            candidates.append(candidate)
    return candidates


def is_of_position(finding: Finding) -> bool:
    """Return whether a finding is a function of the positions and the direction alone."""
    return get_effect(finding.judged.candidate.effect).of_position


class EarlierSearch(NamedTuple):
    """What a search leaves to one that goes on where it ended; its rows, of which there are many, are gone by then.

    `family` are the scores beside the model alone, which are the same in both.
    """

    pool: Pool
    family: ScoredFamily
    findings: Sequence[Finding]
    choices: Sequence[EffectChoice]
    losses: Mapping[EffectChoice, Loss]


def search_findings(
    state: State,
    first: ScoredFamily,
    rows: ProductSource,
    progress: Progress,
    earlier: EarlierSearch | None = None,
) -> SearchRecord:
    """Add the best effect that passes all tests, again and again, until none does.

    After an effect that is a first-order sensitivity, and after a mass of some runs, all columns are made anew: those
    of the plain model are about torque that it predicted wrongly for want of this effect, and what they leave would be
    taken for something else.
    Names that take much of the same error are weighed with their shape constants between those of the grid.
    What the residual has but a faint trace of is asked about once something was found on its joint.
    Where neither the model nor that with its first finding predicts parts of the motion from the others, nothing is
    found but what explains most of the error where it was fitted.

    Parameters
    ----------
    state : State
        The model that the search starts from, with the contacts that disturb it.
    first : ScoredFamily
        All candidates, scored beside that model.
    rows : ProductSource
        Gives products of further columns.
    progress : Progress
        Called with the fraction done and a message; may raise to cancel.
    earlier : EarlierSearch, optional
        What another search found: this one goes on where it ended.

    Returns
    -------
    SearchRecord
        What was added, and what became of the other candidates.
    """
    record = SearchRecord(state, rows)
    contacts, family = state.findings, first
    firm = is_determined(state)
    if earlier is not None and earlier.findings:
        record.losses.update(earlier.losses)
        pairs = zip(earlier.findings, earlier.choices, strict=True)
        added = [place_finding(finding, choice, state.pool, rows.model) for finding, choice in pairs]
        for finding in added:
            state = state.add_finding(finding)
        if any(changes_prediction(finding.judged.candidate.choice) for finding in added):
            rows = rows.add_findings(state.findings)
            state = replace(state, data=rows.gather_products(state.pool))
        state = state.estimate_noise()
        firm = firm or is_determined(replace(state, findings=contacts))
        family = score_family(state, _list_remaining(state.pool, added))
    # Contacts are events of a recording, not effects of the arm: they do not count.
    while family.scored and (number := len(state.findings) - len(contacts)) < state.rules.max_effects:
        progress(number / (number + 1), f"{number} effects found, {len(family.scored)} candidates")
        record.rejections.clear()
        judged = family.scored
        choice = select_candidate(state, judged, record.rejections)
        if choice is None and family.is_fresh:
            break
        if choice is None:
            # What was found on other joints since changes little: that is asked once nothing else passes.
            family = score_family(state, [scored.candidate for scored in judged], family)
            continue
        # The grid is coarse: before a name is settled, its rivals are tried with finer constants.
        chosen, equal = compare_names(rows, state, choice, judged)
        around = _list_neighbour_columns(state.pool, chosen.candidate, state.base)
        finding = Finding(chosen, equal, chosen.p, around)
        grown = state.add_finding(finding)
        if changes_prediction(chosen.candidate.choice):
            rows = rows.add_findings(grown.findings)
            grown = replace(grown, data=rows.gather_products(state.pool))
        # What one run has and the others have not keeps the plain model from predicting a part of it, too.
        grown = grown.estimate_noise()
        firm = firm or is_determined(replace(grown, findings=contacts))
        if not firm and not is_main_explanation(replace(grown, base=state.base, noise=state.noise), chosen):
            record.is_undetermined = True
            record.rejections[chosen.candidate] = Reason.build("undetermined_model")
            break
        state = grown
        remaining = _list_remaining(state.pool, state.findings[len(contacts) :])
        again = changes_prediction(chosen.candidate.choice)
        family = score_family(state, remaining, family, None if again else chosen.joints)
        record.record_losses(finding, judged, family.scored)
    record.added = state.findings[len(contacts) :]
    record.state, record.rows, record.family = state, rows, family
    return record


def settle_findings(record: SearchRecord) -> None:
    """Settle what a search added, on the grid: merge findings, drop superfluous ones, split groups.

    Several findings over the position of a joint become one that explains as much. Joints of a group whose constants
    the data tell apart become findings with their own constants.

    Parameters
    ----------
    record : SearchRecord
        What the search added; its state becomes that of the findings that stay.
    """
    # The order matters: a finding may be superfluous beside what others were merged into, and only what lasts is split.
    state = merge_findings_on_joint(record.rows, record.state)
    pruned = prune_findings(state)
    lasting = {finding.judged.candidate for finding in pruned.findings}
    superfluous = {finding.judged.candidate for finding in state.findings} - lasting
    record.dropped.update(dict.fromkeys(superfluous, Reason.build("superfluous")))
    record.state = split_groups(pruned)


def place_finding(finding: Finding, choice: EffectChoice, pool: Pool, model: Model) -> Finding:
    """Return a finding with the shape constants of a choice, as a candidate of a pool.

    Parameters
    ----------
    finding : Finding
        The finding.
    choice : EffectChoice
        What it has become.
    pool : Pool
        A pool that has the columns of the choice.
    model : Model
        The model in which something is missing.
    """
    candidate = pool.build_candidate(choice, model.signals)
    # Neighbours of a coarse constant have done their part.
    return replace(finding, judged=replace(finding.judged, candidate=candidate), around=())


def _list_remaining(pool: Pool, findings: Sequence[Finding]) -> list[Candidate]:
    """List the candidates that are still to be tried beside these findings."""
    candidates, known = dict.fromkeys(pool.initial_candidates), set[str]()
    for finding in findings:
        chosen = finding.judged.candidate
        reached = {pool.observation.robot.joint_names[j] for j in finding.judged.joints}
        # What the constants of a function of the position are off by looks like a wave, too: that is no trace of one.
        known.update(chosen.joints if is_of_position(finding) else ())
        candidates |= dict.fromkeys(
            other for other in pool.candidates if other in pool.faint and set(other.joints) <= reached - known
        )
        # What the finding says is no candidate on its joints any more.
        candidates = {other: None for other in candidates if not _is_superseded(other, chosen, reached)}
    return list(candidates)


def _is_superseded(candidate: Candidate, chosen: Candidate, reached: set[str]) -> bool:
    """Return whether a candidate is the chosen one in other words: the same effect on a joint that it already has.

    `reached` are the joints that the chosen one acts on.
    """
    if candidate.columns == chosen.columns:
        return True
    effect, mine = get_effect(candidate.effect), get_effect(chosen.effect)
    # What rubs more under a load that was added rubs under any load: that is friction of all runs, and no change.
    if mine.in_some_runs and effect.is_friction and effect.needs_load:
        return bool(candidate.runs) and candidate.runs == chosen.runs
    if candidate.effect in mine.covers and _is_slow_wave(candidate):
        return set(candidate.joints) <= reached
    if effect is not mine or bool(candidate.runs) != bool(chosen.runs):
        return False
    if effect.in_some_runs:
        return bool(set(candidate.runs) & set(chosen.runs)) or candidate.runs == chosen.runs
    if effect.proposal != "grid":
        same = candidate.joints == chosen.joints and candidate.shape == chosen.shape
        return same and (not chosen.runs or candidate.runs == chosen.runs)
    return not candidate.joints or bool(set(candidate.joints) & set(chosen.joints))


def _is_slow_wave(candidate: Candidate) -> bool:
    """Return whether a function of the position has so few waves that a polynomial says much the same."""
    if get_effect(candidate.effect).proposal != "angle_spectrum":
        return True
    return max(value for _, value in candidate.shape) < RULES.few_waves


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
