"""Limits of thousands of turns are how some write continuous joints: nothing makes that many of them."""

from __future__ import annotations

import numpy as np
import pytest
from support.one_joint_robots import one_joint_urdf

import dynident as dy
from dynident.motion.limits.bounds import build_bounds
from dynident.robot import Robot, robot_from_urdf


def wide(name: str, size: float, **said: object) -> Robot:
    text = one_joint_urdf(name).replace('lower="-2.5" upper="2.5"', f'lower="{-size}" upper="{size}"')
    return robot_from_urdf(name, text.replace('lower="-0.4" upper="0.4"', f'lower="{-size}" upper="{size}"'), **said)


@pytest.mark.parametrize("size", [10_000.0, 1e16, 1e300])
def test_a_design_within_limits_of_thousands_of_turns_stays_within_one(size: float) -> None:
    request = dy.DesignRequest(
        trajectory=dy.TrajectoryRequest(duration=4.0, sampling_rate=50.0), starts=1, random_trajectories=2
    )
    design = dy.design(wide("pendulum", size), request).design
    assert np.abs(design.q).max() <= np.pi
    assert design.duration < 20.0
    known = (
        "limits of axis are wider than 10 turns and count as no limits"
        if size < 1e300
        else "No position limit is known"
    )
    assert any(known in note for note in design.notes)
    sweep = dy.design(wide("pendulum", size), kind="slow_sweep", duration=4.0, sampling_rate=50.0).design
    assert np.abs(sweep.q).max() <= np.pi


def test_limits_stated_for_one_design_count_the_same_and_a_few_turns_are_limits() -> None:
    bounds = build_bounds(wide("pendulum", 10_000.0), {"axis": dy.Limits(position=(-5000.0, 5000.0))})
    assert (bounds.position_low[0], bounds.position_high[0]) == (-np.pi, np.pi)
    bounds = build_bounds(wide("pendulum", 10_000.0), {"axis": dy.Limits(position=(-4.0, 4.0))})
    assert (bounds.position_low[0], bounds.position_high[0]) == (-4.0, 4.0)
    bounds = build_bounds(wide("pendulum", 18.85), {})
    assert (bounds.position_low[0], bounds.position_high[0]) == (-18.85, 18.85)
    assert not any("count as no limits" in note for note in bounds.notes)


def test_a_slide_of_kilometres_has_no_range() -> None:
    with pytest.raises(dy.DynidentError, match="wider than any machine; state its position limits"):
        build_bounds(wide("rail", 10_000.0), {})


def test_limits_of_a_description_that_no_machine_has_count_as_not_known() -> None:
    text = one_joint_urdf("pendulum").replace('velocity="2" effort="120"', 'velocity="1e30" effort="1e30"')
    limits = robot_from_urdf("pendulum", text).joints[0].limits
    assert (limits.velocity, limits.effort) == (None, None)
    with pytest.raises(dy.DynidentError, match="1e-06 to 1e"):
        robot_from_urdf("pendulum", text, limits={"axis": dy.Limits(velocity=1e30)})
