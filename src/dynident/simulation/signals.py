"""The signals of effects as a simulator has them: inside a step, and where a sensor sees the torque."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import casadi as ca

from dynident.effects import Signals
from dynident.effects.prediction import Prediction
from dynident.robot.model import Robot


class _InsideStep(Prediction):
    """The load torque is an input: within a step it is known from the mass matrix at no further cost.

    What is not known within a step, or known to nobody but a sensor, is stood in for by symbols without a value.
    """

    @cached_property
    def load(self) -> ca.SX:
        """SX (n, 1): symbol of the load torque."""
        return ca.SX.sym("load", self.robot.n)

    @cached_property
    def unknown(self) -> ca.SX:
        """SX (1, 1): what no expression that has a value in a step depends on."""
        return ca.SX.sym("unknown")

    @cached_property
    def load_rate(self) -> ca.SX:
        """SX (n, 1): no value."""
        return ca.repmat(self.unknown, self.robot.n, 1)

    @cached_property
    def load_acceleration(self) -> ca.SX:
        """SX (n, 1): no value."""
        return ca.repmat(self.unknown, self.robot.n, 1)

    @cached_property
    def load_over_position(self) -> ca.SX:
        """SX (n, n): no value."""
        return ca.repmat(self.unknown, self.robot.n, self.robot.n)

    @cached_property
    def load_over_origins(self) -> ca.SX:
        """SX (n, 3 n): no value."""
        return ca.repmat(self.unknown, self.robot.n, 3 * self.robot.n)

    @cached_property
    def mass(self) -> ca.SX:
        """SX (n, n): no value."""
        return ca.repmat(self.unknown, self.robot.n, self.robot.n)

    @cached_property
    def smooth(self) -> ca.SX:
        """SX (n, 1): no value."""
        return ca.repmat(self.unknown, self.robot.n, 1)

    @cached_property
    def motor(self) -> ca.SX:
        """SX (n, 1): no value."""
        return ca.repmat(self.unknown, self.robot.n, 1)


@dataclass(frozen=True, eq=False)
class Sliding:
    """A relative velocity with dry friction, and the symbol of its direction: ±1 sliding, anything between at rest."""

    velocity: ca.SX
    direction: ca.SX


class SimulatedSignals(Signals):
    """Signals inside a step of the motion.

    The sign of a velocity is a symbol of its own: where the velocity is zero, friction takes whatever value between the
    two directions holds the joint, and the step has to find it.
    """

    def __init__(self, robot: Robot) -> None:
        super().__init__(robot)
        self._others: list[Sliding] = []

    @cached_property
    def sign(self) -> ca.SX:
        """SX (n, 1): the directions in which the joints' friction acts."""
        return ca.SX.sym("direction", self.robot.n)

    def sign_of(self, velocity: ca.SX) -> ca.SX:
        """The direction of friction at a relative velocity, entry by entry; the joint's own where it is a joint's."""
        return ca.vertcat(*(self._direction_of(velocity[k]) for k in range(velocity.numel())))

    def _direction_of(self, velocity: ca.SX) -> ca.SX:
        for j in range(self.robot.n):
            if ca.is_equal(velocity, self.dq[j]):
                return self.sign[j]
        self._others.append(Sliding(velocity, ca.SX.sym(f"direction_{self.robot.n + len(self._others)}")))
        return self._others[-1].direction

    def sliding_in(self, torque: ca.SX) -> tuple[Sliding, ...]:
        """Those of all joints, then the others that a torque depends on."""
        joints = [Sliding(self.dq[j], self.sign[j]) for j in range(self.robot.n)]
        return (*joints, *(one for one in self._others if ca.depends_on(torque, one.direction)))

    @cached_property
    def predicted(self) -> _InsideStep:
        """What is known of the model's torque inside a step."""
        return _InsideStep(self.robot, self.q, self.dq, self.ddq, self.dddq, self.ddddq, self.sign, self.reference)

    def moves(self, torque: ca.SX) -> bool:
        """Whether a column's torque takes part in the motion; else it is a matter of what is measured."""
        return not ca.depends_on(torque, ca.vertcat(self.dddq, self.ddddq, self.predicted.unknown))


class _AtSensor(Prediction):
    """The torque of the motors is not predicted: it is there to be measured."""

    @cached_property
    def motor(self) -> ca.SX:
        """SX (n, 1): symbol of the torque that the motors give."""
        return ca.SX.sym("motor", self.robot.n)


class SensorSignals(Signals):
    """Signals where a sensor sees torque and position."""

    @cached_property
    def predicted(self) -> _AtSensor:
        """The model's torque, and the motors' own."""
        return _AtSensor(self.robot, self.q, self.dq, self.ddq, self.dddq, self.ddddq, self.sign, self.reference)
