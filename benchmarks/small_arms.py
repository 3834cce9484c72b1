"""Arms of three joints with effects hidden in them, whose recordings take a moment to make and to diagnose.

Four runs at different speeds follow Fourier motions exactly; the torque is that of Newton and Euler with friction and
what is hidden. No controller moves the arm, so that no joint sticks: what shows at halts needs `hidden_effects.py`.
In every third arm, each joint has Stribeck friction, a gear ripple and a gain error of a few per cent besides.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from engine.drives import effort_limits, speed_limits, usual_drives
from engine.motions import fourier_motion
from engine.robots import arm_by_name, as_described

from dynident.array_types import FloatArray
from dynident.recordings import Recording, recording_from_arrays
from dynident.robot import Robot
from dynident.robot.pinocchio_conversion import compute_described_torque

RATE, DURATION, PACES = 200.0, 10.0, (1.0, 0.8, 0.5, 0.25)


@dataclass
class Run:
    """One run while its torque is written: signals (m, n), and factors of what is measured."""

    robot: Robot
    rng: np.random.Generator
    number: int
    t: FloatArray
    q: FloatArray
    dq: FloatArray
    ddq: FloatArray
    tau: FloatArray
    load: FloatArray
    gain: FloatArray = field(default_factory=lambda: np.ones(0))
    late: float = 0.0

    def add(self, joint: int, torque: FloatArray) -> None:
        self.tau[:, joint] += torque


Law = Callable[[Run, int, np.random.Generator], None]


def _hysteresis(q: FloatArray, slip: float) -> FloatArray:
    z = np.zeros(len(q))
    for k in range(1, len(q)):
        z[k] = min(1.0, max(-1.0, z[k - 1] + (q[k] - q[k - 1]) / slip))
    return z


def _coulomb(run: Run, j: int) -> float:
    return float(usual_drives(run.robot).coulomb[j])


def _effort(run: Run, j: int) -> float:
    return float(effort_limits(run.robot)[j])


def _offset(run: Run, j: int, rng: np.random.Generator) -> None:
    run.add(j, np.full(len(run.t), float(rng.choice([-1, 1]) * rng.uniform(0.008, 0.025)) * _effort(run, j)))


def _stribeck(run: Run, j: int, rng: np.random.Generator) -> None:
    size, speed = rng.uniform(0.4, 0.9) * _coulomb(run, j), np.exp(rng.uniform(np.log(0.03), np.log(0.15)))
    run.add(j, size * np.sign(run.dq[:, j]) * np.exp(-((run.dq[:, j] / speed) ** 2)))


def _power(run: Run, j: int, rng: np.random.Generator) -> None:
    x = run.dq[:, j] / speed_limits(run.robot)[j]
    run.add(j, rng.uniform(0.04, 0.1) * _effort(run, j) * np.sign(x) * np.abs(x) ** rng.choice([0.5, 2.0, 3.0]))


def _load(run: Run, j: int, rng: np.random.Generator) -> None:
    run.add(j, rng.uniform(0.05, 0.1) * np.abs(run.load[:, j]) * np.sign(run.dq[:, j]))


def _asymmetric(run: Run, j: int, rng: np.random.Generator) -> None:
    run.add(j, rng.uniform(0.3, 0.6) * usual_drives(run.robot).viscous[j] * np.abs(run.dq[:, j]))


def _presliding(run: Run, j: int, rng: np.random.Generator) -> None:
    slip = np.exp(rng.uniform(np.log(0.015), np.log(0.06)))
    run.add(j, _coulomb(run, j) * (_hysteresis(run.q[:, j], slip) - np.sign(run.dq[:, j])))


def _spring(run: Run, j: int, rng: np.random.Generator) -> None:
    size = rng.choice([-1, 1]) * rng.uniform(0.008, 0.03)
    run.add(j, size * _effort(run, j) * (run.q[:, j] - rng.uniform(-0.5, 0.5)))


def _ripple(run: Run, j: int, rng: np.random.Generator) -> None:
    waves, phase = rng.choice([3, 6, 8, 12, 20, 31]), rng.uniform(0.0, 6.28)
    run.add(j, rng.uniform(0.006, 0.018) * _effort(run, j) * np.sin(waves * run.q[:, j] + phase))


def _position_friction(run: Run, j: int, rng: np.random.Generator) -> None:
    wave = np.sin(rng.choice([1, 2]) * run.q[:, j] + rng.uniform(0.0, 6.28))
    run.add(j, rng.uniform(0.3, 0.5) * _coulomb(run, j) * wave * np.sign(run.dq[:, j]))


def _balancer(run: Run, j: int, rng: np.random.Generator) -> None:
    x = run.q[:, j] - rng.uniform(-0.5, 0.5)
    run.add(j, rng.uniform(0.05, 0.12) * _effort(run, j) * np.sin(x) / np.sqrt(1.1 + np.cos(x)))


def _coupling(run: Run, j: int, rng: np.random.Generator) -> None:
    j = min(j, run.robot.n - 2)
    speed, size = run.dq[:, j] + run.dq[:, j + 1], rng.uniform(0.02, 0.04)
    shared = size * _effort(run, j + 1) * (np.sign(speed) + 0.4 * speed)
    run.add(j, shared)
    run.add(j + 1, shared)


def _saturation(run: Run, j: int, rng: np.random.Generator) -> None:
    run.tau[:, j] *= 1.0 + rng.uniform(0.08, 0.2) * np.abs(run.tau[:, j]) / _effort(run, j)


def _delay(run: Run, _j: int, rng: np.random.Generator) -> None:
    run.late += rng.uniform(0.006, 0.014)


def _tilt(run: Run, _j: int, rng: np.random.Generator) -> None:
    angle, azimuth = np.radians(rng.uniform(0.7, 3.0)), rng.uniform(0.0, 6.28)
    gravity = 9.81 * np.array([np.sin(angle) * np.cos(azimuth), np.sin(angle) * np.sin(azimuth), -np.cos(angle)])
    robot = run.robot
    leaning = Robot(robot.name, robot.joints, gravity, robot.drives, robot.description, robot.inertias)
    run.tau += compute_described_torque(leaning, run.q, run.dq, run.ddq) - run.load


def _payload(run: Run, _j: int, rng: np.random.Generator) -> None:
    mass = rng.uniform(0.4, 1.5)
    if run.number >= 2:
        inertias = np.array(run.robot.inertias)
        inertias[-1, 9] += mass
        inertias[-1, 8] += 0.1 * mass
        robot = run.robot
        loaded = Robot(robot.name, robot.joints, robot.gravity, robot.drives, robot.description, inertias)
        run.tau += compute_described_torque(loaded, run.q, run.dq, run.ddq) - run.load


LAWS: dict[str, tuple[Law, tuple[str, ...]]] = {
    "offset": (_offset, ("offset", "coulomb_asymmetric")),
    "stribeck": (_stribeck, ("stribeck",)),
    "viscous_nonlinear": (_power, ("viscous_nonlinear",)),
    "viscous_asymmetric": (_asymmetric, ("viscous_asymmetric",)),
    "load_dependent_friction": (_load, ("load_dependent_friction",)),
    "presliding": (_presliding, ("presliding",)),
    "joint_spring": (_spring, ("joint_spring", "gravity_compensator")),
    "torque_ripple": (_ripple, ("torque_ripple",)),
    "position_dependent_friction": (_position_friction, ("position_dependent_friction",)),
    "gravity_compensator": (_balancer, ("gravity_compensator", "joint_spring", "torque_ripple", "unknown:position")),
    "transmission_coupling": (_coupling, ("transmission_coupling",)),
    "drive_gain_saturation": (_saturation, ("drive_gain_saturation",)),
    "torque_delay": (_delay, ("torque_delay",)),
    "base_tilt": (_tilt, ("base_tilt",)),
    "payload": (_payload, ("payload",)),
}
"""How each effect is written, and the names that are right for it."""

MESS = ("stribeck", "torque_ripple")


@dataclass(frozen=True)
class SmallArm:
    """An arm and what is hidden in it.

    Parameters
    ----------
    seed, number : int
        What it is drawn from.
    hidden : tuple of (str, int)
        Names of `LAWS`, each with the index of a joint.
    messy : bool
        Whether all joints have some of everything besides.
    """

    seed: int
    number: int
    hidden: tuple[tuple[str, int], ...]
    messy: bool

    @property
    def accept(self) -> tuple[tuple[str, ...], ...]:
        """A group of right names for each hidden effect."""
        return tuple(LAWS[name][1] for name, _ in self.hidden)

    def record(self) -> tuple[Robot, Recording, Recording]:
        """Return the arm as described, the recording to learn from, and one that is held out."""
        robot = arm_by_name(f"three-{1000 * self.seed + self.number}")
        training = [self._run(robot, k, pace) for k, pace in enumerate(PACES)]
        held_out = [self._run(robot, len(PACES), 0.7)]
        described = as_described(robot, 1000 * self.seed + self.number)
        return described, _join(robot, training, "training"), _join(robot, held_out, "held out")

    def _run(self, robot: Robot, number: int, pace: float) -> Run:
        rng = np.random.default_rng([self.seed, self.number, number])
        motion = fourier_motion(robot, DURATION, int(rng.integers(2**31)), 1.0 / RATE, pace=pace)
        load = compute_described_torque(robot, motion.q, motion.dq, motion.ddq)
        drives = usual_drives(robot)
        tau = load + drives.rotor * motion.ddq + drives.viscous * motion.dq + drives.coulomb * np.sign(motion.dq)
        run = Run(robot, rng, number, motion.t, motion.q, motion.dq, motion.ddq, tau, load)
        # What is hidden is the same in every run.
        for k, (name, joint) in enumerate(self.hidden):
            LAWS[name][0](run, joint, np.random.default_rng([self.seed, self.number, 100 + k]))
        if self.messy:
            own = np.random.default_rng([self.seed, self.number, 99])
            for joint in range(robot.n):
                before = run.tau[:, joint].copy()
                for name in MESS:
                    LAWS[name][0](run, joint, own)
                # A third of what a hidden effect has.
                run.tau[:, joint] = before + (run.tau[:, joint] - before) / 3.0
        return run


def _join(robot: Robot, runs: list[Run], name: str) -> Recording:
    """Return runs as one recording, a segment each, with noise and encoder steps."""
    step = 2 * np.pi / 2**18
    noise = 0.005 * effort_limits(robot)
    start, times, taus = 0.0, [], []
    for run in runs:
        late = np.column_stack([np.interp(run.t - run.late, run.t, column) for column in run.tau.T])
        taus.append(late + noise * run.rng.standard_normal(late.shape))
        times.append(start + run.t)
        start = float(times[-1][-1]) + 2.0
    return recording_from_arrays(
        np.concatenate(times),
        np.round(np.concatenate([run.q for run in runs]) / step) * step,
        np.concatenate(taus),
        joint_names=robot.joint_names,
        segment=np.concatenate([np.full(len(run.t), run.number + 1) for run in runs]),
        name=name,
    )


def draw_small_arm(seed: int, number: int) -> SmallArm:
    """Draw an arm: of six, one is clean, three have one effect, two have two; every third is messy."""
    rng = np.random.default_rng([seed, number])
    count = (0, 1, 1, 1, 2, 2)[number % 6]
    names = rng.permutation(list(LAWS))[:count]
    hidden = tuple((str(name), int(rng.integers(3))) for name in names)
    return SmallArm(seed, number, hidden, messy=count > 0 and number % 3 == 2)
