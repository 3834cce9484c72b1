"""Every view of the workbench as a picture: `python docs/screenshots.py [--out FOLDER]`.

Tells the tutorial's story to a service of its own, opens each view in Chromium, wide and narrow, light and dark, and
writes docs/screenshots/. Needs `pip install 'dynident[test]'` and a Chromium: its path in CHROMIUM, or in PATH.
"""

from __future__ import annotations

import argparse
import io
import os
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from PIL import Image
from playwright.sync_api import Browser, Page, sync_playwright

from dynident.robot import library_table
from dynident_client import Client

OUT = Path(__file__).resolve().parent / "screenshots"
SIZES = {"wide": (1440, 900), "narrow": (390, 844)}
SCHEMES = ("light", "dark")
TALLEST = 1600
"""Pixels: what is below is the rest of a long table."""
CELL = {"floor": -0.3, "boxes": [{"name": "table", "center": [1.0, 0.0, 0.1], "size": [0.4, 1.0, 0.4]}]}
"""What the arm is kept clear of, in m."""
TRAJECTORY = {"duration": 8.0, "sampling_rate": 100.0}
MOTIONS = {
    "run1": "--harmonics 3 --duration 8 --periods 3 --seed 2",
    "validation": "--duration 16 --seed 5",
}


@dataclass(frozen=True)
class Shown:
    """What a service has that views can show, by id."""

    robot: str
    recording: str
    first: str
    better: str
    rival: str
    design: str


@dataclass(frozen=True)
class View:
    """A view: its address, what is there once it is drawn, what is pressed then, and what the picture is of."""

    address: str
    there: str
    pressed: tuple[str, ...] = ()
    only: str = ""


def views(has: Shown) -> dict[str, View]:
    """Every view by name."""
    model = f"/?identification={has.better}"
    new = f"/?view=new&robot={has.robot}"
    beside = (".arm-beside > summary", ".arm-beside canvas.arm")
    return {
        "import": View(new, "#recordings"),
        "robot": View(new, "#recordings", ("#robot-picture > summary", "#robot-picture canvas.arm"), "#robot-picture"),
        "recording": View(f"/?view=recording&measurement={has.recording}", "#signals-title"),
        "verdict": View(f"{model}&tab=verdict", "#fitness-summary"),
        "compare": View(f"{model}&tab=compare", "#torque-chart canvas"),
        "arm": View(f"{model}&tab=compare", "#torque-chart canvas", beside, ".arm-beside"),
        "missing": View(f"/?identification={has.first}&tab=missing", "#verdict"),
        "ladder": View(f"{model}&tab=missing", "#missing-title"),
        "parameters": View(f"{model}&tab=parameters", "#parameters table"),
        "trust": View(f"{model}&tab=trust", "#validations-title"),
        "data": View(f"{model}&tab=data", "#data-table"),
        "design": View(
            f"/?view=design&robot={has.robot}&design={has.design}", "#design-again", ("#nearest-now button",)
        ),
        "campaigns": View("/?view=campaigns", "#campaign-form"),
        "changes": View(f"/?view=changes&identification={has.better}", "#days select"),
        "models": View("/?view=models", "#models-table"),
        "two-models": View(f"/?view=models&pair={has.better},{has.rival}", "#overlay-torque canvas"),
        "robots": View("/?view=robots", "#robots-table"),
        "recordings": View("/?view=recordings", "#recordings-table"),
        "jobs": View("/?view=jobs", "#jobs-table"),
    }


