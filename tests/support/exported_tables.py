"""One recording as tools export it: a row for each value, runs one behind another, pairs of columns, text in cells."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Callable
from datetime import datetime, timedelta
from pathlib import Path

import h5py
import numpy as np
from scipy.io import savemat
from support.logger_layouts import Recorded, cells, counted, number, table, written

Layout = Callable[[Path, Recorded], Path]


def melted(folder: Path, run: Recorded) -> Path:
    """`pandas.melt`: all rows of one signal below those of another."""
    names = [*counted("q{}", run.n, 1), *counted("tau{}", run.n, 1)]
    columns = zip(names, np.column_stack([run.q, run.tau]).T, strict=True)
    rows = [
        f"{number(t)},{name},{number(value)}"
        for name, values in columns
        for t, value in zip(run.t, values, strict=True)
    ]
    return written(folder / "long.csv", "\n".join(["time,variable,value", *rows, ""]))


def joint_below_joint(folder: Path, run: Recorded) -> Path:
    """Tables of each joint, one below another."""
    rows = [
        ",".join([joint, *map(number, row)])
        for k, joint in enumerate(run.joints)
        for row in np.column_stack([run.t, run.q[:, k], run.tau[:, k]])
    ]
    return written(folder / "joints.csv", "\n".join(["joint,time,position,effort", *rows, ""]))


def joint_and_quantity(folder: Path, run: Recorded) -> Path:
    """A row for each value, with the joint and the quantity in columns of their own."""
    signals = (("position", run.q), ("torque", run.tau))
    rows = [
        f"{number(t)},{joint},{name},{number(values[i, k])}"
        for i, t in enumerate(run.t)
        for k, joint in enumerate(run.joints)
        for name, values in signals
    ]
    return written(folder / "tidy.csv", "\n".join(["time,joint,quantity,value", *rows, ""]))


def values_without_a_line_of_names(folder: Path, run: Recorded) -> Path:
    """What a subscriber of MQTT prints: the time, the topic and the value of each message."""
    begin = datetime(2025, 5, 6, 10, 20, 30)
    signals = (("position", run.q), ("torque", run.tau))
    rows = [
        f"{(begin + timedelta(seconds=float(t))).isoformat(timespec='microseconds')}+0200 arm/{name}{k + 1} "
        f"{number(values[i, k])}"
        for i, t in enumerate(run.t)
        for k in range(run.n)
        for name, values in signals
    ]
    return written(folder / "messages.txt", "\n".join([*rows, ""]))


def rows_behind_keys(folder: Path, run: Recorded) -> Path:
    """A recorder of test benches: keys of the head, and one before the units and before every row."""
    names = [*counted("Bench/q{}", run.n, 1), *counted("Bench/trq{}", run.n, 1)]
    units = ["m" if slides else "rad" for slides in run.slides] + ["N" if slides else "Nm" for slides in run.slides]
    head = ["descriptions;run 3", "trace_header", ";".join(["trace_names", "Time", *names])]
    head.append(";".join(["trace_units", "s", *units]))
    values = np.column_stack([run.t, run.q, run.tau])
    rows = [f"trace_values;{';'.join(map(number, row))}" for row in values]
    return written(folder / "bench.csv", "\n".join([*head, *rows, ""]))


def pairs_of_time_and_value(folder: Path, run: Recorded) -> Path:
    """LabVIEW's measurement file with a time for each channel, and a column for comments behind them."""
    names = [*counted("q{}", run.n, 1), *counted("tau{}", run.n, 1)]
    values = np.column_stack([run.q, run.tau])
    between = "\t\t"
    head = [
        "LabVIEW Measurement\t\nX_Columns\tMulti\n***End_of_Header***\t\n\t",
        f"Samples\t{between.join([str(len(run.t))] * len(names))}",
        f"X_Dimension\t{between.join(['Time'] * len(names))}",
        "***End_of_Header***",
        "X_Value\t" + "\tX_Value\t".join(names) + "\tComment",
    ]
    rows = ["\t".join(f"{number(t)}\t{number(value)}" for value in row) for t, row in zip(run.t, values, strict=True)]
    return written(folder / "channels.lvm", "\n".join([*head, *rows, ""]))


