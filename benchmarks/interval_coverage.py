"""How often 95 % intervals hold the truth, by class of parameter and for predicted torque, over simulated recordings.

python benchmarks/interval_coverage.py [recordings [estimator]]
python benchmarks/interval_coverage.py shapes [recordings]
python benchmarks/interval_coverage.py slow [recordings [first seed]]

Torque of Pinocchio along another random motion each time, white torque noise of 1 % of the largest torque, encoders of
2^17 counts a turn that are one count unsteady; filters are chosen from the data as for a user. Then the same with
something that no model has and all joints share: a force and a moment at the flange that wander, as a hose, a tool
cable or a shaking base make them (some 4 % of the torque). Beside the intervals that are told: those that take the
joints for independent, and those that count every filtered sample.

`shapes`: the same of shape constants, and of the parameters of the joints that they are on, beside what these would be
told with the shapes taken for certain. Three joints each have Stribeck friction, a power of the speed, presliding or a
ripple; another case is a counterbalance on the second. Constants are found as for a user: searched for, or refined from
a line of the residual's spectrum.

`slow`: residuals of each joint that wander by themselves (first-order autoregressive, of 0 to 1.5 s memory, 1 % of the
largest torque), on an arm of two joints and on one of six, by every strategy and estimator, which no block of time is
long against.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pinocchio
from common import FloatArray
from scipy.signal import lfilter

from dynident.effects import STOP, Column, EffectChoice, MemorySignal, ReferenceParameters
from dynident.effects.hysteresis_states import step_state
from dynident.estimation import CovarianceName, statistics
from dynident.identification import Identification, IdentificationChoices, identify, identify_model
from dynident.identification.identification_choices import COVARIANCES, EstimatorName
from dynident.identification.identified_models.torque_prediction import predict
from dynident.identification.shape_search import refine_shapes
from dynident.progress import ignore_progress
from dynident.recordings import Recording, choose_preprocessing, recording_from_arrays
from dynident.regressors.model_structure import build_model
from dynident.regressors.observation_matrix import RegressorInputs
from dynident.robot import Robot, robot_from_library, robot_from_urdf, to_pinocchio

EFFECTS = tuple(EffectChoice(name) for name in ("rigid_body", "rotor_inertia", "coulomb", "viscous", "offset"))
DURATION, RATE = 20.0, 200.0
TORQUE_NOISE, COUNT = 0.01, 2 * np.pi / 2**17


MEMORIES = (0.3, 1.0)
"""Of the wandering force, s."""
FORCE, ARM = 3.0, 0.1
"""Its size in N, and that of the moment over it in m."""
TORQUE = "predicted torque"


@dataclass(frozen=True)
class Coverage:
    """Share of intervals that hold the truth, for each class of parameters and for predicted torque.

    `by_joint` with the joints independent, `naive` with all samples; of predicted torque `honest` alone.
    """

    recordings: int
    honest: Mapping[str, float]
    by_joint: Mapping[str, float]
    naive: Mapping[str, float]
    largest_bias: Mapping[str, float]


@dataclass(frozen=True)
class Hidden:
    """An effect on some joints with true shape constants `shape`, and where a search for them begins, if anywhere.

    `own`: the true value of its first parameter, None where that depends on a phase.
    """

    effect: str
    joints: tuple[int, ...]
    torque: Callable[[FloatArray, FloatArray], FloatArray]
    shape: Mapping[str, float]
    begun: tuple[tuple[str, float], ...] = ()
    own: float | None = None


def _stop(q: FloatArray, _dq: FloatArray) -> FloatArray:
    """Presliding by the stop operator, from a state of zero."""
    signal, z, out = MemorySignal(STOP, 0, 0.02), 0.0, np.zeros(len(q))
    for k in range(1, len(q)):
        z = step_state(signal, z, q[k] - q[k - 1])
        out[k] = 8.0 * z
    return out


def _counterbalance(q: FloatArray, _dq: FloatArray) -> FloatArray:
    x, r = q - 0.4, 0.45
    return -1200.0 * np.sin(x) * (1 - 0.4 / np.sqrt(1 + r**2 + 2 * r * np.cos(x)))


THREE = (1, 2, 3)
HIDDEN = (
    Hidden("stribeck", THREE, lambda q, dq: 8.0 * np.exp(-((dq / 0.2) ** 2)) * np.sign(dq), {"vs": 0.2}, own=8.0),
    Hidden("viscous_nonlinear", THREE, lambda q, dq: 12.0 * np.abs(dq) ** 2.4 * np.sign(dq), {"p": 2.4}, own=12.0),
    Hidden("presliding", THREE, _stop, {"d0": 0.02}, own=8.0),
    Hidden("torque_ripple", THREE, lambda q, dq: 4.0 * np.cos(30.02 * q), {"k": 30.02}, (("k", 30.0),)),
    Hidden("gravity_compensator", (1,), _counterbalance, {"phi": 0.4, "r": 0.45}),
)


class VirtualArm:
    """An arm with drawn rotors and friction, and what measures it."""

    def __init__(self, robot: Robot | None = None, seed: int = 0) -> None:
        self.robot = robot or robot_from_library("ur10")
        self._model = to_pinocchio(self.robot)
        self._data = self._model.createData()
        self.drives = np.random.default_rng(seed).uniform(0.5, 5.0, (4, self.robot.n))

    @property
    def standard(self) -> FloatArray:
        """Standard parameters in the order of the columns of `EFFECTS`."""
        assert self.robot.inertias is not None
        return np.concatenate([self.robot.inertias.reshape(-1), self.drives.ravel()])

    def recorded(self, seed: int, memory: float | None = None, hidden: Hidden | None = None) -> Recording:
        """A recording of another motion with another noise for every seed, and a force with so long a memory (s)."""
        rng = np.random.default_rng([7, seed])
        q, dq, ddq = self.motion(rng)
        tau = self.compute_torque(q, dq, ddq)
        if hidden is not None:
            for joint in hidden.joints:
                tau[:, joint] += hidden.torque(q[:, joint], dq[:, joint])
        tau += TORQUE_NOISE * np.abs(tau).max(axis=0) * rng.standard_normal(tau.shape)
        if memory is not None:
            tau += self._disturbed(q, memory, rng)
        counts = np.round(q / COUNT + rng.standard_normal(q.shape))
        t = np.arange(len(q)) / RATE
        return recording_from_arrays(t, COUNT * counts, tau, joint_names=self.robot.joint_names, name=f"run {seed}")

    def compute_torque(self, q: FloatArray, dq: FloatArray, ddq: FloatArray) -> FloatArray:
        """Torque (m, n) of a motion."""
        ia, fc, fv, b = self.drives
        rigid = np.array([pinocchio.rnea(self._model, self._data, *rows) for rows in zip(q, dq, ddq, strict=True)])
        return np.asarray(rigid + ia * ddq + fc * np.sign(dq) + fv * dq + b)

    def _disturbed(self, q: FloatArray, memory: float, rng: np.random.Generator) -> FloatArray:
        """(m, n): torque of a wandering force and moment at the flange."""
        keep = np.exp(-2.0 / (RATE * memory))
        force = rng.standard_normal((len(q), 6))
        for _ in range(2):
            force = lfilter([1.0 - keep], [1.0, -keep], force, axis=0)
        force *= np.array([FORCE] * 3 + [FORCE * ARM] * 3) / force.std(axis=0)
        flange, frame = self._model.nframes - 1, pinocchio.LOCAL_WORLD_ALIGNED
        rows = [
            pinocchio.computeFrameJacobian(self._model, self._data, posture, flange, frame).T @ own
            for posture, own in zip(q, force, strict=True)
        ]
        return np.array(rows)

    def motion(self, rng: np.random.Generator) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Positions, velocities and accelerations (m, n)."""
        t = np.arange(round(DURATION * RATE)) / RATE
        q, dq, ddq = (np.zeros((len(t), self.robot.n)) for _ in range(3))
        for harmonic in range(1, 6):
            w = 2 * np.pi * 0.1 * harmonic
            size = rng.uniform(0.3, 1.0, self.robot.n) / np.sqrt(harmonic)
            wave = w * t[:, None] + rng.uniform(0, 2 * np.pi, self.robot.n)
            q += 0.5 * size * np.sin(wave)
            dq += 0.5 * size * w * np.cos(wave)
            ddq -= 0.5 * size * w**2 * np.sin(wave)
        return q, dq, ddq


