"""Models whose exported programs are run."""

from __future__ import annotations

import numpy as np
import pytest
from support.models_with_chosen_parameters import PLAIN, FloatArray, made_up
from support.oracles import arm, crooked_urdf

from dynident.effects import CATALOGUE, EffectChoice
from dynident.identification import Identification
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
