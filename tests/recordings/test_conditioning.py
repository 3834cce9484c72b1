"""Recordings are put right before their checks: samples that cannot be, wrapped angles, missing cells; and told of."""

from __future__ import annotations

import re
from itertools import product
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from support.recording_data import write_csv, write_parquet
from support.spoilt_recordings import KINDS, N, arm_signals, corrupt, file_columns

from dynident.identification import identify
from dynident.identification.robot_recording_import import import_for_robot
from dynident.recordings import (
    JointLimits,
    RecordedJoints,
    RecordingError,
    RecordingMetadata,
    import_recording,
)
from dynident.recordings.columns_to_signals import Column, Layout
from dynident.recordings.conditioning import Conditioning, missing_and_held
from dynident.recordings.file_source import RawRows
from dynident.recordings.recording_import import condition_arrays, scan_time
from dynident.recordings.row_storage import load_stored_samples
from dynident.simulation import Sensors, TrueEffect, VirtualRobot
from dynident.testing.trial_arm import build_trial_arm, build_trial_motion

DATA = Path(__file__).parents[3] / "shared" / "data"
JOINTS = RecordedJoints([f"joint{k + 1}" for k in range(N)], [JointLimits()] * N)


def conditioned(t, values, joints=JOINTS):
    q, tau, checks = condition_arrays(t, values[:, : joints.n], values[:, joints.n :], joints)
    return np.column_stack([q, tau]), {check.name: check for check in checks}


