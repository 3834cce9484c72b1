"""Identification, diagnosis and export of machines with tied joints and closed loops."""

from __future__ import annotations

import json
import re
from functools import cache
from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from support.closed_loop_robots import machine, palletiser

from dynident.effects import EffectChoice
from dynident.errors import DynidentError
from dynident.export.mjcf import to_mjcf
from dynident.export.urdf import to_urdf
from dynident.identification import Identification, IdentificationChoices, identify
from dynident.identification.column_inference.file_inspection import inspect_file
from dynident.recordings import Recording, recording_from_arrays
from dynident.robot import Robot, to_pinocchio
from dynident.robot.modified_dh import robot_from_modified_dh
from dynident.simulation import TrueEffect, VirtualRobot

RATE = 250.0
COULOMB, VISCOUS = 3.0, 2.0
PAGE = Path(__file__).parents[2] / "docs" / "closed-loops.md"


def recorded(robot: Robot, seed: int, noise: float = 1e-3) -> Recording:
    """A motion of sines within the limits.

    The torque is that of Pinocchio's tree seen from the driven joints, with friction of the driven joints and of a
    passive one.
    """
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 20.0, 1 / RATE)
    low, high = np.array([joint.limits.position for joint in robot.joints]).T
    w = 2 * np.pi * 0.1 * np.arange(1, 6)[:, None, None]
    a, phase = rng.normal(size=(5, 1, robot.n)) / np.arange(1, 6)[:, None, None], rng.uniform(0, 6.28, (5, 1, robot.n))
    shape = (a * np.sin(w * t[:, None] + phase)).sum(0)
    size = 0.45 * (high - low) / np.abs(shape).max(0)
    q = 0.5 * (low + high) + size * shape
    dq = size * (a * w * np.cos(w * t[:, None] + phase)).sum(0)
    ddq = -size * (a * w**2 * np.sin(w * t[:, None] + phase)).sum(0)
    whole = robot.linkage.compute_motion(q, dq, ddq)
    model = to_pinocchio(robot)
    data = model.createData()
    tau = np.array([pin.rnea(model, data, *state) for state in zip(*whole, strict=True)])
    forearm = robot.tree.joint_names.index("forearm")
    v = whole[1][:, forearm]
    tau[:, forearm] += COULOMB * np.sign(v) + VISCOUS * v
    driven = np.einsum("mij,mi->mj", robot.linkage.compute_jacobian(q), tau) + COULOMB * np.sign(dq) + VISCOUS * dq
    driven += noise * np.abs(driven).max(0) * rng.normal(size=q.shape)
    return recording_from_arrays(t, q, driven, joint_names=robot.joint_names, name=f"run{seed}")


def choices(robot: Robot) -> IdentificationChoices:
    joints = (*robot.joint_names, "forearm")
    effects = [EffectChoice("rigid_body"), EffectChoice("coulomb", joints), EffectChoice("viscous", joints)]
    return IdentificationChoices(effects=tuple(effects), estimator="wls")


@cache
def identified(name: str) -> tuple[Identification, list[Recording]]:
    robot = machine(name)
    runs = [recorded(robot, seed) for seed in (1, 2, 3)]
    return identify(robot, runs[:2], runs[2:], choices(robot)), runs


@pytest.mark.parametrize("name", ["palletiser", "six_axis"])
def test_links_and_friction_on_both_sides_of_a_loop_are_found(name: str) -> None:
    found, _ = identified(name)
    robot = found.model.robot
    assert found.held_out_moving.relative.max() < 0.01
    values = {c.name: v for c, v in zip(found.model.kept, found.values, strict=True)}
    for joint in (*robot.joint_names, "forearm"):
        number = robot.tree.joint_names.index(joint) + 1
        assert values[f"Fc{number}"] == pytest.approx(COULOMB, rel=0.05)
        assert values[f"Fv{number}"] == pytest.approx(VISCOUS, rel=0.1)
    standard = np.zeros(len(found.model.columns))
    rigid = [k for k, column in enumerate(found.model.columns) if column.effect == "rigid_body"]
    standard[rigid] = robot.inertias.reshape(-1)
    truth = found.model.base.grouping @ standard
    inertial = np.array([column.effect == "rigid_body" for column in found.model.kept])
    large = inertial & (np.abs(truth) > 0.5)
    np.testing.assert_allclose(found.values[large], truth[large], rtol=0.05, atol=0.05)


