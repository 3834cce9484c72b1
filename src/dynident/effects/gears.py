"""Gear effects: backlash and joint elasticity, linearised about the predicted torque; holds the usual stiffness."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType

import casadi as ca

from dynident.effects.effect import RATIO, Column, Effect, Estimate, ParameterSpec, ShapeSpec
from dynident.effects.effect_signals import Signals
from dynident.effects.usual_effect_sizes import UsualSize, get_largest_torque
from dynident.robot.robot_model import Robot

# Torsional stiffness of a joint per unit of the largest torque, N m/rad per N m.
_STIFFNESS = 70.0


class Backlash(Effect):
    """Play: the link is off by half of it, to the side to which the load torque pushes it."""

    id = "backlash"
    title = "Backlash"
    formula = (
        r"-\left(\frac{\partial\hat\tau_l}{\partial q_j}\,\beta + (A_j + I_a)\,\ddot\beta\right),"
        r"\quad \beta = \frac{b}{2}\tanh\frac{\hat\tau_l}{w}"
    )
    parameters = (
        ParameterSpec("bl", "rad", "play b, from the posture; negative if q is measured at the link", "m", most=0.03),
        ParameterSpec("bi", "rad", "play b, from the acceleration of the links", "m", most=0.03),
        ParameterSpec("br", "N m s²", "play b times the rotor inertia", "N s²"),
    )
    shapes = (ShapeSpec("w", "N m", "load torque within which the teeth change sides", 1.0, refined=RATIO),)
    signature = "a step of the posture, and a pulse, where the load torque changes its sign"
    confused_with = ("joint_elasticity",)
    sources = ("Nordin and Gutman 2002",)
    experiment = "slow_sweep"
    told_from = MappingProxyType({"slow_sweep": ("joint_elasticity",)})
    first_order = True
    needs_load = True

    def usual(self, robot: Robot, joint: int) -> UsualSize:
        """Return the usual size: a tenth of a degree, or a fifth of a millimetre."""
        play = 2e-3 if robot.joints[joint].kind == "revolute" else 0.2e-3
        return UsualSize({"bl": play, "bi": play}, {"w": 0.04 * get_largest_torque(robot, joint)})

    def columns(self, signals: Signals, joints: Sequence[int], shape: Mapping[str, float]) -> list[Column]:
        """Return three columns a joint: by posture and by acceleration of the links, and by the rotor's inertia."""
        constants = self.shape_with_defaults(shape)
        predicted, width = signals.predicted, constants["w"]
        columns = []
        for j in joints:
            # β = b/2 tanh(τ/w) lags behind the load. Its second time derivative needs those of tanh: with
            # s = tanh(τ/w), s' = (1 - s²)/w and s'' = -2 s s'/w.
            side = ca.tanh(predicted.load[j] / width)
            slope = (1 - side * side) / width
            jerk = slope * predicted.load_acceleration[j] - 2 * side * slope / width * predicted.load_rate[j] ** 2
            rotor = ca.SX(signals.robot.n, 1)
            rotor[j] = -0.5 * jerk
            # The link lags by β: it sags as in another posture, and is accelerated by β̈ through column j of the
            # inertia matrix, on all joints. The rotor's column counts only where the position is measured at the link.
            torques = (-0.5 * predicted.load_over_position[:, j] * side, -0.5 * predicted.mass[:, j] * jerk, rotor)
            for spec, torque in zip(self.parameters, torques, strict=True):
                columns.append(self._reaching_column(signals, spec, j, torque, constants))
        return columns

    def is_plausible(self, estimates: Mapping[str, Estimate], shape: Mapping[str, float]) -> bool:
        """Return whether the estimates agree on one play, measured at the motor or at the link."""
        return super().is_plausible(estimates, shape) and _are_consistent(*map(estimates.get, ("bl", "bi", "br")))

    def grid(self, robot: Robot, joint: int) -> list[Mapping[str, float]]:
        """Return half a per cent and 4 % of the joint's effort limit."""
        # A sharp and a soft change of sides; the search goes on from the better one in quarters of an octave.
        effort = get_largest_torque(robot, joint)
        return [{"w": 0.005 * effort}, {"w": 0.04 * effort}]


