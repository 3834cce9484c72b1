"""Damaged meshes and descriptions end in a result or in an error in words, within time and memory."""

from __future__ import annotations

import pytest
from support.file_mutations import DESCRIPTIONS, MESHES, MUTABLE_FILES, read_mutants

PEAK = 600 * 2**20
"""Bytes; about 200 MB are what reads them."""


@pytest.mark.slow
@pytest.mark.sweep
@pytest.mark.parametrize("kind", [kind for kind in MUTABLE_FILES if kind in (*MESHES, *DESCRIPTIONS)])
def test_a_damaged_mesh_or_description_is_read_or_refused_in_words(kind, thorough):
    pytest.importorskip("mujoco")
    count = 2000 if thorough else 100
    outcomes = read_mutants(kind, 3, count)
    assert outcomes.count == count
    assert not outcomes.faults
    assert not outcomes.deaths
    assert outcomes.refusals > count // 5  # damages are found
    assert outcomes.peak < PEAK
