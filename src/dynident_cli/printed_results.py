"""Print results: which tables, columns and sentences; the exit code of a stopped model (3)."""

from __future__ import annotations

import shlex
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console

from dynident.effects import EffectChoice, get_effect
from dynident.effects.effect_text_format import format_effect
from dynident.errors import word_notes, word_remedies
from dynident.identification import Identification
from dynident.identification.identified_models.correlated_and_essential_parameters import (
    EssentialPath,
    parameter_dependence,
)
from dynident.number_format import format_percent
from dynident.presentation.diagnosis_tables import (
    EVIDENCE,
    build_candidate_table,
    build_diagnosis_tables,
    build_limit_table,
    build_limits_by_joint_table,
    build_series_tables,
    describe_rivals,
)
from dynident.presentation.labels import (
    PARAMETER_JUDGEMENTS,
    describe_condition_number,
    format_choice,
    format_hidden_effects,
    format_joints,
    get_effect_title,
)
from dynident.presentation.ladder_tables import (
    build_ladder_table,
    build_two_ladders_table,
    describe_last_step,
    list_steps,
)
from dynident.presentation.model_tables import (
    GROUPING,
    RATIO,
    TIMES_SMALLEST,
    build_error_table,
    build_essential_tables,
    build_parameter_table,
    build_shape_table,
    build_worst_table,
    compare_by_joint,
    list_error_kinds,
)
from dynident.presentation.recording_tables import ShownRecording, build_recording_table, describe_findings
from dynident.presentation.tables import Cell, ReportedTable
from dynident.presentation.validation_and_verdict_tables import (
    VALIDATION_WORDS,
    build_figure_tables,
    build_verdict_tables,
)
from dynident.recordings.file_names_and_digests import make_unique_names
from dynident.recordings.joint_phases import Phase
from dynident.robot import Robot
from dynident_cli.command_output import print_tables, write_model
from dynident_cli.contract_documents import to_document
from dynident_cli.request_options import list_option_words, write_option
from dynident_cli.shared_options import Reading

if TYPE_CHECKING:
    from dynident.api.model import Model
    from dynident.api.recording_collection import Recordings
    from dynident.diagnosis import Comparison, Diagnosis, Judgement
    from dynident.diagnosis.diagnosis_result import Change
    from dynident.diagnosis.monitoring import Series
    from dynident.verdict import Action, ModelVerdict, State, Use
    from dynident_cli.shared_options import OutputOptions
    from dynident_service.validations.wire_types import ValidationResult

_TOO_WIDE = (GROUPING, TIMES_SMALLEST)
"""Columns of parameter tables that do not fit a terminal; files and reports have them."""

_MANY_JOINTS = 12
"""Of a robot with more joints, such as a humanoid, tables show those joints that are worst."""

_WORST_JOINTS = 8
_WORST_COMBINATIONS = 3
"""Combinations of parameters that hardly show; of so many joints, there are more than anybody reads here."""

EXIT_STOPPED = 3
"""The exit code of a model that is not to be used."""

_STYLES: Mapping[State, str] = {"yes": "green", "limited": "yellow", "no": "red", "not_judged": "yellow"}


def show_measurements(console: Console, measurements: Recordings, held_out: Recordings) -> None:
    """Print the recordings and all checks that are not ok."""
    uses = ((measurements, "identification"), (held_out, "held out"))
    shown = [ShownRecording(item.recording, item.checks, use) for group, use in uses for item in group]
    print_tables(console, [build_recording_table(shown).drop_columns("duration", "windows used", "payload")])
    for line in describe_findings(shown):
        console.print(f"  {line}")


def fold_joints(table: ReportedTable, worst_by: str, last: int = 0) -> ReportedTable:
    """Return a table of joints; of many joints those with the largest numbers in a column, and the `last` rows."""
    is_long = len(table.rows) - last > _MANY_JOINTS
    return table.fold_rows(worst_by, _WORST_JOINTS, last) if is_long else table


