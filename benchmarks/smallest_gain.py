"""How much has a name to explain before it is worth telling? Right and wrong ones by what they take of the noise.

    python benchmarks/smallest_gain.py [--seed 1 | --seed new] [--cases 84] [--processes 2]

Calibrates `least_gain_over_noise` and `least_reach` of `diagnosis/decision_levels.py`. The arms of `hidden_effects.py`
are diagnosed, and what is recommended is added one after the other, in its order. A line a name: `gain`, the squared
error where joints move that it takes away, over the square of the sensors' noise in the band, on the joint where that
is most; `reach`, the share of its column that is left beside the model, times the t of what it gains; the error of
the runs that no parameter saw, with it over without it. A name is `right` where it is hidden, or an equivalent of
what is; the others are `extra`.
"""

from __future__ import annotations

import os
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
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
from hiding.judging import named
from hiding.recorded import recorded

from dynident.diagnosis import diagnose
from dynident.errors import DynidentError
from dynident.identification import extend, identify

LIMITS = (0.08, 0.15, 0.2, 0.25, 0.3, 0.4, 0.5)
REACHES = (0.1, 0.15, 0.25, 0.35, 0.5, 1.0, 2.0)


@dataclass(frozen=True)
class Told:
    """A recommended name: how much it takes away, how far it reaches beyond the data, and whether it is there."""

    case: str
    name: str
    gain: float
    reach: float
    held_out: float
    right: bool


def main() -> None:
    given = asked(__doc__ or "", 84)
    start, told = time.perf_counter(), []
    for some in each(
        partial(told_of, folder=given.cache), draw_cases(Wanted(given.seed, given.cases)), given.processes
    ):
        for one in some:
            told.append(one)
            sort = "right" if one.right else "extra"
            print(f"  {one.gain:9.3f} {one.reach:7.2f} {one.held_out:6.3f} {sort} {one.case}: {one.name}", flush=True)
    show(f"Smallest gains, seed {given.seed}, {time.perf_counter() - start:.0f} s", _below(told, "gain", LIMITS))
    show("Smallest reaches", _below(told, "reach", REACHES))


def _below(told: list[Told], figure: str, limits: Sequence[float]) -> list[tuple[str, ...]]:
    """How many names of either sort have less of a figure than each limit."""
    rows = [("limit", "right names below", "extra names below")]
    for limit in limits:
        counts = (sum(getattr(one, figure) < limit for one in told if one.right == right) for right in (True, False))
        rows.append((f"{limit:g}", *map(str, counts)))
    right = sum(one.right for one in told)
    return [*rows, ("of", str(right), str(len(told) - right))]


def told_of(case: Case, folder: Path | None) -> list[Told]:
    """What is recommended of a case, one after the other."""
    try:
        return list(_told_of(case, folder))
    except DynidentError as error:
        print(f"  {case.name}: {error.detail}", flush=True)
        return []


def _told_of(case: Case, folder: Path | None) -> Iterator[Told]:
    runs = recorded(case, folder)
    training, unseen = runs.recordings(held_out=False), runs.recordings(held_out=True)
    robot = as_described(arm_by_name(case.arm), case.noise)
    model = identify(robot, training, unseen)
    found = diagnose(model, training)
    extra = set(named(case, robot, found).extra)
    for choice in found.recommended:
        grown = extend(model, [choice], training, unseen)
        (told,) = (one for one in found.candidates if one.choice == choice)
        gain = (model.fit.rms**2 - grown.fit.rms**2) / np.maximum(found.noise_floor**2, np.finfo(float).tiny)
        yield Told(
            case.name,
            f"{choice.effect} {','.join(choice.joints)}",
            float(gain.max()),
            told.separability * told.t_value,
            grown.held_out.relative_total / model.held_out.relative_total,
            choice.effect not in extra,
        )
        model = grown


if __name__ == "__main__":
    main()