def class_of(column: Column) -> str:
    """Inertia (second moments), first moments, or the effect's name."""
    if column.effect != "rigid_body":
        return column.effect
    return "first moments" if column.parameter.startswith("M") else "inertia"


def study(recordings: int, first: int = 0, estimator: EstimatorName = "wls", memory: float | None = None) -> Coverage:
    """Identify so many recordings with an estimator, the first with the seed `first`, and count."""
    arm = VirtualArm()
    model = build_model(arm.robot, EFFECTS)
    truth = model.base.grouping @ arm.standard
    held: dict[CovarianceName, list[FloatArray]] = {name: [] for name in COVARIANCES.names}
    errors, deviations, torques = [], [], []
    for seed in range(first, first + recordings):
        recording = arm.recorded(seed, memory)
        filters = choose_preprocessing([recording])
        choices = IdentificationChoices(effects=EFFECTS, preprocessing=filters, estimator=estimator)
        found = identify_model(
            model, [recording], [], choices, filters, ReferenceParameters.massless(arm.robot), ignore_progress
        )
        errors.append(found.values - truth)
        deviations.append(found.statistics.standard_deviations)
        for name in COVARIANCES.names:
            told = name == choices.covariance
            spread = found.statistics if told else statistics(found.data.equations, found.estimate.solution, name)
            held[name].append(np.abs(errors[-1]) <= spread.half_widths())
        motion = tuple(part[::40] for part in arm.motion(np.random.default_rng([8, seed])))
        predicted = predict(found.estimate, *motion)
        true = replace(found.estimate, solution=replace(found.estimate.solution, values=truth))
        right = predict(true, *motion).torque
        torques.append(np.abs(predicted.torque - right) <= predicted.mean_half_width)
    classes = np.array([class_of(column) for column in model.kept])
    bias = np.abs(np.mean(errors, axis=0) / np.mean(deviations, axis=0))
    named = list(dict.fromkeys(classes.tolist()))
    shares = {
        kind: {name: float(np.mean(np.array(hits)[:, classes == name])) for name in named}
        for kind, hits in held.items()
    }
    shares["by_time_and_joints"][TORQUE] = float(np.mean(torques))
    return Coverage(
        recordings,
        shares["by_time_and_joints"],
        shares["by_joint"],
        shares["independent"],
        {name: float(bias[classes == name].max()) for name in named},
    )