def show_identification(console: Console, identification: Identification, *, parameters: bool = True) -> None:
    """Print the errors per joint, the parameters, the shape constants, and the warnings of a model."""
    for reason in identification.preprocessing.reasons:
        console.print(f"  {reason}", style="dim")
    joints = identification.model.robot.joints
    names = [joint.name for joint in joints]
    errors = build_error_table(list_error_kinds(identification), names, [joint.effort_unit for joint in joints])
    worst_by = errors.columns[2 if identification.held_out is None else 5]
    print_tables(console, [fold_joints(errors, worst_by, last=1).drop_columns(RATIO)])
    # After an extension most parameters are those of the model before, and are not printed again.
    if parameters:
        if len(joints) > _MANY_JOINTS:
            print_tables(console, [_count_parameters(identification)])
            console.print("  A report (dynident report MODEL RUN) and --json list all joints and parameters.")
        else:
            base_table = build_parameter_table("Base parameters", identification.parameters)
            print_tables(console, [base_table.drop_columns(*_TOO_WIDE)])
        sentences = parameter_dependence(identification).sentences
        most = _WORST_COMBINATIONS if len(joints) > _MANY_JOINTS else len(sentences)
        for sentence in sentences[:most]:
            console.print(f"  {sentence}")
        console.print(
            f"Scaled condition number of W: {describe_condition_number(identification)}; "
            f"{identification.equations_per_parameter:.0f} equations per parameter"
        )
    if identification.shape_constants:
        print_tables(console, [build_shape_table(identification.shape_constants, names)])
        for constant in identification.shape_constants:
            # The note of a choice among kinds explains nothing that is odd.
            if constant.note and constant.judgement != "chosen":
                place = format_joints(constant.joints, names)
                console.print(f"  {constant.name} of {constant.effect} on {place}: {constant.note}.")
    for warning in identification.warnings:
        console.print(f"! {warning}", style="yellow")


def _count_parameters(identification: Identification) -> ReportedTable:
    """Return how many parameters of each effect are determined: a humanoid has too many of them to list."""
    counts: dict[str, Counter[str]] = {}
    for parameter in identification.parameters:
        if parameter.essential:
            counts.setdefault(get_effect_title(parameter.effect), Counter())[parameter.judgement] += 1
    counts["all"] = sum(counts.values(), Counter())
    judgements = [kind for kind in PARAMETER_JUDGEMENTS if counts["all"][kind]]
    rows = tuple(
        (Cell(name), *(Cell(str(count), count) for count in (*(own[kind] for kind in judgements), own.total())))
        for name, own in counts.items()
    )
    heads = ("effect", *(PARAMETER_JUDGEMENTS[kind].words for kind in judgements), "parameters")
    return ReportedTable("Base parameters", heads, rows)


def show_essential(console: Console, path: EssentialPath) -> None:
    """Print the steps of the backward elimination and the essential parameters."""
    print_tables(console, (reported_table.drop_columns(*_TOO_WIDE) for reported_table in build_essential_tables(path)))
    console.print(path.reason)


def show_comparison(console: Console, name: str, comparison: Comparison, judgement: Judgement) -> None:
    """Print the errors per joint, their ratio to the noise floor, and the intervals with the largest residuals."""
    print_tables(console, [fold_joints(compare_by_joint(name, comparison, judgement), "moving", last=1)])
    if (comparison.phase == Phase.STANDING).any():
        console.print(
            "  While a joint stands still, static friction may balance the torque. Compared with the predicted torque "
            f"itself, the error on all rows is {format_percent(comparison.raw_errors.relative_total)}."
        )
    print_tables(console, [build_worst_table(comparison.worst[:5], comparison.joint_names, comparison.units)])
    for note in judgement.notes:
        console.print(f"  {note}")


def show_diagnosis(
    console: Console,
    diagnosis: Diagnosis,
    robot: Robot,
    extend_command: str,
    questions: Sequence[tuple[str, str]] = (),
    n_open: int = 0,
    each_limit: bool = False,
) -> None:
    """Print a diagnosis, and the command that adds what it recommends.

    `questions` are effects and joints for which the reason is printed, with "" for the best place; `n_open` is the
    number of open questions for which no experiment was looked for; `each_limit` prints detection limits joint by
    joint.
    """
    from dynident.advice import AdvisedDiagnosis
    from dynident.diagnosis.diagnosis_summary import group_patterns

    console.print(diagnosis.summary, style="bold")
    candidates = build_candidate_table(diagnosis.candidates, robot.joint_names)
    print_tables(console, [candidates.drop_columns(*EVIDENCE)])
    for item in diagnosis.candidates:
        if item.significant:
            console.print(f"  {item.rank}. {item.evidence}")
    _print_how_to_answer(console, diagnosis)
    for effect, joint in questions:
        place = f" on {joint}" if joint else ""
        console.print(f"  {get_effect_title(effect)}{place}: {diagnosis.why_not(effect, joint)}")
    if diagnosis.detection_limits:
        own = build_limits_by_joint_table(diagnosis) if each_limit else build_limit_table(diagnosis, robot.joint_names)
        print_tables(console, [own])
    elif diagnosis.not_visible:
        console.print(f"  These data could not show at its usual size: {format_hidden_effects(diagnosis, robot)}")
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


