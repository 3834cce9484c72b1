"""One case from simulation to judgement: identify, diagnose, add what is recommended, hold it against the truth."""

from __future__ import annotations

import time
import traceback
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from engine.disturbances import Contact
from engine.robots import arm_by_name, as_described

from dynident.diagnosis import Diagnosis, compare, diagnose
from dynident.effects import CATALOGUE, EffectChoice
from dynident.errors import DynidentError
from dynident.identification import Identification, extend, identify
from dynident.recordings import Recording, low_pass
from dynident.robot import Robot
from hiding.case import Case, Placed
from hiding.moving import moving_at
from hiding.outcome import Hint, HowRecorded, Naming, Outcome
from hiding.recorded import Recorded, label_of, recorded
from hiding.visibility import SHOWS, excess

# Hz, where the program does not filter the torque.
_BAND = 20.0


def judge_safely(case: Case, folder: Path | None, shows: float = SHOWS) -> Outcome:
    """Judge a case; where anything raises, the outcome says what."""
    try:
        return judge(case, folder, shows)
    except Exception as error:
        where = traceback.extract_tb(error.__traceback__)[-1]
        return _failed(case, f"{type(error).__name__}: {error} ({Path(where.filename).name}:{where.lineno})")


def judge(case: Case, folder: Path | None, shows: float = SHOWS) -> Outcome:
    """Simulate (or fetch) a case, run the product on it, compare.

    An effect counts as one that shows from this excess on.
    """
    start = time.perf_counter()
    data = recorded(case, folder)
    robot = as_described(arm_by_name(case.arm), case.noise)
    left = _excess(data, folder)
    simulating = time.perf_counter() - start
    training, held_out = data.recordings(held_out=False), data.recordings(held_out=True)
    start = time.perf_counter()
    plain = identify(robot, training, held_out)
    diagnosis = diagnose(plain, training, validation=held_out)
    better = extend(plain, diagnosis.recommended, training, held_out) if diagnosis.recommended else plain
    seconds = time.perf_counter() - start
    true = _true_structure(case, robot, plain, training, held_out)
    outcome = named(case, robot, diagnosis)
    before, after = error_over_noise(plain, data), error_over_noise(better, data)
    oracle = error_over_noise(true, data) if true else None
    return replace(
        outcome,
        excess=left,
        shows=left >= shows,
        plain=before,
        after=after,
        oracle=before if case.kind == "clean" else oracle,
        oracle_gain=None if oracle is None else 1 - oracle / before,
        parameter_errors=parameter_errors(case, robot, better),
        seconds=seconds,
        simulating=simulating,
    )


def error_over_noise(found: Identification, data: Recorded) -> float:
    """Held-out residual over what the filter leaves of the torque sensor's noise, joints taken together.

    Of the rows in which a joint moves, which is told apart without the program: where it sticks, nobody could know.
    """
    robot, cutoff = arm_by_name(data.case.arm), found.preprocessing.torque_cutoff
    taps = low_pass(data.case.instruments.rate, cutoff)
    floor = data.runs[0].noise * float(np.sqrt((taps**2).sum()))
    residuals, clear = [], []
    for numbers, recording in zip(data.files(held_out=True), data.recordings(held_out=True), strict=True):
        compared = compare(found, recording)
        for segment, number in enumerate(numbers):
            rows = compared.segment == segment
            residuals.append(compared.residual[rows])
            clear.append(moving_at(compared.t[rows], data.runs[number], robot, cutoff or _BAND))
    squares, counted = np.concatenate(residuals) ** 2, np.concatenate(clear)
    joints = counted.any(axis=0)
    rms = np.sqrt((squares * counted).sum(axis=0)[joints] / counted.sum(axis=0)[joints])
    return float(np.sqrt(np.mean((rms / floor[joints]) ** 2)))


