"""Lists of many resources cost no more questions to the database than lists of one."""

from __future__ import annotations

from typing import Any

from fastapi.testclient import TestClient
from service_helpers import TWO_JOINTS
from sqlalchemy import event

from dynident_service.storage_and_engine import Services

TABLES = ("FROM resources", "FROM dependencies", "FROM objects")


def test_a_longer_page_asks_the_database_no_more_often(client: TestClient, services: Services) -> None:
    body = {"name": "one of many", "description": {"format": "modified_dh", "content": TWO_JOINTS}}
    for _ in range(5):
        assert client.post("/v1/robots", json=body).status_code == 201
    asked: list[str] = []

    def note(connection: Any, cursor: Any, statement: str, *_: Any) -> None:
        asked.append(" ".join(statement.split()))

    def questions(limit: int) -> int:
        asked.clear()
        assert len(client.get("/v1/robots", params={"limit": limit}).json()["items"]) == limit
        return len([one for one in asked if any(table in one for table in TABLES)])

    event.listen(services.database.engine, "before_cursor_execute", note)
    try:
        assert questions(5) == questions(1) == 3
    finally:
        event.remove(services.database.engine, "before_cursor_execute", note)
