"""What a file that cannot be used as it is lacks, in words that lead on; made of the columns of a drawn arm."""

from __future__ import annotations

import io
import time
import timeit
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from scipy.io import savemat
from scipy.optimize import nnls
from support.drawn_recordings import Log, guess, log, log_of, read, write
from support.oracles import crooked_urdf, fourier_motion, pinocchio_torque

from dynident.api.robot_files import load_robot, set_drive_gains
from dynident.errors import DynidentError
from dynident.identification.column_inference import dynamics_fits
from dynident.identification.column_inference.column_names import list_spellings_by_joint, read_names
from dynident.identification.column_inference.column_statistics import Sample
from dynident.identification.column_inference.dynamics_fits import DynamicsFits
from dynident.identification.column_inference.file_inspection import inspect_file
from dynident.identification.column_inference.infer_columns import propose
from dynident.identification.column_inference.metadata_proposal import Proposal, describe_gear_ratios, describe_waves
from dynident.identification.column_inference.unit_inference import compute_reach, guess_torque_unit
from dynident.identification.recording_faults.column_faults import ColumnFault, Motion
from dynident.identification.recording_faults.description_fit import _fit
from dynident.identification.recording_faults.fault_search import _find_turned_pair
from dynident.identification.recording_faults.tree_fit import BLOCKS
from dynident.identification.recording_faults.unexplained_torque import HeldOutFit, UnexplainedTorque
from dynident.identification.robot_recording_import import import_cured
from dynident.recordings import RecordingError, RecordingMetadata
from dynident.recordings.cells_without_numbers import find_quantities
from dynident.recordings.columns_to_signals import Column, Layout
from dynident.recordings.file_source import find_bursts
from dynident.recordings.formats import open_source
from dynident.recordings.formats.packed_messages import find_labels, name_labelled_numbers
from dynident.recordings.formats.text_streams import (
    RewrittenText,
    flatten_lists,
    has_minus_elsewhere,
)
from dynident.recordings.time_columns import RestartingSource
from dynident.robot import Robot, robot_from_urdf


@pytest.mark.parametrize("seed", [1, 2])
def test_rows_in_reverse_order_are_told_as_that(tmp_path: Path, seed: int) -> None:
    given = log("ur10", seed, duration=8.0)
    columns = {name: values[::-1] for name, values in given.columns().items()}
    (asked,) = guess(given.robot, columns).questions
    assert asked.detail.startswith(
        "t runs backward: the rows are in reverse order, or it counts down. Write the earliest"
    )
    assert [remedy.field for remedy in asked.remedies] == ["rate"]
    with pytest.raises(RecordingError, match="the rows are in reverse order") as refused:
        read(given.robot, tmp_path, columns)
    assert [remedy.field for remedy in refused.value.remedies] == ["rate"]


def test_a_file_with_a_row_for_each_signal_is_to_be_transposed() -> None:
    given = log("ur10", 1, duration=8.0)
    rows = np.array(list(given.columns().values()))
    lying = {f"{value:g}": rows[1:, k] for k, value in enumerate(rows[0])}
    (asked,) = guess(given.robot, lying).questions
    assert "transpose the file" in asked.detail


def test_velocities_without_positions_do_not_suffice() -> None:
    given = log("ur10", 1, duration=8.0)
    columns = given.columns(q=np.gradient(given.q, given.t, axis=0))
    named = {name.replace("q", "dq"): values for name, values in columns.items()}
    details = [one.detail for one in guess(given.robot, named).questions]
    assert any("Velocities alone do not suffice" in detail for detail in details)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_bursts_of_rows_with_one_time_are_read_without_a_warning_of_numpy(seed: int, tmp_path: Path) -> None:
    """A reader that empties its buffer now and then stamps several rows alike; the rate of the rows is the way on."""
    given = log("ur10", seed, rate=1000.0, duration=6.0)
    rng = np.random.default_rng(seed)
    late = np.maximum.accumulate(given.t + rng.exponential(2e-4, len(given.t)))
    columns = given.columns() | {"t": np.round(late, 3)}
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        guess(given.robot, columns)
    with pytest.raises(RecordingError, match='state "rate": … if the rows are evenly spaced'):
        read(given.robot, tmp_path, columns)
    checks = read(given.robot, tmp_path, columns, rate=1000.0).checks
    assert [one.name for one in checks if one.status == "error"] == []


@pytest.mark.parametrize("seed", [1, 2])
def test_rows_that_a_network_delivers_in_bursts_are_asked_for_their_rate(seed: int) -> None:
    given = log("ur10", seed, rate=100.0, duration=20.0)
    last = np.minimum(np.cumsum(np.random.default_rng(seed).integers(3, 12, len(given.t))), len(given.t) - 1)
    burst = np.searchsorted(last, np.arange(len(given.t)))
    arrived = given.t[last[burst]] + 4e-4 * (np.arange(len(given.t)) - last[burst]) + 0.01
    (question,) = guess(given.robot, given.columns() | {"t": arrived}).questions
    assert (question.field, "at a time by t" in question.detail) == ("columns/t", True)
    assert question.remedies[0].value == pytest.approx(100.0, rel=0.02)
    as_it_is = question.remedies[1]
    assert (as_it_is.field, as_it_is.value) == ("columns", {"t": "t"})
    table = given.columns() | {"t": arrived}
    sample = Sample(tuple(table), np.column_stack(list(table.values())), {}, stated={"t": "t"})
    assert "at a time by t" not in str(propose(sample, given.robot).questions)


@pytest.mark.parametrize(
    ("seed", "rate", "run", "pause"), [(1, 20.0, 9.0, 21.0), (2, 50.0, 4.0, 8.0), (3, 50.0, 3.0, 9.0)]
)
@pytest.mark.parametrize("rests", [False, True])
def test_pauses_between_runs_are_no_bursts(seed: int, rate: float, run: float, pause: float, rests: bool) -> None:
    """A run is recorded now and then; the robot goes on unseen, or stands from the end of a run to the next."""
    given = log("ur10", seed, rate=rate, duration=10.0 * (run + pause))
    kept = given.t % (run + pause) < run
    columns = {name: values[kept] for name, values in given.columns().items()}
    if rests:
        phase = (
            given.t[kept] // (run + pause) + 0.5 - 0.5 * np.cos(np.pi * (given.t[kept] % (run + pause)) / run)
        ) * run
        columns |= {f"q{k + 1}": np.interp(phase, given.t, q) for k, q in enumerate(given.q.T)}
    assert "at a time" not in str([asked.detail for asked in guess(given.robot, columns).questions])


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("factor", [1.2, 1.6])
def test_masses_tell_a_wrong_clock_from_scaled_velocities(seed: int, factor: float, tmp_path: Path) -> None:
    given = log("ur10", seed, rate=100.0)
    speed = np.gradient(given.q, given.t, axis=0)
    found = []
    for of_time, of_speed in ((factor, 1.0), (1.0, factor)):
        columns = given.columns() | {f"dq{k + 1}": of_speed * dq for k, dq in enumerate(speed.T)}
        columns["t"] = of_time * given.t
        inspected = inspect_file(write(tmp_path / "run.parquet", columns), given.robot).proposal
        assert inspected is not None
        checks = read(given.robot, tmp_path, columns, cures=5).checks
        names = {check.name for check in checks}, {guess.field.removeprefix("rows/") for guess in inspected.guesses}
        found.append(["clock_rate" in own for own in names])
    assert found == [[True, True], [False, False]]


@pytest.mark.parametrize("seed", [1, 2])
def test_a_warning_that_is_not_cured_says_so(seed: int, tmp_path: Path) -> None:
    given = log("ur10", seed, rate=200.0)
    late = np.column_stack([np.interp(given.t - 0.05, given.t, column) for column in given.tau.T])
    columns = replace(given, tau=late).columns()
    (asked,) = (one for one in read(given.robot, tmp_path, columns, cures=5).checks if one.name == "torque_delay")
    assert (asked.status, "Not corrected: only what would be refused" in asked.detail) == ("warning", True)
    (plain,) = (one for one in read(given.robot, tmp_path, columns).checks if one.name == "torque_delay")
    assert "Not corrected" not in plain.detail


def test_a_description_without_masses_says_what_cannot_be_checked() -> None:
    given = log("ur10", 1)
    proposals = [guess(robot, given.columns()) for robot in (given.robot, replace(given.robot, inertias=None))]
    assert ["no masses" in [one.value for one in proposal.guesses] for proposal in proposals] == [False, True]


def test_a_force_is_not_called_a_torque(tmp_path: Path) -> None:
    given = log("scara", 1)
    reasons = {one.field: one.reason for one in guess(given.robot, given.columns()).guesses}
    slides = [k + 1 for k, joint in enumerate(given.robot.joints) if joint.kind == "prismatic"]
    assert ["N m" in reasons[f"units/tau{k}"].partition("torques are in")[0] for k in slides] == [False] * len(slides)
    table = given.columns() | {"state": np.array([f"step {k} of 40" for k in range(len(given.t))])}
    proposal = inspect_file(write(tmp_path / "run.parquet", table), given.robot).proposal
    assert proposal is not None
    assert [one.reason for one in proposal.guesses if one.value == "state"] == [
        "not used: their cells are no plain numbers"
    ]


def test_a_look_at_a_file_tells_what_the_import_does_with_its_rows(tmp_path: Path) -> None:
    given = log("ur10", 4)
    columns = given.columns()
    half = len(given.t) // 2
    restarted = columns | {"t": np.concatenate([given.t[:half], given.t[: len(given.t) - half]])}
    jumped = columns | {"t": given.t + np.where(np.arange(len(given.t)) < half, 0.0, 3600.0)}
    for name, content in (("time_restarts", restarted), ("gaps", jumped)):
        proposal = inspect_file(write(tmp_path / f"{name}.parquet", content), given.robot).proposal
        assert proposal is not None
        assert proposal.is_sure
        assert [one.field for one in proposal.guesses if one.value == "noticed"] == [f"rows/{name}"]


