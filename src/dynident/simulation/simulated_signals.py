"""Signals that effects read inside a simulation step and at the sensors."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import casadi as ca

from dynident.effects import Signals
from dynident.effects.predicted_torque_expressions import Prediction
from dynident.robot.robot_model import Robot


class _StepPrediction(Prediction):
    """Predictions inside a step, where the load torque is an input: the mass matrix gives it at no further cost.

    Quantities that are not known within a step, or that only a sensor sees, are symbols without a value.
    """

    @cached_property
    def load(self) -> ca.SX:
        """SX (n, 1): symbol of the load torque."""
        return ca.SX.sym("load", self.robot.n)

    @cached_property
    def unknown_symbol(self) -> ca.SX:
        """SX (1, 1): a symbol that no expression with a value in a step contains."""
        return ca.SX.sym("unknown")

    @cached_property
    def load_rate(self) -> ca.SX:
        """SX (n, 1): no value."""
        return ca.repmat(self.unknown_symbol, self.robot.n, 1)

    @cached_property
    def load_acceleration(self) -> ca.SX:
        """SX (n, 1): no value."""
        return ca.repmat(self.unknown_symbol, self.robot.n, 1)

    @cached_property
    def load_over_position(self) -> ca.SX:
        """SX (n, n): no value."""
        return ca.repmat(self.unknown_symbol, self.robot.n, self.robot.n)

    @cached_property
    def load_over_origins(self) -> ca.SX:
        """SX (n, 3 n): no value."""
        return ca.repmat(self.unknown_symbol, self.robot.n, 3 * self.robot.n)

    @cached_property
    def mass(self) -> ca.SX:
        """SX (n, n): no value."""
        return ca.repmat(self.unknown_symbol, self.robot.n, self.robot.n)

    @cached_property
    def smooth(self) -> ca.SX:
        """SX (n, 1): no value."""
        return ca.repmat(self.unknown_symbol, self.robot.n, 1)

    @cached_property
    def motor(self) -> ca.SX:
        """SX (n, 1): no value."""
        return ca.repmat(self.unknown_symbol, self.robot.n, 1)


@dataclass(frozen=True, eq=False)
class Sliding:
    """A relative velocity with dry friction, and the symbol of its direction.

    Parameters
    ----------
    velocity : casadi.SX
        The relative velocity, rad/s or m/s.
    direction : casadi.SX
        Symbol of the direction of friction: ±1 where it slides, anything between at rest.
    """

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
        """Return the direction of friction at a relative velocity, entry by entry.

        Where the velocity is that of a joint, it is the joint's own direction.
        """
        return ca.vertcat(*(self._find_direction(velocity[k]) for k in range(velocity.numel())))

    def _find_direction(self, velocity: ca.SX) -> ca.SX:
        for j in range(self.robot.n):
            # The same symbol for the same velocity: a joint slides or rests for all of its friction at once.
            if ca.is_equal(velocity, self.dq[j]):
                return self.sign[j]
        self._others.append(Sliding(velocity, ca.SX.sym(f"direction_{self.robot.n + len(self._others)}")))
        return self._others[-1].direction

    def list_sliding(self, torque: ca.SX) -> tuple[Sliding, ...]:
        """Return the sliding velocities of all joints, then the others that a torque depends on."""
        joints = [Sliding(self.dq[j], self.sign[j]) for j in range(self.robot.n)]
        return (*joints, *(sliding for sliding in self._others if ca.depends_on(torque, sliding.direction)))

    @cached_property
    def predicted(self) -> _StepPrediction:
        """Predictions of the model's torque inside a step."""
        return _StepPrediction(self.robot, self.q, self.dq, self.ddq, self.dddq, self.ddddq, self.sign, self.reference)

    def is_part_of_motion(self, torque: ca.SX) -> bool:
        """Return whether a column's torque takes part in the motion; if not, it belongs to the measurement."""
        # Third and fourth derivatives and symbols without a value do not exist within a step.
        return not ca.depends_on(torque, ca.vertcat(self.dddq, self.ddddq, self.predicted.unknown_symbol))


class _SensorPrediction(Prediction):
    """Predictions at a sensor, where the torque of the motors is measured instead of predicted."""

    @cached_property
    def motor(self) -> ca.SX:
        """SX (n, 1): symbol of the torque that the motors give."""
        return ca.SX.sym("motor", self.robot.n)


class SensorSignals(Signals):
    """Signals where a sensor sees torque and position."""

    @cached_property
    def predicted(self) -> _SensorPrediction:
        """Predictions of the model's torque, with the motors' own as an input."""
        return _SensorPrediction(
            self.robot, self.q, self.dq, self.ddq, self.dddq, self.ddddq, self.sign, self.reference
        )
