"""Campaigns: errors over a region against their definition, promises, decisions, and whole campaigns to their ends."""

from __future__ import annotations

import re
import subprocess
import sys
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import norm
from support.oracles import pinocchio_torque
from typer.testing import CliRunner

import dynident as dy
from dynident.advice import campaign as campaign_module
from dynident.advice.campaign import PlannedRun, _predict_end, add_run, decide, plan_run, start_campaign
from dynident.advice.campaign_request import DESIGN_SECONDS, DESIGN_STARTS, CampaignRequest, list_designs
from dynident.advice.payload_goal import PayloadErrors
from dynident.advice.prediction_error import (
    RegionRows,
    RunErrors,
    _pool_inflation,
    build_measure,
    compare_with_run,
    compute_effect_errors,
    compute_lacking,
    compute_region_rows,
    evaluate_rows,
    predict_errors,
)
from dynident.diagnosis import diagnose
from dynident.estimation.residual_correlation import compute_sandwich_covariance
from dynident.excitation import CriterionChoice, DesignRequest, TrajectoryRequest, design_experiment
from dynident.excitation.criteria.design_criterion import build_design_criterion
from dynident.excitation.criteria.optimality_criteria import compute_true_values
from dynident.excitation.criteria.prediction_region import Region, collect_region, count_harmonics, draw_region
from dynident.excitation.design_observation_matrix import build_design_model
from dynident.excitation.design_request import compute_planned_seconds
from dynident.excitation.design_result import expect_recording, follows_design
from dynident.excitation.expected_torque import ExpectedTorque
from dynident.identification import identify
from dynident.motion.limits.bounds import slow_down_limits
from dynident.presentation.design_tables import build_campaign_table
from dynident.recordings import choose_preprocessing
from dynident.recordings.row_storage import load_stored_samples
from dynident.reports.figures.design import draw_campaign
from dynident.simulation import (
    Reference,
    Sensors,
    SimulationRequest,
    build_typical_effect,
    list_drive_effects,
    simulate,
    write_simulated_recording,
)
from dynident_cli.commands import campaign as campaign_command
from dynident_cli.program_and_exit_codes import app

ARM = dy.load_robot("scara")
RATE = 100.0
DESIGN = DesignRequest(
    starts=1, random_trajectories=10, trajectory=TrajectoryRequest(duration=6.0, harmonics=3, sampling_rate=RATE)
)
POINTS = replace(DESIGN.trajectory, family="point_to_point", duration=10.0)
REQUEST = CampaignRequest(error=0.02, minutes=2.0, design=DESIGN)


def measured(design, seed: int, hidden: str = ""):
    """What the virtual arm measures along a design."""
    effects = list_drive_effects(ARM)
    if hidden:
        effects = (*effects, build_typical_effect(ARM, hidden, "elbow"))
    motion = Reference(design.t, design.q, design.dq, design.ddq)
    return simulate(ARM, SimulationRequest(motion, effects, sensors=Sensors(sampling_rate=200.0), seed=seed))


def recorded(design, name: str, hidden: str = "", silent: int | None = None):
    """The same as a recording; the torque of a joint may be missing."""
    run = measured(design, int(name.removeprefix("run")), hidden)
    tau = run.tau if silent is None else np.where(np.arange(ARM.n) == silent, np.nan, run.tau)
    data = {"t": run.t, "q": run.q, "tau": tau}
    return replace(dy.read_recordings(data, robot=ARM)[0].recording, name=name)


@cache
def first_run(harmonics: int = DESIGN.trajectory.harmonics):
    """A campaign after its first run, the plan of that run, and the plan of the next."""
    # A slow run is half as long as a run may be; the next one is as long as it may be.
    requests = [
        replace(DESIGN, trajectory=replace(DESIGN.trajectory, harmonics=harmonics, duration=duration))
        for duration in (12.0, 6.0)
    ]
    start, then = (start_campaign(ARM, replace(REQUEST, error=1e-4, design=design)) for design in requests)
    plan = plan_run(start)
    state = add_run(replace(start, request=then.request), recorded(plan.design, "run1"), plan)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(campaign_module, "list_designs", lambda longest: (longest,))
        return plan, state, plan_run(state)


def test_a_motion_begins_near_home_where_that_costs_little():
    # Joints that turn twice around: starts that are drawn anywhere are several radians away.
    state = start_campaign(dy.load_robot("xarm7"), REQUEST)
    slow = slow_down_limits(state.robot, {}, REQUEST.first_speed)
    requested = replace(state.request.design, limits=slow, effects=state.request.choices.effects)
    planned, plain = plan_run(state).design, design_experiment(state.robot, requested)
    moves = [design.duration - (design.exciting[1] - design.exciting[0]) for design in (planned, plain)]
    assert moves[0] < 0.5 * moves[1]


def test_the_shortest_run_that_reaches_the_goal_is_planned():
    plan, state, _ = first_run()
    assert measure_motion(plan) == pytest.approx(6.0, abs=0.1)
    easy = plan_run(replace(state, request=replace(state.request, error=0.02)))
    assert (easy.promised <= 0.02).all()
    assert measure_motion(easy) == pytest.approx(3.0, abs=0.1)


@pytest.fixture
def plan_lengths(monkeypatch):
    """A function that plans a run of a state; it returns the length planned, s, and those that were designed.

    Motions are only lengths here, with moves of 1 s, and their promises are given; one that promises 0 does not exist.
    """

    def plan(state, promises):
        designed = []

        def design_motion(state, request, progress, speed=1.0):
            seconds = compute_planned_seconds(request)
            designed.append(seconds)
            if promises.get(seconds) == 0.0:
                raise dy.DynidentError("no motion of this length was found")
            return SimpleNamespace(seconds=seconds, duration=seconds + 1.0, moves=1.0)

        monkeypatch.setattr(campaign_module, "_design_motion", design_motion)
        monkeypatch.setattr(
            campaign_module, "predict_errors", lambda model, measure, design, last: np.full(4, promises[design.seconds])
        )
        design = plan_run(state).design
        return design.duration - design.moves, designed

    return plan


def test_a_longer_run_is_planned_only_where_it_tells_more_for_its_time(plan_lengths):
    _, state, _ = first_run()
    (run,) = state.runs
    state = replace(state, runs=(replace(run, parameters=np.full(4, 0.1), lacking=np.zeros(4)),))
    request = replace(REQUEST, error=0.01, design=replace(DESIGN, trajectory=replace(DESIGN.trajectory, duration=10.0)))

    def plan(promises, **changes):
        return plan_lengths(replace(state, request=replace(request, **changes)), promises)

    # One search is enough where the shortest run reaches the goal, and no more than two are made.
    assert plan({2.5: 0.01}) == (2.5, [2.5])
    # A longer one that promises more error, or less error but much later, is not taken.
    assert plan({2.5: 0.02, 10.0: 0.03}) == (2.5, [2.5, 10.0])
    assert plan({2.5: 0.012, 10.0: 0.009}) == (2.5, [2.5, 10.0])
    assert plan({2.5: 0.04, 10.0: 0.015}) == (10.0, [2.5, 10.0])
    # In the last run what it tells counts, and not its time.
    assert plan({2.5: 0.012, 10.0: 0.009}, runs=2) == (10.0, [2.5, 10.0])
    assert plan({2.5: 0.02, 10.0: 0.03}, runs=2) == (2.5, [2.5, 10.0])
    # A run and its moves have to fit into the time that is left.
    for left, fitting in ((11.1, 10.0), (10.9, 5.0), (5.9, 2.5), (1.0, 2.5)):
        short = {"minutes": (state.seconds + left) / 60}
        promises = dict.fromkeys((5.0, 10.0), 0.015) | {2.5: 0.04}
        assert plan(promises, **short)[0] == fitting
    # A longer motion may keep limits that a shorter one cannot keep.
    assert plan({2.5: 0.0, 10.0: 0.03}) == (10.0, [2.5, 10.0])
    with pytest.raises(dy.DynidentError, match="no motion of this length"):
        plan({2.5: 0.0}, minutes=(state.seconds + 4.0) / 60)
    assert plan({10.0: 0.03}, design=replace(request.design, trajectory=POINTS)) == (10.0, [10.0])


