"""A virtual robot with any chosen effects, sensors and noise."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dynident.lazy import lazily

if TYPE_CHECKING:
    from dynident.simulation.control import Controller
    from dynident.simulation.measurement import Measurement, Truth, joined, measurement_table, write_measurement
    from dynident.simulation.reference import Reference, warmed
    from dynident.simulation.request import (
        SimulationRequest,
        StandardParameters,
        check_runs_named,
        simulate,
        standard_parameters,
    )
    from dynident.simulation.resolved import beside, check_acting, simulation_of, true_effects
    from dynident.simulation.stated import ActingEffect, Sensors, Session, Simulated, Warming
    from dynident.simulation.truth import TrueEffect, on_each_joint
    from dynident.simulation.typical import typical_drive, typical_effect
    from dynident.simulation.virtual_robot import VirtualRobot

__all__ = [
    "ActingEffect",
    "Controller",
    "Measurement",
    "Reference",
    "Sensors",
    "Session",
    "Simulated",
    "SimulationRequest",
    "StandardParameters",
    "TrueEffect",
    "Truth",
    "VirtualRobot",
    "Warming",
    "beside",
    "check_acting",
    "check_runs_named",
    "joined",
    "measurement_table",
    "on_each_joint",
    "simulate",
    "simulation_of",
    "standard_parameters",
    "true_effects",
    "typical_drive",
    "typical_effect",
    "warmed",
    "write_measurement",
]

if not TYPE_CHECKING:
    # What can be asked is declared in this room, too: who reads that does not wait for what answers it.
    __getattr__ = lazily(__name__)
