"""SDF, USD, FMU, URDF for Drake and actuators, each read by the program that it is for, give the identified torque.

Each test skips where its engine is not installed, and says so.
"""

from __future__ import annotations

import ast
import gc
import re
import shutil
import subprocess
import weakref
import zipfile
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any
from xml.etree import ElementTree

import casadi as ca
import mujoco
import numpy as np
import pinocchio as pin
import pytest
from support.exported_programs import ARM, check_stated_error, error_of, held_out, identify_arm, needed
from support.exported_robots import moving
from support.models_with_chosen_parameters import PLAIN, FloatArray, drives, from_standard, made_up, path, predicted
from support.oracles import Motion, arm, crooked_urdf

from dynident.effects import EffectChoice
from dynident.errors import DynidentError
from dynident.export import (
    ExportedFile,
    MissingTorque,
    export_model,
    to_fmu,
    to_mjcf,
    to_mujoco,
    to_sdf,
    to_urdf,
    to_usd,
)
from dynident.export.casadi_function import build_torque_formula
from dynident.export.urdf import ROTOR_TAG
from dynident.identification import Identification, make_physical
from dynident.identification.identified_models import remove_and_solve_again
from dynident.identification.identified_models.equation_of_motion import build_equation_of_motion
from dynident.robot import Robot, robot_from_urdf

TREE = robot_from_urdf("tree", crooked_urdf(7, 3, (1, 5), (-1, 0, 1, 1, 0, 4, 5)))
ROBOTS = {"a serial arm": arm("ur10"), "a sliding joint": arm("scara"), "a tree": TREE, "axes askew": arm("crooked")}
RICH = (*PLAIN, "stribeck", "viscous_nonlinear", "offset", "torque_ripple", "presliding")


def import_engine(name: str) -> Any:
    return pytest.importorskip(name, reason=f"NO {name}: files for it are not read by it here")


def identified(robot: Robot, effects: tuple[str, ...] = PLAIN) -> Identification:
    """A model with the description's inertias, and friction and other effects of usual sizes."""
    plain = from_standard(robot, drives(robot) | {f"Ia{j + 1}": 0.3 for j in range(robot.n)})
    if effects == PLAIN:
        return plain
    values = {column.name: value for column, value in zip(plain.model.kept, plain.values, strict=True)}
    columns = made_up(robot, effects).model.kept
    # Hysteresis that grows with the load would need a load that can be.
    sizes = [0.0 if column.name.startswith("cz") else values.get(column.name, 0.4) for column in columns]
    return made_up(robot, effects, np.array(sizes))


def measured_model() -> Identification:
    """An arm, identified with all its effects, and tried on held-out data."""
    return identify_arm(EffectChoice("viscous_nonlinear", shape=(("p", 2.0),)))


def stated_error(file: ExportedFile, sentence: str) -> float:
    """A percentage that the head of the file states, behind this sentence."""
    text = file.content.decode()
    for note in file.notes:
        if found := re.search(sentence + r"[^\d]*([\d.]+)\s%", note):
            assert " ".join(note.split()) in " ".join(text.split())
            return float(found[1]) / 100
    raise AssertionError(sentence)


OF_FILE = r"of this file \(and of the model\):"


def torque_in_drake(text: str, gravity: FloatArray, motion: Motion, names: tuple[str, ...], kind: str) -> FloatArray:
    """What Drake computes; it has no Coulomb friction of joints."""
    drake = import_engine("pydrake.all")
    plant = drake.MultibodyPlant(0.0)
    drake.Parser(plant).AddModelsFromString(text, kind)
    if kind == "urdf":
        root = ElementTree.fromstring(text)
        moved = {child.get("link") for child in root.iterfind("joint/child")}
        [base] = {link.get("name") for link in root.iterfind("link")} - moved
        plant.WeldFrames(plant.world_frame(), plant.GetFrameByName(base))
    plant.mutable_gravity_field().set_gravity_vector(gravity)
    plant.Finalize()
    assert plant.num_actuators() == len(names)
    context = plant.CreateDefaultContext()
    places = [plant.GetJointByName(name).position_start() for name in names]
    torque = np.empty_like(motion.q)
    for k, (q, dq, ddq) in enumerate(zip(motion.q, motion.dq, motion.ddq, strict=True)):
        ordered = np.empty((3, len(names)))
        ordered[:, places] = q, dq, ddq
        plant.SetPositions(context, ordered[0])
        plant.SetVelocities(context, ordered[1])
        forces = drake.MultibodyForces(plant)
        plant.CalcForceElementsContribution(context, forces)
        torque[k] = plant.CalcInverseDynamics(context, ordered[2], forces)[places]
    return torque


