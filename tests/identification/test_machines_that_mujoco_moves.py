"""Machines with closed loops under control in MuJoCo, with dry friction on joints that have no motor."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache

import mujoco
import numpy as np
import pytest
from support.closed_loop_robots import machine, mjcf

from dynident.diagnosis import Comparison, DiagnosisChoices, compare, diagnose
from dynident.effects import EffectChoice
from dynident.identification import Identification, IdentificationChoices, identify
from dynident.recordings import Recording, low_pass, recording_from_arrays
from dynident.recordings.joint_phases import Phase
from dynident.robot import Robot

STEP, RATE, DURATION = 2e-4, 1000.0, 20.0
COUNTS, LINEAR, NOISE = 2**19, 1e-6, 0.005
COULOMB, VISCOUS, PASSIVE = 1.0, 0.7, 0.4
RODS = ("left_rod", "right_rod")
HELD_OUT = (11,)
ASKED = ("stribeck", "joint_spring", "transmission_coupling", "torque_ripple")


@dataclass(frozen=True, eq=False)
class Rubbed:
    """A machine of the tests with Coulomb friction and damping on joints with and without a motor.

    `gains`: stiffness and damping of each motor's controller.
    """

    name: str
    friction: Mapping[str, tuple[float, float]]
    gains: Mapping[str, tuple[float, float]]

    @property
    def robot(self) -> Robot:
        return machine(self.name)


FIVE_BAR = Rubbed(
    "five_bar",
    dict.fromkeys(("left", "right"), (COULOMB, VISCOUS)) | dict.fromkeys(RODS, (PASSIVE, 0.3)),
    dict.fromkeys(("left", "right"), (4000.0, 150.0)),
)
ARMS = tuple(f"arm{leg}" for leg in range(3))
LEGS = tuple(f"{part}{leg}" for leg in range(3) for part in ("swing", "rod"))
DELTA = Rubbed(
    "delta",
    dict.fromkeys(ARMS, (0.2, 0.1)) | dict.fromkeys(LEGS, (0.02, 0.01)),
    dict.fromkeys(ARMS, (4000.0, 150.0)),
)
HEAVY = {"yaw": (15.0, 10.0), "arm": (15.0, 10.0), "lever": (12.0, 8.0), "forearm": (6.0, 3.0), "rod": (3.0, 2.0)}
BASE_GAINS = {"yaw": (1e5, 2000.0), "arm": (1e5, 2000.0), "lever": (5e4, 1000.0)}
PALLETISER = Rubbed("palletiser", HEAVY | {"flange": (0.3, 0.2)}, BASE_GAINS | {"flange": (320.0, 6.4)})
SIX_AXIS = Rubbed(
    "six_axis",
    HEAVY | {"roll": (0.3, 0.2), "pitch": (0.3, 0.2), "turn": (0.1, 0.1), "finger": (0.5, 1.0)},
    BASE_GAINS | dict.fromkeys(("roll", "pitch", "turn"), (320.0, 6.4)) | {"finger": (6400.0, 128.0)},
)


@dataclass(frozen=True)
class Peak:
    """More dry friction on a passive joint: `size` in N m times exp(-(v / width)²)."""

    joint: str
    size: float
    width: float = 0.1

    def at(self, speed: float) -> float:
        return self.size * float(np.exp(-((speed / self.width) ** 2)))


def reference(robot: Robot, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A motion of sines within four fifths of the ranges: t (m,), q and dq (m, n)."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, DURATION, STEP)
    low, high = np.array([joint.limits.position for joint in robot.joints]).T
    w = 2 * np.pi * 0.1 * np.arange(1, 6)[:, None, None]
    a, phase = rng.normal(size=(5, 1, robot.n)) / np.arange(1, 6)[:, None, None], rng.uniform(0, 6.28, (5, 1, robot.n))
    shape = (a * np.sin(w * t[:, None] + phase)).sum(0)
    size = 0.4 * (high - low) / np.abs(shape).max(0)
    return t, 0.5 * (low + high) + size * shape, size * (a * w * np.cos(w * t[:, None] + phase)).sum(0)


def moved(rubbed: Rubbed, seed: int, peak: Peak | None = None, *, silent: bool = False) -> tuple[Recording, np.ndarray]:
    """A machine that MuJoCo moves under joint control, as instruments see it, and their torque noise (n,).

    `silent`: the noise is not in the torque.
    """
    robot = rubbed.robot
    model = mujoco.MjModel.from_xml_string(mjcf(robot, friction=dict(rubbed.friction)))
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_LIMIT
    data = mujoco.MjData(model)
    t, q, dq = reference(robot, seed)
    tree = [model.joint(name).qposadr[0] for name in robot.tree.joint_names]
    driven = [model.joint(name).qposadr[0] for name in robot.joint_names]
    whole = robot.linkage.compute_motion(q[:1], dq[:1], 0 * dq[:1])
    data.qpos[tree], data.qvel[tree] = whole[0][0], whole[1][0]
    stiffness, damping = np.array([rubbed.gains[name] for name in robot.joint_names]).T
    seen, torque = np.empty_like(q), np.empty_like(q)
    # A hundred thousand steps: what each of them shares is computed once, and MuJoCo's arrays are looked up once.
    command = stiffness * q + damping * dq
    qpos, qvel, control, loss = data.qpos, data.qvel, data.ctrl, model.dof_frictionloss
    place = model.joint(peak.joint).dofadr[0] if peak is not None else 0
    for position, own, wanted in zip(seen, torque, command, strict=True):
        qpos.take(driven, out=position)
        np.subtract(wanted, stiffness * position + damping * qvel.take(driven), out=own)
        control[:] = own
        if peak is not None:
            loss[place] = rubbed.friction[peak.joint][0] + peak.at(float(qvel[place]))
        mujoco.mj_step(model, data)
    every = round(1 / (RATE * STEP))
    count = np.array([2 * np.pi / COUNTS if joint.kind == "revolute" else LINEAR for joint in robot.joints])
    noise = NOISE * np.abs(torque).max(0)
    tau = torque[::every]
    if not silent:
        tau = tau + noise * np.random.default_rng(100 + seed).normal(size=tau.shape)
    positions = np.round(seen[::every] / count) * count
    names = robot.joint_names
    return recording_from_arrays(t[::every], positions, tau, joint_names=names, name=f"run{seed}"), noise


def identified(rubbed: Rubbed, runs: list[Recording]) -> Identification:
    joints = tuple(rubbed.friction)
    effects = (EffectChoice("rigid_body"), EffectChoice("coulomb", joints), EffectChoice("viscous", joints))
    return identify(rubbed.robot, runs, [], IdentificationChoices(effects=effects))


@cache
def with_friction(rubbed: Rubbed, n_runs: int) -> tuple[Identification, list[tuple[Comparison, np.ndarray]]]:
    """A machine identified from so many runs; other runs without noise beside its prediction, with their noise (n,)."""
    found = identified(rubbed, [moved(rubbed, seed)[0] for seed in range(1, n_runs + 1)])
    others = [moved(rubbed, seed, silent=True) for seed in HELD_OUT]
    return found, [(compare(found, run), noise) for run, noise in others]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("rubbed", "n_runs"),
    [
        (FIVE_BAR, 2),
        (SIX_AXIS, 4),
        pytest.param(PALLETISER, 6, marks=pytest.mark.thorough),
        pytest.param(DELTA, 4, marks=pytest.mark.thorough),
    ],
    ids=lambda given: given.name if isinstance(given, Rubbed) else str(given),
)
def test_friction_of_passive_joints_leaves_little_more_than_noise_where_they_move(rubbed: Rubbed, n_runs: int) -> None:
    """Without noise in the held-out runs, what is left is the model's error, much less than noise would hide."""
    found, held_out = with_friction(rubbed, n_runs)
    taps = low_pass(RATE, found.preprocessing.torque_cutoff)
    errors = np.concatenate([run.residual / (noise * np.sqrt(taps @ taps)) for run, noise in held_out])
    moving = np.concatenate([run.phase for run, _ in held_out]) == Phase.MOVING
    over_floor = np.sqrt(1.0 + (errors**2 * moving).sum(axis=0) / moving.sum(axis=0))
    assert (over_floor < 1.1).all(), over_floor


