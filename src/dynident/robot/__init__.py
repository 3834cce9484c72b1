"""Robots: joints on a tree, limits, drive chains; read from URDF, MJCF or Denavit-Hartenberg tables."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dynident.lazy_loader import make_lazy_exports

if TYPE_CHECKING:
    from dynident.robot.bundled_arms import library_names, library_source, library_table, robot_from_library
    from dynident.robot.collision_reader import CollisionGeometry, collision_geometry
    from dynident.robot.description_and_json import robot_from_description
    from dynident.robot.forward_kinematics import compute_tool_jacobian, draw_unit_forces, joint_frames, tool_path
    from dynident.robot.joint import Joint
    from dynident.robot.limits_and_drives import Drive, Limits
    from dynident.robot.mjcf_reader import robot_from_mjcf
    from dynident.robot.modified_dh import robot_from_modified_dh
    from dynident.robot.pinocchio_conversion import to_pinocchio
    from dynident.robot.robot_model import INERTIAL_NAMES, Description, Robot, coupling_matrix
    from dynident.robot.urdf_reader import robot_from_urdf
    from dynident.robot.urdf_writer import urdf_from_robot

__all__ = [
    "INERTIAL_NAMES",
    "CollisionGeometry",
    "Description",
    "Drive",
    "Joint",
    "Limits",
    "Robot",
    "collision_geometry",
    "compute_tool_jacobian",
    "coupling_matrix",
    "draw_unit_forces",
    "joint_frames",
    "library_names",
    "library_source",
    "library_table",
    "robot_from_description",
    "robot_from_library",
    "robot_from_mjcf",
    "robot_from_modified_dh",
    "robot_from_urdf",
    "to_pinocchio",
    "tool_path",
    "urdf_from_robot",
]

if not TYPE_CHECKING:
    # Requests are declared in this package, too. Loading names lazily lets code that only reads requests start fast.
    __getattr__, __dir__ = make_lazy_exports(__name__)