def test_runs_without_a_promise_leave_the_time_for_those_that_have_to_follow(plan_lengths):
    design = replace(DESIGN, trajectory=replace(DESIGN.trajectory, duration=10.0))
    _, after_first, _ = first_run()

    def plan(seconds, **changes):
        state = start_campaign(ARM, replace(REQUEST, design=design, minutes=seconds / 60, **changes))
        return plan_lengths(state, {})

    assert plan(9.6) == (5.0, [5.0])
    # The shortest run that follows takes 3.5 s with its moves, which are known once a motion is designed.
    assert plan(9.4) == (2.5, [5.0, 2.5])
    assert plan(3.6) == (2.5, [2.5])
    first = r"The first run, at 30\.0.% of the velocity limits, takes 3\.50 s with its moves from and to home"
    with pytest.raises(dy.DynidentError, match=first) as refused:
        plan(3.0)
    assert refused.value.pointer == "/minutes"
    load = {"goal": "payload", "unloaded_runs": 2}
    assert [plan(seconds, **load)[0] for seconds in (13.1, 12.9, 10.6)] == [5.0, 2.5, 2.5]
    with pytest.raises(
        dy.DynidentError, match=r"3 runs, the last with the load, take 10\.5 s with their moves"
    ) as refused:
        plan(10.4, **load)
    assert refused.value.pointer == "/minutes"
    # For effects a run is as long as it may be.
    state = after_first
    for left, expected in ((11.1, (10.0, [10.0])), (10.9, (5.0, [10.0, 5.0])), (5.1, (2.5, [5.0, 2.5]))):
        minutes = (state.seconds + left) / 60
        request = replace(REQUEST, goal="effects", decide=("stribeck",), design=design, minutes=minutes)
        assert plan_lengths(replace(state, request=request), {}) == expected


def test_options_of_a_motion_say_what_they_are_for_the_runs_of_a_campaign():
    words = " ".join(CliRunner().invoke(app, ["campaign", "--help"], env={"COLUMNS": "200"}).stdout.split())
    assert "a run may take half or a quarter of it, in s" in words
    assert f"by default {DESIGN_STARTS}, or as many as the time allows" in words


def test_a_search_that_is_not_stated_makes_few_starts_and_ends_in_time():
    def start(**changes):
        design = start_campaign(ARM, replace(REQUEST, design=replace(DESIGN, starts=None, **changes))).request.design
        return design.starts, design.time_budget

    assert start() == (DESIGN_STARTS, DESIGN_SECONDS)
    assert start(time_budget=60.0) == (None, 60.0)


def measure_motion(planned) -> float:
    """Return the time of a planned motion without the moves from and to home, s."""
    start, end = planned.design.exciting
    return end - start


def test_shorter_runs_keep_the_highest_frequency_and_the_usual_number_of_harmonics():
    def count(**changes):
        trajectory = replace(DESIGN.trajectory, **{"duration": 10.0, "harmonics": 12, **changes})
        designs = list_designs(replace(DESIGN, trajectory=trajectory))
        return [(d.trajectory.duration, d.trajectory.periods, d.trajectory.harmonics) for d in designs]

    assert count() == [(2.5, 1, 5), (5.0, 1, 6), (10.0, 1, 12)]
    assert count(harmonics=3) == [(2.5, 1, 3), (5.0, 1, 3), (10.0, 1, 3)]
    assert count(periods=4) == [(10.0, 1, 12), (10.0, 2, 12), (10.0, 4, 12)]
    assert count(periods=3) == [(7.5, 1, 9), (10.0, 1, 12), (10.0, 3, 12)]
    # Whole periods: none is longer or has more harmonics than was requested.
    assert count(periods=5, harmonics=90) == [(10.0, 1, 90), (10.0, 2, 90), (10.0, 5, 90)]
    assert count(duration=0.02) == [(0.02, 1, 12)]
    # A run of a second is mostly ends; a motion from point to point has no duration of its own.
    assert count(duration=4.0) == [(2.0, 1, 6), (4.0, 1, 12)]
    assert count(family="point_to_point") == [(10.0, 1, 12)]
    assert count(sampling_rate=6.0) == [(5.0, 1, 6), (10.0, 1, 12)]


def test_figure_and_table_count_short_campaigns_in_seconds():
    _, state, _ = first_run()
    assert "robot time (s)" in draw_campaign(state)
    long = replace(state, runs=tuple(replace(run, seconds=200.0) for run in state.runs))
    assert "robot time (min)" in draw_campaign(long)
    tables = [build_campaign_table(each.runs, each.request, ARM.joint_names) for each in (state, long)]
    assert [table.columns[1] for table in tables] == ["robot time so far (s)", "robot time so far (min)"]
    assert tables[0].rows[0][1].value == pytest.approx(state.seconds)
    assert tables[1].rows[0][1].value == pytest.approx(200.0 / 60.0)


def test_what_a_model_lacks_counts_all_runs_by_their_time():
    def run(excess: float, scatter: float, seconds: float) -> RunErrors:
        return RunErrors(np.zeros(1), np.array([excess]), np.array([scatter]), np.array([seconds]))

    # A short run with a large residual by chance, after a long one without.
    short, long = run(4.0, 1.0, 1.0), run(0.0, 0.5, 9.0)
    assert compute_lacking([short]) == pytest.approx([np.sqrt(4.0 - norm.ppf(0.95))])
    assert compute_lacking([long, short]) == pytest.approx([0.0])
    assert compute_lacking([run(4.0, 1.0, 5.0)] * 2) == pytest.approx([np.sqrt(4.0 - norm.ppf(0.95) / np.sqrt(2))])
    assert compute_lacking([run(0.0, 0.0, 0.0)]) == pytest.approx([0.0])


def test_chance_is_no_lack_on_any_joint_with_95_per_cent_probability():
    draws = np.random.default_rng(5).standard_normal((4000, 7))
    lacking = [compute_lacking([RunErrors(np.zeros(7), draw, np.ones(7), np.ones(7))]) for draw in draws]
    assert np.mean(np.max(lacking, axis=1) > 0) == pytest.approx(0.05, abs=0.012)


