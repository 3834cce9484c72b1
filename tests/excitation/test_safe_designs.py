from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.signal import resample
from support.robots_with_collision_geometry import Judge, judge_of, safe_robot

from dynident.array_types import FloatArray
from dynident.effects import EffectChoice
from dynident.errors import DynidentError
from dynident.excitation import Design, DesignRequest, TrajectoryRequest, design_experiment
from dynident.motion import Box, ImpossibleLimitsError, Surroundings, ToolRange, Wall
from dynident.robot import Limits

ROBOTS = ("franka_panda", "ur10", "gantry")
SHORT = TrajectoryRequest(duration=3.0, harmonics=3, sampling_rate=200.0)
QUICK = DesignRequest(
    effects=(EffectChoice("coulomb"), EffectChoice("viscous")), trajectory=SHORT, starts=1, random_trajectories=3
)
ROUNDING = 1e-9
EDGES = (0.5, 0.5, 0.5)


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
    boxes = draw(st.lists(st.builds(Box, st.sampled_from("ab"), vector, edges, vector), max_size=2, unique_by=_name))
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


def _name(box: Box) -> str:
    return box.name


def _wall(distance: float, angle: float) -> Wall:
    away = (float(np.cos(angle)), float(np.sin(angle)), 0.0)
    return Wall("fence", (-distance * away[0], -distance * away[1], 0.0), away)


def _tool_range(low: float, size: float) -> ToolRange:
    return ToolRange(low=(low, None, None), high=(low + size, 1.1, None))


def assert_within_joint_limits(
    judge: Judge, request: DesignRequest, q: FloatArray, dq: FloatArray, ddq: FloatArray
) -> None:
    tau = judge.torque(q, dq, ddq) * (1 + request.torque_margin)
    for j, joint in enumerate(judge.robot.joints):
        for limits in (joint.limits, request.limits.get(joint.name, Limits())):
            if limits.position is not None:
                assert limits.position[0] - ROUNDING <= q[:, j].min()
                assert q[:, j].max() <= limits.position[1] + ROUNDING
            bounds = (limits.velocity, limits.acceleration, limits.effort, limits.power)
            for bound, signal in zip(bounds, (dq, ddq, tau, tau * dq), strict=True):
                assert bound is None or np.abs(signal[:, j]).max() <= bound * (1 + ROUNDING)


def assert_tool_within_range(judge: Judge, tool: ToolRange | None, q: FloatArray) -> None:
    if tool is None:
        return
    at = judge.tool(q)
    for k in range(3):
        assert tool.low[k] is None or tool.low[k] - ROUNDING <= at[:, k].min()
        assert tool.high[k] is None or at[:, k].max() <= tool.high[k] + ROUNDING


def assert_safe(judge: Judge, request: DesignRequest, design: Design) -> None:
    """Every limit as the user stated it, on the samples, and between them where the motion is band-limited."""
    robot, rate = judge.robot, design.sampling_rate
    first, last = (round(at * rate) for at in design.exciting)
    looked_at = [(design.q, design.dq, design.ddq)]
    if design.period is not None:
        looked_at.append(tuple(resample(signal[first:last], 4 * (last - first)) for signal in looked_at[0]))
    for q, dq, ddq in looked_at:
        assert_within_joint_limits(judge, request, q, dq, ddq)
        assert_tool_within_range(judge, request.surroundings.tool_range, q)
    jerk = np.abs(np.diff(design.ddq, axis=0)).max(axis=0) * rate
    slope = (design.q[2:] - design.q[:-2]) * (0.5 * rate)
    np.testing.assert_allclose(slope, design.dq[1:-1], atol=0.5 * jerk.max() / rate**2 + 1e-9)
    for j, joint in enumerate(robot.joints):
        for limits in (joint.limits, request.limits.get(joint.name, Limits())):
            assert limits.jerk is None or jerk[j] <= limits.jerk * (1 + 1e-6)
    notes, kept = " ".join(design.notes), request.surroundings.clearance
    if "is required instead of" in notes:
        kept = min(margin.bound for margin in design.margins if margin.limit == "clearance")
    for pair, distance in judge.nearest(design.q[::2], request.surroundings, notes).items():
        assert distance >= kept - 1e-6, pair
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


