"""Models of a robot whose base floats: in a harness with a sensor, with a sensor in a foot, and in flight."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pinocchio as pin
import pyarrow.csv as pacsv
import pytest
from scipy.interpolate import CubicSpline
from support.floating_robots import (
    COULOMB,
    MASS,
    ROTOR,
    VISCOUS,
    WALKER,
    Motion,
    build_model,
    compute_motor_torque,
    draw_motion,
    fly,
    stand_on_shin,
    write_log,
)

import dynident as dy
from dynident.array_types import FloatArray
from dynident.diagnosis import compare
from dynident.diagnosis.comparison.measured_against_predicted import predict_again
from dynident.effects import LINKS, EffectChoice, ReferenceParameters, Signals, build_columns
from dynident.errors import DynidentError
from dynident.identification import IdentificationChoices, identify
from dynident.identification.identified_models.recursive_identification import RecursiveIdentification
from dynident.recordings import Preprocessing, Recording, SampleBlock
from dynident.regressors.dynamic_model_rows import SampleFunction
from dynident.regressors.observation_matrix import Observation, RegressorInputs
from dynident.regressors.row_phases import have_same_instants
from dynident.robot import Robot, contacts


@pytest.fixture(name="robot")
def walker(tmp_path: Path) -> Robot:
    (tmp_path / "walker.urdf").write_text(WALKER)
    return dy.set_base(dy.load_robot(tmp_path / "walker.urdf"), "floating")


def push_shin(motion: Motion, seed: int) -> FloatArray:
    """Return a wrench (m, 6) of the ground on the shin, in its frame: sums of sines, 20 N and 2 N m."""
    rng = np.random.default_rng(seed)
    frequency, phase = rng.uniform(0.3, 1.5, 6), rng.uniform(0, 6, 6)
    return np.sin(2 * np.pi * motion.t[:, None] * frequency + phase) * np.array([20, 20, 40, 2, 2, 2])


def write_runs(tmp_path: Path, kind: str, seeds: tuple[int, ...]) -> list[Path]:
    """Write logs of the walker; `kind` is what holds it."""
    model, files = build_model(), []
    data = model.createData()
    for seed in seeds:
        path = tmp_path / f"{kind}{seed}.csv"
        if kind == "flight":
            motion, torque = fly(seed, 2.0)
            files.append(write_log(path, motion, torque, noise=0.01, seed=seed))
            continue
        motion = draw_motion(seed)
        torque, wrench = compute_motor_torque(motion)
        wrenches = {"base": wrench}
        if kind == "foot":
            wrenches["shin"] = push_shin(motion, seed)
            for k in range(len(motion.t)):
                jacobian = pin.computeFrameJacobian(
                    model, data, motion.q[k], model.getFrameId("shin"), pin.ReferenceFrame.LOCAL
                )
                by_ground = jacobian.T @ wrenches["shin"][k]
                torque[k] -= by_ground[6:]
                wrench[k] -= by_ground[:6]
        files.append(write_log(path, motion, torque, wrenches, noise=0.01, seed=seed))
    return files


def test_the_projection_of_a_sample_is_computed_once_for_all_columns(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "walker.urdf").write_text(WALKER)
    robot = dy.set_base(dy.load_robot(tmp_path / "walker.urdf"), "floating", ["shin"])
    signals = Signals(robot)
    links, friction = (build_columns([choice], signals) for choice in (LINKS, EffectChoice("viscous")))
    observation = Observation.from_columns(robot, links, signals).extend(friction, signals)
    q = np.random.default_rng(1).uniform(-1.0, 1.0, (100, robot.n))
    projected = []
    project = contacts.compute_contact_projection

    def count_samples(robot: Robot, q: FloatArray) -> FloatArray:
        projected.append(len(q))
        return project(robot, q)

    monkeypatch.setattr(contacts, "compute_contact_projection", count_samples)
    for _ in range(2):
        projected.clear()
        observation.evaluate(q, q, q, reference=ReferenceParameters.massless(robot), memory=np.zeros((100, 0)))
        # Nor is it kept: of a humanoid, some hundred megabytes would be.
        assert sum(projected) == len(q)


def test_columns_are_projected_at_the_positions_at_which_torques_were(tmp_path: Path) -> None:
    (tmp_path / "walker.urdf").write_text(WALKER)
    floating = dy.set_base(dy.load_robot(tmp_path / "walker.urdf"), "floating")
    robot = dy.set_base(floating, "floating", ["shin"])
    rng = np.random.default_rng(4)
    measured = rng.uniform(-0.3, 0.3, (50, robot.n))
    q, dq, ddq = np.stack([measured, measured, measured]) + rng.normal(0.0, 0.05, (3, *measured.shape))
    block = SampleBlock(
        segment=0, t=0.01 * np.arange(50), q=q, dq=dq, ddq=ddq, dddq=ddq, ddddq=ddq, tau=np.zeros_like(q),
        used=np.ones(50, dtype=bool), temperature=None, starts_segment=True, measured_q=measured,
    )  # fmt: skip
    recording, values = cast("Recording", SimpleNamespace(period=0.01)), rng.uniform(0.1, 1.0, 200)
    torques = []
    for own in (floating, robot):
        signals = Signals(own)
        observation = Observation.from_columns(own, build_columns([LINKS], signals), signals)
        entries = SampleFunction(observation, ReferenceParameters.massless(own), recording)(block)
        torques.append(observation.compute_torque(entries, values[: observation.n_columns]))
    projection = contacts.compute_contact_projection(robot, measured)
    np.testing.assert_allclose(torques[1], np.einsum("mij,mj->mi", projection, torques[0]), atol=1e-9)
    elsewhere = np.einsum("mij,mj->mi", contacts.compute_contact_projection(robot, q), torques[0])
    assert np.abs(torques[1] - elsewhere).max() > 0.1


@pytest.mark.parametrize(("kind", "seeds"), [("harness", (1, 2)), ("foot", (5, 6)), ("flight", (3, 4, 7, 8, 9))])
def test_mass_friction_and_rotors_are_found_whatever_holds_the_robot(
    robot: Robot, tmp_path: Path, kind: str, seeds: tuple[int, ...]
) -> None:
    recordings = dy.read_recordings(*write_runs(tmp_path, kind, seeds), robot=robot)
    model = dy.identify(robot, recordings[:-1], validation=recordings[-1:])
    values = {row.name: row.value for row in model.parameters}
    # Torques and forces have noise of 1 %: means over thousands of samples are far better.
    assert values["M6"] == pytest.approx(MASS, rel=2e-3)
    for k in range(3):
        assert values[f"Fc{7 + k}"] == pytest.approx(COULOMB[k], rel=0.02)
        assert values[f"Fv{7 + k}"] == pytest.approx(VISCOUS[k], rel=0.02)
        assert values[f"Ia{7 + k}"] == pytest.approx(ROTOR[k], rel=0.05)
    # Neither friction nor a rotor is sought in a coordinate of the base.
    assert not {f"{name}{k}" for name in ("Fc", "Fv", "Ia") for k in range(1, 7)} & set(values)
    # Noise of 1 % of the torques, less what the filter takes of it.
    errors = {row.joint: row for row in model.errors}
    for name in robot.joint_names if kind != "flight" else robot.joint_names[6:]:
        assert errors[name].held_out < 0.02


def replace_position(file: Path, name: str, change: Callable[[FloatArray, FloatArray], FloatArray]) -> None:
    """Put an accelerometer in place of the base's position: columns by `name`, and a change of force and weight."""
    motion, rows = draw_motion(int(file.stem[-1])), pacsv.read_csv(file)
    weight = np.array([pin.Quaternion(q).matrix().T @ [0.0, 0.0, 9.81] for q in motion.q[:, 3:7]])
    force = change(motion.a[:, :3] + np.cross(motion.v[:, 3:6], motion.v[:, :3]) + weight, weight)
    for k, axis in enumerate("xyz"):
        rows = rows.drop_columns(f"base_{axis}").append_column(name.format(axis), [force[:, k]])
    pacsv.write_csv(rows, file)


