"""`dynident demo` from beginning to end: design, record, identify, diagnose, and what it prints."""

from __future__ import annotations

import json
import shlex
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from rich.console import Console

import dynident as dy
from dynident.advice import AdvisedDiagnosis
from dynident.api.model import Model
from dynident.api.model_report import Report
from dynident.api.motion_design import DesignedMotion
from dynident.array_types import FloatArray
from dynident.diagnosis import Comparison
from dynident.effects import get_effect
from dynident.effects.usual_effect_sizes import get_largest_torque
from dynident.errors import DynidentError
from dynident.excitation import Design, DesignRequest, design_experiment
from dynident.file_output import write_atomically
from dynident.identification import Identification
from dynident.number_format import format_number, format_percent
from dynident.presentation.diagnosis_tables import EVIDENCE, build_candidate_table, describe_rivals
from dynident.presentation.ladder_tables import build_ladder_joint_table, build_ladder_table, list_steps
from dynident.progress import Progress, scale_progress
from dynident.recordings.arrow_tables import write_table
from dynident.robot import Robot
from dynident.simulation import Reference, Sensors, VirtualRobot, build_recording_table
from dynident_cli.command_output import build_table, print_tables, show_progress_bar
from dynident_cli.demo.scenario import Scenario


@dataclass(frozen=True, eq=False)
class Analysis:
    """The results of all steps; the model has everything that the diagnosis recommends."""

    comparison: Comparison
    diagnosis: AdvisedDiagnosis
    model: Model
    report: Report

    @property
    def ladder(self) -> tuple[Identification, ...]:
        """The models from the first to the last."""
        return tuple(self.model.identification.ladder())

    @property
    def first(self) -> Identification:
        """The model before anything was added."""
        return self.ladder[0]

    @property
    def last(self) -> Identification:
        """The model with everything that was added."""
        return self.model.identification

    def compute_floor_ratio(self, model: Identification) -> FloatArray:
        """Return the held-out residual of a model over the noise floor, joint by joint, where joints move.

        Shape (n,); 1 is the best that a model can reach.
        """
        moving = model.held_out_moving
        assert moving is not None
        return moving.rms / self.diagnosis.noise_floor


def analyse_recordings(
    robot: Robot,
    training: Sequence[Path],
    held_out: Sequence[Path],
    design: Design,
    progress: Progress,
) -> Analysis:
    """Identify, compare, diagnose, add the recommended effects one by one, and write the report.

    `design` is of the first recording, for the report.
    """
    runs = dy.read_recordings(*training, *held_out, robot=robot, progress=scale_progress(progress, 0.0, 0.1))
    recordings, validation = runs[: len(training)], runs[len(training) :]
    # As any user would, with the usual effects and without a choice.
    model = dy.identify(robot, recordings, validation=validation, progress=scale_progress(progress, 0.1, 0.2))
    comparison = dy.compare(model, validation[:1])[0].comparison
    diagnosis = dy.diagnose(model, progress=scale_progress(progress, 0.2, 0.7))
    for index, choice in enumerate(diagnosis.recommended):
        progress(0.7 + 0.15 * index / len(diagnosis.recommended), f"adding {choice.effect}")
        model = model.extend(choice)
    progress(0.85, "writing the report")
    report = dy.report(
        model,
        diagnosis=diagnosis,
        design=DesignedMotion(robot, design),
        title=f"Demonstration: {robot.name}",
        progress=scale_progress(progress, 0.85, 1.0),
    )
    return Analysis(comparison, diagnosis.advised_diagnosis, model, report)


# Random motions from point to point, the best of which is taken: each takes a second to find.
_FEW_RANDOM_TRAJECTORIES = 4


@dataclass(frozen=True, eq=False)
class MeasuredRun:
    """One recording as a user has it: the file, and the design of its motion."""

    path: Path
    design: Design
    n_samples: int


def design_runs(scenario: Scenario, progress: Progress) -> list[Design]:
    """Design a trajectory for every course of the plan."""
    courses = scenario.plan.courses
    designs = []
    for index, course in enumerate(courses):
        request = DesignRequest(
            kind=course.kind,
            trajectory=course.trajectory,
            random_trajectories=_FEW_RANDOM_TRAJECTORIES if course.points else DesignRequest.random_trajectories,
            limits=scenario.compute_limits(course),
            # A number of starts, not seconds: the same seed then gives the same trajectory on any machine.
            starts=course.starts,
            noise=_compute_torque_noise(scenario),
            # Every course of every scenario has a seed of its own.
            seed=len(courses) * scenario.seed + index,
        )
        share = scale_progress(progress, index / len(courses), (index + 1) / len(courses))
        designs.append(design_experiment(scenario.robot, request, share))
    return designs


