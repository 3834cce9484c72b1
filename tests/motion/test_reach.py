"""How far a motion takes the arm is said where nothing around it was stated."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from support.oracles import arm

from dynident.motion.collision.obstacle_geometry import NOTHING_STATED, measure_reach, note_reach
from dynident.motion.collision.surroundings import Box, Surroundings
from dynident.robot import urdf_from_robot


@pytest.fixture
def motion() -> tuple[np.ndarray, np.ndarray]:
    return np.arange(50) * 0.1, np.random.default_rng(3).uniform(-3.0, 3.0, (50, 6))


def test_the_reach_is_what_pinocchio_finds(motion: tuple[np.ndarray, np.ndarray]) -> None:
    robot, (t, q) = arm("ur10"), motion
    model = pin.buildModelFromXML(urdf_from_robot(robot))
    data, heights, widths = model.createData(), [], []
    for row in q:
        pin.forwardKinematics(model, data, row)
        origins = np.array([data.oMi[model.getJointId(name)].translation for name in robot.joint_names])
        heights.append(origins[:, 2])
        widths.append(np.hypot(origins[:, 0], origins[:, 1]))
    lowest = np.array(heights)
    moment, joint = np.unravel_index(lowest.argmin(), lowest.shape)
    reach = measure_reach(robot, t, q)
    assert reach.lowest == pytest.approx(lowest.min(), abs=1e-9)
    assert (reach.lowest_joint, reach.lowest_time) == (robot.joint_names[joint], pytest.approx(t[moment]))
    assert reach.widest == pytest.approx(np.max(widths), abs=1e-9)
    assert reach.below == pytest.approx((lowest.min(axis=1) < -1e-3).mean())


def test_it_is_said_unless_something_around_the_robot_was_stated(motion: tuple[np.ndarray, np.ndarray]) -> None:
    robot, (t, q) = arm("ur10"), motion
    (note,) = note_reach(robot, t, q, Surroundings())
    assert note.code == NOTHING_STATED
    assert "below the base plane" in note
    assert "a third of the speed first" in note
    box = Box(name="table", center=(1.0, 0.0, 0.0), size=(0.1, 0.1, 0.1))
    for stated in (Surroundings(floor=0.0), Surroundings(boxes=(box,))):
        assert note_reach(robot, t, q, stated) == ()
