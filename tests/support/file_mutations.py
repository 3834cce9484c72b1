"""Small valid files of every format that is read, what damages them, and what reads them in a process of its own.

As a program it reads mutants one by one and prints a line a mutant:
`python tests/support/file_mutations.py mcap 1 0 100`.
"""

from __future__ import annotations

import faulthandler
import gzip
import io
import json
import os
import resource
import signal
import sqlite3
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

ROWS = 300
JOINTS = ("shoulder", "elbow")
JOINT_STATE = "sensor_msgs/msg/JointState"
SECONDS = 20.0
"""For one mutant; a whole file of this size takes some hundredths."""
ROOM = 3 * 2**30
"""Bytes of address space that a reader may take beyond those that it starts with."""


def signals() -> dict[str, np.ndarray]:
    t = np.arange(ROWS) * 0.005
    q = np.column_stack([np.sin(3 * t), np.cos(4 * t)])
    dq = np.column_stack([3 * np.cos(3 * t), -4 * np.sin(4 * t)])
    tau = np.array([-9.0, -16.0]) * q + 2 * dq + 3 * np.sign(dq)
    return {"t": t, "q": q, "tau": tau}


def written(write: Callable[[Path], object], name: str) -> bytes:
    """What `write` puts into a file."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / name
        write(path)
        return path.read_bytes()


def hdf5_file() -> bytes:
    import h5py

    def write(path: Path) -> None:
        with h5py.File(path, "w", libver="earliest") as file:
            group = file.create_group("log")
            group["t"] = signals()["t"]
            group.create_dataset("q", data=signals()["q"], chunks=(64, 2), compression="gzip", shuffle=True)
            group.create_dataset("tau", data=signals()["tau"], chunks=(50, 1), fletcher32=True)
            table = np.zeros(ROWS, dtype=[("word", "S4"), ("value", "f4"), ("three", "f8", 3)])
            file.create_dataset("table", data=table, chunks=(100,), compression="lzf")

    return written(write, "run.h5")


def parquet_file() -> bytes:
    import pyarrow as pa
    import pyarrow.parquet as pq

    values = signals()
    columns: dict[str, Any] = {"t": values["t"]}
    columns |= {f"{kind}{j + 1}": values[kind][:, j] for kind in ("q", "tau") for j in range(2)}
    columns["pose"] = pa.array(list(values["q"]), pa.list_(pa.float64()))
    columns["mode"] = pa.array(["a", "b", "c"] * (ROWS // 3))
    return written(lambda path: pq.write_table(pa.table(columns), path, row_group_size=100), "run.parquet")


def npy_file() -> bytes:
    values = signals()
    whole = np.column_stack([values["t"], values["q"], values["tau"]])
    return written(lambda path: np.save(path, whole), "run.npy")


def npz_file() -> bytes:
    return written(lambda path: np.savez_compressed(path, **signals()), "run.npz")


def mat_file(compressed: bool = True) -> bytes:
    from scipy.io import savemat

    content = {"log": signals(), "note": "text", "gain": 2.0}
    return written(lambda path: savemat(path, content, do_compression=compressed), "run.mat")


def _states(store: Any) -> Iterator[tuple[int, Any]]:
    types, values = store.types, signals()
    for k, t in enumerate(values["t"]):
        stamp = round((1000 + t) * 1e9)
        time = types["builtin_interfaces/msg/Time"](sec=stamp // 10**9, nanosec=stamp % 10**9)
        sequence = {"seq": k} if any(name == "seq" for name, _ in store.fielddefs["std_msgs/msg/Header"][1]) else {}
        header = types["std_msgs/msg/Header"](**sequence, stamp=time, frame_id="")
        yield stamp, types[JOINT_STATE](header, list(JOINTS), values["q"][k], np.zeros(0), values["tau"][k])


def rosbag1_file() -> bytes:
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_typestore

    def write(path: Path) -> None:
        store = get_typestore(Stores.ROS1_NOETIC)
        writer = Writer(path)
        writer.set_compression(Writer.CompressionFormat.BZ2)
        with writer:
            topic = writer.add_connection("/joint_states", JOINT_STATE, typestore=store)
            for stamp, message in _states(store):
                writer.write(topic, stamp, store.serialize_ros1(message, JOINT_STATE))

    return written(write, "run.bag")


def rosbag2_file() -> bytes:
    from rosbags.typesys import Stores, get_typestore

    def write(path: Path) -> None:
        store = get_typestore(Stores.ROS2_HUMBLE)
        base = sqlite3.connect(path)
        base.execute("CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL)")
        base.execute("CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB)")
        base.execute("CREATE INDEX timestamp_idx ON messages (timestamp ASC)")
        base.execute("INSERT INTO topics VALUES (1, '/joint_states', ?)", (JOINT_STATE,))
        rows = [(stamp, bytes(store.serialize_cdr(message, JOINT_STATE))) for stamp, message in _states(store)]
        base.executemany("INSERT INTO messages(topic_id, timestamp, data) VALUES (1, ?, ?)", rows)
        base.commit()
        base.close()

    return written(write, "run.db3")


def mcap_file(compression: str = "ZSTD", chunked: bool = True) -> bytes:
    from mcap.writer import CompressionType, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    text, _ = store.generate_msgdef(JOINT_STATE, ros_version=2)
    out = io.BytesIO()
    writer = Writer(out, chunk_size=8192, compression=CompressionType[compression], use_chunking=chunked)
    writer.start()
    schema = writer.register_schema(name=JOINT_STATE, encoding="ros2msg", data=text.encode())
    channel = writer.register_channel("/joint_states", "cdr", schema)
    for stamp, message in _states(store):
        data = bytes(store.serialize_cdr(message, JOINT_STATE))
        writer.add_message(channel, log_time=stamp, data=data, publish_time=stamp)
    writer.finish()
    return out.getvalue()


def _rows() -> Iterator[list[float]]:
    values = signals()
    yield from (row.tolist() for row in np.column_stack([values["t"], values["q"], values["tau"]]))


def csv_file(head: str = "t,q1,q2,tau1,tau2") -> bytes:
    return "\n".join([head, *(",".join(map(repr, row)) for row in _rows()), ""]).encode()


def worded_csv_file() -> bytes:
    """Written times, names of joints in cells, and lists."""
    lines = ["stamp,name,position,effort"]
    for t, *row in _rows():
        lines.append(f'2025-05-06T10:20:{30 + t:09.6f}Z,"{list(JOINTS)}","({row[0]}, {row[1]})",[{row[2]} {row[3]}]')
    return "\n".join(lines).encode()


def sparse_csv_file() -> bytes:
    lines = ["__time,a/q1,a/q2,b/tau1,b/tau2"]
    for t, *row in _rows():
        lines += [f"{t!r},{row[0]!r},{row[1]!r},,", f"{t + 0.002!r},,,{row[2]!r},{row[3]!r}"]
    return "\n".join(lines).encode()


def jsonl_file() -> bytes:
    records = ({"t": t, "q": row[:2], "arm": {"tau": row[2:], "mode": "run"}} for t, *row in _rows())
    return "\n".join(json.dumps(one) for one in records).encode()


def json_file() -> bytes:
    t, *rest = np.array(list(_rows())).T
    content = {"t": t.tolist(), "q": np.array(rest[:2]).T.tolist(), "tau": np.array(rest[2:]).tolist()}
    return json.dumps({"log": content}).encode()


def zip_file() -> bytes:
    out = io.BytesIO()
    table = np.array(list(_rows()))
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, values in (("t", table[:, :1]), ("q", table[:, 1:3]), ("tau", table[:, 3:])):
            archive.writestr(f"{name}.csv", "\n".join(" ".join(map(repr, row)) for row in values.tolist()))
    return out.getvalue()


def zst_file() -> bytes:
    import pyarrow as pa

    return bytes(pa.compress(csv_file(), "zstd", asbytes=True))


MJCF = """<mujoco model="arm"><compiler angle="radian"/><option gravity="0 0 -9.81"/><worldbody>
<body name="one" pos="0 0 .3"><joint name="shoulder" axis="0 0 1" range="-2 2" limited="true"/>
<inertial pos="0 0 .1" mass="2" diaginertia=".1 .1 .1"/>
<body name="two" pos=".4 0 0" euler="0 .2 0"><joint name="elbow" axis="0 1 0"/>
<geom type="box" size=".1 .05 .05" mass="1"/><site name="tip" pos=".2 0 0"/></body></body></worldbody>
<actuator><motor joint="shoulder" forcerange="-50 50" gear="2"/><motor joint="elbow"/></actuator></mujoco>"""

URDF = """<robot name="arm"><link name="base"/>
<link name="one"><inertial><mass value="2"/><inertia ixx=".1" ixy="0" ixz="0" iyy=".1" iyz="0" izz=".1"/></inertial>
<collision><origin xyz="0 0 .1" rpy="0 .3 0"/><geometry><cylinder radius=".05" length=".3"/></geometry></collision>
</link>
<link name="two"><collision><geometry><box size=".1 .2 .3"/></geometry></collision></link>
<joint name="shoulder" type="revolute"><parent link="base"/><child link="one"/><axis xyz="0 0 1"/>
<limit lower="-2" upper="2" velocity="1" effort="5"/></joint>
<joint name="elbow" type="prismatic"><parent link="one"/><child link="two"/><origin xyz="0 0 .4"/><axis xyz="0 1 0"/>
<limit lower="-1" upper="1" velocity="1" effort="5"/></joint></robot>"""

CORNERS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype=np.float32)
FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])


def stl_file() -> bytes:
    triangles = np.zeros(len(FACES), dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("rest", "<u2")])
    triangles["corners"] = CORNERS[FACES]
    return bytes(80) + len(FACES).to_bytes(4, "little") + triangles.tobytes()


def stl_text() -> bytes:
    lines = ["solid part"]
    for face in FACES:
        lines += ["facet normal 0 0 0", "outer loop"]
        lines += [f"vertex {x:g} {y:g} {z:g}" for x, y, z in CORNERS[face]]
        lines += ["endloop", "endfacet"]
    return "\n".join([*lines, "endsolid part", ""]).encode()


def obj_file() -> bytes:
    lines = ["# a part", "mtllib part.mtl", "o part", *(f"v {x:g} {y:g} {z:g}" for x, y, z in CORNERS)]
    lines += ["vn 0 0 1", "usemtl grey", *("f " + " ".join(f"{k + 1}//1" for k in face) for face in FACES)]
    return "\n".join([*lines, ""]).encode()


def ply_file(binary: bool = True) -> bytes:
    form = "binary_little_endian" if binary else "ascii"
    head = f"ply\nformat {form} 1.0\ncomment a part\nelement vertex 4\n"
    head += "".join(f"property float {axis}\n" for axis in "xyz")
    head += "element face 4\nproperty list uchar int vertex_indices\nend_header\n"
    if binary:
        faces = b"".join(b"\x03" + face.astype("<i4").tobytes() for face in FACES)
        return head.encode() + CORNERS.astype("<f4").tobytes() + faces
    rows = [" ".join(f"{value:g}" for value in corner) for corner in CORNERS]
    rows += ["3 " + " ".join(map(str, face)) for face in FACES]
    return (head + "\n".join(rows) + "\n").encode()


def dae_file() -> bytes:
    numbers = " ".join(f"{value:g}" for value in CORNERS.ravel())
    indices = " ".join(str(k) for k in FACES.ravel())
    return f"""<?xml version="1.0" encoding="utf-8"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><unit name="meter" meter="1"/><up_axis>Z_UP</up_axis></asset>
