"""Link by link from the terminal link, and the wrist before the shoulder."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.noise_free_data import drawn_standard, reduced_states, states, torque_of
from support.oracles import arm, crooked_urdf, fourier_motion, record

from dynident.effects import EffectChoice
from dynident.errors import DynidentError
from dynident.estimation import EstimationError, compute_errors
from dynident.identification import IdentificationChoices, identify
from dynident.identification.equations.model_and_data_checks import find_undetermined_parameters
from dynident.identification.estimation_problem import Problem
from dynident.identification.strategies.sequential import (
    StepEstimates,
    find_wrist_joints,
    iterate_steps,
    select_joints,
    take_step,
)
from dynident.identification.strategies.solve_by_strategy import solve_by_strategy
from dynident.recordings import Preprocessing
from dynident.regressors.model_structure import build_model
from dynident.robot import robot_from_urdf

EFFECTS = tuple(EffectChoice(name) for name in ("rigid_body", "rotor_inertia", "coulomb", "viscous", "offset"))
STEPS = ("link_by_link", "wrist_then_shoulder")
UR10 = arm("ur10")
MODEL = build_model(UR10, EFFECTS)
NOISE = np.array([2.0, 2.0, 1.0, 0.5, 0.5, 0.5])


def choices(**more) -> IdentificationChoices:
    return IdentificationChoices(**{"effects": EFFECTS, "strategy": "sequential", **more})


def solved(model, asked, data):
    return solve_by_strategy(asked, Problem.from_choices(model, asked, data))


def step_of(data, joint, findings):
    asked = choices()
    return take_step(
        asked.solver, Problem.from_choices(MODEL, asked, data), select_joints(data.equations, (joint,)), findings
    )


@pytest.mark.sweep
@pytest.mark.parametrize("steps", STEPS)
@pytest.mark.parametrize("estimator", ["ols", "wls"])
@pytest.mark.parametrize("name", ["ur10", "franka_panda", "scara", "dual_arm", "crooked"])
def test_exact_torque_gives_the_true_base_parameters(name, estimator, steps):
    robot = arm(name)
    model = build_model(robot, EFFECTS)
    motion, standard = states(robot), drawn_standard(robot)
    data = reduced_states(model, [(motion, torque_of(robot, motion, standard))])
    truth = model.base.grouping @ standard
    found = solved(model, choices(estimator=estimator, steps=steps), data)
    assert np.abs(found.solution.values - truth).max() < 1e-8 * np.abs(truth).max()


@given(n=st.integers(1, 7), seed=st.integers(0, 10_000), data=st.data())
@settings(max_examples=25, deadline=None)
@pytest.mark.slow
def test_random_robots_are_identified_link_by_link(n, seed, data):
    sliding = tuple(k for k in range(n) if data.draw(st.booleans()))
    parents = tuple(data.draw(st.integers(-1, k - 1)) for k in range(n))
    robot = robot_from_urdf("random", crooked_urdf(n, seed, sliding, parents))
    model = build_model(robot, EFFECTS)
    motion, standard = states(robot, seed=seed), drawn_standard(robot, seed)
    reduced = reduced_states(model, [(motion, torque_of(robot, motion, standard))])
    truth = model.base.grouping @ standard
    for steps in STEPS:
        found = solved(model, choices(steps=steps), reduced)
        assert np.abs(found.solution.values - truth).max() < 1e-8 * np.abs(truth).max()


def test_the_first_step_is_the_terminal_joints_equation_alone():
    motion, standard = states(UR10), drawn_standard(UR10)
    tau = torque_of(UR10, motion, standard)
    tau += NOISE * np.random.default_rng(3).normal(size=tau.shape)
    data = reduced_states(MODEL, [(motion, tau)])
    last = data.equations.equations[5]
    k = len(last.columns)
    alone = np.zeros(MODEL.n_parameters)
    alone[last.columns] = np.linalg.lstsq(last.whole_factor[:, :k], last.whole_factor[:, k])[0]
    found = step_of(data, 5, StepEstimates.empty(MODEL.n_parameters)).findings
    assert len(found.values) == k
    np.testing.assert_allclose(found.values, found.functions @ alone, rtol=1e-6, atol=1e-9)
    # What one joint's equation has said no later one changes.
    second = step_of(data, 4, found).findings
    np.testing.assert_array_equal(second.values[:k], found.values)
    np.testing.assert_array_equal(second.covariance[:k, :k], found.covariance)


@pytest.mark.slow
@pytest.mark.parametrize("steps", STEPS)
def test_stated_deviations_are_those_of_repeated_experiments(steps):
    """The covariance carried from step to step, against the scatter of the estimates over many draws of the noise."""
    motion, standard = states(UR10, 300, 4), drawn_standard(UR10)
    exact = torque_of(UR10, motion, standard)
    truth = MODEL.base.grouping @ standard
    rng = np.random.default_rng(8)
    signs = rng.choice([-1.0, 1.0], (50, len(truth)))
    draws, stated, covariances, widths = [], [], [], []
    for _ in range(60):
        data = reduced_states(MODEL, [(motion, exact + NOISE * rng.normal(size=exact.shape))])
        found = solved(MODEL, choices(steps=steps), data)
        error = found.solution.values - truth
        draws.append(error)
        stated.append(found.statistics.standard_deviations)
        covariances.append(found.statistics.covariance)
        widths.append(found.statistics.half_widths())
    ratio = np.mean(stated, axis=0) / np.std(draws, axis=0)
    assert 0.85 < np.median(ratio) < 1.3
    assert ratio.min() > 0.6
    # With the correlation between steps: sums over all parameters, each of which counts alike, are as far off as is
    # stated. A covariance from a few blocks of time has no inverse.
    forms = signs / np.std(draws, axis=0)
    squares = np.mean((forms @ np.transpose(draws)) ** 2, axis=1)
    assert 0.6 < np.median(squares / np.einsum("fk,kl,fl->f", forms, np.mean(covariances, axis=0), forms)) < 1.2
    covered = np.mean(np.abs(draws) < np.array(widths))
    assert 0.92 < covered < 0.99


def test_what_is_uncertain_in_earlier_steps_weighs_less_in_later_ones():
    """Against holding the earlier estimates for exact, which is the plain sequential method [12.24]."""
    motion, standard = states(UR10, 200, 4), drawn_standard(UR10)
    exact = torque_of(UR10, motion, standard)
    truth = MODEL.base.grouping @ standard
    noise = np.array([0.2, 0.2, 0.2, 2.0, 2.0, 2.0])
    rng = np.random.default_rng(1)
    weighted, plain = [], []
    for _ in range(10):
        data = reduced_states(MODEL, [(motion, exact + noise * rng.normal(size=exact.shape))])
        found = solved(MODEL, choices(), data)
        scale = found.statistics.standard_deviations
        weighted.append((found.solution.values - truth) / scale)
        plain.append((_held_for_exact(data) - truth) / scale)
    assert np.sqrt(np.mean(np.square(weighted))) < 0.8 * np.sqrt(np.mean(np.square(plain)))


def _held_for_exact(data) -> np.ndarray:
    values, known = np.zeros(MODEL.n_parameters), np.zeros(MODEL.n_parameters, dtype=bool)
    for joint in reversed(range(UR10.n)):
        equation = data.equations.equations[joint]
        k = len(equation.columns)
        w, y = equation.whole_factor[:, :k], equation.whole_factor[:, k]
        new = ~known[equation.columns]
        rest = y - w[:, ~new] @ values[equation.columns[~new]]
        values[equation.columns[new]] = np.linalg.lstsq(w[:, new], rest, rcond=1e-10)[0]
        known[equation.columns] = True
    return values


def test_combinations_that_one_equation_does_not_separate_wait_for_the_next():
    """A link that turns about its joint's axis only by that joint shows the sum of its inertia and the rotor's."""
    standard = drawn_standard(UR10)
    truth = MODEL.base.grouping @ standard
    motions = [states(UR10, seed=1, still=(0, 1, 2, 3, 4)), states(UR10, seed=2)]
    alone, both = (
        reduced_states(MODEL, [(motion, torque_of(UR10, motion, standard)) for motion in motions[:k]]) for k in (1, 2)
    )
    # Joint 6 has torque in the first run alone, where nothing else moves.
    equations = (*both.equations.equations[:5], alone.equations.equations[5])
    data = replace(both, equations=replace(both.equations, equations=equations))
    step = step_of(data, 5, StepEstimates.empty(MODEL.n_parameters))
    equation = data.equations.equations[5]
    assert 0 < len(step.findings.values) < len(equation.columns)
    np.testing.assert_allclose(step.findings.values, step.findings.functions @ truth, rtol=1e-9)
    found = solved(MODEL, choices(), data)
    assert np.abs(found.solution.values - truth).max() < 1e-7 * np.abs(truth).max()


def test_runs_with_a_locked_wrist_and_runs_of_the_wrist_alone_are_identified_together():
    """Sets of special motions [Vandanjon 95]: no run shows all parameters, all of them together do."""
    standard = drawn_standard(UR10)
    truth = MODEL.base.grouping @ standard
    sets = [(3, 4, 5), (0, 1, 2), (0, 4), (1, 3, 5)] * 3
    motions = [states(UR10, 100, seed, still) for seed, still in enumerate(sets)]
    runs = [(motion, torque_of(UR10, motion, standard)) for motion in motions]
    for one in runs:
        assert find_undetermined_parameters(MODEL, reduced_states(MODEL, [one]).equations)
    data = reduced_states(MODEL, runs)
    for strategy in ("global", "sequential"):
        found = solved(MODEL, choices(strategy=strategy), data)
        assert np.abs(found.solution.values - truth).max() < 1e-7 * np.abs(truth).max()


def test_noisy_recordings_are_predicted_nearly_as_well_as_by_the_global_strategy():
    motions = [fourier_motion(UR10, duration, 100.0, seed) for duration, seed in ((20.0, 1), (12.0, 2))]
    standard = drawn_standard(UR10)
    rng = np.random.default_rng(5)
    runs = [
        record(UR10, motion, torque_of(UR10, motion, standard) + NOISE * rng.normal(size=motion.q.shape), name)
        for motion, name in zip(motions, ("training", "validation"), strict=True)
    ]
    band = Preprocessing(10.0, 8.0, 3)
    whole = identify(UR10, runs[:1], runs[1:], choices(strategy="global", preprocessing=band))
    for steps in STEPS:
        found = identify(UR10, runs[:1], runs[1:], choices(steps=steps, preprocessing=band))
        assert found.held_out.relative_total < 1.15 * whole.held_out.relative_total
        np.testing.assert_array_equal(compute_errors(found.data.training, found.values).squares, found.fit.squares)
        np.testing.assert_allclose(found.noise, found.fit.rms, rtol=0.1)
        assert (found.effective_rows > 50).all()
        assert (found.effective_rows <= found.n_equations / UR10.n).all()


def test_the_wrist_are_the_last_three_joints_of_every_arm():
    assert find_wrist_joints(UR10) == (3, 4, 5)
    assert find_wrist_joints(arm("franka_panda")) == (4, 5, 6)
    assert find_wrist_joints(arm("scara")) == (2, 3)
    assert find_wrist_joints(robot_from_urdf("one", crooked_urdf(1, sliding=()))) == ()
    two_arms = robot_from_urdf("two", crooked_urdf(9, sliding=(), parents=(-1, 0, 1, 2, 3, 0, 5, 6, 7)))
    assert find_wrist_joints(two_arms) == (3, 4, 7, 8)
    assert list(iterate_steps(UR10, "wrist_then_shoulder")) == [(3, 4, 5), (0, 1, 2)]
    assert list(iterate_steps(UR10, "link_by_link")) == [(5,), (4,), (3,), (2,), (1,), (0,)]


@pytest.mark.parametrize(
    ("more", "pointer", "word"),
    [({"estimator": "feasible"}, "/estimator", "feasible"), ({"model": "power"}, "/strategy", "power")],
)
def test_choices_that_cannot_be_taken_in_steps_are_refused(more, pointer, word):
    motion, standard = states(UR10), drawn_standard(UR10)
    data = reduced_states(MODEL, [(motion, torque_of(UR10, motion, standard))])
    with pytest.raises(DynidentError, match=word) as caught:
        solved(MODEL, choices(**more), data)
    assert caught.value.pointer == pointer
    assert "global" in caught.value.detail


def test_a_locked_joint_is_named():
    motion = fourier_motion(UR10, 10.0, 100.0, 1)
    motion.q[:, 2], motion.dq[:, 2], motion.ddq[:, 2] = 0.3, 0.0, 0.0
    run = record(UR10, motion, torque_of(UR10, motion, drawn_standard(UR10)))
    with pytest.raises(EstimationError, match="Fc3"):
        identify(UR10, [run], [], choices(preprocessing=Preprocessing(10.0, 8.0, 3)))


def test_torque_that_is_zero_throughout_is_refused():
    motion = fourier_motion(UR10, 10.0, 100.0, 1)
    run = record(UR10, motion, np.zeros_like(motion.q))
    for strategy in ("global", "sequential"):
        with pytest.raises(EstimationError, match="torque") as caught:
            identify(UR10, [run], [], choices(strategy=strategy, preprocessing=Preprocessing(10.0, 8.0, 3)))
        assert caught.value.pointer == "/recordings"


def locked_run(still, seed: int, name: str, standard):
    """A run whose locked joints are held by brakes and stiction, and whose encoders flicker by a count."""
    motion = fourier_motion(UR10, 12.0, 100.0, seed)
    rng = np.random.default_rng(seed)
    for joint in still:
        motion.q[:, joint], motion.dq[:, joint], motion.ddq[:, joint] = rng.uniform(-1, 1), 0.0, 0.0
    tau = torque_of(UR10, motion, standard) + 0.2 * rng.normal(size=motion.q.shape)
    tau[:, list(still)] += rng.uniform(-20, 20, len(still))
    return record(UR10, motion, tau, name), motion.q + 1e-5 * rng.integers(-1, 2, motion.q.shape)


def test_joints_that_are_locked_in_some_runs_tell_nothing_of_their_friction_there():
    standard = drawn_standard(UR10)
    sets = [(3, 4, 5), (0, 1, 2), (0, 4), (1, 3, 5), (), ()]
    runs = []
    for seed, still in enumerate(sets):
        clean, flickering = locked_run(still, seed, f"run{seed}", standard)
        runs.append(record(UR10, fourier_motion(UR10, 12.0, 100.0, seed), clean.source.tau, clean.name))
        runs[-1] = replace(runs[-1], source=replace(clean.source, q=flickering))
    band = Preprocessing(10.0, 8.0, 3)
    for strategy in ("global", "sequential"):
        found = identify(UR10, runs, [], choices(strategy=strategy, preprocessing=band))
        truth = found.model.base.grouping @ standard
        assert np.median(np.abs(found.values - truth) / found.statistics.standard_deviations) < 1.5
        friction = np.array([c.effect in ("coulomb", "viscous") for c in found.model.kept])
        np.testing.assert_allclose(found.values[friction], truth[friction], rtol=0.15)
        # Where a joint is locked there are no rows of it: in two, three or four of six runs it moves.
        rows = np.array([equation.counts.sum() for equation in found.data.training.equations])
        moves = np.array([sum(joint not in still for still in sets) for joint in range(6)])
        np.testing.assert_allclose(rows / rows.max(), moves / moves.max(), rtol=0.02)
