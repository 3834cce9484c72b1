"""Are effects of the size of their detection limit found? Hidden at a half, once and twice the limit, on fresh seeds.

    python benchmarks/detection_limits.py [--seed 1 | --seed new] [--draws 10] [--effects joint_spring stribeck]
    python benchmarks/detection_limits.py --parts [--seed 1 | --seed new] [--draws 5]

A draw is an arm simulated in MuJoCo, with motions, controller and noise of its own. A clean recording gives the limits;
then some effects, each on a joint of the draw, are hidden in sizes around their limit, and the recording is diagnosed.
An effect is found if it, or one that is reported as its equivalent, is recommended on that joint. Sizes are multiples
of `half_size`, which should be found in half of the cases, and `size` itself, which should be found in 95 %.

With `--parts`, effects of their usual size are hidden instead, and halves and a shifted part of the recordings are
diagnosed by themselves: counted is whether the name is the same in those whose own limits are below that size.
"""

from __future__ import annotations

import argparse
import math
import os
import secrets
import time
from collections.abc import Callable, Mapping
from dataclasses import replace

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(name, "1")

import numpy as np
from common import show
from engine import Bandwidth, Hidden, Instruments, Run, disturbances, friction, structure
from engine.drives import usual_drives
from engine.robots import arm_by_name, as_described
from hiding.case import Case, Manner, Placed, Take
from hiding.recorded import recorded

from dynident.diagnosis import Diagnosis, diagnose
from dynident.diagnosis.diagnosis_result import DetectionLimit
from dynident.effects import get_effect
from dynident.identification import identify
from dynident.robot import Robot

ARMS = ("ur10", "franka_panda", "ur5")
DURATION, PAUSE, PACES = 20.0, 3.0, (1.0, 0.4)
PARTS = {"whole": (0.0, 1.0), "first half": (0.0, 0.5), "second half": (0.5, 1.0), "shifted": (0.07, 1.0)}
SIZES = ("0.5 x half", "1 x half", "1 x size", "2 x half")

Numbers = Mapping[str, float]

