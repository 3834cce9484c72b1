"""What a benchmark measured against its rival in the same run, kept for `run.py`.

A script states each of its comparisons once, by `compared`; run by itself it only prints, run by `run.py` they go into
the file that DYNIDENT_BENCHMARK names, one JSON document a line.
"""

from __future__ import annotations

import json
import os
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal

Kind = Literal["seconds", "samples a second", "MB"]
FILE = "DYNIDENT_BENCHMARK"


@dataclass(frozen=True)
class Comparison:
    """One quantity, ours and the rival's, measured one after the other on the same machine."""

    what: str
    rival: str
    ours: float
    theirs: float
    kind: Kind = "seconds"

    @property
    def times_better(self) -> float:
        """How many times faster or smaller ours is; below 1 it is slower or larger."""
        return self.ours / self.theirs if self.kind == "samples a second" else self.theirs / self.ours


def compared(what: str, ours: float, rival: str, theirs: float, kind: Kind = "seconds") -> None:
    """State a comparison."""
    if place := os.environ.get(FILE):
        with Path(place).open("a", encoding="utf-8") as file:
            file.write(json.dumps(asdict(Comparison(what, rival, ours, theirs, kind))) + "\n")


def read_comparisons(file: Path) -> list[Comparison]:
    """All that a script stated, in its order."""
    return [Comparison(**json.loads(line)) for line in file.read_text(encoding="utf-8").splitlines()]
