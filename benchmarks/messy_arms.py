"""Is a larger effect named where every joint has small ones of every kind? Real arms are like that.

    python benchmarks/messy_arms.py [--seed 1 | --seed new] [--cases 12] [--processes 1] [--json out.json]

Every joint slips before it slides, has Stribeck friction, a gear ripple and a torque gain that is off; four runs at
full speed and below it are logged at 125 Hz, the torque one sample late. One larger effect is hidden on top.
Counted are: cases in which it is among the recommended, cases among these in which its joint is right, and cases in
which a name is recommended that neither the mess nor the hidden effect has, nor any name that is told as its equal.
Of a hidden effect that is not named, its detection limit is printed: below that, the recordings do not show it.
"""

from __future__ import annotations

import argparse
import json
import os
import secrets
import time
from functools import partial
from pathlib import Path

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(name, "1")

import numpy as np
from common import show
from engine import Bandwidth, Instruments, disturbances, friction, structure
from engine.drives import effort_limits, speed_limits, usual_drives
from engine.robots import arm_by_name, as_described
from hiding.asking import each, kept
from hiding.case import Case, Manner, Placed, Take
from hiding.families import FAMILIES
from hiding.recorded import recorded
from hiding.site import Site

from dynident.diagnosis import diagnose
from dynident.identification import identify

RATE, PAUSE, PACES = 125.0, 3.0, (1.0, 0.8, 0.5, 0.2)
ARMS = ("ur10", "franka_panda", "ur5")
# The larger effects that a mess does not have itself.
LARGER = (
    "offset", "joint_spring", "load_dependent_friction", "viscous_nonlinear", "base_tilt",
    "position_dependent_friction", "viscous_asymmetric", "encoder_zero_error", "transmission_coupling",
    "gravity_compensator", "drive_gain_saturation", "coulomb_asymmetric",
)  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", default="1", help='a number, or "new"')
    parser.add_argument("--cases", type=int, default=len(LARGER))
    parser.add_argument("--duration", type=float, default=18.0, help="s of a run")
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--json", type=Path, default=None, help="write every outcome here")
    parser.add_argument("--cache", type=Path, default=kept())
    given = parser.parse_args()
    seed = secrets.randbelow(10**6) if given.seed == "new" else int(given.seed)
    start = time.perf_counter()
    outcomes = []
    for outcome in each(
        partial(judge, folder=given.cache), draw_cases(seed, given.cases, given.duration), given.processes
    ):
        outcomes.append(outcome)
        print(outcome, flush=True)
    hits = [outcome for outcome in outcomes if outcome["named"]]
    if given.json:
        given.json.write_text(json.dumps(outcomes, indent=1))
    show(
        f"Messy arms, seed {seed}, {time.perf_counter() - start:.0f} s",
        [
            ("named", f"{len(hits)}/{len(outcomes)}"),
            ("joint right", f"{sum(bool(outcome['joint']) for outcome in hits)}/{len(hits)}"),
            ("a name that is not there", f"{sum(bool(outcome['extra']) for outcome in outcomes)}/{len(outcomes)}"),
            ("seconds of a diagnosis", f"{np.median([outcome['seconds'] for outcome in outcomes]):.1f}"),
        ],
    )


def draw_cases(seed: int, n_cases: int, duration: float) -> list[Case]:
    """Draw arms with a mess on every joint and one larger effect."""
    cases = []
    for number in range(n_cases):
        rng = np.random.default_rng([seed, number])
        arm, effect = ARMS[(seed + number) % len(ARMS)], LARGER[number % len(LARGER)]
        session = tuple(
            Take(k * (duration + PAUSE), duration, held_out, k > 0 and not held_out, pace)
            for k, (pace, held_out) in enumerate([*((pace, False) for pace in PACES), (0.7, True)])
        )
        site = Site(arm_by_name(arm), rng, 1.0, session)
        hidden = (*draw_mess(site), FAMILIES[effect](site))
        instruments = Instruments(2 ** int(rng.integers(17, 20)), float(rng.uniform(0.004, 0.008)), RATE)
        manner = Manner("fourier", int(rng.integers(2**31)), Bandwidth(float(rng.uniform(5.0, 15.0))), 1.0)
        name = f"{effect} {arm} #{number}"
        cases.append(Case(name, arm, hidden, "full", instruments, manner, int(rng.integers(2**31)), session))
    return cases


def draw_mess(site: Site) -> tuple[Placed, ...]:
    """Draw the small effects that every joint has."""
    drives, effort, speed = usual_drives(site.robot), effort_limits(site.robot), speed_limits(site.robot)
    mess = []
    for j in range(site.robot.n):
        coulomb, slip = float(drives.coulomb[j]), float(np.exp(site.between(np.log(2e-3), np.log(8e-3))))
        slow = site.between(0.02, 0.08) * float(speed[j]) / 2.5
        ripple = site.between(0.002, 0.005) * float(effort[j])
        mess += [
            Placed("presliding", (j,), friction.Dahl(j, slip)),
            Placed("stribeck", (j,), friction.Stribeck(j, site.between(0.1, 0.3) * coulomb, slow)),
            Placed("torque_ripple", (j,), structure.Ripple(j, (ripple,), (site.between(8.0, 40.0),), (0.0,))),
            Placed("drive_gain_error", (j,), disturbances.GainError(j, site.sign() * site.between(0.01, 0.04))),
        ]
    return (*mess, Placed("torque_delay", (), disturbances.Delay(1.0 / RATE)))


def judge(case: Case, folder: Path | None) -> dict[str, object]:
    """Simulate a case, identify, diagnose and compare with what is hidden."""
    data, robot = recorded(case, folder), as_described(arm_by_name(case.arm), case.noise)
    training, validation = data.recordings(held_out=False), data.recordings(held_out=True)
    plain = identify(robot, training, validation)
    start = time.perf_counter()
    diagnosis = diagnose(plain, training, validation=validation)
    seconds = time.perf_counter() - start
    target = case.hidden[-1]
    hits = [
        item
        for item in diagnosis.candidates
        if item.significant and set(target.names) & {item.effect, *item.equivalent}
    ]
    joints = {robot.joint_names[j] for j in target.joints}
    there = {name for placed in case.hidden for name in placed.names}
    equal = {item.choice: item.equivalent for item in diagnosis.candidates if item.significant}
    places = sorted(joints) or [""]
    return {
        "case": case.name,
        "joints": sorted(joints),
        "named": bool(hits),
        "joint": any(not joints or not item.joints or joints & set(item.joints) for item in hits),
        "extra": sorted(
            {choice.effect for choice in diagnosis.recommended if not there & {choice.effect, *equal.get(choice, ())}}
        ),
        "hidden": str(target.physics),
        "why not": "" if hits else [diagnosis.why_not(name, joint).text for name in target.names for joint in places],
        "recommended": [str(choice) for choice in diagnosis.recommended],
        "seconds": seconds,
    }


if __name__ == "__main__":
    main()
