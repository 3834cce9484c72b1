"""Move a robot with ROS 2 along a planned motion, and record its joint states.

    python ros2_trajectory.py MOTION.csv RECORDING.csv [--controller /joint_trajectory_controller]

The motion is one goal of the action `FollowJointTrajectory`, as joint_trajectory_controller and most makers' drivers
have it; `/joint_states` is recorded while it runs, with the effort as torque. Check what your driver means by effort:
some publish currents, some the torque that a model expects, some nothing.

Rows are written to RECORDING.csv.part as they come, which becomes RECORDING.csv at the end: `dynident campaign` looks
at them, and ends this script where the run is not worth going on with. It cancels the goal then, which stops the robot.

The robot has to stand at the first posture. Where the controller rejects or aborts the goal, or the joint states lack
effort, there is no recording, and the reason is printed. `rclpy`, `control_msgs` and `rosidl_runtime_py` come with
ROS 2; source its setup file first.
"""

from __future__ import annotations

import argparse
import signal
import sys
from pathlib import Path
from typing import Any, TextIO

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

CONTROLLER = "/joint_trajectory_controller"
STATES = "/joint_states"
NEAR = 0.05
"""Distance from the first posture, rad or m, from which the robot is not moved."""
TOLERANCE = 0.1
"""Distance from the motion, rad or m, at which the controller aborts it."""
PATIENCE = 10.0
"""Seconds that an answer may take beyond the motion."""
# action_msgs/GoalStatus
_SUCCEEDED = 4
# control_msgs/action/FollowJointTrajectory
_ERRORS = {
    -1: "INVALID_GOAL",
    -2: "INVALID_JOINTS",
    -3: "OLD_HEADER_TIMESTAMP",
    -4: "PATH_TOLERANCE_VIOLATED",
    -5: "GOAL_TOLERANCE_VIOLATED",
}


class RunEndedError(Exception):
    """The reason why a run was ended."""


def read_motion(path: Path) -> tuple[list[str], FloatArray, dict[str, FloatArray]]:
    """Read a motion: names of its joints, t (m,), and q, dq, ddq (m, n)."""
    names = path.read_text(encoding="utf-8").split("\n", 1)[0].strip().split(",")
    rows = np.loadtxt(path, delimiter=",", skiprows=1, ndmin=2)
    if len(rows) < 2:
        raise RunEndedError(f"{path} has no motion")
    joints = [name.removeprefix("q_") for name in names if name.startswith("q_")]
    parts = {kind: rows[:, [names.index(f"{kind}_{joint}") for joint in joints]] for kind in ("q", "dq", "ddq")}
    return joints, rows[:, names.index("t")], parts


