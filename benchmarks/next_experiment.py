"""Does the proposed experiment decide? Virtual arms whose first data leave two effects open, and what is proposed next.

    python benchmarks/next_experiment.py [--seed 1 | --seed new] [--cases 30] [--pairs stribeck+viscous_nonlinear,…]

A case is an arm of the library with one effect of a pair of rivals in it and a first motion too poor to tell which:
small, in one place, quick, or short. Counted are cases in which one of the two is recommended first and the data do not
decide: the wrong one, or the right one with the other as an equal or in the question asked next. Of these the proposed
design is made as it is posted (with the data at hand as earlier runs), the virtual arm executes it, and both runs
together are identified and diagnosed.

`asked`: the experiment is about the two; `right`: then the true one is recommended and the other is not; `first`:
nothing stands before it either; `alone`: the other is no equal any more (what includes the true one always is).
`designed`, `reached` and `given` are standard deviations over the one that was promised: what the design made expects,
and that of the identified parameter beside its rival, with the shape constants of both uncertain (as an identification
tells it) and with these as they are (what was promised).
"""

from __future__ import annotations

import argparse
import os
import secrets
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from unittest.mock import patch

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(name, "1")

import numpy as np
from common import FloatArray, show

from dynident.advice import AdvisedDiagnosis, NextExperiment, advise
from dynident.diagnosis import Diagnosis, DiagnosisChoices, examine
from dynident.effects import EffectChoice, get_effect
from dynident.errors import DynidentError
from dynident.excitation import Design, design_experiment
from dynident.identification import IdentificationChoices, identify
from dynident.recordings import Recording, recording_from_arrays
from dynident.robot import Robot, robot_from_library
from dynident.simulation import (
    Reference,
    Sensors,
    SimulationRequest,
    TrueEffect,
    build_typical_effect,
    list_drive_effects,
    simulate,
)

ARMS = ("ur5", "ur10", "franka_panda")
PAIRS = (
    ("joint_spring", "gravity_compensator"),
    ("offset", "joint_spring"),
    ("stribeck", "viscous_nonlinear"),
    ("load_dependent_friction", "position_dependent_friction"),
    ("torque_delay", "joint_elasticity"),
    ("torque_ripple", "joint_spring"),
    ("presliding", "stribeck"),
    ("load_dependent_friction", "drive_gain_saturation"),
)
_DRIVES = ("rigid_body", "rotor_inertia", "coulomb", "viscous")
_RATE = 250.0
# So many motions are tried before a case counts as one that every motion decides.
_TRIES = 4


@dataclass(frozen=True)
class Case:
    """An arm, what is hidden in it, what it may be taken for, and the first motion."""

    arm: str
    hidden: TrueEffect
    rival: str
    seed: int
    duration: float
    amplitude: float
    fastest: float

    @property
    def name(self) -> str:
        """For a table."""
        return f"{self.arm} {self.hidden.effect} {self.hidden.joint or 'robot'} (not {self.rival})"


@dataclass(frozen=True)
class Outcome:
    """What came of a case whose first data did not decide. Ratios are None where nothing was promised."""

    case: Case
    asked: bool
    right: bool
    first: bool
    alone: bool
    designed: float | None
    reached: float | None
    given: float | None
    words: str


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--seed", default="1", help='a number, or "new"')
    parser.add_argument("--cases", type=int, default=30)
    parser.add_argument("--two", action="store_true", help="diagnose among the two and the names they are taken for")
    parser.add_argument("--pairs", default="", help="names joined by +, with commas between pairs")
    arguments = parser.parse_args()
    seed = secrets.randbelow(10**6) if arguments.seed == "new" else int(arguments.seed)
    pairs = [tuple(pair.split("+")) for pair in arguments.pairs.split(",") if pair] or list(PAIRS)
    start = time.perf_counter()
    outcomes = []
    print(f"seed {seed}", flush=True)
    for outcome in run(seed, pairs, arguments.two):
        outcomes.append(outcome)
        print(f"  {len(outcomes):2d} {_line(outcome)}", flush=True)
        if len(outcomes) == arguments.cases:
            break
    show(f"Next experiments, seed {seed}, {time.perf_counter() - start:.0f} s", _table(outcomes))


def run(seed: int, pairs: Sequence[Sequence[str]], two: bool) -> Iterator[Outcome]:
    """Outcomes of cases that the first data do not decide, pair by pair in turn, without end."""
    number = 0
    while True:
        pair = pairs[number % len(pairs)]
        rng = np.random.default_rng([seed, number])
        number += 1
        case = _drawn(rng, pair)
        for _ in range(_TRIES):
            try:
                outcome = judged(case, two)
            except DynidentError as error:
                print(f"     {case.name}: {error}", flush=True)
                outcome = None
            if outcome is not None:
                yield outcome
                break
            case = _other_motion(case, rng)


