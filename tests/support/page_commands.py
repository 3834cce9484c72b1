"""Commands as a page writes them, one a line, run in this process: it imports once what each would import anew."""

from __future__ import annotations

import contextlib
import os
import shlex
import sys
from pathlib import Path

from click.testing import Result
from typer.testing import CliRunner

from dynident_cli.program_and_exit_codes import app


def run_commands(folder: Path, block: str) -> str:
    """Run the `dynident` commands of a block in a folder; gives what they print on stdout."""
    told = []
    with contextlib.chdir(folder):
        for line in block.splitlines():
            program, *arguments = shlex.split(line)
            assert program == "dynident", line
            # Programs that a command runs are found beside this Python, as in an environment that is active.
            path = os.pathsep.join((str(Path(sys.executable).parent), os.environ.get("PATH", "")))
            ended = CliRunner().invoke(app, arguments, prog_name=program, env={"COLUMNS": "200", "PATH": path})
            assert ended.exit_code == 0 or _judged(ended), f"{line}\n{ended.output}"
            told.append(ended.stdout)
    return "".join(told)


def _judged(ended: Result) -> bool:
    """Whether a validation ran to its end and its verdict is a failure: that is about the data, not the command."""
    return ended.exit_code == 1 and isinstance(ended.exception, SystemExit) and "✕ fail" in ended.stdout
