"""Tables and sentences of the ladder of models: its steps, the best one, the last one, and two ladders side by side."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import zip_longest

from dynident.effects import EffectChoice
from dynident.identification import Identification
from dynident.identification.identified_models.held_out_gain import (
    SAME_ERROR,
    WORSE_ERROR,
    BestStep,
    find_best_of_errors,
    list_confirming_rows,
)
from dynident.number_format import format_number, format_percent
from dynident.presentation.labels import format_choice
from dynident.presentation.model_tables import ErrorFigures, ErrorNumbers, format_ratio
from dynident.presentation.tables import Cell, ReportedTable, make_percent_cell, make_text_cells


@dataclass(frozen=True)
class Step:
    """One model of a ladder: what its step changed, and its errors where joints move (on all rows where none does).

    `held_out_all` is the held-out error on all rows; `confirmed_by` are the kinds of held-out rows that confirm what
    was added. `task` tells the held-out rows and their filters: errors of different ones do not compare.
    """

    added: Sequence[EffectChoice]
    removed: Sequence[EffectChoice]
    n_parameters: int | None
    fit: ErrorNumbers
    held_out: ErrorNumbers | None
    held_out_all: float | None
    confirmed_by: Sequence[str] = ()
    task: object = None

    def describe_change(self, joints: Sequence[str]) -> str:
        """Return in words what the step added and removed."""
        removed = [f"without {format_choice(choice, joints)}" for choice in self.removed]
        return "; ".join([*(format_choice(choice, joints) for choice in self.added), *removed]) or "first model"


def make_step(model: Identification) -> Step:
    """Return the last step of the ladder of a model."""
    return Step(
        model.step.added,
        model.step.removed,
        model.model.n_parameters,
        ErrorFigures.from_errors(model.fit_judged),
        None if model.held_out_judged is None else ErrorFigures.from_errors(model.held_out_judged),
        None if model.held_out is None else model.held_out.relative_total,
        list_confirming_rows(model) or (),
        (replace(model.preprocessing, reasons=()), model.data.validation_names),
    )


def list_steps(identification: Identification) -> list[Step]:
    """Return the steps of the ladder of a model, the first model first."""
    return [make_step(model) for model in identification.ladder()]


_NOT_COMPARABLE = "The models have different filters or held-out recordings: their errors cannot be compared."


def _have_same_task(steps: Sequence[Step]) -> bool:
    return all(step.task == steps[0].task for step in steps)


def find_best(steps: Sequence[Step]) -> BestStep | None:
    """Return which step of a ladder predicts held-out data best.

    None where one of them has no held-out error, or its own recordings or filters.
    """
    if not _have_same_task(steps):
        return None
    totals = [step.held_out.relative_total for step in steps if step.held_out is not None]
    known = [total for total in totals if total is not None]
    preferred = [bool(step.confirmed_by or step.removed) for step in steps]
    return find_best_of_errors(known, preferred) if len(known) == len(steps) else None


def select_comparable_errors(steps: Sequence[Step]) -> tuple[str, list[ErrorNumbers]]:
    """Return "held out" and the held-out errors of all steps where each has one, else "fit" and those of the fit."""
    # An error of the fit beside a held-out one would flatter its model.
    held_out = [step.held_out for step in steps if step.held_out is not None]
    return ("held out", held_out) if len(held_out) == len(steps) else ("fit", [step.fit for step in steps])


def build_ladder_table(steps: Sequence[Step], joints: Sequence[str]) -> ReportedTable:
    """Return the models of a ladder with their errors of all joints; the best one on held-out data is marked.

    Parameters
    ----------
    steps : sequence of Step
        The steps, the first model first.
    joints : sequence of str
        Names of all joints of the robot.
    """
    best = find_best(steps)
    rows = tuple(
        (
            *make_text_cells(str(k + 1), step.describe_change(joints)),
            Cell("–" if step.n_parameters is None else str(step.n_parameters), is_figures=True),
            make_percent_cell(step.fit.relative_total),
            make_percent_cell(None if step.held_out is None else step.held_out.relative_total),
            make_percent_cell(step.held_out_all),
            _mark_step(best, k, len(steps)),
        )
        for k, step in enumerate(steps)
    )
    columns = ("model", "change", "parameters", "fit", "held out", "held out, all rows", "on held-out data")
    title = "Ladder of models: relative error where joints move, and on all rows"
    sentence = describe_best_step(best, steps) if _have_same_task(steps) else _NOT_COMPARABLE
    marked_rows = () if best is None or len(steps) < 2 else (best.best,)
    return ReportedTable(
        title, columns, rows, 2, notes=(sentence,) if sentence else (), name="ladder", marked_rows=marked_rows
    )


def _mark_step(best: BestStep | None, index: int, count: int) -> Cell:
    if best is None or count < 2:
        return Cell("")
    if index == best.best:
        return Cell("✓ preferred" if best.equal else "✓ best", mark="ok")
    if index in best.equal:
        return Cell("equal")
    return Cell("↑ rises", mark="warning") if index in best.rises else Cell("")


def describe_best_step(best_step: BestStep | None, steps: Sequence[Step]) -> str:
    """Return the sentence that says which model of a ladder predicts held-out data best; "" without a choice."""
    if best_step is None or len(steps) < 2:
        return ""
    best = f"Model {best_step.best + 1} predicts held-out data best"
    if best_step.equal:
        # The smallest error alone does not decide, so no model is said to have it.
        equal = sorted((best_step.best, *best_step.equal))
        reason = _describe_preference(best_step.best, equal, steps)
        best = f"Models {_join_numbers(equal)} predict held-out data equally well where joints move{reason}"
    rises = best_step.rises
    if not rises:
        return f"{best}."
    if len(rises) < len(steps) - rises[0]:
        models = "models" if len(rises) > 1 else "model"
        return f"{best}; the held-out error of {models} {_join_numbers(rises)} is larger."
    return f"{best}; from model {rises[0] + 1} on the held-out error is larger: the steps from there on do not help."


def _describe_preference(best: int, equal: Sequence[int], steps: Sequence[Step]) -> str:
    """Return why a model is preferred to others that predict as well; "" where neither data nor its size tell."""
    if steps[best].confirmed_by:
        return f"; held-out data confirm what model {best + 1} adds"
    sizes = [size for k in equal if (size := steps[k].n_parameters) is not None]
    # Of as many parameters, the earlier model is the simpler one.
    is_simplest = len(sizes) == len(equal) and equal[sizes.index(min(sizes))] == best
    return f"; model {best + 1} is the simplest" if is_simplest else ""


def _join_numbers(models: Sequence[int]) -> str:
    """Return the numbers of models, from 1 on: "1, 2 and 3"."""
    *others, last = (str(k + 1) for k in models)
    return f"{', '.join(others)} and {last}" if others else last


def build_ladder_joint_table(
    steps: Sequence[Step], joints: Sequence[str], floor: Sequence[float] | None = None
) -> ReportedTable:
    """Return each joint's error in every model of a ladder.

    Parameters
    ----------
    steps : sequence of Step
        The steps, the first model first.
    joints : sequence of str
        Names of all joints of the robot.
    floor : sequence of float, optional
        Noise floor of each joint over the rms of its measured torque.
    """
    kind, errors = select_comparable_errors(steps)
    columns = ["joint", *(f"model {k}" for k in range(1, len(steps) + 1))]
    columns += ["last over first"] * (len(steps) > 1) + ["noise floor"] * (floor is not None)
    rows = []
    for j, joint in enumerate(joints):
        values = [error.relative[j] for error in errors]
        row = [Cell(joint), *map(make_percent_cell, values)]
        # The ratio says what all steps together have brought this joint.
        row += [Cell(format_ratio(values[-1], values[0]), is_figures=True)] if len(steps) > 1 else []
        row += [] if floor is None else [make_percent_cell(floor[j])]
        rows.append(tuple(row))
    notes = (
        "Noise floor: the torque sensor's noise within the filter's band, from second differences of the raw torque.",
    )
    title = f"Relative error per joint where it moves, {kind}"
    return ReportedTable(title, tuple(columns), tuple(rows), notes=notes if floor is not None else (), name="joints")


def build_two_ladders_table(
    names: tuple[str, str], ladders: tuple[Sequence[Step], Sequence[Step]], joints: Sequence[str]
) -> ReportedTable:
    """Return two ladders side by side; held-out errors, or those of the fit where any model has no held-out data."""
    kind, errors = select_comparable_errors([*ladders[0], *ladders[1]])
    pairs = zip_longest(errors[: len(ladders[0])], errors[len(ladders[0]) :])
    rows = []
    for k, ((own, other), steps) in enumerate(zip(pairs, zip_longest(*ladders), strict=True), start=1):
        cells = [Cell(str(k))]
        for step, error in zip(steps, (own, other), strict=True):
            cells += (
                [Cell("–"), Cell("–")]
                if step is None
                else [Cell(step.describe_change(joints)), make_percent_cell(error.relative_total)]
            )
        both = own is not None and other is not None
        cells.append(_subtract(own.relative_total, other.relative_total) if both else Cell("–"))
        cells += [_subtract(own.relative[j], other.relative[j]) if both else Cell("–") for j in range(len(joints))]
        rows.append(tuple(cells))
    return ReportedTable(
        f"Two ladders: relative error where joints move, {kind}",
        ("model", names[0], "error", names[1], "error", "difference, points", *joints),
        tuple(rows),
        numbers_from=5,
        notes=("Differences are in percentage points; below zero the first ladder is better.",),
        name="two_ladders",
    )


def _subtract(own: float | None, other: float | None) -> Cell:
    if own is None or other is None:
        return Cell("–")
    points = 100 * (own - other)
    return Cell(f"{'+' if points > 0 else ''}{format_number(points, 2)}", own - other)


def describe_gain(identification: Identification) -> str:
    """Return the model's error, that of the model that it began from, and what was added and removed."""
    steps, joints = list_steps(identification), identification.model.robot.joint_names
    kind, errors = select_comparable_errors(steps)
    data = "on held-out data" if kind == "held out" else "in the fit"
    last = f"Where joints move, the relative error of the torque is {format_percent(errors[-1].relative_total)} {data}"
    if len(steps) == 1:
        return f"{last}."
    kinds = {
        "Added": [choice for step in steps for choice in step.added],
        "Removed": [choice for step in steps for choice in step.removed],
    }
    changes = "".join(
        f" {name}: {'; '.join(format_choice(choice, joints) for choice in choices)}."
        for name, choices in kinds.items()
        if choices
    )
    return f"{last}; it was {format_percent(errors[0].relative_total)} before.{changes}"


