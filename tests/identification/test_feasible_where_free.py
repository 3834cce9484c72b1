"""By default estimates are those of a robot that can exist where the fit hardly changes, with intervals that hold."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.oracles import arm, fourier_motion, pinocchio_torque, record

from dynident.effects import EffectChoice, get_role
from dynident.export import export_model
from dynident.identification import Identification, IdentificationChoices, identify
from dynident.presentation.labels import describe_estimator
from dynident.recordings import Recording
from dynident.robot import Robot
from dynident.robot.pseudo_inertia import smallest_pseudo_inertia
from dynident.robot.robot_model import INERTIAL_NAMES

ROBOT = arm("ur10")
EFFECTS = tuple(EffectChoice(name) for name in ("rigid_body", "rotor_inertia", "coulomb", "viscous"))
AUTO = IdentificationChoices(EFFECTS)
PLAIN = IdentificationChoices(EFFECTS, estimator="wls")
ROTORS, COULOMB, VISCOUS = np.full(6, 0.4), np.full(6, 6.0), np.full(6, 5.0)


def run(seed: int, noise: float, robot: Robot = ROBOT) -> Recording:
    motion = fourier_motion(robot, 20.0, 200.0, 3)
    tau = pinocchio_torque(robot, motion.q, motion.dq, motion.ddq)
    tau = (
        tau + ROTORS[: robot.n] * motion.ddq + COULOMB[: robot.n] * np.sign(motion.dq) + VISCOUS[: robot.n] * motion.dq
    )
    size = np.sqrt((tau**2).mean(axis=0))
    return record(robot, motion, tau + noise * size * np.random.default_rng(seed).normal(size=tau.shape))


def truth(found: Identification) -> np.ndarray:
    drives = {"rotor": ROTORS, "dry": COULOMB, "damping": VISCOUS}
    standard = np.zeros(len(found.model.columns))
    for k, column in enumerate(found.model.columns):
        joint, role = ROBOT.joint_names.index(column.link), get_role(column)
        if role == "link":
            standard[k] = ROBOT.inertias[joint, INERTIAL_NAMES.index(column.parameter)]
        else:
            standard[k] = drives[role][joint]
    return found.model.base.grouping @ standard


def test_estimates_that_no_robot_has_are_moved_and_their_intervals_stay_and_hold() -> None:
    inside, total, nearer = 0, 0, []
    for seed in range(12):
        recording = run(seed, 0.05)
        plain, moved = identify(ROBOT, [recording], choices=PLAIN), identify(ROBOT, [recording], choices=AUTO)
        assert plain.estimate.standard is None
        assert moved.estimate.standard is not None
        np.testing.assert_array_equal(moved.statistics.covariance, plain.statistics.covariance)
        assert moved.fit.relative_total < 1.02 * plain.fit.relative_total
        right = truth(moved)
        inside += int(np.count_nonzero(np.abs(moved.values - right) <= moved.statistics.half_widths()))
        total += len(right)
        deviations = plain.statistics.standard_deviations
        nearer.append([np.linalg.norm((one.values - right) / deviations) for one in (moved, plain)])
    assert inside / total > 0.93
    # The truth is a robot: what is nearer to robots is nearer to it.
    assert np.mean(nearer, axis=0)[0] < np.mean(nearer, axis=0)[1]
    assert export_model(moved, "urdf").content


def test_estimates_of_a_robot_stay_to_the_last_digit() -> None:
    recording = run(1, 1e-5)
    plain, same = identify(ROBOT, [recording], choices=PLAIN), identify(ROBOT, [recording], choices=AUTO)
    np.testing.assert_array_equal(same.values, plain.values)


def test_estimates_stay_where_a_robot_that_can_exist_would_fit_worse() -> None:
    # With all torques turned round, masses would have to be negative.
    motion = fourier_motion(ROBOT, 20.0, 200.0, 3)
    turned = record(ROBOT, motion, -pinocchio_torque(ROBOT, motion.q, motion.dq, motion.ddq))
    plain, same = identify(ROBOT, [turned], choices=PLAIN), identify(ROBOT, [turned], choices=AUTO)
    np.testing.assert_array_equal(same.values, plain.values)
    assert same.estimate.standard is None
    assert describe_estimator(same) == "auto: weighted least squares"
    assert describe_estimator(identify(ROBOT, [run(1, 1e-5)], choices=AUTO)) == "auto: feasible parameters"


def test_links_of_a_description_that_cannot_exist_may_have_the_parameters_of_others_that_can() -> None:
    crooked = arm("crooked")
    recording = run(1, 1e-3, crooked)
    plain, same = identify(crooked, [recording], choices=PLAIN), identify(crooked, [recording], choices=AUTO)
    np.testing.assert_array_equal(same.values, plain.values)
    # The data say nothing of these links but their sums, and the solver of bounds is less exact than least squares.
    gap = same.model.base.grouping @ same.estimate.standard.values - same.values
    assert np.abs(gap / same.statistics.standard_deviations).max() < 0.01
    links = [k for k, column in enumerate(same.model.columns) if get_role(column) == "link"]
    assert smallest_pseudo_inertia(same.estimate.standard.values[links].reshape(-1, 10)).min() >= 0.0


def test_a_fit_of_bodies_that_can_exist_is_known_as_one_however_small_its_deviations_are() -> None:
    # With hardly any noise rounding is many standard deviations.
    recording = run(1, 1e-6)
    plain, same = identify(ROBOT, [recording], choices=PLAIN), identify(ROBOT, [recording], choices=AUTO)
    np.testing.assert_array_equal(same.values, plain.values)
    assert same.estimate.standard is not None


def test_what_sits_in_some_runs_alone_is_not_held_to_bodies_that_can_exist() -> None:
    runs = [replace(run(seed, 0.05), name=name) for seed, name in ((1, "empty"), (2, "loaded"))]
    effects = (*EFFECTS, EffectChoice("payload", (ROBOT.joint_names[-1],), runs=("loaded",)))
    found = [identify(ROBOT, runs, choices=replace(one, effects=effects)) for one in (AUTO, PLAIN)]
    np.testing.assert_array_equal(found[0].values, found[1].values)


@pytest.mark.parametrize("strategy", ["sequential"])
def test_strategies_of_several_steps_keep_what_every_step_says(strategy: str) -> None:
    recording = run(1, 0.05)
    found = [identify(ROBOT, [recording], choices=replace(one, strategy=strategy)) for one in (AUTO, PLAIN)]
    np.testing.assert_array_equal(found[0].values, found[1].values)


def test_a_description_in_grams_and_millimetres_is_no_obstacle_to_bodies_that_can_exist() -> None:
    factors = np.array([1e9] * 6 + [1e3] * 3 + [1e3])
    grams = replace(ROBOT, inertias=ROBOT.inertias * factors)
    found = identify(grams, [run(1, 0.05)], choices=replace(AUTO, estimator="feasible"))
    masses = found.estimate.standard.values[[c.parameter == "M" for c in found.model.columns]]
    assert masses.sum() == pytest.approx(ROBOT.inertias[:, 9].sum(), rel=0.5)
    assert export_model(found, "urdf").content


def test_every_fit_that_no_robot_has_is_moved_where_that_is_free() -> None:
    # In some of these the solver stops a little before the limit, and names none.
    for seed in range(12):
        assert identify(ROBOT, [run(seed, 0.01)], choices=AUTO).estimate.standard is not None
