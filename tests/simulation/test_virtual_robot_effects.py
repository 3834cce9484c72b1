"""The torque that a virtual robot measures is the links' and all its effects', and friction stays as sharp as it is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from support.virtual_arms import effort, fourier, plain_friction

from dynident.effects import CATALOGUE, EffectChoice, ReferenceParameters, Signals, build_columns
from dynident.effects.hysteresis_states import MemoryStates
from dynident.regressors.observation_matrix import FurtherSignals, Observation
from dynident.robot import Robot, robot_from_library, to_pinocchio
from dynident.simulation import (
    Sensors,
    SimulatedRecording,
    TrueEffect,
    VirtualRobot,
    Warming,
    add_warming,
    build_typical_effect,
    spread_over_joints,
)

PLAIN = {"rigid_body", "rotor_inertia", "coulomb", "viscous"}
# What leaves the motion as it is.
MEASURED = {
    "drive_gain_error", "drive_gain_saturation", "torque_delay", "encoder_zero_error", "kinematic_error", "backlash",
    "joint_elasticity",
}  # fmt: skip
INTERNAL = Sensors(sampling_rate=4000.0, encoder_counts=None, torque_noise=0.0)


def _hidden(robot: Robot, name: str) -> TrueEffect:
    """One effect of a size that shows, on joint 2, or on joint 4 where a rotor has to be carried."""
    if name == "rotor_coupling":
        return TrueEffect(name, robot.joint_names[3], (("NJ", 0.5),))
    if name == "external_contact":
        return TrueEffect(name, "", (("fz", 20.0), ("myh", 15.0)), (("t0", 1.0), ("t1", 2.0)))
    alone = CATALOGUE[name].scope == "robot" or len(CATALOGUE[name].get_default_joints(robot)) == 1
    joint = "" if alone else robot.joint_names[1]
    typical = build_typical_effect(robot, name, joint)
    return replace(typical, values=(*typical.values, ("cz", 0.03))) if name == "presliding" else typical


def _inverse(robot: Robot, effects: tuple[TrueEffect, ...], measured: SimulatedRecording) -> np.ndarray:
    """Torque (m, n) of links and effects at the true states, from the identification's own observation matrix."""
    signals, truth = Signals(robot), measured.truth
    columns = build_columns([EffectChoice("rigid_body"), *(effect.choice for effect in effects)], signals)
    observation = Observation.from_columns(robot, columns, signals)
    reference = ReferenceParameters.from_links(robot.inertias, robot.n)
    entries = observation.evaluate(
        truth.q,
        truth.dq,
        truth.ddq,
        reference=reference,
        memory=MemoryStates(observation.memory).push(truth.q),
        further=FurtherSignals(time=measured.t, temperature=measured.temperature, runs=np.ones(len(observation.runs))),
    )
    dense = np.zeros((len(truth.q), robot.n, len(columns)))
    dense[:, observation.entry_rows, observation.entry_columns] = entries
    values = list(robot.inertias.ravel())
    for effect in effects:
        named = dict(effect.values)
        values += [named.get(spec.name, 0.0) for spec in CATALOGUE[effect.effect].parameters]
    return dense @ np.array(values)


@pytest.mark.sweep
@pytest.mark.parametrize("name", sorted(set(CATALOGUE) - PLAIN - MEASURED))
def test_measured_torque_is_that_of_the_links_and_every_effect(name: str) -> None:
    robot = robot_from_library("ur10")
    effects = (*plain_friction(robot), _hidden(robot, name))
    warm = add_warming(fourier(robot, 3.0), Warming(40.0, 50.0, 2.0))
    measured = VirtualRobot(robot, effects).measure(warm, INTERNAL)
    truth = measured.truth
    error = measured.tau - _inverse(robot, effects, measured)
    moving = np.abs(truth.dq).min(axis=1) > 0.01
    moving &= np.abs(truth.dq[:, 1] + truth.dq[:, 2]) > 0.01
    assert np.count_nonzero(moving) > 1000
    assert np.sqrt(np.mean(error[moving] ** 2, axis=0)) == pytest.approx(np.zeros(6), abs=2e-4 * effort(robot).min())
    without = measured.tau - _inverse(robot, effects[:-1], measured)
    assert np.sqrt(np.mean(without[moving] ** 2, axis=0)).max() > 0.5


def test_friction_is_found_sharp_and_no_stribeck_effect_with_it() -> None:
    robot = robot_from_library("franka_panda")
    effects = plain_friction(robot)
    truth = VirtualRobot(robot, effects).measure(fourier(robot, 10.0), INTERNAL).truth
    model = to_pinocchio(robot)
    model.armature = 0.003 * effort(robot)
    data = model.createData()
    links = np.array([pin.rnea(model, data, *row) for row in zip(truth.q, truth.dq, truth.ddq, strict=True)])
    friction = truth.tau - links
    for j in range(robot.n):
        v = truth.dq[:, j]
        moving = np.abs(v) > 5e-3
        columns = np.column_stack([np.sign(v), v, np.exp(-((v / 0.03) ** 2)) * np.sign(v)])[moving]
        coulomb, viscous, stribeck = np.linalg.lstsq(columns, friction[moving, j], rcond=None)[0]
        assert coulomb == pytest.approx(0.04 * effort(robot)[j], rel=0.01)
        assert viscous == pytest.approx(0.03 * effort(robot)[j], rel=0.01)
        assert abs(stribeck) < 0.01 * coulomb


def test_a_joint_at_rest_under_friction_stays_where_it_is() -> None:
    robot = robot_from_library("ur10")
    still = fourier(robot, 2.0, amplitude=0.0)
    tilted = (*plain_friction(robot), TrueEffect("base_tilt", "", (("gx", 0.2),)))
    truth = VirtualRobot(robot, tilted).measure(still, INTERNAL).truth
    # The tilt is nothing that the feed-forward torque knows of; friction holds the arm against it.
    assert not np.any(truth.dq)
    assert np.array_equal(truth.q, np.repeat(truth.q[:1], len(truth.q), axis=0))


def test_presliding_rounds_the_reversal_over_the_slip_distance() -> None:
    robot = robot_from_library("ur10")
    slip = 4e-3
    presliding = TrueEffect("presliding", robot.joint_names[0], (("Fz", 10.0),), (("d0", slip),))
    truth = (
        VirtualRobot(robot, (presliding, *spread_over_joints(robot, "viscous", "Fv", [5.0] * 6)))
        .measure(fourier(robot, 5.0), INTERNAL)
        .truth
    )
    model = to_pinocchio(robot)
    data = model.createData()
    links = np.array([pin.rnea(model, data, *row) for row in zip(truth.q, truth.dq, truth.ddq, strict=True)])
    hysteresis = truth.tau[:, 0] - links[:, 0] - 5.0 * truth.dq[:, 0]
    turn = int(np.flatnonzero(np.diff(np.sign(truth.dq[4000:, 0])))[0]) + 4000
    travelled = np.abs(truth.q[turn:, 0] - truth.q[turn, 0])
    half = turn + int(np.argmax(travelled > slip))
    full = turn + int(np.argmax(travelled > 2.2 * slip))
    assert abs(hysteresis[turn]) == pytest.approx(10.0, rel=0.02)
    assert abs(hysteresis[half]) < 0.5
    assert hysteresis[full] == pytest.approx(-hysteresis[turn], rel=0.02)
