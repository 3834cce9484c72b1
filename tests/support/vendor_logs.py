"""Files as robots' own loggers write them, made from signals that are known: names, units and order are theirs."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Signals:
    """What was measured, t (m,) in s, the others (m, n) in SI, and what was commanded or estimated beside it."""

    t: FloatArray
    q: FloatArray
    dq: FloatArray
    tau: FloatArray
    current: FloatArray
    q_command: FloatArray
    tau_command: FloatArray
    current_command: FloatArray
    external: FloatArray

    @property
    def n(self) -> int:
        return self.q.shape[1]

    def thinned(self, every: int) -> Signals:
        return Signals(**{name: values[::every] for name, values in vars(self).items()})


def _text(path: Path, names: list[str], columns: list[FloatArray], delimiter: str = ",", *, form: str = "%.9g") -> Path:
    header = delimiter.join(names)
    np.savetxt(path, np.column_stack(columns), form, delimiter, header=header, comments="")
    return path


def _rtde(signals: Signals, start: float) -> tuple[list[str], list[FloatArray]]:
    """All outputs that ur_rtde records unless told otherwise, but single bits, in its order."""
    m, n = signals.q.shape
    one, six, three = np.ones((m, 1)), np.ones((m, n)), np.ones((m, 3))
    wave = np.sin(np.linspace(0.0, 9.0, m))[:, None]
    warm = 30.0 + 0.01 * np.floor(np.linspace(0.0, 100.0, m))[:, None] * six
    parts: list[tuple[str, FloatArray]] = [
        ("timestamp", signals.t[:, None] + start),
        ("target_q", signals.q_command),
        ("target_qd", signals.dq + 1e-4),
        ("target_qdd", np.gradient(signals.dq, axis=0) * 100.0),
        ("target_current", signals.current_command),
        ("target_moment", signals.tau_command),
        ("actual_q", signals.q),
        ("actual_qd", signals.dq),
        ("actual_current", signals.current),
        ("joint_control_output", signals.current_command * 1.01),
        ("actual_TCP_pose", 0.5 * six * wave),
        ("actual_TCP_speed", 0.1 * six * wave),
        ("actual_TCP_force", 3.0 * six * wave),
        ("target_TCP_pose", 0.5 * six * wave),
        ("target_TCP_speed", 0.1 * six * wave),
        ("actual_digital_input_bits", 0 * one),
        ("joint_temperatures", warm),
        ("actual_execution_time", 0.2 + 0.01 * wave),
        ("robot_mode", 7 * one),
        ("joint_mode", 253 * six),
        ("safety_mode", one),
        ("actual_tool_accelerometer", 9.8 * three * wave),
        ("speed_scaling", one),
        ("target_speed_fraction", one),
        ("actual_momentum", 5.0 * np.abs(wave)),
        ("actual_main_voltage", 48.0 + 0.1 * wave),
        ("actual_robot_voltage", 48.0 + 0.1 * wave),
        ("actual_robot_current", 1.0 + 0.1 * wave),
        ("actual_joint_voltage", 48.0 + 0.1 * six * wave),
        ("actual_digital_output_bits", 0 * one),
        ("runtime_state", 2 * one),
        ("payload", 0.5 * one),
        ("payload_cog", 0.01 * three),
        ("payload_inertia", 0.001 * six),
    ]
    names = [f"{name}_{k}" if part.shape[1] > 1 else name for name, part in parts for k in range(part.shape[1])]
    return names, [part for _, part in parts]


def ur_rtde(signals: Signals, path: Path, start: float = 51234.0) -> Path:
    """`RTDEReceiveInterface.startFileRecording` of ur_rtde: six decimals, time since the controller was started."""
    return _text(path.with_suffix(".csv"), *_rtde(signals, start), form="%.6f")


def rtde_record(signals: Signals, path: Path, start: float = 51234.0) -> Path:
    """`record.py` of Universal Robots' RTDE client: the same names between spaces, of the outputs of a recipe."""
    names, parts = _rtde(signals, start)
    columns = np.column_stack(parts)
    kept = [
        k
        for k, name in enumerate(names)
        if name.startswith(("timestamp", "target_q", "actual_q", "actual_cur", "target_m"))
    ]
    return _text(path.with_suffix(".csv"), [names[k] for k in kept], [columns[:, kept]], " ", form="%.16g")