@pytest.mark.parametrize("kind", ["sdf", "urdf"])
@pytest.mark.parametrize("robot", ROBOTS.values(), ids=ROBOTS.keys())
def test_drake_computes_the_identified_torque_but_for_coulomb_friction(robot: Robot, kind: str) -> None:
    model, motion = identified(robot), path(robot, 60)
    file = {"sdf": to_sdf, "urdf": to_urdf}[kind](model)
    found = torque_in_drake(file.content.decode(), robot.gravity, motion, robot.joint_names, kind)
    coulomb = np.array([drives(robot)[f"Fc{j + 1}"] for j in range(robot.n)])
    expected = predicted(model, motion) - coulomb * np.sign(motion.dq)
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())


def named(first: str, second: str) -> Robot:
    """An arm of two joints with these names."""
    text = crooked_urdf(2, 0, (1,), (-1, 0)).replace('"j0"', f'"{first}"').replace('"j1"', f'"{second}"')
    return robot_from_urdf("named", text)


@pytest.mark.parametrize(
    ("names", "called"),
    [
        (("base", "base_mount"), ("base", "base_mount")),
        (("arm::turn", "__slide__"), ("arm_turn", "slide")),
        (("world", " a b"), ("world_", "a b")),
    ],
)
def test_drake_reads_joints_whose_names_sdf_reserves(names: tuple[str, str], called: tuple[str, str]) -> None:
    robot = named(*names)
    model, motion = identified(robot), path(robot, 20)
    file = to_sdf(model)
    found = torque_in_drake(file.content.decode(), robot.gravity, motion, called, "sdf")
    expected = torque_in_drake(to_sdf(identified(named("j0", "j1"))).content.decode(), robot.gravity, motion,
                               ("j0", "j1"), "sdf")  # fmt: skip
    np.testing.assert_allclose(found, expected, atol=1e-9)
    assert any("SDF does not allow the names" in note for note in file.notes) == (names != called)


@pytest.mark.parametrize("kind", ["sdf", "urdf"])
def test_the_error_that_a_file_states_for_drake_is_what_drake_finds(kind: str) -> None:
    file = export_model(measured_model(), kind)
    torque = torque_in_drake(file.content.decode(), ARM.gravity, held_out(), ARM.joint_names, kind)
    assert error_of(torque) == pytest.approx(stated_error(file, "Drake has no Coulomb friction"), rel=0.05)


def test_the_errors_that_a_urdf_states_are_what_pinocchio_finds() -> None:
    file, motion = export_model(measured_model(), "urdf"), held_out()
    text = file.content.decode()
    model = pin.buildModelFromXML(text)
    data = model.createData()
    places = [model.joints[model.getJointId(name)].idx_v for name in ARM.joint_names]
    states = np.empty((3, *motion.q.shape))
    states[:, :, places] = motion.q, motion.dq, motion.ddq
    torque = np.array([pin.rnea(model, data, q, dq, ddq) for q, dq, ddq in zip(*states, strict=True)])
    torque = (torque + model.damping * states[1] + model.friction * np.sign(states[1]))[:, places]
    # Pinocchio does not read the tags of rotors; who wants them sets `armature`.
    assert error_of(torque) == pytest.approx(stated_error(file, "do not read them compute the torque with"), rel=0.05)
    joints = {joint.get("name"): joint for joint in ElementTree.fromstring(text).findall("joint")}
    tags = [joints[name].find(ROTOR_TAG) for name in ARM.joint_names]
    rotors = np.array([0.0 if tag is None else float(tag.get("inertia", "nan")) for tag in tags])
    assert error_of(torque + rotors * motion.ddq) == pytest.approx(stated_error(file, OF_FILE), rel=0.05)


def test_mjx_finds_the_error_that_an_mjcf_states() -> None:
    jax, mjx = import_engine("jax"), import_engine("mujoco.mjx")
    jax.config.update("jax_enable_x64", True)
    file, motion = export_model(measured_model(), "mjcf"), held_out()
    model = mjx.put_model(mujoco.MjModel.from_xml_string(file.content.decode()))

    def compute_torque(q: Any, dq: Any, ddq: Any) -> Any:
        return mjx.inverse(model, mjx.make_data(model).replace(qpos=q, qvel=dq, qacc=ddq)).qfrc_inverse

    torque = np.asarray(jax.jit(jax.vmap(compute_torque))(motion.q, motion.dq, motion.ddq))
    assert error_of(torque) == pytest.approx(stated_error(file, OF_FILE), rel=0.05)


