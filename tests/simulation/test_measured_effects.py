"""Effects that are a matter of what is measured, and several runs in one measurement."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from support.oracles import pinocchio_torque
from support.virtual_arms import fourier, plain_friction

from dynident.errors import DynidentError
from dynident.recordings import JointLimits, RecordedJoints, RecordingMetadata, import_recording
from dynident.robot import Robot, robot_from_library
from dynident.simulation import (
    Reference,
    Sensors,
    SimulatedRecording,
    SimulationRequest,
    TrueEffect,
    VirtualRobot,
    Warming,
    add_warming,
    build_typical_effect,
    simulate,
    spread_over_joints,
    write_simulated_recording,
)

EXACT = Sensors(sampling_rate=1000.0, encoder_counts=None, torque_noise=0.0)
JOINT = 1


@pytest.fixture(scope="module")
def robot() -> Robot:
    return robot_from_library("ur10")


@pytest.fixture(scope="module")
def reference(robot: Robot) -> Reference:
    return fourier(robot, 3.0)


def measured(robot: Robot, reference: Reference, *effects: TrueEffect) -> SimulatedRecording:
    """What is measured of a robot without dry friction, whose motion is smooth."""
    viscous = spread_over_joints(robot, "viscous", "Fv", [5.0] * robot.n)
    return VirtualRobot(robot, (*viscous, *effects)).measure(reference, EXACT)


def on_joint(robot: Robot, effect: str, value: dict[str, float], shape: dict[str, float] | None = None) -> TrueEffect:
    return TrueEffect(effect, robot.joint_names[JOINT], tuple(value.items()), tuple((shape or {}).items()))


def share(found: np.ndarray, expected: np.ndarray) -> float:
    """Largest difference over the largest value, on rows that are clear of the ends."""
    return float(np.abs(found - expected)[100:-100].max() / np.abs(expected).max())


@pytest.mark.parametrize("effect", ["drive_gain_error", "torque_delay", "encoder_zero_error", "joint_elasticity"])
def test_the_motion_is_as_it_is_without_them(robot: Robot, reference: Reference, effect: str) -> None:
    joint = "" if effect == "torque_delay" else robot.joint_names[JOINT]
    found, plain = measured(robot, reference, build_typical_effect(robot, effect, joint)), measured(robot, reference)
    np.testing.assert_array_equal(found.q, plain.q)
    np.testing.assert_array_equal(found.truth.tau, plain.truth.tau)
    assert np.abs(found.tau - plain.tau).max() > 0.5


def test_a_gain_that_is_off_scales_the_whole_torque_of_its_joint(robot: Robot, reference: Reference) -> None:
    found = measured(robot, reference, on_joint(robot, "drive_gain_error", {"eps": 0.05}))
    np.testing.assert_allclose(found.tau[:, JOINT], 1.05 * found.truth.tau[:, JOINT], rtol=1e-12)
    others = np.delete(found.tau, JOINT, axis=1)
    np.testing.assert_array_equal(others, np.delete(found.truth.tau, JOINT, axis=1))


def test_a_saturating_motor_bends_the_torque(robot: Robot, reference: Reference) -> None:
    found = measured(robot, reference, on_joint(robot, "drive_gain_saturation", {"sat": -4e-4}))
    tau = found.truth.tau[:, JOINT]
    np.testing.assert_allclose(found.tau[:, JOINT], tau * (1 - 4e-4 * np.abs(tau)), rtol=1e-12)


def test_late_torque_is_that_of_an_earlier_instant_with_its_jumps(robot: Robot, reference: Reference) -> None:
    late = TrueEffect("torque_delay", "", (("delay", 0.012),))
    found = VirtualRobot(robot, (*plain_friction(robot), late)).measure(reference, EXACT)
    np.testing.assert_allclose(found.tau[12:], found.truth.tau[:-12], atol=1e-9)
    assert np.abs(found.tau - found.truth.tau).max() > 1.0


@pytest.mark.parametrize(
    ("effect", "values"),
    [("drive_gain_error", {"eps": -0.3}), ("drive_gain_error", {"eps": 0.9}), ("drive_gain_error", {"eps": 1.5}),
     ("drive_gain_saturation", {"sat": 1e-3}), ("torque_delay", {"delay": 0.012}),
     ("encoder_zero_error", {"dq0": 1e-3})],
)  # fmt: skip
def test_the_torque_of_the_motors_is_recovered_from_what_sensors_show(
    robot: Robot, reference: Reference, effect: str, values: dict[str, float]
) -> None:
    joint = "" if effect == "torque_delay" else robot.joint_names[JOINT]
    gain = TrueEffect("drive_gain_error", robot.joint_names[2], (("eps", 0.05),))
    viscous = spread_over_joints(robot, "viscous", "Fv", [5.0] * robot.n)
    arm = VirtualRobot(robot, (*viscous, gain, TrueEffect(effect, joint, tuple(values.items()))))
    found = arm.measure(reference, EXACT)
    motion = Reference(found.t, found.truth.q, found.truth.dq, found.truth.ddq)
    recovered = arm.sensing.recover_motor_torque(motion, found.tau, "")
    assert share(found.tau, found.truth.tau) > 1e-3
    assert share(recovered, found.truth.tau) < 1e-6


def test_torque_that_no_motor_gives_is_refused(robot: Robot, reference: Reference) -> None:
    # A drive that shows a tenth less for each N m shows at most 2.5 N m.
    arm = VirtualRobot(robot, (on_joint(robot, "drive_gain_saturation", {"sat": -0.1}),))
    motion = arm.measure(reference, EXACT).truth
    given = Reference(np.arange(len(motion.q)) * 1e-3, motion.q, motion.dq, motion.ddq)
    with pytest.raises(DynidentError, match="too large"):
        arm.sensing.recover_motor_torque(given, np.full_like(motion.tau, 50.0), "")


def test_an_encoder_that_is_off_shows_the_torque_of_the_true_position(robot: Robot, reference: Reference) -> None:
    found = measured(robot, reference, on_joint(robot, "encoder_zero_error", {"dq0": 1e-3}))
    q = found.truth.q.copy()
    q[:, JOINT] += 1e-3
    true, shown = (pinocchio_torque(robot, p, found.truth.dq, found.truth.ddq) for p in (q, found.truth.q))
    assert share(found.tau - found.truth.tau, true - shown) < 2e-3


def test_a_link_that_is_longer_shows_the_torque_of_its_true_length(robot: Robot, reference: Reference) -> None:
    found = measured(robot, reference, on_joint(robot, "kinematic_error", {"dx": 1e-4, "dz": -2e-4}))
    placement = robot.joints[JOINT].placement.copy()
    placement[:3, 3] += [1e-4, 0.0, -2e-4]
    joints = list(robot.joints)
    joints[JOINT] = replace(joints[JOINT], placement=placement)
    state = (found.truth.q, found.truth.dq, found.truth.ddq)
    longer = pinocchio_torque(replace(robot, joints=tuple(joints)), *state) - pinocchio_torque(robot, *state)
    assert share(found.tau - found.truth.tau, longer) < 2e-3


def test_play_shows_the_torque_of_the_side_that_the_load_lies_on(robot: Robot, reference: Reference) -> None:
    found = measured(robot, reference, on_joint(robot, "backlash", {"bl": 1e-3}, {"w": 5.0}))
    state = (found.truth.dq, found.truth.ddq)
    load = pinocchio_torque(robot, found.truth.q, *state)
    q = found.truth.q.copy()
    q[:, JOINT] -= 0.5e-3 * np.tanh(load[:, JOINT] / 5.0)
    assert share(found.tau - found.truth.tau, pinocchio_torque(robot, q, *state) - load) < 2e-3


def test_links_behind_an_elastic_gear_follow_what_it_twists(robot: Robot, reference: Reference) -> None:
    compliance = 1e-6
    values = {"Ce": compliance, "Cl": compliance}
    found = measured(robot, reference, on_joint(robot, "joint_elasticity", values))
    truth = found.truth
    load = pinocchio_torque(robot, truth.q, truth.dq, truth.ddq)
    twist = np.zeros_like(load)
    twist[:, JOINT] = compliance * load[:, JOINT]
    ddtwist = np.gradient(np.gradient(twist, 1e-3, axis=0), 1e-3, axis=0)
    behind = pinocchio_torque(robot, truth.q - twist, truth.dq, truth.ddq - ddtwist)
    # Where the motion has no jerks, that is, neither begins nor ends to swell.
    smooth = slice(900, 2100)
    assert share((found.tau - truth.tau)[smooth], (behind - load)[smooth]) < 0.01


def test_effects_in_some_runs_are_in_those_alone(robot: Robot, reference: Reference) -> None:
    payload = replace(build_typical_effect(robot, "payload", ""), runs=("loaded",))
    weak = replace(on_joint(robot, "drive_gain_error", {"eps": 0.05}), runs=("loaded",))
    virtual = VirtualRobot(robot, (*spread_over_joints(robot, "viscous", "Fv", [5.0] * 6), payload, weak))
    empty, loaded = (virtual.measure(reference, EXACT, run=run) for run in ("empty", "loaded"))
    np.testing.assert_allclose(empty.tau, measured(robot, reference).tau, atol=0.01)
    expected = measured(robot, reference, replace(payload, runs=())).truth.tau
    np.testing.assert_allclose(loaded.truth.tau, expected, atol=0.01)
    np.testing.assert_allclose(loaded.tau[:, JOINT], 1.05 * loaded.truth.tau[:, JOINT], rtol=1e-9)


def test_several_runs_are_segments_of_one_recording_while_the_session_goes_on(robot: Robot, tmp_path: Path) -> None:
    payload = replace(build_typical_effect(robot, "payload", ""), runs=("2",))
    request = SimulationRequest(
        fourier(robot, 2.0), (payload,), sensors=EXACT, runs=3, pause=100.0, warming=Warming(20.0, 40.0, 50.0)
    )
    found = simulate(robot, request)
    assert found.n_samples == 3 * 2001
    assert found.segment is not None
    starts = found.t[np.searchsorted(found.segment, [1, 2, 3])]
    np.testing.assert_allclose(starts, [0.0, 102.0, 204.0])
    assert found.temperature is not None
    np.testing.assert_allclose(found.temperature[:, 3], 40.0 - 20.0 * np.exp(-found.t / 50.0), atol=1e-3)
    light, heavy, again = (found.tau[found.segment == k] for k in (1, 2, 3))
    np.testing.assert_allclose(again, light, atol=1e-6)
    assert np.abs(heavy - light).max() > 10.0
    path = write_simulated_recording(found, tmp_path / "runs.parquet")
    assert pq.read_table(path).column_names[-1] == "segment"
    recording, _ = import_recording(
        path,
        tmp_path / "recording.parquet",
        RecordedJoints(
            robot.joint_names,
            limits=[JointLimits(position=j.limits.position, effort=j.limits.effort) for j in robot.joints],
        ),
        metadata=RecordingMetadata(name="virtual"),
    )
    assert [recording.name_segment(k) for k in range(3)] == ["virtual#1", "virtual#2", "virtual#3"]
    assert recording.has_temperature


def test_noise_differs_from_run_to_run(robot: Robot) -> None:
    found = simulate(robot, SimulationRequest(fourier(robot, 1.0), runs=2))
    assert found.segment is not None
    noise = found.tau - found.truth.tau
    first, second = noise[found.segment == 1], noise[found.segment == 2]
    assert abs(np.corrcoef(first.ravel(), second.ravel())[0, 1]) < 0.1


@pytest.mark.parametrize(
    ("changed", "pointer"),
    [
        ({"runs": 0}, "/runs"),
        ({"pause": -1.0}, "/pause"),
        ({"runs": 2, "effects": (TrueEffect("payload", "", (("Mp", 1.0),), runs=("3",)),)}, "/effects/0/runs"),
    ],
)
def test_a_session_that_cannot_be_is_refused(robot: Robot, changed: dict[str, object], pointer: str) -> None:
    with pytest.raises(DynidentError) as caught:
        simulate(robot, replace(SimulationRequest(fourier(robot, 0.5)), **changed))  # type: ignore[arg-type]
    assert caught.value.pointer == pointer


def test_a_joint_that_warms_up_in_no_time_is_refused() -> None:
    with pytest.raises(DynidentError, match="time_constant is 0") as caught:
        Warming(time_constant=0.0)
    assert caught.value.pointer == "/time_constant"


def test_friction_that_depends_on_temperature_needs_one(robot: Robot) -> None:
    virtual = VirtualRobot(robot, (build_typical_effect(robot, "temperature_friction", robot.joint_names[JOINT]),))
    with pytest.raises(DynidentError, match="temperature_friction needs the temperature") as caught:
        virtual.measure(fourier(robot, 0.5))
    assert caught.value.pointer == "/temperature"
    assert virtual.measure(add_warming(fourier(robot, 0.5), Warming())).temperature is not None


def test_joints_warm_up_by_themselves_where_an_effect_needs_it(robot: Robot) -> None:
    hidden = build_typical_effect(robot, "temperature_friction", robot.joint_names[JOINT])
    assert simulate(robot, SimulationRequest(fourier(robot, 0.5), (hidden,))).temperature is not None
    assert simulate(robot, SimulationRequest(fourier(robot, 0.5))).temperature is None
