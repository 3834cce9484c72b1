"""One recording as many loggers write it: the layouts of their files, from any robot, rate and seed."""

from __future__ import annotations

import csv
import gzip
import io
import json
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pyarrow as pa
from scipy.io import savemat

FloatArray = np.ndarray


@dataclass(frozen=True, eq=False)
class Recorded:
    """What was measured: t (m,) in s, q, dq, tau (m, n), in the order of the robot's joints."""

    joints: tuple[str, ...]
    t: FloatArray
    q: FloatArray
    dq: FloatArray
    tau: FloatArray
    slides: tuple[bool, ...]
    rng: np.random.Generator

    @property
    def n(self) -> int:
        return len(self.joints)

    def in_order(self, order: list[int]) -> Recorded:
        joints = tuple(self.joints[k] for k in order)
        slides = tuple(self.slides[k] for k in order)
        return Recorded(joints, self.t, self.q[:, order], self.dq[:, order], self.tau[:, order], slides, self.rng)

    def shuffled(self) -> Recorded:
        return self.in_order(self.rng.permutation(self.n).tolist())

    def sorted(self) -> Recorded:
        return self.in_order(sorted(range(self.n), key=lambda k: self.joints[k]))


def number(value: float) -> str:
    return f"{value:.9g}"


def table(header: list[str], columns: list[list[str]], delimiter: str = ",", end: str = "\n") -> str:
    lines = [delimiter.join(header)] if header else []
    lines += [delimiter.join(row) for row in zip(*columns, strict=True)]
    return end.join(lines) + end


def cells(values: FloatArray) -> list[list[str]]:
    """The columns of values (m, c) as text."""
    return [[number(value) for value in column] for column in values.T]


def counted(pattern: str, n: int, first: int = 0) -> list[str]:
    return [pattern.format(k + first) for k in range(n)]


def blocks(run: Recorded) -> list[list[str]]:
    return [*cells(run.q), *cells(run.dq), *cells(run.tau)]


def rostopic(folder: Path, run: Recorded) -> Path:
    run, n, m = run.sorted(), run.n, len(run.t)
    stamp = [str(1_700_000_000_000_000_000 + round(t * 1e9)) for t in run.t]
    header = ["%time", "field.header.seq", "field.header.stamp", "field.header.frame_id"]
    header += [f"field.{name}{k}" for name in ("name", "position", "velocity", "effort") for k in range(n)]
    named = [[joint] * m for joint in run.joints]
    columns = [stamp, [str(k) for k in range(m)], stamp, [""] * m, *named, *blocks(run)]
    return written(folder / "echo.csv", table(header, columns))


