"""Damaged files of every format of recordings end in a result or in an error in words, within time and memory."""

from __future__ import annotations

import pytest
from support.file_mutations import DESCRIPTIONS, MESHES, MUTABLE_FILES, mutant, read_mutants

RECORDINGS = [kind for kind in MUTABLE_FILES if kind not in (*MESHES, *DESCRIPTIONS)]
PEAK = 600 * 2**20
"""Bytes; about 170 MB are what reads them."""


@pytest.mark.slow
@pytest.mark.sweep
@pytest.mark.parametrize("kind", RECORDINGS)
def test_a_damaged_recording_is_read_or_refused_in_words(kind, thorough):
    pytest.importorskip("h5py")
    pytest.importorskip("mcap")
    count = 2000 if thorough else 100
    outcomes = read_mutants(kind, 3, count)
    assert outcomes.count == count
    assert not outcomes.faults
    assert not outcomes.deaths
    assert outcomes.refusals > count // 5  # damages are found
    assert outcomes.peak < PEAK


def test_mutants_are_the_same_for_the_same_numbers_and_mostly_differ_from_the_file():
    content = MUTABLE_FILES["npy"]()
    assert mutant("npy", 1, 2, content) == mutant("npy", 1, 2, content)
    assert sum(mutant("npy", 1, number, content) != content for number in range(50)) > 40
