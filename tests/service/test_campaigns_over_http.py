"""Campaigns over HTTP: ask, move a virtual robot, tell, to the goal; refusals; a service that is started again."""

from __future__ import annotations

import re
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import httpx2
import pytest

from dynident.robot import library_table
from dynident_client import Client, ProblemError

pytestmark = pytest.mark.slow

DRIVES = [{"effect": "rotor_inertia"}, {"effect": "coulomb"}, {"effect": "viscous"}]
MOTION = {"trajectory": {"duration": 6.0, "harmonics": 3, "sampling_rate": 100.0}, "starts": 1}


def begin(live: Client, **more: Any) -> Any:
    robot = live.robots.create("scara", modified_dh=library_table("scara"))
    return live.campaigns.create(robot, **{"goal": {"error": 0.05}, "budget": {"robot_time": 120.0}, **MOTION, **more})


def run(live: Client, campaign: Any, seed: int, *more: dict[str, str]) -> Any:
    """Make the motion that a campaign asks for, with a virtual robot; `more` acts besides its friction."""
    design = live.campaigns.ask(campaign).wait()
    simulation = live.simulations.create(
        campaign["request"]["robot_id"], effects=[*DRIVES, *more], design=design, seed=seed, name=f"run{seed}"
    ).wait()
    return live.measurements.get(simulation.result["measurement_id"])


def test_a_campaign_is_asked_and_told_until_its_goal_is_reached(live: Client) -> None:
    campaign = begin(live, name="cell 4")
    assert (campaign.state, campaign.steps) == ("asking", [])
    told, models = [], []
    for number in range(1, 6):
        recording = run(live, campaign, number)
        assert live.campaigns.get(campaign).state == "waiting"
        model = live.campaigns.tell(campaign, recording).wait()
        told.append(recording.id)
        models.append(model)
        campaign = live.campaigns.get(campaign)
        assert campaign.identification_id == model.id
        if campaign.state != "asking":
            break
    assert campaign.state == "reached"
    assert campaign.achieved_error is not None
    assert campaign.achieved_error <= 0.05
    runs = [run for step in campaign.steps for run in step["runs"]]
    assert [run["measurement_id"] for run in runs] == told
    assert runs[0]["promised"] is None
    assert runs[-1]["promised"] is not None
    (table,) = campaign["tables"]
    assert [row[0]["text"] for row in table["rows"]] == [run["name"] for run in runs]
    assert campaign.robot_time == pytest.approx(sum(run["seconds"] for run in runs))
    # The model is one like any other.
    assert live.identifications.get(campaign.identification_id)["request"]["measurement_ids"] == told
    assert live.identifications.verdict(campaign.identification_id)["uses"]
    with pytest.raises(ProblemError, match="The campaign is over: The goal of"):
        live.campaigns.ask(campaign)
    with pytest.raises(ProblemError, match="need"):
        live.campaigns.delete(campaign)
    # Without one in between, the runs that are listed would not be those of the last model.
    with pytest.raises(ProblemError, match="need"):
        live.identifications.delete(models[0])


def test_what_does_not_fit_is_refused_with_its_place(live: Client) -> None:
    campaign = begin(live)
    recording = run(live, campaign, 1)
    # Asked twice, the same motion.
    assert live.campaigns.ask(campaign).id == live.campaigns.get(campaign).design_id
    live.campaigns.tell(campaign, recording).wait()
    with pytest.raises(ProblemError, match="is a run of this campaign already"):
        live.campaigns.tell(campaign, recording)
    with pytest.raises(ProblemError, match="there is no measurement"):
        live.campaigns.tell(campaign, "mea_none")
    robot = live.robots.get(campaign["request"]["robot_id"])
    with pytest.raises(ProblemError, match="one run takes 3 s, and all together may take 2 s"):
        live.campaigns.create(robot, budget={"robot_time": 2.0}, **MOTION)
    for goal, place in (
        ({"kind": "gains"}, "/goal"),
        ({"kind": "payload", "quantities": ["weight"]}, "/goal/quantities/0"),
        # No motion of a SCARA shows how high a load is.
        ({"kind": "payload", "quantities": ["mass", "centre_z"]}, "/goal/quantities"),
        ({"error": 11.0}, "/goal/error"),
        ({"kind": "parameters", "parameters": []}, "/goal/parameters"),
        ({"kind": "parameters", "parameters": ["m1"]}, "/goal/parameters"),
        ({"kind": "effects", "effects": ["magic"]}, "/goal/effects"),
        ({"kind": "effects", "effects": ["payload"]}, "/goal/effects"),
    ):
        with pytest.raises(ProblemError) as refused:
            live.campaigns.create(robot, goal=goal)
        assert [error["pointer"] for error in refused.value.errors] == [place], goal
    again = live.campaigns.create(robot, measurements=[recording], **MOTION)
    assert again.state == "estimating"
    with pytest.raises(ProblemError, match="takes in a recording"):
        live.campaigns.ask(again)