def model_of_stage(content: bytes, folder: Path) -> tuple[pin.Model, dict[str, FloatArray]]:
    """A Pinocchio model built from what usd-core reads of a stage, and armature and friction by joint.

    It stands on the poses of the bodies in the world, not on the frames of the joints in their parents.
    """
    import_engine("pxr")
    from pxr import Usd, UsdGeom, UsdPhysics, UsdValidation

    file = folder / "arm.usda"
    file.write_bytes(content)
    stage = Usd.Stage.Open(str(file))
    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    assert not UsdValidation.ValidationContext(validators).Validate(stage)
    assert UsdGeom.GetStageMetersPerUnit(stage) == 1.0
    assert stage.GetDefaultPrim().HasAPI(UsdPhysics.ArticulationRootAPI)
    model, world, bodies = pin.Model(), {}, {}

    def pose(prim: Any) -> pin.SE3:
        matrix = np.array(UsdGeom.XformCache().GetLocalToWorldTransform(prim))
        return pin.SE3(matrix[:3, :3].T, matrix[3, :3])

    def quaternion(value: Any) -> FloatArray:
        return pin.Quaternion(value.real, *value.imaginary).normalized().matrix()

    drive: dict[str, list[float]] = {"armature": [], "dynamicFrictionEffort": [], "viscousFrictionCoefficient": []}
    names, bounds = [], []
    for prim in stage.Traverse():
        if prim.GetName() == "base":
            bodies[prim.GetPath()] = 0
            world[prim.GetPath()] = pose(prim)
        if not prim.IsA(UsdPhysics.RevoluteJoint) and not prim.IsA(UsdPhysics.PrismaticJoint):
            continue
        revolute = prim.IsA(UsdPhysics.RevoluteJoint)
        joint = (UsdPhysics.RevoluteJoint if revolute else UsdPhysics.PrismaticJoint)(prim)
        [parent], [child] = joint.GetBody0Rel().GetTargets(), joint.GetBody1Rel().GetTargets()
        body = stage.GetPrimAtPath(child)
        world[child] = pose(body)
        here, there = (
            pin.SE3(quaternion(turned.Get()), np.array(place.Get(), dtype=float))
            for turned, place in (
                (joint.GetLocalRot1Attr(), joint.GetLocalPos1Attr()),
                (joint.GetLocalRot0Attr(), joint.GetLocalPos0Attr()),
            )
        )
        # Both frames of the joint are one where q = 0.
        assert (world[parent] * there).isApprox(world[child] * here, 1e-5)
        assert joint.GetAxisAttr().Get() == "X"
        axis = here.rotation[:, 0]
        kind = pin.JointModelRevoluteUnaligned(axis) if revolute else pin.JointModelPrismaticUnaligned(axis)
        index = model.addJoint(bodies[parent], kind, world[parent].inverse() * world[child], prim.GetName())
        bodies[child] = index
        mass = UsdPhysics.MassAPI(body)
        turned = quaternion(mass.GetPrincipalAxesAttr().Get())
        inertia = turned @ np.diag(np.array(mass.GetDiagonalInertiaAttr().Get(), dtype=float)) @ turned.T
        centre = np.array(mass.GetCenterOfMassAttr().Get(), dtype=float)
        model.appendBodyToJoint(index, pin.Inertia(mass.GetMassAttr().Get(), centre, inertia), pin.SE3.Identity())
        for name, values in drive.items():
            values.append(prim.GetAttribute(f"physxJointAxis:{'angular' if revolute else 'linear'}:{name}").Get())
        # PhysX reads friction of a turning joint in N m s/degree.
        drive["viscousFrictionCoefficient"][-1] *= 180.0 / np.pi if revolute else 1.0
        names.append(prim.GetAttribute("dynident:joint").Get())
        limits = joint.GetLowerLimitAttr().Get(), joint.GetUpperLimitAttr().Get()
        bounds.append(np.radians(limits) if revolute else limits)
    scene = UsdPhysics.Scene(stage.GetPrimAtPath(f"{stage.GetDefaultPrim().GetPath()}/scene"))
    direction = np.array(scene.GetGravityDirectionAttr().Get(), dtype=float)
    model.gravity.linear = direction * scene.GetGravityMagnitudeAttr().Get()
    return model, {key: np.array(values) for key, values in drive.items()} | {
        "names": np.array(names),
        "limits": np.array(bounds),
    }


