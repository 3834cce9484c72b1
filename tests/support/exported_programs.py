"""Models whose exported programs are run."""

from __future__ import annotations

import re
from functools import cache

import numpy as np
import pytest
from support.exported_robots import moving
from support.models_with_chosen_parameters import PLAIN, FloatArray, made_up
from support.oracles import Motion, arm, crooked_urdf, fourier_motion, pinocchio_torque, record

from dynident.effects import CATALOGUE, EffectChoice
from dynident.identification import Identification, IdentificationChoices, identify
from dynident.recordings import Preprocessing
from dynident.robot import robot_from_urdf

TREE = robot_from_urdf("tree", crooked_urdf(7, 3, (1, 5), (-1, 0, 1, 1, 0, 4, 5)))
HYSTERESIS = (
    EffectChoice("presliding", (), (("d0", 0.01), ("law", 1.0))),
    EffectChoice("presliding", (), (("d0", 0.02), ("law", -1.0))),
)


def every_effect() -> tuple[EffectChoice, ...]:
    """All of the catalogue, some in runs of their own, a joint with a shape of its own."""
    special = {
        "presliding": HYSTERESIS,
        "payload": (EffectChoice("payload"), EffectChoice("payload", runs=("heavy", "run 2"))),
        "stribeck": (EffectChoice("stribeck", (), (("vs", 0.2), ("delta", 1.3))),),
        "external_contact": (EffectChoice("external_contact", (), (("t0", 0.5), ("t1", 1.5))),),
        "transmission_coupling": (EffectChoice("transmission_coupling", (), (("side", -1.0),)),),
    }
    return tuple(one for effect in CATALOGUE for one in special.get(effect, (EffectChoice(effect),)))


MODELS = {
    "plain": lambda: made_up(arm("franka_panda"), PLAIN),
    "friction alone": lambda: made_up(arm("scara"), ("coulomb", "stribeck")),
    "hysteresis on a tree": lambda: made_up(TREE, (*PLAIN, *HYSTERESIS, "load_dependent_friction")),
    "everything": lambda: made_up(arm("ur10"), every_effect()),
    "everything with a sliding joint": lambda: made_up(arm("scara"), every_effect()),
}
NAMES = [pytest.param(name, marks=pytest.mark.slow if name == "everything" else ()) for name in MODELS]


def run_signals(identification: Identification) -> FloatArray:
    return np.array([1.0, 0.0][: len(identification.model.observation.runs)])


ARM = arm("scara")


@cache
def held_out() -> Motion:
    return fourier_motion(ARM, 15.0, 200.0, 2)


def needed(motion: Motion, seed: int) -> FloatArray:
    """Torque of an arm whose friction no simulator has words for, with noise."""
    tau = pinocchio_torque(ARM, motion.q, motion.dq, motion.ddq) + 0.4 * motion.ddq
    tau = tau + 2.0 * np.sign(motion.dq) + 1.5 * motion.dq + 3.0 * motion.dq * np.abs(motion.dq)
    return tau + np.random.default_rng(seed).normal(0.0, 0.02, tau.shape)


@cache
def identify_arm(*more: EffectChoice) -> Identification:
    """That arm, identified with plain effects and these, and tried on held-out data."""
    motions = (fourier_motion(ARM, 15.0, 200.0, 1), held_out())
    fit, other = (record(ARM, motion, needed(motion, k)) for k, motion in enumerate(motions))
    effects = (*(EffectChoice(effect) for effect in PLAIN), *more)
    return identify(ARM, [fit], [other], IdentificationChoices(effects, preprocessing=Preprocessing(20.0, 20.0, 3)))


def error_of(torque: FloatArray, every: int = 1) -> float:
    """The relative error of torques along the held-out motion, or at some of its samples."""
    rows, expected = np.flatnonzero(moving(held_out()))[::every], needed(held_out(), 1)
    return float(np.linalg.norm((torque - expected)[rows]) / np.linalg.norm(expected[rows]))


def check_stated_error(text: str, torque: FloatArray, every: int = 1) -> None:
    """A program computes this torque along the held-out motion; its text states the error that it has there."""
    words = " ".join(text.replace("\n *", " ").split())
    [stated] = set(re.findall(r"([\d.]+) % on held-out data", words))
    # The plain model lacks friction: its error is far above the noise, which preprocessing filters.
    assert error_of(torque, every) > 0.05
    assert error_of(torque, every) == pytest.approx(float(stated) / 100, rel=0.05)
