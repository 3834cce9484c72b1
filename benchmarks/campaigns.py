"""Campaigns on virtual arms: robot time until the true error is at the goal, promises, decisions, hidden effects.

    python benchmarks/campaigns.py [--arms scara,xarm7] [--seeds 4] [--goal 0.02] [--hidden] [--mujoco] [--rivals]
    python benchmarks/campaigns.py --load 0.02 [--arms scara,ur10] [--seeds 4]

Each campaign has links of its own (10 % off the description) and friction of usual size. The true error is that of the
identified model's torque over the region of the goal, against the arm's own torque.

With --rivals, three others make four runs each: one design for the predicted torque, random motions, and one design by
the condition number. Their runs have the whole length, as of people who do not know how long a run has to be, and once
more the campaign's shortest one. They know the effects of the campaign's last model, and need no slow first run; when
they are at the goal, only the truth tells.

With --hidden, the same arm also makes a fixed programme of four runs (designs by the condition number, at full speed),
which are diagnosed together afterwards: whether that names the hidden effect, and in how many minutes. A campaign ends
at its goal: those whose model is at the goal without the effect are counted apart.

With --mujoco, another engine moves the arm, with joints that stick, and says its true torque: nothing of the program
under test but the description is in it. With --load, the goal is a load's mass to within so many kg, and its centre to
within a tenth as many m; the load is the usual one of each arm.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from dataclasses import dataclass, field, replace
from pathlib import Path

import common  # noqa: F401  (pins the threads of linear algebra before numpy is imported)
import engine
import mujoco
import numpy as np
from engine.scene import Scene, dof_of

import dynident as dy
from dynident.advice.campaign import add_run, plan_run, start_campaign
from dynident.advice.campaign_request import DESIGN_STARTS, CampaignRequest, Decision, list_designs
from dynident.advice.payload_goal import select_payload_errors
from dynident.diagnosis import diagnose
from dynident.effects import LINKS, ReferenceParameters, Signals, build_columns
from dynident.excitation import CriterionChoice, DesignRequest, TrajectoryRequest, design_experiment
from dynident.identification import identify
from dynident.number_format import format_percent
from dynident.regressors.observation_matrix import Observation
from dynident.robot.robot_model import INERTIAL_NAMES
from dynident.simulation.reference_motion import Reference
from dynident.simulation.simulated_recording import write_simulated_recording
from dynident.simulation.simulation_from_request import SimulationRequest, simulate
from dynident.simulation.true_effects import build_typical_effect, list_drive_effects
from dynident.text_and_html_tables import format_text_table

LINK_SPREAD = 0.1
PROGRAMME_RUNS = 4
RIVALS = ("one design", "random", "condition number")
RIVAL_RUNS = 4
HIDDEN = ("stribeck", "torque_ripple", "joint_spring", "coulomb_asymmetric", "load_dependent_friction", "presliding")
# Beside Coulomb friction, both are the same torque.
EQUALS = {"coulomb_asymmetric": "offset"}


class VirtualArm:
    """An arm with links and effects of its own, which follows designs and knows its true torque."""

    def __init__(self, name: str, seed: int, hidden: str = "") -> None:
        self.robot, self.seed = dy.load_robot(name), seed
        rng = np.random.default_rng([seed, len(name)])
        n_links = len(self.robot.inertias)
        self.inertias = self.robot.inertias * (1 + LINK_SPREAD * rng.standard_normal((n_links, 1)))
        self.effects = list_drive_effects(self.robot)
        self.hidden = None
        if hidden:
            joint = self.robot.joint_names[int(rng.integers(self.robot.n))]
            self.hidden = build_typical_effect(self.robot, hidden, joint)
            self.effects = (*self.effects, self.hidden)
        self.folder = tempfile.TemporaryDirectory()

    def record(self, design, number: int, *more):
        reference = Reference(design.t, design.q, design.dq, design.ddq)
        request = SimulationRequest(reference, (*self.effects, *more), self.inertias, seed=1000 * self.seed + number)
        path = Path(self.folder.name) / f"run{number}.csv"
        write_simulated_recording(simulate(self.robot, request), path)
        return dy.read_recordings(path, robot=self.robot).recordings[0]

    def compute_torque(self, region):
        signals = Signals(self.robot)
        columns = build_columns([effect.choice for effect in self.effects], signals)
        observation = Observation.from_columns(self.robot, columns, signals)
        memory = np.ones((len(region.q), observation.n_memory))
        for k, item in enumerate(observation.memory):
            memory[:, k] = np.sign(region.dq[:, item.joint])
        reference = ReferenceParameters.from_links(self.inertias, self.robot.n)
        entries = observation.evaluate(region.q, region.dq, region.ddq, reference=reference, memory=memory)
        values = [
            next(dict(effect.values)[column.parameter] for effect in self.effects
                 if effect.choice.effect == column.effect and column.link in (*effect.choice.joints, ""))
            for column in columns
        ]  # fmt: skip
        links = build_columns([LINKS], signals)
        rows = Observation.from_columns(self.robot, links, signals)
        weights = [
            self.inertias[self.robot.tree.joint_names.index(c.link), INERTIAL_NAMES.index(c.parameter)] for c in links
        ]
        at = rows.evaluate(region.q, region.dq, region.ddq, reference=reference, memory=np.zeros((len(region.q), 0)))
        return observation.compute_torque(entries, np.array(values)) + rows.compute_torque(at, np.array(weights))

    def compute_true_error(self, identification, region):
        """Return the true relative error (n,) of a model over a region."""
        from dynident.advice.prediction_error import evaluate_rows

        truth = self.compute_torque(region)
        torque = evaluate_rows(identification, region.q, region.dq, region.ddq) @ identification.values
        return np.sqrt(((torque - truth) ** 2).mean(axis=0) / (truth**2).mean(axis=0))


class MujocoArm(VirtualArm):
    """The same arm in another engine, under its joint controllers; friction sticks where a joint reverses."""

    def __init__(self, name: str, seed: int, hidden: str = "") -> None:
        super().__init__(name, seed)
        self.arm = engine.Arm(replace(self.robot, inertias=self.inertias), engine.usual_drives(self.robot))

    def record(self, design, number: int):
        from scipy.interpolate import CubicHermiteSpline

        t = np.arange(0.0, design.t[-1], self.arm.step)
        q, dq = (CubicHermiteSpline(design.t, *pair) for pair in ((design.q, design.dq), (design.dq, design.ddq)))
        run = engine.record(self.arm, engine.Motion(t, q(t), dq(t), dq.derivative()(t)), seed=1000 * self.seed + number)
        checked = dy.read_recordings({"t": run.t, "q": run.q, "tau": run.tau}, robot=self.robot)
        return replace(checked.recordings[0], name=f"run{number}")

    def compute_torque(self, region):
        model, data = Scene.of(self.arm.robot, self.arm.drives, self.arm.step).engine()
        dof = np.array([dof_of(model, j) for j in range(self.robot.n)])
        # Its inverse dynamics take a slow joint that reverses within a step for one that sticks: friction is added.
        friction = model.dof_frictionloss[dof] * np.sign(region.dq)
        model.dof_frictionloss[:] = 0.0
        torque = np.empty_like(region.q)
        for k, state in enumerate(zip(region.q, region.dq, region.ddq, strict=True)):
            data.qpos[dof], data.qvel[dof], data.qacc[dof] = state
            mujoco.mj_inverse(model, data)
            torque[k] = data.qfrc_inverse[dof]
        return torque + friction


def weigh_load(arm: VirtualArm, request: CampaignRequest):
    """Return the state at the end, and how far each quantity is off, over the half-width of its interval."""
    load = build_typical_effect(arm.robot, "payload", arm.robot.joint_names[-1])
    values = dict(load.values)
    true = {"mass": values["Mp"]}
    true |= {f"centre_{x}": values.get(f"M{x.upper()}p", 0.0) / values["Mp"] for x in "xyz"}
    state = start_campaign(arm.robot, request)
    while not state.decision.is_end:
        planned, loads = plan_run(state), (load,) if state.is_load_due else ()
        state = add_run(state, arm.record(planned.design, len(state.runs) + 1, *loads), planned)
    measure = select_payload_errors(state.identification, request)
    moments = dict(zip(request.quantities, measure.values[1:], strict=True))
    found = {name: measure.values[0] if name == "mass" else moments[name] / measure.values[0] for name in moments}
    off = np.array([found[name] - true[name] for name in request.quantities])
    return state, np.abs(off) / (state.runs[-1].errors * measure.tolerances)


def measure_loads(asked: argparse.Namespace, design: DesignRequest) -> None:
    """Run campaigns for a load on each arm, and print how often the interval holds the truth."""
    rows, within = [], []
    for name in asked.arms.split(","):
        # No motion of a SCARA shows how high a load is.
        quantities = ("mass", "centre_x", "centre_y", "centre_z")[: 3 if name == "scara" else 4]
        for seed in range(asked.first_seed, asked.first_seed + asked.seeds):
            request = CampaignRequest(
                goal="payload", quantities=quantities, mass_error=asked.load, centre_error=asked.load / 10,
                minutes=asked.minutes, design=design,
            )  # fmt: skip
            state, off = weigh_load(VirtualArm(name, seed), request)
            within.append(off)
            words = state.decision.sentence.split(": ", 1)[-1][:90]
            rows.append([name, str(seed), state.decision.code, str(len(state.runs)), f"{off.max():.2f}", words])
            print(rows[-1], flush=True)
    heads = ["arm", "seed", "decision", "runs", "off / half-width", "load"]
    print(format_text_table("Loads", heads, rows, len(rows), right_from=3))
    inside = np.concatenate(within) <= 1.0
    print(f"the interval holds the truth: {inside.mean():.0%} of {len(inside)} quantities")


def run_campaign(arm: VirtualArm, request: CampaignRequest):
    """Return the state at the end, and of each run: robot minutes, the run, true errors, seconds of ask and tell."""
    state, history = start_campaign(arm.robot, request), []
    while not state.decision.is_end:
        start = time.process_time()
        planned = plan_run(state)
        asked = time.process_time()
        recording = arm.record(planned.design, len(state.runs) + 1)
        moved = time.process_time()
        state = add_run(state, recording, planned)
        seconds = asked - start, time.process_time() - moved
        true = arm.compute_true_error(state.identification, state.region)
        history.append((state.seconds / 60, state.runs[-1], true, seconds))
    return state, history


def is_reached_after_all(arm: VirtualArm, state) -> bool:
    """Return whether a campaign that was given up states its goal to be reached when it goes on until the end."""
    while True:
        planned = plan_run(replace(state, decision=Decision("next_run", "")))
        if state.seconds_left < planned.design.duration or len(state.runs) >= state.request.runs:
            return False
        state = add_run(state, arm.record(planned.design, len(state.runs) + 1), planned)
        if state.decision.code == "reached":
            return True


def run_rival(arm: VirtualArm, state, kind: str, request: DesignRequest):
    """Return robot minutes and the largest true error after each run of a rival: one design, or a new random motion."""
    effects = state.identification.model.effects
    choices = replace(state.request.choices, effects=effects)
    request = replace(request, effects=effects)
    if kind == "random":
        request = replace(request, kind="random", random_trajectories=1)
    if kind == "one design":
        request = replace(request, criterion=CriterionChoice("prediction"))
    region = state.region if kind == "one design" else None
    recordings, minutes, history, design = [], 0.0, [], None
    for k in range(RIVAL_RUNS):
        if design is None or kind == "random":
            design = design_experiment(arm.robot, replace(request, seed=request.seed + k), region=region)
        recordings.append(arm.record(design, 100 * (1 + RIVALS.index(kind)) + k))
        minutes += design.duration / 60
        true = arm.compute_true_error(identify(arm.robot, recordings, (), choices), state.region)
        history.append((minutes, float(true.max())))
    return history


def run_rivals(arm: VirtualArm, state) -> dict[str, list[tuple[float, float]]]:
    """Return the history of each rival, with runs of the whole length and of the shortest one of the campaign."""
    shortest, *_, longest = list_designs(state.request.design)
    return {
        f"{kind}, {request.trajectory.duration:g} s": run_rival(arm, state, kind, request)
        for request in (longest, shortest)
        for kind in RIVALS
    }


def run_programme(arm: VirtualArm, request: CampaignRequest):
    """Return robot minutes of a fixed programme of runs, and the effects in the model after their diagnosis."""
    designs = [
        design_experiment(arm.robot, replace(request.design, effects=request.choices.effects, seed=500 + k))
        for k in range(PROGRAMME_RUNS)
    ]
    recordings = [arm.record(design, 500 + k) for k, design in enumerate(designs)]
    model = identify(arm.robot, recordings, (), request.choices)
    found = diagnose(model, recordings).recommended
    return sum(design.duration for design in designs) / 60, (*model.model.effects, *found)


def has_hidden(arm: VirtualArm, effects) -> bool:
    """Return whether the hidden effect, or its equal, is among effects, on its joint."""
    hidden = arm.hidden.choice
    found = [choice for choice in effects if choice.effect in (hidden.effect, EQUALS.get(hidden.effect))]
    return any(not choice.joints or set(hidden.joints) & set(choice.joints) for choice in found)


def find_named(arm: VirtualArm, history) -> float:
    """Return the robot minutes after which the hidden effect stays among what a campaign adds; infinite if never."""
    minutes = np.inf
    for at, run, *_ in reversed(history):
        if not has_hidden(arm, run.added):
            break
        minutes = at
    return minutes


def find_goal(history, goal: float) -> float:
    """Return the robot minutes after which the true error stays at the goal; infinite where it does not."""
    minutes = np.inf
    for at, error in reversed(history):
        if error > goal:
            break
        minutes = at
    return minutes


def print_runs(state, history) -> None:
    """Print of each run what was promised, achieved and true on its worst joint, and what was added."""
    names = state.targets
    for k, (minutes, run, true, (ask, tell)) in enumerate(history):
        worst = int(np.argmax(run.errors))
        promised = "–" if run.promised is None else format_percent(float(run.promised.max()))
        changed = ", effects changed" if run.is_changed else ""
        added = "; ".join(f"{c.effect}@{'+'.join(c.joints)}" for c in run.added)
        print(
            f"  run {k + 1}, {minutes:.2f} min: promised {promised}, stated {format_percent(float(run.errors.max()))} "
            f"({names[worst]}, lacking {format_percent(float(run.lacking[worst]))}), true "
            f"{format_percent(float(true.max()))} ({names[int(np.argmax(true))]}); ask {ask:.1f} s, tell {tell:.1f} s"
            f"{changed} {added}",
            flush=True,
        )
    print(f"  {state.decision.sentence}", flush=True)


def print_curves(curves, ends: list[float], goal: float) -> None:
    """Print the true error over robot time of campaigns and rivals, and when each is at the goal, or is said to be."""
    rows = []
    for kind, histories in curves.items():
        for k in range(max(map(len, histories))):
            reached = [history[k] for history in histories if len(history) > k]
            minutes, errors = np.array(reached).T
            low, middle, high, most = np.quantile(errors, (0.25, 0.5, 0.75, 0.95))
            rows.append([
                kind, str(k + 1), str(len(reached)), f"{60 * np.median(minutes):.1f}",
                *(format_percent(float(error)) for error in (middle, low, high, most)),
            ])  # fmt: skip
    heads = ["who", "run", "arms", "seconds", "true error: median", "lower quartile", "upper quartile", "95 %"]
    print(format_text_table("True error over robot time", heads, rows, len(rows), right_from=1))
    rows = []
    for kind, histories in curves.items():
        # A campaign is at the goal when it says so; a rival, when the truth is.
        at = ends if kind == "campaign" else [find_goal(history, goal) for history in histories]
        low, middle, most = 60 * np.quantile(at, (0.05, 0.5, 0.95), method="higher")
        rows.append([kind, f"{middle:.1f}", f"{low:.1f}", f"{most:.1f}", f"{np.isinf(at).sum()} of {len(at)}"])
    heads = ["who", "seconds: median", "of 5 %", "of 95 %", "never"]
    print(format_text_table("Robot time until the goal", heads, rows, len(rows), right_from=1))


@dataclass
class Tally:
    """What campaigns promised and said, against the truth."""

    goal: float
    ratios: list[float] = field(default_factory=list)
    reached: list[bool] = field(default_factory=list)
    beyond: list[bool] = field(default_factory=list)
    given_up: list[bool] = field(default_factory=list)
    named: list[bool] = field(default_factory=list)
    needless: list[bool] = field(default_factory=list)
    """Of hidden effects that are not named: whether the true error is at the goal without them."""
    minutes_to_name: list[float] = field(default_factory=list)
    programme: list[tuple[float, bool]] = field(default_factory=list)
    seconds: list[tuple[float, float]] = field(default_factory=list)
    curves: dict[str, list] = field(default_factory=dict)
    ends: list[float] = field(default_factory=list)
    """Robot minutes after which each campaign that has rivals said *reached*; infinite of those that gave up."""

    def add(self, arm: VirtualArm, state, history) -> None:
        """Take in a campaign that is over."""
        for _, run, _, seconds in history:
            self.seconds.append(seconds)
            if run.promised is not None and not run.is_changed:
                self.ratios.append(float(run.errors.max() / run.promised.max()))
        is_true = bool(history[-1][2].max() <= self.goal)
        if state.decision.code == "reached":
            self.reached.append(is_true)
        if state.decision.code == "not_reachable":
            self.beyond.append(not is_true)
            self.given_up.append(not is_reached_after_all(arm, state))
        if arm.hidden is not None:
            self.named.append(has_hidden(arm, state.identification.model.effects))
            if not self.named[-1]:
                self.needless.append(is_true)
            self.minutes_to_name.append(find_named(arm, history))
            minutes, effects = run_programme(arm, state.request)
            self.programme.append((minutes, has_hidden(arm, effects)))

    def add_rivals(self, arm: VirtualArm, state, history) -> None:
        """Let the rivals run on the arm of a campaign that is over."""
        own = [(minutes, float(error.max())) for minutes, _, error, _ in history]
        self.ends.append(history[-1][0] if state.decision.code == "reached" else np.inf)
        for kind, curve in {"campaign": own, **run_rivals(arm, state)}.items():
            self.curves.setdefault(kind, []).append(curve)

    def print(self) -> None:
        """Print the shares of what was true."""
        within = np.mean([1 / 1.3 <= ratio <= 1.3 for ratio in self.ratios]) if self.ratios else np.nan
        print(
            f"achieved / promised: median {np.median(self.ratios):.2f}, within 1.3: {within:.0%} of {len(self.ratios)}"
        )
        for words, found in (
            ("said reached, and the true error is at the goal", self.reached),
            ("said not to be reached, and the true error is above the goal", self.beyond),
            ("said not to be reached, and it is not when the campaign goes on", self.given_up),
            ("hidden effect in the model at the end", self.named),
            ("hidden effect not in the model, and the true error at the goal without it", self.needless),
        ):
            if found:
                print(f"{words}: {np.mean(found):.0%} of {len(found)}")
        if self.programme:
            minutes, named = np.array(self.programme).T
            print(
                f"hidden effect named to stay after {np.median(self.minutes_to_name):.2f} min (median); a fixed "
                f"programme of {PROGRAMME_RUNS} runs takes {np.median(minutes):.2f} min and names {np.mean(named):.0%}"
            )
        if self.curves:
            print_curves(self.curves, self.ends, self.goal)
        longest = np.max(self.seconds, axis=0)
        print(f"longest ask {longest[0]:.1f} s, tell {longest[1]:.1f} s of processor time")


def measure_campaign(asked: argparse.Namespace, design: DesignRequest, name: str, seed: int, tally: Tally) -> list[str]:
    """Run a campaign, and its rivals where asked for; return its row of the table."""
    hidden = HIDDEN[seed % len(HIDDEN)] if asked.hidden else ""
    arm = (MujocoArm if asked.mujoco else VirtualArm)(name, seed, hidden)
    state, history = run_campaign(arm, CampaignRequest(error=asked.goal, minutes=asked.minutes, design=design))
    minutes, run, true, _ = history[-1]
    added = "; ".join(f"{c.effect}@{'+'.join(c.joints)}" for c in run.added)
    row = [
        name, str(seed), hidden or "–", state.decision.code, str(len(history)), f"{minutes:.2f}",
        format_percent(float(run.errors.max())), format_percent(float(true.max())), added or "–",
    ]  # fmt: skip
    print(row, flush=True)
    print_runs(state, history)
    tally.add(arm, state, history)
    if asked.rivals:
        tally.add_rivals(arm, state, history)
    return row


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--arms", default="scara")
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--first-seed", type=int, default=1)
    parser.add_argument("--goal", type=float, default=0.02)
    parser.add_argument("--minutes", type=float, default=3.0)
    words = "starts of a design's search: the same on any machine"
    parser.add_argument("--starts", type=int, default=DESIGN_STARTS, help=words)
    parser.add_argument("--hidden", action="store_true", help="hide an effect in each arm")
    parser.add_argument("--rivals", action="store_true")
    parser.add_argument("--mujoco", action="store_true", help="another engine moves the arms")
    parser.add_argument("--load", type=float, help="kg to within which a load is to be known")
    asked = parser.parse_args()
    design = DesignRequest(starts=asked.starts, trajectory=TrajectoryRequest(duration=10.0, sampling_rate=100.0))
    if asked.load is not None:
        measure_loads(asked, design)
        return
    if asked.mujoco and asked.hidden:
        parser.error("effects are hidden in virtual arms alone; leave out --mujoco or --hidden")
    tally = Tally(asked.goal)
    rows = [
        measure_campaign(asked, design, name, seed, tally)
        for name in asked.arms.split(",")
        for seed in range(asked.first_seed, asked.first_seed + asked.seeds)
    ]
    heads = ["arm", "seed", "hidden", "decision", "runs", "minutes", "stated", "true", "added"]
    print(format_text_table("Campaigns", heads, rows, len(rows), right_from=4))
    tally.print()


if __name__ == "__main__":
    main()
