"""Signals come as they were recorded: whole, or thinned with every extreme in them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from fastapi.testclient import TestClient
from support.measurement_uploads import as_csv, sound, upload

from dynident_service.measurements import routes as measurements
from dynident_service.storage_and_engine import Services


@pytest.fixture(scope="module")
def columns() -> dict[str, np.ndarray]:
    made = sound(40_000, 1000.0)
    made["tau2"][30_123] = 300.0
    made["lamp"] = np.arange(40_000.0)
    made["q1"] = np.degrees(made["q1"])
    return made


@pytest.fixture
def measurement(client: TestClient, robot: dict[str, Any], columns: dict[str, np.ndarray]) -> str:
    answer = upload(client, robot, as_parquet(columns), units={"q1": "deg"}, signs={"tau1": -1}, accept=ACCEPTED)
    assert answer.status_code == 201, answer.text
    return str(answer.json()["id"])


ACCEPTED = ["torque_sign", "joint_sign"]


def as_parquet(columns: dict[str, np.ndarray]) -> bytes:
    import pyarrow as pa
    import pyarrow.parquet as pq

    sink = pa.BufferOutputStream()
    pq.write_table(pa.table(columns), sink)
    return sink.getvalue().to_pybytes()


def raw(client: TestClient, identifier: str, **query: Any) -> dict[str, Any]:
    answer = client.get(f"/v1/measurements/{identifier}/raw", params=query)
    assert answer.status_code == 200, answer.text
    return dict(answer.json())


def test_without_points_there_is_every_row(client: TestClient, measurement: str, columns: Any) -> None:
    found = raw(client, measurement, signals="q1,tau_shoulder,lamp")
    assert found["units"] == {"q1": "rad", "tau_shoulder": "N m", "lamp": ""}
    assert found["n_samples"] == len(found["t"]) == 40_000
    assert np.allclose(found["signals"]["q1"], np.radians(columns["q1"]), rtol=1e-12)
    assert np.array_equal(found["signals"]["tau_shoulder"], -columns["tau1"])
    assert np.array_equal(found["signals"]["lamp"], columns["lamp"])
    assert found["available"] == ["q_shoulder", "q_elbow", "tau_shoulder", "tau_elbow"]


def test_thinned_signals_keep_their_extremes(client: TestClient, measurement: str, columns: Any) -> None:
    found = raw(client, measurement, points=1000)
    assert list(found["signals"]) == ["q1", "q2", "tau1", "tau2"]
    assert 300 < len(found["t"]) <= 1100
    assert found["n_samples"] == 40_000
    assert found["available"] == ["q_shoulder", "q_elbow", "tau_shoulder", "tau_elbow"]
    assert max(found["signals"]["tau2"]) == 300.0
    assert min(found["signals"]["q2"]) == columns["q2"].min()
    assert found["t"] == sorted(found["t"])


def test_a_stretch_of_time_is_given_alone(client: TestClient, measurement: str) -> None:
    query = {"from": 2.0, "to": 2.1}
    whole, thin = raw(client, measurement, **query), raw(client, measurement, **query, points=5000)
    assert whole == thin
    assert (whole["t"][0], whole["t"][-1], whole["n_samples"]) == (2.0, 2.1, 101)
    empty = raw(client, measurement, **{"from": 900.0})
    assert (empty["t"], empty["n_samples"]) == ([], 0)


def test_what_is_no_number_is_null(client: TestClient, robot: dict[str, Any]) -> None:
    columns = sound()
    columns["light"] = np.where(np.arange(2000) == 3, np.nan, 1.0)
    made = upload(client, robot, as_csv(columns)).json()["id"]
    assert raw(client, made, signals="light", to=0.02)["signals"]["light"] == [1.0, 1.0, 1.0, None, 1.0]


def test_a_signal_that_is_not_there_is_named(client: TestClient, measurement: str) -> None:
    answer = client.get(f"/v1/measurements/{measurement}/raw", params={"signals": "q7"})
    assert answer.status_code == 422
    assert "q7" in answer.json()["detail"]
    assert "lamp" in answer.json()["detail"]
    assert client.get("/v1/measurements/m_nothing/raw").status_code == 404


def test_when_each_joint_stands_is_told_in_seconds_of_the_file(client: TestClient, robot: dict[str, Any]) -> None:
    made = sound(4000)
    rest = slice(1000, 1400)
    made["q2"][rest] = made["q2"][rest.start]
    stored = upload(client, robot, as_csv(made), accept=[*ACCEPTED, "position_jumps"], skip=["frozen_signals"])
    assert stored.status_code == 201, stored.text
    found = client.get(f"/v1/measurements/{stored.json()['id']}/standstills").json()
    assert [one["joint"] for one in found["joints"]] == ["shoulder", "elbow"]
    stands = [ends for ends in found["joints"][1]["standing"] if ends[1] - ends[0] > 1.0]
    assert len(stands) == 1
    assert stands[0] == pytest.approx([5.0, 7.0], abs=0.1)
    assert all(end - start < 1.0 for start, end in found["joints"][0]["standing"])
    share = sum(end - start for start, end in found["joints"][1]["standing"]) / 20.0
    assert share == pytest.approx(stored.json()["phases"]["standing"][1], abs=0.01)
    assert client.get("/v1/measurements/m_nothing/standstills").status_code == 404


def test_nothing_of_an_answer_stays_on_the_disk(client: TestClient, services: Services, measurement: str) -> None:
    raw(client, measurement)
    assert client.get(f"/v1/measurements/{measurement}/raw", params={"signals": "no"}).status_code == 422
    assert list(services.settings.uploads_dir.iterdir()) == []


def test_an_answer_is_never_larger_than_the_disk_can_take(
    client: TestClient, measurement: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(measurements, "SMALLEST_ANSWER", 100_000)
    monkeypatch.setattr(measurements, "DIGITS", 0)
    answer = client.get(f"/v1/measurements/{measurement}/raw")
    assert answer.status_code == 413
    assert "ask for less at a time" in answer.json()["detail"]
