"""Half a dozen moves in which half of the joints stay: what so little data say of the order of columns."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.oracles import Motion, arm, fourier_motion, pinocchio_torque, record

from dynident.identification.recording_faults import ColumnFault, find_recording_faults, gravity_in_torque
from dynident.identification.recording_faults.column_faults import Motion as MotionRows
from dynident.identification.recording_faults.description_fit import DescriptionFit, measure_left_by_description
from dynident.identification.recording_faults.fault_checks import _report_fault
from dynident.identification.recording_faults.fault_search import DetectedFault
from dynident.identification.recording_faults.rows_for_fault_search import filter_motion
from dynident.identification.recording_faults.tree_fit import BLOCKS, GramMatrices
from dynident.identification.recording_faults.unexplained_torque import HeldOutFit
from dynident.recordings import Recording
from dynident.robot.pinocchio_conversion import compute_described_torque

ROBOT = arm("ur10")
EFFORT = np.array([joint.limits.effort for joint in ROBOT.joints])
MOVES, SECONDS, RATE = 5, 8.0, 200.0


def moves(seed: int) -> Motion:
    """From posture to posture, each joint staying in half of the moves."""
    rng = np.random.default_rng([seed, 7])
    t = np.arange(round(SECONDS * RATE)) / RATE
    each, n = SECONDS / MOVES, ROBOT.n
    way = rng.uniform(-1.0, 1.0, size=(MOVES, n)) * (rng.random((MOVES, n)) > 0.5)
    start = np.array([0.0, -1.2, 1.2, 0.0, 0.0, 0.0]) + np.vstack([np.zeros(n), np.cumsum(way, axis=0)[:-1]])
    move, time = np.minimum((t / each).astype(int), MOVES - 1), 0.8 * each
    s = np.clip((t - move * each) / time, 0.0, 1.0)[:, None]
    q = start[move] + (10 * s**3 - 15 * s**4 + 6 * s**5) * way[move]
    dq = (30 * s**2 - 60 * s**3 + 30 * s**4) * way[move] / time
    ddq = (60 * s - 180 * s**2 + 120 * s**3) * (s < 1.0) * way[move] / time**2
    return Motion(t, q, dq, ddq)


def recorded(seed: int, order: tuple[int, ...] = (0, 1, 2, 3, 4, 5)) -> Recording:
    """With friction that falls from rest and grows with the load, which nothing that is fitted has."""
    motion, rng = moves(seed), np.random.default_rng([seed, 1])
    torque = pinocchio_torque(ROBOT, motion.q, motion.dq, motion.ddq)
    falling = 0.04 * np.sign(motion.dq) * (1 + 0.5 * np.exp(-np.abs(motion.dq) / 0.2))
    friction = EFFORT * (falling + 0.03 * motion.dq) + 0.1 * np.abs(torque) * np.sign(motion.dq)
    noise = 0.005 * EFFORT * rng.normal(size=torque.shape)
    return record(ROBOT, motion, (torque + friction + noise)[:, list(order)])


@pytest.mark.parametrize("seed", [5, 14])
def test_right_columns_stay_right_where_a_fit_explains_another_order_better_by_chance(seed: int) -> None:
    found, _ = find_recording_faults(ROBOT, recorded(seed)) or ((), 1.0)
    assert found == ()


def test_the_masses_of_the_description_refute_another_order(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(DescriptionFit, "refutes", lambda self, fault: False)
    found, _ = find_recording_faults(ROBOT, recorded(5)) or ((), 1.0)
    assert found


@pytest.mark.parametrize("seed", [3, 5, 33])
def test_of_several_orders_that_explain_more_the_one_is_named_that_the_description_bears_out(seed: int) -> None:
    found, _ = find_recording_faults(ROBOT, recorded(seed, (0, 2, 1, 3, 4, 5))) or ((), 1.0)
    assert [one.fault for one in found] == [ColumnFault("torques swapped", (1, 2))]


def test_a_description_without_masses_refutes_nothing() -> None:
    bare = replace(ROBOT, inertias=None)
    motion = filter_motion(recorded(5))
    assert motion is not None
    assert measure_left_by_description(bare, motion) is None
    assert not DescriptionFit(bare, motion, HeldOutFit(bare).measure_unexplained(motion)).refutes(
        ColumnFault("joints swapped", (4, 5))
    )


@pytest.mark.parametrize(
    ("left", "is_refuted", "is_borne_out"),
    [(-1.93, True, False), (-1.98, True, False), (-2.03, False, True), (-2.15, False, True), (-1.5, True, False)],
)
def test_a_description_that_explains_as_much_as_a_fit_decides_between_faults(
    left: float, is_refuted: bool, is_borne_out: bool
) -> None:
    """Of right recordings, without a fault it leaves as much, to 0.02 a joint; of wrong ones, 0.09 less and more."""
    motion = filter_motion(recorded(5))
    assert motion is not None
    blocks, fault = np.full(10, -1.95), ColumnFault("joints swapped", (4, 5))
    now = replace(HeldOutFit(ROBOT).measure_unexplained(motion), blocks=blocks)
    described, scatter = DescriptionFit(ROBOT, motion, now), 0.4 * np.cos(np.arange(10) * np.pi)
    described.__dict__["_left_as_is"] = np.full(10, -1.94)
    described._blocks_by_fault[fault] = left + scatter
    assert described.refutes(fault) is is_refuted
    assert described.bears_out(fault, replace(now, blocks=np.full(10, left))) is is_borne_out
    assert described.compute_shares(fault) == pytest.approx((np.exp(-1.94), np.exp(left)))
    # Where a fit explains far more than the description, what the description leaves proves nothing.
    assert not described.bears_out(fault, replace(now, blocks=np.full(10, left - 1.0)))


def test_friction_that_has_another_sign_tells_a_turned_sign_and_nothing_else() -> None:
    motion = filter_motion(recorded(5))
    assert motion is not None
    mended = HeldOutFit(ROBOT).measure_unexplained(motion)
    now = replace(mended, against=mended.against + 1)
    assert now.is_surely_above(mended)
    assert not now.is_surely_above(mended, by_friction=False)


def test_a_fault_that_the_masses_alone_tell_is_reported_with_what_they_leave() -> None:
    names = [f"q{k + 1}" for k in range(6)], [f"tau{k + 1}" for k in range(6)]
    fault = DetectedFault(ColumnFault("joint zero", (3,), 1.2), (), 0.1, 0.1, False, (0.4, 0.08))
    check = _report_fault(fault, recorded(5), *names)
    assert "the masses of the description leave 40" in check.detail
    assert "friction would drive" not in check.detail


def test_what_one_part_of_a_recording_has_leaves_nothing_but_what_the_others_have() -> None:
    (judge,), rng = HeldOutFit(ROBOT)._trees, np.random.default_rng(4)
    c = judge.n_columns
    rows = rng.normal(size=(BLOCKS, 2 * c, c + 1))
    # Next to nothing but in one block: a difference of sums would be rounding.
    rows[:, :, 0] *= np.where(np.arange(BLOCKS) == 4, 1e3, 1e-9)[:, None]
    each = np.repeat(np.einsum("bmi,bmk->bik", rows, rows)[:, None] / ROBOT.n, ROBOT.n, axis=1)
    whole = np.concatenate([each, each.sum(axis=0, keepdims=True)])
    grams = GramMatrices(whole[..., :-1, :-1], whole[..., :-1, -1], whole[..., -1, -1])
    others = np.delete(rows, 4, axis=0).reshape(-1, c + 1)
    told, *_ = np.linalg.lstsq(others[:, :-1], others[:, -1])
    found = judge._fit_all_but_each(grams, np.ones(ROBOT.n))[4]
    assert others[:, :-1] @ found == pytest.approx(others[:, :-1] @ told, abs=1e-4)


@pytest.mark.parametrize(
    ("taken_out", "error", "zero", "is_refused"),
    [(0.0, 0.1, 0.0, False), (0.0, 0.1, 1.5, False), (1.0, 0.1, 0.0, True), (1.0, 3.0, 0.0, False)],
)
def test_gravity_is_not_said_to_be_missing_where_the_description_bears_it_out_or_motion_tells_too_little(
    taken_out: float, error: float, zero: float, is_refused: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    motion = filter_motion(recorded(3))
    assert motion is not None
    load = compute_described_torque(ROBOT, motion.q, np.zeros_like(motion.q), np.zeros_like(motion.q))
    # A joint that was not homed has its load at other angles.
    q = motion.q + zero * (np.arange(6) == 1)
    given = replace(motion, q=q, tau=motion.tau - taken_out * load)
    told = gravity_in_torque.LoadShares(gravity=0.76, motion=5.9, motion_error=error)
    monkeypatch.setattr(gravity_in_torque, "measure_load_shares", lambda *_: told)
    monkeypatch.setattr(
        gravity_in_torque, "measure_unexplained_share", lambda robot, _: 0.08 if robot.gravity.any() else 0.07
    )
    assert gravity_in_torque.detect_compensated_gravity(ROBOT, given) == (told if is_refused else None)


def test_the_share_of_motion_is_told_with_its_error_which_few_moves_make_large() -> None:
    few, many = (gravity_in_torque.measure_load_shares(ROBOT, one) for one in (filter_motion(recorded(3)), fourier()))
    assert few is not None
    assert many is not None
    assert many.motion == pytest.approx(1.0, abs=4 * many.motion_error)
    assert many.motion_error < 0.1 < few.motion_error


def fourier() -> MotionRows:
    """Rows of a motion that tells much, of the same length."""
    motion = fourier_motion(ROBOT, SECONDS, RATE, 3)
    torque = pinocchio_torque(ROBOT, motion.q, motion.dq, motion.ddq) + 0.04 * EFFORT * np.sign(motion.dq)
    found = filter_motion(
        record(ROBOT, motion, torque + 0.005 * EFFORT * np.random.default_rng(3).normal(size=torque.shape))
    )
    assert found is not None
    return found
