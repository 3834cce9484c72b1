"""Data that cannot determine a model: a clear error each, whatever the estimator."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.oracles import arm, fourier_motion, pinocchio_torque, record

from dynident.effects import EffectChoice
from dynident.errors import DynidentError
from dynident.identification import IdentificationChoices, identify
from dynident.recordings import Preprocessing

EFFECTS = tuple(EffectChoice(name) for name in ("rigid_body", "coulomb", "viscous"))
CHOICES = IdentificationChoices(EFFECTS, preprocessing=Preprocessing(15.0, 15.0, 5))
ROBOT = arm("ur10")
ESTIMATORS = ("ols", "wls", "irls", "feasible")


def run(duration: float = 10.0, silent: tuple[int, ...] = (), still: tuple[int, ...] = (), **more):
    motion = fourier_motion(ROBOT, duration, 200.0, seed=2)
    q, dq, ddq = (item.copy() for item in (motion.q, motion.dq, motion.ddq))
    for item in (q, dq, ddq):
        item[:, list(still)] = 0.0
    tau = pinocchio_torque(ROBOT, q, dq, ddq) + np.sign(dq) + dq
    tau = tau + 0.1 * np.random.default_rng(0).normal(size=tau.shape)
    tau[:, list(silent)] = 0.0
    return record(ROBOT, replace(motion, q=q, dq=dq, ddq=ddq), tau, **more)


@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_a_joint_whose_torque_is_zero_throughout_is_named(estimator):
    with pytest.raises(DynidentError, match=r"torque of elbow_joint is zero everywhere.*weight") as raised:
        identify(ROBOT, [run(silent=(2,))], choices=replace(CHOICES, estimator=estimator))
    assert raised.value.pointer == "/recordings"


@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_no_torque_at_all_is_said(estimator):
    with pytest.raises(DynidentError, match="torque is zero everywhere"):
        identify(ROBOT, [run(silent=tuple(range(6)))], choices=replace(CHOICES, estimator=estimator))


@pytest.mark.parametrize("estimator", ESTIMATORS)
@pytest.mark.parametrize("strategy", ["global", "sequential"])
def test_too_few_samples_are_said(estimator, strategy):
    if strategy == "sequential" and estimator in ("irls", "feasible"):
        return  # refused for another reason
    short = run(10.0, windows=((1.0, 1.05),))
    with pytest.raises(DynidentError) as raised:
        identify(ROBOT, [short], choices=replace(CHOICES, estimator=estimator, strategy=strategy))
    assert raised.value.title in ("Too few samples", "Not identifiable")
    assert "record" in raised.value.detail


@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_a_joint_that_is_locked_is_named_by_its_parameters(estimator):
    with pytest.raises(DynidentError, match="Fc3") as raised:
        identify(ROBOT, [run(still=(2,))], choices=replace(CHOICES, estimator=estimator))
    assert "lock" in raised.value.detail


def test_a_prior_does_not_make_up_for_silent_torque():
    with pytest.raises(DynidentError, match="zero everywhere"):
        identify(ROBOT, [run(silent=(2,))], choices=replace(CHOICES, prior="description", estimator="feasible"))


@pytest.mark.parametrize("estimator", ["wls", "feasible"])
def test_a_prior_of_links_that_cannot_exist_is_infeasible(estimator):
    wrong = ROBOT.inertias.copy()
    wrong[2, 3] *= 10.0
    robot = replace(ROBOT, inertias=wrong)
    choices = replace(CHOICES, prior="description", estimator=estimator)
    with pytest.raises(DynidentError, match="elbow_joint") as raised:
        identify(robot, [run()], choices=choices)
    assert (raised.value.pointer, raised.value.title) == ("/prior", "Infeasible prior")
    found = identify(robot, [run()], choices=replace(choices, free_links=("elbow_joint",)))
    assert found.inertia_matrix_positive_definite


def test_friction_and_an_offset_are_one_where_a_joint_never_turns_back():
    """The joint moved, so to ask for motion would be the wrong reason."""
    motion = fourier_motion(ROBOT, 10.0, 200.0, seed=2)
    q, dq, ddq = (item.copy() for item in (motion.q, motion.dq, motion.ddq))
    q[:, 1], dq[:, 1], ddq[:, 1] = 0.15 * motion.t - 1.0 + 0.1 * np.sin(motion.t), 0.15 + 0.1 * np.cos(motion.t), 0.0
    ddq[:, 1] = -0.1 * np.sin(motion.t)
    tau = pinocchio_torque(ROBOT, q, dq, ddq) + np.sign(dq) + dq
    oneway = record(ROBOT, replace(motion, q=q, dq=dq, ddq=ddq), tau)
    with pytest.raises(DynidentError, match=r"Fc2, b2.*one direction only"):
        identify(ROBOT, [oneway], choices=replace(CHOICES, effects=(*EFFECTS, EffectChoice("offset"))))


def test_a_joint_that_moves_in_few_blocks_of_time_is_warned_of() -> None:
    """Its rows count as independent, whatever they are, while those of the others are judged by blocks."""
    robot = arm("ur10")
    motion = fourier_motion(robot, 20.0, 100.0, 3)
    tau = pinocchio_torque(robot, motion.q, motion.dq, motion.ddq) + np.sign(motion.dq) + motion.dq
    tau += 0.1 * np.random.default_rng(3).normal(size=tau.shape)
    whole = record(robot, motion, tau)
    # Beyond these torques the last joint's drive saturates, but for three seconds.
    tau[(motion.t < 8.0) | (motion.t > 11.0), 5] = 60.0
    short = replace(record(robot, motion, tau), torque_ranges=((-np.inf, np.inf),) * 5 + ((-50.0, 50.0),))
    few = "Less than 5 blocks of time show the motion of wrist_3_joint"
    assert any(few in warning for warning in identify(robot, [short]).warnings)
    assert not any("blocks of time" in warning for warning in identify(robot, [whole]).warnings)
