"""An arm that rests between its moves, over HTTP: no windows, errors of moving rows beside all, a band at rest."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from support.joints_at_rest import COULOMB, MOVES, PERIOD, resting_motion, write_resting_run
from support.oracles import arm

from dynident.recordings.joint_phases import SLOW, SLOW_SHARE
from dynident.robot import library_table
from dynident_client import Client

pytestmark = pytest.mark.slow
ROBOT = arm("scara")
FIGURES = {"rms", "relative", "relative_total"}


@dataclass
class Bench:
    client: Client
    training: Any
    held_out: Any
    model: Any


@pytest.fixture(scope="module")
def bench(live: Client, tmp_path_factory: pytest.TempPathFactory) -> Bench:
    folder = tmp_path_factory.mktemp("resting")
    robot = live.robots.create("scara", modified_dh=library_table("scara"))
    runs = [
        live.measurements.upload(robot, write_resting_run(ROBOT, folder / f"run{seed}.csv", seed), name=f"run{seed}")
        for seed in (1, 2)
    ]
    model = live.identifications.create(robot, runs[:1], validation=runs[1:]).wait()
    return Bench(live, runs[0], runs[1], model)


def test_a_measurement_says_how_much_of_its_time_every_joint_stands(bench: Bench) -> None:
    phases = bench.training.phases
    standing, reversing = np.array(phases["standing"]), np.array(phases["reversing"])
    assert len(standing) == len(reversing) == ROBOT.n
    speed = np.abs(resting_motion(ROBOT, 32.0, 100.0, seed=1).dq)
    slow = np.minimum(SLOW, SLOW_SHARE * np.sqrt(np.mean(speed**2, axis=0)))
    # A halt is slow somewhere, and begins and ends at twice that; both are told to a sample or two.
    assert (standing + reversing > (speed < slow).mean(axis=0) - 0.02).all()
    assert (standing + reversing < (speed < 2.0 * slow).mean(axis=0) + 0.02).all()
    assert (standing > 1.0 - MOVES / PERIOD).all()
    assert ((reversing > 0.0) & (reversing < 0.03)).all()
    (check,) = (one for one in bench.training.checks if one["name"] == "standstill")
    assert check["status"] == "ok"
    assert all(name in check["detail"] for name in ROBOT.joint_names)


def test_rest_spoils_no_parameter_and_errors_are_told_for_moving_rows_and_for_all(bench: Bench) -> None:
    found = bench.model.result
    for errors in (found["residual"], found["validation"]):
        assert errors.keys() >= {*FIGURES, "moving"}
        assert errors["moving"].keys() == FIGURES
        assert len(errors["moving"]["rms"]) == ROBOT.n
        assert errors["relative_total"] < 0.02
        # Friction holds the torque at rest: those rows add no error, and reversals little.
        assert errors["moving"]["rms"] != errors["rms"]
        np.testing.assert_allclose(errors["moving"]["rms"], errors["rms"], rtol=0.3)
    friction = [one["value"] for one in found["parameters"] if one["effect"] == "coulomb"]
    np.testing.assert_allclose(friction, COULOMB, rtol=0.02)


def test_a_comparison_is_told_with_and_without_the_band_at_rest(bench: Bench) -> None:
    comparison = bench.client.comparisons.create(bench.model, bench.held_out).wait()
    found = comparison.result
    assert found["moving"].keys() == found["raw"].keys() == FIGURES
    assert found["relative_total"] == pytest.approx(bench.model.result["validation"]["relative_total"], rel=0.05)
    assert found["moving"]["relative_total"] == pytest.approx(
        bench.model.result["validation"]["moving"]["relative_total"], rel=1e-6
    )
    assert found["raw"]["relative_total"] > 5.0 * found["relative_total"]
    # Behind the filters rest is a little longer than in the recording.
    recorded = bench.held_out["phases"]["reversing"]
    assert all(a > b for a, b in zip(found["phases"]["reversing"], recorded, strict=True))
    series = bench.client.comparisons.series(comparison, ROBOT.joint_names[0], points=100_000)
    standing, lower, upper, predicted = (np.array(series[k]) for k in ("standing", "lower", "upper", "predicted"))
    assert standing.mean() == pytest.approx(found["phases"]["standing"][0])
    np.testing.assert_allclose((upper - lower)[standing], 2 * COULOMB, rtol=0.05)
    np.testing.assert_array_equal(lower[~standing], predicted[~standing])


def test_an_extension_by_several_effects_is_one_rung_each_on_the_ladder(bench: Bench) -> None:
    first, second = ROBOT.joint_names[:2]
    added = [
        {"effect": "offset"},
        {"effect": "joint_spring", "joints": [first]},
        {"effect": "stribeck", "joints": [second]},
    ]
    better = bench.client.identifications.extend(bench.model, added).wait()
    steps = better.result["rungs"]
    assert [[one["effect"] for one in step["added"]] for step in steps] == [["offset"], ["joint_spring"]]
    counts = [len(bench.model.result["parameters"]), *(one["n_parameters"] for one in steps)]
    assert counts[0] < counts[1] < counts[2] < len(better.result["parameters"])
    assert all(step["residual"]["moving"] and step["validation"]["moving"] for step in steps)

    ladder = bench.client.identifications.lineage(better)
    assert [rung["id"] for rung in ladder] == [bench.model.id, f"{better.id}/1", f"{better.id}/2", better.id]
    assert [rung["part_of"] for rung in ladder] == [None, better.id, better.id, None]
    assert [rung["parent_id"] for rung in ladder] == [None, *(rung["id"] for rung in ladder[:-1])]
    assert [[one["effect"] for one in rung["added"]] for rung in ladder[1:]] == [[one["effect"]] for one in added]
    assert ladder[-1]["added"][0]["shape_parameters"]["vs"] > 0
    assert ladder[-1]["effects"] == better.result["effects"]
    assert ladder[2]["effects"] == better.result["effects"][:-1]

    totals = [rung["validation"]["relative_total"] for rung in ladder]
    best = int(np.argmin(totals))
    assert [rung["best"] for rung in ladder] == [k == best for k in range(4)]
    assert [rung["rises"] for rung in ladder] == [k > best and totals[k] > totals[best] for k in range(4)]

    back = bench.client.identifications.remove(better, [{"effect": "offset"}]).wait()
    assert back.result["rungs"] == []
    compared = bench.client.identifications.compare_lineages(back, better)
    assert compared["common_ancestor"] == better.id
    assert len(compared["differences"]) == 5


def test_validations_and_reports_tell_the_errors_of_moving_rows_too(bench: Bench) -> None:
    cross = bench.client.validations.create(bench.model, "cross").wait().result
    expected = bench.model.result["validation"]["moving"]["relative_total"]
    assert cross["measurements"][0]["errors"]["moving"]["relative_total"] == pytest.approx(expected)
    assert cross["total"]["moving"]["relative_total"] == pytest.approx(expected)
    essential = bench.client.identifications.essential(bench.model)
    assert all(step["residual"]["moving"] for step in [essential, *essential["steps"]])