def _write_runs_end_to_end(path: Path, given: Log) -> Path:
    """Two runs that were appended with the line of names of each."""
    columns = given.columns()
    rows = [",".join(f"{value:.9g}" for value in row) for row in np.column_stack(list(columns.values()))]
    names, half = ",".join(columns), len(rows) // 2
    path.write_text("\n".join([names, *rows[:half], names, *rows[half:]]) + "\n")
    return path


def _write_mat(path: Path, given: Log) -> Path:
    savemat(path, {"data": {"Ts": given.t[1] - given.t[0], "pos": given.q.T, "trq": given.tau.T}})
    return path


def _write_npz(path: Path, given: Log) -> Path:
    np.savez(path, q=given.q, tau=given.tau, dt=given.t[1] - given.t[0])
    return path


def _write_hdf5(path: Path, given: Log) -> Path:
    with h5py.File(path, "w") as file:
        file["run/q"], file["run/tau"], file["run/sample_rate"] = given.q, given.tau, 1.0 / (given.t[1] - given.t[0])
    return path


@pytest.mark.parametrize(("arm", "seed", "rate"), [("ur10", 1, 100.0), ("ur5", 2, 250.0)])
@pytest.mark.parametrize(
    ("name", "write_file"),
    [("a.csv", _write_runs_end_to_end), ("a.mat", _write_mat), ("a.npz", _write_npz), ("a.h5", _write_hdf5)],
)
def test_files_without_a_plain_clock_or_with_names_between_the_rows_ask_nothing(
    tmp_path: Path, name: str, write_file, arm: str, seed: int, rate: float
) -> None:
    given = log(arm, seed, rate=rate, duration=8.0)
    inspection = inspect_file(write_file(tmp_path / name, given), given.robot)
    assert inspection.proposal is not None
    assert inspection.proposal.questions == ()
    assert f"{rate:g} Hz" in next(one.reason for one in inspection.proposal.guesses if one.field == "columns/t")


def test_several_sampling_times_in_a_file_are_not_believed(tmp_path: Path) -> None:
    given = log("ur10", 1, duration=8.0)
    path = tmp_path / "a.npz"
    np.savez(path, q=given.q, tau=given.tau, dt=0.01, Ts=0.001)
    inspection = inspect_file(path, given.robot)
    assert inspection.proposal is not None
    assert [one.field for one in inspection.proposal.questions] == ["columns/t"]


def pendulum() -> Robot:
    """Two joints about level axes that are parallel: in their plane any gravity has some masses that go with it."""
    link = (
        '<inertial><origin xyz="0 0 -0.12"/><mass value="0.7"/>'
        '<inertia ixx="0.006" ixy="0" ixz="0" iyy="0.006" iyz="0" izz="0.001"/></inertial>'
    )
    joint = '<axis xyz="0 1 0"/><limit lower="-3" upper="3" velocity="20" effort="8"/></joint>'
    return robot_from_urdf(
        "pendulum",
        f'<robot name="pendulum"><link name="base"/><link name="a">{link}</link><link name="b">{link}</link>'
        f'<joint name="j1" type="revolute"><parent link="base"/><child link="a"/>{joint}'
        f'<joint name="j2" type="revolute"><parent link="a"/><child link="b"/><origin xyz="0 0 -0.25"/>{joint}</robot>',
    )


@pytest.mark.sweep
@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("direction", [(1.0, 0.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)])
def test_gravity_that_only_the_masses_tell_is_told(tmp_path: Path, direction: tuple[float, ...], seed: int) -> None:
    given = log_of(pendulum(), seed)
    stated = replace(given.robot, gravity=9.81 * np.array(direction))
    warned = [one for one in read(stated, tmp_path, given.columns()).checks if one.status != "ok"]
    assert [one.name for one in warned] == ["gravity_direction"]
    assert "along (0,0,-9.81)" in warned[0].detail
    right = read(given.robot, tmp_path, given.columns()).checks
    assert [one.name for one in right if one.status != "ok"] == []


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_gain_of_an_arm_of_two_joints_is_told_by_its_masses(tmp_path: Path, seed: int) -> None:
    given = log_of(pendulum(), seed)
    checks = read(given.robot, tmp_path, given.columns(tau=10.0 * given.tau)).checks
    (warned,) = [one for one in checks if one.status != "ok"]
    assert warned.name == "torque_scale"
    assert warned.apply is not None
    assert warned.apply.scale == {"tau1": 0.1, "tau2": 0.1}


@pytest.mark.parametrize("joint", [0, 1])
@pytest.mark.parametrize("missing", [0.0, np.nan])
def test_a_joint_without_torque_does_not_say_where_gravity_is(tmp_path: Path, joint: int, missing: float) -> None:
    given = log_of(pendulum(), 1)
    tau = given.tau.copy()
    tau[:, joint] = missing
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        try:
            checks = read(given.robot, tmp_path, given.columns(tau=tau)).checks
        except RecordingError as error:
            checks = error.checks
    assert "gravity_direction" not in [one.name for one in checks if one.status != "ok"]


@pytest.mark.parametrize("seconds", [0.02, -0.02])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_delay_is_told_where_nearly_all_is_explained(tmp_path: Path, seed: int, seconds: float) -> None:
    """What is unexplained is then below what counts as perfect with any delay near the right one."""
    given = log_of(pendulum(), seed)
    late = np.column_stack([np.interp(given.t - seconds, given.t, torque) for torque in given.tau.T])
    warned = [one for one in read(given.robot, tmp_path, given.columns(tau=late)).checks if one.status != "ok"]
    assert [one.name for one in warned] == ["torque_delay"]
    assert warned[0].apply is not None
    assert abs(warned[0].apply.torque_delay - seconds) < 0.003


@pytest.mark.parametrize(("name", "seed"), [("ur5", 1), ("franka_panda", 2)])
@pytest.mark.parametrize("seconds", [0.05, -0.085, 0.13])
def test_a_delay_longer_than_usual_ones_is_found_as_well(tmp_path: Path, name: str, seed: int, seconds: float) -> None:
    given = log(name, seed)
    late = np.column_stack([np.interp(given.t - seconds, given.t, torque) for torque in given.tau.T])
    checks = read(given.robot, tmp_path, given.columns(tau=late)).checks
    (delay,) = [one for one in checks if one.name == "torque_delay" and one.status != "ok"]
    assert delay.apply is not None
    assert abs(delay.apply.torque_delay - seconds) < 0.005


@pytest.mark.parametrize(("name", "seed", "seconds"), [("ur5", 1, 0.42), ("ur10", 2, -0.7), ("franka_panda", 3, 1.6)])
def test_clocks_that_are_apart_are_the_first_cause_and_brought_together(
    tmp_path: Path, name: str, seed: int, seconds: float
) -> None:
    """Positions and torques of two computers: every torque belongs to another moment, and signs look wrong as well."""
    given = log(name, seed)
    late = np.column_stack([np.interp(given.t - seconds, given.t, torque) for torque in given.tau.T])
    inner = slice(200, -200)
    columns = {key: values[inner] for key, values in given.columns(tau=late).items()}
    with pytest.raises(RecordingError, match="stamped by different clocks") as refused:
        read(given.robot, tmp_path, columns)
    (wrong,) = [check for check in refused.value.checks if check.status == "error"]
    assert wrong.apply is not None
    assert abs(wrong.apply.torque_delay - seconds) < 0.01
    (cure,) = read(given.robot, tmp_path, columns, cures=3).revisions
    assert abs(cure.torque_delay - seconds) < 0.01


@pytest.mark.parametrize("seed", [1, 2])
def test_an_angle_from_the_horizon_is_not_asked_as_gears_of_all_joints(seed: int) -> None:
    given = log("ur5", seed)
    q = given.q.copy()
    q[:, 2] += q[:, 1]
    found = guess(given.robot, given.columns(q=q))
    (asked,) = found.questions
    assert (asked.check, dict(found.units)) == ("joint_coupling", {})


def test_a_force_of_a_joint_that_slides_is_counted_with_the_torques_of_the_others() -> None:
    given = log("scara", 3)
    columns = {name.replace("tau", "Drehmoment "): values for name, values in given.columns().items()}
    columns["Kraft 3"] = columns.pop("Drehmoment 3")
    found = guess(given.robot, columns)
    assert [found.columns[f"tau{k}"] for k in (1, 2, 3, 4)] == [
        "Drehmoment 1", "Drehmoment 2", "Kraft 3", "Drehmoment 4"
    ]  # fmt: skip
    # Of a joint that turns it is something else: contact, mostly.
    columns["Kraft 2"] = columns.pop("Drehmoment 2")
    assert guess(given.robot, columns).columns.get("tau2") != "Kraft 2"


def test_friction_is_no_excess_where_the_masses_say_that_the_torque_is_right(tmp_path: Path) -> None:
    given = log("ur5", 2)
    tau = given.tau.copy()
    speed = np.gradient(given.q[:, 1], given.t)
    tau[:, 1] += 0.25 * np.abs(tau[:, 1]).max() * np.sign(speed)
    assert [one.name for one in read(given.robot, tmp_path, given.columns(tau=tau)).checks if one.status != "ok"] == []


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("arm5.urdf", "did you mean 'arm6.urdf'"),
        ("none/arm.urdf", "the folder .*none does not exist"),
        ("link.urdf", "is a link to gone.urdf, which does not exist"),
        ("folder.d", "is a folder"),
    ],
)
def test_a_description_that_is_not_there_is_said_to_be_missing(tmp_path: Path, name: str, told: str) -> None:
    (tmp_path / "arm6.urdf").write_text("<robot/>")
    (tmp_path / "link.urdf").symlink_to("gone.urdf")
    (tmp_path / "folder.d").mkdir()
    with pytest.raises(DynidentError, match=told):
        load_robot(tmp_path / name)


