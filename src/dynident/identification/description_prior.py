"""Priors: normal from the robot's description or of single known parameters, or an entropic one on bodies.

Holds when a description is impossible or a placeholder, so that it gives no prior, and what may be known by name.

From the normal prior on standard parameters follows one on base parameters.

The entropic distance of a body with the pseudo-inertia J from the description's with J₀ is the divergence

    d(J ‖ J₀) = tr(J₀⁻¹ J) - log det(J₀⁻¹ J) - 4

(Wensing, Kim and Slotine 2018; Lee, Wensing and Park 2019). It is twice the Kullback-Leibler divergence between normal
distributions with these second moments. It is convex, the same in every frame and every unit, and grows without bound
where a body stops being possible. Near J₀ it is ½ tr((J₀⁻¹ dJ)²). Added to the squares of the weighted residuals with
the factor 2 / p², it assigns the mass, and the second moment of the mass about any plane, a relative standard deviation
of p.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NoReturn

import numpy as np

from dynident.array_types import BoolArray, FloatArray, IndexArray
from dynident.effects import DEFAULT_EFFECTS, OFFSETS, Column, get_role
from dynident.errors import DynidentError, describe_missing_joint, suggest_names
from dynident.estimation import PriorInformation
from dynident.estimation.parameter_covariance import compute_null_space
from dynident.identification.estimation_problem_options import DescriptionTrust
from dynident.identification.standard_parameters import find_bodies
from dynident.regressors.model_structure import Model
from dynident.robot.pseudo_inertia import (
    estimate_inertia_errors,
    estimate_rotor_inertias,
    find_description_units,
    find_impossible_links,
    inertial_parameters,
    pseudo_inertia,
    smallest_pseudo_inertia,
)
from dynident.robot.robot_model import INERTIAL_NAMES, Robot

# Of a link's parameters those that no body has below zero.
_NEVER_NEGATIVE = ("XX", "YY", "ZZ", "M")
# Share of the largest singular value below which a combination has no error of its own but rounding.
_NULL = 1e-9


@dataclass(frozen=True, eq=False)
class NormalPrior:
    """A normal prior on standard parameters.

    Parameters
    ----------
    mean : (c,)
        Mean of each parameter.
    size : (c,)
        Standard deviation of each parameter.
    stated : (c,)
        Where it is false nothing is known: mean and size are then only the order of magnitude.
    spread : (c, c) or None
        Where given, errors of the stated parameters are its product with independent ones of size one, and `size` is
        only an order of magnitude there, too.
    """

    mean: FloatArray
    size: FloatArray
    stated: BoolArray
    spread: FloatArray | None = None


@dataclass(frozen=True, eq=False)
class SplitPrior:
    """A prior in two independent parts: what it says of base parameters, and the rest.

    Parameters
    ----------
    base : PriorInformation
        Rows for the base parameters (b,).
    rest : (k, c)
        Rows for the standard parameters, counted from their mean and in units of their size, that say what the base
        parameters do not.
    """

    base: PriorInformation
    rest: FloatArray


def split_prior(model: Model, belief: NormalPrior) -> SplitPrior:
    """Split a prior into rows for the base parameters, and rows for what the base parameters leave open.

    Parameters
    ----------
    model : Model
        The model, with its base parameters' columns.
    belief : NormalPrior
        Mean and standard deviation of the standard parameters.

    Returns
    -------
    SplitPrior
        Rows for the base parameters, and the rest.
    """
    grouping, stated = model.base.grouping, belief.stated
    # Scale the standard parameters by their standard deviations and every base parameter by its own size, so that kg
    # and kg m² compare.
    scaled = grouping * belief.size
    errors = np.eye(int(stated.sum()))
    if belief.spread is not None:
        errors = belief.spread[np.ix_(stated, stated)] / belief.size[stated][:, None]
    row_size = np.linalg.norm(np.where(model.base.written, scaled, 0.0), axis=1)
    scaled = scaled / row_size[:, None]
    unknown = np.where(model.base.written, scaled, 0.0)[:, ~stated]
    # Only combinations of base parameters that hold no unknown standard parameter have a prior at all.
    untouched = compute_null_space(unknown.T, size=1.0).T
    mapped = untouched @ scaled[:, stated] @ errors
    # The singular values are the standard deviations of independent combinations of base parameters.
    left_vectors, singular, right_vectors = np.linalg.svd(mapped, full_matrices=False)
    enough = singular > _NULL * max(float(singular.max(initial=0.0)), 1.0)
    # Whitened rows: each has an error of variance one, and the errors are independent.
    whiten = (left_vectors[:, enough] / singular[enough]).T @ untouched
    factor = whiten / row_size
    base = PriorInformation(factor, factor @ (grouping @ np.where(stated, belief.mean, 0.0)))
    rest = np.zeros((len(errors), len(belief.mean)))
    # The complement of the directions that the base parameters take: independent of them, as the errors are whitened.
    rest[:, stated] = (np.eye(len(errors)) - right_vectors[enough].T @ right_vectors[enough]) @ np.linalg.inv(errors)
    return SplitPrior(base, rest)


# Smallest eigenvalue of a pseudo-inertia, scaled to a unit diagonal, that has a distance: flatter bodies are at the
# edge of what can exist.
_FLAT = 1e-6


@dataclass(frozen=True, eq=False)
class EntropicPrior:
    """The divergence of bodies from those of a description.

    Parameters
    ----------
    columns : (k, 10)
        Numbers of the bodies' standard parameters.
    nominal : (k, 4, 4)
        Their pseudo-inertias J₀ in the description.
    share : float
        The relative standard deviation p.
    """

    columns: IndexArray
    nominal: FloatArray
    share: float

    def compute_cost(self, values: FloatArray) -> float:
        """Return the cost 2 / p² Σ d(J ‖ J₀) of standard parameters (c,): infinite for bodies that cannot exist."""
        matrices = pseudo_inertia(values[self.columns])
        if not len(matrices):
            return 0.0
        try:
            # The same factorisation as in `approximate_at`. By rounding, a test of eigenvalues could pass a matrix that
            # has no Cholesky factor.
            np.linalg.cholesky(matrices)
        except np.linalg.LinAlgError:
            return float("inf")
        # J₀⁻¹ J: its trace and determinant do not depend on the frame.
        relative = np.linalg.solve(self.nominal, matrices)
        divergence = np.trace(relative, axis1=1, axis2=2) - np.linalg.slogdet(relative)[1] - 4.0
        return float(2.0 / self.share**2 * divergence.sum())

    def approximate_at(self, belief: NormalPrior, values: FloatArray) -> NormalPrior:
        """Return the normal prior whose cost has the slope and curvature of `compute_cost` at standard parameters (c,).

        Its mean is 2 J - J J₀⁻¹ J and its errors are p L Δ Lᵀ with J = L Lᵀ, the entries of the symmetric Δ being
        independent.

        Parameters
        ----------
        belief : NormalPrior
            Prior of the other parameters.
        values : (c,)
            Standard parameters, whose bodies are possible.

        Returns
        -------
        NormalPrior
            `belief` with the bodies' mean and spread in place of its own.
        """
        mean, spread = belief.mean.copy(), np.diag(belief.size)
        for columns, nominal in zip(self.columns, self.nominal, strict=True):
            matrix = pseudo_inertia(values[columns])
            root = np.linalg.cholesky(matrix)
            mean[columns] = inertial_parameters(2.0 * matrix - matrix @ np.linalg.solve(nominal, matrix))
            spread[np.ix_(columns, columns)] = self.share * inertial_parameters(root @ _SYMMETRIC_BASIS @ root.T).T
        return replace(belief, mean=mean, spread=spread)


def build_entropic_prior(model: Model, share: float, belief: NormalPrior) -> EntropicPrior:
    """Return the entropic prior of the links that a belief covers, whose bodies are usually off by the share.

    Parameters
    ----------
    model : Model
        The model, with its base parameters' columns.
    share : float
        p, the relative standard deviation.
    belief : NormalPrior
        Its mean is the description.

    Raises
    ------
    DynidentError
        Where the description of one of them is flat or without mass: no body with volume is near it.
    """
    # A body of which some parameters are unknown has no distance as a whole.
    believed = [body for body in find_bodies(model.columns) if belief.stated[body.columns].all()]
    nominal = np.array([belief.mean[body.columns] for body in believed]).reshape(-1, 10)
    _check_bodies(model.robot.name, [body.name for body in believed], nominal)
    columns = np.array([body.columns for body in believed], dtype=np.intp).reshape(-1, 10)
    return EntropicPrior(columns, pseudo_inertia(nominal), share)


def _check_bodies(robot: str, names: Sequence[str], nominal: FloatArray) -> None:
    flat = [name for name, least in zip(names, smallest_pseudo_inertia(nominal), strict=True) if not least > _FLAT]
    if flat:
        raise DynidentError(
            f"the description of {robot} gives {', '.join(flat)} no mass or no extent in some direction: the entropic "
            "prior is not defined for such a body; correct it, add the link to free_links, or choose the prior "
            "description",
            pointer="/prior",
            title="No prior",
        )


def _build_symmetric_basis() -> FloatArray:
    """Return a basis (10, 4, 4) of the symmetric matrices, orthonormal in the Frobenius product."""
    matrices = []
    for row in range(4):
        for column in range(row + 1):
            matrix = np.zeros((4, 4))
            matrix[row, column] = matrix[column, row] = 1.0 if row == column else np.sqrt(0.5)
            matrices.append(matrix)
    return np.array(matrices)


_SYMMETRIC_BASIS = _build_symmetric_basis()


_TITLE = "No prior"
# Inertias of links within this share of one another are the same: placeholders.
_ALIKE = 1e-6


def build_prior(model: Model, trust: DescriptionTrust) -> PriorInformation | None:
    """Return what a prior says of the base parameters; None where there is none.

    Base parameters are sums of standard ones, β = G φ. So where φ has the mean μ and the covariance D, β has the mean
    G μ and the covariance G D Gᵀ. Of sums with something unknown in them (a rotor's inertia, friction, a free link)
    nothing is known.

    For the entropic prior this is its normal approximation at the description.

    Parameters
    ----------
    model : Model
        The model, with its base parameters' columns.
    trust : DescriptionTrust
        Prior from the description, if any, and how far it is trusted; known parameters.

    Returns
    -------
    PriorInformation or None
        Rows for the base parameters; None where there is no prior.

    Raises
    ------
    DynidentError
        Where the description gives no inertias, gives placeholders or impossible ones, or a free link does not exist.
    """
    known = _build_known(model, trust.known)
    if trust.prior is None:
        return known
    check_description(model.robot.tree, trust.free_links)
    belief = build_normal_prior(model, trust)
    if trust.of_bodies:
        belief = build_entropic_prior(model, trust.error, belief).approximate_at(belief, belief.mean)
    described = split_prior(model, belief).base
    return described if known is None else known.combine_with(described)


def _build_known(model: Model, known: Sequence[tuple[str, float, float]]) -> PriorInformation | None:
    """Return base parameters that are known: held exactly, or as rows where they have a standard deviation."""
    names, b = [column.name for column in model.kept], model.n_parameters
    places = [(names.index(name), value, error) for name, value, error in known if name in names]
    if not places:
        return None
    uncertain = [(k, value, error) for k, value, error in places if error > 0]
    factor, right = np.zeros((len(uncertain), b)), np.zeros(len(uncertain))
    for row, (k, value, error) in enumerate(uncertain):
        factor[row, k], right[row] = 1.0 / error, value / error
    held = np.full(b, np.nan)
    for k, value, error in places:
        if error == 0:
            held[k] = value
    return PriorInformation(factor, right, None if np.isnan(held).all() else held)


def check_description(robot: Robot, free_links: Sequence[str]) -> None:
    """Raise where a robot's description gives no inertias of its links that a prior could use.

    Parameters
    ----------
    robot : Robot
        The robot.
    free_links : sequence of str
        Joints whose links need none.

    Raises
    ------
    DynidentError
    """
    # A prior that believes placeholders would do more harm than none, so each of these cases is refused.
    inertias = robot.inertias
    for index, name in enumerate(free_links):
        if name not in robot.joint_names:
            raise DynidentError(
                describe_missing_joint(name, robot.joint_names),
                pointer=f"/free_links/{index}",
                title="Unknown joint",
            )
    # The last of the ten parameters is the mass.
    if inertias is None or not np.any(inertias[:, 9] > 0):
        raise DynidentError(
            f"the description of {robot.name} gives no inertias; add them (<inertial> of every link), or leave the "
            "prior out",
            pointer="/prior",
            title=_TITLE,
        )
    for link, values in enumerate(inertias):
        if not np.all(np.isfinite(values)) or values[9] < 0:
            raise DynidentError(
                f"the description gives {robot.joint_names[link]} a mass of {values[9]:g} kg or an inertia that is "
                "not a number, which cannot be used; correct the description, or leave the prior out",
                pointer="/prior",
                title=_TITLE,
            )
    if impossible := [name for name in find_impossible_links(robot) if name not in free_links]:
        raise DynidentError(
            f"the description gives {', '.join(impossible)} an inertia that is not physically possible (each moment "
            "of inertia is at most the sum of the other two, about the centre of mass); correct it, add the link to "
            "free_links, or leave the prior out",
            pointer="/prior",
            title="Infeasible prior",
        )
    if robot.n > 1 and np.all(np.abs(inertias - inertias[0]) <= _ALIKE * np.abs(inertias[0]).max()):
        raise DynidentError(
            f"the description of {robot.name} gives all links the same inertia: these are placeholders; replace them "
            "by the values from the drawings, or leave the prior out",
            pointer="/prior",
            title=_TITLE,
        )


def build_normal_prior(model: Model, trust: DescriptionTrust) -> NormalPrior:
    """Return what the description says of a model's standard parameters, whether or not a prior is chosen.

    Parameters
    ----------
    model : Model
        The model, with its base parameters' columns.
    trust : DescriptionTrust
        Prior from the description, if any, and how far it is trusted.

    Returns
    -------
    NormalPrior
        Mean and standard deviation of all standard parameters, and which are stated.
    """
    robot = model.robot.tree
    # Numbers in grams would be far from everything that the data say.
    units = find_description_units(robot)
    robot = robot if units is None else units.to_si(robot)
    nominal = np.zeros((robot.n, 10)) if robot.inertias is None else robot.inertias
    errors, rotors = estimate_inertia_errors(robot, trust.error), estimate_rotor_inertias(robot)
    mean, size = np.zeros(len(model.columns)), np.ones(len(model.columns))
    stated = np.zeros(len(model.columns), dtype=bool)
    for k, column in enumerate(model.columns):
        role = get_role(column)
        if role == "link":
            link, parameter = robot.joint_names.index(column.link), INERTIAL_NAMES.index(column.parameter)
            mean[k], size[k] = nominal[link, parameter], errors[link, parameter]
            # Without a prior the description still gives sizes, and decides what the data leave open.
            stated[k] = trust.prior is not None and column.link not in trust.free_links
        elif role == "rotor":
            # Descriptions hardly ever state rotor inertias: only their order of magnitude is used, for scaling.
            size[k] = rotors[robot.joint_names.index(column.link)]
        elif role == "load":
            size[k] = errors[robot.joint_names.index(column.link), _get_payload_parameter(column)]
    return NormalPrior(mean, size, stated)


def check_known(model: Model, known: Mapping[str, float]) -> None:
    """Raise where a known parameter is not one that the model lists, or a mass, inertia or friction below zero.

    Parameters
    ----------
    model : Model
        The model, with its base parameters' columns.
    known : mapping of str to float
        Values of the known parameters, by name.

    Raises
    ------
    DynidentError
        Names the parameter, and those that there are; of a standard parameter, those that contain it.
    """
    columns, listed = {column.name: column for column in model.columns}, [column.name for column in model.kept]
    for name, value in known.items():
        if name not in listed:
            if name in columns:
                _refuse_grouped(model, name, list(columns).index(name))
            raise DynidentError(
                f"the model has no parameter {name!r}{suggest_names(name, listed)}; its parameters are: "
                f"{', '.join(listed)}",
                pointer="/known",
                title="Unknown parameter",
            )
        check_unique(name, listed, "/known")
        row = listed.index(name)
        parts = [(model.columns[k], weight) for k, weight in enumerate(model.base.grouping[row]) if weight != 0]
        # A sum may be negative as soon as one of its terms may.
        if value < 0 and all(weight > 0 and _is_never_negative(column) for column, weight in parts):
            raise DynidentError(
                f"the known {name} is {value:g}, but no mass and no moment of inertia is below zero; give the value of "
                "a body that can exist",
                pointer="/known",
                title="Impossible value",
            )
        if value < 0 and has_plain_friction(model) and all(get_role(column) in FRICTION_ROLES for column, _ in parts):
            raise DynidentError(
                f"the known {name} is {value:g}, but friction below zero would drive the motion; check the sign of the "
                "value",
                pointer="/known",
                title="Impossible value",
            )


def check_unique(name: str, listed: Sequence[str], pointer: str) -> None:
    """Raise where several parameters have a name, as those of two ripples on one joint."""
    if listed.count(name) > 1:
        raise DynidentError(
            f"{listed.count(name)} parameters of the model have the name {name}, so it does not say which is meant; "
            "leave it out",
            pointer=pointer,
            title="Ambiguous parameter",
        )


FRICTION_ROLES = ("dry", "damping")
"""Roles of the parameters of friction that brakes."""
_PLAIN = {choice.effect for choice in (*DEFAULT_EFFECTS, OFFSETS)}


def has_plain_friction(model: Model) -> bool:
    """Return whether no friction may be below zero: beside other friction effects a negative part is possible.

    Parameters
    ----------
    model : Model
        The robot with its effects.
    """
    return all(choice.effect in _PLAIN for choice in model.effects)


def _refuse_grouped(model: Model, name: str, column: int) -> NoReturn:
    sums = [
        f"{model.kept[row].name} = {model.base.groupings[row]}" for row in np.flatnonzero(model.base.written[:, column])
    ]
    shown = f"the motion shows it only in {'; '.join(sums)}" if sums else "no motion shows it"
    remedy = "state the value of the whole sum as known, or leave it out" if sums else "leave it out of known"
    raise DynidentError(
        f"{name} is not a parameter by itself: {shown}; {remedy}", pointer="/known", title="Grouped parameter"
    )


def _is_never_negative(column: Column) -> bool:
    role = get_role(column)
    return role == "rotor" or (role == "link" and column.parameter in _NEVER_NEGATIVE)


def _get_payload_parameter(column: Column) -> int:
    return [f"{name}p" for name in INERTIAL_NAMES].index(column.parameter)
