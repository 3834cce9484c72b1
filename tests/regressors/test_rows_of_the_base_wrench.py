"""The base's reaction wrench against Pinocchio: rows, identified base parameters, and what is marginalised."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from support.oracles import arm, crooked_urdf, fourier_motion, pinocchio_torque, random_states

from dynident.effects import EffectChoice, ReferenceParameters
from dynident.errors import DynidentError
from dynident.estimation import (
    EquationFactors,
    Reduction,
    compute_errors,
    solve,
    solve_ordinary,
    solve_weighted,
    statistics,
)
from dynident.identification import IdentificationChoices, extend, identify
from dynident.identification.equations.filtered_energy_power_wrench import marginalise_parameters
from dynident.identification.identified_models.remove_and_solve_again import remove
from dynident.recordings import FurtherColumns, Preprocessing, Recording, filtered_blocks, recording_from_arrays
from dynident.regressors.equation_forms import build_wrench_form, build_wrench_model
from dynident.regressors.model_structure import build_model
from dynident.robot import robot_from_urdf, to_pinocchio

LINKS = (EffectChoice("rigid_body"),)
SLOW = Preprocessing(None, 5.0, 10)
STANDING = np.array([3.0, -2.0, 80.0, 1.0, -4.0, 0.5])


def wrenches(robot, q, dq, ddq) -> np.ndarray:
    """(m, 6): what the base exerts on the links, by Pinocchio's recursion, about the base's origin."""
    model = to_pinocchio(robot)
    data = model.createData()
    found = np.empty((len(q), 6))
    for k, state in enumerate(zip(q, dq, ddq, strict=True)):
        pin.rnea(model, data, *state)
        roots = [joint for joint in range(1, model.njoints) if model.parents[joint] == 0]
        found[k] = sum((data.liMi[joint].act(data.f[joint]).vector for joint in roots), np.zeros(6))
    return found


def recorded(robot, seconds=60.0, rate=1000.0, frequency=0.05, seed=3, noise=0.0, **more) -> Recording:
    motion = fourier_motion(robot, seconds, rate, seed, base_frequency=frequency, amplitude=2.5)
    state = motion.q, motion.dq, motion.ddq
    drawn = np.random.default_rng(seed)
    wrench = wrenches(robot, *state) + STANDING + noise * drawn.normal(size=(len(motion.t), 6)) * [5, 5, 5, 1, 1, 1]
    names = {"joint_names": robot.joint_names, "name": "run", **more}
    return recording_from_arrays(
        motion.t, motion.q, pinocchio_torque(robot, *state), further=FurtherColumns(wrench=wrench), **names
    )


def error(found, truth: np.ndarray) -> float:
    """||D (χ - truth)|| / ||D truth|| with D the norms of the torque's columns."""
    scales = solve_ordinary(found.data.training).scales
    return float(np.linalg.norm(scales * (found.values - truth)) / np.linalg.norm(scales * truth))


def by_wrench(robot, runs, **more):
    return identify(robot, runs, [], IdentificationChoices(LINKS, model="base_wrench", preprocessing=SLOW, **more))


@pytest.mark.parametrize("name", ["ur10", "franka_panda", "scara", "dual_arm", "crooked"])
def test_rows_of_the_wrench_are_pinocchios(name):
    robot = arm(name)
    model = build_model(robot, LINKS)
    form = build_wrench_form(robot, model.columns, model.signals)
    q, dq, ddq = random_states(robot, 20, 1)
    entries = form.observation.evaluate(
        q, dq, ddq, reference=ReferenceParameters.massless(robot), memory=np.zeros((20, 0))
    )
    dense = np.zeros((20, 12, len(model.columns)))
    dense[:, form.observation.entry_rows, form.observation.entry_columns] = entries
    np.testing.assert_allclose(dense[:, 6:] @ robot.inertias.ravel(), wrenches(robot, q, dq, ddq), atol=1e-9)


