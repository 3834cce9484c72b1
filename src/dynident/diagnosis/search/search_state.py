"""The state of a search (products, model so far, findings, noise), what it records, and the scores of candidates."""

from __future__ import annotations

from collections.abc import Collection, Hashable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

from dynident.array_types import FloatArray, IndexArray
from dynident.diagnosis.candidates.candidate_pool import Candidate, Pool
from dynident.diagnosis.candidates.held_out_scores import FoldedFits, JointBlocks, compute_held_out_errors, score_folds
from dynident.diagnosis.candidates.inner_product_accumulation import PhasedProducts, gather_products
from dynident.diagnosis.candidates.significance import (
    FamilywiseLevels,
    ScoredCandidate,
    combine_scores,
    draw_scores,
    run_familywise_test,
)
from dynident.diagnosis.candidates.time_blocks_and_folds import KINDS, Products
from dynident.diagnosis.decision_levels import RULES, DecisionRules
from dynident.diagnosis.outcome_reasons import Reason
from dynident.effects import EffectChoice, get_effect
from dynident.estimation.least_squares import floor_noise
from dynident.regressors.model_structure import Model
from dynident.regressors.observation_matrix import RegressorInputs


@dataclass(frozen=True, eq=False)
class Finding:
    """An effect that was found, and what the data cannot tell it from.

    Parameters
    ----------
    judged : ScoredCandidate
        The candidate with its score.
    equal : tuple of ScoredCandidate
        Candidates that the data cannot tell from it.
    p : float
        Its corrected p-value.
    around : tuple of int
        Columns of the same effect with neighbouring shape constants: until the constants are refined they say what the
        coarse ones cannot, so that it is not taken for something else.
    why : str
        What speaks for it, in words, where it is not its mark in the residual of a moving joint.
    former : tuple of ScoredCandidate
        Names that it had before: less likely, but one of them stands where its name and the equal ones turn out to be
        impossible.
    """

    judged: ScoredCandidate
    equal: tuple[ScoredCandidate, ...]
    p: float
    around: tuple[int, ...] = ()
    why: str = ""
    former: tuple[ScoredCandidate, ...] = ()

    @property
    def is_transient(self) -> bool:
        """Whether it happened once, so that blocks that it shows in cannot be held out: a contact."""
        return get_effect(self.judged.candidate.effect).is_transient

    @property
    def columns(self) -> tuple[int, ...]:
        """All columns that come with the finding."""
        return self.judged.candidate.columns + self.around


@dataclass(frozen=True, eq=False)
class State:
    """State of a search: what it looks at, the model so far, and what was found.

    Parameters
    ----------
    data : PhasedProducts
        Products of all columns.
    pool : Pool
        Model and candidates.
    base : tuple of int
        Columns of the model so far.
    noise : (n,)
        Rms of the residual that they leave, N m or N.
    floor : (n,)
        Noise of the sensors, N m or N.
    findings : tuple of Finding
        What was found.
    rules : DecisionRules
        The levels of the decision.
    """

    data: PhasedProducts
    pool: Pool
    base: tuple[int, ...]
    noise: FloatArray
    floor: FloatArray
    findings: tuple[Finding, ...] = ()
    rules: DecisionRules = RULES

    @property
    def level(self) -> float:
        """Largest p-value of a finding."""
        return self.rules.significance

    @property
    def columns(self) -> IndexArray:
        """Columns of the model so far (b,)."""
        return np.array(self.base, dtype=np.intp)

    @property
    def key(self) -> tuple[tuple[int, ...], Hashable]:
        """What tells the model so far, and its noise and data, from others: beside them, scores are the same."""
        return self.base, (self.noise.tobytes(), self.data.identity)

    @property
    def rows(self) -> Products:
        """Rows that are equations for the model so far."""
        return self.data.select_for_model(self.base)

    def drop_columns(self, columns: Collection[int]) -> State:
        """Return the state without some columns; the findings stay."""
        return replace(self, base=tuple(k for k in self.base if k not in columns))

    def drop_findings(self, gone: Collection[Finding]) -> State:
        """Return the state without some findings and their columns."""
        lasting = tuple(finding for finding in self.findings if finding not in gone)
        return replace(self.drop_columns({k for finding in gone for k in finding.columns}), findings=lasting)

    def add_finding(self, finding: Finding) -> State:
        """Return the state with one finding more; the noise stays."""
        return replace(self, base=self.base + finding.columns, findings=(*self.findings, finding))

    def estimate_noise(self) -> State:
        """Return the state with the noise that its model leaves, held out."""
        return replace(self, noise=estimate_residual_noise(self.data, self.base))


