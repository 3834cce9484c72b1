"""Other choices on data that are reduced already: the same as identifying anew, without any recording."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from support.oracles import arm, fourier_motion, pinocchio_torque, record

from dynident.effects import EffectChoice
from dynident.errors import DynidentError
from dynident.identification import Identification, IdentificationChoices, from_bytes, identify, to_bytes
from dynident.identification.identified_models.remove_and_solve_again import reidentify
from dynident.recordings import Preprocessing

EFFECTS = tuple(EffectChoice(name) for name in ("rigid_body", "rotor_inertia", "coulomb", "viscous", "offset"))
CHOICES = IdentificationChoices(EFFECTS, preprocessing=Preprocessing(15.0, 15.0, 5))


def recording(seed: int, name: str):
    robot = arm("ur10")
    motion = fourier_motion(robot, 15.0, 200.0, seed=seed)
    tau = pinocchio_torque(robot, motion.q, motion.dq, motion.ddq) + 2.0 * np.sign(motion.dq) + motion.dq
    return record(robot, motion, tau + 0.5 * np.random.default_rng(seed).normal(size=tau.shape), name)


TRAINING, VALIDATION = recording(1, "training"), recording(2, "validation")


@cache
def anew(choices: IdentificationChoices = CHOICES) -> Identification:
    return identify(arm("ur10"), [TRAINING], [VALIDATION], choices)


@pytest.mark.parametrize(
    "change",
    [
        {"estimator": "ols"},
        {"estimator": "feasible"},
        {"estimator": "feasible", "prior": "description", "free_links": ("wrist_3_joint",)},
        {"strategy": "sequential"},
        {"strategy": "sequential", "steps": "wrist_then_shoulder"},
        {"effects": EFFECTS[:4]},
        {"effects": (*EFFECTS[:1], *EFFECTS[2:]), "estimator": "ols"},
        {"effects": (*EFFECTS[:2], replace(EFFECTS[2], joints=("elbow_joint",)))},
    ],
    ids=str,
)
def test_it_is_the_same_as_identifying_anew(change):
    choices = replace(CHOICES, **change)
    again, expected = reidentify(anew(), choices), anew(choices)
    assert again.choices == expected.choices
    assert [p.name for p in again.parameters] == [p.name for p in expected.parameters]
    deviation = np.maximum(expected.statistics.standard_deviations, 1e-9 * np.abs(expected.values).max())
    assert np.abs((again.values - expected.values) / deviation).max() < 1e-3
    np.testing.assert_allclose(
        again.statistics.standard_deviations, expected.statistics.standard_deviations, rtol=1e-3, atol=1e-9
    )
    np.testing.assert_allclose(again.held_out.relative, expected.held_out.relative, rtol=1e-5)
    assert again.worst_inertia_eigenvalue == pytest.approx(expected.worst_inertia_eigenvalue, rel=1e-3)
    assert again.data.measurement_names == expected.data.measurement_names
    assert again.warnings == expected.warnings


def test_a_model_from_a_file_is_solved_again():
    stored = from_bytes(to_bytes(anew()))
    np.testing.assert_allclose(reidentify(stored, replace(CHOICES, estimator="ols")).values,
                               anew(replace(CHOICES, estimator="ols")).values, rtol=1e-9)  # fmt: skip


@pytest.mark.parametrize(
    ("change", "pointer", "says"),
    [
        ({"model": "power"}, "/model", "dynamic"),
        ({"estimator": "iv"}, "/estimator", "wls, ols, feasible"),
        ({"strategy": "separate_friction"}, "/strategy", "single joints"),
        ({"effects": (*EFFECTS, EffectChoice("stribeck"))}, "/effects", "stribeck"),
        ({"preprocessing": Preprocessing(8.0, 8.0, 5)}, "/preprocessing", "filtered with other settings"),
    ],
    ids=str,
)
def test_what_the_reduced_data_cannot_give_is_refused(change, pointer, says):
    with pytest.raises(DynidentError, match=says) as raised:
        reidentify(anew(), replace(CHOICES, **change))
    assert raised.value.pointer == pointer
    assert raised.value.title == "Recordings needed"