def torque_of_usd(file: ExportedFile, motion: Motion, folder: Path) -> FloatArray:
    model, drive = model_of_stage(file.content, folder)
    data = model.createData()
    rows = zip(motion.q, motion.dq, motion.ddq, strict=True)
    rigid = np.array([pin.rnea(model, data, q, dq, ddq) for q, dq, ddq in rows])
    friction = drive["dynamicFrictionEffort"] * np.sign(motion.dq) + drive["viscousFrictionCoefficient"] * motion.dq
    return np.asarray(rigid + friction + drive["armature"] * motion.ddq)


@pytest.mark.parametrize("robot", ROBOTS.values(), ids=ROBOTS.keys())
def test_a_usd_stage_has_the_identified_torque(robot: Robot, tmp_path: Path) -> None:
    model, motion = identified(robot), path(robot, 60)
    file = to_usd(model)
    # Most attributes of UsdPhysics have single precision.
    expected = predicted(model, motion)
    np.testing.assert_allclose(torque_of_usd(file, motion, tmp_path), expected, atol=3e-6 * np.abs(expected).max())
    _, drive = model_of_stage(file.content, tmp_path)
    assert tuple(drive["names"]) == robot.joint_names
    for joint, limits in zip(robot.joints, drive["limits"], strict=True):
        if joint.limits.position is not None:
            np.testing.assert_allclose(limits, joint.limits.position, rtol=1e-6)


def test_the_error_that_a_usd_states_is_what_its_reader_finds(tmp_path: Path) -> None:
    file = to_usd(measured_model())
    assert error_of(torque_of_usd(file, held_out(), tmp_path)) == pytest.approx(stated_error(file, OF_FILE), rel=0.05)


def inverse_in_mujoco(model: Identification, motion: Motion, period: float) -> FloatArray:
    simulated = to_mujoco(model)
    data, torque = mujoco.MjData(simulated), np.empty_like(motion.q)
    with MissingTorque(simulated, model):
        for k in range(len(motion.q)):
            data.time = k * period
            data.qpos, data.qvel, data.qacc = motion.q[k], motion.dq[k], motion.ddq[k]
            mujoco.mj_inverse(simulated, data)
            torque[k] = data.qfrc_inverse
    return torque


@pytest.mark.parametrize("name", ["ur10", "scara"])
def test_mujoco_with_the_missing_torque_has_every_effect(name: str) -> None:
    robot = arm(name)
    model, motion = identified(robot, RICH), path(robot)
    used, expected = moving(motion), predicted(model, motion)
    found = inverse_in_mujoco(model, motion, 0.01)
    np.testing.assert_allclose(found[used], expected[used], rtol=1e-9, atol=1e-9 * np.abs(expected).max())


def test_mujoco_with_the_missing_torque_has_the_error_of_the_model() -> None:
    model = measured_model()
    torque = inverse_in_mujoco(model, held_out(), 0.005)
    # The noise of single samples, which preprocessing filters, is in both.
    assert error_of(torque) == pytest.approx(error_of(predicted(model, held_out())), rel=0.05)
    assert error_of(torque) < 0.5 * stated_error(to_mjcf(model), OF_FILE)


def test_the_callback_leaves_other_models_and_the_process_as_they_were() -> None:
    model = identified(ARM, RICH)
    simulated = to_mujoco(model)
    data, other = mujoco.MjData(simulated), mujoco.MjModel.from_xml_string(to_mjcf(model).content.decode())
    plain = mujoco.MjData(other)
    mujoco.mj_forward(other, plain)
    before = plain.qacc.copy()
    with MissingTorque(simulated, model):
        mujoco.mj_forward(simulated, data)
        mujoco.mj_forward(other, plain)
    np.testing.assert_array_equal(plain.qacc, before)
    assert mujoco.get_mjcb_passive() is None
    with pytest.raises(DynidentError, match="no space"):
        MissingTorque(other, model)


def test_temperatures_are_as_many_as_joints() -> None:
    model = identified(ARM)
    with pytest.raises(DynidentError, match=r"temperature has the shape \(2,\); give 4 numbers"):
        MissingTorque(to_mujoco(model), model, temperature=np.array([20.0, 30.0]))


def test_a_joint_that_friction_holds_stands_still_in_mujoco() -> None:
    model = identified(ARM, (*PLAIN, "stribeck"))
    simulated = to_mujoco(model)
    data = mujoco.MjData(simulated)
    # The first joint turns about the vertical: gravity does not move it. Coulomb and Stribeck friction hold it.
    data.qfrc_applied[0] = drives(ARM)["Fc1"] + 0.3
    with MissingTorque(simulated, model):
        mujoco.mj_step(simulated, data, 200)
        assert abs(data.qvel[0]) < 1e-3
        data.qfrc_applied[0] += 0.5
        mujoco.mj_step(simulated, data, 200)
    assert data.qvel[0] > 0.01


