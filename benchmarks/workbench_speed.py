"""How long the workbench takes to show what was asked for, in a real Chromium beside a service of its own.

    python benchmarks/workbench_speed.py [--repeats 5] [--samples 1000000] [--models 200] [--recordings 40]

From a click until what it shows is drawn: the first view of a browser that knows nothing yet, a tab, a joint, an
effect that is added, a stretch of a recording of a million samples of seven joints; and the same lists once the
service holds many models and recordings. A design with a budget of 15 s until it is told. Needs
`pip install 'dynident[test]'` and a Chromium: its path in CHROMIUM, or in PATH.
"""

from __future__ import annotations

import argparse
import os
import shutil
import statistics
import sys
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from common import Samples, show, simulated_samples
from playwright.sync_api import Browser, Page, sync_playwright
from service_beside import served

from dynident.robot import library_table, robot_from_library, to_pinocchio
from dynident_client import Client
from dynident_client.computation_options import Trajectory
from dynident_client.resource_objects import Identification, Robot

ALLOWED = {
    "first view of an empty service": 1000.0,
    "effect added, until its errors are there": 300.0,
    "another tab": 150.0,
    "another joint": 150.0,
    "zoom, drawn": 100.0,
}
"""ms"""
MOTION: Trajectory = {"duration": 10.0, "sampling_rate": 100.0}
SETTLED = 10.0
"""Seconds after which a service that began has nothing to do."""
RUN_TO = """([act, there]) => new Promise((done, failed) => {
  const begun = performance.now();
  const shown = new Function(`return (${there})`);
  new Function(act)();
  const look = () => {
    // One frame more, so that what is in the page is on the screen.
    if (shown()) requestAnimationFrame(() => done(performance.now() - begun));
    else if (performance.now() - begun > 60000) failed(new Error(`never: ${there}`));
    else requestAnimationFrame(look);
  };
  look();
})"""
"""Does something and gives the ms until something is there."""
SEEN = """window.seenAfter = new Promise((seen) => {
  const look = () => {
    const found = document.querySelector('THERE');
    // One frame more, so that what is in the page is on the screen.
    if (found?.getClientRects().length) requestAnimationFrame(() => seen(performance.now()));
    else requestAnimationFrame(look);
  };
  requestAnimationFrame(look);
})"""
SCRIPTS = """() => performance.getEntriesByType('resource').filter((one) => one.name.endsWith('.js'))
  .reduce((sum, one) => sum + one.decodedBodySize, 0) / 1000"""


@dataclass
class Watch:
    """Durations in ms, by what was done."""

    seen: dict[str, list[float]] = field(default_factory=dict)

    def note(self, what: str, milliseconds: float) -> None:
        self.seen.setdefault(what, []).append(milliseconds)

    def table(self) -> list[tuple[str, ...]]:
        rows: list[tuple[str, ...]] = [("what", "middle", "slowest", "asked")]
        for what, each in self.seen.items():
            asked = next((f"{limit:.0f} ms" for start, limit in ALLOWED.items() if what.startswith(start)), "")
            rows.append((what, f"{statistics.median(each):.0f} ms", f"{max(each):.0f} ms", asked))
        return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--samples", type=int, default=1_000_000)
    parser.add_argument("--models", type=int, default=200)
    parser.add_argument("--recordings", type=int, default=40)
    parser.add_argument("--design", type=float, default=15.0, help="budget of the design in s; 0: none is made")
    given = parser.parse_args()
    chromium = os.environ.get("CHROMIUM") or shutil.which("chromium") or shutil.which("chromium-browser")
    if chromium is None:
        sys.exit("there is no Chromium on this machine: put its path into CHROMIUM")
    watch = Watch()
    with tempfile.TemporaryDirectory() as name, sync_playwright() as started:
        folder = Path(name)
        browser = started.chromium.launch(executable_path=chromium, args=["--no-sandbox", "--disable-gpu"])
        with served(folder / "data") as service, Client(service.url) as client:
            url = service.url
            cold(browser, url, watch, given.repeats)
            ur10 = client.robots.create("UR10", modified_dh=library_table("ur10"))
            model = small_model(client, ur10, folder)
            tabs_and_joints(browser, url, model.id, watch, given.repeats)
            adding(browser, url, model.id, watch, given.repeats)
            if given.design:
                begun = time.perf_counter()
                client.designs.create(ur10, trajectory=MOTION, time_budget=given.design).wait()
                watch.note(f"a design with a budget of {given.design:.0f} s", since(begun))
            large(client, browser, url, folder, watch, given)
            many(client, browser, url, folder, watch, given)
        browser.close()
    show(f"The workbench, {given.repeats} times each", watch.table())


