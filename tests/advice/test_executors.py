"""Scripts that make a campaign's motions: a MuJoCo scene, a UR by RTDE, a robot with ROS 2."""

from __future__ import annotations

import importlib.util
import re
import socket
import struct
import sys
import threading
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import ModuleType, SimpleNamespace

import mujoco
import numpy as np
import pytest
from support.closed_loop_robots import mjcf

import dynident as dy
from dynident.advice.campaign_request import CampaignRequest
from dynident.advice.prediction_error import evaluate_rows
from dynident.excitation import DesignRequest, TrajectoryRequest
from dynident.simulation import list_drive_effects

SCRIPTS = Path(__file__).parents[2] / "docs" / "executors"
ARM = dy.load_robot("scara")
DESIGN = DesignRequest(
    starts=1, random_trajectories=10, trajectory=TrajectoryRequest(duration=6.0, harmonics=3, sampling_rate=100.0)
)


@cache
def load_script(name: str) -> ModuleType:
    """A script of the documentation as a module."""
    spec = importlib.util.spec_from_file_location(name, SCRIPTS / f"{name}.py")
    assert spec is not None
    module = sys.modules[name] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def scene(tmp_path) -> Path:
    """A MuJoCo scene of the arm: links 10 % off its description, rotors, and friction that sticks."""
    factors = 1 + 0.1 * np.random.default_rng(5).standard_normal((ARM.n, 1))
    true = {(effect.effect, effect.joint): effect.values[0][1] for effect in list_drive_effects(ARM)}
    friction = {name: (true["coulomb", name], true["viscous", name]) for name in ARM.joint_names}
    text = mjcf(replace(ARM, inertias=ARM.inertias * factors), friction=friction)
    for name in ARM.joint_names:
        text = text.replace(f'<joint name="{name}"', f'<joint name="{name}" armature="{true["rotor_inertia", name]!r}"')
    path = tmp_path / "scene.xml"
    path.write_text(text, encoding="utf-8")
    return path


def compute_engine_torque(path: Path, region) -> np.ndarray:
    """The torque (m, n) that the engine itself needs at states."""
    model, _, dofs = load_script("mujoco_scene").load_scene(path, list(ARM.joint_names))
    data, torque = mujoco.MjData(model), np.empty_like(region.q)
    # Its inverse dynamics take a slow joint that reverses within a step for one that sticks: friction is added here.
    friction = model.dof_frictionloss[dofs] * np.sign(region.dq)
    model.dof_frictionloss[:] = 0.0
    for k, state in enumerate(zip(region.q, region.dq, region.ddq, strict=True)):
        data.qpos[dofs], data.qvel[dofs], data.qacc[dofs] = state
        mujoco.mj_inverse(model, data)
        torque[k] = data.qfrc_inverse[dofs]
    return torque + friction


@pytest.mark.slow
def test_a_campaign_reaches_its_goal_with_an_arm_that_another_engine_moves(scene, tmp_path):
    campaign = dy.Campaign(ARM, request=CampaignRequest(error=0.02, minutes=2.0, design=DESIGN))

    def execute(motion):
        number = len(campaign.state.runs) + 1
        files = tmp_path / "motion.csv", tmp_path / f"run{number}.csv"
        motion.save(files[0])
        assert load_script("mujoco_scene").main([str(scene), *map(str, files), "--seed", str(number)]) == 0
        return dy.read_recordings(files[1], robot=ARM)

    dy.run_campaign(campaign, execute)
    assert campaign.decision.code == "reached", campaign.decision.sentence
    region, found = campaign.state.region, campaign.state.identification
    truth = compute_engine_torque(scene, region)
    torque = evaluate_rows(found, region.q, region.dq, region.ddq) @ found.values
    error = np.sqrt(((torque - truth) ** 2).mean(axis=0) / (truth**2).mean(axis=0))
    assert error.max() <= 0.02


