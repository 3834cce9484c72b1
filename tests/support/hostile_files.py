"""Files that ask for what no recording, mesh or robot needs: memory, time, other files, programs.

As a program it reads all of them as the library does, and prints a line a file:
`PYTHONPATH=tests python -m support.hostile_files`.
"""

from __future__ import annotations

import io
import json
import pickle
import resource
import sqlite3
import struct
import tempfile
import time
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from support.file_mutations import (
    JOINT_STATE,
    MJCF,
    MUTABLE_FILES,
    URDF,
    dae_file,
    obj_file,
    read_all,
    signals,
    stl_file,
    written,
)

MB = 2**20


class HostileFile(NamedTuple):
    """`reason` is a part of what is answered; `None` where the file does no harm and may be read."""

    name: str
    file_name: str
    content: bytes
    reason: str | None


def hostile_files(outside: str = "/etc/hostname") -> list[HostileFile]:
    """All of them; `outside` is a file that none of them may bring into an answer."""
    made = [
        *_arrays_of_numpy(),
        *_mat_files(),
        *_hdf5_files(outside),
        *_tables(),
        *_texts(),
        *_bags(),
        *_mcap_files(),
        *_meshes(outside),
        *_descriptions(),
    ]
    return [HostileFile(*one) for one in made]


_Made = tuple[str, str, bytes, str | None]


def _npy(shape: object, kind: str = "<f8", data: bytes = b"") -> bytes:
    text = f"{{'descr': {kind!r}, 'fortran_order': False, 'shape': {shape}, }}".encode()
    text += b" " * (-(11 + len(text)) % 64) + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text + data


def _archive(members: dict[str, bytes], how: int = zipfile.ZIP_DEFLATED) -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", how, compresslevel=1) as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return out.getvalue()


def _arrays_of_numpy() -> list[_Made]:
    zeros = _npy((MB,), data=bytes(8 * MB))
    objects = _npy((100,), "|O", pickle.dumps([None] * 100))
    return [
        ("shape that wraps", "run.npy", _npy((2**32, 2**32)), "its last numbers are missing"),
        ("shape beyond 64 bits", "run.npy", _npy((2**70, 1)), "its last numbers are missing"),
        ("negative shape", "run.npy", _npy((-8, -8), data=bytes(512)), "its shape is"),
        ("no rows of endless width", "run.npy", _npy((0, 2**70)), "no arrays of numbers with rows"),
        ("header of 4 GB", "run.npy", b"\x93NUMPY\x02\x00\xff\xff\xff\xff{}", "cannot be read as npy"),
        ("header of brackets", "run.npy", _npy("(" * 5000), "cannot be read as npy"),
        ("pickled objects", "run.npy", objects, "Python objects"),
        ("archive that unpacks to 300 MB", "run.npz", _archive({f"q{k}.npy": zeros for k in range(38)}), "unpacks to"),
        ("archive of another kind", "run.npz", _archive({"q.npy": zeros}, zipfile.ZIP_LZMA), "NumPy does not use"),
        ("pickles in an archive", "run.npz", _archive({"q.npy": objects}), "Python objects"),
        (
            "archive of too many arrays",
            "run.npz",
            _archive({f"{k}.npy": b"" for k in range(10_001)}, zipfile.ZIP_STORED),
            "has 10001 columns",
        ),
    ]


_MAT_HEAD = b"MATLAB 5.0 MAT-file".ljust(124) + struct.pack("<H", 0x0100) + b"IM"


