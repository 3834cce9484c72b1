"""Which rules and levels of the diagnosis decide anything? Each is switched off, on cases with hidden effects.

    python benchmarks/decisive_rules.py --folders cases/71301 [--halting 10] [--messy 4] [--changes 6] [--json out.json]
    python benchmarks/decisive_rules.py --folders cases/81301 --only-names --json names.json

`--folders` has cases of `data.csv`, `robot.urdf` and `truth.json`; the others are simulated. A diagnosis runs once up
to its rules; from there it is finished in child processes. In the first, with all rules, each decision is also made
without the rule or level that it is due to: one that never decides otherwise cannot change the outcome. The others are
switched off in groups. Where a group changes nothing, none of it is decisive in this case; else the group is halved. A
switch that was decisive in `--enough` cases is not tried again. `other decision` counts the cases in which any decision
was another one without the rule. `better` and `worse` count the cases in which the first name, or the number of names
that are not there, became so.
"""

from __future__ import annotations

import argparse
import json
import os
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(name, "1")

import changes
import messy_arms
import numpy as np
import small_arms
from common import show
from engine.robots import arm_by_name, as_described
from hiding.drawing import Wanted, draw_cases
from hiding.manners import Manners
from hiding.recorded import recorded
from rule_switches import DECISIONS, FLOODGATES, RULES, SWITCHES, fork_at_rules

from dynident.diagnosis import Diagnosis, diagnose
from dynident.identification import Identification, identify
from dynident.recordings import FurtherColumns, Recording, recording_from_arrays
from dynident.robot import robot_from_urdf

WORDS = {
    "asym_coulomb": "coulomb_asymmetric",
    "visc_nl": "viscous_nonlinear",
    "load_dep": "load_dependent_friction",
    "temp": "temperature_friction",
    "warmup": "warm_up_friction",
    "cogging": "torque_ripple",
    "posfric": "position_dependent_friction",
    "hysteresis": "presliding",
    "spring": "joint_spring",
    "balancer": "gravity_compensator",
    "tilt": "base_tilt",
    "coupling": "transmission_coupling",
    "delay": "torque_delay",
    "gain_sat": "drive_gain_saturation",
    "elastic": "joint_elasticity",
    "enc_zero": "encoder_zero_error",
    "contact": "external_contact",
    "base_vib": "base_vibration",
    "hose": "cable_force",
    "wrong_kin": "kinematic_error",
    "unknown:q": "unknown:position",
}
"""Names of the cases in folders, as the catalogue has them."""


Runs = Sequence[Recording]
Prepared = tuple[Identification, Runs, Runs, Runs]


@dataclass(frozen=True)
class Case:
    """A case: how it is prepared, and groups of names of which each has to be among the findings.

    Parameters
    ----------
    name : str
        Name of the case.
    prepare : callable
        Returns the model, the recordings, those of a baseline, and held-out ones.
    accept : tuple of tuple of str
        A group for each hidden effect; none for a clean arm.
    """

    name: str
    prepare: Callable[[], Prepared]
    accept: tuple[tuple[str, ...], ...]