@pytest.mark.parametrize(
    ("name", "bias", "unit"),
    [("base_acc_{}", 0.02, 1.0), ("imu_linear_acceleration_{}", 0.5, 1.0), ("base_acc_{} [g]", 0.2, 9.80665)],
)
def test_an_accelerometer_stands_for_the_position_of_the_base(
    robot: Robot, tmp_path: Path, name: str, bias: float, unit: float
) -> None:
    rng, files = np.random.default_rng(4), write_runs(tmp_path, "harness", (1, 2))
    for file in files:
        # Noise and bias as of a cheap sensor.
        replace_position(file, name, lambda force, _: (force + bias + 0.05 * rng.normal(size=force.shape)) / unit)
    assert not dy.inspect(files[0], robot).questions
    recordings = dy.read_recordings(*files, robot=robot)
    model = dy.identify(robot, recordings[:1], validation=recordings[1:])
    assert next(row.value for row in model.parameters if row.name == "M6") == pytest.approx(MASS, rel=5e-3)
    assert all(row.held_out < 0.05 for row in model.errors)


@pytest.mark.parametrize(
    ("change", "advice"),
    [
        (lambda force, weight: force - weight, "without gravity: record the raw accelerometer, or the position"),
        (lambda force, _: force / 9.80665, r"in g: write \[g\] behind the names"),
        (lambda force, _: -force, "record that of the root link along the axes of its frame"),
    ],
)
def test_an_accelerometer_has_to_measure_gravity(
    robot: Robot, tmp_path: Path, change: Callable[[FloatArray, FloatArray], FloatArray], advice: str
) -> None:
    (file,) = write_runs(tmp_path, "harness", (1,))
    replace_position(file, "imu_acc_{}", change)
    with pytest.raises(DynidentError, match=advice):
        dy.read_recordings(file, robot=robot)
    assert any("9.81 upwards" in question.detail for question in dy.inspect(file, robot).questions)


