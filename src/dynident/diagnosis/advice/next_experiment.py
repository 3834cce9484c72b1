"""The experiment that would decide what the data could not."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dynident.diagnosis.advice.doubts import Doubt
from dynident.diagnosis.advice.kinds import EXPERIMENTS, Experiment, Question
from dynident.diagnosis.advice.pairs import ALONE, experiment_for
from dynident.diagnosis.advice.separation import Information, amplitudes, of_data, of_proposal, separation
from dynident.diagnosis.comparing.compare import Comparison
from dynident.diagnosis.result import NextExperiment, Separation
from dynident.effects import EffectChoice, effect_by_id
from dynident.effects.catalogue import joints_of
from dynident.errors import DynidentError
from dynident.excitation import CriterionChoice, DesignRequest
from dynident.excitation.criteria.deciding import parameters_of
from dynident.excitation.limits.bounds import Bounds, bounds_of
from dynident.excitation.observation.model import DesignModel, design_model
from dynident.identification import Identification
from dynident.robot.model import FloatArray

# Of the present standard deviation: below it no other motion is looked for, above it none is proposed.
_CLEARLY_BETTER, _HARDLY_BETTER = 0.8, 0.95


def next_experiment(
    identification: Identification, comparisons: Sequence[Comparison], doubts: Sequence[Doubt]
) -> NextExperiment | None:
    """Propose the motion that decides the first doubt that a motion can decide.

    Parameters
    ----------
    identification : Identification
        The model in question.
    comparisons : sequence of Comparison
        It beside the data at hand.
    doubts : sequence of Doubt
        What is open, most important first.
    """
    for doubt in doubts:
        found = _answer(identification, comparisons, doubt)
        if found is not None:
            return found
    return None


@dataclass(frozen=True, eq=False)
class _Pairing:
    """The suspect's rival that is hardest to tell from it, and how well the data at hand do.

    `deciding` is the parameter of the suspect that comes out best, `size` its amplitude, None where nobody knows it;
    `others` are the parameters of the other rivals.
    """

    rival: EffectChoice | None
    others: tuple[int, ...]
    deciding: int | None
    size: float | None
    present: Separation | None

    def judged(self, model: DesignModel, known: Information) -> Separation | None:
        """The separation from this rival alone."""
        if self.deciding is None:
            return None
        matrix = known.matrix.copy()
        matrix[list(self.others), :] = 0.0
        matrix[:, list(self.others)] = 0.0
        return separation(model, Information(matrix, known.right), self.deciding, self.size)


@dataclass(frozen=True, eq=False)
class _Case:
    """One doubt, with the model [others | suspect | rivals], what the data at hand say about it, and how hard it is."""

    question: Question
    model: DesignModel
    known: Information
    row_weights: FloatArray
    rate: float
    pairing: _Pairing

    def after(self, request: DesignRequest) -> Separation | None:
        """The separation that the data at hand and a design like this reach together."""
        if self.pairing.deciding is None:
            return None
        more = of_proposal(self.model, request, self.question.bounds, self.row_weights, self.rate)
        return self.pairing.judged(self.model, self.known + more)


def _answer(identification: Identification, comparisons: Sequence[Comparison], doubt: Doubt) -> NextExperiment | None:
    try:
        bounds = bounds_of(identification.model.robot, {}).tightened()
        case = _case_of(identification, comparisons, doubt, bounds)
    except DynidentError:
        # Limits that are not known: no motion can be proposed.
        return None
    if _absorbed(case.model, doubt.suspect):
        return None
    question = case.question
    best: tuple[Experiment, DesignRequest, Separation | None] | None = None
    for experiment in _worth_trying(question):
        request = _within_the_motion(case.model, experiment.design(question), identification.model.effects)
        try:
            reached = case.after(request) if experiment.predictable else None
        except DynidentError:
            continue
        if best is None or (reached and best[2] and reached.standard_deviation < best[2].standard_deviation):
            best = experiment, request, reached
        if reached is None or case.pairing.present is None:
            break
        if reached.standard_deviation < _CLEARLY_BETTER * case.pairing.present.standard_deviation:
            break
    if best is None:
        return None
    experiment, request, reached = best
    present = case.pairing.present if reached else None
    if present and reached and not reached.standard_deviation < _HARDLY_BETTER * present.standard_deviation:
        return None
    return NextExperiment(
        reason=_reason(experiment, question, doubt, present, reached),
        design=request,
        present_separation=present,
        expected_separation=reached,
        instructions=experiment.instructions,
    )


def _absorbed(model: DesignModel, suspect: EffectChoice) -> bool:
    """Whether an effect is, for every motion, the same function as others of the model."""
    own = any(column.effect == suspect.effect for column in model.columns)
    return own and not parameters_of(model, suspect)


def _worth_trying(question: Question) -> list[Experiment]:
    """The experiment of the pair, then those that show one of the two alone."""
    names = [choice.effect for choice in question.rivals]
    offered = [experiment_for(names[0], names[1] if len(names) > 1 else None)]
    offered += [EXPERIMENTS[ALONE[name]] for name in names if name in ALONE]
    return list(dict.fromkeys(offered))


def _case_of(identification: Identification, comparisons: Sequence[Comparison], doubt: Doubt, bounds: Bounds) -> _Case:
    model = identification.model
    effects = (*model.effects, *doubt.beside)
    wanted = design_model(
        model.robot,
        (*effects, doubt.suspect, *doubt.rivals),
        signals=model.signals,
        reference=identification.next_reference(),
    )
    weights = _row_weights(identification, comparisons)
    known = of_data(wanted, comparisons, weights)
    pairing = _hardest(wanted, known, doubt)
    rate = _row_rate(comparisons)
    raw_rate = rate * identification.preprocessing.decimation
    names = model.robot.joint_names
    question = Question(
        effects=effects,
        suspect=doubt.suspect,
        rival=pairing.rival,
        joints=tuple(names[j] for j in joints_of(doubt.suspect, model.robot)),
        bounds=bounds,
        noise={name: _short(np.sqrt(raw_rate / rate) / weight) for name, weight in zip(names, weights, strict=True)},
        rate=_short(raw_rate),
    )
    return _Case(question, wanted, known, weights, rate, pairing)


def _row_weights(identification: Identification, comparisons: Sequence[Comparison]) -> FloatArray:
    """(n,): one over the noise that every row would have if rows were independent of each other."""
    rows = sum(len(one.t) for one in comparisons)
    independent = np.clip(identification.effective_rows / max(rows, 1), 1e-3, 1.0)
    return np.asarray(np.sqrt(independent) / identification.noise)


def _hardest(model: DesignModel, known: Information, doubt: Doubt) -> _Pairing:
    """The pairing with the rival that leaves the suspect least certain."""
    suspect = parameters_of(model, doubt.suspect)
    groups = [set(parameters_of(model, rival)) for rival in doubt.rivals]
    taken = set().union(*groups)
    first = doubt.rivals[0] if doubt.rivals else None
    if not suspect:
        return _Pairing(first, (), None, None, None)
    best = _Pairing(first, tuple(sorted(taken)), suspect[0], None, None)
    if doubt.rivals:
        sizes = amplitudes(known, suspect, sorted(taken))
        alone = [replace(best, deciding=k, size=float(size)) for k, size in zip(suspect, sizes, strict=True)]
        best = max(alone, key=lambda one: _t_of(one.judged(model, known)))
    pairings = [
        replace(best, rival=rival, others=tuple(sorted(taken - group)))
        for rival, group in zip(doubt.rivals, groups, strict=True)
        if group
    ]
    judged = [replace(one, present=one.judged(model, known)) for one in pairings or [best]]
    return max(judged, key=lambda one: one.present.standard_deviation if one.present else 0.0)


def _t_of(found: Separation | None) -> float:
    return 0.0 if found is None or found.t_value is None else found.t_value


def _row_rate(comparisons: Sequence[Comparison]) -> float:
    """Rows a second of filtered, decimated data."""
    steps = np.concatenate([np.diff(one.t) for one in comparisons])
    return 1.0 / float(np.median(steps))


def _short(value: float) -> float:
    return float(f"{value:.4g}")


def _within_the_motion(model: DesignModel, request: DesignRequest, effects: tuple[EffectChoice, ...]) -> DesignRequest:
    """The request with a criterion that a motion can meet: what rests on more than it is left out."""
    possible = tuple(choice for choice in request.criterion.effects if parameters_of(model, choice))
    if possible:
        return replace(request, criterion=replace(request.criterion, effects=possible))
    return replace(request, effects=effects, criterion=CriterionChoice())


def _reason(
    experiment: Experiment, question: Question, doubt: Doubt, present: Separation | None, reached: Separation | None
) -> str:
    suspect = doubt.suspect.effect
    where = ", ".join(question.joints) if effect_by_id(suspect).scope == "joint" else "the whole robot"
    if doubt.rivals:
        what = f"tell {suspect} from {' or '.join(rival.effect for rival in doubt.rivals)}"
    else:
        what = f"show whether {suspect} is there"
    text = f"{experiment.words} would {what} on {where}."
    if present is None or reached is None:
        return text
    unit = "" if reached.unit == "-" else f" {reached.unit}"
    was = f"now {present.standard_deviation:.2g}" if np.isfinite(present.standard_deviation) else "now not at all"
    text = f"{text} It should give {reached.parameter} to within {reached.standard_deviation:.2g}{unit} ({was})"
    if reached.t_value is None or present.t_value is None:
        return f"{text}."
    return f"{text}: what was found is {reached.t_value:.1f} times that (now {present.t_value:.1f} times)."
