"""The filter on a pendulum, against one written out for it with finite differences."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from dynident.estimation import EstimationError
from dynident.estimation.kalman import KalmanFilter, KalmanNoise, TorqueSlopes

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


def started(values, deviation=0.5, position=1e-4, torque=0.05, wander=0.0) -> KalmanFilter:
    noise = KalmanNoise(np.array([position]), np.array([torque]), np.full(3, wander))
    return KalmanFilter(pendulum, PERIOD, noise, np.array(values), np.eye(3) * deviation**2)


def run(one: KalmanFilter, q, tau) -> np.ndarray:
    one.begin(q[:1], q[1:2], tau[1:2])
    return np.array([one.step(q[k : k + 1], tau[k : k + 1]) for k in range(2, len(q))])


def test_every_step_is_that_of_a_filter_written_out_with_finite_differences():
    q, tau = driven(0.5, 0.05, 1e-4)
    one = started([0.5, 2.5, 0.4], wander=0.01)
    one.begin(q[:1], q[1:2], tau[1:2])
    state, covariance = one.state.copy(), one.covariance.copy()

    def moved(x, u):
        resisting, half = x[3] * np.sin(x[0]), 0.5 * x[4]
        after = ((x[2] / PERIOD - half) * x[1] + u - resisting) / (x[2] / PERIOD + half)
        return np.array([x[0] + PERIOD * after, after, *x[2:]])

    for k in range(2, len(q)):
        u = tau[k - 1]
        steps = 1e-5 * np.maximum(np.abs(state), 0.1)
        f = np.column_stack(
            [
                (moved(state + h * e, u) - moved(state - h * e, u)) / (2 * h)
                for h, e in zip(steps, np.eye(5), strict=True)
            ]
        )
        g = (moved(state, u + 1e-4) - moved(state, u - 1e-4)) / 2e-4
        state = moved(state, u)
        wandering = np.diag([0, 0, *np.full(3, 0.01**2 * PERIOD)])
        covariance = f @ covariance @ f.T + 0.05**2 * np.outer(g, g) + wandering
        gain = covariance[:, 0] / (covariance[0, 0] + 1e-8)
        state = state + gain * (q[k] - state[0])
        covariance = covariance - np.outer(gain, covariance[0])
        one.step(q[k : k + 1], tau[k : k + 1])
        np.testing.assert_allclose(one.state, state, rtol=1e-6, atol=1e-8)
        np.testing.assert_allclose(one.covariance, covariance, rtol=1e-4, atol=1e-10)


def test_without_noise_the_filter_finds_the_true_pendulum():
    q, tau = driven(30.0)
    one = started([0.8, 1.5, 0.6], position=1e-6, torque=1e-3)
    run(one, q, tau)
    np.testing.assert_allclose(one.values, TRUTH, rtol=2e-3)


@pytest.mark.slow
def test_with_noise_of_the_size_it_expects_its_deviations_are_the_spread_of_its_estimates():
    estimates, promised, innovations = [], [], []
    for seed in range(8):
        q, tau = driven(10.0, 0.3, 1e-3, seed)
        one = started([0.43, 2.9, 0.28], deviation=0.1, position=1e-3, torque=0.3)
        innovations.append(np.mean(run(one, q, tau)[100:] ** 2))
        estimates.append(one.values)
        promised.append(np.sqrt(np.diag(one.values_covariance)))
    normalised = (np.array(estimates) - TRUTH) / np.array(promised)
    assert 0.5 < np.sqrt(np.mean(normalised**2)) < 1.5
    assert np.mean(innovations) == pytest.approx(1.0, abs=0.1)


def test_estimates_are_there_after_every_sample_and_become_surer():
    q, tau = driven(10.0, 0.3, 1e-3)
    one = started([0.5, 2.5, 0.4], position=1e-3, torque=0.3)
    one.begin(q[:1], q[1:2], tau[1:2])
    sizes = []
    for k in range(2, len(q)):
        one.step(q[k : k + 1], tau[k : k + 1])
        sizes.append(np.trace(one.values_covariance))
    assert all(np.diff(sizes) <= 1e-12)
    assert sizes[-1] < 0.05 * sizes[0]


def test_a_new_stretch_keeps_the_parameters_and_forgets_the_motion():
    q, tau = driven(5.0, 0.3, 1e-3)
    one = started([0.5, 2.5, 0.4], position=1e-3, torque=0.3)
    run(one, q, tau)
    values, covariance = one.values.copy(), one.values_covariance.copy()
    one.begin(np.array([1.0]), np.array([1.005]), np.array([0.0]))
    np.testing.assert_array_equal(one.values, values)
    np.testing.assert_array_equal(one.values_covariance, covariance)
    assert not one.covariance[:2, 2:].any()


def test_a_robot_without_inertia_is_an_error_in_words():
    one = started([0.0, 0.0, 0.0])
    one.begin(np.zeros(1), np.zeros(1), np.zeros(1))
    with pytest.raises(EstimationError, match="singular"):
        one.step(np.zeros(1), np.ones(1))


def test_a_sample_before_the_beginning_of_a_stretch_is_a_mistake():
    with pytest.raises(ValueError, match="begin a stretch"):
        started([1.0, 1.0, 1.0]).step(np.zeros(1), np.zeros(1))
