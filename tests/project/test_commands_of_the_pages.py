"""Every command that a page names, in a block or in a sentence, is there with the options that it is given."""

from __future__ import annotations

import ast
import importlib.util
import re
import shlex
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import click
import pytest
import typer
from support.sources import tree_of

from dynident_cli.program_and_exit_codes import app

ROOT = Path(__file__).resolve().parents[2]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", ROOT / "SECURITY.md", ROOT / "benchmarks" / "README.md"]
PAGES += sorted((ROOT / "docs").rglob("*.md"))
BEGINS = ("dynident ", "python ", ".ci/")
# Modules that come with Python or with what the page says to install.
ELSEWHERE = {"venv", "pydoc", "build"}


def commands_of(text: str) -> Iterator[str]:
    """Lines of blocks, fenced or indented, and spans of code that are commands; continued lines are joined."""
    text = re.sub(r"\\\n\s*", " ", text)
    blocks = "".join(re.findall(r"^```\w*\n(.*?)^```$", text, re.MULTILINE | re.DOTALL))
    prose = re.sub(r"^```.*?^```$", "", text, flags=re.MULTILINE | re.DOTALL)
    lines = [*blocks.splitlines(), *re.findall(r"^    (\S.*)$", prose, re.MULTILINE)]
    for one in [*lines, *re.findall(r"`([^`]+)`", prose)]:
        said = " ".join(one.split())
        for part in said.split(" && "):
            plain = re.sub(r"^(\.venv/bin/|!|exec )", "", part)
            if plain.startswith(BEGINS):
                yield re.sub(r"\s# .*", "", plain)


@cache
def verbs() -> dict[str, set[str]]:
    """The options of every command of the command line."""
    group = typer.main.get_command(app)
    assert isinstance(group, click.Group) or hasattr(group, "commands")
    own = {name for one in group.params for name in one.opts} | {"--help"}
    found = {name: {opt for one in verb.params for opt in one.opts} for name, verb in group.commands.items()}
    return {name: {*options, "-h", "--help"} for name, options in found.items()} | {"": own}


def wrong_with(command: str) -> str:
    """What is wrong with a command as it is written; empty where nothing is."""
    program, *words = shlex.split(command)
    options = [re.sub(r"=.*", "", one) for one in words if re.match(r"--?[a-zA-Z]", one)]
    if program == "dynident":
        named = "" if not words or words[0].startswith("-") else words[0]
        if named not in verbs():
            return "" if re.fullmatch(r"[A-Z…]+", named) else f"no command {named}"
        unknown = [one for one in options if one not in verbs()[named]]
        return f"{named} has no {', '.join(unknown)}" if unknown else ""
    if program.startswith(".ci/"):
        return "" if (ROOT / program).exists() else f"no script {program}"
    if words[0] == "-m":
        there = words[1] in ELSEWHERE or importlib.util.find_spec(words[1]) is not None
        return "" if there else f"no module {words[1]}"
    if words[0].startswith("-"):
        return ""
    script = ROOT / words[0]
    if not script.exists():
        return f"no script {words[0]}"
    text = script.read_text(encoding="utf-8")
    unknown = [one for one in options if f'"{one}"' not in text]
    return f"{words[0]} has no {', '.join(unknown)}" if unknown else ""


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_command_that_a_page_names_is_there_with_its_options(page: Path) -> None:
    found = {one: wrong_with(one) for one in commands_of(page.read_text(encoding="utf-8"))}
    assert not {one: wrong for one, wrong in found.items() if wrong}


def messages_of(tree: ast.Module) -> Iterator[str]:
    """The texts in a module's code, with an X for what is put into them; docstrings, too."""
    for node in ast.walk(tree):
        if isinstance(node, ast.JoinedStr):
            yield "".join(part.value if isinstance(part, ast.Constant) else "X" for part in node.values)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.value


def commands_in_messages() -> Iterator[tuple[str, str]]:
    """Commands that the program's own messages name, with the module: from `dynident` to the end of the sentence."""
    for path in sorted([*(ROOT / "src").rglob("*.py"), *(ROOT / "service").rglob("*.py")]):
        for message in messages_of(tree_of(path)):
            for quoted in re.findall(r"`(dynident [^`]*)`", message):
                yield path.name, " ".join(quoted.split())
            for named in re.findall(r"(?<!`)\bdynident ([a-z]+(?: [^`.,:;()\n]*)?)", message):
                if named.split()[0] in verbs():
                    yield path.name, f"dynident {' '.join(named.split())}"


def test_every_command_that_a_message_names_is_there_with_its_options() -> None:
    found = set(commands_in_messages())
    assert len(found) > 30
    assert {("printed_results.py", "dynident validate MODEL payload LOADED --unloaded RUN --mass KG")} <= found
    assert not {one: wrong for one in found if (wrong := wrong_with(one[1].replace("'", "")))}


def test_commands_are_found_in_blocks_sentences_and_continued_lines() -> None:
    text = (
        "```sh\ndynident design a.urdf \\\n    --kind random\n```\n\nthen `dynident remove x` and\n\n"
        "    dynident doctor\n\n`.venv/bin/dynident demo`, `dynident ladder\nbetter.npz --against other.npz`"
    )
    verbs_found = [shlex.split(one)[1] for one in commands_of(text)]
    assert verbs_found == ["design", "doctor", "remove", "demo", "ladder"]
    assert sum(len(list(commands_of(page.read_text(encoding="utf-8")))) for page in PAGES) > 120


@pytest.mark.parametrize(
    ("command", "wrong"),
    [
        ("dynident desing arm.urdf", "no command desing"),
        ("dynident design arm.urdf --colour red", "design has no --colour"),
        ("dynident --version", ""),
        ("python -m dynident_service.old_key", "no module dynident_service.old_key"),
        ("python benchmarks/slow.py", "no script benchmarks/slow.py"),
        ("python benchmarks/run.py --slowly", "benchmarks/run.py has no --slowly"),
        (".ci/rnu", "no script .ci/rnu"),
    ],
)
def test_a_command_that_is_not_there_is_told(command: str, wrong: str) -> None:
    assert wrong_with(command) == wrong