def test_one_short_run_does_not_decide_alone_how_correlated_residuals_are():
    plan, _, _ = first_run()
    pooled, own = [], []
    for seed in range(21, 29):
        model = identify(ARM, [recorded(plan.design, f"run{seed}")], (), REQUEST.choices)
        pooled.append(_pool_inflation(model, 200.0))
        own.append(model.data.training.row_counts / model.statistics.effective_rows)
    # The residual of these runs is filtered noise alone, of one factor.
    assert np.log(pooled).std(axis=0).max() < 0.5 * np.log(own).std(axis=0).mean()
    assert np.log(pooled).mean() == pytest.approx(np.log(own).mean(), abs=0.2)


def test_what_a_model_lacks_at_speed_counts_though_the_slow_run_does_not_show_it():
    _, state, following = first_run()
    run = measured(following.design, 2)
    # A torque that no effect explains, and that grows with the speed of another joint.
    unknown = 2.0 * np.sin(3.0 * run.q[:, 0]) * (np.gradient(run.q[:, 0], run.t) / 2.5) ** 2
    tau = run.tau + np.where(np.arange(ARM.n) == 1, unknown[:, None], 0.0)
    fast = replace(dy.read_recordings({"t": run.t, "q": run.q, "tau": tau}, robot=ARM)[0].recording, name="run2")
    state = add_run(state, fast, following)
    slow, alone = (compare_with_run(state.identification, recording) for recording in state.recordings)
    torque = compute_region_rows(state.identification, state.region).torque
    assert state.runs[-1].lacking == pytest.approx(compute_lacking([alone]) / torque)
    assert state.runs[-1].lacking[1] > 1.2 * compute_lacking([slow, alone])[1] / torque[1] > 0


def read_positions(recording):
    """Positions (m, n) of a recording."""
    columns = load_stored_samples(recording).columns
    return np.column_stack([columns[f"q_{name}"] for name in recording.joint_names])


def test_the_error_of_one_parameter_is_that_of_its_normal_distribution():
    rows = RegionRows(np.array([[[4.0]]]), np.array([10.0]), 1e6)
    # The torque is 2 χ: with a standard deviation of 0.5 in χ its error stays below 1.96 · 2 · 0.5 in 95 of 100 cases.
    assert rows.compute_errors(np.array([[0.25]])) == pytest.approx([norm.ppf(0.975) / 10], rel=0.06)


def test_the_errors_of_two_joints_hold_together():
    rows = RegionRows(np.array([np.diag([1.0, 0.0]), np.diag([0.0, 4.0])]), np.ones(2), 1e6)
    # Of two independent errors both stay below z with the probability 0.95 where each does with its root.
    z = norm.ppf(0.5 + 0.5 * np.sqrt(0.95))
    assert rows.compute_errors(np.eye(2)) == pytest.approx([z, 2 * z], rel=0.06)
    # With few degrees of freedom they are larger.
    assert (replace(rows, freedom=6.0).compute_errors(np.eye(2)) > 1.15 * rows.compute_errors(np.eye(2))).all()


def test_the_criterion_is_the_variance_of_the_torque_over_the_region():
    model = build_design_model(ARM, [dy.EffectChoice("rigid_body"), dy.EffectChoice("viscous")])
    region = draw_region(ARM, {}, seed=3)
    criterion = build_design_criterion(model, CriterionChoice("prediction"), {}, region=region)
    w = np.random.default_rng(0).standard_normal((60 * ARM.n, model.n_parameters))
    rows = model.observe(region.q, region.dq, region.ddq)
    variances = np.einsum("ra,ab,rb->r", rows, np.linalg.inv(w.T @ w / 60), rows).reshape(-1, ARM.n)
    torque = pinocchio_torque(ARM, region.q, region.dq, region.ddq)
    expected = (variances.mean(axis=0) / (torque**2).mean(axis=0)).sum()
    values = compute_true_values(criterion.choice, w, 60, criterion.a_priori, criterion.deciding)
    assert values.criterion == pytest.approx(expected, rel=1e-6)
    smooth, gradient = criterion.smooth_criterion(w)
    assert np.exp(smooth) == pytest.approx(60 * expected / 60**2, rel=1e-6)
    direction = np.random.default_rng(1).standard_normal(w.shape)
    ends = [criterion.smooth_criterion(w + s * direction)[0] for s in (1e-6, -1e-6)]
    assert np.sum(gradient * direction) == pytest.approx((ends[0] - ends[1]) / 2e-6, rel=1e-4)


def test_the_first_motion_is_slow_and_promises_nothing():
    plan, _, following = first_run()
    limits = np.array([joint.limits.velocity for joint in ARM.joints])
    assert plan.promised is None
    assert (np.abs(plan.design.dq).max(axis=0) <= 0.3 * limits + 1e-9).all()
    assert (np.abs(following.design.dq).max(axis=0) > 0.3 * limits).any()


def test_a_motion_that_is_made_for_ever_leaves_no_uncertainty_and_never_more_than_before():
    _, state, following = first_run()
    rows = compute_region_rows(state.identification, state.region)
    errors = [
        predict_errors(state.identification, rows, following.design, state.recordings[-1], k) for k in (0.0, 1.0, 1e9)
    ]
    assert errors[0] == pytest.approx(state.runs[-1].parameters, rel=1e-6)
    assert (errors[1] < errors[0]).all()
    assert errors[2].max() < 1e-3


def test_a_promise_counts_the_whole_motion_but_what_filters_take_from_its_ends():
    _, state, following = first_run()
    rows = compute_region_rows(state.identification, state.region)
    design, last = following.design, state.recordings[-1]
    promised = predict_errors(state.identification, rows, design, last)
    # Standing for two seconds at either end tells nothing, but spares the ways there and back the ends of the filters.
    wait = np.arange(1.0, 2.0 * RATE + 1.0)
    longer = replace(
        design,
        t=np.concatenate([design.t[0] - wait[::-1] / RATE, design.t, design.t[-1] + wait / RATE]),
        **{
            name: np.pad(getattr(design, name), ((len(wait), len(wait)), (0, 0)), mode)
            for name, mode in (("q", "edge"), ("dq", "constant"), ("ddq", "constant"))
        },
    )
    waited = predict_errors(state.identification, rows, longer, last)
    assert waited.sum() < promised.sum()
    # Rows beside the longer halts are left out, the quantiles of the errors are those of a thousand draws, and filters
    # spread over more of a short move from home.
    assert (waited < 1.1 * promised).all()
    assert (waited > 0.4 * promised).all()


def test_a_promise_counts_rows_at_reversals_by_their_weight():
    _, state, following = first_run(TrajectoryRequest.harmonics)
    identification = state.identification
    rows = compute_region_rows(identification, state.region)
    training = identification.data.training

    def promise(weight: float):
        # The rows so far stay as they are; those of the planned motion are weighted anew.
        equations = tuple(replace(e, weighted_rows=replace(e.weighted_rows, weight=weight)) for e in training.equations)
        data = replace(identification.data, training=replace(training, equations=equations))
        return predict_errors(replace(identification, data=data), rows, following.design, state.recordings[-1])

    assert all(0.1 < equation.weighted_rows.weight < 1 for equation in training.equations)
    own = predict_errors(identification, rows, following.design, state.recordings[-1])
    assert promise(1.0).sum() < own.sum() < promise(0.01).sum()


