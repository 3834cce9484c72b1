"""Effects of drives, springs, the base and the surroundings are named, and adding them leaves the noise alone."""

from __future__ import annotations

import numpy as np
import pytest
from support.further_hidden_effects import CONTACT, DELAY, FREQUENCY, MORE, PAYLOAD, loaded, touched
from support.hidden_effects import (
    BAND,
    NAMES,
    ROBOT,
    WITH_OFFSET,
    experiment,
    floor,
    motions,
    nothing,
    on_joint,
    recorded,
)

from dynident.diagnosis import diagnose, evidence
from dynident.identification import IdentificationChoices, extend, identify

pytestmark = pytest.mark.slow

SHAPES = {"base_vibration": ("f", FREQUENCY)}
SIZES = {"torque_delay": ("delay", DELAY), "drive_gain_error": ("eps2", 0.08)}


@pytest.mark.sweep
@pytest.mark.parametrize("effect", MORE)
def test_a_hidden_effect_alone_is_named_with_its_shape_and_leaves_nothing_but_noise_once_added(effect):
    case = MORE[effect]
    run = experiment(case.hidden, case.effects, 1)
    found = diagnose(run.identification, [run.training])
    place = () if case.joint is None else (NAMES[case.joint],)
    assert [(choice.effect, choice.joints) for choice in found.recommended] == [(effect, place)]
    if effect in SHAPES:
        name, value = SHAPES[effect]
        assert found.recommended[0].shape_values[name] == pytest.approx(value, abs=0.01)
    grown = extend(run.identification, found.recommended, [run.training], [run.validation])
    before, after = run.identification.held_out.rms / floor(1), grown.held_out.rms / floor(1)
    assert before.max() > 1.3
    assert after.max() <= 1.1
    if effect in SIZES:
        name, value = SIZES[effect]
        assert next(p.value for p in grown.parameters if p.name == name) == pytest.approx(value, rel=0.1)


def test_a_touch_is_named_with_the_time_of_it():
    run = experiment(touched)
    (choice,) = diagnose(run.identification, [run.training]).recommended
    assert (choice.effect, choice.runs) == ("external_contact", ("training",))
    assert choice.shape_values["t0"] == pytest.approx(CONTACT[0], abs=0.2)
    assert choice.shape_values["t1"] == pytest.approx(CONTACT[1], abs=0.2)


def test_a_payload_is_found_in_the_run_that_has_it_with_its_mass():
    first, second = motions(3)
    bare, heavy = recorded(first, nothing, 1, "bare"), recorded(second, loaded, 2, "heavy")
    plain = identify(ROBOT, [bare, heavy], [], IdentificationChoices(WITH_OFFSET, preprocessing=BAND))
    found = diagnose(plain, [bare, heavy])
    (choice,) = found.recommended
    assert (choice.effect, choice.joints, choice.runs) == ("payload", NAMES[-1:], ("heavy",))
    grown = extend(plain, [choice], [bare, heavy])
    assert next(p.value for p in grown.parameters if p.name == f"Mp{len(NAMES)}") == pytest.approx(PAYLOAD, rel=0.03)
    drawn = evidence(plain, found.candidates[:1], [bare, heavy])
    removed = 1 - grown.fit.squares / plain.fit.squares
    assert max(one.explained for one in drawn) > 0.5
    for one in drawn:
        assert one.explained == pytest.approx(removed[NAMES.index(one.joint)], abs=0.05)


def test_friction_that_depends_on_another_joint_has_no_name_but_its_variable():
    def law(motion, load):
        tau = np.zeros_like(load)
        tau[:, 2] = 6.0 * np.sin(1.5 * motion.q[:, 4]) * np.sign(motion.dq[:, 2])
        return tau

    run = experiment(law)
    found = diagnose(run.identification, [run.training])
    assert found.recommended == ()
    assert (found.unknown[0].joint, found.unknown[0].variable) == (NAMES[2], "other_joints")


def test_a_rough_spot_is_no_spring_but_something_over_the_position():
    middle = float(np.median(motions(0)[0].q[:, 2]))
    run = experiment(on_joint(2, lambda q, v, load: 6.0 * np.exp(-(((q - middle) / 0.15) ** 2))))
    found = diagnose(run.identification, [run.training])
    assert {choice.effect for choice in found.recommended} <= {"torque_ripple"}
    assert (NAMES[2], "position") in [(pattern.joint, pattern.variable) for pattern in found.unknown]
