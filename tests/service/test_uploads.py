from __future__ import annotations

import hashlib
import os
import time
from collections.abc import Callable
from datetime import timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fastapi.testclient import TestClient
from support.measurement_uploads import Columns, as_csv, files_in, sound, upload

from dynident_service.readiness import sweep_folder
from dynident_service.storage.deletion_and_expiry import sweep_objects
from dynident_service.storage_and_engine import Services


@pytest.fixture
def stored(services: Services) -> Callable[[], tuple[set[Path], int]]:
    """What is stored: files of the object store and of unfinished uploads, and the number of measurements."""

    def look() -> tuple[set[Path], int]:
        folder = services.settings.data_dir
        files = files_in(folder / "objects") | files_in(folder / "uploads")
        return files, len(services.resources.list_page("measurement", 500).items)

    return look


def test_a_measurement_says_whether_it_holds_commanded_positions(client: TestClient, robot: dict[str, Any]) -> None:
    columns = sound()
    assert not upload(client, robot, as_csv(columns)).json()["has_command"]
    told = {**columns, "q_command1": columns["q1"], "q_command2": columns["q2"]}
    made = upload(client, robot, as_csv(told)).json()
    assert made["has_command"]
    assert client.get(f"/v1/measurements/{made['id']}").json()["has_command"]


def test_a_sound_recording_is_stored_and_comes_back_as_it_was(client: TestClient, robot: dict[str, Any]) -> None:
    content = as_csv(sound())
    answer = upload(client, robot, content)
    measurement = answer.json()
    assert answer.status_code == 201, answer.text
    assert measurement["sha256"] == hashlib.sha256(content).hexdigest()
    assert measurement["n_samples"] == 2000
    assert measurement["sampling_rate"] == pytest.approx(200.0)
    assert {check["status"] for check in measurement["checks"]} <= {"ok", "warning"}
    assert client.get(f"{answer.headers['location']}/content").content == content
    assert client.get(answer.headers["location"]).json() == measurement
    assert measurement["id"] in [
        one["id"] for one in client.get("/v1/measurements", params={"robot_id": robot["id"]}).json()["items"]
    ]


def test_a_robot_with_measurements_cannot_be_deleted_and_the_answer_names_them(
    client: TestClient, robot: dict[str, Any]
) -> None:
    measurement = upload(client, robot, as_csv(sound())).json()
    answer = client.delete(f"/v1/robots/{robot['id']}")
    assert answer.status_code == 409
    assert answer.json()["dependents"] == [{"id": measurement["id"], "kind": "measurement"}]
    assert client.delete(f"/v1/measurements/{measurement['id']}").status_code == 204
    assert client.delete(f"/v1/robots/{robot['id']}").status_code == 204


def test_a_file_is_swept_away_once_its_last_owner_is_deleted_and_no_sooner(
    client: TestClient, robot: dict[str, Any], services: Services, stored: Callable[[], tuple[set[Path], int]]
) -> None:
    def sweep_now() -> None:
        sweep_objects(services.database, services.objects, timedelta(0))

    sweep_now()
    before, _ = stored()
    content = as_csv(sound(1500))
    first, second = (upload(client, robot, content).json()["id"] for _ in range(2))
    client.delete(f"/v1/measurements/{first}")
    sweep_now()
    assert client.get(f"/v1/measurements/{second}/content").content == content
    client.delete(f"/v1/measurements/{second}")
    assert stored()[0] > before
    sweep_now()
    assert stored()[0] == before


def test_a_retried_upload_is_stored_once(
    client: TestClient, robot: dict[str, Any], stored: Callable[[], tuple[set[Path], int]]
) -> None:
    content = as_csv(sound(1700))
    first = upload(client, robot, content, key="u1").json()
    after_first = stored()
    assert upload(client, robot, content, key="u1").json() == first
    assert stored() == after_first
    assert upload(client, robot, as_csv(sound(1701)), key="u1").status_code == 422
    assert stored() == after_first


def spoiled(change: Callable[[Columns], None]) -> bytes:
    columns = sound()
    change(columns)
    return as_csv(columns)


def put(name: str, row: int, value: float) -> Callable[[Columns], None]:
    def change(columns: Columns) -> None:
        columns[name][row] = value

    return change


def scale(names: str, factor: float) -> Callable[[Columns], None]:
    def change(columns: Columns) -> None:
        for name in names.split():
            columns[name] *= factor

    return change


