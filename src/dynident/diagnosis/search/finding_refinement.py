"""Refine findings: the link that they are on, their shape constants (a joint's own or common), alike ones merged.

Joints of a group may have shape constants of their own: no two gears of an arm are alike.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from dynident.array_types import FloatArray
from dynident.diagnosis.candidates.candidate_pool import (
    Candidate,
    Pool,
    build_pool_of_choices,
    is_sharper_than_resolved,
    is_width_resolved,
    select_columns_on,
)
from dynident.diagnosis.candidates.held_out_scores import JointBlocks
from dynident.diagnosis.candidates.inner_product_accumulation import PhasedProducts, gather_products
from dynident.diagnosis.candidates.significance import ScoredCandidate
from dynident.diagnosis.comparison.measured_against_predicted import Comparison, predict_again
from dynident.diagnosis.decision_levels import RULES
from dynident.diagnosis.outcome_reasons import Reason, ReasonCode
from dynident.diagnosis.residuals.resolution_at_reversals import Resolution
from dynident.diagnosis.search.acceptance_rules import compute_explained_error
from dynident.diagnosis.search.contacts_and_loads import LoadGains
from dynident.diagnosis.search.physical_plausibility import is_physically_possible
from dynident.diagnosis.search.pruning import RefinedModel
from dynident.diagnosis.search.search_state import Finding, State, gather_state, score_all
from dynident.effects import EffectChoice, get_effect
from dynident.estimation import EstimationError, solve_weighted
from dynident.estimation.residual_errors import compute_t
from dynident.identification import Identification
from dynident.identification.shape_search import are_nearly_alike, refine_shapes
from dynident.progress import Progress, ignore_progress, scale_progress
from dynident.regressors.dynamic_model_rows import reduce_recordings
from dynident.regressors.model_structure import Model, extend_model
from dynident.regressors.observation_matrix import RegressorInputs
from dynident.robot import Robot


def split_groups(state: State) -> State:
    """Split every group whose joints have shape constants that the data tell apart.

    A group was found with one value for all of its joints. Values are those of the grid still; joints that have the
    same one stay together.
    """
    findings: list[Finding] = []
    # Group after group, each beside what the earlier ones have become.
    for finding in state.findings:
        parts = _split_finding(state, finding)
        rest = state.drop_columns(finding.columns)
        state = replace(rest, base=(*rest.base, *(k for part in parts for k in part.columns)))
        findings += parts
    return replace(state, findings=tuple(findings))


def merge_findings_with_close_constants(
    findings: Sequence[Finding], choices: Sequence[EffectChoice], robot: Robot, resolved: Resolution
) -> tuple[tuple[Finding, ...], tuple[EffectChoice, ...]]:
    """Merge findings whose refined constants have come out alike.

    So are slips of one friction that are both too short for the data to tell. The constants are those of the one with
    the most joints.

    Parameters
    ----------
    findings : sequence of Finding
        The findings.
    choices : sequence of EffectChoice
        What each of them has become, with refined constants.
    robot : Robot
        The robot, as its description gives it.
    resolved : Resolution
        What the data can resolve.
    """

    def are_alike(first: EffectChoice, second: EffectChoice) -> bool:
        same = (first.effect, first.runs) == (second.effect, second.runs)
        return are_nearly_alike(first, second) or (
            same and all(is_sharper_than_resolved(choice, robot, resolved) for choice in (first, second))
        )

    merged: list[tuple[int, Finding, EffectChoice]] = []
    numbered = zip(range(len(findings)), findings, choices, strict=True)
    for number, finding, choice in sorted(numbered, key=lambda item: -len(item[2].joints)):
        alike = next((k for k, (_, _, other) in enumerate(merged) if are_alike(other, choice)), None)
        if alike is None:
            merged.append((number, finding, choice))
            continue
        first, other, larger = merged[alike]
        own = tuple(name for name in robot.tree.joint_names if name in {*larger.joints, *choice.joints})
        judged = _join_scores(other.judged, finding.judged, own)
        merged[alike] = first, replace(other, judged=judged), replace(larger, joints=own)
    # Merging went from large groups to small; the ranking keeps the order in which things were found.
    merged.sort(key=lambda item: item[0])
    return tuple(finding for _, finding, _ in merged), tuple(choice for _, _, choice in merged)


def _join_scores(first: ScoredCandidate, second: ScoredCandidate, names: tuple[str, ...]) -> ScoredCandidate:
    """Return the scores of one effect on the joints of both: any of these may drop out later on."""
    # An effect of one joint that acts on others, too, has no errors of its own joint alone.
    if not all(len(scored.joints) == len(scored.candidate.joints) for scored in (first, second)):
        return first
    places = dict(
        zip((*first.candidate.joints, *second.candidate.joints), (*first.joints, *second.joints), strict=True)
    )
    before, after, columns = first.before.copy(), first.after.copy(), list(second.joints)
    before[:, columns], after[:, columns] = second.before[:, columns], second.after[:, columns]
    return replace(
        first,
        candidate=replace(first.candidate, joints=names),
        joints=tuple(places[name] for name in names),
        before=before,
        after=after,
        gains=first.gains + second.gains,
    )


def _split_finding(state: State, finding: Finding) -> list[Finding]:
    """Return the finding, or one for every set of constants that its joints have, that of most joints first."""
    group = finding.judged.candidate
    # Without a constant that is refined there is nothing in which joints could differ.
    if len(group.joints) < 2 or all(spec.refined is None for spec in get_effect(group.effect).shapes):
        return [finding]
    each = [_choose_constants(state, group, joint) for joint in group.joints]
    shapes = {candidate.shape: [other for other in each if other.shape == candidate.shape] for candidate in each}
    if len(shapes) < 2:
        return [finding]
    rest = state.drop_columns(finding.columns)
    # Joints that have the same constants stay together.
    whole = [_join_candidates(some) for some in sorted(shapes.values(), key=len, reverse=True)]
    parts = []
    for candidate in whole:
        others = tuple(k for other in whole if other is not candidate for k in other.columns)
        (scored,) = score_all(replace(rest, base=rest.base + others), [candidate])
        parts.append(replace(finding, judged=replace(scored, p=finding.p), around=()))
    return parts


def _choose_constants(state: State, group: Candidate, joint: str) -> Candidate:
    """Return the effect on one joint of a group, with its own constants where the data tell them apart."""
    mine = select_columns_on(state.pool, group, joint)
    same = Candidate(group.effect, (joint,), group.shape, mine, group.runs)
    others = [
        candidate
        for candidate in state.pool.candidates
        if (candidate.effect, candidate.joints, candidate.runs) == (group.effect, (joint,), group.runs)
        and candidate.columns != mine
    ]
    # The group's constants are scored along with the joint's own, beside the same model.
    first, *judged = score_all(state.drop_columns(mine), [same, *others])
    best = max(judged, key=lambda scored: scored.total_gain, default=first)
    return best.candidate if _are_distinguishable(first, best) else same


def _are_distinguishable(group: ScoredCandidate, own: ScoredCandidate) -> bool:
    """Return whether a joint's own constants explain clearly more than those of its group, and enough to matter."""
    more = own.gains - group.gains
    return float(more.sum()) >= RULES.own_drop * float(group.after_weighted.sum()) and compute_t(more) >= RULES.sure_t


