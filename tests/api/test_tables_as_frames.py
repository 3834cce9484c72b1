"""What a user expects to be a table is a data frame: samples, torque over time, ranked effects, changes, models."""

from __future__ import annotations

import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

import dynident as dy
from dynident.recordings import FurtherColumns, recording_from_arrays

pandas = pytest.importorskip("pandas")


@pytest.fixture(scope="module")
def compared(better: dy.Model, runs: dy.Recordings) -> dy.Comparisons:
    return dy.compare(better, runs)


@pytest.fixture(scope="module")
def changed(better: dy.Model, runs: dy.Recordings, desk: Path, robot: dy.Robot) -> dy.Changes:
    return dy.changes(better, before=runs, after=dy.read_recordings(desk / "today.csv", robot=robot))


@pytest.fixture(scope="module")
def motion(robot: dy.Robot) -> dy.DesignedMotion:
    return dy.design(robot, kind="random", duration=5.0, sampling_rate=50.0)


def test_the_samples_of_a_recording_are_those_of_its_file(desk: Path, runs: dy.Recordings) -> None:
    frame, file = runs["run1"].to_frame(), pandas.read_csv(desk / "run1.csv")
    assert list(frame.columns[:3]) == ["t", "segment", "q_shoulder"]
    assert len(runs["run1"]) == len(frame) == len(file) == 2000
    assert runs["run1"].sampling_rate == pytest.approx(1.0 / np.diff(file.t).mean())
    np.testing.assert_allclose(frame.t, file.t)
    np.testing.assert_allclose(frame.q_elbow, file.q2)
    np.testing.assert_allclose(frame.tau_elbow, file.tau2)
    assert "dq_elbow" not in frame
    # A frame holds all samples, also those outside of the windows.
    half = dy.revise(runs["run1"], windows=[(0.0, 5.0)]).to_frame()
    assert len(half) == 2000
    assert set(half.t[half.used]) == set(frame.t[frame.t <= 5.0])


def test_units_of_samples_are_those_of_the_joints(runs: dy.Recordings, motion: dy.DesignedMotion) -> None:
    units = runs["run1"].to_frame("pandas").attrs["units"]
    assert units["t"] == "s"
    assert (units["q_elbow"], units["tau_elbow"]) == ("rad", "N m")
    assert (units["q_quill"], units["tau_quill"]) == ("m", "N")
    units = motion.to_frame().attrs["units"]
    assert (units["dq_elbow"], units["ddq_quill"]) == ("rad/s", "m/s^2")


def test_measured_velocities_are_there_where_the_file_has_them(desk: Path, robot: dy.Robot, tmp_path: Path) -> None:
    file = pandas.read_csv(desk / "run1.csv")
    for j, one in enumerate(robot.joints):
        speed = np.gradient(file[f"q{j + 1}"], file.t)
        file[f"dq{j + 1}"] = np.rad2deg(speed) if one.kind == "revolute" else speed
    file.to_csv(tmp_path / "fast.csv", index=False)
    units = {f"dq{j + 1}": "deg/s" for j, one in enumerate(robot.joints) if one.kind == "revolute"}
    frame = dy.read_recordings(tmp_path / "fast.csv", robot=robot, units=units)[0].to_frame()
    np.testing.assert_allclose(frame.dq_elbow, np.deg2rad(file.dq2), atol=1e-9)
    assert frame.attrs["units"]["dq_elbow"] == "rad/s"
    assert frame.attrs["units"]["dq_quill"] == "m/s"