@dataclass
class Tally:
    """What became of a switch.

    Parameters
    ----------
    tried : int
        Cases in which it was switched off.
    fired : int
        Cases in which a decision was another one without it.
    decisive : list of str
        Cases in which names, joints or the conclusion changed.
    better, worse : int
        Of the decisive cases.
    """

    tried: int = 0
    fired: int = 0
    decisive: list[str] = field(default_factory=list)
    better: int = 0
    worse: int = 0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--folders", type=Path, nargs="*", default=[])
    parser.add_argument("--small", type=int, default=0, help="arms as in small_arms.py")
    parser.add_argument("--halting", type=int, default=0, help="arms that move from point to point")
    parser.add_argument("--messy", type=int, default=0, help="arms as in messy_arms.py")
    parser.add_argument("--changes", type=int, default=0, help="pairs of days as in changes.py")
    parser.add_argument("--enough", type=int, default=2, help="decisive cases after which a switch is not tried again")
    usual = [switch for switch in SWITCHES if switch not in FLOODGATES]
    parser.add_argument("--switches", nargs="*", default=usual, choices=SWITCHES)
    parser.add_argument("--only-names", action="store_true", help="switch nothing off")
    parser.add_argument("--json", type=Path, default=None, help="write every outcome here, and go on from there")
    given = parser.parse_args()
    start = time.perf_counter()
    stored = json.loads(given.json.read_text()) if given.json and given.json.exists() else {}
    names: dict[str, Any] = stored.get("names", {})
    tallies = {switch: Tally(**stored.get("switches", {}).get(switch, {})) for switch in given.switches}
    for case in list_cases(given.seed, given.folders, given.small, given.halting, given.messy, given.changes):
        if case.name in names:
            continue
        waiting = [] if given.only_names else [s for s in given.switches if len(tallies[s].decisive) < given.enough]
        begin = time.perf_counter()
        try:
            plain, changed, seconds = switch_off_in_groups(case, waiting)
        except Exception:
            print(case.name, traceback.format_exc(), flush=True)
            continue
        names[case.name] = {**plain, **score(plain, case), "seconds": seconds, "accept": case.accept}
        for switch in waiting:
            tallies[switch].tried += 1
            tallies[switch].fired += switch in plain["fired"]
        for switch, outcome in changed.items():
            record(tallies[switch], case, plain, outcome)
        told = {switch: outcome.get("names", outcome) for switch, outcome in changed.items()}
        spent = f"{seconds:.1f} s, {time.perf_counter() - begin:.0f} s of {len(waiting)} switches"
        print(case.name, plain["names"], plain["conclusion"], spent, told, flush=True)
        if given.json:
            content = {"names": names, "switches": {switch: vars(tally) for switch, tally in tallies.items()}}
            given.json.write_text(json.dumps(content, indent=1))
    if not given.only_names and names:
        show_switches(tallies, time.perf_counter() - start)
    show_names(names)


def list_cases(seed: int, folders: Sequence[Path], small: int, halting: int, messy: int, pairs: int) -> Iterator[Case]:
    """List all cases; they are simulated or read where they are prepared."""
    for arm in (small_arms.draw_small_arm(seed, number) for number in range(small)):
        hidden = "+".join(f"{name}@{joint + 1}" for name, joint in arm.hidden) or "clean"
        # What every joint of a messy arm has is no extra name.
        mess = (small_arms.MESS,) if arm.messy else ()
        kind = "messy small" if arm.messy else "small"
        yield Case(f"{kind} {seed} {arm.number} {hidden}", lambda arm=arm: prepare_small(arm), (*arm.accept, *mess))
    for number in range(pairs):
        pair = changes.drawn(seed, number)
        accept = () if pair.kind == "nothing" else (changes.NAMES[pair.kind],)
        yield Case(f"changes {seed} {number} {pair.text}", lambda pair=pair: prepare_pair(pair), accept)
    for each in messy_arms.draw_cases(seed, messy, 18.0):
        there = tuple({name for placed in each.hidden for name in placed.names})
        yield Case(
            f"messy {seed} {each.name}", lambda each=each: prepare_simulated(each), (each.hidden[-1].names, there)
        )
    for each in draw_cases(Wanted(seed, halting, sizes=("full",), manners=Manners(motions=("point-to-point",)))):
        yield Case(
            f"halting {seed} {each.name}",
            lambda each=each: prepare_simulated(each),
            tuple((*placed.names, *(f"unknown:{variable}" for variable in placed.variables)) for placed in each.hidden),
        )
    for folder in folders:
        for path in sorted(folder.glob("case_*")):
            truth = json.loads((path / "truth.json").read_text())
            groups = tuple(tuple(WORDS.get(name, name) for name in group) for group in truth["accept"])
            kind = f"{folder.name}/{path.name} {truth['case_kind']} {truth['robot']}"
            yield Case(kind, lambda path=path: prepare_folder(path), () if groups == (("none",),) else groups)


