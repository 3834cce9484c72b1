"""Whatever is added to a model, it keeps the parameters that it has."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.oracles import arm, fourier_motion, pinocchio_torque, record

from dynident.diagnosis import diagnose
from dynident.effects import CATALOGUE, EffectChoice, get_effect
from dynident.effects.effect_choices import DEFAULT_EFFECTS, OFFSETS
from dynident.errors import DynidentError
from dynident.identification import Identification, IdentificationChoices, extend, identify
from dynident.recordings import RecordedJoints, Recording, RecordingMetadata, import_recording
from dynident.regressors.base_parameters import select_base
from dynident.regressors.model_structure import build_model, extend_model
from dynident.robot import Robot, robot_from_urdf

KNOWN = (*DEFAULT_EFFECTS, OFFSETS)
DATA = Path(__file__).resolve().parents[2].parent / "shared" / "data" / "kinova_gen3"


def rounded(name: str, seed: int) -> Robot:
    """An arm whose right angles are not quite right, as many digits as a description has."""
    rng = np.random.default_rng(seed)
    robot = arm(name)
    joints = []
    for joint in robot.joints:
        x, y, z = rng.normal(scale=1e-5, size=3)
        turn = np.array([[1.0, -z, y], [z, 1.0, -x], [-y, x, 1.0]])
        placement = joint.placement.copy()
        placement[:3, :3] = turn @ joint.placement[:3, :3]
        joints.append(replace(joint, placement=placement))
    return Robot(robot.name, tuple(joints), robot.gravity, robot.drives, robot.description, robot.inertias)


def choice_of(effect: str, robot: Robot, rng: np.random.Generator) -> EffectChoice | None:
    """The effect on a random joint, with its usual constants."""
    described = get_effect(effect)
    possible = described.applicable(robot)
    if not possible or any(effect == known.effect for known in KNOWN):
        return None
    joint = int(rng.choice(possible))
    shape = described.grid(robot, joint)[0] if described.scope == "joint" else {}
    shape = described.shape_with_defaults(shape)
    joints = (robot.joint_names[joint],) if described.scope == "joint" else ()
    return EffectChoice(effect, joints, tuple(sorted(shape.items())), ("run",) if described.in_some_runs else ())


def test_columns_that_are_known_to_be_independent_stay_whatever_other_states_show():
    rng = np.random.default_rng(0)
    w = rng.normal(size=(60, 4))
    w[:, 1] = w[:, 0] + 1e-6 * w[:, 1]
    names = ("a", "b", "c", "d")
    assert select_base(w, names).kept == (0, 2, 3)
    found = select_base(w, names, n_known=3)
    assert found.kept == (0, 1, 2, 3)
    assert len(found.groupings) == 4
    w[:, 3] = w[:, 1] + w[:, 2]
    found = select_base(w, names, n_known=3)
    assert found.kept == (0, 1, 2)
    np.testing.assert_allclose(found.grouping[:, 3], [0, 1, 1], atol=1e-4)


@pytest.mark.sweep
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("name", ["ur10", "franka_panda"])
def test_a_model_keeps_its_parameters_whatever_is_added(name, seed):
    rng, robot = np.random.default_rng(seed), rounded(name, seed)
    # Just where the rounding makes columns dependent or not.
    tolerance = float(10 ** rng.uniform(-5.5, -4.0))
    known = build_model(robot, KNOWN, tolerance=tolerance)
    for effect in CATALOGUE:
        choice = choice_of(effect, robot, rng)
        if choice is None:
            continue
        grown = extend_model(known, [choice], tolerance=tolerance)
        assert grown.base.kept[: known.n_parameters] == known.base.kept
        assert grown.observation.n_columns == grown.n_parameters == len(grown.base.groupings)


def run_of(name: str, seed: int) -> tuple[Robot, Recording]:
    robot = arm(name)
    rng = np.random.default_rng(seed)
    motion = fourier_motion(robot, 10.0, 100.0, seed, fastest=float(rng.uniform(0.1, 0.7)))
    effort = np.array([joint.limits.effort or 50.0 for joint in robot.joints])
    load = pinocchio_torque(robot, motion.q, motion.dq, motion.ddq)
    tau = load + 0.03 * effort * np.sign(motion.dq) + 0.01 * effort * rng.normal(size=load.shape)
    return robot, record(robot, motion, tau, "run")


def check_extending(model: Identification, recording: Recording, choice: EffectChoice) -> None:
    try:
        grown = extend(model, [choice], [recording])
    except DynidentError:
        # In words, not by a traceback.
        return
    assert len(grown.parameters) > len(model.parameters)


@pytest.mark.slow
@pytest.mark.sweep
@pytest.mark.parametrize("name", ["ur10", "crooked", "scara"])
def test_extending_works_or_says_why_not(name):
    robot, recording = run_of(name, 3)
    model = identify(robot, [recording], [], IdentificationChoices(KNOWN))
    rng = np.random.default_rng(0)
    for effect in CATALOGUE:
        choice = choice_of(effect, robot, rng)
        if choice is not None:
            check_extending(model, recording, choice)


@pytest.mark.real_data
@pytest.mark.skipif(not DATA.is_dir(), reason="the recordings of real robots are not here")
@pytest.mark.parametrize("files", [pytest.param(("run1",), marks=pytest.mark.thorough), ("run1", "run2", "run3")])
def test_a_diagnosis_of_an_arm_with_rounded_angles_can_be_added(files, tmp_path):
    robot = robot_from_urdf("kinova", (DATA / "kinova.urdf").read_text(encoding="utf-8"))
    recordings = [
        import_recording(
            DATA / f"{name}.parquet",
            tmp_path / f"{name}.parquet",
            RecordedJoints(robot.joint_names),
            metadata=RecordingMetadata(name=name),
        )[0]
        for name in files
    ]
    model = identify(robot, recordings, [], IdentificationChoices(KNOWN))
    found = diagnose(model, recordings)
    assert found.recommended
    grown = extend(model, found.recommended, recordings)
    assert grown.fit.relative_total < model.fit.relative_total