def test_columns_named_by_the_links_are_those_of_the_joints_that_move_them() -> None:
    given = log("ur10", 4, duration=8.0)
    names = ("torso", "upperarm", "forearm", "handroot", "palm", "fingerplate")
    joints = tuple(replace(joint, link=link) for joint, link in zip(given.robot.joints, names, strict=True))
    order = np.random.default_rng(4).permutation(6)
    columns = {"time": given.t}
    for signal, values in (("angle", given.q), ("torque", given.tau)):
        columns |= {f"{names[j]}_{signal}": values[:, j] for j in order}
    proposal = guess(replace(given.robot, joints=joints), columns)
    assert proposal.questions == ()
    assert [proposal.columns[f"q{j + 1}"] for j in range(6)] == [f"{name}_angle" for name in names]


def test_objects_of_canopen_are_counts_and_thousandths_of_the_rated_torque() -> None:
    given = log("ur10", 5, duration=8.0)
    counts = np.rint(given.q / (2.0 * np.pi) * 524288.0)
    shares = np.rint(1e3 * given.tau / np.abs(given.tau).max(axis=0))
    columns = {"time_ms": 1e3 * given.t}
    for index, values in (("6064h", counts), ("6077h", shares)):
        columns |= {f"Node{j + 1}.{index}": values[:, j] for j in range(6)}
    proposal = guess(given.robot, columns)
    assert (proposal.columns["q6"], proposal.columns["current6"]) == ("Node6.6064h", "Node6.6077h")
    (drives,) = [asked for asked in proposal.questions if asked.field == "drives"]
    assert "in permille: give the drive gains" in drives.detail


def test_degrees_that_are_radians_are_asked_about() -> None:
    given = log("ur10", 6, duration=8.0)
    names = {"t": "time"} | {f"q{j}": f"q{j}_deg" for j in range(1, 7)}
    columns = {names.get(name, name): values for name, values in given.columns().items()}
    asked = next(one for one in guess(given.robot, columns).questions if one.field == "units/q")
    assert asked.choices[0] == "rad"
    assert "its name says deg, but then no joint moves by more than" in asked.detail


def test_sines_and_cosines_are_no_angles() -> None:
    given = log("ur10", 7, duration=8.0)
    columns = {"t": given.t}
    for name, wave in (("cos", np.cos), ("sin", np.sin)):
        columns |= {f"{name}_q{j + 1}": wave(given.q[:, j]) for j in range(6)}
    columns |= {f"tau{j + 1}": given.tau[:, j] for j in range(6)}
    asked = next(one for one in guess(given.robot, columns).questions if one.field == "columns/q")
    assert "are sines and cosines: write the angles" in asked.detail


@pytest.mark.parametrize("pattern", ["sine.{}", "{}_sine", "cos_{}", "{}_sin"])
def test_a_sine_without_its_cosine_names_a_motion(pattern: str) -> None:
    names = [pattern.format(f"{kind}{j}") for kind in ("q", "tau") for j in range(1, 7)]
    columns = read_names(["t", *names], {})
    assert [column.signal for column in columns] == ["t", *["q"] * 6, *["tau"] * 6]
    assert describe_waves(columns) == ""
    assert read_names(["par_sin_filtro_1"], {})[0].signal is None


def test_obvious_outliers_are_called_corrupted_before_an_import_as_well() -> None:
    given = log("ur10", 8, duration=8.0)
    tau = given.tau.copy()
    tau[[100, 300, 701], 2] = 1e7
    (row,) = [one for one in guess(given.robot, given.columns(tau=tau)).guesses if one.field.startswith("rows/")]
    assert row.field == "rows/corrupted_samples"


@pytest.mark.parametrize("share", [0.0, 0.5])
def test_rows_whose_drives_are_off_are_no_motion_of_a_proposal(share: float) -> None:
    """They are left out where columns are guessed, as they are when the file is read."""
    given = log("ur10", 8)
    place, off = int(share * len(given.t)), 1000
    tau = np.insert(given.tau, [place] * off, 0.0, axis=0)
    q = np.insert(given.q, [place] * off, given.q[place], axis=0)
    t = np.arange(len(q)) * (given.t[1] - given.t[0])
    columns = {"t": t} | {f"{s}{k + 1}": values[:, k] for s, values in (("q", q), ("tau", tau)) for k in range(6)}
    proposal, whole = guess(given.robot, columns), guess(given.robot, given.columns())
    assert proposal.questions == ()
    assert [one.field for one in proposal.guesses if one.field.startswith("rows/")] == ["rows/idle_drives"]
    unexplained = [next(one.value for one in made.guesses if one.field == "check") for made in (proposal, whole)]
    assert unexplained[0] == unexplained[1]


@pytest.mark.parametrize("after", [0.3, 0.6])
def test_torques_that_step_once_are_told_with_the_time(tmp_path: Path, after: float) -> None:
    """Sensors that are zeroed anew in the middle of a recording; a drift is none."""
    given = log("ur10", 9)
    signs = np.array([1.0, -1.0, 1.0, 1.0, -1.0, 1.0])
    later = (given.t >= after * given.t[-1])[:, None]
    stepped = read(given.robot, tmp_path, given.columns(tau=given.tau + 0.2 * given.tau.std(axis=0) * signs * later))
    (step,) = [check for check in stepped.checks if check.name == "torque_step"]
    assert step.status == "warning"
    assert step.time == pytest.approx(after * given.t[-1], abs=0.3)
    for drift in (0.0 * given.t, given.t / given.t[-1], -np.exp(-given.t / 4.0)):
        drifting = read(
            given.robot, tmp_path, given.columns(tau=given.tau + 0.2 * given.tau.std(axis=0) * drift[:, None])
        )
        assert "torque_step" not in {check.name for check in drifting.checks}


def test_a_load_that_is_taken_up_says_nothing_of_units(tmp_path: Path) -> None:
    """What it adds to friction is that of neither side."""
    given = log("ur10", 5)
    loaded = np.array([0.0, -1.0, 1.0, 0.0, 0.0, 0.0]) * (given.t >= 0.5 * given.t[-1])[:, None]
    taken = read(given.robot, tmp_path, given.columns(tau=given.tau + 4.0 * given.tau.std(axis=0) * loaded))
    assert [check.name for check in taken.checks if check.status != "ok"] == ["torque_step"]


def test_the_time_of_a_step_of_torque_is_right_inside_windows(tmp_path: Path) -> None:
    given = log("ur10", 9)
    end = float(given.t[-1])
    later = (given.t >= 0.6 * end)[:, None]
    columns = given.columns(tau=given.tau + 0.2 * given.tau.std(axis=0) * later)
    result = read(given.robot, tmp_path, columns, windows=((0.3 * end, 0.9 * end),))
    (step,) = [check for check in result.checks if check.name == "torque_step"]
    assert step.time == pytest.approx(0.6 * end, abs=0.3)


@pytest.mark.parametrize("joint", [0, 3])
def test_a_joint_that_stands_exactly_still_is_read(tmp_path: Path, joint: int) -> None:
    given = log("scara", 4, duration=8.0)
    q = given.q.copy()
    q[:, joint] = 0.1
    assert "joint_motion" in {check.name for check in read(given.robot, tmp_path, given.columns(q=q)).checks}


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"\xfd7zXZ\x00\x00\x04", "compressed with xz"),
        (b"arm,joint=j1 pos=0.1,eff=2.3 1700000000000000000\n" * 3, "InfluxDB's line protocol"),
        (b"t,q1,tau1\n" + b"0.1,2,3\n" * 9 + b"t,tau1,q1\n" + b"0.1,3,2\n" * 9, "in another order"),
    ],
)
def test_further_files_that_are_not_read_say_what_to_do(tmp_path: Path, content: bytes, words: str) -> None:
    path = tmp_path / "run.csv"
    path.write_bytes(content)
    with pytest.raises(RecordingError, match=words):
        inspect_file(path, None, log("ur10", 1, duration=8.0).robot)


def test_an_array_of_three_axes_says_which_are_needed(tmp_path: Path) -> None:
    path = tmp_path / "run.npy"
    np.save(path, np.zeros((100, 6, 3)))
    with pytest.raises(RecordingError, match=r"3 axes \(100 x 6 x 3\): save an array of rows"):
        inspect_file(path, None, log("ur10", 1, duration=8.0).robot)


@pytest.mark.parametrize(("arm", "seed"), [("ur10", 1), ("ur5", 2), ("franka_panda", 3)])
@pytest.mark.parametrize(
    ("unit", "size"), [("kgf cm", 0.0980665), ("lbf ft", 1.3558179), ("mN m", 1e-3), ("N cm", 1e-2)]
)
def test_the_unit_of_torques_that_is_not_stated_is_asked_by_the_masses(
    arm: str, seed: int, unit: str, size: float
) -> None:
    given = log(arm, seed, duration=10.0)
    proposal = guess(given.robot, given.columns(tau=given.tau / size))
    proposed = proposal.units.get("tau", "N m")
    # Feet and pounds are so near to N m that the masses of no description tell them apart.
    assert proposed == ("N m" if unit == "lbf ft" else unit)
    asked = [question for question in proposal.questions if question.field == "units/tau"]
    assert all(unit in question.choices and "times in N m" in question.detail for question in asked)
    assert len(proposal.questions) == len(asked) <= (unit in ("kgf cm", "N cm"))


@pytest.mark.parametrize(("arm", "seed"), [("ur10", 1), ("ur5", 2)])
@pytest.mark.parametrize("largest", [150.0, 0.01])
def test_drive_gains_answer_what_numbers_called_torques_are(arm: str, seed: int, largest: float) -> None:
    """Thousandths of the rated torques, or torques before the gears: N m per unit of them are the drive gains."""
    given = log(arm, seed, duration=10.0)
    rng = np.random.default_rng(seed)
    gains = rng.uniform(0.2, 1.0, given.robot.n) / largest
    columns = given.columns(tau=given.tau / gains)
    (question,) = guess(given.robot, columns).questions
    assert question.field == "units/tau"
    arm_with_gains = set_drive_gains(given.robot, gains.tolist())
    # Without limits of effort, the size of the numbers alone would make them mA.
    free = [replace(joint, limits=replace(joint.limits, effort=None)) for joint in arm_with_gains.joints]
    for robot in (arm_with_gains, replace(arm_with_gains, joints=tuple(free))):
        told = guess(robot, columns)
        assert told.questions == ()
        assert (told.effort_kind, told.units.get("current", "A")) == ("motor_torque", "A")
    assert [name for name in told.columns if name.startswith("current")] == [f"current{j + 1}" for j in range(6)]


