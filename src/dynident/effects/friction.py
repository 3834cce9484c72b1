"""Friction without memory: Coulomb, viscous, Stribeck, by load, position, temperature, warm-up."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import ClassVar

import casadi as ca

from dynident.array_types import FloatArray
from dynident.effects.effect import RATIO, Column, Effect, Estimate, ParameterSpec, ShapeSpec, build_geometric_grid
from dynident.effects.effect_signals import Signals
from dynident.effects.usual_effect_sizes import (
    COULOMB_SHARE,
    VISCOUS_SHARE,
    UsualSize,
    get_largest_torque,
    get_usual_coulomb,
    get_usual_viscous,
    get_velocity_scale,
)
from dynident.robot.robot_model import Robot


def bound_friction(torque: ca.SX, dq: ca.SX, speeds: FloatArray) -> ca.SX:
    """Return friction that never gets smaller beyond the speeds at which it was measured.

    A power of the speed that fits a recording may bend down right behind it, and drive the joint from some speed on.
    So may a straight line that falls. Up to `speeds`, and where friction grows, nothing changes.

    Parameters
    ----------
    torque : SX (n, 1)
        Friction of each joint, a function of its own speed, in N m or N.
    dq : SX (n, 1)
        Velocities of the joints.
    speeds : (n,)
        Largest speed of each joint in the recordings, in rad/s or m/s.
    """
    bounded = ca.densify(torque)
    for j in range(dq.numel()):
        # Friction that does not depend on the speed cannot fall with it.
        if not ca.depends_on(bounded[j], dq[j]):
            continue
        inside = ca.fmin(float(speeds[j]), ca.fmax(-float(speeds[j]), dq[j]))
        last = ca.substitute(torque[j], dq[j], inside)
        bounded[j] = ca.if_else(dq[j] >= 0, ca.fmax(torque[j], last), ca.fmin(torque[j], last))
    return bounded


REFERENCE_TEMPERATURE = 25.0
"""Temperature in °C at which the friction is that of `viscous` and `coulomb` alone."""


class _DriftingFriction(Effect):
    """Viscous and Coulomb friction times a common factor that changes in time."""

    is_friction: ClassVar[bool] = True

    def get_factor(self, signals: Signals, joint: int, shape: Mapping[str, float]) -> ca.SX:
        """Return the factor (1, 1)."""
        raise TypeError(f"{type(self).__name__} gives no factor")

    def columns(self, signals: Signals, joints: Sequence[int], shape: Mapping[str, float]) -> list[Column]:
        """Return a viscous and a Coulomb column a joint."""
        constants = self.shape_with_defaults(shape)
        columns = []
        for j in joints:
            factor = self.get_factor(signals, j, constants)
            for spec, torque in zip(self.parameters, (signals.dq[j], signals.sign[j]), strict=True):
                columns.append(self._column(signals, spec, j, factor * torque, constants))
        return columns


class TemperatureFriction(_DriftingFriction):
    """Friction that changes with the temperature of the joint, as grease thins. It needs recorded temperatures."""

    id = "temperature_friction"
    title = "Temperature-dependent friction"
    formula = r"(T - T_0)\,(a\,\dot q + b\,\mathrm{sign}(\dot q))"
    parameters = (
        ParameterSpec("Fvt", "N m s/(rad K)", "change of viscous friction per kelvin above 25 °C", "N s/(m K)"),
        ParameterSpec("Fct", "N m/K", "change of Coulomb friction per kelvin above 25 °C", "N/K"),
    )
    signature = "friction that drifts with the temperature of the joint"
    confused_with = ("warm_up_friction",)
    sources = ("Bittencourt and Axelsson 2014", "Simoni, Beschi, Legnani and Visioli 2015")
    experiment = "cold_and_warm"
    told_from = MappingProxyType({"cold_and_warm": ("warm_up_friction", "viscous")})
    needs_temperature = True

    def usual(self, robot: Robot, joint: int) -> UsualSize:
        """Return the usual size: a per cent or two of the usual friction for every kelvin."""
        return UsualSize(
            {"Fvt": -0.02 * get_usual_viscous(robot, joint), "Fct": -0.01 * get_usual_coulomb(robot, joint)}
        )

    def get_factor(self, signals: Signals, joint: int, shape: Mapping[str, float]) -> ca.SX:
        """Return T - 25 °C."""
        # Zero at a temperature in use, so that Coulomb and viscous friction keep their meaning and their usual size.
        return signals.temperature[joint] - REFERENCE_TEMPERATURE


class WarmUpFriction(_DriftingFriction):
    """Friction that falls after a cold start, for recordings without temperatures."""

    id = "warm_up_friction"
    title = "Friction that falls as the robot warms up"
    formula = r"e^{-t / T_w}\,(a\,\dot q + b\,\mathrm{sign}(\dot q))"
    parameters = (
        ParameterSpec("Fvw", "N m s/rad", "excess of viscous friction at t = 0", "N s/m"),
        ParameterSpec("Fcw", "N m", "excess of Coulomb friction at t = 0", "N"),
    )
    needs_session = True
    shapes = (ShapeSpec("Tw", "s", "time constant of warming up", 900.0, refined=RATIO),)
    signature = "friction that decays with the time of the session"
    confused_with = ("temperature_friction",)
    sources = ("Simoni, Beschi, Legnani and Visioli 2015",)
    experiment = "cold_and_warm"
    told_from = MappingProxyType({"cold_and_warm": ("viscous",)})

    def usual(self, robot: Robot, joint: int) -> UsualSize:
        """Return the usual size: half of the usual friction, gone in a quarter of an hour."""
        values = {"Fvw": 0.6 * get_usual_viscous(robot, joint), "Fcw": 0.3 * get_usual_coulomb(robot, joint)}
        return UsualSize(values, {"Tw": 900.0})

    def get_factor(self, signals: Signals, joint: int, shape: Mapping[str, float]) -> ca.SX:
        """Return exp(-t / Tw)."""
        # It dies away, so that Coulomb and viscous friction are those of the warm robot.
        return ca.exp(-signals.time / shape["Tw"])

    def grid(self, robot: Robot, joint: int) -> list[Mapping[str, float]]:
        """Return time constants from half a minute to two hours."""
        # Factors of four suffice: the search goes on from the best of them in quarters of an octave.
        return [{"Tw": value} for value in build_geometric_grid(30.0, 7680.0, 4.0)]


_KHALIL = "Khalil and Dombre 2002, chapter 12, [12.11]"


class _OneColumnFriction(Effect):
    """Friction with one parameter and one expression a joint."""

    is_friction: ClassVar[bool] = True

    def expression(self, signals: Signals, joint: int, shape: Mapping[str, float]) -> ca.SX:
        """Return the torque (1, 1) for a unit parameter."""
        raise TypeError(f"{type(self).__name__} gives no expression")

    def columns(self, signals: Signals, joints: Sequence[int], shape: Mapping[str, float]) -> list[Column]:
        """Return one column a joint."""
        constants = self.shape_with_defaults(shape)
        return [
            self._column(signals, self.parameters[0], j, self.expression(signals, j, constants), constants)
            for j in joints
        ]


class Coulomb(_OneColumnFriction):
    """Dry friction of constant size."""

    id = "coulomb"
    title = "Coulomb friction"
    formula = r"F_c\,\mathrm{sign}(\dot q)"
    parameters = (ParameterSpec("Fc", "N m", "Coulomb friction", "N", positive=True, resists=True, role="dry"),)
    signature = "a step at each reversal"
    sources = (_KHALIL,)
    experiment = "constant_speeds"
    may_change = True
    changes_with = ("viscous",)

    def usual(self, robot: Robot, joint: int) -> UsualSize:
        """Return the usual size: some per cent of the largest torque."""
        return UsualSize({"Fc": get_usual_coulomb(robot, joint)})

    def expression(self, signals: Signals, joint: int, shape: Mapping[str, float]) -> ca.SX:
        """Return sign(q̇)."""
        return signals.sign[joint]


class CoulombAsymmetric(Effect):
    """Dry friction that differs between the directions."""

    id = "coulomb_asymmetric"
    title = "Asymmetric Coulomb friction"
    formula = r"F_+ \ (\dot q > 0),\quad -F_- \ (\dot q < 0)"
    parameters = (
        ParameterSpec("Fcp", "N m", "Coulomb friction forward", "N"),
        ParameterSpec("Fcn", "N m", "Coulomb friction backward", "N"),
    )
    signature = "a constant: half the difference between the two directions"
    confused_with = ("offset",)
    # Beside Coulomb friction, half the difference between the directions is a constant torque.
    same_function = ("offset",)
    sources = ("Armstrong-Hélouvry, Dupont and Canudas de Wit 1994",)
    experiment = "slow_sweep"
    is_friction = True

    def usual(self, robot: Robot, joint: int) -> UsualSize:
        """Return the usual size: a third of the usual friction, one way."""
        torque = get_largest_torque(robot, joint)
        return UsualSize({"Fcp": 0.3 * COULOMB_SHARE * torque, "Fcn": 0.0})

    def columns(self, signals: Signals, joints: Sequence[int], shape: Mapping[str, float]) -> list[Column]:
        """Return a column for each direction."""
        columns = []
        for j in joints:
            # 1 forward and 0 backward; less 1 it is 0 forward and -1 backward.
            forward = 0.5 * (1 + signals.sign[j])
            for spec, torque in zip(self.parameters, (forward, forward - 1), strict=True):
                columns.append(self._column(signals, spec, j, torque))
        return columns


class Viscous(_OneColumnFriction):
    """Friction proportional to velocity."""

    id = "viscous"
    title = "Viscous friction"
    formula = r"F_v\,\dot q"
    parameters = (
        ParameterSpec("Fv", "N m s/rad", "viscous friction", "N s/m", positive=True, resists=True, role="damping"),
    )
    signature = "a straight line over velocity"
    sources = (_KHALIL,)
    experiment = "constant_speeds"
    may_change = True
    changes_with = ("coulomb",)

    def usual(self, robot: Robot, joint: int) -> UsualSize:
        """Return the usual size: some per cent of the largest torque at full speed."""
        return UsualSize({"Fv": get_usual_viscous(robot, joint)})

    def expression(self, signals: Signals, joint: int, shape: Mapping[str, float]) -> ca.SX:
        """Return q̇."""
        return signals.dq[joint]


class ViscousAsymmetric(_OneColumnFriction):
    """Viscous friction that differs between the directions."""

    id = "viscous_asymmetric"
    title = "Asymmetric viscous friction"
    formula = r"c\,|\dot q|"
    parameters = (
        ParameterSpec("Fva", "N m s/rad", "half the difference of viscous friction forward and backward", "N s/m"),
    )
    signature = "even in the velocity: the same sign in both directions, growing with speed"
    sources = ("Armstrong-Hélouvry, Dupont and Canudas de Wit 1994",)
    experiment = "constant_speeds"
    told_from = MappingProxyType({"constant_speeds": ("offset", "coulomb_asymmetric", "viscous_nonlinear")})

    def usual(self, robot: Robot, joint: int) -> UsualSize:
        """Return the usual size: a third of the usual friction."""
        torque = get_largest_torque(robot, joint)
        return UsualSize({"Fva": 0.3 * VISCOUS_SHARE * torque / get_velocity_scale(robot, joint)})

    def expression(self, signals: Signals, joint: int, shape: Mapping[str, float]) -> ca.SX:
        """Return |q̇|."""
        return ca.fabs(signals.dq[joint])


class Stribeck(_OneColumnFriction):
    """Friction that falls as a lubricant film builds up."""

    id = "stribeck"
    title = "Stribeck friction"
    formula = r"(F_s - F_c)\,e^{-|\dot q / v_s|^\delta}\,\mathrm{sign}(\dot q)"
    parameters = (
        ParameterSpec("Fst", "N m", "excess of friction at low speed over Coulomb friction", "N", positive=True),
    )
    shapes = (
        ShapeSpec(
            "vs", "rad/s", "Stribeck velocity", 0.05, relative_to_velocity=True, resolved_by="speed", refined=RATIO
        ),
        ShapeSpec("delta", "-", "exponent of the ratio of velocity to Stribeck velocity", 2.0),
    )
    signature = "odd in the velocity, with peaks at low speed on both sides"
    confused_with = ("viscous_nonlinear", "presliding")
    sources = ("Armstrong-Hélouvry, Dupont and Canudas de Wit 1994",)
    experiment = "constant_speeds"
    holds_at_rest = True
    told_from = MappingProxyType({"constant_speeds": ("viscous_nonlinear", "coulomb", "break_away", "viscous")})
    often_missed = 3

    def usual(self, robot: Robot, joint: int) -> UsualSize:
        """Return the usual size: more than half of the usual Coulomb friction, at some per cent of the speed."""
        torque = get_largest_torque(robot, joint)
        return UsualSize({"Fst": 0.6 * COULOMB_SHARE * torque}, {"vs": 0.03 * get_velocity_scale(robot, joint)})

    def expression(self, signals: Signals, joint: int, shape: Mapping[str, float]) -> ca.SX:
        """Return exp(-|q̇/vs|^δ) sign(q̇)."""
        ratio = signals.dq[joint] / shape["vs"]
        delta = shape["delta"]
        # A product takes less time than a power, and 2 is the usual exponent.
        power = ratio * ratio if delta == 2.0 else ca.fabs(ratio) ** delta
        return ca.exp(-power) * signals.sign[joint]

    def at_starts(self, shape: Mapping[str, float]) -> bool:
        """Return True: it is friction at low speed."""
        return True

    def grid(self, robot: Robot, joint: int) -> list[Mapping[str, float]]:
        """Return Stribeck velocities from 0.4 % to 13 % of the joint's velocity limit, bell-shaped and pointed."""
        # Factors of two suffice: the search goes on from the best of them in quarters of an octave.
        speeds = build_geometric_grid(
            0.004 * get_velocity_scale(robot, joint), 0.13 * get_velocity_scale(robot, joint), 2.0
        )
        return [{"vs": v, "delta": delta} for delta in (2.0, 1.0) for v in speeds]


