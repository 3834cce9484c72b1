"""A full set of standard parameters of bodies that can exist, for programs that know links and joints only.

The base parameters determine the torque, but a file of links needs all ten parameters of each. Of all sets that give
the identified base parameters, the one nearest to the description (or to the standard parameters that were estimated)
is taken whose links have pseudo-inertias that are positive definite (Wensing, Kim and Slotine 2018) and whose rotors
are not negative: a semidefinite problem, whose solution is then moved onto G K = χ to the last digit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dynident.arrays import FloatArray
from dynident.effects import Role, role_of
from dynident.errors import DynidentError
from dynident.estimation import errors
from dynident.estimation.semidefinite import Equations, InfeasibleError, constrained_least_squares
from dynident.export.unknowns import Unknowns
from dynident.identification import Estimate, Identification
from dynident.identification.estimators.feasible import feasible
from dynident.identification.problem import Problem
from dynident.regressors.model import Model

# Least eigenvalues of a link's pseudo-inertia, in units of its usual mass and size, that are tried one after the other.
# Links that were estimated as feasible are so already.
_MARGINS = (2e-2, 1e-3, 1e-5, 0.0)
_SMALL_MARGINS = _MARGINS[2:]
# How much less the distance to the description counts than what is impossible; and the share of the worst that is
# blamed as well.
_NEAR, _BLAMED = (1e-2, 1e-1, 1.0), 0.1
# Below this, of its usual size, a rotor is none; below that margin a link is flat or none; and what of friction is
# rounding.
_NO_ROTOR, _POSSIBLE, _ROUNDING = 1e-6, 1e-9, -1e-9
_FRICTION: tuple[Role, ...] = ("dry", "damping")


@dataclass(frozen=True, eq=False)
class Completion:
    """Standard parameters of a whole robot.

    inertias (n, 10), in the order of `INERTIAL_NAMES`; rotors, coulomb, viscous (n,); `values` (b,) the base parameters
    that they give. `exact`: those are the identified ones. `notes` say what a user must know of them.
    """

    inertias: FloatArray
    rotors: FloatArray
    coulomb: FloatArray
    viscous: FloatArray
    values: FloatArray
    exact: bool
    notes: tuple[str, ...] = ()


def complete(identification: Identification, *, nearest: bool = False, rotors_in_links: bool = False) -> Completion:
    """Return feasible standard parameters that give the identified base parameters exactly.

    Parameters
    ----------
    identification : Identification
    nearest : bool
        Where there are none: give those whose torque along the identification's data is nearest instead, and a note.
    rotors_in_links : bool
        Give rotors only what cannot be said of the links.

    Raises
    ------
    DynidentError
        Where there are none and `nearest` is not set (naming the links), or the model has no rigid body.
    """
    values = identification.values
    blamed = _driving_friction(identification.estimate)
    margins = _SMALL_MARGINS if identification.choices.solver.possible_bodies else _MARGINS
    # Where the rotors' share does not fit into the links, they may have one of their own.
    for merged in (True, False) if rotors_in_links else (False,):
        unknowns = Unknowns.of(identification.model, rotors_in_links=merged, estimated=identification.estimate.standard)
        equations = _equations(unknowns, values)
        completed = _completed(unknowns, equations, values, margins)
        if completed is not None and not blamed:
            return _gathered(identification.model, unknowns, completed, values)
    if completed is None:
        blamed += _impossible(unknowns, equations)
    if not nearest:
        raise DynidentError(
            f"no bodies that can exist have the identified base parameters: {'; '.join(blamed)}. Identify with the "
            'estimator "feasible", on data that excite these parameters, or ask for the nearest feasible ones '
            "(nearest), which changes the torque",
            pointer="/format",
            title="Not physically feasible",
        )
    return _nearest(identification, rotors_in_links, blamed)


def _equations(unknowns: Unknowns, values: FloatArray) -> Equations:
    """The base parameters as equations of the unknowns over their scale, each of unit size."""
    factor = unknowns.grouping[unknowns.base_rows] * unknowns.scale
    sizes = np.linalg.norm(factor, axis=1)
    return Equations(factor / sizes[:, None], values[unknowns.base_rows] / sizes)


def _completed(
    unknowns: Unknowns, equations: Equations, values: FloatArray, margins: Sequence[float]
) -> FloatArray | None:
    """Unknowns (k,) that give the base parameters, nearest to the nominal ones; None where there are none."""
    for margin in margins:
        try:
            solution = constrained_least_squares(
                np.eye(unknowns.size),
                unknowns.nominal / unknowns.scale,
                unknowns.matrices(0, np.full(len(unknowns.links), margin)),
                unknowns.rotor_places,
                equations,
            )
        except InfeasibleError:
            continue
        moved = _moved_onto(unknowns, values[unknowns.base_rows], solution.values * unknowns.scale)
        if np.all(unknowns.margins(moved) > _POSSIBLE) and np.all(moved[unknowns.rotor_places] >= 0):
            return moved
    return None


def _moved_onto(unknowns: Unknowns, base: FloatArray, values: FloatArray) -> FloatArray:
    """The unknowns moved by the least that makes them give the base parameters to the last digit."""
    grouping, rotors = unknowns.grouping[unknowns.base_rows], unknowns.rotor_places
    # A rotor of nothing stays one.
    none = rotors[values[rotors] < _NO_ROTOR * unknowns.scale[rotors]]
    weights, moved = unknowns.scale.copy(), values.copy()
    weights[none] = moved[none] = 0.0
    for _ in range(2):
        moved += weights * np.linalg.lstsq(grouping * weights, base - grouping @ moved, rcond=1e-12)[0]
    return moved


def _impossible(unknowns: Unknowns, equations: Equations) -> list[str]:
    """Which links and rotors the base parameters leave no room for, in words."""
    names = unknowns.model.robot.tree.joint_names
    words = [f"the link of {names[j]} (no mass that is positive everywhere has its moments)" for j in unknowns.links]
    words += [f"the rotor of {names[j]} (negative inertia)" for j in unknowns.rotors]
    for near in _NEAR:
        try:
            margins = _least_violation(unknowns, equations, near)
        except InfeasibleError:
            continue
        worst = float(margins.min())
        blamed = margins < (_BLAMED * worst if worst < -_NO_ROTOR else _BLAMED * _MARGINS[0])
        return [word for word, guilty in zip(words, blamed, strict=True) if guilty] or ["the links together"]
    return ["the links, whose parameters are too far from those of any body"]


def _least_violation(unknowns: Unknowns, equations: Equations, near: float) -> FloatArray:
    """Margins of all links, then of all rotors, as near as can be to what is wanted: a problem that has a solution."""
    n_links, n_rotors, size = len(unknowns.links), len(unknowns.rotors), unknowns.size
    # Unknowns, a margin a link, a margin a rotor: a rotor is its margin and something that is not negative.
    total = size + n_links + n_rotors
    wide = np.zeros((len(equations.right), total))
    wide[:, :size] = equations.factor
    wide[:, size + n_links :] = equations.factor[:, unknowns.rotor_places]
    goal = np.eye(total)
    goal[:size] *= near
    # Everything is homogeneous: numbers of about one keep the solver precise.
    shrink = 1.0 / max(1.0, float(np.abs(equations.right).max(initial=0.0)))
    right = np.zeros(total)
    right[:size] = near * shrink * unknowns.nominal / unknowns.scale
    right[size:] = shrink * _MARGINS[0]
    bounds = unknowns.matrices(n_links, np.zeros(n_links))
    held = Equations(wide, shrink * equations.right)
    return constrained_least_squares(goal, right, bounds, unknowns.rotor_places, held).values[size:] / shrink


def _nearest(identification: Identification, rotors_in_links: bool, blamed: list[str]) -> Completion:
    """What the feasible estimator makes of the same equations."""
    choices, data = identification.choices, identification.data.to_solve(identification.estimate.reference)
    fit = feasible(
        Problem(identification.model, data, identification.estimate.solution.known, choices.covariance, choices.trust)
    )
    assert fit.standard is not None
    values = fit.solution.values
    before = errors(data.torque, identification.values).relative_total
    after = errors(data.torque, values).relative_total
    note = (
        f"These are not the identified parameters but the nearest that bodies can have. What cannot exist: "
        f"{'; '.join(blamed)}. Along the identification's data the torque differs by "
        f"{_torque_difference(identification, values)} (rms), and its relative error is {after:.2%} instead of "
        f"{before:.2%}."
    )
    unknowns = Unknowns.of(identification.model, rotors_in_links=rotors_in_links, estimated=fit.standard)
    completed = _completed(unknowns, _equations(unknowns, values), values, _SMALL_MARGINS)
    if completed is None:
        unknowns = Unknowns.of(identification.model)
        completed = fit.standard.values[unknowns.columns]
    changed = _gathered(identification.model, unknowns, completed, values)
    return replace(changed, exact=False, notes=(note, *changed.notes))


def _torque_difference(identification: Identification, values: FloatArray) -> str:
    """Rms of W (values - χ) along the data, joint by joint, in words."""
    change = values - identification.values
    words = []
    for joint, equation in zip(identification.model.robot.joints, identification.data.training.equations, strict=True):
        moved = equation.joined[:, : len(equation.columns)] @ change[equation.columns]
        rms = float(np.linalg.norm(moved)) / np.sqrt(max(float(equation.counts.sum()), 1.0))
        words.append(f"{joint.name} {rms:.3g} {joint.effort_unit}")
    return ", ".join(words)


def _driving_friction(estimate: Estimate) -> list[str]:
    """Coulomb and viscous friction below zero, in words."""
    return [
        f"{column.name} of {column.link} (friction of {value:.3g}, which drives)"
        for column, value in zip(estimate.model.kept, estimate.values, strict=True)
        if role_of(column) in _FRICTION and not column.runs and value < _ROUNDING
    ]


def _gathered(model: Model, unknowns: Unknowns, completed: FloatArray, values: FloatArray) -> Completion:
    """Unknowns and base parameters as those of joints."""
    inertias, rotors = unknowns.standard(completed)
    robot = model.robot.tree
    friction: dict[Role | None, FloatArray] = {role: np.zeros(robot.n) for role in _FRICTION}
    friction_values = values - unknowns.grouping @ completed
    for column, value in zip(model.kept, friction_values, strict=True):
        role = role_of(column)
        if role in friction and not column.runs:
            friction[role][robot.joint_names.index(column.link)] += max(value, 0.0)
    coulomb, viscous = friction.values()
    missing = [joint for j, joint in enumerate(robot.joint_names) if j not in unknowns.links]
    notes = (f"The model has no rigid body on {', '.join(missing)}: these links have no inertia.",) if missing else ()
    return Completion(inertias, np.maximum(rotors, 0.0), coulomb, viscous, values, True, notes)