def _join_candidates(candidates: list[Candidate]) -> Candidate:
    """Join candidates of an effect on single joints with the same constants into one."""
    first = candidates[0]
    joints = tuple(joint for candidate in candidates for joint in candidate.joints)
    return Candidate(
        first.effect, joints, first.shape, tuple(k for candidate in candidates for k in candidate.columns), first.runs
    )


@dataclass(frozen=True, eq=False)
class RecordedSource:
    """Source of products: the recordings that a search learns from.

    Parameters
    ----------
    model : Model
        The model in which something is missing.
    inputs : RegressorInputs
        Recordings that the search learns from, the model's filters, and what torque is predicted with.
    """

    model: Model
    inputs: RegressorInputs

    def gather_products(self, pool: Pool, progress: Progress = ignore_progress) -> PhasedProducts:
        """Return inner products of all columns of a pool and of the torque."""
        return gather_products(pool.observation, self.model.signals, self.inputs, pool.n_base, progress)

    def add_findings(self, findings: Sequence[Finding]) -> RecordedSource:
        """Return the same with the torque predicted by the model with these findings in it."""
        choices = [finding.judged.candidate.choice for finding in findings]
        return replace(self, inputs=improve_reference(self.model, choices, self.inputs))


def locate_findings(
    identification: Identification, findings: Sequence[Finding], inputs: RegressorInputs
) -> tuple[Finding, ...]:
    """Move findings of some runs to the link where they explain most, the outer one where data do not decide."""
    # Only what some runs have may be on any link; other effects were found on their joints.
    loose = [k for k, finding in enumerate(findings) if get_effect(finding.judged.candidate.effect).in_some_runs]
    placed_findings = list(findings)
    for k in loose:
        # Each finding is placed beside all others, where they are by now.
        others = [finding.judged.candidate.choice for i, finding in enumerate(placed_findings) if i != k]
        placed_findings[k] = _move_to_best_link(identification, placed_findings[k], others, inputs)
    return tuple(placed_findings)


