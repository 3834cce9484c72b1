from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from dynident.effects import EffectChoice
from dynident.errors import Cancelled, DynidentError
from dynident.excitation import Design, DesignRequest, TrajectoryRequest, design_experiment
from dynident.excitation.criteria.design_criterion import build_design_criterion
from dynident.excitation.design_observation_matrix import build_design_model
from dynident.excitation.point_sequence import FreePoints, MovePlanner, PointSequence, TwoPoints, stack_rows
from dynident.motion.collision.obstacle_geometry import Surroundings
from dynident.motion.limits.bounds import build_bounds
from dynident.robot import Limits, Robot, to_pinocchio

EFFECTS = tuple(EffectChoice(name) for name in ("rigid_body", "coulomb", "viscous"))
QUICK = DesignRequest(
    effects=EFFECTS,
    trajectory=TrajectoryRequest(family="point_to_point", points=6, sampling_rate=200.0),
    starts=1,
    random_trajectories=10,
    surroundings=Surroundings(self_collision=False),
)


def standstills(design: Design) -> list[np.ndarray]:
    """Postures inside the exciting part in which all joints rest at once."""
    first, last = (round(at * design.sampling_rate) for at in design.exciting)
    speeds = np.abs(design.dq).max(axis=1)
    return [design.q[k] for k in range(first, last) if speeds[k] < 1e-12]


def assert_within(robot: Robot, design: Design, stated: dict[str, Limits]) -> None:
    """By the samples, their differences, and Pinocchio."""
    model = to_pinocchio(robot)
    data = model.createData()
    tau = np.array([pin.rnea(model, data, *s) for s in zip(design.q, design.dq, design.ddq, strict=True)])
    slope = np.diff(design.q, axis=0) * design.sampling_rate
    for j, joint in enumerate(robot.joints):
        for limits in (joint.limits, stated.get(joint.name, Limits())):
            if limits.position is not None:
                assert limits.position[0] <= design.q[:, j].min()
                assert design.q[:, j].max() <= limits.position[1]
            for bound, signal in (
                (limits.velocity, slope),
                (limits.velocity, design.dq),
                (limits.acceleration, design.ddq),
                (limits.effort, tau),
            ):
                assert bound is None or np.abs(signal[:, j]).max() <= bound * (1 + 1e-9)


def test_the_best_points_found_are_better_than_the_best_random_ones_and_keep_the_limits(ur10):
    stated = {"elbow_joint": Limits(velocity=0.8, position=(-1.0, 1.5)), "shoulder_lift_joint": Limits(effort=200.0)}
    design = design_experiment(ur10, replace(QUICK, limits=stated))
    assert design.baseline is not None
    assert design.criterion_values.condition_number < 0.7 * design.baseline.best.condition_number
    assert design.baseline.best.condition_number <= design.baseline.median_condition_number
    assert all(margin.share <= 1 for margin in design.margins)
    assert_within(ur10, design, stated)


def test_the_arm_rests_in_every_point_and_comes_back_to_the_first(scara):
    design = design_experiment(scara, replace(QUICK, trajectory=replace(QUICK.trajectory, periods=2)))
    rests = standstills(design)
    assert len({tuple(np.round(q, 9)) for q in rests}) == 6
    assert design.period is not None
    steps, first = round(design.period * 200), round(design.exciting[0] * 200)
    np.testing.assert_allclose(design.q[first : first + steps], design.q[first + steps : first + 2 * steps], atol=1e-9)
    np.testing.assert_allclose(design.q[0], design.q[-1], atol=1e-12)
    np.testing.assert_allclose(np.diff(design.t), 1 / 200, atol=1e-9)


def test_the_condition_number_is_that_of_pinocchios_regressor(ur10):
    design = design_experiment(ur10, replace(QUICK, effects=(EffectChoice("rigid_body"),)))
    model = to_pinocchio(ur10)
    data = model.createData()
    first, last = (round(at * design.sampling_rate) for at in design.exciting)
    taken = range(first, last + 1, 5)
    rows = [pin.computeJointTorqueRegressor(model, data, design.q[k], design.dq[k], design.ddq[k]) for k in taken]
    w = np.concatenate(rows)
    order = ("M", "MX", "MY", "MZ", "XX", "XY", "YY", "XZ", "YZ", "ZZ")
    names = [f"{name}{link}" for link in range(1, 7) for name in order]
    # Pinocchio's frames are those of the URDF: only the number of independent columns is the same.
    assert len(names) == w.shape[1]
    sigma = np.linalg.svd(w, compute_uv=False)
    assert (sigma > 1e-6 * sigma[0]).sum() == len(design.parameter_names)


def test_a_few_samples_of_a_move_tell_what_the_whole_is_worth(scara):
    model, bounds = build_design_model(scara, EFFECTS), build_bounds(scara, {})
    rng = np.random.default_rng(0)
    points = bounds.middle + 0.6 * bounds.half_range * rng.uniform(-1, 1, (5, 4))
    legs = MovePlanner(bounds, model, 2000.0).plan_sequence(PointSequence(points, np.full((5, 2), 0.7)))
    assert legs is not None
    closely = []
    for leg in legs:
        motion = leg.piece.evaluate(np.arange(0, leg.piece.duration, 1 / 2000))
        closely.append(model.observe(motion.q, motion.dq, motion.ddq, dddq=motion.dddq))
    w = np.concatenate(closely)
    exact = w.T @ w / (len(w) / 4)
    ours = stack_rows(legs).T @ stack_rows(legs)
    sizes = np.sqrt(np.diag(exact))
    np.testing.assert_allclose(ours / np.outer(sizes, sizes), exact / np.outer(sizes, sizes), atol=0.2)
    design_criterion = build_design_criterion(model, QUICK.criterion, {})
    assert design_criterion.smooth_criterion(stack_rows(legs))[0] == pytest.approx(
        design_criterion.smooth_criterion(w / np.sqrt(len(w) / 4))[0], abs=0.2
    )


