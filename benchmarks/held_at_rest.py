"""What holds a joint at rest beyond the model's friction? The constants of `diagnosis/search/sticking.py`.

    python benchmarks/held_at_rest.py [--seed 1 | --seed new] [--cases 60] [--processes 2]

Arms of another engine (`engine/`) with friction, gears, springs or nothing hidden in them are identified, diagnosed
without their halts, and grown by what was recommended. Then the halts of every joint are looked at, of the joints that
have Stribeck friction which the diagnosis did not name apart from all others. Limits are told of joints with a dozen
halts or more; `named`, what the program then says, of those with fewer as well.

A halt counts where it holds so much beyond the model's friction, as a share of it, and so many times the residual
where the joint moves. `taken`: joints of whose halts so many count that the program's test would say so; `alike`: those
of them that are as alike as it asks for; `or along`: or of which nearly all are towards the motion beside them.
`counted`: the share of halts that count, exceeded by one joint in twenty.
"""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from itertools import pairwise
from pathlib import Path
from unittest.mock import patch

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(name, "1")

import numpy as np
from common import show
from engine.robots import arm_by_name, as_described
from hiding.asking import asked, each
from hiding.case import Case
from hiding.drawing import Wanted, draw_cases
from hiding.recorded import recorded
from scipy import stats

from dynident.diagnosis import compare, diagnose
from dynident.diagnosis.candidates.significance import ALPHA
from dynident.diagnosis.search import static_friction
from dynident.diagnosis.search.static_friction import find_halts, find_static_friction
from dynident.identification import extend, identify

# The package shows the function of that name, not the module.
DIAGNOSIS = import_module("dynident.diagnosis.diagnose_model")
HALTS = 12
BY_HALTS = (1, 4, 6, 8, HALTS, 1000)
LIMITS = ((0.1, 3.0), (0.2, 2.0), (0.2, 3.0), (0.2, 5.0), (0.3, 3.0), (0.3, 5.0))
"""Of the friction, and of the residual where the joint moves: both have to be exceeded."""
FAMILIES = (
    "stribeck", "clean", "stribeck+base_tilt", "presliding", "stribeck", "load_dependent_friction", "joint_elasticity",
    "stribeck+torque_ripple", "backlash", "joint_spring", "transmission_coupling", "torque_delay",
)  # fmt: skip


@dataclass(frozen=True)
class Joint:
    """The halts of one joint."""

    case: str
    joint: str
    hidden: bool
    """Whether it has Stribeck friction that was not named."""
    halts: int
    counted: tuple[int, ...]
    """By `LIMITS`."""
    joints: int
    """Of the arm: as many are tested."""
    are_alike: bool
    or_along: bool
    named: bool


def main() -> None:
    given = asked(__doc__ or "", 60)
    cases = draw_cases(Wanted(given.seed, given.cases, FAMILIES))
    start = time.perf_counter()
    joints = [one for some in each(partial(joints_of, folder=given.cache), cases, given.processes) for one in some]
    seconds = time.perf_counter() - start
    show(f"Halts, seed {given.seed}, {len(cases)} cases, {seconds:.0f} s", table(joints))
    show("Static friction that the program names", named(joints))


def joints_of(case: Case, folder: Path) -> list[Joint]:
    """Identify, diagnose and extend a case, and look at its halts."""
    data = recorded(case, folder)
    robot = as_described(arm_by_name(case.arm), case.noise)
    training = data.recordings(held_out=False)
    plain = identify(robot, training)
    with patch.object(DIAGNOSIS, "find_static_friction", lambda grown, recordings, final, *choices: (grown, final, ())):
        recommended = diagnose(plain, training).recommended
    grown = extend(plain, recommended, training) if recommended else plain
    named = {joint for choice in recommended for joint in choice.joints if choice.effect == "stribeck"}
    there = {robot.joint_names[j] for placed in case.hidden if placed.effect == "stribeck" for j in placed.joints}
    comparisons = [compare(grown, recording) for recording in training]
    *_, held = find_static_friction(grown, training, comparisons, None)
    by_halts = {robot.joint_names[j] for one in held for j in one.judged.joints}
    found = []
    for j, joint in enumerate(robot.joint_names):
        halts = find_halts(comparisons, j)
        if not len(halts.beyond) or joint in there & named:
            continue
        residual = comparisons[0].noise[j]
        counted = tuple(
            int(((halts.share >= share) & (halts.beyond >= times * residual)).sum()) for share, times in LIMITS
        )
        same = len(halts.beyond), counted, robot.n, halts.are_alike, halts.look_like_friction, joint in by_halts
        found.append(Joint(case.name, joint, joint in there, *same))
    print(*found, sep="\n", flush=True)
    return found


def table(joints: Sequence[Joint]) -> list[tuple[str, ...]]:
    """What limits would take for static friction, with and without Stribeck friction that was not named."""
    rows = [("joints", "number", "share, times", "taken", "alike", "or along", "counted")]
    for hidden, words in ((True, "Stribeck, not named"), (False, "all others")):
        own = [one for one in joints if one.hidden == hidden and one.halts >= HALTS]
        for k, (share, times) in enumerate(LIMITS):
            taken = [one for one in own if is_taken(one, k)]
            counted = np.quantile([one.counted[k] / one.halts for one in own] or [0.0], 0.95)
            alike, along = (sum(some) for some in ([t.are_alike for t in taken], [t.or_along for t in taken]))
            limits = f"{share:g}, {times:g}"
            rows.append((words, str(len(own)), limits, str(len(taken)), str(alike), str(along), f"{counted:.2f}"))
    return rows


def named(joints: Sequence[Joint]) -> list[tuple[str, ...]]:
    """Of how many joints the program says that they have it, by the number of their halts."""
    rows = [("joints", "halts", "number", "named")]
    for hidden, words in ((True, "Stribeck, not named"), (False, "all others")):
        for least, most in pairwise(BY_HALTS):
            own = [one for one in joints if one.hidden == hidden and least <= one.halts < most]
            rows.append((words, f"{least} to {most - 1}", str(len(own)), str(sum(one.named for one in own))))
    return rows


def is_taken(one: Joint, k: int) -> bool:
    """Whether more halts count than usually do, by the test of the program."""
    return bool(one.joints * stats.binom.sf(one.counted[k] - 1, one.halts, static_friction._USUAL) <= ALPHA)


if __name__ == "__main__":
    main()
