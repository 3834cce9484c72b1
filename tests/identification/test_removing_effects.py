"""Effects taken out of a model again, from its reduced data alone; and what is said of additions that do not help."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.oracles import arm, fourier_motion, pinocchio_torque, record

from dynident.effects import EffectChoice
from dynident.errors import DynidentError
from dynident.identification import IdentificationChoices, extend, from_bytes, identify, remove, to_bytes
from dynident.identification.identified_models import held_out_gain
from dynident.recordings import Preprocessing

ROBOT = arm("ur10")
NAMES = ROBOT.joint_names
PLAIN = tuple(EffectChoice(name) for name in ("rigid_body", "rotor_inertia", "coulomb", "viscous", "offset"))
CHOICES = IdentificationChoices(PLAIN, estimator="wls", preprocessing=Preprocessing(10.0, 8.0, 3))
SPRING = EffectChoice("joint_spring", (NAMES[0], NAMES[2]))


def run(seed: int, seconds: float, *, spring: float = 20.0):
    motion = fourier_motion(ROBOT, seconds, 100.0, seed)
    v = motion.dq
    tau = pinocchio_torque(ROBOT, motion.q, v, motion.ddq) + 4 * np.sign(v) + 3 * v
    tau[:, 0] += spring * motion.q[:, 0]
    return record(ROBOT, motion, tau + np.random.default_rng(seed).normal(0, 0.5, tau.shape), f"run {seed}")


RUNS, HELD_OUT = [run(1, 20.0)], [run(2, 15.0)]


@pytest.fixture(scope="module")
def plain():
    return identify(ROBOT, RUNS, HELD_OUT, CHOICES)


@pytest.fixture(scope="module")
def grown(plain):
    return extend(plain, [SPRING], RUNS, HELD_OUT)


def anew(*effects: EffectChoice):
    return identify(ROBOT, RUNS, HELD_OUT, replace(CHOICES, effects=effects))


def alike(one, other) -> None:
    assert [p.name for p in one.parameters] == [p.name for p in other.parameters]
    np.testing.assert_allclose(one.values, other.values, rtol=1e-6, atol=1e-8)
    np.testing.assert_allclose(one.held_out.rms, other.held_out.rms, rtol=1e-8)
    np.testing.assert_allclose(
        one.statistics.standard_deviations, other.statistics.standard_deviations, rtol=1e-5, atol=1e-12
    )


def test_removing_what_was_added_gives_the_model_before(plain, grown):
    back = remove(grown, [EffectChoice("joint_spring")])
    alike(back, plain)
    assert back.step.parent is grown
    assert back.step.removed == (EffectChoice("joint_spring"),)
    assert back.step.added == ()
    assert back.data.measurement_names == plain.data.measurement_names
    assert [model.n_equations for model in back.ladder()] == [plain.n_equations] * 3


def test_removing_from_one_joint_leaves_it_on_the_others(grown):
    left = remove(grown, [EffectChoice("joint_spring", (NAMES[2],))])
    alike(left, anew(*PLAIN, EffectChoice("joint_spring", NAMES[:1])))
    assert left.choices.effects[-1] == EffectChoice("joint_spring", (NAMES[0],))


def test_an_effect_of_all_joints_is_taken_off_one(plain):
    left = remove(plain, [EffectChoice("offset", (NAMES[3],))])
    links = [p.link for p in left.parameters if p.effect == "offset"]
    assert links == [name for name in NAMES if name != NAMES[3]]
    assert len(left.values) == len(plain.values) - 1


def test_a_parameter_that_was_absorbed_comes_back_when_its_partner_goes(plain):
    # Without rotors the inertia that they shared a base parameter with has to stand for itself.
    left = remove(plain, [EffectChoice("rotor_inertia"), EffectChoice("offset")])
    alike(left, anew(*(choice for choice in PLAIN if choice.effect not in ("rotor_inertia", "offset"))))
    # The same function twice: the second was absorbed by the first.
    twice = EffectChoice("coulomb_asymmetric")
    both = anew(*PLAIN, twice)
    assert {column.effect for column in both.model.absorbed_columns} == {"coulomb_asymmetric"}
    other = remove(both, [EffectChoice("coulomb"), EffectChoice("offset")])
    alike(other, anew(*(choice for choice in PLAIN if choice.effect not in ("coulomb", "offset")), twice))


@pytest.mark.parametrize(
    ("removed", "pointer", "word"),
    [
        ([EffectChoice("stribeck")], "/effects/0", "has no stribeck"),
        ([EffectChoice("joint_spring", (NAMES[1],))], "/effects/0", f"on {NAMES[1]}"),
        ([EffectChoice("offset"), EffectChoice("offset")], "/effects/1", "has no offset"),
        ([EffectChoice("magic")], "/effects/0", "magic"),
        ([EffectChoice("offset", ("nose",))], "/effects/0", "nose"),
        ([EffectChoice(c.effect) for c in (*PLAIN, SPRING)], "/effects", "no effects left"),
    ],
)
def test_what_cannot_be_removed_is_refused_with_the_reason(grown, removed, pointer, word):
    with pytest.raises(DynidentError, match=word) as caught:
        remove(grown, removed)
    assert caught.value.pointer == pointer


def test_of_two_shapes_of_an_effect_one_can_be_removed(plain):
    slow, fast = (EffectChoice("stribeck", (NAMES[1],), (("delta", 2.0), ("vs", vs))) for vs in (0.05, 0.4))
    two = extend(plain, [slow, fast], RUNS, HELD_OUT)
    left = remove(two, [EffectChoice("stribeck", (), (("vs", 0.4),))])
    assert left.choices.effects[:-1] == plain.choices.effects
    assert left.choices.effects[-1].shape_values["vs"] == 0.05
    with pytest.raises(DynidentError, match=r"vs = 0\.1"):
        remove(two, [EffectChoice("stribeck", (), (("vs", 0.1),))])


def test_what_was_removed_is_in_the_file(grown):
    back = remove(grown, [SPRING])
    assert from_bytes(to_bytes(back)).step.removed == (SPRING,)


def test_an_addition_that_helps_is_not_warned_of(grown):
    assert not any("do not confirm" in warning for warning in grown.warnings)


def test_an_addition_that_only_fits_noise_is_warned_of(plain):
    useless = extend(plain, [EffectChoice("joint_spring", (NAMES[5],))], RUNS, HELD_OUT)
    assert "Held-out data do not confirm" in useless.warnings[0]


def test_an_addition_that_helps_unevenly_is_told_to_help_but_not_surely(grown, monkeypatch):
    monkeypatch.setattr(held_out_gain, "compute_evenness", lambda gains: np.full(len(gains), 1.97))
    warning = held_out_gain.list_addition_warnings(grown)[0]
    assert warning.startswith("Joint spring helps, but this is not certain")
    assert "t = 1.97" in warning
    assert "Remove" not in warning


def test_an_addition_that_makes_a_joint_worse_names_the_joint(plain):
    # A spring that is in the identification run alone.
    learnt = identify(ROBOT, [run(1, 20.0)], [run(2, 15.0, spring=0.0)], CHOICES)
    worse = extend(learnt, [EffectChoice("joint_spring", (NAMES[0],))], [run(1, 20.0)], [run(2, 15.0, spring=0.0)])
    assert any(NAMES[0] in warning and "larger" in warning for warning in worse.warnings)
