"""Effects of motors and amplifiers: gain errors, saturation, torque delay, rotors carried by other links."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from types import MappingProxyType

import casadi as ca

from dynident.effects.effect import Column, Effect, ParameterSpec
from dynident.effects.effect_signals import Signals
from dynident.effects.rigid_body_rows import build_frames, to_constant
from dynident.effects.usual_effect_sizes import ROTOR_SHARE, UsualSize, get_largest_torque
from dynident.robot.robot_model import Robot

# Gear ratio of a usual direct gear.
_GEAR_RATIO = 20.0


class DriveGainError(Effect):
    """A drive gain [12.17] that is off: the torque of one joint is wrong by the same share at all times."""

    id = "drive_gain_error"
    title = "Error of the drive gain"
    sits_on = "motor"
    formula = r"\varepsilon\,\hat\Gamma"
    # Twice the usual size: on a joint with little load a gain scales friction alone, which changes by any share itself.
    parameters = (
        ParameterSpec("eps", "-", "relative error of the drive gain", least=5e-3, most=0.5, most_change=0.12),
    )
    signature = "a scaled copy of the joint's own torque: the other joints give other parameters of the same links"
    confused_with = ("drive_gain_saturation",)
    sources = ("Gautier and Briot 2011", "Khalil and Dombre 2002, chapter 12, [12.17]")
    experiment = "with_payload"
    told_from = MappingProxyType({"with_payload": ("drive_gain_saturation", "rigid_body", "joint_elasticity")})
    first_order = True
    needs_load = True
    may_change = True

    def usual(self, robot: Robot, joint: int) -> UsualSize:
        """Return the usual size: some per cent."""
        return UsualSize({"eps": 0.06})

    def columns(self, signals: Signals, joints: Sequence[int], shape: Mapping[str, float]) -> list[Column]:
        """Return the predicted motor torque of every joint."""
        # A gain that is off by ε scales the whole torque: it adds ε times what the model predicts.
        return [self._column(signals, self.parameters[0], j, signals.predicted.motor[j]) for j in joints]


class DriveGainSaturation(Effect):
    """A motor whose torque per ampere falls at large currents."""

    id = "drive_gain_saturation"
    title = "Saturation of the motor"
    sits_on = "motor"
    formula = r"s\,\hat\Gamma\,|\hat\Gamma|"
    parameters = (ParameterSpec("sat", "1/(N m)", "relative change of the gain per unit of torque", "1/N"),)
    signature = "curvature of measured over predicted torque"
    confused_with = ("load_dependent_friction", "drive_gain_error")
    sources = ("Corke 2007",)
    experiment = "with_payload"
    first_order = True
    needs_load = True

    def usual(self, robot: Robot, joint: int) -> UsualSize:
        """Return the usual size: a tenth at the largest torque."""
        return UsualSize({"sat": 0.12 / get_largest_torque(robot, joint)})

    def columns(self, signals: Signals, joints: Sequence[int], shape: Mapping[str, float]) -> list[Column]:
        """Return torque times its size, of every joint."""
        # The predicted torque, not the measured one: its noise would enter W, and be squared here.
        motor = signals.predicted.motor
        return [self._column(signals, self.parameters[0], j, motor[j] * ca.fabs(motor[j])) for j in joints]


class TorqueDelay(Effect):
    """Torque that is recorded later than the positions of its row."""

    id = "torque_delay"
    title = "Delay of the measured torque"
    formula = r"-\delta\,\dot{\hat\Gamma} + \frac{\delta^2}{2}\,\ddot{\hat\Gamma}"
    parameters = (
        ParameterSpec("delay", "s", "delay of the torque", positive=True, least=0.5e-3, most=0.1, role="delay"),
        ParameterSpec(
            "delay_sq", "s²", "square of the delay, from the curvature of the torque", positive=True, most=0.01
        ),
    )
    signature = "in quadrature with the torque, on all joints"
    confused_with = ("joint_elasticity",)
    sources = ("Swevers, Verdonck and De Schutter 2007",)
    experiment = "paces"
    told_from = MappingProxyType({"paces": ("joint_elasticity", "viscous", "viscous_nonlinear", "stribeck")})
    often_missed = 6
    scope = "robot"
    first_order = True
    needs_load = True
    may_change = True

    def usual(self, robot: Robot, joint: int) -> UsualSize:
        """Return the usual size: some milliseconds."""
        return UsualSize({"delay": 8e-3})

    def columns(self, signals: Signals, joints: Sequence[int], shape: Mapping[str, float]) -> list[Column]:
        """Return minus the rate and half the second derivative of the predicted torque, with Coulomb friction."""
        # Taylor: Γ(t - δ) = Γ - δ Γ̇ + ½ δ² Γ̈. The square is a parameter of its own, so that the torque stays linear.
        predicted = signals.predicted
        # Coulomb friction jumps, so its derivatives are differences over the sampling period.
        rate = predicted.smooth_rate + predicted.get_drive_parameter("Fc") * signals.sign_rate
        curvature = predicted.smooth_curvature + predicted.get_drive_parameter("Fc") * signals.sign_curvature
        return [
            self._robot_column(spec, torque)
            for spec, torque in zip(self.parameters, (-rate, 0.5 * curvature), strict=True)
        ]


class RotorCoupling(Effect):
    """The torque of a fast rotor that the links before its joint turn, as in a gyroscope.

    Its kinetic energy has, beside ½ N² Jm q̇j² (the rotor inertia Ia), the part N Jm q̇j (zj · ω) with ω the angular
    velocity of the link that carries it.
    """

    id = "rotor_coupling"
    title = "Gyroscopic torque of a carried rotor"
    sits_on = "link"
    formula = r"N J_m\,\left(\ddot q_j z_j + \dot q_j\,\omega \times z_j\right),\quad N J_m\,z_j \cdot \dot\omega"
    parameters = (ParameterSpec("NJ", "kg m²", "gear ratio times inertia of the rotor about its own axis"),)
    signature = "products of the joint's velocity with those of joints before it; they vanish in no posture"
    confused_with = ("rigid_body",)
    sources = ("Khalil and Dombre 2002, chapter 9",)
    told_from = MappingProxyType({"paces": ("rigid_body",)})

    def usual(self, robot: Robot, joint: int) -> UsualSize:
        """Return the usual size: that of a usual rotor behind a direct gear."""
        return UsualSize({"NJ": ROTOR_SHARE * get_largest_torque(robot, joint) / _GEAR_RATIO})

    def columns(self, signals: Signals, joints: Sequence[int], shape: Mapping[str, float]) -> list[Column]:
        """Return one column a joint, by Lagrange's equation of the energy that couples rotor and carrier."""
        columns = []
        for j in joints:
            energy = _build_carried_spin(signals, j)
            # Lagrange: d/dt ∂E/∂q̇ - ∂E/∂q, with the time derivative by the chain rule over q and q̇.
            momentum = ca.gradient(energy, signals.dq)
            rate = ca.jtimes(momentum, ca.vertcat(signals.q, signals.dq), ca.vertcat(signals.dq, signals.ddq))
            torque = rate - ca.gradient(energy, signals.q)
            columns.append(self._reaching_column(signals, self.parameters[0], j, torque, energy=partial(ca.SX, energy)))
        return columns

    def applicable(self, robot: Robot) -> tuple[int, ...]:
        """Return revolute joints whose motor a revolute joint carries."""
        return tuple(
            j for j, joint in enumerate(robot.joints) if joint.kind == "revolute" and _list_revolute_ancestors(robot, j)
        )


def _build_carried_spin(signals: Signals, joint: int) -> ca.SX:
    """Return q̇j (zj · ω) for the angular velocity ω of the link that carries joint j's motor."""
    robot = signals.robot
    frames = build_frames(robot, signals.q)
    # The axis, turned back frame by frame: in frame i its product with axis i is what joint i adds to zj · ω.
    axis = ca.mtimes(frames[joint].rotation, to_constant(robot.joints[joint].axis))
    spin = ca.SX(1, 1)
    link = robot.joints[joint].parent
    while link >= 0:
        # Prismatic joints turn no link, and add nothing to ω.
        if robot.joints[link].kind == "revolute":
            spin += ca.dot(axis, to_constant(robot.joints[link].axis)) * signals.dq[link]
        axis = ca.mtimes(frames[link].rotation, axis)
        link = robot.joints[link].parent
    return signals.dq[joint] * spin


def _list_revolute_ancestors(robot: Robot, joint: int) -> list[int]:
    ancestors = []
    link = robot.joints[joint].parent
    while link >= 0:
        if robot.joints[link].kind == "revolute":
            ancestors.append(link)
        link = robot.joints[link].parent
    return ancestors