def libfranka(signals: Signals, path: Path) -> Path:
    """`franka::logToCSV`: time in ms; states counted from 0 in brackets; commands, of which most stay 0."""
    m, n = signals.q.shape
    parts = [
        ("state.q", signals.q),
        ("state.q_d", signals.q_command),
        ("state.dq", signals.dq),
        ("state.dq_d", signals.dq + 1e-4),
        ("state.tau_J", signals.tau),
        ("state.tau_ext_hat_filtered", signals.external),
        ("cmd.q_d", signals.q_command),
        ("cmd.dq_d", np.zeros((m, n))),
        ("cmd.O_T_EE_d", np.zeros((m, 16))),
        ("cmd.O_dP_EE_d", np.zeros((m, 6))),
        ("cmd.tau_J_d", signals.tau_command),
    ]
    first, *others = (", ".join(f"{name}[{k}]" for k in range(part.shape[1])) for name, part in parts)
    heads = [f"time, success_rate, {first}", *others]
    time = np.round(signals.t * 1e3)[:, None]
    return _text(path.with_suffix(".csv"), heads, [time, np.ones((m, 1)), *(part for _, part in parts)], form="%.9g")


def rsi(signals: Signals, path: Path) -> Path:
    """Telegrams of KUKA's RobotSensorInterface as they came, one a line: degrees, and IPOC in ms."""
    tail = '<Delay D="0"/><Tech C11="0.000" C12="0.000"/><DiL>0</DiL><Digout o1="0" o2="0" o3="0"/>'
    pose = " ".join(
        f'{axis}="{value:.4f}"' for axis, value in zip("XYZABC", (1350.0, 0, 1569.0, 180, 0, 180), strict=True)
    )
    q, command = np.rad2deg(signals.q), np.rad2deg(signals.q_command)

    def axes(values: FloatArray) -> str:
        return " ".join(f'A{j + 1}="{value:.4f}"' for j, value in enumerate(values))

    lines = [
        f'<Rob Type="KUKA"><RIst {pose}/><RSol {pose}/><AIPos {axes(q[k])}/><ASPos {axes(command[k])}/>'
        f"<MACur {axes(signals.current[k])}/>{tail}<IPOC>{round(4208163634 + t * 1e3)}</IPOC></Rob>"
        for k, t in enumerate(signals.t)
    ]
    path = path.with_suffix(".xml")
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def pyfri(signals: Signals, path: Path) -> Path:
    """`ClientApplication.collect_data` of pyFRI: measured and interpolated positions, measured and external torques."""
    m, n = signals.q.shape
    wall = 1.7e9 + signals.t
    named = {"index": np.arange(m), "time": signals.t, "record_time_nsec": np.round(wall * 1e9)}
    named |= {"tsec": np.floor(wall), "tnsec": np.round((wall % 1.0) * 1e9)}
    for name, part in (("mp", signals.q), ("ip", signals.q_command), ("mt", signals.tau), ("et", signals.external)):
        named |= {f"{name}{j + 1}": part[:, j] for j in range(n)}
    named["dt"] = np.full(m, signals.t[1] - signals.t[0])
    return _text(path.with_suffix(".csv"), list(named), list(named.values()), form="%.19g")


def lbr_state(signals: Signals, path: Path) -> Path:
    """The fields of FRI's LBRState by their names, as CSV of a topic: arrays are counted from 0."""
    wall = 1.7e9 + signals.t
    named = {"sample_time": np.full(len(wall), 0.005), "session_state": np.full(len(wall), 4.0)}
    named |= {"time_stamp_sec": np.floor(wall), "time_stamp_nano_sec": np.round((wall % 1.0) * 1e9)}
    parts = {
        "measured_joint_position": signals.q,
        "commanded_joint_position": signals.q_command,
        "measured_torque": signals.tau,
        "commanded_torque": signals.tau_command,
        "external_torque": signals.external,
        "ipo_joint_position": signals.q_command,
    }
    named |= {f"{name}[{j}]": part[:, j] for name, part in parts.items() for j in range(signals.n)}
    named["tracking_performance"] = np.ones(len(wall))
    return _text(path.with_suffix(".csv"), list(named), list(named.values()), form="%.19g")


