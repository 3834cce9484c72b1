"""A file that cannot hold all of a model holds the best one that it can, and says how good that is."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from xml.etree import ElementTree

import numpy as np
import pytest
from support.exported_robots import moving, torque_of_mjcf, torque_of_urdf
from support.floating_robots import WALKER
from support.models_with_chosen_parameters import PLAIN, FloatArray, from_standard, measured
from support.oracles import Motion, arm, fourier_motion, pinocchio_torque, record

from dynident.effects import EffectChoice
from dynident.errors import DynidentError
from dynident.export import ExportedFile, export_model, to_mjcf, to_urdf
from dynident.export.feasible_links_and_joints import MOST_FREE_ERROR_RATIO, predicts_as_well
from dynident.identification import Identification, IdentificationChoices, identify
from dynident.recordings import Preprocessing
from dynident.robot import Robot, robot_from_urdf
from dynident.robot.description_and_json import set_base
from dynident.robot.pinocchio_conversion import compute_described_torque

ROBOT = arm("scara")
CURVED = EffectChoice("viscous_nonlinear", shape=(("p", 2.0),))


def measured_torque(motion: Motion, seed: int) -> FloatArray:
    """What a robot needs whose viscous friction bends upward, with a little noise."""
    tau = pinocchio_torque(ROBOT, motion.q, motion.dq, motion.ddq)
    tau = tau + 2.0 * np.sign(motion.dq) + 1.5 * motion.dq + 3.0 * motion.dq * np.abs(motion.dq) + 0.05 * motion.ddq
    return tau + np.random.default_rng(seed).normal(0.0, 0.02, tau.shape)


@cache
def held_out_motion() -> Motion:
    return fourier_motion(ROBOT, 15.0, 200.0, 2)


@cache
def model_of(*effects: EffectChoice | str, estimator: str = "wls") -> Identification:
    motions = (fourier_motion(ROBOT, 15.0, 200.0, 1), held_out_motion())
    fit, held_out = (record(ROBOT, motion, measured_torque(motion, k)) for k, motion in enumerate(motions))
    chosen = tuple(EffectChoice(effect) if isinstance(effect, str) else effect for effect in effects)
    choices = IdentificationChoices(chosen, estimator=estimator, preprocessing=Preprocessing(20.0, 20.0, 3))
    return identify(ROBOT, [fit], [held_out], choices)


@cache
def model_with_offsets(of_quill: float = 9.0) -> Identification:
    """A model of a robot whose torque sensors have constant errors that are large beside its gravity."""
    offset = np.array([8.0, -6.0, of_quill, 2.0])
    motions = (fourier_motion(ROBOT, 15.0, 200.0, 1), held_out_motion())
    fit, held_out = (record(ROBOT, motion, measured_torque(motion, k) + offset) for k, motion in enumerate(motions))
    chosen = tuple(EffectChoice(effect) for effect in (*PLAIN, "offset"))
    return identify(
        ROBOT, [fit], [held_out], IdentificationChoices((*chosen, CURVED), preprocessing=Preprocessing(20.0, 20.0, 3))
    )


def error_of_reader(file: ExportedFile) -> float:
    """The relative error on held-out data of torque that Pinocchio or MuJoCo computes from a file."""
    motion, text = held_out_motion(), file.content.decode()
    if file.name.endswith(".urdf"):
        torque = torque_of_urdf(text, np.asarray(ROBOT.gravity), motion)
    else:
        torque = torque_of_mjcf(text, motion)
    rows, expected = moving(motion), measured_torque(motion, 1)
    return float(np.linalg.norm((torque - expected)[rows]) / np.linalg.norm(expected[rows]))


def stated_errors(file: ExportedFile) -> tuple[float, float]:
    """The errors of the file and of the model that the file states at its head."""
    found = re.search(r"of this file \(and of the model\): ([\d.]+)\s% \(([\d.]+)\s%\)", file.content.decode())
    assert found is not None
    return float(found[1]) / 100, float(found[2]) / 100


@pytest.mark.parametrize("write", [to_urdf, to_mjcf])
def test_friction_takes_on_what_it_can_of_a_law_that_a_file_cannot_hold(
    write: Callable[[Identification], ExportedFile],
) -> None:
    first, better = model_of(*PLAIN), model_of(*PLAIN, CURVED)
    file = write(better)
    assert error_of_reader(file) < 1.05 * error_of_reader(write(first))
    # Nobody would have reached it by leaving the term out: the better model has less viscous friction than the first.
    viscous = [{c.name: v for c, v in zip(m.model.kept, m.values, strict=True)}["Fv1"] for m in (first, better)]
    assert viscous[1] < 0.8 * viscous[0]


@pytest.mark.parametrize("nearest", [False, True])
def test_a_constant_torque_that_a_file_cannot_hold_is_no_mass(nearest: bool) -> None:
    text = to_urdf(model_with_offsets(), nearest=nearest).content.decode()
    inside = {
        joint.get("name"): joint.find("dynident_rotor") for joint in ElementTree.fromstring(text).findall("joint")
    }
    rotors = [0.0 if (rotor := inside[name]) is None else float(rotor.get("inertia", "")) for name in ROBOT.joint_names]
    q = held_out_motion().q[::200]
    expected = mass_matrices(ROBOT, q, np.full(ROBOT.n, 0.05))
    found = mass_matrices(robot_from_urdf("read", text), q, np.array(rotors))
    assert np.abs(found - expected).max() < 0.01 * np.abs(expected).max()


@pytest.mark.parametrize("write", [to_urdf, to_mjcf])
def test_links_that_can_exist_are_free_beside_an_effect_that_the_file_lacks(
    write: Callable[[Identification], ExportedFile],
) -> None:
    """What the file loses by the effect is not the price of links that can exist."""
    model = model_with_offsets(of_quill=0.0)
    names = [column.name for column in model.model.kept]
    # A rotor that is below zero by so little that nobody would notice.
    values = np.where(np.array(names) == "Ia4", -1e-4, model.values)
    solution = replace(model.estimate.solution, values=values)
    changed = model.with_changes(estimate=model.estimate.with_changes(solution=solution))
    file = write(changed)
    assert "nearest to the identified ones that can exist" in file.content.decode()


def mass_matrices(robot: Robot, q: FloatArray, rotors: FloatArray) -> FloatArray:
    """Mass matrices (n, m, n) in some postures, with the rotors' inertias."""
    rest = np.zeros_like(q)
    static = compute_described_torque(robot, q, rest, rest, rotors)
    return np.array([compute_described_torque(robot, q, rest, rest + row, rotors) - static for row in np.eye(robot.n)])


