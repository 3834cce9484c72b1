"""Test whether a candidate's parameters are determined beside the model, and list effects that could not be seen."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from dynident.array_types import BoolArray, FloatArray
from dynident.diagnosis.candidates.candidate_pool import Candidate, Pool
from dynident.diagnosis.candidates.held_out_scores import compute_held_out_errors, score_fitted
from dynident.diagnosis.candidates.products_of_scored_pairs import find_present
from dynident.diagnosis.candidates.significance import ScoredCandidate
from dynident.diagnosis.candidates.time_blocks_and_folds import Products
from dynident.diagnosis.decision_levels import RULES
from dynident.diagnosis.diagnosis_result import DetectionLimit, Invisible
from dynident.diagnosis.outcome_reasons import CandidateOutcome, Reason
from dynident.diagnosis.search.search_state import State
from dynident.effects import EffectChoice, build_columns, get_effect
from dynident.errors import DynidentError
from dynident.estimation import EstimationError, Reduction, solve_weighted
from dynident.estimation.least_squares import compute_noise_levels
from dynident.estimation.outlying_spans import OUTLYING_RATIO
from dynident.identification import Identification, IdentificationChoices
from dynident.identification.estimation_problem import Problem
from dynident.identification.identified_models.add_effects import extend_at_once
from dynident.number_format import format_percent
from dynident.progress import Progress, scale_progress
from dynident.recordings import Recording
from dynident.regressors.errors_by_phase import FittedPhase, compute_moving_errors, compute_phase_squares
from dynident.regressors.row_phases import remembers_path, shows_at_starts

_NOTHING_PREDICTED = 1e-6
"""Squared torque that an effect predicts of held-out rows, as a share of their squared error: less is rounding."""

Key = tuple[str, tuple[str, ...]]


def find_invisible(first: Sequence[ScoredCandidate]) -> tuple[Invisible, ...]:
    """Find effects on a joint of whose columns hardly anything is left beside the model, whatever their constants.

    Returns
    -------
    tuple of Invisible
        Effects with the share of their column that is left.
    """
    shares: dict[Key, float] = {}
    for scored in first:
        # Groups are left out: each of their joints is a candidate by itself.
        if len(scored.candidate.joints) <= 1:
            key = (scored.candidate.effect, scored.candidate.joints)
            # The constants of which most is left count: an effect is invisible only if none of them shows.
            shares[key] = max(shares.get(key, 0.0), scored.separability)
    why = "of its column is independent of the model on this motion, so these data cannot show it"
    return tuple(
        Invisible(
            *key, f"only {format_percent(share, decimals=1)} {why}", f"{format_percent(share, decimals=1)} independent"
        )
        for key, share in shares.items()
        if share < RULES.least_separability
    )


def list_unaddable(choices: Sequence[EffectChoice], dropped: Mapping[int, Reason]) -> tuple[Invisible, ...]:
    """List the effects that cannot be added; others that were dropped, by number, have shown and are not there."""
    return tuple(
        Invisible(
            choices[number].effect, choices[number].joints, f"it cannot be added: {dict(reason.values)['detail']}"
        )
        for number, reason in dropped.items()
        if reason.code == "cannot_be_added"
    )


def list_too_large_limits(
    limits: Sequence[DetectionLimit], hidden: Sequence[Invisible], outcomes: Sequence[CandidateOutcome]
) -> tuple[Invisible, ...]:
    """List the effects that would not show even at their usual size.

    Parameters
    ----------
    limits : sequence of DetectionLimit
        The detection limits.
    hidden : sequence of Invisible
        What could not have shown for other reasons, and is not repeated.
    outcomes : sequence of CandidateOutcome
        What became of every effect: what was found first and then refused has shown.
    """
    known = {(invisible.effect, invisible.joints) for invisible in hidden}
    refused = [outcome.choice for outcome in outcomes if outcome.reason.code in ("not_confirmed", "no_help_once_added")]
    known |= {(choice.effect, (joint,)) for choice in refused for joint in choice.joints}
    return tuple(
        _build_invisible(limit) for limit in limits if limit.share > 1.0 and (limit.effect, limit.joints) not in known
    )


def _build_invisible(limit: DetectionLimit) -> Invisible:
    unit = "" if limit.unit == "-" else f" {limit.unit}"
    usual = f"an arm with this effect has about {limit.usual:.2g}{unit}"
    if not math.isfinite(limit.size):
        return Invisible(limit.effect, limit.joints, f"these data would not show it at any size; {usual}", "at no size")
    shown = f"{limit.parameter} would have shown from {limit.size:.2g}{unit} on"
    brief = f"{limit.parameter}: from {limit.size:.2g} on (usual: {limit.usual:.2g}{unit})"
    return Invisible(limit.effect, limit.joints, f"{shown}; {usual}", brief)


def list_columns_with_findings(pool: Pool, base: tuple[int, ...], choices: Sequence[EffectChoice]) -> tuple[int, ...]:
    """List the columns of a model with what was found, at the shape constants of the pool nearest to theirs.

    Parameters
    ----------
    pool : Pool
        Model and candidates.
    base : tuple of int
        Columns of the model.
    choices : sequence of EffectChoice
        What the findings have become, with all their joints.
    """
    own = (column for choice in choices for column in _find_pool_columns(choice, pool))
    return tuple(dict.fromkeys((*base, *own)))


def _find_pool_columns(choice: EffectChoice, pool: Pool) -> tuple[int, ...]:
    """Return the pool's columns of an effect, with the shape constants nearest to those that it was found with."""

    def distance(other: Candidate) -> float:
        # Refined constants are not on the grid of the pool any more.
        pairs = [(choice.shape_values.get(name, 0.0), value) for name, value in other.shape]
        return sum(abs(a - b) / max(abs(a), abs(b), 1e-12) for a, b in pairs) + (other.runs != choice.runs)

    def find_nearest(joints: tuple[str, ...]) -> tuple[int, ...]:
        alike = [other for other in pool.candidates if other.effect == choice.effect and other.joints == joints]
        return min(alike, key=distance).columns if alike else ()

    # A group from which joints were dropped, or that joints have joined, is no candidate of the pool: its joints are.
    return find_nearest(choice.joints) or tuple(column for name in choice.joints for column in find_nearest((name,)))