def test_a_limit_of_effort_that_is_too_small_is_no_reason_to_ask_for_the_unit() -> None:
    weak = crooked_urdf(5, 11, sliding=()).replace('effort="80"', 'effort="20"')
    given = log_of(robot_from_urdf("weak", weak), 4, duration=10.0)
    assert np.abs(given.tau).max() > 40.0
    assert guess(given.robot, given.columns()).questions == ()


@pytest.mark.parametrize("pattern", ["Axis\\{}", "Axis\\1{}", "\\g<0>{}"])
def test_names_of_columns_are_said_as_they_are(pattern: str) -> None:
    given = log("ur10", 1, duration=8.0)
    columns = given.columns()
    renamed = {
        pattern.format(name) if name != "t" else name: np.where(np.arange(len(given.t)) == 300, np.nan, values)
        if name != "t"
        else values
        for name, values in columns.items()
    }
    details = [one.reason for one in guess(given.robot, renamed).guesses if one.value == "corrected"]
    assert any(pattern.format("q1") in detail for detail in details), details


def test_torques_made_from_commands_are_still_so_in_some_rows() -> None:
    given = log("ur10", 1, duration=8.0)
    fits = DynamicsFits(given.robot, given.t)
    fits.from_commands = True
    rows = given.t < 5.0
    recording = fits.select_rows(rows).to_recording(given.q[rows], given.tau[rows])
    assert recording is not None
    assert recording.torque_from_commands


def test_turns_of_the_joints_are_taken_where_the_dynamics_bear_them_out() -> None:
    given = log("ur10", 2)
    found = guess(given.robot, given.columns(q=given.q / (2.0 * np.pi)))
    assert (found.questions, found.units["q"]) == ((), "rev")


@pytest.mark.parametrize("seed", [1, 2])
def test_turns_of_motors_are_not_taken_for_degrees_of_the_joints(seed: int) -> None:
    given = log("ur10", seed)
    found = guess(given.robot, given.columns(q=given.q * 20.0 / (2.0 * np.pi)))
    (asked,) = [one for one in found.questions if one.field == "units/q"]
    counts = asked.remedies[0].value
    assert isinstance(counts, dict)
    # Turns of the inner joints lift what they carry, and tell most.
    assert [float(counts[f"q{j}"].partition(":")[2]) for j in (2, 3)] == pytest.approx([20.0, 20.0], rel=0.15)


def test_torques_whose_names_state_several_units_are_read_in_these() -> None:
    given = log("ur10", 3)
    scale = np.array([1.0, 1.0, 1.0, 1e3, 1e3, 1e3])
    named = {f"J{j + 1} torque [{'Nm' if j < 3 else 'mNm'}]": given.tau[:, j] * scale[j] for j in range(6)}
    positions = {f"J{j + 1} position [rad]": given.q[:, j] for j in range(6)}
    found = guess(given.robot, {"t": given.t} | positions | named)
    assert found.questions == ()
    assert [found.units.get(f"tau{j}", "N m") for j in (1, 4)] == ["N m", "mN m"]


def test_joints_that_the_file_lacks_are_to_be_locked_though_they_are_half_of_all() -> None:
    given = log("ur10", 1, duration=8.0)
    columns = {
        f"axis{j + 1}_{kind}": values[:, j]
        for kind, values in (("pos", given.q), ("torque", given.tau))
        for j in range(3)
    }
    (asked,) = [one for one in guess(given.robot, {"t": given.t} | columns).questions if one.field == "robot"]
    assert asked.remedies[0].value == dict.fromkeys(given.robot.joint_names[3:], 0)


def test_a_clock_of_coarse_steps_is_told_with_the_rate_of_the_rows() -> None:
    given = log("ur10", 1)
    columns = given.columns() | {"t": np.floor(given.t * 64.0) / 64.0}
    (asked,) = guess(given.robot, columns).questions
    assert "stays the same for 1.6 rows at a time" in asked.detail
    assert asked.remedies[0].value == pytest.approx(100.0, rel=1e-3)


def test_a_load_that_the_description_lacks_is_no_other_zero_of_the_last_joint() -> None:
    given = log("ur10", 4)
    inertias = given.robot.inertias.copy()
    inertias[-1] += 2.0 * np.array([0.03, 0.0, 0.0, 0.03, -0.0036, 0.003, 0.0, 0.03, 0.12, 1.0])
    motion = fourier_motion(given.robot, 20.0, 100.0, 4)
    loaded = pinocchio_torque(replace(given.robot, inertias=inertias), motion.q, motion.dq, motion.ddq)
    empty = pinocchio_torque(given.robot, motion.q, motion.dq, motion.ddq)
    found = guess(given.robot, given.columns(tau=given.tau + loaded - empty))
    assert [one.check for one in found.questions] == []


@pytest.mark.parametrize("is_cut", [False, True])
def test_groups_of_a_scope_that_share_a_time_are_read(tmp_path: Path, is_cut: bool) -> None:
    """Tabs and decimal commas, and two groups of channels at rates of their own, each with its time first."""
    given = log("ur10", 1, duration=10.0)
    groups = ((1, "Axis{}.ActPos", "° (Angle)", np.rad2deg(given.q)), (2, "Axis{}.ActTrq", "(None)", given.tau))
    lines = ["Name\tScope", "File\tC:\\a.csv", "", ""]
    for key, values in (
        ("Name", [[pattern.format(j) for j in range(1, 7)] for _, pattern, _, _ in groups]),
        ("SampleTime[ms]", [[str(10 * every)] * 6 for every, _, _, _ in groups]),
        ("Unit", [[unit] * 6 for _, _, unit, _ in groups]),
    ):
        lines.append("\t".join(cell for own in values for cell in (key, *own)))
    lines.append("")
    for row, t in enumerate(given.t):
        cells = []
        for every, _, _, values in groups:
            at = row * every
            inside = at < len(given.t)
            # The first row may be of zeros, without a comma.
            cells += [f"{1e3 * t * every:g}", *(f"{x:.6f}" if row else "0" for x in values[at])] if inside else [""] * 7
        # Lines end where the channels do.
        line = "\t".join(cells).replace(".", ",")
        lines.append(line.rstrip("\t") if is_cut else line)
    (tmp_path / "scope.txt").write_bytes("\n".join(lines).encode("cp1252"))
    proposal = inspect_file(tmp_path / "scope.txt", given.robot).proposal
    assert proposal.questions == ()
    assert (proposal.units["q"], proposal.columns["tau3"]) == ("deg", "Axis3.ActTrq")


def test_rows_behind_a_word_are_read_and_other_messages_left_out(tmp_path: Path) -> None:
    given = log("ur10", 1, duration=6.0)
    rows = [f"Y,{1e3 * t:.0f}," + ",".join(f"{x:.6f}" for x in values) for t, values in zip(
        given.t, np.hstack([given.q, given.tau]), strict=True)]  # fmt: skip
    path = tmp_path / "controller.log"
    path.write_text("\n".join(["I,boot ok,1.3", *rows[:200], "I,temperature,31.5", *rows[200:]]) + "\n")
    found = inspect_file(path, given.robot).proposal
    assert (found.columns["t"], found.columns["q1"], found.columns["tau6"]) == ("column2", "column3", "column14")


def test_lists_in_braces_beside_dates_without_signs_are_read(tmp_path: Path) -> None:
    given = log("ur10", 1, duration=10.0)
    lines = ["Timestamp;Joint_Angle;Joint_Torque;Error"]
    for t, q, tau in zip(given.t, np.rad2deg(given.q), given.tau, strict=True):
        both = ["{" + ",".join(f"{x:.5f}" for x in values) + "}" for values in (q, tau)]
        lines.append(f"20240506 13:04:{5.0 + t:06.3f};{both[0]};{both[1]};false")
    path = tmp_path / "flow.csv"
    path.write_text("\n".join(lines) + "\n")
    proposal = inspect_file(path, given.robot).proposal
    assert (proposal.questions, proposal.units["q"]) == ((), "deg")


def test_lines_of_a_plotter_are_rows_of_its_signals(tmp_path: Path) -> None:
    given = log("ur10", 1, duration=10.0)
    columns = {name: values for name, values in given.columns().items() if name != "t"}
    path = tmp_path / "plotted.txt"
    path.write_text(
        "".join(
            f">{name}:{1.7e12 + round(1e3 * t):.0f}:{values[k]:.7g}\n"
            for k, t in enumerate(given.t)
            for name, values in columns.items()
        )
    )
    proposal = inspect_file(path, given.robot).proposal
    assert proposal.questions == ()
    assert (proposal.columns["q2"], proposal.columns["tau6"]) == ("value_q2", "value_tau6")


def test_a_rewritten_text_ends_where_no_more_rows_are_asked_for() -> None:
    """Arrow reads ahead in a thread, which may not go on while Python ends."""
    text = RewrittenText(io.BytesIO(b"1,2\n" * 9), ())
    assert text.read(4) == b"1,2\n"
    text.is_ended = True
    assert text.read() == b""


def test_texts_in_braces_are_no_lists(tmp_path: Path) -> None:
    lines = [f'{k / 100},{0.1 * k:.1f},"{{ready{", moving" if k % 3 else ""}}}",{k}' for k in range(300)]
    path = tmp_path / "flags.csv"
    path.write_text("\n".join(["t,q1,flags,tau1", *lines, ""]))
    source = open_source(path, None)
    assert (source.names, source.remarks) == (["t", "q1", "flags", "tau1"], ())
    assert sum(batch.num_rows for batch in source.batches(["tau1"])) == 300
    objects = [f'{k / 100};{{"a": {k}}};{k}' for k in range(300)]
    path.write_text("\n".join(["t;state;tau1", *objects, ""]))
    source = open_source(path, None)
    assert "a" in source.names
    np.testing.assert_array_equal(next(source.batches(["tau1"])).column("tau1").to_numpy(), np.arange(300))