def tell(client: Client, folder: Path) -> Shown:
    """The tutorial's story over HTTP."""
    for name, options in MOTIONS.items():
        motion, hidden = f"{name}.motion.csv", "--effects gravity_compensator@shoulder_lift_joint"
        _run(folder, f"design ur10 --kind random {options} --rate 200 --surroundings nothing.json -o {motion}")
        seed = 0 if name == "run1" else 1
        _run(folder, f"simulate ur10 --trajectory {motion} {hidden} --rate 250 --seed {seed} -o {name}.csv")
    robot = client.robots.create("UR10", modified_dh=library_table("ur10"))
    run1, validation = (client.measurements.upload(robot, folder / f"{name}.csv") for name in MOTIONS)
    first = client.identifications.create(robot, [run1], validation=[validation]).wait()
    found = client.diagnoses.create(first).wait()
    better = client.identifications.extend(first, found.result["recommended"]).wait()
    spring = [{"effect": "joint_spring", "joints": ["shoulder_lift_joint"]}]
    rival = client.identifications.extend(first, spring).wait()
    client.diagnoses.create(better).wait()
    wanted = {"kind": "random", "trajectory": TRAJECTORY, "random_trajectories": 20}
    design = client.designs.create(robot, **wanted, surroundings=CELL).wait()
    return Shown(*(one.id for one in (robot, run1, first, better, rival, design)))


def _run(folder: Path, words: str) -> None:
    (folder / "nothing.json").write_text('{"self_collision": false, "assume_floor": false}', encoding="utf-8")
    command = [str(Path(sys.executable).with_name("dynident")), *words.split()]
    subprocess.run(command, cwd=folder, check=True, stdout=subprocess.DEVNULL)


@contextmanager
def served(folder: Path) -> Iterator[str]:
    """A service in a process of its own; gives its address."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    command = [str(Path(sys.executable).with_name("dynident")), "serve", "--port", str(port), "--data-dir", str(folder)]
    with (folder.parent / "service.log").open("wb") as log:
        process = subprocess.Popen(command, stdout=log, stderr=subprocess.STDOUT)
        try:
            while not _answers(port):
                if process.poll() is not None:
                    sys.exit((folder.parent / "service.log").read_text(encoding="utf-8"))
                time.sleep(0.1)
            yield f"http://127.0.0.1:{port}"
        finally:
            process.terminate()
            process.wait(60)


def _answers(port: int) -> bool:
    with socket.socket() as tried:
        return tried.connect_ex(("127.0.0.1", port)) == 0


def open_view(page: Page, view: View) -> None:
    """A view, once all of it is drawn."""
    page.goto(view.address)
    page.locator(view.there).first.wait_for(timeout=60_000)
    for one in view.pressed:
        page.locator(one).first.click(timeout=60_000)
    # What was pressed may be far down, and a bar that sticks to the window's top with it.
    page.evaluate("scrollTo(0, 0)")
    page.wait_for_load_state("networkidle")
    page.wait_for_function("!document.querySelector('main')?.innerText.match(/(Loading|Comparing|Judging[^.]*) …/)")
    # What is drawn after the last answer.
    page.wait_for_timeout(300)


def opened(browser: Browser, url: str, size: str, scheme: Any) -> Page:
    """A page of a size in a colour scheme."""
    width, height = SIZES[size]
    context = browser.new_context(base_url=url, viewport={"width": width, "height": height}, color_scheme=scheme)
    return context.new_page()


def taken(page: Page, view: View) -> bytes:
    """The picture of a view that is open."""
    return page.locator(view.only).screenshot() if view.only else page.screenshot(full_page=True)


def photograph(url: str, has: Shown, out: Path) -> None:
    """All views, four pictures each."""
    out.mkdir(parents=True, exist_ok=True)
    program = os.environ.get("CHROMIUM") or shutil.which("chromium") or shutil.which("chromium-browser")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=["--no-sandbox", "--disable-gpu"])
        for size in SIZES:
            for scheme in SCHEMES:
                page = opened(browser, url, size, scheme)
                for name, view in views(has).items():
                    open_view(page, view)
                    drawn = Image.open(io.BytesIO(taken(page, view)))
                    wide, tall = drawn.size
                    drawn.crop((0, 0, wide, min(tall, TALLEST))).save(out / f"{name}-{size}-{scheme}.webp", quality=45)
                page.context.close()
        browser.close()


def main() -> None:
    """Tell, open, draw."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--out", type=Path, default=OUT)
    out = parser.parse_args().out
    with TemporaryDirectory() as temporary:
        folder = Path(temporary)
        with served(folder / "data") as url:
            photograph(url, tell(Client(url), folder), out)


if __name__ == "__main__":
    main()
