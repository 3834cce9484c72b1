"""Propose the next experiment for a diagnosis, with a design request, and attach it (`advise`).

Holds when two rivals count as decided, and how much smaller a standard deviation has to become for a run to be worth
it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from dynident.advice.discriminating_experiments import (
    EXPERIMENTS,
    AdvisedDiagnosis,
    Experiment,
    NextExperiment,
    Question,
    Separation,
    choose_experiment,
    word_reason,
)
from dynident.advice.effect_separation import (
    DataRows,
    NormalEquations,
    compute_row_weights,
    compute_separation,
    evaluate_data_rows,
    fit_amplitudes,
    normal_equations_from_rehearsal,
)
from dynident.array_types import FloatArray
from dynident.diagnosis import Diagnosis, Examination
from dynident.diagnosis.ambiguities import Doubt
from dynident.diagnosis.changes_between_recordings import prepare_undisturbed
from dynident.diagnosis.comparison.measured_against_predicted import Comparison, compare
from dynident.effects import EffectChoice, get_effect
from dynident.effects.effect_columns import find_joints
from dynident.errors import DynidentError
from dynident.excitation import CriterionChoice, DesignRequest, Rehearsal, rehearse_motion, rehearse_quickly
from dynident.excitation.criteria.design_criterion import find_effect_parameters
from dynident.excitation.design_observation_matrix import DesignModel, build_design_model
from dynident.excitation.design_request import compute_planned_seconds
from dynident.excitation.expected_torque import ExpectedTorque
from dynident.identification import Identification
from dynident.motion import Surroundings
from dynident.motion.limits.bounds import Bounds, build_bounds
from dynident.parallel import single_threaded
from dynident.progress import Progress, ignore_progress
from dynident.recordings import Recording
from dynident.robot.robot_model import Robot
from dynident.simulation import build_typical_effect


@single_threaded
def advise(examined: Examination) -> AdvisedDiagnosis:
    """Propose the experiment that would decide what a diagnosis leaves open.

    Parameters
    ----------
    examined : Examination
        What `dynident.diagnosis.examine` returned: the diagnosis, its doubts, and the data behind it.

    Returns
    -------
    AdvisedDiagnosis
        The diagnosis with the proposed experiment; `next_experiment` is None where no motion decides anything.
    """
    proposed = next_experiment(examined.identification, examined.comparisons, examined.doubts, examined.recordings)
    diagnosis_fields = {field.name: getattr(examined.diagnosis, field.name) for field in fields(Diagnosis)}
    return AdvisedDiagnosis(**diagnosis_fields, next_experiment=proposed)


@single_threaded
def decide_doubts(
    identification: Identification,
    recordings: Sequence[Recording],
    doubts: Sequence[Doubt],
    baseline: Sequence[Recording] = (),
    progress: Progress = ignore_progress,
) -> NextExperiment | None:
    """Propose the experiment for the doubts of a diagnosis whose data are no longer at hand.

    Parameters
    ----------
    identification : Identification
        The model that was diagnosed.
    recordings, baseline : sequence of Recording
        The recordings that it was diagnosed with.
    doubts : sequence of Doubt
        What the diagnosis left open, most important first.
    progress : Progress
        Called with the fraction done and a message; may raise to cancel.

    Returns
    -------
    NextExperiment or None
        None where no motion decides anything.
    """
    if not doubts:
        return None
    undisturbed, _ = prepare_undisturbed(identification, recordings, baseline)
    progress(0.3, "looking for a motion that decides")
    comparisons = [compare(undisturbed.identification, recording) for recording in undisturbed.recordings]
    return next_experiment(undisturbed.identification, comparisons, doubts, undisturbed.recordings)


_BETTER = 0.8
"""Of the present standard deviation: an experiment that leaves more of it tells nothing new."""
_DECISIVE, _MUCH_BETTER = 4.0, 0.5
"""An amplitude of so many standard deviations decides; where none is known, half of the present deviation has to do."""
_DECIDED_SHARE = 0.5
"""Rivals with so much of their columns to themselves are not alike in the data; with a decisive t nothing is open."""
_SEEN = 3.0
"""An effect of usual size that would have been so many standard deviations large in the data has been looked for."""


def next_experiment(
    identification: Identification,
    comparisons: Sequence[Comparison],
    doubts: Sequence[Doubt],
    recordings: Sequence[Recording] = (),
) -> NextExperiment | None:
    """Propose the motion that decides the first doubt that a motion can decide.

    Doubts about findings come first and are settled as well as a motion can. An effect that could not be seen is asked
    about only where its usual size would have been missed and the motion would show it. No motion is proposed that
    decides nothing. The promised separation is that of the data at hand together with the motion of a design that
    counts these data as `earlier` runs.

    Parameters
    ----------
    identification : Identification
        The model in question.
    comparisons : sequence of Comparison
        The model's prediction of the data at hand.
    doubts : sequence of Doubt
        What is open, most important first.
    recordings : sequence of Recording, optional
        Those of the comparisons: they say which data belong to runs with an effect of their own.

    Returns
    -------
    NextExperiment or None
        None where no motion decides anything, or where the robot's limits are not known.
    """
    try:
        # As the design will: clear of the robot itself, which shortens strokes, and with torque by this model.
        expected = ExpectedTorque(identification.model.robot, identification.estimate)
        bounds = build_bounds(
            identification.model.robot, {}, surroundings=Surroundings(), torque_note=expected.complete_note
        ).tighten()
    except DynidentError:
        # Limits that are not known: no motion can be proposed.
        return None
    second_best = None
    for doubt in doubts:
        answer = _propose_experiment(
            identification, _AvailableData(tuple(comparisons), tuple(recordings)), doubt, bounds
        )
        if answer is not None and answer.decides:
            return answer.advice
        # Doubts come in order of importance, so that the first answer is kept if none decides.
        second_best = second_best or answer
    return None if second_best is None else second_best.advice


@dataclass(frozen=True, eq=False)
class _AvailableData:
    """The comparisons of the data at hand, and the recordings behind them where these are known."""

    comparisons: tuple[Comparison, ...]
    recordings: tuple[Recording, ...]


@dataclass(frozen=True)
class _Proposal:
    """A proposal, and whether it decides the doubt or only brings light into it."""

    advice: NextExperiment
    decides: bool


@dataclass(frozen=True, eq=False)
class _Pairing:
    """A suspect and one rival in one model [others | suspect | rival], and how well the data at hand tell them apart.

    `deciding` is the parameter that comes out best, of the suspect, or of the rival where this alone has no shape
    constants: with other constants, which more data will find, the same effect has other amplitudes. `size` is what it
    is if the other of the two is not there (as usual on real arms where the suspect could not be seen), None where
    nobody knows it.
    """

    rival: EffectChoice | None
    model: DesignModel
    rows: DataRows
    row_weights: FloatArray
    known: NormalEquations
    deciding: int | None
    size: float | None

    def compute_separation(self, more: NormalEquations | None = None) -> Separation | None:
        """Return how well the data at hand, together with `more`, tell the two apart."""
        if self.deciding is None:
            return None
        known = self.known if more is None else self.known + more
        return compute_separation(self.model, known, self.deciding, self.size)


@dataclass(frozen=True, eq=False)
class _Case:
    """One doubt as a question, its hardest pairing, and how many filtered rows a second has."""

    question: Question
    pairing: _Pairing
    rate: float

    def estimate_separation(self, request: DesignRequest) -> Separation | None:
        """Return what a quickly made motion of this kind reaches together with the data at hand."""
        pairing = self.pairing
        return self._compute_separation_after(
            rehearse_quickly(request, pairing.model, self.question.bounds, self._evaluation_rate(request)), request
        )

    def rehearse_separation(self, request: DesignRequest) -> Separation | None:
        """Return what the motion of this very design reaches together with the data at hand."""
        pairing = self.pairing
        earlier = pairing.rows.to_earlier_rows(compute_planned_seconds(request) * self.rate)
        motion = rehearse_motion(request, pairing.model, self.question.bounds, self._evaluation_rate(request), earlier)
        return self._compute_separation_after(motion, request)

    def _compute_separation_after(self, motion: Rehearsal, request: DesignRequest) -> Separation | None:
        # The weights are per row of the data at hand. A motion that is sampled more densely has more rows a second, but
        # no more independent ones, so each row weighs less.
        weights = self.pairing.row_weights * np.sqrt(self.rate / self._evaluation_rate(request))
        return self.pairing.compute_separation(normal_equations_from_rehearsal(self.pairing.model, motion, weights))

    def _evaluation_rate(self, request: DesignRequest) -> float:
        """Return the rate in Hz at which columns are evaluated."""
        # Path memory needs all samples: between two decimated rows a joint may reverse.
        return request.trajectory.sampling_rate if self.pairing.model.needs_path else self.rate


def _propose_experiment(
    identification: Identification, data: _AvailableData, doubt: Doubt, bounds: Bounds
) -> _Proposal | None:
    try:
        case = _build_case(identification, data, doubt, bounds)
    except DynidentError:
        # Effects that no motion has columns for.
        return None
    pairing, question = case.pairing, case.question
    # What is a combination of other columns for every motion cannot be told from them by any motion.
    if _is_absorbed(pairing.model, doubt.suspect):
        return None
    present = pairing.compute_separation()
    if present is not None and _is_settled(doubt, present):
        return None
    choice = _choose_experiment(case, identification.model.effects, present)
    if choice is None:
        return None
    experiment, request, estimate = choice
    reached: Separation | None = None
    if estimate is None or present is None:
        present = None
    else:
        reached = _rehearse_better_separation(case, request, present)
        if reached is None:
            return None
    # An answer that cannot be predicted counts as deciding: what it rests on, such as a temperature, is what tells the
    # two apart.
    decides = present is None or reached is None or _is_decisive(present, reached)
    if not doubt.rivals:
        if present is None or not decides:
            return None
        # The size is not what was found: nothing was.
        present, reached = (replace(estimate, t_value=None) if estimate else None for estimate in (present, reached))
    advice = NextExperiment(
        reason=word_reason(experiment, question, doubt, present, reached),
        design=request,
        present_separation=present,
        expected_separation=reached,
        instructions=experiment.instructions,
    )
    return _Proposal(advice, decides)


def _choose_experiment(
    case: _Case, effects: tuple[EffectChoice, ...], present: Separation | None
) -> tuple[Experiment, DesignRequest, Separation | None] | None:
    """Choose the kind of experiment, with its design and what a quickly made motion of it reaches."""
    best: tuple[Experiment, DesignRequest, Separation | None] | None = None
    # The kinds of experiments are tried in order by a motion that is quick to make. The first that decides ends the
    # search; another one replaces the best only where it is much better.
    for experiment in _list_experiments(case.question):
        request = restrict_criterion_to_motion(case.pairing.model, experiment.design(case.question), effects)
        try:
            reached = case.estimate_separation(request) if experiment.predictable else None
        except DynidentError:
            continue
        if best is None or (reached and best[2] and _is_much_better(best[2], reached)):
            best = experiment, request, reached
        if reached is None or present is None or _is_decisive(present, reached):
            break
    return best


def _rehearse_better_separation(case: _Case, request: DesignRequest, present: Separation) -> Separation | None:
    """Return what the motion of a design reaches; None where this is no better than the data at hand, or no motion."""
    try:
        # The rough motion served to choose. What is promised to the user comes from rehearsing the design itself.
        reached = case.rehearse_separation(request)
    except DynidentError:
        return None
    if reached is None or not reached.standard_deviation < _BETTER * present.standard_deviation:
        return None
    return reached


def _is_settled(doubt: Doubt, present: Separation) -> bool:
    """Whether the data at hand have decided already, or would have shown what was not seen."""
    if present.t_value is None:
        return False
    if doubt.rivals:
        return present.t_value >= _DECISIVE and present.share >= _DECIDED_SHARE
    return present.t_value >= _SEEN


def _is_much_better(reference: Separation, other: Separation) -> bool:
    return other.standard_deviation < _MUCH_BETTER * reference.standard_deviation


def _is_decisive(present: Separation, reached: Separation) -> bool:
    if reached.t_value is None:
        return _is_much_better(present, reached)
    return reached.t_value >= _DECISIVE and reached.standard_deviation < _BETTER * present.standard_deviation


def _is_absorbed(model: DesignModel, suspect: EffectChoice) -> bool:
    """Whether an effect is, for every motion, the same function as others of the model."""
    own = any(column.effect == suspect.effect for column in model.columns)
    return own and not find_effect_parameters(model, suspect)


def _list_experiments(question: Question) -> list[Experiment]:
    """List the experiment for the pair, then those that show one of the two alone."""
    names = [choice.effect for choice in question.rivals]
    offered = [choose_experiment(names[0], names[1] if len(names) > 1 else None)]
    if question.is_about_place:
        # What shows the effect shows it wherever it is.
        return offered
    # Where no kind is made for the pair, an experiment that shows one of the two well may still decide.
    offered += [EXPERIMENTS[get_effect(name).experiment] for name in names]
    # Each kind once, in the order of preference; a set would lose the order.
    return list(dict.fromkeys(offered))


def _build_case(identification: Identification, data: _AvailableData, doubt: Doubt, bounds: Bounds) -> _Case:
    model = identification.model
    pairing = _find_hardest_pairing(identification, data, doubt)
    # Rows of the fit are decimated; the experiment is sampled as the recordings are.
    rate = _compute_row_rate(data.comparisons)
    raw_rate = rate * identification.preprocessing.decimation
    names, weights = model.robot.joint_names, pairing.row_weights
    question = Question(
        effects=(*model.effects, *doubt.beside),
        suspect=doubt.suspect,
        rival=pairing.rival,
        joints=_list_moved_joints(
            model.robot, [model.robot.tree.joint_names[j] for j in find_joints(doubt.suspect, model.robot)]
        ),
        bounds=bounds,
        noise={
            name: _round_to_four_digits(np.sqrt(raw_rate / rate) / weight)
            for name, weight in zip(names, weights, strict=True)
        },
        rate=_round_to_four_digits(raw_rate),
    )
    return _Case(question, pairing, rate)


def _list_moved_joints(robot: Robot, joints: Sequence[str]) -> tuple[str, ...]:
    """Return the joints that an experiment about these has to move: a passive joint moves with others."""
    return tuple(dict.fromkeys(robot.joint_names[k] for joint in joints for k in robot.get_movers(joint)))


def _find_hardest_pairing(identification: Identification, data: _AvailableData, doubt: Doubt) -> _Pairing:
    """Return the pairing with the rival that leaves the suspect least certain."""
    pairings = [_build_pairing(identification, data, doubt, rival) for rival in doubt.rivals or (None,)]
    # A rival without a column of its own is the same function as something in the model: it is no other explanation.
    real = [
        pairing for pairing in pairings if pairing.rival is None or find_effect_parameters(pairing.model, pairing.rival)
    ]
    return min(real or pairings, key=_compute_t_value)


def _compute_t_value(pairing: _Pairing) -> float:
    estimate = pairing.compute_separation()
    return 0.0 if estimate is None or estimate.t_value is None else estimate.t_value


def _build_pairing(
    identification: Identification, data: _AvailableData, doubt: Doubt, rival: EffectChoice | None
) -> _Pairing:
    model = identification.model
    of_place = rival is not None and rival.effect == doubt.suspect.effect
    # The order matters: of columns that depend on each other, the base parameters keep the earlier ones.
    pair = (doubt.suspect,) if rival is None else (rival, doubt.suspect) if of_place else (doubt.suspect, rival)
    extended_model = build_design_model(
        model.robot,
        (*model.effects, *doubt.beside, *pair),
        signals=model.signals,
        reference=identification.estimate.next_reference(),
        other_runs=True,
        expected=ExpectedTorque(model.robot, identification.estimate),
    )
    rows = evaluate_data_rows(extended_model, data.comparisons, data.recordings)
    weights = compute_row_weights(rows)
    known = rows.compute_normal_equations(weights)
    # Without a parameter that decides until one is found below.
    undecided = _Pairing(rival, extended_model, rows, weights, known, None, None)
    own = find_effect_parameters(extended_model, doubt.suspect)
    others = () if rival is None else find_effect_parameters(extended_model, rival)
    if others and doubt.suspect.shape and rival is not None and not rival.shape:
        # A suspect with shape constants is not judged by its amplitude: with other constants, which more data will
        # find, it has another one. The rival without shape constants decides instead.
        own, others = others, own
    if not own:
        return undecided
    if of_place:
        deciding, size = _find_surest_parameter(identification, data, doubt, extended_model, own)
        return replace(undecided, deciding=deciding, size=size)
    sizes = (
        _get_typical_sizes(extended_model, doubt.suspect, own) if rival is None else fit_amplitudes(known, own, others)
    )
    pairings = [replace(undecided, deciding=k, size=float(size)) for k, size in zip(own, sizes, strict=True)]
    return max(pairings, key=_compute_t_value)


def _find_surest_parameter(
    identification: Identification, data: _AvailableData, doubt: Doubt, model: DesignModel, own: Sequence[int]
) -> tuple[int, float]:
    """Return the parameter that is surest without the rival, of those that the rival cannot replace, and its size."""
    alone = _build_pairing(identification, data, replace(doubt, rivals=()), None)
    columns_alone = find_effect_parameters(alone.model, doubt.suspect)
    sizes = fit_amplitudes(alone.known, columns_alone, ())
    separations = [
        compute_separation(alone.model, alone.known, k, float(size))
        for k, size in zip(columns_alone, sizes, strict=True)
    ]
    by_name = {
        estimate.parameter: (estimate.t_value or 0.0, float(size))
        for estimate, size in zip(separations, sizes, strict=True)
    }
    t_and_size = {k: by_name.get(model.base_columns[k].name, (0.0, 0.0)) for k in own}
    surest = max(own, key=lambda k: t_and_size[k][0])
    return surest, t_and_size[surest][1]


def _get_typical_sizes(model: DesignModel, suspect: EffectChoice, parameters: Sequence[int]) -> list[float]:
    """Return how large the parameters are on real arms with the effect; 0 where no typical value is known."""
    joint = suspect.joints[0] if suspect.joints else ""
    usual = dict(build_typical_effect(model.robot, suspect.effect, joint).values)
    return [usual.get(model.base_columns[k].parameter, 0.0) for k in parameters]


def _compute_row_rate(comparisons: Sequence[Comparison]) -> float:
    """Return the rows a second of filtered, decimated data."""
    # The median: gaps between segments are a few long steps among many short ones.
    steps = np.concatenate([np.diff(comparison.t) for comparison in comparisons])
    return 1.0 / float(np.median(steps))


def _round_to_four_digits(value: float) -> float:
    return float(f"{value:.4g}")


def restrict_criterion_to_motion(
    model: DesignModel, request: DesignRequest, effects: tuple[EffectChoice, ...]
) -> DesignRequest:
    """Return the request with a criterion that a motion can meet, without effects that rest on more than the motion."""
    possible = tuple(choice for choice in request.criterion.effects if find_effect_parameters(model, choice))
    if possible:
        return replace(request, criterion=replace(request.criterion, effects=possible))
    return replace(request, effects=effects, criterion=CriterionChoice())
