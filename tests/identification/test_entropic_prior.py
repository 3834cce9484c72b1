"""The entropic prior: against other solvers, in other frames, and what it is good for."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import cvxpy as cp
import numpy as np
import pytest
from scipy.optimize import minimize
from support.oracles import arm, crooked_urdf, fourier_motion, pinocchio_torque, record

from dynident.effects import EffectChoice, ReferenceParameters
from dynident.errors import DynidentError
from dynident.estimation import build_weighted_factor, solve_weighted
from dynident.identification import Identification, IdentificationChoices, identify
from dynident.identification.description_prior import (
    EntropicPrior,
    build_entropic_prior,
    build_normal_prior,
    build_prior,
)
from dynident.identification.equations.reduced_recordings import reduce_to_rows
from dynident.identification.estimators.feasible import minimise_entropic_cost
from dynident.identification.estimators.feasible_problem import build_problem, build_standard_prior
from dynident.identification.identified_models.model_files import from_bytes, to_bytes
from dynident.recordings import Preprocessing
from dynident.regressors.model_structure import build_model
from dynident.regressors.observation_matrix import RegressorInputs
from dynident.robot import robot_from_urdf
from dynident.robot.pseudo_inertia import PSEUDO_INERTIA_PARTS, inertial_parameters, pseudo_inertia

LINKS = (EffectChoice("rigid_body"),)
EFFECTS = tuple(EffectChoice(name) for name in ("rigid_body", "rotor_inertia", "coulomb", "viscous"))
FILTERS = Preprocessing(15.0, 15.0, 5)
CHOICES = IdentificationChoices(EFFECTS, estimator="feasible", prior="description_entropic", preprocessing=FILTERS)


def recorded(robot, truth, amplitude: float = 1.2, noise: float = 0.3, friction: bool = True, name: str = "run"):
    """Torque of the robot `truth` on a motion that suits `robot`."""
    m = fourier_motion(robot, 10.0, 200.0, seed=2, amplitude=amplitude)
    tau = pinocchio_torque(truth, m.q, m.dq, m.ddq) + friction * (1.5 * np.sign(m.dq) + 2.0 * m.dq + 0.2 * m.ddq)
    return record(robot, m, tau + noise * np.random.default_rng(7).normal(size=tau.shape), name)


class TwoLinks:
    """A problem with two crooked links and nothing else, whose description is far off and whose data are poor."""

    def __init__(self, noise: float) -> None:
        self.truth = robot_from_urdf("two", crooked_urdf(2, seed=22, sliding=()))
        changed = self.truth.inertias * np.array([[1.5], [0.6]])
        self.robot = replace(self.truth, inertias=changed)
        self.model = build_model(self.robot, LINKS)
        self.choices = replace(CHOICES, effects=LINKS)
        run = recorded(self.robot, self.truth, 0.3, noise, friction=False)
        data = reduce_to_rows(
            self.model,
            self.choices.row_options,
            RegressorInputs([run], FILTERS, ReferenceParameters.massless(self.robot)),
        )
        known = build_prior(self.model, self.choices.trust)
        start = solve_weighted(data.equations, known)
        believed = build_standard_prior(self.model, self.choices.trust, start)
        at_nominal = build_problem(self.model, data.equations, known, believed.approximate_at(believed.belief.mean))
        _, found = minimise_entropic_cost(self.model, at_nominal, believed, start.noise)
        self.found = at_nominal.unit * found.values
        self.prior = believed.entropic
        factor = build_weighted_factor(data.equations, start.noise)
        b = self.model.n_parameters
        self.rows, self.right = factor[:b, :b] @ self.model.base.grouping, factor[:b, b]

    def cost(self, values) -> float:
        return float(np.sum((self.rows @ values - self.right) ** 2)) + self.prior.compute_cost(values)


@pytest.fixture(scope="module", params=[0.02, 2.0], ids=["good data", "poor data"])
def two(request):
    return TwoLinks(request.param)


def test_the_least_cost_over_bodies_written_as_cholesky_factors_is_that_of_the_estimator(two):
    roots = np.linalg.cholesky(pseudo_inertia(two.found.reshape(2, 10)))
    nominal = np.linalg.cholesky(two.prior.nominal)
    lower = np.tril_indices(4)

    def values_of(x):
        """Any x makes a body: J = L₀ K Kᵀ L₀ᵀ."""
        inner = np.zeros((2, 4, 4))
        inner[:, *lower] = x.reshape(2, 10)
        whole = nominal @ inner
        return inertial_parameters(whole @ whole.transpose(0, 2, 1)).ravel(), inner, whole

    def cost_and_slope(x):
        values, inner, whole = values_of(x)
        rest = two.rows @ values - two.right
        # dφ = M dJ with the linear map of `inertial_parameters`, its adjoint taken entry by entry.
        adjoint = np.einsum("lk,kij->lij", (2.0 * two.rows.T @ rest).reshape(2, 10), _MAP)
        adjoint = 0.5 * (adjoint + adjoint.transpose(0, 2, 1))
        weight = 2.0 / two.prior.share**2
        gram = inner @ inner.transpose(0, 2, 1)
        divergence = np.trace(gram, axis1=1, axis2=2) - np.linalg.slogdet(gram)[1] - 4.0
        slope = 2.0 * nominal.transpose(0, 2, 1) @ adjoint @ whole
        slope += weight * (2.0 * inner - 2.0 * np.linalg.inv(inner).transpose(0, 2, 1))
        return float(rest @ rest) + weight * divergence.sum(), slope[:, *lower].ravel()

    start = np.tile(np.eye(4)[lower], 2)
    assert cost_and_slope(start)[0] == pytest.approx(two.cost(values_of(start)[0]))
    theirs = minimize(cost_and_slope, start, jac=True, method="BFGS", options={"gtol": 1e-7, "maxiter": 5000})
    assert two.cost(two.found) == pytest.approx(theirs.fun, rel=1e-7)
    np.testing.assert_allclose(values_of(theirs.x)[0], two.found, rtol=1e-3, atol=1e-4 * np.abs(two.found).max())
    # And the estimator's own solution has no slope.
    here = np.linalg.solve(nominal, roots)[:, *lower].ravel()
    assert np.abs(cost_and_slope(here)[1]).max() < 1e-3 * np.abs(cost_and_slope(start)[1]).max()


def test_the_least_cost_is_that_of_cvxpy(two):
    u = cp.Variable(20)
    relative = []
    for link in range(2):
        half = np.linalg.inv(np.linalg.cholesky(two.prior.nominal[link]))
        parts = half @ PSEUDO_INERTIA_PARTS @ half.T
        relative.append(sum(u[10 * link + k] * parts[k] for k in range(10)))
    weight = 2.0 / two.prior.share**2
    divergence = sum(cp.trace(one) - cp.log_det(one) - 4.0 for one in relative)
    cp.Problem(cp.Minimize(cp.sum_squares(two.rows @ u - two.right) + weight * divergence)).solve(solver="CLARABEL")
    assert two.cost(two.found) <= two.cost(u.value) * (1 + 1e-9)
    assert two.cost(two.found) == pytest.approx(two.cost(u.value), rel=1e-5)


def _map():
    """(10, 4, 4): coefficients of the entries of J in each inertial parameter."""
    made = np.zeros((10, 4, 4))
    for i in range(4):
        for j in range(4):
            one = np.zeros((4, 4))
            one[i, j] = one[j, i] = 1.0
            made[:, i, j] = inertial_parameters(one) * (1.0 if i == j else 0.5)
    return made


_MAP = _map()


def test_the_distance_of_two_bodies_is_the_same_in_every_frame_and_unit():
    rng = np.random.default_rng(0)
    body, nominal = (pseudo_inertia(arm("ur10").inertias[link]) for link in (2, 3))
    rotation = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    moved = np.eye(4)
    moved[:3, :3], moved[:3, 3] = 1e3 * rotation, rng.normal(size=3)  # a frame elsewhere, and millimetres

    def distance(one, other):
        return EntropicPrior(np.arange(10)[None], other[None], 0.2).compute_cost(inertial_parameters(one))

    assert distance(body, nominal) > 1.0
    assert distance(moved @ body @ moved.T, moved @ nominal @ moved.T) == pytest.approx(distance(body, nominal))
    assert distance(nominal, nominal) == pytest.approx(0.0, abs=1e-9)


def test_masses_are_believed_within_the_share_that_is_given():
    model = build_model(arm("ur10"), LINKS)
    for share in (0.2, 0.05):
        choices = replace(CHOICES, effects=LINKS, prior_error=share)
        belief = build_normal_prior(model, choices.trust)
        near = build_entropic_prior(model, share, belief).approximate_at(belief, belief.mean)
        masses = slice(9, None, 10)
        np.testing.assert_allclose(np.linalg.norm(near.spread[masses], axis=1), share * arm("ur10").inertias[:, 9])
        np.testing.assert_allclose(near.mean, belief.mean, atol=1e-9)


def test_the_normal_belief_near_a_body_has_the_slope_and_curvature_of_the_distance():
    model = build_model(arm("ur10"), LINKS)
    belief = build_normal_prior(model, CHOICES.trust)
    prior = build_entropic_prior(model, CHOICES.prior_error, belief)
    here = 1.3 * belief.mean
    near = prior.approximate_at(belief, here)
    information = np.linalg.inv(near.spread @ near.spread.T)
    step = 1e-3 * near.spread @ np.random.default_rng(1).normal(size=len(here))

    def normal(values):
        return (values - near.mean) @ information @ (values - near.mean)

    slope = (prior.compute_cost(here + step) - prior.compute_cost(here - step)) / 2
    bend = prior.compute_cost(here + step) + prior.compute_cost(here - step) - 2 * prior.compute_cost(here)
    assert slope == pytest.approx((normal(here + step) - normal(here - step)) / 2, rel=1e-4)
    assert bend == pytest.approx(normal(here + step) + normal(here - step) - 2 * normal(here), rel=1e-2)


@cache
def poor(prior: str, free: tuple[str, ...] = ()) -> Identification:
    """A motion of a few degrees, of a UR10 whose description is a tenth off."""
    robot = replace(arm("ur10"), inertias=1.1 * arm("ur10").inertias)
    runs = [recorded(robot, arm("ur10"), 0.1)], [recorded(robot, arm("ur10"), 1.5, name="wide")]
    return identify(robot, *runs, replace(CHOICES, prior=prior, free_links=free))


def test_a_poor_motion_predicts_a_good_one_better_than_with_independent_parameters():
    assert poor("description_entropic").held_out.relative_total < 0.8 * poor("description").held_out.relative_total


def test_every_link_is_a_body_with_volume_and_nothing_is_held_at_an_edge():
    found = poor("description_entropic")
    inertias = found.estimate.standard.to_inertias(found.model)
    relative = np.linalg.solve(pseudo_inertia(found.model.robot.inertias), pseudo_inertia(inertias))
    assert np.linalg.eigvals(relative).real.min() > 0.1
    assert not any("Held at the limit" in warning for warning in found.warnings)
    assert any("less than the prior does" in warning for warning in found.warnings)


def test_a_free_link_is_not_believed():
    held, free = poor("description_entropic"), poor("description_entropic", ("wrist_3_joint",))
    last = [k for k, column in enumerate(held.model.columns) if column.effect == "rigid_body"][-1]
    assert held.estimate.standard.standard_deviations[last] < 0.2 * free.estimate.standard.standard_deviations[last]


def test_the_choice_is_kept_in_files():
    assert from_bytes(to_bytes(poor("description_entropic"))).choices.prior == "description_entropic"


def test_it_goes_with_the_feasible_estimator_alone():
    with pytest.raises(DynidentError, match="works only with the estimator feasible") as refused:
        replace(CHOICES, estimator="wls")
    assert refused.value.pointer == "/prior"


def test_a_description_with_a_link_without_extent_is_refused_unless_the_link_is_free():
    inertias = arm("ur10").inertias.copy()
    inertias[-1] = [0, 0, 0, 0, 0, 0, 0, 0, 0, 0.4]
    robot = replace(arm("ur10"), inertias=inertias)
    runs = [recorded(robot, arm("ur10"))], []
    with pytest.raises(DynidentError, match="wrist_3_joint no mass or no extent") as refused:
        identify(robot, *runs, CHOICES)
    assert refused.value.pointer == "/prior"
    assert identify(robot, *runs, replace(CHOICES, free_links=("wrist_3_joint",))).fit.relative_total < 0.05


def test_a_belief_so_weak_that_no_body_is_settled_on_is_refused_with_what_to_do():
    robot = replace(arm("ur10"), inertias=1.1 * arm("ur10").inertias)
    with pytest.raises(DynidentError, match=r"prior_error is 100000000\.0; it must be") as refused:
        identify(robot, [recorded(robot, arm("ur10"), 0.1)], [], replace(CHOICES, prior_error=1e8))
    assert refused.value.pointer == "/prior_error"
