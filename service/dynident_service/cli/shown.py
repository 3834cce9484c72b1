"""Results as tables for people."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import zip_longest
from typing import TYPE_CHECKING

import numpy as np
from rich.console import Console

from dynident.effects import EffectChoice, effect_by_id
from dynident.effects.written import effect_text
from dynident.estimation import Errors
from dynident.identification import Identification
from dynident.identification.study.dependence import parameter_dependence
from dynident.identification.study.essential import EssentialPath
from dynident.identification.study.gain import best_rung
from dynident.recordings import phase_shares
from dynident.recordings.phases import Phase
from dynident.reports.candidate_rows import COLUMNS as CANDIDATES
from dynident.reports.candidate_rows import candidate_rows
from dynident.reports.change_rows import COLUMNS, FRICTION_COLUMNS, change_rows, friction_row
from dynident.reports.numbers import number, percent
from dynident.reports.parameter_tables import GROUPING, TIMES_SMALLEST, essential_tables, parameter_table, shape_table
from dynident.reports.words import (
    best_rung_text,
    hidden_text,
    place_text,
    rung_mark,
    standing_text,
)
from dynident.robot import Robot
from dynident_service.cli.inputs import Loaded
from dynident_service.cli.terminal import print_tables, table

if TYPE_CHECKING:
    from dynident.advice import AdvisedDiagnosis
    from dynident.diagnosis import Comparison, Diagnosis, Judgement
    from dynident.diagnosis.result import Change
    from dynident.diagnosis.series import Course, Series, SeriesChange
    from dynident.validation.drift import Drift
    from dynident.verdict import ModelVerdict, State

_TOO_WIDE = (GROUPING, TIMES_SMALLEST)

STOPPED = 3
"""The exit code of a model that is not to be used."""

_STYLES: Mapping[State, str] = {"yes": "green", "limited": "yellow", "no": "red", "not_judged": "yellow"}
_MARKS = {"ok": "✓", "warning": "!", "error": "✕"}


def show_measurements(console: Console, measurements: Sequence[Loaded], held_out: Sequence[Loaded]) -> None:
    """What was read, and everything doubtful in it."""
    rows = []
    for group, use in ((measurements, "identification"), (held_out, "held out")):
        for item in group:
            recording = item.recording
            rate = f"{recording.sampling_rate:.4g} Hz"
            rows.append(
                [recording.name, use, str(recording.n_samples), rate, standing_text(phase_shares(recording).standing)]
            )
    columns = ("measurement", "used for", "samples", "rate", "each joint stands")
    console.print(table("", columns, rows, right_from=2))
    for item in [*measurements, *held_out]:
        for check in item.checks:
            if check.status != "ok":
                name = check.name.replace("_", " ")
                console.print(f"  {_MARKS[check.status]} {item.recording.name}, {name}: {check.detail}")


def show_identification(console: Console, found: Identification, *, parameters: bool = True) -> None:
    """Errors per joint, parameters, warnings."""
    for reason in found.preprocessing.reasons:
        console.print(f"  {reason}", style="dim")
    console.print(_errors_table(found))
    if parameters:
        shown = parameter_table("Base parameters", found.parameters)
        print_tables(console, [shown.without(*_TOO_WIDE)])
        for sentence in parameter_dependence(found).sentences:
            console.print(f"  {sentence}")
        console.print(
            f"Condition number of W: {number(found.condition_number)}; {found.equations_per_parameter:.0f} equations "
            "per parameter"
        )
    if found.shape_constants:
        print_tables(console, [shape_table(found.shape_constants, found.model.robot.joint_names)])
        for constant in found.shape_constants:
            if constant.note and constant.judgement != "chosen":
                place = place_text(constant.joints, found.model.robot.joint_names)
                console.print(f"  {constant.name} of {constant.effect} on {place}: {constant.note}.")
    for warning in found.warnings:
        console.print(f"! {warning}", style="yellow")


def show_essential(console: Console, found: EssentialPath) -> None:
    """What was taken out, step by step, and what is left."""
    print_tables(console, (one.without(*_TOO_WIDE) for one in essential_tables(found)))
    console.print(found.reason)


def show_comparison(console: Console, name: str, found: Comparison, judged: Judgement) -> None:
    """Errors per joint, also against the noise floor, and the worst stretches."""
    errors, moving = found.errors, found.moving_errors
    rows = [
        [
            joint,
            *error_cells(moving, errors, j, found.units[j]),
            f"{number(float(judged.noise.values[j]))} {found.units[j]}",
            f"{judged.over_noise[j]:.1f} x" if moving.counts[j] else "–",
            f"{judged.effective_samples[j]:.0f} of {len(found.t)}",
        ]
        for j, joint in enumerate(found.joint_names)
    ]
    rows.append(["all joints", "", percent(moving.relative_total), percent(errors.relative_total), "", "", ""])
    columns = (
        "joint",
        "rms,\nmoving",
        "relative,\nmoving",
        "all\nrows",
        "noise\nfloor",
        "over\nnoise",
        "independent\nsamples",
    )
    console.print(table(f"Measured against predicted: {name}", columns, rows))
    if (found.phase == Phase.STANDING).any():
        console.print(
            "  Where a joint stands, static friction may hold the torque; held against the predicted torque itself the "
            f"error on all rows is {percent(found.raw_errors.relative_total)}."
        )
    worst = [
        [
            one.joint,
            f"{one.start:.2f} to {one.end:.2f} s",
            number(one.rms),
            f"{one.ratio:.1f} x",
            ", ".join(f"{value:.2f}" for value in one.pose),
        ]
        for one in found.worst[:5]
    ]
    console.print(table("Where it is worst", ("joint", "when", "rms", "of the joint's own", "pose"), worst))
    for note in judged.notes:
        console.print(f"  {note}")


def show_diagnosis(console: Console, found: AdvisedDiagnosis, robot: Robot) -> None:
    """The verdict, the ranking, what was not visible."""
    console.print(found.summary, style="bold")
    console.print(table("Candidates", CANDIDATES, candidate_rows(found.candidates, robot), right_from=3))
    for item in found.candidates:
        if item.significant:
            console.print(f"  {item.rank}. {item.evidence}")
    if found.recommended:
        wanted = ",".join(effect_text(choice) for choice in found.recommended)
        console.print(f"To add what is missing: dynident extend … --effects '{wanted}'", soft_wrap=True)
    for pattern in found.unknown:
        console.print(
            f"  {pattern.joint} still depends on {pattern.variable.replace('_', ' ')} ({percent(pattern.share, 2)})"
        )
    if found.not_visible:
        console.print(f"  This data could not have shown: {hidden_text(found, robot)}")
    if found.next_experiment is not None:
        console.print(f"  Next experiment: {found.next_experiment.reason}")
        for step in found.next_experiment.instructions:
            console.print(f"    - {step}")


def show_changes(console: Console, found: Diagnosis, robot: Robot) -> None:
    """What differs from the baseline, and what both lack."""
    console.print(found.summary, style="bold")
    rows = [list(row) for one in found.changes or () for row in change_rows(one, robot)]
    if rows:
        console.print(table("Changes since the baseline", COLUMNS, rows, right_from=3))
    for one in found.changes or ():
        _show_evidence(console, one)
    if found.friction:
        friction = [list(friction_row(one)) for one in found.friction]
        console.print(table("Friction of each joint", FRICTION_COLUMNS, friction, right_from=1))
    if found.recommended:
        both = "; ".join(choice_text(choice, robot) for choice in found.recommended)
        console.print(f"  Missing in the model before and after: {both}")
    if found.not_visible:
        console.print(f"  These motions could not have shown: {hidden_text(found, robot)}")


def _show_evidence(console: Console, one: Change) -> None:
    doubt = f" This data cannot tell it from: {', '.join(one.equivalent)}." if one.equivalent else ""
    console.print(f"  {one.evidence}{doubt}")


def choice_text(choice: EffectChoice, robot: Robot) -> str:
    """An effect in words: "Stribeck friction on joint2"."""
    title = effect_by_id(choice.effect).title
    return f"{title} on {place_text(choice.joints, robot.joint_names)}" if choice.joints else title


def error_cells(moving: Errors, errors: Errors, joint: int, unit: str) -> list[str]:
    """Of one joint: rms and relative error where it moves, relative error on all rows."""
    if not errors.counts[joint]:
        return ["no torque", "–", "–"]
    if not moving.counts[joint]:
        return ["never", "–", percent(float(errors.relative[joint]))]
    rms, relative = float(moving.rms[joint]), float(moving.relative[joint])
    return [f"{number(rms)} {unit}", percent(relative), percent(float(errors.relative[joint]))]


def _errors_table(found: Identification) -> object:
    kinds = [("fit", found.fit_moving, found.fit)]
    if found.held_out is not None and found.held_out_moving is not None:
        kinds.append(("held out", found.held_out_moving, found.held_out))
    columns, total = ["joint"], ["all joints"]
    for name, moving, errors in kinds:
        columns += [f"{name}, rms,\nmoving", "relative,\nmoving", "all\nrows"]
        total += ["", percent(moving.relative_total), percent(errors.relative_total)]
    rows = [
        [
            joint.name,
            *(cell for _, moving, all_of in kinds for cell in error_cells(moving, all_of, j, joint.effort_unit)),
        ]
        for j, joint in enumerate(found.model.robot.joints)
    ]
    return table("Error per joint: where it moves, and on all rows", columns, [*rows, total])


def show_verdict(console: Console, found: ModelVerdict) -> None:
    """What the model is fit for, why not, and what to do next."""
    if found.stop is not None:
        console.print(f"✕ {found.summary}", style="bold red")
    else:
        for one in found.uses:
            console.print(f"{one.mark} {one.words}: {one.reason}", style=_STYLES[one.state])
            console.print(f"    → {one.next_step}", soft_wrap=True)
        if found.drift is not None:
            _show_drift(console, found.drift)
    for step in found.next_steps:
        console.print(f"→ {step}")


def _show_drift(console: Console, drift: Drift) -> None:
    """How far a simulation is off that is left alone, joint by joint."""
    rows = [
        [joint, *(percent(share, 2) for share in each)]
        for joint, each in zip(drift.joint_names, drift.share.T.tolist(), strict=True)
    ]
    columns = ("joint", *(f"after {after:g} s" for after in drift.after))
    console.print(
        table("A simulation left alone under the measured torque is off by, of the joint's way", columns, rows)
    )


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
        console.print(f"  {told}")


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


def show_series(console: Console, found: Series, robot: Robot) -> None:
    """What changed and when, and the course of what did; of all else the file has it."""
    console.print(found.summary, style="bold")
    rows = [[when(one, found.days), *row] for one in found.changes for row in change_rows(one.change, robot)]
    if rows:
        console.print(table("Changes", ("from", *COLUMNS), rows, right_from=4))
    changed = {
        (one.change.choice.effect, joint) for one in found.changes for joint in one.change.choice.joints or ("",)
    }
    courses = [course for course in found.courses if (course.effect, course.joint) in changed]
    if courses:
        console.print(_courses(courses, found.days))
    for one in found.changes:
        _show_evidence(console, one.change)
    if found.missing:
        both = "; ".join(choice_text(choice, robot) for choice in found.missing)
        console.print(f"  Missing in the model on all days: {both}")


def when(one: SeriesChange, days: Sequence[str]) -> str:
    """The day from which something differs, with those that the data cannot tell from it."""
    if one.earliest == one.latest:
        return days[one.since]
    return f"{days[one.since]} ({days[one.earliest]} to {days[one.latest]})"


def _courses(courses: Sequence[Course], days: Sequence[str]) -> object:
    rows = []
    for k, day in enumerate(days):
        cells = [_cell(course.values[k], course.intervals[k]) for course in courses]
        rows.append([day, *cells])
    names = [f"{course.parameter}, {course.unit}" for course in courses]
    return table("Day by day, ± half of the 95 % interval", ("day", *names), rows, right_from=1)


def _cell(value: float, interval: np.ndarray) -> str:
    if not np.isfinite(value):
        return "not determined"
    return f"{number(float(value))} ± {number(float(interval[1] - value))}"
