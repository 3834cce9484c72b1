"""Combinations of choices that share what one of them knows: standing joints, known values, friction of some runs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.oracles import arm, fourier_motion, pinocchio_torque, record

from dynident.effects import EffectChoice
from dynident.errors import DynidentError
from dynident.estimation import FactorAccumulator, build_prior, solve_instrumental, solve_weighted
from dynident.identification import IdentificationChoices, extend, identify
from dynident.identification.estimators.feasible_problem import _list_not_negative
from dynident.identification.identified_models.torque_prediction import predict
from dynident.recordings import Preprocessing
from dynident.regressors.model_structure import build_model

EFFECTS = tuple(EffectChoice(name) for name in ("rigid_body", "rotor_inertia", "coulomb", "viscous"))
BAND = Preprocessing(12.0, 12.0, 4)
STICKING = 2
FC, FV = 1.5, 2.0


def runs():
    """A motion of all joints, and one in which a joint stands still while stiction carries some of its load."""
    robot = arm("ur10")
    made = []
    for number, still in enumerate(((), (STICKING,))):
        motion = fourier_motion(robot, 20.0, 200.0, seed=number)
        q, dq, ddq = motion.q.copy(), motion.dq.copy(), motion.ddq.copy()
        for joint in still:
            q[:, joint], dq[:, joint], ddq[:, joint] = 0.3, 0.0, 0.0
        tau = pinocchio_torque(robot, q, dq, ddq) + FC * np.sign(dq) + FV * dq + 0.5 * ddq
        tau[:, list(still)] += 25.0
        tau = tau + 0.05 * np.random.default_rng(number).normal(size=tau.shape)
        noisy = q + 1e-6 * np.random.default_rng(number + 9).normal(size=q.shape)
        made.append(record(robot, replace(motion, q=noisy, dq=dq, ddq=ddq), tau, f"run {number}"))
    return robot, made


@pytest.mark.parametrize(
    "chosen", [{"model": "dynamic"}, {"model": "filtered"}, {"estimator": "irls"}], ids=lambda item: str(item)
)
def test_a_joint_that_stands_still_spoils_its_friction_in_no_method(chosen):
    robot, recordings = runs()
    found = identify(robot, recordings, [], IdentificationChoices(EFFECTS, preprocessing=BAND, **chosen))
    values = {parameter.name: parameter.value for parameter in found.parameters}
    assert values[f"Fc{STICKING + 1}"] == pytest.approx(FC, abs=0.1)
    assert values[f"Fv{STICKING + 1}"] == pytest.approx(FV, abs=0.1)
    assert not any("have no weight" in warning for warning in found.warnings)


def test_torque_that_depends_on_jerk_is_not_predicted_without_it():
    robot, recordings = runs()
    plain = identify(robot, recordings[:1], [], IdentificationChoices(EFFECTS, preprocessing=BAND))
    late = extend(plain, [EffectChoice("torque_delay")], recordings[:1])
    still = np.zeros((3, 6))
    assert predict(plain.estimate, still, still, still).torque.shape == (3, 6)
    with pytest.raises(DynidentError, match="torque_delay depends on derivatives of the acceleration"):
        predict(late.estimate, still, still, still)


def test_friction_of_some_runs_is_a_difference_and_may_be_negative():
    model = build_model(arm("ur10"), (*EFFECTS, EffectChoice("coulomb", runs=("warm",))))
    held = {(model.columns[k].name, model.columns[k].runs) for k in _list_not_negative(model)}
    assert ("Fc1", ()) in held
    assert ("Fc1", ("warm",)) not in held


def test_instruments_take_what_is_known_into_account_from_the_beginning():
    rng = np.random.default_rng(0)
    w = rng.normal(size=(400, 2))
    w = np.column_stack([w, w[:, 1]])  # the last two columns are one
    y = w @ [1.0, 2.0, 3.0] + 0.01 * rng.normal(size=400)
    accumulator = FactorAccumulator([np.arange(6)], 6, 0.5)
    accumulator.push(np.arange(400) / 50.0, [np.column_stack([w, w, y])])
    both = accumulator.finish()
    known = build_prior(np.array([2.0]), np.full((1, 1), 1e-6), np.array([1]), 3)
    np.testing.assert_allclose(
        solve_instrumental(both, known).solution.values,
        solve_weighted(both.select_columns(np.arange(3)), known).values,
        atol=1e-3,
    )
