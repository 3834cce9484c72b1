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
import pickle
import sys
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(name, "1")

import changes
import messy_arms
import numpy as np
from common import show
from engine.robots import arm_by_name, as_described
from hiding.drawing import Wanted, draw_cases
from hiding.manners import Manners
from hiding.recorded import recorded

from dynident.diagnosis import Diagnosis, decision_levels, diagnose, diagnose_model
from dynident.diagnosis.search.candidate_outcomes import FinalScores
from dynident.diagnosis.candidates import significance
from dynident.diagnosis.candidates.significance import ScoredCandidate
from dynident.diagnosis.search import (
    acceptance_rules,
    comparison_of_rivals,
    finding_refinement,
    forward_selection,
    next_finding,
    physical_plausibility,
    pruning,
)
from dynident.diagnosis.search.search_state import Finding, State
from dynident.diagnosis.outcome_reasons import Reason
from dynident.identification import Identification, identify
from dynident.recordings import FurtherColumns, Recording, recording_from_arrays
from dynident.robot import robot_from_urdf

LEVELS: dict[str, dict[str, float]] = {
    "least_error_drop": {"least_error_drop": 0.0},
    "least_drop": {"least_drop": 0.0},
    "least_gain_over_noise": {"least_gain_over_noise": 0.0},
    "least_gain_at_reversals": {"least_gain_at_reversals": 0.08},
    "most_of_block": {"most_of_block": 1e9},
    "much_more": {"much_more": 1e9},
    "hardly_more": {"hardly_more": 0.0},
    "least_separability": {"least_separability": 0.0},
    "least_reach": {"least_reach": 0.0},
    "blurred_drop": {"blurred_drop": 0.0},
    "least_drop_in_runs": {"least_drop_in_runs": 0.0},
    "least_drop_of_change": {"least_drop_of_change": 0.0},
    "shadow": {"shadow": 0.0},
    "quiet": {"quiet": 0.0},
    "joint_drop": {"joint_drop": 0.0},
    "joint_t": {"joint_t": 0.0, "large_joint_t": 0.0},
    "large_joint_t": {"large_joint_t": 2.0},
    "staying_t": {"staying_t": 1e9},
    "own_drop": {"own_drop": 0.0},
    "own_t": {"own_t": 0.0},
    "one_by_one": {"one_by_one": 1e9},
    "staying_finding_t": {"staying_finding_t": 0.0},
    "found_again": {"found_again": 0.0},
    "more_for_parameters": {"more_for_parameters": 0.0},
    "as_much_as_change": {"as_much_as_change": 1e9},
    "still_gains": {"still_gains": -1e9},
    "still_gains high": {"still_gains": 1e9},
    "equal_gain": {"equal_gain": 1e9},
    "equal_t": {"equal_t": 0.0},
    "contends": {"contends": 1e9},
    "same_gain": {"same_gain": -1.0},
    "apart_t": {"apart_t": 1e9},
    "harm": {"harm": 1e9},
    "harm_t": {"harm_t": 1e9},
    "given_back": {"given_back": 1e9},
    "wrong_sign": {"wrong_sign": 0.0},
    "rows_of_filter": {"rows_of_filter": 1.0},
    "part_to_part": {"part_to_part": 1e9},
    "main_explanation": {"main_explanation": -1e9},
    "few_waves": {"few_waves": 1e9},
    "few_waves none": {"few_waves": 0.0},
    "left_over": {"left_over": 1e9},
    "much_left_over": {"much_left_over": 1e9},
    "most_blind": {"most_blind": 1e9},
    "adequate_over_noise": {"adequate_over_noise": 1e9},
}
"""Levels and the values that switch them off."""


def _no_reason(*_: Any, **__: Any) -> None:
    return None


def _nothing(*_: Any, **__: Any) -> tuple[()]:
    return ()


def _empty(*_: Any, **__: Any) -> list[Any]:
    return []


def _true(*_: Any, **__: Any) -> bool:
    return True


def _false(*_: Any, **__: Any) -> bool:
    return False


def _only_strip(_data: Any, _pool: Any, state: Any) -> Any:
    """Prune nothing but the columns of neighbouring constants."""
    around = {k for finding in state.findings for k in finding.around}
    findings = tuple(replace(finding, around=()) for finding in state.findings)
    return replace(state, findings=findings, base=tuple(k for k in state.base if k not in around))


def _keep_scores(data: Any, _pool: Any, start: Any, findings: Any, _choices: Any, first: Any) -> FinalScores:
    """Leave the scores of all candidates beside the findings as they are beside the model alone."""
    return FinalScores(replace(start, findings=tuple(findings)), data, first.scored, first.levels)


