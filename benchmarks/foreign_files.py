"""Twelve files as others write them, made from a real recording: the same held-out error as the clean ones?

    python benchmarks/foreign_files.py [--files 3]

Each pair of files (30 s to identify, 50 s held out, of the UR10e in ../shared/data) is read as it is proposed; told are
the error, its distance from that of the clean files, and what was asked. With `--files`, of the first so many.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import common
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

import dynident as dy

FOLDER = common.RECORDINGS / "ur10e"
GAINS = (14.87, 13.26, 11.13, 10.62, 11.03, 11.47)
RATED = np.array([10.0, 20.0, 10.0, 2.0, 2.0, 2.0])
"""A: currents in permille are of these."""
WINDOWS = {"id_30s_12harm": (6.76, 37.38), "id_50s_12harm": (3.9, 54.0)}
Table = dict[str, np.ndarray]
J = range(1, 7)


def clean(name: str) -> Table:
    table = pq.read_table(FOLDER / f"{name}.parquet")
    kept = ["t", *(f"{kind}{j}" for kind in ("q", "dq", "current") for j in J)]
    return {column: table[column].to_numpy() for column in kept}


def wide(table: Table, kind: str) -> np.ndarray:
    return np.column_stack([table[f"{kind}{j}"] for j in J])


def text(table: Table, path: Path, delimiter: str = ",", comma: bool = False, names: bool = True) -> Path:
    rows = "\n".join(delimiter.join(f"{value:.10g}" for value in row) for row in np.column_stack(list(table.values())))
    rows = rows.replace(".", ",") if comma else rows
    path.write_text((delimiter.join(table) + "\n" if names else "") + rows + "\n", encoding="utf-8")
    return path


def renamed(table: Table, pattern: dict[str, str], time: str = "time", factor: dict[str, float] | None = None) -> Table:
    factor = factor or {}
    found = {time: table["t"] * factor.get("t", 1.0)}
    for kind, name in pattern.items():
        for j in J:
            found[name.format(j=j, z=j - 1)] = table[f"{kind}{j}"] * factor.get(kind, 1.0)
    return found


def shuffled(table: Table, path: Path) -> Path:
    names = {"q": "joint_{j}_pos", "dq": "joint_{j}_vel", "current": "joint_{j}_cur"}
    theirs = renamed(table, names)
    order = list(theirs)
    np.random.default_rng(3).shuffle(order)
    return text({name: theirs[name] for name in order}, path.with_suffix(".csv"))


def degrees(table: Table, path: Path) -> Path:
    names = {"q": "Angle{j}", "dq": "Speed{j}", "current": "MotorCurrent{j}"}
    factor = {"q": 180 / np.pi, "dq": 30 / np.pi, "t": 1e3}
    return text(renamed(table, names, "Timestamp", factor), path.with_suffix(".csv"))


def milliamperes(table: Table, path: Path) -> Path:
    return text(renamed(table, {"q": "q{j}", "current": "curr{j}"}, factor={"current": 1e3}), path.with_suffix(".csv"))


def permille(table: Table, path: Path) -> Path:
    found = renamed(table, {"q": "ActPos_{j} [rad]"}, "t [s]")
    for j in J:
        found[f"ActTorque_{j} [permille]"] = np.round(table[f"current{j}"] / RATED[j - 1] * 1000, 2)
    return text(found, path.with_suffix(".csv"))


def german(table: Table, path: Path) -> Path:
    names = {"q": "A{j} Winkel [°]", "current": "A{j} Strom [A]"}
    return text(renamed(table, names, "Zeit [s]", {"q": 180 / np.pi}), path.with_suffix(".csv"), ";", comma=True)


def without_names(table: Table, path: Path) -> Path:
    return text(table, path.with_suffix(".csv"), " ", names=False)


def ur_log(table: Table, path: Path) -> Path:
    names = {"q": "actual_q_{z}", "dq": "actual_qd_{z}", "current": "actual_current_{z}"}
    found = renamed(table, names, "timestamp")
    found["timestamp"] = found["timestamp"] + 51234.0
    found |= {f"target_q_{j - 1}": table[f"q{j}"] + 1e-4 for j in J}
    return text(found, path.with_suffix(".csv"), " ")


def mat(table: Table, path: Path) -> Path:
    from scipy.io import savemat

    path = path.with_suffix(".mat")
    arrays = {
        "time": table["t"],
        "pos": wide(table, "q").T,
        "vel": wide(table, "dq").T,
        "cur": wide(table, "current").T,
    }
    savemat(path, {"log": arrays})
    return path


def hdf5(table: Table, path: Path) -> Path:
    import h5py

    path = path.with_suffix(".h5")
    with h5py.File(path, "w") as file:
        group = file.create_group("robot")
        group["timestamp"] = (table["t"] * 1e9).astype(np.int64)
        group["joint_position"], group["motor_current"] = np.rad2deg(wide(table, "q")), wide(table, "current")
    return path


def lerobot(table: Table, path: Path) -> Path:
    path = path.with_suffix(".parquet")
    lists = {
        "observation.position": wide(table, "q"), "observation.current": wide(table, "current"),
    }  # fmt: skip
    columns = {name: pa.array(list(values), pa.list_(pa.float64())) for name, values in lists.items()}
    pq.write_table(pa.table({"timestamp": table["t"], "frame_index": np.arange(len(table["t"])), **columns}), path)
    return path


def bag(table: Table, path: Path) -> Path:
    """Positions and efforts (currents) in one topic of ROS 2."""
    from rosbags.rosbag2 import Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    kind = "sensor_msgs/msg/JointState"
    folder = path.with_suffix("")
    with Writer(folder, version=8) as writer:
        topic = writer.add_connection("/joint_states", kind, typestore=store)
        for stamp, message in states(store, table):
            writer.write(topic, stamp, store.serialize_cdr(message, kind))
    return next(folder.glob("*.db3"))


def mcap(table: Table, path: Path) -> Path:
    """Positions in one topic, efforts in another at twice the rate, between the others' stamps."""
    from mcap.writer import Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    kind = "sensor_msgs/msg/JointState"
    path = path.with_suffix(".mcap")
    fine = {"t": np.repeat(table["t"], 2)}
    fine["t"][1::2][:-1] = (table["t"][:-1] + table["t"][1:]) / 2
    fine["t"] = fine["t"][:-1]
    for j in J:
        fine[f"q{j}"] = np.interp(fine["t"], table["t"], table[f"q{j}"])
        fine[f"current{j}"] = np.interp(fine["t"], table["t"], table[f"current{j}"])
    every = [(stamp, "/joint_states", message) for stamp, message in states(store, table, effort=False)]
    every += [(stamp, "/motor_current", message) for stamp, message in states(store, fine, position=False)]
    definition, _ = store.generate_msgdef(kind, ros_version=2)
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema(name=kind, encoding="ros2msg", data=definition.encode())
        channels = {name: writer.register_channel(name, "cdr", schema) for name in ("/joint_states", "/motor_current")}
        for stamp, topic, message in sorted(every, key=lambda one: one[:2]):
            data = bytes(store.serialize_cdr(message, kind))
            writer.add_message(channels[topic], log_time=stamp, data=data, publish_time=stamp)
        writer.finish()
    return path