def test_the_place_that_an_accelerometer_drifts_to_says_nothing_of_units(robot: Robot, tmp_path: Path) -> None:
    (file,) = write_runs(tmp_path, "harness", (1,))
    replace_position(file, "imu_acc_{}", lambda force, _: force + np.linspace(-7.0, 7.0, len(force))[:, None])
    (recording,) = dy.read_recordings(file, robot=robot)
    place = next(recording.recording.source.rows(0, 4000, 4000)).q[:, 2]
    assert np.abs(np.diff(place)).max() * 200.0 > 20.0
    assert not [check for check in recording.checks if check.name == "position_unit" and check.status != "ok"]


def test_angles_turn_an_accelerometer_as_a_quaternion_does(robot: Robot, tmp_path: Path) -> None:
    (file,) = write_runs(tmp_path, "harness", (1,))
    replace_position(file, "imu_acc_{}", lambda force, _: force + 0.1)
    (by_quaternion,) = dy.read_recordings(file, robot=robot)
    rows = pacsv.read_csv(file)
    angles = np.array([pin.rpy.matrixToRpy(pin.Quaternion(q).matrix()) for q in draw_motion(1).q[:, 3:7]])
    for k, name in enumerate(("base_roll", "base_pitch", "base_yaw")):
        rows = rows.append_column(name, [np.degrees(angles[:, k])])
    pacsv.write_csv(rows.drop_columns([f"base_q{axis}" for axis in "xyzw"]), file)
    units = dict.fromkeys(("base_roll", "base_pitch", "base_yaw"), "deg")
    (by_angles,) = dy.read_recordings(file, robot=robot, units=units)
    expected, found = (next(each.recording.source.rows(0, 4000, 4000)).q for each in (by_quaternion, by_angles))
    np.testing.assert_allclose(found, expected, atol=1e-6)