def _compute_torque_noise(scenario: Scenario) -> dict[str, float]:
    """Return the standard deviation of each joint's torque sensor, as the robot's data sheet would state it."""
    sensors = Sensors(sampling_rate=scenario.plan.rate)
    names = scenario.robot.joint_names
    return {name: sensors.torque_noise * get_largest_torque(scenario.robot, j) for j, name in enumerate(names)}


def record_runs(scenario: Scenario, designs: Sequence[Design], folder: Path, progress: Progress) -> list[MeasuredRun]:
    """Let the virtual robot follow the trajectories, and write what its sensors record."""
    virtual = VirtualRobot(scenario.robot, scenario.effects, inertias=scenario.inertias)
    sensors = Sensors(sampling_rate=scenario.plan.rate)
    total = sum(design.duration for design in designs)
    runs, done = [], 0.0
    for index, (course, design) in enumerate(zip(scenario.plan.courses, designs, strict=True)):
        share = scale_progress(progress, done / total, (done + design.duration) / total)
        # The noise of every run of every scenario is another one.
        seed = len(designs) * scenario.seed + index
        # Effects that drift depend on the time of the session, in which the runs follow each other.
        begins = scenario.start_time(course)
        reference = to_reference(design, begins)
        if scenario.warms_up:
            temperature = scenario.compute_temperature(reference.t)
            reference = replace(reference, temperature=np.repeat(temperature[:, None], scenario.robot.n, axis=1))
        recording = virtual.measure(reference, sensors, run=course.name, seed=seed, progress=share)
        DesignedMotion(scenario.robot, design).save(folder / f"trajectory_{course.name}.csv")
        write_table(build_recording_table(recording), folder / f"{course.name}.csv")
        runs.append(MeasuredRun(folder / f"{course.name}.csv", design, recording.n_samples))
        done += design.duration
    return runs


def write_hidden_effect(scenario: Scenario, path: Path) -> None:
    """Write what was hidden to a file that is not read before the end."""
    hidden = None if scenario.hidden is None else asdict(scenario.hidden)
    write_atomically(path, json.dumps({"hidden": hidden, "seed": scenario.seed}, indent=1).encode())


def to_reference(design: Design, begins: float = 0.0) -> Reference:
    """Return the motion of a design as the robot's controller takes it.

    `begins` is the time of the session at which it starts, s.
    """
    return Reference(design.t + begins, design.q, design.dq, design.ddq)


_SHOWN_CANDIDATES = 5
# A residual below this multiple of the noise floor cannot be told from noise.
_VISIBLE_RATIO = 1.15


def print_introduction(console: Console, scenario: Scenario) -> None:
    """Print what will happen."""
    robot = scenario.robot
    _print_heading(console, "The robot")
    console.print(
        f"A virtual {robot.name} with {robot.n} joints. Its links are up to 10 % lighter or heavier than its "
        "description says, its friction and rotor inertias are random"
        + (", and one more effect is hidden in it." if scenario.hidden is not None else "."),
    )
    console.print(
        "The hidden effect is written to hidden.json and is not read again before the end: identification and "
        "diagnosis use only the description and the recorded files.",
    )


def print_experiment(console: Console, runs: Sequence[MeasuredRun], seconds: float) -> None:
    """Print trajectories and recordings."""
    _print_heading(console, "Design and measurement")
    rows = []
    for run in runs:
        values, baseline = run.design.criterion_values, run.design.baseline
        best = format_number(baseline.best.condition_number) if baseline is not None else "–"
        kind = "optimised" if run.design.request.kind == "optimized" else "from point to point"
        rows.append([run.path.name, kind, f"{run.design.duration:.0f} s", str(run.n_samples),
                     format_number(values.condition_number), best])  # fmt: skip
    columns = ("recording", "trajectory", "length", "samples", "condition number", "best random motion")
    console.print(build_table("", columns, rows, right_from=2))
    console.print(
        f"Encoders of 2^19 counts, torque noise of 0.5 % of each joint's limit; {seconds:.1f} s to design and "
        "measure. run2.csv is slow. validation.csv, which no fit uses, moves from point to point and stops at "
        "each. The whole of every recording is used, including standstill.",
    )


