from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from fastapi.testclient import TestClient
from service_helpers import app_of

from dynident_service.api_keys import create_key
from dynident_service.settings import Settings, hash_key
from dynident_service.storage.database import Database, migrate
from dynident_service.storage.database_tables import KeyRow


@pytest.fixture(scope="module")
def guarded(tmp_path_factory: pytest.TempPathFactory) -> Iterator[TestClient]:
    settings = Settings(data_dir=tmp_path_factory.mktemp("guarded"), host="0.0.0.0", api_keys=["configured"], workers=1)
    with TestClient(app_of(settings), "http://robot-cell:8000", raise_server_exceptions=False) as client:
        yield client


def test_a_service_that_others_reach_asks_for_a_key(guarded: TestClient) -> None:
    answer = guarded.get("/v1/robots")
    assert answer.status_code == 401
    assert answer.headers["www-authenticate"] == "Bearer"
    assert answer.headers["content-type"] == "application/problem+json"
    assert guarded.get("/v1/robots", headers={"authorization": "Bearer wrong"}).status_code == 401


def test_a_key_opens_as_bearer_token_and_as_header(guarded: TestClient) -> None:
    assert guarded.get("/v1/robots", headers={"authorization": "Bearer configured"}).status_code == 200
    assert guarded.get("/v1/robots", headers={"x-api-key": "configured"}).status_code == 200


def test_health_needs_no_key(guarded: TestClient) -> None:
    assert guarded.get("/healthz").status_code == 200
    assert guarded.get("/readyz").status_code == 200


def test_a_made_key_opens_and_only_its_hash_is_kept(guarded: TestClient) -> None:
    database: Database = guarded.app.state.services.database  # type: ignore[attr-defined]
    key = create_key(database, "cell 3")
    assert guarded.get("/v1/robots", headers={"x-api-key": key}).status_code == 200
    with database.read() as session:
        (row,) = session.query(KeyRow).filter_by(name="cell 3")
    assert row.sha256 == hash_key(key)
    assert key not in row.sha256


def test_a_service_without_keys_refuses_to_be_reached_by_others(tmp_path_factory: pytest.TempPathFactory) -> None:
    settings = Settings(data_dir=tmp_path_factory.mktemp("open"), host="0.0.0.0", workers=1)
    with pytest.raises(RuntimeError, match="API key"), TestClient(app_of(settings)):
        pass


def test_without_keys_only_local_host_names_are_answered(client: TestClient) -> None:
    assert client.get("/v1/robots", headers={"host": "attacker.example"}).status_code == 421
    assert client.get("/v1/robots", headers={"host": "localhost:8000"}).status_code == 200
    assert client.get("/v1/robots", headers={"host": "[::1]:8000"}).status_code == 200


def test_pages_of_other_origins_cannot_change_anything(client: TestClient) -> None:
    answer = client.post("/v1/robots", json={}, headers={"origin": "https://attacker.example"})
    assert answer.status_code == 403
    assert client.post("/v1/robots", json={}, headers={"origin": "http://127.0.0.1"}).status_code == 422


def test_settings_come_from_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DYNIDENT_PORT", "9123")
    monkeypatch.setenv("DYNIDENT_DATABASE_URL", "postgresql://u:p@db/x")
    settings = Settings()
    assert settings.port == 9123
    assert settings.database == "postgresql+psycopg://u:p@db/x"


