"""A simulated robot that is left alone: its motion is Pinocchio's, and it drifts where its parameters are wrong."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from support.oracles import arm, fourier_motion, pinocchio_torque, record

from dynident.effects import EffectChoice
from dynident.identification import IdentificationChoices, identify
from dynident.robot import to_pinocchio
from dynident.simulation import Reference, VirtualRobot
from dynident.validation.simulated_response import compute_open_loop_drift, validate_simulation

ROBOT = arm("ur10")
LINKS = IdentificationChoices((EffectChoice("rigid_body"),), estimator="feasible")


def test_free_motion_under_given_torque_is_that_of_the_articulated_body_algorithm() -> None:
    motion = fourier_motion(ROBOT, 1.0, 1000.0, 2)
    tau = 0.9 * pinocchio_torque(ROBOT, motion.q, motion.dq, motion.ddq)
    model = to_pinocchio(ROBOT)
    data = model.createData()
    q, dq, path = motion.q[0].copy(), motion.dq[0].copy(), []
    ddq = pin.aba(model, data, q, dq, tau[0]).copy()
    start = Reference(motion.t[:1], q[None].copy(), dq[None].copy(), ddq[None])
    found = VirtualRobot(ROBOT).move_freely(start, tau, 1e-3)
    for row in tau:
        path.append(q.copy())
        # Runge and Kutta's method, with the torque of the sample held.
        k1 = pin.aba(model, data, q, dq, row).copy()
        k2 = pin.aba(model, data, q + 5e-4 * dq, dq + 5e-4 * k1, row).copy()
        k3 = pin.aba(model, data, q + 5e-4 * dq + 2.5e-7 * k1, dq + 5e-4 * k2, row).copy()
        k4 = pin.aba(model, data, q + 1e-3 * dq + 5e-7 * k2, dq + 1e-3 * k3, row).copy()
        q = q + 1e-3 * dq + 1e-6 / 6.0 * (k1 + k2 + k3)
        dq = dq + 1e-3 / 6.0 * (k1 + 2 * k2 + 2 * k3 + k4)
    moved = np.abs(np.array(path) - path[0]).max()
    assert np.abs(found[:500] - np.array(path)[:500]).max() < 0.01 * moved


def test_a_right_model_stays_near_and_one_of_other_links_runs_away() -> None:
    recordings = []
    for seed in (3, 4):
        motion = fourier_motion(ROBOT, 10.0, 200.0, seed)
        recordings.append(record(ROBOT, motion, pinocchio_torque(ROBOT, motion.q, motion.dq, motion.ddq), f"run{seed}"))
    right = compute_open_loop_drift(identify(ROBOT, recordings[:1], choices=LINKS), recordings[1:])
    assert right.starts > 5
    assert right.share[0].max() < 0.01
    assert right.share[1].max() < 0.05
    motion = fourier_motion(ROBOT, 10.0, 200.0, 3)
    wrong = record(ROBOT, motion, 1.3 * pinocchio_torque(ROBOT, motion.q, motion.dq, motion.ddq), "wrong")
    off = compute_open_loop_drift(identify(ROBOT, [wrong], choices=LINKS), recordings[1:])
    assert off.share[1].max() > 0.3
    assert off.way == pytest.approx(right.way)


def test_what_a_tracking_controller_makes_up_for_does_not_pass() -> None:
    motion = fourier_motion(ROBOT, 10.0, 200.0, 3)
    tau = pinocchio_torque(ROBOT, motion.q, motion.dq, motion.ddq)
    unseen = fourier_motion(ROBOT, 6.0, 200.0, 4)
    held_out = record(ROBOT, unseen, pinocchio_torque(ROBOT, unseen.q, unseen.dq, unseen.ddq), "unseen")
    right = validate_simulation(identify(ROBOT, [record(ROBOT, motion, tau)], choices=LINKS), held_out, 0.9)
    assert right.judged.verdict == "pass"
    assert right.drift is not None
    assert "after 0.5 s" in right.judged.reason
    # Torque that is too large by a quarter: the controller follows all the same, and the limit on torque is wide.
    wrong = validate_simulation(identify(ROBOT, [record(ROBOT, motion, 1.25 * tau)], choices=LINKS), held_out, 0.9)
    assert wrong.position_share is not None
    assert wrong.position_share.max() < 0.02
    assert wrong.judged.verdict == "fail"
    assert "half a second" in wrong.judged.reason