def test_the_points_are_chosen_so_that_no_move_touches_the_arm_itself(ur10):
    design = design_experiment(ur10, replace(QUICK, surroundings=Surroundings()))
    clear = [margin for margin in design.margins if margin.limit == "clearance"]
    assert clear
    assert all(margin.value >= margin.bound for margin in clear)
    assert all(margin.share <= 1 for margin in design.margins)


def test_the_same_seed_gives_the_same_points_and_another_one_others(scara):
    first, again, other = (design_experiment(scara, replace(QUICK, seed=seed)) for seed in (3, 3, 4))
    np.testing.assert_array_equal(first.q, again.q)
    assert first.q.shape != other.q.shape or not np.allclose(first.q, other.q)


def test_joints_that_are_not_named_stay_locked(ur10):
    joints = ("elbow_joint", "wrist_1_joint")
    design = design_experiment(ur10, replace(QUICK, trajectory=replace(QUICK.trajectory, joints=joints)))
    moves = np.ptp(design.q, axis=0) > 0
    assert [name for name, moving in zip(ur10.joint_names, moves, strict=True) if moving] == list(joints)
    assert {name[-1] for name in design.parameter_names} == {"3", "4"}


def test_the_arm_rests_in_every_point_for_as_long_as_it_is_asked_to(ur10):
    asked = replace(QUICK, kind="random", trajectory=replace(QUICK.trajectory, dwell=(0.1, 0.6), periods=2))
    design, again = (design_experiment(ur10, asked) for _ in range(2))
    np.testing.assert_array_equal(design.q, again.q)
    still = np.concatenate([[False], ~np.any(design.dq, axis=1), [False]]).astype(np.int8)
    begins, ends = np.flatnonzero(np.diff(still) == 1), np.flatnonzero(np.diff(still) == -1)
    lasts = np.sort((ends - begins - 1) / design.sampling_rate)[-2 * asked.trajectory.points :]
    half = 0.5 / design.sampling_rate
    assert lasts.min() >= 0.1 - half
    assert lasts.max() <= 0.6 + half
    assert np.ptp(lasts) > 0.1
    for first, last in zip(begins, ends, strict=True):
        assert not np.any(np.ptp(design.q[first:last], axis=0) > 1e-12)


def test_a_random_sequence_can_be_had_and_a_time_budget_and_cancelling_are_heeded(ur10):
    design = design_experiment(ur10, replace(QUICK, kind="random"))
    assert design.baseline is not None
    assert design.criterion_values.condition_number == pytest.approx(design.baseline.best.condition_number, rel=0.1)
    hurried = design_experiment(ur10, replace(QUICK, starts=None, time_budget=0.05))
    assert any("0 starts completed before the time limit" in note for note in hurried.notes)

    def stop(fraction: float, message: str) -> None:
        if "variation" in message:
            raise Cancelled

    with pytest.raises(Cancelled):
        design_experiment(ur10, QUICK, stop)


@pytest.mark.parametrize(
    ("trajectory", "pointer"),
    [
        ({"points": 1}, "/points"),
        ({"points": 10_000}, "/points"),
        ({"paces": (1.0, 0.5)}, "/trajectory/paces"),
        ({"dwell": (0.5, 0.1)}, "/trajectory/dwell"),
        ({"dwell": (-0.1, 0.1)}, "/dwell/0"),
        ({"dwell": (0.1, float("nan"))}, "/dwell/1"),
        ({"family": "fourier", "dwell": (0.1, 0.6)}, "/trajectory/dwell"),
    ],
)
def test_what_cannot_be_a_sequence_of_moves_is_refused_with_its_place(scara, trajectory, pointer):
    with pytest.raises(DynidentError) as caught:
        design_experiment(scara, replace(QUICK, trajectory=replace(QUICK.trajectory, **trajectory)))
    assert caught.value.pointer == pointer


def test_effects_that_remember_the_path_and_other_models_are_refused(scara):
    slipping = (*EFFECTS, EffectChoice("presliding", ("elbow",)))
    with pytest.raises(DynidentError, match="depends on the path since the last reversal"):
        design_experiment(scara, replace(QUICK, effects=slipping))
    with pytest.raises(DynidentError, match="only a periodic trajectory"):
        design_experiment(scara, replace(QUICK, model="energy"))


def test_drawn_and_varied_points_stay_inside_the_limits_and_two_points_lock_the_others(ur10):
    bounds = build_bounds(ur10, {})
    rng = np.random.default_rng(1)
    postures = bounds.middle + 0.8 * bounds.half_range * rng.uniform(-1, 1, (50, 6))
    longest = np.array([0.0, 0.4, 0.0, 1.0, 0.0, 0.0])
    spaces = (FreePoints(bounds, postures, 5), TwoPoints(bounds, postures, 0.5 * longest, longest))
    for space in spaces:
        sequence = space.draw(rng)
        for _ in range(200):
            sequence = space.vary(sequence, rng, 0.4)
            assert (sequence.points >= bounds.position_low - 1e-12).all()
            assert (sequence.points <= bounds.position_high + 1e-12).all()
            assert ((sequence.shares > 0) & (sequence.shares <= 1)).all()
    way = np.abs(np.diff(sequence.points, axis=0))[0]
    assert (way[longest == 0] < 1e-12).all()
    assert (way >= 0.5 * longest - 1e-9).all()
    assert (way <= longest + 1e-9).all()
