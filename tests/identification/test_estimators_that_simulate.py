"""Instrumental variables and output error from a simulated robot, on torque of Pinocchio and noisy encoders."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.oracles import arm, fourier_motion, pinocchio_torque, record

from dynident.effects import EffectChoice, ReferenceParameters
from dynident.errors import DynidentError
from dynident.estimation import solve_ordinary, statistics
from dynident.identification import IdentificationChoices, identify, remove
from dynident.identification.equations.reduced_recordings import reduce_torque
from dynident.identification.estimation_problem import Problem
from dynident.identification.estimators.identified_robot_simulator import (
    align_commanded_motion,
    build_movable_simulator,
    read_whole_segments,
    simulate_recording,
)
from dynident.identification.estimators.instrumental_variables_and_output_error import (
    estimate_by_instrumental_variables,
)
from dynident.recordings import Preprocessing
from dynident.regressors.model_structure import build_model
from dynident.regressors.observation_matrix import RegressorInputs

NAMES = ("rigid_body", "rotor_inertia", "coulomb", "viscous", "offset")
EFFECTS = tuple(EffectChoice(name) for name in NAMES)
RATE = 200.0
WIDE = Preprocessing(40.0, 20.0, 2)


class Arm:
    """A robot with drives, a motion of it, and the torque of Pinocchio along it."""

    def __init__(self, name: str, duration: float, seed: int = 3) -> None:
        self.robot = arm(name)
        self.motion = fourier_motion(self.robot, duration, RATE, seed)
        self.drives = np.random.default_rng(0).uniform(0.5, 5.0, (4, self.robot.n))
        ia, fc, fv, b = self.drives
        m = self.motion
        rigid = pinocchio_torque(self.robot, m.q, m.dq, m.ddq)
        self.tau = rigid + ia * m.ddq + fc * np.sign(m.dq) + fv * m.dq + b
        self.model = build_model(self.robot, EFFECTS)
        standard = np.concatenate([self.robot.inertias.reshape(-1), self.drives.ravel()])
        self.truth = self.model.base.grouping @ standard

    def recorded(self, seed: int = 0, encoder: float = 0.0, noise: float | np.ndarray = 0.0):
        rng = np.random.default_rng(seed)
        q = self.motion.q + encoder * rng.normal(size=self.motion.q.shape)
        tau = self.tau + noise * rng.normal(size=q.shape)
        return record(self.robot, replace(self.motion, q=q), tau)


SMALL = Arm("scara", 12.0)


def choices(estimator: str, **more) -> IdentificationChoices:
    return IdentificationChoices(effects=EFFECTS, estimator=estimator, **{"preprocessing": WIDE, **more})


def test_the_simulated_robot_follows_the_recorded_motion_with_the_true_accelerations():
    recording = SMALL.recorded()
    simulator = build_movable_simulator(SMALL.model, SMALL.truth)
    motion = simulate_recording(simulator, recording, read_whole_segments(recording, Preprocessing(40.0, None, 1)))
    (q, dq, ddq), inner = motion.segments[0], slice(40, -40)
    assert q.shape == SMALL.motion.q.shape
    assert np.abs(q - SMALL.motion.q)[inner].max() < 2e-3
    for simulated, true in ((dq, SMALL.motion.dq), (ddq, SMALL.motion.ddq)):
        rest = (simulated - true)[inner]
        assert np.sqrt(np.mean(rest**2)) < 0.1 * np.sqrt(np.mean(true**2))


def test_where_no_robot_has_the_first_estimate_the_links_of_the_description_are_simulated_with_friction_that_brakes():
    simulator = build_movable_simulator(SMALL.model, -SMALL.truth)
    assert np.array_equal(simulator.robot.inertias, SMALL.robot.inertias)
    assert not any(one.effect == "rotor_inertia" for one in simulator.robot.effects)
    friction = [value for one in simulator.robot.effects for name, value in one.values if name in ("Fc", "Fv")]
    assert friction == [0.0] * (2 * SMALL.robot.n)
    said = {c.name: v for c, v in zip(SMALL.model.kept, simulator.values, strict=True)}
    assert said["b1"] == pytest.approx(-SMALL.drives[3, 0])


def test_where_the_description_has_no_inertias_either_nothing_is_simulated_and_the_error_says_what_to_do():
    bare = build_model(replace(SMALL.robot, inertias=None), EFFECTS)
    with pytest.raises(DynidentError, match="Use wls or feasible") as caught:
        build_movable_simulator(bare, -bare.base.grouping @ np.ones(len(bare.columns)))
    assert caught.value.pointer == "/estimator"


@pytest.mark.parametrize(("estimator", "least"), [("iv", 1e-3), ("didim", 2e-2)])
def test_without_noise_the_estimates_are_the_true_parameters(estimator, least):
    found = identify(SMALL.robot, [SMALL.recorded()], [], choices(estimator))
    # As torque: a metre per second of the sliding joint is not to be held against a radian per second.
    torque = found.estimate.solution.scales
    assert np.abs((found.values - SMALL.truth) * torque).max() < least * np.abs(SMALL.truth * torque).max()
    assert found.fit.relative_total < least
    said = found.warnings[0]
    assert "converged after" in said
    assert "not converge" not in said


def test_the_user_is_told_what_was_simulated_and_how_strong_the_instruments_are():
    found = identify(SMALL.robot, [SMALL.recorded(1, 1e-4, 0.2)], [], choices("iv"))
    assert "15 Hz of control bandwidth" in found.warnings[0]
    assert "weakest correlation" in found.warnings[0]


def test_two_segments_are_simulated_one_by_one():
    m = SMALL.motion
    half = len(m.t) // 2
    segment = np.where(np.arange(len(m.t)) < half, 1, 2)
    t = m.t + np.where(segment == 2, 100.0, 0.0)
    two = record(SMALL.robot, replace(m, t=t), SMALL.tau, segment=segment)
    found = identify(SMALL.robot, [two], [], choices("iv"))
    assert np.abs(found.values - SMALL.truth).max() < 1e-2 * np.abs(SMALL.truth).max()


@pytest.mark.parametrize("estimator", ["iv", "didim"])
def test_without_the_recordings_there_is_nothing_to_simulate_and_the_error_says_so(estimator):
    found = identify(SMALL.robot, [SMALL.recorded(2, 0.0, 0.2)], [], choices(estimator))
    with pytest.raises(DynidentError, match="needs the recordings themselves") as caught:
        remove(found, [EffectChoice("offset")])
    assert caught.value.pointer == "/estimator"


@pytest.mark.slow
def test_instrumental_variables_remove_the_bias_that_encoder_noise_leaves_in_least_squares():
    big, runs = Arm("ur10", 20.0), 10
    noise = np.array([2.0, 2.0, 1.0, 0.5, 0.5, 0.5])
    least, least_deviations, found, deviations = [], [], [], []
    for seed in range(runs):
        data = reduce_torque(
            big.model, RegressorInputs([big.recorded(seed, 1e-4, noise)], WIDE, ReferenceParameters.massless(big.robot))
        )
        plain = solve_ordinary(data.equations)
        least.append(plain.values)
        least_deviations.append(statistics(data.equations, plain).standard_deviations)
        fit = estimate_by_instrumental_variables(Problem.from_choices(big.model, choices("iv"), data))
        found.append(fit.solution.values)
        deviations.append(fit.statistics.standard_deviations)
    plain_bias = np.abs(np.mean(least, axis=0) - big.truth) / np.mean(least_deviations, axis=0)
    bias = np.abs(np.mean(found, axis=0) - big.truth) / np.mean(deviations, axis=0)
    biased = plain_bias > 3.0
    assert biased.sum() >= 8
    assert bias[biased].max() < 2.0
    assert bias.max() < 2.0
    # Not because the standard deviations had become large: a single run is nearer to the truth, too.
    errors = [np.sqrt(np.mean((np.array(runs_) - big.truth) ** 2, axis=0))[biased] for runs_ in (least, found)]
    assert np.median(errors[1] / errors[0]) < 0.5
    # Held against the spread of the estimates themselves, which knows nothing of our statistics.
    spread = np.std(found, axis=0, ddof=1)
    assert np.sqrt(np.mean(((np.mean(found, axis=0) - big.truth) / (spread / np.sqrt(runs))) ** 2)) < 4.0


def commanded_run(late: float = 0.0, encoder: float = 0.0, noise: float = 0.0, seed: int = 0, wrong: float = 1.0):
    """A run of the small arm that follows its command so many seconds later; `wrong`: the command's scale."""
    told, made = SMALL.motion, SMALL.recorded(seed, encoder, noise)
    rows = next(made.source.rows(0, made.n_samples, made.n_samples))
    t = told.t + late
    command = wrong * np.column_stack([np.interp(t, told.t, told.q[:, joint]) for joint in range(SMALL.robot.n)])
    return record(SMALL.robot, replace(told, q=rows.q), rows.tau, command=command)


