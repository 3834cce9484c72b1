"""Columns in another order and signs turned round are noticed with their cure; right recordings pass."""

from __future__ import annotations

import csv
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import make_interp_spline
from support.drawn_recordings import log_of
from support.oracles import Motion, arm, crooked_urdf, fourier_motion, pinocchio_torque, record

from dynident.errors import Remedy
from dynident.identification.column_inference import torque_or_current
from dynident.identification.column_inference.column_statistics import Sample
from dynident.identification.column_inference.infer_columns import propose
from dynident.identification.recording_faults import ColumnFault, build_dynamics_checks, find_recording_faults
from dynident.identification.recording_faults import unexplained_torque as judging
from dynident.identification.recording_faults.column_faults import Motion as MotionRows
from dynident.identification.recording_faults.fault_search import search_faults
from dynident.identification.recording_faults.gravity_in_torque import find_mounting
from dynident.identification.recording_faults.rows_for_fault_search import (
    estimate_delay,
    filter_motion,
    filter_whole_motion,
)
from dynident.identification.recording_faults.torque_scale import (
    are_nearer_to_others,
    compute_described_load,
    find_excess_friction,
    find_torque_scales,
    get_effort_limits,
    is_nearer_to_masses,
)
from dynident.identification.recording_faults.unexplained_torque import HeldOutFit
from dynident.recordings import (
    JointLimits,
    RecordedJoints,
    Recording,
    RecordingError,
    RecordingMetadata,
    Revision,
    import_recording,
)
from dynident.recordings.recording import ModelChecks
from dynident.recordings.recording_metadata import Check
from dynident.robot import Robot, robot_from_urdf

pytestmark = pytest.mark.sweep

ROBOT = arm("ur10")
EFFORT = np.array([joint.limits.effort for joint in ROBOT.joints])
BY_DYNAMICS = build_dynamics_checks(ROBOT)
Q, TAU = ([f"{name}{k + 1}" for k in range(6)] for name in ("q", "tau"))


@cache
def measured(seed: int = 3) -> tuple[Motion, np.ndarray]:
    motion = fourier_motion(ROBOT, 20.0, 200.0, seed)
    friction = 0.04 * EFFORT * np.sign(motion.dq) + 0.03 * EFFORT * motion.dq
    tau = pinocchio_torque(ROBOT, motion.q, motion.dq, motion.ddq) + friction
    return motion, tau + 0.005 * EFFORT * np.random.default_rng(seed).normal(size=tau.shape)


def recorded(fault: ColumnFault | None = None, seed: int = 3) -> Recording:
    motion, tau = measured(seed)
    q = motion.q
    if fault is not None:
        order, sign = np.arange(6), np.ones(6)
        if len(fault.joints) == 2:
            order[list(fault.joints)] = fault.joints[::-1]
        else:
            sign[fault.joints[0]] = -1.0
        q = q[:, order] * sign if "torque" not in fault.kind else q
        tau = tau[:, order] * sign if "position" not in fault.kind else tau
    return record(ROBOT, replace(motion, q=q), tau)


@pytest.mark.parametrize("pair", [(1, 4), (2, 3)])
def test_two_joints_that_are_turned_are_named_and_no_others(pair: tuple[int, int]) -> None:
    motion, tau = measured()
    turned = np.where(np.isin(np.arange(6), pair), -1.0, 1.0)
    found, left = find_recording_faults(ROBOT, record(ROBOT, replace(motion, q=motion.q * turned), tau * turned)) or (
        (),
        1.0,
    )
    assert {one.fault.kind for one in found} == {"joint turned"}
    assert sorted(joint for one in found for joint in one.fault.joints) == list(pair)
    assert left < 0.1


@pytest.mark.parametrize("joint", [1, 2])
def test_a_weak_torque_is_named_although_gravity_gives_more_work_back_than_it_seems_to_do(joint: int) -> None:
    motion, tau = measured(4)
    weak = np.where(np.arange(6) == joint, 0.11, 1.0)
    found, _ = find_recording_faults(ROBOT, record(ROBOT, motion, tau * weak)) or ((), 1.0)
    assert [(one.fault.kind, one.fault.joints) for one in found] == [("torque scaled", (joint,))]


def test_a_right_recording_has_no_mistake_in_it_and_it_is_said_how_much_the_robot_leaves() -> None:
    found, left = find_recording_faults(ROBOT, recorded()) or ((), 1.0)
    assert found == ()
    assert left < 0.1