def ros2_echo(folder: Path, run: Recorded) -> Path:
    run, m = run.shuffled(), len(run.t)
    stamp = 1_700_000_000 * 10**9 + np.round(run.t * 1e9).astype(np.int64)
    columns = [[str(one // 10**9) for one in stamp], [str(one % 10**9) for one in stamp], ["base"] * m]
    columns += [[joint] * m for joint in run.joints] + blocks(run)
    return written(folder / "echo2.csv", table([], columns))


def bagpy(folder: Path, run: Recorded) -> Path:
    run = run.shuffled()
    text = io.StringIO()
    writer = csv.writer(text)
    writer.writerow(["Time", "header.seq", "header.frame_id", "name", "position", "velocity", "effort"])
    for k, t in enumerate(run.t):
        arrays = ["(" + ", ".join(repr(float(v)) for v in one[k]) + ")" for one in (run.q, run.dq, run.tau)]
        writer.writerow([f"{1.7e9 + t:.6f}", k, "", str(list(run.joints)), *arrays])
    return written(folder / "joint_states.csv", text.getvalue())


def numpy_cells(folder: Path, run: Recorded) -> Path:
    text = io.StringIO()
    writer = csv.writer(text)
    writer.writerow(["time", "qpos", "qvel", "torque"])
    for k, t in enumerate(run.t):
        writer.writerow([number(t), *(str(one[k]) for one in (run.q, run.dq, run.tau))])  # breaks long lines
    return written(folder / "arrays.csv", text.getvalue())


def bare_lists(folder: Path, run: Recorded) -> Path:
    rows = [f"{t:.6f},{q.tolist()},{tau.tolist()}" for t, q, tau in zip(run.t, run.q, run.tau, strict=True)]
    return written(folder / "lists.csv", "\n".join(["t,q,tau", *rows, ""]))


def sparse_topics(folder: Path, run: Recorded) -> Path:
    run = run.shuffled()
    every = int(run.rng.choice([1, 2]))
    delay = 0.26 * float(run.t[1] - run.t[0])
    header = ["__time", *(f"/joint_states/{j}/position" for j in run.joints)]
    header += [f"/motor_feedback/{j}/torque" for j in run.joints]
    rows = [(t, [number(v) for v in q] + [""] * run.n) for t, q in zip(run.t, run.q, strict=True)]
    late = [np.interp(run.t[::every] + delay, run.t, column) for column in run.tau.T]
    rows += [
        (t + delay, [""] * run.n + [number(v) for v in tau]) for t, *tau in zip(run.t[::every], *late, strict=True)
    ]
    lines = [",".join([f"{1.7e9 + t:.6f}", *values]) for t, values in sorted(rows, key=lambda row: row[0])]
    return written(folder / "plot.csv", "\n".join([",".join(header), *lines, ""]))


def json_lines(folder: Path, run: Recorded) -> Path:
    records = [
        {"t": t, "pos": q.tolist(), "vel": dq.tolist(), "torque": tau.tolist(), "gripper": {"pos": 0.1, "on": True}}
        for t, q, dq, tau in zip(run.t.tolist(), run.q, run.dq, run.tau, strict=True)
    ]
    return written(folder / "run.jsonl", "\n".join(json.dumps(one) for one in records))


def json_array(folder: Path, run: Recorded) -> Path:
    run = run.shuffled()
    records = [
        {"time": t, "joints": [{"name": j, "q": a, "tau": b} for j, a, b in zip(run.joints, q, tau, strict=True)]}
        for t, q, tau in zip(run.t.tolist(), run.q.tolist(), run.tau.tolist(), strict=True)
    ]
    return written(folder / "run.json", json.dumps({"robot": "arm", "samples": records}, indent=1))


def json_columns(folder: Path, run: Recorded) -> Path:
    content = {"t": run.t.tolist(), "q": run.q.tolist(), "qd": run.dq.tolist(), "tau": run.tau.tolist()}
    return written(folder / "columns.json", json.dumps({"log": content}))


def rosbridge(folder: Path, run: Recorded) -> Path:
    run = run.shuffled()
    lines = []
    for k, t in enumerate(run.t):
        header = {"stamp": {"secs": 1_700_000_000 + int(t), "nsecs": round((t - int(t)) * 1e9)}, "frame_id": ""}
        arrays = {"position": run.q[k].tolist(), "velocity": run.dq[k].tolist(), "effort": run.tau[k].tolist()}
        lines.append(json.dumps({"topic": "/joint_states", "msg": {"header": header, "name": run.joints, **arrays}}))
    return written(folder / "bridge.jsonl", "\n".join(lines))


def iso_dates(folder: Path, run: Recorded) -> Path:
    zone = str(run.rng.choice(["", "Z", "+02:00"]))
    begin = datetime(2025, 5, 6, 23, 59, 55, tzinfo=UTC)
    sign = str(run.rng.choice(["T", " "]))
    # As Python writes it, whole seconds have no fraction.
    stamps = [
        (begin + timedelta(microseconds=round(t * 1e6))).replace(tzinfo=None).isoformat(sign) + zone for t in run.t
    ]
    header = ["", "timestamp", *counted("joint{}_pos", run.n, 1), *counted("joint{}_torque", run.n, 1)]
    columns = [[str(k) for k in range(len(run.t))], stamps, *cells(run.q), *cells(run.tau)]
    return written(folder / "iso.csv", table(header, columns))


def epoch(folder: Path, run: Recorded) -> Path:
    factor = int(run.rng.choice([1_000, 1_000_000, 1_000_000_000]))
    stamps = [str(round((1.7e9 * factor) + t * factor)) for t in run.t]
    header = ["index", "epoch", *counted("q_{}", run.n), *counted("torque_{}", run.n)]
    columns = [[str(k) for k in range(len(run.t))], stamps, *cells(run.q), *cells(run.tau)]
    return written(folder / "epoch.csv", table(header, columns))


def german_sheet(folder: Path, run: Recorded) -> Path:
    empty = ";" * (2 * run.n)
    header = ["Zeit", *counted("Position Achse {}", run.n, 1), *counted("Drehmoment Achse {}", run.n, 1)]
    units = ["s", *["rad"] * run.n, *["Nm"] * run.n]
    columns = [[number(v).replace(".", ",") for v in one] for one in np.column_stack([run.t, run.q, run.tau]).T]
    rows = table([], columns, ";", "\r\n")
    head = [f"Messung vom 12.3.2025{empty}", f"Prüfstand 3;Abtastrate 200 Hz{empty[1:]}", empty]
    return written(folder / "sheet.csv", "\r\n".join([*head, ";".join(header), ";".join(units), rows]))


def aligned_columns(folder: Path, run: Recorded) -> Path:
    np.savetxt(folder / "aligned.txt", np.column_stack([run.t, run.q, run.dq, run.tau]), fmt="%16.7e")
    return folder / "aligned.txt"


def timetable(folder: Path, run: Recorded) -> Path:
    header = ["Time", *counted("q_{}", run.n, 1), *counted("tau_{}", run.n, 1)]
    columns = [[f"{number(t)} sec" for t in run.t], *cells(run.q), *cells(run.tau)]
    return written(folder / "timetable.csv", table(header, columns))


def row_a_joint(folder: Path, run: Recorded) -> Path:
    run = run.shuffled()
    lines = ["time,joint,position,velocity,torque"]
    for k, t in enumerate(run.t):
        lines += [
            ",".join([number(t), j, *(number(v) for v in values)])
            for j, *values in zip(run.joints, run.q[k], run.dq[k], run.tau[k], strict=True)
        ]
    return written(folder / "long.csv", "\n".join([*lines, ""]))


def two_headers(folder: Path, run: Recorded) -> Path:
    n = run.n
    first = ["", *["q"] * n, *["tau"] * n]
    second = ["", *(str(k) for k in range(n)), *(str(k) for k in range(n))]
    head = [",".join(first), ",".join(second), "t" + "," * (2 * n)]
    rows = table([], [[number(t) for t in run.t], *cells(run.q), *cells(run.tau)])
    return written(folder / "levels.csv", "\n".join([*head, rows]))


def utf16_tabs(folder: Path, run: Recorded) -> Path:
    header = ["Time [ms]", *(f"Position {k + 1} [{'mm' if slides else '°'}]" for k, slides in enumerate(run.slides))]
    header += [f"Effort {k + 1} [{'N' if slides else 'Nm'}]" for k, slides in enumerate(run.slides)]
    columns = cells(np.column_stack([1e3 * run.t, np.where(run.slides, 1e3, 180 / np.pi) * run.q, run.tau]))
    path = folder / "unicode.txt"
    path.write_bytes(table(header, columns, "\t", "\r\n").encode("utf-16"))
    return path


def gzipped(folder: Path, run: Recorded) -> Path:
    path = folder / "run.csv.gz"
    path.write_bytes(gzip.compress(plain(run).encode()))
    return path


def zstandard(folder: Path, run: Recorded) -> Path:
    path = folder / "run.csv.zst"
    with pa.CompressedOutputStream(pa.OSFile(str(path), "wb"), "zstd") as file:
        file.write(plain(run).encode())
    return path


def plain(run: Recorded) -> str:
    header = ["t", *counted("q{}", run.n, 1), *counted("dq{}", run.n, 1), *counted("tau{}", run.n, 1)]
    return table(header, [[number(t) for t in run.t], *blocks(run)])


def file_a_signal(folder: Path, run: Recorded) -> Path:
    run = run.shuffled()
    every = int(run.rng.choice([1, 2]))
    for name, values, step in (("position", run.q, 1), ("velocity", run.dq, 1), ("effort", run.tau, every)):
        header = ["t", *(f"{joint}_{name}" for joint in run.joints)]
        columns = cells(np.column_stack([run.t[::step], values[::step]]))
        written(folder / f"arm_{name}.csv", table(header, columns))
    return folder / "arm_position.csv+arm_velocity.csv+arm_effort.csv"


def files_alike(folder: Path, run: Recorded) -> Path:
    for name, values in (("positions", run.q), ("torques", run.tau)):
        header = ["time", *run.joints]
        written(folder / f"{name}.csv", table(header, cells(np.column_stack([run.t, values]))))
    return folder / "positions.csv+torques.csv"


def clock_in_a_file(folder: Path, run: Recorded) -> Path:
    for name, values in (("t", run.t[:, None]), ("q", run.q), ("dq", run.dq), ("tau", run.tau)):
        np.savetxt(folder / f"{name}.csv", values, fmt="%.9g")
    return folder / "t.csv+q.csv+dq.csv+tau.csv"


def archive(folder: Path, run: Recorded) -> Path:
    path = folder / "run.zip"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as packed:
        for name, values in (("time", run.t[:, None]), ("q", run.q), ("tau", run.tau)):
            packed.writestr(f"run/{name}.txt", table([], cells(values), " "))
    return path


def no_time(folder: Path, run: Recorded) -> Path:
    np.savetxt(folder / "matrix.txt", np.column_stack([run.q, run.dq, run.tau]))
    return folder / "matrix.txt"


def row_a_motor(folder: Path, run: Recorded) -> Path:
    lines = ["timestamp_us,motor_id,pos,vel,torque"]
    step = 1e6 * float(run.t[1] - run.t[0]) / (2 * run.n)
    for k, t in enumerate(run.t):
        lines += [
            ",".join(
                [str(round(1e6 * t + j * step)), str(j + 1), *(number(one[k, j]) for one in (run.q, run.dq, run.tau))]
            )
            for j in range(run.n)
        ]
    return written(folder / "can.csv", "\n".join([*lines, ""]))


def order_that_changes(folder: Path, run: Recorded) -> Path:
    """Two publishers of one topic that do not agree on the order."""
    lines = ["time,joint_names,positions,efforts"]
    for k, t in enumerate(run.t):
        rows = slice(k, k + 1)
        one = Recorded(run.joints, run.t[rows], run.q[rows], run.dq[rows], run.tau[rows], run.slides, run.rng)
        one = one if k % 3 else one.in_order(list(range(run.n))[::-1])
        lines.append(f'{t:.6f},"{list(one.joints)}","{one.q[0].tolist()}","{one.tau[0].tolist()}"')
    return written(folder / "orders.csv", "\n".join(lines))


def record_a_topic(folder: Path, run: Recorded) -> Path:
    run = run.shuffled()
    lines = []
    for k, t in enumerate(run.t.tolist()):
        states = {"topic": "states", "t": t, "position": dict(zip(run.joints, run.q[k].tolist(), strict=True))}
        motors = {"topic": "motors", "t": t, "torque": dict(zip(run.joints, run.tau[k].tolist(), strict=True))}
        lines += [json.dumps(states), json.dumps(motors)]
    return written(folder / "topics.jsonl", "\n".join(lines))


def controller_state(folder: Path, run: Recorded) -> Path:
    run, n, m = run.sorted(), run.n, len(run.t)
    stamp = [str(1_700_000_000_000_000_000 + round(t * 1e9)) for t in run.t]
    kinds = ("desired.positions", "desired.velocities", "actual.positions", "actual.velocities", "actual.effort")
    header = ["%time", "field.header.stamp", *counted("field.joint_names{}", n)]
    header += [f"field.{kind}{k}" for kind in kinds for k in range(n)]
    wanted = run.q + 0.002 * run.dq
    columns = [stamp, stamp, *([joint] * m for joint in run.joints), *cells(wanted), *cells(run.dq), *blocks(run)]
    return written(folder / "state.csv", table(header, columns))


def mujoco(folder: Path, run: Recorded) -> Path:
    names = [*counted("qpos_{}", run.n), *counted("qvel_{}", run.n), *counted("ctrl_{}", run.n)]
    header = ["time", *names, *counted("qfrc_actuator_{}", run.n)]
    wanted = cells(run.q + 0.003 * run.dq)
    columns = [[number(t) for t in run.t], *cells(run.q), *cells(run.dq), *wanted, *cells(run.tau)]
    return written(folder / "mujoco.csv", table(header, columns))


def rtde_spaces(folder: Path, run: Recorded) -> Path:
    header = [
        "timestamp",
        *counted("actual_q_{}", run.n),
        *counted("actual_qd_{}", run.n),
        *counted("joint_torque_{}", run.n),
    ]
    return written(folder / "rtde.csv", table(header, [[number(51234.0 + t) for t in run.t], *blocks(run)], " "))


def printed_messages(folder: Path, run: Recorded) -> Path:
    """`ros2 topic echo /joint_states > FILE`, with the joints in the order of their names."""
    run = run.in_order(sorted(range(run.n), key=lambda joint: run.joints[joint]))
    lines = []
    for k, t in enumerate(run.t):
        lines += ["header:", "  stamp:", f"    sec: {1700 + int(t)}", f"    nanosec: {round((t % 1) * 1e9)}"]
        lines += ["  frame_id: ''", "name:", *(f"- {joint}" for joint in run.joints)]
        for key, values in (("position", run.q), ("velocity", run.dq), ("effort", run.tau)):
            lines += [f"{key}:", *(f"- {number(value)}" for value in values[k])]
        lines.append("---")
    return written(folder / "echo.yaml", "\n".join([*lines, ""]))


def printed_messages_of_ros_1(folder: Path, run: Recorded) -> Path:
    """`rostopic echo`: lists in brackets, which go on in the next line, and a string of the frame."""
    lines = []
    for k, t in enumerate(run.t):
        lines += ["header: ", f"  seq: {k}", "  stamp: ", f"    secs: {1700 + int(t)}"]
        lines += [
            f"    nsecs: {round((t % 1) * 1e9):9d}",
            '  frame_id: "base link"',
            f"name: [{', '.join(run.joints)}]",
        ]
        for key, values in (("position", run.q), ("velocity", run.dq), ("effort", run.tau)):
            items = [number(value) for value in values[k]]
            lines.append(f"{key}: [{', '.join(items[:2])},\n  {', '.join(items[2:])}]")
        lines.append("---")
    return written(folder / "echo.txt", "\n".join([*lines, ""]))


def printed_names_and_values(folder: Path, run: Recorded) -> Path:
    """What a program printed: the same names again and again, each with its list."""
    lines = []
    for k, t in enumerate(run.t):
        lines.append(f"time: {number(t)}")
        for key, values in (("q", run.q), ("dq", run.dq), ("tau", run.tau), ("tau_ext", 0.0 * run.tau)):
            lines.append(f"{key}:  [{' '.join(number(value) for value in values[k])}]")
        lines.append("")
    return written(folder / "printed.txt", "\n".join(lines))


def list_in_yaml(folder: Path, run: Recorded) -> Path:
    lines = []
    for k, t in enumerate(run.t):
        lines += [f"- t: {number(t)}", f"  q: [{', '.join(map(number, run.q[k]))}]"]
        lines += [f"  tau: [{', '.join(map(number, run.tau[k]))}]"]
    return written(folder / "list.yaml", "\n".join([*lines, ""]))


def printed_dictionaries(folder: Path, run: Recorded) -> Path:
    """Dictionaries as Python prints them, of arrays and NumPy's numbers."""
    lines = [
        f"{{'t': np.float64({number(t)}), 'q': array([{', '.join(map(number, run.q[k]))}]), "
        f"'tau': array([{', '.join(map(number, run.tau[k]))}], dtype=float32), 'ok': True, 'mode': 'run', 'e': None}}"
        for k, t in enumerate(run.t)
    ]
    return written(folder / "printed.log", "\n".join([*lines, ""]))


def structure_of_a_scope(folder: Path, run: Recorded) -> Path:
    """Simulink's structure with time: an array of signals, each with its label."""
    path = folder / "scope.mat"
    signals = np.zeros(3, dtype=[("values", object), ("dimensions", object), ("label", object)])
    named = (("joint position", run.q), ("joint velocity", run.dq), ("joint torque", run.tau))
    for place, (label, values) in enumerate(named):
        signals[place] = (values, float(run.n), label)
    savemat(path, {"ScopeData": {"time": run.t[:, None], "signals": signals, "blockName": "arm/Scope"}})
    return path


def files_by_their_endings(folder: Path, run: Recorded) -> Path:
    """Logs of hrpsys: run.q and run.tau, without names, each with the time in front."""
    paths = [
        written(folder / f"run.{ending}", table([], cells(np.column_stack([12.0 + run.t, values])), " ", " \n"))
        for ending, values in (("q", run.q), ("tau", run.tau))
    ]
    return Path("+".join(map(str, paths)))


def file_a_joint(folder: Path, run: Recorded) -> Path:
    paths = [
        written(
            folder / f"joint{joint + 1}.csv",
            table(
                ["t", "position", "velocity", "torque"],
                [[number(t) for t in run.t], *(cells(values[:, [joint]])[0] for values in (run.q, run.dq, run.tau))],
            ),
        )
        for joint in range(run.n)
    ]
    return Path("+".join(map(str, paths)))


def row_a_motor_with_its_own_clock(folder: Path, run: Recorded) -> Path:
    """The time has no usual name, and runs on between the motors."""
    lines = ["host_ms,loop_ms,motor_id,pos,vel,tau,iq(A),err"]
    for k, t in enumerate(run.t):
        lines += [
            f"{1.7e12 + 1e3 * t + 0.01 * j:.2f},10.0,{j + 1},{number(run.q[k, j])},{number(run.dq[k, j])},"
            f"{number(run.tau[k, j])},{number(0.3 * run.tau[k, j])},0"
            for j in range(run.n)
        ]
    return written(folder / "motors.csv", "\n".join([*lines, ""]))


def other_arm_beside(folder: Path, run: Recorded) -> Path:
    """Another arm in the same file, whose joints are counted, beside those that have the robot's names."""
    t = [number(t) for t in run.t]
    header, columns = ["time"], [t]
    for signal, values in (("position", run.q), ("velocity", run.dq), ("effort", run.tau)):
        header += [f"/other_arm_{joint}/{signal}" for joint in range(run.n)]
        columns += cells(values[::-1])
        header += [f"/{joint}/{signal}" for joint in run.joints]
        columns += cells(values)
    return written(folder / "two_arms.csv", table(header, columns))


def _from(run: Recorded, form: Callable[[datetime], str]) -> list[str]:
    begin = datetime(2025, 5, 6, 11, 58, 57, tzinfo=UTC)
    return [form(begin + timedelta(seconds=float(t))) for t in run.t]


def stamps_of_digits(folder: Path, run: Recorded) -> Path:
    """20250506115857005: more digits than a number keeps."""
    stamps = _from(run, lambda moment: moment.strftime("%Y%m%d%H%M%S%f")[:-3])
    header = ["timestamp", *counted("q{}", run.n), *counted("tau{}", run.n)]
    return written(folder / "digits.csv", table(header, [stamps, *cells(run.q), *cells(run.tau)]))


def minutes_and_seconds(folder: Path, run: Recorded) -> Path:
    stamps = _from(run, lambda moment: moment.strftime("%M:%S.%f")[:-3])
    header = ["Time", *counted("q{}", run.n), *counted("tau{}", run.n)]
    return written(folder / "minutes.csv", table(header, [stamps, *cells(run.q), *cells(run.tau)]))


def rows_behind_signs_of_remarks(folder: Path, run: Recorded) -> Path:
    """What a robot's program writes: a sign, a number, date and time of day, a clock, and no names."""
    days, times = (_from(run, lambda moment, form=form: moment.strftime(form)) for form in ("%Y-%m-%d", "%H:%M:%S"))
    columns = [["# 1"] * len(run.t), days, times, [f"{t:.3f}" for t in run.t], *blocks(run)]
    return written(folder / "rapid.txt", table([], columns, " "))


def written(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8", newline="")
    return path


LAYOUTS: dict[str, Callable[[Path, Recorded], Path]] = {
    one.__name__: one
    for one in (
        rostopic, ros2_echo, bagpy, numpy_cells, bare_lists, sparse_topics, json_lines, json_array, json_columns,
        rosbridge, iso_dates, epoch, german_sheet, aligned_columns, timetable, row_a_joint, two_headers, utf16_tabs,
        gzipped, zstandard, file_a_signal, files_alike, clock_in_a_file, archive, no_time, rtde_spaces,
        row_a_motor, order_that_changes, record_a_topic, controller_state, mujoco, printed_messages,
        printed_messages_of_ros_1, printed_names_and_values, list_in_yaml, printed_dictionaries, structure_of_a_scope,
        files_by_their_endings, file_a_joint, row_a_motor_with_its_own_clock, other_arm_beside,
        stamps_of_digits, minutes_and_seconds, rows_behind_signs_of_remarks,
    )
}  # fmt: skip
BETWEEN_SAMPLES = frozenset({"sparse_topics", "file_a_signal", "row_a_motor", "row_a_motor_with_its_own_clock"})
"""Layouts whose signals have times of their own."""
WITHOUT_TIME = frozenset({"no_time"})