def test_recordings_stand_below_each_other_and_may_hold_different_columns(robot: dy.Robot) -> None:
    t = np.arange(400) / 100.0
    q = np.sin(t)[:, None] * np.ones(robot.n)
    further = FurtherColumns(temperature=30.0 + q, wrench=np.ones((400, 6)))
    plain = recording_from_arrays(t, q, q, joint_names=robot.joint_names, segment=np.repeat([4, 7], 200), name="plain")
    warm = recording_from_arrays(t + 3.0, q, 2 * q, joint_names=robot.joint_names, further=further, name="warm")
    frame = dy.Recordings((dy.CheckedRecording(plain), dy.CheckedRecording(warm))).to_frame()
    assert list(frame.columns[:3]) == ["recording", "t", "segment"]
    assert list(frame.recording) == ["plain"] * 400 + ["warm"] * 400
    assert list(frame.segment) == [4] * 200 + [7] * 200 + [0] * 400
    np.testing.assert_allclose(frame.t, np.concatenate([t, t + 3.0]), atol=1e-9)
    np.testing.assert_allclose(frame.tau_elbow[400:], 2 * q[:, 0], atol=1e-9)
    assert frame.temperature_elbow.isna().sum() == frame.base_fx.isna().sum() == 400
    units = frame.attrs["units"]
    assert (units["temperature_elbow"], units["base_fx"], units["base_mz"]) == ("degC", "N", "N m")
    assert dy.Recordings(()).to_frame().empty


def test_a_comparison_is_a_row_a_joint_and_time(compared: dy.Comparisons) -> None:
    below = compared["run2"].comparison
    frame = compared["run2"].to_frame()
    assert len(frame) == below.measured.size
    elbow = frame[frame.joint == "elbow"]
    k = below.joint_names.index("elbow")
    for name in ("measured", "predicted", "residual", "raw_residual"):
        np.testing.assert_array_equal(elbow[name], getattr(below, name)[:, k])
    np.testing.assert_array_equal(elbow.raw_residual, elbow.measured - elbow.predicted)
    # The interval is the one of the plot: half of it is 1.96 deviations of parameters and noise.
    np.testing.assert_allclose(elbow.interval_upper - elbow.predicted, below.band[:, k])
    np.testing.assert_allclose(elbow.predicted - elbow.interval_lower, below.band[:, k])
    inside = elbow.measured.between(elbow.interval_lower, elbow.interval_upper)
    assert 0.85 < inside[elbow.phase == "moving"].mean() < 1.0
    assert not {"lower", "upper"} & set(frame)
    np.testing.assert_array_equal(elbow.t, below.t)
    np.testing.assert_array_equal(elbow.phase == "moving", below.moving[:, k])
    assert dict(zip(frame.joint, frame.unit, strict=True)) == dict(zip(below.joint_names, below.units, strict=True))


def test_at_standstill_the_residual_is_the_distance_to_static_friction(
    model: dy.Model, robot: dy.Robot, desk: Path
) -> None:
    file = pandas.read_csv(desk / "run1.csv")
    # The elbow halts for six seconds, and its torque jumps meanwhile by less and by more than its friction.
    halt, after = (file.t > 6.0) & (file.t < 12.0), file.t >= 12.0
    file.loc[after, "q2"] += file.q2[halt].iloc[0] - file.q2[after].iloc[0]
    file.loc[halt, "q2"] = file.q2[halt].iloc[0]
    file.loc[halt, "tau2"] = file.tau2[halt].iloc[0] + np.where(file.t[halt] > 9.0, 40.0, 0.0)
    halted = dy.read_recordings(file, robot=robot)
    frame = dy.compare(model, halted).to_frame()
    elbow = frame[frame.joint == "elbow"]
    stands = (elbow.phase == "standing").to_numpy()
    assert stands.sum() > 50
    beyond = elbow.measured - elbow.measured.clip(elbow.friction_lower, elbow.friction_upper)
    np.testing.assert_allclose(elbow.residual[stands], beyond[stands])
    assert (elbow.residual == elbow.raw_residual)[~stands & (elbow.phase != "no_torque")].all()
    assert (elbow.residual != elbow.raw_residual)[stands].all()
    np.testing.assert_array_equal(model.residuals(halted)["elbow"], elbow.residual)
    raw = model.residuals(halted, raw=True)
    np.testing.assert_array_equal(raw["elbow"], elbow.measured - elbow.predicted)
    assert "standstill" in model.residuals(halted).title
    assert "standstill" not in raw.title


