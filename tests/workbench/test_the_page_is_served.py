"""What serves the workbench: no browser is needed."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest
from fastapi.testclient import TestClient

from dynident_service import workbench
from dynident_service.app import create_app
from dynident_service.settings import Settings
from dynident_service.workbench import PageFiles

MOST_LINES = 300
OWN = sorted(path for path in workbench.FOLDER.rglob("*") if path.suffix in (".js", ".css", ".html"))
OWN = [path for path in OWN if "vendor" not in path.parts]


@pytest.fixture(scope="module")
def client(tmp_path_factory: pytest.TempPathFactory) -> TestClient:
    settings = Settings(
        data_dir=tmp_path_factory.mktemp("page"), workers=1, api_keys=["a-key-of-the-test"], require_keys=True
    )  # type: ignore[list-item]
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


def test_a_browser_keeps_the_files_and_asks_for_the_page_anew_which_names_another_version_once_a_file_changes(
    client: TestClient, tmp_path: Path
) -> None:
    page = client.get("/")
    assert page.headers["cache-control"] == "no-cache"
    named = re.findall(rf'(?:src|href)="({workbench.PREFIX}/[^"]+)"', page.text)
    for path in named:
        answer = client.get(path, follow_redirects=False)
        assert (answer.status_code, "immutable" in answer.headers["cache-control"]) == (200, True), path
    # What an older page asks for is answered by the file as it is now.
    assert client.get(f"{workbench.PREFIX}/0123456789abcdef/js/app.js", follow_redirects=False).status_code == 307

    copied = Path(shutil.copytree(workbench.FOLDER, tmp_path / "static"))
    before = PageFiles.read(copied, workbench.PREFIX).version
    assert before in page.text
    with (copied / "js" / "app.js").open("a") as file:
        file.write("// more")
    assert PageFiles.read(copied, workbench.PREFIX).version != before


def test_all_modules_that_the_first_view_imports_are_asked_for_at_once(client: TestClient) -> None:
    preloaded = re.findall(r'modulepreload" href="/workbench/[0-9a-f]+/([^"]+)"', client.get("/").text)
    for name in preloaded:
        text = (workbench.FOLDER / name).read_text()
        for relative in re.findall(r'^import .*from "(\.{1,2}/[^"]+)"', text, re.MULTILINE):
            path = (workbench.FOLDER / name).parent / relative
            assert path.resolve().relative_to(workbench.FOLDER).as_posix() in preloaded, (name, relative)
    assert "js/lists/models_page.js" not in preloaded


def test_the_page_comes_compressed_to_who_understands_that(client: TestClient) -> None:
    plain, small = (
        client.get("/workbench/js/app.js", headers={"accept-encoding": one}) for one in ("identity", "gzip")
    )
    assert plain.content == small.content == (workbench.FOLDER / "js" / "app.js").read_bytes()
    assert int(small.headers["content-length"]) < 0.6 * int(plain.headers["content-length"])


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


def test_every_kind_of_box_has_its_colours() -> None:
    texts = {path: path.read_text(encoding="utf-8") for path in OWN}
    kinds = {kind for text in texts.values() for kind in re.findall(r'"box ([a-z]+)', text)}
    assert kinds
    assert [kind for kind in kinds if f".box.{kind} {{ background" not in "".join(texts.values())] == []