def gather_state(model: Model, pool: Pool, inputs: RegressorInputs, noise: FloatArray) -> State:
    """Return the state of a model beside which nothing was found, on products of all columns of a pool.

    Parameters
    ----------
    model : Model
        The model in which something is missing.
    pool : Pool
        Model and candidates.
    inputs : RegressorInputs
        Recordings, the model's filters, and what torque is predicted with.
    noise : (n,)
        Rms of the model's residual, N m or N; it stands for the noise of the sensors, too.
    """
    data = gather_products(pool.observation, model.signals, inputs, pool.n_base)
    return State(data, pool, tuple(range(pool.n_base)), noise, noise)


def score_all(
    state: State, candidates: Sequence[Candidate], *, kinds: tuple[bool, bool] | None = None
) -> list[ScoredCandidate]:
    """Score every candidate beside the model so far, in both kinds of folds; their p-values stay one.

    Each is scored on the rows that are equations for the model with it in: with friction that remembers the path also
    those where joints reverse, with friction that shows where a joint starts also those beside a halt; of all joints,
    so that candidates on different ones have the same rows.

    Parameters
    ----------
    state : State
        The model so far and what was found.
    candidates : sequence of Candidate
        Candidates to score.
    kinds : tuple of (bool, bool) or None
        Whether rows at reversals, and rows beside halts, count for all candidates, so that their gains can be compared;
        by default each has its own rows.

    Returns
    -------
    list of ScoredCandidate
        The candidates in their order.
    """
    scored = {
        k: each
        for rows in _group_by_rows(state, candidates, kinds)
        for k, each in zip(rows.members, _score_same_rows(rows, state, by_parameters=False)[0], strict=True)
    }
    return [scored[k] for k in range(len(candidates))]


@dataclass(frozen=True, eq=False)
class ScoredFamily:
    """Candidates that were scored and tested together.

    Parameters
    ----------
    scored : tuple of ScoredCandidate
        The candidates.
    levels : FamilywiseLevels
        What the test asks of each of them.
    draws : tuple of (draws,)
        Sizes of the scores of each of them, with the signs of blocks drawn anew.
    models : tuple of (tuple of int, hashable)
        The model (`State.key`) that each of them was scored beside.
    is_fresh : bool
        Whether that is for all of them the model that they were tested beside.
    """

    scored: tuple[ScoredCandidate, ...]
    levels: FamilywiseLevels
    draws: tuple[FloatArray, ...] = ()
    models: tuple[tuple[tuple[int, ...], Hashable], ...] = ()
    is_fresh: bool = True


def score_family(
    state: State,
    candidates: Sequence[Candidate],
    earlier: ScoredFamily | None = None,
    changed: Collection[int] | None = None,
) -> ScoredFamily:
    """Score candidates as `score_all` does, and test them together.

    What was scored beside the same model is not scored again.

    Parameters
    ----------
    state : State
        The model so far and what was found.
    candidates : sequence of Candidate
        Candidates to score.
    earlier : ScoredFamily, optional
        Scores beside a model that may differ: they stay for candidates that act on none of the joints where it does.
    changed : collection of int, optional
        Indices of these joints; all where left out. With none, scores beside the same columns stay: the data may be
        those of another pool, of the same rows, in which they have the same numbers.

    Returns
    -------
    ScoredFamily
        The candidates with the p-value of the family-wise test, and what the test asks of each of them.
    """
    known: dict[Candidate, tuple[ScoredCandidate, FloatArray, tuple[tuple[int, ...], Hashable]]] = {}
    if earlier is not None:
        for scored, own, model in zip(earlier.scored, earlier.draws, earlier.models, strict=True):
            if changed and set(changed).isdisjoint(scored.joints):
                known[scored.candidate] = scored, own, model
            elif model == state.key or (changed is not None and not changed and model[0] == state.base):
                known[scored.candidate] = scored, own, state.key
    stale = [candidate for candidate in candidates if candidate not in known]
    for rows in _group_by_rows(state, stale, None):
        scored_rows, contributions = _score_same_rows(rows, state, by_parameters=True)
        for candidate, own in zip(rows.candidates, contributions, strict=True):
            # Zeros are the scores of a candidate that explains nothing, so that its gains decide.
            own *= state.pool.is_change(candidate) or may_use_scores(candidate)
        for candidate, each, own in zip(rows.candidates, scored_rows, draw_scores(contributions), strict=True):
            known[candidate] = each, own, state.key
    members = [known[candidate] for candidate in candidates]
    # One test for all candidates of a round: the more are tried, the larger the best of them is by chance.
    gains = np.stack([scored.gains for scored, _, _ in members]) if members else np.zeros((0, 0))
    draws = tuple(own for _, own, _ in members)
    p, levels = run_familywise_test(gains, draws, state.level)
    tested = tuple(replace(scored, p=float(own)) for (scored, _, _), own in zip(members, p, strict=True))
    models = tuple(model for _, _, model in members)
    return ScoredFamily(tested, levels, draws, models, all(model == state.key for model in models))


