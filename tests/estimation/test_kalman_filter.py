"""The filter on a pendulum, against one written out for it with finite differences."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from dynident.estimation import EstimationError, build_prior
from dynident.estimation.kalman_filter import KalmanFilter, KalmanNoise, TorqueSlopes
from dynident.estimation.qr_decomposition import compute_r_factor

# Inertia, first moment times gravity, viscous friction.
TRUTH = np.array([0.4, 3.0, 0.25])
PERIOD = 0.01


def pendulum(q, dq, ddq, values) -> TorqueSlopes:
    """τ = J q̈ + m g l sin q + f q̇."""
    w = np.array([[ddq[0], np.sin(q[0]), dq[0]]])
    return TorqueSlopes(
        w @ values,
        np.array([[values[1] * np.cos(q[0])]]),
        np.array([[values[2]]]),
        np.array([[values[0]]]),
        w,
    )


def driven(duration: float, torque_noise: float = 0.0, position_noise: float = 0.0, seed: int = 0):
    """Positions and torques of the true pendulum, integrated to 1e-10, that a sum of sines drives."""

    def torque(t):
        return 2.0 * np.sin(2.0 * t) + 1.5 * np.sin(5.3 * t + 1.0) + 0.8 * np.sin(11.0 * t)

    def rates(t, state):
        return [state[1], (torque(t) - TRUTH[1] * np.sin(state[0]) - TRUTH[2] * state[1]) / TRUTH[0]]

    t = np.arange(0.0, duration, PERIOD)
    path = solve_ivp(rates, (0.0, duration), [0.2, 0.0], t_eval=t, rtol=1e-10, atol=1e-12).y
    rng = np.random.default_rng(seed)
    return path[0] + position_noise * rng.normal(size=len(t)), torque(t) + torque_noise * rng.normal(size=len(t))


def started(values, deviation=0.5, position=1e-4, torque=0.05, acceleration=300.0) -> KalmanFilter:
    noise = KalmanNoise(np.array([position]), np.array([torque]), np.array([acceleration]))
    return KalmanFilter(pendulum, PERIOD, noise, np.array(values), np.eye(3) * deviation**2)


def rough_acceleration(q):
    """Second differences over eleven samples of a smoothed position: off by some per cent."""
    smooth = np.convolve(np.pad(q, 10, mode="edge"), np.ones(5) / 5, mode="same")
    return ((smooth[10:] - 2 * smooth[5:-5] + smooth[:-10]) / (5 * PERIOD) ** 2)[5:-5]


def run(one: KalmanFilter, q, tau):
    ddq = rough_acceleration(q)
    one.begin(q[:1], q[1:2], tau[1:2], ddq[1:2])
    return [one.step(q[k : k + 1], tau[k : k + 1], ddq[k : k + 1]) for k in range(2, len(q))]


def test_every_step_is_that_of_a_filter_with_the_parameters_in_its_state_written_out_with_finite_differences():
    q, tau = driven(0.5, 0.05, 1e-4)
    ddq = rough_acceleration(q)
    one = started([0.5, 2.5, 0.4], acceleration=20.0)
    one.begin(q[:1], q[1:2], tau[1:2], ddq[1:2])
    state = np.concatenate([one.motion, one.values])
    r, quotient = 1e-8, 1e-8 / PERIOD
    covariance = np.diag([0, 0, *np.full(3, 0.25)])
    covariance[:2, :2] = [[r, quotient], [quotient, 2 * r / PERIOD**2]]

    def moved(x, a):
        after = x[1] + PERIOD * a
        return np.array([x[0] + PERIOD * after, after, *x[2:]])

    def measured(x, a):
        mean = x[1] + 0.5 * PERIOD * a
        return np.array([x[2] * a + x[3] * np.sin(x[0]) + x[4] * mean, moved(x, a)[0]])

    def slopes(function, x, a):
        whole = np.append(x, a)
        steps = 1e-5 * np.maximum(np.abs(whole), 0.1)
        pairs = [(whole + h * e, whole - h * e, 2 * h) for h, e in zip(steps, np.eye(6), strict=True)]
        return np.column_stack([(function(p[:-1], p[-1]) - function(m[:-1], m[-1])) / h for p, m, h in pairs])

    for k in range(2, len(q)):
        a = ddq[k - 1]
        wide = np.zeros((6, 6))
        wide[:5, :5], wide[5, 5] = covariance, 20.0**2
        h = slopes(measured, state, a)
        gain = wide @ h.T @ np.linalg.inv(h @ wide @ h.T + np.diag([0.05**2, 1e-8]))
        change = gain @ (np.array([tau[k - 1], q[k]]) - measured(state, a))
        wide = wide - gain @ h @ wide
        state, a = state + change[:5], a + change[5]
        f = slopes(moved, state, a)
        state, covariance = moved(state, a), f @ wide @ f.T
        one.step(q[k : k + 1], tau[k : k + 1], ddq[k : k + 1])
        np.testing.assert_allclose(np.concatenate([one.motion, one.values]), state, rtol=1e-6, atol=1e-8)
        np.testing.assert_allclose(one.covariance, covariance[2:, 2:], rtol=1e-4, atol=1e-10)


def test_the_estimate_is_the_least_squares_solution_of_the_equations_that_its_samples_make():
    q, tau = driven(10.0, 0.3, 1e-3)
    start = np.array([0.5, 2.5, 0.4])
    one = started(start, position=1e-3, torque=0.3)
    rows = np.concatenate([sample.rows for sample in run(one, q, tau)])
    known = build_prior(start, np.eye(3) * 0.25, np.arange(3), 3)
    factor = compute_r_factor(np.concatenate([known.rows, rows]))
    np.testing.assert_allclose(np.linalg.solve(factor[:3, :3], factor[:3, 3]), one.values, rtol=1e-9)
    np.testing.assert_allclose(np.linalg.inv(factor[:3, :3].T @ factor[:3, :3]), one.covariance, rtol=1e-7)


def test_without_noise_the_filter_finds_the_true_pendulum():
    q, tau = driven(30.0)
    one = started([0.8, 1.5, 0.6], position=1e-6, torque=1e-3)
    run(one, q, tau)
    np.testing.assert_allclose(one.values, TRUTH, rtol=2e-3)


def test_a_beginning_that_no_body_can_have_does_not_lead_astray():
    q, tau = driven(30.0, 0.05, 1e-5)
    one = started([-0.1, 1.5, -0.2], deviation=1.0, position=1e-5)
    run(one, q, tau)
    np.testing.assert_allclose(one.values, TRUTH, rtol=0.03)


def test_noise_of_the_torque_larger_than_the_torque_does_not_make_inertias_larger():
    found = []
    for seed in range(3):
        q, tau = driven(20.0, 6.0, 1e-5, seed)
        one = started([0.5, 2.5, 0.4], deviation=1.0, position=1e-5, torque=6.0)
        run(one, q, tau)
        found.append((one.values - TRUTH) / np.sqrt(np.diag(one.covariance)))
    # The mean of three has a standard deviation of 0.58.
    assert np.abs(np.mean(found, axis=0)).max() < 1.75


@pytest.mark.slow
def test_with_noise_of_the_size_it_expects_its_deviations_are_the_spread_of_its_estimates():
    estimates, promised, surprises = [], [], []
    for seed in range(12):
        q, tau = driven(10.0, 0.3, 1e-3, seed)
        one = started([0.43, 2.9, 0.28], deviation=0.1, position=1e-3, torque=0.3)
        surprises.append(np.mean([sample.surprise for sample in run(one, q, tau)[100:]]))
        estimates.append(one.values)
        promised.append(np.sqrt(np.diag(one.covariance)))
    normalised = (np.array(estimates) - TRUTH) / np.array(promised)
    assert 0.6 < np.sqrt(np.mean(normalised**2)) < 1.4
    assert np.mean(surprises) == pytest.approx(1.0, abs=0.1)


def test_estimates_are_there_after_every_sample_and_become_surer():
    q, tau = driven(10.0, 0.3, 1e-3)
    ddq = rough_acceleration(q)
    one = started([0.5, 2.5, 0.4], position=1e-3, torque=0.3)
    one.begin(q[:1], q[1:2], tau[1:2], ddq[1:2])
    sizes = []
    for k in range(2, len(q)):
        one.step(q[k : k + 1], tau[k : k + 1], ddq[k : k + 1])
        sizes.append(np.trace(one.covariance))
    assert all(np.diff(sizes) <= 1e-12)
    assert sizes[-1] < 0.05 * sizes[0]


def test_a_new_stretch_keeps_the_parameters_and_forgets_the_motion():
    q, tau = driven(5.0, 0.3, 1e-3)
    one = started([0.5, 2.5, 0.4], position=1e-3, torque=0.3)
    run(one, q, tau)
    values, covariance = one.values.copy(), one.covariance.copy()
    one.begin(np.array([1.0]), np.array([1.005]), np.array([0.0]), np.array([0.0]))
    np.testing.assert_array_equal(one.values, values)
    np.testing.assert_array_equal(one.covariance, covariance)
    np.testing.assert_allclose(one.motion, [1.005, 0.5])


def test_a_torque_that_is_no_number_is_an_error_in_words():
    one = started([0.5, 2.5, 0.4])
    one.begin(np.zeros(1), np.zeros(1), np.array([np.nan]), np.zeros(1))
    with pytest.raises(EstimationError, match="not finite"):
        one.step(np.zeros(1), np.ones(1), np.zeros(1))


def test_a_sample_before_the_beginning_of_a_stretch_is_a_mistake():
    with pytest.raises(ValueError, match="start a segment"):
        started([1.0, 1.0, 1.0]).step(np.zeros(1), np.zeros(1), np.zeros(1))
