"""How far a search has come, as bytes: all that it needs to go on as if it had never been stopped."""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from dynident.arrays import FloatArray
from dynident.version import __version__


@dataclass(frozen=True, eq=False)
class StartReached:
    """One start: numbers by name and arrays by name, which only the start itself understands."""

    numbers: Mapping[str, float]
    arrays: Mapping[str, FloatArray]


@dataclass(frozen=True, eq=False)
class Reached:
    """A search that was stopped: the time it took (s), its random trajectories (k, m, n) and the best found (m, n).

    `starts` are those of the heat that begins with number `first`; `completed` counts all that were.
    """

    seconds: float
    candidates: FloatArray
    best: FloatArray
    first: int = 0
    completed: int = 0
    starts: Sequence[StartReached] = field(default=())

    def to_bytes(self) -> bytes:
        """Write it down."""
        said = {
            "dynident": __version__,
            "seconds": self.seconds,
            "first": self.first,
            "completed": self.completed,
            "starts": [dict(one.numbers) for one in self.starts],
        }
        arrays = {"candidates": self.candidates, "best": self.best}
        for k, one in enumerate(self.starts):
            arrays |= {f"start{k}.{name}": value for name, value in one.arrays.items()}
        with io.BytesIO() as file:
            np.savez(file, said=np.frombuffer(json.dumps(said).encode(), np.uint8), **arrays)  # type: ignore[arg-type]
            return file.getvalue()


def reached_of(content: bytes | None) -> Reached | None:
    """Read what was written down; `None` where there is nothing, or another version wrote it."""
    if content is None:
        return None
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
            said = json.loads(arrays["said"].tobytes())
            if said["dynident"] != __version__:
                return None
            starts = []
            for k, numbers in enumerate(said["starts"]):
                of_start = f"start{k}."
                named = {
                    name.removeprefix(of_start): arrays[name] for name in arrays.files if name.startswith(of_start)
                }
                starts.append(StartReached(numbers, named))
            return Reached(
                said["seconds"], arrays["candidates"], arrays["best"], said["first"], said["completed"], tuple(starts)
            )
    except (ValueError, KeyError, OSError, EOFError, zipfile.BadZipFile):
        return None
