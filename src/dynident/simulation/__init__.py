"""A virtual robot with any effects, sensors and noise, that is moved and recorded."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dynident.lazy_loader import make_lazy_exports

if TYPE_CHECKING:
    from dynident.simulation.reference_motion import Reference, add_warming
    from dynident.simulation.simulated_recording import (
        SimulatedRecording,
        Truth,
        build_recording_table,
        join_runs,
        write_simulated_recording,
    )
    from dynident.simulation.simulation_from_request import (
        SimulationRequest,
        StandardParameters,
        build_simulation_request,
        build_standard_parameters,
        check_acting_effects,
        check_run_labels,
        compute_true_parameters,
        replace_usual_effects,
        resolve_true_effects,
        simulate,
    )
    from dynident.simulation.true_effects import (
        TrueEffect,
        build_typical_effect,
        list_drive_effects,
        spread_over_joints,
    )
    from dynident.simulation.virtual_robot import Controller, VirtualRobot
    from dynident.simulation.virtual_robot_request import ActingEffect, Sensors, Session, Simulated, Warming

__all__ = [
    "ActingEffect",
    "Controller",
    "Reference",
    "Sensors",
    "Session",
    "Simulated",
    "SimulatedRecording",
    "SimulationRequest",
    "StandardParameters",
    "TrueEffect",
    "Truth",
    "VirtualRobot",
    "Warming",
    "add_warming",
    "build_recording_table",
    "build_simulation_request",
    "build_standard_parameters",
    "build_typical_effect",
    "check_acting_effects",
    "check_run_labels",
    "compute_true_parameters",
    "join_runs",
    "list_drive_effects",
    "replace_usual_effects",
    "resolve_true_effects",
    "simulate",
    "spread_over_joints",
    "write_simulated_recording",
]

if not TYPE_CHECKING:
    # What can be asked is declared in this package, too: who reads that does not wait for what answers it.
    __getattr__, __dir__ = make_lazy_exports(__name__)
