"""Forward selection: add the best candidate that passes the rules until none does; revise and merge earlier findings.

Holds which two findings become one effect on several joints.

Later findings lead back to earlier ones: waves get another name, and two findings become one effect.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

from dynident.diagnosis.candidates.candidate_pool import Candidate, Pool
from dynident.diagnosis.candidates.inner_product_accumulation import PhasedProducts
from dynident.diagnosis.candidates.significance import ScoredCandidate
from dynident.diagnosis.decision_levels import RULES
from dynident.diagnosis.outcome_reasons import Reason
from dynident.diagnosis.search.comparison_of_rivals import (
    build_finer_pool,
    compare_names,
    explains_as_much,
    list_starts,
)
from dynident.diagnosis.search.finding_refinement import changes_prediction, split_groups
from dynident.diagnosis.search.identifiability_and_invisible_effects import is_determined, is_main_explanation
from dynident.diagnosis.search.next_finding import select_candidate
from dynident.diagnosis.search.physical_plausibility import is_physically_possible
from dynident.diagnosis.search.pruning import prune_findings
from dynident.diagnosis.search.search_state import Finding, State, estimate_residual_noise, score_all, score_family
from dynident.effects import get_effect
from dynident.identification.shape_search import list_between
from dynident.progress import Progress
from dynident.regressors.model_structure import Model


def merge_findings_on_joint(rows: ProductSource, data: PhasedProducts, pool: Pool, state: State) -> State:
    """Merge several findings on a joint into one, where that one explains as much.

    Parameters
    ----------
    rows : ProductSource
        Gives products of further columns.
    data : PhasedProducts
        Products of all columns.
    pool : Pool
        Model and candidates.
    state : State
        The model so far and what was found.
    """
    for several in _group_by_joint(state.findings):
        state = _merge_group(rows, data, pool, state, several)
    return state


def _group_by_joint(findings: Sequence[Finding]) -> list[list[Finding]]:
    """Group findings that are functions of the position of the same joint, in the same runs."""
    places: dict[object, list[Finding]] = {}
    for finding in findings:
        mine = finding.judged.candidate
        if is_of_position(finding) and len(mine.joints) == 1:
            places.setdefault((mine.joints, mine.runs), []).append(finding)
    return [findings for findings in places.values() if len(findings) > 1]


def _merge_group(
    rows: ProductSource, data: PhasedProducts, pool: Pool, state: State, several: Sequence[Finding]
) -> State:
    removed = {column for finding in several for column in finding.columns}
    others = tuple(finding for finding in state.findings if finding not in several)
    without_them = replace(state, base=tuple(k for k in state.base if k not in removed), findings=others)
    # One effect is the better explanation only if it has no more parameters and constants than all of them together.
    most = sum(finding.judged.freedom for finding in several)
    judged = score_all(data, pool, without_them.base, _list_single_curves(pool, without_them, several), state.noise)
    judged = [scored for scored in judged if scored.freedom <= most]
    parents = {finer: scored for scored in list_starts(judged) for finer in list_between(scored.candidate.choice)}
    theirs = [finding.judged.candidate.choice for finding in several]
    finer = build_finer_pool(rows.model, pool, without_them, [*theirs, *parents])
    columns = tuple(
        k
        for column_candidate in finer.candidates
        if column_candidate.choice in theirs
        for k in column_candidate.columns
    )
    first = several[0].judged.candidate
    together = Candidate(first.effect, first.joints, (), columns, first.runs)
    singles = [candidate for candidate in finer.candidates if candidate.choice in parents]
    # The columns of the search without them are the finer pool's first.
    here = tuple(range(finer.n_base))
    fine = rows.gather_products(finer)
    # The findings as one candidate, so that it can be compared with each single effect.
    both, *each = score_all(fine, finer, here, [together, *singles], state.noise)
    as_good = [
        option
        for option in each
        if explains_as_much(option, both) and is_physically_possible(fine, finer, here, state.noise, option)
    ]
    best = max(as_good, key=lambda scored: scored.total_gain, default=None)
    if best is None:
        return state
    # That something is there was tested for each of them; the new name takes over the surest test.
    p = min(finding.p for finding in several)
    new = Finding(replace(parents[best.candidate.choice], p=p), (), p)
    findings = [new if finding is several[0] else finding for finding in state.findings]
    remaining = tuple(finding for finding in findings if finding is new or finding not in several)
    return replace(state, base=without_them.base + new.columns, findings=remaining)


def _list_single_curves(pool: Pool, beside: State, several: Sequence[Finding]) -> list[Candidate]:
    """List curves over the position of that joint; none so general that it explains whatever was found."""
    mine = several[0].judged.candidate
    names = {finding.judged.candidate.effect for finding in several}
    candidates = []
    for candidate in pool.candidates:
        effect = get_effect(candidate.effect)
        alike = candidate.joints == mine.joints and candidate.runs == mine.runs and effect.of_position
        if alike and not names & set(effect.covers) and not set(candidate.columns) & set(beside.base):
            candidates.append(candidate)
    return candidates


class ProductSource(Protocol):
    """Source of the products of any columns."""

    @property
    def model(self) -> Model:
        """The model in which something is missing."""

    def gather_products(self, pool: Pool) -> PhasedProducts:
        """Return inner products of all columns of a pool and of the torque."""

    def add_findings(self, findings: Sequence[Finding]) -> ProductSource:
        """Return the same with the torque predicted by the model with these findings in it."""


def revisit_findings(rows: ProductSource, data: PhasedProducts, pool: Pool, state: State) -> State:
    """Give functions of a joint's position the names that they have beside all that was found on that joint.

    Parameters
    ----------
    rows : ProductSource
        Gives products of further columns.
    data : PhasedProducts
        Products of all columns.
    pool : Pool
        Model and candidates.
    state : State
        The model so far and what was found.
    """
    for number, finding in enumerate(state.findings):
        later = state.findings[number + 1 :]
        # Another function of the position says what its constants are off by, until they are refined.
        others = [other for other in later if not is_of_position(other)]
        if _may_be_a_wave(finding) and any(_share_a_joint(finding, other) for other in others):
            state = _rename_finding(rows, data, pool, state, number)
    return state


def _rename_finding(rows: ProductSource, data: PhasedProducts, pool: Pool, state: State, number: int) -> State:
    finding = state.findings[number]
    mine = finding.judged.candidate
    others = (*state.findings[:number], *state.findings[number + 1 :])
    without_it = replace(state, base=tuple(k for k in state.base if k not in finding.columns), findings=others)
    # The same joint in the same runs: only the name is in question.
    free = [
        candidate for candidate in pool.candidates if candidate.joints == mine.joints and candidate.runs == mine.runs
    ]
    free = [
        candidate
        for candidate in free
        if _is_admissible(candidate, others) and not set(candidate.columns) & set(without_it.base)
    ]
    judged = score_all(data, pool, without_it.base, free, state.noise)
    # That something is there was tested among all that could be.
    judged = [replace(scored, p=finding.p) for scored in judged]
    choice = select_candidate(data, pool, without_it, judged)
    if choice is None:
        return state
    chosen, equal = compare_names(rows.model, pool, without_it, choice, judged, rows.gather_products)
    new = Finding(chosen, equal, finding.p)
    findings = (*state.findings[:number], new, *state.findings[number + 1 :])
    return replace(state, base=without_it.base + new.columns, findings=findings)


def is_of_position(finding: Finding) -> bool:
    """Return whether a finding is a function of the positions and the direction alone."""
    return get_effect(finding.judged.candidate.effect).of_position


def _may_be_a_wave(finding: Finding) -> bool:
    """Return whether a finding is, or might be called, a wave over the joint's angle."""
    names = {finding.judged.candidate.effect, *(scored.candidate.effect for scored in finding.equal)}
    known = {other for name in names for other in (name, *get_effect(name).confused_with, *get_effect(name).covers)}
    return any(get_effect(name).proposal == "angle_spectrum" for name in known)