def objects_in_cells(folder: Path, run: Recorded) -> Path:
    """A data base's export of messages."""
    rows = []
    for k, t in enumerate(run.t):
        message = json.dumps({"q": run.q[k].tolist(), "tau": run.tau[k].tolist()}).replace('"', '""')
        rows.append(f'{k},{1.7e9 + t:.6f},"{message}"')
    return written(folder / "messages.csv", "\n".join(["id,created_at,payload", *rows, ""]))


def list_below_a_name(folder: Path, run: Recorded) -> Path:
    """YAML whose records stand below a name."""
    lines = ["robot: arm", "log:"]
    for t, q, tau in zip(run.t, run.q, run.tau, strict=True):
        lines += [f"  - t: {number(t)}", f"    q: {q.tolist()}", f"    tau: {tau.tolist()}"]
    return written(folder / "log.yaml", "\n".join([*lines, "end: true", ""]))


def printed_tuples(folder: Path, run: Recorded) -> Path:
    rows = [f"({number(t)}, {q.tolist()}, {tau.tolist()})" for t, q, tau in zip(run.t, run.q, run.tau, strict=True)]
    return written(folder / "printed.txt", "\n".join([*rows, ""]))


def pose_of_the_tool_beside(folder: Path, run: Recorded) -> Path:
    """Joints, the pose of the tool, and torques that are called t1, t2, ….."""
    pose = 300.0 + np.cumsum(run.rng.normal(size=(len(run.t), 6)), axis=0)
    names = [*counted("j{}", run.n, 1), "x", "y", "z", "roll", "pitch", "yaw", *counted("t{}", run.n, 1)]
    columns = [number(1.7e5 + t) for t in run.t], *cells(np.column_stack([run.q, pose, run.tau]))
    return written(folder / "sdk.csv", table(["timestamp", *names], list(columns)))


def data_set_of_diadem(folder: Path, run: Recorded) -> Path:
    """KUKA's trace: a header of text, and the numbers of all channels in another file, scaled, row by row."""
    names = [*counted("AxisAngle_A{}", run.n, 1), *counted("Torque_A{}", run.n, 1)]
    kind = "<f8" if run.n % 2 else ">f8"
    np.column_stack([1e3 * run.q, 1e2 * run.tau]).astype(kind).tofile(folder / "trace.r64")
    m, step = len(run.t), run.t[1] - run.t[0]
    channels = [["200,Time", "202,s", "210,IMPLIZIT", f"220,{m}", "240,0", f"241,{number(step)}"]]
    for k, name in enumerate(names):
        factor = "0.001" if k < run.n else "0.01"
        unit = "Nm" if k >= run.n else "m" if run.slides[k] else "rad"
        stored = ["211,C:\\trace\\trace.r64", "213,BLOCK", "214,REAL64", f"220,{m}", f"221,{k + 1}"]
        channels.append([f"200,{name}", f"202,{unit}", "210,EXPLIZIT", *stored, "240,0", f"241,{factor}"])
    lines = ["DIAEXTENDED  {@:ENGLISH", "#BEGINGLOBALHEADER", "112,High -> Low", "#ENDGLOBALHEADER"]
    for channel in channels:
        lines += ["#BEGINCHANNELHEADER", *channel, "#ENDCHANNELHEADER"]
    return written(folder / "trace.dat", "\r\n".join([*lines, ""]))


def arrays_of_numpy_apart(folder: Path, run: Recorded) -> Path:
    for name, values in (("t", run.t), ("q", run.q), ("tau", run.tau)):
        np.save(folder / f"{name}.npy", values)
    return Path("+".join(str(folder / f"{name}.npy") for name in ("t", "q", "tau")))


def merged_heads(folder: Path, run: Recorded) -> Path:
    """A sheet whose heads stand over several columns each: only the first of them has the word."""
    empty = [""] * (run.n - 1)
    names = ["Time", *counted("J{}", run.n, 1), *counted("J{}", run.n, 1)]
    text = table(names, cells(np.column_stack([run.t, run.q, run.tau])))
    return written(folder / "merged.csv", ",".join(["", "Position", *empty, "Torque", *empty]) + "\n" + text)