def test_a_promise_filters_the_planned_motion_as_its_recording_will_be():
    _, state, following = first_run(TrajectoryRequest.harmonics)
    model, rows, last = (
        state.identification,
        compute_region_rows(state.identification, state.region),
        state.recordings[-1],
    )
    expected = choose_preprocessing((last, expect_recording(following.design, last)))
    actual = choose_preprocessing((last, recorded(following.design, "run2")))
    assert expected.torque_cutoff == pytest.approx(actual.torque_cutoff, rel=0.05)
    own = predict_errors(model, rows, following.design, last)
    # Filters that the caller chose stay; three times as many rows, with three times the variance, tell as much.
    wide = replace(model.preprocessing, torque_cutoff=39.0, position_cutoff=54.0, decimation=1)
    assert model.preprocessing.decimation == 3
    fixed = replace(model, choices=replace(model.choices, preprocessing=wide))
    filtered_less = predict_errors(fixed, rows, following.design, last)
    assert not np.allclose(own, filtered_less, rtol=1e-3)
    assert own == pytest.approx(filtered_less, rel=0.3)


def test_a_poor_last_motion_does_not_bound_what_the_time_that_is_left_brings():
    _, state, following = first_run()
    rows = compute_region_rows(state.identification, state.region)
    design = following.design
    still = replace(design, q=np.tile(design.q[:1], (len(design.t), 1)), dq=0 * design.dq, ddq=0 * design.ddq)
    at_end = _predict_end(state, rows, PlannedRun(still, None))
    now = state.runs[-1].parameters * np.sqrt(state.seconds / (state.seconds + state.seconds_left))
    assert at_end == pytest.approx(np.hypot(now, state.runs[-1].lacking))


def test_a_short_last_motion_does_not_bound_what_longer_ones_bring():
    _, state, following = first_run()
    rows = compute_region_rows(state.identification, state.region)
    short = plan_run(state)
    assert short.design.duration < 0.6 * following.design.duration
    # One run is left, for which there is time as long as it may be.
    state = replace(state, request=replace(state.request, runs=2))
    at_end = _predict_end(state, rows, short)
    count = (6.0 + short.design.moves) / short.design.duration
    again = predict_errors(state.identification, rows, short.design, state.recordings[-1], count)
    assert (at_end <= np.hypot(again, state.runs[-1].lacking) + 1e-12).all()


def test_a_joint_that_stuck_at_its_reversals_is_expected_to_stick_at_those_of_the_next_motion():
    _, state, following = first_run()
    design, recording = following.design, state.recordings[-1]
    turns = [np.flatnonzero(design.dq[:-1, j] * design.dq[1:, j] < 0) for j in range(ARM.n)]
    # The virtual arm's joints break loose at once; here the elbow holds its place for a tenth of a second.
    held = expect_recording(design, recording)
    t, q = np.arange(held.segments[0].length) * held.period, read_positions(held)
    start = int(design.t[turns[1][0]] / held.period)
    assert len(turns[1]) > 1
    for k in turns[1]:
        row = int(design.t[k] / held.period)
        q[row : row + round(0.1 / held.period), 1] = q[row, 1]
    stuck = dy.read_recordings({"t": t, "q": q, "tau": np.zeros_like(q)}, robot=ARM)[0].recording
    later = read_positions(expect_recording(design, stuck))
    after = slice(start + 2, start + round(0.05 / held.period))
    assert np.ptp(later[after, 1]) == pytest.approx(0.0, abs=1e-9)
    assert later[:, 0] == pytest.approx(read_positions(held)[:, 0])
    # A controller overcomes friction by the error of the position: four times as fast, the plan is as far ahead in a
    # quarter of the time.
    fast = replace(design, t=design.t / 4, dq=4 * design.dq, ddq=16 * design.ddq)
    holds = []
    for plan in (design, fast):
        positions = read_positions(expect_recording(plan, stuck))[:, 1]
        paths = [positions[int(plan.t[k] / held.period) + 2 :] for k in turns[1]]
        holds.append(max(int(np.argmax(np.abs(np.diff(path)) > 1e-9)) for path in paths))
    assert 0 < 2 * holds[1] < holds[0]
    # One that seems to stick at half of them lingers there by itself; it is not expected to stick.
    for k in turns[1][::2]:
        row = int(design.t[k] / held.period)
        q[row : row + round(0.1 / held.period), 1] = read_positions(held)[row : row + round(0.1 / held.period), 1]
    half = dy.read_recordings({"t": t, "q": q, "tau": np.zeros_like(q)}, robot=ARM)[0].recording
    assert read_positions(expect_recording(design, half)) == pytest.approx(read_positions(held))


def test_filters_leave_the_inertia_of_an_arm_whose_joints_break_loose_as_it_is():
    plan, state, following = first_run()
    effects = list_drive_effects(ARM)
    runs = []
    for design in (plan.design, following.design):
        motion = Reference(design.t, design.q, design.dq, design.ddq)
        run = simulate(ARM, SimulationRequest(motion, effects, sensors=Sensors(torque_noise=1e-6)))
        runs.append(dy.read_recordings({"t": run.t, "q": run.q, "tau": run.tau}, robot=ARM)[0].recording)
    found = identify(ARM, runs, ())
    region = state.region
    drives = {(effect.effect, effect.joint): effect.values[0][1] for effect in effects}
    rotor, coulomb, viscous = (
        np.array([drives[effect, joint] for joint in ARM.joint_names])
        for effect in ("rotor_inertia", "coulomb", "viscous")
    )
    torque = pinocchio_torque(ARM, region.q, region.dq, region.ddq)
    torque += rotor * region.ddq + coulomb * np.sign(region.dq) + viscous * region.dq
    wrong = evaluate_rows(found, region.q, region.dq, region.ddq) @ found.values - torque
    # The elbow's is 0.042 % where the acceleration passes the filter of the positions.
    assert np.sqrt((wrong[:, 1] ** 2).mean() / (torque[:, 1] ** 2).mean()) < 1.5e-4


def test_a_design_for_the_prediction_predicts_better_than_one_for_the_condition_number():
    _, state, following = first_run()
    other = design_experiment(ARM, replace(DESIGN, effects=state.identification.model.effects, seed=1))
    rows = compute_region_rows(state.identification, state.region)
    own, rival = (
        predict_errors(state.identification, rows, design, state.recordings[-1]) for design in (following.design, other)
    )
    assert own.max() < rival.max()