def _is_admissible(candidate: Candidate, others: Sequence[Finding]) -> bool:
    """Return whether a candidate is none of the other findings, nor contained in one."""
    return not any(
        other.judged.candidate.effect == candidate.effect
        or candidate.effect in get_effect(other.judged.candidate.effect).covers
        for other in others
        if set(other.judged.candidate.joints) & set(candidate.joints)
    )


def _share_a_joint(first: Finding, second: Finding) -> bool:
    return bool(set(first.judged.candidate.joints) & set(second.judged.candidate.joints))


@dataclass(frozen=True)
class Loss:
    """The finding beside which a candidate lost most of its gain.

    Parameters
    ----------
    finding : Finding
        The finding.
    gain : float
        What the candidate lost when this was added, in units of the noise.
    """

    finding: Finding
    gain: float


@dataclass(eq=False)
class SearchRecord:
    """What a search found, and what became of the candidates that it did not choose.

    Parameters
    ----------
    findings : tuple of Finding
        The findings.
    data : PhasedProducts
        Products of all columns, with the torque that the last model predicts.
    is_undetermined : bool
        Whether a finding was given up because the motion does not determine the model.
    rejections : dict of Candidate to Reason
        Why candidates were not chosen in the last round.
    dropped : dict of Candidate to Reason
        Why findings were dropped again.
    added : tuple of Finding
        The findings as they were added one by one, before they were renamed, merged, pruned or split.
    losses : dict of Candidate to Loss
        Which finding took most of each candidate's gain.
    """

    findings: tuple[Finding, ...]
    data: PhasedProducts
    is_undetermined: bool = False
    rejections: dict[Candidate, Reason] = field(default_factory=dict)
    dropped: dict[Candidate, Reason] = field(default_factory=dict)
    added: tuple[Finding, ...] = ()
    losses: dict[Candidate, Loss] = field(default_factory=dict)

    def record_losses(
        self, finding: Finding, before: Sequence[ScoredCandidate], after: Sequence[ScoredCandidate]
    ) -> None:
        """Record what each candidate lost by a finding; one that is no candidate any more lost all.

        Parameters
        ----------
        finding : Finding
            The finding that was added.
        before, after : sequence of ScoredCandidate
            The candidates, scored without it and beside it.
        """
        gains = {scored.candidate: scored.total_gain for scored in after}
        for scored in before:
            lost = scored.total_gain - gains.get(scored.candidate, 0.0)
            known = self.losses.get(scored.candidate)
            if lost > 0.0 and (known is None or lost > known.gain):
                self.losses[scored.candidate] = Loss(finding, lost)