@pytest.mark.parametrize(("names", "field"), [(("x1", "x2", "x3"), "effort_kind"), (("a", "b", "c"), "columns/tau")])
def test_columns_that_may_be_the_torques_are_asked_about_beside_wrenches(
    robot: Robot, tmp_path: Path, names: tuple[str, ...], field: str
) -> None:
    motion = draw_motion(1, 8.0)
    torque, wrench = compute_motor_torque(motion)
    log = write_log(tmp_path / "log.csv", motion, torque, {"base": wrench})
    rows = pacsv.read_csv(log)
    others = dict(zip(("tau1", "tau2", "tau3"), names, strict=True))
    pacsv.write_csv(rows.rename_columns([others.get(name, name) for name in rows.column_names]), log)
    proposal = dy.inspect(log, robot)
    (question,) = proposal.questions
    assert question.field == field
    assert "none" not in proposal.said["columns"].values()
    # Whoever knows that there is no torque is told how to say so.
    offered = [remedy.value for remedy in question.remedies]
    assert offered == ([{"tau1": "none", "tau2": "none", "tau3": "none"}] if field == "columns/tau" else [])


def test_the_forces_that_hold_a_robot_without_torques_give_its_mass(tmp_path: Path) -> None:
    (tmp_path / "walker.urdf").write_text(WALKER)
    robot = dy.set_base(dy.load_robot(tmp_path / "walker.urdf"), "floating")
    files = write_runs(tmp_path, "harness", (1, 2))
    for file in files:
        rows = pacsv.read_csv(file)
        pacsv.write_csv(rows.select([name for name in rows.column_names if not name.startswith("tau")]), file)
    found = dy.inspect(files[0], robot)
    assert not found.questions
    recordings = dy.read_recordings(*files, robot=robot, **found.said)
    model = dy.identify(robot, recordings[:1], validation=recordings[1:])
    assert next(row.value for row in model.parameters if row.name == "M6") == pytest.approx(MASS, rel=2e-3)
    assert any("The torque of all joints was not recorded" in warning for warning in model.warnings)


def test_unknown_forces_of_the_ground_are_eliminated(tmp_path: Path) -> None:
    (tmp_path / "walker.urdf").write_text(WALKER)
    robot = dy.set_base(dy.load_robot(tmp_path / "walker.urdf"), "floating", ["shin"])
    files = []
    for seed in (1, 2, 3):
        motion = draw_motion(seed)
        torque, _ = stand_on_shin(motion)
        files.append(write_log(tmp_path / f"stand{seed}.csv", motion, torque, noise=0.01, seed=seed))
    recordings = dy.read_recordings(*files, robot=robot)
    model = dy.identify(robot, recordings[:2], validation=recordings[2:])
    rows = {row.name: row for row in model.parameters}
    # A link that stands shows nothing of its own mass: what it carries is the rest.
    assert rows["M6"].value == pytest.approx(MASS - 1.2, rel=0.01)
    for k in range(3):
        assert rows[f"Fc{7 + k}"].value == pytest.approx(COULOMB[k], rel=0.03)
        assert rows[f"Ia{7 + k}"].value == pytest.approx(ROTOR[k], rel=0.05)
    assert all(row.held_out < 0.02 for row in model.errors)
    # Its projected equations have no mass matrix that could be positive definite.
    assert not any("inertia matrix" in warning for warning in model.warnings)
    # What is left without the projection lacks the link that stands: it is no torque of any robot.
    rest = np.zeros(robot.n)
    with pytest.raises(DynidentError, match="Nothing is known of the mass of a link that stands"):
        model.mass_matrix(rest)
    with pytest.raises(DynidentError, match="Nothing is known of the mass of a link that stands"):
        model.export(tmp_path / "walker.c")
    model.export(tmp_path / "walker.json")
    with pytest.raises(DynidentError, match="walker has contacts, whose unknown forces are eliminated"):
        dy.identify(robot, recordings[:2], choices=dy.IdentificationChoices(model="power"))


