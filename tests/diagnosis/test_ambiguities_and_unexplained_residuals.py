"""What a diagnosis says of a finding that may be elsewhere, and of a residual that nothing explains."""

from __future__ import annotations

import numpy as np
import pytest

from dynident.diagnosis.candidates.candidate_pool import Candidate
from dynident.diagnosis.candidates.held_out_scores import Score
from dynident.diagnosis.candidates.significance import ScoredCandidate, combine_scores
from dynident.diagnosis.decision_levels import RULES
from dynident.diagnosis.diagnosis_result import UnknownPattern
from dynident.diagnosis.diagnosis_summary import rank_findings, select_verdict
from dynident.diagnosis.search.search_state import Finding
from dynident.effects import EffectChoice

PEAK = (("delta", 2.0), ("vs", 0.1))


def explaining(*joints: str) -> ScoredCandidate:
    """A friction peak on some joints that takes half of the squared error of a robot's only motor."""
    candidate = Candidate("stribeck", joints, PEAK, (5,))
    before = np.ones((20, 1))
    score = Score(candidate, before, 0.5 * before, 1.0, np.ones(1), np.ones(1))
    return combine_scores([[score], [score]], [(0,)], np.ones(1))[0]


def test_a_friction_peak_that_may_as_well_be_on_another_passive_joint_is_told_with_it():
    equal = (explaining("forearm"), explaining("rod"), explaining("arm", "forearm", "rod"))
    finding = Finding(explaining("rod"), equal, 0.001)
    (ranked,) = rank_findings([finding], [EffectChoice("stribeck", ("rod",), PEAK)])
    assert ranked.joints == ("rod",)
    assert ranked.evidence.endswith("It may equally well act on: forearm.")


def test_a_friction_peak_that_is_on_one_joint_alone_is_told_of_that_joint():
    finding = Finding(explaining("rod"), (explaining("rod"), explaining("arm", "rod")), 0.001)
    (ranked,) = rank_findings([finding], [EffectChoice("stribeck", ("rod",), PEAK)])
    assert "may equally well act on" not in ranked.evidence


@pytest.mark.parametrize(
    ("recommended", "unknown", "worst", "verdict"),
    [
        ((), (), 1.9, "adequate"),
        ((), (), 13.0, "unexplained"),
        ((), (UnknownPattern("arm", "position", 0.2),), 1.0, "unexplained"),
        ((EffectChoice("stribeck", ("rod",), PEAK),), (), 13.0, "missing_effect"),
    ],
)
def test_no_model_is_adequate_that_leaves_many_times_the_noise(recommended, unknown, worst, verdict):
    assert 1.9 < RULES.adequate_over_noise < 13.0
    assert select_verdict(recommended, unknown, np.array([1.0, worst])) == verdict
