"""Rows where joints turn round count by a noise of their own: friction does not change its sign just when W says."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.oracles import arm, fourier_motion, pinocchio_torque, record

from dynident.diagnosis import DiagnosisChoices, diagnose
from dynident.effects import EffectChoice
from dynident.identification import Identification, IdentificationChoices, extend, identify, reidentify, remove
from dynident.identification.identified_models.model_files import from_bytes, to_bytes
from dynident.recordings import Preprocessing

ROBOT = arm("ur10")
COULOMB, VISCOUS, LATE = 15.0, 4.0, 0.02
PLAIN = tuple(EffectChoice(name) for name in ("rigid_body", "coulomb", "viscous"))
CHOICES = IdentificationChoices(PLAIN, preprocessing=Preprocessing(14.0, 10.0, 5))
ALIKE = replace(CHOICES, weigh_turns=False)


def recorded(seed: int):
    """Friction whose sign comes late, as if it were stretched a little first."""
    motion = fourier_motion(ROBOT, 20.0, 200.0, seed)
    sign = np.sign(np.roll(motion.dq, round(LATE * 200.0), axis=0))
    noise = 0.3 * np.random.default_rng([seed, 1]).normal(size=motion.q.shape)
    tau = pinocchio_torque(ROBOT, motion.q, motion.dq, motion.ddq) + COULOMB * sign + VISCOUS * motion.dq + noise
    return record(ROBOT, motion, tau, f"run{seed}")


RUN, OTHER = recorded(1), recorded(2)


@pytest.fixture(scope="module")
def weighed() -> Identification:
    return identify(ROBOT, [RUN], [OTHER], CHOICES)


@pytest.fixture(scope="module")
def alike() -> Identification:
    return identify(ROBOT, [RUN], [OTHER], ALIKE)


def weights(found: Identification) -> np.ndarray:
    return np.array([equation.weighted_rows.weight for equation in found.data.training.equations])


def test_moving_rows_of_another_run_are_predicted_better_and_friction_is_nearer_to_the_truth(weighed, alike):
    assert weighed.held_out_moving.relative_total < 0.9 * alike.held_out_moving.relative_total

    def off(found: Identification) -> float:
        return float(np.linalg.norm([p.value - COULOMB for p in found.parameters if p.effect == "coulomb"]))

    assert off(weighed) < 0.7 * off(alike)
    assert (weights(weighed) < 0.5).all()
    assert (weights(alike) == 1.0).all()


def test_what_is_told_of_errors_is_of_all_rows_alike(weighed, alike):
    assert weighed.fit.counts.tolist() == alike.fit.counts.tolist()
    assert weighed.fit.measured == pytest.approx(alike.fit.measured)
    assert weighed.condition_number == pytest.approx(alike.condition_number)
    # Least squares of all rows alike leaves the smaller residual of them.
    assert (weighed.fit.squares.sum() / alike.fit.squares.sum()) > 1.0


def test_solving_again_and_files_give_what_identifying_anew_does(weighed, alike):
    read = from_bytes(to_bytes(weighed))
    assert weights(read).tolist() == weights(weighed).tolist()
    for start in (weighed, read):
        np.testing.assert_allclose(reidentify(start, ALIKE).values, alike.values, rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(reidentify(alike, CHOICES).values, weighed.values, rtol=1e-7, atol=1e-9)


def test_a_model_with_more_and_less_of_an_effect_is_the_one_that_was_there_before(weighed):
    more = extend(weighed, [EffectChoice("offset")], [RUN], [OTHER])
    assert (weights(more) < 0.5).all()
    # Weights are iterated until they change by little, from another start.
    np.testing.assert_allclose(remove(more, [EffectChoice("offset")]).values, weighed.values, rtol=1e-5, atol=1e-5)


def test_a_diagnosis_names_the_same_however_the_model_was_weighed(weighed, alike):
    told = [diagnose(one, [RUN], DiagnosisChoices(("offset", "stribeck", "torque_delay"))) for one in (weighed, alike)]
    assert told[0].recommended == told[1].recommended
    assert told[0].residual_rms == pytest.approx(told[1].residual_rms)


@pytest.mark.parametrize(("estimator", "counts"), [("wls", True), ("feasible", True), ("ols", False), ("irls", False)])
def test_it_is_for_estimators_that_weigh_joints_and_leave_rows_alone(estimator, counts):
    found = identify(ROBOT, [RUN], [], replace(CHOICES, estimator=estimator))
    assert bool((weights(found) < 1.0).any()) is counts