@pytest.mark.sweep
@pytest.mark.parametrize("name", ROBOTS)
def test_what_is_designed_keeps_every_limit_and_touches_nothing(name):
    check_requests(name, 2, 0.0)


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("name", [pytest.param("franka_panda", marks=pytest.mark.thorough), *ROBOTS[1:]])
def test_drawn_sets_of_limits_are_kept_or_refused_with_the_reason(name, thorough):
    check_requests(name, 167 if thorough else 6, 0.3)


@pytest.mark.slow
def test_optimised_motions_of_the_panda_hit_the_arm_itself_unless_that_is_kept_from_them(thorough):
    judge = judge_of("franka_panda")
    effects = tuple(EffectChoice(name) for name in ("rigid_body", "coulomb", "viscous"))
    careless, careful = [], []
    seeds = 8 if thorough else 3
    for seed in range(seeds):
        request = DesignRequest(effects=effects, starts=1, random_trajectories=20, seed=seed)
        free = design_experiment(judge.robot, replace(request, surroundings=Surroundings(self_collision=False)))
        safe = design_experiment(judge.robot, request)
        careless.append(min(judge.nearest(free.q, Surroundings(), " ".join(safe.notes)).values()))
        careful.append(min(judge.nearest(safe.q, Surroundings(), " ".join(safe.notes)).values()))
        assert safe.criterion_values.condition_number < 60
    # Of three motions one tells that there is something to avoid; a share of them needs more.
    assert sum(distance < 0 for distance in careless) >= (0.6 * seeds if thorough else 1)
    assert min(careful) >= 0.02 - 1e-6


def test_what_comes_near_is_named_with_its_distance():
    design = design_experiment(
        safe_robot("gantry"),
        replace(QUICK, surroundings=Surroundings(boxes=(Box("crate", (0, 0.9, 0.5), (0.5,) * 3),))),
    )
    clearances = [margin for margin in design.margins if margin.limit == "clearance"]
    nearest = judge_of("gantry").nearest(design.q, design.request.surroundings, " ".join(design.notes))
    assert {margin.joint.split(" – ")[0] for margin in clearances} == {"carriage", "upper", "lower", "tool"}
    assert min(margin.value for margin in clearances) == pytest.approx(min(nearest.values()), abs=2e-3)
    assert all(margin.value >= margin.bound == 0.02 for margin in clearances)


def test_the_way_home_goes_around_a_box_between_home_and_start():
    judge = judge_of("gantry")
    pillar = Surroundings(boxes=(Box("pillar", (0.0, 0.06, 1.15), (0.16, 0.6, 0.3)),))
    request = replace(
        QUICK,
        kind="random",
        home=(0.0, -1.6, 0.0, 0.0),
        limits={"shoulder": Limits(position=(-1.7, 1.7)), "elbow": Limits(position=(-1.8, 1.8))},
        surroundings=pillar,
    )
    around = 0
    for seed in range(6):
        design = design_experiment(judge.robot, replace(request, seed=seed))
        assert_safe(judge, request, design)
        np.testing.assert_allclose(design.q[[0, -1]], [request.home] * 2, atol=1e-9)
        way = design.q[: round(design.exciting[0] * design.sampling_rate)] - design.q[0]
        around += np.linalg.matrix_rank(way, tol=1e-3 * np.abs(way).max()) > 1
    assert around > 0


@pytest.mark.parametrize("size", [(1, 1, 1), np.ones(3, dtype=int)], ids=["tuple", "array"])
def test_boxes_that_are_given_one_by_one_in_whole_numbers_are_in_the_way(size):
    block = Surroundings(boxes=(Box(name, (0, 0, 0.6), size) for name in ["block"]))
    with pytest.raises(ImpossibleLimitsError, match="'upper – box 'block'' would touch"):
        design_experiment(safe_robot("gantry"), replace(QUICK, surroundings=block))


def test_a_home_in_the_way_is_refused_by_what_it_touches():
    block = Surroundings(boxes=(Box("block", (0, 0, 0.6), (0.3, 0.3, 0.3)),))
    with pytest.raises(ImpossibleLimitsError, match=r"At home, 'upper – box 'block'' would touch") as caught:
        design_experiment(safe_robot("gantry"), replace(QUICK, home=(0.0, 0.0, 0.0, 0.0), surroundings=block))
    assert caught.value.pointer == "/home"


