"""How far does the residual of a span stand out? The limit of `estimation/outlying_spans.py`.

    python benchmarks/outlying_spans.py [--seed 1 | --seed new] [--cases 80] [--processes 1]

Arms of another engine (`engine/`), clean ones and such with an effect that the plain model lacks, are identified, and
of every case the span whose residual stands out most is told: squared residual by row of the span over that of the
other rows, solved without it. Contacts are told apart: they are what is to be found.
"""

from __future__ import annotations

import os
import time
from functools import partial
from pathlib import Path

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(name, "1")

from common import show
from engine.robots import arm_by_name, as_described
from hiding.asking import asked, each
from hiding.case import Case
from hiding.drawing import Wanted, draw_cases
from hiding.recorded import recorded

from dynident.estimation import find_outlying_spans
from dynident.estimation.outlying_spans import OUTLYING_RATIO
from dynident.identification import identify


def main() -> None:
    given = asked(__doc__ or "", 80)
    start = time.perf_counter()
    cases = draw_cases(Wanted(given.seed, given.cases))
    found = list(each(partial(largest, folder=given.cache), cases, given.processes))
    told = sorted(zip(found, (case.name for case in cases), strict=True), reverse=True)
    rows = [("case", "squared residual of the span that stands out most, over the rest")]
    rows += [(name, f"{ratio:.1f}") for ratio, name in told[:10]]
    rows.append((f"above {OUTLYING_RATIO:g}", str(sum(ratio > OUTLYING_RATIO for ratio in found))))
    seconds = time.perf_counter() - start
    show(f"Spans that stand out, seed {given.seed}, {len(cases)} cases, {seconds:.0f} s", rows)


def largest(case: Case, folder: Path) -> float:
    """The ratio of the span that stands out most; 1 where none does."""
    model = identify(as_described(arm_by_name(case.arm), case.noise), recorded(case, folder).recordings(held_out=False))
    spans = find_outlying_spans(model.data.training, 1.0).spans
    ratio = max((span.ratio for span in spans), default=1.0)
    print(case.name, f"{ratio:.1f}", flush=True)
    return ratio


if __name__ == "__main__":
    main()
