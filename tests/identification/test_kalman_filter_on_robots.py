"""Identification by the Kalman filter on torque of Pinocchio, beside weighted least squares."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter
from support.oracles import arm, fourier_motion, pinocchio_torque, record

from dynident.effects import EffectChoice, ReferenceParameters
from dynident.errors import DynidentError
from dynident.estimation import EstimationError, build_prior
from dynident.identification import IdentificationChoices, identify
from dynident.identification.equations.reduced_recordings import reduce_to_rows
from dynident.identification.estimators.kalman import TorqueFunction, estimate_noise, run_filter
from dynident.recordings import choose_preprocessing
from dynident.regressors.model_structure import build_model
from dynident.regressors.observation_matrix import RegressorInputs

ROBOT = arm("scara")
NAMES = ("rigid_body", "rotor_inertia", "coulomb", "viscous", "offset")
EFFECTS = tuple(EffectChoice(name) for name in NAMES)
DRIVES = np.random.default_rng(0).uniform(0.5, 5.0, (4, ROBOT.n))
RATE = 200.0
MODEL = build_model(ROBOT, EFFECTS)
TRUTH = MODEL.base.grouping @ np.concatenate([ROBOT.inertias.reshape(-1), DRIVES.ravel()])


def recorded(
    duration: float,
    noise: float = 0.5,
    encoder: float = 2e-5,
    seed: int = 3,
    correlated: float = 0.0,
    rate: float = RATE,
    **more,
):
    """A recording whose torque noise has the size `noise` and is correlated from one sample to the next."""
    m = fourier_motion(ROBOT, duration, rate, seed)
    ia, fc, fv, b = DRIVES
    tau = pinocchio_torque(ROBOT, m.q, m.dq, m.ddq) + ia * m.ddq + fc * np.sign(m.dq) + fv * m.dq + b
    rng = np.random.default_rng(seed)
    shaken = m.q + encoder * rng.normal(size=m.q.shape)
    moved = type(m)(m.t, shaken, m.dq, m.ddq)
    white = np.sqrt(1.0 - correlated**2) * rng.normal(size=(len(tau) + 200, ROBOT.n))
    shaking = lfilter([1.0], [1.0, -correlated], white, axis=0)[200:]
    return record(ROBOT, moved, tau + noise * shaking, **more)


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
            plus = function(state[0], state[1], state[2], values).torque
            state[place][joint] -= 2e-6
            minus = function(state[0], state[1], state[2], values).torque
            np.testing.assert_allclose(slope[:, joint], (plus - minus) / 2e-6, rtol=1e-5, atol=1e-6)


def test_the_filter_predicts_torque_as_well_as_weighted_least_squares(both):
    filtered, least = both
    assert filtered.held_out.relative_total < 1.02 * least.held_out.relative_total
    torque = filtered.estimate.solution.scales
    assert np.abs((filtered.values - TRUTH) * torque).max() < 0.02 * np.abs(TRUTH * torque).max()


def test_the_user_is_told_what_the_filter_began_with_and_how_far_its_own_covariance_is_off(both):
    filtered, _ = both
    assert "used the first 25\u202f% of the data for its initial values, and processed 19." in filtered.warnings[0]
    assert "times those of its own covariance" in filtered.warnings[0]


@pytest.mark.slow
@pytest.mark.parametrize("correlated", [0.0, 0.95], ids=["white", "correlated"])
def test_nineteen_of_twenty_intervals_of_the_filter_hold_the_truth(correlated):
    held, distances = [], []
    for seed in range(10, 22):
        found = identify(ROBOT, [recorded(14.0, 1.0, seed=seed, correlated=correlated, rate=100.0)], [], choices("ekf"))
        low, high = np.array([parameter.interval for parameter in found.parameters]).T
        held.append((low <= TRUTH) & (high >= TRUTH))
        distances.append((found.values - TRUTH) / found.statistics.standard_deviations)
    # 264 intervals, of some 60 independent ones: the share has a standard deviation of three per cent.
    assert 0.88 < np.mean(held) < 1.0
    assert 0.75 < np.sqrt(np.mean(np.square(distances))) < 1.25


def test_without_noise_the_filter_finds_the_true_parameters():
    found = identify(ROBOT, [recorded(20.0, 0.0, 0.0)], [], choices("ekf"))
    torque = found.estimate.solution.scales
    assert np.abs((found.values - TRUTH) * torque).max() < 2e-3 * np.abs(TRUTH * torque).max()
    assert found.fit.relative_total < 2e-3


def test_two_recordings_are_one_after_another():
    found = identify(ROBOT, [recorded(10.0), recorded(10.0, seed=4, name="second")], [], choices("ekf"))
    torque = found.estimate.solution.scales
    assert np.abs((found.values - TRUTH) * torque).max() < 0.03 * np.abs(TRUTH * torque).max()


def test_a_filter_that_begins_with_a_robot_that_cannot_be_and_is_sure_of_it_diverges_with_an_error():
    run = recorded(10.0)
    filters = choose_preprocessing([run])
    data = reduce_to_rows(
        MODEL, choices("ekf").row_options, RegressorInputs([run], filters, ReferenceParameters.massless(ROBOT))
    )
    values = TRUTH.copy()
    values[:4] *= -10.0
    start = build_prior(values, np.diag((1e-6 * np.abs(TRUTH) + 1e-9) ** 2), np.arange(len(TRUTH)), len(TRUTH))
    with pytest.raises(EstimationError, match="diverged") as caught:
        run_filter(TorqueFunction(MODEL), MODEL, data, start, estimate_noise(data, np.full(ROBOT.n, 0.5)))
    assert caught.value.title == "Divergence"


def braked(duration: float):
    """A recording whose fourth joint stands still in its brake, which takes any torque."""
    m = fourier_motion(ROBOT, duration, 100.0, 3)
    q, dq, ddq = m.q.copy(), m.dq.copy(), m.ddq.copy()
    q[:, 3], dq[:, 3], ddq[:, 3] = 0.3, 0.0, 0.0
    ia, fc, fv, b = DRIVES
    tau = pinocchio_torque(ROBOT, q, dq, ddq) + ia * ddq + fc * np.sign(dq) + fv * dq + b
    tau[:, 3] += 40.0 * np.sin(m.t)
    tau += 0.3 * np.random.default_rng(0).normal(size=tau.shape)
    return record(ROBOT, type(m)(m.t, q, dq, ddq), tau, name="braked")


def test_a_joint_that_stands_still_with_its_brake_on_does_not_spoil_the_others():
    found = identify(ROBOT, [recorded(12.0, rate=100.0), braked(12.0)], [], choices("ekf"))
    torque = found.estimate.solution.scales
    assert np.abs((found.values - TRUTH) * torque).max() < 0.03 * np.abs(TRUTH * torque).max()


def test_where_a_quarter_of_the_data_does_not_determine_the_parameters_the_filter_begins_with_more():
    found = identify(ROBOT, [braked(6.0), recorded(14.0, 0.3, rate=100.0)], [], choices("ekf"))
    assert "used the first 50\u202f% of the data" in found.warnings[0]
    torque = found.estimate.solution.scales
    assert np.abs((found.values - TRUTH) * torque).max() < 0.03 * np.abs(TRUTH * torque).max()


def test_an_effect_that_remembers_has_no_place_in_the_filter():
    presliding = EffectChoice("presliding", ROBOT.joint_names[:1], (("d0", 0.01), ("law", 1.0)))
    with pytest.raises(DynidentError, match="presliding depends on more than") as caught:
        identify(ROBOT, [recorded(10.0)], [], choices("ekf", *EFFECTS, presliding))
    assert caught.value.pointer == "/estimator"
