"""Every view, light and dark, wide and narrow: axe finds nothing, nothing is wider than its window, no complaint."""

from __future__ import annotations

import runpy
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import pytest
from support.two_link_arm import URDF

from dynident_client import Client

axe = pytest.importorskip("axe_playwright_python.sync_playwright", reason="these tests need axe-playwright-python")
pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parents[2]
PICTURES = runpy.run_path(str(ROOT / "docs" / "screenshots.py"))


@pytest.fixture(scope="module")
def has(service: str, recordings: tuple[Path, Path]) -> Any:
    """A service with something in every view."""
    client = Client(service)
    robot = client.robots.create("two links", urdf=URDF)
    fit, held = (client.measurements.upload(robot, path) for path in recordings)
    first = client.identifications.create(robot, [fit], validation=[held]).wait()
    found = client.diagnoses.create(first).wait()
    better = client.identifications.extend(first, found.result["recommended"]).wait()
    rival = client.identifications.extend(first, [{"effect": "offset"}]).wait()
    client.diagnoses.create(better).wait()
    design = client.designs.create(robot, kind="random", trajectory={"duration": 8.0, "sampling_rate": 100.0}).wait()
    return PICTURES["Shown"](*(one.id for one in (robot, fit, first, better, rival, design)))


# Colours depend on the scheme alone, places on the size alone.
USUAL = (("wide", "light"), ("narrow", "dark"))


@pytest.mark.parametrize(
    ("size", "scheme"),
    [
        pytest.param(*one, marks=[] if one in USUAL else pytest.mark.thorough)
        for one in product(PICTURES["SIZES"], PICTURES["SCHEMES"])
    ],
)
def test_every_view_is_for_everybody(browser: Any, service: str, has: Any, size: str, scheme: str) -> None:
    page = PICTURES["opened"](browser, service, size, scheme)
    complaints: list[str] = []
    page.on("console", lambda message: message.type == "error" and complaints.append(message.text))
    page.on("pageerror", lambda error: complaints.append(str(error)))
    faults = []
    for name, view in PICTURES["views"](has).items():
        # The small arm has no shape that could come near anything.
        PICTURES["open_view"](page, replace(view, pressed=()) if name == "design" else view)
        found = axe.Axe().run(page)
        for one in found.response["violations"]:
            places = [" ".join(str(part) for part in node["target"]) for node in one["nodes"][:3]]
            faults.append(f"{name}: {one['id']}, {one['help']}: {'; '.join(places)}")
        wider = page.evaluate("document.documentElement.scrollWidth - innerWidth")
        faults += [f"{name}: {wider} pixels wider than its window"] if wider > 0 else []
    page.context.close()
    assert not faults + complaints, "\n".join(faults + complaints)