def states(store, table: Table, *, position: bool = True, effort: bool = True):
    names = dy.load_robot(FOLDER / "robot.urdf").joint_names
    header, time = store.types["std_msgs/msg/Header"], store.types["builtin_interfaces/msg/Time"]
    state, nothing = store.types["sensor_msgs/msg/JointState"], np.empty(0)
    q, current = wide(table, "q"), wide(table, "current")
    for k, t in enumerate(table["t"]):
        stamp = round((1.7e9 + t) * 1e9)
        at = header(stamp=time(sec=stamp // 10**9, nanosec=stamp % 10**9), frame_id="")
        yield stamp, state(at, list(names), q[k] if position else nothing, nothing, current[k] if effort else nothing)


FILES: dict[str, Callable[[Table, Path], Path]] = {
    "columns renamed and shuffled": shuffled,
    "degrees, rpm, ms": degrees,
    "mA": milliamperes,
    "permille": permille,
    "German decimal commas": german,
    "no header": without_names,
    "UR log": ur_log,
    "MAT": mat,
    "HDF5": hdf5,
    "LeRobot": lerobot,
    "bag of ROS 2": bag,
    "MCAP, two topics at two rates": mcap,
}


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--files", type=int, default=len(FILES), help="of how many writers")
    chosen = dict(list(FILES.items())[: parser.parse_args().files])
    robot = dy.load_robot(FOLDER / "robot.urdf", drive_gains=GAINS)
    tables = {name: clean(name) for name in WINDOWS}

    def error(paths: list[Path], machine: dy.Robot, said: list[dict], start: list[float]) -> float:
        read = [
            dy.read_recordings(path, robot=machine, windows=[(WINDOWS[name][0] - s, WINDOWS[name][1] - s)], **one)
            for path, name, one, s in zip(paths, WINDOWS, said, start, strict=True)
        ]
        return float(dy.identify(machine, read[0], validation=read[1]).identification.held_out.relative_total)

    originals = [FOLDER / f"{name}.parquet" for name in WINDOWS]
    known = error(originals, robot, [{}, {}], [0.0, 0.0])
    rows = [("clean", f"{known:.2%}", "", "")]
    for title, write in chosen.items():
        with tempfile.TemporaryDirectory() as folder:
            paths = [write(tables[name], Path(folder) / name) for name in WINDOWS]
            per_unit = np.array(GAINS) * RATED / 1000 if write is permille else np.array(GAINS)
            machine = dy.load_robot(FOLDER / "robot.urdf", drive_gains=per_unit)
            found = [dy.inspect(path, machine) for path in paths]
            asked = sorted({one.field for one in found[0].questions})
            said: list[dict[str, Any]] = [dict(one.said) for one in found]
            # What is asked of efforts of a joint state is answered: currents.
            for one in said:
                one["columns"] = {name.replace("tau", "current"): theirs for name, theirs in one["columns"].items()}
                one["units"] = {
                    name.replace("tau", "current"): unit
                    for name, unit in one["units"].items()
                    if unit[-1] == "A" or not name.startswith("tau")
                }
            start = [float(table["t"][0]) if write in (bag, mcap) else 0.0 for table in tables.values()]
            start = [-51234.0, -51234.0] if write is ur_log else start
            try:
                value = error(paths, machine, said, start)
                rows.append((title, f"{value:.2%}", f"{value / known - 1:+.2%}", ", ".join(asked) or "nothing"))
            except dy.DynidentError as failure:
                rows.append((title, "-", str(failure)[:90], ", ".join(asked)))
            print(rows[-1], flush=True)
    common.show("Foreign files (file, held-out error, against the clean file, asked)", rows)


if __name__ == "__main__":
    main()