def test_rows_go_by_their_names_as_in_pandas(model: dy.Model) -> None:
    assert model.bse.loc["Fc2", "standard_deviation"] == model.bse["Fc2"]
    assert model.parameters.loc["Fc2", "value"] == model.params["Fc2"]
    assert model.conf_int().loc["Fc2"].tolist() == model.conf_int()["Fc2"].tolist()
    assert model.covariance.loc["Fc1", "Fv1"] == model.covariance["Fc1", "Fv1"]
    assert model.parameters.names == tuple(model.params.keys())


def test_a_recording_has_a_length(runs: dy.Recordings) -> None:
    assert len(runs["run1"]) == len(runs["run1"].recording) == len(runs["run1"].to_frame()) == 2000


def test_comparisons_stand_below_each_other(compared: dy.Comparisons) -> None:
    frame = compared.to_frame()
    assert list(frame.recording.unique()) == ["run1", "run2"]
    last = frame[frame.recording == "run2"].drop(columns="recording").reset_index(drop=True)
    pandas.testing.assert_frame_equal(last, compared["run2"].to_frame())
    assert compared[:0].to_frame().empty


def test_a_diagnosis_is_its_ranking_and_a_row_says_what_can_be_added(
    model: dy.Model, found: dy.DiagnosedModel, better: dy.Model
) -> None:
    frame = found.to_frame()
    assert list(frame["rank"]) == [one.rank for one in found.candidates]
    best = frame.iloc[0]
    assert (best.effect, best.joints, best.recommended) == ("stribeck", "shoulder", True)
    assert best.error_drop == found.candidates[0].error_drop
    assert "vs = " in best.constants
    assert best.constants.endswith(" rad/s")
    assert [one.effect for one in model.extend(best.choice).effects] == [one.effect for one in better.effects]


def test_kinds_in_a_ranking_are_told_in_words(found: dy.DiagnosedModel) -> None:
    frame = found.to_frame()
    told = frame[frame.effect == "presliding"].constants
    assert len(told)
    assert all("law: stop" in text or "law: dahl" in text for text in told)


def test_changes_are_the_rows_of_their_table(changed: dy.Changes) -> None:
    frame = changed.to_frame()
    one = next(one for one in changed if one.choice.effect == "coulomb")
    row = frame[(frame.effect == "coulomb") & frame.p_value.notna()].iloc[0]
    assert len(frame) == sum(1 + len(one.more) for one in changed)
    assert (row.joint, row.parameter, row.unit) == ("elbow", one.main.parameter, "N m")
    assert (row.difference, row.interval_low, row.interval_high) == (one.main.value, *one.main.interval)
    assert row.p_value == one.p_value


def test_nothing_that_has_changed_is_a_frame_without_rows(changed: dy.Changes) -> None:
    from dataclasses import replace

    same = replace(changed, diagnosis=replace(changed.diagnosis, changes=()))
    assert same.to_frame().empty
    assert list(same.to_frame().columns) == list(changed.to_frame().columns)


def test_what_friction_did_is_drawn_where_nothing_has_changed_as_well(changed: dy.Changes) -> None:
    from dataclasses import replace

    same = replace(changed, diagnosis=replace(changed.diagnosis, changes=()))
    for found in (changed, same):
        drawn = found.plot().svg
        assert "Friction of each joint since the baseline" in drawn
        assert all(joint in drawn for joint in found.model.robot.joint_names)
    unknown = replace(same, diagnosis=replace(same.diagnosis, friction=()))
    with pytest.raises(dy.DynidentError, match="nothing to draw, because there are no changes"):
        unknown.plot()