def marked(check, shape) -> np.ndarray:
    marks = np.zeros(shape, dtype=bool)
    for source, rows in check.rows.items():
        kind, joint = source.split("_joint")
        marks[np.array(rows) - 1, int(joint) - 1 + (shape[1] // 2 if kind == "tau" else 0)] = True
    return marks


def wrapped(q, border: float):
    return (q - border) % (2 * np.pi) + border


@pytest.mark.parametrize(("rate", "moves"), list(product((60.0, 100.0, 200.0, 1000.0), (False, True))))
@pytest.mark.parametrize(("noise", "count"), [("normal", 1e-5), ("t5", 1e-6), ("laplace", 2e-3)])
def test_nothing_is_called_corrupted_in_a_clean_recording(rate, moves, noise, count):
    for seed in (21, 22):
        t, values = arm_signals(seed, rate, 15.0, point_to_point=moves, noise=noise, count=count)
        right, checks = conditioned(t, values)
        assert checks["corrupted_samples"].status == "ok", checks["corrupted_samples"]
        np.testing.assert_array_equal(right, values)


@pytest.mark.parametrize("seed", [3, 4])
def test_corrupted_positions_that_stand_close_together_hide_no_others(seed):
    """They make the usual step of their 64 rows large, and no others may be measured by it."""
    t, values = arm_signals(seed, 200.0, 20.0)
    rows = np.concatenate([np.arange(1283, 1340, 7), [1150, 1200, 1400, 1500]])
    spoilt = values.copy()
    spoilt[rows, 1] += 0.01 * np.ptp(values[:, 1]) * np.where(np.arange(len(rows)) % 2, 1.0, -1.0)
    found = marked(conditioned(t, spoilt)[1]["corrupted_samples"], values.shape)
    assert sorted(np.flatnonzero(found[:, 1])) == sorted(rows)
    assert found.sum() == len(rows)


@pytest.mark.parametrize(("frequency", "decay"), [(12.5, 0.3), (15.0, 0.2)])
def test_a_joint_that_stands_is_struck_and_rings_has_no_corrupted_samples(frequency, decay):
    t = np.arange(6000) / 100.0
    for seed in range(6):
        rng = np.random.default_rng(seed)
        since = (t - 3.0 - rng.uniform(0.0, 0.3)) % 6.0
        q = np.where(t > 3.5, 2e-3 * np.exp(-since / decay) * np.sin(2.0 * np.pi * frequency * since), 0.0)
        values = np.column_stack([q + 1e-5 * rng.normal(size=len(t)), np.cos(t) + 0.01 * rng.normal(size=len(t))])
        right, checks = conditioned(t, values, RecordedJoints(["joint1"], [JointLimits()]))
        assert checks["corrupted_samples"].status == "ok", checks["corrupted_samples"]
        np.testing.assert_array_equal(right, values)


def test_the_check_says_from_which_size_on_samples_are_found():
    t, values = arm_signals(3, 200.0, 20.0)
    detail = conditioned(t, values)[1]["corrupted_samples"].detail
    sizes = re.findall(r"([\d.]+)\s%\sof the range of a (position|torque) \((\w+)_joint(\d)\)", detail)
    assert [kind for _, kind, _, _ in sizes] == ["position", "torque"]
    for share, _, kind, joint in sizes:
        column = int(joint) - 1 + (N if kind == "tau" else 0)
        size = 0.01 * float(share) * float(np.subtract(*np.quantile(values[:, column], (0.99, 0.01))))
        rows, found = np.arange(100, 3900, 100), []
        for times in (0.4, 4.0):
            spoilt = values.copy()
            spoilt[rows, column] += times * size
            found.append(marked(conditioned(t, spoilt)[1]["corrupted_samples"], values.shape)[rows, column].mean())
        assert found[0] == 0.0
        assert found[1] > 0.8


def test_the_named_size_is_a_share_of_the_range_of_the_whole_file():
    """A recording may begin with a long standstill, and a joint may rest all the time: both have noise alone."""
    _, moving = arm_signals(3, 200.0, 60.0)
    values = np.vstack([np.tile(moving[:1], (60 * 200, 1)), moving])
    values[:, 1] = 0.0
    noise = np.array([1e-5] * N + [0.05] * N)
    values += noise * np.random.default_rng(0).normal(size=values.shape)
    detail = conditioned(np.arange(len(values)) / 200.0, values)[1]["corrupted_samples"].detail
    shares = [float(share) for share in re.findall(r"([\d.]+)\s%\sof the range", detail)]
    assert len(shares) == 2
    assert max(shares) < 30.0


@pytest.mark.sweep
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("longest", [1, 4])
@pytest.mark.parametrize("share", [0.002, 0.02])
def test_corrupted_samples_are_named_and_replaced(kind, longest, share):
    hits = planted_in = invented = 0
    for seed, rate, moves in ((31, 100.0, False), (32, 200.0, True), (33, 1000.0, False)):
        t, values = arm_signals(seed, rate, 15.0, point_to_point=moves)
        spoilt, planted = corrupt(values, seed, share, kind, longest)
        right, checks = conditioned(t, spoilt)
        found = marked(checks["corrupted_samples"], values.shape)
        hits += int((found & planted).sum())
        planted_in += int(planted.sum())
        invented += int((found & ~planted).sum())
        mended = (found & planted)[:, :N]
        assert np.nanmax(np.abs(right - values)[:, :N][mended], initial=0.0) < 2e-3
    assert hits >= 0.95 * planted_in
    assert invented <= 0.02 * planted_in


@pytest.mark.parametrize("moves", [False, True])
def test_many_small_corrupted_samples_do_not_pass_for_noise(moves):
    t, values = arm_signals(41, 200.0, 15.0, point_to_point=moves, level=0.03)
    spoilt, planted = corrupt(values, 41, 0.02, "spike")
    smaller = 10.0 ** np.random.default_rng(41).uniform(-1.5, 0.0, values.shape)
    spoilt = np.where(planted, values + smaller * (spoilt - values), values)
    _, checks = conditioned(t, spoilt)
    found = marked(checks["corrupted_samples"], values.shape)
    wrong = ((spoilt - values) / values.std(axis=0))[:, N:]
    assert np.sqrt(((wrong * ~found[:, N:]) ** 2).sum() / (wrong**2).sum()) < 0.5
    assert not (found & ~planted).any()


def test_corrupted_samples_are_found_beside_stamps_that_come_late():
    rng = np.random.default_rng(5)
    fine, signals = arm_signals(3, 1000.0, 20.0)
    # Every twentieth sample is taken 2 ms late: the signal swings there by what the joint moves.
    rows = np.arange(0, 19_900, 10) + 2 * (rng.random(1990) < 0.05)
    t, values = fine[::10][: len(rows)], signals[rows]
    spoilt, planted = corrupt(values, 5, 0.01, "spike", 1, tuple(range(N)))
    found = marked(conditioned(t, spoilt)[-1]["corrupted_samples"], spoilt.shape)
    assert (found & planted)[:, :N].sum() >= 0.95 * planted.sum()
    assert not (found & ~planted).any()
    assert conditioned(t, values)[-1]["corrupted_samples"].status == "ok"


def test_a_burst_of_five_samples_at_100_hertz_costs_no_rows():
    t, values = arm_signals(3, 100.0)
    spoilt = values.copy()
    spoilt[700:705, 1] = np.nan
    *_, checks = conditioned(t, spoilt)
    assert "rows_left_out" not in checks


def test_one_zero_in_a_thousand_rows_is_told_with_row_time_and_column():
    t, values = arm_signals(5, 200.0)
    values[1234, 2] = 0.0
    right, checks = conditioned(t, values)
    check = checks["corrupted_samples"]
    assert (check.status, check.column, check.row, check.rows) == ("warning", "q_joint3", 1235, {"q_joint3": (1235,)})
    assert check.time == pytest.approx(1234 / 200)
    assert abs(right[1234, 2] - 0.5 * (values[1233, 2] + values[1235, 2])) < 1e-4


def test_how_a_file_comes_in_blocks_changes_nothing():
    t, values = arm_signals(6, 1000.0, 40.0)
    spoilt, _ = corrupt(values, 6, 0.01, "zero", 3)
    spoilt[:, 0] = wrapped(6.0 * spoilt[:, 0], -np.pi)
    whole, _ = conditioned(t, spoilt)
    for size in (777, 16384, 20000):
        right = in_blocks(t, spoilt, size)
        np.testing.assert_array_equal(right, whole)


def in_blocks(t, values, size):
    source = Blocks(t, values, size)
    conditioning = Conditioning(source.layout, JOINTS.known_limits, scan_time(source, source.layout, ()))
    return np.concatenate([rows.values for rows in conditioning.condition(source.rows(source.layout))])


class Blocks:
    """Rows in blocks of one size."""

    def __init__(self, t, values, size):
        self._t, self._values, self._size = t, values, size
        q, tau = (tuple(Column(f"{kind}_{name}") for name in JOINTS.names) for kind in ("q", "tau"))
        self.layout = Layout(Column("t"), None, q, tau)

    def rows(self, layout):
        for first in range(0, len(self._t), self._size):
            part = slice(first, first + self._size)
            yield RawRows(first, self._t[part], np.zeros(len(self._t[part]), dtype=np.int64), self._values[part])

    times = rows


@pytest.mark.parametrize("border", [-np.pi, 0.0])
@pytest.mark.parametrize("rate", [60.0, 250.0, 1000.0])
def test_wrapped_angles_are_made_continuous(border, rate):
    t, values = arm_signals(41, rate, 30.0)
    turning = values.copy()
    turning[:, :N] *= 4.0
    measured = turning.copy()
    measured[:, :N] = wrapped(turning[:, :N], border)
    assert np.abs(np.diff(measured[:, :N], axis=0)).max() > np.pi
    right, checks = conditioned(t, measured)
    off = right[:, :N] - turning[:, :N]
    np.testing.assert_allclose(off - off[0], 0.0, atol=1e-9)
    jumps = {f"q_joint{j + 1}": tuple(np.flatnonzero(np.abs(np.diff(measured[:, j])) > np.pi) + 2) for j in range(N)}
    assert checks["wrapped_angles"].rows == {name: rows for name, rows in jumps.items() if rows}


def test_angles_that_wrap_and_are_corrupted_are_put_right_both():
    t, values = arm_signals(42, 200.0, 30.0)
    turning = values.copy()
    turning[:, :N] *= 4.0
    measured = turning.copy()
    measured[:, :N] = wrapped(turning[:, :N], -np.pi)
    spoilt, planted = corrupt(measured, 42, 0.01, "zero", columns=tuple(range(N)))
    right, checks = conditioned(t, spoilt)
    off = right[:, :N] - turning[:, :N]
    turns = np.round(off / (2 * np.pi))
    assert (turns == turns[0]).all()
    assert np.abs(off - 2 * np.pi * turns)[~planted[:, :N]].max() < 1e-4
    found = marked(checks["corrupted_samples"], planted.shape)
    assert (found & planted).sum() >= 0.95 * planted.sum()


def test_what_goes_beyond_a_turn_without_jumps_stays_as_it_is():
    t, values = arm_signals(43, 200.0, 30.0)
    values[:, :N] *= 6.0
    right, checks = conditioned(t, values)
    assert checks["wrapped_angles"].status == "ok"
    np.testing.assert_array_equal(right, values)


def test_turns_in_a_gap_are_told_by_the_logged_velocity(tmp_path):
    rate, speed = 100.0, 2.4
    t = np.arange(3000) / rate
    kept = (t < 8.0) | (t > 11.9)
    q = speed * t[:, None] + np.array([0.0, 0.3, 0.6])
    dq = np.full_like(q, speed) + 0.5 * np.cos(t)[:, None]
    q = q + 0.5 * np.sin(t)[:, None]
    tau = 3.0 * np.sin(t)[:, None] + np.random.default_rng(1).normal(0, 0.1, q.shape)
    columns = {"t": t[kept]}
    columns |= {f"q{j + 1}": wrapped(q[kept, j], -np.pi) for j in range(3)}
    columns |= {f"dq{j + 1}": dq[kept, j] for j in range(3)} | {f"tau{j + 1}": tau[kept, j] for j in range(3)}
    accept = RecordingMetadata(accept=("torque_sign", "torque_order", "gaps", "position_unit", "torque_delay"))
    recording, _ = import_recording(
        write_parquet(tmp_path / "run.parquet", columns), tmp_path / "out", RecordedJoints(("a", "b", "c")),
        metadata=accept,
    )  # fmt: skip
    stored = load_stored_samples(recording).columns
    off = np.asarray(stored["q_b"]) - np.interp(stored["t"], t, q[:, 1])
    assert len(recording.segments) == 2
    assert np.abs(off - off[0]).max() < 1e-3


def test_limits_tell_which_turn_a_wrapped_angle_is_in():
    t, values = arm_signals(44, 200.0, 30.0)
    values[:, :N] *= np.pi / np.abs(values[:, :N]).max(axis=0) * 0.8
    measured = values.copy()
    measured[:, :N] = wrapped(values[:, :N], 0.0)
    limits = [JointLimits("revolute", (-2.9, 2.9))] * N
    right, _ = conditioned(t, measured, RecordedJoints(JOINTS.names, limits))
    np.testing.assert_allclose(right[:, :N], values[:, :N], atol=1e-9)
    # An angle may pass the border between its first samples.
    first = int(np.argmax(np.diff(np.sign(values[:, 0])) != 0)) - 1
    right, _ = conditioned(t[first:], measured[first:], RecordedJoints(JOINTS.names, limits))
    np.testing.assert_allclose(right[:, :N], values[first:, :N], atol=1e-9)


def test_steps_that_are_left_out_change_nothing(tmp_path):
    t, values = arm_signals(45, 200.0)
    values[700, 1] = 0.0
    path = write_parquet(tmp_path / "run.parquet", file_columns(t, values))
    accept = ("torque_sign", "torque_order", "torque_delay", "position_unit")
    stored = {}
    for skip in ((), ("corrupted_samples",)):
        metadata = RecordingMetadata(accept=accept, skip=skip)
        recording, checks = import_recording(path, tmp_path / "out", JOINTS, metadata=metadata)
        stored[skip] = np.asarray(load_stored_samples(recording).columns["q_joint2"])[700]
        assert ("corrupted_samples" in {check.name for check in checks}) is not bool(skip)
    assert stored["corrupted_samples",] == 0.0
    assert abs(stored[()] - values[699, 1]) < 0.05
    with pytest.raises(RecordingError, match="skip names 'bridging', which is not a step that can be left out"):
        RecordingMetadata(skip=("bridging",))


@pytest.mark.parametrize("suffix", ["csv", "parquet"])
@pytest.mark.parametrize("value", [np.nan, np.inf, 1e200])
def test_cells_without_a_number_are_bridged_and_told(tmp_path, suffix, value):
    t, values = arm_signals(46, 200.0)
    rng = np.random.default_rng(3)
    spoilt = values.copy()
    spoilt[rng.random(values.shape) < 0.02] = value
    write = write_csv if suffix == "csv" else write_parquet
    path = write(tmp_path / f"run.{suffix}", file_columns(t, spoilt))
    metadata = RecordingMetadata(accept=("torque_sign", "torque_order", "torque_delay"))
    recording, checks = import_recording(path, tmp_path / "out", JOINTS, metadata=metadata)
    check = next(check for check in checks if check.name == "missing_values")
    expected = {
        f"{'q' if k < N else 'tau'}{k % N + 1}": tuple(np.flatnonzero(spoilt[:, k] != values[:, k]) + 1)
        for k in range(2 * N)
    }
    assert check.rows == expected
    assert recording.n_samples == len(t)
    assert np.abs(np.asarray(load_stored_samples(recording).columns["q_joint1"]) - values[:, 0]).max() < 1e-3


def test_long_stretches_without_numbers_are_left_out_and_split_the_recording(tmp_path):
    t, values = arm_signals(47, 200.0)
    values[1000:1100, 5] = np.nan
    path = write_parquet(tmp_path / "run.parquet", file_columns(t, values))
    metadata = RecordingMetadata(accept=("torque_sign", "torque_order", "torque_delay"))
    recording, checks = import_recording(path, tmp_path / "out", JOINTS, metadata=metadata)
    check = next(check for check in checks if check.name == "rows_left_out")
    assert (check.status, check.column, check.row) == ("warning", "tau2", 1001)
    assert "100 of 4000 rows are left out" in check.detail
    assert [segment.length for segment in recording.segments] == [1000, 2900]


def test_a_recording_with_most_of_a_signal_missing_is_refused_by_name(tmp_path):
    t, values = arm_signals(48, 200.0)
    values[500:, 6] = np.nan
    path = write_parquet(tmp_path / "run.parquet", file_columns(t, values))
    with pytest.raises(RecordingError, match=r"3500 of 4000 rows are left out.*tau3"):
        import_recording(path, tmp_path / "out", JOINTS)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("rate", [100.0, 500.0])
def test_rows_in_which_the_drives_are_off_are_told_and_not_used(rate):
    t, values = arm_signals(51, rate, 40.0)
    off = slice(round(12 * rate), round(19 * rate))
    values[off, :N] = values[off.start, :N]
    values[off, N:] = 0.0
    right, checks = conditioned(t, values)
    check = checks["idle_drives"]
    assert (check.status, check.row) == ("warning", off.start + 1)
    assert f"{off.stop - off.start} rows" in check.detail
    assert np.isnan(right[off, N:]).all()
    np.testing.assert_array_equal(np.delete(right, off, axis=0), np.delete(values, off, axis=0))
    assert checks["corrupted_samples"].status == "ok"


@pytest.mark.parametrize(
    ("rate", "seconds", "with_position"),
    [(60.0, 3.0, True), (60.0, 3.0, False), (200.0, 1.0, True), (200.0, 1.0, False), (1000.0, 30.0, False)],
)
def test_a_torque_that_is_frozen_while_others_go_on_is_told_and_not_used(rate, seconds, with_position):
    """Longer than a window, too: 30 s at 1 kHz are 30,000 rows."""
    t, values = arm_signals(55, rate, 60.0)
    frozen = slice(round(12 * rate), round((12 + seconds) * rate))
    spoilt = [1, N + 1] if with_position else [N + 1]
    values[frozen, spoilt] = values[frozen.start, spoilt]
    right, checks = conditioned(t, values)
    check = checks["frozen_signals"]
    assert (check.status, check.row) == ("warning", frozen.start + 2)
    assert np.isnan(right[frozen.start + 1 : frozen.stop, N + 1]).all()
    kept = np.delete(np.arange(len(t)), np.arange(frozen.start + 1, frozen.stop))
    np.testing.assert_array_equal(right[kept], values[kept])


@pytest.mark.parametrize("columns", [[1], list(range(2 * N))])
@pytest.mark.parametrize("rate", [100.0, 1000.0])
def test_positions_that_are_frozen_and_jump_then_are_told_and_not_used(rate, columns):
    """An encoder that is lost for a while, and a log that stalls."""
    t, values = arm_signals(57, rate, 40.0)
    frozen = slice(round(12 * rate), round(14.3 * rate))
    values[frozen, columns] = values[frozen.start, columns]
    right, checks = conditioned(t, values)
    check = checks["frozen_signals"]
    assert (check.status, check.row) == ("warning", frozen.start + 2)
    assert np.isnan(right[frozen.start + 1 : frozen.stop, 1]).all()
    kept = np.delete(np.arange(len(t)), np.arange(frozen.start + 1, frozen.stop))
    np.testing.assert_array_equal(right[kept], values[kept])


@pytest.mark.parametrize("columns", [[1], list(range(N))])
@pytest.mark.parametrize(("rate", "rows"), [(100.0, 15), (250.0, 20), (1000.0, 60)])
def test_positions_that_read_0_for_a_moment_are_told_and_not_used(rate, rows, columns):
    """Encoders that are reset: for longer than a corrupted sample, and for less than a bus is lost."""
    t, values = arm_signals(57, rate, 40.0)
    zero = slice(round(12 * rate), round(12 * rate) + rows)
    values[zero, columns] = 0.0
    right, checks = conditioned(t, values)
    check = checks["frozen_signals"]
    assert (check.status, check.row) == ("warning", zero.start + 1)
    # The first of them is not the one before.
    assert "stay exactly the same although the joint moves" in check.detail
    assert np.isnan(right[zero, 1]).all()
    kept = np.delete(np.arange(len(t)), np.arange(zero.start, zero.stop))
    np.testing.assert_array_equal(right[kept], values[kept])


def test_signals_that_are_never_the_same_for_long_are_not_searched_for_jumps(monkeypatch):
    monkeypatch.setattr(missing_and_held.FrozenSignals, "_jumps_away", None)
    t, values = arm_signals(57, 250.0, 40.0)
    assert conditioned(t, values)[1]["frozen_signals"].status == "ok"


def test_a_joint_that_stands_exactly_still_for_a_while_is_not_frozen():
    t, values = arm_signals(58, 200.0, 40.0)
    pause = np.clip(t, None, 15.0) + np.clip(t - 20.0, 0.0, None)
    values[:, 1] = np.interp(pause, t, values[:, 1])
    assert conditioned(t, values)[1]["frozen_signals"].status == "ok"


@pytest.mark.parametrize(
    ("seconds", "columns", "told"),
    [
        ((0, 40), [N + 1], ["tau_joint2 (rows 2 to 32768, t = 32.767 s)"]),
        ((10, 50), [1, N + 1], [f"{name}_joint2 (rows 10002 to 49152, t = 49.151 s)" for name in ("q", "tau")]),
    ],
)
def test_what_showed_too_late_to_be_frozen_is_told_with_the_rows_that_are_used(seconds, columns, told):
    """Rows are decided on in their order: before it moves, a joint stands."""
    t, values = arm_signals(5, 1000.0, 60.0)
    frozen = slice(*(second * 1000 for second in seconds))
    values[frozen, columns] = values[frozen.start, columns]
    right, checks = conditioned(t, values)
    assert f"It showed too late to leave out {', '.join(told)}: exclude these." in checks["frozen_signals"].detail
    first = checks["frozen_signals"].row - 1
    assert np.isnan(right[first : frozen.stop, columns]).all()
    np.testing.assert_array_equal(right[:first], values[:first])


@pytest.mark.parametrize("missing", [1, 300])
def test_a_joint_that_never_moves_and_has_no_number_at_the_end_is_not_frozen(missing):
    t, values = arm_signals(1, 200.0)
    values[:, 2] = 0.5
    values[-missing:, 2] = np.nan
    assert conditioned(t, values)[1]["frozen_signals"].status == "ok"


@pytest.mark.parametrize("toggles", [0.0, 1e-3])
@pytest.mark.parametrize("held", [0.0, 0.5])
def test_joints_that_stand_while_another_moves_keep_their_torque(held, toggles):
    """Behind a brake, or without noise in a simulation; an encoder may toggle between two counts."""
    rate = 200.0
    t, values = arm_signals(4, rate, 60.0)
    signals = np.repeat(values[:1], len(t), axis=0)
    for joint in range(N):
        own = np.arange(len(t)) * N // len(t) == joint
        signals[:, joint] += toggles * (np.random.default_rng(joint).random(len(t)) < 0.5)
        signals[own, joint] = values[own, joint]
        signals[:, N + joint] = held * np.median(values[:, N + joint])
        signals[own, N + joint] = values[own, N + joint]
        first, last = np.flatnonzero(own)[[0, -1]]
        signals[:first, joint] += values[first, joint] - values[0, joint]
        signals[last + 1 :, joint] += values[last, joint] - values[0, joint]
    right, checks = conditioned(t, signals)
    assert checks["frozen_signals"].status == "ok"
    np.testing.assert_array_equal(right, signals)


def test_a_torque_without_gravity_or_noise_is_constant_while_its_joint_moves_evenly():
    t, values = arm_signals(4, 200.0, 60.0)
    speed = np.where(t < 20.0, 0.1 * np.sin(np.pi * t / 5.0), 0.2 * np.clip(2.0 * np.sin(np.pi * t / 10.0), -1.0, 1.0))
    values[:, 2] = np.cumsum(speed) / 200.0
    values[:, N + 2] = 49.0 + 5.0 * np.gradient(speed, t) + 10.0 * speed + 3.0 * np.sign(speed)
    right, checks = conditioned(t, values)
    assert checks["frozen_signals"].status == "ok"
    np.testing.assert_array_equal(right, values)


def test_a_joint_that_rests_at_the_border_of_its_angle_is_not_frozen():
    t, values = arm_signals(1, 200.0, 30.0)
    values[:, 0] = wrapped(-0.4 * (1.0 - np.cos(2.0 * np.pi * np.clip(t - 2.0, 0.0, None) / 15.0)), 0.0)
    right, checks = conditioned(t, values)
    assert checks["frozen_signals"].status == "ok"
    assert not np.isnan(right).any()


def test_torques_that_stand_coarse_torques_and_saturated_ones_are_not_frozen():
    t, values = arm_signals(56, 200.0, 40.0)
    size = np.abs(values[:, N:]).max(axis=0)
    coarse, cut = values.copy(), values.copy()
    coarse[:, N:] = np.round(values[:, N:] / (0.05 * size)) * 0.05 * size
    cut[:, N:] = np.clip(values[:, N:], -0.3 * size, 0.3 * size)
    still = np.concatenate([values[:2000], np.repeat(values[2000:2001], 2000, axis=0), values[2000:-2000]])
    for spoilt in (values, coarse, cut, still):
        assert conditioned(t, spoilt)[1]["frozen_signals"].status == "ok"


def test_torques_that_fade_out_to_nothing_are_those_of_drives_that_are_on():
    t, values = arm_signals(52, 200.0, 40.0)
    fade = np.clip(np.abs(t - 20.0) - 4.0, 0.0, 1.0)
    values[:, N:] *= (3.0 * fade**2 - 2.0 * fade**3)[:, None]
    _, checks = conditioned(t, values)
    assert checks["idle_drives"].status == "ok"


@pytest.mark.parametrize(("rate", "hold"), [(500.0, 10), (200.0, 4), (1000.0, 2)])
def test_samples_that_are_held_are_told_with_their_true_rate_and_interpolated(rate, hold):
    t, values = arm_signals(53, rate, 20.0)
    held = values[np.arange(len(t)) // hold * hold]
    right, checks = conditioned(t, held)
    check = checks["held_samples"]
    assert check.status == "warning"
    assert f"come only about {rate / hold:.3g} times a second" in check.detail
    inner = slice(2 * hold, -3 * hold)
    assert np.abs(right - values)[inner, :N].max() < 0.05 * np.abs(held - values)[inner, :N].max()


@pytest.mark.parametrize(
    ("rate", "hold", "kind"), [(100.0, 10, "torques"), (500.0, 4, "positions"), (200.0, 2, "torques")]
)
def test_one_kind_of_signal_on_a_slower_bus_is_told_and_interpolated(rate, hold, kind):
    t, values = arm_signals(55, rate, 20.0)
    columns, other = (slice(N, None), slice(N)) if kind == "torques" else (slice(N), slice(N, None))
    held = values.copy()
    held[:, columns] = values[np.arange(len(t)) // hold * hold, columns]
    right, checks = conditioned(t, held)
    assert f"all {kind} repeat the row before" in checks["held_samples"].detail
    assert f"come only about {rate / hold:.3g} times a second" in checks["held_samples"].detail
    np.testing.assert_array_equal(right[:, other], values[:, other])
    inner = slice(2 * hold, -3 * hold)
    assert np.abs(right - values)[inner].sum() < 0.8 * np.abs(held - values)[inner].sum()


def test_coarse_torques_are_not_held():
    t, values = arm_signals(56, 500.0, 20.0)
    span = np.ptp(values[:, N:], axis=0)
    values[:, N:] = np.rint(values[:, N:] / span * 20.0) / 20.0 * span
    _, checks = conditioned(t, values)
    assert checks["held_samples"].status == "ok"


@pytest.mark.parametrize(
    ("digit", "speed"), [(2 * np.pi / 4096, 0.2), (2 * np.pi / 4096, 1.0), (1e-3, 0.2), (1e-3, 0.4), (1e-4, 0.02)]
)
@pytest.mark.parametrize("n", [1, N])
def test_coarse_positions_of_one_joint_at_constant_speed_are_not_held(digit, speed, n):
    t = np.arange(8000) / 1000.0
    q = np.zeros((len(t), n))
    q[:, -1] = np.rint(np.abs((speed * t) % 0.8 - 0.4) / digit) * digit
    values = np.column_stack([q, np.random.default_rng(57).normal(size=q.shape)])
    joints = RecordedJoints([f"joint{k + 1}" for k in range(n)], [JointLimits()] * n)
    right, checks = conditioned(t, values, joints)
    assert checks["held_samples"].status == "ok"
    np.testing.assert_array_equal(right[:, :n], q)


def test_a_robot_that_stands_without_noise_holds_nothing():
    t, values = arm_signals(54, 200.0, 20.0, level=0.0)
    # It goes on from where it stopped.
    values = np.concatenate([values[:1500], np.repeat(values[1500:1501], 1000, axis=0), values[1500:-1000]])
    right, checks = conditioned(t, values)
    assert checks["held_samples"].status == "ok"
    np.testing.assert_array_equal(right, values)


def real_files() -> list[Path]:
    return sorted(DATA.glob("*/*.parquet"))


@pytest.mark.real_data
@pytest.mark.skipif(not DATA.is_dir(), reason="the recordings of real robots (../shared/data) are absent")
def test_nothing_is_put_right_in_recordings_of_real_robots():
    for path in real_files():
        table = pq.read_table(path)
        t = np.asarray(table["t"], dtype=np.float64)
        n = sum(name[0] == "q" and name[1:].isdigit() for name in table.column_names)
        effort = next(kind for kind in ("tau", "current", "tau_fric") if f"{kind}1" in table.column_names)
        values = np.column_stack(
            [np.asarray(table[f"{kind}{j + 1}"], dtype=np.float64) for kind in ("q", effort) for j in range(n)]
        )
        joints = RecordedJoints([f"joint{j + 1}" for j in range(n)], [JointLimits()] * n)
        right, checks = conditioned(t, values, joints)
        assert [check for check in checks.values() if check.status != "ok"] == [], path
        np.testing.assert_array_equal(right, values)


@pytest.mark.real_data
@pytest.mark.skipif(not DATA.is_dir(), reason="the recordings of real robots (../shared/data) are absent")
@pytest.mark.parametrize("run", ["run1", "run2", "run3"])
def test_wrapped_files_of_a_real_arm_are_as_good_as_unwrapped_ones(tmp_path, run):
    folder = DATA / "kinova_gen3"
    joints = RecordedJoints([f"joint{k + 1}" for k in range(7)])
    metadata = RecordingMetadata(accept=("torque_sign", "torque_order", "gaps"))
    found = []
    for number, path in enumerate((folder / f"{run}.parquet", folder / "wrapped" / f"{run}.csv")):
        recording, _ = import_recording(path, tmp_path / f"{number}", joints, metadata=metadata)
        found.append(np.column_stack([load_stored_samples(recording).columns[f"q_joint{k + 1}"] for k in range(7)]))
    np.testing.assert_allclose(found[0], found[1], atol=1e-6)


@pytest.fixture(scope="module")
def trial_runs():
    """Two measured runs of the trial arm with friction and noise, as positions and torques (m, 6)."""
    robot = build_trial_arm()
    virtual = VirtualRobot(robot, [TrueEffect("coulomb", name, (("Fc", 1.5),)) for name in robot.joint_names])
    sensors = Sensors(250.0, None, torque_noise=0.0, torque_noise_absolute=(0.05,) * robot.n)
    runs = [virtual.measure(build_trial_motion(robot, k), sensors, run=f"run{k}", seed=k) for k in range(2)]
    return robot, [(run.t, np.column_stack([np.round(run.q, 5), run.tau])) for run in runs]


@pytest.mark.sweep
@pytest.mark.parametrize(
    ("share", "kind", "longest"),
    [(3e-4, "zero", 1), (0.002, "spike", 1), (0.02, "zero", 1), (0.02, "stuck", 3), (0.02, "largest", 5)],
)
def test_a_model_from_corrupted_recordings_is_as_good_as_from_clean_ones(tmp_path, trial_runs, share, kind, longest):
    robot, runs = trial_runs

    def error(spoil: bool) -> float:
        recordings = []
        for k, (t, values) in enumerate(runs):
            content = corrupt(values, 7 + k, share, kind, longest)[0] if spoil else values
            path = write_parquet(tmp_path / f"run{k}.parquet", file_columns(t, content))
            recordings.append(import_for_robot(robot, path, tmp_path / f"{k}.stored", RecordingMetadata(f"run{k}"))[0])
        model = identify(robot, recordings[:1], recordings[1:])
        assert model.held_out is not None
        return model.held_out.relative_total

    assert error(spoil=True) <= 1.2 * error(spoil=False)


@pytest.mark.parametrize("starts", [(0.0, 0.0, 0.0), (100.0, 40.0, 40.5)])
@pytest.mark.parametrize("rate", [50.0, 400.0])
def test_runs_one_behind_the_other_are_told_apart_where_the_time_begins_again(tmp_path, rate, starts):
    runs = [arm_signals(seed, rate, 10.0 + seed) for seed in (1, 2, 3)]
    t = np.concatenate([run[0] + start for run, start in zip(runs, starts, strict=True)])
    values = np.concatenate([run[1] for run in runs])
    path = write_parquet(tmp_path / "run.parquet", file_columns(t, values))
    metadata = RecordingMetadata(accept=("torque_sign", "torque_order", "torque_delay"))
    recording, checks = import_recording(path, tmp_path / "out", JOINTS, metadata=metadata)
    lengths = [len(run[0]) for run in runs]
    assert [segment.length for segment in recording.segments] == lengths
    assert [segment.start_time for segment in recording.segments] == pytest.approx(starts)
    check = next(check for check in checks if check.name == "time_restarts")
    assert check.rows == {"t": (lengths[0] + 1, lengths[0] + lengths[1] + 1)}
    assert len(recording.segment_names) == 3


def test_rows_in_the_wrong_order_are_no_runs(tmp_path):
    t, values = arm_signals(4, 200.0)
    t[[900, 903]] = t[[903, 900]]
    path = write_parquet(tmp_path / "run.parquet", file_columns(t, values))
    with pytest.raises(RecordingError, match="goes back") as caught:
        import_recording(path, tmp_path / "out", JOINTS)
    assert caught.value.row == 902