def _mat_matrix(name: bytes, kind: int, rows: int, rest: bytes) -> bytes:
    name = name.ljust(-(-len(name) // 8) * 8, b"\0")
    body = struct.pack("<IIII", 6, 8, kind, 0) + struct.pack("<IIii", 5, 8, rows, 1)
    body += struct.pack("<II", 1, len(name)) + name + rest
    return struct.pack("<II", 14, len(body)) + body


def _mat_files() -> list[_Made]:
    zeros = _mat_matrix(b"q", 6, 6 * MB, struct.pack("<II", 9, 48 * MB) + bytes(48 * MB))
    packed = zlib.compress(zeros, 1)
    deep = b""
    for _ in range(200):
        names = struct.pack("<HHi", 5, 4, 8) + struct.pack("<II", 1, 8) + b"inside\0\0"
        deep = _mat_matrix(b"log", 2, 1, names + deep)
    short = _mat_matrix(b"q", 6, 2**31 - 1, struct.pack("<II", 9, 64) + bytes(64))
    return [
        ("parts that unpack to 300 MB", "run.mat", _MAT_HEAD + 7 * _mat_part(packed), "unpacks to"),
        ("part that says to unpack to 4 GB", "run.mat", _MAT_HEAD + _mat_part(_lying_part()), "unpacks to"),
        ("deep structures", "run.mat", _MAT_HEAD + deep, "more than 32 levels deep"),
        ("more numbers than there are", "run.mat", _MAT_HEAD + short, "match how many numbers it has"),
    ]


def _mat_part(packed: bytes) -> bytes:
    return struct.pack("<II", 15, len(packed)) + packed


def _lying_part() -> bytes:
    return zlib.compress(struct.pack("<II", 14, 2**32 - 1) + bytes(100))


def _hdf5(make: Callable[[Any], object], **options: Any) -> bytes:
    import h5py

    def write(path: Path) -> None:
        with h5py.File(path, "w", **options) as file:
            make(file)

    return written(write, "run.h5")


def _with_signals(make: Callable[[Any], object]) -> bytes:
    def both(file: Any) -> None:
        file["t"] = signals()["t"]
        for kind in ("q", "tau"):
            for joint in range(2):
                file[f"{kind}{joint + 1}"] = signals()[kind][:, joint]
        make(file)

    return _hdf5(both)


def _hdf5_files(outside: str) -> list[_Made]:
    import h5py

    def virtual(file: Any) -> None:
        layout = h5py.VirtualLayout(shape=(300,), dtype="f8")
        layout[:] = h5py.VirtualSource(outside, "secret", shape=(300,))
        file.create_virtual_dataset("leak", layout)

    def bomb(file: Any) -> None:
        item = file.create_dataset("leak", shape=(50_000,), dtype="f8", chunks=(50_000,), compression="gzip")
        item.id.write_direct_chunk((0,), zlib.compress(bytes(300 * MB), 9))

    def foreign_filter(file: Any) -> None:
        space = h5py.h5s.create_simple((300,))
        properties = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
        properties.set_chunk((300,))
        properties.set_filter(32_015, h5py.h5z.FLAG_OPTIONAL, ())
        h5py.h5d.create(file.id, b"leak", h5py.h5t.NATIVE_DOUBLE, space, properties)

    def deep(file: Any) -> None:
        for _ in range(100):
            file = file.create_group("inside")
        file["q"] = np.zeros(100)

    def table(file: Any) -> None:
        rows = np.zeros(300, dtype=[("word", h5py.string_dtype()), ("value", "f8")])
        rows["word"] = "text"
        file["table"] = rows

    chunk = {"dtype": "f8", "chunks": (4000, 100_000), "compression": "gzip"}
    return [
        (
            "external storage",
            "run.h5",
            _with_signals(lambda file: file.create_dataset("leak", (300,), "u1", external=[(outside, 0, 300)])),
            "leak keeps its data in another file (external storage)",
        ),
        ("virtual data set", "run.h5", _with_signals(virtual), "leak keeps its data in another file"),
        (
            "link to another file",
            "run.h5",
            _with_signals(lambda file: file.__setitem__("leak", h5py.ExternalLink(outside, "/secret"))),
            "leak is a link to another file",
        ),
        (
            "soft link to nowhere",
            "run.h5",
            _with_signals(lambda file: file.__setitem__("leak", h5py.SoftLink("/../../secret"))),
            None,
        ),
        (
            "shape that no file holds",
            "run.h5",
            _hdf5(lambda file: file.create_dataset("q1", (8, 10**8), "f8", chunks=(8, 1000))),
            "unpacks to",
        ),
        (
            "rows without end",
            "run.h5",
            _hdf5(lambda file: file.create_dataset("q1", (10**15,), "f8", chunks=(1000,))),
            "unpacks to",
        ),
        ("one chunk of 3 GB", "run.h5", _hdf5(lambda file: file.create_dataset("q", (4000, 100_000), **chunk)), "MB"),
        (
            "one chunk of 100 MB",
            "run.h5",
            _hdf5(lambda file: file.create_dataset("q", (1000, 13_000), "f8", chunks=(1000, 13_000))),
            "A chunk of q unpacks to",
        ),
        ("chunk that unpacks to 300 MB", "run.h5", _with_signals(bomb), "unpacks to more than the 400000 bytes"),
        ("filter of a plug-in", "run.h5", _with_signals(foreign_filter), "is stored with the filter 32015"),
        ("deep groups", "run.h5", _hdf5(deep), "more than 32 levels deep"),
        ("chunk of no bytes", "run.h5", chunk_of_no_bytes(), "is damaged"),
        ("table with texts", "run.h5", _with_signals(table), None),
        (
            "too many columns",
            "run.h5",
            _hdf5(lambda file: file.update({"t": np.zeros(9), "q": np.zeros((9, 20_000), dtype="u1")})),
            "has 20001 columns",
        ),
    ]


def chunk_of_no_bytes() -> bytes:
    """A chunk with a checksum that is said to take no bytes: HDF5 subtracts those of the checksum and reads on."""
    values = np.arange(300.0)
    content = bytearray(
        _hdf5(lambda file: file.create_dataset("q1", data=values, chunks=(300,), fletcher32=True), libver="earliest")
    )
    # The tree's only key begins with the size of the chunk and the mask of its filters.
    key = struct.pack("<II", values.nbytes + 4, 0)
    at = content.index(key, content.index(b"TREE\x01"))
    content[at : at + 4] = bytes(4)
    return bytes(content)


def _tables() -> list[_Made]:
    import pyarrow as pa
    import pyarrow.parquet as pq

    def parquet(table: Any) -> bytes:
        return written(lambda path: pq.write_table(table, path), "run.parquet")

    nested = {name: signals()["t"] for name in ("q1", "q2", "tau1", "tau2")} | {"t": pa.array([{"a": 1.0}] * 300)}
    many = pa.table({f"c{k}": pa.array([0], pa.int8()) for k in range(10_001)})
    constant = pa.table({"t": pa.array(np.zeros(34 * MB, dtype=np.int8))})
    names = ",".join(f"c{k}" for k in range(10_500))
    telegram = "<Rob " + " ".join(f'a{k}="1"' for k in range(10_500)) + "></Rob>"
    return [
        ("rows of one value", "run.parquet", parquet(constant), "unpacks to"),
        ("too many columns", "run.parquet", parquet(many), "has 10001 columns"),
        ("nested column", "run.parquet", parquet(pa.table(nested)), None),
        ("too many columns", "run.csv", f"{names}\n".encode(), "columns; at most"),
        ("too many attributes", "run.xml", telegram.encode(), "columns; at most"),
        (
            "deep telegram",
            "run.xml",
            b"<Rob >" + b"<a>" * 10_000 + b"</a>" * 10_000 + b"</Rob>",
            "no complete telegram",
        ),
    ]


def _texts() -> list[_Made]:
    import pyarrow as pa

    lines = b"t,q1,q2,tau1,tau2\n" + b"0,0,0,0,0\n" * 2000
    bomb = lines + b"0,0,0,0,0\n" * 5_000_000
    zeros = bytes(300 * MB)
    record = json.dumps({"t": 0.0, "q": [0.0, 0.0], "tau": [0.0, 0.0]}).encode()
    wide = json.dumps({f"c{k}": 0.0 for k in range(10_500)}).encode()
    zipped = {"t.csv": "\n".join(map(str, range(1000))).encode(), "q.csv": b"0 0\n" * 1000, "tau.csv": b"0 0\n" * 1000}
    row = b"0.0," + b"[" * 6_000_000
    names = [f"a {{\n  n{k}: 1\n}}\n".encode() for k in range(6000)]
    begin = b"h {\n  t: 1\n}\n"
    dates = b"t,q1,q2,tau1,tau2\n" + b"9999-99-99 99:99:99,0,0,0,0\n" * 50
    return [
        ("gzip bomb", "run.csv.gz", zlib.compress(bomb, 1, wbits=31), "unpacks to"),
        ("zstd bomb", "run.csv.zst", bytes(pa.compress(bomb, "zstd", asbytes=True)), "unpacks to"),
        ("compressed array", "run.npy.gz", zlib.compress(_npy((3,)), wbits=31), "Unpack the file first"),
        ("cut gzip", "run.csv.gz", zlib.compress(lines, wbits=31)[:60], "Truncated compressed stream"),
        ("deep JSON", "run.json", b'{"a":' * 100_000, "JSON"),
        ("deep arrays", "run.json", b'[{"a":' + b"[" * 100_000, "JSON"),
        ("deep record", "run.jsonl", b'{"a":' * 40 + b"1" + b"}" * 40, "deeper than"),
        ("endless record", "run.json", b'{"a": [' + b"0.1234567890123456," * 2_000_000, "is longer than"),
        ("long number", "run.jsonl", record + b'\n{"t": 1' + b"0" * 100_000 + b"}", "Record 2 cannot be read"),
        ("too many columns", "run.jsonl", wide, "columns; at most"),
        ("too many items", "run.jsonl", (b'{"a": [' + b"0," * 20_000 + b'0], "b": {}}\n') * 2, "columns; at most"),
        ("name that is no text", "run.jsonl", b'{"\\ud800": 1}\n' * 3, "not valid Unicode text"),
        ("list that never ends", "run.csv", lines[:18] + b"0,[1],0,0,0\n" * 3 + row, "list in it is not closed"),
        ("dates that are none", "run.csv", dates, "has no number in row 1"),
        ("bomb in an archive", "run.zip", _archive({"a.csv": zeros, "b.csv": zeros}), "unpacks to"),
        ("many files", "run.zip", _archive({f"f{k}.csv": b"0\n" for k in range(65)}), "at most 64"),
        ("way out of an archive", "run.zip", _archive({**zipped, "../../q.csv": b"0 0\n" * 10}), "twice"),
        ("archive in an archive", "run.zip", _archive({"a.zip": _archive(zipped)}), "neither Parquet nor text"),
        ("workbook", "run.xlsx", _archive({"[Content_Types].xml": b"<a/>"}), "save the sheet as CSV"),
        ("pickle", "run.pkl", pickle.dumps({"t": [0.0]}, protocol=4), "never opened"),
        ("remarks before a table", "run.csv", b"-- a\n\n" * 40 + lines, "only 2000 rows"),
        ("empty lines in a message", "run.txt", b"a {" + b"\n" * 60_000 + lines, "only 2000 rows"),
        (
            "long word in an object",
            "run.log",
            b"State(t=0.1, q=" + b"a" * 1_000_000 + b")\nState(t=0.2)\n",
            "no column tau_shoulder",
        ),
        ("names that grow", "run.txt", begin + b"".join(names), "A message is longer than"),
        ("names that grow in records", "run.txt", begin + begin.join(names), "numbers of the messages are missing"),
    ]


def _bag(*statements: str, messages: bool = True) -> bytes:
    def write(path: Path) -> None:
        base = sqlite3.connect(path)
        base.execute("CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT)")
        base.execute("INSERT INTO topics VALUES (1, '/joint_states', ?)", (JOINT_STATE,))
        if messages:
            base.execute(
                "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB)"
            )
        for statement in statements:
            base.execute(statement)
        base.commit()
        base.close()

    return written(write, "run.db3")


def _bags() -> list[_Made]:
    endless = (
        "CREATE VIEW messages AS WITH RECURSIVE c(x) AS (SELECT 1 UNION ALL SELECT x+1 FROM c) "
        "SELECT x AS id, 1 AS topic_id, x AS timestamp, zeroblob(100000) AS data FROM c"
    )
    computed = (
        "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, "
        "data BLOB AS (zeroblob(100000000)))"
    )
    trigger = "CREATE TRIGGER one AFTER INSERT ON messages BEGIN DELETE FROM topics; END"
    large = "INSERT INTO messages VALUES (1, 1, 1, zeroblob(4200000))"
    return [
        ("endless view", "run.db3", _bag(endless, messages=False), "contains messages, a view"),
        ("view beside the tables", "run.db3", _bag("CREATE VIEW v AS SELECT 1"), "contains v, a view"),
        ("trigger", "run.db3", _bag(trigger), "contains one, a trigger"),
        ("virtual table", "run.db3", _bag("CREATE VIRTUAL TABLE v USING fts4(a)"), "a virtual table"),
        (
            "computed column",
            "run.db3",
            _bag(computed, "INSERT INTO messages VALUES (1, 1, 1)", messages=False),
            "no stored column data",
        ),
        ("message of 4 MB", "run.db3", _bag(large), "A message of /joint_states has 4200000 bytes"),
        ("message of text", "run.db3", _bag("INSERT INTO messages VALUES (1, 1, 1, 'text')"), "not stored as bytes"),
        (
            "time that is none",
            "run.db3",
            _bag("INSERT INTO messages VALUES (1, 1, 'now', x'00')"),
            "time or data of a message",
        ),
        ("chunk of a bag of ROS 1", "run.bag", _ros1_bomb(), "unpacks to 64 MB at once"),
    ]


def _ros1_bomb() -> bytes:
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_typestore

    def write(path: Path) -> None:
        writer = Writer(path)
        writer.set_compression(Writer.CompressionFormat.LZ4)
        with writer:
            topic = writer.add_connection("/joint_states", JOINT_STATE, typestore=get_typestore(Stores.ROS1_NOETIC))
            writer.write(topic, 10**9, bytes(100 * MB))

    return written(write, "run.bag")


def _mcap(definition: str, type_name: str, *messages: bytes) -> bytes:
    from mcap.writer import CompressionType, Writer

    out = io.BytesIO()
    writer = Writer(out, compression=CompressionType.NONE)
    writer.start()
    schema = writer.register_schema(type_name, "ros2msg", definition.encode())
    channel = writer.register_channel("/joint_states", "cdr", schema)
    for number, data in enumerate(messages or [b"\0\1\0\0" + bytes(64)] * 3):
        writer.add_message(channel, number * 10**7, data, number * 10**7)
    writer.finish()
    return out.getvalue()


def _mcap_chunk(compression: str, size: int, data: bytes) -> bytes:
    """A file of one chunk, without a summary."""

    def text(value: str) -> bytes:
        return struct.pack("<I", len(value)) + value.encode()

    def record(code: int, body: bytes) -> bytes:
        return struct.pack("<BQ", code, len(body)) + body

    chunk = struct.pack("<QQQI", 0, 10**9, size, 0) + text(compression) + struct.pack("<Q", len(data)) + data
    magic = b"\x89MCAP0\r\n"
    body = record(1, text("ros2") + text("")) + record(6, chunk) + record(15, bytes(4)) + record(2, bytes(20))
    return magic + body + magic


def _mcap_files() -> list[_Made]:
    import lz4.frame
    import zstandard
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    types = store.types
    header = types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](1, 0), "")
    names = [f"j{k}" for k in range(10_001)]
    wide = types[JOINT_STATE](header, names, np.zeros(10_001), np.zeros(0), np.zeros(0))
    data = bytes(store.serialize_cdr(wide, JOINT_STATE))
    zeros = bytes(300 * MB)
    zstd = zstandard.ZstdCompressor(level=1).compress(zeros)
    franka = "franka_msgs/msg/FrankaState"
    return [
        ("chunk of 300 MB", "run.mcap", _mcap_chunk("zstd", 300 * MB, zstd), "unpacks to 300 MB at once"),
        ("chunk that lies", "run.mcap", _mcap_chunk("zstd", 1000, zstd), "more than the 1000 bytes"),
        ("chunk of LZ4", "run.mcap", _mcap_chunk("lz4", 1000, lz4.frame.compress(zeros)), "more than the 1000 bytes"),
        ("chunk of 2**63 bytes", "run.mcap", _mcap_chunk("zstd", 2**63, zstd[:100]), "at once"),
        (
            "type that holds itself",
            "run.mcap",
            _mcap("lbr_fri_msgs/LBRState a\n", "lbr_fri_msgs/msg/LBRState"),
            "itself",
        ),
        ("array of 10^9", "run.mcap", _mcap("float64[1000000000] q\n", franka), "contains 1000000000 numbers"),
        ("texts of 10^8", "run.mcap", _mcap("string[100000000] q\n", franka), "contains 100000000 numbers"),
        ("long definition", "run.mcap", _mcap("float64 q\n" * 40_000, franka), "has 400000 characters"),
        ("too many joints", "run.mcap", _mcap("", JOINT_STATE, *[data] * 3), "has 10001 columns"),
    ]