def write_runs_with_a_joint_at_rest(tmp_path: Path, share: float) -> list[Path]:
    """Write logs of the walker on its shin; in each one joint stands, held by a share of its friction."""
    files = []
    for joint in range(3):
        motion = draw_motion(10 + joint)
        motion.q[:, 7 + joint] = 0.3
        motion.v[:, 6 + joint] = motion.a[:, 6 + joint] = 0.0
        torque, _ = stand_on_shin(motion)
        torque[:, joint] += share * COULOMB[joint]
        files.append(write_log(tmp_path / f"one_stands{joint}.csv", motion, torque, noise=0.01, seed=joint))
    return files


@pytest.mark.parametrize("share", [-0.9, 0.9])
def test_the_friction_of_a_joint_that_stands_is_not_in_the_equations_of_the_others(
    tmp_path: Path, share: float
) -> None:
    (tmp_path / "walker.urdf").write_text(WALKER)
    robot = dy.set_base(dy.load_robot(tmp_path / "walker.urdf"), "floating", ["shin"])
    # There is no instant at which all joints move: without the rows of the others nothing would be left.
    files = write_runs_with_a_joint_at_rest(tmp_path, share)
    recordings = dy.read_recordings(*files, robot=robot)
    model = dy.identify(robot, recordings)
    values = {row.name: row.value for row in model.parameters}
    assert values["M6"] == pytest.approx(MASS - 1.2, rel=0.015)
    for k in range(3):
        assert values[f"Fc{7 + k}"] == pytest.approx(COULOMB[k], rel=0.05)
    # What is compared with a prediction lacks the friction, too: noise of 1 % is left, less what the filter takes.
    comparison = compare(model.identification, recordings[0].recording)
    rest = comparison.measured - comparison.predicted
    others = [j for j in range(robot.n) if j != 6]
    assert (rest.std(axis=0)[others] < 0.02 * comparison.measured.std(axis=0)[others]).all()
    inputs = RegressorInputs(
        [recordings[0].recording], model.identification.preprocessing, model.identification.estimate.reference
    )
    again = predict_again(comparison, model.identification.model.observation, model.identification.values, inputs)
    np.testing.assert_allclose(again.predicted, comparison.predicted, atol=1e-9)


def write_run_with_halts(tmp_path: Path) -> Path:
    """Write a log of the walker on its shin in which every joint stops for 3 s, held by 0.9 of its friction."""
    motion = draw_motion(10, 30.0)
    standing = np.zeros((len(motion.t), 3), dtype=bool)
    for joint in range(3):
        path = CubicSpline(motion.t, motion.q[:, 7 + joint])
        begin = 4.0 + 8.0 * joint
        # The joint's own time slows down within a second, stands, and goes on.
        distance = np.clip(np.abs(motion.t - begin - 2.5) - 1.5, 0.0, 1.0)
        pace = distance**2 * (3.0 - 2.0 * distance)
        slope = 6.0 * distance * (1.0 - distance) * np.sign(motion.t - begin - 2.5)
        own = np.concatenate([[0.0], np.cumsum(0.5 * (pace[1:] + pace[:-1]) * np.diff(motion.t))])
        motion.q[:, 7 + joint], motion.v[:, 6 + joint] = path(own), path(own, 1) * pace
        motion.a[:, 6 + joint] = path(own, 2) * pace**2 + path(own, 1) * slope
        standing[:, joint] = pace == 0.0
    torque, _ = stand_on_shin(motion)
    return write_log(tmp_path / "halts.csv", motion, torque + 0.9 * COULOMB * standing, noise=0.01)


def test_joints_that_halt_in_turn_leave_the_equations_of_others_true_live_as_well(tmp_path: Path) -> None:
    (tmp_path / "walker.urdf").write_text(WALKER)
    robot = dy.set_base(dy.load_robot(tmp_path / "walker.urdf"), "floating", ["shin"])
    (read,) = dy.read_recordings(write_run_with_halts(tmp_path), robot=robot)
    choices = IdentificationChoices(preprocessing=Preprocessing(20.0, 20.0, 2))
    batch, live = identify(robot, [read.recording], (), choices), RecursiveIdentification(robot, choices)
    live.push(read.recording)
    np.testing.assert_allclose(live.finish(read.recording).estimate.values, batch.values, rtol=1e-6)
    number = [column.name for column in batch.model.kept].index("M6")
    assert batch.values[number] == pytest.approx(MASS - 1.2, rel=0.015)
    # With the friction of the halts in the equations of the others it is five times as large.
    assert batch.estimate.statistics.standard_deviations[number] < 0.01 * MASS


