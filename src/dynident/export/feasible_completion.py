"""Complete base parameters to all standard parameters of bodies that can exist, for programs that know only links.

The base parameters determine the torque, but a file of links needs all ten parameters of each link. Among all sets that
give the identified base parameters, with positive definite pseudo-inertias (Wensing, Kim and Slotine 2018) and rotors
that are not negative, the one nearest to the description (or to estimated standard parameters) is chosen. This is a
semidefinite problem, whose solution is then projected on G K = χ to the last digit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dynident.array_types import FloatArray
from dynident.effects import Role, get_role
from dynident.errors import DynidentError
from dynident.estimation import compute_errors
from dynident.estimation.constrained_least_squares import EqualityConstraints, InfeasibleError, solve_constrained
from dynident.export.link_unknowns import LinkUnknowns
from dynident.identification import Estimate, Identification
from dynident.identification.estimators.feasible import solve_feasible
from dynident.identification.problem import Problem
from dynident.regressors.model import Model

# Least eigenvalues of a link's pseudo-inertia, in units of its usual mass and size, tried in this order: a large margin
# keeps links away from degenerate bodies, but not all base parameters allow it. Parameters of a feasible estimator may
# lie at the border already, so that for them only small margins are tried.
_MARGINS = (2e-2, 1e-3, 1e-5, 0.0)
_SMALL_MARGINS = _MARGINS[2:]
# Weights of the distance to the description against violations; and the share of the worst violation from which on
# other links are named in the error as well.
_NEAR, _BLAMED = (1e-2, 1e-1, 1.0), 0.1
# Share of its usual size below which a rotor counts as zero; margin below which a link counts as infeasible; and
# negative friction that is still rounding.
_NO_ROTOR, _POSSIBLE, _ROUNDING = 1e-6, 1e-9, -1e-9
_FRICTION: tuple[Role, ...] = ("dry", "damping")


@dataclass(frozen=True, eq=False)
class Completion:
    """Standard parameters of a whole robot.

    Parameters
    ----------
    inertias : (n, 10)
        Inertial parameters of every link, in the order of `INERTIAL_NAMES`: moments about the joint's origin in kg m²,
        first moments in kg m, mass in kg.
    rotors : (n,)
        Rotor inertias seen at the joints, in kg m², or kg.
    coulomb : (n,)
        Coulomb friction of the joints, in N m, or N.
    viscous : (n,)
        Viscous friction of the joints, in N m s/rad, or N s/m.
    values : (b,)
        Base parameters that these standard parameters give.
    exact : bool
        Whether those are the identified ones.
    notes : tuple of str
        What a user must know of them, a sentence each.
    """

    inertias: FloatArray
    rotors: FloatArray
    coulomb: FloatArray
    viscous: FloatArray
    values: FloatArray
    exact: bool
    notes: tuple[str, ...] = ()


def complete_parameters(
    identification: Identification, *, nearest: bool = False, rotors_in_links: bool = False
) -> Completion:
    """Return feasible standard parameters that give the identified base parameters exactly.

    Parameters
    ----------
    identification : Identification
        The identified model, with the data of its fit.
    nearest : bool
        If there are none, return those with the nearest torque along the identification's data instead, and a note.
    rotors_in_links : bool
        Give rotors only what cannot belong to the links.

    Returns
    -------
    Completion
        Standard parameters of all links, rotors and friction.

    Raises
    ------
    DynidentError
        If there are none and `nearest` is not set (naming the links), or the model has no rigid body.
    """
    values = identification.values
    blamed = _describe_negative_friction(identification.estimate)
    margins = _SMALL_MARGINS if identification.choices.solver.possible_bodies else _MARGINS
    # If the links cannot take the rotors' inertia, try again with rotors of their own.
    for merged in (True, False) if rotors_in_links else (False,):
        unknowns = LinkUnknowns.from_model(
            identification.model, rotors_in_links=merged, estimated=identification.estimate.standard
        )
        equations = _build_equations(unknowns, values)
        completed = _solve_completion(unknowns, equations, values, margins)
        if completed is not None and not blamed:
            return _collect_by_joint(identification.model, unknowns, completed, values)
    if completed is None:
        blamed += _describe_impossible(unknowns, equations)
    if not nearest:
        raise DynidentError(
            f"no bodies that can exist have the identified base parameters: {'; '.join(blamed)}. Identify with the "
            'estimator "feasible", on data that excite these parameters, or ask for the nearest feasible ones '
            "(nearest), which changes the torque",
            pointer="/format",
            title="Not physically feasible",
        )
    return _complete_nearest(identification, rotors_in_links, blamed)


def _build_equations(unknowns: LinkUnknowns, values: FloatArray) -> EqualityConstraints:
    """Return the base parameters as equations of the scaled unknowns, each row of unit length."""
    factor = unknowns.grouping[unknowns.base_rows] * unknowns.scale
    sizes = np.linalg.norm(factor, axis=1)
    return EqualityConstraints(factor / sizes[:, None], values[unknowns.base_rows] / sizes)


def _solve_completion(
    unknowns: LinkUnknowns, equations: EqualityConstraints, values: FloatArray, margins: Sequence[float]
) -> FloatArray | None:
    """Return the unknowns (k,) nearest to the nominal ones that give the base parameters; None if there are none."""
    # Larger margins first: the farther links are from degenerate bodies, the better other programs can compute with
    # them.
    for margin in margins:
        try:
            solution = solve_constrained(
                np.eye(unknowns.size),
                unknowns.nominal / unknowns.scale,
                unknowns.build_bounds(0, np.full(len(unknowns.links), margin)),
                unknowns.rotor_places,
                equations,
            )
        except InfeasibleError:
            continue
        # The solver meets the equations to its tolerance only. Project on them exactly, and check that the small move
        # has not left the feasible set.
        moved = _project_on_base(unknowns, values[unknowns.base_rows], solution.values * unknowns.scale)
        if np.all(unknowns.compute_margins(moved) > _POSSIBLE) and np.all(moved[unknowns.rotor_places] >= 0):
            return moved
    return None


def _project_on_base(unknowns: LinkUnknowns, base: FloatArray, values: FloatArray) -> FloatArray:
    """Return the unknowns after the smallest move that makes them give the base parameters to the last digit."""
    grouping, rotors = unknowns.grouping[unknowns.base_rows], unknowns.rotor_places
    # A rotor that is zero stays zero: the smallest move would make it slightly negative as likely as positive.
    none = rotors[values[rotors] < _NO_ROTOR * unknowns.scale[rotors]]
    weights, moved = unknowns.scale.copy(), values.copy()
    weights[none] = moved[none] = 0.0
    # Minimum norm in units of each unknown's scale; the second pass removes the rounding of the first.
    for _ in range(2):
        moved += weights * np.linalg.lstsq(grouping * weights, base - grouping @ moved, rcond=1e-12)[0]
    return moved


def _describe_impossible(unknowns: LinkUnknowns, equations: EqualityConstraints) -> list[str]:
    """Return texts on the links and rotors that the base parameters make impossible."""
    names = unknowns.model.robot.tree.joint_names
    words = [f"the link of {names[j]} (no mass that is positive everywhere has its moments)" for j in unknowns.links]
    words += [f"the rotor of {names[j]} (negative inertia)" for j in unknowns.rotors]
    # The smaller the weight of the description, the clearer the violations stand out, and the worse the problem is
    # conditioned: where the solver fails, the next weight is tried.
    for near in _NEAR:
        try:
            margins = _minimise_violation(unknowns, equations, near)
        except InfeasibleError:
            continue
        worst = float(margins.min())
        blamed = margins < (_BLAMED * worst if worst < -_NO_ROTOR else _BLAMED * _MARGINS[0])
        return [word for word, guilty in zip(words, blamed, strict=True) if guilty] or ["the links together"]
    return ["the links, whose parameters are too far from those of any body"]


def _minimise_violation(unknowns: LinkUnknowns, equations: EqualityConstraints, near: float) -> FloatArray:
    """Return the margins of all links, then of all rotors, in the problem relaxed so that it has a solution."""
    n_links, n_rotors, size = len(unknowns.links), len(unknowns.rotors), unknowns.size
    # Unknowns, a margin a link, a margin a rotor: a rotor is its margin and something that is not negative.
    total = size + n_links + n_rotors
    wide = np.zeros((len(equations.right), total))
    wide[:, :size] = equations.factor
    # A rotor is split into a part that is not negative and its margin, which may be: both count in the equations.
    wide[:, size + n_links :] = equations.factor[:, unknowns.rotor_places]
    goal = np.eye(total)
    goal[:size] *= near
    # The problem is homogeneous, so it may be scaled; numbers of about one keep the solver precise.
    shrink = 1.0 / max(1.0, float(np.abs(equations.right).max(initial=0.0)))
    right = np.zeros(total)
    right[:size] = near * shrink * unknowns.nominal / unknowns.scale
    right[size:] = shrink * _MARGINS[0]
    bounds = unknowns.build_bounds(n_links, np.zeros(n_links))
    held = EqualityConstraints(wide, shrink * equations.right)
    return solve_constrained(goal, right, bounds, unknowns.rotor_places, held).values[size:] / shrink


def _complete_nearest(identification: Identification, rotors_in_links: bool, blamed: list[str]) -> Completion:
    """Return the completion of the feasible estimator's solution for the same data, with a note on the difference."""
    choices, data = identification.choices, identification.data.to_data(identification.estimate.reference)
    fit = solve_feasible(
        Problem(identification.model, data, identification.estimate.solution.known, choices.covariance, choices.trust)
    )
    assert fit.standard is not None
    values = fit.solution.values
    before = compute_errors(data.torque, identification.values).relative_total
    after = compute_errors(data.torque, values).relative_total
    note = (
        f"These are not the identified parameters but the nearest that bodies can have. What cannot exist: "
        f"{'; '.join(blamed)}. Along the identification's data the torque differs by "
        f"{_describe_torque_difference(identification, values)} (rms), and its relative error is {after:.2%} "
        f"instead of "
        f"{before:.2%}."
    )
    unknowns = LinkUnknowns.from_model(identification.model, rotors_in_links=rotors_in_links, estimated=fit.standard)
    completed = _solve_completion(unknowns, _build_equations(unknowns, values), values, _SMALL_MARGINS)
    if completed is None:
        unknowns = LinkUnknowns.from_model(identification.model)
        # Where no exact projection succeeds, the estimator's own standard parameters are near enough: they give its
        # base parameters to its tolerance.
        completed = fit.standard.values[unknowns.columns]
    changed = _collect_by_joint(identification.model, unknowns, completed, values)
    return replace(changed, exact=False, notes=(note, *changed.notes))