def _over_blocks(names: Any, rivals: Any, run: Any) -> float:
    return _stability(names, rivals, np.zeros_like(run))


RULES: dict[str, list[tuple[Any, str, Callable[..., Any]]]] = {
    **{
        name: [(acceptance_rules, name, _no_reason)]
        for name in (
            "_check_visibility",
            "_check_size",
            "_check_reach",
            "_check_blur",
            "_check_shadows",
            "_check_each_joint",
            "_check_runs",
        )
    },
    "_find_plainer": [(next_finding, "_find_plainer", _no_reason)],
    "_find_lasting_cause": [(next_finding, "_find_lasting_cause", _no_reason)],
    "_find_larger_rivals": [(next_finding, "_find_larger_rivals", _empty)],
    "_select_first_order": [(next_finding, "_select_first_order", _empty)],
    "_check_moving_joints": [(next_finding, "_check_moving_joints", _no_reason)],
    "_check_run_effects": [(next_finding, "_check_run_effects", _no_reason)],
    "_drop_split_groups": [(next_finding, "_drop_split_groups", list)],
    "_find_twins": [(next_finding, "_find_twins", _empty)],
    "_prefer_usual_change": [(next_finding, "_prefer_usual_change", lambda _state, chosen, twins: (chosen, twins))],
    "_is_part_of_change": [(next_finding, "_is_part_of_change", _false)],
    "_find_confused": [(next_finding, "_find_confused", _nothing)],
    "find_richer_changes": [(next_finding, "find_richer_changes", _nothing)],
    "drop_idle_joints": [(next_finding, "drop_idle_joints", lambda _data, _pool, _state, chosen: chosen)],
    "stability over runs": [
        (module, "compute_stability", _over_blocks) for module in (next_finding, comparison_of_rivals)
    ],
    "_is_dissipative": [(physical_plausibility, "_is_dissipative", _true)],
    "_find_wrong_friction": [(physical_plausibility, "_find_wrong_friction", _no_reason)],
    "find_impossibility": [(next_finding, "find_impossibility", _no_reason)],
    "revisit_findings": [(forward_selection, "revisit_findings", lambda _rows, _data, _pool, state: state)],
    "merge_findings_on_joint": [
        (forward_selection, "merge_findings_on_joint", lambda _rows, _data, _pool, state: state)
    ],
    "split_groups": [(forward_selection, "split_groups", lambda _data, _pool, state: state)],
    "prune_findings on the grid": [(forward_selection, "prune_findings", _only_strip)],
    "prune_findings refined": [(finding_refinement, "prune_findings", _only_strip)],
    "_list_neighbour_columns": [(forward_selection, "_list_neighbour_columns", _nothing)],
    "is_determined": [(forward_selection, "is_determined", _true)],
    "compare_names": [(forward_selection, "compare_names", lambda _m, _p, _s, choice, _j, _r: choice)],
    "_is_slimmer": [(comparison_of_rivals, "_is_slimmer", _false)],
    "_exceeds_constant": [(comparison_of_rivals, "_exceeds_constant", _true)],
    "faint candidates": [
        (
            diagnose_model,
            "search_findings",
            lambda data, pool, *rest: _search(data, replace(pool, faint=frozenset()), *rest),
        )
    ],
    "locate_findings": [
        (finding_refinement, "locate_findings", lambda _identification, findings, _inputs: tuple(findings))
    ],
    "merge_findings_with_close_constants": [
        (
            finding_refinement,
            "merge_findings_with_close_constants",
            lambda findings, choices, _robot, _resolved: (tuple(findings), tuple(choices)),
        )
    ],
    "trim_joints": [
        (
            finding_refinement,
            "trim_joints",
            lambda _data, _pool, state: [finding.judged.candidate.joints for finding in state.findings],
        )
    ],
    "select_harmless": [
        (finding_refinement, "select_harmless", lambda _data, _base, columns, _noise: list(range(len(columns))))
    ],
    "is_width_resolved": [(finding_refinement, "is_width_resolved", _true)],
    "_find_independent": [(finding_refinement, "_find_independent", lambda _model, choices: list(range(len(choices))))],
    "drop_faded_contacts": [
        (finding_refinement, "drop_faded_contacts", lambda _data, _pool, state, _preprocessing: state)
    ],
    "find_misnamed": [(diagnose_model, "find_misnamed", _empty)],
    "find_dependent_findings": [(diagnose_model, "find_dependent_findings", _empty)],
    "is_only_helpful_at_first": [(diagnose_model, "is_only_helpful_at_first", _false)],
    "find_static_friction": [
        (diagnose_model, "find_static_friction", lambda grown, _recordings, final, *_: (grown, final, ()))
    ],
    "find_contacts": [(diagnose_model, "find_contacts", _nothing)],
}
"""Rules and what stands in for them where they are switched off."""

