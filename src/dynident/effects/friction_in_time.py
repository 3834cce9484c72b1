"""Friction that changes while the robot works: with its temperature, or with the time since it was started."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import ClassVar

import casadi as ca

from dynident.effects.effect import RATIO, Column, Effect, ParameterSpec, ShapeSpec, build_geometric_grid
from dynident.effects.signals import Signals
from dynident.effects.sizes import UsualSize, get_usual_coulomb, get_usual_viscous
from dynident.robot.model import Robot

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
    """Grease that thins as the joint warms up; needs the temperature of the joint."""

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
        return signals.temperature[joint] - REFERENCE_TEMPERATURE


class WarmUpFriction(_DriftingFriction):
    """Friction that falls after a cold start, where nobody measured the temperature."""

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
        return ca.exp(-signals.time / shape["Tw"])

    def grid(self, robot: Robot, joint: int) -> list[Mapping[str, float]]:
        """Return time constants from half a minute to two hours."""
        return [{"Tw": value} for value in build_geometric_grid(30.0, 7680.0, 4.0)]
