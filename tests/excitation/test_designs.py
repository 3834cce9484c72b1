from __future__ import annotations

import json
import time
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pyarrow.csv
import pyarrow.parquet
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import CubicHermiteSpline
from scipy.signal import resample

from dynident.effects import EffectChoice, ReferenceParameters
from dynident.errors import Cancelled, DynidentError
from dynident.excitation import (
    CriterionChoice,
    Design,
    DesignRequest,
    TrajectoryRequest,
    design_document,
    design_experiment,
    design_table,
    trajectory_document,
    write_design,
)
from dynident.motion import ImpossibleLimitsError, Surroundings
from dynident.motion.joint_trajectories import FourierFamily
from dynident.motion.limits.bounds import build_bounds
from dynident.motion.limits.limit_margins import AmplitudeScaler
from dynident.robot import Limits, Robot, robot_from_library, to_pinocchio

INERTIA_AND_FRICTION = tuple(EffectChoice(name) for name in ("rigid_body", "coulomb", "viscous"))
SHORT = TrajectoryRequest(duration=4.0, harmonics=4, sampling_rate=250.0, periods=2)
QUICK = DesignRequest(effects=INERTIA_AND_FRICTION, trajectory=SHORT, starts=1, random_trajectories=15)


def exciting_part(design: Design) -> slice:
    first, last = (round(at * design.sampling_rate) for at in design.exciting)
    return slice(first, last)


def finely(design: Design) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """One period between the samples as well: a band-limited signal is known there too."""
    first = exciting_part(design).start
    assert design.period is not None
    steps = round(design.period * design.sampling_rate)
    q, dq, ddq = (resample(signal[first : first + steps], 8 * steps) for signal in (design.q, design.dq, design.ddq))
    return q, dq, ddq


