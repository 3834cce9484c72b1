"""Friction first, joint by joint from runs of constant velocity, then the inertial parameters (§12.3.3 ii)."""

from __future__ import annotations

import numpy as np

from dynident.errors import DynidentError
from dynident.identification.choices import IdentificationChoices
from dynident.identification.data import Data
from dynident.identification.fit import Fit
from dynident.identification.friction_runs import FrictionRuns, friction_columns, friction_runs
from dynident.identification.sequential import check_estimator
from dynident.identification.steps import Findings, conclude_steps, take_step
from dynident.regressors.model import Model

# Fast motion of less than so many times the speed of slow motion does not tell dry friction from viscous friction well;
# ramps at the ends, a fifth of the time on either side, do not count.
_SPEEDS, _ENDS = 1.5, 0.2


def separate_friction(model: Model, choices: IdentificationChoices, data: Data) -> Fit:
    """Find the friction of every joint that moves alone somewhere, then all other parameters with it known.

    The runs are those of the recordings with the role "friction", or else any that are found in the data. Friction
    keeps the values that these runs give; how uncertain they are is carried into the other parameters.

    Raises
    ------
    DynidentError
        Where no joint with friction in the model ever moves alone, or for an estimator that cannot be taken in steps.
    """
    check_estimator(choices)
    sources = data.friction or data.recordings
    if not sources:
        raise DynidentError(
            "the runs of single joints are not in the reduced data; identify from the recordings anew",
            pointer="/strategy",
            title="Recordings needed",
        )
    runs = friction_runs(model, sources, choices.preprocessing, data.reference)
    told = [j for j in range(model.robot.n) if len(runs.velocities[j]) and friction_columns(model, j)]
    if not told:
        raise DynidentError(
            f"no joint with friction in the model moves alone at constant velocity in "
            f"{', '.join(r.name for r in sources)}; record each joint by itself at several constant speeds in both "
            'directions, with "role": "friction", or choose the global strategy',
            pointer="/measurement_ids",
            title="No friction runs",
        )
    alone = take_step(model, choices, data, runs.equations, Findings.nothing(model.n_parameters))
    rest = take_step(model, choices, data, data.equations, alone.findings)
    warnings = () if rest.fit is None else rest.fit.warnings
    return conclude_steps(data, rest.findings, _warnings(model, runs, alone.findings) + warnings)


def _warnings(model: Model, runs: FrictionRuns, found: Findings) -> tuple[str, ...]:
    made = []
    names = model.robot.joint_names
    without = [names[j] for j in range(model.robot.n) if friction_columns(model, j) and not len(runs.velocities[j])]
    if without:
        made.append(
            f"No run shows {', '.join(without)} moving alone at constant velocity: their friction is identified "
            "together with the inertial parameters."
        )
    for j, velocities in enumerate(runs.velocities):
        columns = friction_columns(model, j)
        if not columns or not len(velocities):
            continue
        speeds = np.repeat(np.abs(velocities), runs.equations.equations[j].counts)
        slow, fast = np.quantile(speeds, (_ENDS, 1 - _ENDS))
        told = np.linalg.matrix_rank(found.functions[:, columns]) if len(found.values) else 0
        if not ((velocities > 0).any() and (velocities < 0).any()):
            made.append(f"{names[j]} moves alone in one direction only: Coulomb friction cannot be told from gravity.")
        elif fast < _SPEEDS * slow:
            made.append(
                f"{names[j]} moves alone at one speed of {fast:.3g} only: how its friction depends on the speed is "
                "hardly to be told."
            )
        elif told < len(columns):
            made.append(
                f"The friction runs of {names[j]} tell {told} of its {len(columns)} friction parameters; the others "
                "are identified together with the inertial parameters."
            )
    return tuple(made)