def test_decisions_say_what_is_in_the_way():
    _, state, following = first_run()
    rows = compute_region_rows(state.identification, state.region)

    def decided(**changes):
        runs = changes.pop("runs", 2) * state.runs
        run = replace(runs[-1], **{name: np.full(ARM.n, value) for name, value in changes.items() if name != "request"})
        request = changes.get("request", REQUEST)
        return decide(replace(state, runs=(*runs[:-1], run), request=request), rows, following)

    assert decided(parameters=0.01, lacking=0.0).code == "reached"
    assert decided(parameters=0.01, lacking=0.0, runs=1).code == "next_run"
    assert decided(parameters=0.03, lacking=0.0).code == "next_run"
    lacking = decided(parameters=0.001, lacking=0.05)
    assert (lacking.code, "no effect of the catalogue" in lacking.sentence) == ("not_reachable", True)
    assert decided(parameters=0.03, lacking=0.0, request=replace(REQUEST, minutes=0.05)).code == "out_of_time"
    # The shortest run takes 3 s, and its moves.
    left = replace(REQUEST, minutes=(2 * state.seconds + 3.0 + 0.9 * following.design.moves) / 60)
    assert decided(parameters=0.03, lacking=0.0, request=left).code == "out_of_time"
    never = replace(REQUEST, error=1e-6, minutes=0.7)
    hopeless = decided(parameters=0.03, lacking=0.0, runs=3, request=never)
    assert (hopeless.code, "Give more minutes or runs" in hopeless.sentence) == ("not_reachable", True)
    # One motion at full speed may be a poor one, whose repetition says little of those to come.
    assert decided(parameters=0.03, lacking=0.0, request=never).code == "next_run"
    # Time for thousands of runs is worth nothing where the number of runs is limited.
    long, few = (replace(REQUEST, error=0.002, minutes=1000.0, runs=runs) for runs in (10_000, 4))
    codes = [decided(parameters=0.03, lacking=0.0, runs=3, request=request).code for request in (long, few)]
    assert codes == ["next_run", "not_reachable"]
    # A load has no relative error that could be larger, and an effect none at all.
    for goal, larger in (
        ("torque", " or a larger error"),
        ("payload", " or a larger mass_error or centre_error"),
        ("effects", ""),
    ):
        request = replace(REQUEST, goal=goal, decide=ARM.joint_names, quantities=ARM.joint_names, minutes=0.05)
        assert decided(parameters=2.0, lacking=0.0, request=request).sentence.endswith(f"Give more{larger}.")
    broken = decided(parameters=0.5, lacking=0.0, promised=0.01)
    assert "less than promised" in broken.sentence


def test_chance_is_no_lack_of_the_model_and_a_missing_effect_is_one():
    plan, _, following = first_run()
    seen = {}
    for hidden in ("", "joint_spring"):
        lacking = []
        for seed in range(11, 17):
            runs = [
                recorded(design, f"run{10 * seed + k}", hidden)
                for k, design in enumerate((plan.design, following.design))
            ]
            model = identify(ARM, runs, (), REQUEST.choices)
            lacking += [compute_lacking([compare_with_run(model, run)]) for run in runs]
        seen[hidden] = np.array(lacking)
    # Six pairs of runs of four joints: with 95 % probability each.
    assert np.count_nonzero(seen[""]) <= 5
    # The usual spring leaves some 0.8 N m in the slow run and 2 in the other; chance explains little of that.
    assert (seen["joint_spring"][:, 1] > 0.7).all()


def test_effects_are_recommended_alike_without_detection_limits():
    plan, _, following = first_run()
    runs = [recorded(plan.design, "run91", "joint_spring"), recorded(following.design, "run92", "joint_spring")]
    model = identify(ARM, runs, (), REQUEST.choices)
    whole, quick = (diagnose(model, runs, with_limits=with_limits) for with_limits in (True, False))
    assert [choice.effect for choice in whole.recommended] == ["joint_spring"]
    assert (quick.recommended, quick.detection_limits) == (whole.recommended, ())
    assert whole.detection_limits


def test_a_joint_without_torque_never_reaches_the_goal():
    plan, _, _ = first_run()
    state = start_campaign(ARM, replace(REQUEST, error=1.0))
    for name in ("run1", "run2"):
        state = add_run(state, recorded(plan.design, name, silent=1))
        assert state.runs[-1].errors[1] >= 1.0
        assert state.decision.code == "not_reachable"
        assert f"The torque of {ARM.joint_names[1]} was not recorded" in state.decision.sentence


def test_a_promise_counts_for_its_own_motion_alone():
    plan, state, following = first_run()
    own = recorded(following.design, "run2")
    assert follows_design(own, following.design)
    assert not follows_design(own, plan.design)
    # The first motion is slow and small.
    assert not follows_design(state.recordings[0], following.design)
    other = add_run(state, recorded(plan.design, "run3"), following)
    assert other.runs[-1].promised is None


def test_a_motion_whose_ends_the_filters_cut_off_is_followed():
    # Fast for the first and the last half second, slow between.
    t = np.arange(0.0, 3.0, 0.01)
    frequency = np.where((t < 0.5) | (t > 2.5), 3.0, 0.3)
    phase, amplitude = 2 * np.pi * np.cumsum(frequency) * 0.01, np.array([0.4, 0.4, 0.05, 0.4])
    q = amplitude * np.sin(phase)[:, None] - [0.0, 0.0, 0.1, 0.0]
    dq = amplitude * (2 * np.pi * frequency * np.cos(phase))[:, None]
    made = dy.read_recordings({"t": t, "q": q, "tau": np.zeros_like(q)}, robot=ARM)[0].recording
    ddq = np.gradient(dq, t, axis=0)
    assert follows_design(made, SimpleNamespace(t=t, q=q, dq=dq, ddq=ddq))
    assert not follows_design(made, SimpleNamespace(t=0.5 * t, q=q, dq=2 * dq, ddq=4 * ddq))


@pytest.mark.parametrize("frequency", [6.0, 10.0])
def test_a_fast_motion_is_followed_though_differences_of_its_positions_smooth_it(frequency):
    t, amplitude, omega = np.arange(0.0, 4.0, 0.005), np.array([0.02, 0.02, 0.01, 0.02]), 2 * np.pi * frequency
    swing, speed = amplitude * np.sin(omega * t)[:, None], omega * amplitude * np.cos(omega * t)[:, None]
    q = swing - [0.0, 0.0, 0.1, 0.0]
    made = dy.read_recordings({"t": t, "q": q, "tau": np.zeros_like(q)}, robot=ARM)[0].recording
    assert follows_design(made, SimpleNamespace(t=t, q=q, dq=speed, ddq=-(omega**2) * swing))
    assert not follows_design(made, SimpleNamespace(t=0.5 * t, q=q, dq=2 * speed, ddq=-4 * omega**2 * swing))


def test_a_run_is_told_once_and_only_motions_of_all_joints_add_up():
    _, state, _ = first_run()
    with pytest.raises(dy.DynidentError, match="run1 has the samples of an earlier run"):
        add_run(state, state.recordings[0])
    with pytest.raises(dy.DynidentError, match="all joints"):
        start_campaign(ARM, replace(REQUEST, design=replace(DESIGN, kind="reversals")))
    with pytest.raises(dy.DynidentError, match=r"one run takes 3 s, and all together may take 1\.8 s"):
        start_campaign(ARM, replace(REQUEST, minutes=0.03))
    warm = replace(REQUEST.choices, effects=(*REQUEST.choices.effects, dy.EffectChoice("temperature_friction")))
    with pytest.raises(dy.DynidentError, match="temperature_friction depends on more than the motion"):
        start_campaign(ARM, replace(REQUEST, choices=warm))
    with pytest.raises(dy.DynidentError, match="before the first run"):
        dy.Campaign(ARM).plot()


