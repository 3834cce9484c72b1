"""Deviations held against draws of stretches of time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.oracles import arm, fourier_motion, pinocchio_torque, record

from dynident.effects import EffectChoice
from dynident.identification import IdentificationChoices, from_bytes, identify, reidentify, to_bytes
from dynident.recordings import Preprocessing
from dynident.validation import validate_bootstrap

ROBOT = arm("scara")
BASE = tuple(EffectChoice(name) for name in ("rigid_body", "coulomb", "viscous"))
STRIBECK = EffectChoice("stribeck", (ROBOT.joint_names[0],))
SLOWLY = 50


def identified(duration: float, *effects: EffectChoice, shared: float = 0.0, lasting: int = SLOWLY, **choices):
    motion = fourier_motion(ROBOT, duration, 200.0, 1)
    rng = np.random.default_rng(0)
    tau = pinocchio_torque(ROBOT, motion.q, motion.dq, motion.ddq) + 2 * np.sign(motion.dq) + motion.dq
    v = motion.dq[:, 0]
    tau[:, 0] += 4.0 * np.exp(-((v / 0.15) ** 2)) * np.sign(v) + 0.3 * rng.normal(size=len(v))
    tau += 0.3 * rng.normal(size=tau.shape)
    steps = rng.normal(size=len(v) // lasting + 1)
    tau += shared * np.repeat(steps, lasting)[: len(v), None]
    asked = IdentificationChoices((*BASE, *effects), preprocessing=Preprocessing(None, 20.0, 3), **choices)
    return identify(ROBOT, [record(ROBOT, motion, tau)], [], asked)


FOUND = identified(30.0, STRIBECK)


def test_deviations_that_stand_pass_and_shape_constants_are_among_them():
    found = validate_bootstrap(FOUND)
    assert found.judged.verdict == "pass"
    assert (found.kind, found.draws, found.lost) == ("wild", 999, 0)
    names = [one.name for one in found.parameters]
    assert names == [*(p.name for p in FOUND.parameters), f"ln vs on {ROBOT.joint_names[0]}"]
    told = [one.told for one in found.parameters]
    np.testing.assert_allclose(told[:-1], [p.standard_deviation for p in FOUND.parameters])
    constant = next(one for one in FOUND.shape_constants if one.name == "vs")
    assert told[-1] == pytest.approx(constant.standard_deviation / constant.value)
    assert 0.7 < np.median([one.ratio for one in found.parameters]) < 1.4


def test_long_recordings_are_drawn_with_replacement():
    found = validate_bootstrap(identified(90.0, STRIBECK), draws=300)
    assert (found.kind, found.judged.verdict) == ("pairs", "pass")
    assert found.stretches >= 30


def test_draws_leave_out_what_neighbours_that_depend_on_each_other_add():
    # Residuals that last for 10 s, and blocks of a few seconds.
    slow = validate_bootstrap(identified(60.0, shared=2.0, lasting=2000))
    ratios, shares = np.array([(one.ratio, one.low * one.high) for one in slow.parameters]).T
    assert shares.min() < 0.5 < 0.8 < np.median(shares)
    np.testing.assert_allclose(ratios, shares, rtol=0.25)
    assert not any(one.outside for one in slow.parameters)
    # That they are as small as they have to be confirms nothing of the rest.
    small = [one.name for one in slow.parameters if one.ratio < 0.5]
    assert slow.judged.verdict == "pass"
    assert f"For {len(small)} of {len(slow.parameters)} they are less than 0.5 times" in slow.judged.reason
    assert small[0] in slow.judged.reason.split("do not confirm")[1]
    assert "do not confirm" not in validate_bootstrap(FOUND).judged.reason


def test_deviations_that_leave_out_what_joints_share_fail_by_name():
    told_wrong = identified(30.0, STRIBECK, shared=2.0, covariance="independent")
    found = validate_bootstrap(told_wrong)
    assert found.judged.verdict == "fail"
    assert sum(one.outside for one in found.parameters) > len(found.parameters) / 2
    assert "care" in found.judged.reason
    right = reidentify(told_wrong, replace(told_wrong.choices, covariance="by_time_and_joints"))
    assert validate_bootstrap(right).judged.verdict == "pass"


def test_it_is_the_same_from_a_file_for_the_same_seed_and_another_for_another():
    read = from_bytes(to_bytes(FOUND))
    assert validate_bootstrap(read, seed=3).parameters == validate_bootstrap(FOUND, seed=3).parameters
    assert validate_bootstrap(read, seed=4).parameters != validate_bootstrap(FOUND, seed=3).parameters


def test_what_is_no_least_squares_of_torque_is_not_evaluated():
    found = validate_bootstrap(identified(30.0, strategy="sequential"))
    assert found.judged.verdict == "not_evaluated"
    assert "global" in found.judged.reason
    assert found.parameters == ()
