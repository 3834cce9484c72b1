"""Rows of a recording that come while the robot moves: append, retry, follow, finish; bad bodies; another service."""

from __future__ import annotations

import io
import json
import re
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import httpx2
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from fastapi.testclient import TestClient
from service_helpers import app_of, serving
from support.measurement_uploads import move_two_joints

from dynident_client import Client, ProblemError
from dynident_service.measurements import rows_routes
from dynident_service.problems import ProblemError as ProblemOfService
from dynident_service.settings import Settings
from dynident_service.storage.object_store import ObjectStore
from dynident_service.storage.repository_values import CHANGED

PIECE = 300
JSON = {"content-type": "application/json"}


RUN = move_two_joints()
LENGTH = len(RUN["t"])


def part(first: int, last: int) -> dict[str, list[float]]:
    return {name: values[first:last].tolist() for name, values in RUN.items()}


def as_csv(first: int, last: int) -> bytes:
    rows = zip(*part(first, last).values(), strict=True)
    return "\n".join([",".join(RUN), *(",".join(map(repr, row)) for row in rows)]).encode()


def as_parquet(first: int, last: int) -> bytes:
    buffer = io.BytesIO()
    pq.write_table(pa.table(part(first, last)), buffer)
    return buffer.getvalue()


TABLE = {
    "joints": [
        {"name": "shoulder", "alpha": 0, "d": 0, "r": 0},
        {"name": "elbow", "alpha": 0, "d": 0.5, "r": 0},
    ]
}
ROBOT = {"name": "scara", "description": {"format": "modified_dh", "content": TABLE}}


def begin(client: TestClient) -> str:
    robot = client.post("/v1/robots", json=ROBOT)
    assert robot.status_code == 201, robot.text
    body = {"under_way": True, "metadata": {"robot_id": robot.json()["id"], "name": "live"}}
    made = client.post("/v1/measurements", json=body)
    assert made.status_code == 201, made.text
    assert (made.json()["under_way"], made.json()["n_samples"]) == (True, 0)
    return str(made.json()["id"])


def send(client: TestClient, measurement: str, first: int, last: int, **query: Any) -> httpx2.Response:
    return client.patch(
        f"/v1/measurements/{measurement}/rows", params={"offset": first, **query}, json=part(first, last)
    )


def test_rows_in_any_form_become_the_measurement_that_the_whole_file_is(client: TestClient) -> None:
    measurement = begin(client)
    path = f"/v1/measurements/{measurement}/rows"
    assert send(client, measurement, 0, PIECE).json()["n_samples"] == PIECE
    csv = client.patch(
        path, params={"offset": PIECE}, content=as_csv(PIECE, 2 * PIECE), headers={"content-type": "text/csv"}
    )
    assert csv.json()["n_samples"] == 2 * PIECE
    # A retry, also one that brings more, is harmless.
    assert send(client, measurement, 0, PIECE).json()["n_samples"] == 2 * PIECE
    assert send(client, measurement, PIECE, 3 * PIECE).json()["n_samples"] == 3 * PIECE
    last = {"offset": 3 * PIECE, "finished": True}
    media = {"content-type": "application/vnd.apache.parquet"}
    for _ in range(2):
        done = client.patch(path, params=last, content=as_parquet(3 * PIECE, LENGTH), headers=media)
        assert done.status_code == 200, done.text
        assert (done.json()["under_way"], done.json()["n_samples"]) == (False, LENGTH)
    view = client.get(f"/v1/measurements/{measurement}").json()
    upload = client.post(
        "/v1/measurements",
        files={"file": ("run.csv", as_csv(0, LENGTH))},
        data={"metadata": json.dumps({"robot_id": view["robot_id"], "name": "live"})},
    ).json()
    for field in ("n_samples", "sampling_rate", "joints", "segments", "phases", "checks"):
        assert view[field] == upload[field], field
    content = client.get(f"/v1/measurements/{measurement}/content")
    assert pq.read_table(io.BytesIO(content.content)).num_rows == LENGTH
    assert content.headers["etag"] == f'"{view["sha256"]}"'
    # It is identified from like any other.
    body = {"robot_id": view["robot_id"], "measurement_ids": [measurement]}
    assert client.post("/v1/identifications", json=body).status_code == 202
    assert send(client, measurement, LENGTH - 5, LENGTH).status_code == 409


