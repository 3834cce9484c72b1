"""Remove findings, or joints of them, that later findings make superfluous, and findings that do harm.

Holds the model with refined findings and nothing else, beside which they are judged again.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dynident.array_types import FloatArray, IndexArray
from dynident.diagnosis.candidates.candidate_pool import Candidate, Pool, select_columns_on
from dynident.diagnosis.candidates.held_out_scores import FoldedFits, JointBlocks, score_folds
from dynident.diagnosis.candidates.products_of_scored_pairs import find_present
from dynident.diagnosis.candidates.significance import ScoredCandidate
from dynident.diagnosis.candidates.time_blocks_and_folds import Products, split_data_folds
from dynident.diagnosis.decision_levels import RULES
from dynident.diagnosis.outcome_reasons import Reason
from dynident.diagnosis.search.acceptance_rules import compute_gain_over_floor, get_least_gain, is_shadowed
from dynident.diagnosis.search.contacts_and_loads import drop_faded_contacts
from dynident.diagnosis.search.physical_plausibility import find_impossible_parameter, is_physically_possible
from dynident.diagnosis.search.search_state import Finding, State, gather_state, score_all
from dynident.effects import EffectChoice, build_columns, get_effect
from dynident.estimation.residual_errors import compute_evenness
from dynident.identification.identified_models.held_out_gain import IN_PASSING
from dynident.recordings import Preprocessing
from dynident.regressors.model_structure import Model
from dynident.regressors.observation_matrix import RegressorInputs

# Share of a column's squares in one run from which on the others do not determine its parameter.
_NEARLY_ALL = 0.9
_SHOWN = 1e-6
"""Share of the squares of what the data show best of a finding, below which they show a combination not at all."""


def select_harmless(state: State, columns: Sequence[tuple[int, ...]]) -> list[int]:
    """Select the findings that make the prediction worse nowhere, in the order in which they are to be added.

    One that hurts waits for the next that does not, and is tried again beside it: friction judged on torque that is
    late is not what it is once the delay is known. Whole runs are left out of the fit where the others determine the
    model without them, else a tenth of one in a row.
    """
    accepted: list[int] = []
    waiting = list(range(len(columns)))
    while (number := next((k for k in waiting if _is_harmless(state, columns[k])), None)) is not None:
        accepted.append(number)
        waiting.remove(number)
        state = replace(state, base=state.base + columns[number])
    return accepted


def _is_harmless(state: State, own: tuple[int, ...]) -> bool:
    # The rows of the larger model for both, so that the errors are of the same samples.
    larger, noise, finding = replace(state, base=state.base + own), state.noise, [Candidate("", (), (), own)]
    rows = larger.rows
    blocks = JointBlocks.from_products(rows, state.columns, finding)
    fits = None
    # Whole runs are the harder test: they are other motions, or other days.
    if _can_leave_out_runs(rows, larger.columns):
        by_runs = FoldedFits.from_blocks(rows, blocks, noise, ("runs",))
        fits = by_runs if _is_shown_by_several_runs(by_runs) else None
    fits = fits or FoldedFits.from_blocks(rows, blocks, noise, ("parts",))
    (((before, (score,)),), _) = score_folds(rows, fits, finding, noise, by_parameters=False)
    # As in scoring, no loss counts for more than there was: a part left out may be what decides.
    return not _is_harmful(before / noise**2, np.minimum(score.after, 2.0 * before) / noise**2)


def _can_leave_out_runs(data: Products, base: IndexArray) -> bool:
    """Return whether there are several runs, and the columns of a model are known without any one of them."""
    runs = split_data_folds(data, "runs")
    if len(runs) < 2:
        return False
    inside = np.zeros((len(runs), len(base)))
    for joint, where in enumerate(data.position):
        have, places = find_present(where, base)
        squares = data.take_products(joint, places, places)
        inside[:, have] += [squares[run].sum(axis=0) for run in runs]
    return not bool((inside > _NEARLY_ALL * inside.sum(axis=0)).any())


def _is_shown_by_several_runs(fits: FoldedFits) -> bool:
    """Return whether the parameters of a finding are known beside the model without any one of the runs.

    A load on a shank has large columns in every run, but while the feet stand, they say what columns of the model say:
    only the runs in which the foot is lifted show it.
    """
    whole, *without_each = fits.fits.get_remaining_products(0)[:, 0]
    scale = np.sqrt(np.maximum(np.diag(whole), np.finfo(float).tiny))
    sizes, directions = np.linalg.eigh(whole / np.outer(scale, scale))
    # Combinations that no run shows are not in question.
    shown = sizes > _SHOWN * sizes[-1]
    if not shown.any():
        return False
    whitening = directions[:, shown] / np.sqrt(sizes[shown]) / scale[:, None]
    return all(np.linalg.eigvalsh(whitening.T @ own @ whitening)[0] > 1.0 - _NEARLY_ALL for own in without_each)


def _is_harmful(before: FloatArray, after: FloatArray) -> bool:
    """Return whether squared errors (s, n), in units of the noise, grow on any joint beyond chance, or on the whole."""
    removed = float(before.sum() - after.sum())
    if after.sum() > RULES.harm**2 * before.sum():
        return True
    # A joint is harmed where its error grows noticeably, by much of what the finding removes in all, and beyond chance.
    added = (after - before).sum(axis=0)
    grown = (after.sum(axis=0) > RULES.harm**2 * before.sum(axis=0)) & (added > IN_PASSING * removed)
    return bool((grown & (compute_evenness((after - before).T) >= RULES.harm_t)).any())


def prune_findings(state: State) -> State:
    """Remove the findings that others have made superfluous, the weakest first.

    Neighbours of coarse shape constants are left out: so many columns more would leave little for anything else.
    """
    state = state.drop_columns({k for finding in state.findings for k in finding.around})
    state = replace(state, findings=tuple(replace(finding, around=()) for finding in state.findings))
    while len(state.findings) > 1:
        judged = [
            (_rescore_finding(state, finding), finding)
            for finding in state.findings
            # A contact happened once and cannot be held out.
            if not finding.is_transient
        ]
        weak = [
            (scored, finding)
            for scored, finding in judged
            if scored.drop < state.rules.joint_drop
            or scored.t < state.rules.sure_t
            or any(is_shadowed(scored, other, state.floor) for other, rival in judged if rival is not finding)
        ]
        if not weak:
            break
        # One at a time: without the weakest, another may be needed again.
        _, superfluous = min(weak, key=lambda pair: pair[0].total_gain)
        state = state.drop_findings([superfluous])
    return state


def _rescore_finding(state: State, finding: Finding) -> ScoredCandidate:
    """Score a finding beside all others."""
    return score_all(state.drop_columns(finding.columns), [finding.judged.candidate])[0]


def trim_joints(state: State) -> list[tuple[str, ...]]:
    """Return the joints of every finding that still gain from it, each beside all the rest; at least one of a group."""
    joints = []
    for finding in state.findings:
        members, state = _select_members(state, finding.judged.candidate)
        joints.append(members)
    return joints


def _select_members(state: State, group: Candidate) -> tuple[tuple[str, ...], State]:
    """Return the joints of a group that gain from it, and the state without the columns of the others.

    What most joints of an arm have, their gears have: another of the group stays there unless data speak against it.
    """
    if len(group.joints) < 2:
        return group.joints, state
    gains, firm, likely, pool, rules = {}, [], [], state.pool, state.rules
    for joint in group.joints:
        own = select_columns_on(pool, group, joint)
        rest = state.drop_columns(own)
        alone = Candidate(group.effect, (joint,), group.shape, own, group.runs)
        (scored,) = score_all(rest, [alone])
        # If no joint passes, the one that gains most stands for the group.
        gains[joint] = scored.total_gain
        # What a group's other days had, it may have lost to another finding since: then it cannot have become less.
        if pool.is_change(alone) and not is_physically_possible(rest, scored):
            state = rest
        elif _has_gain(state, scored, rules.clear_t):
            firm.append(joint)
        elif _has_gain(state, scored, rules.staying_t):
            likely.append(joint)
        else:
            state = rest
    # Only where half of all joints surely have the effect is it likely on the others, too.
    if 2 * len(firm) < len(pool.observation.robot.joint_names):
        state = state.drop_columns({k for joint in likely for k in select_columns_on(pool, group, joint)})
        likely = []
    members = tuple(joint for joint in group.joints if joint in firm or joint in likely)
    return members or (max(gains, key=lambda name: gains[name]),), state


def _has_gain(state: State, alone: ScoredCandidate, least_t: float) -> bool:
    """Return whether a joint of a group gains by itself: enough, evenly, and more than the sensor's noise."""
    joint = state.pool.observation.robot.get_movers(alone.candidate.joints[0])[0]
    least_gain = get_least_gain(get_effect(alone.candidate.effect))
    is_helpful = alone.drop >= state.rules.joint_drop and alone.t >= least_t
    return is_helpful and compute_gain_over_floor(state, alone, joint) >= least_gain