def _are_consistent(posture: Estimate | None, links: Estimate | None, rotor: Estimate | None) -> bool:
    """Return whether estimates of one gear are consistent with a position measured at the motor or at the link.

    At the motor, the link lags behind: posture and inertia of the links give the same value within a factor of two, and
    the rotor gives none. At the link, the rotor has to catch up, and the links give none.
    """
    lagging = [estimate for estimate in (posture, links) if estimate is not None]
    is_significant = [estimate.value > estimate.doubt for estimate in lagging]
    rotor_seen = rotor is not None and abs(rotor.value) > rotor.doubt
    # A rotor that shows means that the position is measured at the link: then the links may not show.
    if rotor_seen and rotor is not None:
        return rotor.value > 0 and not any(abs(estimate.value) > estimate.doubt for estimate in lagging)
    sizes = [estimate.value for estimate in lagging]
    return bool(lagging) and all(is_significant) and max(sizes) <= 2.0 * min(sizes)


class JointElasticity(Effect):
    """A gear or belt that twists by τl / K: the link is not where the motor is.

    Where the position is measured at the motor, the load is that of the posture q - τl / K and of its acceleration
    (`Ce`, `Cl`, both -1/K); where it is measured at the link, the rotor has to follow the twist as well (`Cr`, Ia/K).
    """

    id = "joint_elasticity"
    title = "Elastic joint"
    formula = (
        r"-\frac{1}{K}\left(\frac{\partial\hat\tau_l}{\partial q_j}\,\hat\tau_l + A_j\,\ddot{\hat\tau}_l\right)"
        r" + \frac{I_a}{K}\,\ddot{\hat\tau}_l"
    )
    parameters = (
        ParameterSpec(
            "Ce", "rad/(N m)", "compliance 1/K, from the static deflection in each posture", "m/N", positive=True
        ),
        ParameterSpec("Cl", "rad/(N m)", "compliance 1/K, from the acceleration of the links", "m/N", positive=True),
        ParameterSpec("Cr", "s²", "rotor inertia times compliance, Ia/K", positive=True),
    )
    signature = "grows with the frequency of the motion; the arm bends under its own weight"
    confused_with = ("backlash", "encoder_zero_error", "torque_delay")
    sources = ("Gautier, Jubien and Janot 2013",)
    experiment = "paces"
    told_from = MappingProxyType({"paces": ("rotor_inertia", "encoder_zero_error")})
    first_order = True
    needs_load = True

    def usual(self, robot: Robot, joint: int) -> UsualSize:
        """Return the usual size: that of a harmonic drive."""
        compliance = 1 / (_STIFFNESS * get_largest_torque(robot, joint))
        return UsualSize({"Ce": compliance, "Cl": compliance})

    def is_plausible(self, estimates: Mapping[str, Estimate], shape: Mapping[str, float]) -> bool:
        """Return whether the estimates agree on one compliance, measured at the motor or at the link."""
        return super().is_plausible(estimates, shape) and _are_consistent(*map(estimates.get, ("Ce", "Cl", "Cr")))

    def columns(self, signals: Signals, joints: Sequence[int], shape: Mapping[str, float]) -> list[Column]:
        """Return three columns a joint."""
        # First order in the twist: slopes at the posture of the motor, times the twist of the predicted load.
        predicted = signals.predicted
        columns = []
        for j in joints:
            rotor = ca.SX(signals.robot.n, 1)
            # The twist is τl / K, so that its acceleration is that of the load torque over K.
            rotor[j] = predicted.load_acceleration[j]
            torques = (
                -predicted.load_over_position[:, j] * predicted.load[j],
                -predicted.mass[:, j] * predicted.load_acceleration[j],
                rotor,
            )
            for spec, torque in zip(self.parameters, torques, strict=True):
                columns.append(self._reaching_column(signals, spec, j, torque))
        return columns