def test_a_scene_that_does_not_fit_or_that_the_arm_touches_ends_the_run_with_its_reason(scene, tmp_path, capsys):
    script, text = load_script("mujoco_scene"), scene.read_text(encoding="utf-8")
    motion, recording = tmp_path / "motion.csv", tmp_path / "run.csv"
    # The first run takes half of the length.
    longer = replace(DESIGN, trajectory=replace(DESIGN.trajectory, duration=12.0))
    dy.Campaign(ARM, request=CampaignRequest(design=longer)).ask().save(motion)
    # A ball on the last link that is in a box of the world from the start.
    touching = text.replace("<worldbody>", '<worldbody><geom type="box" size="3 3 3"/>')
    touching = re.sub(r'(<body name="b3"[^>]*>)', r'\1<geom type="sphere" size="0.01" mass="0"/>', touching)
    for changed, words in (
        (text.replace('"elbow"', '"other"'), "the scene has no joint elbow; it has: shoulder, other"),
        (touching, "b3 and world touch after 0.00 s"),
        (re.sub('frictionloss="7.5"', 'frictionloss="9000"', text), "quill does not follow after"),
    ):
        assert changed != text
        scene.write_text(changed, encoding="utf-8")
        assert script.main([str(scene), str(motion), str(recording)]) == 1
        assert words in capsys.readouterr().err
        assert not recording.exists()
    # What touches without the arm is no matter of the run.
    floor = '<worldbody><geom type="plane" size="9 9 1" pos="0 0 -5"/><body pos="0 0 -4.9"><freejoint/>'
    box = '<inertial pos="0 0 0" mass="1" diaginertia="0.01 0.01 0.01"/>'
    scene.write_text(text.replace("<worldbody>", floor + f'<geom type="box" size=".1 .1 .1"/>{box}</body>'))
    assert script.main([str(scene), str(motion), str(recording)]) == 0, capsys.readouterr().err


@pytest.mark.parametrize("script", ["mujoco_scene", "ros2_trajectory", "ur_rtde"])
def test_a_motion_that_cannot_be_read_ends_the_run_with_its_reason(scene, ros, tmp_path, capsys, script):
    motion, recording = tmp_path / "motion.csv", tmp_path / "run.csv"
    design = dy.Campaign(dy.load_robot("ur10") if script == "ur_rtde" else ARM, request=CampaignRequest(design=DESIGN))
    design.ask().save(motion)
    text = motion.read_text(encoding="utf-8")
    first = {"mujoco_scene": [str(scene)], "ros2_trajectory": [], "ur_rtde": ["127.0.0.1"]}[script]
    for changed in (text.replace("t,", "time,", 1), text.rstrip().rpartition(",")[0], text.split("\n")[0] + "\n1\n"):
        motion.write_text(changed, encoding="utf-8")
        assert load_script(script).main([*first, str(motion), str(recording)]) == 1
        assert "run ended: " in capsys.readouterr().err
        assert not recording.exists()
    if script == "mujoco_scene":
        motion.write_text(text, encoding="utf-8")
        scene.write_text("<mujoco>", encoding="utf-8")
        assert load_script(script).main([*first, str(motion), str(recording)]) == 1
        assert "run ended: " in capsys.readouterr().err


RTDE_SIGNALS = {
    "timestamp": "DOUBLE",
    "actual_q": "VECTOR6D",
    "actual_current": "VECTOR6D",
    "safety_mode": "INT32",
    "output_int_register_24": "INT32",
}


