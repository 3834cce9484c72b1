"""Whether 95 % intervals hold the truth in 95 % of cases, class by class of parameters."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))

from interval_coverage import (
    HIDDEN,
    MEMORIES,
    SLOW,
    TORQUE,
    Coverage,
    VirtualArm,
    build_two_joints,
    study,
    study_shapes,
    study_slow,
)

CLASSES = {"inertia", "first moments", "rotor_inertia", "coulomb", "viscous", "offset", TORQUE}


@pytest.fixture(scope="module")
def coverage(thorough: bool) -> Coverage:
    # The smallest class has six parameters: of 600 intervals 95 % hold the truth to within three standard deviations.
    return study(200 if thorough else 100)


@pytest.fixture(scope="module")
def shared(thorough: bool) -> Coverage:
    # What counts samples or joints as independent is far from 95 %: fewer recordings show it.
    return study(200 if thorough else 16, memory=MEMORIES[0])


@pytest.mark.slow
def test_intervals_hold_the_truth_in_about_95_of_100_cases_in_every_class(coverage):
    assert set(coverage.honest) == CLASSES
    for name, share in coverage.honest.items():
        assert 0.92 <= share <= 0.98, (name, share)


@pytest.mark.thorough
def test_they_do_so_where_joints_share_what_the_model_lacks(shared):
    assert set(shared.honest) == CLASSES
    for name, share in shared.honest.items():
        assert 0.92 <= share <= 0.98, (name, share)


USUAL = [("estimator", "wls", 0.0), ("estimator", "wls", 0.5), ("strategy", "sequential", 0.5)]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("field", "way", "memory"),
    [
        pytest.param(*one, memory, marks=[] if (*one, memory) in USUAL else pytest.mark.thorough)
        for one in (("estimator", "wls"), ("strategy", "sequential"))
        for memory in SLOW
    ],
)
def test_intervals_hold_however_slow_the_residuals_of_each_joint(field, way, memory, thorough):
    shares = study_slow(VirtualArm(build_two_joints()), {field: way}, memory, 200 if thorough else 80, 71_001)
    assert 0.92 <= shares["all"] <= 0.98


@pytest.mark.thorough
def test_shape_constants_and_the_parameters_beside_them_have_intervals_that_hold():
    found = study_shapes(HIDDEN[0], 50)
    assert found.told == {"vs": 1.0}
    assert 0.90 <= found.constants["vs"] <= 0.99
    for name, share in found.parameters.items():
        assert 0.90 <= share <= 0.99, (name, share)
    assert found.certain["coulomb"] < 0.92


@pytest.mark.slow
def test_counting_filtered_samples_as_independent_promises_too_much(coverage, shared):
    assert max(coverage.naive.values()) < 0.90
    assert max(shared.naive.values()) < 0.70