def gltf(uri: str) -> bytes:
    """A mesh whose corners stand in another file."""
    view = {"buffer": 0, "byteOffset": 0, "byteLength": 36}
    corners = {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3", "min": [0, 0, 0], "max": [1, 1, 1]}
    return json.dumps(
        {
            "asset": {"version": "2.0"},
            "scene": 0,
            "scenes": [{"nodes": [0]}],
            "nodes": [{"mesh": 0}],
            "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
            "buffers": [{"uri": uri, "byteLength": 36}],
            "bufferViews": [view],
            "accessors": [corners],
        }
    ).encode()


def _meshes(outside: str) -> list[_Made]:
    elsewhere = gltf(outside)
    laughs = b'<!DOCTYPE a [<!ENTITY a "aaaaaaaa"><!ENTITY b "&a;&a;&a;">]>' + dae_file().partition(b"?>")[2]
    two = '<instance_node url="#n{0}"/><instance_node url="#n{0}"/>'
    nodes = "".join(f'<node id="n{k}">{two.format(k + 1)}</node>' for k in range(60))
    doubling = dae_file().replace(b"</visual_scene>", f'{nodes}<node id="n60"/></visual_scene>'.encode())
    deep = dae_file().replace(b"<scene>", b"<extra>" * 200 + b"</extra>" * 200 + b"<scene>")
    other = dae_file().replace(b'url="#part"', f'url="{outside}#part"'.encode())
    large = b"ply\nformat ascii 1.0\nelement vertex 4294967296\nproperty float x\nend_header\n0\n"
    listing = (
        b"ply\nformat binary_little_endian 1.0\nelement face 1\nproperty list uint int vertex_indices\nend_header\n"
    )
    return [
        ("glTF by its name", "part.gltf", elsewhere, "ends in '.gltf'"),
        ("glTF as STL", "part.stl", elsewhere, "not an STL file"),
        ("glTF as OBJ", "part.obj", elsewhere, "no triangles"),
        ("glTF as PLY", "part.ply", elsewhere, "not a PLY file"),
        ("glTF as DAE", "part.dae", elsewhere, "not a DAE file"),
        ("more triangles than there are", "part.stl", bytes(80) + b"\xff" * 4 + stl_file()[84:], "not an STL file"),
        ("more corners than there are", "part.ply", large, "declares 4294967296"),
        ("face of 4 billion corners", "part.ply", listing + b"\xff" * 4, "last rows are missing"),
        ("materials elsewhere", "part.obj", obj_file().replace(b"part.mtl", outside.encode()), None),
        ("entities", "part.dae", laughs, "document type"),
        ("nodes that double", "part.dae", doubling, "nodes"),
        ("deep elements", "part.dae", deep, "more than 100"),
        ("geometry elsewhere", "part.dae", other, "refers to "),
    ]


def _descriptions() -> list[_Made]:
    comments = "<!-- a -->" * 100_000 + "<!-- -->"
    table = '{"joints": [{"name": %s}]}'
    shoulder = '<joint name="shoulder" type="revolute">'
    return [
        ("many comments", "arm.urdf", (comments + URDF).encode(), None),
        ("many comments", "arm.xml", (comments + MJCF).encode(), None),
        ("comments without a robot", "arm.urdf", comments.encode(), "malformed"),
        ("deep elements", "arm.urdf", ("<robot>" + "<a>" * 10_000).encode(), "nested more than 100"),
        ("entities", "arm.urdf", ('<!DOCTYPE a [<!ENTITY a "a">]>' + URDF).encode(), "document type"),
        ("mass of 1e300", "arm.urdf", URDF.replace('value="2"', 'value="1e300"').encode(), "too large"),
        ("mass that is no number", "arm.urdf", URDF.replace('value="2"', 'value="nan"').encode(), "expected a number"),
        ("place without end", "arm.urdf", URDF.replace('"0 0 .4"', '"0 0 inf"').encode(), "expected 3 numbers"),
        (
            "line break in a name",
            "arm.urdf",
            URDF.replace(shoulder, shoulder.replace("shoulder", "shoul&#10;der")).encode(),
            "without control characters",
        ),
        ("JSON of 400 levels", "arm.json", (table % ("[" * 400 + "]" * 400)).encode(), "nested too deeply"),
        ("JSON of 100,000 levels", "arm.json", b"[" * 100_000, "nested too deeply"),
        ("incomplete character", "arm.json", (table % '"\\ud800"').encode(), "incomplete character"),
        ("line break in a name", "arm.json", (table % '"a\\nb"').encode(), "without control characters"),
        ("size of 1e300", "arm.xml", MJCF.replace('size=".1', 'size="1e300').encode(), "MuJoCo"),
        ("place of 1e300", "arm.xml", MJCF.replace('pos="0 0 .3"', 'pos="0 0 1e300"').encode(), "MuJoCo"),
        (
            "other file",
            "arm.xml",
            MJCF.replace("<worldbody>", '<include file="b.xml"/><worldbody>').encode(),
            "include",
        ),
    ]


def kind_of(file_name: str) -> str:
    """What `read_all` takes a file for."""
    endings = {".urdf": "urdf", ".json": "modified_dh", ".xml": "mjcf"}
    if file_name.startswith("part."):
        return "stl"
    return endings.get(Path(file_name).suffix, "run") if file_name.startswith("arm.") else "run"


def _main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        made = [(*one[:2], one.content, one.reason) for one in hostile_files()]
        for name, make in MUTABLE_FILES.items():  # so that what is loaded only once counts for none of the files
            path = Path(folder) / "first"
            if name not in ("stl", "stl_text", "obj", "ply", "ply_text", "dae"):
                path.write_bytes(make())
                read_all(path, name)
        for name, file_name, content, reason in made:
            path = Path(folder) / file_name
            path.write_bytes(content)
            Path("/proc/self/clear_refs").write_text("5")  # the peak of memory begins anew
            before, begin = _peak(), time.perf_counter()
            try:
                read_all(path, kind_of(file_name))
                said: str | None = None
            except Exception as error:
                said = f"{type(error).__name__}: {error}"
            seconds, memory = time.perf_counter() - begin, _peak() - before
            values = {"name": f"{name} ({file_name})", "said": said, "reason": reason}
            print(json.dumps({**values, "seconds": seconds, "memory": memory}), flush=True)
            path.unlink()


def _peak() -> int:
    """Bytes of the largest resident memory since it was asked to begin anew."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) * 1024 for line in lines if line.startswith("VmHWM"))


if __name__ == "__main__":
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    _main()
