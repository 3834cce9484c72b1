"""Whatever single effect is asked for, a diagnosis answers: also where this robot and motion cannot have it."""

from __future__ import annotations

import numpy as np
import pytest
from support.oracles import fourier_motion

from dynident.diagnosis import DiagnosisChoices, diagnose
from dynident.effects import CATALOGUE
from dynident.identification import Identification, IdentificationChoices, identify
from dynident.recordings import Recording, recording_from_arrays
from dynident.robot import robot_from_library

ROBOT = robot_from_library("scara")


@pytest.fixture(scope="module")
def recording() -> Recording:
    """A motion in which many effects cannot show."""
    motion = fourier_motion(ROBOT, 6.0, 200.0, 3, fastest=0.2)
    noise = np.random.default_rng(4).normal(0.0, 0.1, motion.q.shape)
    tau = 5.0 * motion.ddq + 3.0 * np.sign(motion.dq) + noise
    return recording_from_arrays(motion.t, motion.q, tau, joint_names=ROBOT.joint_names, name="short")


@pytest.fixture(scope="module")
def model(recording: Recording) -> Identification:
    return identify(ROBOT, [recording], [], IdentificationChoices())


@pytest.mark.parametrize("effect", CATALOGUE)
def test_one_effect_alone_is_asked_for(model: Identification, recording: Recording, effect: str) -> None:
    diagnosis = diagnose(model, [recording], DiagnosisChoices((effect,)))
    assert {candidate.effect for candidate in diagnosis.candidates} <= {effect}
    assert diagnosis.summary
