"""A robot over many days, through the contract."""

from __future__ import annotations

import pytest

from dynident.robot import library_table
from dynident_client import Client, ProblemError, Record

pytestmark = pytest.mark.slow

DRIVE = [{"effect": "rotor_inertia"}, {"effect": "coulomb"}, {"effect": "viscous"}]


def day(live: Client, robot: Record, seed: int, effects: list[dict[str, object]]) -> Record:
    trajectory = {"duration": 10.0, "periods": 2, "sampling_rate": 200.0}
    made = live.simulations.create(robot, effects=effects, seed=seed, trajectory=trajectory).wait()
    return live.measurements.get(made.result["measurement_id"])


def test_a_mass_is_told_with_the_day_from_which_it_is_there_and_a_later_day_joins_the_kept_ones(live: Client) -> None:
    robot = live.robots.create("scara", modified_dh=library_table("scara"))
    link = robot.joints[1]["name"]
    mass = {"effect": "payload", "joints": [link], "parameters": {"Mp": 2.0, "MXp": 0.4, "ZZp": 0.09}}
    runs = [day(live, robot, seed, DRIVE if seed < 3 else [*DRIVE, mass]) for seed in (1, 2, 3, 4)]
    model = live.identifications.create(robot, runs[:1]).wait()
    first = live.series.create(model, [[run] for run in runs[:3]], names=["mon", "tue", "wed"]).wait()
    (change,) = first.result["changes"]
    assert (change["effect"], change["joints"], change["since"]) == ("payload", [link], "wed")
    assert first.result["days"] == ["mon", "tue", "wed"]
    assert live.series.figure(first).startswith(b"<svg")

    longer = live.series.create(model, [[runs[3]]], names=["thu"], continues=first).wait()
    assert longer.result["days"] == ["mon", "tue", "wed", "thu"]
    assert [one["since"] for one in longer.result["changes"]] == ["wed"]
    assert all(len(course["values"]) == 4 for course in longer.result["courses"])
    changes, tracks = live.series.get(longer.id)["tables"]
    assert changes["rows"][0][0]["text"] == "wed"
    assert [row[0]["text"] for row in tracks["rows"]] == ["mon", "tue", "wed", "thu"]
    assert [one.id for one in live.series.page().items] == [longer.id, first.id]
    with pytest.raises(ProblemError) as refused:
        live.series.delete(first)
    assert refused.value.status == 409


def test_days_that_cannot_be_a_series_are_refused_with_their_place(live: Client) -> None:
    robot = live.robots.create("scara", modified_dh=library_table("scara"))
    run = day(live, robot, 1, DRIVE)
    model = live.identifications.create(robot, [run]).wait()
    for days, pointer in (([[run]], "/days"), ([[run], [run]], "/days/1/measurement_ids/0")):
        with pytest.raises(ProblemError) as refused:
            live.series.create(model, days)
        assert refused.value.errors[0]["pointer"] == pointer
