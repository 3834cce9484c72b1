"""What a diagnosis proposes to do next: a design that can be run, and what it would tell that the data do not."""

from __future__ import annotations

import time
from functools import cache

import numpy as np
import pytest
from hidden_effects import CASES, NAMES, ROBOT, Experiment, experiment

from dynident.diagnosis import Comparison, NextExperiment, compare
from dynident.diagnosis.advice.doubts import Doubt, doubts_of
from dynident.diagnosis.advice.kinds import EXPERIMENTS
from dynident.diagnosis.advice.next_experiment import next_experiment
from dynident.diagnosis.advice.pairs import ALONE, PAIRS, experiment_for
from dynident.diagnosis.result import Invisible
from dynident.effects import CATALOGUE, EffectChoice
from dynident.excitation import design_experiment


def on(joint: int, effect: str, **shape: float) -> EffectChoice:
    return EffectChoice(effect, (NAMES[joint],), tuple(sorted(shape.items())))


PAIRS_TO_DECIDE = {
    "constant_velocity": Doubt(on(0, "stribeck", vs=0.3), (on(0, "viscous_nonlinear", p=2.0),)),
    "reversals": Doubt(on(3, "presliding", d0=0.01), (on(3, "stribeck", vs=0.1),)),
    "slow_sweep": Doubt(
        on(1, "joint_spring"), (on(1, "gravity_compensator", phi=0.1, r=0.25), on(1, "torque_ripple", k=2))
    ),
    "optimized": Doubt(on(2, "load_dependent_friction"), (on(2, "position_dependent_friction", k=1.0),)),
}


@cache
def data() -> tuple[Experiment, tuple[Comparison, ...]]:
    run = experiment(CASES["viscous_nonlinear"].hidden)
    return run, (compare(run.identification, run.training),)


def proposed(*doubts: Doubt) -> NextExperiment | None:
    run, comparisons = data()
    return next_experiment(run.identification, comparisons, doubts)


@pytest.mark.parametrize("kind", PAIRS_TO_DECIDE)
def test_rivals_are_to_be_told_apart_by_a_motion_that_knows_them_better_than_the_data(kind):
    doubt = PAIRS_TO_DECIDE[kind]
    found = proposed(doubt)
    assert found is not None
    assert found.design.kind == kind
    assert doubt.suspect.effect in found.reason
    assert doubt.rivals[0].effect in found.reason
    assert found.present_separation is not None
    assert found.expected_separation is not None
    assert found.expected_separation.parameter == found.present_separation.parameter
    assert found.expected_separation.standard_deviation < 0.8 * found.present_separation.standard_deviation


@pytest.mark.parametrize("kind", ["constant_velocity", "reversals"])
def test_the_predicted_deviation_is_that_of_the_design_made_and_of_the_data_together(kind):
    found = proposed(PAIRS_TO_DECIDE[kind])
    assert found is not None
    design = design_experiment(ROBOT, found.design)
    parameter = found.expected_separation.parameter
    alone = next(one for one in design.expected if one.name == parameter)
    # The data at hand add what the motion alone lacks, never the other way round.
    assert found.expected_separation.standard_deviation < 1.05 * alone.standard_deviation
    assert design.criterion_values.criterion < np.inf


def test_a_proposal_does_not_keep_a_diagnosis_waiting():
    data()
    for doubt in PAIRS_TO_DECIDE.values():
        began = time.process_time()
        proposed(doubt)
        assert time.process_time() - began < 1.0


def test_what_people_have_to_do_is_said_beside_the_design():
    payload = proposed(PAIRS_TO_DECIDE["optimized"])
    assert payload is not None
    assert any("payload of known mass" in step for step in payload.instructions)
    session = proposed(Doubt(on(2, "temperature_friction"), (on(2, "warm_up_friction", Tw=900.0),)))
    assert session is not None
    assert any("cold" in step for step in session.instructions)
    assert session.expected_separation is None
    design_experiment(ROBOT, session.design)


def test_an_effect_that_could_not_be_seen_gets_the_motion_that_shows_it():
    hidden = (Invisible("joint_spring", (NAMES[5],), "too small"), Invisible("presliding", (NAMES[1],), "too fast"))
    doubts = doubts_of((), (), hidden, ROBOT)
    assert [doubt.suspect.effect for doubt in doubts] == ["presliding", "joint_spring"]
    found = proposed(*doubts)
    assert found is not None
    assert found.design.kind == "reversals"
    assert found.design.trajectory.joints == (NAMES[1],)
    assert f"show whether presliding is there on {NAMES[1]}" in found.reason


def test_nothing_is_proposed_where_nothing_is_open():
    assert proposed() is None


def test_no_motion_is_proposed_for_what_no_motion_can_tell():
    assert proposed(Doubt(on(0, "coulomb_asymmetric"), (on(0, "offset"),))) is None


def test_the_table_knows_every_effect_of_the_catalogue():
    assert set(CATALOGUE) <= set(ALONE)
    assert set(ALONE.values()) | set(PAIRS.values()) == set(EXPERIMENTS)
    for pair in PAIRS:
        assert len(pair) == 2
        assert pair <= set(ALONE)


def test_every_confusion_that_the_catalogue_warns_of_has_an_experiment():
    for effect in CATALOGUE.values():
        for other in effect.confused_with:
            assert experiment_for(effect.id, other) is not None


@pytest.mark.parametrize("effect", [name for name in CATALOGUE if name not in ("rigid_body", "coulomb", "viscous")])
def test_every_effect_gets_a_design_that_can_be_made(effect):
    possible = CATALOGUE[effect].applicable(ROBOT)
    if effect == "rotor_inertia" or not possible:
        pytest.skip("in the model, or on no joint of this robot")
    grid = CATALOGUE[effect].grid(ROBOT, possible[-1])
    shape = tuple(sorted((name, float(value) or 0.5) for name, value in grid[0].items())) if grid else ()
    joints = () if CATALOGUE[effect].scope == "robot" else (NAMES[possible[-1]],)
    found = proposed(Doubt(EffectChoice(effect, joints, shape)))
    if effect in ("offset", "coulomb_asymmetric", "rotor_coupling", "encoder_zero_error"):
        return  # In the model, or the same function of every motion as something that is.
    assert found is not None
    quick = found.design.kind not in ("optimized", "random")
    if quick:
        assert design_experiment(ROBOT, found.design).duration < 600