def is_determined(state: State) -> bool:
    """Return whether the model that the search starts from predicts parts of the motion from the others.

    Where the motion does not determine it, what a candidate gains is what it happens to hold the model by.
    """
    return compute_part_to_part_ratio(state) <= state.rules.part_to_part


def compute_part_to_part_ratio(state: State) -> float:
    """Return the error on a fifth of the motion that is left out in a row, over that on every fifth block.

    Blocks with what was found already, a contact, do not count: it happened once, no other part of the motion tells
    of it.
    """
    rows, noise = state.rows, state.noise
    usual = np.ones(rows.n_blocks, dtype=bool)
    for finding in state.findings:
        usual &= ~_find_active_blocks(rows, finding.columns)
    # Interleaved folds are surrounded by data of the fit; a contiguous fold is a motion that the fit has not seen.
    inside, ahead = (
        float((compute_held_out_errors(rows, state.columns, noise, kind)[usual] / noise**2).sum())
        for kind in ("interleaved", "contiguous")
    )
    return float(np.sqrt(ahead / max(inside, np.finfo(float).tiny)))


def is_main_explanation(state: State, scored: ScoredCandidate) -> bool:
    """Return whether a candidate takes away most of what the model leaves where it was fitted.

    There nothing is predicted, so that none of it is for holding a model that the motion does not determine; a column
    or a few that take so much of what all parameters together could not are no chance, either.
    """
    # Fitted, not held out: what a poor motion leaves undetermined cannot be predicted by any model.
    rows = state.data.select_for_candidates(state.base, np.array(state.data.find_row_kinds(scored.candidate.columns)))
    fitted, own = score_fitted(rows, state.columns, scored.candidate, state.noise), list(scored.joints)
    initial, remaining = fitted.before[:, own].sum(axis=0), fitted.after[:, own].sum(axis=0)
    # A group is judged by all of its joints together.
    if len(scored.candidate.joints) > 1:
        initial, remaining = initial.sum(keepdims=True), remaining.sum(keepdims=True)
    return bool(
        (remaining <= (1.0 - state.rules.main_explanation) * initial).any()
        and scored.drop >= state.rules.main_explanation
    )


def _find_active_blocks(rows: Products, columns: Sequence[int]) -> BoolArray:
    """Return the blocks (s,) in which any of the columns is not zero."""
    is_shown = np.zeros(rows.n_blocks, dtype=bool)
    for joint, where in enumerate(rows.position):
        _, places = find_present(where, np.array(columns, dtype=np.intp))
        is_shown |= (rows.take_products(joint, places, places) > 0).any(axis=1)
    return is_shown


