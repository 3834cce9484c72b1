from __future__ import annotations

from collections.abc import Iterator

import pytest
from fastapi.testclient import TestClient

from dynident_service.app import create_app
from dynident_service.keys import create_key, hash_of
from dynident_service.settings import Settings
from dynident_service.storage.database import Database
from dynident_service.storage.migrate import migrate
from dynident_service.storage.tables import KeyRow


@pytest.fixture(scope="module")
def guarded(tmp_path_factory: pytest.TempPathFactory) -> Iterator[TestClient]:
    settings = Settings(data_dir=tmp_path_factory.mktemp("guarded"), host="0.0.0.0", api_keys=["configured"], workers=1)
    with TestClient(create_app(settings), "http://robot-cell:8000", raise_server_exceptions=False) as client:
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
        (row,) = session.query(KeyRow).all()
    assert row.sha256 == hash_of(key)
    assert key not in row.sha256


def test_a_service_without_keys_refuses_to_be_reached_by_others(tmp_path_factory: pytest.TempPathFactory) -> None:
    settings = Settings(data_dir=tmp_path_factory.mktemp("open"), host="0.0.0.0", workers=1)
    with pytest.raises(RuntimeError, match="API key"), TestClient(create_app(settings)):
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
    from dynident_service.keys import KeyRing

    folder = tmp_path_factory.mktemp("keys")
    monkeypatch.setenv("DYNIDENT_DATA_DIR", str(folder))
    assert new_key.main(["lab"]) == 0
    key = capsys.readouterr().out.strip()
    database = Database(Settings().database)
    migrate(database)
    assert KeyRing(Settings(), database).knows(key)
    database.close()
