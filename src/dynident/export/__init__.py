"""Export of identified models: URDF, SDF, MJCF, USD, FMU, C and C++, CasADi, JSON, actuators, loads of controllers."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dynident.lazy_loader import make_lazy_exports

if TYPE_CHECKING:
    from dynident.export.actuator_files import to_isaac_lab_actuators, to_mjlab_actuators
    from dynident.export.c_code import to_c
    from dynident.export.c_header import to_c_header, to_cpp_header
    from dynident.export.casadi_function import to_casadi
    from dynident.export.controller_load_files import (
        IdentifiedLoad,
        identify_load,
        to_franka_load,
        to_kuka_load,
        to_load_urdf,
        to_ur_friction,
        to_urscript,
    )
    from dynident.export.export_request import ExportChoices, ExportFormat
    from dynident.export.feasible_completion import Completion, complete_parameters
    from dynident.export.feasible_links_and_joints import ExportedFile
    from dynident.export.fmu import to_fmu
    from dynident.export.mjcf import to_mjcf
    from dynident.export.model_export import compute_held_out_error, export_model
    from dynident.export.model_json import model_from_json, model_to_document, to_json
    from dynident.export.mujoco_missing_torque import MissingTorque, to_mujoco
    from dynident.export.randomisation import (
        ModelDistribution,
        ModelDraws,
        TorqueDisturbance,
        build_distribution,
        to_randomisation,
    )
    from dynident.export.ros2_package import to_ros2_package, unpack_files
    from dynident.export.sdf import to_sdf
    from dynident.export.torque_disturbance import compute_drift_coverage, measure_disturbance
    from dynident.export.torque_predictor import PredictingModel, TorquePredictor
    from dynident.export.urdf import to_urdf
    from dynident.export.usd import to_usd
    from dynident.regressors.observation_matrix import FurtherSignals

__all__ = [
    "Completion",
    "ExportChoices",
    "ExportFormat",
    "ExportedFile",
    "FurtherSignals",
    "IdentifiedLoad",
    "MissingTorque",
    "ModelDistribution",
    "ModelDraws",
    "PredictingModel",
    "TorqueDisturbance",
    "TorquePredictor",
    "build_distribution",
    "complete_parameters",
    "compute_drift_coverage",
    "compute_held_out_error",
    "export_model",
    "identify_load",
    "measure_disturbance",
    "model_from_json",
    "model_to_document",
    "to_c",
    "to_c_header",
    "to_casadi",
    "to_cpp_header",
    "to_fmu",
    "to_franka_load",
    "to_isaac_lab_actuators",
    "to_json",
    "to_kuka_load",
    "to_load_urdf",
    "to_mjcf",
    "to_mjlab_actuators",
    "to_mujoco",
    "to_randomisation",
    "to_ros2_package",
    "to_sdf",
    "to_ur_friction",
    "to_urdf",
    "to_urscript",
    "to_usd",
    "unpack_files",
]

if not TYPE_CHECKING:
    # Requests are declared in this package, too. Loading names lazily lets code that only reads requests start fast.
    __getattr__, __dir__ = make_lazy_exports(__name__)
