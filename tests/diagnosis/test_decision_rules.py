"""Every level of the decision stands in one object, with its unit, its meaning and its reason."""

from __future__ import annotations

from dataclasses import FrozenInstanceError, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from support.hidden_effects import CASES, NAMES, experiment

from dynident.diagnosis import DecisionRules, DiagnosisChoices, diagnose
from dynident.diagnosis.candidates.candidate_pool import Candidate
from dynident.diagnosis.candidates.significance import ScoredCandidate
from dynident.diagnosis.decision_levels import RULES
from dynident.diagnosis.search.acceptance_rules import find_rejection
from dynident.diagnosis.search.search_state import State

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"
MOST_LEVELS = 60


def test_every_level_says_what_it_is_and_why() -> None:
    levels = list(RULES.list_levels())
    assert len(levels) <= MOST_LEVELS
    for level in levels:
        assert level.unit
        assert level.meaning
        assert len(level.reason) > 10
        assert not level.script or (BENCHMARKS / f"{level.script}.py").exists(), level.name
    assert {level.name: level.value for level in levels}["least_error_drop"] == 0.02


def test_a_level_that_a_request_sets_has_the_name_of_its_field() -> None:
    rules = DiagnosisChoices(max_effects=3, significance=0.05).rules
    changed = {level.name: level.value for level in rules.list_levels() if level not in RULES.list_levels()}
    assert changed == {"max_effects": 3, "significance": 0.05}


def test_the_levels_cannot_be_changed_in_place() -> None:
    with pytest.raises(FrozenInstanceError):
        RULES.least_error_drop = 0.5  # type: ignore[misc]


def score(**values: float) -> ScoredCandidate:
    """A friction of one joint that removes half of the squared error in ten blocks, unless values say otherwise."""
    before = np.full((10, 1), 100.0)
    share = values.pop("share", 0.5)
    numbers = {"drop": share, "t": 9.0, "separability": 0.8, "share_improved": 1.0, "p": 0.0005}
    return ScoredCandidate(
        Candidate("viscous_asymmetric", ("elbow",), (), (1,)),
        (0,),
        before,
        (1.0 - share) * before,
        gains=np.full(10, 100.0 * share),
        amplitudes=np.ones(1),
        measured=np.full(1, 1e4),
        after_weighted=np.full(10, 100.0 * (1.0 - share)),
        **{**numbers, **values},
    )


@pytest.mark.parametrize(
    ("values", "changed", "code"),
    [
        ({"separability": 0.1}, {"least_separability": 0.2}, "not_determined"),
        ({"p": 0.008}, {"significance": 0.005}, "not_significant"),
        ({"share": 0.1}, {"least_error_drop": 0.2}, "too_small"),
        ({"t": 3.0, "separability": 0.2}, {"least_reach": 1.0}, "not_determined"),
    ],
)
def test_a_level_of_the_search_decides_and_gives_its_reason(values, changed, code) -> None:
    # Ten blocks of ten rows.
    data = cast(Any, SimpleNamespace(count_rows=lambda _columns: np.full((10, 1), 10.0)))
    state = State(data, cast(Any, None), (0,), np.ones(1), np.full(1, 0.01))
    scored = score(**values)
    assert find_rejection(state, scored) is None
    rejection = find_rejection(replace(state, rules=replace(RULES, **changed)), scored)
    assert rejection is not None
    assert rejection.code == code


def test_the_significance_of_a_request_is_that_of_the_rules() -> None:
    case = CASES["viscous_nonlinear"]
    run = experiment(case.hidden, case.effects)
    diagnosis = diagnose(
        run.identification, [run.training], DiagnosisChoices((case.effect, "stribeck", "offset"), significance=0.05)
    )
    assert (diagnosis.recommended[0].effect, diagnosis.recommended[0].joints) == (case.effect, (NAMES[case.joint],))
    assert DecisionRules().significance == 0.01