@pytest.mark.parametrize(
    ("content", "column", "row"),
    [
        (spoiled(scale("t", 0.0)), "t", None),
        (spoiled(scale("tau1", 0.0)), "tau1", None),
        (spoiled(scale("tau1 tau2", -1.0)), "tau2", None),
        (spoiled(lambda columns: columns.pop("tau2")), "tau2", None),
        (b"t,q1,q2,tau1,tau2\n0,0,0,0,0\n0.01,zero,0,0,0\n", "q1", None),
    ],
)
def test_a_bad_file_names_column_and_row_and_leaves_nothing_behind(
    client: TestClient,
    robot: dict[str, Any],
    stored: Callable[[], tuple[set[Path], int]],
    content: bytes,
    column: str,
    row: int | None,
) -> None:
    before = stored()
    answer = upload(client, robot, content)
    assert answer.status_code == 422, answer.text
    assert answer.headers["content-type"] == "application/problem+json"
    (field,) = answer.json()["errors"]
    assert column in field["pointer"] or column in field["detail"]
    assert field.get("row") == row or row is None
    assert stored() == before


@pytest.mark.parametrize(
    ("content", "name", "column", "row"),
    [
        (spoiled(put("q2", 1000, np.nan)), "missing_values", "q2", 1001),
        (spoiled(put("tau1", 500, np.inf)), "missing_values", "tau1", 501),
    ],
)
def test_what_was_put_right_or_may_be_wrong_is_a_warning_with_column_and_row(
    client: TestClient, robot: dict[str, Any], content: bytes, name: str, column: str, row: int | None
) -> None:
    answer = upload(client, robot, content)
    assert answer.status_code == 201, answer.text
    (check,) = [check for check in answer.json()["checks"] if check["name"] == name]
    assert (check["status"], check["column"], check["row"]) == ("warning", column, row)


@pytest.mark.parametrize(
    ("metadata", "pointer"),
    [
        ({"robot_id": "rob_nothing"}, "/metadata/robot_id"),
        ({"role": "decoration"}, "/metadata/role"),
        ({"windows": [[2, 1]]}, "/metadata/windows/0"),
        ({"windows": [[1, "x"]]}, "/metadata/windows/0/1"),
        ({"units": {"q": "furlong"}}, "/metadata/units/q"),
        ({"columns": {"q9": "x"}}, "/metadata/columns/q9"),
        ({"surprise": 1}, "/metadata/surprise"),
        ({"name": None}, "/metadata/name"),
    ],
)
def test_what_is_said_of_a_file_is_checked(
    client: TestClient,
    robot: dict[str, Any],
    stored: Callable[[], tuple[set[Path], int]],
    metadata: dict[str, Any],
    pointer: str,
) -> None:
    before = stored()
    answer = upload(client, robot, as_csv(sound()), **metadata)
    assert answer.status_code == 422
    assert [field["pointer"] for field in answer.json()["errors"]] == [pointer]
    assert stored() == before


@pytest.mark.parametrize(
    "content", [b"", b"PAR1", b"PAR1" + bytes(100) + b"PAR1", b"\x00" * 5000, b"t\n", b"a,b\n1,2\n"]
)
def test_what_is_no_recording_is_refused_and_never_a_500(
    client: TestClient, robot: dict[str, Any], stored: Callable[[], tuple[set[Path], int]], content: bytes
) -> None:
    before = stored()
    answer = upload(client, robot, content)
    assert answer.status_code == 422, answer.text
    assert stored() == before


def test_a_form_without_its_parts_says_which(client: TestClient) -> None:
    answer = client.post("/v1/measurements", data={"metadata": "{}"}, files={"other": b""})
    assert answer.status_code == 422
    assert "/file" in [field["pointer"] for field in answer.json()["errors"]]
    assert client.post("/v1/measurements", content=b"junk").status_code == 422
    bad = client.post("/v1/measurements", data={"metadata": "{oops"}, files={"file": b"x"})
    assert bad.status_code == 422
    assert bad.json()["errors"][0]["pointer"] == "/metadata"


def test_uploads_that_were_cut_off_are_swept_away_after_a_day(tmp_path: Path) -> None:
    for name in ("old", "new"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "source").write_bytes(b"half a fi")
    a_day_ago = time.time() - 25 * 3600
    os.utime(tmp_path / "old", (a_day_ago, a_day_ago))
    sweep_folder(tmp_path, time.time() - 24 * 3600)
    sweep_folder(tmp_path / "not there", time.time())
    assert [path.name for path in tmp_path.iterdir()] == ["new"]
