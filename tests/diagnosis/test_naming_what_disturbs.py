"""Effects of drives, springs, the base and the surroundings are named, and adding them leaves the noise alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.further_hidden_effects import CONTACT, DELAY, FREQUENCY, MORE, PAYLOAD, loaded, loaded_on, touched
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
from dynident.diagnosis.candidates.candidate_pool import build_pool_of_choices
from dynident.diagnosis.candidates.held_out_scores import JointBlocks
from dynident.diagnosis.search.contacts_and_loads import LoadGains
from dynident.diagnosis.search.search_state import gather_state
from dynident.effects import EffectChoice
from dynident.identification import IdentificationChoices, extend, identify
from dynident.regressors.observation_matrix import RegressorInputs

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


@pytest.mark.parametrize(
    ("link", "centre", "mass"),
    # On an inner link, whose torque no load on the tool has; and on the axis of the last joint, where it is the same
    # function of the motion as on the link before.
    [(2, (0.4, 0.0, 0.05), 0.5), (4, (0.03, 0.02, 0.0), 0.4), (5, (0.0, 0.0, 0.06), 1.0)],
)
def test_a_load_is_found_on_any_link_and_on_the_outer_one_where_both_explain_it(link, centre, mass):
    first, second = motions(3)
    bare = recorded(first, nothing, 1, "bare")
    heavy = recorded(second, loaded_on(link, centre, mass), 2, "heavy")
    plain = identify(ROBOT, [bare, heavy], [], IdentificationChoices(WITH_OFFSET, preprocessing=BAND))
    (choice,) = diagnose(plain, [bare, heavy]).recommended
    assert (choice.effect, choice.joints, choice.runs) == ("payload", (NAMES[link],), ("heavy",))


def test_a_stated_load_is_found_on_the_link_that_carries_it():
    runs = [
        recorded(motion, loaded_on(4, (0.3, 0.0, 0.05), 2.0) if k % 2 == 0 else nothing, k, f"run{k}")
        for k, motion in enumerate(motions(6) + motions(7))
    ]
    runs = [replace(run, payload={"mass": 2.0}) if k % 2 == 0 else run for k, run in enumerate(runs)]
    plain = identify(ROBOT, runs, [], IdentificationChoices(WITH_OFFSET, preprocessing=BAND))
    (choice,) = diagnose(plain, runs).recommended
    assert (choice.effect, choice.joints, choice.runs) == ("payload", NAMES[4:5], ())


@pytest.mark.parametrize("equations", ["energy", "power"])
def test_a_load_is_found_on_its_link_from_energy_too(equations):
    first, second = motions(3)
    bare = recorded(first, nothing, 1, "bare")
    heavy = recorded(second, loaded_on(4, (0.3, 0.0, 0.05), 2.0), 2, "heavy")
    choices = IdentificationChoices(WITH_OFFSET, model=equations, preprocessing=BAND)
    plain = identify(ROBOT, [bare, heavy], [], choices)
    found = diagnose(plain, [bare, heavy]).recommended
    assert ("payload", NAMES[4:5], ("heavy",)) in [(choice.effect, choice.joints, choice.runs) for choice in found]


def test_what_a_load_explains_is_the_same_with_columns_of_its_own():
    first, second = motions(4)
    bare, heavy = recorded(first, nothing, 3, "bare"), recorded(second, nothing, 4, "heavy")
    plain = identify(ROBOT, [bare, heavy], [], IdentificationChoices(WITH_OFFSET, preprocessing=BAND))
    inputs = RegressorInputs([bare, heavy], BAND, plain.estimate.next_reference())
    state = gather_state(plain.model, build_pool_of_choices(plain.model, ()), inputs, plain.noise)
    gains = LoadGains.from_state(plain.model, state, inputs).compute_gains(("heavy",))
    for name in NAMES:
        pool = build_pool_of_choices(plain.model, [EffectChoice("payload", (name,), (), ("heavy",))])
        grown = gather_state(plain.model, pool, inputs, plain.noise)
        columns = np.arange(len(pool.observation.columns))
        wide, narrow = (
            JointBlocks.from_products(grown.rows, own, ()).sum_sets(plain.noise, grown.rows.sets)
            for own in (columns, columns[: pool.n_base])
        )
        explained = [sums.wy[0] @ np.linalg.lstsq(sums.ww[0], sums.wy[0], rcond=1e-13)[0] for sums in (wide, narrow)]
        assert gains.get(name, 0.0) == pytest.approx(explained[0] - explained[1], rel=0.02, abs=0.2)


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