def _move_to_best_link(
    identification: Identification, finding: Finding, others: Sequence[EffectChoice], inputs: RegressorInputs
) -> Finding:
    model, own = identification.model, finding.judged.candidate.choice
    with_load = gather_state(model, build_pool_of_choices(model, [*others, own]), inputs, identification.noise)
    everything = tuple(range(len(with_load.pool.observation.columns)))
    # In units of what is left beside the load where it was found: without it, the residual is not noise.
    noise = replace(with_load, base=everything).estimate_noise().noise
    mine = with_load.pool.find_candidate(own)
    beside = replace(with_load, base=tuple(k for k in everything if mine is None or k not in mine.columns), noise=noise)
    links = LoadGains.from_state(model, beside, inputs).list_links(own.runs)
    choices = list(dict.fromkeys([*(replace(own, joints=(name,)) for name in links), own]))
    if choices == [own]:
        return finding
    pool = build_pool_of_choices(model, [*others, *choices])
    state = gather_state(model, pool, inputs, noise)
    find = pool.find_candidate
    columns = [k for choice in others if (other := find(choice)) for k in other.columns]
    state = replace(state, base=(*state.base, *columns))
    judged = score_all(state, [candidate for choice in choices if (candidate := find(choice))])
    # On a link where it would be below zero, a mass makes up for something else.
    chosen, *alike = [scored for scored in judged if is_physically_possible(state, scored)] or judged
    equal = [scored for scored in alike if scored.candidate.joints[0] in links]
    return replace(finding, judged=replace(chosen, p=finding.p), equal=(*finding.equal, *equal), around=())


def refine_constants(
    model: Model, findings: Sequence[Finding], inputs: RegressorInputs, resolved: Resolution, progress: Progress
) -> tuple[tuple[Finding, ...], tuple[EffectChoice, ...]]:
    """Return findings, those alike merged, and what they are with the shape constants that fit best."""
    choices = refine_shapes(model, [finding.judged.candidate.choice for finding in findings], inputs, progress)
    return merge_findings_with_close_constants(findings, choices, model.robot, resolved)


# Solutions until first-order columns are about the model that they are part of.
_PASSES = 2


def refine_findings(
    identification: Identification,
    findings: Sequence[Finding],
    inputs: RegressorInputs,
    resolved: Resolution,
    floor: FloatArray,
    since: tuple[str, ...],
    progress: Progress,
) -> tuple[tuple[Finding, ...], tuple[EffectChoice, ...], dict[Candidate, Reason]]:
    """Refine the shape constants of the findings; drop those that only made up for the coarse constants of another.

    A peak of friction whose best width is below what the data resolve made up for sticking, not for Stribeck friction.

    Returns
    -------
    tuple of Finding, tuple of EffectChoice, dict of Candidate to Reason
        The remaining findings, what each has become, and why each of the others was dropped.
    """
    findings = locate_findings(identification, findings, inputs)
    choices = tuple(finding.judged.candidate.choice for finding in findings)
    dropped: dict[Candidate, Reason] = {}

    def select(kept: Sequence[int], code: ReasonCode) -> tuple[Finding, ...]:
        """Return the findings of these indices; note the reason of the others."""
        gone = [findings[i].judged.candidate for i in range(len(findings)) if i not in kept]
        dropped.update(dict.fromkeys(gone, Reason.build(code)))
        return tuple(findings[i] for i in kept)

    if not choices:
        return (), (), dropped
    model = identification.model
    findings, choices = refine_constants(model, findings, inputs, resolved, scale_progress(progress, 0.0, 0.5))
    again = scale_progress(progress, 0.5, 1.0)
    # Refining may lead to constants that the data cannot resolve: then another name that explains as much takes over.
    while unresolved := {
        i: choice.joints for i, choice in enumerate(choices) if not is_width_resolved(choice, model.robot, resolved)
    }:
        dropped.update((findings[i].judged.candidate, Reason.build("not_resolved")) for i in unresolved)
        findings, choices = _rename_findings(findings, choices, unresolved)
        choices = refine_shapes(model, choices, inputs, again)
    while choices:
        inputs = improve_reference(model, choices, inputs)
        lean = RefinedModel.from_choices(model, findings, choices, since, inputs, floor)
        impossible = lean.find_impossible()
        if impossible:
            dropped.update(
                (replace(findings[i].judged.candidate, joints=joints), reason)
                for i, (reason, joints) in impossible.items()
            )
            findings, choices = _rename_findings(
                findings, choices, {i: joints for i, (_, joints) in impossible.items()}
            )
            choices = refine_shapes(model, choices, inputs, again)
            continue
        slimmer, needed = lean.select_needed(inputs.preprocessing)
        # Refining the constants of fewer effects may make others superfluous, so this goes on until nothing changes.
        if slimmer == choices:
            break
        findings = select(needed, "superfluous")
        choices = refine_shapes(model, slimmer, inputs, again)
    if not choices:
        return (), (), dropped
    resolved_indices = [i for i, choice in enumerate(choices) if is_width_resolved(choice, model.robot, resolved)]
    # In the order in which somebody would add them: the largest first.
    lasting = lean.select_harmless(
        sorted(resolved_indices, key=lambda i: -compute_explained_error(findings[i].judged, floor))
    )
    remaining = select(lasting, "harmful")
    # What cannot be resolved was not tried for harm.
    select(resolved_indices, "not_resolved")
    return remaining, tuple(choices[i] for i in lasting), dropped


