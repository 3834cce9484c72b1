"""What a diagnosis says of arms that stand and stick, and of torque that no effect in nature gives."""

from __future__ import annotations

import numpy as np
import pytest
from hidden_effects import experiment
from oracles import arm, record
from resting import resting_motion, resting_torque
from test_scoring_and_gate import judged

from dynident.diagnosis import diagnose
from dynident.diagnosis.search.acceptance import shadowed
from dynident.identification import identify
from dynident.recordings import Recording

SCARA = arm("scara")
EXCESS = 2.5


def resting(seed: int, excess: float, vs: float) -> Recording:
    """An arm that rests between moves, its first joint harder to move at low speed."""
    motion = resting_motion(SCARA, 60.0, 200.0, seed)
    tau = resting_torque(SCARA, motion, seed)
    speed = motion.dq[:, 0]
    tau[:, 0] += excess * np.exp(-((speed / vs) ** 2)) * np.sign(speed) * (np.abs(speed) > 1e-6)
    return record(SCARA, motion, tau, f"run{seed}")


@pytest.mark.parametrize("vs", [0.03, 0.06])
def test_friction_that_peaks_at_low_speed_is_named_on_a_joint_that_stops_at_every_move(vs: float):
    # 0.03 rad/s is below the slowest rows that the filter's width leaves between halts.
    run = resting(1, EXCESS, vs)
    found = diagnose(identify(SCARA, [run], [resting(2, EXCESS, vs)]), [run])
    assert [(choice.effect, choice.joints) for choice in found.recommended] == [("stribeck", SCARA.joint_names[:1])]
    assert found.recommended[0].shape_values["delta"] == 2.0
    assert found.recommended[0].shape_values["vs"] == pytest.approx(vs, rel=0.05)


def test_nothing_is_named_on_an_arm_that_only_rests_between_its_moves():
    run = resting(1, 0.0, 0.06)
    assert diagnose(identify(SCARA, [run], [resting(2, 0.0, 0.06)]), [run]).recommended == ()


def early(motion, load):
    """Torque 3 ms before its cause, as a log has it whose positions come late."""
    rate = 1.0 / (motion.t[1] - motion.t[0])
    return 3e-3 * np.gradient(load, axis=0) * rate


def test_a_torque_before_its_cause_is_given_no_name():
    run = experiment(early)
    assert diagnose(run.identification, [run.training]).recommended == ()


def test_what_is_small_beside_a_rough_formula_is_taken_for_what_it_leaves():
    rows = np.ones((40, 1))
    floor = np.ones(1)
    cable = judged(np.ones(40), name="cable_force", before=100.0 * rows, after=rows)
    spring = judged(np.ones(40), name="joint_spring", before=100.0 * rows, after=rows)
    small, large = (judged(np.ones(40), name="offset", before=b * rows, after=rows) for b in (2.5, 5.0))
    assert shadowed(small, cable, floor)
    assert not shadowed(large, cable, floor)
    assert not shadowed(small, spring, floor)
