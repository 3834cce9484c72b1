from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from safe_robots import Judge, judge_of, safe_robot
from scipy.signal import resample

from dynident.effects import EffectChoice
from dynident.excitation import (
    Box,
    Design,
    DesignRequest,
    ImpossibleLimitsError,
    Surroundings,
    ToolRange,
    TrajectoryRequest,
    Wall,
    design_experiment,
)
from dynident.robot import Limits

ROBOTS = ("franka_panda", "ur10", "gantry")
SHORT = TrajectoryRequest(duration=3.0, harmonics=3, sampling_rate=200.0)
QUICK = DesignRequest(
    effects=(EffectChoice("coulomb"), EffectChoice("viscous")), trajectory=SHORT, starts=1, random_trajectories=3
)
ROUNDING = 1e-9


@st.composite
def requests(draw: st.DrawFn, name: str) -> DesignRequest:
    robot = safe_robot(name)
    stated = {}
    for joint in robot.joints:
        if draw(st.booleans()):
            continue
        low, high = joint.limits.position or (-np.pi, np.pi)
        ends = sorted(draw(st.floats(0, 1)) for _ in range(2))
        if ends[1] - ends[0] < 0.02:
            ends = [0.0, 1.0]
        effort = joint.limits.effort or 100.0
        stated[joint.name] = Limits(
            position=(low + ends[0] * (high - low), low + ends[1] * (high - low)),
            velocity=draw(st.none() | st.floats(0.05, 5.0)),
            acceleration=draw(st.none() | st.floats(0.1, 40.0)),
            jerk=draw(st.none() | st.floats(5.0, 2000.0)),
            effort=draw(st.none() | st.floats(0.3 * effort, effort)),
            power=draw(st.none() | st.floats(0.01 * effort, effort)),
        )
    vector = st.tuples(*[st.floats(-1.2, 1.2)] * 3)
    edges = st.tuples(*[st.floats(0.05, 0.6)] * 3)
    boxes = draw(st.lists(st.builds(Box, st.just("crate"), vector, edges, vector), max_size=2))
    walls = draw(st.lists(st.builds(_wall, st.floats(0.3, 1.0), st.floats(-3.1, 3.1)), max_size=1))
    tool = draw(st.none() | st.builds(_tool_range, st.floats(-0.8, 0.2), st.floats(0.3, 1.0)))
    return replace(
        QUICK,
        kind=draw(st.sampled_from(["random", "random", "optimized"])),
        seed=draw(st.integers(0, 1000)),
        limits=stated,
        torque_margin=draw(st.sampled_from([0.0, 0.2])),
        surroundings=Surroundings(
            floor=draw(st.none() | st.floats(-1.0, 0.0)),
            walls=tuple(walls),
            boxes=tuple(boxes),
            tool_range=tool,
            clearance=draw(st.sampled_from([0.005, 0.02, 0.05])),
        ),
    )


def _wall(distance: float, angle: float) -> Wall:
    away = (float(np.cos(angle)), float(np.sin(angle)), 0.0)
    return Wall("fence", (-distance * away[0], -distance * away[1], 0.0), away)


def _tool_range(low: float, size: float) -> ToolRange:
    return ToolRange(low=(low, None, None), high=(low + size, 1.1, None))


def assert_safe(judge: Judge, request: DesignRequest, design: Design) -> None:
    """Every limit as the user stated it, on the samples, and between them where the motion is band-limited."""
    robot, rate = judge.robot, design.sampling_rate
    first, last = (round(at * rate) for at in design.exciting)
    between = [resample(signal[first:last], 4 * (last - first)) for signal in (design.q, design.dq, design.ddq)]
    for q, dq, ddq in ((design.q, design.dq, design.ddq), between):
        tau = judge.torque(q, dq, ddq) * (1 + request.torque_margin)
        for j, joint in enumerate(robot.joints):
            for limits in (joint.limits, request.limits.get(joint.name, Limits())):
                if limits.position is not None:
                    assert limits.position[0] - ROUNDING <= q[:, j].min()
                    assert q[:, j].max() <= limits.position[1] + ROUNDING
                signals = (dq, ddq, tau, tau * dq)
                for bound, signal in zip(
                    (limits.velocity, limits.acceleration, limits.effort, limits.power), signals, strict=True
                ):
                    assert bound is None or np.abs(signal[:, j]).max() <= bound * (1 + ROUNDING)
        tool = request.surroundings.tool_range
        if tool is not None:
            at = judge.tool(q)
            for k in range(3):
                assert tool.low[k] is None or tool.low[k] - ROUNDING <= at[:, k].min()
                assert tool.high[k] is None or at[:, k].max() <= tool.high[k] + ROUNDING
    jerk = np.abs(np.diff(design.ddq, axis=0)).max(axis=0) * rate
    slope = (design.q[2:] - design.q[:-2]) * (0.5 * rate)
    np.testing.assert_allclose(slope, design.dq[1:-1], atol=0.5 * jerk.max() / rate**2 + 1e-9)
    for j, joint in enumerate(robot.joints):
        for limits in (joint.limits, request.limits.get(joint.name, Limits())):
            assert limits.jerk is None or jerk[j] <= limits.jerk * (1 + 1e-6)
    nearest = judge.nearest(design.q[::2], request.surroundings, " ".join(design.notes))
    for pair, distance in nearest.items():
        assert distance >= request.surroundings.clearance - 1e-6, pair
    assert all(margin.share <= 1 for margin in design.margins)


def assert_names_the_limit(judge: Judge, error: ImpossibleLimitsError) -> None:
    names = [*judge.robot.joint_names, *(joint.link for joint in judge.robot.joints if joint.link)]
    assert error.pointer.startswith(("/limits", "/home", "/surroundings"))
    assert any(f"'{name}" in error.detail for name in names) or "the tool would be at" in error.detail


def check_requests(name: str, count: int, least_share: float) -> None:
    judge, seen = judge_of(name), Counter[str]()

    @given(request=requests(name))
    @settings(max_examples=count, deadline=None, suppress_health_check=list(HealthCheck), derandomize=True)
    def check(request: DesignRequest) -> None:
        try:
            design = design_experiment(judge.robot, request)
        except ImpossibleLimitsError as error:
            seen["refused"] += 1
            assert_names_the_limit(judge, error)
            return
        seen["returned"] += 1
        assert_safe(judge, request, design)

    check()
    assert seen["returned"] >= least_share * count, seen


@pytest.mark.parametrize("name", ROBOTS)
def test_what_is_designed_keeps_every_limit_and_touches_nothing(name):
    check_requests(name, 4, 0.0)


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize("name", ROBOTS)
def test_five_hundred_sets_of_limits_are_kept_or_refused_with_the_reason(name):
    check_requests(name, 167, 0.3)