@dataclass(frozen=True)
class ShapeCoverage:
    """Shares of intervals that hold the truth: of shape constants by name, of parameters by effect.

    `told`: share of the constants that have an interval at all; `pull`: mean of their errors over their deviations, and
    the standard deviation of that; `certain` of parameters with the shapes taken for certain.
    """

    told: Mapping[str, float]
    constants: Mapping[str, float]
    pull: Mapping[str, tuple[float, float]]
    parameters: Mapping[str, float]
    certain: Mapping[str, float]


def shapes_found(arm: VirtualArm, hidden: Hidden, recording: Recording) -> Identification:
    """Identify with the hidden effect; its constants are searched for, or refined from where they were begun."""
    filters = choose_preprocessing([recording])
    names = [arm.robot.joint_names[joint] for joint in hidden.joints]
    choices = [EffectChoice(hidden.effect, (name,), hidden.begun) for name in names]
    if hidden.begun:
        plain = identify(arm.robot, [recording], [], IdentificationChoices(effects=EFFECTS, preprocessing=filters))
        choices = list(
            refine_shapes(plain.model, choices, RegressorInputs([recording], filters, plain.estimate.next_reference()))
        )
    return identify(
        arm.robot, [recording], [], IdentificationChoices(effects=(*EFFECTS, *choices), preprocessing=filters)
    )


