"""The inertia matrix over the whole joint range."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from support.measured_arm import BAND, IA, ROBOT, with_values
from support.oracles import arm, fourier_motion, pinocchio_torque, record

from dynident.effects import EffectChoice, ReferenceParameters
from dynident.identification import IdentificationChoices, identify
from dynident.identification.standard_parameters import (
    compute_smallest_inertia_eigenvalue,
    draw_postures,
    get_joint_range,
)
from dynident.robot import to_pinocchio
from dynident.validation import validate_inertia_matrix
from dynident.validation.inertia_matrix import _PostureSearch


def scaled_eigenvalue(q: np.ndarray, rotors: np.ndarray) -> float:
    """By Pinocchio's composite rigid-body algorithm."""
    model = to_pinocchio(ROBOT)
    upper = pin.crba(model, model.createData(), q)
    a = np.triu(upper) + np.triu(upper, 1).T + np.diag(rotors)
    scale = 1 / np.sqrt(np.diag(a))
    return float(np.linalg.eigvalsh(a * np.outer(scale, scale))[0])


@pytest.fixture(scope="module")
def true_model(identified):
    """The identification with the true parameters in it."""
    standard = np.zeros(len(identified.model.columns))
    for k, column in enumerate(identified.model.columns):
        joint = ROBOT.joint_names.index(column.link)
        if column.effect == "rigid_body":
            standard[k] = ROBOT.inertias.reshape(-1)[k]
        elif column.effect == "rotor_inertia":
            standard[k] = IA[joint]
    return with_values(identified, identified.model.base.grouping @ standard)


def test_the_worst_posture_is_worse_than_any_sample_and_is_what_pinocchio_says(true_model):
    found = validate_inertia_matrix(true_model)
    assert found.judged.verdict == "pass"
    assert found.smallest_eigenvalue == pytest.approx(scaled_eigenvalue(found.posture, IA), rel=1e-6)
    others = [scaled_eigenvalue(q, IA) for q in draw_postures(ROBOT, 3000, seed=7)]
    assert found.smallest_eigenvalue <= min(others)
    assert found.smallest_eigenvalue <= found.sampled
    low, high = get_joint_range(ROBOT)
    assert np.all((found.posture >= low) & (found.posture <= high))


def test_the_gradient_is_that_of_finite_differences(true_model):
    search = _PostureSearch(true_model.model, true_model.values)
    q = draw_postures(ROBOT, 1, seed=3)[0]
    gradient = search._value_and_gradient(q)[1]
    step = 1e-6 * np.eye(ROBOT.n)
    differences = [(search._value_and_gradient(q + h)[0] - search._value_and_gradient(q - h)[0]) / 2e-6 for h in step]
    assert gradient == pytest.approx(differences, abs=1e-7)


def test_its_standard_deviation_is_that_of_drawn_parameters(identified):
    found = validate_inertia_matrix(identified)
    rng = np.random.default_rng(0)
    drawn = rng.multivariate_normal(identified.values, identified.statistics.covariance, size=400)
    values = [_at(identified, parameters, found.posture) for parameters in drawn]
    assert found.standard_deviation == pytest.approx(np.std(values), rel=0.2)


def _at(identified, parameters: np.ndarray, posture: np.ndarray) -> float:
    model = identified.model
    observation = model.observation
    n = model.robot.n
    ddq = np.vstack([np.zeros(n), np.eye(n)])
    q = np.tile(posture, (n + 1, 1))
    entries = observation.evaluate(
        q,
        np.zeros_like(q),
        ddq,
        reference=ReferenceParameters.massless(model.robot),
        memory=np.zeros((n + 1, observation.n_memory)),
    )
    torque = observation.compute_torque(entries, parameters)
    a = torque[1:] - torque[0]
    scale = 1 / np.sqrt(np.diag(a))
    return float(np.linalg.eigvalsh(0.5 * (a + a.T) * np.outer(scale, scale))[0])


def test_a_matrix_that_is_indefinite_in_a_corner_alone_is_found_where_samples_see_nothing(true_model):
    """The inertia is lowered until the usual samples just call it positive definite."""
    values = true_model.values.copy()
    names = [column.name for column in true_model.model.kept]
    k = next(k for k, name in enumerate(names) if name.startswith("ZZ3"))

    def lowered(amount: float):
        changed = values.copy()
        changed[k] -= amount
        return with_values(true_model, changed)

    low, high = 0.0, 50.0
    for _ in range(40):
        middle = 0.5 * (low + high)
        if compute_smallest_inertia_eigenvalue(true_model.model, lowered(middle).values) > 0:
            low = middle
        else:
            high = middle
    barely = lowered(low)
    assert compute_smallest_inertia_eigenvalue(barely.model, barely.values) > 0
    found = validate_inertia_matrix(barely)
    assert found.judged.verdict == "fail"
    assert found.smallest_eigenvalue < 0
    assert "elbow_joint = " in found.judged.reason


def test_negative_inertia_on_the_diagonal_fails(true_model):
    found = validate_inertia_matrix(with_values(true_model, -true_model.values))
    assert found.judged.verdict == "fail"
    assert found.smallest_eigenvalue <= -1.0


def test_a_model_without_inertia_is_not_evaluated(training):
    friction = tuple(EffectChoice(name) for name in ("coulomb", "viscous"))
    found = identify(ROBOT, [training], [], IdentificationChoices(effects=friction, preprocessing=BAND))
    judged = validate_inertia_matrix(found).judged
    assert judged.verdict == "not_evaluated"
    assert "inertia" in judged.reason


def test_sliding_joints_are_searched_too():
    robot = arm("scara")
    motion = fourier_motion(robot, 20.0, 100.0, 4)
    run = record(robot, motion, pinocchio_torque(robot, motion.q, motion.dq, motion.ddq))
    found = identify(robot, [run], [], IdentificationChoices(effects=(EffectChoice("rigid_body"),), preprocessing=BAND))
    result = validate_inertia_matrix(found)
    assert result.judged.verdict == "pass"
    assert "rad or m" in result.judged.reason
