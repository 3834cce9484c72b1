"""The sign of a torque is told from rows in which its joint moves: at rest friction holds whatever it holds."""

from __future__ import annotations

import numpy as np
import pytest
from support.joints_at_rest import resting_motion, resting_torque
from support.oracles import arm

from dynident.recordings import nonparametric_fit, recording_from_arrays

ROBOT = arm("scara")


def directions(seed: int, signs: np.ndarray) -> list[nonparametric_fit.Direction]:
    motion = resting_motion(ROBOT, 10.0, 250.0, seed)
    tau = resting_torque(ROBOT, motion, seed) * signs
    found = nonparametric_fit.gather_evidence(
        recording_from_arrays(motion.t, motion.q, tau, joint_names=ROBOT.joint_names, name="run")
    )
    assert found is not None
    return [nonparametric_fit.measure_direction(found, joint) for joint in range(ROBOT.n)]


@pytest.mark.parametrize("seed", [18, 32, 5, 6])
def test_ten_seconds_with_pauses_tell_the_sign_of_every_torque_that_moves_enough(seed: int) -> None:
    right = directions(seed, np.ones(ROBOT.n))
    assert not any(one.friction < 0 and one.inertia < 0 for one in right)
    assert any(one.friction > 4 for one in right)
    turned = directions(seed, np.array([-1.0, 1.0, 1.0, 1.0]))
    assert turned[0].friction == pytest.approx(-right[0].friction)
    assert turned[0].inertia == pytest.approx(-right[0].inertia)
    assert turned[1:] == right[1:]