class MockController:
    """A controller of Universal Robots as its RTDE guide describes it: recipes, packages, and a port for programs.

    The arm follows what the program reads from the registers; `fault` is what goes wrong, and half a second of motion
    passes before it does.
    """

    START = np.array([0.0, -1.57, 1.57, -1.57, -1.57, 0.0])

    def __init__(self, fault: str = "") -> None:
        self.fault, self.program = fault, ""
        self.q, self.message, self.command, self.target = self.START.copy(), 0, 0, self.START.copy()
        self.sockets = [socket.create_server(("127.0.0.1", 0)) for _ in range(2)]
        self.ports = [server.getsockname()[1] for server in self.sockets]
        self.threads = [threading.Thread(target=run, daemon=True) for run in (self.exchange, self.take_program)]
        for thread in self.threads:
            thread.start()

    def take_program(self) -> None:
        connection, _ = self.sockets[1].accept()
        with connection:
            while not self.program.rstrip().endswith("end\nend"):
                text = connection.recv(4096).decode()
                if not text:
                    break
                self.program += text

    def exchange(self) -> None:
        connection, _ = self.sockets[0].accept()
        with connection, connection.makefile("rb") as incoming:

            def send(kind: str, payload: bytes) -> None:
                connection.sendall(struct.pack(">HB", 3 + len(payload), ord(kind)) + payload)

            def receive() -> tuple[str, bytes]:
                size, kind = struct.unpack(">HB", incoming.read(3))
                return chr(kind), incoming.read(size - 3)

            kind, payload = receive()
            assert (kind, payload) == ("V", b"\x00\x02")
            send("V", b"\x00" if self.fault == "version" else b"\x01")
            if self.fault == "version":
                return
            kind, payload = receive()
            self.rate, outputs = struct.unpack(">d", payload[:8])[0], payload[8:].decode().split(",")
            kinds = [RTDE_SIGNALS[name] for name in outputs]
            send("O", b"\x01" + ",".join(kinds).encode())
            kind, payload = receive()
            inputs = payload.decode().split(",")
            assert inputs == ["input_int_register_24", *(f"input_double_register_{k}" for k in range(24, 30))]
            taken = "IN_USE" if self.fault == "in use" else "INT32"
            send("I", b"\x02" + ",".join([taken, *["DOUBLE"] * 6]).encode())
            if self.fault == "in use":
                return
            assert receive() == ("S", b"")
            send("S", b"\x01")
            send("M", b"\x05hello\x04mock\x03")
            # Texts may be empty.
            send("M", b"")
            if self.fault == "no size":
                connection.sendall(b"\x00\x00U")
            format_of = {"DOUBLE": "d", "VECTOR6D": "6d", "INT32": "i"}
            packing = ">B" + "".join(format_of[kind] for kind in kinds)
            for k in range(10**6):
                self.move(k)
                stopped = self.fault == "protective stop" and self.followed > 0.5
                send("U", struct.pack(packing, 1, 40.0 + k / self.rate, *self.q, *(0.1 * self.q), 3 if stopped else 1,
                                      self.message))  # fmt: skip
                if k == 0:
                    # The first package is looked at before anything is sent.
                    continue
                try:
                    kind, payload = receive()
                except (OSError, struct.error):
                    return
                assert kind == "U"
                recipe, self.command, *target = struct.unpack(">Bi6d", payload)
                assert recipe == 2
                self.target = np.array(target)

    followed = 0.0

    def move(self, k: int) -> None:
        """One cycle of the program, if it has come."""
        tokens = re.findall(r"write_output_integer_register\(24, (\d+)\)", self.program)
        if len(tokens) < 2:
            return
        if self.command == 0:
            self.message = int(tokens[0])
        elif self.command == 1:
            self.followed += 1 / self.rate
            if not (self.fault == "stuck" and self.followed > 0.5):
                self.q = self.target
        elif self.fault != "program gone":
            self.message = int(tokens[1])


@pytest.fixture
def ur_motion(tmp_path) -> Path:
    """A motion of a UR10 from rest to rest, two seconds long, as a campaign writes it."""
    t = np.arange(201) / 100.0
    s = 0.3 * (1 - np.cos(np.pi * t))[:, None] * np.ones(6)
    names = dy.load_robot("ur10").joint_names
    header = ",".join(["t", *(f"q_{name}" for name in names)])
    rows = np.column_stack([t, MockController.START + s])
    np.savetxt(tmp_path / "motion.csv", rows, delimiter=",", header=header, comments="")
    return tmp_path / "motion.csv"