def parameter_errors(case: Case, robot: Robot, found: Identification) -> tuple[tuple[str, float], ...]:
    """Relative errors of the hidden effects' main parameters that the model has."""
    errors = []
    for placed in case.hidden:
        links = {robot.joint_names[j] for j in placed.joints} or {""}
        for truth in placed.truths:
            names = {name + str(j + 1) for name in truth.names for j in placed.joints} or set(truth.names)
            values = [
                p.value
                for p in found.parameters
                if p.effect in placed.names and (p.link in links or not placed.joints) and p.name in names
            ]
            if len(values) == len(truth.names):
                value = values[0] if len(values) == 1 and truth.signed else float(np.linalg.norm(values))
                true = truth.value if truth.signed else abs(truth.value)
                errors.append(("+".join(truth.names), abs(value - true) / abs(true)))
    return tuple(errors)


def choice_of(case: Case, placed: Placed, robot: Robot) -> EffectChoice | None:
    """The hidden effect as the product would be told of it; None where it does not know it."""
    effect = next((name for name in placed.names if name in CATALOGUE), None)
    if effect is None or not placed.in_catalogue:
        return None
    # What reaches over two joints is named by the first.
    joints = placed.joints[:1] if effect in ("transmission_coupling", "cable_force") else placed.joints
    names = tuple(robot.joint_names[j] for j in joints) if CATALOGUE[effect].scope == "joint" else ()
    return EffectChoice(effect, names, _shape(case, placed), runs=runs_of(case, placed))


def _shape(case: Case, placed: Placed) -> tuple[tuple[str, float], ...]:
    if not isinstance(placed.physics, Contact):
        return placed.shape
    start = case.session[placed.physics.runs[0]].start
    return ("t0", start + placed.physics.begin), ("t1", start + placed.physics.end)


def runs_of(case: Case, placed: Placed) -> tuple[str, ...]:
    """Labels of the runs that an effect is in; empty: all."""
    return tuple(label_of(case, index) for index in getattr(placed.physics, "runs", ()))


def _excess(data: Recorded, folder: Path | None) -> float:
    """Of the effect that shows least."""
    case = data.case
    if not case.hidden:
        return 0.0
    if len(case.hidden) == 1:
        return float(excess(data, folder).max())
    alone = [replace(case, hidden=(placed,)) for placed in case.hidden]
    return min(float(excess(recorded(one, folder), folder).max()) for one in alone)


def _true_structure(
    case: Case, robot: Robot, plain: Identification, training: Sequence[Recording], held_out: Sequence[Recording]
) -> Identification | None:
    choices = [choice_of(case, placed, robot) for placed in case.hidden]
    known = [choice for choice in choices if choice is not None]
    if not known or len(known) < len(choices):
        return None
    try:
        return extend(plain, known, training, held_out)
    except DynidentError:
        return None


def named(case: Case, robot: Robot, diagnosis: Diagnosis) -> Outcome:
    """What the diagnosis says, held against what is hidden. Errors and times are filled in by the caller."""
    recommended = diagnosis.recommended
    first = diagnosis.candidates[0] if recommended and diagnosis.candidates else None
    names = {name for placed in case.hidden for name in placed.names}
    naming: Naming = "none"
    meant: Placed | None = None
    if first is not None:
        meant = next((p for p in case.hidden if first.effect in p.names), None)
        naming = "right" if meant else "wrong"
        if meant is None and case.kind != "outside":
            meant = next((p for p in case.hidden if set(first.equivalent) & set(p.names)), None)
            naming = "equivalent" if meant else "wrong"
    three = {name for c in diagnosis.candidates[:3] for name in (c.effect, *(c.equivalent if c.significant else ()))}
    told = {(u.joint, str(u.variable)) for u in diagnosis.unknown}
    right_unknown = any(
        (robot.joint_names[j], variable) in told for p in case.hidden for j in p.joints[:1] for variable in p.variables
    )
    return replace(
        _failed(case, ""),
        verdict=diagnosis.verdict,
        naming=naming,
        in_three=bool(three & names),
        joint=None if first is None or meant is None else _on_its_joint(meant, first.joints, robot),
        complete=bool(case.hidden) and all(_found(p, diagnosis, robot) for p in case.hidden),
        beside=_beside(case, diagnosis, robot),
        extra=_extra(case, diagnosis),
        unknown_right=right_unknown,
        recommended=tuple(_told(choice) for choice in recommended),
        unknown=tuple(f"{u.joint} over {u.variable} ({u.share:.0%})" for u in diagnosis.unknown),
        hints=tuple(
            Hint(c.effect, c.joints, c.significant, c.equivalent, c.evidence) for c in diagnosis.candidates[:4]
        ),
    )


