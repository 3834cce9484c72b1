"""What does it take to name an effect on equal terms? The constants of `diagnosis/search/comparison_of_rivals.py`.

    python benchmarks/equal_terms.py [--seed 1 | --seed new] [--cases 48] [--processes 2]

Arms of another engine (`engine/`) with something hidden in them that other effects look like. Every time that a name
is weighed again, more rivals take part, from more values of their grids, than in the program; of these contests those
count in which a hidden effect is among the rivals or was chosen.

Of `rivals` that gain less than a share on the grid of what was chosen there: how many right names lag behind it and win
on equal terms, and how many of them a threshold would lose; `taking part` is how many names there are in the mean,
which is what a contest costs. `starts`: of the names that come to 0.9 of the best, in how many the best is reached (to
0.5 %) from so many values of the grid. `as much`: right names with fewer constants than a wrong one that gains more by
a larger part than this (they lose), and right ones with more constants that gain more by no larger part (they lose,
too).
"""

from __future__ import annotations

import os
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
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

from dynident.diagnosis import diagnose, diagnose_model
from dynident.diagnosis.candidates.candidate_pool import Candidate, Pool
from dynident.diagnosis.candidates.significance import ScoredCandidate
from dynident.diagnosis.decision_levels import RULES
from dynident.diagnosis.search import comparison_of_rivals
from dynident.diagnosis.search.search_state import ProductSource, State, score_all
from dynident.estimation.residual_errors import compute_t
from dynident.identification import identify
from dynident.identification.shape_search import list_between

RIVALS, STARTS = 0.3, 12
FAMILIES = (
    "joint_spring", "gravity_compensator", "torque_ripple", "cable_force", "stribeck", "viscous_nonlinear",
    "load_dependent_friction", "presliding", "position_dependent_friction", "stribeck+torque_ripple",
    "load_dependent_friction+joint_spring", "load_dependent_friction+torque_ripple",
)  # fmt: skip


@dataclass(frozen=True)
class Rival:
    """A name in a contest: its gain on the grid, and what it gains at best from each of its values there."""

    name: str
    right: bool
    on_grid: float
    gains: tuple[float, ...]
    """From the best value of the grid to the worst; shares of what was chosen on the grid."""
    constants: int

    @property
    def best(self) -> float:
        """What it gains on equal terms."""
        return max(self.gains)


@dataclass(frozen=True)
class Contest:
    """One weighing, on the rows that all rivals have in common."""

    case: str
    rivals: tuple[Rival, ...]
    t: float
    """Of what the best wrong name gains more than the best right one, over the stretches; 0 where there is but one."""
    f: float
    """The same over what the better of the two leaves, a stretch: the F of one constant more."""


def main() -> None:
    given = asked(__doc__ or "", 48)
    cases = draw_cases(Wanted(given.seed, given.cases, FAMILIES))
    start = time.perf_counter()
    contests = [one for some in each(partial(contests_of, folder=given.cache), cases, given.processes) for one in some]
    show(f"Rivals, seed {given.seed}, {len(cases)} cases, {time.perf_counter() - start:.0f} s", rivals_table(contests))
    show("Starts", starts_table(contests))
    show("Fewer constants", constants_table(contests))


def contests_of(case: Case, folder: Path) -> list[Contest]:
    """Identify and diagnose a case, and write down its contests."""
    data = recorded(case, folder)
    robot = as_described(arm_by_name(case.arm), case.noise)
    training = data.recordings(held_out=False)
    with listening(case) as heard:
        diagnose(identify(robot, training), training)
    print(*heard, sep="\n", flush=True)
    return heard


@contextmanager
def listening(case: Case) -> Iterator[list[Contest]]:
    """Contests as they are fought, and once more with more rivals and starts."""
    heard: list[Contest] = []
    name = comparison_of_rivals.name_findings

    def named(rows: ProductSource, state: State) -> State:
        for finding in state.findings:
            beside = state.drop_findings([finding])
            rivals = comparison_of_rivals._list_rivals(state, finding, beside)
            judged = score_all(beside, [finding.judged.candidate, *rivals])
            with (
                patch.object(comparison_of_rivals, "RULES", replace(RULES, contends=RIVALS)),
                patch.object(comparison_of_rivals, "_STARTS", STARTS),
            ):
                found = weighed(case, rows, beside, judged[0], judged)
            if found is not None:
                heard.append(found)
        return name(rows, state)

    with patch.object(diagnose_model, "name_findings", named):
        yield heard


