"""Measured against predicted torque along a recording."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from support.hidden_effects import BAND, NAMES, NOISE, ROBOT, experiment, motions, recorded
from support.oracles import Motion, fourier_motion, record

import dynident as dy
from dynident.diagnosis import compare
from dynident.diagnosis.comparison.noise_floor import estimate_sensor_noise
from dynident.diagnosis.residuals.failure_map_and_unknown_patterns import build_failure_map, find_unknown_patterns
from dynident.diagnosis.residuals.spectral_peaks import find_angle_lines
from dynident.errors import DynidentError
from dynident.recordings import Preprocessing, low_pass, recording_from_arrays


@pytest.fixture(scope="module")
def run():
    return experiment()


@pytest.fixture(scope="module")
def comparison(run):
    return compare(run.identification, run.validation)


def test_errors_of_a_comparison_are_those_of_the_identification(run, comparison):
    held_out = run.identification.held_out
    np.testing.assert_allclose(comparison.errors.rms, held_out.rms, rtol=1e-8)
    np.testing.assert_allclose(comparison.errors.relative, held_out.relative, rtol=1e-8)
    fit = compare(run.identification, run.training)
    np.testing.assert_allclose(fit.errors.squares, run.identification.fit.squares, rtol=1e-7)


def test_signals_are_those_of_the_motion(run, comparison):
    motion = motions(0)[1]
    for name, expected in (("q", motion.q), ("dq", motion.dq)):
        for j in range(len(NAMES)):
            interpolated = np.interp(comparison.t, motion.t, expected[:, j])
            np.testing.assert_allclose(getattr(comparison, name)[:, j], interpolated, atol=0.02)


def test_the_band_holds_95_percent_of_the_residual(comparison):
    inside = np.abs(comparison.residual) <= comparison.band
    assert 0.92 <= inside.mean() <= 0.98
    assert (comparison.deviation >= 0).all()


def test_the_load_is_the_rigid_body_part_of_the_prediction(run, comparison):
    friction = comparison.predicted - comparison.load
    chi = {p.name: p.value for p in run.identification.parameters}
    moving = np.abs(comparison.dq[:, 3]) > 0.5
    expected = chi["Fc4"] * np.sign(comparison.dq[:, 3]) + chi["Fv4"] * comparison.dq[:, 3] + chi["b4"]
    expected = expected + chi["Ia4"] * comparison.ddq[:, 3] if "Ia4" in chi else expected
    np.testing.assert_allclose(friction[moving, 3], expected[moving], atol=0.15)


def test_the_worst_stretch_is_where_the_torque_was_disturbed(run):
    motion = fourier_motion(ROBOT, 20.0, 200.0, 77)
    disturbed = recorded(
        motion, lambda m, load: 30.0 * ((m.t > 8.1) & (m.t < 8.4))[:, None] * np.eye(6)[2], 5, "contact"
    )
    worst = compare(run.identification, disturbed).worst[0]
    assert worst.joint == NAMES[2]
    assert worst.start <= 8.4
    assert worst.end >= 8.1
    assert worst.ratio > 3
    assert 8.05 <= worst.time <= 8.45
    at = int(np.argmin(np.abs(motion.t - worst.time)))
    np.testing.assert_allclose(worst.pose, motion.q[at], atol=0.02)
    np.testing.assert_allclose(worst.speed, motion.dq[at], atol=0.05)


def test_temperature_is_a_signal_where_it_was_measured(run):
    motion = fourier_motion(ROBOT, 20.0, 200.0, 77)
    warm = 30.0 + motion.t[:, None] * np.arange(6)
    tau = np.zeros((len(motion.t), 6))
    found = compare(run.identification, record(ROBOT, motion, tau, temperature=warm))
    assert found.temperature is not None
    np.testing.assert_allclose(found.temperature[:, 3], 30.0 + 3.0 * found.t, atol=0.01)
    cold = compare(run.identification, record(ROBOT, motion, tau))
    assert cold.temperature is None


def test_a_recording_too_short_to_compare_says_so(run):
    motion = fourier_motion(ROBOT, 20.0, 200.0, 77)
    short = Motion(motion.t[:30], motion.q[:30], motion.dq[:30], motion.ddq[:30])
    with pytest.raises(DynidentError, match="no rows"):
        compare(run.identification, record(ROBOT, short, np.zeros((30, 6))))


def test_segments_are_numbered(run):
    motion = fourier_motion(ROBOT, 20.0, 200.0, 77)
    t = motion.t + np.where(np.arange(4000) >= 2000, 5.0, 0.0)
    two = recording_from_arrays(
        t, motion.q, np.zeros((4000, 6)), joint_names=NAMES, segment=(np.arange(4000) >= 2000).astype(int)
    )
    found = compare(run.identification, two)
    assert set(found.segment) == {0.0, 1.0}
    assert found.t[found.segment == 1].min() > 14.9


def test_the_noise_floor_is_the_sensors_noise_in_the_band(run):
    for preprocessing in (BAND, Preprocessing(10.0, 4.0, 10), Preprocessing(10.0, None, 1)):
        taps = low_pass(200.0, preprocessing.torque_cutoff)
        expected = NOISE * np.sqrt(np.sum(taps**2))
        np.testing.assert_allclose(estimate_sensor_noise([run.training], preprocessing), expected, rtol=0.1)


def test_a_line_over_the_angle_is_found_at_its_number_of_cycles(run):
    motion = fourier_motion(ROBOT, 40.0, 200.0, 78)
    for k in (17.0, 40.0):
        ripple = recorded(motion, lambda m, load, k=k: 1.5 * np.sin(k * m.q[:, 4:5]) * np.eye(6)[4], 6, "ripple")
        lines = find_angle_lines([compare(run.identification, ripple)], ROBOT)
        assert any(joint == 4 and abs(value - k) < 0.5 for joint, value in lines.clear)


@pytest.mark.parametrize("lead", [0.004, 0.005, 0.02, 0.06])
def test_a_line_over_a_stroke_is_found_at_the_lead_of_its_screw(lead):
    arm, rng, t = dy.load_robot("scara"), np.random.default_rng(4), np.arange(4000) / 200.0
    q = np.tile(-0.1 + 0.09 * np.sin(0.7 * t) + 0.01 * np.sin(3.1 * t), (arm.n, 1)).T
    k, quill = 2 * np.pi / lead, arm.joint_names.index("quill")
    residual = rng.normal(0.0, 0.2, q.shape)
    noise = find_angle_lines([SimpleNamespace(q=q, residual=residual, counted_rows=np.ones(q.shape, dtype=bool))], arm)
    residual[:, quill] += 0.5 * np.sin(k * q[:, quill])
    seen = SimpleNamespace(q=q, residual=residual, counted_rows=np.ones(q.shape, dtype=bool))
    lines = [value for joint, value in find_angle_lines([seen], arm).clear if joint == quill]
    # Within a tenth of a wave over the stroke of 0.2 m.
    assert min(abs(value - k) for value in lines) < 0.1 * 2 * np.pi / 0.2
    assert noise.clear == ()


@pytest.mark.parametrize("seed", range(3))
def test_a_line_is_found_where_a_joint_is_nearly_always_near_the_points_that_it_goes_to(seed):
    rng, t = np.random.default_rng(seed), np.arange(8000) / 200.0
    points = np.cumsum(np.concatenate([[0.0], rng.choice([-1.0, 1.0], 20) * rng.uniform(0.3, 0.9, 20)]))
    # Quintic moves of a second, and two at each point, where something else is off by as much.
    number, since = np.divmod(t, 3.0)
    share, k = np.clip(since, 0.0, 1.0), number.astype(int)
    q = points[k] + np.diff(points)[k] * share**3 * (10 - 15 * share + 6 * share**2)
    residual = 0.3 * np.sin(12.0 * q) + 0.3 * rng.normal(size=20)[k] * (since > 1.0) + rng.normal(0.0, 0.05, len(t))
    shape = (len(t), ROBOT.n)
    seen = SimpleNamespace(
        q=np.tile(q[:, None], ROBOT.n),
        residual=np.tile(residual[:, None], ROBOT.n),
        counted_rows=np.ones(shape, dtype=bool),
    )
    clear = find_angle_lines([seen], ROBOT).clear
    assert min(abs(line - 12.0) for joint, line in clear if joint == 4) < 0.3


def test_noise_alone_has_neither_patterns_nor_a_place_where_it_fails(comparison):
    assert find_unknown_patterns([comparison]) == ()
    assert all(spot.ratio < 2 for spot in build_failure_map([comparison]))


@pytest.mark.parametrize(
    ("variable", "law"),
    [
        ("position", lambda m: 3.0 * np.sign(np.sin(3 * m.q[:, 2]))),
        ("velocity", lambda m: 3.0 * np.exp(-(((m.dq[:, 2] - 0.5) / 0.15) ** 2))),
        ("time", lambda m: 2.0 * np.sign(np.sin(2 * np.pi * m.t / 41.0 + 1))),
    ],
)
def test_a_dependence_without_a_name_is_found_with_its_variable(run, variable, law):
    motion = fourier_motion(ROBOT, 40.0, 200.0, 79)
    odd = recorded(motion, lambda m, load: law(m)[:, None] * np.eye(6)[2], 7, "odd")
    patterns = find_unknown_patterns([compare(run.identification, odd)])
    assert patterns
    assert patterns[0].joint == NAMES[2]
    assert patterns[0].variable == variable
    assert patterns[0].share > 0.3