def _beside(case: Case, diagnosis: Diagnosis, robot: Robot) -> tuple[str, ...]:
    """Recommended effects that are not hidden, and joints on which a hidden effect is not."""
    found: set[str] = set()
    twins = _twins(case, diagnosis)
    for choice in diagnosis.recommended:
        meant = [placed for placed in case.hidden if choice.effect in placed.names]
        if not meant and choice.effect not in twins:
            found.add(choice.effect)
        elsewhere = set(choice.joints) - {robot.joint_names[j] for placed in meant for j in placed.joints}
        if meant and all(placed.joints for placed in meant):
            found |= {f"{choice.effect} on {name}" for name in elsewhere}
    return tuple(sorted(found))


def _extra(case: Case, diagnosis: Diagnosis) -> tuple[str, ...]:
    """Recommended names that are not there, whatever stands beside them and whatever they are equivalent to."""
    there = {name for placed in case.hidden for name in placed.names}
    return tuple(dict.fromkeys(choice.effect for choice in diagnosis.recommended if choice.effect not in there))


def _twins(case: Case, diagnosis: Diagnosis) -> set[str]:
    """Recommended names that are reported as equivalent to what is hidden."""
    names = {name for placed in case.hidden for name in placed.names if placed.in_catalogue}
    return {c.effect for c in diagnosis.candidates if c.significant and set(c.equivalent) & names}


def _found(placed: Placed, diagnosis: Diagnosis, robot: Robot) -> bool:
    return any(
        c.significant
        and set(placed.names) & {c.effect, *c.equivalent}
        and _on_its_joint(placed, c.joints, robot) is not False
        for c in diagnosis.candidates
    )


def _on_its_joint(placed: Placed, joints: Sequence[str], robot: Robot) -> bool | None:
    """None where either has no joint."""
    if not placed.joints or not joints:
        return None
    return bool({robot.joint_names[j] for j in placed.joints} & set(joints))


def _told(choice: EffectChoice) -> str:
    shape = ", ".join(f"{name} {value:.3g}" for name, value in choice.shape)
    runs = ", ".join(getattr(choice, "runs", ()))
    return (
        choice.effect
        + (f" on {', '.join(choice.joints)}" if choice.joints else "")
        + (f" ({shape})" if shape else "")
        + (f" in {runs}" if runs else "")
    )


def _failed(case: Case, failure: str) -> Outcome:
    robot = arm_by_name(case.arm)
    return Outcome(
        case=case.name, kind=case.kind, size=case.size, recorded=_how(case),
        effects=tuple(p.effect for p in case.hidden), arm=case.arm,
        joints=tuple(robot.joint_names[j] for p in case.hidden for j in p.joints), excess=0.0, shows=False,
        known=all(set(p.names) & set(CATALOGUE) for p in case.hidden), verdict="", naming="none", in_three=False,
        joint=None, complete=False, beside=(), extra=(), unknown_right=False, recommended=(), unknown=(), hints=(),
        plain=float("nan"), after=float("nan"), oracle=None, oracle_gain=None, parameter_errors=(), seconds=0.0,
        simulating=0.0, failure=failure,
    )  # fmt: skip


def _how(case: Case) -> HowRecorded:
    paces = tuple(dict.fromkeys(take.pace for take in case.session))
    return HowRecorded(case.manner.motion, case.manner.firmness, round(case.instruments.rate, 1), paces)