def test_mujoco_takes_the_exported_machine_with_its_loop_and_its_tie() -> None:
    found, _ = identified("six_axis")
    text = to_mjcf(found, nearest=True).content.decode()
    model = mujoco.MjModel.from_xml_string(text)
    assert model.njnt == found.model.robot.tree.n
    assert model.nu == found.model.robot.n
    kinds = [mujoco.mjtEq(kind) for kind in model.eq_type]
    assert set(kinds) == {mujoco.mjtEq.mjEQ_CONNECT, mujoco.mjtEq.mjEQ_TENDON}


def test_a_urdf_cannot_hold_a_loop_and_says_what_can() -> None:
    found, _ = identified("palletiser")
    with pytest.raises(DynidentError, match="has closed loops, but a URDF can only describe a tree"):
        to_urdf(found, nearest=True)


def test_a_recording_beyond_what_the_loops_allow_is_refused_with_the_instant() -> None:
    robot = machine("five_bar")
    t = np.arange(0.0, 10.0, 1 / RATE)
    q = np.array([2.2, 0.9]) + np.array([0.9, -0.9]) * np.sin(2 * np.pi * 0.2 * t)[:, None]
    run = recording_from_arrays(t, q, np.cos(q), joint_names=robot.joint_names, name="far")
    with pytest.raises(DynidentError, match=r"At t = [\d.]+ s the loops \(tip\) are open by"):
        identify(robot, [run], [], IdentificationChoices(effects=(EffectChoice("rigid_body"),)))


def test_the_virtual_robot_moves_with_friction_on_a_passive_joint() -> None:
    robot = machine("palletiser")
    virtual = VirtualRobot(robot, [TrueEffect("coulomb", "forearm", (("Fc", 5.0),))])
    q = np.array([[0.1, 1.3, 2.9, 0.2]])
    dq = np.array([[0.0, 0.3, -0.2, 0.0]])
    links = virtual.dynamics.rigid(q, dq, 0 * q)
    whole = robot.linkage.compute_motion(q, dq, 0 * q)
    model = to_pinocchio(robot)
    expected = robot.linkage.compute_jacobian(q)[0].T @ pin.rnea(
        model, model.createData(), *(part[0] for part in whole)
    )
    np.testing.assert_allclose(links[0], expected, rtol=1e-9, atol=1e-9)


def test_the_palletiser_of_the_page_is_read() -> None:
    text = re.search(r"<!-- palletiser.json -->\n```json\n(.*?)```", PAGE.read_text(), re.DOTALL)
    robot = robot_from_modified_dh("palletiser", text[1])
    assert robot.joint_names == ("yaw", "arm", "lever", "flange")
    assert json.loads(text[1])["loops"] == palletiser()["loops"]


def test_a_file_of_a_machine_with_loops_is_understood_from_its_driven_joints(tmp_path: Path) -> None:
    robot = machine("palletiser")
    rows = next(iter(recorded(robot, 1).source.rows(0, 3000, 3000)))
    t = np.arange(3000) / RATE
    passive = robot.linkage.compute_positions(rows.q)[:, list(robot.linkage.passive)]
    # Encoders of passive joints, whose names begin as those of driven ones: forearm and arm, and a rod.
    of_passive = [f"q_{robot.tree.joint_names[j]}" for j in robot.linkage.passive]
    of_driven = [f"{signal}_{name}" for signal in ("q", "tau") for name in robot.joint_names]
    columns = np.column_stack([t, passive, rows.q, rows.tau])
    header = ",".join(["t", *of_passive, *of_driven])
    np.savetxt(tmp_path / "run.csv", columns, delimiter=",", header=header, comments="")
    found = inspect_file(tmp_path / "run.csv", robot).proposal
    assert found.effort_kind == "joint_torque"
    assert found.is_sure
    assert [found.columns[f"q{k}"] for k in range(1, 5)] == [f"q_{name}" for name in robot.joint_names]
    assert any("q_forearm, q_rod" in one.value and "passive joints" in one.reason for one in found.guesses)
