"""Spans that something outside the model disturbed are found, explained and left out before any physics is named."""

from __future__ import annotations

import tracemalloc
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pinocchio as pin
import pytest
from support.hidden_effects import WITH_OFFSET
from support.oracles import FloatArray, arm, fourier_motion, pinocchio_torque, record

from dynident.diagnosis import Diagnosis, diagnose, disturbances
from dynident.estimation import FactorAccumulator, find_outlying_spans, outlying_spans
from dynident.identification import Identification, IdentificationChoices, extend, identify
from dynident.recordings import Recording
from dynident.robot import Robot, to_pinocchio
from dynident.verdict import verdict

pytestmark = pytest.mark.sweep

RATE, DURATION = 200.0, 24.0


def case(seed: int, disturb) -> tuple[Recording, Identification, tuple[float, float]]:
    """A run of an arm in which something acts from a random time on for a random while, and the model from it."""
    rng = np.random.default_rng(seed)
    robot = arm(("ur10", "franka_panda", "crooked")[seed % 3])
    motion = fourier_motion(robot, DURATION, RATE, seed)
    effort = np.array([joint.limits.effort for joint in robot.joints])
    friction = 0.03 * effort * (np.sign(motion.dq) + motion.dq)
    tau = pinocchio_torque(robot, motion.q, motion.dq, motion.ddq) + friction + 0.002 * effort * motion.ddq
    length = rng.uniform(1.0, 4.0)
    start = rng.uniform(2.0, DURATION - length - 2.0)
    inside = (motion.t >= start) & (motion.t <= start + length)
    tau = disturb(robot, motion, tau, inside, rng) + 0.002 * effort * rng.normal(size=tau.shape)
    recording = record(robot, motion, tau, "run")
    return recording, identify(robot, [recording], [], IdentificationChoices(WITH_OFFSET)), (start, start + length)


