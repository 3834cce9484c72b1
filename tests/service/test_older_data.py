"""A data directory of an older version is brought up to date, and all that is in it is of use."""

from __future__ import annotations

import tarfile
from pathlib import Path
from typing import Any

import pytest
from fastapi.testclient import TestClient
from service_helpers import app_of, wait_for
from typer.testing import CliRunner

from dynident_cli.program_and_exit_codes import app
from dynident_service.settings import Settings

KEPT = Path(__file__).parent.parent / "older_versions" / "data_directory_of_format_1.tar.xz"
"""An arm of two joints, one simulated recording, a model of format 1, one with `offset` added, a diagnosis; written by
the last commit before format 2, whose database was at the first migration."""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    with tarfile.open(KEPT) as archive:
        archive.extractall(tmp_path, filter="data")
    return tmp_path


def test_a_data_directory_of_the_first_format_is_shown_and_gone_on_from(folder: Path) -> None:
    with TestClient(app_of(Settings(data_dir=folder, workers=1)), "http://127.0.0.1") as client:

        def compute(path: str, body: dict[str, Any]) -> dict[str, Any]:
            answer = client.post(path, json=body)
            assert answer.status_code == 202, answer.text
            where = answer.headers["location"]
            return dict(wait_for(lambda: _ended(client.get(where).json()), timeout=60))

        items = {}
        for kind in ("robots", "measurements", "identifications", "diagnoses"):
            items[kind] = client.get(f"/v1/{kind}").json()["items"]
            for item in items[kind]:
                assert client.get(f"/v1/{kind}/{item['id']}").status_code == 200
        assert [len(found) for found in items.values()] == [1, 1, 2, 1]
        model, recording = items["identifications"][0]["id"], items["measurements"][0]["id"]
        assert client.get(f"/v1/identifications/{model}/export?format=urdf").status_code == 200
        assert client.get(f"/v1/identifications/{model}/verdict").status_code == 200
        assert client.get(f"/v1/measurements/{recording}/raw?signals=tau1").status_code == 200
        added = {"effects": [{"effect": "stribeck", "joints": ["shoulder"], "shape_parameters": {"vs": 0.05}}]}
        for path, body in (
            (f"/v1/identifications/{model}/extend", added),
            ("/v1/reports", {"identification_id": model}),
        ):
            view = compute(path, body)
            assert view["status"] == "succeeded", view["error"]


def _ended(view: dict[str, Any]) -> dict[str, Any] | None:
    return view if view["status"] in ("succeeded", "failed") else None


def test_a_data_directory_of_the_first_format_is_well(folder: Path) -> None:
    run = CliRunner().invoke(app, ["doctor", "--data-dir", str(folder)])
    assert (run.exit_code, run.output) == (0, "no faults found\n")
