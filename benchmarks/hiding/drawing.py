"""Cases drawn from a seed."""

from __future__ import annotations

import zlib
from collections import Counter
from dataclasses import dataclass, field

import numpy as np
from engine.robots import arm_by_name

from hiding.case import Case, Size
from hiding.families import FAMILIES
from hiding.manners import Manners, draw_instruments, draw_manner, draw_paces
from hiding.outside import OUTSIDE
from hiding.sessions import draw_session
from hiding.site import Site

# Families that never stand beside one another in a double case: both are the same function of the motion.
PAIRS = (
    ("stribeck", "base_tilt"),
    ("load_dependent_friction", "joint_spring"),
    ("presliding", "torque_delay"),
    ("torque_ripple", "viscous_nonlinear"),
    ("transmission_coupling", "offset"),
    ("position_dependent_friction", "encoder_zero_error"),
    ("gravity_compensator", "viscous_asymmetric"),
    ("payload", "torque_ripple"),
    ("stribeck", "torque_ripple"),
    ("load_dependent_friction", "base_tilt"),
    ("presliding", "joint_spring"),
    ("torque_delay", "offset"),
)


@dataclass(frozen=True)
class Wanted:
    """What to draw: empty families or arms stand for all; `manners` is how they may be moved and recorded."""

    seed: int
    cases: int
    families: tuple[str, ...] = ()
    arms: tuple[str, ...] = ()
    sizes: tuple[Size, ...] = ("full", "quarter")
    manners: Manners = field(default_factory=Manners)


def draw_cases(wanted: Wanted) -> list[Case]:
    """Single cases of every family in turn, full before quarter, then doubles, outside and clean ones.

    As many of each kind as fit the number of cases; with families named, these alone.
    """
    arms = wanted.arms or default_arms(wanted.seed)
    plan = _plan(wanted)
    cases, drawn = [], Counter[tuple[tuple[str, ...], Size]]()
    for names, size in plan:
        # A case does not depend on which others are drawn: it can be drawn again alone.
        number = drawn[names, size]
        drawn[names, size] += 1
        start = zlib.crc32("+".join(names).encode()) + (1 if size == "quarter" else 0)
        cases.append(_case(names, size, arms[(start + number) % len(arms)], wanted, number))
    return cases


def default_arms(seed: int) -> tuple[str, ...]:
    """Arms of the library and arms that are drawn anew for a seed."""
    return ("franka_panda", "ur10", "ur5", f"six-{seed}", f"six-{seed + 1}", f"sliding-{seed}")


def _plan(wanted: Wanted) -> list[tuple[tuple[str, ...], Size]]:
    if wanted.families:
        named = [tuple(name.split("+")) if name != "clean" else () for name in wanted.families]
        rounds = [(names, size) for size in wanted.sizes for names in named]
        return [rounds[k % len(rounds)] for k in range(wanted.cases or len(rounds))]
    total = wanted.cases
    # Per 80 cases: 54 single, 12 double, 6 outside, 8 clean.
    clean, outside, double = round(0.1 * total), round(0.075 * total), round(0.15 * total)
    singles: list[tuple[tuple[str, ...], Size]] = [((name,), size) for size in wanted.sizes for name in FAMILIES]
    odd = list(OUTSIDE)
    return [
        *(singles[k % len(singles)] for k in range(total - clean - outside - double)),
        *((PAIRS[k % len(PAIRS)], "full") for k in range(double)),
        *(((odd[k % len(odd)],), "full") for k in range(outside)),
        *(((), "full") for _ in range(clean)),
    ]


def _case(names: tuple[str, ...], size: Size, arm: str, wanted: Wanted, number: int) -> Case:
    key = (wanted.seed, number, size == "full", zlib.crc32("+".join(names).encode()))
    # What is hidden is drawn apart from how it is recorded: the same can be asked of other motions and rates.
    rng, recording = np.random.default_rng([*key, 0]), np.random.default_rng([*key, 1])
    manner = draw_manner(wanted.manners, recording)
    session = draw_session(names, draw_paces(wanted.manners, recording), recording)
    site = Site(arm_by_name(arm), rng, 1.0 if size == "full" else 0.25, session)
    return Case(
        f"{'+'.join(names) or 'clean'} {size} {arm} #{number}",
        arm,
        tuple({**FAMILIES, **OUTSIDE}[name](site) for name in names),
        size,
        draw_instruments(wanted.manners, recording),
        manner,
        int(recording.integers(2**31)),
        session,
    )