def pushed(robot: Robot, motion, tau: FloatArray, inside, rng) -> FloatArray:
    """A constant force at a point of one of the outer links."""
    model = to_pinocchio(robot)
    data, link = model.createData(), int(rng.integers(3, robot.n + 1))
    force, point = rng.normal(size=3), rng.uniform(-0.08, 0.08, 3)
    force *= rng.uniform(20.0, 50.0) / np.linalg.norm(force)
    for k in np.flatnonzero(inside):
        pin.computeJointJacobians(model, data, motion.q[k])
        jacobian = pin.getJointJacobian(model, data, link, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
        arm_of_force = data.oMi[link].rotation @ point
        tau[k] -= jacobian.T @ np.concatenate([force, np.cross(arm_of_force, force)])
    return tau


def untouched(robot: Robot, motion, tau: FloatArray, inside, rng) -> FloatArray:
    return tau


def held_by_a_brake(robot: Robot, motion, tau: FloatArray, inside, rng) -> FloatArray:
    tau[inside, 1] = 0.0
    return tau


def late(robot: Robot, motion, tau: FloatArray, inside, rng) -> FloatArray:
    moved = np.column_stack([np.interp(motion.t - 0.1, motion.t, column) for column in tau.T])
    return np.where(inside[:, None], moved, tau)


def weighted_down(robot: Robot, motion, tau: FloatArray, inside, rng) -> FloatArray:
    heavier = robot.inertias.copy()
    heavier[-1, 9] += 2.0
    heavy = Robot(robot.name, robot.joints, robot.gravity, robot.drives, robot.description, heavier)
    more = pinocchio_torque(heavy, motion.q, motion.dq, motion.ddq)
    more -= pinocchio_torque(robot, motion.q, motion.dq, motion.ddq)
    return tau + np.where(inside[:, None], more, 0.0)


def put_down(robot: Robot, motion, tau: FloatArray, inside, rng) -> FloatArray:
    return weighted_down(robot, motion, tau, ~inside, rng)


def shaken(robot: Robot, motion, tau: FloatArray, inside, rng) -> FloatArray:
    effort = np.array([joint.limits.effort for joint in robot.joints])
    return tau + 0.1 * effort * rng.normal(size=tau.shape) * inside[:, None]


def said(found: Diagnosis) -> str:
    """The first sentence."""
    return found.summary.partition(". ")[0].partition(": leave")[0]


@pytest.mark.sweep
@pytest.mark.parametrize("seed", [*range(6), *(pytest.param(k, marks=pytest.mark.thorough) for k in range(6, 18))])
def test_a_push_is_named_with_its_seconds_and_nothing_else_is(seed):
    recording, model, (start, end) = case(seed, pushed)
    found = diagnose(model, [recording])
    (choice,) = found.recommended
    assert choice.effect == "external_contact"
    assert choice.shape_values["t0"] == pytest.approx(start, abs=0.4)
    assert choice.shape_values["t1"] == pytest.approx(end, abs=0.4)
    assert said(found).startswith(f"From {choice.shape_values['t0']:.1f} to {choice.shape_values['t1']:.1f} s of run ")
    assert "an external force" in said(found)
    grown = extend(model, found.recommended, [recording])
    assert grown.fit.relative_total < 0.5 * model.fit.relative_total


@pytest.mark.sweep
@pytest.mark.parametrize("seed", range(30, 36))
def test_nothing_is_said_of_an_arm_that_nothing_touched(seed):
    recording, model, _ = case(seed, untouched)
    assert not any("something else acted" in warning for warning in model.warnings)
    found = diagnose(model, [recording])
    assert (found.recommended, found.unknown) == ((), ())
    assert not found.summary.startswith("From")


@pytest.mark.sweep
@pytest.mark.parametrize(
    ("disturb", "cause"),
    [
        (held_by_a_brake, "hardly changes: the drives were off, or the brakes were engaged"),
        (late, "ms late: a clock jumped"),
        (shaken, "no force on one link explains it"),
    ],
)
@pytest.mark.parametrize("seed", [0, 1])
def test_what_is_no_push_is_described_and_left_out(disturb, cause, seed):
    recording, model, (start, end) = case(seed, disturb)
    found = diagnose(model, [recording])
    assert found.recommended == ()
    assert [pattern.variable for pattern in found.unknown] == ["time"]
    sentence = said(found)
    assert cause in sentence
    first, last = (float(word) for word in sentence.removeprefix("From ").split(" s of ")[0].split(" to "))
    assert (first, last) == (pytest.approx(start, abs=0.5), pytest.approx(end, abs=0.5))


def test_a_brake_is_told_where_the_robot_mostly_stands():
    rng = np.random.default_rng(2)
    predicted = np.concatenate([np.full((3000, 1), 5.0), 20.0 * np.sin(np.arange(1000) / 60.0)[:, None]])
    measured = predicted + 0.02 * rng.normal(size=predicted.shape)
    rows = np.arange(4000) >= 3600
    measured[rows] = 0.02 * rng.normal(size=(400, 1))
    comparison = SimpleNamespace(measured=measured, predicted=predicted, joint_names=("elbow",))
    cause = disturbances._find_cause(comparison, rows, np.ones(1))
    assert cause == "the torque of elbow hardly changes: the drives were off, or the brakes were engaged"


def test_a_position_that_jumps_is_no_drive_that_is_off():
    robot = arm("ur10")
    motion = fourier_motion(robot, DURATION, RATE, 0)
    effort = np.array([joint.limits.effort for joint in robot.joints])
    tau = pinocchio_torque(robot, motion.q, motion.dq, motion.ddq) + 0.03 * effort * np.sign(motion.dq)
    tau += 0.002 * effort * np.random.default_rng(0).normal(size=tau.shape)
    q = motion.q.copy()
    q[motion.t > 12.0, 2] += 0.12
    recording = record(robot, replace(motion, q=q), tau, "run")
    model = identify(robot, [recording], [], IdentificationChoices(WITH_OFFSET))
    assert "drives were off" not in diagnose(model, [recording]).summary


@pytest.mark.parametrize(("disturb", "more"), [(weighted_down, "more"), (put_down, "less")])
@pytest.mark.parametrize("seed", [0, 1, 3])
def test_a_load_that_is_carried_for_a_while_is_given_with_its_mass(seed, disturb, more):
    recording, model, _ = case(seed, disturb)
    found = diagnose(model, [recording])
    assert found.recommended == ()
    sentence = said(found)
    assert f" kg {more} on {recording.joint_names[-1]} than in the other seconds" in sentence
    assert float(sentence.partition("the robot carried ")[2].partition(" kg")[0]) == pytest.approx(2.0, rel=0.05)


def test_an_identification_and_its_verdict_say_that_seconds_stand_out():
    _, model, (start, end) = case(0, pushed)
    (warning,) = [one for one in model.warnings if "something else acted" in one]
    first, last = (float(word) for word in warning.removeprefix("From ").split(" s of ")[0].split(" to "))
    # Of the stretches that factors are kept for.
    assert start - 2.5 < first < start + 0.1
    assert end - 0.1 < last < end + 2.5
    steps = verdict(model).next_steps
    assert any(f"{first:.1f} to {last:.1f} s" in step for step in steps)


def warmed(seed: int, time_constant: float, seconds: float = 240.0, rate: float = 50.0) -> list[Recording]:
    """A cold start of an arm and another one, whose friction falls with the time of either."""
    robot, recordings = arm(("ur10", "franka_panda", "crooked")[seed % 3]), []
    effort = np.array([joint.limits.effort for joint in robot.joints])
    for k, length in ((seed, seconds), (seed + 100, 0.6 * seconds)):
        motion, rng = fourier_motion(robot, length, rate, k), np.random.default_rng(k)
        more = np.exp(-motion.t / time_constant)[:, None]
        friction = 0.03 * effort * ((1.0 + 0.3 * more) * np.sign(motion.dq) + (1.0 + 1.3 * more) * motion.dq)
        tau = pinocchio_torque(robot, motion.q, motion.dq, motion.ddq) + friction + 0.002 * effort * motion.ddq
        tau += 0.0005 * effort * rng.normal(size=tau.shape)
        recordings.append(record(robot, motion, tau, f"start{k}"))
    return recordings


@pytest.mark.parametrize(("seed", "time_constant"), [(0, 70.0), (1, 40.0), (2, 70.0), (3, 70.0)])
def test_friction_that_falls_slowly_is_no_interruption(seed, time_constant):
    recordings = warmed(seed, time_constant)[:1]
    robot = arm(("ur10", "franka_panda", "crooked")[seed % 3])
    model = identify(robot, recordings, [], IdentificationChoices(WITH_OFFSET))
    outlying = find_outlying_spans(model.data.training)
    assert outlying.spans == ()
    assert outlying.drifts
    assert [one for one in model.warnings if "changes slowly over the time" in one]
    assert not any("something else acted" in one for one in model.warnings)
    assert not any("Leave out" in step for step in verdict(model).next_steps)


def test_a_diagnosis_names_the_warm_up_also_where_the_clock_of_each_recording_starts_anew():
    recordings = warmed(0, 70.0)
    model = identify(arm("ur10"), recordings, [], IdentificationChoices(WITH_OFFSET))
    assert diagnose(model, recordings).recommended[0].effect == "warm_up_friction"


def reduction(rows: int, bad: slice, seed: int = 0, breaks: tuple[int, ...] = ()):
    """Equations of noise one, and ten in some rows, in stretches of a second; time starts anew at every break."""
    rng = np.random.default_rng(seed)
    w = rng.normal(size=(rows, 5))
    y = w @ np.arange(1.0, 6.0) + rng.normal(size=rows)
    y[bad] += 10.0 + 10.0 * w[bad, 0]
    folded = FactorAccumulator([np.arange(5)], 5, 0.999)
    for part in np.split(np.arange(rows), breaks):
        folded.push(0.02 * (part - part[0]), [np.column_stack([w, y])[part]])
        folded.end_block()
    return folded.finish()


def test_spans_that_stand_out_are_found_with_parameters_that_they_did_not_shift():
    found = find_outlying_spans(reduction(2000, slice(500, 650)))
    (span,) = found.spans
    assert (span.start, span.end) == (pytest.approx(10.0, abs=1.0), pytest.approx(13.0, abs=1.0))
    assert span.ratio > 50
    np.testing.assert_allclose(found.values, np.arange(1.0, 6.0), atol=0.1)


@pytest.mark.parametrize("seed", range(20))
def test_noise_has_no_spans_that_stand_out(seed):
    found = find_outlying_spans(reduction(1000, slice(0, 0), seed))
    assert found.spans == ()
    assert not found.drifts


def test_a_whole_run_that_differs_from_others_is_no_span():
    assert find_outlying_spans(reduction(2000, slice(500, 1000), breaks=(500, 1000, 1500))).spans == ()


def test_a_span_in_which_alone_a_joint_moves_is_not_left_out():
    robot = arm("scara")
    motion = fourier_motion(robot, DURATION, RATE, 3)
    inside = (motion.t >= 8.0) & (motion.t <= 11.0)
    moves = np.sin(np.pi * (motion.t - 8.0) / 3.0) ** 4 * inside
    motion.q[:, -1] = moves * np.sin(6.0 * motion.t)
    motion.dq[:, -1] = np.gradient(motion.q[:, -1], 1 / RATE)
    motion.ddq[:, -1] = np.gradient(motion.dq[:, -1], 1 / RATE)
    effort = np.array([joint.limits.effort for joint in robot.joints])
    rng = np.random.default_rng(0)
    friction = 0.03 * effort * (np.sign(motion.dq) + motion.dq)
    tau = pinocchio_torque(robot, motion.q, motion.dq, motion.ddq) + friction
    tau[:, :2] += 0.2 * effort[:2] * np.sin(40.0 * motion.t)[:, None] * inside[:, None]
    recording = record(robot, motion, tau + 0.002 * effort * rng.normal(size=tau.shape), "run")
    model = identify(robot, [recording], [], IdentificationChoices(WITH_OFFSET))
    # What is left without these seconds determines nothing of the last joint: the diagnosis looks at all there is.
    assert diagnose(model, [recording]).residual_rms.shape == (robot.n,)


@pytest.mark.parametrize("size", [0.0, 0.5, 1.0, 2.0, 4.0, 8.0])
@pytest.mark.parametrize("ratio", [2.0, 5.0, 25.0])
def test_bounds_of_all_spans_hide_none(size, ratio, monkeypatch):
    """Spans that the bounds rule out are those that solving without each of them rules out."""
    rng = np.random.default_rng(int(100 * size + ratio))
    accumulator = FactorAccumulator([np.arange(5), np.arange(2, 8)], 8, 1.0)
    for segment in range(2):
        t = np.arange(0.0, 12.0, 0.05) + 100.0 * segment
        disturbed = (t > 3.0) & (t < 6.5) & (segment == 0)
        rows = []
        for columns in (np.arange(5), np.arange(2, 8)):
            w = rng.normal(size=(len(t), len(columns)))
            y = w @ np.linspace(-1.0, 1.0, 8)[columns] + 0.1 * rng.normal(size=len(t)) * (1.0 + size * disturbed)
            rows.append(np.column_stack([w, y]))
        accumulator.push(t, rows)
        accumulator.end_block()
    reduction = accumulator.finish()
    found = find_outlying_spans(reduction, ratio)
    monkeypatch.setattr(outlying_spans, "_CLEARLY", 0.0)
    solved = find_outlying_spans(reduction, ratio)
    assert [(span.first, span.last) for span in found.spans] == [(span.first, span.last) for span in solved.spans]
    np.testing.assert_allclose(found.values, solved.values, rtol=1e-12)
    if (1.0 + size) ** 2 > 2.0 * ratio:
        assert found.spans


def test_where_nothing_is_disturbed_no_span_is_solved_without(monkeypatch):
    _, model, _ = case(1, untouched)

    def solve(*_):
        raise AssertionError("hundreds of windows are solved")

    monkeypatch.setattr(outlying_spans._SpanSearch, "_compute_rest_squares", solve)
    assert not find_outlying_spans(model.data.training).spans


def test_equations_of_many_joints_take_memory_for_their_own_columns_alone():
    rng = np.random.default_rng(3)
    n, rows, own = 30, 1000, 4
    truth, columns = rng.normal(size=n * own), [np.arange(own * j, own * (j + 1)) for j in range(n)]
    folded = FactorAccumulator(columns, n * own, 0.999)
    equations = []
    for joint in columns:
        w = rng.normal(size=(rows, own))
        y = w @ truth[joint] + 0.1 * rng.normal(size=rows)
        y[500:650] += 3.0
        equations.append(np.column_stack([w, y]))
    folded.push(0.02 * np.arange(rows), equations)
    data = folded.finish()
    tracemalloc.start()
    found = find_outlying_spans(data)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    (span,) = found.spans
    assert (span.start, span.end) == (pytest.approx(10.0, abs=1.0), pytest.approx(13.0, abs=1.0))
    np.testing.assert_allclose(found.values, truth, atol=0.05)
    # Products of all columns for every equation and block would be 230 MB, twice.
    assert peak < 60e6