@pytest.mark.parametrize("late", [0.0, 0.03])
def test_the_command_is_brought_as_late_as_the_motion(late):
    found = align_commanded_motion(commanded_run(late, 1e-4), Preprocessing(40.0, None, 1))
    np.testing.assert_allclose(found.delay, late, atol=1e-3)
    assert found.is_followed


@pytest.mark.parametrize("estimator", ["iv", "didim"])
def test_a_robot_that_follows_its_command_late_is_identified_from_the_command(estimator):
    found = identify(SMALL.robot, [commanded_run(0.02)], [], choices(estimator))
    assert "the commanded positions, delayed by up to 20 ms" in found.warnings[0]
    torque = found.estimate.solution.scales
    assert np.abs((found.values - SMALL.truth) * torque).max() < 2e-2 * np.abs(SMALL.truth * torque).max()


def test_with_a_command_the_noise_of_encoders_does_not_reach_what_output_error_finds():
    runs = [commanded_run(0.01, encoder, 0.1) for encoder in (0.0, 2e-3)]
    quiet, noisy = (identify(SMALL.robot, [run], [], choices("didim")) for run in runs)
    # Along the measured positions it changes by ten standard deviations.
    assert np.abs((noisy.values - quiet.values) / quiet.statistics.standard_deviations).max() < 2.0


