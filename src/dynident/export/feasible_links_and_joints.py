"""Links and joints that URDF and MJCF are written from, and how much error feasibility costs.

Holds the error ratio up to which feasible bodies count as equally good (1.05), and that of a warning (1.25).
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from dynident.array_types import FloatArray
from dynident.effects import EffectChoice, ReferenceParameters, Role, get_effect, get_role
from dynident.errors import DynidentError
from dynident.estimation import Errors
from dynident.estimation.least_squares import build_weighted_factor
from dynident.export.comments_and_names import describe_effect
from dynident.export.feasible_completion import (
    Completion,
    complete_parameters,
    compute_base_parameters,
    replace_friction,
)
from dynident.identification import Identification, reidentify
from dynident.number_format import format_percent
from dynident.regressors.errors_by_phase import compute_moving_errors
from dynident.robot.pinocchio_conversion import compute_described_torque
from dynident.robot.robot_model import Robot

MOST_FREE_ERROR_RATIO = 1.05
"""Ratio of the relative errors with and without the constraint of feasible bodies, up to which the constraint costs
nothing that a user would notice: two models of one robot from two recordings differ by more."""
NOTABLE_ERROR_RATIO = 1.25
"""Ratio of the relative errors of a file and of its model, above which a warning recommends another format."""


def select_held_effects(identification: Identification, held: Collection[Role]) -> tuple[EffectChoice, ...]:
    """Return the chosen effects of a model that a format for parameters with the roles `held` can hold."""
    effects = identification.choices.effects
    return tuple(choice for choice in effects if not choice.runs and get_effect(choice.effect).fits_roles(held))


def check_is_tree(identification: Identification, format_name: str) -> None:
    """Raise a DynidentError if joints of the robot follow others, or its links form closed loops."""
    if identification.model.robot.linkage is not None:
        raise DynidentError(
            f"joints of {identification.model.robot.name} follow others, which this export to {format_name} does not "
            "write; export MJCF, C code, a CasADi function or JSON",
            pointer="/format",
            title=f"Not expressible in {format_name}",
        )


def check_base(identification: Identification) -> None:
    """Raise a DynidentError if the base moves, whose coordinates no file of links and joints has."""
    identification.model.robot.require_fixed_base("export of links and joints")


def project_model(identification: Identification, held: Collection[Role]) -> Identification:
    """Return a model with only the effects that a format can hold, fitted to the same data again.

    Where the format holds all effects, that is the model itself. In the new one links and rotors make up for the
    effects that are missing, as far as they can: `fit_beside_links` has what a file is to hold.

    Parameters
    ----------
    identification : Identification
        The identified model, with the data of its fit.
    held : collection of Role
        Roles of the parameters that the format has words for.

    Returns
    -------
    Identification
        The fitted model.
    """
    held_effects, choices = select_held_effects(identification, held), identification.choices
    if not held_effects or held_effects == choices.effects:
        return identification
    # Estimators that go over the rows themselves would read all recordings again: weighted least squares works on the
    # factors.
    estimator = choices.estimator if choices.solver.from_reduced else "wls"
    return reidentify(identification, replace(choices, effects=held_effects, strategy="global", estimator=estimator))


def get_link_parameters(identification: Identification, projected: Identification) -> FloatArray:
    """Return the base parameters (b,) of a projected model, those of links and rotors as they were identified.

    Those that the identified model does not have by this name are as they were fitted.
    """
    places = {column.name: k for k, column in enumerate(identification.model.kept)}
    return np.array(
        [
            0.0
            if not get_effect(column.effect).is_inertia
            else identification.values[places[column.name]]
            if column.name in places
            else value
            for column, value in zip(projected.model.kept, projected.values, strict=True)
        ]
    )


def fit_beside_links(identification: Identification, projected: Identification, links: FloatArray) -> Identification:
    """Return a projected model with given links and rotors, and everything else fitted to the data again.

    A constant torque or a spring that the format lacks is no mass. A fit of the links without it predicts motions like
    the recorded ones a little better and everything else worse: of an arm with offsets of its sensors a link came out
    at seven times its mass. Friction, however, takes on what it can of a law that is missing.

    Parameters
    ----------
    identification : Identification
        The identified model, which says how sure the parameters are.
    projected : Identification
        The model with only the effects that the format can hold.
    links : (b,)
        What the links and rotors give of its base parameters; what stands there for others is fitted again.

    Returns
    -------
    Identification
        The projected model with other values. Friction is not negative.
    """
    model, training = projected.model, projected.data.training
    free = np.array([not get_effect(column.effect).is_inertia for column in model.kept])
    values = links.copy()
    if free.any():
        # Imported here: few who import this module write files.
        from scipy.optimize import lsq_linear

        weighted = build_weighted_factor(training, projected.estimate.solution.noise)
        lower = [0.0 if get_role(column) in ("dry", "damping") else -np.inf for column in model.kept]
        rest = lsq_linear(
            weighted[:, :-1][:, free], weighted[:, -1] - weighted[:, :-1] @ values, (np.array(lower)[free], np.inf)
        )
        values[free] += rest.x
    places = [column.name for column in identification.model.kept]
    statistics = projected.statistics
    if all(column.name in places for column in model.kept):
        shared = [places.index(column.name) for column in model.kept]
        own = identification.statistics
        statistics = replace(statistics, covariance=own.covariance[np.ix_(shared, shared)], freedom=own.freedom[shared])
    solution = replace(projected.estimate.solution, values=values)
    return projected.with_changes(
        estimate=projected.estimate.with_changes(solution=solution, statistics=statistics, standard=None)
    )


def predicts_as_well(identification: Identification, values: FloatArray) -> bool:
    """Return whether other base parameters (b,) predict held-out data as well; False if there are no such data."""
    if identification.data.held_out is None:
        return False
    before = compute_moving_errors(identification.data.held_out, identification.values).relative_total
    return compute_moving_errors(identification.data.held_out, values).relative_total <= MOST_FREE_ERROR_RATIO * before


@dataclass(frozen=True)
class ProjectionError:
    """Errors of a model and of an exported file where joints move, on the same data.

    Parameters
    ----------
    joints : tuple of str
        Names of the n joints, in the robot's order.
    model : Errors
        Errors of the model.
    file : Errors
        Errors of what the file holds of it.
    is_held_out : bool
        Whether the data are held-out ones; otherwise they are those of the fit.
    """

    joints: tuple[str, ...]
    model: Errors
    file: Errors
    is_held_out: bool

    @classmethod
    def compare_with(
        cls, identification: Identification, projected: Identification, values: FloatArray
    ) -> ProjectionError:
        """Return the comparison of a model with base parameters (b,) of its projection."""
        own_data, projected_data = identification.data.held_out, projected.data.held_out
        is_held_out = own_data is not None and projected_data is not None
        # Errors can only be compared on the same data: where one model lacks held-out data, both are judged on those of
        # the fit.
        if own_data is None or projected_data is None:
            own_data, projected_data = identification.data.training, projected.data.training
        joints = identification.model.robot.joint_names
        return cls(
            joints,
            compute_moving_errors(own_data, identification.values),
            compute_moving_errors(projected_data, values),
            is_held_out,
        )

    @property
    def is_notable(self) -> bool:
        """Whether the file is so much worse than the model that a warning is needed."""
        return self.file.relative_total > NOTABLE_ERROR_RATIO * self.model.relative_total

    def describe(self) -> tuple[str, ...]:
        """Return sentences with the errors, in total and by joint."""
        data = "held-out data" if self.is_held_out else "the data of the fit (no held-out data were given)"
        total = f"{format_percent(self.file.relative_total)} ({format_percent(self.model.relative_total)})"
        subject = f"Relative error of torque where joints move, on {data}, of this file (and of the model)"
        each = ", ".join(
            f"{joint} {format_percent(file)} ({format_percent(model)})"
            for joint, file, model in zip(self.joints, self.file.relative, self.model.relative, strict=True)
        )
        errors = f"{subject}: {total}; {each}."
        if not self.is_notable:
            return (errors,)
        lost = (
            f"The error of this file is {self.file.relative_total / self.model.relative_total:.1f} times that of the "
            "model"
        )
        return (f"Warning: {lost}; C code, CasADi functions and JSON contain the whole model.", errors)


SMALL = 1e-9
"""Share of the torque up to which a difference counts as rounding."""
_STATES = 25


@dataclass(frozen=True)
class ExportedFile:
    """A file of an exported model.

    Parameters
    ----------
    name : str
        Name of the file, made from the robot's.
    media_type : str
        Media type as HTTP states it, such as "application/xml".
    content : bytes
        What stands in the file.
    notes : tuple of str
        What the format could not hold, a sentence each.
    held_out_error : float or None
        Relative error of the torque on held-out data, where joints move, of a program that reads all of the file; None
        where there are no such data, or the file is no model of the torque. For formats that hold every effect,
        `export_model` states it.
    """

    name: str
    media_type: str
    content: bytes
    notes: tuple[str, ...] = ()
    held_out_error: float | None = None

    def __repr__(self) -> str:
        head = f"ExportedFile({self.name}, {len(self.content) / 1e3:.1f} kB)"
        return "\n".join([head, *(f"  note: {note}" for note in self.notes)])


@dataclass(frozen=True, eq=False)
class FeasibleLinks:
    """Feasible links and joints of an identified model, for formats that consist of links and joints.

    Attributes
    ----------
    identification : Identification
        The identified model, with the data of its fit.
    projected : Identification
        The model with only those effects that the format can hold: its links and rotors are those of the identified
        model, and the rest was fitted to the data again.
    standard : Completion
        Standard parameters of the projected model.
    held : tuple of Role
        Roles of the parameters that the format has words for.
    """

    identification: Identification
    projected: Identification
    standard: Completion
    held: tuple[Role, ...]

    @classmethod
    def from_model(
        cls, identification: Identification, held: tuple[Role, ...], *, nearest: bool, rotors_in_links: bool = False
    ) -> FeasibleLinks:
        """Return the links and joints of a model.

        It raises an error as `complete_parameters` does, unless the nearest feasible bodies predict as well or
        `nearest` is set.
        """
        check_base(identification)
        projected = project_model(identification, held)
        whole, impossible = projected is identification, None
        complete = partial(
            complete_parameters,
            identification,
            rotors_in_links=rotors_in_links,
            file_model=None if whole else projected.model,
        )
        try:
            standard = complete()
        except DynidentError as error:
            impossible = error
            standard = complete(nearest=True)
        unchanged = identification
        if not whole:
            unchanged = fit_beside_links(identification, projected, get_link_parameters(identification, projected))
            links = compute_base_parameters(projected.model, standard)
            projected = fit_beside_links(identification, projected, links)
            standard = replace_friction(standard, projected.model, projected.values)
        # Bodies that predict held-out data as well are no loss: the user need not ask for them.
        if impossible is not None and not nearest and not predicts_as_well(unchanged, standard.values):
            raise impossible
        return cls(identification, projected, standard, held)

    @property
    def robot(self) -> Robot:
        """The robot, with the inertias of its description."""
        return self.identification.model.robot

    @cached_property
    def cost(self) -> ProjectionError:
        """Errors of the model, and of these links and joints."""
        return ProjectionError.compare_with(self.identification, self.projected, self.standard.values)

    @property
    def held_out_error(self) -> float | None:
        """Relative error of these links and joints on held-out data, where joints move; None without such data."""
        return self.cost.file.relative_total if self.cost.is_held_out else None

    @cached_property
    def notes(self) -> tuple[str, ...]:
        """What a user must know: parameters that were changed, effects that are left out, rounded geometry."""
        choices_in_file = select_held_effects(self.identification, self.held)
        left_out = [
            f"{get_effect(choice.effect).title} is not in this file, because the format cannot express it: "
            f"{describe_effect(choice)}."
            for choice in self.identification.choices.effects
            if choice not in choices_in_file
        ]
        if left_out:
            bodies = "as identified" if self.standard.exact else "the nearest to the identified ones that can exist"
            left_out.append(
                f"Links and rotors are {bodies}; what else the file holds was fitted to the data again without these "
                "effects."
            )
        notes = [*self.cost.describe(), *self.standard.notes, *left_out]
        if self.rounding_error > SMALL:
            notes.append(
                "Right angles are rounded in the description: the torque of the links therefore differs by "
                f"{self.rounding_error:.1g} of its size from that of the base parameters, which leave such small "
                "terms out."
            )
        return tuple(notes)

    def describe_loss(self, tags: str, *unread: Role) -> str:
        """Return a sentence on the error of a program that ignores parts of the file.

        Parameters
        ----------
        tags : str
            What they are called in the file.
        unread : Role
            Roles of the parameters that it ignores: "rotor", "dry", "damping".
        """
        model, standard = self.projected.model, self.standard
        by_role = {"rotor": standard.rotors, "dry": standard.coulomb, "damping": standard.viscous}
        names = model.robot.tree.joint_names
        values = standard.values.copy()
        for k, column in enumerate(model.columns):
            role = get_role(column)
            if role in unread and role in by_role and not column.runs:
                values -= model.base.grouping[:, k] * by_role[role][names.index(column.link)]
        errors = ProjectionError.compare_with(self.identification, self.projected, values)
        data = "on held-out data" if errors.is_held_out else "on the data of the fit"
        return (
            f"Programs that do not read {tags} compute the torque with a relative error of "
            f"{format_percent(errors.file.relative_total, decimals=2)} {data}, where joints move."
        )

    @cached_property
    def rounding_error(self) -> float:
        """Largest difference of the links' and rotors' torque from that of the base parameters, over its size."""
        model = self.projected.model
        observation, robot = model.observation, model.robot
        # Compare at random states by an independent path: Newton and Euler with the completed links on one side, the
        # observation matrix times the base parameters on the other.
        rng = np.random.default_rng(0)
        q, dq, ddq = (rng.uniform(-size, size, (_STATES, robot.n)) for size in (1.0, 1.0, 3.0))
        if robot.linkage is not None and robot.linkage.closure is not None:
            q = robot.linkage.closure.draw_postures(rng, _STATES)
        nothing = ReferenceParameters.massless(robot)
        memory = np.zeros((_STATES, observation.n_memory))
        entries = observation.evaluate(q, dq, ddq, reference=nothing, memory=memory)
        inertial = np.array([get_effect(column.effect).is_inertia for column in observation.columns])
        # Friction and springs are left out: only links and rotors are in question here.
        expected = observation.compute_torque(entries, np.where(inertial, self.standard.values, 0.0))
        torque = compute_rigid_torque(robot, self.standard.inertias, q, dq, ddq, self.standard.rotors)
        size = float(np.abs(expected).max(initial=0.0)) or 1.0
        return float(np.abs(torque - expected).max(initial=0.0)) / size


def compute_rigid_torque(
    robot: Robot, inertias: FloatArray, q: FloatArray, dq: FloatArray, ddq: FloatArray, rotors: FloatArray
) -> FloatArray:
    """Return the torque (m, n) that links with inertias (N, 10) and rotors (N,) need, by Newton and Euler."""
    if robot.linkage is None:
        return np.asarray(compute_described_torque(replace(robot, inertias=inertias), q, dq, ddq, rotors))
    tree = replace(robot.linkage.tree, inertias=inertias)
    return np.asarray(
        compute_described_torque(replace(robot, linkage=replace(robot.linkage, tree=tree)), q, dq, ddq, rotors)
    )