LAWS: Mapping[str, Callable[[Robot, int, Numbers, Numbers], Hidden]] = {
    "offset": lambda robot, j, p, c: disturbances.Offset(j, p["b"]),
    "viscous_asymmetric": lambda robot, j, p, c: friction.AsymmetricViscous(j, p["Fva"]),
    "viscous_nonlinear": lambda robot, j, p, c: friction.PowerViscous(j, p["Fvn"], c["p"]),
    "stribeck": lambda robot, j, p, c: friction.Stribeck(j, p["Fst"], c["vs"], c["delta"]),
    "load_dependent_friction": lambda robot, j, p, c: friction.LoadFriction(j, p["cl"]),
    "position_dependent_friction": lambda robot, j, p, c: friction.PositionFriction(
        j,
        math.hypot(p["Fpc"], p["Fps"]) / float(usual_drives(robot).coulomb[j]),
        c["k"],
        math.atan2(p["Fpc"], p["Fps"]),
    ),
    "joint_spring": lambda robot, j, p, c: structure.Spring(j, p["ks"], -p["bs"] / p["ks"]),
    "transmission_coupling": lambda robot, j, p, c: structure.Coupling(j, c["side"], p["Iam"], p["Fvm"], p["Fcm"]),
    "drive_gain_error": lambda robot, j, p, c: disturbances.GainError(j, p["eps"]),
    "drive_gain_saturation": lambda robot, j, p, c: disturbances.Saturation(j, p["sat"], 1.0),
    "encoder_zero_error": lambda robot, j, p, c: disturbances.ZeroError(j, -p["dq0"]),
    "torque_delay": lambda robot, j, p, c: disturbances.Delay(p["delay"]),
}
"""How the simulator has each effect, from its parameters and shape constants."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", default="1", help='a number, or "new"')
    parser.add_argument("--draws", type=int, default=10)
    parser.add_argument("--each", type=int, default=6, help="effects of a draw")
    parser.add_argument("--effects", nargs="*", default=list(LAWS), choices=list(LAWS))
    parser.add_argument("--parts", action="store_true", help="halves and a shifted part, at the usual size")
    given = parser.parse_args()
    seed = secrets.randbelow(10**6) if given.seed == "new" else int(given.seed)
    start = time.perf_counter()
    if given.parts:
        show(
            f"Named in parts of the recordings, seed {seed}",
            count_in_parts(seed, given.draws, given.each, given.effects),
        )
        return
    found: dict[tuple[str, str], list[bool]] = {(effect, size): [] for effect in given.effects for size in SIZES}
    for number in range(given.draws):
        rng = np.random.default_rng([seed, number])
        clean = draw_clean(ARMS[number % len(ARMS)], rng)
        limits = [limit for limit in judge(clean).detection_limits if is_usable(clean, limit, given.effects)]
        for limit in pick(limits, given.each, rng):
            half, sure = limit.half_size, limit.size
            for name, value in zip(SIZES, (0.5 * half, half, sure, 2.0 * half), strict=True):
                diagnosis = judge(hide(clean, limit, value))
                found[limit.effect, name].append(is_named(diagnosis, limit))
                named = "" if found[limit.effect, name][-1] else tell(diagnosis, limit)
                print(clean.name, limit.effect, *limit.joints, f"{sure / half:.2f}", name, named or "found", flush=True)
    rows = [(effect, *format_shares([found[effect, size] for size in SIZES])) for effect in given.effects]
    every = [[hit for effect in given.effects for hit in found[effect, size]] for size in SIZES]
    show(
        f"Found around the limits, seed {seed}, {time.perf_counter() - start:.0f} s",
        [("effect", "cases", *SIZES), *rows, ("all", *format_shares(every))],
    )


def count_in_parts(seed: int, draws: int, count: int, effects: list[str]) -> list[tuple[str, str]]:
    """Hide effects of their usual size and count the parts of the recordings in which they are named."""
    hits: dict[str, list[bool]] = {part: [] for part in PARTS}
    for number in range(draws):
        rng = np.random.default_rng([seed, number])
        clean = draw_clean(ARMS[number % len(ARMS)], rng)
        limits = {
            part: {
                (limit.effect, limit.joints): limit
                for limit in judge(clean, part).detection_limits
                if is_usable(clean, limit, effects) and limit.share <= 1.0
            }
            for part in PARTS
        }
        for limit in pick(list(limits["whole"].values()), count, rng):
            case = hide(clean, limit, limit.usual)
            for part in PARTS:
                if (limit.effect, limit.joints) in limits[part]:
                    diagnosis = judge(case, part)
                    hits[part].append(is_named(diagnosis, limit))
                    named = "found" if hits[part][-1] else tell(diagnosis, limit)
                    print(clean.name, limit.effect, *limit.joints, f"{limit.share:.2f}", part, named, flush=True)
    return [(part, f"{sum(own)}/{len(own)}") for part, own in hits.items()]


def draw_clean(arm: str, rng: np.random.Generator) -> Case:
    """Draw how an arm with nothing hidden is moved and recorded."""
    session = tuple(Take(k * (DURATION + PAUSE), DURATION, pace=pace) for k, pace in enumerate(PACES))
    instruments = Instruments(2 ** int(rng.integers(17, 20)), float(rng.uniform(0.004, 0.008)), 250.0)
    manner = Manner("fourier", int(rng.integers(2**31)), Bandwidth(float(rng.uniform(5.0, 15.0))), 1.0)
    noise = int(rng.integers(2**31))
    return Case(f"{arm} {noise % 1000}", arm, (), "full", instruments, manner, noise, session)


def judge(case: Case, part: str = "whole") -> Diagnosis:
    """Simulate a case, identify and diagnose a part of its recordings."""
    whole = recorded(case)
    recordings = replace(whole, runs=tuple(cut(run, *PARTS[part]) for run in whole.runs)).recordings(held_out=False)
    return diagnose(identify(as_described(arm_by_name(case.arm), case.noise), recordings, []), recordings)


def cut(run: Run, begin: float, end: float) -> Run:
    """Return a part of a run, between two shares of its samples."""
    rows = slice(int(begin * len(run.t)), int(end * len(run.t)))
    signals = {name: getattr(run, name)[rows] for name in ("t", "q", "tau", "exact_tau")}
    return replace(run, **signals)


def is_usable(case: Case, limit: DetectionLimit, effects: list[str]) -> bool:
    """Whether there is a limit that an arm could have: up to three times of what is usual."""
    robot = arm_by_name(case.arm)
    joint = robot.joint_names.index(limit.joints[0]) if limit.joints else 0
    # A joint of the simulator's coupling needs a next one.
    is_last = limit.effect == "transmission_coupling" and joint == robot.n - 1
    return limit.effect in effects and limit.share <= 3.0 and not is_last


def pick(limits: list[DetectionLimit], count: int, rng: np.random.Generator) -> list[DetectionLimit]:
    """Draw some effects, each on one of its joints."""
    effects = list(dict.fromkeys(limit.effect for limit in limits))
    chosen = rng.permutation(len(effects))[:count]
    places = [[limit for limit in limits if limit.effect == effects[k]] for k in chosen]
    return [own[int(rng.integers(len(own)))] for own in places]


def hide(clean: Case, limit: DetectionLimit, size: float) -> Case:
    """Hide an effect in a clean arm, all of its parameters in proportion to the one that has the size."""
    robot = arm_by_name(clean.arm)
    joint = robot.joint_names.index(limit.joints[0]) if limit.joints else 0
    usual = get_effect(limit.effect).usual(robot, joint)
    assert usual is not None
    values = {name: float(value) * size / limit.usual for name, value in usual.values.items()}
    shape = {"delta": 2.0, **usual.shape, **dict(limit.shape)}
    physics = LAWS[limit.effect](robot, joint, values, shape)
    return replace(clean, hidden=(Placed(limit.effect, (joint,), physics),))


def is_named(diagnosis: Diagnosis, limit: DetectionLimit) -> bool:
    """Whether the effect, or one that the data do not tell from it, is recommended on its joint."""
    return any(
        item.significant
        and limit.effect in (item.effect, *item.equivalent)
        and (not limit.joints or limit.joints[0] in item.joints)
        for item in diagnosis.candidates
    )


def tell(diagnosis: Diagnosis, limit: DetectionLimit) -> str:
    """Return why an effect was not named, and what was in its place."""
    reason = diagnosis.why_not(limit.effect, limit.joints[0] if limit.joints else "")
    others = ", ".join(str(choice) for choice in diagnosis.recommended)
    values = " ".join(f"{k}={v:.3g}" if isinstance(v, float) else f"{k}={v}" for k, v in reason.values)
    return f"{reason.code} {values} [{others}]"


def format_shares(hits: list[list[bool]]) -> tuple[str, ...]:
    return str(len(hits[0])), *(f"{np.mean(own):.0%}" if own else "-" for own in hits)


if __name__ == "__main__":
    main()