def search_findings(
    data: PhasedProducts,
    pool: Pool,
    state: State,
    first: list[ScoredCandidate],
    rows: ProductSource,
    progress: Progress,
    earlier: SearchRecord | None = None,
) -> SearchRecord:
    """Add the best effect that passes all tests, again and again, until none does; then drop what became superfluous.

    After an effect that is a first-order sensitivity, and after a mass of some runs, all columns are made anew: those
    of the plain model are about torque that it predicted wrongly for want of this effect, and what they leave would be
    taken for something else.
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
    rows : ProductSource
        Gives products of further columns.
    progress : Progress
        Called with the fraction done and a message; may raise to cancel.
    earlier : SearchRecord, optional
        A search with fewer candidates, the first columns of the pool: this one goes on where it ended.

    Returns
    -------
    SearchRecord
        The findings, and what became of the other candidates.
    """
    record = SearchRecord(state.findings, data)
    contacts, judged = state.findings, first
    firm = is_determined(data.select_for_model(state.base), state)
    if earlier is not None and earlier.added:
        record.losses.update(earlier.losses)
        state = replace(state, findings=(*contacts, *earlier.added))
        base = state.base + tuple(k for finding in earlier.added for k in finding.columns)
        if any(changes_prediction(finding.judged.candidate.choice) for finding in earlier.added):
            rows = rows.add_findings(state.findings)
            data = rows.gather_products(pool)
        state = replace(state, base=base, noise=estimate_residual_noise(data, base))
        firm = firm or is_determined(data.select_for_model(base), replace(state, findings=contacts))
        judged = list(score_family(data, pool, base, _list_remaining(pool, earlier.added), state.noise).scored)
    most = state.rules.most_effects
    # Contacts are events of a recording, not effects of the arm: they do not count.
    while judged and (number := len(state.findings) - len(contacts)) < most:
        progress(number / (number + 1), f"{number} effects found, {len(judged)} candidates")
        record.rejections.clear()
        choice = select_candidate(data, pool, state, judged, record.rejections)
        if choice is None:
            break
        # The grid is coarse: before a name is settled, its rivals are tried with finer constants.
        chosen, equal = compare_names(rows.model, pool, state, choice, judged, rows.gather_products)
        finding = Finding(chosen, equal, chosen.p, _list_neighbour_columns(pool, chosen.candidate, state.base))
        base = state.base + finding.columns
        if changes_prediction(chosen.candidate.choice):
            rows = rows.add_findings((*state.findings, finding))
            data = rows.gather_products(pool)
        # What one run has and the others have not keeps the plain model from predicting a part of it, too.
        grown = replace(state, base=base, noise=estimate_residual_noise(data, base), findings=contacts)
        firm = firm or is_determined(data.select_for_model(base), grown)
        if not firm and not is_main_explanation(data, state, chosen):
            record.is_undetermined = True
            record.rejections[chosen.candidate] = Reason.build("undetermined_model")
            break
        state = replace(grown, findings=(*state.findings, finding))
        remaining = _list_remaining(pool, state.findings[len(contacts) :])
        before, judged = judged, list(score_family(data, pool, state.base, remaining, state.noise).scored)
        record.record_losses(finding, before, judged)
    record.added = state.findings[len(contacts) :]
    # The order matters: names are settled before findings of one name are merged, and only then is anything dropped or
    # split.
    state = merge_findings_on_joint(rows, data, pool, revisit_findings(rows, data, pool, state))
    pruned = prune_findings(data, pool, state)
    lasting = {finding.judged.candidate for finding in pruned.findings}
    superfluous = {finding.judged.candidate for finding in state.findings} - lasting
    record.dropped.update(dict.fromkeys(superfluous, Reason.build("superfluous")))
    record.findings, record.data = split_groups(data, pool, pruned).findings, data
    return record


