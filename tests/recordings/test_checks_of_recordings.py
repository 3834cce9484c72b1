"""A bad file for every check: it is refused or warned of, with the column and the row or time, and nothing stays."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import butter, sosfilt
from support.recording_data import JOINTS, motion, write_parquet

from dynident.errors import Remedy
from dynident.recordings import (
    Check,
    JointLimits,
    RecordedJoints,
    RecordingError,
    RecordingMetadata,
    Revision,
    import_recording,
    phase_shares,
    torque_checks,
)
from dynident.recordings.columns_to_signals import Column, Layout
from dynident.recordings.file_source import RawSample
from dynident.recordings.joint_phases import find_phases
from dynident.recordings.signal_spectra import find_dead_zone

LIMITS = tuple(JointLimits(position=(-3.0, 3.0), velocity=6.0, effort=200.0) for _ in JOINTS)


def given(tmp_path, columns, *, limits=None, against=None, **metadata):
    source, joints = write_parquet(tmp_path / "run.parquet", columns), RecordedJoints(JOINTS, limits=limits)
    return import_recording(
        source, tmp_path / "stored", joints, metadata=RecordingMetadata(**metadata), against=against
    )


def found(tmp_path, columns, name, **how):
    _, checks = given(tmp_path, columns, **how)
    return next(check for check in checks if check.name == name)


def refused(tmp_path, columns, **how) -> RecordingError:
    with pytest.raises(RecordingError) as caught:
        given(tmp_path, columns, **how)
    assert [path.name for path in tmp_path.iterdir()] == ["run.parquet"], "something half-stored stays behind"
    error = caught.value
    assert error.pointer in columns or error.pointer.startswith("/")
    assert error.row is not None or error.time is not None
    return error


def changed(name, change, columns=None):
    columns = columns or motion()
    return columns | {name: change(columns[name].copy())}


def test_a_sound_recording_passes_every_check(tmp_path):
    columns = motion()
    columns |= {f"dq{joint + 1}": columns["dq_true"][:, joint] for joint in range(3)}
    _, checks = given(tmp_path, columns, limits=LIMITS)
    assert {check.name: check.status for check in checks if check.status != "ok"} == {}
    assert len({check.name for check in checks}) == len(checks) >= 13


def test_unsorted_time_is_refused_with_the_row(tmp_path):
    def swap(t):
        t[[700, 701]] = t[[701, 700]]
        return t

    error = refused(tmp_path, changed("t", swap))
    assert (error.pointer, error.row) == ("t", 702)
    assert "segment" in error.detail


def test_repeated_time_with_other_content_is_refused_with_the_row(tmp_path):
    error = refused(tmp_path, changed("t", lambda t: np.floor(t * 20) / 20))
    assert (error.pointer, error.row) == ("t", 2)
    assert "too few digits" in error.detail


def test_few_rows_within_one_tick_of_the_clock_are_left_out(tmp_path):
    def tick(t):
        t[50::100] = t[49::100][: len(t[50::100])]
        return t

    check = found(tmp_path, changed("t", tick), "repeated_time")
    assert (check.status, check.row) == ("warning", 51)
    assert "left out" in check.detail


def test_few_rows_within_one_tick_are_left_out_where_a_joint_mostly_stands(tmp_path):
    columns = changed(
        "q2", lambda q: np.where(np.arange(len(q)) < 0.97 * len(q), q[0], q[0] + 1e-3 * np.arange(len(q)))
    )
    last = len(columns["t"]) - 10
    columns["t"] = columns["t"].copy()
    columns["t"][last] = columns["t"][last - 1]
    assert found(tmp_path, columns, "repeated_time").status == "warning"


def test_a_clock_that_stands_still_for_many_rows_is_refused(tmp_path):
    def stand(t):
        t[700:720] = t[700]
        return t

    error = refused(tmp_path, changed("t", stand))
    assert (error.pointer, error.title) == ("t", "Repeated time")


def test_few_rows_of_another_recording_between_the_others_are_refused(tmp_path):
    columns = changed("t", lambda t: t)
    places = np.sort(np.r_[np.arange(len(columns["t"])), np.arange(700, 710)])
    mixed = {name: values[places] for name, values in columns.items()}
    foreign = np.flatnonzero(np.diff(places) == 0) + 1
    for name in ("q1", "q2", "q3"):
        mixed[name][foreign] = columns[name][1200]
    assert refused(tmp_path, mixed).title == "Repeated time"


def test_time_that_is_no_number_is_refused_with_the_row(tmp_path):
    def spoil(t):
        t[99] = np.nan
        return t

    assert (refused(tmp_path, changed("t", spoil)).pointer, refused(tmp_path, changed("t", spoil)).row) == ("t", 100)


@pytest.mark.parametrize("name", ["q2", "tau3"])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_what_is_no_number_is_told_with_column_row_and_time(tmp_path, name, value):
    def spoil(values):
        values[1234] = value
        return values

    check = found(tmp_path, changed(name, spoil), "missing_values")
    assert (check.status, check.column, check.row) == ("warning", name, 1235)
    assert check.time == pytest.approx(1234 / 200)


@pytest.mark.parametrize("value", [1e200, -1e31])
def test_what_no_sensor_gives_is_refused_where_most_of_a_signal_is_it(tmp_path, value):
    def spoil(values):
        values[400:] = value
        return values

    error = refused(tmp_path, changed("tau2", spoil))
    assert (error.pointer, error.row) == ("tau2", 401)
    assert "2600 of 3000 rows are left out" in error.detail


@pytest.mark.parametrize(("unit", "factor"), [("ms", 1e3), ("us", 1e6), ("ns", 1e9)])
def test_time_in_a_smaller_unit_is_refused_with_the_unit_that_it_seems_to_have(tmp_path, unit, factor):
    error = refused(tmp_path, changed("t", lambda t: factor * t))
    assert error.pointer == "t"
    assert f'"units": {{"t": "{unit}"}}' in error.detail


def test_jitter_is_reported_with_its_worst_row(tmp_path):
    def shake(t):
        t = t + np.random.default_rng(0).uniform(-1e-3, 1e-3, len(t))
        t[800] += 2e-3
        return t

    check = found(tmp_path, changed("t", shake), "sampling_jitter")
    assert (check.status, check.column) == ("warning", "t")
    assert check.row in (801, 802)


def test_time_without_any_rate_is_refused(tmp_path):
    rng = np.random.default_rng(1)
    error = refused(tmp_path, changed("t", lambda t: np.cumsum(rng.exponential(0.005, len(t)))))
    assert error.title == "Sampling jitter"


def test_more_missing_than_measured_is_refused(tmp_path):
    error = refused(tmp_path, changed("t", lambda t: t + 2.0 * np.floor(np.arange(len(t)) / 300)))
    assert (error.title, error.row) == ("Gaps", 300)


def test_standstill_is_told_joint_by_joint_and_asks_for_no_windows(tmp_path):
    columns = {name: values for name, values in motion().items() if values.ndim == 1}
    still = {name: np.concatenate([np.full(600, v[0]), v, np.full(400, v[-1])]) for name, v in columns.items()}
    still["q2"][1000:2000] = still["q2"][1000]
    still["q2"][2000:] += still["q2"][1000] - columns["q2"][1400]
    still["t"] = np.arange(4000) / 200
    check = found(tmp_path, still, "standstill")
    assert check.status == "ok"
    told = dict(re.findall(r"(\w+) (\d+)\s%", check.detail))
    assert abs(float(told["shoulder"]) - 25) <= 2
    assert abs(float(told["elbow"]) - 50) <= 2
    assert "windows" not in check.detail.replace("No windows are needed", "")
    inside = found(tmp_path, still, "standstill", windows=((3.0, 18.0),))
    assert "elbow" in inside.detail
    assert "shoulder" not in inside.detail


def test_the_shares_of_a_joints_time_are_those_of_its_positions(tmp_path):
    columns = motion()
    columns["q3"] = np.full(3000, 0.2)
    recording, _ = given(tmp_path, columns, role="validation")
    shares = phase_shares(recording)
    assert shares.standing[2] == 1.0
    assert shares.reversing[2] == 0.0
    assert shares.standing[0] < 0.01
    assert 0.0 < shares.reversing[0] < 0.05


def test_a_recording_in_which_nothing_moves_is_refused(tmp_path):
    columns = motion()
    rng = np.random.default_rng(2)
    columns |= {f"q{j}": 0.5 + 1e-5 * rng.normal(size=3000) for j in (1, 2, 3)}
    assert refused(tmp_path, columns).title == "Standstill"


def test_a_joint_that_never_moved_is_named_and_the_recording_taken(tmp_path):
    columns = changed("q2", lambda q: np.full_like(q, 0.7))
    check = found(tmp_path, columns, "joint_motion")
    assert (check.status, check.column, check.row) == ("warning", "q2", 1)
    assert "elbow never moved" in check.detail
    assert found(tmp_path, columns, "joint_motion", role="validation").status == "warning"
    assert found(tmp_path, columns, "joint_motion", role="friction").status == "ok"


def test_what_the_user_accepts_is_a_warning(tmp_path):
    columns = changed("tau2", lambda tau: np.full_like(tau, 0.7))
    assert refused(tmp_path, columns).title == "Constant torque"
    check = found(tmp_path, columns, "constant_torque", accept=("constant_torque",))
    assert check.status == "warning"
    assert "Accepted" in check.detail
    assert check.is_accepted


@pytest.mark.parametrize("limits", [None, LIMITS])
def test_degrees_taken_for_radians_are_refused(tmp_path, limits):
    columns = motion()
    columns |= {f"q{j}": np.degrees(columns[f"q{j}"]) for j in (1, 2, 3)}
    error = refused(tmp_path, columns, limits=limits)
    assert error.title == "Position unit"
    assert error.pointer.startswith("q")
    assert '"units": {"q": "deg"}' in error.detail
    assert found(tmp_path, columns, "position_unit", limits=limits, units={"q": "deg"}).status == "ok"


def test_a_joint_without_limits_turns_as_often_as_it_likes_at_a_speed_it_can_reach(tmp_path):
    columns = changed("q1", lambda q: q + 5.0 * motion()["t"])

    def turns(velocity):
        return tuple(JointLimits(velocity=velocity) for _ in JOINTS)

    assert np.ptp(columns["q1"]) > 12.0 * np.pi
    assert refused(tmp_path, columns, limits=turns(1.0)).title == "Position unit"
    # Nothing but an impossible speed tells: otherwise a warning, which corrects nothing.
    for velocity in (None, 9.0):
        check = found(tmp_path, columns, "position_unit", limits=turns(velocity))
        assert (check.status, check.column, check.apply) == ("warning", "q1", None)


def test_positions_beyond_the_limits_are_a_warning(tmp_path):
    check = found(tmp_path, changed("q1", lambda q: q + 3.2), "position_unit", limits=LIMITS)
    assert (check.status, check.column) == ("warning", "q1")


@pytest.mark.parametrize(
    ("factor", "status", "words"),
    [
        (180 / np.pi, "error", "deg/s"),
        (30 / np.pi, "error", "rpm"),
        (101.0, "warning", "motor"),
        (-1.0, "warning", "sign"),
    ],
)
def test_velocity_that_is_not_the_derivative_of_position_is_told_by_its_factor(tmp_path, factor, status, words):
    columns = motion()
    columns |= {f"dq{joint + 1}": factor * columns["dq_true"][:, joint] for joint in range(3)}
    if status == "error":
        error = refused(tmp_path, columns)
        assert error.pointer == "dq1"
        assert words in error.detail
    else:
        check = found(tmp_path, columns, "velocity_unit")
        assert (check.status, check.column) == (status, "dq1")
        assert words in check.detail


def test_velocities_of_all_joints_that_are_off_alike_tell_of_a_wrong_clock(tmp_path):
    columns = motion()
    rate = 1.0 / (columns["t"][1] - columns["t"][0])
    columns |= {f"dq{joint + 1}": columns["dq_true"][:, joint] for joint in range(3)}
    columns["t"] = 0.8 * columns["t"]
    check = found(tmp_path, columns, "clock_rate")
    assert (check.status, check.remedies[0].value) == ("warning", pytest.approx(rate, rel=1e-3))
    # Those of single joints have other causes, and a filter takes a little of all.
    columns |= {"t": columns["t"] / 0.8, "dq1": 0.8 * columns["dq1"]}
    assert "clock_rate" not in {check.name for check in given(tmp_path, columns)[1]}


@pytest.mark.parametrize("factor", [0.6, 1.6])
def test_a_clock_that_is_far_off_is_no_unit_of_velocities(tmp_path, factor):
    columns = motion()
    columns |= {f"dq{joint + 1}": columns["dq_true"][:, joint] for joint in range(3)}
    columns["t"] = factor * columns["t"]
    names = {check.name: check.status for check in given(tmp_path, columns)[1]}
    assert (names["clock_rate"], "velocity_unit" in names) == ("warning", False)


@pytest.mark.parametrize(("rate", "cutoff"), [(10.0, None), (200.0, 2.5), (200.0, 2.0)])
def test_velocities_of_one_frequency_are_no_wrong_clock(tmp_path, rate, cutoff):
    """Neither few rows of a period, nor a first-order filter: both take the same of every joint."""
    t = np.arange(0.0, 30.0, 1.0 / rate)
    phases = 2.0 * np.pi * t[:, None] + np.array([0.0, 1.0, 2.0])
    q, dq = np.sin(phases), 2.0 * np.pi * np.cos(phases)
    tau = dq - 20.0 * q
    if cutoff is not None:
        dq = sosfilt(butter(1, cutoff, fs=rate, output="sos"), dq, axis=0)
    columns = {"t": t}
    for joint in range(3):
        columns |= {f"q{joint + 1}": q[:, joint], f"dq{joint + 1}": dq[:, joint], f"tau{joint + 1}": tau[:, joint]}
    assert "clock_rate" not in {check.name for check in given(tmp_path, columns)[1]}


@pytest.mark.parametrize(("step", "status"), [(3e-3, "warning"), (3e-2, "error")])
def test_coarse_steps_of_position_are_named(tmp_path, step, status):
    columns = changed("q3", lambda q: step * np.rint(q / step))
    if status == "error":
        error = refused(tmp_path, columns)
        assert (error.title, error.pointer) == ("Quantisation", "q3")
    else:
        check = found(tmp_path, columns, "quantisation")
        assert (check.status, check.column) == ("warning", "q3")
        assert "0.003" in check.detail


def test_fine_steps_of_position_are_no_finding(tmp_path):
    check = found(tmp_path, changed("q3", lambda q: 1e-5 * np.rint(q / 1e-5)), "quantisation")
    assert check.status == "ok"


@pytest.mark.parametrize(("share", "status"), [(0.97, "warning"), (0.55, "error")])
def test_saturated_torque_is_named_with_its_first_row(tmp_path, share, status):
    columns = motion()
    bound = np.quantile(columns["tau2"], share)
    columns["tau2"] = np.minimum(columns["tau2"], bound)
    first = int(np.flatnonzero((columns["tau2"][:-5] == bound) & (columns["tau2"][5:] == bound))[0]) + 1
    if status == "error":
        error = refused(tmp_path, columns)
        assert (error.title, error.pointer) == ("Saturation", "tau2")
        assert abs(error.row - first) < 20
    else:
        check = found(tmp_path, columns, "saturation")
        assert (check.status, check.column) == ("warning", "tau2")
        assert abs(check.row - first) < 20


def test_all_torques_that_saturate_are_named(tmp_path):
    columns = motion()
    for name, share in (("tau1", 0.97), ("tau2", 0.93), ("tau3", 0.9)):
        columns[name] = np.minimum(columns[name], np.quantile(columns[name], share))
    check = found(tmp_path, columns, "saturation")
    assert (check.status, check.column) == ("warning", "tau3")
    assert re.search(r"So do tau2 in 7\.0.%, tau1 in 3\.0.% of the rows\.$", check.detail)


@pytest.mark.parametrize("share", [0.2, 0.5])
def test_a_torque_that_is_zero_below_a_threshold_has_a_dead_zone(tmp_path, share):
    columns = motion()
    tau = columns["tau2"] - np.median(columns["tau2"])
    threshold = np.quantile(np.abs(tau), share)
    # On both sides, and of a torque that is below zero only.
    for values in (tau, np.minimum(tau, 0.0)):
        columns["tau2"] = np.where(np.abs(values) < threshold, 0.0, values)
        check = found(tmp_path, columns, "dead_zone")
        assert (check.status, check.column) == ("warning", "tau2")
        assert f"below {threshold:.2g}"[:-1] in check.detail
        assert found(tmp_path, columns, "saturation").status == "ok"
    recording, _ = given(tmp_path, columns)
    assert recording.torque_ranges[1] == pytest.approx((threshold, -threshold), rel=0.05)
    assert sum(len(rows[1].starts) for rows in find_phases(recording).clipped) > 0.0


def test_a_torque_that_saturates_does_so_beside_a_dead_zone(tmp_path):
    columns = motion()
    tau = columns["tau2"] - np.median(columns["tau2"])
    top = np.quantile(np.abs(tau), 0.85)
    columns["tau2"] = np.where(np.abs(tau) < 0.1 * top, 0.0, np.clip(tau, -top, top))
    assert found(tmp_path, columns, "saturation").column == "tau2"
    recording, _ = given(tmp_path, columns)
    assert recording.torque_ranges[1] == pytest.approx((-top, top))
    # On one side: its end at 0 is that of the dead zone.
    columns["tau2"] = np.minimum(columns["tau2"], 0.0)
    recording, _ = given(tmp_path, columns)
    assert recording.torque_ranges[1] == pytest.approx((-top, np.inf))


def test_a_drive_that_is_switched_has_no_dead_zone(tmp_path):
    columns = motion()
    t, tau = columns["t"], columns["tau2"]
    steps = np.where(t % 2.0 < 0.7, 0.0, np.ptp(tau) * np.sign(np.sin(3.0 * t)) + 0.01 * tau)
    # Steps times a supply or a lever that varies are as many sizes.
    coarse = np.rint(20.0 * (tau - np.median(tau)) / np.ptp(tau))
    varied = coarse * (1.0 - 0.002 * t), coarse * (1.0 + 0.15 * np.sin(0.7 * t))
    for values in (np.where(t % 2.0 < 0.5, 0.0, tau + np.ptp(tau)), steps, np.rint(3.0 * tau / np.ptp(tau)), *varied):
        assert not find_dead_zone(values, columns["q2"])


def test_the_torque_behind_a_brake_is_named_without_the_coordinates_of_the_base():
    t = np.arange(1000) * 0.01
    q, tau = np.cumsum(np.ones((1000, 8)), axis=0), np.zeros((1000, 8))
    tau[:500, 6], q[500:, 6] = 5.0 + np.sin(t[:500]), q[500, 6]
    tau[500:, 7] = 5.0 + np.sin(t[500:])
    every, columns = np.ones(1000, dtype=bool), tuple(Column(f"c{joint}") for joint in range(8))
    sample = RawSample(np.arange(1000), t, q, tau, None, every, every)
    layout = Layout(Column("t"), None, columns, columns, n_base=6)
    remedies = torque_checks._find_brake(6, tau[:, 6] == 0.0, sample, layout)
    assert remedies == (Remedy("windows", ((0.0, 4.99),)), Remedy("columns", {"tau2": "none"}))
    # Rows that are not in the sample split no interval.
    some = t < 10.0
    some[100:300] = False
    part = RawSample(sample.row[some], t[some], q[some], tau[some], None, every[some], every[some])
    assert torque_checks._find_brake(6, tau[some, 6] == 0.0, part, layout) == remedies


@pytest.mark.parametrize("digits", [0.02, 0.005])
def test_the_rounded_top_of_a_smooth_torque_is_no_saturation(tmp_path, digits):
    columns = motion()
    step = digits * np.ptp(columns["tau2"])
    columns["tau2"] = step * np.rint(columns["tau2"] / step)
    assert found(tmp_path, columns, "saturation").status == "ok"


def test_a_fast_torque_without_digits_that_is_cut_off_is_saturated(tmp_path):
    columns = motion()
    # Eight rows a period: its few values lie on no grid.
    columns["tau2"] = np.clip(10.0 * np.sin(2.0 * np.pi * 5.0 * columns["t"]), -8.0, 8.0)
    error = refused(tmp_path, columns)
    assert (error.title, error.pointer) == ("Saturation", "tau2")


def range_of_torque(t, q, tau, effort):
    """The lowest and highest torque of a joint that was measured."""
    layout = Layout(Column("t"), None, (Column("q1"),), (Column("tau1"),))
    every = np.ones(len(t), dtype=bool)
    sample = RawSample(np.arange(len(t)), t, q[:, None], tau[:, None], None, every, every)
    return torque_checks.find_torque_ranges(sample, layout, (JointLimits(effort=effort),), 0.01)


@pytest.mark.parametrize("times", [1.0, 3.0])
def test_a_sensor_at_the_end_of_its_range_flickers(times):
    columns = motion()
    bound, digit = float(np.quantile(columns["tau2"], 0.9)), 2e-4 * float(np.ptp(columns["tau2"]))
    is_cut = columns["tau2"] >= bound
    flicker = digit * np.random.default_rng(3).integers(0, 2, len(is_cut))
    tau = np.where(is_cut, bound - flicker, columns["tau2"])
    ((low, high),) = range_of_torque(columns["t"], columns["q2"], tau, times * bound)
    assert low == -np.inf
    # A drive's limit is known to half a per cent.
    assert bound - (2 * digit if times > 1.0 else 0.006 * bound) < high <= bound - digit


def test_a_torque_that_goes_beyond_its_limit_is_not_saturated_there():
    t = np.arange(4000) * 0.01
    tau = 10.0 * np.sin(0.5 * t) + 1e-3 * np.random.default_rng(1).normal(size=len(t))
    assert range_of_torque(t, tau, tau, 9.9) == ()


def draw_trapezoids(seed, digit, noise):
    """Time, position, and rounded torque of a joint that moves there and back at trapezoidal speeds, with dwells."""
    rng, period = np.random.default_rng(seed), 0.01
    phases = []
    for move in range(12):
        ramp, cruise, dwell = (int(seconds / period) for seconds in rng.uniform(0.15, 0.6, 3))
        acceleration = (-1.0) ** move * rng.choice([2.0, 4.0])
        phases += [acceleration] * ramp + [0.0] * cruise + [-acceleration] * ramp + [0.0] * dwell
    ddq = np.array(phases)
    dq = np.cumsum(ddq) * period
    dq[np.abs(dq) < 1e-9] = 0.0
    q = np.cumsum(dq) * period
    tau = ddq + rng.choice([0.0, 3.0]) * np.cos(q) + np.sign(dq)
    step = digit * np.ptp(tau)
    return period * np.arange(len(q)), q, step * np.rint(tau / step + noise * rng.normal(size=len(q)))


@pytest.mark.parametrize("digit", [1e-3, 5e-3])
@pytest.mark.parametrize("noise", [0.2, 0.5, 1.0, 4.0])
def test_constant_accelerations_with_few_digits_of_torque_are_at_no_range(digit, noise):
    drawn = [draw_trapezoids(seed, digit, noise) for seed in range(20)]
    # A phase without gravity may be as flat as a range: one in twenty.
    assert sum(range_of_torque(t, q, tau, None) != () for t, q, tau in drawn) <= 1


@pytest.mark.parametrize("digit", [0.0, 0.1, 1.0])
def test_a_smooth_peak_at_a_known_limit_is_at_no_range(digit):
    t = np.arange(4000) * 0.01
    tau = 50.0 * np.sin(t)
    tau = digit * np.rint(tau / digit) if digit else tau
    assert range_of_torque(t, np.sin(0.3 * t), tau, 50.0) == ()
    ((low, high),) = range_of_torque(t, np.sin(0.3 * t), np.clip(1.3 * tau, -50.0, 50.0), 50.0)
    assert -50.0 <= low < -49.0
    assert 49.0 < high <= 50.0


@pytest.mark.parametrize("size", [-0.4, 0.05])
def test_a_position_that_is_counted_anew_is_told_with_its_row(tmp_path, size):
    columns = motion()
    columns["q2"][1000:] += size
    check = found(tmp_path, columns, "position_jump")
    assert (check.status, check.column, check.row) == ("warning", "q2", 1001)
    assert f"jumps by {size:.1g}" in check.detail
    assert "or rows were lost there" in check.detail


@pytest.mark.parametrize("row", [300, 1500])
def test_positions_that_are_all_set_anew_are_one_finding(tmp_path, row):
    """A robot that is homed while it is recorded."""
    columns = motion()
    for name, size in (("q1", -0.7), ("q2", 0.3), ("q3", 0.2)):
        columns[name][:row] += size
    check = found(tmp_path, columns, "position_jump")
    assert (check.status, check.row) == ("warning", row + 1)
    assert "q1, q2, q3 jump together" in check.detail
    assert "all were set to zero again, or rows were lost there" in check.detail


def test_lost_rows_and_a_joint_that_stops_at_once_are_no_jump(tmp_path):
    columns = motion()
    lost = {
        name: values[:-20] if name == "t" else np.delete(values, slice(700, 720), axis=0)
        for name, values in columns.items()
    }
    stopped = columns | {"q2": np.where(np.arange(len(columns["t"])) > 1200, columns["q2"][1200], columns["q2"])}
    waited = {name: np.delete(values, slice(700, 720), axis=0) for name, values in columns.items()}
    for folder, made in (("lost", lost), ("waited", waited), ("stopped", stopped)):
        (tmp_path / folder).mkdir()
        _, checks = given(tmp_path / folder, made)
        assert "position_jump" not in {check.name for check in checks}


def test_lost_rows_of_a_joint_that_moves_alone_are_named_as_a_cause(tmp_path):
    columns = motion()
    columns |= {name: 0.01 * columns[name] for name in ("q1", "q3")}
    fastest = int(np.abs(np.diff(columns["q2"])[500:2500]).argmax()) + 500
    rows = slice(fastest - 20, fastest + 20)
    lost = {name: values[:-40] if name == "t" else np.delete(values, rows, axis=0) for name, values in columns.items()}
    assert "or rows were lost there" in found(tmp_path, lost, "position_jump").detail


def test_torque_that_was_not_recorded_is_refused(tmp_path):
    error = refused(tmp_path, changed("tau1", np.zeros_like))
    assert (error.title, error.pointer) == ("Constant torque", "tau1")


@pytest.mark.parametrize("joint", [1, 2, 3])
def test_a_torque_of_the_wrong_sign_is_refused_and_named(tmp_path, joint):
    error = refused(tmp_path, changed(f"tau{joint}", np.negative, motion(9000)))
    assert (error.title, error.pointer) == ("Torque sign", f"tau{joint}")


def test_friction_says_nothing_of_signs_where_a_model_says_that_the_zeros_are_wrong(tmp_path):
    def against(recording, q, tau):
        return (Check("joint_zero", "warning", "the zeros are elsewhere", q[0]),)

    _, checks = given(tmp_path, changed("tau2", np.negative, motion(9000)), against=against)
    assert [check.name for check in checks if check.status != "ok"] == ["joint_zero"]


def test_a_sign_that_a_model_doubts_is_not_made_sure_by_friction(tmp_path):
    def against(recording, q, tau):
        turned = Check("torque_sign", "warning", "possibly turned", tau[1], apply=Revision(signs={"tau2": -1.0}))
        return (Check("torque_order", "ok", "as it is"), turned)

    _, checks = given(tmp_path, changed("tau2", np.negative, motion(9000)), against=against)
    assert [(check.name, check.status) for check in checks if check.status != "ok"] == [("torque_sign", "warning")]


@pytest.mark.parametrize("order", [(2, 1, 3), (1, 3, 2), (3, 2, 1), (2, 3, 1)])
def test_torque_columns_in_another_order_are_refused_and_named(tmp_path, order):
    columns = motion(9000)
    shuffled = columns | {f"tau{ours}": columns[f"tau{theirs}"] for ours, theirs in zip((1, 2, 3), order, strict=True)}
    error = refused(tmp_path, shuffled)
    assert error.title == "Torque order"
    for ours, theirs in zip((1, 2, 3), order, strict=True):
        assert (ours == theirs) or f"tau{ours} shows the friction of {JOINTS[theirs - 1]}" in error.detail


@pytest.mark.parametrize("shift", [-3, 2, 3])
def test_torque_that_is_late_or_early_is_told_in_milliseconds(tmp_path, shift):
    columns = motion(9000)
    columns |= {f"tau{j}": np.roll(columns[f"tau{j}"], shift) for j in (1, 2, 3)}
    check = found(tmp_path, columns, "torque_delay", windows=((0.1, 44.0),))
    assert check.status == "warning"
    first, last = (float(part) for part in check.detail.split(" ms")[0].removeprefix("The torque is ").split(" to "))
    assert abs(first - 5.0 * abs(shift)) < 2.5
    assert abs(last - 5.0 * abs(shift)) < 2.5
    assert ("late" if shift > 0 else "early") in check.detail


def test_torque_that_is_far_too_late_is_refused_with_the_cure(tmp_path):
    columns = motion(9000)
    columns |= {f"tau{j}": np.roll(columns[f"tau{j}"], 20) for j in (1, 2, 3)}
    error = refused(tmp_path, columns, windows=((1.0, 44.0),))
    assert error.title == "Torque delay"
    assert '"torque_delay": 0.099' in error.detail
    mended = found(tmp_path, columns, "torque_delay", windows=((1.0, 44.0),), torque_delay=0.1)
    assert mended.status == "ok"


def test_one_joint_alone_is_not_called_late(tmp_path):
    columns = motion(9000)
    source = write_parquet(tmp_path / "run.parquet", {"t": columns["t"], "q1": columns["q1"], "tau1": columns["tau1"]})
    _, checks = import_recording(source, tmp_path / "stored", RecordedJoints(("only",)))
    assert all(check.status == "ok" for check in checks)


def test_a_short_recording_is_a_warning(tmp_path):
    columns = {name: values[:300] for name, values in motion().items()}
    assert found(tmp_path, columns, "length").status == "warning"


def test_an_error_carries_all_that_was_found(tmp_path):
    columns = motion()
    columns["tau2"] = np.full(3000, 0.7)
    columns["t"] = columns["t"] + np.where(np.arange(3000) > 1000, 1.0, 0.0)
    error = refused(tmp_path, columns)
    assert {"gaps": "warning", "constant_torque": "error"}.items() <= {c.name: c.status for c in error.checks}.items()


def test_checks_of_a_long_recording_take_a_few_seconds_at_most(tmp_path):
    import time

    columns = motion(400_000, rate=1000.0)
    source = write_parquet(tmp_path / "run.parquet", columns)
    start = time.process_time()
    import_recording(source, tmp_path / "stored", RecordedJoints(JOINTS))
    assert time.process_time() - start < 8.0


@pytest.mark.parametrize(("digit", "levels"), [(0.026, 2), (0.004, 3)])
def test_a_joint_that_stands_without_load_does_not_saturate(tmp_path, digit, levels):
    columns = motion()
    steps = np.random.default_rng(levels).integers(0, levels, len(columns["t"]))
    columns |= {"q3": 0.2 + 3e-5 * (steps > 0), "tau3": -0.5 * digit + digit * steps}
    assert found(tmp_path, columns, "saturation").status == "ok"


def test_the_force_of_a_sliding_joint_saturates_in_newtons(tmp_path):
    columns = motion()
    columns["tau2"] = np.minimum(columns["tau2"], np.quantile(columns["tau2"], 0.97))
    for kind, unit in (("prismatic", "N)"), ("revolute", "N m)")):
        limits = tuple(replace(limit, kind=kind) for limit in LIMITS)
        detail = found(tmp_path, columns, "saturation", limits=limits).detail
        assert detail.partition("extreme value (")[2].split(" ", 1)[1].startswith(f"{unit} for")


def test_the_check_of_the_source_of_the_torque_names_a_current_that_gains_are_used_for(tmp_path):
    columns = motion()
    assert found(tmp_path, columns, "torque_source").column == ""
    currents = {name.replace("tau", "current"): values for name, values in columns.items()}
    source, joints = write_parquet(tmp_path / "current.parquet", currents), RecordedJoints(JOINTS, gains=[1.0] * 3)
    _, checks = import_recording(source, tmp_path / "stored", joints)
    assert [check.column for check in checks if check.name == "torque_source"] == ["current1"]


def test_errors_of_a_table_that_was_transposed_say_so(tmp_path):
    columns = motion()
    path = tmp_path / "turned.csv"
    names = ("t", *(f"{kind}{joint}" for kind in ("q", "tau") for joint in (1, 2)))
    path.write_text("\n".join(",".join([name, *(f"{value:.6g}" for value in columns[name])]) for name in names) + "\n")
    with pytest.raises(RecordingError, match=r"tau3.*the table is transposed") as caught:
        import_recording(path, tmp_path / "stored", RecordedJoints(JOINTS))
    assert caught.value.pointer