def test_a_ladder_is_a_row_a_model(better: dy.Model) -> None:
    frame = better.ladder.to_frame()
    assert list(frame.model) == [1, 2]
    assert list(frame.fit) == [one.fit.relative_total for one in better.ladder]
    assert list(frame.held_out) == [one.held_out.relative_total for one in better.ladder]  # type: ignore[union-attr]
    assert "Stribeck friction on shoulder" in frame.new[1]
    assert list(frame.best) == [False, True]
    assert list(frame.parameters) == [len(one.parameters) for one in better.ladder]


def test_a_ladder_without_held_out_data_says_nothing_of_them(robot: dy.Robot, runs: dy.Recordings) -> None:
    frame = dy.identify(robot, runs[:1]).ladder.to_frame()
    assert frame.held_out.isna().all()
    assert not frame.best.any()


def test_a_designed_motion_is_what_is_saved(motion: dy.DesignedMotion, tmp_path: Path) -> None:
    motion.save(tmp_path / "motion.csv")
    saved, frame = pandas.read_csv(tmp_path / "motion.csv"), motion.to_frame()
    assert list(saved.columns) == list(frame.columns)
    np.testing.assert_allclose(frame, saved, atol=1e-9)


def test_a_motion_says_how_near_it_comes_to_each_limit(motion: dy.DesignedMotion) -> None:
    limits = motion.limits.to_frame()
    assert list(limits.columns) == ["joint", "limit", "reached", "allowed", "used"]
    assert set(limits["joint"]) >= set(motion.robot.joint_names)
    assert limits["used"].is_monotonic_decreasing
    assert limits["used"].max() <= 1.0 + 1e-9


@pytest.mark.parametrize("ending", [".csv", ".parquet"])
def test_what_is_a_frame_can_be_saved(
    compared: dy.Comparisons,
    found: dy.DiagnosedModel,
    changed: dy.Changes,
    better: dy.Model,
    tmp_path: Path,
    ending: str,
) -> None:
    read = {".csv": pandas.read_csv, ".parquet": pandas.read_parquet}[ending]
    for what in (compared, found, changed, better.ladder, better.parameters, better.errors):
        what.save(tmp_path / f"table{ending}")
        saved, frame = read(tmp_path / f"table{ending}"), what.to_frame("pandas")
        if frame.index.name:
            frame = frame.reset_index()
        assert list(saved.columns) == list(frame.columns)
        numbers = frame.select_dtypes("number").columns
        np.testing.assert_allclose(saved[numbers].astype(float), frame[numbers].astype(float), rtol=1e-9)
    # The last of them has names of rows: they are the first column.
    assert list(better.robot.joint_names) == saved.iloc[:, 0].tolist()[: better.robot.n]


class Frame:
    """Stands for a data frame of polars, which has no place for units."""

    __slots__ = ("columns",)

    def __init__(self, columns: dict[str, Any]) -> None:
        self.columns = columns


@pytest.mark.parametrize("what", ["recordings", "recording", "comparisons", "comparison", "diagnosis", "changes",
                                  "ladder", "design"])  # fmt: skip
def test_each_is_a_frame_of_polars_too(
    what: str,
    runs: dy.Recordings,
    compared: dy.Comparisons,
    found: dy.DiagnosedModel,
    changed: dy.Changes,
    better: dy.Model,
    motion: dy.DesignedMotion,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    things = {
        "recordings": runs,
        "recording": runs[0],
        "comparisons": compared,
        "comparison": compared[0],
        "diagnosis": found,
        "changes": changed,
        "ladder": better.ladder,
        "design": motion,
    }
    stand_in = ModuleType("polars")
    stand_in.DataFrame = Frame  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "polars", stand_in)
    columns = things[what].to_frame("polars").columns
    assert len({len(values) for values in columns.values()}) == 1
    assert not any(isinstance(values, np.ndarray) and values.dtype.kind == "O" for values in columns.values())
