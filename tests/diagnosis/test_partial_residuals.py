"""What each ranked effect leaves in the residual, against the law that was hidden."""

from __future__ import annotations

import numpy as np
import pytest
from support.hidden_effects import CASES, NAMES, experiment

from dynident.diagnosis import RankedEffect, evidence
from dynident.effects import EffectChoice
from dynident.identification import extend


def ranked(effect: str, joints: tuple[str, ...], rank: int = 1, **shape: float) -> RankedEffect:
    choice = EffectChoice(effect, joints, tuple(sorted(shape.items())))
    return RankedEffect(rank, choice, 0.1, 0.05, 0.5, 9.0, 1e-6, True, "", (), 0.9)


@pytest.fixture(scope="module")
def spring():
    return experiment(CASES["joint_spring"].hidden)


def test_a_spring_is_drawn_over_the_position_and_its_line_lies_in_the_residual(spring):
    (found,) = evidence(spring.identification, [ranked("joint_spring", NAMES[:1])], [spring.training])
    assert (found.joint, found.variable, found.unit) == (NAMES[0], "position", "rad")
    # Some of the slope is hidden in the model's own parameters.
    assert 2.0 < np.polyfit(found.x, found.fitted, 1)[0] < 6.2
    noise = found.spread / np.sqrt(found.count)
    assert np.mean(np.abs(found.residual - found.fitted) < 4 * noise) > 0.9
    assert found.explained > 0.5
    assert (np.diff(found.x) > 0).all()


def test_what_an_effect_explains_is_what_adding_it_removes(spring):
    (found,) = evidence(spring.identification, [ranked("joint_spring", NAMES[:1])], [spring.training])
    grown = extend(spring.identification, [EffectChoice("joint_spring", NAMES[:1])], [spring.training])
    removed = 1 - grown.fit.squares[0] / spring.identification.fit.squares[0]
    assert found.explained == pytest.approx(removed, abs=0.02)


def test_an_effect_that_is_not_there_explains_nothing(spring):
    found = evidence(spring.identification, [ranked("joint_spring", NAMES[3:4], rank=2)], [spring.training])
    assert all(one.explained < 0.05 for one in found)


def test_a_ripple_is_drawn_over_one_turn_of_its_phase():
    rippling = experiment(CASES["torque_ripple"].hidden)
    (found,) = evidence(rippling.identification, [ranked("torque_ripple", NAMES[3:4], k=21.0)], [rippling.training])
    assert found.variable == "phase"
    assert 0 <= found.x[0] < found.x[-1] <= 2 * np.pi
    np.testing.assert_allclose(found.fitted, 0.9 * np.sin(found.x + 0.7), atol=0.15)


def test_friction_is_drawn_over_the_velocity_and_groups_give_a_figure_a_joint():
    rubbing = experiment(CASES["viscous_nonlinear"].hidden)
    found = evidence(rubbing.identification, [ranked("viscous_nonlinear", NAMES, p=2.0)], [rubbing.training])
    assert [one.joint for one in found] == list(NAMES)
    assert found[0].variable == "velocity"
    assert found[0].explained == max(one.explained for one in found)


def test_without_ranked_effects_there_is_nothing_to_draw(spring):
    assert evidence(spring.identification, [], [spring.training]) == ()
    assert evidence(spring.identification, [ranked("joint_spring", NAMES[:1], rank=99)], [spring.training]) == ()