def _print_how_to_answer(console: Console, diagnosis: Diagnosis) -> None:
    """Print the options that answer whether the robot has the parts that recommended effects are of."""
    effects = [get_effect(choice.effect) for choice in diagnosis.recommended if diagnosis.find_question(choice)]
    for part in dict.fromkeys(effect.hardware for effect in effects):
        console.print(f"  Answer once whether the robot has it: --has {part} or --has-not {part}.")


def show_changes(console: Console, diagnosis: Diagnosis, robot: Robot) -> None:
    """Print what differs from the baseline, and what the model lacks before and after."""
    console.print(diagnosis.summary, style="bold")
    units = [joint.effort_unit for joint in robot.joints]
    tables = {table.name: table for table in build_diagnosis_tables(diagnosis, robot.joint_names, units)}
    if "changes" in tables:
        print_tables(console, [tables["changes"].drop_columns(EVIDENCE[-1])])
    _show_evidence(console, diagnosis.changes or ())
    if "friction" in tables:
        print_tables(console, [fold_joints(tables["friction"], "relative to before")])
    if diagnosis.recommended:
        both = "; ".join(format_choice(choice, robot.joint_names) for choice in diagnosis.recommended)
        console.print(f"  Missing in the model before and after: {both}")
    if diagnosis.not_visible:
        console.print(f"  These motions could not show: {format_hidden_effects(diagnosis, robot)}")


def _show_evidence(console: Console, changes: Sequence[Change]) -> None:
    for change in changes:
        console.print(f"  {change.evidence}{describe_rivals(change.equivalent)}")


COMMANDS_OF_NEXT_STEPS: Mapping[Action | None, str] = {
    "diagnose": "dynident diagnose MODEL RUN",
    "design": "dynident design ROBOT",
    "identify_feasible": "dynident identify … --effects EFFECTS --estimator feasible",
    "check_gains": "dynident validate MODEL payload LOADED --unloaded RUN --mass KG",
    "identify_gains": "dynident gains",
    "export_for_simulation": "dynident export MODEL -f urdf, or -f mjcf",
    "export_for_feed_forward": "dynident export MODEL -f c, or -f casadi",
    "observe_momentum": "dynident validate MODEL collision RUN",
    "weigh_load": "dynident validate MODEL payload LOADED --unloaded RUN",
}
"""The command of each next step of a verdict; EFFECTS are those of the model."""


def show_verdict(console: Console, verdict: ModelVerdict, effects: Sequence[EffectChoice]) -> None:
    """Print for which uses a model with these effects is fit, why or why not, and what to do next."""
    # After a gross fault the uses mean nothing.
    if verdict.stop is not None:
        console.print(f"✕ {word_remedies(verdict.summary, verdict.stop.remedies, write_option)}", style="bold red")
    else:
        # What several uses lack alike is said once.
        alike: dict[tuple[str, str], list[Use]] = {}
        for use in verdict.uses:
            alike.setdefault((use.reason, use.next_step), []).append(use)
        for use, *others in alike.values():
            words = ", ".join([use.words, *(other.words for other in others)])
            (reason,) = word_notes([use.reason], write_option)
            console.print(f"{use.mark} {words}: {reason}", style=_STYLES[use.state])
            command = COMMANDS_OF_NEXT_STEPS.get(use.next_action, "")
            command = command.replace("EFFECTS", shlex.quote(",".join(map(format_effect, effects))))
            step = f"{use.next_step.removesuffix('.')}: {command}" if command else use.next_step
            console.print(f"    → {step}", soft_wrap=True)
        drift = (table for table in build_verdict_tables(verdict) if table.name == "drift")
        print_tables(console, (fold_joints(table, table.columns[1]) for table in drift))
    for step in verdict.next_steps:
        console.print(f"→ {step}")


def show_next_command(
    console: Console, what: str, words: Sequence[object], files: Sequence[Path], reading: Reading
) -> None:
    """Print the command that follows on these files, read as they were here; none where options name others."""
    options = {option.name: getattr(reading, option.name) for option in fields(Reading)}
    names = make_unique_names(files)
    if names != [name for path in files for name in make_unique_names([path])] and any(
        "=" in text for text in (*reading.windows, *reading.metadata)
    ):
        return
    options["metadata"] = [text for text in reading.metadata if "=" not in text or text.partition("=")[0] in names]
    command = shlex.join(["dynident", *map(str, words), *list_option_words(Reading(**options))])
    console.print(f"Next, {what}: {command}", style="bold", soft_wrap=True)