def test_the_time_that_lists_in_braces_take_grows_with_their_number() -> None:
    def measure(n: int) -> float:
        text = "".join(f"{k / 100},{{{k}.5 {k}}},{{{k}.0 -1e-3}}\n" for k in range(n))
        return min(timeit.repeat(lambda: flatten_lists(text), timer=time.process_time, number=1, repeat=5))

    # Eight times as many lists took fifty times as long where each looked for an end of its own in all the others.
    assert measure(4000) < 25.0 * measure(500)


def test_lines_of_a_plotter_may_hold_several_samples_and_others_are_counted(tmp_path: Path) -> None:
    plotted = [
        f">q1:{1000 + 10 * k}:{0.1 * k:.1f}\n>tau1:{1000 + 10 * k}:{k};{1005 + 10 * k}:{k}.5\n" for k in range(300)
    ]
    path = tmp_path / "plotted.txt"
    path.write_text("".join(["boot, ok\n", 'note "a"\n', *plotted]))
    source = open_source(path, None)
    values = np.concatenate([batch.column("value_tau1").to_numpy() for batch in source.batches(["value_tau1"])])
    np.testing.assert_allclose(values, 0.5 * np.arange(600))
    assert any("2 rows have another number of cells" in remark and "boot" in remark for remark in source.remarks)


def test_what_a_channel_holds_may_stand_below_its_name(tmp_path: Path) -> None:
    path = tmp_path / "graph.csv"
    rows = [f"{0.5 * k},{k % 50},{k % 7}" for k in range(100)]
    path.write_text("\n".join(["Time,Analog 1,Analog 2", "ms,Position feedback,Servo motor torque", *rows, ""]))
    assert open_source(path, None).names == ["Time_ms", "Analog 1_Position feedback", "Analog 2_Servo motor torque"]
    # Names of ours are whole.
    path.write_text("\n".join(["t,q1,tau1", "Seconds,Degrees,Newton meters", *rows, ""]))
    assert open_source(path, None).names == ["t", "q1", "tau1"]


def test_names_in_two_lines_are_no_channels_of_a_scope(tmp_path: Path) -> None:
    rows = [f"{0.1 * k:.1f},{k},{k + 1},{k % 7}" for k in range(100)]
    path = tmp_path / "run.csv"
    path.write_text("\n".join(["position,position,position,torque", "joint1,joint2,joint3,joint1", *rows, ""]))
    names = [f"position_joint{joint}" for joint in (1, 2, 3)]
    assert open_source(path, None).names == [*names, "torque_joint1"]
    # Words that stand in the place of times do not make times of numbers that fall.
    head = ["q,joint1,q,joint2", "unit,rad,unit,deg"]
    path.write_text("\n".join([*head, *(f"{100 - k},{k},{k % 5},{k}" for k in range(100)), ""]))
    assert not open_source(path, None).clocks


@pytest.mark.parametrize("is_nested", [False, True])
def test_lists_of_structures_within_structures_are_columns(tmp_path: Path, is_nested: bool) -> None:
    def make_joint(k: int) -> dict[str, object]:
        state = {"position": 0.1 * k, "effort": 1.0 * k}
        return {"state": state} if is_nested else state

    rows = [{"stamp": 0.01 * row, "joints": [make_joint(row + j) for j in range(3)]} for row in range(20)]
    path = tmp_path / "run.parquet"
    pq.write_table(pa.table({"msg": rows}), path)
    source = open_source(path, None)
    stem = "msg.joints.state" if is_nested else "msg.joints"
    names = [f"{stem}.{kind}{j}" for kind in ("position", "effort") for j in (1, 2, 3)]
    assert source.names == ["msg.stamp", *names]
    (batch,) = source.batches([f"{stem}.effort3"])
    assert batch.column(0).to_pylist() == [row + 2.0 for row in range(20)]


@pytest.mark.parametrize(
    "read_text",
    [
        lambda: find_labels(["A" * 20_000] * 12),
        lambda: find_labels(["a: " + " " * 20_000 + "b"] * 12),
        lambda: name_labelled_numbers("1" * 20_000 + "a"),
        lambda: find_labels(["q: " + "0.1 " * 10_000 + " ".join(f"a{k}=1" for k in range(2000))] * 2),
        lambda: has_minus_elsewhere("1" * 20_000 + "a"),
        lambda: find_quantities({"q1": ["1" * 20_000 + "!"]}),
    ],
)
def test_long_words_and_numbers_are_read_in_a_time_that_grows_with_their_length(
    read_text: Callable[[], object],
) -> None:
    assert timeit.timeit(read_text, number=1) < 1.0


def test_messages_of_two_kinds_with_as_many_cells_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "run.log"
    path.write_text("".join(f"IMU,{k / 100},{k},1\n" + f"ARM,{k / 100},{k},2\n" * (k % 3) for k in range(100)))
    with pytest.raises(RecordingError, match=r"several kinds \(IMU, ARM\)"):
        open_source(path, None)


def test_a_marked_row_without_a_value_is_no_line_of_names(tmp_path: Path) -> None:
    path = tmp_path / "run.log"
    path.write_text("".join(f"ARM,{k / 100},{'nan' if k == 0 else k},2\n" for k in range(100)))
    source = open_source(path, None)
    assert source.names == ["column1", "column2", "column3", "column4"]
    assert sum(batch.num_rows for batch in source.batches(["column2"])) == 100


def test_a_time_of_day_goes_on_behind_midnight(tmp_path: Path) -> None:
    given = log("ur10", 1, duration=8.0)
    seconds = np.round(86_395.0 + given.t, 2)
    clock = [f"{x % 86400 // 3600:02.0f}:{x % 3600 // 60:02.0f}:{x % 60:05.2f}" for x in seconds]
    columns = given.columns()
    rows = np.column_stack(list(columns.values())[1:])
    lines = [f"{time},{','.join(f'{value:.9g}' for value in row)}" for time, row in zip(clock, rows, strict=True)]
    path = tmp_path / "run.csv"
    path.write_text("\n".join([",".join(columns), *lines]) + "\n")
    recording = import_cured(given.robot, path, tmp_path / "read.parquet", RecordingMetadata(), most=0).recording
    assert len(recording.segments) == 1
    assert recording.segments[0].length * recording.period == pytest.approx(given.t[-1], abs=0.03)
    proposal = inspect_file(path, given.robot).proposal
    assert proposal is not None
    assert proposal.questions == ()


def _write_clock(path: Path, seconds: np.ndarray) -> list[pa.RecordBatch]:
    """Write a long file with a time of day and segments, and return its rows as they are read."""
    clock = [f"{x % 86400 // 3600:02.0f}:{x % 3600 // 60:02.0f}:{x % 60:05.2f}" for x in seconds]
    rows = [f"{time},1,{np.sin(k):.12f},{np.cos(k):.12f}" for k, time in enumerate(clock)]
    path.write_text("\n".join(["time,segment,q1,tau1", *rows, ""]))
    return list(open_source(path, None).batches(["time", "segment"]))


def test_midnight_between_two_blocks_of_a_file_with_segments_is_passed(tmp_path: Path) -> None:
    path, steps = tmp_path / "run.csv", 0.01 * np.arange(30_000)
    first = _write_clock(path, 3600.0 + steps)[0].num_rows
    assert first < len(steps)
    seconds = 86_400.0 + steps - steps[first]
    batches = _write_clock(path, seconds)
    assert batches[0].num_rows == first
    t = np.concatenate([batch.column("time").to_numpy(zero_copy_only=False) for batch in batches])
    np.testing.assert_allclose(t, seconds, atol=1e-6)


def test_a_row_that_is_late_at_midnight_is_of_the_day_before(tmp_path: Path) -> None:
    seconds = 86_399.0 + 0.05 * np.arange(100)
    seconds[[19, 20]] = seconds[[20, 19]]
    (batch,) = _write_clock(tmp_path / "run.csv", seconds)
    np.testing.assert_allclose(batch.column("time").to_numpy(zero_copy_only=False), seconds, atol=1e-6)


def test_runs_of_a_whole_day_that_begin_at_0_are_two(tmp_path: Path) -> None:
    t = np.tile(10.0 * np.arange(8640), 2)
    path = write(tmp_path / "run.parquet", {"t": t, "q1": np.sin(t), "tau1": np.cos(t)})
    column = Column("t")
    layout = Layout(column, None, (Column("q1"),), (Column("tau1"),))
    rows = list(RestartingSource(open_source(path, None)).times(layout))
    assert {int(label) for block in rows for label in block.segment} == {0, 1}


def test_joints_are_found_where_the_words_that_all_names_begin_with_are_others() -> None:
    """A vendor's arm0.sh0 is the description's arm_sh0."""
    ends = ["sh0", "sh1", "el0", "el1", "wr0", "wr1"]
    given = log("ur5", 1, duration=8.0)
    robot = replace(
        given.robot, joints=tuple(replace(j, name=f"arm_{e}") for j, e in zip(given.robot.joints, ends, strict=True))
    )
    order = [5, 3, 1, 0, 2, 4]
    columns = {"time": given.t, "state.fl.hx.position": given.t % 1.0}
    columns |= {f"state.arm0.{ends[k]}.position": given.q[:, k] for k in order}
    columns |= {f"state.arm0.{ends[k]}.torque": given.tau[:, k] for k in order}
    proposal = guess(robot, columns)
    assert proposal.questions == ()
    assert [proposal.columns[f"tau{k + 1}"] for k in range(6)] == [f"state.arm0.{end}.torque" for end in ends]