class ViscousNonlinear(_OneColumnFriction):
    """Viscous friction that is not proportional to the velocity, but to a power of it."""

    id = "viscous_nonlinear"
    title = "Nonlinear viscous friction"
    formula = r"a\,|\dot q|^p\,\mathrm{sign}(\dot q)"
    parameters = (ParameterSpec("Fvn", "N m (s/rad)^p", "coefficient of the power of the velocity", "N (s/m)^p"),)
    shapes = (ShapeSpec("p", "-", "exponent of the velocity", 2.0, least=0.4, refined=RATIO, natural=(0.5, 2.0, 3.0)),)
    signature = "odd in the velocity, with a slope that grows or falls with speed"
    confused_with = ("stribeck",)
    is_rough = True
    sources = ("Gaz, Cognetti, Oliva, Robuffo Giordano and De Luca 2019",)
    experiment = "constant_speeds"
    told_from = MappingProxyType({"constant_speeds": ("viscous", "coulomb")})
    often_missed = 5

    def usual(self, robot: Robot, joint: int) -> UsualSize:
        """Return the usual size: some per cent of the largest torque at half the speed."""
        half = get_velocity_scale(robot, joint) / 2
        return UsualSize({"Fvn": 0.06 * get_largest_torque(robot, joint) / half**2}, {"p": 2.0})

    def expression(self, signals: Signals, joint: int, shape: Mapping[str, float]) -> ca.SX:
        """Return |q̇|^p sign(q̇)."""
        # The power of a negative velocity would be no number for a broken exponent: size and sign are kept apart.
        magnitude = ca.fabs(signals.dq[joint])
        return magnitude ** shape["p"] * signals.sign[joint]

    def is_plausible(self, estimates: Mapping[str, Estimate], shape: Mapping[str, float]) -> bool:
        """Return whether the friction rises where the power is below one: what falls from rest is Stribeck friction."""
        possible = super().is_plausible(estimates, shape)
        falls = any(estimate.value < -estimate.doubt for estimate in estimates.values())
        return possible and not (falls and self.is_steep_at_rest(shape))

    def at_starts(self, shape: Mapping[str, float]) -> bool:
        """Return whether the power is below one: then it is steepest where the joint starts."""
        return self.is_steep_at_rest(shape)

    def is_steep_at_rest(self, shape: Mapping[str, float]) -> bool:
        """Return whether the power is below one."""
        return shape["p"] < 1.0

    def grid(self, robot: Robot, joint: int) -> list[Mapping[str, float]]:
        """Return exponents below and above one."""
        return [{"p": p} for p in (2.0, 0.5, 3.0)]