def test_a_request_that_is_sent_twice_counts_once(live: Client) -> None:
    campaign = begin(live)
    recording = run(live, campaign, 1)
    with ThreadPoolExecutor(4) as threads, httpx2.Client(base_url=live._transport._http.base_url) as http:

        def send(path: str, body: dict[str, Any], **headers: str) -> list[httpx2.Response]:
            return list(threads.map(lambda _: http.post(path, json=body, headers=headers), range(4)))

        address = f"/v1/campaigns/{campaign.id}"
        # Without a key all but one are refused; while one motion waits, it is the answer to each.
        assert {answer.headers["location"] for answer in send(f"{address}/ask", {})} == {
            f"/v1/designs/{live.campaigns.get(campaign).design_id}"
        }
        told = send(f"{address}/tell", {"measurement_id": recording.id})
        assert sorted(answer.status_code for answer in told) == [202, 409, 409, 409]
        body = {"robot_id": campaign["request"]["robot_id"], "measurement_ids": [recording.id], **MOTION}
        begun = send("/v1/campaigns", body, **{"Idempotency-Key": "begin"})
        (begun_id,) = {answer.json()["id"] for answer in begun}
        (step,) = live.campaigns.get(begun_id).steps
        live.identifications.get(step["identification_id"]).wait()
        asked = send(f"/v1/campaigns/{begun_id}/ask", {})
        assert len({answer.json()["id"] for answer in asked}) == 1


def test_a_campaign_may_have_the_longest_name(live: Client) -> None:
    design = live.campaigns.ask(begin(live, name="n" * 200))
    assert len(design["name"]) == 200
    assert design["name"].endswith("n: run 1")


def test_what_no_motion_can_be_designed_for_is_refused_at_once(live: Client) -> None:
    for more, place in (
        ({"effects": [{"effect": "coulomb", "joints": ["none"]}]}, "/effects/0"),
        ({"effects": [{"effect": "temperature_friction"}]}, "/effects"),
        ({"trajectory": {"joints": ["elbow"]}}, "/trajectory/joints"),
        ({"trajectory": {"duration": 600.0}}, "/budget/robot_time"),
    ):
        with pytest.raises(ProblemError) as caught:
            begin(live, **more)
        assert caught.value.errors[0]["pointer"] == place


def test_a_time_that_is_too_short_with_the_moves_is_pointed_out_in_the_body(live: Client) -> None:
    with pytest.raises(ProblemError, match="with its moves from and to home") as caught:
        live.campaigns.ask(begin(live, budget={"robot_time": 3.01})).wait()
    assert caught.value.errors[0]["pointer"] == "/budget/robot_time"


def test_parameters_and_effects_are_goals_as_well(live: Client) -> None:
    known = begin(live, goal={"kind": "parameters", "parameters": ["Fc1", "Fv1"], "error": 0.5})
    sought = begin(live, goal={"kind": "effects", "effects": ["stribeck"]})
    assert (known["targets"], sought["targets"]) == (["Fc1", "Fv1"], ["stribeck"])
    for campaign in (known, sought):
        for number in (1, 2):
            live.campaigns.tell(campaign, run(live, campaign, number)).wait()
            shown = live.campaigns.get(campaign)
            if shown.state != "asking":
                break
        runs = [made for step in shown.steps for made in step["runs"]]
        assert all(len(made["achieved"]) == len(campaign["targets"]) for made in runs)
        assert shown["tables"]
    assert live.campaigns.get(known).state == "reached"


def test_a_load_is_weighed_after_it_was_mounted(live: Client) -> None:
    goal = {"kind": "payload", "quantities": ["mass", "centre_x"], "mass_error": 0.05, "unloaded_runs": 1}
    campaign = begin(live, goal=goal)
    assert campaign["targets"] == ["mass", "centre_x"]
    assert campaign["decision"]["sentence"].endswith("Leave the load off.")
    live.campaigns.tell(campaign, run(live, campaign, 1)).wait()
    campaign = live.campaigns.get(campaign)
    assert campaign["decision"]["sentence"].startswith("Mount the load now")
    assert campaign["achieved"] is None
    for number in range(2, 6):
        model = live.campaigns.tell(campaign, run(live, campaign, number, {"effect": "payload"})).wait()
        campaign = live.campaigns.get(campaign)
        if campaign.state != "asking":
            break
    assert campaign.state == "reached", campaign["decision"]
    assert re.search(r"mass 2\.\d+ ± 0\.0\d+ kg, centre x", campaign["decision"]["sentence"])
    (mass,) = (parameter for parameter in model.result["parameters"] if parameter["name"].startswith("Mp"))
    # The usual load of this arm: a tenth of its vertical force, as the virtual robot has it.
    assert mass["interval"][0] < 2.1237 < mass["interval"][1]


def test_a_load_that_does_not_show_yet_has_a_centre_without_a_bound(live: Client) -> None:
    goal = {"kind": "payload", "quantities": ["mass", "centre_x"], "mass_error": 0.01, "unloaded_runs": 1}
    campaign = begin(live, goal=goal)
    # The load was not mounted for the second run.
    for number in (1, 2):
        live.campaigns.tell(campaign, run(live, campaign, number)).wait()
    recording = run(live, campaign, 3, {"effect": "payload"})
    campaign = live.campaigns.get(campaign)
    mass, centre = campaign.steps[-1]["promised"]
    assert mass > 0
    assert (centre, campaign["promised"]) == (None, None)
    live.campaigns.tell(campaign, recording).wait()
    campaign = live.campaigns.get(campaign)
    assert campaign.steps[-1]["runs"][0]["promised"] == [mass, None]
    assert campaign["tables"]
