"""Cases drawn from a seed."""

from __future__ import annotations

import zlib
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from engine import Instruments
from engine.robots import arm_by_name

from hiding.case import USUAL_SESSION, Case, Placed, Size, Take
from hiding.families import FAMILIES
from hiding.outside import OUTSIDE
from hiding.site import Site

_COUNTS, _RATES = (2**17, 2**18, 2**19), (1000.0, 1000.0, 500.0, 250.0)
# Motions are shared between cases, so that a clean arm need not be simulated for every one of them.
_MOTIONS = 2
# Quick and wide; with a stiff and a soft controller.
_SLOPES = (0.7, 1.3)
_LAGS = (0.5e-3, 1.5e-3)
_AFRESH = (Take(0.0, 24.0), Take(0.0, 24.0), Take(0.0, 24.0, held_out=True))
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
    """What to draw: empty families or arms stand for all."""

    seed: int
    cases: int
    families: tuple[str, ...] = ()
    arms: tuple[str, ...] = ()
    sizes: tuple[Size, ...] = ("full", "quarter")


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
        cases.append(_case(names, size, arms[(start + number) % len(arms)], wanted.seed, number))
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


def _case(names: tuple[str, ...], size: Size, arm: str, seed: int, number: int) -> Case:
    rng = np.random.default_rng([seed, number, size == "full", zlib.crc32("+".join(names).encode())])
    site = Site(arm_by_name(arm), rng, 1.0 if size == "full" else 0.25)
    hidden = tuple({**FAMILIES, **OUTSIDE}[name](site) for name in names)
    instruments = Instruments(int(rng.choice(_COUNTS)), float(rng.uniform(0.004, 0.008)), float(rng.choice(_RATES)))
    motion = int(rng.integers(_MOTIONS))
    name = f"{'+'.join(names) or 'clean'} {size} {arm} #{number}"
    return Case(
        name,
        arm,
        hidden,
        size,
        instruments,
        100 * seed + 10 * motion,
        int(rng.integers(2**31)),
        _SLOPES[motion],
        _LAGS[motion],
        _session(hidden, rng),
    )


def _session(hidden: Sequence[Placed], rng: np.random.Generator) -> tuple[Take, ...]:
    names = [placed.effect for placed in hidden]
    if "temperature_friction" in names:
        return Take(0.0, 24.0), Take(3600.0, 24.0), Take(1800.0, 24.0, held_out=True)
    if "warm_up_friction" in names:
        starts = (0.0, 900.0, 2400.0, 6000.0)
        return (*(Take(start, 15.0) for start in starts), Take(1500.0, 15.0, held_out=True))
    if "payload" in names and rng.random() < 0.5:
        # Both runs in one file, told apart by its segment column.
        return Take(0.0, 24.0), Take(60.0, 24.0, joined=True), Take(120.0, 24.0, held_out=True)
    # Most people's files begin at t = 0.
    return _AFRESH if rng.random() < 0.5 else USUAL_SESSION