def test_a_recording_under_way_is_not_used_before_its_end(client: TestClient) -> None:
    measurement = begin(client)
    send(client, measurement, 0, PIECE)
    robot = client.get(f"/v1/measurements/{measurement}").json()["robot_id"]
    refused = client.post("/v1/identifications", json={"robot_id": robot, "measurement_ids": [measurement]})
    assert refused.status_code == 422
    assert refused.json()["errors"][0]["pointer"] == "/measurement_ids/0"
    for below in ("raw", "standstills"):
        assert client.get(f"/v1/measurements/{measurement}/{below}").status_code == 404
    empty = begin(client)
    assert client.get(f"/v1/measurements/{empty}/content").status_code == 404
    assert client.post(f"/v1/measurements/{empty}/revisions", json={"role": "validation"}).status_code == 404
    assert measurement in [m["id"] for m in client.get("/v1/measurements").json()["items"]]
    assert client.delete(f"/v1/measurements/{measurement}").status_code == 204


@pytest.mark.parametrize(
    ("offset", "content", "media", "status"),
    [
        (PIECE + 1, None, None, 409),
        (0, {**part(0, 5), "q1": [9.0] * 5}, None, 409),
        (PIECE, {"t": [1.0]}, None, 422),
        (PIECE, {**part(0, 3), "q1": [1.0]}, None, 422),
        (PIECE, {**part(0, 1), "q1": ["a"]}, None, 422),
        (PIECE, {name: [] for name in RUN}, None, 422),
        (PIECE, [1, 2], None, 422),
        (PIECE, b"{", "application/json", 422),
        (PIECE, b"t,q1\n1,2,3\n", "text/csv", 422),
        (PIECE, b"t,q1,q2,tau1,tau2\na,b,c,d,e\n", "text/csv", 422),
        (PIECE, b"PAR1....", "application/vnd.apache.parquet", 422),
        (PIECE, b"\x00\xff" * 50, "text/csv", 422),
        (PIECE, b"x", "text/plain", 415),
        (-1, {}, None, 422),
        (PIECE, b"", "application/json", 200),
        (5, b"", "application/json", 409),
    ],
)
def test_bad_rows_are_problems_and_change_nothing(
    client: TestClient, offset: int, content: Any, media: str | None, status: int
) -> None:
    measurement = begin(client)
    send(client, measurement, 0, PIECE)
    how = (
        {"content": content, "headers": {"content-type": media}}
        if isinstance(content, bytes)
        else {"json": part(PIECE, PIECE + 5) if content is None else content}
    )
    answer = client.patch(f"/v1/measurements/{measurement}/rows", params={"offset": offset}, **how)
    assert answer.status_code == status, answer.text
    assert client.get(f"/v1/measurements/{measurement}").json()["n_samples"] == PIECE


def test_a_recording_that_is_refused_at_its_end_stays_as_it_is(client: TestClient) -> None:
    measurement = begin(client)
    still = {name: ([0.01 * k for k in range(50)] if name == "t" else [0.0] * 50) for name in RUN}
    answer = client.patch(f"/v1/measurements/{measurement}/rows", params={"offset": 0, "finished": True}, json=still)
    assert answer.status_code == 422
    view = client.get(f"/v1/measurements/{measurement}").json()
    assert (view["under_way"], view["n_samples"]) == (True, 50)
    empty = begin(client)
    answer = client.patch(f"/v1/measurements/{empty}/rows", params={"offset": 0, "finished": True})
    assert answer.status_code == 422


