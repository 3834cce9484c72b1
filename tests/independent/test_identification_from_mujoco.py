"""The identification on recordings of another engine: what it finds is what was put in."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest
from engine import Arm, FloatArray, Instruments, Run, fourier_motion, record, usual_drives

from dynident.identification import Identification, IdentificationChoices, identify
from dynident.recordings import Recording, low_pass, recording_from_arrays
from dynident.robot import robot_from_library

pytestmark = pytest.mark.slow

ARMS = ("franka_panda", "ur10")


@dataclass(frozen=True)
class Case:
    arm: Arm
    identification: Identification
    validation: Run


def _record(arm: Arm, seed: int, instruments: Instruments | None = None) -> tuple[Recording, Run]:
    run = record(arm, fourier_motion(arm.robot, 24.0, seed), instruments, seed)
    return recording_from_arrays(run.t, run.q, run.tau, joint_names=arm.robot.joint_names, name=f"run {seed}"), run


@cache
def _case(name: str) -> Case:
    robot = robot_from_library(name)
    arm = Arm(robot, usual_drives(robot))
    training = [_record(arm, seed)[0] for seed in (1, 2)]
    held_out, run = _record(arm, 3)
    return Case(arm, identify(robot, training, [held_out], IdentificationChoices(estimator="wls")), run)


def _floor(case: Case) -> FloatArray:
    """What the parallel filter leaves of the torque noise (n,): no model can do better."""
    taps = low_pass(1000.0, case.identification.preprocessing.torque_cutoff)
    return case.validation.noise * float(np.sqrt((taps**2).sum()))


@pytest.mark.parametrize("name", ARMS)
def test_held_out_torque_is_predicted_down_to_the_noise(name: str) -> None:
    case = _case(name)
    assert case.identification.held_out_moving is not None
    ratio = case.identification.held_out_moving.rms / _floor(case)
    assert ratio.min() > 0.9
    assert np.median(ratio) < 1.15
    # Where a light joint sticks at a reversal, sign(q̇) is not the truth: above the noise, though not by much.
    assert ratio.max() < 1.8


@pytest.mark.parametrize("name", ARMS)
def test_friction_and_rotor_inertia_are_found_within_three_percent(name: str) -> None:
    case = _case(name)
    drives = case.arm.drives
    true = {"Fc": drives.coulomb, "Fv": drives.viscous}
    checked = 0
    for parameter in case.identification.parameters:
        kind = parameter.name[:2]
        if kind in true and parameter.effect in ("coulomb", "viscous"):
            expected = true[kind][case.arm.robot.joint_names.index(parameter.link)]
            assert parameter.value == pytest.approx(expected, rel=0.03), parameter.name
            checked += 1
    assert checked == 2 * case.arm.robot.n


@pytest.mark.parametrize("name", ARMS)
def test_base_parameters_are_those_of_the_engine(name: str) -> None:
    case = _case(name)
    found, model = case.identification, case.identification.model
    robot, drives = case.arm.robot, case.arm.drives
    assert robot.inertias is not None
    of = {"rotor_inertia": drives.rotor, "coulomb": drives.coulomb, "viscous": drives.viscous}
    standard = np.array(
        [
            robot.inertias[robot.joint_names.index(c.link)][_INERTIAL.index(c.parameter)]
            if c.effect == "rigid_body"
            else of[c.effect][robot.joint_names.index(c.link)]
            for c in model.columns
        ]
    )
    true = model.base.grouping @ standard
    gap = np.abs(found.values - true) / found.statistics.standard_deviations
    # Standard deviations speak of noise; the friction of a sticking joint adds a little that is not.
    assert np.sqrt(np.mean(gap**2)) < 2.5
    known = found.statistics.relative_standard_deviations(found.values) < 0.1
    assert np.count_nonzero(known) > 0.5 * len(known)
    assert np.median(np.abs(found.values - true)[known] / np.abs(true)[known]) < 0.01


_INERTIAL = ("XX", "XY", "XZ", "YY", "YZ", "ZZ", "MX", "MY", "MZ", "M")


@pytest.mark.parametrize("name", ARMS)
def test_without_noise_and_quantisation_hardly_any_error_is_left(name: str) -> None:
    robot = robot_from_library(name)
    arm = Arm(robot, usual_drives(robot))
    exact = Instruments(counts=2**40, noise=0.0)
    training, (held_out, _) = [_record(arm, seed, exact)[0] for seed in (1, 2)], _record(arm, 3, exact)
    found = identify(robot, training, [held_out])
    assert found.held_out is not None
    assert found.held_out.relative_total < 0.0025