@pytest.mark.parametrize(
    "made",
    [
        ColumnFault("torques swapped", (0, 1)),
        ColumnFault("torques swapped", (3, 4)),
        ColumnFault("positions swapped", (1, 2)),
        ColumnFault("joints swapped", (0, 2)),
        ColumnFault("torque turned", (1,)),
        ColumnFault("torque turned", (4,)),
        ColumnFault("position turned", (2,)),
        ColumnFault("joint turned", (1,)),
    ],
    ids=str,
)
def test_a_mistake_is_named(made: ColumnFault) -> None:
    found, left = find_recording_faults(ROBOT, recorded(made)) or ((), 1.0)
    assert len(found) == 1
    assert made in (found[0].fault, *found[0].alike)
    assert found[0].left_with > 1.1 * found[0].left_without
    assert left == pytest.approx(found[0].left_without)


def test_a_wrist_whose_torque_is_turned_round_is_told_by_its_friction() -> None:
    told = build_dynamics_checks(ROBOT)(recorded(ColumnFault("torque turned", (5,))), Q, TAU)
    assert told is not None
    (wrong,) = [one for one in told if one.status == "error"]
    assert wrong.name == "torque_sign"
    assert "friction would drive the joint" in wrong.detail


def test_a_wrist_whose_torque_falls_with_its_speed_but_not_its_dry_friction_is_not_turned_round() -> None:
    motion, tau = measured()
    # As of a current that is read at the end of each step of a servo's command: more speed, less torque.
    falling = 0.07 * EFFORT[5] * motion.dq[:, 5]
    assert np.mean((0.04 * EFFORT[5] * np.sign(motion.dq[:, 5]) - falling) * np.sign(motion.dq[:, 5])) < 0.0
    early = tau.copy()
    early[:, 5] -= 0.03 * EFFORT[5] * motion.dq[:, 5] + falling
    found, _ = find_recording_faults(ROBOT, record(ROBOT, motion, early)) or ((), 1.0)
    assert found == ()


def test_of_a_motor_that_hardly_works_no_sign_is_turned_without_asking() -> None:
    motion, tau = measured()
    # As much friction as a motor has that is off, and more: a sixth of the drives beside it.
    own = 0.04 * EFFORT * np.sign(motion.dq) + 0.03 * EFFORT * motion.dq
    weak = (tau - 0.6 * own * (np.arange(6) == 5)) * [1, 1, 1, 1, 1, -1]
    (wrong,) = [
        one for one in build_dynamics_checks(ROBOT)(record(ROBOT, motion, weak), Q, TAU) or () if one.status != "ok"
    ]
    assert (wrong.name, wrong.status) == ("torque_sign", "warning")
    assert wrong.apply == Revision(signs={"tau6": -1.0})


def test_a_robot_on_a_wall_is_not_refused_for_columns_in_another_order() -> None:
    for gravity in ([0, -9.81, 0], [9.81, 0, 0], [0, 0, 9.81]):
        leaning = Robot(ROBOT.name, ROBOT.joints, np.array(gravity), ROBOT.drives, ROBOT.description, ROBOT.inertias)
        motion, tau = measured()
        load = [pinocchio_torque(one, motion.q, motion.dq, motion.ddq) for one in (ROBOT, leaning)]
        hung = record(ROBOT, motion, tau - load[0] + load[1])
        told = build_dynamics_checks(ROBOT)(hung, Q, TAU)
        assert told is not None
        assert all(one.status != "error" for one in told)
        assert all("gravity" in one.detail for one in told if one.status == "warning")


def test_two_mistakes_at_once_are_both_named() -> None:
    motion, tau = measured()
    wrong = tau[:, [1, 0, 2, 3, 4, 5]] * [1, 1, -1, 1, 1, 1]
    found, _ = find_recording_faults(ROBOT, record(ROBOT, motion, wrong)) or ((), 1.0)
    assert {one.fault for one in found} == {
        ColumnFault("torques swapped", (0, 1)),
        ColumnFault("torque turned", (2,)),
    }