def test_rows_of_columns_without_friction_are_no_rows_beside_friction_where_contacts_mix_them(tmp_path: Path) -> None:
    (tmp_path / "walker.urdf").write_text(WALKER)
    floating = dy.set_base(dy.load_robot(tmp_path / "walker.urdf"), "floating")
    assert not changes_instants(floating)
    assert changes_instants(dy.set_base(floating, "floating", ["shin"]))


def changes_instants(robot: Robot) -> bool:
    """Return whether rows without friction are other ones once a column of friction is there."""
    signals = Signals(robot)
    bare = Observation.from_columns(robot, build_columns((LINKS,), signals), signals)
    rubbed = bare.extend(build_columns((EffectChoice("coulomb"),), signals), signals)
    return not have_same_instants(bare, rubbed)


def test_a_mass_that_was_added_to_the_trunk_is_found_there(robot: Robot, tmp_path: Path) -> None:
    place, files = np.array([0.1, -0.05, 0.15]), []
    for k, added in enumerate((0.0, 0.5)):
        motion, model = draw_motion(21 + k), build_model()
        model.inertias[1] = model.inertias[1] + pin.Inertia(added, place, np.zeros((3, 3)))
        data = model.createData()
        total = np.array([pin.rnea(model, data, *state) for state in zip(motion.q, motion.v, motion.a, strict=True)])
        friction = COULOMB * np.sign(motion.v[:, 6:]) + VISCOUS * motion.v[:, 6:] + ROTOR * motion.a[:, 6:]
        log = tmp_path / f"added{k}.csv"
        files.append(write_log(log, motion, total[:, 6:] + friction, {"base": total[:, :6]}, noise=0.01, seed=k))
    before, after = dy.read_recordings(*files, robot=robot)[:1], dy.read_recordings(*files, robot=robot)[1:]
    changes = dy.changes(dy.identify(robot, before), before=before, after=after)
    (change,) = changes
    assert (change.choice.effect, change.choice.joints) == ("payload", ("base_roll",))
    assert "Added mass on trunk" in changes.summary
    assert set(changes.to_frame()["joint"]) == {"trunk"}
    assert change.evidence.startswith("Added mass on trunk: Mp6 differs")
    values = {value.parameter: value.value for value in (change.main, *change.more)}
    assert values["Mp6"] == pytest.approx(0.5, rel=0.02)
    assert values["m l"] == pytest.approx(0.5 * float(np.linalg.norm(place)), rel=0.05)


def test_a_robot_that_only_stands_is_asked_to_lift_its_feet(tmp_path: Path) -> None:
    (tmp_path / "walker.urdf").write_text(WALKER)
    feet = ["shin@0,0,-0.4^0.03", "shin@0,0.05,-0.4^0.03"]
    robot = dy.set_base(dy.load_robot(tmp_path / "walker.urdf"), "floating", feet)
    motion = draw_motion(1)
    torque, _ = stand_on_shin(motion)
    recordings = dy.read_recordings(write_log(tmp_path / "stand.csv", motion, torque, noise=0.01, seed=1), robot=robot)
    with pytest.raises(DynidentError, match="lifts its feet one after the other and shifts its weight"):
        dy.identify(robot, recordings)


def test_equation_types_that_a_moving_base_has_not_are_refused(robot: Robot, tmp_path: Path) -> None:
    recordings = dy.read_recordings(*write_runs(tmp_path, "harness", (1,)), robot=robot)
    with pytest.raises(DynidentError, match="walker has a floating base"):
        dy.identify(robot, recordings, choices=dy.IdentificationChoices(model="base_wrench"))