def test_an_arm_at_rest_is_held_up_by_its_weight():
    robot = arm("ur10")
    model = build_model(robot, LINKS)
    form = build_wrench_form(robot, model.columns, model.signals)
    zero = np.zeros((1, robot.n))
    entries = form.observation.evaluate(
        zero, zero, zero, reference=ReferenceParameters.massless(form.observation.robot), memory=np.zeros((1, 0))
    )
    dense = np.zeros((12, len(model.columns)))
    dense[form.observation.entry_rows, form.observation.entry_columns] = entries[0]
    force = dense[6:9] @ robot.inertias.ravel()
    np.testing.assert_allclose(force, [0.0, 0.0, 9.81 * robot.inertias[:, 9].sum()], atol=1e-9)


@pytest.mark.parametrize(
    "name", ["scara", *(pytest.param(name, marks=pytest.mark.slow) for name in ("ur10", "crooked"))]
)
def test_noise_free_wrench_and_torque_give_the_same_base_parameters_as_the_description(name):
    robot = arm(name)
    run = recorded(robot, 50.0, 500.0)
    for model, estimator in (("base_wrench", "ols"), ("base_wrench", "wls"), ("dynamic", "ols"), ("dynamic", "wls")):
        choices = IdentificationChoices(LINKS, model=model, estimator=estimator, preprocessing=SLOW)
        found = identify(robot, [run], [], choices)
        assert error(found, found.model.base.grouping @ robot.inertias.ravel()) < 1e-8, (model, estimator)
        said = any("friction and rotors are not in this model" in warning for warning in found.warnings)
        assert said == (model == "base_wrench")