def study_shapes(hidden: Hidden, recordings: int, first: int = 0, memory: float | None = None) -> ShapeCoverage:
    """Identify so many recordings with one hidden effect and count."""
    arm = VirtualArm()
    held: dict[str, list[bool]] = {name: [] for name in hidden.shape}
    told: dict[str, list[bool]] = {name: [] for name in hidden.shape}
    pulls: dict[str, list[float]] = {name: [] for name in hidden.shape}
    parameters: dict[str, list[bool]] = {}
    certain: dict[str, list[bool]] = {}
    names = [arm.robot.joint_names[joint] for joint in hidden.joints]
    for seed in range(first, first + recordings):
        found = shapes_found(arm, hidden, arm.recorded(seed, memory, hidden))
        for one in found.shape_constants:
            if one.name not in hidden.shape:
                continue
            told[one.name].append(one.interval is not None)
            if one.interval is not None:
                truth = hidden.shape[one.name]
                held[one.name].append(one.interval[0] <= truth <= one.interval[1])
                pulls[one.name].append((one.value - truth) / one.standard_deviation)
        half = statistics(found.data.equations, found.estimate.solution).half_widths()
        for k, parameter in enumerate(found.parameters):
            if parameter.link not in names:
                continue
            joint = arm.robot.joint_names.index(parameter.link)
            truths = {"coulomb": arm.drives[1, joint], "viscous": arm.drives[2, joint], hidden.effect: hidden.own}
            if parameter.effect not in truths or (parameter.effect == hidden.effect and parameter.name[:-1] in _MORE):
                continue
            truth = truths[parameter.effect]
            if truth is None:
                continue
            low, high = parameter.interval
            parameters.setdefault(parameter.effect, []).append(low <= truth <= high)
            certain.setdefault(parameter.effect, []).append(abs(parameter.value - truth) <= half[k])
    return ShapeCoverage(
        _shares(told),
        _shares(held),
        {name: (float(np.mean(own)), float(np.std(own))) if own else (0.0, 0.0) for name, own in pulls.items()},
        _shares(parameters),
        _shares(certain),
    )


_MORE = ("cz",)
"""Parameters of hidden effects that are zero in truth."""


def _shares(found: Mapping[str, Sequence[bool]]) -> dict[str, float]:
    return {name: float(np.mean(own)) if own else float("nan") for name, own in found.items()}


SLOW = (0.0, 0.1, 0.5, 1.5)
"""Memories of wandering residuals, s; blocks of 20 s of data are 1 s long."""
WAYS: tuple[Mapping[str, str], ...] = (
    {"estimator": "wls"},
    {"estimator": "ols"},
    {"estimator": "irls"},
    {"estimator": "feasible"},
    {"estimator": "iv"},
    {"estimator": "didim"},
    {"estimator": "ekf"},
    {"strategy": "sequential", "steps": "link_by_link"},
    {"strategy": "sequential", "steps": "wrist_then_shoulder"},
    {"strategy": "separate_friction"},
)
"""Choices that estimate differently."""


def build_two_joints() -> Robot:
    """Return an arm of two joints: one turns about a vertical axis, the other about a horizontal one behind it."""
    link = """<link name="link{0}"><inertial><origin xyz="0.12 0.02 0.05"/><mass value="{1}"/>
    <inertia ixx="0.03" iyy="0.05" izz="0.04" ixy="0.002" ixz="0" iyz="0.001"/></inertial></link>"""
    joint = """<joint name="joint{0}" type="revolute"><parent link="{1}"/><child link="link{0}"/>
    <origin xyz="0.2 0 0.1"/><axis xyz="{2}"/><limit lower="-3" upper="3" velocity="3" effort="100"/></joint>"""
    parts = [link.format(1, 6.0), link.format(2, 3.0), joint.format(1, "base", "0 0 1")]
    parts += [joint.format(2, "link1", "0 1 0"), '<link name="base"/>']
    return robot_from_urdf("two joints", f'<robot name="two">{"".join(parts)}</robot>')


def build_stroke(robot: Robot, joint: int) -> FloatArray:
    """Return positions (m, n) of one joint alone at constant speeds, for the strategy that begins with friction."""
    speeds = np.repeat([0.1, 0.3, 0.6, -0.6, -0.3, -0.1], round(1.5 * RATE))
    q = np.tile(np.linspace(0.4, -0.4, robot.n), (len(speeds), 1))
    q[:, joint] += np.cumsum(speeds) / RATE
    return q


def wander(rng: np.random.Generator, size: FloatArray, rows: int, memory: float) -> FloatArray:
    """Return stationary first-order autoregressive noise (rows, n) of the standard deviation `size` (n,)."""
    keep = np.exp(-1.0 / (RATE * memory)) if memory > 0 else 0.0
    first = round(5 * memory * RATE)
    white = rng.standard_normal((rows + first, len(size)))
    return size * lfilter([np.sqrt(1.0 - keep**2)], [1.0, -keep], white, axis=0)[first:]


