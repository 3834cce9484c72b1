"""Sensors, files, requests: what a virtual robot's measurement is to the rest of the program."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.virtual_arms import effort, fourier, plain_friction

from dynident.effects import CATALOGUE
from dynident.errors import Cancelled, DynidentError
from dynident.recordings import JointLimits, RecordedJoints, RecordingMetadata, import_recording
from dynident.robot import Drive, Robot, robot_from_library
from dynident.simulation import (
    Reference,
    Sensors,
    SimulationRequest,
    TrueEffect,
    VirtualRobot,
    Warming,
    add_warming,
    build_standard_parameters,
    build_typical_effect,
    list_drive_effects,
    simulate,
    spread_over_joints,
    write_simulated_recording,
)

# Effects that are below the noise of most arms' sensors even where they are as large as usual.
FAINT = {"backlash", "kinematic_error", "rotor_coupling"}


@pytest.fixture(scope="module")
def robot() -> Robot:
    return robot_from_library("ur10")


def test_noise_has_the_stated_share_of_the_effort_limit_and_is_told(robot: Robot) -> None:
    measured = VirtualRobot(robot).measure(fourier(robot, 5.0), Sensors(torque_noise=0.006))
    assert measured.noise == pytest.approx(0.006 * effort(robot))
    assert np.std(measured.tau - measured.truth.tau, axis=0) == pytest.approx(measured.noise, rel=0.05)


def test_positions_are_whole_encoder_counts_next_to_the_truth(robot: Robot) -> None:
    measured = VirtualRobot(robot).measure(fourier(robot, 1.0), Sensors(encoder_counts=2**12))
    step = 2 * np.pi / 2**12
    assert measured.q / step == pytest.approx(np.rint(measured.q / step), abs=1e-6)
    assert np.abs(measured.q - measured.truth.q).max() <= step / 2 + 1e-12


def test_the_same_seed_gives_the_same_measurement_and_another_seed_another(robot: Robot) -> None:
    virtual, reference = VirtualRobot(robot), fourier(robot, 0.5)
    first, again, other = (virtual.measure(reference, Sensors(jitter=1e-4), seed=seed) for seed in (3, 3, 4))
    assert np.array_equal(first.tau, again.tau)
    assert np.array_equal(first.t, again.t)
    assert not np.array_equal(first.tau, other.tau)


def test_jitter_moves_the_instants_and_the_samples_with_them(robot: Robot) -> None:
    virtual, reference = VirtualRobot(robot), fourier(robot, 2.0)
    exact = Sensors(sampling_rate=100.0, encoder_counts=None, torque_noise=0.0)
    regular, jittering = virtual.measure(reference, exact), virtual.measure(reference, replace(exact, jitter=1e-3))
    assert np.std(jittering.t - regular.t) == pytest.approx(1e-3, rel=0.2)
    assert np.all(np.diff(jittering.t) > 0)
    moved = jittering.truth.q - regular.truth.q
    # To second order in the jitter: the velocity times the shift.
    expected = regular.truth.dq * (jittering.t - regular.t)[:, None]
    assert moved == pytest.approx(expected, abs=0.5 * np.abs(regular.truth.ddq).max() * 4e-3**2)


def test_currents_are_torques_over_drive_gains(robot: Robot) -> None:
    gains = np.array([14.0, 13.0, 11.0, 10.0, 11.0, 11.5])
    driven = replace(robot, drives=tuple(Drive(drive_gain=float(gain)) for gain in gains))
    measured = VirtualRobot(driven).measure(fourier(driven, 0.5), Sensors(current=True))
    assert measured.current is not None
    assert measured.current * gains == pytest.approx(measured.tau)


@pytest.mark.parametrize("file_format", ["csv", "parquet"])
@pytest.mark.parametrize("current", [False, True])
def test_a_written_measurement_is_read_back_as_a_recording(
    robot: Robot, tmp_path: Path, file_format: str, current: bool
) -> None:
    driven = replace(robot, drives=tuple(Drive(drive_gain=12.0) for _ in range(robot.n)))
    reference = fourier(driven, 4.0)
    heated = replace(reference, temperature=np.full_like(reference.q, 31.5))
    measured = VirtualRobot(driven, plain_friction(driven)).measure(heated, Sensors(current=current))
    path = write_simulated_recording(measured, tmp_path / f"run.{file_format}", file_format)  # type: ignore[arg-type]
    recording, checks = import_recording(
        path,
        tmp_path / "imported.parquet",
        RecordedJoints(
            driven.joint_names,
            gains=[drive.gain for drive in driven.drives],
            limits=[JointLimits(position=j.limits.position, effort=j.limits.effort) for j in driven.joints],
        ),
        metadata=RecordingMetadata(name="virtual"),
    )
    assert recording.n_samples == measured.n_samples == 4001
    assert recording.sampling_rate == pytest.approx(1000.0)
    assert recording.has_temperature
    assert [check for check in checks if check.status == "error"] == []
    rows = next(iter(recording.source.rows(0, recording.n_samples, recording.n_samples)))
    assert rows.q == pytest.approx(measured.q[: len(rows.q)], abs=1e-9)
    assert rows.tau == pytest.approx(measured.tau[: len(rows.tau)], abs=1e-6)


def test_thirty_seconds_are_simulated_as_a_stream_of_progress_and_can_be_cancelled(robot: Robot) -> None:
    seen: list[float] = []

    def stop(fraction: float, message: str) -> None:
        seen.append(fraction)
        if fraction > 0.02:
            raise Cancelled

    with pytest.raises(Cancelled):
        VirtualRobot(robot).measure(fourier(robot, 30.0), progress=stop)
    assert len(seen) > 1
    assert seen == sorted(seen)
    assert seen[-1] < 0.05


def test_a_trajectory_beyond_the_motors_is_refused_with_joint_and_time(robot: Robot) -> None:
    reference = fourier(robot, 4.0)
    faster = Reference(reference.t / 8, reference.q, reference.dq * 8, reference.ddq * 64)
    with pytest.raises(DynidentError, match=r"cannot follow.*off by more than .* at t = 0\.\d+ s; its effort limit is"):
        VirtualRobot(robot).measure(faster)


@pytest.mark.parametrize(
    ("effect", "pointer"),
    [
        (TrueEffect("stribek", "joint1", ()), "/effects/1"),
        (TrueEffect("stribeck", "joint9", ()), "/effects/1"),
        (TrueEffect("stribeck", "", ()), "/effects/1/joint"),
        (TrueEffect("coulomb", "joint1", (("Fv", 1.0),)), "/effects/1/values/Fv"),
        (TrueEffect("viscous", "joint1", (("Fv", -1.0),)), "/effects/1/values/Fv"),
        (TrueEffect("offset", "joint1", (("b", float("nan")),)), "/effects/1/values/b"),
        (TrueEffect("stribeck", "joint1", (("Fst", 1.0),), (("speed", 1.0),)), "/effects/1"),
        (TrueEffect("coulomb", "joint1", (("Fc", 1.0),)), "/effects/1"),
        (TrueEffect("rigid_body", "joint1", (("M", 1.0),)), "/effects/1"),
    ],
)
def test_an_effect_that_does_not_fit_is_named_by_its_place(robot: Robot, effect: TrueEffect, pointer: str) -> None:
    first = robot.joint_names[0]
    given = replace(effect, joint=first if effect.joint == "joint1" else effect.joint)
    with pytest.raises(DynidentError) as caught:
        VirtualRobot(robot, (TrueEffect("coulomb", first, (("Fc", 2.0),)), given))
    assert caught.value.pointer == pointer


@pytest.mark.parametrize(
    ("sensors", "pointer"),
    [
        ({"sampling_rate": 0.0}, "/sampling_rate"),
        ({"encoder_counts": -1}, "/encoder_counts"),
        ({"torque_noise": -0.1}, "/torque_noise"),
        ({"torque_noise_absolute": (1.0, -1.0)}, "/torque_noise_absolute/1"),
        ({"torque_noise_absolute": (1.0,)}, "/noise/torque_noise_absolute"),
        ({"jitter": 1e-3}, "/noise/jitter"),
        ({"current": True}, "/noise/current"),
    ],
)
def test_sensors_that_nobody_has_are_refused(robot: Robot, sensors: dict[str, Any], pointer: str) -> None:
    with pytest.raises(DynidentError) as caught:
        VirtualRobot(robot).measure(fourier(robot, 0.5), Sensors(**sensors))
    assert caught.value.pointer == pointer


def test_a_broken_trajectory_is_refused_with_the_sample(robot: Robot) -> None:
    good = fourier(robot, 0.5)
    q = good.q.copy()
    q[17, 2] = np.nan
    t = good.t.copy()
    t[9] = t[8]
    for broken, pointer in (
        (replace(good, q=q), "/trajectory/q/17"),
        (replace(good, t=t), "/trajectory/t/9"),
        (replace(good, dq=good.dq[:, :3]), "/trajectory/dq"),
    ):
        with pytest.raises(DynidentError) as caught:
            VirtualRobot(robot).measure(broken)
        assert caught.value.pointer == pointer


def test_a_robot_without_inertial_parameters_says_what_it_needs(robot: Robot) -> None:
    with pytest.raises(DynidentError, match="ten per link"):
        VirtualRobot(replace(robot, inertias=None))


def test_standard_parameters_by_name_are_those_of_the_simulation(robot: Robot) -> None:
    assert robot.inertias is not None
    given = build_standard_parameters(robot, {"ZZ2": 4.5, "Fc3": 7.0, "Ia1": 2.0})
    changed = given.inertias != robot.inertias
    assert np.argwhere(changed).tolist() == [[1, 5]]
    assert given.inertias[1, 5] == 4.5
    assert {(e.effect, e.joint, e.values) for e in given.effects} == {
        ("coulomb", robot.joint_names[2], (("Fc", 7.0),)),
        ("rotor_inertia", robot.joint_names[0], (("Ia", 2.0),)),
    }
    for wrong in ("ZZ7", "Fx1", "ZZ", "M0"):
        with pytest.raises(DynidentError, match="no standard parameter"):
            build_standard_parameters(robot, {wrong: 1.0})


def test_a_request_gives_the_measurement_of_its_robot(robot: Robot) -> None:
    effects = spread_over_joints(robot, "viscous", "Fv", [3.0] * robot.n)
    reference = fourier(robot, 1.0)
    assert robot.inertias is not None
    request = SimulationRequest(reference, effects, 1.1 * robot.inertias, Sensors(sampling_rate=250.0), seed=5)
    measured = simulate(robot, request)
    direct = VirtualRobot(robot, effects, inertias=1.1 * robot.inertias).measure(
        reference, Sensors(sampling_rate=250.0), seed=5
    )
    assert np.array_equal(measured.tau, direct.tau)
    assert measured.n_samples == 251


@pytest.mark.sweep
@pytest.mark.parametrize("effect", sorted(set(CATALOGUE) - {"rigid_body", "rotor_inertia", "coulomb", "viscous"}))
def test_every_effect_of_the_catalogue_has_a_typical_size_that_shows_in_the_torque(robot: Robot, effect: str) -> None:
    exact = Sensors(sampling_rate=200.0, encoder_counts=None, torque_noise=0.0)
    warm = add_warming(fourier(robot, 4.0), Warming())
    # The motor of joint 4 is carried along by joints whose axes are not across its own.
    usual = CATALOGUE[effect].get_default_joints(robot)
    alone = CATALOGUE[effect].scope == "robot" or len(usual) == 1
    joint = "" if alone else robot.joint_names[3 if effect == "rotor_coupling" else 1]
    hidden = build_typical_effect(robot, effect, joint)
    without, with_it = (
        VirtualRobot(robot, effects).measure(warm, exact).tau
        for effects in (list_drive_effects(robot), (*list_drive_effects(robot), hidden))
    )
    difference = np.sqrt(np.mean((with_it - without) ** 2, axis=0) / effort(robot) ** 2).max()
    assert (5e-5 if effect in FAINT else 0.002) < difference < 0.12