def test_the_command_to_make_a_key_prints_one_that_works(
    tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from dynident_service import new_key
    from dynident_service.api_keys import KeyRing

    folder = tmp_path_factory.mktemp("keys")
    monkeypatch.setenv("DYNIDENT_DATA_DIR", str(folder))
    assert new_key.main(["lab"]) == 0
    key = capsys.readouterr().out.strip()
    database = Database(Settings().database)
    migrate(database)
    assert KeyRing(Settings(), database).find_holder(key) is not None
    database.close()


def test_a_key_allows_what_its_scope_says_and_no_more(guarded: TestClient) -> None:
    database: Database = guarded.app.state.services.database  # type: ignore[attr-defined]
    statuses = {"read": (200, 403, 403), "submit": (200, 422, 403), "admin": (200, 422, 404)}
    for scope, expected in statuses.items():
        headers = {"x-api-key": create_key(database, f"a {scope} key", scope)}  # type: ignore[arg-type]
        answers = (
            guarded.get("/v1/robots", headers=headers),
            guarded.post("/v1/robots", json={}, headers=headers),
            guarded.delete("/v1/robots/rob_nothing", headers=headers),
        )
        assert tuple(answer.status_code for answer in answers) == expected
    refused = guarded.post("/v1/robots", json={}, headers={"x-api-key": create_key(database, "watcher", "read")})
    assert "'watcher' has the scope read; POST needs a key with the scope submit" in refused.json()["detail"]


def test_a_key_whose_time_is_over_opens_no_more_and_says_so(guarded: TestClient) -> None:
    database: Database = guarded.app.state.services.database  # type: ignore[attr-defined]
    key, over = create_key(database, "guest", days=1), create_key(database, "last week's guest", days=-1)
    assert guarded.get("/v1/robots", headers={"x-api-key": key}).status_code == 200
    answer = guarded.get("/v1/robots", headers={"x-api-key": over})
    assert (answer.status_code, answer.json()["title"]) == (401, "API key expired")


def test_who_changed_what_is_written_down_and_no_key_ever_is(
    guarded: TestClient, caplog: pytest.LogCaptureFixture
) -> None:
    database: Database = guarded.app.state.services.database  # type: ignore[attr-defined]
    key = create_key(database, "cell 5", "admin", owner="Ada")
    caplog.set_level("DEBUG")
    for headers in ({"x-api-key": key}, {"authorization": f"Bearer {key}"}):
        guarded.get(f"/v1/robots?cursor={key[:30]}", headers=headers)
        guarded.delete("/v1/robots/rob_nothing%0Aforged", headers=headers)
        guarded.delete("/v1/robots/rob_nothing", headers={"x-api-key": f"{key}?"})
    lines = [record.getMessage() for record in caplog.records if record.name == "dynident.audit"]
    assert len(lines) == 4
    assert lines[0].startswith("'cell 5' of 'Ada': DELETE '/v1/robots/rob_nothing")
    assert lines[1] == "'an unknown caller': DELETE '/v1/robots/rob_nothing': 401"
    assert not any("\n" in line for line in lines)
    ours = [record.getMessage() for record in caplog.records if record.name.startswith(("dynident", "uvicorn"))]
    assert not any(key in line or hash_key(key) in line for line in ours)


def test_keys_are_listed_with_their_last_use_and_revoked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from dynident_service import new_key
    from dynident_service.api_keys import KeyRing

    monkeypatch.setenv("DYNIDENT_DATA_DIR", str(tmp_path))
    assert new_key.main(["cell 7", "--scope", "read", "--owner", "Ada", "--days", "30"]) == 0
    key = capsys.readouterr().out.strip()
    database = Database(Settings().database)
    assert new_key.main(["--list"]) == 0
    assert capsys.readouterr().out.startswith("cell 7: read, owner Ada, used never, ends 2")
    assert KeyRing(Settings(), database).find_holder(key) is not None
    assert new_key.main(["--list"]) == 0
    told = capsys.readouterr().out
    assert "used 2" in told
    assert key not in told
    assert new_key.main(["cell 7", "--revoke"]) == 0
    assert KeyRing(Settings(), database).find_holder(key) is None
    assert new_key.main(["cell 7", "--revoke"]) == 1
    database.close()


def test_a_key_that_may_only_look_asks_for_poses_and_posts_nothing_else(guarded: TestClient) -> None:
    database: Database = guarded.app.state.services.database  # type: ignore[attr-defined]
    headers = {"x-api-key": create_key(database, "onlooker", "read")}
    paths = guarded.get("/openapi.json", headers=headers).json()["paths"]
    posts = [path.replace("{", "").replace("}", "") for path, operations in paths.items() if "post" in operations]
    allowed = {path for path in posts if guarded.post(path, json={}, headers=headers).status_code != 403}
    assert allowed == {"/v1/robots/robot_id/poses"}


@pytest.mark.parametrize("days", ["1e9", "nan", "inf", "-1", "0", "soon"])
def test_a_key_ends_after_a_number_of_days_that_a_calendar_has(days: str, capsys: pytest.CaptureFixture[str]) -> None:
    from dynident_service import new_key

    with pytest.raises(SystemExit) as ended:
        new_key.main(["cell 7", f"--days={days}"])
    assert ended.value.code == 2
    assert f"'{days}' is not a number of days above 0 and up to 36500" in capsys.readouterr().err


@pytest.mark.parametrize("number", ["-1", "1.5", "9223372036854775808"])
def test_a_quota_is_a_whole_number_that_the_database_holds(number: str, capsys: pytest.CaptureFixture[str]) -> None:
    from dynident_service import new_key

    with pytest.raises(SystemExit):
        new_key.main(["cell 7", f"--quota-jobs={number}"])
    assert f"'{number}' is not a whole number from 0" in capsys.readouterr().err