def may_use_scores(candidate: Candidate) -> bool:
    """Return whether scores may speak for a candidate; else its gains alone do.

    Filters, clocks and halts leave in every row a little of what looks like a delay or a soft joint, and at reversals
    of what looks like presliding: scores find it on any arm. They do so on every day alike: of what changed they tell.
    """
    effect = get_effect(candidate.effect)
    return not effect.first_order and all(spec.resolved_by != "displacement" for spec in effect.shapes)


@dataclass(frozen=True, eq=False)
class _CommonRows:
    """Candidates (by number) that are all about the same rows, with these."""

    members: list[int]
    candidates: list[Candidate]
    data: Products


def _group_by_rows(
    state: State, candidates: Sequence[Candidate], kinds: tuple[bool, bool] | None
) -> Iterator[_CommonRows]:
    """Yield the candidates by their rows: the model's products are summed once for all that share them."""
    # There are four sets at most: with or without rows at reversals, with or without rows beside halts.
    sets: dict[tuple[bool, bool], list[int]] = {}
    for k, candidate in enumerate(candidates):
        sets.setdefault(kinds or state.data.find_row_kinds(candidate.columns), []).append(k)
    for used, members in sets.items():
        own = [candidates[k] for k in members]
        yield _CommonRows(members, own, state.data.select_for_candidates(state.base, np.array(used)))


def _score_same_rows(
    rows: _CommonRows, state: State, *, by_parameters: bool
) -> tuple[list[ScoredCandidate], list[FloatArray]]:
    """Score candidates that are all about the same rows; return what each block adds to their scores, if asked for."""
    candidates, noise = rows.candidates, state.noise
    blocks = JointBlocks.from_products(rows.data, state.columns, candidates)
    fits = FoldedFits.from_blocks(rows.data, blocks, noise, KINDS)
    scores_by_kind, contributions = score_folds(rows.data, fits, candidates, noise, by_parameters=by_parameters)
    joints = [state.pool.find_joints(candidate.columns) for candidate in candidates]
    return combine_scores([scores for _, scores in scores_by_kind], joints, noise), contributions


def estimate_residual_noise(data: PhasedProducts, base: tuple[int, ...]) -> FloatArray:
    """Return the rms (n,) of the held-out residual of every joint for the model so far."""
    rows = data.select_for_model(base)
    # Held out, so that a model with many columns does not look less noisy than it is.
    squares = compute_held_out_errors(rows, np.array(base, dtype=np.intp), np.ones(rows.n_joints), "interleaved").sum(
        axis=0
    )
    sigma = np.sqrt(squares / np.maximum(rows.counts.sum(axis=0), 1.0))
    return floor_noise(sigma)


class ProductSource(Protocol):
    """Source of the products of any columns."""

    @property
    def model(self) -> Model:
        """The model in which something is missing."""

    def gather_products(self, pool: Pool) -> PhasedProducts:
        """Return inner products of all columns of a pool and of the torque."""

    def add_findings(self, findings: Sequence[Finding]) -> ProductSource:
        """Return the same with the torque predicted by the model with these findings in it."""


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
    state : State
        The model with what was found, and products with the torque that it predicts.
    rows : ProductSource
        Gives products of further columns, with that torque.
    is_undetermined : bool
        Whether a finding was given up because the motion does not determine the model.
    rejections : dict of Candidate to Reason
        Why candidates were not chosen in the last round.
    dropped : dict of Candidate to Reason
        Why findings were dropped again.
    added : tuple of Finding
        The findings as they were added one by one, before they were renamed, merged, pruned or split.
    losses : dict of EffectChoice to Loss
        Which finding took most of each candidate's gain.
    family : ScoredFamily or None
        The candidates that were left in the last round.
    """

    state: State
    rows: ProductSource
    is_undetermined: bool = False
    rejections: dict[Candidate, Reason] = field(default_factory=dict)
    dropped: dict[Candidate, Reason] = field(default_factory=dict)
    added: tuple[Finding, ...] = ()
    losses: dict[EffectChoice, Loss] = field(default_factory=dict)
    family: ScoredFamily | None = None

    def record_losses(
        self, finding: Finding, before: Sequence[ScoredCandidate], after: Sequence[ScoredCandidate]
    ) -> None:
        """Record what each candidate lost by a finding; one that is no candidate any more lost all."""
        gains = {scored.candidate: scored.total_gain for scored in after}
        for scored in before:
            lost = scored.total_gain - gains.get(scored.candidate, 0.0)
            known = self.losses.get(scored.candidate.choice)
            if lost > 0.0 and (known is None or lost > known.gain):
                self.losses[scored.candidate.choice] = Loss(finding, lost)