@pytest.mark.slow
def test_friction_of_passive_joints_is_found() -> None:
    found, _ = with_friction(FIVE_BAR, 2)
    values = {column.name: value for column, value in zip(found.model.kept, found.values, strict=True)}
    assert [values[name] for name in ("Fc1", "Fc3")] == pytest.approx([COULOMB] * 2, rel=0.02)
    assert [values[name] for name in ("Fc2", "Fc4")] == pytest.approx([PASSIVE] * 2, rel=0.03)


@pytest.mark.slow
def test_rows_beside_halts_of_passive_joints_are_told_apart() -> None:
    """There the sign of friction is uncertain, and what is left is several times what it is elsewhere."""
    _, [(held_out, _), *_] = with_friction(FIVE_BAR, 2)
    beside, moving = (held_out.phase == phase for phase in (Phase.PASSIVE_HALT, Phase.MOVING))
    assert 0.05 < beside.mean() < 0.5
    rms = [np.sqrt((held_out.residual[rows] ** 2).mean()) for rows in (beside, moving)]
    assert rms[0] > 3 * rms[1]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("rubbed", "peak"),
    [
        (FIVE_BAR, Peak("left_rod", 0.6)),
        pytest.param(DELTA, Peak("swing0", 0.1), marks=pytest.mark.thorough),
        pytest.param(DELTA, Peak("swing2", 0.1), marks=pytest.mark.thorough),
    ],
    ids=lambda given: given.joint if isinstance(given, Peak) else given.name,
)
def test_a_friction_peak_hidden_on_a_passive_joint_is_named(rubbed: Rubbed, peak: Peak) -> None:
    # Of a delta one passive joint or another turns beside more than four fifths of the rows: they are equations of the
    # motion in them alone.
    runs = [moved(rubbed, seed, peak)[0] for seed in (1, 2)]
    found = diagnose(identified(rubbed, runs), runs, DiagnosisChoices(ASKED))
    assert [(choice.effect, choice.joints) for choice in found.recommended] == [("stribeck", (peak.joint,))]
    assert found.recommended[0].shape_values["vs"] == pytest.approx(peak.width, rel=0.05)
    assert (found.residual_rms < 1.1 * found.noise_floor).all()


@pytest.mark.slow
@pytest.mark.thorough
def test_nothing_is_named_in_a_clean_delta() -> None:
    runs = [moved(DELTA, seed)[0] for seed in (1, 2)]
    found = diagnose(identified(DELTA, runs), runs, DiagnosisChoices(ASKED))
    assert found.recommended == ()
    assert found.verdict == "adequate"
    assert (found.residual_rms < 1.1 * found.noise_floor).all()
