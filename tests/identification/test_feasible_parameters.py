"""Physically feasible parameters: against cvxpy on the same data, against the truth, and what is said of limits."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import cvxpy as cp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.oracles import arm, fourier_motion, pinocchio_torque, record

from dynident.effects import EffectChoice
from dynident.estimation import build_weighted_factor, compute_errors, compute_pooled_statistics
from dynident.identification import Identification, IdentificationChoices, identify
from dynident.identification.estimation_problem import Problem
from dynident.identification.estimators.feasible import solve_feasible
from dynident.identification.identified_models.model_files import from_bytes, to_bytes
from dynident.recordings import Preprocessing
from dynident.robot.pseudo_inertia import PSEUDO_INERTIA_PARTS, pseudo_inertia, smallest_pseudo_inertia

EFFECTS = tuple(EffectChoice(name) for name in ("rigid_body", "rotor_inertia", "coulomb", "viscous"))
CHOICES = IdentificationChoices(EFFECTS, estimator="feasible", preprocessing=Preprocessing(15.0, 15.0, 5))
FRICTION, VISCOUS, ROTOR = 2.0, 1.5, 0.1


@cache
def identified(
    noise: float = 0.0, duration: float = 20.0, estimator: str = "feasible", seed: int = 0, friction: float = FRICTION
) -> Identification:
    """A UR10 with friction and rotors, identified from its torque."""
    robot = arm("ur10")
    motion = fourier_motion(robot, duration, 200.0, seed=2)
    tau = pinocchio_torque(robot, motion.q, motion.dq, motion.ddq)
    tau = tau + friction * np.sign(motion.dq) + VISCOUS * motion.dq + ROTOR * motion.ddq
    tau = tau + noise * np.random.default_rng(seed).normal(size=tau.shape)
    recordings = [record(robot, motion, tau)]
    return identify(robot, recordings, choices=replace(CHOICES, estimator=estimator))


def test_data_of_a_robot_that_exists_give_the_same_as_weighted_least_squares():
    found, free = identified(0.02, 40.0), identified(0.02, 40.0, "wls")
    assert not any("Held at" in warning for warning in found.warnings)
    gap = np.abs(found.values - free.values) / free.statistics.standard_deviations
    assert gap.max() < 1e-3
    np.testing.assert_allclose(found.statistics.standard_deviations, free.statistics.standard_deviations, rtol=1e-3)


def test_without_noise_the_least_squares_solution_is_found():
    found, free = identified(), identified(estimator="wls")
    possible, best = (compute_errors(one.data.training, one.values).relative_total for one in (found, free))
    assert possible < 1.02 * best
    scale = np.abs(found.values).max()
    np.testing.assert_allclose(found.values, free.values, atol=2e-3 * scale)


def test_feasible_parameters_are_those_of_cvxpy():
    """One weighting, the same constraints, stated in another language and solved by another solver."""
    found = identified(1.0, 3.0)
    model, solution = found.model, found.estimate.solution
    rows = build_weighted_factor(found.data.equations, solution.noise)
    b, grouping = model.n_parameters, model.base.grouping
    u = cp.Variable(len(model.columns))
    constraints = [u[k] >= 0 for k, column in enumerate(model.columns) if column.effect != "rigid_body"]
    for name in model.robot.joint_names:
        links = [k for k, column in enumerate(model.columns) if column.effect == "rigid_body" and column.link == name]
        constraints.append(sum(u[k] * part for k, part in zip(links, PSEUDO_INERTIA_PARTS, strict=True)) >> 0)
    size = np.abs(rows).max()
    objective = cp.sum_squares((rows[:b, :b] @ grouping) / size @ u - rows[:b, b] / size)
    cp.Problem(cp.Minimize(objective), constraints).solve(solver="SCS", eps=1e-9, max_iters=200_000)

    def cost(values: np.ndarray) -> float:
        return float(np.sum((rows[:b, :b] @ values - rows[:b, b]) ** 2))

    least = cost(np.linalg.solve(rows[:b, :b], rows[:b, b]))
    theirs, ours = cost(grouping @ u.value) - least, cost(found.values) - least
    assert theirs > 10.0  # constraints hold something back
    # Links may be quite flat here, and the weights are those after the last round.
    assert ours == pytest.approx(theirs, rel=0.01)


@settings(max_examples=8, deadline=None)
@given(seed=st.integers(0, 1000), noise=st.sampled_from([0.5, 3.0, 20.0]))
def test_every_link_could_exist_however_bad_the_data_are(seed, noise):
    found = identified(noise, 3.0, seed=seed)
    assert found.estimate.standard is not None
    inertias = found.estimate.standard.to_inertias(found.model)
    assert np.linalg.eigvalsh(pseudo_inertia(inertias)).min() > 0
    assert smallest_pseudo_inertia(inertias).min() > 0
    assert all(p.value >= -1e-6 for p in found.parameters if p.effect in ("coulomb", "viscous"))
    # The standard parameters are those of the base parameters.
    np.testing.assert_allclose(
        found.model.base.grouping @ found.estimate.standard.values, found.values, rtol=1e-9, atol=1e-9
    )
    assert found.inertia_matrix_positive_definite


def test_least_squares_alone_gives_links_that_cannot_exist_on_such_data():
    free = identified(20.0, 3.0, "wls")
    inertias = free.estimate.standard_inertia().reshape(-1, 10)
    assert smallest_pseudo_inertia(inertias).min() < 0
    assert not free.inertia_matrix_positive_definite


def test_friction_that_drives_the_motion_is_held_at_zero_and_named():
    found = identified(0.05, 20.0, friction=-0.5)
    held = [p for p in found.parameters if p.effect == "coulomb"]
    assert max(abs(p.value) for p in held) < 1e-5
    assert all(p.standard_deviation < 1e-9 for p in held)
    warning = next(warning for warning in found.warnings if "Held at zero" in warning)
    assert all(p.name in warning for p in held)
    assert any("increases the residual" in warning and "residual" in warning for warning in found.warnings)


def test_a_limit_that_holds_makes_its_direction_certain_and_leaves_the_others():
    found = identified(0.05, 20.0, friction=-0.5)
    free = replace(found.estimate.solution, free=None)
    solutions = (found.estimate.solution, free)
    limited, unlimited = (compute_pooled_statistics(found.data.equations, one) for one in solutions)
    held = np.array([p.effect == "coulomb" for p in found.parameters])
    assert (found.statistics.standard_deviations[held] < 1e-9).all()
    assert (unlimited.standard_deviations[held] > 1e-4).all()
    ratio = limited.standard_deviations[~held] / unlimited.standard_deviations[~held]
    assert (ratio < 1 + 1e-6).all()
    assert np.median(ratio) > 0.3


def test_the_same_reduced_data_give_the_same_again():
    found = identified(1.0, 20.0)
    data = found.data.to_data(found.estimate.reference)
    fit = solve_feasible(Problem.from_choices(found.model, found.choices, data))
    np.testing.assert_allclose(fit.solution.values, found.values, rtol=1e-9)


def test_standard_parameters_and_limits_come_back_from_a_file():
    whole = identified(0.05, 20.0, friction=-0.5)
    found, again = whole.estimate, from_bytes(to_bytes(whole)).estimate
    assert again.standard is not None
    assert found.standard is not None
    np.testing.assert_array_equal(again.standard.values, found.standard.values)
    np.testing.assert_array_equal(again.standard.standard_deviations, found.standard.standard_deviations)
    np.testing.assert_array_equal(again.solution.free, found.solution.free)
    np.testing.assert_array_equal(again.standard_inertia(), found.standard_inertia())


def test_what_the_data_leave_open_is_not_given_a_standard_deviation():
    found = identified(0.02, 40.0)
    deviations = dict(
        zip((c.name for c in found.model.columns), found.estimate.standard.standard_deviations, strict=True)
    )
    assert np.isinf(deviations["M1"])
    assert np.isfinite(deviations["Fv4"])
    assert deviations["Fv4"] == pytest.approx(
        next(p.standard_deviation for p in found.parameters if p.name == "Fv4"), rel=0.5
    )


def test_friction_alone_is_held_to_its_sign_without_any_link():
    robot = arm("ur10")
    motion = fourier_motion(robot, 10.0, 200.0, seed=2)
    tau = -1.0 * np.sign(motion.dq) + 0.5 * motion.dq
    choices = replace(CHOICES, effects=EFFECTS[2:])
    found = identify(robot, [record(robot, motion, tau)], choices=choices)
    assert all(p.value == pytest.approx(0.0, abs=1e-6) for p in found.parameters if p.effect == "coulomb")
    assert all(p.value > -1e-9 for p in found.parameters)
    np.testing.assert_array_equal(found.estimate.standard_inertia(), robot.inertias.reshape(-1))


def test_beside_other_friction_that_resists_coulomb_may_have_any_sign():
    robot = arm("ur10")
    motion = fourier_motion(robot, 20.0, 200.0, seed=2)
    speed = np.abs(motion.dq)
    # Friction that grows with the root of the speed: Coulomb friction and its complement are parts of one sum.
    tau = pinocchio_torque(robot, motion.q, motion.dq, motion.ddq) + np.sign(motion.dq) * (-0.3 + 3.0 * np.sqrt(speed))
    shape = (("p", 0.5),)
    choices = replace(CHOICES, effects=(*EFFECTS, EffectChoice("viscous_nonlinear", shape=shape)))
    found = identify(robot, [record(robot, motion, tau)], choices=choices)
    coulomb = [p.value for p in found.parameters if p.effect == "coulomb"]
    assert np.median(coulomb) == pytest.approx(-0.3, abs=0.15)
