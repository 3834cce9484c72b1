"""Whether 95 % intervals hold the truth in 95 % of cases, class by class of parameters."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))

from interval_coverage import Coverage, study


@pytest.fixture(scope="module")
def coverage() -> Coverage:
    return study(200)


@pytest.mark.slow
def test_intervals_hold_the_true_parameter_in_about_95_of_100_cases_in_every_class(coverage):
    assert set(coverage.honest) == {"inertia", "first moments", "rotor_inertia", "coulomb", "viscous", "offset"}
    for name, share in coverage.honest.items():
        assert 0.92 <= share <= 0.98, (name, share)


@pytest.mark.slow
def test_counting_filtered_samples_as_independent_promises_too_much(coverage):
    assert max(coverage.naive.values()) < 0.90