def objects_of_joints(folder: Path, run: Recorded) -> Path:
    """JSON with an object for each joint, which holds its arrays."""
    joints = [
        {"name": name, "pos": run.q[:, k].tolist(), "tau": run.tau[:, k].tolist()} for k, name in enumerate(run.joints)
    ]
    return written(folder / "joints.json", json.dumps({"t": run.t.tolist(), "joints": joints}))


def records_of_numpy(folder: Path, run: Recorded) -> Path:
    kinds = [("time", "f8"), ("q", "f8", (run.n,)), ("tau", "f8", (run.n,)), ("mode", "U8")]
    log = np.zeros(len(run.t), dtype=kinds)
    log["time"], log["q"], log["tau"], log["mode"] = run.t, run.q, run.tau, "run"
    np.savez(folder / "log.npz", log=log)
    return folder / "log.npz"


def messages_of_a_simulator(folder: Path, run: Recorded) -> Path:
    """Messages of protobuf as `gz topic --echo` prints them: numbers that are 0 are left out."""

    def fields(indent: str, values: dict[str, float]) -> str:
        return "".join(f"{indent}{name}: {number(value)}\n" for name, value in values.items() if value)

    text = ""
    for t, q, tau in zip(run.t, run.q, run.tau, strict=True):
        nanoseconds = round(1e9 * t)
        stamp = fields("    ", {"sec": nanoseconds // 10**9, "nsec": nanoseconds % 10**9})
        text += f'header {{\n  stamp {{\n{stamp}  }}\n}}\nname: "arm"\n'
        for k, joint in enumerate(run.joints):
            axis = fields("    ", {"position": q[k], "force": tau[k]})
            text += f'joint {{\n  name: "{joint}"\n  axis1 {{\n    xyz {{\n      z: 1\n    }}\n{axis}  }}\n}}\n'
    return written(folder / "echo.txt", text)


def values_beside_their_names(folder: Path, run: Recorded) -> Path:
    """`ros2 topic echo /dynamic_joint_states`: the joints, and what each number is, stand in lists of their own."""
    text = ""
    for t, q, tau in zip(run.t, run.q, run.tau, strict=True):
        text += (
            f"header:\n  stamp:\n    sec: {1700000000 + int(t)}\n    nanosec: {round(1e9 * (t % 1.0))}\njoint_names:\n"
        )
        text += "".join(f"- {joint}\n" for joint in reversed(run.joints)) + "interface_values:\n"
        for k in reversed(range(run.n)):
            text += "- interface_names:\n  - effort\n  - position\n  values:\n"
            text += f"  - {number(tau[k])}\n  - {number(q[k])}\n"
        text += "---\n"
    return written(folder / "dynamic.yaml", text)


def printed_objects(folder: Path, run: Recorded) -> Path:
    """Dataclasses of Python, with arrays of NumPy."""
    rows = [
        f"State(t={number(t)}, q=array([{', '.join(map(number, q))}]), tau=array({tau.tolist()}), ok=True)"
        for t, q, tau in zip(run.t, run.q, run.tau, strict=True)
    ]
    return written(folder / "objects.log", "\n".join([*rows, ""]))


def structures_of_rust(folder: Path, run: Recorded) -> Path:
    """What `{:?}` prints of a structure."""
    rows = [
        f"JointState {{ t: {number(t)}, q: {q.tolist()}, tau: {tau.tolist()}, mode: Running }}"
        for t, q, tau in zip(run.t, run.q, run.tau, strict=True)
    ]
    return written(folder / "debug.log", "\n".join([*rows, ""]))


def answer_of_a_data_base(folder: Path, run: Recorded) -> Path:
    """InfluxDB's answer: names of columns, and rows, deep in an object."""
    names = ["time", *counted("q{}", run.n, 1), *counted("tau{}", run.n, 1)]
    series = {"name": "arm", "columns": names, "values": np.column_stack([run.t, run.q, run.tau]).tolist()}
    return written(folder / "answer.json", json.dumps({"results": [{"statement_id": 0, "series": [series]}]}))


def objects_by_their_times(folder: Path, run: Recorded) -> Path:
    records = {number(t): {"q": q.tolist(), "tau": u.tolist()} for t, q, u in zip(run.t, run.q, run.tau, strict=True)}
    return written(folder / "times.json", json.dumps(records))


def durations_of_iso(folder: Path, run: Recorded) -> Path:
    header = ["t", *counted("q{}", run.n, 1), *counted("tau{}", run.n, 1)]
    t = [f"PT{number(t)}S" if t < 3.0 else f"PT0M{number(t)}S" for t in run.t]
    return written(folder / "iso.csv", table(header, [t, *cells(np.column_stack([run.q, run.tau]))]))


def rate_in_a_remark(folder: Path, run: Recorded) -> Path:
    text = table([*counted("q{}", run.n, 1), *counted("tau{}", run.n, 1)], cells(np.column_stack([run.q, run.tau])))
    rate = (len(run.t) - 1) / (run.t[-1] - run.t[0])
    return written(folder / "rate.csv", f"# Robot: arm\n# Sampling rate: {rate:.6g} Hz\n{text}")


def tags_with_milliseconds_apart(folder: Path, run: Recorded) -> Path:
    """A historian that writes the milliseconds of a time of day in a column of their own."""
    rows = ["Date,Time,Millitm,TagName,Value,Status,Marker"]
    for t, q, tau in zip(run.t, run.q, run.tau, strict=True):
        second, part = divmod(round(1e3 * t), 1000)
        for k in range(run.n):
            begin = f"05/06/2024,13:04:{second:02d},{part},[PLC]Axis{k + 1}"
            rows += [f"{begin}.ActPos,{number(q[k])},,B", f"{begin}.ActTorque,{number(tau[k])},,B"]
    return written(folder / "trend.csv", "\n".join([*rows, ""]))


def further_axis(folder: Path, run: Recorded) -> Path:
    """A rail that stands and has noise in its torque, below names that do not say what the columns are."""
    noise = run.rng.normal(size=len(run.t))
    values = np.column_stack([run.t, run.q, np.full(len(run.t), 1.25), run.tau, noise])
    header = ["Time", *counted("A{}", run.n, 1), "E1", *counted("M_A{}", run.n, 1), "M_E1"]
    return written(folder / "rail.csv", table(header, cells(values)))


def slots_of_a_simulator(folder: Path, run: Recorded) -> Path:
    """PyBullet's log: places for more joints than the robot has, q, u and t."""
    rest = np.zeros((len(run.t), 12 - run.n))
    parts = [part for signal in (run.q, run.dq, run.tau) for part in (signal, rest)]
    header = ["stepCount", "timeStamp", *counted("q{}", 12), *counted("u{}", 12), *counted("t{}", 12)]
    return written(folder / "slots.csv", table(header, cells(np.column_stack([np.arange(len(run.t)), run.t, *parts]))))


def stamps_in_brackets(folder: Path, run: Recorded) -> Path:
    """Sunrise's log: whole seconds and nanoseconds, their units behind one name."""
    t = 1.65e9 + 0.25 + run.t
    stamps = [[f"{int(s)}" for s in t], [f"{round(1e9 * (s % 1.0))}" for s in t]]
    header = ["Time[s]", "Time[ns]", *counted("msrTrq_{}", run.n), *counted("msrJntPos_{}", run.n)]
    values = [*stamps, *cells(np.column_stack([run.tau, run.q]))]
    return written(folder / "log.csv", table(header, values))


def messages_of_a_bus(folder: Path, run: Recorded) -> Path:
    """Decoded frames: a row for each signal, whose message is that of the joint."""
    rows = [
        f"{number(t)},DRIVE{k + 1}_STATUS,{name},{number(values[i, k])},{unit}"
        for i, t in enumerate(run.t)
        for k in range(run.n)
        for name, values, unit in (("Position", run.q, "rad"), ("Torque", run.tau, "Nm"))
    ]
    return written(folder / "bus.csv", "\n".join(["timestamp,message,signal,value,unit", *rows, ""]))


def braces_behind_a_time_of_day(folder: Path, run: Recorded) -> Path:
    """What a program of a teach pendant writes, below a line of its own."""
    begin = datetime(2025, 5, 6, 10, 59, 55)
    lists = [[",".join(map(number, row)) for row in rows] for rows in (run.q, run.tau)]
    rows = [
        f"{(begin + timedelta(seconds=float(t))).strftime('%H:%M:%S.%f')} jPos={{{q}}} jTorque={{{tau}}}"
        for t, q, tau in zip(run.t, *lists, strict=True)
    ]
    return written(folder / "pendant.txt", "\n".join(["logger started", *rows, ""]))


def numbers_in_brackets(folder: Path, run: Recorded) -> Path:
    """What a port of YARP is dumped to: a count, a stamp, and groups of numbers with their states."""
    groups = [[" ".join(map(number, row)) for row in rows] for rows in (run.q, run.dq, run.tau)]
    rows = [
        f"{k + 900} {1.7e9 + t:.6f} ({q}) [ok] ({dq}) [ok] ({tau}) [ok]"
        for k, (t, q, dq, tau) in enumerate(zip(run.t, *groups, strict=True))
    ]
    return written(folder / "data.log", "\n".join([*rows, ""]))


def properties_below_the_names(folder: Path, run: Recorded) -> Path:
    """LabVIEW's export of waveforms: the length, the unit and the step of time of each channel, and no time."""
    names = [*counted("Axis{}_Position", run.n, 1), *counted("Axis{}_Torque", run.n, 1)]
    units = ["m" if slides else "rad" for slides in run.slides] + ["N" if slides else "Nm" for slides in run.slides]
    values, step = np.column_stack([run.q, run.tau]), number(run.t[1] - run.t[0])
    head = [("Root Name", "Title"), ("run", "4"), ("Channel", *names), ("Length", *[str(len(run.t))] * len(names))]
    head += [("Minimum", *map(number, values.min(axis=0))), ("unit_string", *units)]
    head += [("wf_increment", *[step] * len(names))]
    rows = ["\t".join(["", *map(number, row)]) for row in values]
    return written(folder / "waveforms.txt", "\n".join(["\t".join(line) for line in head] + [*rows, ""]))


def answer_of_a_query(folder: Path, run: Recorded) -> Path:
    """InfluxDB's annotated CSV: a row for each value, tables by field, and behind them one of words."""
    begin = datetime(2026, 3, 11, 8, 12, 3)
    stamps = [(begin + timedelta(seconds=float(t))).isoformat(timespec="microseconds") + "Z" for t in run.t]
    bounds = "2026-03-11T08:12:00Z,2026-03-11T08:13:00Z"
    types = "string,long,dateTime:RFC3339,dateTime:RFC3339,dateTime:RFC3339"
    head = ["#group,false,false,true,true,false,false,true,true,true", f"#datatype,{types},double,string,string,string"]
    head += ["#default,_result,,,,,,,,", ",result,table,_start,_stop,_time,_value,_field,_measurement,joint"]
    series = [(name, k) for name in ("effort", "position", "velocity") for k in range(run.n)]
    values = {"effort": run.tau, "position": run.q, "velocity": run.dq}
    rows = [
        f",,{number},{bounds},{stamp},{value:.9g},{name},joint_state,{run.joints[k]}"
        for number, (name, k) in enumerate(series)
        for stamp, value in zip(stamps, values[name][:, k], strict=True)
    ]
    words = ["", *head[:1], f"#datatype,{types},string,string,string", "#default,_result,,,,,,,"]
    words += [",result,table,_start,_stop,_time,_value,_field,_measurement"]
    words += [f",,99,{bounds},{stamp},AUT,mode,controller" for stamp in stamps[:5]]
    return written(folder / "query.csv", "\r\n".join([*head, *rows, *words, ""]))


def variables_of_a_controller(folder: Path, run: Recorded) -> Path:
    """CODESYS's storage of data: time in us, path, value and type of each variable, without a line of names."""
    rows = ["1773216000000000|Device.Application.PRG_Main.iState|20|INT"]
    for t, q, tau in zip(run.t, run.q, run.tau, strict=True):
        for k in range(run.n):
            begin = f"{1773216000000000 + round(1e6 * t)}|Device.Application.GVL_Rob.aAxis[{k + 1}]"
            slides = run.slides[k]
            position = f"lrActPos_m|{q[k]:.9g}" if slides else f"lrActPos_deg|{np.degrees(q[k]):.9g}"
            rows += [f"{begin}.{position}|LREAL", f"{begin}.lrActTrq_{'N' if slides else 'Nm'}|{tau[k]:.9g}|LREAL"]
            rows.append(f"{begin}.bInPosition|TRUE|BOOL")
    return written(folder / "storage.csv", "\n".join([*rows, ""]))


def keys_with_lists(folder: Path, run: Recorded) -> Path:
    """AdvantageScope's list: time, key and value, which may be a list, a word or a number; commands stand beside."""
    rows = ["Timestamp,Key,Value", '2.5,/RealMetadata/ProjectName,"Arm, 2026"', "2.5,/DriverStation/Enabled,false"]
    for i, t in enumerate(run.t):
        lists = (("AppliedTorqueNm", run.tau[i]), ("PositionsRad", run.q[i]), ("SetpointsRad", np.round(run.q[i], 2)))
        rows += [f'{10.0 + t:.6f},/Arm/{name},"[{",".join(map(number, values))}]"' for name, values in lists]
        if i % 50 == 0:
            rows.append(f"{10.0 + t:.6f},/SystemStats/BatteryVoltage,{12.0 + 0.1 * run.rng.random():.3f}")
    return written(folder / "list.csv", "\n".join([*rows, ""]))


def lying_table(folder: Path, run: Recorded) -> Path:
    """A row for each signal, with its name in front."""
    names = ["time", *counted("joint position {}", run.n, 1), *counted("joint torque {}", run.n, 1)]
    rows = zip(names, np.column_stack([run.t, run.q, run.tau]).T, strict=True)
    return written(folder / "lying.csv", "\n".join([",".join([name, *map(number, row)]) for name, row in rows]))


def blocks_with_titles(folder: Path, run: Recorded) -> Path:
    """Traces of a controller, one below another, with the same names and units of their own."""
    lines = ["*** DATA STORAGE  26/03/12 09:41"]
    unit = "mm" if run.slides[0] else "deg"
    signals = (
        (f"ANGLE (FEEDBACK)|{unit}", run.q),
        (f"SPEED (FEEDBACK)|{unit}/s", run.dq),
        ("TORQUE, JOINT|Nm", run.tau),
    )
    for label, values in signals:
        title, _, unit = label.partition("|")
        shown = np.degrees(values) if unit.startswith("deg") else values
        lines += [
            "",
            f"[{title}]",
            f"UNIT={unit}",
            f"SAMPLES={len(run.t)}",
            "\t".join(["Time[ms]", *counted("JT{}", run.n, 1)]),
        ]
        lines += ["\t".join([number(1e3 * t), *map(number, row)]) for t, row in zip(run.t, shown, strict=True)]
    return written(folder / "traces.txt", "\n".join([*lines, ""]))


def capture_with_keys(folder: Path, run: Recorded) -> Path:
    """A capture of an experiment: a key before names, types, units and the first row; commands before the signals."""
    places = [f'"Root/{path}[{k}]"' for path in ("Ref/theta_d", "Sensors/theta", "Drives/M_out") for k in range(run.n)]
    units = 2 * ["mm" if slides else "°" for slides in run.slides] + ["N" if slides else "Nm" for slides in run.slides]
    angles = np.where(run.slides, 1e3 * run.q, np.degrees(run.q))
    values = np.column_stack([run.t, np.round(angles), angles, run.tau])
    rows = [";".join(["", *map(number, row)]) for row in values]
    head = ["capture;Task 1;period;0.002", ";".join(["path", "Time", *places])]
    head += [";".join(["type", *["float64"] * values.shape[1]]), ";".join(["unit", "s", *units])]
    return written(folder / "capture.csv", "\n".join([*head, f"trace_values{rows[0]}", *rows[1:], ""]))


def titles_in_chinese(folder: Path, run: Recorded) -> Path:
    """A pendant's table in the encoding of its country, with commands, a row number and a word of state."""
    names = [f"关节{k + 1}{what}" for what in ("指令角度(度)", "实际角度(度)", "实际力矩(牛·米)") for k in range(run.n)]
    angles = np.degrees(run.q)
    values = np.column_stack([1e3 * run.t, np.round(angles, 1), angles, run.tau])
    columns = [[str(k + 1) for k in range(len(run.t))], *cells(values), ["运行"] * len(run.t)]
    text = table(["序号", "时间(毫秒)", *names, "运行状态"], columns)
    (folder / "pendant.csv").write_bytes(text.encode("gb18030"))
    return folder / "pendant.csv"


def counts_of_a_timer(folder: Path, run: Recorded) -> Path:
    """Stamps of a 16-bit timer that counts steps of 10 us."""
    counts = [str((51235 + round(1e5 * t)) % 65536) for t in run.t]
    names = ["tick_10us", *counted("pos_{}", run.n, 1), *counted("trq_{}", run.n, 1)]
    return written(folder / "ticks.csv", table(names, [counts, *cells(np.column_stack([run.q, run.tau]))]))


def tensors_in_cells(folder: Path, run: Recorded) -> Path:
    """What `str` makes of the tensors of a batch of one environment."""
    columns = [
        [f"tensor([[{', '.join(f'{value: .9e}' for value in row)}]], device='cuda:0')" for row in values]
        for values in (run.q, run.dq, run.tau)
    ]
    header = ["step", "sim_time", "joint_pos", "joint_vel", "applied_torque"]
    lines = zip(map(str, range(len(run.t))), map(number, run.t), *columns, strict=True)
    text = "\n".join(",".join([step, t, *(f'"{cell}"' for cell in row)]) for step, t, *row in lines)
    return written(folder / "tensors.csv", f"{','.join(header)}\n{text}\n")


def names_before_lists(folder: Path, run: Recorded) -> Path:
    """What a program prints of each step: a name, a comma, and an array of NumPy, which may go on in the next line."""
    text = ""
    for t, q, dq, tau in zip(run.t, run.q, run.dq, run.tau, strict=True):
        text += f"mujoco_time, {number(t)}\n"
        for name, values in (("qpos", q), ("qvel", dq), ("qfrc_actuator", tau)):
            text += f"{name}, {np.array2string(values, precision=10, max_line_width=75)}\n"
        text += "\n"
    return written(folder / "printed.csv", text)


def words_in_cells_below_the_names(folder: Path, run: Recorded) -> Path:
    """The data inspector of Simulink: below the names, words before what each signal has."""
    names = [*counted("q({})", run.n, 1), *counted("tau({})", run.n, 1)]
    units = ["mm" if slides else "deg" for slides in run.slides] + ["N" if slides else "N*m" for slides in run.slides]
    facts = {"Type": ["double"] * len(names), "Unit": units, "BlockPath": ["rig/Arm"] * len(names)}
    lines = [["time", *names], *(["", *(f"{word}: {value}" for value in values)] for word, values in facts.items())]
    factors = np.where(run.slides, 1e3, np.degrees(1.0))
    for t, q, tau in zip(run.t, run.q * factors, run.tau, strict=True):
        lines.append([number(t), *map(number, q), *map(number, tau)])
    return written(folder / "inspector.csv", "\n".join([*map(",".join, lines), ""]))


EXPORTED_TABLES: dict[str, Layout] = {
    layout.__name__: layout
    for layout in (
        melted, joint_below_joint, joint_and_quantity, pairs_of_time_and_value, objects_in_cells, list_below_a_name,
        printed_tuples, pose_of_the_tool_beside, data_set_of_diadem, arrays_of_numpy_apart, merged_heads,
        objects_of_joints, records_of_numpy, messages_of_a_simulator, values_beside_their_names, printed_objects,
        structures_of_rust, answer_of_a_data_base, objects_by_their_times, rate_in_a_remark, durations_of_iso,
        tags_with_milliseconds_apart, further_axis, slots_of_a_simulator,
        stamps_in_brackets, messages_of_a_bus, values_without_a_line_of_names, rows_behind_keys,
        braces_behind_a_time_of_day, numbers_in_brackets, properties_below_the_names, answer_of_a_query,
        variables_of_a_controller, keys_with_lists, lying_table, blocks_with_titles, capture_with_keys,
        titles_in_chinese, counts_of_a_timer, tensors_in_cells, names_before_lists, words_in_cells_below_the_names,
    )
}  # fmt: skip


def split_runs(run: Recorded) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Two runs of different lengths, each with a clock of its own from 0."""
    cut = 2 * len(run.t) // 5
    parts = (slice(None, cut), slice(cut, None))
    return [(run.t[part] - run.t[part][0], run.q[part], run.tau[part]) for part in parts]


def runs_in_structures(folder: Path, run: Recorded) -> Path:
    runs = np.zeros(2, dtype=[("t", object), ("q", object), ("tau", object)])
    for k, part in enumerate(split_runs(run)):
        runs[k] = part
    savemat(folder / "runs.mat", {"runs": runs})
    return folder / "runs.mat"


def runs_in_groups(folder: Path, run: Recorded) -> Path:
    with h5py.File(folder / "runs.h5", "w") as file:
        for k, part in enumerate(split_runs(run)):
            file[f"data/demo_{k}/actions"] = part[1]
            for name, values in zip(("obs/t", "obs/q", "obs/tau"), part, strict=True):
                file[f"data/demo_{k}/{name}"] = values
    return folder / "runs.h5"


def runs_in_objects(folder: Path, run: Recorded) -> Path:
    runs = [{name: values.tolist() for name, values in zip(("t", "q", "tau"), part, strict=True)}
            for part in split_runs(run)]  # fmt: skip
    return written(folder / "runs.json", json.dumps({"robot": "arm", "runs": runs}))


def runs_in_an_archive(folder: Path, run: Recorded) -> Path:
    header = ["t", *counted("q{}", run.n, 1), *counted("tau{}", run.n, 1)]
    with zipfile.ZipFile(folder / "runs.zip", "w") as archive:
        # In the order of their numbers, not in that of the archive.
        for k, part in reversed(list(enumerate(split_runs(run)))):
            archive.writestr(f"log/run_{9 + k}.csv", table(header, cells(np.column_stack(part))))
    return folder / "runs.zip"


def refer(file: h5py.File, name: str, targets: list[h5py.Group | h5py.Dataset | None]) -> None:
    """Write cells as MATLAB 7.3 does: references to what lies elsewhere in the file, or to nothing."""
    cells = file.create_dataset(name, (len(targets), 1), dtype=h5py.special_dtype(ref=h5py.Reference))
    for k, target in enumerate(targets):
        if target is not None:
            cells[k, 0] = target.ref


def runs_in_cells(folder: Path, run: Recorded) -> Path:
    """MATLAB 7.3: a cell of structures, {run1, run2}, and an empty cell."""
    with h5py.File(folder / "cells.mat", "w") as file:
        groups = []
        for k, part in enumerate(split_runs(run)):
            groups.append(file.create_group(f"#refs#/{'ba'[k]}"))
            for name, values in zip(("t", "q", "tau"), part, strict=True):
                groups[-1][name] = np.atleast_2d(values.T)
        refer(file, "runs", [*groups, None])
    return folder / "cells.mat"


def runs_in_fields(folder: Path, run: Recorded) -> Path:
    """MATLAB 7.3: an array of structures, whose fields are lists of cells."""
    with h5py.File(folder / "fields.mat", "w") as file:
        for column, name in enumerate(("t", "q", "tau")):
            targets: list[h5py.Group | h5py.Dataset | None] = []
            for k, part in enumerate(split_runs(run)):
                targets.append(file.create_dataset(f"#refs#/{name}{k}", data=np.atleast_2d(part[column].T)))
            refer(file, f"runs/{name}", targets)
    return folder / "fields.mat"


FILES_OF_RUNS: dict[str, Layout] = {
    layout.__name__: layout
    for layout in (
        runs_in_structures, runs_in_groups, runs_in_objects, runs_in_an_archive, runs_in_cells, runs_in_fields,
    )
}  # fmt: skip