@dataclass(frozen=True)
class StepSentence:
    """What the last step of a ladder did, in words, and whether it made nothing worse."""

    text: str
    is_better: bool


_CONFIRMING = {"reversing": "at reversals", "starting": "at starts"}


def describe_last_step(steps: Sequence[Step], joints: Sequence[str], first: int | None = None) -> StepSentence:
    """Return what a ladder did since the model `first` (the last but one by default), and which joints got worse."""
    first = len(steps) - 2 if first is None else first
    before, after = steps[first], steps[-1]
    added = [choice for step in steps[first + 1 :] for choice in step.added]
    changes = [("error of the fit", before.fit, after.fit)]
    unseen = before.held_out is not None and after.held_out is not None
    if before.held_out is not None and after.held_out is not None:
        changes.insert(0, ("held-out error", before.held_out, after.held_out))
    errors = ", ".join(
        f"{name} {format_percent(a.relative_total)} → {format_percent(b.relative_total)}" for name, a, b in changes
    )
    # What was removed may raise the error by what nobody would notice; what was added has to lower it, or to be
    # confirmed at the reversals or starts that it explains.
    _, old, new = changes[0]
    allowed = SAME_ERROR if after.removed else 1.0
    is_worse = not (new.relative_total or 0.0) < allowed * (old.relative_total or 0.0) and not after.confirmed_by
    worse = [
        joint
        for joint, a, b in zip(joints, old.relative, new.relative, strict=True)
        if a is not None and b is not None and b > WORSE_ERROR * a
    ]
    where = f" Worse than before on {', '.join(worse)}: see the table per joint before you keep it." if worse else ""
    if after.removed:
        names = "; ".join(format_choice(choice, joints) for choice in after.removed)
        loss = " The error is larger without it." if is_worse else "" if worse else " The model does not need it."
        return StepSentence(f"Removed {names}: where joints move, {errors}.{loss}{where}", not is_worse and not worse)
    names = "; ".join(format_choice(choice, joints) for choice in added)
    places = " and ".join(_CONFIRMING[rows] for rows in after.confirmed_by if rows in _CONFIRMING)
    confirmed = f" Held-out data confirm it {places}." if places else ""
    data = " on data that the fit has not seen" if unseen else ""
    advice = f" It did not help{data}: consider removing it." if is_worse else ""
    return StepSentence(
        f"Added {names}: where joints move, {errors}.{confirmed}{advice}{where}", not is_worse and not worse
    )