def lerobot(
    episodes: list[Signals],
    folder: Path,
    joints: list[str] | None,
    *,
    together: bool = False,
    version: str = "v3.0",
    effort: bool = True,
) -> Path:
    """A data set of LeRobot whose state holds the positions of named joints, and whose action the commanded ones.

    Effort and velocity stand in features of their own or, `together`, in the state, as `<joint>.pos` and so on; without
    `effort` there are none, as LeRobot itself records its arms.
    """
    states, efforts, speeds, actions = (
        [getattr(one, name) for one in episodes] for name in ("q", "tau", "dq", "q_command")
    )
    count = [len(one.t) for one in episodes]
    columns: dict[str, FloatArray] = {"observation.state": np.concatenate(states)}
    names = {"observation.state": [f"{joint}.pos" for joint in joints] if joints else None}
    if together:
        parts = zip(states, speeds, efforts, strict=True)
        columns["observation.state"] = np.concatenate([np.column_stack(part) for part in parts])
        names["observation.state"] = [
            f"{joint}.{field}" for field in ("pos", "vel", "effort") for joint in joints or []
        ] or None
    elif effort:
        columns |= {"observation.velocity": np.concatenate(speeds), "observation.effort": np.concatenate(efforts)}
        names |= {"observation.velocity": joints, "observation.effort": joints}
    columns["action"] = np.concatenate(actions)
    names["action"] = [f"{joint}.pos" for joint in joints] if joints else None
    table = {
        name: pa.array(
            list(part.astype(np.float32)), pa.list_(pa.float32(), part.shape[1] if version == "v3.0" else -1)
        )
        for name, part in columns.items()
    }
    table["timestamp"] = pa.array(np.concatenate([one.t - one.t[0] for one in episodes]).astype(np.float32))
    table["frame_index"] = pa.array(np.concatenate([np.arange(m) for m in count]))
    table["episode_index"] = pa.array(np.repeat(np.arange(len(count)), count))
    table["index"] = pa.array(np.arange(sum(count)))
    table["task_index"] = pa.array(np.zeros(sum(count), dtype=np.int64))
    path = folder / "data" / "chunk-000" / ("file-000.parquet" if version == "v3.0" else "episode_000000.parquet")
    path.parent.mkdir(parents=True)
    pq.write_table(pa.table(table), path)
    (folder / "meta").mkdir()
    if version != "v3.0":
        names = {name: {"motors": one} if one else None for name, one in names.items()}
    features = {
        name: {"dtype": "float32", "shape": [values.shape[1]], "names": names[name]} for name, values in columns.items()
    }
    info = {"codebase_version": version, "robot_type": "arm", "fps": 100, "features": features}
    (folder / "meta" / "info.json").write_text(json.dumps(info), encoding="utf-8")
    return path


_SEVEN = ("q", "q_d", "dq", "dq_d", "tau_J", "tau_J_d", "tau_ext_hat_filtered")
_FRANKA_STATE = "\n".join(
    ["std_msgs/Header header", *(f"float64[7] {name}" for name in _SEVEN), "float64[16] O_T_EE", "float64 time"]
)
_FRANKA_ROBOT_STATE = "\n".join(
    [
        "std_msgs/Header header",
        *(
            f"sensor_msgs/JointState {name}"
            for name in (
                "measured_joint_state",
                "desired_joint_state",
                "measured_joint_motor_state",
                "tau_ext_hat_filtered",
            )
        ),
        "geometry_msgs/WrenchStamped o_f_ext_hat_k",
        "float64[7] dtau_j",
    ]
)
_LBR_STATE = "\n".join(
    ["float64 sample_time", "int8 session_state", "uint32 time_stamp_sec", "uint32 time_stamp_nano_sec"]
    + [f"float64[7] {name}" for name in ("measured_joint_position", "measured_torque", "commanded_torque")]
    + ["float64[7] external_torque", "float64[7] ipo_joint_position", "float64 tracking_performance"]
)


