from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pyarrow.parquet as pq
import pytest

from dynident.effects import EffectChoice
from dynident.errors import Cancelled, DynidentError
from dynident.excitation import (
    CriterionChoice,
    Design,
    DesignRequest,
    TrajectoryRequest,
    design_document,
    design_experiment,
    design_table,
    write_design,
)
from dynident.excitation.experiments.run_search import BetweenTwoPoints, factor_information, plan_runs
from dynident.motion.collision.obstacle_geometry import Surroundings
from dynident.robot import Robot, to_pinocchio

EFFECTS = tuple(EffectChoice(name) for name in ("rigid_body", "coulomb", "viscous"))
QUICK = DesignRequest(
    kind="sequential",
    effects=EFFECTS,
    trajectory=TrajectoryRequest(sets="link_by_link", duration=3.0, harmonics=3, points=8, sampling_rate=100.0),
    surroundings=Surroundings(self_collision=False),
)


def request_for(sets: str, **more: object) -> DesignRequest:
    return replace(QUICK, trajectory=replace(QUICK.trajectory, sets=sets, **more))


@pytest.fixture(scope="module")
def vandanjon(scara: Robot) -> Design:
    return design_experiment(scara, request_for("vandanjon"))


@pytest.fixture(scope="module")
def quick(scara: Robot) -> tuple[Design, list[float]]:
    """A set, and what its progress told."""
    told: list[float] = []
    return design_experiment(scara, QUICK, lambda fraction, message: told.append(fraction)), told


def moving_in(design: Design, run: object) -> tuple[str, ...]:
    inside = design.segments == 1 + design.runs.index(run)
    moved = np.ptp(design.q[inside], axis=0) > 1e-9
    return tuple(name for name, moves in zip(design.joint_names, moved, strict=True) if moves)


@pytest.mark.parametrize("sets", ["link_by_link", "wrist_then_shoulder"])
def test_in_every_run_only_the_named_joints_move_and_all_of_them_do(scara, quick, sets):
    design = quick[0] if sets == "link_by_link" else design_experiment(scara, request_for(sets))
    assert len(design.runs) == len(plan_runs(sets, scara.joint_names))
    for run in design.runs:
        assert moving_in(design, run) == run.joints
    assert np.isfinite(design.criterion_values.condition_number)
    assert all(margin.share <= 1 for margin in design.margins)


def test_a_set_that_cannot_tell_all_parameters_names_them_and_what_would(scara):
    request = replace(
        request_for("wrist_then_shoulder", duration=1.0, harmonics=2),
        effects=(*EFFECTS, EffectChoice("rotor_inertia")),
        random_trajectories=1,
    )
    notes = design_experiment(scara, request).notes
    said = [note for note in notes if "full rank" in note]
    assert len(said) == 1
    assert "Ia2" in said[0]
    assert "vandanjon" in said[0]


def test_vandanjons_sets_lock_all_joints_but_one_or_two_and_move_between_two_points(scara, vandanjon):
    kinds = {run.label.split(",")[0] for run in vandanjon.runs}
    assert kinds == {"inertia", "centrifugal coupling", "inertial coupling", "gravity"}
    for run in vandanjon.runs:
        assert moving_in(vandanjon, run) == run.joints
        inside = vandanjon.segments == 1 + vandanjon.runs.index(run)
        resting = inside & (np.abs(vandanjon.dq).max(axis=1) < 1e-12)
        places = {tuple(np.round(q, 6)) for q in vandanjon.q[resting]}
        if run.label == "gravity":
            assert len(places) == 8
            assert (np.abs(vandanjon.dq[inside]) < 0.26 * np.array([j.limits.velocity for j in scara.joints])).all()
        else:
            assert len(places) == 2
            assert len(run.joints) <= 2


def test_the_fast_joint_of_a_centrifugal_run_reaches_its_top_speed_and_an_inertial_run_never_cruises(scara, vandanjon):
    for planned, run in zip(plan_runs("vandanjon", scara.joint_names), vandanjon.runs, strict=True):
        inside = vandanjon.segments == 1 + vandanjon.runs.index(run)
        if not isinstance(planned.how, BetweenTwoPoints):
            continue
        for j in (*planned.how.long, *planned.how.short):
            top = scara.joints[j].limits.velocity
            cruising = np.abs(vandanjon.dq[inside, j]) > 0.999 * top
            if planned.how.short:
                assert cruising.mean() < 0.2


def test_together_the_runs_show_every_parameter_that_a_motion_of_all_joints_shows(scara, vandanjon):
    """The moving joints' rows of Pinocchio's regressor, stacked over all runs, have the rank of its full regressor."""
    model = to_pinocchio(scara)
    data = model.createData()
    rows = []
    for index, run in enumerate(vandanjon.runs):
        moving = [scara.joint_names.index(name) for name in run.joints]
        for k in np.flatnonzero(vandanjon.segments == index + 1)[::7]:
            state = (vandanjon.q[k], vandanjon.dq[k], vandanjon.ddq[k])
            rows.append(pin.computeJointTorqueRegressor(model, data, *state)[moving])
    sigma = np.linalg.svd(np.concatenate(rows), compute_uv=False)
    links = [name for name in vandanjon.parameter_names if not name.startswith("F")]
    assert (sigma > 1e-6 * sigma[0]).sum() == len(links)
    assert np.isfinite(vandanjon.criterion_values.condition_number)
    assert not any("not have full rank" in note for note in vandanjon.notes)


