"""Effects hidden anew each time in arms of another engine: enough of them are named, and nothing is made up.

`HIDDEN_EFFECTS_SEED=<number>` draws the same cases again.
"""

from __future__ import annotations

import os
import secrets

import numpy as np
import pytest
from hiding.case import Case
from hiding.drawing import PAIRS, Wanted, draw_cases
from hiding.families import FAMILIES
from hiding.judging import judge_safely
from hiding.manners import Manners
from hiding.outcome import Outcome
from hiding.outside import OUTSIDE
from hiding.table import describe, is_failure

Outcomes = tuple[Outcome, ...]

# Other cases every time: what fails by chance once in some hundred runs says nothing of one change.
pytestmark = [pytest.mark.slow, pytest.mark.thorough, pytest.mark.timeout(1800)]

# Single cases at their full size and at a quarter of it.
FULL, QUARTER = 8, 2
# Quick motions without pauses, firmly controlled: what is harder is for the benchmark.
EASY = Manners(motions=("fourier",), firmnesses=("stiff",), paces=(1.0,))
# What any seed has to reach: a few cases tell little, so this is far below what is usual.
NAMED, WITHIN, MADE_UP = 0.5, 0.5, 0.25


def _drawn(seed: int, full: int, quarter: int) -> list[Case]:
    rng = np.random.default_rng(seed)
    singles = [str(name) for name in rng.choice(list(FAMILIES), full + quarter, replace=False)]
    pair = "+".join(PAIRS[int(rng.integers(len(PAIRS)))])
    odd = str(rng.choice(list(OUTSIDE)))
    return [
        *draw_cases(Wanted(seed, 0, (*singles[:full], pair, odd, "clean"), sizes=("full",), manners=EASY)),
        *draw_cases(Wanted(seed, 0, tuple(singles[full:]), sizes=("quarter",), manners=EASY)),
    ]


@pytest.fixture(scope="module")
def outcomes() -> Outcomes:
    seed = int(os.environ.get("HIDDEN_EFFECTS_SEED") or secrets.randbelow(10**6))
    print(f"\nHIDDEN_EFFECTS_SEED={seed}")
    found = tuple(judge_safely(case, None) for case in _drawn(seed, FULL, QUARTER))
    print("\n".join(describe(outcome) for outcome in found if is_failure(outcome)))
    return found


def _shown(outcomes: Outcomes, kind: str) -> list[Outcome]:
    return [outcome for outcome in outcomes if outcome.kind == kind and outcome.shows]


def test_every_hidden_effect_gets_an_answer_and_not_an_error(outcomes: Outcomes) -> None:
    assert [outcome.failure for outcome in outcomes if outcome.failure] == []


def test_most_hidden_effects_are_named_first(outcomes: Outcomes) -> None:
    shown = _shown(outcomes, "single")
    named = [outcome for outcome in shown if outcome.naming in ("right", "equivalent")]
    assert len(named) >= NAMED * len(shown)


def test_an_effect_that_is_named_is_on_its_joint(outcomes: Outcomes) -> None:
    assert all(o.joint is not False for o in _shown(outcomes, "single") if o.naming in ("right", "equivalent"))


def test_adding_what_is_recommended_predicts_about_as_well_as_the_truth(outcomes: Outcomes) -> None:
    ratios = [outcome.over_oracle for outcome in _shown(outcomes, "single") if outcome.over_oracle is not None]
    assert sum(ratio <= 1.05 for ratio in ratios) >= WITHIN * len(ratios)


def test_of_two_hidden_effects_at_least_one_is_named_first(outcomes: Outcomes) -> None:
    assert all(outcome.naming in ("right", "equivalent") for outcome in _shown(outcomes, "double"))


def test_hardly_anything_is_recommended_that_is_not_there(outcomes: Outcomes) -> None:
    assert sum(bool(outcome.beside) for outcome in outcomes) <= MADE_UP * len(outcomes)