def test_states_and_the_slow_motion_keep_to_the_limits_of_the_campaign():
    limits = {"elbow": dy.Limits(position=(-0.1, 0.1), velocity=0.5)}
    region = draw_region(ARM, limits, 1.0)
    assert np.abs(region.q[:, 1]).max() <= 0.1
    assert np.abs(region.dq[:, 1]).max() <= 0.5
    state = start_campaign(ARM, replace(REQUEST, design=replace(DESIGN, limits=limits)))
    assert np.abs(state.region.q[:, 1]).max() <= 0.1
    design = plan_run(state).design
    assert np.abs(design.dq[:, 1]).max() <= 0.15 + 1e-9


def test_a_joint_of_short_stroke_moves_as_fast_as_its_torque_is_to_be_predicted():
    usual = TrajectoryRequest.harmonics
    _, state, following = first_run(usual)
    quill = ARM.joint_names.index("quill")
    assert np.abs(following.design.dq[:, quill]).max() > 0.8 * np.abs(state.region.dq[:, quill]).max()
    # A long period needs more harmonics. What the caller chose stays, and so does a motion that has none.
    needed = count_harmonics(state.region, ARM, {}, 20.0)
    assert needed > 12
    for robot, changes, expected in (
        (ARM, {"harmonics": usual}, needed),
        (dy.load_robot("ur5"), {"harmonics": usual, "duration": 6.0}, usual),
        (ARM, {"harmonics": 3}, 3),
        (ARM, {"harmonics": 12}, 12),
        (ARM, {"harmonics": usual, "family": "b_spline"}, usual),
    ):
        design = replace(DESIGN, trajectory=replace(DESIGN.trajectory, **{"duration": 20.0, **changes}))
        started = start_campaign(robot, replace(REQUEST, design=design))
        assert started.request.design.trajectory.harmonics == expected
    # Over a tiny stroke the acceleration bounds the speed, and the unknowns of the search are bounded.
    tiny = {"quill": dy.Limits(position=(-1e-4, 1e-4), acceleration=1.0)}
    assert 5 < count_harmonics(state.region, ARM, tiny, 0.5) < 20
    assert count_harmonics(state.region, ARM, tiny, 60.0) == 20


def test_a_joint_that_the_region_never_loads_is_judged_by_its_noise():
    _, state, following = first_run()
    still = Region(*(np.zeros((20, ARM.n)) for _ in range(3)))
    rows = compute_region_rows(state.identification, still)
    errors = predict_errors(state.identification, rows, following.design, state.recordings[-1])
    assert np.isfinite(errors).all()
    assert (rows.torque >= state.identification.noise).all()


def test_the_promise_for_a_load_that_only_one_covariance_shows_is_a_number_above_zero():
    _, state, following = first_run()
    identification = state.identification
    covariance = identification.statistics.covariance
    # Larger by its pooled covariance than by its own; the mass is between the bounds at which each shows it.
    pooled = compute_sandwich_covariance(
        identification.data.training, identification.estimate.solution, _pool_inflation(identification, 200.0)
    )
    own, other = (1.96 * np.sqrt(np.diag(matrix)) for matrix in (covariance, pooled))
    column = int(np.argmax(other / own))
    assert other[column] > own[column]
    values = np.array([0.5 * (own[column] + other[column]), 0.1])
    indices, freedom = np.array([column, (column + 1) % len(own)]), np.array([20.0, 20.0])
    measure = PayloadErrors(("centre_x",), indices, values, freedom, np.array([0.01]))
    assert np.isfinite(measure.compute_errors(covariance)).all()
    assert np.isinf(measure.compute_errors(pooled)).all()
    for repetitions in (0.0, 1e6):
        errors = predict_errors(identification, measure, following.design, state.recordings[-1], repetitions)
        assert (errors > 0).all()


def test_the_region_of_recordings_holds_their_states():
    _, state, _ = first_run()
    region = collect_region(state.recordings)
    assert isinstance(region, Region)
    assert 200 < len(region.q) <= 400
    # Runs are at 0.3 of the limits; measured velocities go a little beyond.
    assert (np.abs(region.dq).max(axis=0) <= 0.32 * np.array([joint.limits.velocity for joint in ARM.joints])).all()
    assert region.q.shape == region.ddq.shape == (len(region.q), ARM.n)


@pytest.mark.slow
def test_a_campaign_finds_a_hidden_effect_on_its_way_to_the_goal():
    campaign = dy.Campaign(ARM, error=0.03, request=REQUEST)
    names = iter(f"run{k}" for k in range(1, 9))
    dy.run_campaign(campaign, lambda motion: [recorded(motion.design, next(names), "joint_spring")])
    assert campaign.decision.code == "reached"
    assert any(choice.effect == "joint_spring" for choice in campaign.model.identification.model.effects)
    frame = campaign.to_table()
    assert frame["error"][-1] <= 0.03
    assert [frame["promised"][0], frame["predicted"][0]] == [None, None]
    assert re.search(r"run2.*%", repr(campaign))
    assert "goal" in campaign.plot().svg
    with pytest.raises(dy.DynidentError, match="the campaign is over"):
        campaign.ask()


@pytest.mark.slow
def test_the_command_goes_on_from_its_folder_and_says_what_a_command_did_wrong(tmp_path):
    plan, _, following = first_run()
    for number, design in enumerate((plan.design, following.design), start=1):
        write_simulated_recording(measured(design, number), tmp_path / f"run{number}.csv")
    common = ["campaign", "scara", "--folder", str(tmp_path)]
    done = CliRunner().invoke(app, [*common, "--error", "0.05"])
    assert done.exit_code == 0, done.output
    assert "is reached" in done.output
    assert (tmp_path / "model.npz").is_file()
    (tmp_path / "run2.csv").unlink()
    fails = f'{sys.executable} -c "raise SystemExit(5)"'
    failed = CliRunner().invoke(app, [*common, "--error", "0.02", "--starts", "1", "--execute", fails])
    assert failed.exit_code == 2
    assert "ended with code 5" in failed.output
    assert (tmp_path / "run2_motion.csv").is_file()


def run_to_the_end(request, hidden: str = ""):
    """A campaign with the virtual arm until it is over."""
    state = start_campaign(ARM, request)
    while not state.decision.is_end:
        plan = plan_run(state)
        state = add_run(state, recorded(plan.design, f"run{len(state.runs) + 1}", hidden), plan)
    return state


def test_a_campaign_for_parameters_ends_where_their_intervals_are_small_enough_and_hold_the_truth():
    request = replace(REQUEST, goal="parameters", parameters=("Fc1", "ZZ2"), error=0.05)
    state = run_to_the_end(request)
    assert state.decision.code == "reached"
    by_name = {parameter.name: parameter for parameter in state.identification.parameters}
    true = {
        effect.effect: dict(effect.values) for effect in list_drive_effects(ARM) if effect.joint == ARM.joint_names[0]
    }
    for name, error in zip(state.targets, state.runs[-1].errors, strict=True):
        low, high = by_name[name].interval
        assert 0.5 * (high - low) / abs(by_name[name].value) == pytest.approx(error)
    low, high = by_name["Fc1"].interval
    assert low < true["coulomb"]["Fc"] < high


