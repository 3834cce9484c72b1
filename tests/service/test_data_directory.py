"""The data directory is its owner's alone, is cleared of what a killed service left, and has to be writable."""

from __future__ import annotations

import os
import stat
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from fastapi.testclient import TestClient
from service_helpers import app_of, wait_for
from typer.testing import CliRunner

from dynident_cli.program_and_exit_codes import app
from dynident_service import new_key
from dynident_service.settings import Settings
from dynident_service.storage.data_directory import mark_in_use, prepare_data_directory, restrict_file_permissions

UNWRITABLE = Path("/proc/self")
"""Nobody makes files there, not even root, who may write wherever modes alone forbid it."""
KEY = "a" * 64


@pytest.fixture(autouse=True)
def _usual_umask() -> Iterator[None]:
    before = os.umask(0o022)
    yield
    os.umask(before)


def mode_of(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


def test_a_new_data_directory_is_for_its_owner_alone(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    folder = tmp_path / "new" / "data"
    prepare_data_directory(folder)
    assert mode_of(folder) == 0o700
    assert not caplog.records


def test_one_that_others_may_enter_is_told_at_the_start(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    tmp_path.chmod(0o755)
    prepare_data_directory(tmp_path)
    assert [record.levelname for record in caplog.records] == ["WARNING"]
    assert f"chmod o= {tmp_path}" in caplog.text


def test_what_the_command_line_writes_is_not_for_everybody(tmp_path: Path) -> None:
    folder, target = tmp_path / "data", tmp_path / "backup.zip"
    with restrict_file_permissions():
        folder.mkdir()
    for command in (["backup", str(target)], ["doctor"]):
        run = CliRunner().invoke(app, [*command, "--data-dir", str(folder)])
        assert run.exit_code == 0, run.output
    files = [folder, target, *folder.rglob("*")]
    assert len(files) > 2
    assert [path for path in files if mode_of(path) & 0o007] == []


def leave(folder: Path) -> tuple[Path, ...]:
    """What a service that was killed leaves in its data directory."""
    left = (
        folder / "uploads" / "tmpupload" / "source",
        folder / "uploads" / "tmpfile",
        folder / "cache" / "tmpcopy",
        folder / "objects" / KEY[:2] / f"{KEY}#1",
    )
    for path in left:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(b"half a fi")
    time.sleep(0.05)  # the clock of files stands still for some milliseconds
    return left


def test_what_a_killed_service_left_is_removed_at_the_next_start(tmp_path: Path) -> None:
    left = leave(tmp_path)
    kept = tmp_path / "cache" / KEY
    kept.write_bytes(b"a copy")
    with TestClient(app_of(Settings(data_dir=tmp_path, workers=1)), "http://127.0.0.1"):
        wait_for(lambda: not any(path.exists() for path in left))
        assert kept.exists()
        assert list((tmp_path / "uploads").iterdir()) == []


def test_what_another_service_is_writing_is_left_alone(tmp_path: Path) -> None:
    settings = Settings(data_dir=tmp_path, workers=1)
    with TestClient(app_of(settings), "http://127.0.0.1"):
        left = leave(tmp_path)
        with TestClient(app_of(settings), "http://127.0.0.1") as second:
            second.app.state.services.housekeeping.run_round()  # type: ignore[attr-defined]
            assert all(path.exists() for path in left)


def test_a_directory_is_free_again_when_its_service_is_gone(tmp_path: Path) -> None:
    program = (
        "import sys, pathlib; from dynident_service.storage.data_directory import mark_in_use\n"
        "with mark_in_use(pathlib.Path(sys.argv[1])): print('in use', flush=True); sys.stdin.read()"
    )
    command = [sys.executable, "-c", program, str(tmp_path)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "in use\n"
        with mark_in_use(tmp_path) as is_alone:
            assert not is_alone
        process.kill()
    with mark_in_use(tmp_path) as is_alone:
        assert is_alone


@pytest.mark.parametrize(
    "command",
    [
        ["serve"],
        ["doctor"],
        ["backup", "backup.zip"],
        ["restore", "backup.zip"],
        ["export-robot", "rob_nothing", "robot.zip"],
        ["import-robot", "robot.zip"],
    ],
)
def test_a_data_directory_that_cannot_be_written_is_a_sentence(command: list[str], tmp_path: Path) -> None:
    given = [str(tmp_path / one) if one.endswith(".zip") else one for one in command]
    run = CliRunner().invoke(app, [*given, "--data-dir", str(UNWRITABLE)])
    assert run.exit_code == 2
    assert f"the data directory {UNWRITABLE} is not writable" in run.output


def test_the_programs_say_it_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    occupied = tmp_path / "file"
    occupied.write_text("no folder")
    monkeypatch.setenv("DYNIDENT_DATA_DIR", str(occupied))
    assert new_key.main(["cell 7"]) == 2
    assert f"the data directory {occupied} is not writable" in capsys.readouterr().err
    run = subprocess.run([sys.executable, "-m", "dynident_service"], capture_output=True, text=True, check=False)
    assert (run.returncode, "Traceback" in run.stderr) == (2, False)
    assert f"the data directory {occupied} is not writable" in run.stderr


def test_a_setting_that_cannot_be_used_is_a_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in (("DYNIDENT_PORT", "none"), ("DYNIDENT_API_KEYS", "a key"), ("DYNIDENT_PUBLIC_URL", "here")):
        with monkeypatch.context() as patch:
            patch.setenv(name, value)
            run = CliRunner().invoke(app, ["serve"])
        assert run.exit_code == 2
        assert "Unusable setting" in run.output
        assert name in run.output or name.removeprefix("DYNIDENT_").lower() in run.output