@pytest.mark.parametrize("other", ["imu_angle", "torque"])
def test_what_is_left_of_a_joints_name_is_no_reason_to_prefer_another_devices_columns(other: str) -> None:
    """The roll of an inertial sensor, or of a sensor of forces, is not that of the joint wrist_roll."""
    ends = ["roll", "pitch", "yaw", "surge", "sway", "heave"]
    given = log("ur5", 1, duration=8.0)
    names = [f"wrist_{end}" for end in ends]
    joints = tuple(replace(joint, name=name) for joint, name in zip(given.robot.joints, names, strict=True))
    walk = 0.02 * np.cumsum(np.random.default_rng(1).normal(size=given.q.shape), axis=0)
    columns = {"t": given.t}
    for name, values in (("position", given.q), ("effort", given.tau)):
        columns |= {f"{name}_{k}": values[:, k] for k in range(6)}
    columns |= {f"{other}_{end}": walk[:, k] for k, end in enumerate(ends)}
    proposal = guess(replace(given.robot, joints=joints), columns)
    assert [proposal.columns[f"q{k + 1}"] for k in range(6)] == [f"position_{k}" for k in range(6)]
    assert [proposal.columns[f"tau{k + 1}"] for k in range(6)] == [f"effort_{k}" for k in range(6)]


@pytest.mark.parametrize("answered", [False, True])
def test_columns_that_the_user_states_are_those_that_the_others_are_judged_beside(
    tmp_path: Path, answered: bool
) -> None:
    given = log("ur10", 2, duration=8.0)
    columns: dict[str, np.ndarray] = {"time": given.t}
    columns |= {f"q_{k + 1}": np.rad2deg(given.q[:, k]) for k in range(6)}
    columns |= {f"tau_a_{k + 1}": given.tau[:, k] / 100.0 for k in range(6)}
    columns |= {f"tau_b_{k + 1}": 1000.0 * given.tau[:, k] for k in range(6)}
    stated = {f"tau{k + 1}": f"tau_b_{k + 1}" for k in range(6)} if answered else None
    proposal = inspect_file(write(tmp_path / "a.parquet", columns), given.robot, columns=stated).proposal
    assert proposal is not None
    assert any(question.field == "columns/tau" for question in proposal.questions) is not answered
    if answered:
        assert proposal.columns | (stated or {}) == proposal.columns
        assert proposal.units["tau"] == "mN m"
        assert not any("tau_a" in question.detail for question in proposal.questions)


def test_columns_are_those_that_the_user_states_whatever_others_are_called(tmp_path: Path) -> None:
    """Names such as (a) and q1 are no patterns: findings name them as the file does."""
    given = log("ur10", 2, duration=8.0)
    rng = np.random.default_rng(2)
    columns: dict[str, np.ndarray] = {"time": given.t}
    columns |= {f"q{k + 1}": rng.normal(size=len(given.t)) for k in range(6)}
    columns |= {f"(a){k}.*": given.q[:, k] for k in range(6)}
    columns |= {f"({k}": given.tau[:, k] for k in range(6)}
    columns["(a)2.*"][500:600] = np.nan
    stated = {f"q{k + 1}": f"(a){k}.*" for k in range(6)} | {f"tau{k + 1}": f"({k}" for k in range(6)}
    proposal = inspect_file(write(tmp_path / "a.parquet", columns), given.robot, columns=stated).proposal
    assert proposal is not None
    assert proposal.is_sure
    assert stated.items() <= proposal.columns.items()
    (lost,) = [one.reason for one in proposal.guesses if one.field == "rows/rows_left_out"]
    assert "(a)2.* (100 in rows 501-600)" in lost


@pytest.mark.parametrize(
    ("joint", "moved", "noise"), [(2, True, 0.0), (5, False, 0.01), (5, False, 0.5), (1, False, 0.8)]
)
def test_a_position_that_never_changes_is_the_cause_where_a_standing_joint_does_not_explain_the_torque(
    joint: int, moved: bool, noise: float
) -> None:
    given = log("ur10", 6)
    q, motion = given.q.copy(), fourier_motion(given.robot, 20.0, 100.0, 6)
    q[:, joint] = given.q[0, joint]
    tau = given.tau
    if not moved:
        still = [np.where(np.arange(6) == joint, 0.0, signal) for signal in (motion.dq, motion.ddq)]
        tau = pinocchio_torque(given.robot, q, *still) + 0.01 * given.tau[::-1]
        tau += noise * tau.std(axis=0) * np.random.default_rng(joint).normal(size=tau.shape)
    reasons = " ".join(one.reason for one in guess(given.robot, given.columns(q, tau)).guesses)
    assert ("never changes" in reasons) is moved
    assert not moved or f"q{joint + 1} (elbow_joint) never changes" in reasons


@pytest.mark.parametrize("stated", ["", " [rad]", " [deg]"])
def test_angles_of_motors_that_leave_the_joints_ranges_ask_for_the_gears(stated: str) -> None:
    given = log("ur10", 7)
    angles = given.q * np.array([125.0, -133.3, 101.0, 51.0, -60.0, 50.0])
    angles = np.rad2deg(angles) if "deg" in stated else angles
    columns = {"t": given.t} | {f"joint {k + 1} position (motor side){stated}": angles[:, k] for k in range(6)}
    columns |= {f"tau{k + 1}": given.tau[:, k] for k in range(6)}
    details = [one.detail for one in guess(given.robot, columns).questions]
    assert any("gear ratio" in detail for detail in details), details


@pytest.mark.parametrize("share", [0.15, 0.25])
def test_a_sensor_that_starts_late_leaves_its_column_a_torque(tmp_path: Path, share: float) -> None:
    given = log("ur10", 8)
    tau = given.tau.copy()
    tau[: round(share * len(tau))] = np.nan
    columns = given.columns(tau=tau)
    proposal = inspect_file(write(tmp_path / "a.parquet", columns), given.robot).proposal
    assert proposal is not None
    assert proposal.is_sure
    assert any(one.field == "rows/rows_left_out" for one in proposal.guesses)


@pytest.mark.parametrize("joint", [1, 2])
def test_one_torque_that_is_logged_before_its_gears_is_told_where_gravity_is_most_of_it(joint: int) -> None:
    """The drive's work against friction shows only without the load, which it carries to and fro."""
    given = log("ur10", 9)
    tau = given.tau.copy()
    tau[:, joint] /= 121.0
    (asked,) = guess(given.robot, given.columns(tau=tau)).questions
    assert asked.field == "units/tau"
    assert f"tau{joint + 1} ({given.robot.joint_names[joint]}) 0.008" in asked.detail


def test_rows_that_two_programs_wrote_into_one_file_are_called_that() -> None:
    given = log("ur10", 10)
    columns = {name: np.repeat(values, 2) for name, values in given.columns().items()}
    columns["t"][1::2] += 2e-4
    (asked,) = guess(given.robot, columns).questions
    assert asked.field == "columns/t"
    assert "50\u202f% of the rows repeat the row before" in asked.detail.replace(" %", "\u202f%")
    assert str(asked.remedies[0]) == '"rate": 200'


def test_axes_that_slide_in_micrometres_and_their_forces_are_read() -> None:
    parents = ("base", "x", "y")
    joints = "".join(
        f'<link name="{name}"><inertial><mass value="{mass}"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" '
        f'izz="1"/></inertial></link><joint name="{name}" type="prismatic"><parent link="{parent}"/><child link="'
        f'{name}"/><axis xyz="{axis}"/><limit lower="-0.4" upper="0.4" velocity="1.5" effort="600"/></joint>'
        for name, parent, axis, mass in zip("xyz", parents, ("1 0 0", "0 1 0", "0 0 1"), (22, 11, 5), strict=True)
    )
    given = log_of(robot_from_urdf("gantry", f'<robot name="gantry"><link name="base"/>{joints}</robot>'), 11)
    for unit in ("_um", ""):
        columns = {"time": given.t} | {f"{axis}_pos{unit}": 1e6 * given.q[:, k] for k, axis in enumerate("xyz")}
        columns |= {f"{axis}_force_N": given.tau[:, k] for k, axis in enumerate("xyz")}
        proposal = guess(given.robot, columns)
        assert proposal.questions == ()
        assert [proposal.units[f"q{k}"] for k in (1, 2, 3)] == ["um"] * 3
        assert proposal.columns["tau3"] == "z_force_N"


@pytest.mark.parametrize("seed", [13, 14])
def test_names_of_positions_and_velocities_that_are_exchanged_are_asked_about(seed: int) -> None:
    given = log("ur10", seed)
    rates = fourier_motion(given.robot, 20.0, 100.0, seed).dq
    columns = given.columns(q=rates) | {f"dq{k + 1}": given.q[:, k] for k in range(6)}
    asked = [one for one in guess(given.robot, columns).questions if "exchanged" in one.detail]
    assert len(asked) == 1
    stated = dict(asked[0].remedies[0].value)  # type: ignore[arg-type]
    assert stated == {f"q{k + 1}": f"dq{k + 1}" for k in range(6)}


def test_a_share_of_what_is_rated_is_one() -> None:
    given = log("ur5", 12, duration=12.0)
    columns = {"t": given.t} | {f"J{k + 1} angle[deg]": np.rad2deg(given.q[:, k]) for k in range(6)}
    columns |= {f"J{k + 1} current[% rated]": given.tau[:, k] for k in range(6)}
    (asked,) = guess(given.robot, columns).questions
    assert "are in percent: give the drive gains" in asked.detail


def test_counts_and_shares_of_rated_torques_are_told_by_the_objects_of_the_drives() -> None:
    """CiA 402: first gains are asked for; with them counts that differ by joint are asked with estimates of each."""
    given = log("ur5", 1, duration=12.0)
    gains, counts = (
        np.array([0.15, 0.15, 0.15, 0.028, 0.028, 0.028]),
        np.array([5.3e6, 5.3e6, 5.3e6, 2.8e6, 2.8e6, 2.8e6]),
    )
    columns: dict[str, np.ndarray] = {"t (us)": np.rint(1e6 * given.t)}
    for k in range(6):
        columns[f"Axis {k + 1} 0x6064:00 Position actual value"] = np.rint(given.q[:, k] * counts[k] / (2.0 * np.pi))
        columns[f"Axis {k + 1} 0x6077:00 Torque actual value"] = np.rint(given.tau[:, k] / gains[k])
    asked = {question.field: question for question in guess(given.robot, columns).questions}
    assert "permille" in asked["drives"].detail
    asked = {question.field: question for question in guess(set_drive_gains(given.robot, gains), columns).questions}
    (remedy,) = asked["units/q"].remedies
    for key, unit in remedy.value.items():
        assert float(unit.removeprefix("counts:")) == pytest.approx(counts[int(key[1:]) - 1], rel=0.05)