@pytest.mark.parametrize("order", [(1, 2, 0, 3, 4, 5), (0, 1, 3, 4, 2, 5)])
def test_torques_in_a_ring_are_one_order_by_the_columns_of_the_file(order: tuple[int, ...]) -> None:
    motion, tau = measured()
    found, _ = find_recording_faults(ROBOT, record(ROBOT, motion, tau[:, order])) or ((), 1.0)
    assert len(found) == 1
    assert found[0].certain
    assert dict(found[0].fault.places) == {joint: order.index(joint) for joint in range(6) if order[joint] != joint}


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("order", [(1, 2, 0), (2, 0, 1)])
def test_a_look_at_a_file_asks_once_for_an_order_of_three_torques(
    seed: int, order: tuple[int, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    # As on arms of which a wrong order leaves nothing explained, so that the torques look like external ones.
    monkeypatch.setattr(torque_or_current, "_NOTHING", 0.3)
    drawn = log_of(robot_from_urdf("drawn.urdf", crooked_urdf(3, seed, ())), 3)
    values = np.column_stack([drawn.t, drawn.q, drawn.tau[:, order]])
    found = propose(Sample(("t", *Q[:3], *TAU[:3]), values, {}), drawn.robot)
    (question,) = found.questions
    remedy = Remedy("columns", {TAU[joint]: TAU[order.index(joint)] for joint in range(3)})
    assert (question.check, question.remedies) == ("torque_order", (remedy,))
    assert found.effort_kind == "joint_torque"


def test_a_motion_that_is_too_short_to_tell_is_not_judged() -> None:
    motion, tau = measured()
    few = slice(0, 300)
    short = Motion(motion.t[few], motion.q[few], motion.dq[few], motion.ddq[few])
    assert find_recording_faults(ROBOT, record(ROBOT, short, tau[few])) is None
    assert build_dynamics_checks(ROBOT)(record(ROBOT, short, tau[few]), Q, TAU) is None


def test_a_robot_too_long_to_be_tried_while_somebody_waits_is_not_judged() -> None:
    long = Robot(ROBOT.name, ROBOT.joints * 3, ROBOT.gravity, ROBOT.drives * 3, ROBOT.description, None)
    assert find_recording_faults(long, recorded()) is None


def test_every_kind_of_finding_says_what_is_wrong_and_what_would_be_right() -> None:
    check = build_dynamics_checks(ROBOT)
    words = {
        ColumnFault("torques swapped", (0, 1)): ("torque_order", '"tau1": "tau2", "tau2": "tau1"'),
        ColumnFault("positions swapped", (1, 2)): ("joint_order", '"q2": "q3", "q3": "q2"'),
        ColumnFault("torque turned", (1,)): ("torque_sign", "tau2"),
        ColumnFault("position turned", (2,)): ("joint_sign", "q3"),
    }
    for made, (name, cure) in words.items():
        told = check(recorded(made), Q, TAU)
        assert told is not None
        (wrong,) = [one for one in told if one.status == "error"]
        assert wrong.name == name
        assert cure in wrong.detail
        assert {one.name for one in told} == {"torque_order", "joint_order", "torque_sign", "joint_sign"}
        assert wrong.apply is not None
    assert {one.status for one in check(recorded(), Q, TAU) or ()} == {"ok"}


def written(path: Path, order: list[int], tau: np.ndarray | None = None) -> Path:
    motion, usual = measured()
    tau = usual if tau is None else tau
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["t", *Q, *TAU])
        writer.writerows(np.column_stack([motion.t, motion.q, tau[:, order]]))
    return path


def brought_in(
    path: Path, *accept: str, against: ModelChecks | None = BY_DYNAMICS
) -> tuple[Recording, tuple[Check, ...]]:
    return import_recording(
        path,
        path.with_suffix(".checked.parquet"),
        RecordedJoints(
            ROBOT.joint_names,
            limits=[
                JointLimits(one.kind, one.limits.position, one.limits.velocity, one.limits.effort)
                for one in ROBOT.joints
            ],
        ),
        metadata=RecordingMetadata(accept=accept),
        against=against,
    )


def test_a_file_with_torques_in_another_order_is_refused_unless_its_user_knows_better(tmp_path: Path) -> None:
    wrong = written(tmp_path / "wrong.csv", [1, 0, 2, 3, 4, 5])
    with pytest.raises(RecordingError, match="are exchanged") as refused:
        brought_in(wrong)
    assert refused.value.pointer == "tau1"
    assert brought_in(wrong, "torque_order")[0].n == 6
    assert brought_in(written(tmp_path / "right.csv", [0, 1, 2, 3, 4, 5]))[0].n == 6


def moved(seconds: float) -> Recording:
    """The recording with its torque late by so much."""
    motion, tau = measured()
    late = np.stack([np.interp(motion.t - seconds, motion.t, column) for column in tau.T], axis=1)
    return record(ROBOT, motion, late)


@pytest.mark.parametrize(("drift", "jump"), [(0.002, 0.0), (0.0, 0.03)])
def test_a_delay_that_changes_is_told_without_a_cure(drift: float, jump: float) -> None:
    motion, tau = measured()
    later = motion.t - motion.t.mean()
    clock = motion.t - 0.03 - drift * later - 0.5 * jump * np.sign(later)
    late = np.stack([np.interp(clock, motion.t, column) for column in tau.T], axis=1)
    checks = {check.name: check for check in build_dynamics_checks(ROBOT)(record(ROBOT, motion, late), Q, TAU) or ()}
    delay = checks["torque_delay"]
    assert (delay.status, delay.apply) == ("warning", None)
    assert "a clock drifts, or has jumped" in delay.detail


@pytest.mark.parametrize("seconds", [0.02, 0.035, -0.02])
def test_a_delay_that_no_right_log_has_is_told_with_its_cure(seconds: float) -> None:
    told = {one.name: one for one in build_dynamics_checks(ROBOT)(moved(seconds), Q, TAU) or ()}
    delay = told["torque_delay"]
    assert delay.status == "warning"
    assert ("late" if seconds > 0 else "early") in delay.detail
    assert delay.apply is not None
    assert delay.apply.torque_delay == pytest.approx(seconds, abs=0.003)
    assert "clock" not in delay.detail


@pytest.mark.parametrize("seconds", [0.0, 0.008])
def test_delays_that_drives_have_are_no_mistake(seconds: float) -> None:
    told = {one.name: one for one in build_dynamics_checks(ROBOT)(moved(seconds), Q, TAU) or ()}
    assert told["torque_delay"].status == "ok"


def test_friction_whose_corners_come_early_is_no_early_torque_where_the_dynamics_tell(tmp_path: Path) -> None:
    motion, tau = measured()
    ahead = np.stack([np.interp(motion.t + 0.012, motion.t, column) for column in motion.dq.T], axis=1)
    early = tau + 0.3 * 0.04 * EFFORT * (np.sign(ahead) - np.sign(motion.dq))
    path = written(tmp_path / "early.csv", list(range(6)), early)
    alone, told = ({one.name: one for one in brought_in(path, against=one)[1]} for one in (None, BY_DYNAMICS))
    assert alone["torque_delay"].status != "ok"
    assert "early" in alone["torque_delay"].detail
    assert told["torque_delay"].status == "ok"


@pytest.mark.parametrize("factor", [10.0, 1000.0, 0.1])
def test_a_torque_in_another_unit_is_told_by_the_masses_of_the_description(factor: float) -> None:
    assert ROBOT.inertias is not None
    motion, tau = measured()
    scaled = record(ROBOT, motion, tau * np.where(np.arange(6) == 2, factor, 1.0))
    told = {one.name: one for one in build_dynamics_checks(ROBOT)(scaled, Q, TAU) or ()}
    assert told["torque_scale"].status in ("warning", "error")
    assert told["torque_scale"].apply is not None
    assert told["torque_scale"].apply.scale == {"tau3": pytest.approx(1.0 / factor)}
    assert {one.name: one.status for one in build_dynamics_checks(ROBOT)(recorded(), Q, TAU) or ()}[
        "torque_scale"
    ] == "ok"


def test_a_description_without_masses_tells_nothing_of_units() -> None:
    bare = replace(ROBOT, inertias=None)
    assert "torque_scale" not in {one.name for one in build_dynamics_checks(bare)(recorded(), Q, TAU) or ()}


def without_gravity(share: float) -> Recording:
    motion, tau = measured()
    still = np.zeros_like(motion.dq)
    return record(ROBOT, motion, tau - share * pinocchio_torque(ROBOT, motion.q, still, still))


def test_gravity_compensated_torque_is_refused_with_that_word() -> None:
    told = {one.name: one for one in build_dynamics_checks(ROBOT)(without_gravity(1.0), Q, TAU) or ()}
    assert told["gravity_load"].status == "error"
    assert "gravity-compensated" in told["gravity_load"].detail


def test_torque_with_most_of_its_gravity_is_not() -> None:
    assert "gravity_load" not in {one.name for one in build_dynamics_checks(ROBOT)(without_gravity(0.4), Q, TAU) or ()}


@pytest.mark.parametrize("gravity", [(9.81, 0.0, 0.0), (0.0, 0.0, 9.81)], ids=["wall", "ceiling"])
def test_a_robot_that_is_said_to_stand_elsewhere_is_told_where_gravity_pulls(gravity: tuple[float, ...]) -> None:
    motion = filter_motion(recorded())
    assert motion is not None
    found = find_mounting(replace(ROBOT, gravity=np.array(gravity)), motion)
    assert found.is_sure
    assert found.gravity.tolist() == [0, 0, -9.81]
    assert found.unexplained < found.unexplained_as_stated or gravity[2] > 0


def test_a_torque_that_is_ten_times_off_is_found_from_the_other_joints_without_any_mass() -> None:
    motion, tau = measured()
    scaled = record(ROBOT, motion, tau * np.where(np.arange(6) == 2, 10.0, 1.0))
    told = {one.name: one for one in build_dynamics_checks(replace(ROBOT, inertias=None))(scaled, Q, TAU) or ()}
    # Coupled drives look like it, so that it is no reason to refuse a recording.
    assert told["torque_scale"].status == "warning"
    assert told["torque_scale"].apply is not None
    assert told["torque_scale"].apply.scale == {"tau3": pytest.approx(0.1)}


def test_a_torque_that_the_masses_explain_is_in_no_other_unit() -> None:
    motion, tau = measured()
    given = filter_motion(recorded())
    ten_times = filter_motion(record(ROBOT, motion, 10.0 * tau))
    assert given is not None
    assert ten_times is not None
    load = compute_described_load(ROBOT, given)
    assert not any(is_nearer_to_masses(load, given, joint, factor) for joint in (1, 2) for factor in (1e-3, 0.1, 1e3))
    assert all(is_nearer_to_masses(load, ten_times, joint, 0.1) for joint in (1, 2))
    assert compute_described_load(replace(ROBOT, inertias=None), given) is None
    assert is_nearer_to_masses(None, given, 1, 0.1)


@pytest.mark.parametrize("joint", [0, 4, 5])
def test_a_torque_that_is_ten_times_too_large_is_told_by_friction_where_masses_tell_nothing(joint: int) -> None:
    motion, tau = measured()
    scaled = record(ROBOT, motion, tau * np.where(np.arange(6) == joint, 10.0, 1.0))
    told = {one.name: one for one in build_dynamics_checks(ROBOT)(scaled, Q, TAU) or ()}
    assert told["torque_scale"].status == "warning"
    assert told["torque_scale"].apply is not None
    assert told["torque_scale"].apply.scale == {f"tau{joint + 1}": pytest.approx(0.1)}


def test_friction_is_held_against_what_the_drives_can_give_or_against_the_other_joints() -> None:
    usual = 0.06 * EFFORT * np.ones((10, 6))
    assert find_excess_friction(ROBOT, usual) == {}
    for joint in range(6):
        large = usual * np.where(np.arange(6) == joint, 10.0, 1.0)
        assert find_excess_friction(ROBOT, large) == {joint: pytest.approx(10.0)}
    # Of limits that are a placeholder, nothing is to be had.
    joints = tuple(replace(one, limits=replace(one.limits, effort=10_000.0)) for one in ROBOT.joints)
    unlimited = replace(ROBOT, joints=joints)
    assert get_effort_limits(unlimited) is None
    alike = np.array([20.0, 22.0, 18.0, 6.0, 5.0, 6.0]) * np.ones((10, 6))
    assert find_excess_friction(unlimited, alike) == {}
    for joint in range(6):
        assert set(find_excess_friction(unlimited, alike * np.where(np.arange(6) == joint, 10.0, 1.0))) == {joint}


def test_friction_that_the_data_do_not_tell_is_held_against_nothing() -> None:
    scaled = 0.06 * EFFORT * np.where(np.arange(6) == 4, 10.0, 1.0) * np.ones((10, 6))
    unsure = scaled * np.where((np.arange(10)[:, None] % 2 == 0) & (np.arange(6) == 4), 0.3, 1.0)
    still = np.where(np.arange(6) == 4, np.nan, scaled)
    assert find_excess_friction(ROBOT, scaled) == {4: pytest.approx(10.0)}
    assert find_excess_friction(ROBOT, unsure) == find_excess_friction(ROBOT, still) == {}


def test_a_torque_whose_friction_is_as_the_others_is_in_no_other_unit() -> None:
    usual = 0.06 * EFFORT * np.ones((10, 6))
    large = usual * np.where(np.arange(6) == 4, 10.0, 1.0)
    assert not any(are_nearer_to_others(ROBOT, usual, [4], factor) for factor in (1e-3, 0.1, 10.0))
    assert are_nearer_to_others(ROBOT, large, [4], 0.1)
    assert not are_nearer_to_others(ROBOT, large, [4], 1e-3)
    assert are_nearer_to_others(ROBOT, np.full((10, 6), np.nan), [4], 1e-3)
    # Most joints in another unit: of each by itself the others say nothing, of all of them the first one does.
    outer = usual * np.where(np.arange(6) >= 1, 100.0, 1.0)
    assert are_nearer_to_others(ROBOT, outer, range(1, 6), 0.01)
    assert not are_nearer_to_others(ROBOT, outer, [4], 0.01)


def test_a_load_that_shows_in_a_part_of_the_motion_alone_tells_nothing_of_the_unit() -> None:
    given = filter_motion(recorded())
    assert given is not None
    load = compute_described_load(ROBOT, given)
    assert load is not None
    times = np.where(np.isin(given.block, (3, 4, 5)), 60.0, 0.0)[:, None]
    assert {one.joint for one in find_torque_scales(ROBOT, replace(given, tau=12.0 * load), {}) or ()} == set(range(6))
    assert find_torque_scales(ROBOT, replace(given, tau=times * load), {}) == ()


@pytest.mark.parametrize(("inside", "is_above"), [(-0.5, True), (-0.05, False)])
def test_what_helps_only_where_nothing_was_fitted_is_no_mistake(inside: float, is_above: bool) -> None:
    noise, moving = 0.01 * np.random.default_rng(4).normal(size=10), np.ones(6, dtype=bool)
    shares = np.full(6, 0.1)
    now, other = (
        judging.UnexplainedTorque(noise, 0.0, 0, moving, shares, noise, 0.0),
        judging.UnexplainedTorque(noise[::-1] - 0.5, inside, 0, moving, shares, noise[::-1] - 0.5, inside),
    )
    assert now.is_surely_above(other) is is_above


@pytest.mark.parametrize(("apart", "named"), [(0.9, []), (0.3, [ColumnFault("joint turned", (2,))])])
def test_a_joint_that_is_explained_as_well_apart_from_the_others_is_not_said_to_be_turned_round(
    apart: float, named: list[ColumnFault], monkeypatch: pytest.MonkeyPatch
) -> None:
    given = filter_motion(recorded(ColumnFault("joint turned", (2,))))
    assert given is not None
    usual = HeldOutFit.measure_unexplained

    def left(judge: HeldOutFit, motion: MotionRows) -> judging.UnexplainedTorque:
        found = usual(judge, motion)
        small = np.abs(motion.tau[:, 2]).max() < 0.01 * np.abs(given.tau[:, 2]).max()
        if not small:
            return found
        # The elbow does not go with the others, and is explained where they do not speak of it.
        worst, best = usual(judge, given), usual(judge, ColumnFault("joint turned", (2,)).mend(given))
        return replace(found, blocks=worst.blocks + apart * (best.blocks - worst.blocks), inside=best.inside)

    monkeypatch.setattr(HeldOutFit, "measure_unexplained", left)
    found, _ = search_faults(ROBOT, given) or ((), 1.0)
    assert [one.fault for one in found] == named


@dataclass(frozen=True)
class Left:
    """What a motion whose torque is moved by some seconds is said to leave."""

    fine: np.ndarray
    fine_inside: float


@pytest.mark.parametrize(("inside", "beside", "is_fault"), [(1.0, 1.0, True), (0.05, 1.0, False), (1.0, 0.05, False)])
def test_a_delay_that_helps_only_where_nothing_was_fitted_or_without_constant_torques_is_none(
    inside: float, beside: float, is_fault: bool
) -> None:
    whole = filter_whole_motion(moved(0.0))
    assert whole is not None
    motion, period = whole
    noise = 0.001 * np.random.default_rng(2).normal(size=10)

    def left(tried: MotionRows, share: float = 1.0) -> Left:
        late = float(np.argmin([np.square(tried.tau - row).sum() for row in shifted])) * 0.001 - 0.05
        fall = 20.0 * abs(late - 0.03) * share
        return Left(fall + noise, inside * fall)

    rows = np.arange(len(motion.tau), dtype=np.float64)
    torque = make_interp_spline(rows, motion.tau, k=3)
    shifted = [torque(np.clip(rows + (k * 0.001 - 0.05) / period, 0.0, rows[-1])) for k in range(101)]
    found = estimate_delay(motion, period, left, lambda tried: left(tried, beside))
    assert found is not None
    assert found.seconds == pytest.approx(0.03, abs=0.003)
    assert found.is_fault is is_fault


def steps(seed: int, seconds: float = 8.0, rate: float = 200.0) -> Motion:
    """From one drawn posture to the next, four times, with a short stop at each."""
    rng = np.random.default_rng(seed)
    t = np.arange(round(seconds * rate)) / rate
    postures = np.array([0.0, -1.2, 1.2, 0.0, 0.0, 0.0]) + rng.uniform(-1.0, 1.0, size=(5, 6))
    each = seconds / 4
    way, move = np.diff(postures, axis=0), np.minimum((t / each).astype(int), 3)
    s = np.clip((t - move * each) / (0.9 * each), 0.0, 1.0)[:, None]
    moving = s < 1.0
    q = postures[move] + (10 * s**3 - 15 * s**4 + 6 * s**5) * way[move]
    dq = (30 * s**2 - 60 * s**3 + 30 * s**4) * moving * way[move] / (0.9 * each)
    ddq = (60 * s - 180 * s**2 + 120 * s**3) * moving * way[move] / (0.9 * each) ** 2
    return Motion(t, q, dq, ddq)


def short_run(seed: int, order: list[int]) -> Recording:
    """A short recording of an arm whose drives have constant torques of a twelfth of what they can give."""
    motion, rng = steps(seed), np.random.default_rng([seed, 1])
    friction = 0.04 * EFFORT * np.sign(motion.dq) + 0.03 * EFFORT * motion.dq
    constant = 0.08 * EFFORT * rng.choice([-1.0, 1.0], size=6)
    tau = pinocchio_torque(ROBOT, motion.q, motion.dq, motion.ddq) + friction + constant
    return record(ROBOT, motion, (tau + 0.005 * EFFORT * rng.normal(size=tau.shape))[:, order])


@pytest.mark.parametrize("seed", [0, 3, 5, 10, 13])
def test_constant_torques_do_not_make_a_short_right_recording_one_with_columns_in_another_order(seed: int) -> None:
    found, _ = find_recording_faults(ROBOT, short_run(seed, [0, 1, 2, 3, 4, 5])) or ((), 1.0)
    assert found == ()


@pytest.mark.parametrize("seed", [0, 10])
def test_a_mistake_is_named_beside_constant_torques_too(seed: int) -> None:
    found, _ = find_recording_faults(ROBOT, short_run(seed, [0, 2, 1, 3, 4, 5])) or ((), 1.0)
    assert [one.fault for one in found] == [ColumnFault("torques swapped", (1, 2))]


def test_a_torque_that_was_not_recorded_does_not_spoil_the_fit_of_the_others() -> None:
    motion, tau = measured()
    rows = filter_motion(record(ROBOT, motion, np.where(np.arange(6) == 0, 0.0, tau)))
    assert rows is not None
    shares = HeldOutFit(ROBOT).measure_unexplained(rows).joints
    assert shares[0] == 0.0
    assert shares[1:].max() < 0.1


def test_a_command_is_told_where_a_joint_without_a_load_has_no_torque_at_all(tmp_path: Path) -> None:
    motion, _ = measured()
    still = np.zeros_like(motion.q)
    load = pinocchio_torque(ROBOT, motion.q, still, still)
    assert np.ptp(load[:, 0]) == pytest.approx(0.0, abs=1e-9)
    with pytest.raises(RecordingError) as refused:
        brought_in(written(tmp_path / "command.csv", list(range(6)), np.where(np.arange(6) == 0, 0.0, load)))
    wrong = [one.name for one in refused.value.checks if one.status == "error"]
    assert wrong == ["commanded_torque", "constant_torque"]
