"""The program starts fast, light, and hands its settings on."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import pyarrow.csv as pacsv
import pyarrow.parquet as pq
import pytest
from support.running_commands import dynident, write_run
from typer.main import get_command
from typer.testing import CliRunner

from dynident.version import __version__
from dynident_cli.program_and_exit_codes import create_application
from dynident_service.settings import Settings

VERBS = (
    *("serve", "design", "identify", "compare", "diagnose", "extend", "remove", "ladder"),
    *("simulate", "report", "effects", "demo"),
)


def test_the_version_is_told_without_loading_the_science() -> None:
    program = (
        "import sys; from dynident_cli.program_and_exit_codes import app; code = 0\n"
        "try:\n    app(['--version'], prog_name='dynident')\nexcept SystemExit as end:\n    code = end.code or 0\n"
        "heavy = {'numpy', 'scipy', 'casadi', 'pinocchio', 'pyarrow', 'matplotlib', 'fastapi', 'pydantic'}\n"
        "print(sorted(heavy & set(sys.modules)), code)\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines() == [f"dynident {__version__}", "[] 0"]


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["identify", "ur10", "nowhere.csv"], "there is no file nowhere.csv"),
        (["identify", "nobody", "nowhere.csv"], "neither a file nor a well-known robot 'nobody'. The robots are: "),
        (["identify", "ur10", __file__, "--friction", "nowhere.csv"], "there is no file nowhere.csv"),
        (["extend", "nowhere.npz", "run1.csv"], "there is no file nowhere.npz"),
        (["changes", __file__, "--before", __file__, "--after", "nowhere.csv"], "there is no file nowhere.csv"),
        (["design", "ur10", "--limits", "nowhere.json"], "there is no file nowhere.json"),
    ],
)
def test_a_file_that_is_not_there_is_told_without_loading_the_science(arguments: list[str], told: str) -> None:
    program = (
        "import sys; from dynident_cli.program_and_exit_codes import app\n"
        f"try:\n    app({arguments!r}, prog_name='dynident')\nexcept SystemExit as end:\n    code = end.code or 0\n"
        "heavy = {'numpy', 'scipy', 'casadi', 'pinocchio', 'pyarrow', 'matplotlib', 'fastapi'}\n"
        "print(sorted(heavy & set(sys.modules)), code)\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines() == ["[] 2"]
    assert told in done.stderr


def test_identifying_and_diagnosing_load_no_package_that_they_do_not_need() -> None:
    program = (
        "import sys\n"
        "from dynident.identification.column_inference import inspect_file\n"
        "from dynident.identification import identify\n"
        "from dynident.verdict import verdict\n"
        "from dynident.diagnosis import diagnose\n"
        "from dynident_cli import printed_results\n"
        "from dynident_service.diagnoses.adapters import describe_diagnosis\n"
        "heavy = ('scipy.signal', 'scipy.stats', 'matplotlib', 'fastapi', 'dynident.excitation.experiment_design')\n"
        "print([name for name in heavy if name in sys.modules])\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_every_verb_explains_itself() -> None:
    overview = dynident("--help")
    for verb in VERBS:
        assert f"\n  {verb}" in overview.out
        explained = dynident(verb, "--help")
        assert explained.code == 0
        assert "<class" not in explained.out
        # Arguments have names in capitals: Usage: dynident compare [OPTIONS] {MODEL} {RECORDING}
        arguments = explained.out.partition("[OPTIONS]")[2].partition("\n\n")[0]
        assert re.fullmatch(r"[{}\[\]A-Z_.\s]*", arguments), arguments


def test_the_overview_lists_every_verb_in_one_group_within_80_columns() -> None:
    overview = dynident("--help").out.splitlines()
    assert max(map(len, overview)) <= 80
    begin = next(index for index, line in enumerate(overview) if line == "From files to a better model:")
    listed = [line.split()[0] for line in overview[begin:] if line.startswith("  ")]
    assert sorted(listed) == sorted(get_command(create_application("")).commands)  # type: ignore[attr-defined]
    assert not any(line.endswith("...") for line in overview[begin:])


def test_serve_hands_its_settings_to_the_service(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    given: list[Settings] = []
    monkeypatch.setattr("dynident_service.serve.serve", given.append)
    monkeypatch.setenv("DYNIDENT_PORT", "8123")
    assert dynident("serve", "--host", "0.0.0.0", "--data-dir", tmp_path).code == 0
    assert (given[0].host, given[0].port, given[0].data_dir) == ("0.0.0.0", 8123, tmp_path)
    assert dynident("serve", "--port", 9000).code == 0
    assert (given[1].host, given[1].port) == ("127.0.0.1", 9000)


def test_a_setting_that_cannot_be_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DYNIDENT_WORKERS", "many")
    answer = dynident("serve")
    assert answer.code == 2
    assert "DYNIDENT_WORKERS" in answer.err
    assert "many" in answer.err


def test_a_light_installation_tells_its_version_and_what_to_install(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from dynident_cli.__main__ import main

    for name in [name for name in sys.modules if name.startswith("dynident_cli")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "typer", None)
    monkeypatch.setattr(sys, "argv", ["dynident", "--version"])
    main()
    assert capsys.readouterr().out == f"dynident {__version__}\n"
    monkeypatch.setattr(sys, "argv", ["dynident", "demo"])
    with pytest.raises(SystemExit) as end:
        main()
    assert "pip install" in str(end.value)
    assert "dynident[science]" in str(end.value)


def test_a_verb_whose_packages_are_missing_names_them(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(sys.modules, "dynident_service.serve", raising=False)
    monkeypatch.setitem(sys.modules, "uvicorn", None)
    answer = dynident("serve")
    assert answer.code == 2
    assert "uvicorn" in answer.err
    assert "dynident[service]" in answer.err


def test_a_command_that_is_typed_explains_itself_as_among_all_others() -> None:
    for verb in VERBS:
        alone = CliRunner().invoke(create_application(verb), [verb, "--help"], prog_name="dynident")
        assert (alone.exit_code, alone.stdout) == (0, dynident(verb, "--help").out)


def test_a_command_that_there_is_not_is_told_beside_those_there_are() -> None:
    answer = CliRunner().invoke(create_application("identfy"), ["identfy"], prog_name="dynident")
    assert answer.exit_code == 2
    assert "identify" in answer.stderr


def test_one_identifies_without_loading_what_takes_longer_to_load_than_that(tmp_path: Path) -> None:
    run, other = tmp_path / "run.parquet", tmp_path / "other.parquet"
    for number, path in enumerate((run, other)):
        pq.write_table(pacsv.read_csv(write_run(tmp_path / "run.csv", number)), path)
    script = (
        "import sys; from dynident_cli.program_and_exit_codes import app; code = 0\n"
        f"try:\n    app(['identify', 'scara', {str(run)!r}, '-v', {str(other)!r}, '--json'], prog_name='dynident')\n"
        "except SystemExit as end:\n    code = end.code or 0\n"
        "heavy = {'matplotlib', 'fastapi', 'ruckig', 'pyarrow.compute', 'dynident.diagnosis.search.search_state'}\n"
        "print(sorted(heavy & set(sys.modules)), code, file=sys.stderr)\n"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stderr.splitlines()[-1].startswith("[] ")
    assert json.loads(done.stdout)["parameters"]


def test_every_flag_can_be_switched_off() -> None:
    flags = {
        (verb, parameter.name): parameter.secondary_opts
        for verb, command in get_command(create_application("")).commands.items()  # type: ignore[attr-defined]
        for parameter in command.params
        if getattr(parameter, "is_flag", False) and parameter.name != "help"
    }
    assert ("identify", "weigh_turns") in flags
    assert all(flags.values()), flags