def since(begun: float) -> float:
    """ms of the clock."""
    return 1000 * (time.perf_counter() - begun)


def fresh(browser: Browser, url: str) -> Page:
    """A browser that knows nothing yet."""
    return browser.new_context(base_url=url, viewport={"width": 1440, "height": 900}).new_page()


def view(browser: Browser, url: str, address: str, there: str, watch: Watch, what: str, repeats: int) -> None:
    """Note how long a view takes in a browser that knows nothing yet, from the address until something is there."""
    for _ in range(repeats):
        page = fresh(browser, url)
        watch.note(what, until_there(page, address, there))
        page.context.close()


def until_there(page: Page, address: str, there: str) -> float:
    """ms from a navigation until an element is on the screen, by the page's own clock: who asks from outside waits."""
    page.add_init_script(script=SEEN.replace("THERE", there))
    page.goto(address, wait_until="commit")
    return float(page.evaluate("window.seenAfter"))


def cold(browser: Browser, url: str, watch: Watch, repeats: int) -> None:
    view(browser, url, "/", "main h1", watch, "right after the service began", 1)
    # It loads the science beside what it answers.
    time.sleep(SETTLED)
    view(browser, url, "/", "main h1", watch, "first view of an empty service", repeats)


def small_model(client: Client, robot: Robot, folder: Path) -> Identification:
    """Twenty seconds of an arm, and a model of it with held-out data."""
    arm = to_pinocchio(robot_from_library("ur10"))
    runs = [
        client.measurements.upload(robot, written(simulated_samples(arm, 4000, 200.0, seed=seed), folder / f"{seed}"))
        for seed in (1, 2)
    ]
    model = client.identifications.create(robot, runs[:1], validation=runs[1:]).wait()
    client.diagnoses.create(model).wait()
    return model


def written(samples: Samples, path: Path) -> Path:
    """A recording as a file."""
    path = path.with_suffix(".parquet")
    columns = {"t": samples.t}
    for kind, values in (("q", samples.q), ("tau", samples.tau)):
        columns |= {f"{kind}{k + 1}": column for k, column in enumerate(np.ascontiguousarray(values.T))}
    pq.write_table(pa.table(columns), path)
    return path


def timed(page: Page, act: str, there: str) -> float:
    """ms until something is there after something was done."""
    return float(page.evaluate(RUN_TO, [act, there]))


def tabs_and_joints(browser: Browser, url: str, model: str, watch: Watch, repeats: int) -> None:
    for _ in range(repeats):
        page = fresh(browser, url)
        address = f"/?identification={model}&tab=verdict"
        watch.note("first view of a model", until_there(page, address, "#fitness-summary"))
        page.wait_for_load_state("networkidle")
        for tab, there in (("compare", "#torque-chart canvas"), ("parameters", "#parameters table")):
            shown = f"document.querySelector('{there}')?.offsetParent"
            watch.note(f"another tab: {tab}, for the first time", timed(page, click(f"#tab-{tab}"), shown))
            page.wait_for_load_state("networkidle")
        for tab, there in (("verdict", "#fitness-summary"), ("compare", "#torque-chart canvas")):
            shown = f"document.querySelector('{there}')?.offsetParent"
            watch.note("another tab, again", timed(page, click(f"#tab-{tab}"), shown))
        watch.note("another joint", timed(page, joint_button(3), chosen(3)))
        watch.note("script until here, kB", float(page.evaluate(SCRIPTS)))
        page.context.close()


def click(what: str) -> str:
    return f"document.querySelector({what!r}).click()"


def joint_button(number: int) -> str:
    return click(f"[aria-labelledby=torque-title] .choices button:nth-child({number})")


def chosen(number: int) -> str:
    return f"document.querySelectorAll('.joint-row')[{number - 1}].querySelector('#torque-chart canvas')"


