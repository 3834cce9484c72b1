"""Is the hidden effect found? Arms of another engine with something hidden in them, identified and diagnosed.

    python benchmarks/hidden_effects.py [--seed 1 | --seed new] [--cases 84] [--processes 2] [--json out.json]
    python benchmarks/hidden_effects.py --families stribeck,payload+torque_ripple,clean --arms ur10 --size full
    python benchmarks/hidden_effects.py --motion point-to-point --controller soft --rate 125,60 --paces 1,0.5,0.2

Every case is an arm that MuJoCo moves in closed loop, with one or two effects of the catalogue in it, or something that
no catalogue has, or nothing. The program gets two recordings and a description whose masses are some 15 % off; a third
recording is held out. Every recording has runs at full speed, a middle and a low one. Motions (Fourier, or from point
to point with pauses), controllers (soft, stiff) and rates are drawn with the seed, apart from what is hidden: the same
effects can be asked of other recordings. A case counts as one that shows where the effect leaves more than the noise
in the residual of the plain model, measured without the program.

In the table, shares are of the cases that show; `first` counts names that stand first or are reported as equivalent to
the first (`equiv` of them only so). `beside`, `extra` and `unknown` are of all cases. `beside`: something was
recommended that is not there, or on a joint where it is not, equivalents let pass; `extra`: a recommended name that is
not there, equivalents counted. `error ratio`: held-out error, where joints move, after adding what is recommended over
that of the true structure, median and worst; `par. err`: the same for the main parameters.
"""

from __future__ import annotations

import argparse
import json
import os
import secrets
import sys
import time
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import get_args

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(name, "1")

from common import show
from hiding.asking import each, kept
from hiding.case import Firmness, MotionKind, Size
from hiding.drawing import Wanted, draw_cases
from hiding.families import FAMILIES
from hiding.judging import judge_safely
from hiding.manners import Manners
from hiding.outcome import Outcome
from hiding.outside import OUTSIDE
from hiding.table import describe, is_failure, table, totals
from hiding.visibility import SHOWS

SIZES: dict[str, tuple[Size, ...]] = {"full": ("full",), "quarter": ("quarter",), "both": ("full", "quarter")}


def main() -> None:
    arguments = _arguments()
    seed = secrets.randbelow(10**6) if arguments.seed == "new" else int(arguments.seed)
    families = _listed(arguments.families)
    cases = draw_cases(
        Wanted(
            seed,
            arguments.cases or (0 if families else 84),
            families,
            _listed(arguments.arms),
            SIZES[arguments.size],
            _manners(arguments),
        )
    )
    print(f"seed {seed}: {len(cases)} cases on {', '.join(dict.fromkeys(case.arm for case in cases))}", flush=True)
    start = time.perf_counter()
    outcomes = []
    judging = partial(judge_safely, folder=arguments.cache, shows=arguments.shows)
    for outcome in each(judging, cases, arguments.processes):
        outcomes.append(outcome)
        print(f"  {len(outcomes):3d}/{len(cases)} {_line(outcome)}", flush=True)
    order = {case.name: k for k, case in enumerate(cases)}
    outcomes.sort(key=lambda outcome: order[outcome.case])
    if arguments.json:
        content = {"seed": seed, "totals": totals(outcomes), "outcomes": [asdict(outcome) for outcome in outcomes]}
        arguments.json.write_text(json.dumps(content, indent=1))
    failures = [outcome for outcome in outcomes if is_failure(outcome)]
    print(f"\nFailures: {len(failures)}\n")
    print("\n".join(describe(outcome) for outcome in failures))
    show(f"Hidden effects, seed {seed}, {time.perf_counter() - start:.0f} s", table(outcomes))
    show("In total", [(what, f"{value:.3g}") for what, value in totals(outcomes).items()])


def _manners(arguments: argparse.Namespace) -> Manners:
    """How the arms may be moved and recorded: what is not named is drawn."""
    usual = Manners()
    return Manners(
        (arguments.motion,) if arguments.motion else usual.motions,
        (arguments.controller,) if arguments.controller else usual.firmnesses,
        tuple(map(float, _listed(arguments.rate))) or usual.rates,
        tuple(map(float, _listed(arguments.paces))),
    )


def _line(outcome: Outcome) -> str:
    said = outcome.failure or "; ".join(outcome.recommended) or outcome.verdict
    mark = "FAIL " if is_failure(outcome) else "     "
    shown = "" if outcome.shows or outcome.kind == "clean" else " (below the noise)"
    return f"{mark}{outcome.case}, {', '.join(outcome.joints)}{shown}: {said} [{outcome.seconds:.1f} s]"


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--seed", default="1", help='a number, or "new"')
    parser.add_argument("--cases", type=int, default=0, help="84 by default; with --families, one each")
    parser.add_argument("--families", default="", help="names with commas between; + joins two in one arm; clean")
    parser.add_argument("--arms", default="", help="franka_panda, ur10, ur5, six-<number>, sliding-<number>, …")
    parser.add_argument("--size", choices=SIZES, default="both")
    parser.add_argument("--motion", choices=get_args(MotionKind), help="either by default")
    parser.add_argument("--controller", choices=get_args(Firmness), help="either by default")
    parser.add_argument("--rate", default="", help="Hz, several with commas between: drawn from these")
    parser.add_argument("--paces", default="", help="shares of full speed that every recording has a run at: 1,0.5,0.2")
    parser.add_argument("--shows", type=float, default=SHOWS, help="excess from which on an effect counts as shown")
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--json", type=Path, default=None, help="write every outcome here")
    parser.add_argument("--cache", type=Path, default=kept())
    arguments = parser.parse_args()
    unknown = {part for name in _listed(arguments.families) for part in name.split("+")} - {
        *FAMILIES,
        *OUTSIDE,
        "clean",
    }
    if unknown:
        sys.exit(f"no such family: {', '.join(sorted(unknown))}; there are {', '.join((*FAMILIES, *OUTSIDE, 'clean'))}")
    return arguments


def _listed(text: str) -> tuple[str, ...]:
    return tuple(part for part in text.split(",") if part)


if __name__ == "__main__":
    main()
