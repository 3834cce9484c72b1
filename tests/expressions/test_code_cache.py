"""Regressors are compiled once on a machine; what is kept is never taken for what it is not."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from dynident.expressions import code_cache, compiled_expressions
from dynident.expressions.compiled_expressions import Compiled

llvm = pytest.importorskip("llvmlite.binding")


@pytest.fixture
def folder(tmp_path, monkeypatch) -> Path:
    monkeypatch.setenv(code_cache.SETTING, str(tmp_path))
    return tmp_path / "code"


@pytest.fixture
def builds(monkeypatch) -> list[str]:
    """What is compiled, as text."""
    texts = []
    parse = llvm.parse_assembly

    def counted(text: str):
        if text:
            texts.append(text)
        return parse(text)

    monkeypatch.setattr(llvm, "parse_assembly", counted)
    return texts


def of(factor: float) -> tuple[Compiled, float]:
    """A function, and what it should be at 0.5."""
    x = ca.SX.sym("x")
    return Compiled(ca.Function("rows", [x], [ca.sin(factor * x)]).serialize(), 1, [1], 1), float(np.sin(factor * 0.5))


def value(compiled: Compiled) -> float:
    out = np.zeros((1, 1))
    compiled.run(1, out, [np.array([[0.5]])])
    return float(out[0, 0])


def test_what_was_compiled_once_is_not_compiled_again(folder, builds):
    for _ in range(3):
        compiled, expected = of(1.25)
        assert value(compiled) == pytest.approx(expected, rel=1e-15)
    assert len(builds) == 1
    compiled, expected = of(1.5)
    assert value(compiled) == pytest.approx(expected, rel=1e-15)
    assert len(builds) == 2
    assert len(list(folder.iterdir())) == 2


def test_damaged_code_is_compiled_again(folder, builds):
    of(1.25)
    (path,) = folder.iterdir()
    whole = path.read_bytes()
    for damaged in (b"", whole[:40], whole[:-1], whole[:60] + b"x" + whole[61:]):
        path.write_bytes(damaged)
        before = len(builds)
        compiled, expected = of(1.25)
        assert value(compiled) == pytest.approx(expected, rel=1e-15)
        assert len(builds) == before + 1
        assert path.read_bytes() == whole


def test_another_processor_or_compiler_has_code_of_its_own(folder, builds, monkeypatch):
    of(1.25)
    monkeypatch.setattr(compiled_expressions, "_read_versions", lambda: "another one")
    of(1.25)
    assert len(builds) == 2


@pytest.mark.skipif(not hasattr(os, "geteuid"), reason="rights of files are POSIX's")
def test_code_that_others_could_have_written_is_not_run(folder, builds):
    folder.mkdir()
    folder.chmod(0o777)
    code_cache._find_folder.cache_clear()
    for _ in range(2):
        of(1.25)
    assert len(builds) == 2
    assert not list(folder.iterdir())


@pytest.mark.parametrize("setting", ["", "/dev/null/nowhere"])
def test_without_a_folder_everything_works(setting, builds, monkeypatch):
    monkeypatch.setenv(code_cache.SETTING, setting)
    compiled, expected = of(1.25)
    assert value(compiled) == pytest.approx(expected, rel=1e-15)
    assert len(builds) == 1


def test_the_folder_does_not_grow_without_end(folder, monkeypatch):
    for number in range(8):
        code_cache.load_or_compute(f"text {number}", lambda: bytes(1000))
        newest = max(folder.iterdir(), key=lambda path: path.stat().st_mtime_ns)
        os.utime(newest, (number, number))
    code_cache.load_or_compute("text 0", lambda: pytest.fail("it is there"))  # used just now, so the newest
    monkeypatch.setattr(code_cache, "_MOST_BYTES", 5000)
    code_cache._remove_old_files.cache_clear()
    code_cache.load_or_compute("text 8", lambda: bytes(1000))
    for number in (0, 8):
        code_cache.load_or_compute(f"text {number}", lambda: pytest.fail("it is there"))
    assert len(list(folder.iterdir())) == 2


def test_processes_share_it(folder):
    script = (
        "from dynident.expressions.code_cache import load_or_compute\n"
        "load_or_compute('of both', lambda: print('compiled') or b'code')"
    )
    told = [
        subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True).stdout
        for _ in range(2)
    ]
    assert told == ["compiled\n", ""]