def print_findings(console: Console, robot: Robot, analysis: Analysis) -> None:
    """Print the results of identification, comparison and diagnosis."""
    first = analysis.first
    _print_heading(console, "Identify")
    held_out = first.held_out_judged
    assert held_out is not None
    console.print(
        f"{first.model.n_parameters} base parameters: links, rotor inertia, Coulomb and viscous friction. Error where "
        f"joints move: {format_percent(first.fit_judged.relative_total)} in the fit, "
        f"{format_percent(held_out.relative_total)} held out.",
    )
    _print_heading(console, "Compare")
    over = analysis.compute_floor_ratio(first)
    worst = int(over.argmax())
    console.print(
        f"On held-out data {robot.joint_names[worst]} is worst: its residual is {over[worst]:.1f} times the noise "
        "of the torque sensor.",
    )
    spot = next(
        (failure for failure in analysis.diagnosis.failure_map if failure.joint == robot.joint_names[worst]), None
    )
    if spot is not None:
        console.print(
            f"The residual is largest over {spot.variable}, between {format_number(spot.low)} and "
            f"{format_number(spot.high)} {spot.unit}: {spot.ratio:.1f} times the joint's rms.",
        )
    _print_heading(console, "Diagnose")
    _print_candidates(console, robot, analysis)
    _print_heading(console, "Add the effects; the error falls")
    _print_ladder(console, robot, analysis)


def print_hidden_effect(
    console: Console, scenario: Scenario, analysis: Analysis, named_right: bool, joints: Sequence[int]
) -> None:
    """Print what was hidden beside what was named."""
    _print_heading(console, "What was hidden")
    hidden = scenario.hidden
    if hidden is None:
        answer = "and nothing was found" if named_right else "but something was found: a false alarm"
        console.print(f"Nothing was hidden, {answer}.", style="bold")
        return
    where = f" on {hidden.joint}" if hidden.joint else ""
    console.print(f"Hidden: {get_effect(hidden.effect).title}{where}.", style="bold")
    console.print(
        "It was named." if named_right else "It was not named.",
        style="bold green" if named_right else "bold red",
    )
    truth = dict(hidden.values)
    rows = [
        [
            column.name,
            column.unit,
            format_number(truth[column.parameter], 4),
            format_number(value, 4),
            format_number(deviation, 2),
        ]
        for column, value, deviation in zip(
            analysis.last.model.kept, analysis.last.values, analysis.last.statistics.standard_deviations, strict=True
        )
        if column.effect == hidden.effect and column.link in (hidden.joint, "") and column.parameter in truth
    ]
    for choice in analysis.diagnosis.recommended:
        if choice.effect == hidden.effect and (not hidden.joint or hidden.joint in choice.joints):
            true_shape = get_effect(hidden.effect).shape_with_defaults(dict(hidden.shape))
            specs = {spec.name: spec for spec in get_effect(choice.effect).shapes}
            rows += [
                [
                    name,
                    specs[name].unit,
                    *(
                        specs[name].get_word(constant) or format_number(constant, 4)
                        for constant in (true_shape[name], value)
                    ),
                    "",
                ]
                for name, value in choice.shape
            ]
    if named_right and rows:
        columns = ("parameter", "unit", "true", "identified", "standard deviation")
        console.print(build_table("", columns, rows, right_from=2))
    # Where the first model already reaches the noise, nothing was visible: that is no failure of the diagnosis.
    before = max(float(analysis.compute_floor_ratio(analysis.first)[j]) for j in joints)
    if not named_right and before < _VISIBLE_RATIO:
        console.print("On these motions its torque is below the sensors' noise, so no diagnosis could find it.")
    after = max(float(analysis.compute_floor_ratio(analysis.last)[j]) for j in joints)
    console.print(f"Held-out residual there: {before:.2f} times the noise floor before, {after:.2f} times after.")


def print_files(console: Console, robot: Robot, runs: Sequence[MeasuredRun], folder: Path, seconds: float) -> None:
    """Print where the files are, and how to repeat the analysis by hand."""
    _print_heading(console, "Files")
    console.print(f"{folder}/report.html shows all of this with figures; model.npz is the last model.")
    data = [*(str(run.path) for run in runs[:-1]), "-v", str(runs[-1].path)]
    console.print("The same by hand, from the files only:")
    diagnosed = ["--diagnosis", "my_diagnosis.json"]
    for words in (
        ["identify", robot.name, *data, "-o", "my_model.npz"],
        ["diagnose", "my_model.npz", *data, "-o", "my_diagnosis.json"],
        ["extend", "my_model.npz", *data, *diagnosed, "-o", "my_better.npz"],
        ["report", "my_better.npz", *data, *diagnosed, "-o", "my_report.html"],
    ):
        console.print(f"  {shlex.join(['dynident', *words])}", soft_wrap=True, style="cyan", markup=False)
    console.print(f"Everything took {seconds:.1f} s.")


def _print_candidates(console: Console, robot: Robot, analysis: Analysis) -> None:
    candidates = build_candidate_table(analysis.diagnosis.candidates[:_SHOWN_CANDIDATES], robot.joint_names)
    print_tables(console, [candidates.drop_columns(*EVIDENCE)])
    console.print(analysis.diagnosis.summary, style="bold")
    for item in analysis.diagnosis.candidates:
        if item.significant and item.equivalent:
            console.print(f"{item.title}:{describe_rivals(item.equivalent)}")


