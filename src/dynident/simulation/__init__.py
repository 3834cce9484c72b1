"""A virtual robot with any chosen effects, sensors and noise."""

from dynident.simulation.control import Controller
from dynident.simulation.measurement import Measurement, Truth, joined, measurement_table, write_measurement
from dynident.simulation.reference import Reference, Warming, warmed
from dynident.simulation.request import (
    SimulationRequest,
    StandardParameters,
    check_runs_named,
    simulate,
    standard_parameters,
)
from dynident.simulation.sensors import Sensors
from dynident.simulation.truth import TrueEffect, on_each_joint
from dynident.simulation.typical import typical_drive, typical_effect
from dynident.simulation.virtual_robot import VirtualRobot

__all__ = [
    "Controller",
    "Measurement",
    "Reference",
    "Sensors",
    "SimulationRequest",
    "StandardParameters",
    "TrueEffect",
    "Truth",
    "VirtualRobot",
    "Warming",
    "check_runs_named",
    "joined",
    "measurement_table",
    "on_each_joint",
    "simulate",
    "standard_parameters",
    "typical_drive",
    "typical_effect",
    "warmed",
    "write_measurement",
]
