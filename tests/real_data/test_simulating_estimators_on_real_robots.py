"""A real arm by the estimators that simulate it, and what of its parameters is essential."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pyarrow.parquet as pq
import pytest
from support.real_robots import CHOICES, DATA, UR10E_GAINS, UR10E_ROWS, held_out, pytestmark, robot  # noqa: F401

from dynident.identification import identify
from dynident.identification.identified_models.correlated_and_essential_parameters import (
    essential_parameters,
    parameter_dependence,
)
from dynident.recordings import RecordedJoints, RecordingMetadata, import_recording


@pytest.fixture(scope="module")
def arm():
    return robot("ur10e")


@pytest.fixture(scope="module")
def runs(arm, tmp_path_factory):
    folder = tmp_path_factory.mktemp("recordings")
    found = {}
    for name in ("id_30s_12harm", "id_50s_12harm"):
        source = DATA / "ur10e" / f"{name}.parquet"
        t = pq.read_table(source, columns=["t"])["t"].to_numpy()
        first, last = UR10E_ROWS[name]
        said = RecordingMetadata(name=name, windows=((t[first - 1], t[last - 1]),))
        target = folder / f"{name}.parquet"
        found[name] = import_recording(
            source, target, RecordedJoints(arm.joint_names, gains=UR10E_GAINS), metadata=said
        )[0]
    return found


@pytest.fixture(scope="module")
def solved(arm, runs):
    def by(estimator: str):
        # The others know nothing of rows that count less where joints turn round.
        choices = replace(CHOICES, estimator=estimator, weigh_turns=False)
        return identify(arm, [runs["id_30s_12harm"]], [runs["id_50s_12harm"]], choices)

    return by


@pytest.fixture(scope="module")
def weighted(solved):
    return solved("wls")


@pytest.mark.slow
@pytest.mark.parametrize("estimator", ["iv", "didim"])
def test_a_ur10e_by_simulation_is_the_one_of_weighted_least_squares(solved, weighted, estimator):
    # Good encoders behind good filters leave no bias that instruments would remove: the estimators have to agree.
    found = solved(estimator)
    assert held_out(found) <= 1.02 * held_out(weighted)
    both = np.hypot(found.statistics.standard_deviations, weighted.statistics.standard_deviations)
    assert np.sqrt(np.mean(((found.values - weighted.values) / both) ** 2)) < 1.0


def test_a_ur10e_by_a_kalman_filter_is_the_one_of_weighted_least_squares_and_as_sure(solved, weighted):
    found = solved("ekf")
    assert held_out(found) <= 1.02 * held_out(weighted)
    both = np.hypot(found.statistics.standard_deviations, weighted.statistics.standard_deviations)
    assert np.sqrt(np.mean(((found.values - weighted.values) / both) ** 2)) < 0.6
    assert 0.7 < np.median(found.statistics.standard_deviations / weighted.statistics.standard_deviations) < 1.5


@pytest.mark.slow
def test_a_kalman_filter_on_another_motion_of_a_ur10e_finds_the_same_within_its_standard_deviations(arm, runs, solved):
    here, there = solved("ekf"), identify(arm, [runs["id_50s_12harm"]], [], replace(CHOICES, estimator="ekf"))
    both = np.hypot(here.statistics.standard_deviations, there.statistics.standard_deviations)
    assert np.sqrt(np.mean(((here.values - there.values) / both) ** 2)) < 1.3


def test_half_of_a_ur10es_parameters_are_not_essential_and_held_out_torque_is_predicted_as_well_without(weighted):
    path = essential_parameters(weighted)
    assert 15 <= len(path.essential) <= 35
    assert held_out(path.identification) <= 1.01 * held_out(weighted)
    assert {f"{kind}{joint}" for kind in ("Fc", "Fv") for joint in range(1, 7)} <= set(path.essential)


def test_what_a_ur10es_motion_shows_only_together_is_said(weighted):
    said = parameter_dependence(weighted).sentences
    assert any("MX2 and b2 are determined only together" in sentence for sentence in said)