def study_slow(
    arm: VirtualArm, way: Mapping[str, str], memory: float, recordings: int, first: int = 0
) -> Mapping[str, float]:
    """Return the shares of intervals that hold the truth, by class of parameter, of one motion with other residuals."""
    robot, names = arm.robot, arm.robot.joint_names
    model = build_model(robot, EFFECTS)
    truth = model.base.grouping @ arm.standard
    q, dq, ddq = arm.motion(np.random.default_rng([7, 1]))
    runs = [("test", q, arm.compute_torque(q, dq, ddq))]
    if way.get("strategy") == "separate_friction":
        for joint in range(robot.n):
            stroke = build_stroke(robot, joint)
            speed = np.gradient(stroke, 1.0 / RATE, axis=0)
            runs.append(("friction", stroke, arm.compute_torque(stroke, speed, 0.0 * stroke)))
    size = TORQUE_NOISE * np.abs(runs[0][2]).max(axis=0)
    held = []
    for seed in range(first, first + recordings):
        rng = np.random.default_rng([9, seed])
        made = [
            replace(
                recording_from_arrays(
                    np.arange(len(q)) / RATE, q, tau + wander(rng, size, len(q), memory), joint_names=names,
                    name=f"run {k}",
                ),
                role=role,
            )
            for k, (role, q, tau) in enumerate(runs)
        ]  # fmt: skip
        filters = choose_preprocessing(made[:1])
        choices = IdentificationChoices(effects=EFFECTS, preprocessing=filters, **way)
        found = identify(robot, made, [], choices)
        held.append(np.abs(found.values - truth) <= found.statistics.half_widths())
    classes, hits = np.array([class_of(column) for column in model.kept]), np.array(held)
    return {"all": float(hits.mean())} | {
        name: float(hits[:, classes == name].mean()) for name in dict.fromkeys(classes)
    }


def main_of_slow(recordings: int, first: int) -> None:
    for robot in (build_two_joints(), robot_from_library("ur10")):
        arm = VirtualArm(robot)
        for way in WAYS:
            for memory in SLOW:
                begun = time.process_time()
                shares = study_slow(arm, way, memory, recordings, first)
                words = ", ".join(f"{name} {share:.1%}" for name, share in shares.items())
                spent = time.process_time() - begun
                print(
                    f"{robot.name}, {' '.join(way.values())}, memory {memory:g} s: {words} ({spent:.0f} s)", flush=True
                )


def main_of_shapes(recordings: int) -> None:
    for hidden in HIDDEN:
        for memory in (None, MEMORIES[0]):
            begun = time.perf_counter()
            found = study_shapes(hidden, recordings, memory=memory)
            shared = "sensor noise alone" if memory is None else f"and a force at the flange, memory {memory:g} s"
            spent = time.perf_counter() - begun
            print(f"{hidden.effect}, {recordings} recordings, {shared} ({spent:.0f} s)")
            for name, share in found.constants.items():
                mean, spread = found.pull[name]
                print(
                    f"  {name:18s} {share:6.1%} of {found.told[name]:.0%} with an interval; "
                    f"error / deviation {mean:+.2f} ± {spread:.2f}"
                )
            for name, share in found.parameters.items():
                print(f"  {name:18s} {share:6.1%}; with the shape for certain {found.certain[name]:.1%}", flush=True)


def main() -> None:
    if sys.argv[1:2] == ["shapes"]:
        main_of_shapes(int(sys.argv[2]) if len(sys.argv) > 2 else 100)
        return
    if sys.argv[1:2] == ["slow"]:
        main_of_slow(*(int(word) for word in (*sys.argv[2:], "200", "0")[:2]))
        return
    recordings = int(sys.argv[1]) if len(sys.argv) > 1 else 200
    estimator = sys.argv[2] if len(sys.argv) > 2 else "wls"
    for memory in (None, *MEMORIES):
        begun = time.perf_counter()
        found = study(recordings, estimator=estimator, memory=memory)
        shared = "sensor noise alone" if memory is None else f"and a force at the flange, memory {memory:g} s"
        spent = time.perf_counter() - begun
        print(f"{found.recordings} recordings of {DURATION:g} s, {shared} ({spent:.0f} s)")
        print(f"{'':16s} {'95 % interval':>14s} {'joints independent':>19s} {'rows':>7s} {'largest bias / sd':>18s}")
        for name, share in found.honest.items():
            others = [f"{part[name]:.1%}" if name in part else "" for part in (found.by_joint, found.naive)]
            bias = f"{found.largest_bias[name]:.2f}" if name in found.largest_bias else ""
            print(f"{name:16s} {share:14.1%} {others[0]:>19s} {others[1]:>7s} {bias:>18s}")


if __name__ == "__main__":
    main()
