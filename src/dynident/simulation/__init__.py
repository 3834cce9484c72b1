"""A virtual robot with any chosen effects, sensors and noise."""

from dynident.simulation.control import Controller
from dynident.simulation.measurement import Measurement, Truth, measurement_table, write_measurement
from dynident.simulation.reference import Reference
from dynident.simulation.sensors import Sensors
from dynident.simulation.truth import TrueEffect, on_each_joint
from dynident.simulation.virtual_robot import VirtualRobot

__all__ = [
    "Controller",
    "Measurement",
    "Reference",
    "Sensors",
    "TrueEffect",
    "Truth",
    "VirtualRobot",
    "measurement_table",
    "on_each_joint",
    "write_measurement",
]