def extend_with_findings(
    identification: Identification,
    recommended: Sequence[EffectChoice],
    recordings: Sequence[Recording],
    validation: Sequence[Recording],
    progress: Progress,
) -> tuple[Identification, dict[int, Reason]]:
    """Extend the model by all recommended effects; return also, by number, why some cannot be added or do not help.

    First-order effects are about the torque that the model with all of them predicts. Held-out recordings without
    temperature say nothing of what needs it, and what some runs alone have, they may have as well.
    """
    dropped: dict[int, Reason] = {}
    is_warm = all(recording.has_temperature for recording in validation)
    while numbers := [number for number in range(len(recommended)) if number not in dropped]:
        shown = [k for k in numbers if is_warm or not get_effect(recommended[k].effect).needs_temperature]
        held_out = validation if shown == numbers else ()
        grown, failed = _extend(identification, recommended, numbers, recordings, held_out, progress)
        dropped.update(failed)
        judged = grown
        if shown != numbers:
            judged, failed = _extend(identification, recommended, shown, recordings, validation, progress)
        numbers = [number for number in numbers if number not in dropped]
        gone = {
            number: Reason.build("no_help_once_added")
            for number in numbers
            if is_only_helpful_at_first(grown, recommended[number])
        }
        tested = [k for k in shown if k not in dropped and k not in failed and not recommended[k].runs]
        unconfirmed = list_unconfirmed(judged, [recommended[number] for number in tested])
        gone |= {tested[k]: reason for k, reason in unconfirmed.items() if tested[k] not in gone}
        if not gone:
            return grown, dropped
        dropped.update(gone)
    return identification, dropped


def _extend(
    identification: Identification,
    recommended: Sequence[EffectChoice],
    numbers: Sequence[int],
    recordings: Sequence[Recording],
    validation: Sequence[Recording],
    progress: Progress,
) -> tuple[Identification, dict[int, Reason]]:
    """Extend the model by effects at once; where one of them cannot be added, one by one, first-order effects last."""
    grown, failed = identification, dict[int, Reason]()
    if not numbers:
        return grown, failed
    with suppress(DynidentError):
        choices = [recommended[number] for number in numbers]
        return extend_at_once(identification, choices, recordings, validation, progress), failed
    ordered = sorted(numbers, key=lambda number: get_effect(recommended[number].effect).first_order)
    for k, number in enumerate(ordered):
        own_progress = scale_progress(progress, k / len(ordered), (k + 1) / len(ordered))
        try:
            grown = extend_at_once(grown, [recommended[number]], recordings, validation, own_progress)
        except DynidentError as error:
            failed[number] = Reason.build("cannot_be_added", detail=error.detail)
    return grown, failed


def is_only_helpful_at_first(grown: Identification, choice: EffectChoice) -> bool:
    """Return whether a first-order effect explains nothing any more in the model that is identified with it.

    Its columns are made of the torque that the model without it predicts. Where the motion hardly determines that
    model, the one with it predicts another torque, and the gain is gone: without its columns no joint's error is
    noticeably larger.
    """
    if not get_effect(choice.effect).first_order:
        return False
    # Columns of the same effect may be in the model already, with other runs or shape constants.
    own = {column.key for column in build_columns([choice], grown.model.signals)}
    everything = range(grown.model.n_parameters)
    others = [k for k in everything if grown.model.kept[k].key not in own]
    problem = _build_problem(grown, grown.choices)
    with_it, without = (_solve_with(problem, columns) for columns in (everything, others))
    if with_it is None or without is None:
        return False
    now, before = (compute_noise_levels(problem.data.torque, values) for values in (with_it, without))
    return not (now**2 <= (1.0 - RULES.least_drop) * before**2).any()


def _build_problem(grown: Identification, choices: IdentificationChoices) -> Problem:
    """Return what a model is solved from, and what is known beside, with other choices."""
    return Problem.from_choices(grown.model, choices, grown.data.to_data(grown.estimate.reference))


