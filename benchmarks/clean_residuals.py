"""How far above the sensor noise is what a sound model leaves? The limit of `diagnosis/words.py`.

    python benchmarks/clean_residuals.py [--seed 1 | --seed new] [--cases 24] [--processes 1]

Arms of another engine (`engine/`) with nothing hidden in them are identified, and the residual of every joint where it
moves is set against the noise floor that a diagnosis tells: from second differences of the torque. What is above it
comes from clocks and filters, from torque that is logged slower than it is commanded, and from sign(q̇) beside halts.
The table has, over the cases, the quantiles of the joint that is worst in each.
"""

from __future__ import annotations

import os
import time
from functools import partial
from pathlib import Path

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(name, "1")

import numpy as np
from common import show
from engine.robots import arm_by_name, as_described
from hiding.asking import asked, each
from hiding.case import Case
from hiding.drawing import Wanted, draw_cases
from hiding.recorded import recorded

from dynident.diagnosis import compare
from dynident.diagnosis.comparison.noise_floor import estimate_sensor_noise
from dynident.diagnosis.decision_levels import RULES
from dynident.diagnosis.diagnosis_summary import compute_residual_over_noise
from dynident.identification import identify

QUANTILES = (0.5, 0.75, 0.9, 0.95, 1.0)


def main() -> None:
    given = asked(__doc__ or "", 24)
    start = time.perf_counter()
    cases = draw_cases(Wanted(given.seed, given.cases, ("clean",)))
    worst = np.array(list(each(partial(largest, folder=given.cache), cases, given.processes)))
    rows = [("of the cases", "residual where the worst joint moves, over the noise")]
    rows += [(f"{share:.0%}", f"{np.quantile(worst, share):.1f}") for share in QUANTILES]
    rows.append((f"above {RULES.adequate_over_noise:g}", str(int((worst > RULES.adequate_over_noise).sum()))))
    seconds = time.perf_counter() - start
    show(f"Clean arms, seed {given.seed}, {len(cases)} cases, {seconds:.0f} s", rows)


def largest(case: Case, folder: Path) -> float:
    """The residual over the noise of the joint where that is largest."""
    training = recorded(case, folder).recordings(held_out=False)
    found = identify(as_described(arm_by_name(case.arm), case.noise), training)
    comparisons = [compare(found, recording) for recording in training]
    ratios = compute_residual_over_noise(comparisons, estimate_sensor_noise(training, found.preprocessing))
    print(case.name, *(f"{ratio:.1f}" for ratio in ratios), flush=True)
    return float(ratios.max())


if __name__ == "__main__":
    main()