def drive_torque(robot: Robot, samples: int) -> FloatArray:
    """Torques (m, n) that make all joints swing, at 1 kHz."""
    times = 1e-3 * np.arange(samples)
    return np.asarray(np.abs(predicted(identified(robot), path(robot, 60))).max(axis=0) * 0.3
                      * np.sin(np.outer(times, 2.0 + np.arange(robot.n))))  # fmt: skip


class Fmu:
    """An FMU that fmpy runs."""

    def __init__(self, file: ExportedFile, folder: Path) -> None:
        fmpy = import_engine("fmpy")
        from fmpy.fmi3 import FMU3Slave
        from fmpy.validation import validate_fmu

        place = folder / file.name
        place.write_bytes(file.content)
        assert not validate_fmu(str(place))
        description = fmpy.read_model_description(str(place))
        self.names = {variable.name: variable.valueReference for variable in description.modelVariables}
        self.slave = FMU3Slave(
            guid=description.guid,
            unzipDirectory=fmpy.extract(str(place), str(folder / "unzipped")),
            modelIdentifier=description.coSimulation.modelIdentifier,
            instanceName="arm",
        )
        self.slave.instantiate()
        self.time = 0.0

    def begin(self, **values: float) -> None:
        self.slave.enterInitializationMode()
        self.set(**values)
        # Other programs read outputs here already.
        asked = self.get("ddq", 1)
        self.slave.exitInitializationMode()
        np.testing.assert_array_equal(self.get("ddq", 1), asked)

    def set(self, **values: float) -> None:
        self.slave.setFloat64([self.names[name] for name in values], list(values.values()))

    def get(self, name: str, n: int) -> FloatArray:
        return np.array(self.slave.getFloat64([self.names[f"{name}[{j + 1}]"] for j in range(n)]))

    def step(self, tau: FloatArray, period: float = 1e-3) -> None:
        self.set(**{f"tau[{j + 1}]": float(value) for j, value in enumerate(tau)})
        self.slave.doStep(self.time, period)
        self.time += period

    def close(self) -> None:
        self.slave.terminate()
        self.slave.freeInstance()


@pytest.mark.parametrize("effects", [PLAIN, RICH], ids=["plain", "rich"])
@pytest.mark.parametrize("name", ["ur10", "scara"])
def test_an_fmu_moves_as_mujoco_does(name: str, effects: tuple[str, ...], tmp_path: Path) -> None:
    robot = arm(name)
    model, n = identified(robot, effects), robot.n
    fmu = Fmu(to_fmu(model), tmp_path)
    fmu.begin()
    simulated = to_mujoco(model)
    simulated.opt.timestep = 1e-4
    simulated.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_LIMIT
    data, torque, apart, size = mujoco.MjData(simulated), drive_torque(robot, 500), 0.0, 0.0
    with MissingTorque(simulated, model):
        for tau in torque:
            data.qfrc_applied[:] = tau
            mujoco.mj_step(simulated, data, 10)
            fmu.step(tau)
            apart = max(apart, np.abs(fmu.get("q", n) - data.qpos).max())
            size = max(size, np.abs(data.qpos).max())
    fmu.close()
    assert size > 0.1
    # MuJoCo's steps are of first order, and its friction is soft.
    assert apart < 5e-3 * size


def test_accelerations_of_an_fmu_are_those_of_the_model(tmp_path: Path) -> None:
    model, motion = identified(ARM, (*PLAIN, "stribeck", "viscous_nonlinear")), path(ARM, 60)
    torque, used = predicted(model, motion), np.flatnonzero(moving(motion))[::8]
    file = to_fmu(model)
    for k in used:
        fmu = Fmu(file, tmp_path)
        start = {f"q[{j + 1}]": float(motion.q[k, j]) for j in range(ARM.n)}
        start |= {f"dq[{j + 1}]": float(motion.dq[k, j]) for j in range(ARM.n)}
        start |= {f"tau[{j + 1}]": float(torque[k, j]) for j in range(ARM.n)}
        fmu.begin(**start)
        # The first step is 1 µs long.
        np.testing.assert_allclose(fmu.get("ddq", ARM.n), motion.ddq[k], rtol=1e-3, atol=1e-3)
        fmu.close()