@pytest.mark.parametrize("from_joint", [3, 4])
def test_torques_of_which_some_are_in_a_smaller_unit_are_asked_about_by_these(from_joint: int) -> None:
    given = log("ur10", 2)
    factors = np.where(np.arange(6) >= from_joint, 1000.0, 1.0)
    proposal = guess(given.robot, given.columns(tau=given.tau * factors))
    (asked,) = [question for question in proposal.questions if question.field == "units/tau"]
    named = [k for k in range(6) if given.robot.joint_names[k] in asked.detail]
    assert named == list(range(from_joint, 6))
    assert proposal.units.get("tau", "N m") == "N m"


def test_currents_about_the_zero_of_a_converter_are_to_be_freed_of_it() -> None:
    given = log("ur5", 1)
    gains = np.array([0.08, 0.08, 0.08, 0.015, 0.015, 0.015])
    columns = given.columns(tau=np.rint(2048.0 + given.tau / gains))
    asked = [question.detail for question in guess(given.robot, columns).questions]
    assert len(asked) == 1
    assert "the zero of a converter: subtract it" in asked[0]
    assert not any("converter" in question.detail for question in guess(given.robot, given.columns()).questions)


@pytest.mark.parametrize(("unit", "rounds"), [(" [N]", True), ("", False)])
def test_forces_that_carry_one_load_are_not_about_the_zero_of_a_converter(unit: str, rounds: bool) -> None:
    """Axes that lift the same load need the same force; a converter counts, and states no newtons."""
    text = '<robot name="lift"><link name="l0"/>'
    for k, mass in enumerate((0.2, 0.2, 20.0)):
        text += (
            f'<link name="l{k + 1}"><inertial><mass value="{mass}"/><inertia ixx=".1" iyy=".1" izz=".1" ixy="0" '
            f'ixz="0" iyz="0"/></inertial></link><joint name="lift{k}" type="prismatic"><parent link="l{k}"/>'
            f'<child link="l{k + 1}"/><axis xyz="0 0 1"/><limit lower="-2" upper="2" effort="2000" velocity="3"/>'
            "</joint>"
        )
    robot = robot_from_urdf("lift", text + "</robot>")
    t = 0.004 * np.arange(4000)
    rates = 2.0 * np.pi * np.array([0.1, 0.17, 0.24])
    q = 0.5 * np.sin(np.outer(t, rates) + np.arange(3))
    force = 20.0 * (9.81 - q @ rates**2)[:, None] + 0.2 * 9.81 * np.array([2.0, 1.0, 0.0])
    force += np.random.default_rng(0).normal(size=force.shape)
    force = np.rint(force) if rounds else force
    columns = {"t": t} | {f"position{k + 1} [m]": q[:, k] for k in range(3)}
    proposal = guess(robot, columns | {f"force{k + 1}{unit}": force[:, k] for k in range(3)})
    assert proposal.columns["tau1"] == f"force1{unit}"
    assert not any("converter" in question.detail for question in proposal.questions)


@pytest.mark.parametrize(
    ("name", "signal", "unit"),
    [
        ("actual torque 6077h [Nm]", "tau", "N m"),
        ("6077h motor torque [%]", "tau", "percent"),
        ("0x6078 (A)", "current", "A"),
        ("6077h_1", "tau", "permille"),
        ("0x6078:00", "current", "permille"),
        ("0x60780", None, None),
        ("16077h5", None, None),
    ],
)
def test_objects_of_drives_are_in_thousandths_where_their_names_state_no_unit(
    name: str, signal: str | None, unit: str | None
) -> None:
    (column,) = read_names([name], {})
    assert (column.signal, column.unit) == (signal, unit)


def test_a_change_in_percent_is_no_percentage() -> None:
    assert [column.unit for column in read_names(["J1 speed [%/s]", "J1 load [% rated]"], {})] == [None, "percent"]


def test_columns_of_more_joints_than_the_robot_has_are_named_by_their_signal() -> None:
    """Two arms with a gripper each in every array, beside actions of the same length."""
    given = log("ur5", 1, duration=8.0)
    both = {kind: np.hstack([values, values[:, :1], values[::-1], values[:, :1]]) for kind, values in
            (("action", given.q + 0.01), ("obs/qpos", given.q), ("obs/effort", given.tau))}  # fmt: skip
    columns = {f"{kind}{k + 1}": values[:, k] for kind, values in both.items() for k in range(14)}
    asked = {question.field: question.detail for question in guess(given.robot, {"t": given.t} | columns).questions}
    assert "obs/qpos1 … obs/qpos14 are 14 columns" in asked["columns/q"]
    assert "obs/effort1 … obs/effort14 are 14 columns" in asked["columns/tau"]


def test_axes_that_are_called_by_single_letters_are_found_and_forces_of_sliding_ones() -> None:
    names = [f"{axis} {what}" for axis in "zabcd" for what in ("position (mm)" if axis == "z" else "position (deg)",)]
    assert [spellings != [] for spellings in list_spellings_by_joint(list("zabcd"))] == [True] * 5
    assert [column.unit for column in read_names(names, {}, list("zabcd"))] == ["mm", *["deg"] * 4]


@pytest.mark.parametrize(("axes", "head"), [("SLURBT", "fb_deg_"), ("SLEURBT", "trq_pct_")])
def test_the_letter_of_a_pendants_axis_is_no_unit_or_time(axes: str, head: str) -> None:
    columns = read_names(["time", *sorted(f"{head}{axis}" for axis in axes)], {})[1:]
    unit, signal = ("deg", None) if "deg" in head else ("percent", "tau")
    assert {(column.unit, column.signal) for column in columns} == {(unit, signal)}


def test_a_unit_may_stand_before_the_joints_number_and_beside_an_index_in_brackets() -> None:
    assert [read_names([name], {})[0].unit for name in ("PositionsRad_1", "pos_deg_2", "pos_1_2")] == [
        "rad",
        "deg",
        None,
    ]
    assert read_names(["Sensors/theta[3]"], {"Sensors/theta[3]": "°"})[0].numbers == (3,)


def test_digits_above_the_line_are_no_numbers_of_joints() -> None:
    assert [name.numbers for name in read_names(["q1", "note²", "x³ 2"], {})] == [(1,), (), (2,)]


def test_words_without_spaces_between_them_are_told_apart() -> None:
    command, actual, torque = read_names(["关节1指令角度(度)", "关节1实际角度(度)", "关节1实际力矩(牛·米)"], {})
    assert (command.signal, command.commanded, actual.signal, actual.measured) == ("q", True, "q", True)
    assert (torque.signal, torque.unit, torque.numbers) == ("tau", "N m", (1,))


@pytest.mark.parametrize(("wrong", "unit"), [(1, "N m"), (6, "mN m")])
def test_one_limit_of_effort_that_is_too_small_rules_no_unit_out(wrong: int, unit: str) -> None:
    """A description may state what one motor gives before its gear; where all are exceeded, the unit is another."""
    given = log("ur10", 1, duration=8.0)
    limits = 1.2 * np.abs(given.tau).max(axis=0)
    limits[:wrong] *= 1e-2 if unit == "N m" else 1e-3
    joints = [
        replace(joint, limits=replace(joint.limits, effort=float(limit)))
        for joint, limit in zip(given.robot.joints, limits, strict=True)
    ]
    robot = replace(given.robot, joints=tuple(joints))
    assert guess_torque_unit(robot, given.tau, None, compute_reach(robot)).unit == unit


