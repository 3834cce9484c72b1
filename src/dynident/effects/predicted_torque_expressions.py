"""Expressions of the torque that the model so far predicts, for effects that depend on load or motor torque.

Effects that depend on torque use the predicted one, never the measured one, whose noise would get into W.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import casadi as ca
import numpy as np

from dynident.array_types import FloatArray
from dynident.effects.dependent_joint_dynamics import build_link_torque
from dynident.effects.rigid_body_rows import to_constant
from dynident.errors import DynidentError
from dynident.robot.robot_model import Robot

ROTOR_INERTIA, COULOMB, VISCOUS, OFFSET = ("rotor_inertia", "Ia"), ("coulomb", "Fc"), ("viscous", "Fv"), ("offset", "b")
DRIVE_PARAMETERS = (ROTOR_INERTIA, COULOMB, VISCOUS, OFFSET)
"""Effects and parameters that a motor's torque consists of beside the load, in the order of `reference`."""


def count_reference_parameters(robot: Robot) -> int:
    """Return the number of reference parameters of a robot.

    Parameters
    ----------
    robot : Robot
        A robot of n driven joints and N links.

    Returns
    -------
    int
        10 N + 4 n: ten a link, then Ia, Fc, Fv and b of the drives.
    """
    return 10 * robot.tree.n + len(DRIVE_PARAMETERS) * robot.n


class CarriedInertia(NamedTuple):
    """Inertial parameters (N, 10) that links carry in some runs: those with these labels, `runs`."""

    runs: tuple[str, ...]
    inertias: FloatArray


@dataclass(frozen=True, eq=False)
class ReferenceParameters:
    """Parameters of the model so far, by which torque is predicted.

    As a vector (10 N + 4 n,) they follow one another, the links first.

    Parameters
    ----------
    inertias : (N, 10)
        Standard inertial parameters of the links, in the order of `INERTIAL_NAMES`: kg m², kg m, kg.
    rotors, dry, damping, constant : (n,)
        Ia, Fc, Fv and b of the driven joints' motors: kg m², N m, N m s/rad and N m, or kg, N, N s/m and N.
    carried : tuple of CarriedInertia
        What links carry in some runs alone: it is no part of the vector.
    """

    inertias: FloatArray
    rotors: FloatArray
    dry: FloatArray
    damping: FloatArray
    constant: FloatArray
    carried: tuple[CarriedInertia, ...] = ()

    @classmethod
    def from_links(cls, inertias: FloatArray, n: int) -> ReferenceParameters:
        """Return parameters of links alone: motors have neither rotors nor friction.

        Parameters
        ----------
        inertias : (N, 10)
            Standard inertial parameters of the links.
        n : int
            Number of motors.

        Returns
        -------
        ReferenceParameters
            With zeros for the motors.
        """
        nothing = np.zeros(n)
        return cls(inertias, nothing, nothing, nothing, nothing)

    @classmethod
    def massless(cls, robot: Robot) -> ReferenceParameters:
        """Return parameters that predict no torque: links without mass."""
        return cls.from_links(np.zeros((robot.tree.n, 10)), robot.n)

    @classmethod
    def from_vector(cls, vector: FloatArray, robot: Robot) -> ReferenceParameters:
        """Return the parameters in a vector (10 N + 4 n,), or in one (10 N,) of links alone.

        Parameters
        ----------
        vector : (10 N + 4 n,) or (10 N,)
            Links first, in the order of `to_vector`.
        robot : Robot
            A robot of N links and n driven joints.

        Returns
        -------
        ReferenceParameters
            With zeros for motors where the vector has links alone.

        Raises
        ------
        DynidentError
            For any other length.
        """
        links = 10 * robot.tree.n
        if vector.shape == (links,):
            return cls.from_links(vector.reshape(-1, 10), robot.n)
        if vector.shape != (count_reference_parameters(robot),):
            raise DynidentError(
                f"{vector.shape} reference parameters for {robot.tree.n} links: expected {links} for the links alone, "
                f"or {count_reference_parameters(robot)} with Ia, Fc, Fv and b of all joints",
                title="Unusable reference parameters",
            )
        return cls(vector[:links].reshape(-1, 10), *vector[links:].reshape(len(DRIVE_PARAMETERS), robot.n))

    @property
    def vector(self) -> FloatArray:
        """All parameters as a vector (10 N + 4 n,)."""
        drives = (self.rotors, self.dry, self.damping, self.constant)
        return np.concatenate([self.inertias.reshape(-1), *drives])

    def to_vector(self, robot: Robot) -> FloatArray:
        """Return the vector (10 N + 4 n,), after a check that it fits a robot.

        Raises
        ------
        DynidentError
            If the robot has another number of links or driven joints.
        """
        if self.inertias.shape != (robot.tree.n, 10) or self.rotors.shape != (robot.n,):
            raise DynidentError(
                f"The reference parameters are for {len(self.inertias)} links and {len(self.rotors)} driven joints, "
                f"but {robot.name} has {robot.tree.n} and {robot.n}",
                title="Unusable reference parameters",
            )
        return self.vector

    def add_carried(self, is_run: Callable[[tuple[str, ...]], bool]) -> ReferenceParameters:
        """Return the parameters in one run, with what the links carry there.

        Parameters
        ----------
        is_run : callable
            Returns whether labels of runs name this run.
        """
        own = [carried.inertias for carried in self.carried if is_run(carried.runs)]
        return replace(self, inertias=sum(own, self.inertias), carried=()) if self.carried else self

    def equals(self, other: ReferenceParameters) -> bool:
        """Return whether all values are the same."""
        mine, theirs = ({carried.runs: carried.inertias for carried in own.carried} for own in (self, other))
        return (
            np.array_equal(self.vector, other.vector)
            and mine.keys() == theirs.keys()
            and all(np.array_equal(inertias, theirs[runs]) for runs, inertias in mine.items())
        )


