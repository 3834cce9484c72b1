"""Which joints have an effect that several have, and which have constants of their own?

    python benchmarks/joints_of_a_group.py [--seed 1 | --seed new] [--cases 32] [--processes 2]

What the constants of `diagnosis/search/own_constants.py` and `pruning.py` are judged by. Arms of another engine
(`engine/`) in which most joints have the same friction, each at a size of its own: with constants of their own or (a
quarter) with the same ones; and (a quarter) arms in which two have it.

`named` is what the program recommends: joints that have it, of those that do; joints that do not, of those that do not;
cases with another name beside it; in how many parts it is told, where constants are the same and where they are not;
the held-out error where joints move over that of a model that has the effect on the joints that have it.

`stays` is about the last step of the search, in which every joint of a group is weighed beside all that was found. Of
joints that others of their group outnumber (half of the arm's joints hold by the strict rule) and that do not hold
themselves: how many have the effect, how many do not, from which t on.
"""

from __future__ import annotations

import os
import time
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Literal
from unittest.mock import patch

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(name, "1")

import numpy as np
from common import show
from engine.robots import arm_by_name, as_described
from hiding.asking import asked, each
from hiding.case import Case, Placed, Take
from hiding.drawing import default_arms
from hiding.families import FAMILIES
from hiding.judging import choice_of
from hiding.manners import Manners, draw_instruments, draw_manner, draw_paces
from hiding.recorded import recorded
from hiding.sessions import draw_session
from hiding.site import Site

from dynident.diagnosis import diagnose
from dynident.diagnosis.candidates.significance import ScoredCandidate
from dynident.diagnosis.decision_levels import RULES
from dynident.diagnosis.search import pruning
from dynident.diagnosis.search.search_state import State
from dynident.identification import extend, identify

Manner = Literal["own", "alike", "two"]
GROUPS = ("presliding", "stribeck", "viscous_nonlinear", "load_dependent_friction")
STEPS = (-1.0, 0.0, 0.5, 1.0, 1.5, 2.0)


@dataclass(frozen=True, eq=False)
class At(Site):
    """A site whose chance may fall on one joint alone."""

    only: int = 0

    def joint(self, *, turning: bool = False) -> int:
        return self.only

    def loaded(self, *, before_last: int = 0) -> int:
        return self.only


@dataclass(frozen=True)
class Weighed:
    """A joint of a group at the end of the search: whether it has the effect, and what it gains by itself."""

    case: str
    joint: str
    has_it: bool
    outnumbered: bool
    """Half of the arm's joints hold by the strict rule."""
    firm: bool
    drop: float
    t: float


@dataclass(frozen=True)
class Named:
    """What was recommended for a case."""

    case: str
    effect: str
    alike: bool
    parts: int
    having: int
    lacking: int
    right: int
    wrong: int
    beside: tuple[str, ...]
    error_ratio: float
    weighed: tuple[Weighed, ...]


def main() -> None:
    given = asked(__doc__ or "", 32)
    cases = group_cases(given.seed, given.cases)
    start = time.perf_counter()
    found = []
    for one in each(partial(named, folder=given.cache), cases, given.processes):
        found.append(one)
        print(
            f"  {one.case}: {one.right}/{one.having} joints in {one.parts}, {one.wrong} wrong, "
            f"error {one.error_ratio:.2f}",
            *one.beside,
            flush=True,
        )
    show(f"Named, seed {given.seed}, {len(cases)} cases, {time.perf_counter() - start:.0f} s", named_table(found))
    show("Stays", stays_table([item for one in found for item in one.weighed]))


