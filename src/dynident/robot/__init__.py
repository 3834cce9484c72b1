"""What a machine is: joints on a tree, limits, drive chains; from URDF or a modified Denavit-Hartenberg table."""

from dynident.robot.model import INERTIAL_NAMES, Description, Drive, Joint, Limits, Robot
from dynident.robot.urdf import robot_from_urdf

__all__ = ["INERTIAL_NAMES", "Description", "Drive", "Joint", "Limits", "Robot", "robot_from_urdf"]