def _drawn(rng: np.random.Generator, pair: Sequence[str]) -> Case:
    arm = str(rng.choice(ARMS))
    robot = robot_from_library(arm)
    hidden, rival = (str(name) for name in rng.permutation(pair))
    possible = [set(get_effect(name).applicable(robot)) for name in pair if get_effect(name).scope == "joint"]
    joint = robot.joint_names[int(rng.choice(sorted(set.intersection(*possible))))]
    size = float(rng.uniform(0.6, 1.5))
    typical = build_typical_effect(robot, hidden, joint if get_effect(hidden).scope == "joint" else "")
    placed = replace(typical, values=tuple((name, size * value) for name, value in typical.values))
    return _other_motion(Case(arm, placed, rival, 0, 0.0, 0.0, 0.0), rng)


def _other_motion(case: Case, rng: np.random.Generator) -> Case:
    return replace(
        case,
        seed=int(rng.integers(2**31)),
        duration=float(rng.uniform(10.0, 25.0)),
        amplitude=float(rng.uniform(0.25, 1.0)),
        fastest=float(rng.uniform(0.4, 0.9)),
    )


def judged(case: Case, two: bool) -> Outcome | None:
    """Diagnose, make the proposed motion, diagnose again; None where the first data decide."""
    robot = robot_from_library(case.arm)
    choices = IdentificationChoices(tuple(EffectChoice(name) for name in _model(case)))
    first = measured(robot, case, first_motion(robot, case), 1, "first")
    tried = DiagnosisChoices(tuple(_names(case)) if two else None)
    found = advise(examine(identify(robot, [first], [], choices), [first], tried))
    if _decided(found, case):
        return None
    if not _between(found, case):
        return None
    advice = found.next_experiment
    if advice is None:
        return Outcome(case, False, False, False, False, None, None, None, f"{_said(found)}; nothing proposed")
    asked = {one.effect for one in advice.design.criterion.effects}
    about = asked == {case.hidden.effect, case.rival}
    design = design_experiment(robot, advice.design, earlier=[first])
    second = measured(robot, case, Reference(design.t, design.q, design.dq, design.ddq), 2, "proposed")
    runs = [first, second]
    again = advise(examine(identify(robot, runs, [], choices), runs, tried))
    recommended = [one.effect for one in again.recommended]
    return Outcome(
        case,
        about,
        _is_right(again, case),
        bool(recommended) and recommended[0] == case.hidden.effect,
        _is_right(again, case) and not _is_equal(again, case),
        *_kept(robot, advice, design, runs, replace(choices, effects=_refined(advice, again))),
        f"{_said(found)}; {design.request.kind} {'/'.join(sorted(asked))} {design.duration:.0f} s; {_said(again)}",
    )


def _model(case: Case) -> tuple[str, ...]:
    pair = {case.hidden.effect, case.rival}
    return _DRIVES if "offset" in pair else (*_DRIVES, "offset")


def _between(found: Diagnosis, case: Case) -> bool:
    """Whether one of the two stands first: with a third name before them the question is another one."""
    return bool(found.recommended) and found.recommended[0].effect in (case.hidden.effect, case.rival)


def _names(case: Case) -> list[str]:
    pair = (case.hidden.effect, case.rival)
    return sorted({*pair, *(other for name in pair for other in get_effect(name).confused_with)} - set(_model(case)))


def _is_right(found: Diagnosis, case: Case) -> bool:
    """Whether of the two the true one alone is recommended in its place; what is said of other joints is not asked."""
    here = {
        one.effect
        for one in found.recommended
        if not one.joints or not case.hidden.joint or case.hidden.joint in one.joints
    }
    return case.hidden.effect in here and case.rival not in here


def _is_equal(found: Diagnosis, case: Case) -> bool:
    """Whether the other one is said to explain the data as well."""
    return any(
        item.effect == case.hidden.effect and item.significant and case.rival in item.equivalent
        for item in found.candidates
    )


def _decided(found: AdvisedDiagnosis, case: Case) -> bool:
    """Whether the data decide: the true one alone is recommended, and what is proposed next is not about the two."""
    if not _is_right(found, case) or _is_equal(found, case):
        return False
    if found.next_experiment is None:
        return True
    about = {one.effect for one in found.next_experiment.design.criterion.effects}
    return about != {case.hidden.effect, case.rival}


