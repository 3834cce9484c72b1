"""Identification by the Kalman filter on torque of Pinocchio, beside weighted least squares."""

from __future__ import annotations

import numpy as np
import pytest
from oracles import arm, fourier_motion, pinocchio_torque, record

from dynident.effects import EffectChoice
from dynident.errors import DynidentError
from dynident.estimation import EstimationError
from dynident.estimation.kalman import KalmanNoise
from dynident.identification import IdentificationChoices, identify
from dynident.identification.estimators.kalman import run_filter
from dynident.identification.estimators.torque_function import TorqueFunction
from dynident.regressors.model import build_model

ROBOT = arm("scara")
NAMES = ("rigid_body", "rotor_inertia", "coulomb", "viscous", "offset")
EFFECTS = tuple(EffectChoice(name) for name in NAMES)
DRIVES = np.random.default_rng(0).uniform(0.5, 5.0, (4, ROBOT.n))
RATE = 200.0
MODEL = build_model(ROBOT, EFFECTS)
TRUTH = MODEL.base.grouping @ np.concatenate([ROBOT.inertias.reshape(-1), DRIVES.ravel()])


def recorded(duration: float, noise: float = 0.5, encoder: float = 2e-5, seed: int = 3, **more):
    m = fourier_motion(ROBOT, duration, RATE, seed)
    ia, fc, fv, b = DRIVES
    tau = pinocchio_torque(ROBOT, m.q, m.dq, m.ddq) + ia * m.ddq + fc * np.sign(m.dq) + fv * m.dq + b
    rng = np.random.default_rng(seed)
    shaken = m.q + encoder * rng.normal(size=m.q.shape)
    moved = type(m)(m.t, shaken, m.dq, m.ddq)
    return record(ROBOT, moved, tau + noise * rng.normal(size=tau.shape), **more)


def choices(estimator: str, *effects: EffectChoice, **more) -> IdentificationChoices:
    return IdentificationChoices(effects=effects or EFFECTS, estimator=estimator, **more)


@pytest.fixture(scope="module")
def both():
    runs = [recorded(20.0)], [recorded(8.0, seed=5)]
    return identify(ROBOT, *runs, choices("ekf")), identify(ROBOT, *runs, choices("wls"))


def test_the_slopes_of_the_torque_are_those_of_finite_differences():
    function, rng = TorqueFunction(MODEL), np.random.default_rng(0)
    q, dq, ddq = rng.uniform(0.3, 1.0, (3, ROBOT.n))
    values = rng.normal(size=MODEL.n_parameters)
    found = function(q, dq, ddq, values)
    np.testing.assert_allclose(found.by_parameters @ values, found.torque, rtol=1e-9)
    for place, slope in enumerate((found.by_position, found.by_velocity, found.by_acceleration)):
        for joint in range(ROBOT.n):
            state = [q.copy(), dq.copy(), ddq.copy()]
            state[place][joint] += 1e-6
            plus = function(*state, values).torque
            state[place][joint] -= 2e-6
            minus = function(*state, values).torque
            np.testing.assert_allclose(slope[:, joint], (plus - minus) / 2e-6, rtol=1e-5, atol=1e-6)


def test_the_filter_predicts_torque_nearly_as_well_as_weighted_least_squares(both):
    filtered, least = both
    assert filtered.held_out.relative_total < 1.15 * least.held_out.relative_total
    torque = filtered.solution.scales
    assert np.abs((filtered.values - TRUTH) * torque).max() < 0.02 * np.abs(TRUTH * torque).max()


def test_standard_deviations_are_of_the_right_size_and_the_user_is_told_what_they_rest_on(both):
    filtered, least = both
    distance = (filtered.values - TRUTH) / filtered.statistics.standard_deviations
    assert np.sqrt(np.mean(distance**2)) < 3.0
    ratio = filtered.statistics.standard_deviations / least.statistics.standard_deviations
    assert 0.5 < np.median(ratio) < 4.0
    assert "noises that were tuned" in filtered.warnings[0]


def test_without_noise_the_filter_finds_the_true_parameters():
    found = identify(ROBOT, [recorded(20.0, 0.0, 0.0)], [], choices("ekf"))
    torque = found.solution.scales
    assert np.abs((found.values - TRUTH) * torque).max() < 2e-3 * np.abs(TRUTH * torque).max()
    assert found.fit.relative_total < 2e-3


def test_two_recordings_are_one_after_another():
    found = identify(ROBOT, [recorded(10.0), recorded(10.0, seed=4, name="second")], [], choices("ekf"))
    torque = found.solution.scales
    assert np.abs((found.values - TRUTH) * torque).max() < 0.03 * np.abs(TRUTH * torque).max()


def test_a_filter_that_begins_with_a_robot_that_cannot_be_diverges_with_an_error():
    values = TRUTH.copy()
    values[:4] *= -1.0
    noise = KalmanNoise(np.full(ROBOT.n, 1e-5), np.full(ROBOT.n, 0.5), np.zeros(len(TRUTH)))
    covariance = np.diag((1e-6 * np.abs(TRUTH) + 1e-9) ** 2)
    with pytest.raises(EstimationError, match="diverged") as caught:
        run_filter(TorqueFunction(MODEL), (recorded(10.0),), values, covariance, noise)
    assert caught.value.title == "Divergence"


def test_an_effect_that_remembers_has_no_place_in_the_filter():
    presliding = EffectChoice("presliding", ROBOT.joint_names[:1], (("d0", 0.01), ("law", 1.0)))
    with pytest.raises(DynidentError, match="presliding depends on more than") as caught:
        identify(ROBOT, [recorded(10.0)], [], choices("ekf", *EFFECTS, presliding))
    assert caught.value.pointer == "/estimator"


def test_a_beginning_that_does_not_determine_the_parameters_is_refused():
    m = fourier_motion(ROBOT, 20.0, RATE, 3)
    still = np.minimum(np.maximum(m.t - 8.0, 0.0), 1.0)[:, None]
    q = m.q[0] + still * (m.q - m.q[0])
    tau = np.random.default_rng(0).normal(size=q.shape)
    with pytest.raises(DynidentError, match="first quarter") as caught:
        identify(ROBOT, [record(ROBOT, type(m)(m.t, q, m.dq, m.ddq), tau)], [], choices("ekf"))
    assert caught.value.title == "No initial values"