def test_a_campaign_for_an_effect_finds_it_or_rules_it_out():
    request = replace(REQUEST, goal="effects", decide=("stribeck",))
    for hidden in ("", "stribeck"):
        state = run_to_the_end(request, hidden)
        assert state.decision.code == "reached"
        assert state.decision.sentence.startswith("The goal is reached: stribeck")
        found = {choice.effect for choice in state.identification.model.effects}
        assert ("stribeck" in found) == bool(hidden)


def with_load(design, name: str, loaded: bool):
    """The recording of a run, with a load of 2.12 kg, 3 cm beside the axis of the last joint, or without one."""
    effects = list_drive_effects(ARM)
    if loaded:
        usual = build_typical_effect(ARM, "payload", ARM.joint_names[-1])
        effects = (*effects, replace(usual, values=(*usual.values, ("MXp", 0.03 * dict(usual.values)["Mp"]))))
    motion = Reference(design.t, design.q, design.dq, design.ddq)
    seed = int(name.removeprefix("run"))
    run = simulate(ARM, SimulationRequest(motion, effects, sensors=Sensors(sampling_rate=200.0), seed=seed))
    return replace(dy.read_recordings({"t": run.t, "q": run.q, "tau": run.tau}, robot=ARM)[0].recording, name=name)


def test_a_campaign_weighs_a_load_that_is_mounted_after_the_runs_without_it():
    quantities = ("centre_x", "mass")
    request = replace(REQUEST, goal="payload", quantities=quantities, mass_error=0.03, centre_error=0.002)
    state, plans = start_campaign(ARM, request), []
    assert state.decision.sentence.endswith("Leave the load off.")
    while not state.decision.is_end:
        plans.append(plan_run(state))
        loaded = state.is_load_due
        state = add_run(state, with_load(plans[-1].design, f"run{len(state.runs) + 1}", loaded), plans[-1])
        assert "runs: none" in draw_campaign(state)
        if len(state.runs) <= request.unloaded_runs:
            words = "Mount the load now" if state.is_load_due else "Leave the load off for the next run"
            assert state.decision.sentence.startswith(words)
            assert np.isinf(state.runs[-1].errors).all()
    assert state.decision.code == "reached"
    assert [plan.promised is None for plan in plans[:3]] == [True] * 3
    # Nothing is known of the torque yet when the load is new.
    limits = np.array([joint.limits.velocity for joint in ARM.joints])
    assert (np.abs(plans[2].design.dq).max(axis=0) <= 0.3 * limits + 1e-9).all()
    assert (np.abs(plans[1].design.dq).max(axis=0) > 0.3 * limits).any()
    measure = build_measure(request, state.region, state.identification)
    mass, moment = measure.values[0], measure.values[1]
    centre_width, mass_width = state.runs[-1].errors * np.array([0.002, 0.03])
    # Of 95 % intervals one in twenty misses the truth; of twice as wide ones hardly any.
    assert abs(mass - 2.1237) < 2 * mass_width <= 2 * 0.03
    assert abs(moment / mass - 0.03) < 2 * centre_width <= 2 * 0.002
    assert re.search(r"centre x 0\.0[23]\d* ± 0\.00\d+ m, mass 2\.1\d ± 0\.0\d+ kg", state.decision.sentence)


def test_the_torque_that_a_design_keeps_counts_the_load():
    request = replace(REQUEST, goal="payload", unloaded_runs=1)
    plan, state, _ = first_run()
    state = add_run(start_campaign(ARM, request), state.recordings[0], plan)
    state = add_run(state, with_load(plan.design, "run2", loaded=True))
    q, dq = np.zeros((1, ARM.n)), np.zeros((1, ARM.n))
    ddq = np.zeros((1, ARM.n))
    ddq[0, 2] = 10.0
    with_it, without = (
        ExpectedTorque(ARM, state.identification.estimate, has_loads=has).torque(q, dq, ddq) for has in (True, False)
    )
    # The quill accelerates the load, and carries its weight.
    assert abs(with_it[0, 2] - without[0, 2]) == pytest.approx(2.1237 * (10.0 + 9.81), rel=0.1)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"goal": "parameters"}, "no parameter is named"),
        ({"goal": "payload", "quantities": ()}, "name what is to be known of the load"),
        ({"goal": "payload", "quantities": ("mass", "mass")}, "each once"),
        ({"goal": "payload", "quantities": ("weight",)}, "a load has no weight; choose of mass, centre_x"),
        ({"goal": "payload", "quantities": ("centre_z",)}, "no motion of this robot shows the centre z"),
        ({"goal": "payload", "unloaded_runs": 100, "runs": 200}, "101 runs, the last with the load, take 303 s"),
        ({"goal": "parameters", "parameters": ("m1",)}, "there is no base parameter m1; there are: ZZ1"),
        ({"goal": "effects"}, "no effect is named"),
        ({"goal": "effects", "decide": ("warm_up_friction",)}, "depends on more than the motion"),
        ({"goal": "effects", "decide": ("coulomb",)}, "is in the first model already"),
        ({"goal": "effects", "decide": ("torque_ripple",)}, "cannot be ruled out"),
        ({"goal": "effects", "decide": ("external_contact",)}, "cannot be"),
        ({"goal": "effects", "decide": ("stribeck", "rotor_coupling")}, "rotor_coupling cannot be a goal"),
    ],
)
def test_goals_that_cannot_be_are_refused_before_the_first_run(change, words):
    with pytest.raises(dy.DynidentError, match=words):
        start_campaign(ARM, replace(REQUEST, **change))


def test_an_effect_is_ruled_out_only_where_it_would_have_shown_on_every_joint_that_may_have_it():
    limits = [SimpleNamespace(effect="stribeck", joints=(name,), share=0.5) for name in ARM.joint_names]
    diagnosis = SimpleNamespace(detection_limits=limits, recommended=())
    assert compute_effect_errors(diagnosis, ["stribeck"], ARM) == pytest.approx([0.5])
    # A joint without a limit would have shown nothing, unless the effect was found there.
    diagnosis.detection_limits = limits[1:]
    assert compute_effect_errors(diagnosis, ["stribeck"], ARM) == pytest.approx([np.inf])
    diagnosis.recommended = (dy.EffectChoice("stribeck", ARM.joint_names[:1]),)
    assert compute_effect_errors(diagnosis, ["stribeck"], ARM) == pytest.approx([0.5])


def test_a_motion_that_ends_where_a_joint_is_farthest_out_is_still_the_planned_one():
    first, state, _ = first_run()
    request = replace(REQUEST, goal="parameters", parameters=("Fc1", "MY2", "MY4"))
    plan = plan_run(add_run(start_campaign(ARM, request), state.recordings[0], first))
    assert follows_design(recorded(plan.design, "run2"), plan.design)


