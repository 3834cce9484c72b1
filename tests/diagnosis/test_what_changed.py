"""The same robot on two days, in another motion on each: what changed is told with its size, and nothing else."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from support.further_hidden_effects import PAYLOAD, loaded, scaled
from support.hidden_effects import (
    BAND,
    EFFORT,
    NAMES,
    PLAIN,
    ROBOT,
    WITH_OFFSET,
    Hidden,
    motions,
    nothing,
    on_joint,
    recorded,
    tilted,
)
from support.oracles import FloatArray, Motion, pinocchio_torque

from dynident.diagnosis import Change, Diagnosis, DiagnosisChoices, diagnose
from dynident.diagnosis.candidates.candidate_pool import build_pool
from dynident.diagnosis.residuals.shape_proposals import ShapeProposals
from dynident.effects import EffectChoice, get_effect
from dynident.effects.effect_columns import is_lasting_change
from dynident.errors import DynidentError
from dynident.identification import IdentificationChoices, identify
from dynident.recordings import Recording
from dynident.regressors.model_structure import build_model
from dynident.robot import Robot

pytestmark = pytest.mark.slow

CHOICES = IdentificationChoices(WITH_OFFSET, preprocessing=BAND)
FEW = ("coulomb", "viscous", "payload", "base_tilt")
"""Effects that are tried where it is not in question which of all is named."""
MASS, CENTRE = 3.0, np.array([0.1, -0.02, 0.05])


def worn(motion: Motion, load: FloatArray) -> FloatArray:
    """A third more friction on the elbow."""
    law = on_joint(2, lambda q, v, _: 0.3 * EFFORT[2] * (0.04 * np.sign(v) + 0.03 * v))
    return law(motion, load)


def on_the_forearm(motion: Motion, load: FloatArray) -> FloatArray:
    """A point mass on the third link."""
    x, y, z = CENTRE
    inertia = MASS * np.array([y * y + z * z, -x * y, -x * z, x * x + z * z, -y * z, x * x + y * y])
    inertias = ROBOT.inertias.copy()
    inertias[2] += np.concatenate([inertia, MASS * CENTRE, [MASS]])
    heavy = Robot(ROBOT.name, ROBOT.joints, ROBOT.gravity, ROBOT.drives, ROBOT.description, inertias)
    return pinocchio_torque(heavy, motion.q, motion.dq, motion.ddq) - load


def two_days(since: Hidden) -> tuple[Recording, Recording]:
    first, second = motions(7)
    return recorded(first, nothing, 70, "monday"), recorded(second, since, 71, "friday")


@cache
def asked(since: Hidden) -> Diagnosis:
    monday, friday = two_days(since)
    return diagnose(identify(ROBOT, [monday], [], CHOICES), [friday], baseline=[monday])


def only(found: Diagnosis) -> Change:
    assert found.changes is not None
    assert found.recommended == ()
    (change,) = found.changes
    assert change.choice.runs == ("friday",)
    return change


def holds(change: Change, parameter: str, truth: float) -> bool:
    value = next(one for one in (change.main, *change.more) if one.parameter == parameter)
    return value.interval[0] <= truth <= value.interval[1]


def test_where_nothing_changed_nothing_is_said_to_have() -> None:
    found = asked(nothing)
    assert found.changes == ()
    assert "These recordings show no change" in found.summary


def test_without_a_baseline_nothing_is_said_of_changes() -> None:
    monday, _ = two_days(nothing)
    found = diagnose(identify(ROBOT, [monday], [], CHOICES), [monday])
    assert found.changes is None
    # Who asks what is missing gets the limits of all effects; what changed needs those of the conclusion alone.
    common, every = (
        {one.effect for one in asked(nothing).detection_limits},
        {one.effect for one in found.detection_limits},
    )
    assert common == {name for name in every if get_effect(name).often_missed is not None} < every
    assert asked(nothing).conclusion is not None


def test_more_friction_on_one_joint_is_told_as_that_with_what_it_was_before() -> None:
    found = asked(worn)
    assert found.changes
    assert {(one.choice.effect, one.choice.joints) for one in found.changes} <= {
        ("coulomb", NAMES[2:3]),
        ("viscous", NAMES[2:3]),
    }
    coulomb = next(one for one in found.changes if one.choice.effect == "coulomb")
    assert holds(coulomb, "Fc3", 0.3 * 0.04 * EFFORT[2])
    assert coulomb.main.before == pytest.approx(0.04 * EFFORT[2], rel=0.1)
    assert coulomb.p_value <= 0.01
    # Every number has its unit, and the form that it has in the table.
    assert re.search(r"Fc3 differs by \+[\d.]+ N m \([\d.]+ to [\d.]+ N m; [\d.]+ N m before\)\.", coulomb.evidence)


def test_less_friction_is_told_as_well() -> None:
    less = asked(lambda motion, load: -worn(motion, load)).changes
    assert less
    assert all(one.main.value < 0 for one in less)


def test_a_mass_at_the_flange_is_told_on_the_last_link_with_its_mass() -> None:
    change = only(asked(loaded))
    assert (change.choice.effect, change.choice.joints) == ("payload", NAMES[-1:])
    assert change.main.parameter == "Mp6"
    assert holds(change, "Mp6", 2.5)


def test_a_mass_on_an_inner_link_is_told_on_that_link_with_its_first_moment() -> None:
    change = only(asked(on_the_forearm))
    assert (change.choice.effect, change.choice.joints) == ("payload", NAMES[2:3])
    parameters = {one.parameter for one in (change.main, *change.more)}
    assert parameters & {"Mp3", "m l"}


def test_a_robot_set_up_at_a_slant_is_told_as_a_tilt() -> None:
    change = only(asked(tilted))
    assert (change.choice.effect, change.choice.joints) == ("base_tilt", ())


def test_a_drive_that_gives_more_than_before_is_told_by_how_much() -> None:
    change = only(asked(scaled))
    assert (change.choice.effect, change.choice.joints) == ("drive_gain_error", NAMES[1:2])
    assert holds(change, "eps2", 0.08)


def test_a_model_of_any_strategy_or_estimator_can_be_asked() -> None:
    monday, friday = two_days(worn)
    for more in ({"strategy": "sequential"}, {"estimator": "feasible", "prior": "description_entropic"}):
        model = identify(ROBOT, [monday], [], replace(CHOICES, **more))
        found = diagnose(model, [friday], DiagnosisChoices(FEW), baseline=[monday]).changes
        assert found
        assert {one.choice.joints for one in found} == {NAMES[2:3]}


def test_tests_of_single_joints_are_no_day_to_compare() -> None:
    monday, friday = two_days(worn)
    model = identify(ROBOT, [monday], [], CHOICES)
    with pytest.raises(DynidentError, match="role friction") as refused:
        diagnose(model, [friday], baseline=[replace(monday, role="friction")])
    assert refused.value.pointer == "/baseline_ids"


def test_a_robot_that_feels_no_gravity_can_be_asked() -> None:
    weightless = replace(ROBOT, gravity=np.zeros(3))
    pool = build_pool(build_model(weightless, WITH_OFFSET), None, ShapeProposals(since=("friday",)))
    changes = {one.effect for one in pool.candidates if pool.is_change(one)}
    assert "coulomb" in changes
    assert "base_tilt" not in changes


def test_a_touch_on_the_later_day_is_no_lasting_change() -> None:
    assert is_lasting_change(EffectChoice("coulomb", NAMES[:1], (), ("friday",)), ("friday",))
    assert not is_lasting_change(EffectChoice("external_contact", (), (), ("friday",)), ("friday",))


def test_one_recording_on_both_sides_is_told_and_no_day_differs_from_itself() -> None:
    monday, _ = two_days(nothing)
    model = identify(ROBOT, [monday], [], CHOICES)
    again = replace(monday, name="monday's file once more")
    with pytest.raises(DynidentError, match="the same samples as monday") as raised:
        diagnose(model, [again], baseline=[monday])
    assert raised.value.pointer == "/baseline_ids"


def test_recordings_of_the_same_name_are_told_apart() -> None:
    monday, friday = two_days(worn)
    friday = replace(friday, name=monday.name)
    found = diagnose(identify(ROBOT, [monday], [], CHOICES), [friday], DiagnosisChoices(FEW), baseline=[monday])
    assert found.changes
    assert {one.choice.joints for one in found.changes} == {NAMES[2:3]}


def test_more_of_all_friction_of_a_joint_that_carries_little_is_no_other_gain_of_its_drive() -> None:
    last = ROBOT.n - 1

    def worn_wrist(motion: Motion, load: FloatArray) -> FloatArray:
        # A third more of what `recorded` gives the joint.
        law = on_joint(last, lambda q, v, _: 0.33 * EFFORT[last] * (0.04 * np.sign(v) + 0.03 * v))
        return law(motion, load)

    found = asked(worn_wrist).changes
    assert found
    assert {(one.choice.effect, one.choice.joints) for one in found} <= {
        ("coulomb", NAMES[last:]),
        ("viscous", NAMES[last:]),
    }


def rubs_by_load(share: float) -> Hidden:
    return on_joint(1, lambda q, v, load: share * np.abs(load) * np.sign(v))


def rubs_under(carried: Hidden) -> Hidden:
    """Friction of three joints that grows with all that they carry."""

    def torque(motion: Motion, load: FloatArray) -> FloatArray:
        more = carried(motion, load)
        friction = 0.08 * np.abs(load + more) * np.sign(motion.dq)
        return more + friction * np.isin(np.arange(ROBOT.n), (1, 2, 3))

    return torque


@pytest.mark.parametrize("known", [False, True])
def test_friction_that_grows_with_a_load_that_was_added_is_the_loads(known) -> None:
    first, second = motions(7)
    monday, friday = (
        recorded(first, rubs_under(nothing), 70, "monday"),
        recorded(second, rubs_under(loaded), 71, "friday"),
    )
    effects = (*WITH_OFFSET, EffectChoice("load_dependent_friction", NAMES[1:4])) if known else WITH_OFFSET
    found = diagnose(identify(ROBOT, [monday], [], replace(CHOICES, effects=effects)), [friday], baseline=[monday])
    assert found.changes
    assert [change.choice.effect for change in found.changes] == ["payload"]
    assert holds(found.changes[0], "Mp6", PAYLOAD)
    named = {(choice.effect, joint) for choice in found.recommended for joint in choice.joints}
    assert named == (set() if known else {("load_dependent_friction", joint) for joint in NAMES[1:4]})
    # Whatever the model was that the diagnosis began with. Of six intervals of 95 % one may miss.
    assert sum(one.interval[0] <= 0.0 <= one.interval[1] for one in found.friction) >= 5


def test_differences_of_two_days_do_not_depend_on_the_model_that_one_starts_from() -> None:
    monday, friday = two_days(worn)
    starts = (
        PLAIN,
        WITH_OFFSET,
        (*WITH_OFFSET, EffectChoice("load_dependent_friction")),
        (*WITH_OFFSET, EffectChoice("viscous_nonlinear", (), (("p", 2.0),))),
    )
    found = [
        diagnose(
            identify(ROBOT, [monday], [], replace(CHOICES, effects=effects)),
            [friday],
            DiagnosisChoices(FEW),
            baseline=[monday],
        )
        for effects in starts
    ]
    elbow = [one.friction[2] for one in found]
    truth = 0.3 * EFFORT[2] * (0.04 + 0.03 * elbow[0].speed)
    assert all(one.interval[0] <= truth <= one.interval[1] for one in elbow)
    each = np.array([[one.interval for one in diagnosis.friction] for diagnosis in found])
    # All intervals of a joint have values in common.
    assert (each[:, :, 0].max(axis=0) <= each[:, :, 1].min(axis=0)).all()


def test_what_no_day_has_cannot_have_become_less() -> None:
    found = asked(rubs_by_load(-0.1)).changes
    assert found
    assert not [one for one in found if one.choice.effect == "load_dependent_friction" and one.main.value < 0.0]


def test_how_much_the_friction_of_each_joint_differs_is_told_where_nothing_changed_as_well() -> None:
    still = asked(nothing)
    assert [one.joint for one in still.friction] == list(NAMES)
    assert all(abs(one.value) < 0.01 * one.before for one in still.friction)
    # Of six intervals of 95 % one may miss.
    assert sum(one.interval[0] <= 0.0 <= one.interval[1] for one in still.friction) >= 5
    assert "The friction of each joint differs by no more than" in still.summary
    elbow = asked(worn).friction[2]
    # A third of what `recorded` gives the joint.
    truth = 0.3 * EFFORT[2] * (0.04 + 0.03 * elbow.speed)
    assert elbow.interval[0] <= truth <= elbow.interval[1]
    assert elbow.value / elbow.before == pytest.approx(0.3, abs=0.05)