class LoadDependentFriction(_OneColumnFriction):
    """Gear friction that grows with the transmitted torque."""

    id = "load_dependent_friction"
    title = "Load-dependent Coulomb friction"
    formula = r"c\,|\hat\tau_l|\,\mathrm{sign}(\dot q)"
    parameters = (ParameterSpec("cl", "-", "friction per unit of load torque", positive=True, least=5e-3, most=0.5),)
    signature = "steps at reversals whose height follows the load"
    confused_with = ("position_dependent_friction", "coulomb")
    sources = ("Hamon, Gautier and Garrec 2010",)
    experiment = "with_payload"
    told_from = MappingProxyType(
        {
            "with_payload": (
                "position_dependent_friction",
                "drive_gain_saturation",
                "drive_gain_error",
                "coulomb",
            )
        }
    )
    often_missed = 2
    needs_load = True
    may_change = True
    # Where the load hardly varies, Coulomb friction explains the same torque.
    seldom_changes = True

    def usual(self, robot: Robot, joint: int) -> UsualSize:
        """Return the usual size: that of harmonic drives."""
        return UsualSize({"cl": 0.08})

    def expression(self, signals: Signals, joint: int, shape: Mapping[str, float]) -> ca.SX:
        """Return |τl| sign(q̇)."""
        # The size of the load, whichever way it pulls: friction opposes the motion, not the load.
        return ca.fabs(signals.load[joint]) * signals.sign[joint]


