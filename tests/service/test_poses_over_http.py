"""Poses at which a robot stands, over HTTP: uploaded, identified, reported."""

from __future__ import annotations

import pytest
from support.oracles import arm
from support.poses_at_rest import poses, write_poses

from dynident.robot import library_table
from dynident_client import Client

pytestmark = pytest.mark.slow


def test_gravity_is_identified_from_poses_and_reported(live: Client, tmp_path) -> None:
    robot = live.robots.create("scara", modified_dh=library_table("scara"))
    scara = arm("scara")
    runs = [
        live.measurements.upload(robot, write_poses(tmp_path / f"p{k}.csv", *poses(scara, 40, k)), name=f"p{k}")
        for k in (1, 2)
    ]
    assert any(check["name"] == "poses" for check in runs[0].checks)
    model = live.identifications.create(robot, runs[:1], validation=runs[1:]).wait()
    assert model.result["validation"]["relative_total"] < 0.01
    assert "poses at rest" in model.result["warnings"][0]
