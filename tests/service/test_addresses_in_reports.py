"""A report leads back to the service, never to where the `Host` header of a request says."""

from __future__ import annotations

from pathlib import Path

import pytest
from fastapi.testclient import TestClient
from pydantic import ValidationError
from service_helpers import app_of, wait_for
from test_older_data import folder

from dynident_service.settings import Settings

__all__ = ["folder"]
HEADERS = {"x-api-key": "ours", "host": "attacker.example"}


@pytest.mark.parametrize(
    ("public_url", "address"),
    [("", "http://robot-cell:8000/"), ("https://robots.example/dynident/", "https://robots.example/dynident/")],
)
def test_the_address_is_that_of_the_settings_or_where_the_request_came(
    folder: Path, public_url: str, address: str
) -> None:
    settings = Settings(data_dir=folder, workers=1, require_keys=True, api_keys=["ours"], public_url=public_url)
    with TestClient(app_of(settings), "http://robot-cell:8000", headers=HEADERS) as client:
        model = client.get("/v1/identifications").json()["items"][0]["id"]
        answer = client.post("/v1/reports", json={"identification_id": model})
        assert answer.status_code == 202, answer.text
        where = answer.headers["location"]
        wait_for(lambda: client.get(where).json()["status"] == "succeeded", timeout=60)
        document = client.get(f"{where}/content").text
    assert f'href="{address}?identification={model}"' in document
    assert "attacker.example" not in document


@pytest.mark.parametrize("url", ["robots.example", "javascript:alert(1)", "https://a b", "https://x/?y=1", "ftp://x"])
def test_a_public_address_is_one_of_the_web(url: str) -> None:
    with pytest.raises(ValidationError):
        Settings(public_url=url)
