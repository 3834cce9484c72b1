"""Campaigns on virtual arms: robot time until the true error is at the goal, promises, decisions, hidden effects.

    python benchmarks/campaigns.py [--arms scara,ur10] [--seeds 4] [--goal 0.02] [--minutes 3] [--hidden] [--mujoco]
    python benchmarks/campaigns.py --load 0.02 [--arms scara,ur10] [--seeds 4]

Each campaign has links of its own (10 % off the description) and friction of usual size. The true error is that of the
identified model's torque over the region of the goal, against the arm's own torque. The rivals get the same robot time:
one run of a design by the condition number, and random motions, each of as many periods as fit.

With --mujoco, another engine moves the arm, with joints that stick, and says its true torque: nothing of the program
under test but the description is in it. With --load, the goal is a load's mass to within so many kg, and its centre to
within a tenth as many m; the load is the usual one of each arm.
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import replace
from pathlib import Path

import common  # noqa: F401  (pins the threads of linear algebra before numpy is imported)
import engine
import mujoco
import numpy as np
from engine.scene import Scene, dof_of

import dynident as dy
from dynident.advice.campaign import add_run, plan_run, start_campaign
from dynident.advice.campaign_request import CampaignRequest
from dynident.advice.payload_goal import select_payload_errors
from dynident.effects import LINKS, ReferenceParameters, Signals, build_columns
from dynident.excitation import DesignRequest, TrajectoryRequest, design_experiment
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
HIDDEN = ("stribeck", "torque_ripple", "joint_spring", "coulomb_asymmetric", "load_dependent_friction", "presliding")


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
    """Return the state at the end, and (robot minutes, promised, achieved, true error) of each run."""
    state, history = start_campaign(arm.robot, request), []
    while not state.decision.is_end:
        planned = plan_run(state)
        state = add_run(state, arm.record(planned.design, len(state.runs) + 1), planned)
        run, true = state.runs[-1], arm.compute_true_error(state.identification, state.region)
        history.append((state.seconds / 60, run, true))
    return state, history


def run_rival(arm: VirtualArm, state, kind: str):
    """Return the true error of a model from one motion of a kind, as long as the campaign."""
    trajectory = state.request.design.trajectory
    periods = max(1, int(state.seconds // trajectory.duration))
    request = replace(
        state.request.design, kind=kind, random_trajectories=1 if kind == "random" else 100,
        trajectory=replace(trajectory, periods=periods), effects=state.identification.model.effects,
    )  # fmt: skip
    recording = arm.record(design_experiment(arm.robot, request), 900 + len(kind))
    choices = replace(state.request.choices, effects=state.identification.model.effects)
    return arm.compute_true_error(identify(arm.robot, [recording], (), choices), state.region)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--arms", default="scara")
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--first-seed", type=int, default=1)
    parser.add_argument("--goal", type=float, default=0.02)
    parser.add_argument("--minutes", type=float, default=3.0)
    parser.add_argument("--budget", type=float, default=4.0, help="seconds of a design's search")
    parser.add_argument("--hidden", action="store_true", help="hide an effect in each arm")
    parser.add_argument("--rivals", action="store_true")
    parser.add_argument("--mujoco", action="store_true", help="another engine moves the arms")
    parser.add_argument("--load", type=float, help="kg to within which a load is to be known")
    asked = parser.parse_args()
    design = DesignRequest(time_budget=asked.budget, trajectory=TrajectoryRequest(duration=10.0, sampling_rate=100.0))
    if asked.load is not None:
        measure_loads(asked, design)
        return
    if asked.mujoco and asked.hidden:
        parser.error("effects are hidden in virtual arms alone; leave out --mujoco or --hidden")
    rows, ratios, honest, named = [], [], [], []
    for name in asked.arms.split(","):
        for seed in range(asked.first_seed, asked.first_seed + asked.seeds):
            hidden = HIDDEN[seed % len(HIDDEN)] if asked.hidden else ""
            arm = (MujocoArm if asked.mujoco else VirtualArm)(name, seed, hidden)
            state, history = run_campaign(arm, CampaignRequest(error=asked.goal, minutes=asked.minutes, design=design))
            for _, run, _ in history:
                if run.promised is not None and not run.is_changed:
                    ratios.append(float(run.errors.max() / run.promised.max()))
            minutes, run, true = history[-1]
            if state.decision.code == "reached":
                honest.append(bool(true.max() <= asked.goal))
            if arm.hidden is not None:
                found = [c for c in state.identification.model.effects if c.effect == hidden]
                named.append(any(not c.joints or set(arm.hidden.choice.joints) & set(c.joints) for c in found))
            rivals = [format_percent(float(run_rival(arm, state, kind).max())) for kind in ("optimized", "random")] if (
                asked.rivals) else []  # fmt: skip
            added = "; ".join(f"{c.effect}@{'+'.join(c.joints)}" for c in run.added)
            rows.append([
                name, str(seed), hidden or "–", state.decision.code, str(len(history)), f"{minutes:.2f}",
                format_percent(float(run.errors.max())), format_percent(float(true.max())), *rivals, added or "–",
            ])  # fmt: skip
            print(rows[-1], flush=True)
    heads = ["arm", "seed", "hidden", "decision", "runs", "minutes", "stated", "true",
             *(["one design", "random"] if asked.rivals else []), "added"]  # fmt: skip
    print(format_text_table("Campaigns", heads, rows, len(rows), right_from=4))
    within = np.mean([1 / 1.3 <= ratio <= 1.3 for ratio in ratios]) if ratios else np.nan
    print(f"achieved / promised: median {np.median(ratios):.2f}, within 1.3: {within:.0%} of {len(ratios)}")
    if honest:
        print(f"said reached, and the true error is at the goal: {np.mean(honest):.0%} of {len(honest)}")
    if named:
        print(f"hidden effect in the model at the end: {np.mean(named):.0%} of {len(named)}")


if __name__ == "__main__":
    main()
