"""Print results other than validations: which tables, columns and marks; the exit code of a stopped model (3)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import zip_longest
from typing import TYPE_CHECKING

import numpy as np
from rich.console import Console

from dynident.diagnosis.diagnosis_summary import group_patterns
from dynident.effects import EffectChoice, get_effect
from dynident.estimation import Errors
from dynident.identification import Identification
from dynident.identification.identified_models.correlated_and_essential_parameters import (
    EssentialPath,
    parameter_dependence,
)
from dynident.identification.identified_models.held_out_gain import find_best_step
from dynident.number_format import format_number, format_percent
from dynident.recordings import phase_shares
from dynident.recordings.joint_phases import Phase
from dynident.reports.labels import (
    describe_best_step,
    describe_condition_number,
    format_hidden_effects,
    format_joints,
    format_standstill_shares,
    get_effect_title,
    get_step_mark,
)
from dynident.reports.result_tables import CANDIDATE_COLUMNS as CANDIDATES
from dynident.reports.result_tables import (
    CHANGE_COLUMNS,
    FRICTION_COLUMNS,
    GROUPING,
    LIMIT_COLUMNS,
    TIMES_SMALLEST,
    build_essential_tables,
    build_parameter_table,
    build_shape_table,
    format_candidates,
    format_change,
    format_friction_difference,
    format_limits,
)
from dynident.robot import Robot
from dynident_service.cli.argument_loading import LoadedRecording
from dynident_service.cli.terminal import build_table, print_tables

if TYPE_CHECKING:
    from dynident.diagnosis import Comparison, Diagnosis, Judgement
    from dynident.diagnosis.diagnosis_result import Change
    from dynident.diagnosis.monitoring import ParameterTrack, Series, SeriesChange
    from dynident.validation.simulated_response import Drift
    from dynident.verdict import Action, ModelVerdict, State

_TOO_WIDE = (GROUPING, TIMES_SMALLEST)
"""Columns of parameter tables that do not fit a terminal; files and reports have them."""

EXIT_STOPPED = 3
"""The exit code of a model that is not to be used."""

_STYLES: Mapping[State, str] = {"yes": "green", "limited": "yellow", "no": "red", "not_judged": "yellow"}
_MARKS = {"ok": "✓", "warning": "!", "error": "✕"}


def show_measurements(
    console: Console, measurements: Sequence[LoadedRecording], held_out: Sequence[LoadedRecording]
) -> None:
    """Print the recordings and all checks that are not ok."""
    rows = []
    for group, use in ((measurements, "identification"), (held_out, "held out")):
        for item in group:
            recording = item.recording
            rate = f"{recording.sampling_rate:.4g} Hz"
            rows.append(
                [
                    recording.name,
                    use,
                    str(recording.n_samples),
                    rate,
                    format_standstill_shares(phase_shares(recording).standing),
                ]
            )
    columns = ("measurement", "used for", "samples", "rate", "standstill per joint")
    console.print(build_table("", columns, rows, right_from=2))
    # Passed checks are not printed: the table says already that the file was read.
    for item in [*measurements, *held_out]:
        for check in item.checks:
            if check.status != "ok":
                name = check.name.replace("_", " ")
                console.print(f"  {_MARKS[check.status]} {item.recording.name}, {name}: {check.detail}")


def show_identification(console: Console, identification: Identification, *, parameters: bool = True) -> None:
    """Print the errors per joint, the parameters, the shape constants, and the warnings of a model."""
    for reason in identification.preprocessing.reasons:
        console.print(f"  {reason}", style="dim")
    console.print(_build_errors_table(identification))
    # After an extension most parameters are those of the model before, and are not printed again.
    if parameters:
        base_table = build_parameter_table("Base parameters", identification.parameters)
        print_tables(console, [base_table.drop_columns(*_TOO_WIDE)])
        for sentence in parameter_dependence(identification).sentences:
            console.print(f"  {sentence}")
        console.print(
            f"Condition number of W: {describe_condition_number(identification)}; "
            f"{identification.equations_per_parameter:.0f} equations per parameter"
        )
    if identification.shape_constants:
        print_tables(
            console, [build_shape_table(identification.shape_constants, identification.model.robot.joint_names)]
        )
        for constant in identification.shape_constants:
            # The note of a choice among kinds explains nothing that is odd.
            if constant.note and constant.judgement != "chosen":
                place = format_joints(constant.joints, identification.model.robot.joint_names)
                console.print(f"  {constant.name} of {constant.effect} on {place}: {constant.note}.")
    for warning in identification.warnings:
        console.print(f"! {warning}", style="yellow")


def show_essential(console: Console, path: EssentialPath) -> None:
    """Print the steps of the backward elimination and the essential parameters."""
    print_tables(console, (reported_table.drop_columns(*_TOO_WIDE) for reported_table in build_essential_tables(path)))
    console.print(path.reason)


def show_comparison(console: Console, name: str, comparison: Comparison, judgement: Judgement) -> None:
    """Print the errors per joint, their ratio to the noise floor, and the intervals with the largest residuals."""
    errors, moving = comparison.errors, comparison.moving_errors
    rows = [
        [
            joint,
            *format_errors(moving, errors, j, comparison.units[j]),
            f"{format_number(float(judgement.noise.values[j]))} {comparison.units[j]}",
            f"{judgement.over_noise[j]:.1f} x" if moving.counts[j] else "–",
            f"{judgement.effective_samples[j]:.0f} of {len(comparison.t)}",
        ]
        for j, joint in enumerate(comparison.joint_names)
    ]
    rows.append(
        ["all joints", "", format_percent(moving.relative_total), format_percent(errors.relative_total), "", "", ""]
    )
    columns = (
        "joint",
        "rms,\nmoving",
        "relative,\nmoving",
        "all\nrows",
        "noise\nfloor",
        "over\nnoise",
        "independent\nsamples",
    )
    console.print(build_table(f"Measured against predicted: {name}", columns, rows))
    if (comparison.phase == Phase.STANDING).any():
        console.print(
            "  While a joint stands still, static friction may balance the torque. Compared with the predicted torque "
            f"itself, the error on all rows is {format_percent(comparison.raw_errors.relative_total)}."
        )
    worst = [
        [
            interval.joint,
            f"{interval.start:.2f} to {interval.end:.2f} s",
            format_number(interval.rms),
            f"{interval.ratio:.1f} x",
            ", ".join(f"{value:.2f}" for value in interval.pose),
        ]
        for interval in comparison.worst[:5]
    ]
    console.print(
        build_table("Where it is worst", ("joint", "when", "rms", "relative to the joint's rms", "pose"), worst)
    )
    for note in judgement.notes:
        console.print(f"  {note}")


def show_diagnosis(
    console: Console,
    diagnosis: Diagnosis,
    robot: Robot,
    extend_command: str,
    questions: Sequence[tuple[str, str]] = (),
    n_open: int = 0,
) -> None:
    """Print a diagnosis.

    Parameters
    ----------
    console : Console
        Where to print.
    diagnosis : Diagnosis
        Summary, ranked candidates, recommendation, what the data cannot show, and the next experiment if it has one.
    robot : Robot
        Its robot.
    extend_command : str
        Command that adds the recommended effects.
    questions : sequence of (str, str)
        Effects and joints for which the reason is printed; an empty joint stands for the best place.
    n_open : int
        Number of open questions for which no experiment was looked for.
    """
    from dynident.advice import AdvisedDiagnosis

    console.print(diagnosis.summary, style="bold")
    console.print(build_table("Candidates", CANDIDATES, format_candidates(diagnosis.candidates, robot), right_from=3))
    for item in diagnosis.candidates:
        if item.significant:
            console.print(f"  {item.rank}. {item.evidence}")
    for effect, joint in questions:
        place = f" on {joint}" if joint else ""
        console.print(f"  {get_effect_title(effect)}{place}: {diagnosis.why_not(effect, joint)}")
    if diagnosis.detection_limits:
        rows = format_limits(diagnosis.detection_limits, robot)
        console.print(build_table("What these data would have shown", LIMIT_COLUMNS, rows, wrapped=3))
    elif diagnosis.not_visible:
        console.print(f"  These data could not show in its usual size: {format_hidden_effects(diagnosis, robot)}")
    if diagnosis.recommended:
        console.print(f"To add what is missing: {extend_command}", soft_wrap=True, markup=False, highlight=False)
    for variable, joints, shares in group_patterns(diagnosis.unknown, robot.joint_names):
        console.print(f"  The residual still depends on the {variable}: {joints} ({shares})")
    if diagnosis.conclusion is not None:
        console.print(f"  {diagnosis.conclusion.headline} {diagnosis.conclusion.next_step}")
    if n_open:
        are_open = "1 question is open" if n_open == 1 else f"{n_open} questions are open"
        console.print(f"  {are_open}: --next-experiment looks for a motion that decides.")
    if isinstance(diagnosis, AdvisedDiagnosis) and diagnosis.next_experiment is not None:
        console.print(f"  Next experiment: {diagnosis.next_experiment.reason}")
        for step in diagnosis.next_experiment.instructions:
            console.print(f"    - {step}")


def show_changes(console: Console, diagnosis: Diagnosis, robot: Robot) -> None:
    """Print what differs from the baseline, and what the model lacks before and after."""
    console.print(diagnosis.summary, style="bold")
    rows = [list(row) for change in diagnosis.changes or () for row in format_change(change, robot)]
    if rows:
        console.print(build_table("Changes since the baseline", CHANGE_COLUMNS, rows, right_from=3))
    for change in diagnosis.changes or ():
        _show_evidence(console, change)
    if diagnosis.friction:
        friction = [list(format_friction_difference(difference)) for difference in diagnosis.friction]
        console.print(build_table("Friction of each joint", FRICTION_COLUMNS, friction, right_from=1))
    if diagnosis.recommended:
        both = "; ".join(format_choice(choice, robot) for choice in diagnosis.recommended)
        console.print(f"  Missing in the model before and after: {both}")
    if diagnosis.not_visible:
        console.print(f"  These motions could not show: {format_hidden_effects(diagnosis, robot)}")


def _show_evidence(console: Console, change: Change) -> None:
    doubt = f" These data cannot distinguish it from: {', '.join(change.equivalent)}." if change.equivalent else ""
    console.print(f"  {change.evidence}{doubt}")


def format_choice(choice: EffectChoice, robot: Robot) -> str:
    """Return an effect in words: "Stribeck friction on joint2"."""
    title = get_effect(choice.effect).title
    return f"{title} on {format_joints(choice.joints, robot.joint_names)}" if choice.joints else title


def format_errors(moving: Errors, errors: Errors, joint: int, unit: str) -> list[str]:
    """Format the errors of one joint.

    Parameters
    ----------
    moving, errors : Errors
        Errors on the rows where each joint moves, and on all rows.
    joint : int
        Index of the joint.
    unit : str
        Unit of its torque or force.

    Returns
    -------
    list of str
        Three cells: rms and relative error where it moves, relative error on all rows.
    """
    # A joint without torque has no error, and one that never moves has none while moving.
    if not errors.counts[joint]:
        return ["no torque", "–", "–"]
    if not moving.counts[joint]:
        return ["never", "–", format_percent(float(errors.relative[joint]))]
    rms, relative = float(moving.rms[joint]), float(moving.relative[joint])
    return [f"{format_number(rms)} {unit}", format_percent(relative), format_percent(float(errors.relative[joint]))]


def _build_errors_table(identification: Identification) -> object:
    kinds = [("fit", identification.fit_moving, identification.fit)]
    if identification.held_out is not None and identification.held_out_moving is not None:
        kinds.append(("held out", identification.held_out_moving, identification.held_out))
    columns, total = ["joint"], ["all joints"]
    for name, moving, errors in kinds:
        columns += [f"{name}, rms,\nmoving", "relative,\nmoving", "all\nrows"]
        total += ["", format_percent(moving.relative_total), format_percent(errors.relative_total)]
    rows = [
        [
            joint.name,
            *(cell for _, moving, all_of in kinds for cell in format_errors(moving, all_of, j, joint.effort_unit)),
        ]
        for j, joint in enumerate(identification.model.robot.joints)
    ]
    return build_table("Error per joint: where it moves, and on all rows", columns, [*rows, total])


COMMANDS_OF_NEXT_STEPS: Mapping[Action | None, str] = {
    "diagnose": "dynident diagnose MODEL RUN",
    "design": "dynident design ROBOT",
    "identify_feasible": "dynident identify … --estimator feasible",
    "check_gains": "dynident validate MODEL payload LOADED --unloaded RUN --mass KG",
    "identify_gains": "dynident gains",
    "export_for_simulation": "dynident export MODEL -f urdf, or -f mjcf",
    "export_for_feed_forward": "dynident export MODEL -f c, or -f casadi",
    "weigh_load": "dynident validate MODEL payload LOADED --unloaded RUN",
}
"""The command of each next step of a verdict; for the observer of contacts there is none."""


def show_verdict(console: Console, verdict: ModelVerdict) -> None:
    """Print for which uses a model is fit, why or why not, and what to do next."""
    # After a gross fault the uses mean nothing.
    if verdict.stop is not None:
        console.print(f"✕ {verdict.summary}", style="bold red")
    else:
        for use in verdict.uses:
            console.print(f"{use.mark} {use.words}: {use.reason}", style=_STYLES[use.state])
            command = COMMANDS_OF_NEXT_STEPS.get(use.next_action, "")
            step = f"{use.next_step.removesuffix('.')}: {command}" if command else use.next_step
            console.print(f"    → {step}", soft_wrap=True)
        if verdict.drift is not None:
            _show_drift(console, verdict.drift)
    for step in verdict.next_steps:
        console.print(f"→ {step}")


def _show_drift(console: Console, drift: Drift) -> None:
    """Print the drift of a simulation without feedback, joint by joint."""
    rows = [
        [joint, *(format_percent(share, 2) for share in joint_shares)]
        for joint, joint_shares in zip(drift.joint_names, drift.share.T.tolist(), strict=True)
    ]
    columns = ("joint", *(f"after {after:g} s" for after in drift.after))
    console.print(
        build_table(
            "Drift of an open-loop simulation under the measured torque, relative to the joint's travel", columns, rows
        )
    )


_LADDER_TITLE = "Ladder of models: error where joints move, and on all rows held out"


def show_ladder(console: Console, identification: Identification) -> None:
    """Print the models that led to one and their errors, and mark the best one."""
    models = list(identification.ladder())
    best = find_best_step(models)
    rows = []
    for index, model in enumerate(models):
        held_out = [
            "–" if errors is None else format_percent(errors.relative_total)
            for errors in (model.held_out_judged, model.held_out)
        ]
        fit = format_percent(model.fit_judged.relative_total)
        rows.append([str(index + 1), format_step(model), fit, *held_out, get_step_mark(best, index, len(models))])
    columns = ("model", "change", "fit", "held out", "all rows", "")
    console.print(build_table(_LADDER_TITLE, columns, rows, right_from=2))
    if (best_text := describe_best_step(best, len(models))) != "":
        console.print(f"  {best_text}")


def show_ladders(console: Console, first: tuple[str, Identification], second: tuple[str, Identification]) -> None:
    """Print two ladders side by side.

    Parameters
    ----------
    first, second : tuple of str and Identification
        The name of each ladder and its last model. Held-out errors are compared; errors of the fit where any model of
        the two has no held-out data.
    """
    ladders = [list(identification.ladder()) for _, identification in (first, second)]
    # An error of the fit beside a held-out one would flatter its model.
    held_out = all(model.held_out is not None for ladder in ladders for model in ladder)
    rows = []
    for index, pair in enumerate(zip_longest(*ladders)):
        errors = [None if model is None else _total_error(model, held_out) for model in pair]
        # Of two relative errors the difference in percentage points.
        gap = "" if errors[0] is None or errors[1] is None else f"{100 * (errors[0] - errors[1]):+.2f}"
        cells = [
            ("" if m is None else format_step(m), "" if e is None else format_percent(e))
            for m, e in zip(pair, errors, strict=True)
        ]
        rows.append([str(index + 1), *cells[0], *cells[1], gap])
    columns = ("model", first[0], "error", second[0], "error", "difference, points")
    console.print(
        build_table(
            f"Two ladders: error where joints move, {'held out' if held_out else 'fit'}", columns, rows, right_from=5
        )
    )


def format_step(model: Identification) -> str:
    """Return in words what the last step added to a model or took out of it."""
    if model.step.parent is None:
        return "first model"
    robot = model.model.robot
    added = [format_choice(choice, robot) for choice in model.step.added]
    return ", ".join(added + [f"without {format_choice(choice, robot)}" for choice in model.step.removed])


def _total_error(model: Identification, held_out: bool) -> float:
    judged = model.held_out_judged
    return (judged if held_out and judged is not None else model.fit_judged).relative_total


def show_series(console: Console, series: Series, robot: Robot) -> None:
    """Print what changed and when, and the values of changed parameters day by day; the file has all of them."""
    console.print(series.summary, style="bold")
    rows = [
        [format_first_day(series_change, series.days), *row]
        for series_change in series.changes
        for row in format_change(series_change.change, robot)
    ]
    if rows:
        console.print(build_table("Changes", ("from", *CHANGE_COLUMNS), rows, right_from=4))
    # An effect without joints is of the whole robot; its parameters have an empty joint.
    changed = {
        (series_change.change.choice.effect, joint)
        for series_change in series.changes
        for joint in series_change.change.choice.joints or ("",)
    }
    courses = [course for course in series.courses if (course.effect, course.joint) in changed]
    if courses:
        console.print(_build_courses_table(courses, series.days))
    for series_change in series.changes:
        _show_evidence(console, series_change.change)
    if series.missing:
        both = "; ".join(format_choice(choice, robot) for choice in series.missing)
        console.print(f"  Missing in the model on all days: {both}")


def format_first_day(change: SeriesChange, days: Sequence[str]) -> str:
    """Return the day from which something differs, with the days that the data cannot tell from it."""
    if change.earliest == change.latest:
        return days[change.since]
    return f"{days[change.since]} ({days[change.earliest]} to {days[change.latest]})"


def _build_courses_table(courses: Sequence[ParameterTrack], days: Sequence[str]) -> object:
    rows = []
    for k, day in enumerate(days):
        cells = [_format_course_value(course.values[k], course.intervals[k]) for course in courses]
        rows.append([day, *cells])
    names = [f"{course.parameter}, {course.unit}" for course in courses]
    return build_table("Day by day, ± half of the 95 % interval", ("day", *names), rows, right_from=1)


def _format_course_value(value: float, interval: np.ndarray) -> str:
    if not np.isfinite(value):
        return "not determined"
    return f"{format_number(float(value))} ± {format_number(float(interval[1] - value))}"