def _list_remaining(pool: Pool, findings: Sequence[Finding]) -> list[Candidate]:
    """List the candidates that are still to be tried beside these findings."""
    candidates, known = pool.initial_candidates, set[str]()
    for finding in findings:
        chosen = finding.judged.candidate
        reached = {pool.observation.robot.joint_names[j] for j in finding.judged.joints}
        # What the constants of a function of the position are off by looks like a wave, too: that is no trace of one.
        known.update(chosen.joints if is_of_position(finding) else ())
        candidates += [
            other
            for other in pool.candidates
            if other in pool.faint and set(other.joints) <= reached - known and other not in candidates
        ]
        # What the finding says is no candidate on its joints any more.
        candidates = [other for other in candidates if not _is_superseded(other, chosen, reached)]
    return candidates


def _is_superseded(candidate: Candidate, chosen: Candidate, reached: set[str]) -> bool:
    """Return whether a candidate is the chosen one in other words: the same effect on a joint that it already has.

    `reached` are the joints that the chosen one acts on.
    """
    if candidate.columns == chosen.columns:
        return True
    effect = get_effect(candidate.effect)
    # What rubs more under a load that was added rubs under any load: that is friction of all runs, and no change.
    if get_effect(chosen.effect).in_some_runs and effect.is_friction and effect.needs_load:
        return bool(candidate.runs) and candidate.runs == chosen.runs
    if candidate.effect in get_effect(chosen.effect).covers and _is_slow_wave(candidate):
        return set(candidate.joints) <= reached
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