class PositionDependentFriction(Effect):
    """Coulomb friction that varies with the position, once or a few times per turn of the joint."""

    id = "position_dependent_friction"
    title = "Position-dependent Coulomb friction"
    formula = r"(a_c \cos kq + a_s \sin kq)\,\mathrm{sign}(\dot q)"
    parameters = (
        ParameterSpec("Fpc", "N m", "cosine part", "N"),
        ParameterSpec("Fps", "N m", "sine part", "N"),
    )
    shapes = (ShapeSpec("k", "1/rad", "cycles per turn of the joint", 1.0),)
    signature = "flips with the direction and depends on the joint's position"
    confused_with = ("load_dependent_friction",)
    sources = ("Bittencourt and Gunnarsson 2012",)
    experiment = "slow_sweep"
    told_from = MappingProxyType({"slow_sweep": ("coulomb",)})
    is_friction = True
    of_position = True

    def usual(self, robot: Robot, joint: int) -> UsualSize:
        """Return the usual size: a third of the usual Coulomb friction, once a turn."""
        torque = get_largest_torque(robot, joint)
        values = {"Fpc": 0.3 * COULOMB_SHARE * torque, "Fps": 0.2 * COULOMB_SHARE * torque}
        return UsualSize(values, {"k": 1.0})

    def columns(self, signals: Signals, joints: Sequence[int], shape: Mapping[str, float]) -> list[Column]:
        """Return a cosine and a sine column a joint."""
        constants = self.shape_with_defaults(shape)
        columns = []
        # A cosine and a sine together have any phase, and the torque stays linear in the parameters.
        for j in joints:
            angle = constants["k"] * signals.q[j]
            for spec, wave in zip(self.parameters, (ca.cos(angle), ca.sin(angle)), strict=True):
                columns.append(self._column(signals, spec, j, wave * signals.sign[j], constants))
        return columns

    def applicable(self, robot: Robot) -> tuple[int, ...]:
        """Return revolute joints."""
        return tuple(j for j, joint in enumerate(robot.joints) if joint.kind == "revolute")

    def grid(self, robot: Robot, joint: int) -> list[Mapping[str, float]]:
        """Return one to six cycles a turn."""
        return [{"k": float(k)} for k in (1, 2, 3, 4, 6)]