def build_goal(joints: list[str], t: FloatArray, parts: dict[str, FloatArray]) -> dict[str, Any]:
    """Return the fields of the goal: a point for each sample, and the tolerances of the path."""
    nanoseconds = np.round(1e9 * (t - t[0])).astype(np.int64)
    points = [
        {
            "positions": q.tolist(),
            "velocities": dq.tolist(),
            "accelerations": ddq.tolist(),
            "time_from_start": {"sec": int(time // 10**9), "nanosec": int(time % 10**9)},
        }
        for time, q, dq, ddq in zip(nanoseconds, parts["q"], parts["dq"], parts["ddq"], strict=True)
    ]
    tolerances = [{"name": joint, "position": TOLERANCE} for joint in joints]
    return {"trajectory": {"joint_names": joints, "points": points}, "path_tolerance": tolerances}


class StateRecorder:
    """Joint states by the names of the motion: messages have all joints of the robot, in an order of their own."""

    def __init__(self, joints: list[str], file: TextIO) -> None:
        self.joints, self.file = joints, file
        self.is_moving, self.is_over = False, False
        self.first: Any = None
        self.posture: list[float] = []
        names = ["t", *(f"q_{joint}" for joint in joints), *(f"tau_{joint}" for joint in joints)]
        file.write(",".join(names) + "\n")

    def add(self, message: Any) -> None:
        """Take in a message of the type sensor_msgs/JointState; one that lacks a joint is of other joints."""
        places = {name: k for k, name in enumerate(message.name)}
        if self.is_over or not all(joint in places for joint in self.joints):
            return
        columns = [places[joint] for joint in self.joints]
        if len(message.effort) <= max(columns):
            raise RunEndedError(f"{STATES} has no effort; without torques or currents nothing can be identified")
        values = [message.position[k] for k in columns] + [message.effort[k] for k in columns]
        if not np.isfinite(values).all():
            raise RunEndedError(f"{STATES} has positions or efforts that are no numbers")
        stamp = message.header.stamp
        if self.first is None or not self.is_moving:
            self.first, self.posture = stamp, values[: len(columns)]
        if self.is_moving:
            # Whole numbers first: nanoseconds since 1970 have more digits than a float.
            since = (stamp.sec - self.first.sec) + 1e-9 * (stamp.nanosec - self.first.nanosec)
            self.file.write(",".join(f"{value:.9g}" for value in [since, *values]) + "\n")


def follow(motion: Path, controller: str, file: TextIO) -> None:
    """Move the robot along a motion; time, positions and efforts are written to a file as they come."""
    import rclpy
    from control_msgs.action import FollowJointTrajectory
    from rclpy.action import ActionClient
    from rclpy.signals import SignalHandlerOptions
    from rosidl_runtime_py import set_message_fields
    from sensor_msgs.msg import JointState

    joints, t, parts = read_motion(motion)
    recorder = StateRecorder(joints, file)
    # A signal ends this script by an exception, so that the goal is cancelled before ROS is shut down.
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    try:
        node = rclpy.create_node("dynident_run")
        node.create_subscription(JointState, STATES, recorder.add, 1000)
        client = ActionClient(node, FollowJointTrajectory, f"{controller}/follow_joint_trajectory")
        if not client.wait_for_server(timeout_sec=PATIENCE):
            raise RunEndedError(f"there is no action {controller}/follow_joint_trajectory")

        def wait_for(future: Any, seconds: float, what: str) -> Any:
            rclpy.spin_until_future_complete(node, future, timeout_sec=seconds)
            if not future.done():
                raise RunEndedError(f"{what} after {seconds:g} s")
            return future.result()

        for _ in range(round(PATIENCE / 0.1)):
            if recorder.first is not None:
                break
            rclpy.spin_once(node, timeout_sec=0.1)
        else:
            raise RunEndedError(f"{STATES} says nothing of {', '.join(joints)}")
        if not (np.abs(np.array(recorder.posture) - parts["q"][0]) < NEAR).all():
            first = ", ".join(f"{joint} {value:.3f}" for joint, value in zip(joints, parts["q"][0], strict=True))
            raise RunEndedError(f"the robot does not stand at the first posture of the motion; move it to {first}")
        goal = FollowJointTrajectory.Goal()
        set_message_fields(goal, build_goal(joints, t, parts))
        recorder.is_moving = True
        sent = client.send_goal_async(goal)
        try:
            handle = wait_for(sent, PATIENCE, "the controller did not answer")
            if not handle.accepted:
                raise RunEndedError("the controller rejected the motion")
            answer = wait_for(handle.get_result_async(), float(t[-1] - t[0]) + PATIENCE, "the motion did not end")
        except BaseException:
            # A goal that was sent may be accepted later, and the robot would move unwatched.
            recorder.is_over = True
            rclpy.spin_until_future_complete(node, sent, timeout_sec=PATIENCE)
            if sent.done() and sent.result().accepted:
                rclpy.spin_until_future_complete(node, sent.result().cancel_goal_async(), timeout_sec=PATIENCE)
            raise
        if answer.status != _SUCCEEDED or answer.result.error_code:
            code = answer.result.error_code
            reason = _ERRORS.get(code, f"error {code}")
            raise RunEndedError(f"the controller aborted the motion: {reason} {answer.result.error_string}".rstrip())
    finally:
        rclpy.shutdown()


def main(arguments: list[str] | None = None) -> int:
    """Run the script; 0 where a recording was written."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    for name in ("motion", "recording"):
        parser.add_argument(name, type=Path)
    parser.add_argument("--controller", default=CONTROLLER, help="name of the trajectory controller")
    given = parser.parse_args(arguments)
    unfinished = given.recording.with_name(f"{given.recording.name}.part")
    try:
        with unfinished.open("w", encoding="utf-8", buffering=1) as file:
            follow(given.motion, given.controller, file)
    except (RunEndedError, OSError, ValueError) as error:
        print(f"run ended: {error}", file=sys.stderr)
        return 1
    unfinished.replace(given.recording)
    return 0


if __name__ == "__main__":
    signal.signal(signal.SIGTERM, lambda *_: sys.exit("ended by a signal"))
    sys.exit(main())