def test_the_set_is_better_than_sets_of_random_motions_of_the_same_kind(vandanjon):
    assert vandanjon.baseline is not None
    assert vandanjon.baseline.count > 5
    assert vandanjon.criterion_values.condition_number < vandanjon.baseline.best.condition_number


def test_rows_that_stand_for_an_information_matrix_have_its_inner_products():
    w = np.random.default_rng(0).standard_normal((40, 6)) * np.geomspace(1e-4, 1e4, 6)
    w[:, 3] = 0.0
    information = w.T @ w
    rows = factor_information(information)
    sizes = np.sqrt(np.maximum(np.diag(information), 1e-300))
    np.testing.assert_allclose((rows.T @ rows - information) / np.outer(sizes, sizes), 0.0, atol=1e-12)


def test_a_set_may_be_designed_for_chosen_parameters(scara):
    criterion = CriterionChoice("parameters", parameters=("ZZ1", "Fc2"))
    design = design_experiment(scara, replace(QUICK, criterion=criterion, noise={"shoulder": 2.0, "elbow": 1.0}))
    assert np.isfinite(design.criterion_values.criterion)


def test_the_arm_is_still_between_runs_and_at_home_at_both_ends(vandanjon):
    np.testing.assert_allclose(vandanjon.q[0], vandanjon.q[-1], atol=1e-9)
    np.testing.assert_allclose(np.diff(vandanjon.t), 0.01, atol=1e-9)
    for run in vandanjon.runs:
        for at in (run.start, run.end):
            assert np.abs(vandanjon.dq[round(at * 100)]).max() < 1e-9
    step = np.abs(np.diff(vandanjon.q, axis=0)).max(axis=0) * 100
    assert (step <= 1.001 * np.abs(vandanjon.dq).max(axis=0)).all()


def test_exports_keep_the_runs_apart(vandanjon, tmp_path):
    table = design_table(vandanjon)
    assert table.column_names[:2] == ["t", "segment"]
    write_design(vandanjon, tmp_path / "set.parquet")
    segment = pq.read_table(tmp_path / "set.parquet")["segment"].to_numpy()
    assert segment.dtype.kind == "i"
    assert set(segment) == set(range(len(vandanjon.runs) + 1))
    document: dict[str, Any] = design_document(vandanjon)
    assert [run["label"] for run in document["runs"]] == [run.label for run in vandanjon.runs]


def test_the_same_seed_gives_the_same_set(scara, quick):
    np.testing.assert_array_equal(design_experiment(scara, QUICK).q, quick[0].q)


def test_a_set_can_be_cancelled_and_progress_names_the_run(scara):
    heard = []

    def stop(fraction: float, message: str) -> None:
        heard.append((fraction, message))
        if "run 2 of 4" in message:
            raise Cancelled

    with pytest.raises(Cancelled):
        design_experiment(scara, QUICK, stop)
    assert any("link 4 (wrist)" in message or "run 1 of 4" in message for _, message in heard)


def test_little_time_still_gives_a_whole_set_and_says_so(scara, quick):
    design = design_experiment(scara, replace(QUICK, time_budget=0.05))
    assert len(design.runs) == 4
    assert np.isfinite(design.criterion_values.condition_number)
    assert any("time limit" in note for note in design.notes)
    assert not any("time limit" in note for note in quick[0].notes)


def test_progress_never_goes_back(quick):
    _, told = quick
    assert told == sorted(told)
    assert told[-1] == 1.0


@pytest.mark.parametrize("family", ["b_spline", "point_to_point"])
def test_runs_may_be_of_every_family(scara, family):
    design = design_experiment(scara, request_for("link_by_link", family=family, intervals=5))
    for run in design.runs:
        assert moving_in(design, run) == run.joints
    assert np.isfinite(design.criterion_values.condition_number)


@pytest.mark.parametrize(
    ("more", "pointer"),
    [
        ({"sets": "ballet"}, "/sets"),
        ({"joints": ("elbow",)}, "/trajectory/joints"),
        ({"paces": (1.0, 0.5)}, "/trajectory/paces"),
    ],
)
def test_what_is_no_set_of_test_motions_is_refused_with_its_place(scara, more, pointer):
    with pytest.raises(DynidentError) as caught:
        design_experiment(scara, replace(QUICK, trajectory=replace(QUICK.trajectory, **more)))
    assert caught.value.pointer == pointer


def test_a_robot_without_shoulder_has_no_wrist_either():
    with pytest.raises(DynidentError, match="need at least 4"):
        plan_runs("wrist_then_shoulder", ("a", "b", "c"))