def _print_ladder(console: Console, robot: Robot, analysis: Analysis) -> None:
    steps = list_steps(analysis.last)
    print_tables(
        console, [build_ladder_table(steps, robot.joint_names), build_ladder_joint_table(steps, robot.joint_names)]
    )


def _print_heading(console: Console, text: str) -> None:
    console.print()
    console.print(text, style="bold underline")


@dataclass(frozen=True, eq=False)
class Outcome:
    """The scenario, the results of the analysis, and the time that it all took (s)."""

    scenario: Scenario
    analysis: Analysis
    folder: Path
    seconds: float

    @property
    def is_named_correctly(self) -> bool:
        """True where the diagnosis recommends the hidden effect on its joint, or nothing where nothing was hidden."""
        hidden = self.scenario.hidden
        recommended = self.analysis.diagnosis.recommended
        if hidden is None:
            return not recommended
        # Some effects are the same function under two names. No data can tell these apart.
        names = {hidden.effect, *get_effect(hidden.effect).same_function}
        return any(
            choice.effect in names and (not hidden.joint or hidden.joint in choice.joints) for choice in recommended
        )

    @property
    def joints(self) -> tuple[int, ...]:
        """Indices of the joints that the hidden effect acts on; all joints where it belongs to the robot."""
        names = self.scenario.robot.joint_names
        hidden = self.scenario.hidden
        return (names.index(hidden.joint),) if hidden is not None and hidden.joint else tuple(range(len(names)))

    def to_document(self) -> dict[str, object]:
        """Return the outcome as a JSON document."""
        analysis, hidden = self.analysis, self.scenario.hidden
        return {
            "robot": self.scenario.robot.name,
            "joints": list(self.scenario.robot.joint_names),
            "seed": self.scenario.seed,
            "hidden": None
            if hidden is None
            else {**asdict(hidden), "values": dict(hidden.values), "shape": dict(hidden.shape)},
            "verdict": analysis.diagnosis.verdict,
            "named": [
                {"effect": choice.effect, "joints": list(choice.joints)} for choice in analysis.diagnosis.recommended
            ],
            "named_right": self.is_named_correctly,
            "noise_floor": analysis.diagnosis.noise_floor.tolist(),
            "ladder": [
                {
                    "added": [{"effect": choice.effect, "joints": list(choice.joints)} for choice in model.step.added],
                    "fit": model.fit.relative_total,
                    "held_out": model.held_out.relative_total if model.held_out is not None else None,
                    "held_out_over_noise_floor": analysis.compute_floor_ratio(model).tolist(),
                }
                for model in analysis.ladder
            ],
            "hidden_joints": list(self.joints),
            "folder": str(self.folder),
            "seconds": self.seconds,
        }


def run_demonstration(scenario: Scenario, folder: Path, console: Console) -> Outcome:
    """Run the demonstration, report on it as it goes, and write its files."""
    _make_folder(folder)
    begun = time.monotonic()
    print_introduction(console, scenario)
    with show_progress_bar("design and measure") as progress:
        designs = design_runs(scenario, scale_progress(progress, 0.0, 0.5))
        # Written before anything is analysed: nobody can say later that it was made to fit.
        write_hidden_effect(scenario, folder / "hidden.json")
        runs = record_runs(scenario, designs, folder, scale_progress(progress, 0.5, 1.0))
    print_experiment(console, runs, time.monotonic() - begun)
    analysis = _analyse_files(scenario, runs)
    analysis.model.ladder[0].save(folder / "first_model.npz")
    analysis.model.save(folder / "model.npz")
    analysis.report.save(folder / "report.html")
    outcome = Outcome(scenario, analysis, folder, time.monotonic() - begun)
    print_findings(console, scenario.robot, analysis)
    print_hidden_effect(console, scenario, analysis, outcome.is_named_correctly, outcome.joints)
    print_files(console, scenario.robot, runs, folder, outcome.seconds)
    return outcome


def _analyse_files(scenario: Scenario, runs: list[MeasuredRun]) -> Analysis:
    """Analyse the files with nothing but the robot's description: what is hidden is not passed on."""
    # The last run is the validation: no parameter sees it.
    training, held_out = [run.path for run in runs[:-1]], [runs[-1].path]
    with show_progress_bar("identify and diagnose") as progress:
        return analyse_recordings(scenario.robot, training, held_out, runs[0].design, progress)


def _make_folder(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise DynidentError(f"cannot make the folder {folder}: {error.strerror}", pointer="--out") from error
