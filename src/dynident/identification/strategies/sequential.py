"""The sequential strategy [12.22]-[12.24]: link by link from the terminal link, or the wrist and then the shoulder."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from dynident.errors import DynidentError
from dynident.estimation import EquationFactors, Reduction
from dynident.identification.fit import Fit
from dynident.identification.methods.bases import ESTIMATORS, MODELS, Estimator, StepsName, StrategyChoices
from dynident.identification.problem import Problem
from dynident.identification.strategies.sequential_steps import Step, StepEstimates, conclude_steps, take_step
from dynident.robot.model import Robot

_LONGEST_WRIST = 3


def solve_sequentially(choices: StrategyChoices, problem: Problem) -> Fit:
    """Find the parameters of the terminal link from its joint's equation, then those of the links before it.

    Parameters
    ----------
    choices : StrategyChoices
        `steps` names the order.
    problem : Problem
        Equations of the data, and prior knowledge.

    Returns
    -------
    Fit
        The estimates with their uncertainty, and warnings.

    Raises
    ------
    DynidentError
        For an estimator that needs all equations at once, or a model whose equations are not the joints'.
    """
    check_stepwise(choices)
    model, data = problem.model, problem.data
    findings = StepEstimates.empty(model.n_parameters)
    steps: list[Step] = []
    to_come = set(range(model.robot.n))
    for joints in iterate_steps(model.robot, choices.steps):
        # A joint's equation holds only the links behind it, so from the terminal one on every step adds few unknowns.
        own, later = select_joints(data.equations, joints), select_joints(data.equations, tuple(to_come))
        step = take_step(choices.solver, problem, own, findings, later)
        to_come -= set(joints)
        findings = step.findings
        steps.append(step)
    return conclude_steps(data, steps)


def iterate_steps(robot: Robot, steps: StepsName) -> Iterator[tuple[int, ...]]:
    """Yield the joints whose equations make each step, the terminal ones first.

    Parameters
    ----------
    robot : Robot
        The robot.
    steps : str
        "link_by_link" or "wrist_then_shoulder".
    """
    if steps == "link_by_link":
        yield from ((joint,) for joint in reversed(range(robot.n)))
        return
    # A wrist is light. Identified together with the shoulder, its parameters would drown in the shoulder's noise.
    wrist = find_wrist_joints(robot)
    if wrist:
        yield wrist
    yield tuple(joint for joint in range(robot.n) if joint not in wrist)


def find_wrist_joints(robot: Robot) -> tuple[int, ...]:
    """Return the last three joints of every arm, but not more than half of its joints."""
    wrist = []
    for joint in range(robot.n):
        # Depth of the last joint of this arm; how many joints come after this one decides whether it belongs to the
        # wrist.
        behind = max(len(robot.list_ancestors(other)) for other in robot.list_subtree(joint))
        after = behind - len(robot.list_ancestors(joint))
        if after < min(_LONGEST_WRIST, behind // 2):
            wrist.append(joint)
    return tuple(wrist)


def select_joints(reduction: Reduction, joints: tuple[int, ...]) -> Reduction:
    """Return the same data with the rows of some joints alone; the other equations are empty.

    Parameters
    ----------
    reduction : Reduction
        Factors of W and the torque, one equation a joint.
    joints : tuple of int
        Numbers of the joints, from 0.
    """
    equations = tuple(
        equation if joint in joints else EquationFactors(equation.columns[:0], np.zeros((0, 1, 1)), equation.counts[:0])
        for joint, equation in enumerate(reduction.equations)
    )
    return Reduction(reduction.n_columns, equations, reduction.spans)


def check_stepwise(choices: StrategyChoices) -> None:
    """Raise where an estimator or a model cannot be taken joint by joint.

    Parameters
    ----------
    choices : StrategyChoices
        What is identified, and how.

    Raises
    ------
    DynidentError
    """
    check_estimator(choices.solver)
    if not choices.rows.by_joint:
        raise DynidentError(
            f"the {choices.model} model has no equation of its own for every joint, so that nothing can be identified "
            f"joint by joint; choose from {', '.join(MODELS.names_with('by_joint'))}, or the global strategy",
            pointer="/strategy",
            title="Choices that do not fit",
        )


def check_estimator(estimator: Estimator) -> None:
    """Raise where an estimator cannot be taken in steps.

    Raises
    ------
    DynidentError
    """
    # An estimator that simulates, or that needs all bodies, cannot solve a part of the equations.
    if not estimator.in_steps:
        raise DynidentError(
            f"{estimator.name} cannot be taken in steps; choose from "
            f"{', '.join(ESTIMATORS.names_with('in_steps'))}, or the global strategy",
            pointer="/estimator",
            title="Choices that do not fit",
        )