def _kept(
    robot: Robot, advice: NextExperiment, design: Design, runs: Sequence[Recording], choices: IdentificationChoices
) -> tuple[float | None, float | None, float | None]:
    """Standard deviation by the design made, and twice by the identification with both, over the promised one."""
    promised = advice.expected_separation
    if promised is None:
        return None, None, None
    expected = next(one for one in design.expected if one.name == promised.parameter).standard_deviation

    def identified() -> float | None:
        # Deviations are computed when they are looked at.
        parameters = identify(robot, runs, [], choices).parameters
        return next((one.standard_deviation for one in parameters if one.name == promised.parameter), None)

    told = [identified()]
    with patch("dynident.identification.estimation_problem.linearise_shapes", lambda *_, **__: None):
        told.append(identified())
    by_design, *reached = (None if one is None else one / promised.standard_deviation for one in (expected, *told))
    return by_design, reached[0], reached[1]


def _refined(advice: NextExperiment, again: Diagnosis) -> tuple[EffectChoice, ...]:
    """The model with both rivals, with the shape constants that the second diagnosis found."""
    found = {one.effect: one for one in again.recommended}
    effects = [found.get(one.effect, one) for one in advice.design.effects or ()]
    return tuple(dict.fromkeys(effects))


def first_motion(robot: Robot, case: Case) -> Reference:
    """A sum of sines about one posture, as wide and as quick as the case says."""
    rng = np.random.default_rng(case.seed)
    t = np.arange(round(case.duration * _RATE)) / _RATE
    rates = 2 * np.pi * rng.uniform(0.08, 0.2) * np.arange(1, 5)[:, None]
    made: list[FloatArray] = [np.zeros((len(t), robot.n)) for _ in range(3)]
    for j, joint in enumerate(robot.joints):
        low, high = joint.limits.position or (-2.0, 2.0)
        size, phase = rng.uniform(0.3, 1.0, (4, 1)) / rates**0.5, rng.uniform(0, 2 * np.pi, (4, 1))
        angle = rates * t + phase
        waves = [size * np.sin(angle), size * rates * np.cos(angle), -size * rates**2 * np.sin(angle)]
        x, dx, ddx = (wave.sum(axis=0) for wave in waves)
        room = min(case.amplitude, 0.45 * (high - low))
        limit = case.fastest * (joint.limits.velocity or 2.0)
        scale = min(room / np.abs(x).max(), limit / np.abs(dx).max())
        centre = np.clip(rng.uniform(-0.5, 0.5) + 0.5 * (low + high), max(low + room, -2.0), min(high - room, 2.0))
        for signal, values in zip(made, (centre + scale * x, scale * dx, scale * ddx), strict=True):
            signal[:, j] = values
    return Reference(t, *made)


def measured(robot: Robot, case: Case, motion: Reference, run: int, name: str) -> Recording:
    """What the virtual arm records on a motion."""
    sensors = Sensors(sampling_rate=_RATE)
    effects = (*list_drive_effects(robot), case.hidden)
    seed = (case.seed + run) % 2**31
    taken = simulate(robot, SimulationRequest(motion, effects, sensors=sensors, seed=seed))
    return recording_from_arrays(taken.t, taken.q, taken.tau, joint_names=robot.joint_names, name=name)


def _said(found: Diagnosis) -> str:
    equal = {item.effect: item.equivalent for item in found.candidates if item.significant}
    parts = []
    for one in found.recommended:
        others = f" or {', '.join(equal[one.effect])}" if equal.get(one.effect) else ""
        parts.append(f"{one.effect} {','.join(one.joints)}{others}")
    return "; ".join(parts) or found.verdict


def _line(outcome: Outcome) -> str:
    def ratio(value: float | None) -> str:
        return "-" if value is None else f"{value:.2f}"

    marks = "".join(
        letter if yes else "."
        for letter, yes in zip("arfe", (outcome.asked, outcome.right, outcome.first, outcome.alone), strict=True)
    )
    ratios = " ".join(map(ratio, (outcome.designed, outcome.reached, outcome.given)))
    return f"{marks} {outcome.case.name}: {outcome.words} [{ratios}]"


def _table(outcomes: Sequence[Outcome]) -> list[tuple[str, str]]:
    count = len(outcomes)
    rows = [
        (what, f"{sum(values)}/{count}")
        for what, values in (
            ("asked", [one.asked for one in outcomes]),
            ("right", [one.right for one in outcomes]),
            ("first", [one.first for one in outcomes]),
            ("alone", [one.alone for one in outcomes]),
        )
    ]
    for what, ratios in (
        ("designed", [one.designed for one in outcomes if one.designed is not None]),
        ("reached", [one.reached for one in outcomes if one.reached is not None]),
        ("given", [one.given for one in outcomes if one.given is not None]),
    ):
        within = sum(1 / 1.5 <= value <= 1.5 for value in ratios)
        spread = (
            ", ".join(f"{value:.2f}" for value in np.quantile(ratios, [0.0, 0.25, 0.5, 0.75, 1.0])) if ratios else ""
        )
        rows.append((f"{what} / promised", f"{within}/{len(ratios)} within 1.5 (quartiles {spread})"))
    return rows


if __name__ == "__main__":
    main()
