"""What is recommended is judged in its order, on parts of the motion or runs that were left out."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, cast

import numpy as np
import pytest
from support.hidden_effects import CASES, NAMES, ROBOT, experiment
from support.scored_candidates import products_from_reduction

from dynident.diagnosis.candidates.candidate_pool import build_pool_of_choices
from dynident.diagnosis.candidates.inner_product_accumulation import (
    ConditionalRows,
    PhasedProducts,
)
from dynident.diagnosis.candidates.time_blocks_and_folds import ProductStack
from dynident.diagnosis.residuals.resolution_at_reversals import Resolution
from dynident.diagnosis.search import pruning
from dynident.diagnosis.search.finding_refinement import refine_findings
from dynident.diagnosis.search.pruning import select_harmless
from dynident.diagnosis.search.search_state import Finding, State, gather_state, score_all
from dynident.effects import EffectChoice, Estimate, get_effect
from dynident.estimation import FactorAccumulator
from dynident.progress import ignore_progress
from dynident.regressors.observation_matrix import RegressorInputs

STRETCHES, ROWS = 40, 12
MANY = 150


def gathered(
    y_of, runs: int = 1, seed: int = 0, only_first: int | None = None, alike: bool = False, absent: int | None = None
) -> State:
    """One joint: columns 0 and 1 the model, 2 an effect, the rest functions that mean nothing.

    `only_first`: a column that is there in the first run alone; `alike`: in the others the effect is as column 1;
    `absent`: a column that is zero.
    """
    rng = np.random.default_rng(seed)
    m = STRETCHES * ROWS
    w = rng.normal(size=(m, 3 + MANY))
    if only_first is not None:
        w[m // runs :, only_first] *= 1e-3
    if absent is not None:
        w[:, absent] = 0.0
    if alike:
        w[m // runs :, 2] = w[m // runs :, 1] + 3e-3 * w[m // runs :, 2]
    y = w[:, :2] @ [1.0, -2.0] + y_of(w) + rng.normal(size=m)
    accumulator = FactorAccumulator([np.arange(3 + MANY)], 3 + MANY, 1.0)
    accumulator.push(np.arange(m) / ROWS, [np.column_stack([w, y])])
    moving = products_from_reduction(accumulator.finish())
    run = np.repeat(np.arange(runs), STRETCHES // runs)
    moving = replace(moving, run=run)
    nothing = tuple(ProductStack(np.zeros_like(vars(own[0])["values"])) for own in moving.stacks)
    elsewhere = ConditionalRows(nothing, np.zeros_like(moving.counts), np.zeros((3 + MANY, 1), dtype=bool))
    return State(PhasedProducts(moving, elsewhere, elsewhere), cast(Any, None), (0, 1), np.ones(1), np.ones(1))


@pytest.mark.parametrize("runs", [1, 4])
def test_what_helps_is_kept_and_what_fits_the_noise_alone_is_not(runs):
    state = gathered(lambda w: 0.5 * w[:, 2], runs)
    columns = [tuple(range(3, 3 + MANY)), (2,)]
    assert select_harmless(state, columns) == [1]


def test_an_effect_that_holds_in_one_run_alone_and_is_claimed_for_all_is_dropped():
    def in_the_first_run(w):
        return 3.0 * w[:, 2] * (np.arange(len(w)) < len(w) / 4) - 1.0 * w[:, 2] * (np.arange(len(w)) >= len(w) / 4)

    assert select_harmless(gathered(in_the_first_run, 4), [(2,)]) == []


@pytest.mark.parametrize("column", [1, 2])
def test_what_one_run_alone_determines_is_not_judged_without_that_run(column):
    """A sweep of one joint says nothing of the others, nor the other runs of the payload in one."""
    state = gathered(lambda w: 0.7 * w[:, 2], runs=2, only_first=column)
    assert select_harmless(state, [(2,)]) == [0]


def test_what_only_one_run_tells_from_the_model_is_not_judged_without_that_run():
    """The load on a shank is as large in every run, but while the foot stands it is what the model says already."""
    state = gathered(lambda w: 0.7 * w[:, 2], runs=2, alike=True)
    assert select_harmless(state, [(2,)]) == [0]


def test_a_finding_that_no_row_shows_is_judged_without_an_error():
    state = gathered(lambda w: 0.0 * w[:, 2], runs=2, absent=2)
    assert select_harmless(state, [(2,)]) == [0]


@pytest.mark.parametrize(
    ("effect", "values", "natural"),
    [
        ("torque_delay", {"delay": 8e-3, "delay_sq": 6e-5}, True),
        ("torque_delay", {"delay": -3e-3, "delay_sq": 6e-5}, False),
        ("torque_delay", {"delay": 2e-4, "delay_sq": 1e-7}, False),
        ("stribeck", {"Fst": -0.75}, False),
        ("joint_elasticity", {"Ce": 6.6e-5, "Cl": 7.4e-5, "Cr": 1e-9}, True),
        ("joint_elasticity", {"Ce": 6.6e-5, "Cl": 9.4e-4, "Cr": 1e-9}, False),
        ("joint_elasticity", {"Ce": 1e-9, "Cl": 1e-9, "Cr": 5e-4}, True),
        ("joint_elasticity", {"Ce": 1e-9, "Cl": 3.8e-4, "Cr": 5e-4}, False),
        ("encoder_zero_error", {"dq0": 0.02}, True),
        ("encoder_zero_error", {"dq0": 2.0}, False),
        ("base_tilt", {"gx": 0.3, "gy": 0.001}, True),
        ("base_tilt", {"gx": 0.003, "gy": 0.001}, False),
        ("viscous_nonlinear", {"Fvn": 3.0, "p": 0.5}, True),
        # Friction that falls steeply from rest is Stribeck friction, by whichever law it is described.
        ("viscous_nonlinear", {"Fvn": -3.0, "p": 0.5}, False),
        ("viscous_nonlinear", {"Fvn": -3.0, "p": 3.0}, True),
    ],
)
def test_signs_and_sizes_that_nature_does_not_make_are_refused(effect, values, natural):
    names = {spec.name for spec in get_effect(effect).parameters}
    found = {name: Estimate(value, 1e-8) for name, value in values.items() if name in names}
    assert get_effect(effect).is_plausible(found, values) is natural


@pytest.mark.parametrize(
    ("effect", "values", "possible"),
    [
        # Friction may fall, a gain drift by some per cent; no drive gives a third more than the day before.
        ("viscous", {"Fv": (-2.0, 0.1)}, True),
        ("drive_gain_error", {"eps": (-0.05, 0.01)}, True),
        ("drive_gain_error", {"eps": (0.32, 0.01)}, False),
        ("drive_gain_error", {"eps": (0.32, 0.25)}, True),
        # Nobody would notice a torque that is 8 microseconds later, or a gain that is a tenth of a per cent off.
        ("torque_delay", {"delay": (8e-6, 1e-6), "delay_sq": (1e-9, 1e-9)}, False),
        ("torque_delay", {"delay": (-2e-3, 1e-4), "delay_sq": (1e-9, 1e-9)}, True),
        ("drive_gain_error", {"eps": (1e-3, 1e-4)}, False),
    ],
)
def test_a_change_may_have_either_sign_but_is_noticed_and_no_larger_than_it_comes_to_be(effect, values, possible):
    found = {name: Estimate(*pair) for name, pair in values.items()}
    assert get_effect(effect).is_plausible_change(found) is possible


def test_what_hurts_at_first_is_tried_again_beside_what_was_added_since(monkeypatch):
    """Friction hurts as long as the torque that it is judged on is late."""
    monkeypatch.setattr(pruning, "_is_harmless", lambda state, own: own != (2,) or 3 in state.base)
    assert select_harmless(gathered(lambda w: 0.0 * w[:, 2]), [(2,), (3,), (4,)]) == [1, 0, 2]
    monkeypatch.setattr(pruning, "_is_harmless", lambda state, own: own != (2,))
    assert select_harmless(gathered(lambda w: 0.0 * w[:, 2]), [(2,), (3,)]) == [1]


def test_a_name_that_its_refined_constants_make_impossible_gives_way_to_its_equal() -> None:
    run = experiment(CASES["stribeck"].hidden)
    model = run.identification.model
    place = (NAMES[1],)
    square = EffectChoice("viscous_nonlinear", place, (("p", 2.0),))
    fall = EffectChoice("stribeck", place, (("delta", 2.0), ("vs", 0.12)))
    reference = run.identification.estimate.next_reference()
    inputs = RegressorInputs([run.training], run.identification.preprocessing, reference)
    pool = build_pool_of_choices(model, [square, fall])
    noise = run.identification.noise
    power, peak = score_all(gather_state(model, pool, inputs, noise), pool.candidates)
    limit = np.full(ROBOT.n, 1e-4)
    resolved = Resolution(limit, limit, limit, np.ones(ROBOT.n))
    findings, choices, dropped = refine_findings(
        run.identification, [Finding(power, (peak,), 0.001)], inputs, resolved, noise, (), ignore_progress
    )
    # A square that rises becomes a root that falls: friction that falls from rest is Stribeck friction.
    assert [(choice.effect, choice.joints) for choice in choices] == [("stribeck", (NAMES[1],))]
    assert [finding.judged.candidate.effect for finding in findings] == ["stribeck"]
    assert dropped[power.candidate].code == "impossible"