def test_a_recording_that_is_refused_for_its_columns_is_corrected_by_a_revision(client: TestClient) -> None:
    measurement = begin(client)
    path = f"/v1/measurements/{measurement}"
    # Positions in degrees, and a torque under another name.
    rows = {**part(0, LENGTH), "q1": np.rad2deg(RUN["q1"]).tolist(), "q2": np.rad2deg(RUN["q2"]).tolist()}
    rows["moment"] = rows.pop("tau2")
    answer = client.patch(f"{path}/rows", params={"offset": 0, "finished": True}, json=rows)
    assert answer.status_code == 422
    content = client.get(f"{path}/content")
    assert pq.read_table(io.BytesIO(content.content)).column_names == list(rows)
    change = {"columns": {"tau2": "moment"}, "units": {"q": "deg"}}
    revised = client.post(f"{path}/revisions", json=change)
    assert revised.status_code == 201, revised.text
    view = revised.json()
    assert (view["under_way"], view["n_samples"], view["parent_id"]) == (False, LENGTH, measurement)
    # More rows replace those of the parent alone.
    more = {name: values[-1:] for name, values in rows.items()} | {"t": [LENGTH / 100.0]}
    assert client.patch(f"{path}/rows", params={"offset": LENGTH}, json=more).status_code == 200
    stored = client.get(f"/v1/measurements/{view['id']}/content")
    assert stored.content == content.content
    assert stored.headers["etag"] == f'"{view["sha256"]}"'
    assert client.post(f"/v1/measurements/{view['id']}/revisions", json={"role": "validation"}).status_code == 201


@pytest.mark.parametrize(
    ("offset", "content", "status"),
    [
        (0, as_csv(0, LENGTH), 200),
        (LENGTH - 5, as_csv(LENGTH - 5, LENGTH), 200),
        (LENGTH, b"", 200),
        (5, b"", 409),
        (LENGTH, as_csv(0, 100), 409),
        (LENGTH - 5, as_csv(0, 5), 409),
        (LENGTH - 5, b"\x00\xff" * 50, 422),
    ],
)
def test_only_the_last_rows_are_sent_again_after_the_end(
    client: TestClient, offset: int, content: bytes, status: int
) -> None:
    measurement = begin(client)
    assert send(client, measurement, 0, LENGTH, finished=True).status_code == 200
    media = {"content-type": "text/csv"}
    query = {"offset": offset, "finished": True}
    answer = client.patch(f"/v1/measurements/{measurement}/rows", params=query, content=content, headers=media)
    assert answer.status_code == status, answer.text