def assert_within(robot: Robot, design: Design, stated: dict[str, Limits]) -> None:
    """Every limit, with nothing but the samples, Pinocchio and the limits as the user gave them."""
    model = to_pinocchio(robot)
    data = model.createData()
    period = finely(design)
    for q, dq, ddq in ((design.q, design.dq, design.ddq), period):
        step = max(1, len(q) // 2000)
        states = zip(q[::step], dq[::step], ddq[::step], strict=True)
        tau = np.array([pin.rnea(model, data, *state) for state in states])
        for j, joint in enumerate(robot.joints):
            for limits in (joint.limits, stated.get(joint.name, Limits())):
                if limits.position is not None:
                    low, high = limits.position
                    assert low <= q[:, j].min()
                    assert q[:, j].max() <= high
                for bound, signal in ((limits.velocity, dq), (limits.acceleration, ddq), (limits.effort, tau)):
                    assert bound is None or np.abs(signal[:, j]).max() <= bound
    for j, joint in enumerate(robot.joints):
        jerk = np.abs(np.diff(design.ddq[:, j])).max() * design.sampling_rate
        assert joint.limits.jerk is None or jerk <= joint.limits.jerk * (1 + 1e-6)


@st.composite
def limit_sets(draw: st.DrawFn, robot: Robot) -> dict[str, Limits]:
    stated = {}
    for joint in robot.joints:
        if draw(st.booleans()):
            continue
        low, high = joint.limits.position or (-np.pi, np.pi)
        ends = sorted(draw(st.floats(0, 1)) for _ in range(2))
        if ends[1] - ends[0] < 0.02:
            ends = [0.0, 1.0]
        stated[joint.name] = Limits(
            position=(low + ends[0] * (high - low), low + ends[1] * (high - low)),
            velocity=draw(st.none() | st.floats(0.05, 5.0)),
            acceleration=draw(st.none() | st.floats(0.1, 40.0)),
            effort=draw(st.none() | st.floats(0.3, 1.0).map(lambda share, j=joint: share * (j.limits.effort or 100.0))),
        )
    return stated


@pytest.mark.parametrize("name", ["scara", "ur10"])
def test_every_design_keeps_the_limits_it_was_given(name):
    robot = robot_from_library(name)

    @given(stated=limit_sets(robot), kind=st.sampled_from(["optimized", "random"]), seed=st.integers(0, 1000))
    @settings(max_examples=6, deadline=None)
    def check(stated, kind, seed):
        request = replace(QUICK, kind=kind, limits=stated, seed=seed, random_trajectories=5, time_budget=0.2)
        try:
            design = design_experiment(robot, request)
        except ImpossibleLimitsError as error:
            # A joint, or a pair of bodies such as 'elbow_joint – floor'.
            assert any(joint in str(error) for joint in robot.joint_names)  # noqa: PT017
            return
        assert_within(robot, design, stated)
        assert all(margin.share <= 1 for margin in design.margins)

    check()


def test_a_design_begins_and_ends_at_home_and_rests_at_both_ends_of_its_exciting_part(scara):
    home = (0.5, -0.5, -0.1, 1.0)
    design = design_experiment(scara, replace(QUICK, home=home))
    np.testing.assert_allclose(design.q[[0, -1]], [home, home], atol=1e-12)
    part = exciting_part(design)
    for at in (0, part.start, part.stop, -1):
        np.testing.assert_allclose(design.dq[at], 0, atol=1e-9)
        np.testing.assert_allclose(design.ddq[at], 0, atol=1e-6)
    np.testing.assert_allclose(design.q[part][:1000], design.q[part][1000:], atol=1e-9)
    np.testing.assert_allclose(np.diff(design.t), 1 / 250, atol=1e-9)
    slope = (design.q[2:] - design.q[:-2]) * 125
    np.testing.assert_allclose(slope, design.dq[1:-1], atol=2e-3 * np.abs(design.dq).max())


def test_an_optimised_design_is_better_than_the_best_random_one(ur10):
    request = replace(QUICK, trajectory=TrajectoryRequest(), random_trajectories=40)
    design = design_experiment(ur10, request)
    assert design.baseline is not None
    assert design.baseline.best.condition_number <= design.baseline.median_condition_number
    assert design.criterion_values.condition_number < 0.8 * design.baseline.best.condition_number
    part = exciting_part(design)
    w = _dense_observation(ur10, design.q[part], design.dq[part], design.ddq[part])
    assert np.linalg.cond(w) == pytest.approx(design.criterion_values.condition_number, rel=0.01)


def _dense_observation(robot: Robot, q: np.ndarray, dq: np.ndarray, ddq: np.ndarray) -> np.ndarray:
    from dynident.regressors.model_structure import build_model

    model = build_model(robot, INERTIA_AND_FRICTION)
    observation = model.observation
    entries = observation.evaluate(
        q, dq, ddq, reference=ReferenceParameters.massless(robot), memory=np.zeros((len(q), 0))
    )
    w = np.zeros((len(q), robot.n, observation.n_columns))
    w[:, observation.entry_rows, observation.entry_columns] = entries
    return w.reshape(-1, observation.n_columns)


@pytest.mark.slow
def test_a_panda_gets_a_condition_number_below_62_with_its_57_parameters(panda):
    design = design_experiment(panda, DesignRequest(effects=INERTIA_AND_FRICTION, starts=2))
    assert len(design.parameter_names) == 57
    assert design.criterion_values.condition_number < 62
    assert_within(panda, design, {})


def test_random_motions_that_are_only_compared_take_few_evaluations(panda):
    class CountingModel:
        calls = 0

        def torque(self, q, dq, ddq):
            self.calls += 1
            return np.abs(dq) + 1e-3

    family = FourierFamily(5, 10.0)
    x = np.random.default_rng(0).standard_normal((family.n_coefficients, panda.n))
    bounds = build_bounds(panda, {})
    x[0], counts = bounds.middle, []
    bounds = replace(bounds, torque=np.full(panda.n, 0.05))
    for fine in (True, False):
        model = CountingModel()
        amplitudes = AmplitudeScaler(family, bounds, model, fine=fine).scale_down(x)
        assert amplitudes is not None
        counts.append(model.calls)
    assert counts[1] <= 0.6 * counts[0]


@pytest.mark.parametrize("fine", [True, False])
def test_a_random_motion_that_has_to_be_small_is_made_small(panda, fine):
    family = FourierFamily(5, 10.0)
    x = np.random.default_rng(0).standard_normal((family.n_coefficients, panda.n))
    x[0] = build_bounds(panda, {}).middle

    class Accelerated:
        def torque(self, q, dq, ddq):
            return ddq

    def scale(limit):
        bounds = replace(build_bounds(panda, {}), torque=np.full(panda.n, limit))
        return AmplitudeScaler(family, bounds, Accelerated(), fine=fine).scale_down(x)

    wide, small = scale(np.inf), scale(0.02)
    assert small is not None
    assert 0 < np.abs(small[1:]).max() < np.abs(wide[1:]).max() / 64


@pytest.mark.parametrize("criterion", ["d_optimal", "weighted", "equilibrated"])
def test_every_criterion_lowers_its_own_value(scara, criterion):
    anywhere = Surroundings(assume_floor=False)
    request = replace(QUICK, criterion=CriterionChoice(criterion), surroundings=anywhere)
    design = design_experiment(scara, request)
    assert design.baseline is not None
    assert design.criterion_values.criterion < design.baseline.best.criterion


@pytest.mark.sweep
@pytest.mark.parametrize("seed", range(1, 5))
def test_entries_of_like_size_are_judged_on_the_samples_that_they_were_sought_on(scara, seed):
    request = replace(
        QUICK, criterion=CriterionChoice("equilibrated"), seed=seed, kind="optimized", random_trajectories=5
    )
    design = design_experiment(scara, request)
    # The motion may be a little smaller than the best that was found: limits are kept between the samples, too.
    assert design.criterion_values.criterion < 1.05 * design.baseline.best.criterion


def test_the_same_seed_gives_the_same_design_and_another_one_another(scara):
    first, again, other = (design_experiment(scara, replace(QUICK, seed=seed)) for seed in (4, 4, 5))
    np.testing.assert_array_equal(first.q, again.q)
    assert first.criterion_values == again.criterion_values
    assert not np.array_equal(first.q[exciting_part(first)][:10], other.q[exciting_part(other)][:10])


def test_a_time_budget_is_kept_and_the_best_so_far_returned(panda):
    request = replace(QUICK, trajectory=TrajectoryRequest(), starts=None, time_budget=0.05, random_trajectories=3)
    began = time.process_time()
    design = design_experiment(panda, request)
    assert time.process_time() - began < 3.0
    assert any("0 starts completed before the time limit" in note for note in design.notes)
    assert np.isfinite(design.criterion_values.condition_number)


@pytest.mark.parametrize("at", [0.1, 0.5, 0.97])
def test_a_design_can_be_cancelled_at_any_time(scara, at):
    heard = []

    def stop(fraction: float, message: str) -> None:
        heard.append(message)
        if fraction >= at:
            raise Cancelled

    with pytest.raises(Cancelled):
        design_experiment(scara, replace(QUICK, random_trajectories=100), stop)
    assert heard


def test_progress_tells_the_criterion_and_the_tightest_limit_and_never_goes_back(scara):
    told: list[tuple[float, str]] = []
    design_experiment(scara, replace(QUICK, starts=2), lambda fraction, message: told.append((fraction, message)))
    fractions = [fraction for fraction, _ in told]
    assert fractions == sorted(fractions)
    assert fractions[-1] == 1.0
    assert any("iteration" in message and "criterion" in message and "limit at" in message for _, message in told)


def test_torque_limits_that_no_posture_can_keep_are_refused_by_name(panda):
    limits = {"joint2": Limits(position=(1.2, 1.7), effort=5.0), "joint4": Limits(position=(-0.5, -0.1))}
    with pytest.raises(ImpossibleLimitsError, match=r"'joint2'.*torque limit is 5") as caught:
        design_experiment(panda, replace(QUICK, limits=limits))
    assert caught.value.pointer == "/limits/joint2/effort"


def test_position_limits_outside_the_robots_own_are_refused(panda):
    with pytest.raises(ImpossibleLimitsError, match=r"'joint4'.*outside of its own"):
        design_experiment(panda, replace(QUICK, limits={"joint4": Limits(position=(0.5, 1.0))}))


def test_a_home_outside_its_limits_is_refused(panda):
    with pytest.raises(ImpossibleLimitsError, match="'joint4' at 0, outside"):
        design_experiment(panda, replace(QUICK, home=(0.0,) * 7))


def test_limits_wider_than_the_robots_own_are_said_not_to_be_followed(panda):
    own = panda.joints[0].limits.velocity
    wider = replace(QUICK, kind="random", limits={"joint1": Limits(velocity=9.0), "joint2": Limits(velocity=0.5)})
    notes = design_experiment(panda, wider).notes
    said = [note for note in notes if "wider" in note]
    assert len(said) == 1
    assert f"velocity 9 of joint1 (its own is {own:g})" in said[0]
    assert "joint2" not in said[0]


def test_what_is_not_known_of_limits_is_said(panda):
    bare = replace(
        panda,
        joints=tuple(replace(joint, limits=Limits(position=joint.limits.position)) for joint in panda.joints),
        inertias=None,
    )
    design = design_experiment(bare, replace(QUICK, kind="random"))
    notes = " ".join(design.notes)
    for part in ("No velocity limit", "No acceleration limit", "No jerk limit", "Torque is not checked"):
        assert part in notes
    assert {margin.limit for margin in design.margins} == {
        "position_min", "position_max", "velocity", "acceleration", "jerk", "clearance",
    }  # fmt: skip
    assert np.abs(design.dq).max() <= 1.0


def test_a_sliding_joint_without_a_range_is_asked_for_one(scara):
    joints = tuple(replace(j, limits=Limits()) if j.kind == "prismatic" else j for j in scara.joints)
    with pytest.raises(DynidentError, match="'quill' slides, and its range is not known"):
        design_experiment(replace(scara, joints=joints), QUICK)


@pytest.mark.parametrize(
    ("request_", "pointer"),
    [
        (lambda: replace(QUICK, kind="ballet"), "/kind"),
        (lambda: replace(QUICK, criterion=CriterionChoice("best")), "/name"),
        (lambda: replace(QUICK, trajectory=replace(SHORT, family="spiral")), "/family"),
        (lambda: replace(QUICK, trajectory=replace(SHORT, family="b_spline", intervals=1)), "/intervals"),
        (lambda: replace(QUICK, trajectory=replace(SHORT, duration=float("nan"))), "/duration"),
        (lambda: replace(QUICK, trajectory=replace(SHORT, sampling_rate=3.0)), "/trajectory/sampling_rate"),
        (lambda: replace(QUICK, trajectory=replace(SHORT, periods=0)), "/periods"),
        (lambda: replace(QUICK, trajectory=replace(SHORT, periods=10**9)), "/periods"),
        (lambda: replace(QUICK, effects=(EffectChoice("ghosts"),)), "/effects/0"),
        (lambda: replace(QUICK, limits={"elbow2": Limits(velocity=1.0)}), "/limits/elbow2"),
        (lambda: replace(QUICK, limits={"elbow": Limits(velocity=-1.0)}), "/velocity"),
        (lambda: replace(QUICK, time_budget=0.0), "/time_budget"),
        (lambda: replace(QUICK, criterion=CriterionChoice("weighted", a_priori={"ZZ9": 1.0})), "/criterion/a_priori"),
    ],
)
def test_what_cannot_be_designed_is_refused_with_its_place(scara, request_, pointer):
    with pytest.raises(DynidentError) as caught:
        design_experiment(scara, request_())
    assert caught.value.pointer == pointer


def test_constant_velocity_runs_go_both_ways_at_every_speed_and_move_one_joint_at_a_time(scara):
    trajectory = TrajectoryRequest(duration=2.0, sampling_rate=200.0, speeds=(0.02, 0.1))
    design = design_experiment(scara, DesignRequest(kind="constant_velocity", trajectory=trajectory))
    for j, joint in enumerate(scara.joints):
        for share in (0.02, 0.1):
            for sign in (1, -1):
                cruising = np.abs(design.dq[:, j] - sign * share * joint.limits.velocity) < 1e-5 * joint.limits.velocity
                assert cruising.sum() > 50
                others = np.abs(np.delete(design.dq[cruising], j, axis=1)).max(axis=1)
                # But for a sample on the way to the next joint's stroke that happens to have this speed.
                assert np.mean(others == 0) > 0.98
    np.testing.assert_allclose(design.q[0], design.q[-1], atol=1e-9)
    assert set(design.parameter_names) == {f"{name}{j}" for name in ("Fc", "Fv", "b") for j in range(1, 5)}
    assert design.criterion_values.condition_number < 100


def test_a_trajectory_file_gives_back_what_was_designed(scara, tmp_path):
    design = design_experiment(scara, replace(QUICK, kind="random"))
    table = design_table(design)
    assert table.column_names[:3] == ["t", "q_shoulder", "q_elbow"]
    for name, read in (("d.csv", pyarrow.csv.read_csv), ("d.parquet", pyarrow.parquet.read_table)):
        write_design(design, tmp_path / name)
        back = read(tmp_path / name)
        assert back.column_names == table.column_names
        np.testing.assert_allclose(back["ddq_quill"].to_numpy(), design.ddq[:, 2], rtol=1e-11, atol=1e-12)
    with pytest.raises(DynidentError, match=r"use .csv, .parquet or .yaml"):
        write_design(design, tmp_path / "d.txt")


def test_a_slow_first_run_has_the_same_path_at_a_share_of_the_speed(scara, tmp_path):
    design = design_experiment(scara, replace(QUICK, kind="random"))
    write_design(design, tmp_path / "slow.csv", speed=0.25)
    write_design(design, tmp_path / "slow.yaml", speed=0.25)
    slow = pyarrow.csv.read_csv(tmp_path / "slow.csv")
    t, q, dq, ddq = (slow[name].to_numpy() for name in ("t", "q_elbow", "dq_elbow", "ddq_elbow"))
    assert t[-1] == pytest.approx(4 * design.t[-1])
    np.testing.assert_allclose(q, design.q[:, 1], rtol=1e-11)
    # Its velocities and accelerations are the derivatives of its own positions.
    path = CubicHermiteSpline(t, q, dq)
    middle = (t[1:] + t[:-1]) / 2
    np.testing.assert_allclose(path(middle, 1), CubicHermiteSpline(t, dq, ddq)(middle), atol=1e-3 * np.abs(dq).max())
    points = yaml.safe_load((tmp_path / "slow.yaml").read_text())["points"]
    np.testing.assert_allclose([point["velocities"][1] for point in points], dq, rtol=1e-9, atol=1e-12)
    stamps = [point["time_from_start"]["sec"] + 1e-9 * point["time_from_start"]["nanosec"] for point in points]
    np.testing.assert_allclose(stamps, t - t[0], atol=1e-9)
    for share in (0.0, 1e-300, 1.5, float("nan")):
        with pytest.raises(DynidentError, match="not a share of the speed"):
            write_design(design, tmp_path / "slow.csv", speed=share)


def test_the_documents_are_json_with_the_contracts_fields(scara):
    design = design_experiment(scara, replace(QUICK, kind="random"))
    document = json.loads(json.dumps(design_document(design), allow_nan=False))
    assert document["criterion_values"]["condition_number"] == design.criterion_values.condition_number
    assert document["baseline_values"]["condition_number"] > 1
    assert document["n_samples"] == len(design.t)
    assert {"joint", "limit", "value", "bound", "share"} == set(document["margins"][0])
    trajectory = json.loads(json.dumps(trajectory_document(design), allow_nan=False))
    np.testing.assert_array_equal(trajectory["q"], design.q)
