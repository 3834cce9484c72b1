"""The switches of `decisive_rules.py`: what each rule or level of the diagnosis is replaced by where it is off."""

from __future__ import annotations

import os
import pickle
import sys
import time
import traceback
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from dynident.diagnosis import ambiguities, decision_levels, diagnose_model, diagnosis_request
from dynident.diagnosis.candidates import significance
from dynident.diagnosis.candidates.significance import ScoredCandidate
from dynident.diagnosis.outcome_reasons import Reason
from dynident.diagnosis.search import (
    acceptance_rules,
    comparison_of_rivals,
    finding_refinement,
    forward_selection,
    identifiability_and_invisible_effects,
    next_finding,
    physical_plausibility,
    pruning,
)
from dynident.diagnosis.search.candidate_outcomes import FinalScores
from dynident.diagnosis.search.search_state import Finding, State

LEVELS: dict[str, dict[str, float]] = {
    "least_error_drop": {"least_error_drop": 0.0},
    "least_gain_over_noise": {"least_gain_over_noise": 0.0},
    "least_gain_at_reversals": {"least_gain_at_reversals": 0.08},
    "most_of_block": {"most_of_block": 1e9},
    "least_separability": {"least_separability": 0.0},
    "least_reach": {"least_reach": 0.0},
    "least_drop_in_runs": {"least_drop_in_runs": 0.0},
    "least_drop_of_change": {"least_drop_of_change": 0.0},
    "shadow": {"shadow": 0.0},
    "quiet": {"quiet": 0.0},
    "joint_drop": {"joint_drop": 0.0},
    "clear_t": {"clear_t": 0.0},
    "staying_t": {"staying_t": 1e9},
    "own_drop": {"own_drop": 0.0},
    "sure_t": {"sure_t": 0.0},
    "found_again": {"found_again": 0.0},
    "more_for_parameters": {"more_for_parameters": 0.0},
    "as_much_as_change": {"as_much_as_change": 1e9},
    "still_gains": {"still_gains": -1e9},
    "still_gains high": {"still_gains": 1e9},
    "equal_gain": {"equal_gain": 1e9},
    "equal_t": {"equal_t": 0.0},
    "contends": {"contends": 1e9},
    "same_gain": {"same_gain": -1.0},
    "harm": {"harm": 1e9},
    "harm_t": {"harm_t": 1e9},
    "confirmed": {"confirmed": -1e9},
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


_search: Callable[..., Any] = forward_selection.search_findings
_stability: Callable[..., float] = acceptance_rules.compute_stability


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


def _only_strip(state: State) -> State:
    """Prune nothing but the columns of neighbouring constants."""
    around = {k for finding in state.findings for k in finding.around}
    findings = tuple(replace(finding, around=()) for finding in state.findings)
    return replace(state.drop_columns(around), findings=findings)


def _keep_scores(start: State, _last: Any, findings: Sequence[Finding], _choices: Any, first: Any) -> FinalScores:
    """Leave the scores of all candidates beside the findings as they are beside the model alone."""
    return FinalScores(replace(start, findings=tuple(findings)), first.scored, first.levels)


def _over_blocks(names: Any, rivals: Any, run: Any) -> float:
    return _stability(names, rivals, np.zeros_like(run))


RULES: dict[str, list[tuple[Any, str, Callable[..., Any]]]] = {
    **{
        name: [(acceptance_rules, name, _no_reason)]
        for name in (
            "_check_visibility",
            "_check_size",
            "_check_reach",
            "_check_shadows",
            "_check_each_joint",
            "_check_runs",
        )
    },
    "_find_lasting_cause": [(next_finding, "_find_lasting_cause", _no_reason)],
    "check_moving_joints": [
        (module, "check_moving_joints", _no_reason) for module in (next_finding, comparison_of_rivals)
    ],
    "_find_twins": [(next_finding, "_find_twins", _empty)],
    "_prefer_usual_change": [(next_finding, "_prefer_usual_change", lambda _state, chosen, twins: (chosen, twins))],
    "_is_part_of_change": [(next_finding, "_is_part_of_change", _false)],
    "find_richer_changes": [(next_finding, "find_richer_changes", _nothing)],
    "drop_idle_joints": [(next_finding, "drop_idle_joints", lambda _state, chosen: chosen)],
    "stability over runs": [
        (module, "compute_stability", _over_blocks) for module in (next_finding, comparison_of_rivals)
    ],
    "_find_wrong_friction": [(physical_plausibility, "_find_wrong_friction", _no_reason)],
    "find_impossibility": [(next_finding, "find_impossibility", _no_reason)],
    "compare_names": [(forward_selection, "compare_names", lambda _rows, _state, choice, _judged: choice)],
    "name_findings": [(diagnose_model, "name_findings", lambda _rows, state: state)],
    "merge_findings_on_joint": [(forward_selection, "merge_findings_on_joint", lambda _rows, state: state)],
    "split_groups": [(forward_selection, "split_groups", lambda state: state)],
    "prune_findings on the grid": [(forward_selection, "prune_findings", _only_strip)],
    "prune_findings refined": [(pruning, "prune_findings", _only_strip)],
    "_list_neighbour_columns": [(forward_selection, "_list_neighbour_columns", _nothing)],
    "is_determined": [(forward_selection, "is_determined", _true)],
    "_exceeds_constant": [(comparison_of_rivals, "_exceeds_constant", _true)],
    "_is_slimmer": [(comparison_of_rivals, "_is_slimmer", _false)],
    "faint candidates": [
        (
            diagnose_model,
            "search_findings",
            lambda state, *rest: _search(replace(state, pool=replace(state.pool, faint=frozenset())), *rest),
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
            pruning,
            "trim_joints",
            lambda state: [finding.judged.candidate.joints for finding in state.findings],
        )
    ],
    "select_harmless": [(pruning, "select_harmless", lambda _state, columns: list(range(len(columns))))],
    "is_width_resolved": [(finding_refinement, "is_width_resolved", _true)],
    "drop_faded_contacts": [(pruning, "drop_faded_contacts", lambda state, _preprocessing: state)],
    "is_only_helpful_at_first": [(identifiability_and_invisible_effects, "is_only_helpful_at_first", _false)],
    "find_misnamed": [(diagnose_model, "find_misnamed", _empty)],
    "find_dependent_findings": [(diagnose_model, "find_dependent_findings", _empty)],
    "find_static_friction": [
        (diagnose_model, "find_static_friction", lambda grown, _recordings, final, *_: (grown, final, ()))
    ],
    "find_contacts": [(diagnose_model, "find_contacts", _nothing)],
}
"""Rules and what stands in for them where they are switched off."""

DECISIONS: dict[str, list[Callable[..., Any]]] = {
    "least_gain_over_noise": [acceptance_rules._check_size, acceptance_rules.has_gain_on_joint, pruning._has_gain],
    "least_gain_at_reversals": [acceptance_rules._check_size, acceptance_rules.has_gain_on_joint, pruning._has_gain],
    "least_separability": [acceptance_rules._check_visibility],
    "least_reach": [acceptance_rules._check_reach],
    "least_drop_in_runs": [acceptance_rules._check_runs],
    "least_drop_of_change": [acceptance_rules._check_runs],
    "shadow": [acceptance_rules.is_shadowed],
    "quiet": [acceptance_rules.is_shadowed],
    "staying_t": [pruning._select_members],
    "own_drop": [finding_refinement._are_distinguishable],
    "more_for_parameters": [acceptance_rules.compute_stability, significance.has_larger_gain],
    "as_much_as_change": [next_finding._find_lasting_cause],
    "equal_gain": [next_finding._find_twins],
    "equal_t": [next_finding._find_twins],
    "contends": [comparison_of_rivals._find_contenders],
    "same_gain": [comparison_of_rivals.explains_as_much],
    "harm": [pruning._is_harmful],
    "harm_t": [pruning._is_harmful],
    "rows_of_filter": [physical_plausibility.find_impossibility],
    "part_to_part": [identifiability_and_invisible_effects.is_determined],
    "main_explanation": [identifiability_and_invisible_effects.is_main_explanation],
    "few_waves": [forward_selection._is_slow_wave],
    "few_waves none": [forward_selection._is_slow_wave],
    "left_over": [ambiguities.find_misnamed],
    "much_left_over": [ambiguities.find_misnamed],
}
"""The decisions that a level is for; one without an entry is always tried."""

FLOODGATES = {
    "compare_names",
    "least_error_drop",
    "joint_drop",
    "clear_t",
    "found_again",
    "sure_t",
    "find_impossibility",
    "prune_findings on the grid",
    "prune_findings refined",
    "select_harmless",
}
"""What opens the way to many findings: each is switched off by itself, and only where it is asked for."""

SWITCHES = (*LEVELS, *RULES)


def fork_at_rules(
    run: Callable[[], dict[str, Any]], explore: Callable[[Callable[[Sequence[str]], Any]], None], begin: float
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

    replace_name(diagnosis_request, "DecisionRules", build)
    try:
        outcome = {**run(), "fired": sorted(fired)}
    except Explored:
        return elapsed[0]
    except Exception:
        if not channel:
            raise
        outcome = {"failed": traceback.format_exc()}
    finally:
        replace_name(diagnosis_request, "DecisionRules", plain_class)
    # Only a child gets here.
    with os.fdopen(channel[0], "wb") as stream:
        stream.write(pickle.dumps(outcome))
    os._exit(0)


class Forked(Exception):
    """Raised in a child process.

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
        replace_name(diagnose_model, "compute_detection_limits", _nothing)
        replace_name(diagnose_model, "score_beside_findings", _keep_scores)
    for switch in group:
        for level, value in LEVELS.get(switch, {}).items():
            object.__setattr__(decision_levels.RULES, level, value)
            object.__setattr__(rules, level, value)
        for module, attribute, stand_in in RULES.get(switch, ()):
            replace_name(module, attribute, stand_in)
    return rules


def replace_name(module: Any, name: str, value: Any) -> None:
    """Replace what a module calls by a name, whichever module has defined it."""
    setattr(module, name, value)


def watch_decisions(fired: set[str]) -> None:
    """Make each decision a second time without what it is due to, and note the switches that make it another one."""
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
                fired.update({switch} if args[0].pool.faint else ())
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
