"""Poses at which a robot stands, a row each: gravity, constant torques and the band of friction, and no more."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.oracles import arm, fourier_motion, pinocchio_torque, record
from support.poses_at_rest import poses, write_poses

from dynident.diagnosis import compare, diagnose
from dynident.effects import EffectChoice
from dynident.effects.effect_choices import DEFAULT_EFFECTS, OFFSETS
from dynident.errors import DynidentError
from dynident.identification import IdentificationChoices, extend, from_bytes, identify, make_physical, to_bytes
from dynident.identification.column_inference.column_statistics import Sample
from dynident.identification.column_inference.infer_columns import propose
from dynident.identification.identified_models import remove_and_solve_again
from dynident.identification.robot_recording_import import import_for_robot
from dynident.recordings import Recording, RecordingMetadata, recording_from_arrays
from dynident.recordings.joint_phases import phase_shares
from dynident.recordings.pose_recordings import are_poses, has_poses
from dynident.validation import validate_inertia_matrix
from dynident.verdict import verdict

CHOICES = IdentificationChoices((*DEFAULT_EFFECTS, OFFSETS))
ARMS = ("ur10", "franka_panda", "crooked")


def recorded(name: str, seed: int, count: int = 60, **more) -> Recording:
    robot = arm(name)
    return recording_from_arrays(*poses(robot, count, seed, **more), joint_names=robot.joint_names, name=f"poses{seed}")


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("name", ARMS)
def test_gravity_and_offsets_are_identified_from_poses_and_hold_at_others(name, seed):
    learnt, tried = recorded(name, seed, offset=1.5), recorded(name, seed + 10, offset=1.5)
    assert has_poses(learnt)
    assert len(learnt.segments) == 60
    np.testing.assert_array_equal(phase_shares(learnt).standing, 1.0)
    found = identify(arm(name), [learnt], [tried], CHOICES)
    assert found.held_out.relative_total < 2e-3
    assert found.model.is_at_rest
    assert {choice.effect for choice in found.choices.effects} == {"rigid_body", "offset"}
    offsets = [p for p in found.parameters if p.effect == "offset"]
    # Beside an axis that gravity does not turn about, an offset is a first moment.
    assert sum(abs(p.value - 1.5) < 4 * p.standard_deviation + 1e-3 for p in offsets) >= len(offsets) - 1


@pytest.mark.parametrize("name", ARMS)
def test_parameters_of_poses_are_those_of_the_description_at_rest(name):
    robot = arm(name)
    found = identify(robot, [recorded(name, 3)], [], CHOICES)
    rng = np.random.default_rng(5)
    q = rng.uniform(-1.0, 1.0, (20, robot.n))
    still = np.zeros_like(q)
    model = found.model
    entries = model.observation.evaluate(
        q, still, still, reference=found.estimate.reference, memory=np.zeros((20, model.observation.n_memory))
    )
    predicted, expected = (
        model.observation.compute_torque(entries, found.values),
        pinocchio_torque(robot, q, still, still),
    )
    np.testing.assert_allclose(predicted, expected, atol=2e-3 * np.abs(expected).max())


def test_what_is_impossible_in_a_model_of_poses_is_said_too(monkeypatch):
    found = identify(arm("ur10"), [recorded("ur10", 3)], [], CHOICES)
    assert make_physical(found).warning == ""
    monkeypatch.setattr(remove_and_solve_again, "list_impossible", lambda _: ["Fc1 = -2 N m"])
    possible = make_physical(found)
    assert not possible.is_possible
    assert possible.warning == "A simulation with these parameters could gain energy: Fc1 = -2 N m."


@pytest.mark.parametrize("name", ["ur10", "crooked"])
def test_the_band_of_friction_is_said(name):
    learnt = recorded(name, 4, friction=0.05, both_sides=True)
    found = identify(arm(name), [learnt], [], CHOICES)
    robot = arm(name)
    still = np.zeros((120, robot.n))
    _, q, _ = poses(robot, 60, 4, friction=0.05, both_sides=True)
    size = np.sqrt((pinocchio_torque(robot, q, still, still) ** 2).mean(axis=0)).max()
    # Every row is off by the friction, one way or the other.
    np.testing.assert_allclose(found.fit.rms, 0.05 * size, rtol=0.2)
    assert "poses at rest: they show gravity" in found.warnings[0]
    assert "rotor_inertia, coulomb, viscous act only in motion" in found.warnings[0]
    assert found.warnings[1].startswith("Static friction and noise are within a band")
    assert not any("inertia matrix" in warning for warning in found.warnings)


def test_what_such_data_can_tell_is_said_in_the_verdict():
    found = identify(arm("ur10"), [recorded("ur10", 0)], [recorded("ur10", 1)], CHOICES)
    said = verdict(found, [recorded("ur10", 0)], [recorded("ur10", 1)])
    assert not any(use.fit for use in said.uses)
    assert all("Poses at rest contain no information about motion." in use.reason for use in said.uses)
    assert said.stop is None
    gravity, following = said.next_steps
    assert gravity.startswith("Fit for gravity compensation")
    assert following == "Record a designed motion to identify the dynamics."
    assert validate_inertia_matrix(found).judged.verdict == "not_evaluated"


def test_the_model_is_kept_in_files_compared_and_extended():
    learnt, tried = recorded("ur10", 0), recorded("ur10", 1)
    found = identify(arm("ur10"), [learnt], [tried], CHOICES)
    back = from_bytes(to_bytes(found))
    assert back.model.is_at_rest
    compared = compare(back, tried)
    assert compared.errors.relative_total == pytest.approx(found.held_out.relative_total)
    assert len(compared.t) == 60
    grown = extend(found, [EffectChoice("joint_spring", (arm("ur10").joint_names[0],))], [learnt], [tried])
    assert grown.step.parent is found
    assert any(parameter.effect == "joint_spring" for parameter in grown.parameters)
    with pytest.raises(DynidentError, match="cannot be identified from poses at rest"):
        extend(found, [EffectChoice("stribeck", (), (("vs", 0.1), ("delta", 2.0)))], [learnt])
    with pytest.raises(DynidentError, match="poses at rest show only gravity"):
        diagnose(found, [learnt])


def test_what_is_known_beside_poses_is_a_parameter_of_theirs():
    learnt = recorded("ur10", 0)
    for name in ("M99", "Fc1"):
        with pytest.raises(DynidentError, match=f"no parameter '{name}'") as raised:
            identify(arm("ur10"), [learnt], [], replace(CHOICES, known={name: 1.0}))
        assert raised.value.pointer == "/known"
    found = identify(arm("ur10"), [learnt], [], replace(CHOICES, known={"b2": 0.7}))
    assert next(p.value for p in found.parameters if p.name == "b2") == pytest.approx(0.7, rel=1e-4)


def test_poses_beside_a_motion_are_refused_in_words():
    robot = arm("ur10")
    motion = fourier_motion(robot, 5.0, 100.0, 0)
    moved = record(robot, motion, pinocchio_torque(robot, motion.q, motion.dq, motion.ddq))
    with pytest.raises(DynidentError, match="are poses at rest, the other recordings are motions"):
        identify(robot, [moved], [recorded("ur10", 0)], CHOICES)


@pytest.mark.parametrize("factor", [1.0, 180.0 / np.pi])
@pytest.mark.parametrize("name", ARMS)
def test_a_file_of_poses_is_proposed_and_read(name, factor, tmp_path):
    robot = arm(name)
    kinds = np.array([joint.kind == "revolute" for joint in robot.joints])
    t, q, tau = poses(robot, 50, 7, friction=0.01)
    path = write_poses(tmp_path / "poses.csv", t, q * np.where(kinds, factor, 1.0), tau)
    joints = range(1, robot.n + 1)
    names = ("t", *(f"q{j}" for j in joints), *(f"tau{j}" for j in joints))
    found = propose(Sample(names, np.loadtxt(path, delimiter=",", skiprows=1), {}), robot)
    assert "units/t" not in {question.field for question in found.questions}
    assert "poses at rest" in found.guesses[0].reason or "poses at rest" in found.guesses[1].reason
    units = {"q": "deg"} if factor != 1.0 and kinds.all() else {}
    if kinds.all():
        assert found.units == units
        assert found.questions == ()
    metadata = RecordingMetadata(name="poses", units=dict(found.units))
    recording, checks = import_for_robot(robot, path, tmp_path / "stored.parquet", metadata)
    assert has_poses(recording)
    (check,) = [check for check in checks if check.name == "poses"]
    assert "50 poses at rest" in check.detail
    assert identify(robot, [recording], [], CHOICES).fit.relative_total < 0.1


def test_rows_without_numbers_are_left_out_and_told(tmp_path):
    t, q, tau = poses(arm("ur10"), 40, 2)
    tau[7, 2] = np.nan
    path = write_poses(tmp_path / "poses.csv", t, q, tau)
    recording, checks = import_for_robot(arm("ur10"), path, tmp_path / "stored.parquet", RecordingMetadata())
    assert recording.n_samples == 39
    assert any("1 rows contain no valid numbers" in check.detail for check in checks)


@pytest.mark.parametrize("rate", [2.0, 4.0, 8.0, 100.0])
@pytest.mark.parametrize("name", ARMS)
def test_samples_of_a_motion_are_no_poses(name, rate):
    robot = arm(name)
    motion = fourier_motion(robot, 60.0, rate, 1, base_frequency=0.05)
    assert not are_poses(motion.q)


def test_a_grid_of_poses_is_one_of_poses():
    first, second = np.meshgrid(np.linspace(-1.5, 1.5, 6), np.linspace(-1.0, 1.0, 8), indexing="ij")
    assert are_poses(np.column_stack([first.ravel(), second.ravel()]))


@pytest.mark.parametrize("seed", [0, 1])
def test_a_grid_of_poses_whose_rows_are_counted_is_one_of_poses(seed: int) -> None:
    robot, rng = arm("ur10"), np.random.default_rng(seed)
    places = [np.linspace(-1.2, 1.0, 9), np.linspace(-0.8, 0.9, 12)]
    q = rng.normal(0.0, 1e-5, (108, robot.n))
    q[:, 1:3] += np.array([(a, b) for a in places[0] for b in places[1]])
    tau = pinocchio_torque(robot, q, np.zeros_like(q), np.zeros_like(q)) + rng.normal(0.0, 0.05, q.shape)
    assert are_poses(q)
    names = ("number", *(f"theta_{j + 1}" for j in range(6)), *(f"tau_{j + 1}" for j in range(6)))
    found = propose(Sample(names, np.column_stack([np.arange(108.0), q, tau]), {}), robot)
    assert (found.columns["t"], found.columns["tau6"], found.questions) == ("number", "tau_6", ())


@pytest.mark.parametrize("rows", [40, 300])
def test_a_motion_from_place_to_place_and_a_periodic_one_are_no_grid(rows: int) -> None:
    t = np.arange(rows) / 10.0
    noise = np.random.default_rng(rows).normal(0.0, 1e-4, rows)
    assert not are_poses((np.sin(2.0 * np.pi * 0.7 * t) + noise)[:, None])
    steps = np.repeat(np.random.default_rng(3).permutation(rows // 10), 10)[:, None] / rows
    assert not are_poses(8.0 * steps + noise[:, None])


def wrap(angles: np.ndarray) -> np.ndarray:
    return (angles + np.pi) % (2.0 * np.pi) - np.pi


@pytest.mark.parametrize("resolution", [1.0, 3.0])
@pytest.mark.parametrize("rate", [2.0, 5.0, 10.0, 20.0])
def test_motions_with_coarse_encoders_and_sawteeth_are_no_grids(rate: float, resolution: float) -> None:
    for seed in range(10):
        q = fourier_motion(arm("ur10"), 60.0, rate, seed, base_frequency=0.05).q[:, :3]
        step = np.deg2rad(resolution)
        assert not are_poses(np.round(q / step) * step)
    k = np.arange(400.0)
    saw = np.deg2rad(np.round(np.interp(k % 20.0, [0.0, 17.0, 20.0], [0.0, 51.0, 0.0])))
    assert not are_poses(saw[:, None])
    assert not are_poses(np.column_stack([saw, 0.1 * np.sin(k / 30.0)]))


@pytest.mark.parametrize("rows", [30, 60, 90])
def test_constant_velocities_of_angles_that_are_wrapped_are_no_grid(rows: int) -> None:
    k = np.arange(1200.0)
    turning = wrap(2.0 * np.pi * k / rows)
    assert not are_poses(turning[:, None])
    assert not are_poses(np.column_stack([turning, wrap(2.0 * np.pi * k / (rows + 1))]))
    assert not are_poses(np.column_stack([turning, 0.5 * np.sin(k / 50.0)]))


@pytest.mark.parametrize(("step", "slow"), [(0.2, False), (5.0, True)])
def test_columns_are_poses_only_where_their_times_are_far_apart(step: float, slow: bool) -> None:
    robot = arm("ur10")
    places = np.array([(a, b) for a in np.linspace(-1.2, 1.0, 9) for b in np.linspace(-0.8, 0.9, 12)])
    q = np.zeros((108, 6))
    q[:, 1:3] = places
    tau = pinocchio_torque(robot, q, np.zeros_like(q), np.zeros_like(q))
    names = ("time", *(f"q{j + 1}" for j in range(6)), *(f"tau{j + 1}" for j in range(6)))
    found = propose(Sample(names, np.column_stack([step * np.arange(108.0), q, tau]), {}), robot)
    assert any("poses at rest" in guess.reason for guess in found.guesses) is slow