def weighed(
    case: Case, rows: ProductSource, state: State, chosen: ScoredCandidate, judged: Sequence[ScoredCandidate]
) -> Contest | None:
    """All that take part, or None where none of them is hidden on the joint."""
    own = [item for item in judged if item.candidate == chosen.candidate]
    contenders = list(dict.fromkeys([*own, *comparison_of_rivals._find_contenders(chosen, judged)]))
    names = dict.fromkeys(item.candidate.effect for item in contenders)
    if len(names) < 2 or not any(is_right(case, item.candidate, state.pool) for item in contenders):
        return None
    parents = {finer: item for item in contenders for finer in list_between(item.candidate.choice)}
    finer = comparison_of_rivals.refine_grid(rows, state, list(parents))
    kinds = [finer.data.find_row_kinds(one.columns) for one in finer.pool.candidates]
    common = all(turns for turns, _ in kinds), all(starts for _, starts in kinds)
    again = score_all(finer, finer.pool.candidates, kinds=common)
    rivals = []
    best: dict[bool, ScoredCandidate] = {}
    for name in names:
        grid = [item for item in contenders if item.candidate.effect == name]
        gains = [
            max((item.total_gain for item in again if parents[item.candidate.choice] is start), default=0.0)
            for start in grid
        ]
        on_grid = max(item.total_gain for item in grid) / chosen.total_gain
        shares = tuple(round(gain / chosen.total_gain, 6) for gain in gains)
        right = is_right(case, grid[0].candidate, state.pool)
        own = [item for item in again if item.candidate.effect == name]
        best[right] = max([*own, *([best[right]] if right in best else [])], key=lambda item: item.total_gain)
        rivals.append(Rival(name, right, on_grid, shares, grid[0].freedom))
    t, f = _apart(best[True], best[False]) if len(best) == 2 else (0.0, 0.0)
    return Contest(case.name, tuple(rivals), round(t, 3), round(f, 3))


def _apart(right: ScoredCandidate, wrong: ScoredCandidate) -> tuple[float, float]:
    more = wrong.gains - right.gains
    better = wrong if more.sum() > 0 else right
    return compute_t(more), float(more.sum()) * (len(more) - 1) / max(float(better.after_weighted.sum()), 1e-300)


def is_right(case: Case, candidate: Candidate, pool: Pool) -> bool:
    """Whether a candidate is something hidden, on a joint where it is."""
    joints = pool.observation.robot.joint_names
    return any(
        candidate.effect in placed.names
        and (not placed.joints or not candidate.joints or {joints[j] for j in placed.joints} & set(candidate.joints))
        for placed in case.hidden
    )


def pairs(contests: Sequence[Contest]) -> Iterator[tuple[Rival, Rival, Contest]]:
    """The best right and the best wrong name of every contest that has both, and that contest."""
    for one in contests:
        right = [rival for rival in one.rivals if rival.right]
        wrong = [rival for rival in one.rivals if not rival.right]
        best = [max(some, key=lambda rival: rival.best) for some in (right, wrong) if some]
        if len(best) == 2 and min(rival.best for rival in best) > 0.0:
            yield best[0], best[1], one


def rivals_table(contests: Sequence[Contest]) -> list[tuple[str, ...]]:
    """What is lost by leaving out names that gain little on the grid, and what is saved."""
    lagging = [right.on_grid for right, wrong, _ in pairs(contests) if right.best > wrong.best and right.on_grid < 1.0]
    rows = [("share on the grid", "right names that lag", "lost", "taking part")]
    for share in (RIVALS, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95):
        part = np.mean([sum(rival.on_grid >= share for rival in one.rivals) for one in contests])
        rows.append((f"{share:.2f}", str(len(lagging)), str(sum(value < share for value in lagging)), f"{part:.1f}"))
    return rows


def starts_table(contests: Sequence[Contest]) -> list[tuple[str, ...]]:
    """In how many names the best constants are reached from the first values of the grid."""
    near = [
        rival
        for one in contests
        for rival in one.rivals
        if len(rival.gains) > 1 and rival.best >= 0.9 * max(other.best for other in one.rivals)
    ]
    rows = [("starts", "names", "reached")]
    for count in (1, 2, 3, 4, 6, 8, STARTS):
        reached = sum(max(rival.gains[:count]) >= 0.995 * rival.best for rival in near)
        rows.append((str(count), str(len(near)), str(reached)))
    return rows


def constants_table(contests: Sequence[Contest]) -> list[tuple[str, ...]]:
    """Whom a rule that prefers fewer constants costs the name, and whom its absence."""
    # A gain that is smaller by a tenth is no question of constants.
    fewer = [(1.0 - r.best / w.best, one.t, one.f) for r, w, one in pairs(contests) if r.constants < w.constants]
    more = [(1.0 - w.best / r.best, -one.t, -one.f) for r, w, one in pairs(contests) if r.constants > w.constants]
    fewer, more = [one for one in fewer if 0.0 < one[0] < 0.1], [one for one in more if one[0] > 0.0]
    head = "as much, and t below, or F below"
    rows = [(head, "fewer constants, gains less", "lost", "more constants, gains more", "lost")]
    for part in (0.0, 0.0025, 0.005, 0.01, 0.02, 0.05):
        for t, f in ((np.inf, 0.0), (2.0, 0.0), (2.0, 7.5), (0.0, 7.5)):
            slim = [
                sum(less <= part and (apart < t or gain < f) for less, apart, gain in some) for some in (fewer, more)
            ]
            lost = len(fewer) - slim[0], slim[1]
            rows.append((f"{part:.2%}, {t:g}, {f:g}", str(len(fewer)), str(lost[0]), str(len(more)), str(lost[1])))
    return rows


if __name__ == "__main__":
    main()
