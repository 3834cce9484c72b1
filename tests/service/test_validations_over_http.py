"""Validations over HTTP: every kind ends with a verdict and a reason, and what does not fit is refused."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import pytest

from dynident.identification.methods.base_classes import ESTIMATORS, MODELS
from dynident.robot import library_table
from dynident_client import Client, JobFailed, ProblemError, Record

pytestmark = pytest.mark.slow


@dataclass
class Tried:
    """A model of a virtual arm, what it was identified from and what was held out."""

    client: Client
    training: Record
    held_out: Record
    model: Record

    def ends(self, kind: str, **more: Any) -> dict[str, Any]:
        return self.client.validations.create(self.model, kind, **more).wait().result

    def refused(self, kind: str, **more: Any) -> tuple[int, str]:
        with pytest.raises(ProblemError) as caught:
            self.client.validations.create(self.model, kind, **more)
        return caught.value.status, caught.value.errors[0]["pointer"] if caught.value.errors else ""


@pytest.fixture(scope="module")
def tried(live: Client) -> Tried:
    robot = live.robots.create("scara", modified_dh=library_table("scara"))
    runs = []
    for seed, duration in ((1, 12.0), (2, 9.0)):
        trajectory = {"duration": duration, "periods": 2, "sampling_rate": 200.0}
        made = live.simulations.create(robot, trajectory=trajectory, seed=seed).wait()
        runs.append(live.measurements.get(made.result["measurement_id"]))
    model = live.identifications.create(robot, runs[:1], validation=runs[1:]).wait()
    return Tried(live, runs[0], runs[1], model)


def test_errors_on_own_and_on_unseen_data(tried: Tried) -> None:
    direct, cross = tried.ends("direct"), tried.ends("cross")
    assert (direct["verdict"], cross["verdict"]) == ("pass", "pass")
    assert direct["measurements"][0]["measurement_id"] == tried.training.id
    assert cross["measurements"][0]["measurement_id"] == tried.held_out.id
    assert cross["total"]["relative"] == pytest.approx(tried.model["result"]["validation"]["relative"])
    strict = tried.ends("cross", limit=1e-6)
    assert (strict["verdict"], strict["limit"]) == ("fail", 1e-6)
    assert "limit" in strict["reason"]


def test_the_worst_posture_is_named(tried: Tried) -> None:
    found = tried.ends("inertia_matrix")
    assert found["verdict"] == "pass"
    assert found["inertia_matrix_positive_definite"] is True
    assert found["smallest_eigenvalue"] > 0
    joints = tried.model["result"]["joints"]
    assert list(found["worst_posture"]) == joints
    assert all(joint in found["reason"] for joint in joints)


def test_deviations_stand_beside_those_of_draws(tried: Tried) -> None:
    found = tried.ends("bootstrap", draws=200)
    drawn = found["bootstrap"]
    assert found["verdict"] in ("pass", "fail")
    assert (drawn["draws"], drawn["kind"]) in ((200, "wild"), (200, "pairs"))
    told = {one["name"]: one["standard_deviation"] for one in tried.model["result"]["parameters"]}
    assert {one["name"]: one["told"] for one in drawn["parameters"]} == pytest.approx(told)
    for one in drawn["parameters"]:
        assert one["ratio"] == pytest.approx(one["drawn"] / one["told"])
        assert one["outside"] == (not one["expected"][0] <= one["ratio"] <= one["expected"][1])


def test_methods_stand_in_one_table(tried: Tried) -> None:
    found = tried.ends("methods")
    rows = found["methods"]
    assert {row["model"] for row in rows} == set(MODELS.names)
    assert {row["estimator"] for row in rows} == set(ESTIMATORS.names)
    assert rows[0]["distance_rms"] == 0.0
    assert rows[0]["held_out"]["relative"] == pytest.approx(tried.model["result"]["validation"]["relative"])
    for row in rows:
        assert (row["values"] is None) == (row["problem"] is not None)
        assert row["values"] is None or len(row["values"]) == len(found["parameters"])
    assert found["verdict"] in ("pass", "fail")
    few = tried.ends("methods", methods=[{"estimator": "wls"}, {"estimator": "ols"}])
    assert [row["estimator"] for row in few["methods"]] == ["wls", "ols"]


def test_the_simulator_answers_like_the_robot(tried: Tried) -> None:
    found = tried.ends("simulation", longest=6.0)
    assert found["verdict"] == "pass"
    (one,) = found["simulations"]
    assert one["measurement_id"] == tried.held_out.id
    assert one["duration"] <= 6.0
    assert one["torque"]["relative_total"] < 0.15
    drift = one["drift"]
    assert drift["after"] == [0.1, 0.5, 2.0]
    assert drift["starts"] > 1
    assert max(drift["share"][0]) < 0.5
    alone = tried.ends("drift", horizons=[0.1])
    assert alone["verdict"] == "pass"
    assert alone["drift"]["after"] == [0.1]
    assert len(alone["drift"]["speed"][0]) == len(alone["drift"]["distance"][0])


def test_contact_detection_says_force_time_and_rate(tried: Tried) -> None:
    made = tried.client.validations.create(tried.model, "collision", false_alarms_per_hour=60.0).wait()
    found = made.result
    assert found["verdict"] in ("pass", "fail")
    contact = found["contact"]
    assert contact["false_alarms_an_hour"] >= 60.0
    assert contact["requested"] == 60.0
    assert len(contact["thresholds"]) == len(tried.model["result"]["joints"])
    assert f"in {1e3 * contact['within']:.0f} ms" in found["reason"]
    # A single recording leaves nothing to be left out.
    assert (found["alarms"], found["expected_alarms"]) == (0, 0.0)
    assert tried.refused("collision", measurements=[tried.training]) == (422, "/measurement_ids/0")
    assert tried.refused("drift", false_alarms_per_hour=2.0) == (422, "/false_alarms_per_hour")
    shown = tried.client.validations.get(made.id)
    assert "thresholds" in [table["name"] for table in shown["tables"]]


def test_filters_are_tried_in_simulation(tried: Tried) -> None:
    found = tried.ends("filters", cutoffs=[2.0, 10.0], longest=6.0)
    filters = found["filters"]
    assert found["verdict"] in ("pass", "fail")
    assert filters["used"] in filters["trials"]
    assert filters["chosen"]["error"] == min(trial["error"] for trial in filters["trials"] if trial["error"])
    assert len(filters["torque_noise"]) == len(tried.model["result"]["joints"])


def test_a_known_load_is_weighed(tried: Tried) -> None:
    client, robot = tried.client, tried.model["robot_id"]
    trajectory = {"duration": 12.0, "periods": 2, "sampling_rate": 200.0}
    carried = {"effect": "payload", "parameters": {"Mp": 2.0, "MZp": 0.1}}
    drive = [{"effect": name} for name in ("rotor_inertia", "coulomb", "viscous")]
    made = client.simulations.create(robot, trajectory=trajectory, effects=[*drive, carried], seed=3).wait()
    loaded = made.result["measurement_id"]
    assert tried.refused("payload", measurements=[loaded]) == (422, "/mass")
    assert tried.refused("payload", measurements=[tried.training], mass=2.0) == (422, "/measurement_ids/0")
    found = tried.ends("payload", measurements=[loaded], mass=2.0)
    (one,) = found["payloads"]
    assert (one["measurement_id"], one["stated_mass"]) == (loaded, 2.0)
    assert found["verdict"] == one["verdict"] == "pass", found["reason"]
    assert one["interval"][0] <= one["mass"] <= one["interval"][1]
    assert one["mass"] == pytest.approx(2.0, rel=0.1)
    assert tried.ends("payload", measurements=[loaded], mass=3.0)["verdict"] == "fail"


@pytest.mark.parametrize(
    ("kind", "more", "pointer"),
    [
        ("direct", {"cutoffs": [3.0]}, "/cutoffs"),
        ("direct", {"measurements": ["mea_x"]}, "/measurement_ids"),
        ("inertia_matrix", {"limit": 0.1}, "/limit"),
        ("cross", {"methods": [{}]}, "/methods"),
        ("cross", {"limit": 0.0}, "/limit"),
        ("cross", {"limit": "much"}, "/limit"),
        ("cross", {"measurements": ["mea_nothing"]}, "/measurement_ids/0"),
        ("methods", {"methods": [{"estimator": "magic"}]}, "/methods/0/estimator"),
        ("methods", {"methods": []}, "/methods"),
        ("filters", {"cutoffs": [-1.0]}, "/cutoffs/0"),
        ("filters", {"mass": 2.0}, "/mass"),
        ("payload", {"mass": 2.0}, "/measurement_ids"),
        ("payload", {"mass": -2.0}, "/mass"),
        ("simulation", {"longest": 1e6}, "/longest"),
        ("bootstrap", {"draws": 3}, "/draws"),
        ("bootstrap", {"measurements": ["mea_x"]}, "/measurement_ids"),
        ("direct", {"draws": 200}, "/draws"),
        ("sorcery", {}, "/kind"),
    ],
)
def test_what_a_kind_does_not_take_is_refused_with_its_field(
    tried: Tried, kind: str, more: dict[str, Any], pointer: str
) -> None:
    assert tried.refused(kind, **more) == (422, pointer)


def test_data_that_the_model_has_seen_does_not_count_as_unseen(tried: Tried) -> None:
    for kind in ("cross", "methods"):
        assert tried.refused(kind, measurements=[tried.training]) == (422, "/measurement_ids/0")
    assert tried.refused("filters", measurements=[tried.training, tried.held_out]) == (422, "/measurement_ids/1")


def test_a_report_holds_how_validations_ended(tried: Tried) -> None:
    client = tried.client
    cross = client.validations.create(tried.model, "cross").wait()
    page = client.reports.content(client.reports.create(tried.model, validations=[cross]).wait()).decode()
    assert "Cross validation" in page
    assert cross.result["reason"].replace("'", "&#39;") in page
    other = client.identifications.create(tried.model["robot_id"], [tried.training]).wait()
    for model, stranger, words in ((other, cross, "another model"), (tried.model, "val_nothing", "there is no")):
        with pytest.raises(ProblemError) as refused:
            client.reports.create(model, validations=[stranger])
        assert refused.value.errors[0]["pointer"] == "/validation_ids/0"
        assert words in refused.value.errors[0]["detail"]


def test_a_cutoff_beyond_nyquist_fails_in_words(tried: Tried) -> None:
    with pytest.raises(JobFailed) as failed:
        tried.ends("filters", cutoffs=[150.0], longest=3.0)
    assert failed.value.errors[0]["pointer"] == "/cutoffs/0"