def test_a_room_too_small_is_refused_by_what_is_in_the_way():
    low = Surroundings(walls=(Wall("ceiling", (0, 0, 0.1), (0, 0, -1)),))
    with pytest.raises(ImpossibleLimitsError, match=r"– wall 'ceiling'' would touch each other"):
        design_experiment(safe_robot("gantry"), replace(QUICK, surroundings=low))


def test_strokes_of_single_joints_end_before_the_floor():
    judge = judge_of("gantry")
    request = DesignRequest(
        kind="slow_sweep",
        trajectory=TrajectoryRequest(duration=8.0, sampling_rate=100.0),
        surroundings=Surroundings(floor=0.0),
        home=(0.0, 0.5, 0.5, 0.0),
        limits={"slide": Limits(position=(-0.3, 0.3))},
    )
    on_it = design_experiment(judge.robot, request)
    assert "Not checked, because no motion changes their distance: carriage – floor (0 m)." in on_it.notes
    assert_safe(judge, request, on_it)
    lower = replace(request, surroundings=Surroundings(floor=-0.05))
    design = design_experiment(judge.robot, lower)
    assert_safe(judge, lower, design)
    free = design_experiment(judge.robot, replace(request, surroundings=Surroundings(assume_floor=False)))
    assert np.ptp(design.q[:, 1]) < 0.9 * np.ptp(free.q[:, 1])


def test_an_arm_on_its_own_floor_keeps_the_clearance_that_its_first_links_can_have():
    robot = safe_robot("ur10")
    design = design_experiment(robot, replace(QUICK, surroundings=Surroundings(floor=0.0)))
    assert any("is required instead of 0.02 m" in note and "floor" in note for note in design.notes)
    assert all(margin.value > 0.01 for margin in design.margins if margin.joint.endswith("– floor"))


def test_a_robot_without_geometry_says_so_and_a_radius_of_its_links_mends_it(scara):
    design = design_experiment(scara, replace(QUICK, kind="random"))
    assert (
        "Self-collision is not checked: the robot's description has no collision geometry that could be read."
        in design.notes
    )
    with pytest.raises(DynidentError, match="no collision geometry") as caught:
        design_experiment(scara, replace(QUICK, surroundings=Surroundings(floor=-0.5)))
    assert caught.value.pointer == "/surroundings"
    tubes = Surroundings(floor=-0.5, link_radius=0.05)
    design = design_experiment(scara, replace(QUICK, kind="random", surroundings=tubes))
    assert any("Capsules of radius 0.05 m" in note for note in design.notes)
    assert {margin.bound for margin in design.margins if margin.limit == "clearance"} == {0.02}


@pytest.mark.parametrize(
    ("surroundings", "pointer"),
    [
        (lambda: Surroundings(clearance=0.0), "/clearance"),
        (lambda: Surroundings(floor=float("nan")), "/floor"),
        (lambda: Surroundings(link_radius=-1.0), "/link_radius"),
        (lambda: Surroundings(boxes=(Box("a", (0, 0, 0), (0, 1, 1)),)), "/size/0"),
        (lambda: Surroundings(walls=(Wall("a", (0, 0, 0), (0, 0, 0)),)), "/surroundings/walls/0/normal"),
        (
            lambda: Surroundings(tool_range=ToolRange(low=(1, None, None), high=(0, None, None))),
            "/surroundings/tool_range",
        ),
        (lambda: Surroundings(tool_range=ToolRange(joint="wrist")), "/surroundings/tool_range/joint"),
        (lambda: Surroundings(may_touch=(("tool", "ghost"),)), "/surroundings/may_touch/0"),
    ],
)
def test_what_is_no_obstacle_is_refused_with_its_place(surroundings, pointer):
    with pytest.raises(DynidentError) as caught:
        design_experiment(safe_robot("gantry"), replace(QUICK, surroundings=surroundings()))
    assert caught.value.pointer == pointer


def test_links_that_may_touch_are_not_kept_apart():
    apart = Surroundings(clearance=0.15, assume_floor=False)
    folded = replace(QUICK, kind="random", home=(0.0, 0.0, 2.79, 0.0))
    with pytest.raises(ImpossibleLimitsError, match="At home, 'tool – carriage'"):
        design_experiment(safe_robot("gantry"), replace(folded, surroundings=apart))
    free = tuple((link, other) for link in ("tool", "lower") for other in ("upper", "carriage", "rail"))
    design_experiment(safe_robot("gantry"), replace(folded, surroundings=replace(apart, may_touch=free)))
