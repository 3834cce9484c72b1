"""The choices of an identification over HTTP: each that is available works, each that does not fit is refused."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import pytest

from dynident.identification.methods.base_classes import ESTIMATORS, MODELS
from dynident.robot import library_table
from dynident_client import Client, JobFailed, ProblemError

pytestmark = pytest.mark.slow


@dataclass
class Bench:
    client: Client
    robot: Any
    training: Any
    held_out: Any

    def identified(self, **choices: Any) -> Any:
        made = self.client.identifications.create(self.robot, [self.training], validation=[self.held_out], **choices)
        return made.wait()


@pytest.fixture(scope="module")
def bench(live: Client) -> Bench:
    robot = live.robots.create("scara", modified_dh=library_table("scara"))
    runs = []
    for seed in (1, 2):
        trajectory = {"duration": 10.0, "periods": 2, "sampling_rate": 200.0}
        made = live.simulations.create(robot, trajectory=trajectory, seed=seed).wait()
        runs.append(live.measurements.get(made.result["measurement_id"]))
    return Bench(live, robot, *runs)


def test_a_virtual_robot_goes_from_point_to_point_and_dwells(bench: Bench) -> None:
    points = {"family": "point_to_point", "points": 3, "sampling_rate": 200.0}
    lasts = []
    for dwell in ([0.0, 0.0], [0.5, 0.5]):
        made = bench.client.simulations.create(bench.robot, trajectory={**points, "dwell": dwell}).wait()
        lasts.append(made.result["n_samples"] / 200.0)
    assert lasts[1] - lasts[0] == pytest.approx(3 * 0.5, abs=0.02)


@pytest.mark.sweep
@pytest.mark.parametrize("model", [name for name in MODELS.names if name != "base_wrench"])
def test_every_model_predicts_what_no_parameter_saw(bench: Bench, model: str) -> None:
    assert bench.identified(model=model).result["validation"]["relative_total"] < 0.3


@pytest.mark.sweep
@pytest.mark.parametrize("estimator", ESTIMATORS.names)
def test_every_estimator_predicts_what_no_parameter_saw(bench: Bench, estimator: str) -> None:
    assert bench.identified(estimator=estimator).result["validation"]["relative_total"] < 0.3


@pytest.mark.parametrize("steps", ["link_by_link", "wrist_then_shoulder"])
def test_both_ways_of_steps_predict_what_no_parameter_saw(bench: Bench, steps: str) -> None:
    found = bench.identified(strategy="sequential", steps=steps)
    assert found.result["validation"]["relative_total"] < 0.3


def test_parameters_come_with_intervals_and_the_prior_with_narrower_ones(bench: Bench) -> None:
    plain, believed = bench.identified(), bench.identified(prior="description")
    for one in plain.result["parameters"]:
        low, high = one["interval"]
        assert low < one["value"] < high
    for one, other in zip(plain.result["parameters"], believed.result["parameters"], strict=True):
        assert other["standard_deviation"] <= 1.5 * one["standard_deviation"] + 1e-9


def test_a_known_parameter_is_held_as_the_table_lists_it(bench: Bench) -> None:
    known = {"ZZ1": 1.25, "Fv1": 0.0}
    found = {one["name"]: one for one in bench.identified(known=known).result["parameters"]}
    for name, value in known.items():
        assert (found[name]["value"], found[name]["standard_deviation"], found[name]["judgement"]) == (value, 0, "held")
    assert {one["judgement"] for name, one in found.items() if name not in known} <= {
        "determined",
        "uncertain",
        "zero_in_interval",
    }
    with pytest.raises((ProblemError, JobFailed)) as failed:
        bench.identified(known={"Ia1": 0.1})
    assert "Ia1 is not a parameter by itself: the motion shows it only in ZZ1" in str(failed.value)


def test_bodies_of_the_description_can_be_believed_the_same_in_every_frame(bench: Bench) -> None:
    found = bench.identified(estimator="feasible", prior="description_entropic")
    assert found.result["validation"]["relative_total"] < 0.3


def test_essential_parameters_and_correlations_are_there_without_the_data(bench: Bench) -> None:
    model = bench.identified()
    essential = bench.client.identifications.essential(model)
    names = [one["name"] for one in model.result["parameters"]]
    taken_out = [step["name"] for step in essential["steps"]]
    assert sorted(essential["essential"] + taken_out) == sorted(names)
    assert [one["name"] for one in essential["parameters"]] == essential["essential"]
    assert essential["validation"]["relative_total"] < 1.3 * model.result["validation"]["relative_total"]
    correlation = bench.client.identifications.correlation(model)
    assert correlation["parameters"] == names
    assert all(row[k] == pytest.approx(1.0) for k, row in enumerate(correlation["correlation"]))
    assert correlation["sentences"] == model.result["dependence"]
    with pytest.raises(ProblemError) as refused:
        bench.client.identifications.essential(model, ratio=0.5)
    assert (refused.value.status, refused.value.errors[0]["pointer"]) == (422, "ratio")


@pytest.mark.parametrize(
    ("choices", "pointer"),
    [
        ({"model": "static"}, "/model"),
        ({"strategy": "random"}, "/strategy"),
        ({"estimator": "best"}, "/estimator"),
        ({"steps": "backwards"}, "/steps"),
        ({"prior": "hope"}, "/prior"),
        ({"pole": -1.0}, "/pole"),
        ({"pole": "fast"}, "/pole"),
        ({"interval": 0.0}, "/interval"),
        ({"free_links": ["elbow"]}, "/free_links"),
        ({"known": {"Ia2": "small"}}, "/known/Ia2"),
        ({"known_errors": {"Ia2": 0.1}}, "/known_errors"),
    ],
)
def test_a_choice_that_there_is_not_is_refused_with_its_field(
    bench: Bench, choices: dict[str, Any], pointer: str
) -> None:
    with pytest.raises(ProblemError) as refused:
        bench.client.identifications.create(bench.robot, [bench.training], **choices)
    assert (refused.value.status, refused.value.errors[0]["pointer"]) == (422, pointer)


@pytest.mark.parametrize(
    ("choices", "words"),
    [
        ({"model": "base_wrench"}, "wrench"),
        ({"model": "energy", "strategy": "sequential"}, "energy"),
        ({"prior": "description", "free_links": ["nose"]}, "nose"),
        ({"known": {"Ia9": 0.1}}, "no parameter 'Ia9'"),
        ({"prior": "description_entropic", "estimator": "wls"}, "feasible"),
    ],
)
def test_choices_that_do_not_fit_one_another_or_the_data_fail_in_words(
    bench: Bench, choices: dict[str, Any], words: str
) -> None:
    with pytest.raises((ProblemError, JobFailed)) as failed:
        bench.identified(**choices)
    assert words in str(failed.value)
    assert failed.value.problem["status"] == 422
    assert failed.value.errors[0]["pointer"].startswith("/")
