"""Choose all ten parameters of every link for given base parameters, with positive definite inertias.

The base parameters determine the torque, but a file of links needs all ten parameters of each link. Among all sets that
give the identified base parameters, with positive definite pseudo-inertias (Wensing, Kim and Slotine 2018) and rotors
that are not negative, the one nearest to the description (or to estimated standard parameters) is chosen. This is a
semidefinite problem, whose solution is then projected on G K = χ to the last digit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product

import numpy as np

from dynident.array_types import FloatArray, IndexArray
from dynident.effects import Role, get_role
from dynident.errors import DynidentError
from dynident.estimation import compute_errors
from dynident.estimation.constrained_least_squares import (
    EqualityConstraints,
    InfeasibleError,
    MatrixBound,
    solve_constrained,
)
from dynident.estimation.parameter_covariance import compute_null_space
from dynident.identification import Estimate, Identification
from dynident.identification.estimation_problem import Problem
from dynident.identification.estimators.feasible import solve_feasible
from dynident.identification.standard_parameters import StandardParameters
from dynident.number_format import format_percent
from dynident.regressors.model_structure import Model
from dynident.robot.pseudo_inertia import PSEUDO_INERTIA_PARTS, estimate_inertia_errors, estimate_rotor_inertias
from dynident.robot.robot_model import INERTIAL_NAMES

_TEN = len(INERTIAL_NAMES)
# Radius of gyration, over its size, of a link for which the description has no mass.
_GYRATION = 0.5


@dataclass(frozen=True, eq=False)
class LinkUnknowns:
    """Standard parameters of links and rotors among a model's columns.

    Attributes
    ----------
    model : Model
        The model whose columns they are.
    links, rotors : tuple of int
        Indices of the joints whose link, or whose rotor, is an unknown.
    columns : ndarray (k,)
        Indices of the unknowns among `model.columns`: ten a link, then one a rotor.
    scale, nominal : ndarray (k,)
        Usual error of the description, and its values.
    file_model : Model or None
        The model of a file: what it lacks is left out, and may take what it shares with links and rotors along.
    """

    model: Model
    links: tuple[int, ...]
    rotors: tuple[int, ...]
    columns: IndexArray
    scale: FloatArray
    nominal: FloatArray
    file_model: Model | None = None

    @classmethod
    def from_model(
        cls,
        model: Model,
        *,
        rotors_in_links: bool = False,
        estimated: StandardParameters | None = None,
        file_model: Model | None = None,
    ) -> LinkUnknowns:
        """Return the unknowns of a model.

        Parameters
        ----------
        model : Model
            The model whose columns they are.
        rotors_in_links : bool
            Leave out rotors whose inertia is grouped with that of links, so that the links have it all.
        estimated : StandardParameters, optional
            Nominal values instead of the description's.
        file_model : Model, optional
            The model of a file: what it lacks may take what it shares with links and rotors along.

        Raises
        ------
        DynidentError
            If the model has no rigid body.
        """
        joints = model.robot.tree.joint_names
        rigid = [k for k, column in enumerate(model.columns) if get_role(column) == "link" and not column.runs]
        if not rigid:
            raise DynidentError(
                "the model has no rigid_body, so there are no masses and inertias to write; export C code, a CasADi "
                "function or JSON",
                pointer="/format",
                title="No links in the model",
            )
        base_columns = set(model.base.kept)
        spinning = [
            k
            for k, column in enumerate(model.columns)
            if get_role(column) == "rotor" and not column.runs and (k in base_columns or not rotors_in_links)
        ]
        # Each link has ten columns, one behind the other: every tenth names it.
        links = tuple(joints.index(model.columns[k].link) for k in rigid[::_TEN])
        rotors = tuple(joints.index(model.columns[k].link) for k in spinning)
        doubt = estimate_inertia_errors(model.robot.tree)
        scale = np.concatenate(
            [doubt[list(links)].reshape(-1), estimate_rotor_inertias(model.robot.tree)[list(rotors)]]
        )
        nominal = np.concatenate(
            [_get_described_inertias(model, doubt)[list(links)].reshape(-1), np.zeros(len(rotors))]
        )
        columns = np.array(rigid + spinning, dtype=np.intp)
        # A feasible estimator has found standard parameters already: the completion stays near these instead of the
        # description.
        if estimated is not None:
            nominal = estimated.values[columns]
        return cls(model, links, rotors, columns, scale, nominal, file_model)

    @property
    def size(self) -> int:
        """Number of unknowns k."""
        return len(self.columns)

    @property
    def rotor_places(self) -> IndexArray:
        """Places of the rotors among the unknowns."""
        return np.arange(self.size - len(self.rotors), self.size)

    @cached_property
    def link_sums(self) -> FloatArray:
        """(e, b): the sums of base parameters that links and rotors have to give.

        A constant torque on a vertical slide is grouped with the mass that it carries. Where a file leaves it out, only
        what does not depend on it counts of the base parameters that hold it.
        """
        grouping, b = self.model.base.grouping, self.model.n_parameters
        inertial = [get_role(column) in ("link", "rotor") and not column.runs for column in self.model.kept]
        sums = np.eye(b)[inertial]
        if self.file_model is None:
            return sums
        there = {column.key for column in self.file_model.columns}
        lost = sums @ grouping[:, [column.key not in there for column in self.model.columns]]
        mixed = np.asarray(lost.any(axis=1))
        # Parameters that nothing else is in stay apart: their sizes are very different.
        return np.concatenate([sums[~mixed], compute_null_space(lost[mixed].T).T @ sums[mixed]])

    @cached_property
    def grouping(self) -> FloatArray:
        """(b, k): how the unknowns, in their own units, group into all base parameters."""
        return np.asarray(self.model.base.grouping[:, self.columns])

    def build_bounds(self, extra: int, slack: FloatArray) -> list[MatrixBound]:
        """Return the bounds that keep the pseudo-inertia of every link positive definite.

        The variables are the unknowns over their scale, then `extra` others. The scaled pseudo-inertia of each link is
        to be at
        least `slack` times the unit matrix; where there are extra variables, the first of them, one a link, are
        subtracted from
        it, too.

        Parameters
        ----------
        extra : int
            Number of variables after the unknowns.
        slack : (l,)
            Least eigenvalue of each link's scaled pseudo-inertia.

        Returns
        -------
        list of MatrixBound
            One bound a link.
        """
        bounds = []
        for place, least in enumerate(slack):
            link_places = slice(_TEN * place, _TEN * (place + 1))
            columns = np.arange(link_places.start, link_places.stop)
            parts = self._scale_pseudo_inertias(place) * self.scale[link_places][:, None, None]
            if extra:
                columns = np.append(columns, self.size + place)
                parts = np.concatenate([parts, -np.eye(4)[None]])
            bounds.append(MatrixBound(columns, parts, -least * np.eye(4)))
        return bounds

    def compute_margins(self, unknowns: FloatArray) -> FloatArray:
        """Return the smallest eigenvalue (l,) of each link's scaled pseudo-inertia, which `build_bounds` bounds."""
        none = np.zeros(len(self.links))
        scaled = unknowns / self.scale
        return np.array([np.linalg.eigvalsh(bound.evaluate(scaled))[0] for bound in self.build_bounds(0, none)])

    def _scale_pseudo_inertias(self, place: int) -> FloatArray:
        """Return the pseudo-inertias (10, 4, 4) of unit parameters, in units of the link's usual mass and size."""
        of_link = self.scale[_TEN * place : _TEN * (place + 1)]
        # Without units, eigenvalues of links of all sizes can be compared, and the solver sees numbers of about one.
        mass, length = of_link[9], np.sqrt(of_link[0] / of_link[9])
        shrink = np.array([1 / length] * 3 + [1.0]) / np.sqrt(mass)
        return np.asarray(PSEUDO_INERTIA_PARTS * shrink[:, None] * shrink)

    def to_standard(self, unknowns: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the inertias (n, 10) of all links and (n,) of all rotors; zero where the model has none."""
        n = self.model.robot.tree.n
        inertias, rotors = np.zeros((n, _TEN)), np.zeros(n)
        inertias[list(self.links)] = unknowns[: _TEN * len(self.links)].reshape(-1, _TEN)
        rotors[list(self.rotors)] = unknowns[_TEN * len(self.links) :]
        return inertias, rotors


def _get_described_inertias(model: Model, doubt: FloatArray) -> FloatArray:
    """Return inertias (n, 10) of the description, and a ball about the joint's origin for links without mass."""
    inertias = np.zeros_like(doubt) if model.robot.inertias is None else model.robot.inertias.copy()
    for link in np.flatnonzero(inertias[:, 9] <= 0):
        inertias[link] = 0.0
        inertias[link, 9] = doubt[link, 9]
        # XX, YY and ZZ of a ball are equal, and its products of inertia zero.
        inertias[link, [0, 3, 5]] = _GYRATION**2 * doubt[link, 0]
    return inertias


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
    identification: Identification,
    *,
    nearest: bool = False,
    rotors_in_links: bool = False,
    file_model: Model | None = None,
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
    file_model : Model, optional
        The model of a file that lacks effects. Its friction is fitted again, so that negative friction is no hindrance;
        nor is a constant torque that links would have to make up for.

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
    blamed = _describe_negative_friction(identification.estimate) if file_model is None else []
    margins = _SMALL_MARGINS if identification.choices.solver.possible_bodies else _MARGINS
    # If the links cannot take the rotors' inertia, try again with rotors of their own; if they cannot take all that is
    # grouped with them, without what the file lacks.
    for lacking, merged in product(
        (None,) if file_model is None else (None, file_model), (True, False) if rotors_in_links else (False,)
    ):
        unknowns = LinkUnknowns.from_model(
            identification.model,
            rotors_in_links=merged,
            estimated=identification.estimate.standard,
            file_model=lacking,
        )
        equations = _build_equations(unknowns, values)
        completed = _solve_completion(unknowns, equations, values, margins)
        if completed is not None and not blamed:
            return replace(_collect_by_joint(unknowns.model, unknowns, completed, values), exact=lacking is None)
    if completed is None:
        blamed += _describe_impossible(unknowns, equations)
    if not nearest:
        raise DynidentError(
            f"the identified base parameters are not physically feasible: {'; '.join(blamed)}. Identify with the "
            'estimator "feasible", on data that excite these parameters, or ask for the nearest feasible ones '
            "(nearest), which changes the torque",
            pointer="/format",
            title="Not physically feasible",
        )
    return _complete_nearest(identification, rotors_in_links, blamed)


def _build_equations(unknowns: LinkUnknowns, values: FloatArray) -> EqualityConstraints:
    """Return the base parameters as equations of the scaled unknowns, each row of unit length."""
    factor = unknowns.link_sums @ unknowns.grouping * unknowns.scale
    sizes = np.linalg.norm(factor, axis=1)
    return EqualityConstraints(factor / sizes[:, None], unknowns.link_sums @ values / sizes)


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
        moved = _project_on_base(unknowns, unknowns.link_sums @ values, solution.values * unknowns.scale)
        if np.all(unknowns.compute_margins(moved) > _POSSIBLE) and np.all(moved[unknowns.rotor_places] >= 0):
            return moved
    return None


def _project_on_base(unknowns: LinkUnknowns, base: FloatArray, values: FloatArray) -> FloatArray:
    """Return the unknowns after the smallest move that makes them give these sums to the last digit."""
    grouping, rotors = unknowns.link_sums @ unknowns.grouping, unknowns.rotor_places
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
    words = [f"the link of {names[j]} (no body with positive mass has its moments)" for j in unknowns.links]
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
        f"These are not the identified parameters but the nearest feasible ones. Not feasible: {'; '.join(blamed)}. On "
        "the data of the identification the torque of the whole model differs by "
        f"{_describe_torque_difference(identification, values)} (rms), and its relative error is "
        f"{format_percent(after)} instead of "
        f"{format_percent(before)}."
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


def compute_base_parameters(model: Model, completion: Completion) -> FloatArray:
    """Return what the links and rotors of a completion give of a model's base parameters (b,)."""
    unknowns = LinkUnknowns.from_model(model)
    return unknowns.grouping @ _list_unknowns(unknowns, completion)


def replace_friction(completion: Completion, model: Model, values: FloatArray) -> Completion:
    """Return a completion with the same links and rotors for base parameters (b,) of a model with other friction."""
    unknowns = LinkUnknowns.from_model(model)
    changed = _collect_by_joint(model, unknowns, _list_unknowns(unknowns, completion), values)
    return replace(changed, exact=completion.exact, notes=completion.notes)


def _list_unknowns(unknowns: LinkUnknowns, completion: Completion) -> FloatArray:
    """Return a completion's links and rotors as the unknowns (k,)."""
    return np.append(completion.inertias[list(unknowns.links)].ravel(), completion.rotors[list(unknowns.rotors)])


def _describe_torque_difference(identification: Identification, values: FloatArray) -> str:
    """Return a text with the rms of W (values - χ) along the data for each joint."""
    change = values - identification.values
    words = []
    for joint, equation in zip(identification.model.robot.joints, identification.data.training.equations, strict=True):
        moved = equation.whole_factor[:, : len(equation.columns)] @ change[equation.columns]
        rms = float(np.linalg.norm(moved)) / np.sqrt(max(float(equation.counts.sum()), 1.0))
        words.append(f"{joint.name} {rms:.3g} {joint.effort_unit}")
    return ", ".join(words)


def _describe_negative_friction(estimate: Estimate) -> list[str]:
    """Return texts on negative Coulomb and viscous friction, which would drive the motion."""
    return [
        f"{column.name} of {column.link} (friction of {value:.3g}, which would drive the joint)"
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
