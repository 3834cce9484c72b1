"""A new effect is one file, beside ours or installed: everything else follows."""

from __future__ import annotations

import json
from pathlib import Path

from support.own_effects_page import ROOT, block, run

SHOWN = """
import contextlib, io, json, runpy, sys, tempfile
from pathlib import Path
import dynident.effects as room
room.__path__.append({folder!r})
from fastapi.testclient import TestClient
from dynident.advice.discriminating_experiments import EXPERIMENTS
from dynident.advice.discriminating_experiments import choose_experiment
from dynident.effects import CATALOGUE, EffectChoice
from dynident.regressors.model_structure import build_model
from dynident.robot import robot_from_library
from dynident.simulation import VirtualRobot, build_typical_effect
from dynident.testing import check_effect
from dynident_service.app import create_app
from dynident_cli.__main__ import main
from dynident_service.settings import Settings

robot = robot_from_library("ur10")
sized = build_typical_effect(robot, "hose_friction", robot.joint_names[2])
VirtualRobot(robot, (sized,))
with tempfile.TemporaryDirectory() as folder:
    client = TestClient(create_app(Settings(data_dir=Path(folder))), "http://127.0.0.1")
    listed = [item["id"] for item in client.get("/v1/effects").json()["items"]]
page = runpy.run_path({page!r})["page"]()
told = io.StringIO()
sys.argv = ["dynident", "effects"]
with contextlib.redirect_stdout(told):
    try:
        main()
    except SystemExit:
        pass
print(json.dumps({{
    "http": "hose_friction" in listed,
    "page": "## Friction of a wound hose: `hose_friction`" in page,
    "command": "hose_friction" in told.getvalue(),
    "experiment": choose_experiment("hose_friction", "position_dependent_friction") is EXPERIMENTS["slow_sweep"],
    "columns": len(build_model(robot, [EffectChoice("hose_friction", (), (("q0", 0.2),))]).kept),
    "conforms": check_effect(CATALOGUE["hose_friction"])[-1],
}}))
"""


def test_a_file_beside_ours_is_all_that_an_effect_needs(tmp_path: Path) -> None:
    code = block("python").replace(
        "    is_friction = True\n",
        '    is_friction = True\n    told_from = {"slow_sweep": ("position_dependent_friction",)}\n',
    )
    (tmp_path / "hose_friction.py").write_text(code, encoding="utf-8")
    page = ROOT / "docs" / "effects_table.py"
    answer = run(tmp_path / "elsewhere", SHOWN.format(folder=str(tmp_path), page=str(page)))
    assert answer.returncode == 0, answer.stderr
    found = json.loads(answer.stdout.splitlines()[-1])
    assert found.pop("conforms").startswith("found again"), found
    assert found == {"http": True, "page": True, "command": True, "experiment": True, "columns": 6}
