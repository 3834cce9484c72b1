"""Hash samples to find recordings that share data; holds the share that counts (1 %)."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynident.array_types import BoolArray, FloatArray
from dynident.recordings.recording import Recording
from dynident.recordings.signal_spectra import find_used_runs

Hashes = NDArray[np.uint64]

SHARED = 0.01
"""Share of the moving samples of held-out data that may be of the fit, too: windows that touch share their ends. With
more of them the held-out error is not that of data that no parameter saw."""

_ROWS_TOGETHER = 16
"""Rows that have to be equal one after the other: counts of a coarse encoder and current repeat singly by chance."""
_MOVING = 0.7
"""Share of these rows in which a joint has to move: of one that creeps, coarse counts repeat for many rows."""
_BLOCK = 65_536


@dataclass(frozen=True, eq=False)
class SampleHashes:
    """A hash of position and torque of every row inside the windows, and whether a joint moved since the row before.

    One entry of each list for every run of rows without a gap.
    """

    rows: tuple[Hashes, ...]
    moving: tuple[BoolArray, ...]

    @classmethod
    def from_recording(cls, recording: Recording) -> SampleHashes:
        """Read a recording once, in blocks, and hash its rows."""
        rows, moving = [], []
        for first, length in find_used_runs(recording):
            blocks, last, moved = [], None, []
            for block in recording.source.rows(first, length, _BLOCK):
                blocks.append(_hash_rows(np.hstack([block.q, block.tau])))
                # The first row of a run has none before it and counts as still.
                before = np.vstack([block.q[:1] if last is None else last, block.q[:-1]])
                moved.append((block.q != before).any(axis=1))
                last = block.q[-1:]
            rows.append(np.concatenate(blocks))
            moving.append(np.concatenate(moved))
        return cls(tuple(rows), tuple(moving))

    @property
    def digest(self) -> str:
        """SHA-256, in hexadecimal digits, by which these samples are known whatever their file is called."""
        digest = hashlib.sha256()
        for rows in self.rows:
            # With the lengths: the same rows, split into other runs, are other samples.
            digest.update(len(rows).to_bytes(8, "little"))
            digest.update(rows.tobytes())
        return digest.hexdigest()

    def measure_share_in(self, other: SampleHashes) -> float:
        """Return the share of the rows in motion that are in another recording, too; 0 if nothing moves."""
        # A recording that has shorter runs only is compared by the longest of them.
        together = min(_ROWS_TOGETHER, max((len(hashes) for hashes in self.rows), default=0))
        if not together:
            return 0.0
        other_hashes = np.unique(
            np.concatenate([_hash_runs(hashes, together) for hashes in other.rows] or [np.zeros(0, np.uint64)])
        )
        shared = telling = 0
        for rows, moved in zip(self.rows, self.moving, strict=True):
            # Only rows in motion count: a robot that stands gives equal rows in any two recordings.
            starts = _sum_runs(moved.astype(np.float64), together) >= _MOVING * together
            equal = starts & np.isin(_hash_runs(rows, together), other_hashes)
            telling += _count_covered(starts, together)
            shared += _count_covered(equal, together)
        return shared / telling if telling else 0.0


def find_copied_recordings(fitted: Sequence[SampleHashes], held_out: Sequence[Recording]) -> tuple[str, ...]:
    """Return the names of held-out recordings that hold samples of those that were fitted to.

    Parameters
    ----------
    fitted : sequence of SampleHashes
        Hashes of the recordings that parameters were fitted to.
    held_out : sequence of Recording
        Recordings that no parameter should have seen.

    Returns
    -------
    tuple of str
    """
    own = ((recording.name, SampleHashes.from_recording(recording)) for recording in held_out)
    return tuple(name for name, samples in own if any(samples.measure_share_in(other) > SHARED for other in fitted))


def _sum_runs(values: FloatArray, together: int) -> FloatArray:
    """Return the sums of every so many consecutive values; none if there are fewer."""
    return np.convolve(values, np.ones(together), "valid") if len(values) >= together else np.zeros(0)


def _count_covered(starts: BoolArray, together: int) -> int:
    """Return how many rows lie in the runs of so many rows that start where it is true."""
    # A row that lies in several runs counts once. The full convolution reaches to the last row of the last run.
    return int((np.convolve(starts, np.ones(together)) > 0.5).sum()) if starts.any() else 0


def _hash_rows(values: FloatArray) -> Hashes:
    """Return one hash (m,) for each row of values (m, c): the bits of each, multiplied and added modulo 2**64."""
    bits = np.ascontiguousarray(values + 0.0).view(np.uint64)  # adding zero makes of -0.0 a 0.0
    # Round numbers have zeros in their lower half: the upper half is mixed into it.
    mixed = bits ^ (bits >> np.uint64(32))
    return np.asarray((mixed * _make_factors(bits.shape[1])).sum(axis=1, dtype=np.uint64))


def _hash_runs(rows: Hashes, together: int) -> Hashes:
    """Return a hash of every so many consecutive rows: (m - together + 1,); none if there are fewer."""
    count = len(rows) - together + 1
    if count < 1:
        return np.zeros(0, dtype=np.uint64)
    hashes = np.zeros(count, dtype=np.uint64)
    for k, factor in enumerate(_make_factors(together)):
        # Each place has a factor of its own, so that the same rows in another order give another sum. Unsigned numbers
        # wrap around, as is meant here.
        hashes += rows[k : k + count] * factor
    return hashes


def _make_factors(count: int) -> Hashes:
    """Return odd numbers, always the same."""
    # An odd number has an inverse modulo 2**64: no bit of a value is lost by the product.
    return np.random.default_rng(0).integers(0, 2**63, count, dtype=np.uint64) * np.uint64(2) + np.uint64(1)