DECISIONS: dict[str, list[Callable[..., Any]]] = {
    "least_gain_over_noise": [acceptance_rules._check_size, acceptance_rules.has_gain_on_joint, pruning._has_gain],
    "least_gain_at_reversals": [acceptance_rules._check_size, acceptance_rules.has_gain_on_joint, pruning._has_gain],
    "much_more": [significance.has_larger_gain],
    "hardly_more": [significance.has_larger_gain],
    "least_separability": [acceptance_rules._check_visibility],
    "least_reach": [acceptance_rules._check_reach],
    "blurred_drop": [acceptance_rules._check_blur],
    "least_drop_in_runs": [acceptance_rules._check_runs],
    "least_drop_of_change": [acceptance_rules._check_runs],
    "shadow": [acceptance_rules.is_shadowed],
    "quiet": [acceptance_rules.is_shadowed],
    "large_joint_t": [acceptance_rules.has_gain_on_joint, pruning._select_members],
    "staying_t": [pruning._select_members],
    "own_drop": [finding_refinement._are_distinguishable],
    "own_t": [finding_refinement._are_distinguishable],
    "one_by_one": [next_finding._drop_split_groups],
    "more_for_parameters": [acceptance_rules.compute_stability],
    "as_much_as_change": [next_finding._find_lasting_cause],
    "equal_gain": [next_finding._find_twins, next_finding._find_confused],
    "equal_t": [next_finding._find_twins, next_finding._find_confused],
    "contends": [comparison_of_rivals._find_contenders],
    "same_gain": [comparison_of_rivals.explains_as_much],
    "apart_t": [comparison_of_rivals.explains_as_much],
    "harm": [pruning._is_harmful],
    "harm_t": [pruning._is_harmful],
    "given_back": [physical_plausibility._is_dissipative],
    "wrong_sign": [physical_plausibility.find_impossibility],
    "rows_of_filter": [physical_plausibility.find_impossibility],
    "part_to_part": [forward_selection.is_determined],
    "main_explanation": [forward_selection.is_main_explanation],
    "few_waves": [forward_selection._is_slow_wave],
    "few_waves none": [forward_selection._is_slow_wave],
    "left_over": [diagnose_model.find_misnamed],
    "much_left_over": [diagnose_model.find_misnamed],
}
"""The decisions that a level is for; one without an entry is always tried."""

FLOODGATES = {
    "least_error_drop",
    "least_drop",
    "joint_drop",
    "joint_t",
    "found_again",
    "staying_finding_t",
    "find_impossibility",
    "compare_names",
    "prune_findings on the grid",
    "prune_findings refined",
    "select_harmless",
}
"""What opens the way to many findings: each is switched off by itself, and only where it is asked for."""

SWITCHES = (*LEVELS, *RULES)
_search, _stability = forward_selection.search_findings, acceptance_rules.compute_stability

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