@pytest.mark.parametrize("borne_out", [True, False])
def test_masses_decide_between_one_turned_joint_and_two(monkeypatch: pytest.MonkeyPatch, borne_out: bool) -> None:
    """Of two turned joints a third may seem to be turned, and a fit explain hardly less."""
    given = log("ur10", 1)
    signs = np.where(np.isin(np.arange(6), (1, 3)), -1.0, 1.0)
    t, q, tau = given.t, given.q * signs, given.tau * signs
    dq = np.gradient(q, t, axis=0)
    motion = Motion(q, dq, np.gradient(dq, t, axis=0), tau, np.arange(len(t)) * BLOCKS // len(t), t)
    judge, single = HeldOutFit(given.robot), ColumnFault("joint turned", (2,))
    monkeypatch.setattr(UnexplainedTorque, "is_surely_above", lambda *_, **__: False)
    left = judge.measure_unexplained(single.mend(motion))
    pair = _find_turned_pair(single, left, judge, motion, SimpleNamespace(prefers=lambda *_: borne_out))  # type: ignore[arg-type]
    assert (pair is not None and pair[0].joints == (1, 3)) == borne_out


EXTERNAL_AXES = [
    ("feedBack.joints.joints[{}]", "feedBack.externalJoints.joints[0]", "motorTorque.joints[{}]",
     "motorTorque.externalJoints.joints[0]", 0),
    ("$AXIS_ACT.A{}", "$AXIS_ACT.E1", "$TORQUE_AXIS_ACT.A{}", "$TORQUE_AXIS_ACT.E1", 1),
    ("joint_pos_{}", "ext_axis_pos_1", "joint_torque_{}", "ext_axis_torque_1", 1),
    ("pos_j{}", "pos_rail", "torque_j{}", "torque_rail", 1),
    ("pos_j{:02d}", "pos_rail", "torque_j{:02d}", "torque_rail", 1),
]  # fmt: skip
"""Names of positions and torques of joints, and of the axis that carries them; the first number."""


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize(("q", "axis", "tau", "force", "first"), EXTERNAL_AXES)
def test_the_external_axis_of_a_controller_is_the_joint_that_slides(
    seed: int, q: str, axis: str, tau: str, force: str, first: int
) -> None:
    robot = robot_from_urdf("railed", crooked_urdf(5, seed, (0,)))
    given = log_of(robot, seed)
    numbers = range(first, first + 4)
    columns = {"t": given.t, axis: 1e3 * given.q[:, 0], force: given.tau[:, 0]}
    columns |= {q.format(k): np.rad2deg(given.q[:, 1 + j]) for j, k in enumerate(numbers)}
    columns |= {tau.format(k): given.tau[:, 1 + j] for j, k in enumerate(numbers)}
    # A controller has its external axis behind the joints.
    columns = {name: columns[name] for name in sorted(columns, key=lambda name: name in (axis, force))}
    found = guess(robot, columns)
    assert [found.columns[f"q{k}"] for k in range(1, 6)] == [axis, *(q.format(k) for k in numbers)]
    assert [found.columns[f"tau{k}"] for k in range(1, 6)] == [force, *(tau.format(k) for k in numbers)]
    assert found.units["q1"] == "mm"
    assert found.units["q2"] == "deg"


def test_an_external_axis_with_the_name_of_its_joint_is_counted_by_no_number() -> None:
    text = crooked_urdf(5, 3, (0,)).replace('"j0"', '"rail"')
    for k in range(1, 5):
        text = text.replace(f'"j{k}"', f'"j{k - 1}"')
    robot = robot_from_urdf("railed", text)
    given = log_of(robot, 3)
    names = ["rail", *(f"j{k}" for k in range(4))]
    columns = {"t": given.t} | {f"{name}_pos": given.q[:, k] for k, name in enumerate(names)}
    columns |= {f"{name}_torque": given.tau[:, k] for k, name in enumerate(names)}
    found = guess(robot, columns)
    assert [found.columns[f"q{k + 1}"] for k in range(5)] == [f"{name}_pos" for name in names]


@pytest.mark.parametrize(("moves", "name"), [(True, "$AXIS_ACT.E1"), (False, "$AXIS_ACT.E1"), (True, "$OV_ACT")])
def test_an_external_axis_that_moves_and_that_the_robot_lacks_is_told(moves: bool, name: str, tmp_path: Path) -> None:
    given = log(seed=8)
    columns = {"t": given.t} | {f"$AXIS_ACT.A{k + 1}": given.q[:, k] for k in range(6)}
    columns |= {f"$TORQUE_AXIS_ACT.A{k + 1}": given.tau[:, k] for k in range(6)}
    noise = 0.01 * np.random.default_rng(8).normal(size=len(given.t))
    columns[name] = 300.0 + noise + (500.0 * np.sin(0.7 * given.t) if moves else 0.0)
    ours = {f"{ours}{k}": f"{theirs}.A{k}" for k in range(1, 7) for ours, theirs in
            (("q", "$AXIS_ACT"), ("tau", "$TORQUE_AXIS_ACT"))}  # fmt: skip
    found = read(given.robot, tmp_path, columns, columns=ours)
    told = [check.detail for check in found.checks if check.name == "joint_columns" and check.status == "warning"]
    assert len(told) == (moves and "E1" in name)
    assert all("E1 moves by" in detail and "the description has no such joint" in detail for detail in told)


@pytest.mark.parametrize(
    ("joint", "names", "expected"),
    [
        ("A{}", ["E1", "E2"], ["E1", "E2"]),
        ("q{}", ["e1", "e2", "E1"], []),
        ("A{}", ["e1", "e2", "ext_joint_torque_1", "externalJointTorque1"], []),
        ("q{}", ["rail_pos", "linearUnit", "rail_speed", "track_error", "tracking"], ["rail_pos", "linearUnit"]),
    ],
)
def test_errors_and_external_torques_are_no_external_axes(
    joint: str, names: list[str], expected: list[str], tmp_path: Path
) -> None:
    given = log(seed=8)
    columns = {"t": given.t} | {joint.format(k + 1): given.q[:, k] for k in range(6)}
    columns |= {f"tau{k + 1}": given.tau[:, k] for k in range(6)}
    columns |= {name: 300.0 + (k + 1) * np.sin(0.7 * given.t) for k, name in enumerate(names)}
    ours = {f"q{k}": joint.format(k) for k in range(1, 7)} | {f"tau{k}": f"tau{k}" for k in range(1, 7)}
    found = read(given.robot, tmp_path, columns, columns=ours)
    details = [check.detail for check in found.checks if "the description has no such joint" in check.detail]
    assert len(details) == bool(expected)
    assert [name for name in names if any(f"{name} moves by" in detail for detail in details)] == expected


@pytest.mark.filterwarnings("error")
def test_an_external_axis_without_readings_is_no_motion(tmp_path: Path) -> None:
    given = log(seed=8)
    columns = {"t": given.t} | {f"A{k + 1}": given.q[:, k] for k in range(6)} | {"E1": np.full(len(given.t), np.nan)}
    columns |= {f"tau{k + 1}": given.tau[:, k] for k in range(6)}
    ours = {f"q{k}": f"A{k}" for k in range(1, 7)} | {f"tau{k}": f"tau{k}" for k in range(1, 7)}
    found = read(given.robot, tmp_path, columns, columns=ours)
    assert not any("the description has no such joint" in check.detail for check in found.checks)


def test_the_same_positions_and_torques_are_conditioned_and_filtered_once(monkeypatch: pytest.MonkeyPatch) -> None:
    given, counts = log("ur10", 3), {"condition_arrays": 0, "filter_motion": 0}

    def count(name: str) -> None:
        whole = getattr(dynamics_fits, name)

        def counted(*arguments: object) -> object:
            counts[name] += 1
            return whole(*arguments)

        monkeypatch.setattr(dynamics_fits, name, counted)

    for name in counts:
        count(name)
    guess(given.robot, given.columns())
    # Once for the rows that are used, and once as a recording, which all questions about it share.
    assert counts == {"condition_arrays": 2, "filter_motion": 1}


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_parameters_that_must_not_be_negative_are_those_of_nnls(seed: int) -> None:
    rng = np.random.default_rng(seed)
    rows = rng.normal(size=(20, 300, 6))
    rows[:, :, 4] = 1.0
    rows[:, :, 5] += rows[:, :, :4] @ rng.normal(size=4) + rng.normal()
    # A constant of either sign, as two columns that are not negative.
    expected = [nnls(np.column_stack([part[:, :5], -part[:, 4]]), part[:, 5])[0] for part in rows]
    values = _fit(np.swapaxes(rows, 1, 2) @ rows)
    assert values[:, :4] == pytest.approx(np.array(expected)[:, :4], abs=1e-6)
    assert values[:, 4] == pytest.approx(np.array(expected)[:, 4] - np.array(expected)[:, 5], abs=1e-6)


def test_runs_of_rows_with_times_of_their_own_are_no_bursts() -> None:
    """Half a second of rows at 100 Hz, then a third of a second of none: no rate goes for all rows."""
    ends, step = np.arange(49, 1000, 50), 0.01
    times = ends * step + np.arange(len(ends)) * 0.333
    assert find_bursts(ends, times, step) == (0, 0.0)
    # The same rows, delivered together.
    assert find_bursts(ends, times, 4e-4) == (50, pytest.approx(50.0 / 0.833))


@pytest.mark.parametrize("seed", [1, 2])
def test_positions_of_motors_beside_those_of_joints_tell_the_gear_ratios(seed: int) -> None:
    given = log("ur10", seed)
    columns, rng = given.columns(), np.random.default_rng(seed)
    gears = rng.choice([-1.0, 1.0], 6) * rng.uniform(30.0, 160.0, 6)
    links, torques = ({f"{name}_{k + 1}": columns[f"{ours}{k + 1}"] for k in range(6)} for name, ours in (
        ("link_pos", "q"), ("torque", "tau")))  # fmt: skip
    motors = {f"motor_pos_{k + 1}": gear * links[f"link_pos_{k + 1}"] + rng.normal() for k, gear in enumerate(gears)}
    proposal = guess(given.robot, {"t": columns["t"]} | links | motors | torques)
    assert read_ratios(proposal) == pytest.approx(dict(zip(given.robot.joint_names, gears, strict=True)), rel=1e-3)
    assert proposal.columns["q1"] == "link_pos_1"
    # A second encoder of the joints is no motor.
    others = {f"motor_pos_{k + 1}": 1.01 * links[f"link_pos_{k + 1}"] for k in range(6)}
    proposal = guess(given.robot, {"t": columns["t"]} | links | others | torques)
    assert not any(each.field == "drives" for each in proposal.guesses)


def read_ratios(proposal: Proposal) -> dict[str, float]:
    stated = [each.value.split(", ") for each in proposal.guesses if each.field == "drives"]
    return {name: float(ratio) for name, ratio in (one.split(": ") for own in stated for one in own)}


def test_gear_ratios_are_those_of_the_joints_that_tell_them() -> None:
    rng, names = np.random.default_rng(1), ["base", "shoulder", "elbow"]
    q, gears = rng.normal(size=(500, 3)).cumsum(axis=0), np.array([101.0, -80.0, 50.5])
    coupled = q * gears + np.outer(q[:, 0], [0.0, 0.0, 40.0])

    def ratios(links: np.ndarray, motors: np.ndarray) -> list[str]:
        return [each.value for each in describe_gear_ratios(names, [("q", links), ("motor", motors)])]

    assert ratios(q, q * gears) == ["base: 101, shoulder: -80, elbow: 50.5"]
    assert ratios(q, coupled) == ["base: 101, shoulder: -80"]
    # A joint that stands, and one that stands but for noise.
    for noise in (0.0, 1e-5):
        still = np.where(np.arange(3) == 0, 0.3 + noise * rng.normal(size=q.shape), q)
        assert ratios(still, still * gears + 100.0 * noise * rng.normal(size=q.shape)) == ["shoulder: -80, elbow: 50.5"]
    # Degrees without and with gears, counts, and the joint's own side.
    for factor in (np.rad2deg(1.0), np.rad2deg([1.0, -3.0, 6.0]), np.rad2deg(gears), 4096.0 * gears, 1.0):
        assert ratios(q, q * factor) == []