def test_a_run_under_way_is_stopped_for_what_no_further_second_heals():
    _, state, following = first_run()
    campaign = dy.Campaign(ARM, request=REQUEST)
    campaign._state, campaign._planned = state, following
    run = measured(following.design, 2)
    count = round(0.7 * len(run.t))

    def find(q, tau):
        reasons = campaign.check_under_way({"t": run.t[:count], "q": q[:count], "tau": tau[:count]})
        return {(reason.code, reason.joint) for reason in reasons}

    assert find(run.q, run.tau) == set()
    assert campaign.check_under_way({"t": run.t[:40], "q": run.q[:40], "tau": run.tau[:40]}) == ()
    # For 0.4 s the elbow pushes against something with 40 % of its torque.
    pushed = run.tau.copy()
    inside = (run.t > 3.0) & (run.t < 3.4)
    pushed[inside, 1] += 0.4 * ARM.joints[1].limits.effort
    assert ("contact", "elbow") in find(run.q, pushed)
    # Nothing is known before the first run.
    campaign._state = start_campaign(ARM, REQUEST)
    assert find(run.q, pushed) == set()
    slow = np.column_stack([np.interp(0.3 * run.t, run.t, column) for column in run.q.T])
    assert ("too_slow", "") in find(slow, run.tau)


@pytest.mark.slow
def test_the_command_ends_a_program_whose_rows_are_not_worth_going_on_with(tmp_path):
    plan, _, following = first_run()
    write_simulated_recording(measured(plan.design, 1), tmp_path / "run1.csv")
    run = measured(following.design, 2)
    slow = np.column_stack([np.interp(0.2 * run.t, run.t, column) for column in run.q.T])
    header = ",".join(["t", *(f"{kind}_{name}" for kind in ("q", "tau") for name in ARM.joint_names)])
    np.savetxt(
        tmp_path / "rows.csv", np.column_stack([run.t, slow, run.tau]), delimiter=",", header=header, comments=""
    )
    program = tmp_path / "move.py"
    program.write_text(
        "import pathlib, shutil, signal, sys, time\n"
        "def stop(*_):\n"
        "    pathlib.Path(sys.argv[2] + '.stopped').touch()\n"
        "    sys.exit(1)\n"
        "signal.signal(signal.SIGTERM, stop)\n"
        "shutil.copy(sys.argv[1], sys.argv[2] + '.part')\n"
        "time.sleep(300)\n",
        encoding="utf-8",
    )
    execute = f"{sys.executable} {program} {tmp_path / 'rows.csv'} {{recording}}"
    common = ["campaign", "scara", "--folder", str(tmp_path), "--error", "0.001", "--duration", "6"]
    done = CliRunner().invoke(app, [*common, "--starts", "1", "--execute", execute])
    assert done.exit_code == 2
    assert "the way that the design moves them" in " ".join(done.output.split())
    assert (tmp_path / "run2.csv.stopped").exists()
    assert not (tmp_path / "run2.csv").exists()


@pytest.mark.slow
def test_the_command_moves_nothing_before_the_load_is_mounted(tmp_path, monkeypatch):
    plan, _, _ = first_run()
    write_simulated_recording(measured(plan.design, 1), tmp_path / "run1.csv")
    moved = tmp_path / "moved"
    program = tmp_path / "move.py"
    program.write_text(f"import pathlib\npathlib.Path({str(moved)!r}).touch()\nraise SystemExit(5)", encoding="utf-8")
    goal = ["--goal", "payload", "--quantity", "mass", "--unloaded-runs", "1", "--mass-error", "0.03"]
    common = ["campaign", "scara", "--folder", str(tmp_path), *goal, "--starts", "1", "--duration", "6"]
    command = [*common, "--execute", f"{sys.executable} {program}"]
    first = CliRunner().invoke(app, command)
    assert (first.exit_code, moved.exists()) == (3, False), first.output
    assert "Mount the load now" in first.output
    # With a terminal it is asked for each time.
    monkeypatch.setattr(campaign_command, "sys", SimpleNamespace(stdin=SimpleNamespace(isatty=lambda: True)))
    assert CliRunner().invoke(app, command, input="n\n").exit_code != 0
    assert not moved.exists()
    monkeypatch.undo()
    again = CliRunner().invoke(app, command)
    assert "ended with code 5" in again.output
    assert moved.exists()


@pytest.mark.slow
def test_rows_under_way_are_of_this_run_and_read_as_its_recording_will_be(tmp_path):
    program = tmp_path / "move.py"
    program.write_text(
        "import sys, time\n"
        "import numpy as np\n"
        "import dynident as dy\n"
        "from dynident.simulation import Reference, Sensors, SimulationRequest, list_drive_effects, simulate\n"
        "arm = dy.load_robot('scara')\n"
        "names = open(sys.argv[1]).readline().strip().split(',')\n"
        "rows = np.loadtxt(sys.argv[1], delimiter=',', skiprows=1)\n"
        "q, dq, ddq = (rows[:, [names.index(f'{k}_{n}') for n in arm.joint_names]] for k in ('q', 'dq', 'ddq'))\n"
        "reference = Reference(rows[:, names.index('t')], q, dq, ddq)\n"
        "sensors = Sensors(sampling_rate=200.0)\n"
        "run = simulate(arm, SimulationRequest(reference, list_drive_effects(arm), sensors=sensors, seed=1))\n"
        "header = ','.join(['t', *(f'{k}_{n}' for k in ('q', 'tau') for n in arm.joint_names)])\n"
        "table = np.column_stack([run.t, run.q, run.tau])\n"
        "first = 1 + arm.n\n"
        "table[:, first : first + 2] = table[:, [first + int(k) for k in sys.argv[3]]]\n"
        "time.sleep(2)\n"
        "np.savetxt(sys.argv[2] + '.part', table, delimiter=',', header=header, comments='')\n"
        "time.sleep(4)\n"
        "sys.exit(5)\n",
        encoding="utf-8",
    )
    # Rows that another run left: the first joint is beyond its limit.
    beyond = np.linspace(0.0, 50.0, 1000)
    table = np.column_stack([np.arange(1000) / 100.0, *(2 * ARM.n) * [beyond]])
    header = ",".join(["t", *(f"{kind}_{name}" for kind in ("q", "tau") for name in ARM.joint_names)])
    np.savetxt(tmp_path / "run1.csv.part", table, delimiter=",", header=header, comments="")
    execute = f"{sys.executable} {program} {{motion}} {{recording}}"
    common = ["campaign", "scara", "--folder", str(tmp_path), "--duration", "6", "--starts", "1"]
    # Torques of the first two joints that stand in each other's column, as the options may say.
    names = ",".join(f"tau_{name}=tau_{other}" for name, other in (ARM.joint_names[:2], ARM.joint_names[1::-1]))
    cases = (("01", [], "code 5"), ("10", [], "was ended"), ("10", ["--columns", names], "code 5"))
    for order, columns, words in cases:
        done = CliRunner().invoke(app, [*common, *columns, "--execute", f"{execute} {order}"])
        assert words in " ".join(done.output.split()), (order, columns, done.output)


def test_rows_that_vanish_between_two_looks_end_nothing(tmp_path, monkeypatch):
    _, state, following = first_run()
    rows = tmp_path / "run2.csv.part"
    rows.write_text("t\n0\n", encoding="utf-8")

    def vanish(path):
        raise FileNotFoundError(path)

    monkeypatch.setattr(Path, "read_bytes", vanish)
    with subprocess.Popen([sys.executable, "-c", "import time; time.sleep(1.5)"]) as process:
        assert campaign_command._watch(process, rows, state, following, lambda path: None) == 0
