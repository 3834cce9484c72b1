"""The prior on a model's parameters: the inertias of the robot's description."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dynident.effects import Column, get_role
from dynident.errors import DynidentError
from dynident.estimation import PriorInformation
from dynident.estimation.uncertainty import find_prior_dominated
from dynident.identification.entropic_prior import NormalPrior, build_entropic_prior, split_prior
from dynident.identification.equations.reduce_data import Data
from dynident.identification.fit import Fit
from dynident.identification.problem_options import DescriptionTrust
from dynident.regressors.model import Model
from dynident.robot.model import INERTIAL_NAMES, Robot
from dynident.robot.pseudo_inertia import estimate_inertia_errors, estimate_rotor_inertias, smallest_pseudo_inertia

_TITLE = "No prior"
# Inertias of links within this share of one another are the same: placeholders.
_ALIKE = 1e-6
# How far below zero rounded drawings may bring an eigenvalue of a pseudo-inertia, scaled to a unit diagonal.
_IMPOSSIBLE = 0.01


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
        Prior from the description, if any, and how far it is trusted.

    Returns
    -------
    PriorInformation or None
        Rows for the base parameters; None where there is no prior.

    Raises
    ------
    DynidentError
        Where the description gives no inertias, gives placeholders or impossible ones, or a free link does not exist.
    """
    if trust.prior is None:
        return None
    check_description(model.robot.tree, trust.free_links)
    belief = build_normal_prior(model, trust)
    if trust.of_bodies:
        belief = build_entropic_prior(model, trust.error, belief).approximate_at(belief, belief.mean)
    return split_prior(model, belief).base


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
                f"there is no joint {name!r}; the joints of {robot.name} are: {', '.join(robot.joint_names)}",
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
    # A body exists where its pseudo-inertia has no negative eigenvalue.
    smallest = smallest_pseudo_inertia(inertias)
    impossible = [
        name
        for name, least in zip(robot.joint_names, smallest, strict=True)
        if least < -_IMPOSSIBLE and name not in free_links
    ]
    if impossible:
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


def _get_payload_parameter(column: Column) -> int:
    return [f"{name}p" for name in INERTIAL_NAMES].index(column.parameter)


def add_prior_warning(model: Model, data: Data, fit: Fit) -> Fit:
    """Return the fit with a warning that says what in it rests on the prior rather than on the data.

    Parameters
    ----------
    model : Model
        The model, with its base parameters' columns.
    data : Data
        Recordings reduced to the model's columns.
    fit : Fit
        The fit with the prior.

    Returns
    -------
    Fit
        The same with one more warning, which comes first.
    """
    owed = find_prior_dominated(data.equations, fit.solution)
    names = [column.name for column, rests in zip(model.kept, owed, strict=True) if rests]
    warning = (
        "The inertias of the description are used as data here, each with the usual error of descriptions: this is an "
        "assumption, and the standard deviations depend on it."
    )
    if names:
        warning += f" The data determine these parameters less than the prior does: {', '.join(names)}."
    return replace(fit, warnings=(warning, *fit.warnings))
