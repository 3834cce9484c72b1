"""Designs for the filtered, energy and power models, and designs that complement earlier runs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dynident.effects import EffectChoice
from dynident.errors import DynidentError
from dynident.excitation import CriterionChoice, DesignRequest, TrajectoryRequest, design_experiment
from dynident.excitation.criteria.design_criterion import build_design_criterion
from dynident.excitation.criteria.optimality_criteria import build_smooth_criterion
from dynident.excitation.design_observation_matrix import build_design_model
from dynident.excitation.equation_type_rows import ROW_MODELS, build_row_model
from dynident.excitation.optimisation.design_problem import DesignProblem, Multipliers
from dynident.motion.joint_trajectories import FourierFamily
from dynident.motion.limits.bounds import build_bounds
from dynident.recordings import recording_from_arrays
from dynident.robot import robot_from_library

EFFECTS = tuple(EffectChoice(name) for name in ("rigid_body", "rotor_inertia", "coulomb", "viscous"))
QUICK = DesignRequest(
    effects=EFFECTS, starts=1, random_trajectories=20, trajectory=TrajectoryRequest(duration=8.0, harmonics=4)
)


@pytest.mark.parametrize("rows", ROW_MODELS)
def test_the_gradient_for_every_models_rows_agrees_with_finite_differences(scara, rows):
    family = FourierFamily(4, 3.0)
    model = build_design_model(scara, EFFECTS)
    criterion = build_smooth_criterion(CriterionChoice(), np.ones(model.n_parameters))
    problem = DesignProblem(family, model, criterion, build_bounds(scara, {}), rows)
    rng = np.random.default_rng(2)
    x = rng.standard_normal(family.n_coefficients * scara.n)
    multipliers = Multipliers(rng.uniform(0, 1, (6, problem.n_samples, scara.n)), np.zeros((problem.n_samples, 0)), 3.0)
    at = problem.evaluate(x, multipliers)
    for _ in range(3):
        direction = rng.standard_normal(x.shape)
        forward, backward = (problem.evaluate(x + s * direction, multipliers).lagrangian for s in (1e-6, -1e-6))
        assert at.gradient @ direction == pytest.approx((forward - backward) / 2e-6, rel=2e-4)


def test_the_rows_are_those_of_their_models_written_out():
    n_samples, period, highest = 400, 4.0, 2.0
    t = np.arange(n_samples) * period / n_samples
    wave = 2 * np.pi * 1.5
    w = np.stack([np.sin(wave * t), np.cos(wave * t)], axis=1)[:, :, None]
    dq = np.stack([np.cos(wave * t), np.full(n_samples, 2.0)], axis=1)
    power = w[:, 0, 0] * dq[:, 0] + w[:, 1, 0] * dq[:, 1]
    np.testing.assert_allclose(build_row_model("power", n_samples, period, highest).build_rows(w, dq)[:, 0], power)
    length = 0.125 / highest
    # sin cos = sin(2 wave t)/2 and 2 cos, integrated from t to t + length
    primitive = lambda t: -np.cos(2 * wave * t) / (4 * wave) + 2 * np.sin(wave * t) / wave  # noqa: E731
    energy = build_row_model("energy", n_samples, period, highest).build_rows(w, dq)[:, 0]
    np.testing.assert_allclose(energy, primitive(t + length) - primitive(t), atol=1e-9)
    pole = 2 * 2 * np.pi * highest
    gain = (pole / (1j * wave + pole)) ** 2
    filtered = build_row_model("filtered", n_samples, period, highest).build_rows(w, dq).reshape(n_samples, 2)
    np.testing.assert_allclose(filtered[:, 0], np.imag(gain * np.exp(1j * wave * t)), atol=1e-9)


@pytest.mark.parametrize("rows", ["energy", "power"])
def test_the_energy_and_power_models_need_more_excitation_and_another_motion(scara, rows):
    """§12.7: one equation instead of one a joint is worse conditioned, and more sensitive to the trajectory."""
    dynamic = design_experiment(scara, QUICK)
    other = design_experiment(scara, replace(QUICK, model=rows))
    assert other.criterion_values.condition_number > 1.5 * dynamic.criterion_values.condition_number
    gained = other.baseline.median_condition_number / other.criterion_values.condition_number
    assert gained > 1.5 * dynamic.baseline.median_condition_number / dynamic.criterion_values.condition_number
    family = FourierFamily(4, 8.0)
    model = build_design_model(scara, EFFECTS)
    exciting = [
        np.stack([d.q, d.dq, d.ddq])[:, (d.t >= d.exciting[0]) & (d.t < d.exciting[1])] for d in (dynamic, other)
    ]
    conditions = []
    for q, dq, ddq in exciting:
        w = model.observe(q, dq, ddq).reshape(*q.shape, -1)
        made = build_row_model(rows, len(q), family.period, family.highest_frequency).build_rows(w, dq)
        conditions.append(np.linalg.cond(made))
    # What is best for the dynamic model is not what is best for this one.
    assert conditions[1] < 0.8 * conditions[0]


@pytest.mark.parametrize("rows", ROW_MODELS)
def test_promised_deviations_are_those_of_repeated_least_squares(scara, rows):
    noise = dict(zip(scara.joint_names, (2.0, 1.0, 5.0, 0.2), strict=True))
    design = design_experiment(scara, replace(QUICK, kind="random", model=rows, noise=noise))
    inside = (design.t >= design.exciting[0]) & (design.t < design.exciting[1])
    q, dq, ddq = design.q[inside], design.dq[inside], design.ddq[inside]
    model = build_design_model(scara, EFFECTS)
    w = model.observe(q, dq, ddq).reshape(*q.shape, -1)
    made = build_row_model(rows, len(q), design.period, 0.5)
    sigma = np.array([noise[name] for name in scara.joint_names])
    weights = np.ones(1) if made.joined else sigma
    solve = np.linalg.pinv(made.build_rows(w, dq) / np.tile(weights, len(q))[:, None])
    rng = np.random.default_rng(0)
    draws = []
    for _ in range(300):
        torque = (rng.standard_normal(q.shape) * sigma)[:, :, None]
        draws.append(solve @ (made.build_rows(torque, dq)[:, 0] / np.tile(weights, len(q))))
    promised = np.array([one.standard_deviation for one in design.expected])
    np.testing.assert_allclose(np.std(draws, axis=0), promised, rtol=0.2)


def test_a_design_complements_what_earlier_runs_have_told(scara):
    first = design_experiment(scara, replace(QUICK, kind="random", random_trajectories=1))
    torque = build_design_model(scara, EFFECTS).torque(first.q, first.dq, first.ddq)
    run = recording_from_arrays(first.t, first.q, torque, joint_names=scara.joint_names, name="first")
    wished = replace(QUICK, criterion=CriterionChoice("d_optimal"))
    alone, after = design_experiment(scara, wished), design_experiment(scara, wished, earlier=[run])
    again = design_experiment(scara, replace(wished, kind="random", seed=3), earlier=[run])
    assert after.criterion_values.criterion < alone.criterion_values.criterion
    assert after.criterion_values.criterion < again.criterion_values.criterion
    # Of the same random motions the one is chosen that is worth most together with the run. (In which valley a search
    # ends depends on the last digits of the processor, and that makes more of a difference.)
    model = build_design_model(scara, EFFECTS)
    design_criterion = build_design_criterion(model, wished.criterion, {})
    gained = []
    # Most draws have one motion that is best either way.
    for seed in range(24):
        drawn = replace(wished, kind="random", seed=seed)
        both = []
        for design in (design_experiment(scara, drawn), design_experiment(scara, drawn, earlier=[run])):
            rows = [
                model.observe(d.q[k], d.dq[k], d.ddq[k])
                for d in (first, design)
                for k in [(d.t >= d.exciting[0]) & (d.t < d.exciting[1])]
            ]
            w = np.concatenate(rows)
            both.append(design_criterion.evaluate(w, len(w) // scara.n).criterion)
        gained.append(both[0] - both[1])
    # The run has the rows of its way there and back as well, and filtered ones.
    assert min(gained) > -0.1
    assert max(gained) > 0.1


def test_earlier_runs_lower_what_is_to_be_expected_of_every_parameter(scara):
    noise = dict.fromkeys(scara.joint_names, 1.0)
    # One and the same motion: of several the best one is another, once earlier runs have told some of it.
    request = replace(QUICK, kind="random", noise=noise, random_trajectories=1)
    first = design_experiment(scara, replace(request, seed=5))
    torque = build_design_model(scara, EFFECTS).torque(first.q, first.dq, first.ddq)
    run = recording_from_arrays(first.t, first.q, torque, joint_names=scara.joint_names, name="first")
    alone, after = design_experiment(scara, request), design_experiment(scara, request, earlier=[run])
    before = np.array([one.standard_deviation for one in alone.expected])
    behind = np.array([one.standard_deviation for one in after.expected])
    assert np.all(behind < before)
    assert 0.4 < np.median(behind / before) < 0.9


@pytest.mark.slow
def test_a_motion_that_weighs_a_payload_is_designed_beside_a_run_without_it(ur10):
    """The deviation of a payload's mass, given that the arm was recorded without it."""
    noise = dict.fromkeys(ur10.joint_names, 1.0)
    bare = design_experiment(ur10, replace(QUICK, kind="random", random_trajectories=1))
    torque = build_design_model(ur10, EFFECTS).torque(bare.q, bare.dq, bare.ddq)
    run = recording_from_arrays(bare.t, bare.q, torque, joint_names=ur10.joint_names, name="bare")
    wished = replace(
        QUICK,
        effects=(*EFFECTS, EffectChoice("payload")),
        criterion=CriterionChoice("parameters", parameters=("Mp6",)),
        noise=noise,
    )
    weighing = design_experiment(ur10, wished, earlier=[run])
    any_motion = design_experiment(ur10, replace(wished, kind="random", random_trajectories=1), earlier=[run])
    mass = [next(one.standard_deviation for one in d.expected if one.name == "Mp6") for d in (weighing, any_motion)]
    assert mass[0] < 0.9 * mass[1]
    # Without the run before, arm and payload are one.
    alone = design_experiment(ur10, replace(wished, kind="random", criterion=CriterionChoice()))
    assert "Mp6" not in alone.parameter_names
    assert any("Mp6" in note for note in alone.notes)


def test_what_cannot_be_designed_for_is_refused(scara):
    with pytest.raises(DynidentError) as refused:
        design_experiment(scara, replace(QUICK, kind="constant_velocity", model="power"))
    assert refused.value.pointer == "/model"
    with pytest.raises(DynidentError) as refused:
        design_experiment(scara, replace(QUICK, model="momentum"))
    assert "energy" in refused.value.detail
    other = robot_from_library("ur10")
    t = np.arange(500) / 100
    q = np.outer(np.sin(t), np.ones(6))
    run = recording_from_arrays(t, q, q, joint_names=other.joint_names, name="other")
    with pytest.raises(DynidentError) as refused:
        design_experiment(scara, QUICK, earlier=[run])
    assert refused.value.pointer == "/earlier_ids"
