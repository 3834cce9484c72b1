"""What serves the workbench: no browser is needed."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from fastapi.testclient import TestClient

from dynident_service import workbench
from dynident_service.app import create_app
from dynident_service.settings import Settings

MOST_LINES = 300
OWN = sorted(path for path in workbench.FOLDER.rglob("*") if path.suffix in (".js", ".css", ".html"))
OWN = [path for path in OWN if "vendor" not in path.parts]


@pytest.fixture
def client(tmp_path: Path) -> TestClient:
    settings = Settings(data_dir=tmp_path, workers=1, api_keys=["a-key-of-the-test"], require_keys=True)  # type: ignore[list-item]
    # Not started: the page needs neither database nor engine.
    return TestClient(create_app(settings), "http://127.0.0.1", raise_server_exceptions=False)


def test_the_page_is_there_without_a_key_and_lets_nothing_in_from_elsewhere(client: TestClient) -> None:
    answer = client.get("/")
    assert answer.status_code == 200
    assert answer.headers["content-type"].startswith("text/html")
    assert "default-src 'self'" in answer.headers["content-security-policy"]
    assert "unsafe" not in answer.headers["content-security-policy"]
    assert client.head("/").status_code == 200


@pytest.mark.parametrize("path", OWN, ids=lambda path: path.name)
def test_every_file_of_the_page_is_served_with_its_type(client: TestClient, path: Path) -> None:
    if path.name == "index.html":
        return
    answer = client.get(f"{workbench.PREFIX}/{path.relative_to(workbench.FOLDER).as_posix()}")
    assert answer.status_code == 200
    kinds = {".js": "javascript", ".css": "css"}
    assert kinds[path.suffix] in answer.headers["content-type"]
    assert "default-src 'self'" in answer.headers["content-security-policy"]


def test_everything_that_a_file_names_is_there() -> None:
    for path in OWN:
        text = path.read_text()
        for name in re.findall(r'from "(\.{1,2}/[^"]+)"', text):
            assert (path.parent / name).is_file(), (path.name, name)
        for name in re.findall(r'(?:src|href)="/workbench/([^"]+)"', text):
            assert (workbench.FOLDER / name).is_file(), (path.name, name)


def test_no_file_of_the_page_names_another_host_or_grows_too_long() -> None:
    for path in OWN:
        text = path.read_text()
        hosts = set(re.findall(r"https?://([^/\"'\s]+)", text))
        assert hosts <= {"www.w3.org"}, path.name
        assert len(text.splitlines()) < MOST_LINES, path.name


def test_what_is_vendored_has_its_licence() -> None:
    for folder in (workbench.FOLDER / "vendor").iterdir():
        assert "MIT License" in (folder / "LICENSE").read_text()


def test_the_data_still_needs_the_key(client: TestClient) -> None:
    assert client.get("/v1/robots").status_code == 401
    assert client.get("/workbenches").status_code == 401


@pytest.mark.parametrize("path", ["/workbench/nothing.js", "/workbench/%2e%2e/app.py"])
def test_a_file_that_is_not_of_the_page_is_a_problem(client: TestClient, path: str) -> None:
    answer = client.get(path, headers={"x-api-key": "a-key-of-the-test"})
    assert answer.status_code == 404
    assert answer.headers["content-type"] == "application/problem+json"


def test_the_page_is_no_part_of_the_contract(client: TestClient) -> None:
    paths = client.app.openapi()["paths"]  # type: ignore[attr-defined]
    assert all(path.startswith("/v1/") or path in ("/healthz", "/readyz", "/metrics") for path in paths)