@pytest.mark.slow
@settings(max_examples=6, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(
    seed=st.integers(0, 10_000),
    shape=st.sampled_from([(-1, 0, 1, 2), (-1, 0, 1, 1), (-1, 0, 0, 2, 2), (-1, -1, 0, 1)]),
    sliding=st.sets(st.integers(0, 3), max_size=2),
)
def test_the_wrench_gives_the_base_parameters_of_arms_of_any_shape(seed, shape, sliding):
    robot = robot_from_urdf("drawn", crooked_urdf(len(shape), seed, tuple(sliding), shape))
    found = by_wrench(robot, [recorded(robot, 50.0, frequency=0.05, seed=seed)])
    assert error(found, found.model.base.grouping @ robot.inertias.ravel()) < 1e-8


@pytest.mark.slow
def test_standard_deviations_of_a_noisy_wrench_cover_the_truth():
    robot = arm("scara")
    ratios = []
    for seed in range(12):
        found = by_wrench(robot, [recorded(robot, 30.0, 200.0, 0.2, seed, noise=1.0)])
        truth = found.model.base.grouping @ robot.inertias.ravel()
        ratios.append((found.values - truth) / found.statistics.standard_deviations)
    rms = np.sqrt(np.mean(np.square(ratios)))
    assert 0.7 < rms < 1.4


def test_parameters_that_only_load_the_base_are_no_part_of_the_result():
    robot = arm("ur10")
    model = build_model(robot, LINKS)
    extra = build_wrench_model(model).n_extra
    assert extra > 0
    found = by_wrench(robot, [recorded(robot, 30.0, 200.0)])
    assert [p.name for p in found.parameters] == list(model.base.kept_names)
    assert len(found.data.equations.equations) == 6
    assert found.effective_rows.shape == found.noise.shape == (robot.n,)


def test_taking_nuisance_out_leaves_estimates_residuals_and_deviations_as_they_were():
    rng = np.random.default_rng(0)
    equations = []
    for noise in (1.0, 5.0):
        rows = rng.normal(size=(8, 50, 7))
        rows[:, :, 6] = rows[:, :, :6] @ np.arange(1.0, 7.0) + noise * rng.normal(size=(8, 50))
        factors = np.linalg.qr(rows, mode="r")
        equations.append(EquationFactors(np.arange(6), factors, np.full(8, 50)))
    whole = Reduction(6, tuple(equations), np.arange(16.0).reshape(8, 2))
    smaller = marginalise_parameters(whole, 2)
    one, other = solve_weighted(whole), solve_weighted(smaller)
    np.testing.assert_allclose(other.values, one.values[2:], rtol=1e-4)
    np.testing.assert_allclose(
        statistics(smaller, other).standard_deviations, statistics(whole, one).standard_deviations[2:], rtol=0.1
    )
    alike = solve(whole, np.ones(2))
    plain = marginalise_parameters(whole, 2, weighted=False)
    np.testing.assert_allclose(solve_ordinary(plain).values, alike.values[2:], rtol=1e-9)
    np.testing.assert_allclose(
        compute_errors(plain, alike.values[2:]).squares, compute_errors(whole, alike.values).squares, rtol=1e-9
    )


@pytest.mark.slow
def test_a_payload_is_found_by_the_wrench_and_can_be_taken_out_again():
    robot = arm("ur10")
    box = np.array([0.02, 0.0, 0.0, 0.03, 0.0, 0.01, 0.1, 0.05, 0.2, 2.0])
    heavy = replace(robot, inertias=robot.inertias + np.vstack([np.zeros((5, 10)), box]))
    runs = [recorded(robot, 60.0, 200.0), recorded(heavy, 60.0, 200.0, seed=4, name="loaded")]
    choice = EffectChoice("payload", runs=("loaded",))
    found = identify(
        robot,
        runs,
        [],
        IdentificationChoices((*LINKS, choice), model="base_wrench", preprocessing=Preprocessing(None, 5.0, 5)),
    )
    named = {p.name: p for p in found.parameters}
    assert named["Mp6"].value == pytest.approx(2.0, rel=1e-3)
    truth = np.concatenate([robot.inertias.ravel(), box])
    assert error(found, found.model.base.grouping @ truth) < 1e-3
    smaller = remove(found, [choice])
    assert {p.effect for p in smaller.parameters} == {"rigid_body"}
    grown = extend(smaller, [choice], runs)
    np.testing.assert_allclose(grown.values, found.values, rtol=1e-3, atol=1e-3)


def test_block_borders_leave_no_trace_in_the_equations_of_the_wrench(monkeypatch):
    run = recorded(arm("scara"), 40.0, 200.0, windows=((2.0, 17.0), (19.0, 36.0)))
    whole = by_wrench(arm("scara"), [run]).data.equations
    monkeypatch.setattr("dynident.recordings.position_filter.READ_LENGTH", 777)
    monkeypatch.setattr(
        "dynident.recordings.low_pass_decimation.filtered_blocks",
        lambda *given, **more: filtered_blocks(*given, **more, block_length=331),
    )
    cut = by_wrench(arm("scara"), [run]).data.equations
    assert cut.n_rows == whole.n_rows
    for one, other in zip(cut.equations, whole.equations, strict=True):
        grams = [equation.whole_factor.T @ equation.whole_factor for equation in (one, other)]
        np.testing.assert_allclose(grams[0], grams[1], atol=1e-7 * np.abs(grams[1]).max())


def test_a_wrench_of_the_wrong_sign_is_suspected():
    robot = arm("scara")
    run = recorded(robot, 30.0, 200.0)
    rows = next(iter(run.source.rows(0, run.n_samples, run.n_samples)))
    t = np.arange(run.n_samples) / 200.0
    turned = recording_from_arrays(
        t, rows.q, rows.tau, joint_names=robot.joint_names, further=FurtherColumns(wrench=-rows.wrench)
    )
    right, wrong = (any("sign of the wrench" in w for w in by_wrench(robot, [r]).warnings) for r in (run, turned))
    assert wrong
    assert not right


def test_friction_is_refused_with_what_to_choose():
    robot = arm("scara")
    with pytest.raises(DynidentError, match="coulomb, rotor_inertia, viscous: not in the base wrench") as caught:
        identify(robot, [recorded(robot, 20.0, 200.0)], [], IdentificationChoices(model="base_wrench"))
    assert caught.value.pointer == "/effects/1"
    assert "rigid_body" in caught.value.detail


def test_a_recording_without_a_wrench_is_refused_by_name():
    robot = arm("scara")
    whole = recorded(robot, 20.0, 200.0)
    rows = next(iter(whole.source.rows(0, whole.n_samples, whole.n_samples)))
    t = np.arange(whole.n_samples) / 200.0
    bare = recording_from_arrays(t, rows.q, rows.tau, joint_names=robot.joint_names, name="bare")
    with pytest.raises(DynidentError, match="bare has no wrench of the base: record the columns base_fx") as caught:
        identify(robot, [whole, bare], [], IdentificationChoices(LINKS, model="base_wrench"))
    assert caught.value.pointer == "/recordings/1"