def test_a_revision_while_more_rows_come_is_asked_to_try_again(
    client: TestClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    measurement = begin(client)
    # Rows that no other recording has.
    rows = {**part(0, PIECE), "tau2": (1.001 * RUN["tau2"][:PIECE]).tolist()}
    path = f"/v1/measurements/{measurement}/rows"
    assert client.patch(path, params={"offset": 0}, json=rows).status_code == 200
    fetch = ObjectStore.fetch_file

    def fetch_late(store: ObjectStore, key: str) -> Path:
        monkeypatch.undo()
        assert send(client, measurement, PIECE, LENGTH).status_code == 200
        return fetch(store, key)

    monkeypatch.setattr(ObjectStore, "fetch_file", fetch_late)
    path = f"/v1/measurements/{measurement}/revisions"
    answer = client.post(path, json={"name": "meanwhile"})
    assert (answer.status_code, answer.json()["title"]) == (409, CHANGED), answer.text
    assert client.post(path, json={"name": "again"}).status_code == 201


def test_rows_are_stored_once(client: TestClient, settings: Settings) -> None:
    def count_objects() -> int:
        return len([path for path in settings.data_dir.rglob("*") if re.fullmatch("[0-9a-f]{64}", path.name)])

    before = count_objects()
    measurement = begin(client)
    path = f"/v1/measurements/{measurement}/rows"
    for first in range(0, PIECE, 20):
        # Rows that no other recording has.
        rows = {**part(first, first + 20), "q1": (0.5 * RUN["q1"][first : first + 20]).tolist()}
        assert client.patch(path, params={"offset": first}, json=rows).status_code == 200
    assert count_objects() == before + 1
    # Rows that another recording has as well stay there.
    twin, other = begin(client), begin(client)
    send(client, twin, 0, PIECE)
    send(client, other, 0, PIECE)
    send(client, twin, PIECE, PIECE + 20)
    assert client.get(f"/v1/measurements/{other}/content").status_code == 200
    assert send(client, other, PIECE, LENGTH, finished=True).status_code == 200


def test_equal_rows_that_are_sent_at_once_are_all_accepted(settings: Settings) -> None:
    with serving(settings.model_copy(update={"port": 0})) as url, Client(url) as live:
        measurement = live.measurements.begin(live.robots.create("scara", modified_dh=TABLE), "live").id

        def append(finished: bool) -> int:
            query = {"offset": 0, "finished": finished}
            path = f"{url}/v1/measurements/{measurement}/rows"
            return httpx2.patch(path, params=query, json=part(0, LENGTH), timeout=60.0).status_code

        with ThreadPoolExecutor(5) as pool:
            for finished in (False, True):
                assert list(pool.map(append, [finished] * 5)) == [200] * 5


def test_whole_numbers_that_no_float_holds_are_taken(client: TestClient) -> None:
    measurement = begin(client)
    path = f"/v1/measurements/{measurement}/rows"
    start = 1_700_000_000_000_000_000
    # Those of the first row are exact as floats as well.
    ticks = (start + 1 * (np.arange(LENGTH) > 0) + np.arange(LENGTH) * 10_000_000).tolist()
    for first, last in ((0, 1), (1, PIECE), (1, PIECE), (PIECE, LENGTH)):
        answer = client.patch(path, params={"offset": first}, json={**part(first, last), "t": ticks[first:last]})
        assert answer.status_code == 200, answer.text
    rows = pq.read_table(io.BytesIO(client.get(f"/v1/measurements/{measurement}/content").content))
    assert rows["t"].to_pylist() == ticks
    wrong = client.patch(path, params={"offset": LENGTH}, json={**part(0, 1), "t": [0.5]})
    assert wrong.status_code == 422


def test_a_name_is_no_recording_under_way(client: TestClient) -> None:
    robot = client.post("/v1/robots", json=ROBOT).json()["id"]
    said = {"metadata": json.dumps({"robot_id": robot})}
    answer = client.post("/v1/imports", files={"file": ("run.csv", as_csv(0, LENGTH))}, data=said)
    imported = answer.json()["id"]
    for name in ("run", "under_way"):
        body = {"import_id": imported, "metadata": {"robot_id": robot, "name": name}}
        assert client.post("/v1/measurements", json=body).status_code == 201
    assert client.post("/v1/measurements", content=b"[" * 100_000, headers=JSON).status_code == 422


def test_an_estimate_that_fails_ends_the_stream(client: TestClient, monkeypatch: pytest.MonkeyPatch) -> None:
    measurement = begin(client)
    send(client, measurement, 0, PIECE)
    problems = [ProblemOfService(429, "wait"), ProblemOfService(507, "The disk is full.", title="Disk full")]

    async def fail(*_: object) -> None:
        raise problems.pop(0)

    monkeypatch.setattr(rows_routes, "_estimate", fail)
    answer = client.get(f"/v1/measurements/{measurement}/estimates")
    (event,) = httpx2.EventSource(answer)
    assert event.event == "problem"
    assert (event.json()["status"], event.json()["title"]) == (507, "Disk full")
    assert not problems


@pytest.mark.parametrize("path", ["/v1/measurements/{}/estimates", "/v1/jobs/{}/events"])
def test_an_endless_event_id_is_refused(client: TestClient, path: str) -> None:
    measurement = begin(client)
    send(client, measurement, 0, LENGTH, finished=True)
    robot = client.get(f"/v1/measurements/{measurement}").json()["robot_id"]
    body = {"robot_id": robot, "measurement_ids": [measurement]}
    job = client.post("/v1/identifications", json=body).json()["job_id"]
    of = measurement if "measurements" in path else job
    answer = client.get(path.format(of), headers={"Last-Event-ID": "1" * 5000})
    assert answer.status_code == 422


def test_a_design_of_another_robot_is_refused(settings: Settings) -> None:
    with serving(settings.model_copy(update={"port": 0})) as url, Client(url) as live:
        other = live.robots.create(
            "other",
            modified_dh=TABLE,
            limits={
                joint["name"]: {"position": [-2, 2], "velocity": 2, "acceleration": 5} for joint in TABLE["joints"]
            },
        )
        design = live.designs.create(other, kind="random", time_budget=5.0).wait()
        measurement = live.measurements.begin(live.robots.create("scara", modified_dh=TABLE), "live")
        with pytest.raises(ProblemError) as caught:
            list(live.measurements.follow(measurement, design=design))
        assert caught.value.status == 422
        same = live.measurements.begin(other, "live")
        live.measurements.append_rows(same, part(0, 900), offset=0)
        assert next(iter(live.measurements.follow(same, design=design))).event == "estimate"


def test_ids_of_events_count_the_rows_that_were_sent(client: TestClient) -> None:
    measurement = begin(client)
    # Every tenth row was lost: the rows are resampled, and are more than were sent.
    kept = [k for k in range(LENGTH) if k % 10 != 5]
    rows = {name: values[kept].tolist() for name, values in RUN.items()}
    path = f"/v1/measurements/{measurement}"
    done = client.patch(f"{path}/rows", params={"offset": 0, "finished": True}, json=rows)
    assert done.status_code == 200, done.text
    assert done.json()["n_samples"] > len(kept)
    (event,) = httpx2.EventSource(client.get(f"{path}/estimates"))
    assert (event.event, event.id, event.json()["rows"]) == ("finished", str(len(kept)), len(kept))


def test_the_limit_of_a_recording_holds_for_all_its_rows(settings: Settings) -> None:
    with TestClient(
        app_of(settings.model_copy(update={"max_upload_bytes": 60_000})), base_url="http://127.0.0.1"
    ) as client:
        measurement = begin(client)
        sizes = [send(client, measurement, first, first + PIECE) for first in range(0, LENGTH, PIECE)]
        assert sizes[0].status_code == 200
        assert sizes[-1].status_code in (409, 413)
        assert 413 in [answer.status_code for answer in sizes]


def test_estimates_come_with_the_rows_and_survive_a_restart(settings: Settings) -> None:
    with serving(settings.model_copy(update={"port": 0})) as url, Client(url) as live:
        robot = live.robots.create("scara", modified_dh=TABLE)
        measurement = live.measurements.begin(robot, "live")
        live.measurements.append_rows(measurement, part(0, 900), offset=0)
        first = next(iter(live.measurements.follow(measurement)))
        assert first.event == "estimate"
        assert first.id == "900"
        assert first.data["rows"] == 900
    with serving(settings.model_copy(update={"port": 0})) as url, Client(url) as live:
        events = live.measurements.follow(measurement.id)
        again = next(events)
        assert again.data["parameters"] == first.data["parameters"]
        assert again.data["parameters"]
        assert max(again.data["error"]) < 0.5
        live.measurements.append_rows(measurement.id, part(900, LENGTH), offset=900, finished=True)
        *between, last = list(events)
        assert last.event == "finished"
        assert all(event.event == "estimate" for event in between)
        model = live.identifications.create(robot.id, [measurement.id]).wait()
        values = {p["name"]: p["value"] for p in model.result["parameters"]}
        assert {p["name"]: p["value"] for p in last.data["parameters"]} == pytest.approx(values, rel=1e-6, abs=1e-9)
        # Whoever has the last rows hears of the end alone.
        with httpx2.stream(
            "GET", f"{url}/v1/measurements/{measurement.id}/estimates", headers={"Last-Event-ID": str(LENGTH)}
        ) as answer:
            assert [line for line in answer.iter_lines() if line.startswith("event:")] == ["event: finished"]
        with pytest.raises(ProblemError):
            list(live.measurements.follow("meas_none"))
        with pytest.raises(ProblemError):
            list(live.measurements.follow(measurement.id, design="design_none"))


def test_a_bad_run_is_to_be_stopped(settings: Settings) -> None:
    with serving(settings.model_copy(update={"port": 0})) as url, Client(url) as live:
        robot = live.robots.create("scara", modified_dh=TABLE)
        rows = part(0, 900)
        # The drive of the elbow gives no more than this.
        rows["tau2"] = np.clip(rows["tau2"], -10.0, 10.0).tolist()
        measurement = live.measurements.begin(robot, "saturated")
        live.measurements.append_rows(measurement, rows, offset=0)
        event = next(iter(live.measurements.follow(measurement)))
        assert "saturation" in [reason["code"] for reason in event.data["stop"]]
        sound = live.measurements.begin(robot, "sound")
        live.measurements.append_rows(sound, part(0, 900), offset=0)
        assert next(iter(live.measurements.follow(sound))).data["stop"] == []
        nothing = next(iter(live.measurements.follow(live.measurements.begin(robot, "empty"))))
        assert (nothing.data["rows"], nothing.data["parameters"]) == (0, [])
        assert nothing.data["reason"]
