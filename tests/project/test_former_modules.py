"""Import paths that packages of others still use."""

from __future__ import annotations

import subprocess
import sys
from importlib import import_module

import pytest

from dynident.former_modules import read_former_names

FORMER = read_former_names()


@pytest.mark.parametrize("former", FORMER.modules)
def test_a_former_module_gives_its_names_with_a_warning(former: str) -> None:
    present = import_module(FORMER.modules[former])
    sys.modules.pop(former, None)
    with pytest.warns(DeprecationWarning, match=FORMER.modules[former]):
        module = import_module(former)
    for old, new in FORMER.names.get(FORMER.modules[former], {}).items():
        assert getattr(module, old) is getattr(present, new)
    with pytest.raises(AttributeError):
        module.there_is_no_such_name  # noqa: B018


def test_an_estimator_that_was_written_for_the_former_paths_works() -> None:
    program = """
from dataclasses import dataclass
from dynident.asking import said
from dynident.identification.methods.bases import Estimator

@dataclass(frozen=True)
class Mine(Estimator):
    rounds: int = said("How many rounds", default=3, at_least=1)

    def solve(self, problem):
        return None

print(Mine().rounds)
"""
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    assert run.stdout.strip() == "3"
