"""The page about the workbench shows every view, in a picture that the script makes."""

from __future__ import annotations

import re
import runpy
from pathlib import Path

DOCS = Path(__file__).resolve().parents[2] / "docs"
SCRIPT = runpy.run_path(str(DOCS / "screenshots.py"))


def test_every_view_is_shown_and_has_its_four_pictures() -> None:
    names = list(SCRIPT["views"](SCRIPT["Shown"](*"abcdef")))
    shown = re.findall(r"\]\(screenshots/(.+)-wide-light\.webp\)", (DOCS / "workbench.md").read_text(encoding="utf-8"))
    assert sorted(shown) == sorted(names)
    kinds = [f"{size}-{scheme}" for size in SCRIPT["SIZES"] for scheme in SCRIPT["SCHEMES"]]
    there = {path.name for path in (DOCS / "screenshots").glob("*")}
    assert there == {f"{name}-{kind}.webp" for name in names for kind in kinds}