def test_an_fmu_states_the_error_that_it_has_on_held_out_motion(tmp_path: Path) -> None:
    motion, n, every = held_out(), ARM.n, 20
    file, torque = to_fmu(identify_arm()), needed(motion, 1)
    fmu = Fmu(file, tmp_path)
    for k in np.flatnonzero(moving(motion))[::every]:
        accelerations = []
        for extra in (np.zeros(n), *np.eye(n)):
            fmu.slave.reset()
            values = {"q": motion.q[k], "dq": motion.dq[k], "tau": torque[k] + extra}
            fmu.begin(**{f"{name}[{j + 1}]": float(v) for name, of in values.items() for j, v in enumerate(of)})
            accelerations.append(fmu.get("ddq", n))
        # The torque that the FMU needs for the recorded acceleration, by the mobility that it shows itself.
        mobility = np.column_stack([moved - accelerations[0] for moved in accelerations[1:]])
        torque[k] += np.linalg.solve(mobility, motion.ddq[k] - accelerations[0])
    fmu.close()
    with zipfile.ZipFile(BytesIO(file.content)) as archive:
        check_stated_error(archive.read("documentation/index.html").decode(), torque, every)


def impossible_model() -> Identification:
    """The measured model with a rotor that no robot has."""
    model = measured_model()
    values = model.values.copy()
    values[[column.name for column in model.model.kept].index("Ia2")] = -0.5
    estimate = replace(model.estimate, solution=replace(model.estimate.solution, values=values))
    return replace(model, estimate=estimate)


def test_programs_have_parameters_of_a_robot_and_say_what_that_costs() -> None:
    model = impossible_model()
    file = export_model(model, "c_header")
    [note] = [note for note in file.notes if "would gain energy" in note]
    assert "Ia2 = -0.5 kg m²" in note
    possible = make_physical(model).identification
    assert file.held_out_error == possible.held_out_judged.relative_total
    assert f"Ia2 = {possible.values[[c.name for c in possible.model.kept].index('Ia2')]:.9g}" in file.content.decode()
    # A record of what was identified holds just that.
    assert b"-0.5" in export_model(model, "json").content


def test_programs_of_one_model_solve_it_once_and_do_not_keep_it(monkeypatch: pytest.MonkeyPatch) -> None:
    calls, solve = [], remove_and_solve_again.reidentify
    monkeypatch.setattr(remove_and_solve_again, "reidentify", lambda *of: calls.append(of) or solve(*of))
    model = impossible_model()
    for format in ("c", "c_header", "casadi"):
        assert any("would gain energy" in note for note in export_model(model, format).notes)
    assert len(calls) == 1
    there = weakref.ref(model)
    calls.clear()
    del model
    gc.collect()
    assert there() is None


def written_at_head(file: ExportedFile) -> str:
    """The text of a file with its comment marks and line breaks taken out."""
    return " ".join(file.content.decode().replace("\n *", " ").split())


@pytest.mark.parametrize("format", ["c", "c_header", "cpp_header"])
def test_a_text_says_at_its_head_that_parameters_were_changed(format: str) -> None:
    file = export_model(impossible_model(), format)
    [note] = [note for note in file.notes if "would gain energy" in note]
    assert " ".join(note.split()) in written_at_head(file)


def test_other_programs_say_it_where_they_have_documentation() -> None:
    for format, part in (("ros2", ".hpp"), ("fmu", "index.html")):
        file = export_model(impossible_model(), format)
        with zipfile.ZipFile(BytesIO(file.content)) as archive:
            texts = [archive.read(name).decode() for name in archive.namelist() if name.endswith(part)]
        assert any("would gain energy" in " ".join(text.replace("\n *", " ").split()) for text in texts)
        assert any("would gain energy" in note for note in file.notes)


