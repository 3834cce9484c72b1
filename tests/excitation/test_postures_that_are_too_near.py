"""Postures that capsules clear at once are those that the exact shapes clear: none that touches is let through."""

from __future__ import annotations

import numpy as np
import pytest
from support.robots_with_collision_geometry import safe_robot

from dynident.motion import Box, Surroundings
from dynident.motion.collision.free_space import build_free_space

AROUND = Surroundings(
    self_collision=True, clearance=0.03, boxes=(Box("table", center=(0.4, 0.3, 0.2), size=(0.5, 0.4, 0.3)),)
)


@pytest.mark.parametrize("name", ["gantry", "ur5", "franka_panda"])
def test_a_posture_is_too_near_where_any_two_shapes_are_nearer_than_their_clearance(name: str) -> None:
    robot = safe_robot(name)
    low, high = np.array([joint.limits.position for joint in robot.joints]).T
    space = build_free_space(robot, AROUND, low, high)
    assert space is not None
    assert space.contacts is not None
    q = np.random.default_rng(4).uniform(low, high, (150, robot.n))
    exact = np.any([space.contacts.compute_distances(one, q) < one.clearance for one in space.contacts.pairs], axis=0)
    assert 0 < exact.sum() < len(q)
    np.testing.assert_array_equal(space.contacts.find_too_near(q), exact)
    assert (space.find_complaint(q[exact]) is None, space.find_complaint(q[~exact][:1])) == (False, None)
