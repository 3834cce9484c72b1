"""Campaigns over HTTP: ask, move a virtual robot, tell, to the goal; refusals; a service that is started again."""

from __future__ import annotations

from typing import Any

import pytest

from dynident.robot import library_table
from dynident_client import Client, ProblemError

pytestmark = pytest.mark.slow

DRIVES = [{"effect": "rotor_inertia"}, {"effect": "coulomb"}, {"effect": "viscous"}]
MOTION = {"trajectory": {"duration": 6.0, "harmonics": 3, "sampling_rate": 100.0}, "starts": 1}


def begin(live: Client, **more: Any) -> Any:
    robot = live.robots.create("scara", modified_dh=library_table("scara"))
    return live.campaigns.create(robot, goal={"error": 0.05}, budget={"robot_time": 120.0}, **MOTION, **more)


def run(live: Client, campaign: Any, seed: int) -> Any:
    """Make the motion that a campaign asks for, with a virtual robot."""
    design = live.campaigns.ask(campaign).wait()
    simulation = live.simulations.create(
        campaign["request"]["robot_id"], effects=DRIVES, design=design, seed=seed, name=f"run{seed}"
    ).wait()
    return live.measurements.get(simulation.result["measurement_id"])


def test_a_campaign_is_asked_and_told_until_its_goal_is_reached(live: Client) -> None:
    campaign = begin(live, name="cell 4")
    assert (campaign.state, campaign.steps) == ("asking", [])
    told = []
    for number in range(1, 6):
        recording = run(live, campaign, number)
        assert live.campaigns.get(campaign).state == "waiting"
        model = live.campaigns.tell(campaign, recording).wait()
        told.append(recording.id)
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
    assert campaign.robot_time == pytest.approx(sum(run["seconds"] for run in runs))
    # The model is one like any other.
    assert live.identifications.get(campaign.identification_id)["request"]["measurement_ids"] == told
    assert live.identifications.verdict(campaign.identification_id)["uses"]
    with pytest.raises(ProblemError, match="The campaign is over: The goal of"):
        live.campaigns.ask(campaign)
    with pytest.raises(ProblemError, match="need"):
        live.campaigns.delete(campaign)


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
    with pytest.raises(ProblemError, match="one run takes 6 s, and all together may take 3 s"):
        live.campaigns.create(robot, budget={"robot_time": 3.0}, **MOTION)
    with pytest.raises(ProblemError, match="/goal/kind"):
        live.campaigns.create(robot, goal={"kind": "payload"})
    again = live.campaigns.create(robot, measurements=[recording], **MOTION)
    assert again.state == "estimating"
    with pytest.raises(ProblemError, match="takes in a recording"):
        live.campaigns.ask(again)