def test_a_command_that_the_robot_did_not_follow_is_left_out_with_a_warning():
    found = identify(SMALL.robot, [commanded_run(wrong=0.7)], [], choices("iv"))
    assert any("commanded positions of run are not used" in warning for warning in found.warnings)
    assert "measured positions below" in found.warnings[0]


def test_a_command_with_holes_is_left_out_with_a_warning():
    run = commanded_run()
    command = SMALL.motion.q.copy()
    command[500, 1] = np.nan
    rows = next(run.source.rows(0, run.n_samples, run.n_samples))
    holes = record(SMALL.robot, replace(SMALL.motion, q=rows.q), rows.tau, command=command)
    found = identify(SMALL.robot, [holes], [], choices("iv"))
    assert any("not all of them are numbers" in warning for warning in found.warnings)


@pytest.mark.parametrize("estimator", ["iv", "didim", "wls"])
def test_a_known_value_is_held_whatever_is_simulated(estimator: str):
    recording, names = SMALL.recorded(encoder=1e-5, noise=0.05), [column.name for column in SMALL.model.kept]
    known = {name: float(SMALL.truth[names.index(name)]) for name in ("Fc1", "Fv2", "b2")}
    fixed = identify(SMALL.robot, [recording], choices=choices(estimator, known=known))
    held = [names.index(name) for name in known]
    assert dict(zip(known, fixed.values[held], strict=True)) == known
    assert not fixed.statistics.covariance[held].any()
    free = [k for k in range(len(names)) if k not in held]
    errors = np.abs(fixed.values - SMALL.truth)[free] / fixed.statistics.standard_deviations[free]
    assert errors.max() < 6.0