def list_unconfirmed(grown: Identification, choices: Sequence[EffectChoice]) -> dict[int, Reason]:
    """List effects, by number, that held-out recordings do not confirm in the model that has all of them.

    An effect predicts a part of the torque there. If all of it is right, the squared error falls by the square of that
    part; if it only resembles something else in the motion of the fit, by less, or it grows. The least confirmed one
    goes first, since others may be confirmed without it.

    Parameters
    ----------
    grown : Identification
        The model with all of these effects.
    choices : sequence of EffectChoice
        Effects that it has.
    """
    held_out = grown.data.held_out
    gone: dict[int, Reason] = {}
    if held_out is None or not choices:
        return gone
    # As it will be used: a few rows at reversals, where play and filters show, must not decide what moving rows judge.
    problem = _build_problem(grown, replace(grown.choices, weigh_turns=True))
    all_columns = grown.model.kept
    own = [{column.key for column in build_columns([choice], grown.model.signals)} for choice in choices]
    added = set[tuple[object, ...]]().union(*own)
    plain = _solve_with(problem, [k for k, column in enumerate(all_columns) if column.key not in added])
    # With another load, or another robot, the rows say nothing of what the model lacks.
    if plain is None or _is_disturbed(problem.data.torque, held_out, plain):
        return gone
    while len(gone) < len(choices):
        others = [number for number in range(len(choices)) if number not in gone]
        dropped = {key for number in gone for key in own[number]}
        columns = [k for k, column in enumerate(all_columns) if column.key not in dropped]
        values = _solve_with(problem, columns)
        shares = {
            number: _compute_confirmed_share(
                grown, held_out, problem, [k for k in columns if all_columns[k].key in own[number]], columns, values
            )
            for number in others
        }
        worst = min(shares, key=lambda number: shares[number])
        if shares[worst] >= RULES.confirmed:
            break
        gone[worst] = Reason.build("not_confirmed", share=shares[worst], least=RULES.confirmed)
    return gone


def _is_disturbed(training: Reduction, held_out: Reduction, values: FloatArray) -> bool:
    """Return whether held-out rows as a whole stand out from those of the fit as much as a disturbed span."""
    errors, of_fit = (compute_moving_errors(reduction, values) for reduction in (held_out, training))
    return errors.compute_ratio_to(of_fit) ** 2 > OUTLYING_RATIO


def _solve_with(problem: Problem, columns: Sequence[int]) -> FloatArray | None:
    """Return the parameters (c,) that fit best with some of the columns, 0 for the others; None without a solution."""
    own, training, known = list(columns), problem.data.torque, problem.known
    if known is not None:
        known = known.select_columns(own)
    parameters = np.zeros(training.n_columns)
    try:
        parameters[own] = solve_weighted(training.select_columns(own), known).values
    except EstimationError:
        return None
    return parameters


def _compute_confirmed_share(
    grown: Identification,
    data: Reduction,
    problem: Problem,
    own: Sequence[int],
    columns: Sequence[int],
    values: FloatArray | None,
) -> float:
    """Return the squared error that some columns remove from held-out rows, as a share of the torque they predict.

    `values` are the parameters that fit best with all columns, None where nothing can be solved.

    On the joints that they act on, whatever other parameters make of the others; of the kind of rows that speaks most
    for them, of those on which they claim to act. Infinite where they predict nothing, where nothing can be solved
    without them, and where they lower the error of all joints noticeably: then the parameters of other joints are
    better with them.
    """
    without = _solve_with(problem, [k for k in columns if k not in own])
    if values is None or without is None:
        return math.inf
    observation, noise = grown.model.observation, compute_noise_levels(problem.data.torque, values)
    noise = np.where(noise > 0, noise, 1.0)[:, None]
    acting = [bool(set(own) & set(equation.columns.tolist())) for equation in data.equations]
    kinds: list[FittedPhase] = ["moving"]
    if remembers_path(observation, grown.model.signals)[list(own)].any():
        kinds.append("reversing")
    if shows_at_starts(observation)[list(own)].any():
        kinds.append("starting")
    shares = []
    for kind in kinds:
        after, before, midway = (
            (compute_phase_squares(data, each, kind) / noise**2).sum(axis=1)
            for each in (values, without, 0.5 * (values + without))
        )
        if after.sum() < (1.0 - RULES.least_drop) * before.sum():
            return math.inf
        # Of three points on a line of parameters, the squared errors give the square of what they predict differently.
        predicted = float((2.0 * (before + after) - 4.0 * midway)[acting].sum())
        if predicted > _NOTHING_PREDICTED * float(before[acting].sum()):
            shares.append(float((before - after)[acting].sum()) / predicted)
    return max(shares, default=math.inf)