def show_ladder(console: Console, identification: Identification, parent: Identification | None = None) -> None:
    """Print the models that led to one, mark the best one, and say what was done since its parent."""
    steps, joints = list_steps(identification), identification.model.robot.joint_names
    table = build_ladder_table(steps, joints)
    print_tables(console, [table])
    for sentence in table.notes:
        console.print(f"  {sentence}")
    if len(steps) > 1:
        first = next((k for k, model in enumerate(identification.ladder()) if model is parent), None)
        console.print(f"  {describe_last_step(steps, joints, first).text}")


def show_ladders(console: Console, first: tuple[str, Identification], second: tuple[str, Identification]) -> None:
    """Print two ladders side by side, each given by its name and its last model."""
    joints = first[1].model.robot.joint_names
    names = (first[0], second[0])
    table = build_two_ladders_table(names, (list_steps(first[1]), list_steps(second[1])), joints)
    print_tables(console, [table.drop_columns(*joints)])


def show_series(console: Console, series: Series, robot: Robot) -> None:
    """Print what changed and when, and the values of changed parameters day by day; the file has all of them."""
    console.print(series.summary, style="bold")
    tables = build_series_tables(series, robot.joint_names)
    print_tables(console, (table.drop_columns(EVIDENCE[-1]) for table in tables))
    _show_evidence(console, [series_change.change for series_change in series.changes])
    if series.missing:
        both = "; ".join(format_choice(choice, robot.joint_names) for choice in series.missing)
        console.print(f"  Missing in the model on all days: {both}")


_DISPENSABLE = ("farthest", "time")
"""Columns of the table of methods that are left out where it is still too wide."""

_VERDICT_STYLES = {"pass": "bold green", "fail": "bold red", "not_evaluated": "bold"}


def show_validation(console: Console, result: ValidationResult, robot: Robot) -> None:
    """Print the tables of a validation, its verdict, and the reason."""
    names = robot.joint_names
    by_number = {name: str(number) for number, name in enumerate(names, start=1)}
    for reported_table in build_figure_tables(to_document(result), names):
        # Where the terminal is too narrow for the joints' names as columns, their numbers stand there.
        short = by_number if _table_width(reported_table) > console.width else {}
        # Only names of joints are shortened; other heads stay as they are.
        columns = tuple(short.get(column, column) for column in reported_table.columns)
        table = replace(reported_table, columns=columns)
        # Where that is still too wide, columns go: figures are never wrapped, and names would be letter by letter.
        numbers = tuple(short.values()) if "all joints" in columns else ()
        drops = ((), _DISPENSABLE, numbers, (*numbers, *_DISPENSABLE))
        narrow = next((drop for drop in drops if _table_width(table.drop_columns(*drop)) <= console.width), drops[-1])
        print_tables(console, [table.drop_columns(*narrow)])
        if columns != reported_table.columns and "1" not in narrow:
            console.print(f"  Joints: {', '.join(f'{by_number[name]} {name}' for name in names)}.")
        lost = [column for column in columns if column in narrow and column not in numbers]
        lost += ["the errors of each joint"] if "1" in narrow else []
        if lost:
            console.print(f"  Too wide for this terminal: {', '.join(lost)}. --json and reports have them.")
    console.print(VALIDATION_WORDS[result.verdict].words, style=_VERDICT_STYLES[result.verdict])
    console.print(result.reason)


def _table_width(reported_table: ReportedTable) -> int:
    """Return the width of a table in characters, with nothing wrapped."""
    lines = [reported_table.columns, *reported_table.texts]
    return sum(max(len(line[k]) for line in lines) + 2 for k in range(len(reported_table.columns)))


def write_extended_model(
    result: OutputOptions,
    model: Model,
    parent_id: str,
    parent: Model,
    verdict: ModelVerdict | None = None,
    show_next: Callable[[Console], None] = lambda _: None,
) -> None:
    """Write a model that was made from another one, and print it with the verdict on it where there is one."""

    def show_model(console: Console) -> None:
        show_ladder(console, model.identification, parent.identification)
        show_identification(console, model.identification, parameters=False)
        if verdict is not None:
            show_verdict(console, verdict, model.effects)
            show_next(console)

    write_model(result, "model", model, show_model, (parent_id, parent), verdict)