def prepare_folder(path: Path) -> Prepared:
    """Identify the arm of a folder."""
    robot = robot_from_urdf(path.parent.name, (path / "robot.urdf").read_text())
    fit, held = (read_csv(path / name, robot.joint_names) for name in ("data.csv", "holdout.csv"))
    return identify(robot, [fit], [held]), [fit], (), [held]


def read_csv(path: Path, joints: Sequence[str]) -> Recording:
    """Read a recording of a folder."""
    table, n = np.loadtxt(path, delimiter=",", skiprows=1), len(joints)
    heat = table[:, 2 + 2 * n :] if table.shape[1] > 2 + 2 * n else None
    return recording_from_arrays(
        table[:, 0],
        table[:, 2 : 2 + n],
        table[:, 2 + n : 2 + 2 * n],
        joint_names=tuple(joints),
        further=FurtherColumns(temperature=heat),
        segment=table[:, 1].astype(int),
        name=path.stem,
    )


def prepare_small(arm: small_arms.SmallArm) -> Prepared:
    """Record a small arm and identify it."""
    robot, training, held_out = arm.record()
    return identify(robot, [training], [held_out]), [training], (), [held_out]


def prepare_simulated(each: Any) -> Prepared:
    """Simulate an arm and identify it."""
    data, robot = recorded(each), as_described(arm_by_name(each.arm), each.noise)
    training, held_out = data.recordings(held_out=False), data.recordings(held_out=True)
    return identify(robot, training, held_out), training, (), held_out


def prepare_pair(pair: changes.Pair) -> Prepared:
    """Simulate two days of an arm and identify the first."""
    recordings = [changes.recorded(pair, day) for day in range(pair.days)]
    model = identify(as_described(arm_by_name(pair.arm), pair.seed), recordings[:1])
    return model, recordings[1:], recordings[:1], ()


