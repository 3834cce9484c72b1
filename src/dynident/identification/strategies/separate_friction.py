"""Identify friction first, joint by joint from runs of constant velocity, then the other parameters (§12.3.3 ii)."""

from __future__ import annotations

import numpy as np

from dynident.errors import DynidentError
from dynident.estimation import Reduction
from dynident.identification.choices import IdentificationChoices
from dynident.identification.fit import Fit
from dynident.identification.problem import Problem
from dynident.identification.strategies.friction_runs import FrictionRuns, find_friction_columns, find_friction_runs
from dynident.identification.strategies.sequential import check_estimator
from dynident.identification.strategies.steps import StepEstimates, conclude_steps, take_step
from dynident.regressors.model import Model

# Dry and viscous friction are told apart where the fast motion is at least so many times as fast as the slow one. Ramps
# at the ends, a fifth of the time on either side, do not count.
_SPEEDS, _ENDS = 1.5, 0.2
# A friction parameter is left to the whole robot's motion only where the runs determine it this much worse: otherwise
# friction's own runs are believed.
_PATIENCE = 30.0
# A parameter is named as undetermined where more than this share of it lies outside what the runs determine.
_OPEN = 0.1


def solve_separate_friction(choices: IdentificationChoices, problem: Problem) -> Fit:
    """Find the friction of every joint that moves alone somewhere, then all other parameters with it known.

    The runs are those of the recordings with the role "friction", or else any that are found in the data. Friction
    keeps the values that these runs give, and their uncertainty is carried into the other parameters. Parameters that
    the runs determine much worse than the whole robot's motion does (load-dependent friction where the load hardly
    changes) are left to that motion.

    Parameters
    ----------
    choices : IdentificationChoices
    problem : Problem

    Returns
    -------
    Fit

    Raises
    ------
    DynidentError
        Where no joint with friction in the model ever moves alone, or for an estimator that cannot be taken in steps.
    """
    estimator, model, data = choices.solver, problem.model, problem.data
    check_estimator(estimator)
    sources = data.friction or data.recordings
    if not sources:
        raise DynidentError(
            "the runs of single joints are not in the reduced data; identify from the recordings anew",
            pointer="/strategy",
            title="Recordings needed",
        )
    runs = find_friction_runs(model, sources, choices.preprocessing, data.reference)
    solvable = [j for j in range(model.robot.n) if len(runs.velocities[j]) and find_friction_columns(model, j)]
    if not solvable:
        raise DynidentError(
            f"no joint with friction in the model moves alone at constant velocity in "
            f"{', '.join(r.name for r in sources)}; record each joint by itself at several constant speeds in both "
            'directions, with "role": "friction", or choose the global strategy',
            pointer="/measurement_ids",
            title="No friction runs",
        )
    both = Reduction(model.n_parameters, runs.equations.equations + data.equations.equations, data.equations.spans)
    alone = take_step(estimator, problem, runs.equations, StepEstimates.empty(model.n_parameters), both, _PATIENCE)
    rest = take_step(estimator, problem, data.equations, alone.findings)
    return conclude_steps(data, (alone, rest), _list_warnings(model, runs, alone.findings))


def _list_warnings(model: Model, runs: FrictionRuns, findings: StepEstimates) -> tuple[str, ...]:
    """Return warnings about joints without runs, with poor ones, and about parameters that the runs leave open."""
    sentences = []
    names = model.robot.joint_names
    without = [
        names[j] for j in range(model.robot.n) if find_friction_columns(model, j) and not len(runs.velocities[j])
    ]
    if without:
        sentences.append(
            f"No run shows {', '.join(without)} moving alone at constant velocity: their friction is identified "
            "together with the inertial parameters."
        )
    for j, velocities in enumerate(runs.velocities):
        columns = find_friction_columns(model, j)
        if not columns or not len(velocities):
            continue
        speeds = np.repeat(np.abs(velocities), runs.equations.equations[j].counts)
        slow, fast = np.quantile(speeds, (_ENDS, 1 - _ENDS))
        if not ((velocities > 0).any() and (velocities < 0).any()):
            sentences.append(
                f"{names[j]} moves alone in one direction only: Coulomb friction cannot be told from gravity."
            )
        elif fast < _SPEEDS * slow:
            sentences.append(
                f"{names[j]} moves alone at one speed of {fast:.3g} only: how its friction depends on the speed is "
                "hardly to be told."
            )
    undetermined = _list_undetermined(model, runs, findings)
    if undetermined:
        sentences.append(
            f"The friction runs alone do not tell {', '.join(undetermined)}: these come from all recordings together, "
            "with what the runs say of their combinations."
        )
    return tuple(sentences)


def _list_undetermined(model: Model, runs: FrictionRuns, findings: StepEstimates) -> list[str]:
    """Return the names of friction parameters of joints that move alone which the runs leave undetermined."""
    columns = [k for j, v in enumerate(runs.velocities) if len(v) for k in find_friction_columns(model, j)]
    functions = findings.functions[:, columns]
    sizes = np.linalg.norm(functions, axis=0)
    # The rows of Q span what the runs determine. The squared length of a parameter's row is the share of it that is
    # known.
    known = np.linalg.qr((functions / np.where(sizes > 0, sizes, 1.0)).T)[0]
    missing = 1.0 - np.sum(known * known, axis=1)
    return [model.kept[k].name for k, share in zip(columns, missing, strict=True) if share > _OPEN]