def _stamp(t: float) -> int:
    return round((1.7e9 + t) * 1e9)


def franka_ros(signals: Signals, path: Path) -> Path:
    """A bag of ROS 1 with franka_ros's states, and the joint states at a tenth of their rate that come with them."""
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    store.register(get_types_from_msg(_FRANKA_STATE, "franka_msgs/msg/FrankaState"))
    kinds = {"/joint_states": "sensor_msgs/msg/JointState", "/franka_states": "franka_msgs/msg/FrankaState"}
    header, time, joint, state = (
        store.types[name] for name in ("std_msgs/msg/Header", "builtin_interfaces/msg/Time", *kinds.values())
    )
    names = [f"panda_joint{j + 1}" for j in range(signals.n)]
    path = path.with_suffix(".bag")
    with Writer(path) as writer:
        topics = {topic: writer.add_connection(topic, kind, typestore=store) for topic, kind in kinds.items()}
        for k, t in enumerate(signals.t):
            stamp = _stamp(float(t))
            head = header(seq=k, stamp=time(sec=stamp // 10**9, nanosec=stamp % 10**9), frame_id="")
            q, tau, command = signals.q[k], signals.tau[k], signals.q_command[k]
            seven = (q, command, signals.dq[k], signals.dq[k], tau, signals.tau_command[k], signals.external[k])
            messages = {"/franka_states": state(head, *seven, O_T_EE=np.zeros(16), time=float(t))}
            if k % 10 == 0:
                messages["/joint_states"] = joint(head, names, q, signals.dq[k], tau)
            for topic, message in messages.items():
                writer.write(topics[topic], stamp, store.serialize_ros1(message, kinds[topic]))
    return path


def ros_2(signals: Signals, path: Path, driver: str, joints: list[str]) -> Path:
    """An MCAP of ROS 2 with the states of a `driver`'s own type: franka_ros2, or lbr for that of LBR arms."""
    from mcap.writer import Writer
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    kind, text = {
        "franka_ros2": ("franka_msgs/msg/FrankaRobotState", _FRANKA_ROBOT_STATE),
        "lbr": ("lbr_fri_idl/msg/LBRState", _LBR_STATE),
    }[driver]
    store.register(get_types_from_msg(text, kind))
    header, time = store.types["std_msgs/msg/Header"], store.types["builtin_interfaces/msg/Time"]
    joint, state = store.types["sensor_msgs/msg/JointState"], store.types[kind]
    nothing = np.empty(0)
    definition, _ = store.generate_msgdef(kind, ros_version=2)
    path = path.with_suffix(".mcap")
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema(name=kind, encoding="ros2msg", data=definition.encode())
        channel = writer.register_channel("/robot_state", "cdr", schema)
        for k, t in enumerate(signals.t):
            stamp = _stamp(float(t))
            seconds, rest = divmod(stamp, 10**9)
            q, dq, tau, command = signals.q[k], signals.dq[k], signals.tau[k], signals.q_command[k]
            told, external = signals.tau_command[k], signals.external[k]
            if driver == "lbr":
                message = state(0.005, 4, seconds, rest, q, tau, told, external, command, 1.0)
            else:
                head = header(stamp=time(sec=seconds, nanosec=rest), frame_id="base")
                wrench = store.types["geometry_msgs/msg/Wrench"](
                    *(store.types["geometry_msgs/msg/Vector3"](0.1 * k % 3, 0.0, 1.0) for _ in range(2))
                )
                message = state(
                    head,
                    joint(head, joints, q, dq, tau),
                    joint(head, joints, command, dq, told),
                    joint(head, joints, q, dq, nothing),
                    joint(head, joints, nothing, nothing, external),
                    store.types["geometry_msgs/msg/WrenchStamped"](head, wrench),
                    np.zeros(7),
                )
            data = bytes(store.serialize_cdr(message, kind))
            writer.add_message(channel, log_time=stamp + 1000, data=data, publish_time=stamp)
        writer.finish()
    return path
