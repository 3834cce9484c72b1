"""Messages of a bag in packed form, and the names of the types that hold signals of joints."""

from __future__ import annotations

from typing import NamedTuple

JOINT_STATES = "sensor_msgs/msg/JointState"
WRENCHES = ("geometry_msgs/msg/WrenchStamped", "geometry_msgs/msg/Wrench")
DYNAMIC_STATES = "control_msgs/msg/DynamicJointState"
CONTROLLER_STATES = (
    "control_msgs/msg/JointTrajectoryControllerState",
    "control_msgs/msg/JointControllerState",
)
_LBR = {
    "measured_joint_position": "position",
    "measured_torque": "torque",
    "commanded_joint_position": "commanded_position",
    "commanded_torque": "commanded_torque",
    "external_torque": "external_torque",
}
ARRAYS: dict[str, dict[str, str]] = {
    "franka_msgs/msg/FrankaState": {
        "q": "position",
        "dq": "velocity",
        "tau_J": "torque",
        "q_d": "commanded_position",
        "tau_J_d": "commanded_torque",
        "tau_ext_hat_filtered": "external_torque",
    },
    "lbr_fri_msgs/msg/LBRState": _LBR,
    "lbr_fri_idl/msg/LBRState": _LBR,
}
"""Fields with a number a joint, and what they are called here, of messages that name no joints."""
FRANKA_ROBOT = "franka_msgs/msg/FrankaRobotState"
KNOWN = (JOINT_STATES, *WRENCHES, DYNAMIC_STATES, *CONTROLLER_STATES, *ARRAYS, FRANKA_ROBOT)


class PackedMessage(NamedTuple):
    """A message as it is stored; `definition` is the text of its type where the file gives it."""

    topic: str
    type: str
    definition: str
    stamp: int
    data: bytes


def normalise_type(type_name: str) -> str:
    """Return the type's name as ROS 2 writes it: sensor_msgs/JointState of ROS 1 is sensor_msgs/msg/JointState."""
    return type_name if "/msg/" in type_name else type_name.replace("/", "/msg/", 1)