def test_a_ur_follows_the_motion_by_rtde_and_is_recorded(ur_motion, tmp_path, capsys):
    controller, recording = MockController(), tmp_path / "run.csv"
    arguments = ["127.0.0.1", str(ur_motion), str(recording)]
    assert load_script("ur_rtde").main(arguments, controller.ports) == 0, capsys.readouterr().err
    assert "controller: hello" in capsys.readouterr().err
    with recording.open(encoding="utf-8") as file:
        names = file.readline().strip().split(",")
    assert (names[1], names[7]) == ("q_shoulder_pan_joint", "current_shoulder_pan_joint")
    rows, planned = np.loadtxt(recording, delimiter=",", skiprows=1), np.loadtxt(ur_motion, delimiter=",", skiprows=1)
    assert len(rows) == pytest.approx(2.0 * controller.rate, abs=3)
    wanted = np.column_stack([np.interp(rows[:, 0], planned[:, 0], column) for column in planned[:, 1:].T])
    # What is recorded is the posture of the package before.
    assert np.abs(rows[:, 1:7] - wanted).max() < 2 * 0.3 * np.pi / controller.rate
    assert rows[:, 7:] == pytest.approx(0.1 * rows[:, 1:7], abs=1e-8)
    # Every block of the program is closed, and it stops where nobody writes the registers any more.
    assert len(re.findall(r"^ *(?:def|while|if)", controller.program, re.MULTILINE)) == controller.program.count(
        "end\n"
    )
    assert 'rtde_set_watchdog("input_int_register_24", 10.0, "stop")' in controller.program
    assert "servoj(q, t=0.002," in controller.program


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        ("version", "does not speak version 2"),
        ("in use", "the controller says IN_USE of input_int_register_24"),
        ("protective stop", "stopped the arm (safety mode 3)"),
        ("stuck", "does not follow after"),
        ("elsewhere", "does not stand at the first posture"),
        ("program gone", "the program did not end"),
        ("no size", "a package that is none of RTDE"),
    ],
)
@pytest.mark.timeout(60)
def test_a_run_of_a_ur_that_goes_wrong_leaves_no_recording(ur_motion, tmp_path, capsys, monkeypatch, fault, words):
    monkeypatch.setattr(load_script("ur_rtde"), "PATIENCE", 2.0)
    controller, recording = MockController(fault), tmp_path / "run.csv"
    if fault == "elsewhere":
        controller.q = controller.q + 0.5
    assert load_script("ur_rtde").main(["127.0.0.1", str(ur_motion), str(recording)], controller.ports) == 1
    assert words in capsys.readouterr().err
    assert not recording.exists()
    if fault == "stuck":
        controller.threads[0].join(5.0)
        # The program brakes harder than where the arm stands at the end of a motion.
        assert controller.command == 3
        soft, hard = re.search(
            r"if read_input_integer_register\(24\) == 2:\s+stopj\((.*)\)\s+else:\s+stopj\((.*)\)\s+end\n",
            controller.program,
        ).groups()
        assert (float(soft), float(hard)) == (2.0, 15.0)


class Done:
    """A future that is done."""

    def __init__(self, value) -> None:
        self.value, self.waits = value, 0

    def done(self) -> bool:
        return self.value is not None

    def result(self):
        return self.value


class Later(Done):
    """A future that is done only once it was waited for again."""

    def done(self) -> bool:
        return self.waits > 1


