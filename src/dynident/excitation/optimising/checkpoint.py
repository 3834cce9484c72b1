"""Checkpoint of a search, as bytes: all that it needs to continue as if it had never been stopped."""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from dynident.array_types import FloatArray
from dynident.version import __version__


@dataclass(frozen=True, eq=False)
class StartState:
    """State of one start, which only the start itself understands.

    Parameters
    ----------
    numbers : mapping of str to float
        Numbers of the state by name.
    arrays : mapping of str to ndarray
        Arrays of the state by name.
    """

    numbers: Mapping[str, float]
    arrays: Mapping[str, FloatArray]


@dataclass(frozen=True, eq=False)
class SearchCheckpoint:
    """State of a stopped search.

    Parameters
    ----------
    seconds : float
        Time that it took.
    candidates : (k, m, n)
        Its random trajectories.
    best : (m, n)
        The best coefficients so far.
    first : int
        Number of the first start of the current heat.
    completed : int
        Number of all completed starts.
    starts : sequence of StartState
        States of the starts of the current heat.
    """

    seconds: float
    candidates: FloatArray
    best: FloatArray
    first: int = 0
    completed: int = 0
    starts: Sequence[StartState] = field(default=())

    def to_bytes(self) -> bytes:
        """Return the state as bytes."""
        header = {
            "dynident": __version__,
            "seconds": self.seconds,
            "first": self.first,
            "completed": self.completed,
            "starts": [dict(start.numbers) for start in self.starts],
        }
        arrays = {"candidates": self.candidates, "best": self.best}
        for k, start in enumerate(self.starts):
            # An .npz file is flat, so that the names of arrays carry the number of their start.
            arrays |= {f"start{k}.{name}": value for name, value in start.arrays.items()}
        with io.BytesIO() as file:
            np.savez(file, said=np.frombuffer(json.dumps(header).encode(), np.uint8), **arrays)  # type: ignore[arg-type]
            return file.getvalue()


def read_checkpoint(content: bytes | None) -> SearchCheckpoint | None:
    """Read a state from bytes; None where there is none, or another version wrote it."""
    if content is None:
        return None
    try:
        # Without pickle a damaged or foreign file cannot run code.
        with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
            header = json.loads(arrays["said"].tobytes())
            # Another version may search differently: continuing would give a result that neither version gives alone.
            if header["dynident"] != __version__:
                return None
            starts = []
            for k, numbers in enumerate(header["starts"]):
                of_start = f"start{k}."
                named = {
                    name.removeprefix(of_start): arrays[name] for name in arrays.files if name.startswith(of_start)
                }
                starts.append(StartState(numbers, named))
            return SearchCheckpoint(
                header["seconds"],
                arrays["candidates"],
                arrays["best"],
                header["first"],
                header["completed"],
                tuple(starts),
            )
    # A checkpoint that cannot be read is no error: the search then begins anew.
    except (ValueError, KeyError, OSError, EOFError, zipfile.BadZipFile):
        return None