def group_cases(seed: int, number: int) -> list[Case]:
    """Family after family, manner after manner."""
    arms = [arm for arm in default_arms(seed) if not arm.startswith("sliding")]
    manners: tuple[Manner, ...] = ("own", "alike", "two", "own")
    return [
        _case(GROUPS[k % len(GROUPS)], manners[k // len(GROUPS) % len(manners)], arms[k % len(arms)], seed, k)
        for k in range(number)
    ]


def _case(effect: str, constants: Manner, arm: str, seed: int, number: int) -> Case:
    key = (seed, number, zlib.crc32(effect.encode()))
    rng, recording = np.random.default_rng([*key, 2]), np.random.default_rng([*key, 3])
    manners = Manners()
    manner = draw_manner(manners, recording)
    session = draw_session((effect,), draw_paces(manners, recording), recording)
    robot = arm_by_name(arm)
    members = _members(robot.n, constants != "two", rng)
    # Sizes are drawn for each joint; with the same chance for all of them the constants are the same.
    chances = [np.random.default_rng([*key, 4, 0 if constants == "alike" else j]) for j in members]
    return Case(
        f"{effect} ({constants}) on {len(members)} of {robot.n} joints, {arm} #{number}",
        arm,
        tuple(_placed(effect, arm, j, chance, session) for j, chance in zip(members, chances, strict=True)),
        "full",
        draw_instruments(manners, recording),
        manner,
        int(recording.integers(2**31)),
        session,
    )


def _members(n: int, most: bool, rng: np.random.Generator) -> list[int]:
    """Most joints: each with a chance of 0.85, more than half of them; or two."""
    if not most:
        return sorted(int(j) for j in rng.choice(n, 2, replace=False))
    while True:
        drawn = [j for j in range(n) if rng.random() < 0.85]
        if 2 * len(drawn) > n:
            return drawn


def _placed(effect: str, arm: str, joint: int, rng: np.random.Generator, session: tuple[Take, ...]) -> Placed:
    return FAMILIES[effect](At(arm_by_name(arm), rng, 1.0, session, joint))


def named(case: Case, folder: Path) -> Named:
    """Identify and diagnose a case; what was recommended, and how the joints of its groups were weighed."""
    data = recorded(case, folder)
    robot = as_described(arm_by_name(case.arm), case.noise)
    training, held_out = data.recordings(held_out=False), data.recordings(held_out=True)
    plain = identify(robot, training, held_out)
    effect = case.hidden[0].effect
    names = robot.joint_names
    having = {names[j] for placed in case.hidden for j in placed.joints}
    with listening(case.name, effect, having) as heard:
        found = diagnose(plain, training)
    hit = {joint for choice in found.recommended if choice.effect == effect for joint in choice.joints or names}
    best = extend(plain, found.recommended, training, held_out) if found.recommended else plain
    known = [choice for placed in case.hidden if (choice := choice_of(case, placed, robot)) is not None]
    true = extend(plain, known, training, held_out)
    return Named(
        case.name,
        effect,
        "(alike)" in case.name,
        sum(choice.effect == effect for choice in found.recommended),
        len(having),
        len(names) - len(having),
        len(hit & having),
        len(hit - having),
        tuple(choice.effect for choice in found.recommended if choice.effect != effect),
        best.held_out_moving.relative_total / true.held_out_moving.relative_total,
        tuple(heard),
    )


@contextmanager
def listening(case: str, effect: str, having: set[str]) -> Iterator[list[Weighed]]:
    """How the joints of the hidden effect's group are weighed when the search is over."""
    heard: list[Weighed] = []
    weigh, judge = pruning.trim_joints, pruning._has_gain
    rows: list[tuple[str, bool, ScoredCandidate]] = []

    def gains(state: State, alone: ScoredCandidate, least_t: float) -> bool:
        holds = judge(state, alone, least_t)
        if alone.candidate.effect == effect and least_t != RULES.staying_t:
            rows.append((alone.candidate.joints[0], holds, alone))
        return holds

    def trimmed(state: State) -> list[tuple[str, ...]]:
        rows.clear()
        kept = weigh(state)
        heard.clear()
        outnumbered = 2 * sum(firm for _, firm, _ in rows) >= len(state.pool.observation.robot.joint_names)
        heard.extend(
            Weighed(case, joint, joint in having, outnumbered, firm, item.drop, item.t) for joint, firm, item in rows
        )
        return kept

    with patch.object(pruning, "_has_gain", gains), patch.object(pruning, "trim_joints", trimmed):
        yield heard


def named_table(found: list[Named]) -> list[list[str]]:
    rows = [
        [
            *("effect", "cases", "joints that have it", "joints that do not", "another name"),
            *("parts where alike", "where not", "error ratio, median, worst"),
        ]
    ]
    for effect in (*GROUPS, ""):
        some = [one for one in found if one.effect == effect or not effect]
        if some:
            ratios = [one.error_ratio for one in some]
            rows.append(
                [
                    effect or "all",
                    str(len(some)),
                    f"{sum(one.right for one in some)} of {sum(one.having for one in some)}",
                    f"{sum(one.wrong for one in some)} of {sum(one.lacking for one in some)}",
                    str(sum(bool(one.beside) for one in some)),
                    f"{_mean([one.parts for one in some if one.alike])}",
                    f"{_mean([one.parts for one in some if not one.alike])}",
                    f"{np.median(ratios):.2f}, {max(ratios):.2f}",
                ]
            )
    return rows


def _mean(parts: list[int]) -> str:
    return f"{np.mean(parts):.1f}" if parts else "-"


def stays_table(weighed: list[Weighed]) -> list[list[str]]:
    doubtful = [one for one in weighed if one.outnumbered and not one.firm and one.drop >= RULES.joint_drop]
    rows = [["t from", "have it and stay", "do not have it and stay"]]
    for least in STEPS:
        kept = [one.has_it for one in doubtful if one.t >= least]
        rows.append([f"{least:g}", str(sum(kept)), str(len(kept) - sum(kept))])
    return rows


if __name__ == "__main__":
    main()