def test_a_program_says_that_it_could_gain_energy_where_nothing_better_is_known(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def refuse(*_: object) -> Identification:
        raise DynidentError("no")

    model = impossible_model()
    with pytest.warns(UserWarning, match="would gain energy in a simulation"):
        simulated = to_mujoco(model)
    with pytest.warns(UserWarning, match="would gain energy in a simulation"):
        MissingTorque(simulated, model)
    monkeypatch.setattr(remove_and_solve_again, "reidentify", refuse)
    model = impossible_model()
    for format in ("c", "casadi"):
        assert (
            "A simulation with these parameters could gain energy: Ia2 = -0.5 kg m²."
            in export_model(model, format).notes
        )
    monkeypatch.setattr(remove_and_solve_again, "reidentify", lambda identification, _: identification)
    assert any("could gain energy: Ia2" in note for note in export_model(model, "c").notes)
    with pytest.warns(UserWarning, match="could gain energy: Ia2"):
        MissingTorque(simulated, model)


def with_falling_friction(joint: int = 0) -> Identification:
    """The measured model with friction of a joint that falls at higher speeds."""
    model = measured_model()
    values = model.values.copy()
    values[[column.name for column in model.model.kept].index(f"Fvn{joint + 1}")] = -1.0
    return replace(model, estimate=replace(model.estimate, solution=replace(model.estimate.solution, values=values)))


def test_programs_say_where_their_friction_is_not_the_identified_one() -> None:
    model = with_falling_friction()
    values = model.values.copy()
    values[[column.name for column in model.model.kept].index("Fc1")] = 30.0
    model = replace(model, estimate=replace(model.estimate, solution=replace(model.estimate.solution, values=values)))
    speed = f"{ARM.joint_names[0]} {model.estimate.speeds[0]:.3g} rad/s"
    [note] = [note for note in export_model(model, "casadi").notes if "falls" in note]
    assert f"at these speeds: {speed}. The error on held-out data is that of the identified friction" in note
    assert ARM.joint_names[1] not in note
    assert not any("falls" in note for note in export_model(measured_model(), "casadi").notes)


def test_mujoco_has_the_friction_of_other_programs_beyond_the_recorded_speeds() -> None:
    model = with_falling_friction()
    values, speed = model.values.copy(), float(model.estimate.speeds[0])
    names = [column.name for column in model.model.kept]
    # A sum that rises up to the recorded speed, and falls behind it.
    values[[names.index(name) for name in ("Fc1", "Fv1", "Fvn1")]] = 1.0, 9.0 / speed, -3.0 / speed**2
    model = replace(model, estimate=replace(model.estimate, solution=replace(model.estimate.solution, values=values)))
    assert make_physical(model).identification is model
    simulated = to_mujoco(model)
    data = mujoco.MjData(simulated)

    def friction(factor: float) -> float:
        torque = []
        for dq in (factor * speed, -factor * speed):
            data.qpos, data.qacc, data.qvel = 0.0, 0.0, 0.0
            data.qvel[0] = dq
            mujoco.mj_inverse(simulated, data)
            torque.append(data.qfrc_inverse[0])
        return float(torque[0] - torque[1]) / 2

    with MissingTorque(simulated, model):
        for factor in (0.5, 1.0, 1.2, 2.0, 3.0):
            law = 1.0 + 9.0 * factor - 3.0 * factor**2
            expected = law if factor <= 1.0 else max(law, 7.0)
            assert friction(factor) == pytest.approx(expected, rel=2e-3), factor


def test_friction_in_programs_does_not_fall_beyond_the_recorded_speeds() -> None:
    model = with_falling_friction()
    values, estimate = model.values, model.estimate
    names = [column.name for column in model.model.kept]
    equation, speed = build_equation_of_motion(estimate), float(estimate.speeds[0])
    friction = ca.Function("friction", [equation.get_symbol("dq"), equation.base], [equation.friction])
    formula = build_torque_formula(estimate)
    torque = ca.Function("torque", [argument.symbol for argument in formula.arguments], [formula.torque])

    def law(size: float) -> float:
        return float(values[names.index("Fc1")] + values[names.index("Fv1")] * size - size**2)

    for size in (0.5 * speed, speed, 5 * speed):
        dq = np.array([size, 0.0, 0.0, 0.0])
        expected = max(law(size), law(min(size, speed)))
        assert float(friction(dq, values)[0]) == pytest.approx(expected, rel=1e-9)
        assert float(friction(-dq, values)[0]) == pytest.approx(-expected, rel=1e-9)
        change = torque(np.zeros(4), dq, np.zeros(4)) - torque(np.zeros(4), -dq, np.zeros(4))
        assert float(change[0]) == pytest.approx(2 * expected, rel=1e-9)
    assert law(5 * speed) < law(speed)


def test_an_fmu_rests_carries_a_load_and_goes_back_to_a_state(tmp_path: Path) -> None:
    robot = arm("ur10")
    model = identified(robot, (*PLAIN, "presliding"))
    fmu = Fmu(to_fmu(model), tmp_path)
    fmu.begin()
    holding = -predicted(model, Motion(np.zeros(2), *(np.zeros((2, robot.n)),) * 3))[0] * -1.0
    for _ in range(50):
        fmu.step(holding)
    # Friction holds what rounding leaves: nothing creeps.
    assert np.abs(fmu.get("q", robot.n)).max() < 1e-9
    state = fmu.slave.getFMUState()
    fmu.set(**{"payload.mass": 10.0, "payload.centre_z": 0.1})
    for _ in range(50):
        fmu.step(holding)
    fallen = fmu.get("q", robot.n)
    assert np.abs(fallen).max() > 1e-3
    fmu.slave.setFMUState(state)
    assert np.abs(fmu.get("q", robot.n)).max() < 1e-9
    fmu.close()


def test_the_sources_of_an_fmu_compile_strictly(tmp_path: Path) -> None:
    with zipfile.ZipFile(_write(to_fmu(identified(ARM, RICH)), tmp_path)) as archive:
        archive.extractall(tmp_path)
    for name in ("gcc", "clang"):
        if compiler := shutil.which(name):
            options = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-O1", "-fPIC", "-shared"]
            subprocess.run(
                [compiler, *options, str(tmp_path / "sources/fmu.c"), "-o", str(tmp_path / "fmu.so"), "-lm"],
                check=True,
                timeout=300,
            )


def test_equal_models_are_equal_fmus_and_no_compiler_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    model = identified(ARM)
    assert to_fmu(model).content == to_fmu(model).content
    monkeypatch.setattr(shutil, "which", lambda name: None)
    assert any("no C compiler" in note for note in to_fmu(model).notes)


def _write(file: ExportedFile, folder: Path) -> Path:
    place = folder / file.name
    place.write_bytes(file.content)
    return place


class Recorder(ModuleType):
    """Stands for mjlab or Isaac Lab: its classes keep what they are called with."""

    def __getattr__(self, name: str) -> Any:
        return lambda **fields: SimpleNamespace(kind=name, **fields)


def run_actuators(file: ExportedFile, module: str, monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    package = module.split(".")[0]
    for name in (package, module):
        monkeypatch.setitem(__import__("sys").modules, name, Recorder(name))
    space: dict[str, Any] = {}
    exec(compile(ast.parse(file.content.decode()), file.name, "exec"), space)
    return space


def test_actuators_of_mjlab_give_the_joints_of_the_mjcf(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    model = identified(ARM)
    space = run_actuators(export_model(model, "mjlab"), "mjlab.actuator", monkeypatch)
    mjcf = _write(to_mjcf(model), tmp_path)
    spec, whole = space["load_spec"](str(mjcf)), mujoco.MjModel.from_xml_path(str(mjcf))
    assert not len(spec.actuators)
    actuators = space["torque_actuators"]()
    for actuator in actuators:
        [name] = actuator.target_names_expr
        [joint] = whole.joint(re.sub(r"\\(.)", r"\1", name)).dofadr
        assert actuator.armature == whole.dof_armature[joint]
        assert actuator.frictionloss == whole.dof_frictionloss[joint]
        assert actuator.viscous_damping == whole.dof_damping[joint, ...].flat[0]
    gains = dict.fromkeys(ARM.joint_names, 10.0)
    assert all(actuator.stiffness == 10.0 for actuator in space["position_actuators"](gains, gains))


def test_gains_of_mjlab_are_by_the_joints_own_names(monkeypatch: pytest.MonkeyPatch) -> None:
    names = ("arm-1.turn", "slide (z)")
    space = run_actuators(export_model(identified(named(*names)), "mjlab"), "mjlab.actuator", monkeypatch)
    gains = dict(zip(names, (1.0, 2.0), strict=True))
    for actuator, name in zip(space["position_actuators"](gains, gains), names, strict=True):
        assert actuator.stiffness == gains[name]
        assert re.fullmatch(actuator.target_names_expr[0], name)


def test_actuators_of_isaac_lab_have_the_joints_of_the_usd(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    model = identified(ARM)
    space = run_actuators(export_model(model, "isaac_lab"), "isaaclab.actuators", monkeypatch)
    actuator = space["torque_actuators"]()["arm"]
    assert (actuator.kind, actuator.stiffness, actuator.damping) == ("ImplicitActuatorCfg", 0.0, 0.0)
    pinocchio_model, drive = model_of_stage(to_usd(model).content, tmp_path)
    names = [re.escape(name) for name in list(pinocchio_model.names)[1:]]
    assert actuator.joint_names_expr == names
    for field, attribute in (
        ("armature", "armature"),
        ("friction", "dynamicFrictionEffort"),
        ("dynamic_friction", "dynamicFrictionEffort"),
        ("viscous_friction", "viscousFrictionCoefficient"),
    ):
        values = [getattr(actuator, field)[name] for name in names]
        np.testing.assert_allclose(values, drive[attribute], rtol=1e-6)
    delayed = space["delayed_actuators"](100.0, 10.0, 1, 2)["arm"]
    assert (delayed.kind, delayed.min_delay, delayed.max_delay) == ("DelayedPDActuatorCfg", 1, 2)