def switch_off_in_groups(case: Case, switches: Sequence[str]) -> tuple[dict[str, Any], dict[str, Any], float]:
    """Diagnose a case with all rules, and find the switches that change its outcome."""
    identification, recordings, baseline, held_out = case.prepare()
    results: dict[str, Any] = {}

    def explore(finish: Callable[[Sequence[str]], Any]) -> None:
        begin = time.perf_counter()
        results["plain"] = plain = finish(("watch",) if switches else ("only names",))
        if "failed" in plain:
            raise RuntimeError(plain["failed"])
        results["rest"] = time.perf_counter() - begin
        watched = {*RULES, *DECISIONS}
        able = [switch for switch in switches if switch not in watched or switch in plain["fired"]]
        loose = [[switch] for switch in able if switch in FLOODGATES]
        groups = [*loose, [switch for switch in able if switch not in FLOODGATES]]
        while groups:
            group = groups.pop()
            if not group:
                continue
            outcome = finish(group)
            if is_same(plain, outcome):
                continue
            if len(group) == 1:
                results.setdefault("changed", {})[group[0]] = outcome
            else:
                groups += [group[: len(group) // 2], group[len(group) // 2 :]]

    begin = time.perf_counter()
    before = fork_at_rules(
        lambda: summarise(diagnose(identification, recordings, baseline=baseline, validation=held_out)), explore, begin
    )
    return results["plain"], results.get("changed", {}), before + results["rest"]


def summarise(diagnosis: Diagnosis) -> dict[str, Any]:
    """Return what counts of a diagnosis."""
    # Of two days the changes are what is said; the model of both has what is recommended.
    changed = [change.choice for change in diagnosis.changes or ()]
    choices = [*diagnosis.recommended, *changed]
    return {
        "names": [f"{choice.effect} {','.join(choice.joints)} {','.join(choice.runs)}".strip() for choice in choices],
        "effects": [choice.effect for choice in (changed or diagnosis.recommended)],
        "equivalent": [[*item.equivalent] for item in diagnosis.candidates if item.significant],
        "unknown": [f"{item.joint} {item.variable}" for item in diagnosis.unknown],
        "conclusion": diagnosis.conclusion.code if diagnosis.conclusion else "",
    }


def is_same(plain: dict[str, Any], outcome: dict[str, Any]) -> bool:
    """Return whether only the order, equivalents or unknown patterns differ."""
    if "failed" in plain or "failed" in outcome:
        return False
    return sorted(plain["names"]) == sorted(outcome["names"]) and plain["conclusion"] == outcome["conclusion"]


def score(outcome: dict[str, Any], case: Case) -> dict[str, Any]:
    """Return whether the first name is right, how many hidden effects are named, and how many names are not there."""
    if "failed" in outcome:
        return {"first": False, "hits": 0, "extra": 99}
    effects, unknown = outcome["effects"], ["unknown:" + text.split()[-1] for text in outcome["unknown"]]
    # An arm on which another effect is as good as none is right without a name.
    first = effects[0] if effects else "none"
    target = case.accept[0] if case.accept else ("none",)
    is_messy = case.name.startswith("messy")
    hits = [any(name in group for name in (*effects, *unknown)) for group in case.accept]
    right = hits[0] if is_messy else first in target or any(name in target for name in unknown)
    extra = sum(all(name not in group for group in case.accept) for name in effects)
    return {"first": right, "hits": sum(hits), "extra": extra}


def record(tally: Tally, case: Case, plain: dict[str, Any], outcome: dict[str, Any]) -> None:
    """Note what a switch changed in a case."""
    tally.decisive.append(case.name)
    before, after = score(plain, case), score(outcome, case)
    difference = (
        (after["first"] - before["first"]) + (after["hits"] - before["hits"]) - (after["extra"] - before["extra"])
    )
    tally.better += difference > 0
    tally.worse += difference < 0


def show_switches(tallies: dict[str, Tally], seconds: float) -> None:
    """Show which switches changed what."""
    rows = [
        (switch, str(t.tried), str(t.fired), str(len(t.decisive)), str(t.better), str(t.worse))
        for switch, t in sorted(tallies.items(), key=lambda item: (len(item[1].decisive), -item[1].tried))
    ]
    show(
        f"Switched off, {seconds:.0f} s",
        [("switch", "cases", "other decision", "decisive", "better", "worse"), *rows],
    )


def show_names(names: dict[str, Any]) -> None:
    """Show how good the names are with all rules."""
    rows = list(names.values())
    clean, hidden = [row for row in rows if not row["accept"]], [row for row in rows if row["accept"]]

    def count(several: Sequence[dict[str, Any]], state: str) -> str:
        return f"{sum(row['conclusion'] == state for row in several)}/{len(several)}"

    show(
        f"Names and conclusions with all rules, {len(rows)} cases",
        [
            ("right first", f"{sum(row['first'] for row in hidden)}/{len(hidden)}"),
            ("clean arms with a name", f"{sum(bool(row['names']) for row in clean)}/{len(clean)}"),
            ("a name that is not there", f"{sum(row['extra'] > 0 for row in rows)}/{len(rows)}"),
            ("clean: nothing above the limits", count(clean, "nothing_above_limits")),
            ("clean: cannot tell", count(clean, "cannot_tell")),
            ("hidden: something is missing", count(hidden, "something_is_missing")),
            ("hidden: cannot tell", count(hidden, "cannot_tell")),
            ("hidden: nothing above the limits", count(hidden, "nothing_above_limits")),
            ("seconds of a diagnosis, median", f"{np.median([row['seconds'] for row in rows]):.1f}" if rows else "-"),
        ],
    )


if __name__ == "__main__":
    main()
