"""Intervals of predicted torque against Pinocchio's, and dependence of parameters in words."""

from __future__ import annotations

import numpy as np
import pytest
from support.oracles import arm, fourier_motion, pinocchio_torque, record

from dynident.effects import EffectChoice
from dynident.errors import DynidentError
from dynident.identification import IdentificationChoices, identify
from dynident.identification.identified_models.correlated_and_essential_parameters import parameter_dependence
from dynident.identification.identified_models.torque_prediction import predict
from dynident.recordings import Preprocessing

ROBOT = arm("scara")
EFFECTS = tuple(EffectChoice(name) for name in ("rigid_body", "rotor_inertia", "viscous"))
IA, FV = np.array([2.0, 1.0, 0.5, 0.1]), np.array([3.0, 2.0, 5.0, 0.5])
NOISE = np.array([2.0, 1.0, 1.0, 0.3])
OTHER = fourier_motion(ROBOT, 10.0, 50.0, 77)


def torque(motion):
    return pinocchio_torque(ROBOT, motion.q, motion.dq, motion.ddq) + IA * motion.ddq + FV * motion.dq


def identified(seed: int, fastest: float = 0.7):
    motion = fourier_motion(ROBOT, 20.0, 100.0, seed, fastest=fastest)
    noisy = torque(motion) + NOISE * np.random.default_rng(seed).normal(size=motion.q.shape)
    choices = IdentificationChoices(effects=EFFECTS, preprocessing=Preprocessing(None, 10.0, 3))
    return identify(ROBOT, [record(ROBOT, motion, noisy)], [], choices)


def test_the_interval_of_the_mean_holds_the_true_torque_in_about_95_of_100_cases():
    inside = []
    for seed in range(15):
        found = predict(identified(seed).estimate, OTHER.q, OTHER.dq, OTHER.ddq)
        inside.append(np.abs(found.torque - torque(OTHER)) <= found.mean_half_width)
    assert 0.88 <= np.mean(inside) <= 0.99


def test_the_interval_of_a_measurement_adds_the_residual_noise():
    model = identified(1)
    found = predict(model.estimate, OTHER.q, OTHER.dq, OTHER.ddq, level=0.6827)
    np.testing.assert_allclose(
        found.half_width**2 - found.mean_half_width**2, model.noise[None, :] ** 2 + 0 * OTHER.q, rtol=0.02
    )
    assert (predict(model.estimate, OTHER.q, OTHER.dq, OTHER.ddq).half_width > found.half_width).all()


def test_a_faster_motion_than_the_identified_one_is_predicted_less_surely():
    model = identified(1)
    slow, fast = (predict(model.estimate, OTHER.q, k * OTHER.dq, k**2 * OTHER.ddq).mean_half_width for k in (1.0, 3.0))
    assert np.median(fast / slow) > 2.0


@pytest.mark.parametrize(
    ("name", "change"), [("dq", lambda x: x[:-1]), ("ddq", lambda x: x[:, :2]), ("q", lambda x: x * np.nan)]
)
def test_a_motion_that_does_not_fit_is_refused(name, change):
    motion = {"q": OTHER.q, "dq": OTHER.dq, "ddq": OTHER.ddq}
    motion[name] = change(motion[name])
    with pytest.raises(DynidentError) as caught:
        predict(identified(1).estimate, motion["q"], motion["dq"], motion["ddq"])
    assert caught.value.pointer == f"/{name}"


def test_a_level_that_is_no_probability_is_refused():
    with pytest.raises(DynidentError, match="between 0 and 1"):
        predict(identified(1).estimate, OTHER.q, OTHER.dq, OTHER.ddq, level=95)


def test_a_motion_without_acceleration_is_said_to_leave_combinations_undetermined():
    good, poor = parameter_dependence(identified(2)), parameter_dependence(identified(2, fastest=0.02))
    assert len(poor.sentences) > 0
    assert all(len(one.sentences) <= 10 for one in (good, poor))
    assert any("determined" in sentence and "times less" in sentence for sentence in poor.sentences) or any(
        "determined only together" in sentence for sentence in poor.sentences
    )
    (pair,) = good.dependence.pairs
    together = "their difference" if pair.correlation > 0 else "their sum"
    assert f"Each divided by its standard deviation, {together} is known better than either." in good.sentences[-1]
    assert poor.correlation.shape == (len(poor.names), len(poor.names))
    np.testing.assert_allclose(np.diag(poor.correlation), 1.0)


@pytest.mark.parametrize(("decimation", "few"), [(2, False), (20, True)])
def test_fewer_than_500_equations_for_each_parameter_are_pointed_out_with_their_number(decimation, few):
    motion = fourier_motion(ROBOT, 60.0, 100.0, 1)
    noisy = torque(motion) + NOISE * np.random.default_rng(0).normal(size=motion.q.shape)
    choices = IdentificationChoices(effects=EFFECTS, preprocessing=Preprocessing(None, None, decimation))
    found = identify(ROBOT, [record(ROBOT, motion, noisy)], [], choices)
    said = [warning for warning in found.warnings if "equations per parameter" in warning]
    assert (found.equations_per_parameter < 500) == few
    assert len(said) == few
    assert all(f"{found.equations_per_parameter:.0f}" in warning and "500" in warning for warning in said)