@pytest.mark.parametrize("write", [to_urdf, to_mjcf])
def test_the_error_that_a_file_states_is_what_its_reader_finds(write: Callable[[Identification], ExportedFile]) -> None:
    better = model_of(*PLAIN, CURVED)
    file = write(better)
    of_file, of_model = stated_errors(file)
    assert of_file == pytest.approx(error_of_reader(file), rel=0.05)
    assert of_model == pytest.approx(better.held_out_moving.relative_total, abs=6e-5)
    assert of_file > 1.25 * of_model
    assert any("C code, CasADi functions and JSON contain the whole model" in note for note in file.notes)


def test_a_file_that_holds_the_whole_model_warns_of_nothing() -> None:
    file = export_model(model_of(*PLAIN), "urdf")
    of_file, of_model = stated_errors(file)
    assert of_file <= MOST_FREE_ERROR_RATIO * of_model
    assert not any("Warning" in note for note in file.notes)


def test_bodies_that_can_exist_are_free_where_they_predict_held_out_data_as_well() -> None:
    model = model_of(*PLAIN)
    assert predicts_as_well(model, model.values)
    assert not predicts_as_well(model, 1.2 * model.values)


def test_without_held_out_data_nobody_knows_what_feasibility_costs() -> None:
    with pytest.raises(DynidentError, match="not physically feasible"):
        to_urdf(measured("ur10", noise=2.0))


@pytest.mark.parametrize("write", [to_urdf, to_mjcf])
def test_files_of_links_are_refused_for_a_base_that_moves(write: Callable[..., ExportedFile]) -> None:
    robot = set_base(robot_from_urdf("walker", WALKER), "floating")
    with pytest.raises(DynidentError, match="no export of links and joints for a base that moves"):
        write(from_standard(robot))
