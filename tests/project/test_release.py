"""A release by one command: version, changelog, citation, wheel and tag, or a word why not."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
# What builds the wheel needs minutes, and is tried by itself.
BUILD = "#!/bin/sh\nmkdir -p dist && cp src/dynident/version.py dist/built\n"


def git(folder: Path, *words: str) -> str:
    command = ["git", "-c", "user.name=a", "-c", "user.email=a@b", *words]
    return subprocess.run(command, cwd=folder, check=True, capture_output=True, text=True).stdout


@pytest.fixture
def project(tmp_path: Path) -> Path:
    """As much of the project as a release changes, committed."""
    folder = tmp_path / "project"
    for name in (".ci/release", "CHANGELOG.md", "CITATION.cff", "src/dynident/version.py", ".gitignore"):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, folder / name)
    (folder / ".ci" / "wheels").write_text(BUILD)
    (folder / ".ci" / "wheels").chmod(0o755)
    (folder / "CHANGELOG.md").write_text("# Changelog\n\n## [Unreleased]\n\n### Added\n\n- A robot that dances.\n")
    git(folder, "init", "-q")
    git(folder, "config", "user.name", "a")
    git(folder, "config", "user.email", "a@b")
    git(folder, "add", "-A")
    git(folder, "commit", "-qm", "all")
    return folder


def release(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([folder / ".ci" / "release", *words], cwd=folder, capture_output=True, text=True)


def test_one_command_states_the_version_everywhere_builds_and_tags(project: Path) -> None:
    before = git(project, "rev-parse", "HEAD")
    made = release(project, "7.8.9")
    assert made.returncode == 0, made.stderr
    assert git(project, "rev-parse", "v7.8.9^").strip() == before.strip()
    told = {name: git(project, "show", f"v7.8.9:{name}") for name in ("CHANGELOG.md", "CITATION.cff")}
    assert "## [Unreleased]\n\n## [7.8.9] - 20" in told["CHANGELOG.md"]
    assert "\nversion: 7.8.9\ndate-released: 20" in told["CITATION.cff"]
    assert (project / "dist" / "built").read_text().endswith('__version__ = "7.8.9"\n')
    # Nothing but the tag is left behind, and a second release of the same version is none.
    assert git(project, "status", "--porcelain") == ""
    assert len(git(project, "worktree", "list").splitlines()) == 1
    assert "v7.8.9 is there already" in release(project, "7.8.9").stderr


def test_the_next_release_replaces_the_date_of_the_one_before(project: Path) -> None:
    assert release(project, "7.8.9").returncode == 0
    git(project, "merge", "-q", "--ff-only", "v7.8.9")
    assert "tells of no change" in release(project, "7.9.0").stderr
    page = project / "CHANGELOG.md"
    page.write_text(page.read_text().replace("## [Unreleased]\n", "## [Unreleased]\n\n- It sings, too.\n"))
    git(project, "commit", "-qam", "song")
    assert release(project, "7.9.0").returncode == 0
    assert git(project, "show", "v7.9.0:CITATION.cff").count("date-released") == 1


@pytest.mark.parametrize(
    ("words", "spoilt", "told"),
    [
        ((), "", "say which version"),
        (("v1",), "", "say which version"),
        (("7.8.9",), "CHANGELOG.md", "not committed"),
    ],
)
def test_what_cannot_be_released_is_refused_and_nothing_tagged(
    project: Path, words: tuple[str, ...], spoilt: str, told: str
) -> None:
    if spoilt:
        (project / spoilt).write_text("lost\n")
    made = release(project, *words)
    assert made.returncode == 1
    assert told in made.stderr
    assert git(project, "tag") == ""