@dataclass(frozen=True)
class Case:
    """A case: how it is prepared, and groups of names of which each has to be among the findings.

    Parameters
    ----------
    name : str
        Name of the case.
    prepare : callable
        Returns the model, the recordings, and those of a baseline.
    accept : tuple of tuple of str
        A group for each hidden effect; none for a clean arm.
    """

    name: str
    prepare: Callable[[], tuple[Identification, Sequence[Recording], Sequence[Recording]]]
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
    minor : list of str
        Cases in which the order or the equivalents alone changed.
    better, worse : int
        Of the decisive cases.
    """

    tried: int = 0
    fired: int = 0
    decisive: list[str] = field(default_factory=list)
    minor: list[str] = field(default_factory=list)
    better: int = 0
    worse: int = 0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--folders", type=Path, nargs="*", default=[])
    parser.add_argument("--halting", type=int, default=0, help="arms that move from point to point")
    parser.add_argument("--messy", type=int, default=0, help="arms as in messy_arms.py")
    parser.add_argument("--changes", type=int, default=0, help="pairs of days as in changes.py")
    parser.add_argument("--enough", type=int, default=2, help="decisive cases after which a switch is not tried again")
    parser.add_argument("--switches", nargs="*", default=[s for s in SWITCHES if s not in FLOODGATES], choices=SWITCHES)
    parser.add_argument("--only-names", action="store_true", help="switch nothing off")
    parser.add_argument("--json", type=Path, default=None, help="write every outcome here, and go on from there")
    given = parser.parse_args()
    start = time.perf_counter()
    stored = json.loads(given.json.read_text()) if given.json and given.json.exists() else {}
    names: dict[str, Any] = stored.get("names", {})
    tallies = {switch: Tally(**stored.get("switches", {}).get(switch, {})) for switch in given.switches}
    for case in list_cases(given.seed, given.folders, given.halting, given.messy, given.changes):
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
        told = {s: "minor" if is_minor(plain, o) else str(o.get("names", o)) for s, o in changed.items()}
        print(
            f"{case.name} {plain['names']} {plain['conclusion']} {seconds:.1f} s, {time.perf_counter() - begin:.0f} s of {len(waiting)} switches {told}",
            flush=True,
        )
        if given.json:
            content = {"names": names, "switches": {switch: vars(tally) for switch, tally in tallies.items()}}
            given.json.write_text(json.dumps(content, indent=1))
    if not given.only_names and names:
        show_switches(tallies, time.perf_counter() - start)
    show_names(names)


def list_cases(seed: int, folders: Sequence[Path], halting: int, messy: int, pairs: int) -> Iterator[Case]:
    """List all cases; they are simulated or read where they are prepared."""
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


def prepare_folder(path: Path) -> tuple[Identification, Sequence[Recording], Sequence[Recording]]:
    """Identify the arm of a folder."""
    robot = robot_from_urdf(path.parent.name, (path / "robot.urdf").read_text())
    fit, held = (read_csv(path / name, robot.joint_names) for name in ("data.csv", "holdout.csv"))
    return identify(robot, [fit], [held]), [fit], ()


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


def prepare_simulated(each: Any) -> tuple[Identification, Sequence[Recording], Sequence[Recording]]:
    """Simulate an arm and identify it."""
    data, robot = recorded(each), as_described(arm_by_name(each.arm), each.noise)
    training = data.recordings(held_out=False)
    return identify(robot, training, data.recordings(held_out=True)), training, ()


def prepare_pair(pair: changes.Pair) -> tuple[Identification, Sequence[Recording], Sequence[Recording]]:
    """Simulate two days of an arm and identify the first."""
    recordings = [changes.recorded(pair, day) for day in range(pair.days)]
    model = identify(as_described(arm_by_name(pair.arm), pair.seed), recordings[:1])
    return model, recordings[1:], recordings[:1]


def switch_off_in_groups(case: Case, switches: Sequence[str]) -> tuple[dict[str, Any], dict[str, Any], float]:
    """Diagnose a case with all rules, and find the switches that change its outcome."""
    identification, recordings, baseline = case.prepare()
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
            if is_minor(plain, outcome):
                continue
            if len(group) == 1:
                results.setdefault("changed", {})[group[0]] = outcome
            else:
                groups += [group[: len(group) // 2], group[len(group) // 2 :]]

    begin = time.perf_counter()
    before = fork_at_rules(lambda: diagnose(identification, recordings, baseline=baseline), explore, begin)
    return results["plain"], results.get("changed", {}), before + results["rest"]


def fork_at_rules(
    run: Callable[[], Diagnosis], explore: Callable[[Callable[[Sequence[str]], Any]], None], begin: float
) -> float:
    """Run a diagnosis up to its rules, and finish it in child processes as often as `explore` asks; return the time."""
    plain_class = decision_levels.DecisionRules
    channel: list[int] = []
    fired: set[str] = set()
    elapsed = [0.0]

    class Explored(Exception):
        """All children have returned."""

    def build(**levels: float) -> decision_levels.DecisionRules:
        rules = plain_class(**levels)
        elapsed[0] = time.perf_counter() - begin

        def finish(group: Sequence[str]) -> Any:
            reader, writer = os.pipe()
            child = os.fork()
            if child == 0:
                os.close(reader)
                channel.append(writer)
                raise Forked(tuple(group))
            os.close(writer)
            with os.fdopen(reader, "rb") as stream:
                content = stream.read()
            os.waitpid(child, 0)
            return pickle.loads(content) if content else {"failed": "no answer"}

        try:
            explore(finish)
        except Forked as forked:
            if forked.group == ("watch",):
                apply_switches(rules, ())
                watch_decisions(fired)
                return rules
            return apply_switches(rules, forked.group)
        raise Explored

    diagnose_model.DecisionRules = build  # type: ignore[assignment, misc]
    try:
        outcome = {**summarise(run()), "fired": sorted(fired)}
    except Explored:
        return elapsed[0]
    except Exception:
        if not channel:
            raise
        outcome = {"failed": traceback.format_exc()}
    finally:
        diagnose_model.DecisionRules = plain_class  # type: ignore[misc]
    # Only a child gets here.
    with os.fdopen(channel[0], "wb") as stream:
        stream.write(pickle.dumps(outcome))
    os._exit(0)


class Forked(Exception):
    """This is a child process.

    Parameters
    ----------
    group : tuple of str
        Switches to apply in it.
    """

    def __init__(self, group: tuple[str, ...]) -> None:
        super().__init__()
        self.group = group


def apply_switches(rules: decision_levels.DecisionRules, group: Sequence[str]) -> decision_levels.DecisionRules:
    """Switch levels and rules off in this process; leave out what is computed for the report alone."""
    if group != ("only names",):
        diagnose_model.compute_detection_limits = _nothing  # type: ignore[assignment]
        diagnose_model.score_beside_findings = _keep_scores  # type: ignore[assignment]
    for switch in group:
        for level, value in LEVELS.get(switch, {}).items():
            object.__setattr__(decision_levels.RULES, level, value)
            object.__setattr__(rules, level, value)
        for module, attribute, stand_in in RULES.get(switch, ()):
            setattr(module, attribute, stand_in)
    return rules


def watch_decisions(fired: set[str]) -> None:
    """Make each decision a second time without the rule or level that it is due to, and note where it is another one."""
    watched: dict[Callable[..., Any], list[tuple[str, Callable[..., Any]]]] = {}
    for switch, replacements in RULES.items():
        for module, attribute, stand_in in replacements:
            watched.setdefault(getattr(module, attribute), []).append((switch, stand_in))
    for switch, functions in DECISIONS.items():
        for function in functions:
            watched.setdefault(function, []).append((switch, partial(decide_at_level, function, LEVELS[switch])))
    modules = [module for name, module in sys.modules.items() if name.startswith("dynident.diagnosis")]
    for function, others in watched.items():
        watcher = build_watcher(function, others, fired)
        for module in modules:
            for attribute, value in list(vars(module).items()):
                if value is function:
                    setattr(module, attribute, watcher)


def build_watcher(
    function: Callable[..., Any], others: Sequence[tuple[str, Callable[..., Any]]], fired: set[str]
) -> Callable[..., Any]:
    """Return the function, which also notes the switches whose stand-ins would decide otherwise."""

    def decide(*args: Any, **kwargs: Any) -> Any:
        result = function(*args, **kwargs)
        for switch, stand_in in others:
            # A stand-in of the whole search would be another search.
            if switch == "faint candidates":
                fired.update({switch} if args[1].faint else ())
            elif switch not in fired and simplify(stand_in(*args, **kwargs)) != simplify(result):
                fired.add(switch)
        return result

    return decide


def decide_at_level(function: Callable[..., Any], levels: dict[str, float], *args: Any, **kwargs: Any) -> Any:
    """Call a function with other levels."""
    rules = decision_levels.RULES
    before = {level: getattr(rules, level) for level in levels}
    other = [replace(each, rules=replace(each.rules, **levels)) if isinstance(each, State) else each for each in args]
    try:
        for level, value in levels.items():
            object.__setattr__(rules, level, value)
        return function(*other, **kwargs)
    finally:
        for level, value in before.items():
            object.__setattr__(rules, level, value)


def simplify(value: Any) -> Any:
    """Return what two decisions are compared by."""
    if isinstance(value, State):
        return value.base, tuple(simplify(finding) for finding in value.findings)
    if isinstance(value, Finding):
        return simplify(value.judged), simplify(value.equal)
    if isinstance(value, ScoredCandidate):
        return value.candidate
    if isinstance(value, (tuple, list)):
        return tuple(simplify(item) for item in value)
    if isinstance(value, float):
        return value >= decision_levels.RULES.found_again
    if isinstance(value, Reason):
        return value.code
    return value


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


def is_minor(plain: dict[str, Any], outcome: dict[str, Any]) -> bool:
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
    if is_minor(plain, outcome):
        tally.minor.append(case.name)
        return
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
        (switch, str(t.tried), str(t.fired), str(len(t.decisive)), str(t.better), str(t.worse), str(len(t.minor)))
        for switch, t in sorted(tallies.items(), key=lambda item: (len(item[1].decisive), -item[1].tried))
    ]
    show(f"Switched off, {seconds:.0f} s", [("switch", "cases", "other decision", "decisive", "better", "worse", "minor"), *rows])


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
