"""An identified load in the forms that makers' controllers take."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache

import numpy as np
import pinocchio as pin
import pytest
from support.oracles import arm, fourier_motion, pinocchio_torque, record

from dynident.effects import EffectChoice
from dynident.errors import DynidentError
from dynident.export import export_model, identify_load, to_ur_friction
from dynident.identification import Identification, IdentificationChoices, identify
from dynident.recordings import Preprocessing, Recording

ROBOT = arm("ur10")
EFFECTS = tuple(EffectChoice(name) for name in ("rigid_body", "rotor_inertia", "coulomb", "viscous"))
MASS, CENTRE = 4.0, np.array([0.03, -0.02, 0.1])
INERTIA = np.array([[0.06, 0.004, -0.003], [0.004, 0.05, 0.006], [-0.003, 0.006, 0.03]])


def run(name: str, seed: int, *, carries: bool) -> Recording:
    motion = fourier_motion(ROBOT, 12.0, 200.0, seed=seed)
    inertias = ROBOT.inertias.copy()
    if carries:
        about_origin = INERTIA + MASS * (CENTRE @ CENTRE * np.eye(3) - np.outer(CENTRE, CENTRE))
        inertias[-1] += np.concatenate([about_origin[np.triu_indices(3)], MASS * CENTRE, [MASS]])
    tau = pinocchio_torque(replace(ROBOT, inertias=inertias), motion.q, motion.dq, motion.ddq)
    tau = tau + 1.5 * np.sign(motion.dq) + 2.0 * motion.dq + 0.2 * motion.ddq
    return record(ROBOT, motion, tau + 0.05 * np.random.default_rng(seed).normal(size=tau.shape), name)


@cache
def loaded(noise: float = 0.0) -> Identification:
    choices = IdentificationChoices(
        (*EFFECTS, EffectChoice("payload", runs=("carrying",))), preprocessing=Preprocessing(20.0, 15.0, 5)
    )
    return identify(ROBOT, [run("empty", 1, carries=False), run("carrying", 2, carries=True)], [], choices)


def numbers(line: str) -> np.ndarray:
    return np.array([float(word) for word in re.findall(r"-?\d+\.?\d*(?:e-?\d+)?", line)])


def statement(format: str) -> str:
    """The line of a file that is no comment."""
    return export_model(loaded(), format).content.decode().splitlines()[-1]


def test_the_load_has_its_mass_its_centre_and_its_inertia() -> None:
    load = identify_load(loaded())
    assert load.mass == pytest.approx(MASS, abs=3 * load.mass_error)
    assert load.mass_error < 0.05
    np.testing.assert_array_less(np.abs(load.centre - CENTRE), 3 * load.centre_error + 1e-4)
    assert load.centre_error.max() < 2e-3
    np.testing.assert_allclose(load.inertia, INERTIA, atol=5e-3)
    assert any("±" in line and "kg" in line for line in load.describe())


def test_urscript_has_the_products_of_inertia_behind_the_moments() -> None:
    load, line = identify_load(loaded()), statement("urscript")
    assert line.startswith("set_target_payload(")
    found = numbers(line)
    i = load.inertia
    np.testing.assert_allclose(found[:4], [load.mass, *load.centre], rtol=1e-5)
    np.testing.assert_allclose(found[4:], [i[0, 0], i[1, 1], i[2, 2], i[0, 1], i[0, 2], i[1, 2]], rtol=1e-5)
    text = export_model(loaded(), "urscript").content.decode()
    assert all(line.startswith(("#", "set_target_payload")) for line in text.splitlines())


def test_libfranka_gets_the_whole_matrix() -> None:
    load, line = identify_load(loaded()), statement("franka_load")
    assert line.startswith("robot.setLoad(")
    np.testing.assert_allclose(numbers(line)[4:].reshape(3, 3).T, load.inertia, rtol=1e-5)


def test_kuka_gets_millimetres_and_principal_axes() -> None:
    load, line = identify_load(loaded()), statement("kuka_load")
    mass, x, y, z, a, b, c, *moments = numbers(line.split("=")[1])
    assert mass == pytest.approx(load.mass, rel=1e-5)
    np.testing.assert_allclose([x, y, z], 1e3 * load.centre, rtol=1e-5)
    axes = (
        pin.utils.rotate("z", np.radians(a))
        @ pin.utils.rotate("y", np.radians(b))
        @ pin.utils.rotate("x", np.radians(c))
    )
    np.testing.assert_allclose(axes @ np.diag(moments) @ axes.T, load.inertia, atol=1e-6)


def test_a_urdf_link_is_one_that_pinocchio_reads() -> None:
    load, text = identify_load(loaded()), export_model(loaded(), "load_urdf").content.decode()
    carrier = re.search(r'<parent link="([^"]+)"', text).group(1)
    model = pin.buildModelFromXML(
        f'<robot name="r"><link name="{carrier}"/>{text.split("-->")[1]}</robot>', pin.JointModelFreeFlyer()
    )
    np.testing.assert_allclose(model.inertias[1].mass, load.mass, rtol=1e-9)
    np.testing.assert_allclose(model.inertias[1].lever, load.centre, rtol=1e-9)
    np.testing.assert_allclose(model.inertias[1].inertia, load.inertia, rtol=1e-9)


def test_a_model_without_a_load_says_what_to_do() -> None:
    plain = identify(ROBOT, [run("empty", 1, carries=False)], [], IdentificationChoices(EFFECTS))
    with pytest.raises(DynidentError, match="effect payload"):
        export_model(plain, "urscript")


def with_friction(viscous: float, coulomb: float, seed: int) -> Identification:
    """The arm with this friction in the commanded torque: what its own compensation leaves."""
    motion = fourier_motion(ROBOT, 12.0, 200.0, seed=seed)
    tau = pinocchio_torque(ROBOT, motion.q, motion.dq, motion.ddq) + 0.2 * motion.ddq
    tau = tau + coulomb * np.sign(motion.dq) + viscous * motion.dq
    tau += 0.05 * np.random.default_rng(seed).normal(size=tau.shape)
    choices = IdentificationChoices(EFFECTS, preprocessing=Preprocessing(20.0, 15.0, 5))
    return identify(ROBOT, [record(ROBOT, motion, tau)], [], choices)


def test_shares_of_the_own_compensation_of_a_ur_arm_cancel_its_friction() -> None:
    # The maker's coefficients are 2.5 N m s/rad, which is too much, and 1.2 N m, which is too little.
    file = to_ur_friction(with_friction(2.0, 1.5, 1), with_friction(2.0 - 2.5, 1.5 - 1.2, 2))
    rows = {line.split(":")[0].strip(): line for line in file.content.decode().splitlines() if line.startswith("  ")}
    np.testing.assert_allclose(numbers(rows["viscous_scale"]), 2.0 / 2.5, atol=0.03)
    np.testing.assert_array_equal(numbers(rows["coulomb_scale"]), 1.0)
    text = file.content.decode()
    for joint in ROBOT.joint_names:
        [share, error] = numbers(re.search(rf"# {joint} coulomb_scale: (.*)", text)[1])
        assert abs(share - 1.5 / 1.2) < 2 * error + 0.01
        assert any(joint in note and "Coulomb" in note.title() for note in file.notes)
    assert "parameters:" in text.splitlines()


def test_a_compensation_that_recordings_do_not_show_is_refused() -> None:
    model = with_friction(2.0, 1.5, 1)
    with pytest.raises(DynidentError, match="do not show the compensation"):
        to_ur_friction(model, model)