def _rename_findings(
    findings: Sequence[Finding], choices: Sequence[EffectChoice], impossible: Mapping[int, tuple[str, ...]]
) -> tuple[tuple[Finding, ...], tuple[EffectChoice, ...]]:
    """Give findings of these numbers the next of their equal names on these joints; drop them there without one."""
    renamed: list[tuple[Finding, EffectChoice]] = []
    for i, (finding, choice) in enumerate(zip(findings, choices, strict=True)):
        if i not in impossible:
            renamed.append((finding, choice))
            continue
        possible = tuple(joint for joint in choice.joints if joint not in impossible[i])
        if possible:
            renamed.append((finding, replace(choice, joints=possible)))
        # A name for some joints of a group alone has to be one that the data gave to these joints.
        equal, former = (
            tuple(
                scored
                for scored in names
                if scored.candidate.effect != choice.effect
                and (not possible or set(impossible[i]) <= set(scored.candidate.joints))
            )
            for names in (finding.equal, finding.former)
        )
        if equal or former:
            best, former = (equal[0], former) if equal else (former[0], former[1:])
            new = Finding(replace(best, p=finding.p), equal[1:], finding.p, former=former)
            other = new.judged.candidate.choice
            renamed.append((new, replace(other, joints=impossible[i]) if possible else other))
    return tuple(finding for finding, _ in renamed), tuple(choice for _, choice in renamed)


def improve_reference(model: Model, choices: Sequence[EffectChoice], inputs: RegressorInputs) -> RegressorInputs:
    """Return the inputs with the parameters that torque is predicted with once the effects are in the model.

    Without these effects the parameters are biased by them.
    """
    biasing = [choice for choice in choices if changes_prediction(choice)]
    if not biasing:
        return inputs
    # Functions of the position are left out: they would make up for what the first-order columns cannot say yet.
    firm = [choice for choice in choices if not get_effect(choice.effect).of_position]
    grown = extend_model(model, firm) if firm else model
    for _ in range(_PASSES):
        reduction = reduce_recordings(grown.observation, inputs, by_time=False)
        try:
            inputs = replace(inputs, reference=grown.build_reference(solve_weighted(reduction).values))
        except EstimationError:
            # Together they are not determined: what they correct stays as it was.
            return inputs
    return inputs


def predict_with_findings(
    model: Model, state: State, inputs: RegressorInputs, comparisons: Sequence[Comparison]
) -> Sequence[Comparison]:
    """Return comparisons with the torque that a model predicts with what was found, as it is on the grid."""
    if not state.findings:
        return comparisons
    inputs = improve_reference(model, [finding.judged.candidate.choice for finding in state.findings], inputs)
    # With the neighbours of coarse constants: what those are off by would hide a line, or look like one.
    columns = [state.pool.observation.columns[k] for k in state.base[state.pool.n_base :]]
    observation = model.observation.extend(columns, model.signals)
    blocks = JointBlocks.from_products(state.rows, state.columns, ())
    values = blocks.fit_sets(state.noise).chi[0]
    return [
        predict_again(comparison, observation, values, replace(inputs, recordings=[recording]))
        for comparison, recording in zip(comparisons, inputs.recordings, strict=True)
    ]


def changes_prediction(choice: EffectChoice) -> bool:
    """Return whether the torque that columns depend on is another one with an effect in the model.

    A sensitivity biases all parameters where it is lacking; a mass is a load in the runs that have it.
    """
    effect = get_effect(choice.effect)
    return effect.first_order or effect.in_some_runs
