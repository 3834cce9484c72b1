from __future__ import annotations

import contextlib
import os
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from support.two_link_arm import write_recording

from dynident_service.settings import Settings

if TYPE_CHECKING:
    from playwright.sync_api import Browser, ConsoleMessage, Page

sys.path.append(str(Path(__file__).parents[1] / "service"))
from service_helpers import SCIENCE, serving

SERVICE_TESTS = Path(__file__).parents[1] / "service"
CHROMIUM = os.environ.get("CHROMIUM") or shutil.which("chromium") or shutil.which("chromium-browser")
# Chromium draws the list under its address bar in two processes of their own for every page, and keeps another ready:
# together they cost twice what the page does. Only the last list of disabled features counts: Playwright's is in it.
DISABLED_FEATURES = (
    "AvoidCorsURLLoaderRestartOnRedirect",
    "AvoidUnnecessaryBeforeUnloadCheckSync",
    "DestroyProfileOnBrowserClose",
    "HttpsFirstBalancedModeAutoEnable",
    "HttpsUpgrades",
    "LensOverlay",
    "MediaRouter",
    "NetworkTimeServiceQuerying",
    "OptimizationHints",
    "PaintHolding",
    "PreconnectToSearch",
    "SpareRendererForSitePerProcess",
    "ThirdPartyStoragePartitioning",
    "WebUIOmniboxAimPopup",
    "WebUIOmniboxPopup",
)
FLAGS = [
    "--no-sandbox",
    "--disable-features=" + ",".join(DISABLED_FEATURES),
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
]

playwright = pytest.importorskip("playwright.sync_api", reason="the browser tests need playwright")
# On a machine that is busy with other tests the page may take its time.
playwright.expect.set_options(timeout=60_000)


@dataclass
class Heard:
    """What went wrong in the browser, and whom it asked."""

    complaints: list[str] = field(default_factory=list)
    hosts: set[str] = field(default_factory=set)


@pytest.fixture(scope="session", autouse=True)
def _the_science_is_left_to_nobody() -> Iterator[None]:
    yield
    SCIENCE.close()


@contextlib.contextmanager
def beside(folder: Path, **more: Any) -> Iterator[str]:
    """Run a service in this process, with the science that is loaded once for all of them; gives its address.

    `started` is the other way, as users start it: it takes as long as many a test.
    """
    with serving(Settings(data_dir=folder, workers=2, port=0, log_level="warning", **more)) as address:
        yield address


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """A service of its own; gives its address."""
    with beside(tmp_path_factory.mktemp("workbench")) as address:
        yield address


@pytest.fixture
def locked_service(tmp_path: Path) -> Iterator[str]:
    """A service that asks for a key."""
    with beside(tmp_path, require_keys=True, api_keys=["open-sesame"]) as address:
        yield address


def free_port() -> int:
    """A port that nobody listens on."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return int(free.getsockname()[1])


@contextlib.contextmanager
def started(folder: Path, port: int | None = None, *, science: bool = True) -> Iterator[str]:
    """Run a service in a process of its own, as users start it; without the science where it is to do nothing."""
    port = port or free_port()
    settings = {"DYNIDENT_PORT": str(port), "DYNIDENT_DATA_DIR": str(folder), "DYNIDENT_WORKERS": "2"}
    program = ("-m", "dynident_service") if science else (str(SERVICE_TESTS / "service_without_science.py"),)
    command = [sys.executable, *program]
    with (folder / "log.txt").open("wb") as log:
        process = subprocess.Popen(command, env={**os.environ, **settings}, stdout=log, stderr=subprocess.STDOUT)
        try:
            _wait_until_it_answers(process, port, folder / "log.txt")
            yield f"http://127.0.0.1:{port}"
        finally:
            process.terminate()
            process.wait(30)


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    if CHROMIUM is None:
        pytest.skip("there is no chromium on this machine")
    with playwright.sync_playwright() as started:
        opened = started.chromium.launch(executable_path=CHROMIUM, args=FLAGS, headless=True)
        yield opened
        opened.close()


@pytest.fixture
def heard() -> Heard:
    return Heard()


@pytest.fixture
def page(browser: Browser, service: str, heard: Heard) -> Iterator[Page]:
    """A page of the service, listened to."""
    yield from _listened_to(browser, service, heard)


@pytest.fixture
def first_page(browser: Browser, tmp_path: Path, heard: Heard) -> Iterator[Page]:
    """A page of a service that nobody has used yet, listened to."""
    (tmp_path / "service").mkdir()
    with beside(tmp_path / "service") as address:
        yield from _listened_to(browser, address, heard)


def _listened_to(browser: Browser, service: str, heard: Heard) -> Iterator[Page]:
    opened = listened_page(browser, service, heard)
    yield opened
    opened.context.close()


def listened_page(browser: Browser, service: str, heard: Heard, width: int = 1280) -> Page:
    """A page in a browser that knows nothing yet, listened to."""
    context = browser.new_context(base_url=service, viewport={"width": width, "height": 900})
    opened = context.new_page()
    opened.set_default_timeout(60_000)
    opened.on("console", lambda message: _note(heard, message))
    # Chromium is told well before the first one opens that files are chosen here, and not by a dialog of its own.
    opened.on("filechooser", lambda _: None)
    opened.on("pageerror", lambda error: heard.complaints.append(str(error)))
    opened.on("request", lambda request: heard.hosts.add(request.url.split("/")[2]))
    return opened


@pytest.fixture(scope="session")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Two recordings of the arm with the hidden spring: to identify from, and to hold out."""
    folder = tmp_path_factory.mktemp("recordings")
    return write_recording(folder / "exciting.csv", seed=1), write_recording(folder / "another.csv", seed=2)


def _note(heard: Heard, message: ConsoleMessage) -> None:
    # The browser itself says of every answer of 400 and above that it failed to load; the page shows those in words.
    if message.type in ("error", "warning") and "Failed to load resource" not in message.text:
        heard.complaints.append(message.text)


def _wait_until_it_answers(process: subprocess.Popen[bytes], port: int, log: Path) -> None:
    end = time.monotonic() + 60
    while time.monotonic() < end:
        with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port), 1):
            return
        assert process.poll() is None, log.read_text()
        time.sleep(0.1)
    raise AssertionError(log.read_text())
