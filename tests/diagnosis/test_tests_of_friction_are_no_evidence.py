"""A diagnosis learns from motions of the whole robot; tests of single joints (role friction) are left out of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.oracles import arm, fourier_motion, pinocchio_torque, record

from dynident.diagnosis import diagnose
from dynident.effects import EffectChoice
from dynident.identification import IdentificationChoices, identify
from dynident.recordings import Preprocessing

pytestmark = pytest.mark.slow

ROBOT = arm("scara")


def run(seed: int, name: str, spring: float):
    motion = fourier_motion(ROBOT, 15.0, 100.0, seed)
    tau = pinocchio_torque(ROBOT, motion.q, motion.dq, motion.ddq) + 3 * np.sign(motion.dq) + 2 * motion.dq
    tau[:, 0] += spring * motion.q[:, 0]
    return record(ROBOT, motion, tau + np.random.default_rng(seed).normal(0.0, 0.1, tau.shape), name)


def test_a_spring_that_is_in_a_friction_test_alone_is_not_diagnosed():
    choices = IdentificationChoices(
        tuple(EffectChoice(name) for name in ("rigid_body", "coulomb", "viscous")),
        preprocessing=Preprocessing(10, 8, 3),
    )
    plain = run(1, "plain", 0.0)
    odd = replace(run(2, "odd", 60.0), role="friction")
    found = identify(ROBOT, [plain, odd], [], choices)
    alone, beside = diagnose(found, [plain]), diagnose(found, [plain, odd])
    assert (beside.verdict, beside.summary) == (alone.verdict, alone.summary)
    assert "joint_spring" not in {choice.effect for choice in beside.recommended}
    as_usual = diagnose(found, [plain, replace(odd, role=None)])
    assert as_usual.verdict != alone.verdict
