"""Files for other programs, and the feasible links and joints that URDF and MJCF are written from."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from dynident.arrays import FloatArray
from dynident.effects import ReferenceParameters, Role, get_effect
from dynident.errors import DynidentError
from dynident.export.completion import Completion, complete_parameters
from dynident.export.projection import ProjectionError, predicts_as_well, project_model, select_held_effects
from dynident.export.summary import describe_effect
from dynident.identification import Identification
from dynident.robot.model import Robot
from dynident.robot.pinocchio_model import compute_described_torque

SMALL = 1e-9
"""Share of the torque up to which a difference counts as rounding."""
_STATES = 25


@dataclass(frozen=True)
class ExportedFile:
    """A file of an exported model.

    Attributes
    ----------
    name, media_type : str
    content : bytes
    notes : tuple of str
        What the format could not hold.
    """

    name: str
    media_type: str
    content: bytes
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class FeasibleLinks:
    """Feasible links and joints of an identified model, for formats that consist of links and joints.

    Attributes
    ----------
    identification : Identification
    projected : Identification
        The model with only those effects that the format can hold, fitted to the data again.
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

        It raises an error as `complete` does, unless the nearest feasible bodies predict as well or `nearest` is set.
        """
        projected = project_model(identification, held)
        try:
            standard = complete_parameters(projected, rotors_in_links=rotors_in_links)
        except DynidentError:
            standard = complete_parameters(projected, nearest=True, rotors_in_links=rotors_in_links)
            if not nearest and not predicts_as_well(projected, standard.values):
                raise
        return cls(identification, projected, standard, held)

    @property
    def robot(self) -> Robot:
        """The robot, with the inertias of its description."""
        return self.identification.model.robot

    @cached_property
    def notes(self) -> tuple[str, ...]:
        """What a user must know: parameters that were changed, effects that are left out, rounded geometry."""
        choices_in_file = select_held_effects(self.identification, self.held)
        left_out = [
            f"{get_effect(choice.effect).title} is not in this file, which has no word for it: {describe_effect(choice)}."
            for choice in self.identification.choices.effects
            if choice not in choices_in_file
        ]
        if left_out:
            left_out.append("What the file can hold was fitted to the data again without them.")
        cost = ProjectionError.compare_with(self.identification, self.projected, self.standard.values)
        notes = [*cost.describe(), *self.standard.notes, *left_out]
        if self.rounding_error > SMALL:
            notes.append(
                "Right angles that are rounded in the description let the torque of the links differ by "
                f"{self.rounding_error:.1g} of its size from that of the base parameters, which leave such small terms out."
            )
        return tuple(notes)

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
