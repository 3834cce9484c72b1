"""Every kind and family of trajectory over HTTP: what comes back, and what is refused."""

from __future__ import annotations

from typing import Any

import pytest

from dynident.robot import library_table
from dynident_client import Client, ProblemError

QUICK = {"duration": 3.0, "harmonics": 3, "intervals": 5, "points": 5, "sampling_rate": 50.0}


def designed(live: Client, **asked: Any) -> tuple[dict[str, Any], dict[str, Any]]:
    robot = live.robots.create("scara", modified_dh=library_table("scara"))
    trajectory = {**QUICK, **asked.pop("trajectory")}
    design = live.designs.create(robot, trajectory=trajectory, starts=1, random_trajectories=5, **asked).wait()
    assert design.result is not None
    rows = live.designs.trajectory(design, "csv").decode().splitlines()
    assert len(rows) == design.result["n_samples"] + 1
    return design.result, {"header": rows[0].split(","), "rows": [row.split(",") for row in rows[1:]]}


@pytest.mark.slow
@pytest.mark.parametrize("family", ["b_spline", "point_to_point"])
def test_a_design_of_every_family_is_better_than_random_ones(live: Client, family: str) -> None:
    result, _ = designed(live, trajectory={"family": family})
    assert result["criterion_values"]["criterion"] < result["baseline_values"]["criterion"]
    assert all(margin["share"] <= 1 for margin in result["margins"])
    assert result["runs"] == []


@pytest.mark.slow
def test_a_set_of_test_motions_names_its_runs_and_numbers_them_in_the_trajectory(live: Client) -> None:
    result, table = designed(live, kind="sequential", trajectory={"sets": "link_by_link"})
    assert [run["joints"][-1] for run in result["runs"]] == result["joints"][::-1]
    assert table["header"][:2] == ["t", "segment"]
    times = {run["label"]: (run["start"], run["end"]) for run in result["runs"]}
    for row in table["rows"]:
        inside = [k + 1 for k, (start, end) in enumerate(times.values()) if start - 1e-9 <= float(row[0]) <= end + 1e-9]
        assert int(row[1]) == (inside[0] if inside else 0)


@pytest.mark.slow
def test_joints_that_are_not_named_stay_where_they_are(live: Client) -> None:
    result, table = designed(live, trajectory={"joints": ["elbow", "tool_roll"]})
    at = table["header"].index("q_shoulder")
    assert len({row[at] for row in table["rows"]}) == 1
    assert {one["link"] for one in result["expected_parameters"]} <= {"elbow", "quill", "tool_roll"}


def test_what_cannot_be_moved_like_that_is_refused_with_the_field(live: Client) -> None:
    robot = live.robots.create("scara", modified_dh=library_table("scara"))
    for wrong, pointer in (
        ({"family": "b_spline", "intervals": 1}, "/trajectory/intervals"),
        ({"family": "point_to_point", "points": 1}, "/trajectory/points"),
        ({"family": "point_to_point", "paces": [1.0, 0.5]}, "/trajectory/paces"),
        ({"family": "point_to_point", "dwell": [0.6, 0.1]}, "/trajectory/dwell"),
        ({"sets": "ballet"}, "/trajectory/sets"),
    ):
        with pytest.raises(ProblemError) as refused:
            live.designs.create(robot, trajectory=wrong)
        assert refused.value.status == 422
        assert refused.value.errors[0]["pointer"] == pointer
