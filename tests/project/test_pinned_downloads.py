"""What builds and runs the project from elsewhere is named so that nobody can change it: by digest or commit."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).resolve().parents[2]
DIGEST = re.compile(r"[\w./-]+:[\w.-]+@sha256:[0-9a-f]{64}")
DOCKERFILE = (ROOT / "docker" / "Dockerfile").read_text(encoding="utf-8")
WORKFLOWS = sorted((ROOT / ".github" / "workflows").glob("*.yml"))


def test_the_image_is_built_on_one_that_is_pinned_and_on_nothing_else() -> None:
    (base,) = re.findall(r"^ARG BASE=(\S+)$", DOCKERFILE, re.MULTILINE)
    assert DIGEST.fullmatch(base)
    assert set(re.findall(r"^FROM (\S+)", DOCKERFILE, re.MULTILINE)) == {"${BASE}"}


def test_what_pip_puts_into_the_image_has_a_version_and_the_rest_comes_from_the_lock_file() -> None:
    for asked in re.findall(r"pip install ([^&\n]+)", DOCKERFILE):
        assert all("==" in one for one in asked.split())
    assert DOCKERFILE.count("uv sync") == DOCKERFILE.count("--frozen") == 2


def test_every_image_beside_ours_is_pinned_by_digest_with_its_tag() -> None:
    services = yaml.safe_load((ROOT / "docker" / "compose.yaml").read_text(encoding="utf-8"))["services"]
    foreign = {one["image"] for one in services.values()} - {"dynident"}
    assert len(foreign) == 3
    for image in foreign:
        assert DIGEST.fullmatch(image), image


@pytest.mark.parametrize("workflow", WORKFLOWS, ids=lambda path: path.stem)
def test_every_action_is_pinned_by_its_commit_and_says_which_version_that_is(workflow: Path) -> None:
    used = re.findall(r"uses: (.+)", workflow.read_text(encoding="utf-8"))
    assert used
    for one in used:
        assert re.fullmatch(r"[\w-]+/[\w-]+@[0-9a-f]{40} # v\d+\.\d+\.\d+", one), one
