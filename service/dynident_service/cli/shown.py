"""Results as tables for people."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import zip_longest

from rich.console import Console

from dynident.diagnosis import Comparison, Diagnosis, Judgement
from dynident.effects import EffectChoice, effect_by_id
from dynident.identification import Identification
from dynident.identification.dependence import parameter_dependence
from dynident.identification.essential import EssentialPath
from dynident.reports.numbers import estimate, number, percent
from dynident.reports.words import place_text
from dynident.robot import Robot
from dynident_service.cli.inputs import Loaded
from dynident_service.cli.terminal import table

_MARKS = {"ok": "✓", "warning": "!", "error": "✕"}


def show_measurements(console: Console, measurements: Sequence[Loaded], held_out: Sequence[Loaded]) -> None:
    """What was read, and everything doubtful in it."""
    rows = []
    for group, use in ((measurements, "identification"), (held_out, "held out")):
        for item in group:
            recording = item.recording
            rows.append([recording.name, use, str(recording.n_samples), f"{recording.sampling_rate:.4g} Hz"])
    console.print(table("", ("measurement", "used for", "samples", "rate"), rows, right_from=2))
    for item in [*measurements, *held_out]:
        for check in item.checks:
            if check.status != "ok":
                name = check.name.replace("_", " ")
                console.print(f"  {_MARKS[check.status]} {item.recording.name}, {name}: {check.detail}", markup=False)


def show_identification(console: Console, found: Identification, *, parameters: bool = True) -> None:
    """Errors per joint, parameters, warnings."""
    for reason in found.preprocessing.reasons:
        console.print(f"  {reason}", markup=False, style="dim")
    console.print(_errors_table(found))
    if parameters:
        console.print(_parameters_table(found))
        for sentence in parameter_dependence(found).sentences:
            console.print(f"  {sentence}", markup=False)
        console.print(
            f"Condition number of W: {number(found.condition_number)}; {found.equations_per_parameter:.0f} equations "
            "per parameter",
            markup=False,
        )
    for warning in found.warnings:
        console.print(f"! {warning}", markup=False, style="yellow")


def show_essential(console: Console, found: EssentialPath) -> None:
    """What was taken out, step by step, and what is left."""
    rows = []
    for step in found.steps:
        held_out = "–" if step.held_out is None else percent(step.held_out.relative_total)
        p_value = f"{step.p_value:.2g}"
        rows.append(
            [step.name, percent(step.relative_deviation, 2), p_value, percent(step.fit.relative_total), held_out]
        )
    columns = ("taken out", "relative deviation", "p", "fit", "held out")
    console.print(table("Backward elimination", columns, rows))
    console.print(_parameters_table(found.identification))
    console.print(found.reason, markup=False)


def show_ladder(console: Console, found: Identification) -> None:
    """The error falling, model by model."""
    rows = []
    for index, model in enumerate(found.ladder()):
        held_out = percent(model.held_out.relative_total) if model.held_out is not None else "–"
        rows.append([str(index + 1), change_text(model), percent(model.fit.relative_total), held_out])
    console.print(table("Ladder of models", ("model", "change", "fit", "held out"), rows, right_from=2))


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
    if model.parent is None:
        return "first model"
    robot = model.model.robot
    added = [choice_text(choice, robot) for choice in model.added]
    return ", ".join(added + [f"without {choice_text(choice, robot)}" for choice in model.removed])


def _total(model: Identification, held_out: bool) -> float:
    errors = model.held_out if held_out and model.held_out is not None else model.fit
    return errors.relative_total


def show_comparison(console: Console, name: str, found: Comparison, judged: Judgement) -> None:
    """Errors per joint, also against the noise floor, and the worst stretches."""
    errors = found.errors
    rows = [
        [
            joint,
            f"{number(float(errors.rms[j]))} {found.units[j]}",
            percent(float(errors.relative[j])),
            f"{number(float(judged.noise.values[j]))} {found.units[j]}",
            f"{judged.over_noise[j]:.1f} x",
            f"{judged.effective_samples[j]:.0f} of {len(found.t)}",
        ]
        for j, joint in enumerate(found.joint_names)
    ]
    rows.append(["all joints", "", percent(errors.relative_total), "", "", ""])
    columns = ("joint", "residual, rms", "relative", "noise floor", "over noise", "independent samples")
    console.print(table(f"Measured against predicted: {name}", columns, rows))
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
        console.print(f"  {note}", markup=False)


def show_diagnosis(console: Console, found: Diagnosis, robot: Robot) -> None:
    """The verdict, the ranking, what was not visible."""
    console.print(found.summary, markup=False, style="bold")
    rows = [
        [
            str(item.rank),
            effect_by_id(item.effect).title,
            place_text(item.joints, robot),
            percent(item.error_before),
            percent(item.error_after),
            percent(item.error_drop, 2),
            "yes" if item.significant else "no",
        ]
        for item in found.candidates
    ]
    columns = ("rank", "effect", "joints", "error before", "after", "drop", "significant")
    console.print(table("Candidates", columns, rows, right_from=3))
    for item in found.candidates:
        if item.significant:
            console.print(f"  {item.rank}. {item.evidence}", markup=False)
    if found.recommended:
        wanted = ",".join(choice_argument(choice) for choice in found.recommended)
        console.print(f"To add what is missing: dynident extend … --effects '{wanted}'", markup=False, soft_wrap=True)
    for pattern in found.unknown:
        console.print(
            f"  {pattern.joint} still depends on {pattern.variable.replace('_', ' ')} ({percent(pattern.share, 2)})",
            markup=False,
        )
    if found.not_visible:
        names = ", ".join(dict.fromkeys(item.effect for item in found.not_visible))
        console.print(f"  This data could not have shown: {names}", markup=False)
    if found.next_experiment is not None:
        console.print(f"  Next experiment: {found.next_experiment.reason}", markup=False)
        for step in found.next_experiment.instructions:
            console.print(f"    - {step}", markup=False)


def choice_text(choice: EffectChoice, robot: Robot) -> str:
    """An effect in words: "Stribeck friction on joint2"."""
    title = effect_by_id(choice.effect).title
    return f"{title} on {place_text(choice.joints, robot)}" if choice.joints else title


def choice_argument(choice: EffectChoice) -> str:
    """An effect as `--effects` reads it."""
    joints = f"@{'+'.join(choice.joints)}" if choice.joints else ""
    shape = ",".join(f"{name}={value:.6g}" for name, value in choice.shape)
    return f"{choice.effect}{joints}{':' + shape if shape else ''}"


def _errors_table(found: Identification) -> object:
    rows = []
    for j, joint in enumerate(found.model.robot.joints):
        row = [
            joint.name,
            f"{number(float(found.fit.rms[j]))} {joint.effort_unit}",
            percent(float(found.fit.relative[j])),
        ]
        if found.held_out is not None:
            rms, relative = float(found.held_out.rms[j]), float(found.held_out.relative[j])
            row += [f"{number(rms)} {joint.effort_unit}", percent(relative)]
        rows.append(row)
    total = ["all joints", "", percent(found.fit.relative_total)]
    columns = ["joint", "fit, rms", "fit, relative"]
    if found.held_out is not None:
        total += ["", percent(found.held_out.relative_total)]
        columns += ["held out, rms", "held out, relative"]
    return table("Error per joint", columns, [*rows, total])


def _parameters_table(found: Identification) -> object:
    rows = []
    for one in found.parameters:
        if not one.essential:
            continue
        value, deviation = estimate(one.value, one.standard_deviation)
        interval = " to ".join(estimate(end, one.standard_deviation)[0] for end in one.interval)
        relative = percent(one.relative_standard_deviation, 2)
        judged = "✓" if one.well_identified else "! poorly"
        rows.append([one.name, one.link, value, deviation, interval, one.unit, relative, judged])
    columns = ("parameter", "joint", "value", "standard deviation", "95 % interval", "unit", "relative", "identified")
    return table(f"{len(rows)} base parameters", columns, rows, right_from=2)