@dataclass(frozen=True, eq=False)
class RefinedModel:
    """A model with refined findings behind it and nothing else.

    Parameters
    ----------
    state : State
        The model with all of them, which are the candidates of its pool.
    """

    state: State

    @classmethod
    def from_choices(
        cls,
        model: Model,
        findings: Sequence[Finding],
        choices: Sequence[EffectChoice],
        since: tuple[str, ...],
        inputs: RegressorInputs,
        floor: FloatArray,
    ) -> RefinedModel:
        """Gather the products of the model and of the choices that the findings have become."""
        columns = list(model.kept)
        refined: list[Finding] = []
        for finding, choice in zip(findings, choices, strict=True):
            new_columns = build_columns([choice], model.signals)
            numbers = tuple(range(len(columns), len(columns) + len(new_columns)))
            candidate = Candidate(choice.effect, choice.joints, choice.shape, numbers, choice.runs)
            # Neighbours of a coarse constant have done their part.
            refined.append(replace(finding, judged=replace(finding.judged, candidate=candidate), around=()))
            columns += new_columns
        observation = model.observation.extend(columns[model.n_parameters :], model.signals)
        pool = Pool(observation, model.n_parameters, tuple(finding.judged.candidate for finding in refined), since)
        # As after a search that found all of these: each is judged beside all others.
        state = gather_state(model, pool, inputs, floor)
        everything = tuple(range(observation.n_columns))
        return cls(replace(state, base=everything, findings=tuple(refined)).estimate_noise())

    def select_needed(self, preprocessing: Preprocessing) -> tuple[tuple[EffectChoice, ...], list[int]]:
        """Return the choices that still improve the prediction, on the joints where they do, and their indices."""
        state = prune_findings(drop_faded_contacts(self.state, preprocessing))
        remaining = {finding.judged.candidate for finding in state.findings}
        indices = [i for i, finding in enumerate(self.state.findings) if finding.judged.candidate in remaining]
        slim = [
            replace(self.state.findings[i].judged.candidate.choice, joints=own)
            for i, own in zip(indices, trim_joints(state), strict=True)
        ]
        return tuple(slim), indices

    def find_impossible(self) -> dict[int, tuple[Reason, tuple[str, ...]]]:
        """Return, by number, findings that refined constants have made physically impossible, and on which joints."""
        impossible: dict[int, tuple[Reason, tuple[str, ...]]] = {}
        for i, finding in enumerate(self.state.findings):
            # Without such constants an effect is what the search has judged already.
            if all(spec.refined is None for spec in get_effect(finding.judged.candidate.effect).shapes):
                continue
            found = find_impossible_parameter(self.state.drop_columns(finding.columns), finding.judged)
            if found is not None:
                impossible[i] = found
        return impossible

    def select_harmless(self, order: Sequence[int]) -> list[int]:
        """Return the indices of the findings that hurt nowhere.

        Parameters
        ----------
        order : sequence of int
            Indices of findings in the order in which they are added.
        """
        plain = replace(self.state, base=tuple(range(self.state.pool.n_base)), findings=())
        return [order[k] for k in select_harmless(plain, [self.state.findings[i].columns for i in order])]
