"""Errors of the geometry in a description: zero positions of joints, and places of joints."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from dynident.effects.effect import Column, Effect, ParameterSpec
from dynident.effects.signals import Signals
from dynident.effects.usual_sizes import UsualSize
from dynident.robot.model import Robot


class EncoderZeroError(Effect):
    """A joint whose zero position is not that of the description."""

    id = "encoder_zero_error"
    title = "Error of a joint's zero position"
    sits_on = "motor"
    formula = r"\frac{\partial\hat\tau_l}{\partial q_j}\,\Delta_j"
    parameters = (ParameterSpec("dq0", "rad", "true position less the measured one", "m", least=1e-3, most=0.2),)
    signature = "posture-dependent torque on the joint and those before and after it at once"
    confused_with = ("base_tilt", "joint_elasticity")
    sources = ("Khalil and Dombre 2002, chapter 11",)
    first_order = True
    needs_load = True
    may_change = True

    def usual(self, robot: Robot, joint: int) -> UsualSize:
        """Return the usual size: two degrees, or three millimetres."""
        return UsualSize({"dq0": 0.03 if robot.joints[joint].kind == "revolute" else 3e-3})

    def columns(self, signals: Signals, joints: Sequence[int], shape: Mapping[str, float]) -> list[Column]:
        """Return the sensitivity of all joints' torque to the position of each."""
        # First order of Taylor's series about the description: the error times the slope of the predicted torque.
        slope = signals.predicted.load_over_position
        return [self._reaching_column(signals, self.parameters[0], j, slope[:, j]) for j in joints]


class KinematicError(Effect):
    """A joint that sits some millimetres beside where the description puts it."""

    id = "kinematic_error"
    title = "Error of a link's length"
    sits_on = "link"
    formula = r"\frac{\partial\hat\tau_l}{\partial(d_x, d_y, d_z)_j}\,\delta_j"
    parameters = tuple(
        ParameterSpec(
            f"d{axis}",
            "m",
            f"true place of the joint along {axis} of its antecedent's frame, less given",
            least=5e-4,
            most=0.2,
        )
        for axis in "xyz"
    )
    signature = "like inertia; nearly all of it dissolves in the base parameters"
    confused_with = ("rigid_body",)
    sources = ("Khalil and Dombre 2002, chapter 11",)
    first_order = True
    needs_load = True

    def usual(self, robot: Robot, joint: int) -> UsualSize:
        """Return the usual size: some millimetres."""
        return UsualSize({"dx": 8e-3, "dy": -5e-3, "dz": 4e-3})

    def columns(self, signals: Signals, joints: Sequence[int], shape: Mapping[str, float]) -> list[Column]:
        """Return three columns a joint."""
        # As above, with three slopes a joint: one for each axis of the antecedent's frame.
        slope = signals.predicted.load_over_origins
        return [
            self._reaching_column(signals, spec, j, slope[:, 3 * j + k])
            for j in joints
            for k, spec in enumerate(self.parameters)
        ]