def _describe_torque_difference(identification: Identification, values: FloatArray) -> str:
    """Return a text with the rms of W (values - χ) along the data for each joint."""
    change = values - identification.values
    words = []
    for joint, equation in zip(identification.model.robot.joints, identification.data.training.equations, strict=True):
        moved = equation.joint_factor[:, : len(equation.columns)] @ change[equation.columns]
        rms = float(np.linalg.norm(moved)) / np.sqrt(max(float(equation.counts.sum()), 1.0))
        words.append(f"{joint.name} {rms:.3g} {joint.effort_unit}")
    return ", ".join(words)


def _describe_negative_friction(estimate: Estimate) -> list[str]:
    """Return texts on negative Coulomb and viscous friction, which would drive the motion."""
    return [
        f"{column.name} of {column.link} (friction of {value:.3g}, which drives)"
        for column, value in zip(estimate.model.kept, estimate.values, strict=True)
        if get_role(column) in _FRICTION and not column.runs and value < _ROUNDING
    ]


def _collect_by_joint(model: Model, unknowns: LinkUnknowns, completed: FloatArray, values: FloatArray) -> Completion:
    """Return unknowns and base parameters sorted by joints, as a completion."""
    inertias, rotors = unknowns.to_standard(completed)
    robot = model.robot.tree
    friction: dict[Role | None, FloatArray] = {role: np.zeros(robot.n) for role in _FRICTION}
    # What links and rotors do not explain of the base parameters are the parameters of other effects.
    friction_values = values - unknowns.grouping @ completed
    for column, value in zip(model.kept, friction_values, strict=True):
        role = get_role(column)
        if role in friction and not column.runs:
            # Rounding alone can make it negative here: friction that really drives was refused before, or reported.
            friction[role][robot.joint_names.index(column.link)] += max(value, 0.0)
    coulomb, viscous = friction.values()
    missing = [joint for j, joint in enumerate(robot.joint_names) if j not in unknowns.links]
    notes = (f"The model has no rigid body on {', '.join(missing)}: these links have no inertia.",) if missing else ()
    return Completion(inertias, np.maximum(rotors, 0.0), coulomb, viscous, values, True, notes)