@pytest.fixture
def ros(monkeypatch):
    """The part of ROS 2 that the script uses, as its documents describe it, with a robot that follows a goal."""
    robot = SimpleNamespace(
        goal=None,
        moves=False,
        callback=None,
        cancelled=False,
        accepted=True,
        status=4,
        code=0,
        q=None,
        answer=Done,
    )
    robot.effort, robot.joints = True, ARM.joint_names

    def publish(k: int, q) -> None:
        # All joints of the robot, a gripper's among them, in an order of their own.
        order = [*reversed(robot.joints), "finger"]
        values = {**dict(zip(robot.joints, q, strict=True)), "finger": 9.0}
        stamp = SimpleNamespace(sec=100 + k // 100, nanosec=k % 100 * 10**7)
        effort = [2.0 * values[name] for name in order] if robot.effort else []
        robot.callback(SimpleNamespace(
            header=SimpleNamespace(stamp=stamp), name=order, position=[values[name] for name in order], effort=effort
        ))  # fmt: skip

    class Handle:
        accepted = property(lambda _: robot.accepted)

        def get_result_async(self):
            robot.moves = True
            return Done(SimpleNamespace(
                status=robot.status, result=SimpleNamespace(error_code=robot.code, error_string="")
            )) if robot.status else Done(None)  # fmt: skip

        def cancel_goal_async(self):
            robot.cancelled = True
            return Done(True)

    class ActionClient:
        def __init__(self, node, kind, name) -> None:
            robot.action = name

        def wait_for_server(self, timeout_sec):
            return True

        def send_goal_async(self, goal):
            robot.goal = goal.fields
            return robot.answer(Handle())

    def spin(node, future, timeout_sec) -> None:
        future.waits += 1
        if robot.moves and not robot.cancelled:
            for k, point in enumerate(robot.goal["trajectory"]["points"]):
                publish(k, point["positions"])

    def subscribe(kind, topic, callback, depth) -> None:
        assert topic == "/joint_states"
        robot.callback = callback

    modules = {
        "rclpy": {
            "init": lambda signal_handler_options: None, "shutdown": lambda: None, "spin_until_future_complete": spin,
            "create_node": lambda name: SimpleNamespace(create_subscription=subscribe),
            "spin_once": lambda node, timeout_sec: publish(0, robot.q),
        },
        "rclpy.action": {"ActionClient": ActionClient},
        "rclpy.signals": {"SignalHandlerOptions": SimpleNamespace(NO=0)},
        "control_msgs": {},
        "control_msgs.action": {"FollowJointTrajectory": SimpleNamespace(Goal=SimpleNamespace)},
        "rosidl_runtime_py": {"set_message_fields": lambda goal, fields: setattr(goal, "fields", fields)},
        "sensor_msgs": {},
        "sensor_msgs.msg": {"JointState": None},
    }  # fmt: skip
    for name, content in modules.items():
        module = ModuleType(name)
        vars(module).update(content)
        monkeypatch.setitem(sys.modules, name, module)
    return robot


def test_a_robot_with_ros_follows_one_goal_and_its_joint_states_are_recorded(ros, tmp_path, capsys):
    motion, recording = tmp_path / "motion.csv", tmp_path / "run.csv"
    design = dy.Campaign(ARM, request=CampaignRequest(design=DESIGN)).ask()
    design.save(motion)
    ros.q = design.design.q[0]
    script = load_script("ros2_trajectory")
    assert script.main([str(motion), str(recording), "--controller", "/arm"]) == 0, capsys.readouterr().err
    assert ros.action == "/arm/follow_joint_trajectory"
    points = ros.goal["trajectory"]["points"]
    assert ros.goal["trajectory"]["joint_names"] == list(ARM.joint_names)
    times = [point["time_from_start"]["sec"] + 1e-9 * point["time_from_start"]["nanosec"] for point in points]
    assert times == pytest.approx(design.design.t.tolist(), abs=1e-9)
    assert all(0 <= point["time_from_start"]["nanosec"] < 10**9 for point in points)
    assert [point["velocities"] for point in points] == pytest.approx(design.design.dq, abs=1e-9)
    assert {tolerance["name"] for tolerance in ros.goal["path_tolerance"]} == set(ARM.joint_names)
    found = dy.read_recordings(recording, robot=ARM)[0].recording
    assert np.loadtxt(recording, delimiter=",", skiprows=1)[:, 1 : 1 + ARM.n] == pytest.approx(
        design.design.q, abs=1e-7
    )
    assert found.joint_names == ARM.joint_names


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"accepted": False}, "rejected the motion"),
        ({"status": 6, "code": -4}, "aborted the motion: PATH_TOLERANCE_VIOLATED"),
        ({"status": 0}, "the motion did not end after"),
        ({"effort": False}, "has no effort"),
        ({"q": np.ones(ARM.n)}, "does not stand at the first posture"),
        ({"answer": Later}, "the controller did not answer"),
    ],
)
def test_a_motion_that_ros_does_not_finish_leaves_no_recording(ros, tmp_path, capsys, changes, words):
    motion, recording = tmp_path / "motion.csv", tmp_path / "run.csv"
    design = dy.Campaign(ARM, request=CampaignRequest(design=DESIGN)).ask()
    design.save(motion)
    vars(ros).update({"q": design.design.q[0]} | changes)
    assert load_script("ros2_trajectory").main([str(motion), str(recording)]) == 1
    assert words in capsys.readouterr().err
    assert not recording.exists()
    # Also a goal that is accepted only once nobody waits for it any more.
    assert ros.cancelled == (changes in ({"status": 0}, {"answer": Later}))


@pytest.mark.parametrize("is_accepted", [True, False])
def test_a_script_that_is_ended_cancels_the_motion(ros, tmp_path, monkeypatch, is_accepted):
    motion, recording = tmp_path / "motion.csv", tmp_path / "run.csv"
    design = dy.Campaign(ARM, request=CampaignRequest(design=DESIGN)).ask()
    design.save(motion)
    ros.q = design.design.q[0]
    ros.answer = Done if is_accepted else Later
    spin, ended = sys.modules["rclpy"].spin_until_future_complete, []

    def end(node, future, timeout_sec) -> None:
        if (ros.moves or not is_accepted) and not ended:
            ended.append(True)
            future.waits = 1
            raise SystemExit("ended by a signal")
        spin(node, future, timeout_sec)

    monkeypatch.setattr(sys.modules["rclpy"], "spin_until_future_complete", end)
    with pytest.raises(SystemExit):
        load_script("ros2_trajectory").main([str(motion), str(recording)])
    assert ros.cancelled
    assert not recording.exists()