def adding(browser: Browser, url: str, model: str, watch: Watch, repeats: int) -> None:
    """Add what the diagnosis offers first, each time to the same model."""
    page = fresh(browser, url)
    for _ in range(repeats):
        page.goto(f"/?identification={model}&tab=missing")
        page.locator("#diagnosis button").first.wait_for()
        page.wait_for_load_state("networkidle")
        act = "[...document.querySelectorAll('#diagnosis button')].find((one) => /^Add/.test(one.innerText)).click()"
        there = f"document.querySelector('#ladder-joints') && !location.search.includes('{model}')"
        watch.note("effect added, until its errors are there", timed(page, act, there))
    page.context.close()


def large(client: Client, browser: Browser, url: str, folder: Path, watch: Watch, given: argparse.Namespace) -> None:
    """A recording of a million samples, and a model of it."""
    samples = simulated_samples(to_pinocchio(robot_from_library("franka_panda")), given.samples, 1000.0, seed=3)
    panda = client.robots.create("Panda", modified_dh=library_table("franka_panda"))
    file = written(samples, folder / "large")
    begun = time.perf_counter()
    run = client.measurements.upload(panda, file)
    watch.note(f"{given.samples:,} samples x 7 joints: read", since(begun))
    begun = time.perf_counter()
    model = client.identifications.create(panda, [run]).wait()
    watch.note(f"{given.samples:,} samples x 7 joints: identified", since(begun))
    address, there = f"/?identification={model.id}&tab=compare", "#torque-chart canvas"
    view(browser, url, address, there, watch, "all samples of all joints, compared for the first time", 1)
    view(browser, url, address, there, watch, "all samples of all joints", given.repeats)
    page = fresh(browser, url)
    page.goto(address)
    page.locator(there).wait_for()
    page.wait_for_load_state("networkidle")
    for _ in range(given.repeats):
        before = page.locator("#zoom-state").inner_text()
        # It is drawn in the next frame; what was read before it is there at once.
        watch.note("zoom, drawn", timed(page, wheel(), "true"))
        told = f"document.querySelector('#zoom-state').innerText !== {before!r}"
        watch.note("zoom, every sample of the stretch read", timed(page, wheel(), told))
        page.wait_for_load_state("networkidle")
        watch.note("another joint of a million samples", timed(page, joint_button(2), chosen(2)))
        timed(page, joint_button(1), chosen(1))
    page.context.close()
    view(browser, url, f"/?view=recording&measurement={run.id}", "#signals-title ~ * canvas", watch, "raw signals", 2)


def wheel() -> str:
    """The wheel turned over the middle of the chosen joint's chart."""
    return (
        "const over = document.querySelector('#torque-chart .u-over'); const box = over.getBoundingClientRect();"
        "over.dispatchEvent(new WheelEvent('wheel', { deltaY: -100, bubbles: true, cancelable: true, "
        "clientX: box.left + box.width / 2, clientY: box.top + box.height / 2 }))"
    )


def many(client: Client, browser: Browser, url: str, folder: Path, watch: Watch, given: argparse.Namespace) -> None:
    """Views of a service that holds much."""
    panda = client.robots.create("Panda", modified_dh=library_table("franka_panda"))
    samples = simulated_samples(to_pinocchio(robot_from_library("franka_panda")), 62_000, 1000.0, seed=4)
    file = written(samples, folder / "many")
    runs = [client.measurements.upload(panda, file, name=f"night {k}") for k in range(given.recordings)]
    models = [client.identifications.create(panda, [runs[k % len(runs)]]) for k in range(given.models)]
    for model in models:
        model.wait()
    held = f"of {given.models} models, {given.recordings} recordings"
    for name, there in (("models", "#models-table"), ("recordings", "#recordings-table"), ("jobs", "#jobs-table")):
        view(browser, url, f"/?view={name}", f"{there} tbody tr", watch, f"{name}, {held}", given.repeats)
    last = models[-1].id
    view(browser, url, "/", "main h1", watch, f"first view, {held}", given.repeats)
    view(browser, url, f"/?identification={last}", "#fitness-summary", watch, f"a model, {held}", given.repeats)
    address = f"/?identification={last}&tab=compare"
    view(browser, url, address, "#torque-chart canvas", watch, f"compared for the first time, {held}", 1)
    view(browser, url, address, "#torque-chart canvas", watch, f"compared, {held}", given.repeats)


if __name__ == "__main__":
    main()
