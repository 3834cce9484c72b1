"""Ladders of models as tables for people."""

from __future__ import annotations

from itertools import zip_longest

from rich.console import Console

from dynident.identification import Identification
from dynident.identification.study.gain import best_rung
from dynident.reports.numbers import percent
from dynident.reports.words import best_rung_text, rung_mark
from dynident_service.cli.shown import choice_text
from dynident_service.cli.terminal import table


def show_ladder(console: Console, found: Identification) -> None:
    """The error falling, model by model."""
    models = list(found.ladder())
    best = best_rung(models)
    rows = []
    for index, model in enumerate(models):
        held_out = [
            "–" if errors is None else percent(errors.relative_total)
            for errors in (model.held_out, model.held_out_moving)
        ]
        fit = percent(model.fit.relative_total)
        rows.append([str(index + 1), change_text(model), fit, *held_out, rung_mark(best, index, len(models))])
    columns = ("model", "change", "fit", "held out", "moving", "")
    console.print(table("Ladder of models", columns, rows, right_from=2))
    if (told := best_rung_text(best, len(models))) != "":
        console.print(f"  {told}", markup=False)


def show_ladders(console: Console, one: tuple[str, Identification], other: tuple[str, Identification]) -> None:
    """Two ladders beside each other, each with its name: held-out errors, or those of the fit where there are none."""
    ladders = [list(found.ladder()) for _, found in (one, other)]
    held_out = all(model.held_out is not None for ladder in ladders for model in ladder)
    rows = []
    for index, pair in enumerate(zip_longest(*ladders)):
        errors = [None if model is None else _total(model, held_out) for model in pair]
        gap = "" if errors[0] is None or errors[1] is None else f"{100 * (errors[0] - errors[1]):+.2f}"
        cells = [
            ("" if m is None else change_text(m), "" if e is None else percent(e))
            for m, e in zip(pair, errors, strict=True)
        ]
        rows.append([str(index + 1), *cells[0], *cells[1], gap])
    columns = ("model", one[0], "error", other[0], "error", "difference, points")
    console.print(table(f"Two ladders, {'held out' if held_out else 'fit'}", columns, rows, right_from=5))


def change_text(model: Identification) -> str:
    """What was added to the model before, or taken out of it."""
    if model.step.parent is None:
        return "first model"
    robot = model.model.robot
    added = [choice_text(choice, robot) for choice in model.step.added]
    return ", ".join(added + [f"without {choice_text(choice, robot)}" for choice in model.step.removed])


def _total(model: Identification, held_out: bool) -> float:
    errors = model.held_out if held_out and model.held_out is not None else model.fit
    return errors.relative_total