<library_images><image id="skin"><init_from>skin.png</init_from></image></library_images>
<library_geometries><geometry id="part"><mesh>
<source id="corners"><float_array id="numbers" count="12">{numbers}</float_array><technique_common>
<accessor source="#numbers" count="4" stride="3"><param name="X" type="float"/><param name="Y" type="float"/>
<param name="Z" type="float"/></accessor></technique_common></source>
<vertices id="vertices"><input semantic="POSITION" source="#corners"/></vertices>
<triangles count="4"><input semantic="VERTEX" source="#vertices" offset="0"/><p>{indices}</p></triangles>
</mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene id="scene"><node id="node"><matrix>1 0 0 0 0 1 0 0 0 0 1 .5 0 0 0 1</matrix>
<instance_geometry url="#part"/></node></visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#scene"/></scene></COLLADA>
""".encode()


MUTABLE_FILES: dict[str, Callable[[], bytes]] = {
    "hdf5": hdf5_file,
    "parquet": parquet_file,
    "npy": npy_file,
    "npz": npz_file,
    "mat": mat_file,
    "mat_plain": lambda: mat_file(compressed=False),
    "rosbag": rosbag1_file,
    "rosbag2": rosbag2_file,
    "mcap": mcap_file,
    "mcap_unchunked": lambda: mcap_file(chunked=False),
    "csv": csv_file,
    "csv_words": worded_csv_file,
    "csv_sparse": sparse_csv_file,
    "csv_gz": lambda: gzip.compress(csv_file()),
    "csv_zst": zst_file,
    "jsonl": jsonl_file,
    "json": json_file,
    "zip": zip_file,
    "mjcf": MJCF.encode,
    "urdf": URDF.encode,
    "stl": stl_file,
    "stl_text": stl_text,
    "obj": obj_file,
    "ply": ply_file,
    "ply_text": lambda: ply_file(binary=False),
    "dae": dae_file,
}
"""What makes a small valid file of each format."""
FILE_NAMES = {
    "hdf5": "run.h5",
    "parquet": "run.parquet",
    "npy": "run.npy",
    "npz": "run.npz",
    "mat": "run.mat",
    "mat_plain": "run.mat",
    "rosbag": "run.bag",
    "rosbag2": "run.db3",
    "mcap": "run.mcap",
    "mcap_unchunked": "run.mcap",
    "csv": "run.csv",
    "csv_words": "run.csv",
    "csv_sparse": "run.csv",
    "csv_gz": "run.csv.gz",
    "csv_zst": "run.csv.zst",
    "jsonl": "run.jsonl",
    "json": "run.json",
    "zip": "run.zip",
    "mjcf": "arm.xml",
    "urdf": "arm.urdf",
    "stl": "part.stl",
    "stl_text": "part.stl",
    "obj": "part.obj",
    "ply": "part.ply",
    "ply_text": "part.ply",
    "dae": "part.dae",
}
DESCRIPTIONS = ("mjcf", "urdf", "modified_dh")
MESHES = ("stl", "stl_text", "obj", "ply", "ply_text", "dae")
_NUMBERS = (0, 1, 0x7F, 0xFF, 0x7FFF, 0xFFFF, 0x7FFFFFFF, 0xFFFFFFFF, 2**40, 2**63 - 1, 2**64 - 1)
_WORDS = (b"0", b"-1", b"nan", b"inf", b"1e300", b"-1e300", b"4294967296", b"18446744073709551616", b"1e-300", b"")


def mutate(content: bytes, rng: np.random.Generator) -> bytes:
    """One to four damages: of bits, bytes, lengths, numbers in text, spans that stand twice or are gone, a cut end."""
    data = bytearray(content)
    for _ in range(int(rng.choice([1, 1, 1, 2, 4]))):
        if data:
            damages = _DAMAGES_OF_TEXT if data[:4000].isascii() and 0 not in data[:4000] else _DAMAGES
            damage = damages[int(rng.integers(len(damages)))]
            damage(data, rng)
    return bytes(data)


def _flip_bit(data: bytearray, rng: np.random.Generator) -> None:
    data[int(rng.integers(len(data)))] ^= 1 << int(rng.integers(8))


def _set_byte(data: bytearray, rng: np.random.Generator) -> None:
    data[int(rng.integers(len(data)))] = int(rng.choice([0, 1, 0x7F, 0x80, 0xFF, int(rng.integers(256))]))


def _set_length(data: bytearray, rng: np.random.Generator) -> None:
    width = int(rng.choice([2, 4, 8]))
    at = int(rng.integers(len(data)))
    at -= at % width if rng.random() < 0.7 else 0
    number = int(_NUMBERS[int(rng.integers(len(_NUMBERS)))]) % 256**width
    data[at : at + width] = number.to_bytes(width, "little")


def _set_number(data: bytearray, rng: np.random.Generator) -> None:
    """Replace a number that is written out, or a word."""
    import re

    places = [match.span() for match in re.finditer(rb"[-+.\d][\d.eE+-]*", bytes(data[:20_000]))]
    if places:
        first, last = places[int(rng.integers(len(places)))]
        data[first:last] = _WORDS[int(rng.integers(len(_WORDS)))]


def _double(data: bytearray, rng: np.random.Generator) -> None:
    first, length = int(rng.integers(len(data))), int(rng.integers(1, 200))
    data[first:first] = data[first : first + length]


def _remove(data: bytearray, rng: np.random.Generator) -> None:
    first, length = int(rng.integers(len(data))), int(rng.integers(1, 60))
    del data[first : first + length]


def _copy_over(data: bytearray, rng: np.random.Generator) -> None:
    """Write a span of the file over another one: records point to wrong places."""
    source, target, length = (int(rng.integers(len(data))), int(rng.integers(len(data))), int(rng.integers(1, 100)))
    span = data[source : source + length]
    data[target : target + len(span)] = span


def _truncate(data: bytearray, rng: np.random.Generator) -> None:
    del data[int(rng.integers(len(data))) :]


_DAMAGES: tuple[Callable[[bytearray, np.random.Generator], None], ...] = (
    _flip_bit,
    _flip_bit,
    _set_byte,
    _set_length,
    _set_length,
    _set_number,
    _double,
    _remove,
    _copy_over,
    _truncate,
)
_DAMAGES_OF_TEXT = (*5 * (_set_number,), _set_byte, _flip_bit, _double, _remove, _copy_over, _truncate)


def read_all(path: Path, kind: str) -> None:
    """Read a file as the library does for its users; raises what it raises."""
    if kind in DESCRIPTIONS:
        _read_description(path, kind)
    elif kind in MESHES:
        _read_mesh(path)
    else:
        _read_recording(path)


def _read_description(path: Path, kind: str) -> None:
    from dynident.errors import DynidentError
    from dynident.robot import Description, collision_geometry, robot_from_description

    try:
        text = path.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise DynidentError(str(error)) from None
    robot = robot_from_description("arm", Description(kind, text))
    collision_geometry(robot)


def _read_mesh(path: Path) -> None:
    from dynident.errors import DynidentError
    from dynident.robot.link_meshes import build_hulls, read_surface, thin_surface

    try:
        surface = read_surface(path, np.ones(3), np.eye(4))
    except ValueError as error:  # what its docstring promises
        raise DynidentError(str(error)) from None
    build_hulls(surface)
    thin_surface(surface, 12)


def _read_recording(path: Path) -> None:
    from dynident.errors import DynidentError
    from dynident.recordings import RecordedJoints, RecordingMetadata, import_recording
    from dynident.recordings.formats import open_source
    from dynident.recordings.raw_signals import RecordedSignals, RobotFile

    joints = RecordedJoints(JOINTS)
    source = open_source(path, None)
    with suppress(DynidentError):  # as of a column of text, which nobody asks for below
        for _ in source.blocks():
            pass
    names = [name for name in source.names if name != "t"]
    if names[0] == "column1":
        columns = dict(zip(("t", "q1", "q2", "tau1", "tau2"), names, strict=False))
    else:
        columns = {"t": next((name for name in source.names if _last(name) == "t"), source.names[0])}
    for part, ours in (("q", "q"), ("position", "q"), ("tau", "tau"), ("effort", "tau")):
        alike = [name for name in names if _last(name).startswith(part)]
        columns |= {f"{ours}{k + 1}": name for k, name in enumerate(alike[:2])}
    metadata = RecordingMetadata(columns=columns)
    with tempfile.TemporaryDirectory() as folder:
        import_recording(path, Path(folder) / "stored.parquet", joints, metadata=metadata)
    RecordedSignals(RobotFile(path, metadata, joints)).thin_rows(100)


def _last(name: str) -> str:
    return name.replace("/", ".").rpartition(".")[2]


@dataclass
class Outcomes:
    """What became of mutants: results, errors in words, deaths by signal, and whatever else (which is a fault)."""

    results: int = 0
    refusals: int = 0
    deaths: dict[int, str] = field(default_factory=dict)
    faults: dict[int, str] = field(default_factory=dict)
    peak: int = 0

    @property
    def count(self) -> int:
        return self.results + self.refusals + len(self.deaths) + len(self.faults)


def read_mutants(kind: str, seed: int, count: int) -> Outcomes:
    """Read mutants number 0 to `count` in child processes; a child that dies is followed by another."""
    outcomes = Outcomes()
    first = 0
    while first < count:
        child = subprocess.run(
            [sys.executable, __file__, kind, str(seed), str(first), str(count)],
            capture_output=True,
            text=True,
            check=False,
            env={**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},
        )
        last = -1
        for line in child.stdout.splitlines():
            if not line.startswith("{"):
                continue  # what a C library prints
            said = json.loads(line)
            last = said["mutant"]
            if said["end"] == "result":
                outcomes.results += 1
            elif said["end"] == "refusal":
                outcomes.refusals += 1
            elif said["end"] == "fault":
                outcomes.faults[last] = said["what"]
            outcomes.peak = max(outcomes.peak, said.get("peak", 0))
        if child.returncode == 0:
            break
        last = max(last, first)
        told = child.stderr.strip()[-600:]
        if child.returncode < 0:
            outcomes.deaths[last] = f"{signal.Signals(-child.returncode).name}: {told}"
        else:
            outcomes.faults[last] = f"ended with {child.returncode}: {told}"
        first = last + 1
    return outcomes


def mutant(kind: str, seed: int, number: int, content: bytes | None = None) -> bytes:
    """The same bytes for the same numbers."""
    rng = np.random.default_rng([seed, number])
    return mutate(MUTABLE_FILES[kind]() if content is None else content, rng)


def _main(kind: str, seed: int, first: int, last: int) -> None:
    from dynident.errors import DynidentError

    content = MUTABLE_FILES[kind]()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / FILE_NAMES[kind]
        path.write_bytes(content)
        read_all(path, kind)  # the file itself is valid; and what is loaded only once counts for none of the mutants
        size = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (size + ROOM, size + ROOM))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        for number in range(first, last):
            _say(mutant=number, end="begins")
            path.write_bytes(mutant(kind, seed, number, content))
            faulthandler.dump_traceback_later(SECONDS, exit=True)
            try:
                read_all(path, kind)
                end, what = "result", ""
            except DynidentError as error:
                end, what = "refusal", str(error)
            except Exception as error:
                import traceback

                end, what = "fault", f"{error!r}\n{''.join(traceback.format_tb(error.__traceback__)[-3:])}"
            faulthandler.cancel_dump_traceback_later()
            _say(mutant=number, end=end, what=what[:1500].encode(errors="replace").decode(), peak=_peak())


def _peak() -> int:
    """Bytes of the largest resident memory; `getrusage` would count that of the process which started this one."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(1024 * int(line.split()[1]) for line in lines if line.startswith("VmHWM"))


def _say(**values: object) -> None:
    print(json.dumps(values), flush=True)


if __name__ == "__main__":
    _main(sys.argv[1], *map(int, sys.argv[2:5]))