@dataclass(frozen=True, eq=False)
class Prediction:
    """Torque of the model so far.

    Parameters
    ----------
    robot : Robot
        The robot.
    q, dq, ddq, dddq, ddddq : SX (n, 1)
        Position and its four derivatives.
    sign : SX (n, 1)
        The sign of q̇.
    reference : SX (10 N + 4 n, 1)
        Standard inertial parameters, then Ia, Fc, Fv and b of all joints.
    """

    robot: Robot
    q: ca.SX
    dq: ca.SX
    ddq: ca.SX
    dddq: ca.SX
    ddddq: ca.SX
    sign: ca.SX
    reference: ca.SX

    @property
    def inertia(self) -> ca.SX:
        """SX (10 N, 1): the standard inertial parameters."""
        return self.reference[: 10 * self.robot.tree.n]

    def get_drive_parameter(self, parameter: str) -> ca.SX:
        """Return Ia, Fc, Fv or b of every joint, SX (n, 1)."""
        # The links' parameters, then one kind of drive parameter after the other, each for all joints.
        n = self.robot.n
        first = 10 * self.robot.tree.n + n * [name for _, name in DRIVE_PARAMETERS].index(parameter)
        return self.reference[first : first + n]

    @cached_property
    def load(self) -> ca.SX:
        """SX (n, 1): torque of the links, which the gears carry (N m, N)."""
        return self._build_torque(to_constant(self.robot.gravity))

    @cached_property
    def load_rate(self) -> ca.SX:
        """SX (n, 1): its time derivative."""
        return self._differentiate(self.load, 3)

    @cached_property
    def load_acceleration(self) -> ca.SX:
        """SX (n, 1): its second time derivative."""
        return self._differentiate(self.load_rate, 4)

    @cached_property
    def load_over_position(self) -> ca.SX:
        """SX (n, n): ∂τl/∂q."""
        return ca.jacobian(self.load, self.q)

    @cached_property
    def mass(self) -> ca.SX:
        """SX (n, n): the inertia matrix A of the links."""
        # Torque is linear in accelerations, so that its slope by them is the inertia matrix in every state.
        return ca.jacobian(self.load, self.ddq)

    @cached_property
    def load_over_origins(self) -> ca.SX:
        """SX (n, 3 N): ∂τl over a shift of the joint frames' origins, each in its antecedent's frame (N m/m)."""
        count = self.robot.tree.n
        shift = ca.SX.sym("shift", 3, count)
        shifted = build_link_torque(
            self.robot, self.q, self.dq, self.ddq, to_constant(self.robot.gravity), self.inertia, shift
        )
        # Differentiated by symbols for the shift, then evaluated where the description says: at a shift of zero.
        slope = ca.jacobian(shifted, ca.vec(shift))
        return ca.substitute(slope, shift, ca.SX.zeros(3, count))

    @cached_property
    def gravity_torques(self) -> ca.SX:
        """SX (n, 3): torque that the links need at rest against one m/s² of gravity along each axis of the base."""
        # The torque is linear in gravity: three unit vectors are enough for any direction and any tilt.
        still = ca.SX(self.robot.n, 1)
        along = [
            build_link_torque(self.robot, self.q, still, still, to_constant(axis), self.inertia) for axis in np.eye(3)
        ]
        return ca.horzcat(*along)

    def build_gravity_torque(self, gravity: FloatArray) -> ca.SX:
        """Return the torque SX (n, 1) that the links need at rest against an acceleration of gravity (3,)."""
        return ca.mtimes(self.gravity_torques, to_constant(gravity))

    @cached_property
    def smooth(self) -> ca.SX:
        """SX (n, 1): motor torque without what jumps at reversals."""
        return (
            self.load
            + self.get_drive_parameter("Ia") * self.ddq
            + self.get_drive_parameter("Fv") * self.dq
            + self.get_drive_parameter("b")
        )

    @cached_property
    def smooth_rate(self) -> ca.SX:
        """SX (n, 1): time derivative of the smooth motor torque."""
        return self.load_rate + self.get_drive_parameter("Ia") * self.dddq + self.get_drive_parameter("Fv") * self.ddq

    @cached_property
    def smooth_curvature(self) -> ca.SX:
        """SX (n, 1): second time derivative of the smooth motor torque."""
        return (
            self.load_acceleration
            + self.get_drive_parameter("Ia") * self.ddddq
            + self.get_drive_parameter("Fv") * self.dddq
        )

    @cached_property
    def motor(self) -> ca.SX:
        """SX (n, 1): motor torque with friction."""
        # What jumps is added last, so that the smooth part has derivatives.
        return self.smooth + self.get_drive_parameter("Fc") * self.sign

    def _build_torque(self, gravity: ca.SX) -> ca.SX:
        return build_link_torque(self.robot, self.q, self.dq, self.ddq, gravity, self.inertia)

    def _differentiate(self, expression: ca.SX, order: int) -> ca.SX:
        """Return the time derivative of an expression of q and its first `order` - 1 derivatives."""
        # The chain rule as one directional derivative: the state (q, q̇, …) moves along (q̇, q̈, …).
        state: Sequence[ca.SX] = (self.q, self.dq, self.ddq, self.dddq, self.ddddq)
        return ca.jtimes(expression, ca.vertcat(*state[:order]), ca.vertcat(*state[1 : order + 1]))
