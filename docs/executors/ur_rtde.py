"""Move an arm of Universal Robots along a planned motion by RTDE, and record it.

    python ur_rtde.py HOST MOTION.csv RECORDING.csv

A program on the controller follows positions with `servoj` that this script streams into registers, paced by the
controller's own packages. The recording has the controller's time, positions and joint currents (`actual_current`, A):
RTDE has no measured torque, and `target_moment` is only what the controller's own model expects. State drive gains
with the robot, therefore.

Rows are written to RECORDING.csv.part as they come, which becomes RECORDING.csv at the end: `dynident campaign` looks
at them, and ends this script where the run is not worth going on with. The program then stops the arm.

The arm has to stand at the first posture of the motion, and the controller has to be in remote control. The program
stops if this script falls silent; the script stops the arm if it leaves the motion or its safety mode changes. Then
there is no recording, and the reason is printed.
"""

from __future__ import annotations

import argparse
import contextlib
import signal
import socket
import struct
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

RTDE_PORT, PROGRAM_PORT = 30004, 30002
FREQUENCY = 500.0
"""Packages per second of an e-Series controller; a CB3 has 125."""
NEAR = 0.1
"""Distance in rad from which the arm moves to the first posture by itself."""
LARGEST_ERROR = 0.1
"""Distance in rad from the motion at which the arm is stopped."""
PATIENCE = 10.0
"""Seconds that a package, and the start or the end of the program, may take."""
BRAKING = 15.0
"""Deceleration of the joints in rad/s^2 where a run is ended early; at its end the arm stands."""
_VERSION = 2
# Types of packages of the RTDE guide.
_REQUEST_VERSION, _SETUP_OUTPUTS, _SETUP_INPUTS, _START, _TEXT, _DATA = b"VOISMU"
_OUTPUTS = {
    "timestamp": "DOUBLE",
    "actual_q": "VECTOR6D",
    "actual_current": "VECTOR6D",
    "safety_mode": "INT32",
    "output_int_register_24": "INT32",
}
# Registers 0 to 23 belong to field buses.
_INPUTS = {"input_int_register_24": "INT32"} | {f"input_double_register_{k}": "DOUBLE" for k in range(24, 30)}
_FORMATS = {"DOUBLE": "d", "VECTOR6D": "6d", "INT32": "i"}
_WAIT, _FOLLOW, _END, _BRAKE = 0, 1, 2, 3
_SAFE_MODES = {1: "normal", 2: "reduced"}

# The token tells this program's messages from those that an earlier one left in the register.
PROGRAM = """def follow_motion():
  rtde_set_watchdog("input_int_register_24", 10.0, "stop")
  movej([{start}], a=0.3, v=0.1)
  write_output_integer_register(24, {token})
  while read_input_integer_register(24) == 0:
    sync()
  end
  while read_input_integer_register(24) == 1:
    q = [{registers}]
    servoj(q, t={period}, lookahead_time=0.03, gain=300)
  end
  if read_input_integer_register(24) == 2:
    stopj(2.0)
  else:
    stopj({braking})
  end
  write_output_integer_register(24, {done})
end
"""


class RunEndedError(Exception):
    """The reason why a run was ended."""


class Rtde:
    """A connection by the real-time data exchange protocol, version 2."""

    def __init__(self, host: str, port: int = RTDE_PORT) -> None:
        self._socket = socket.create_connection((host, port), timeout=PATIENCE)
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._received = b""
        self._input_recipe = 0
        if self._exchange(_REQUEST_VERSION, struct.pack(">H", _VERSION)) != b"\x01":
            raise RunEndedError(f"the controller does not speak version {_VERSION} of RTDE")

    def start(self, frequency: float) -> None:
        """Agree on the signals, and start the exchange."""
        outputs = struct.pack(">d", frequency) + ",".join(_OUTPUTS).encode()
        self._check_recipe(_OUTPUTS, self._exchange(_SETUP_OUTPUTS, outputs))
        inputs = self._exchange(_SETUP_INPUTS, ",".join(_INPUTS).encode())
        self._check_recipe(_INPUTS, inputs)
        self._input_recipe = inputs[0]
        if self._exchange(_START) != b"\x01":
            raise RunEndedError("the controller does not start the exchange of data")

    def receive(self) -> dict[str, FloatArray]:
        """Return the next package of the controller."""
        payload = self._wait_for(_DATA)
        values = struct.unpack_from(">" + "".join(_FORMATS[kind] for kind in _OUTPUTS.values()), payload, 1)
        sizes = [6 if kind == "VECTOR6D" else 1 for kind in _OUTPUTS.values()]
        parts = np.split(np.array(values, dtype=np.float64), np.cumsum(sizes)[:-1])
        return dict(zip(_OUTPUTS, parts, strict=True))

    def send(self, command: int, q: FloatArray) -> None:
        """Set the registers that the program on the controller reads."""
        self._send(_DATA, struct.pack(">Bi6d", self._input_recipe, command, *q))

    def close(self) -> None:
        """End the connection."""
        self._socket.close()

    @staticmethod
    def _check_recipe(wanted: dict[str, str], payload: bytes) -> None:
        kinds = payload[1:].decode().split(",")
        # NOT_FOUND for a signal that this controller does not have, IN_USE for a register of somebody else.
        for (name, kind), got in zip(wanted.items(), kinds, strict=True):
            if got != kind:
                raise RunEndedError(f"the controller says {got} of {name}")

    def _exchange(self, kind: int, payload: bytes = b"") -> bytes:
        self._send(kind, payload)
        return self._wait_for(kind)

    def _send(self, kind: int, payload: bytes) -> None:
        self._socket.sendall(struct.pack(">HB", 3 + len(payload), kind) + payload)

    def _wait_for(self, kind: int) -> bytes:
        while True:
            size, got = struct.unpack(">HB", self._read(3))
            if size < 3:
                raise RunEndedError("the controller sent a package that is none of RTDE")
            payload = self._read(size - 3)
            if got == kind:
                return payload
            if got == _TEXT and payload:
                print("controller:", payload[1 : 1 + payload[0]].decode(errors="replace"), file=sys.stderr)

    def _read(self, size: int) -> bytes:
        while len(self._received) < size:
            try:
                chunk = self._socket.recv(65536)
            except TimeoutError as error:
                raise RunEndedError(f"the controller sent nothing for {PATIENCE:g} s") from error
            if not chunk:
                raise RunEndedError("the controller closed the connection")
            self._received += chunk
        taken, self._received = self._received[:size], self._received[size:]
        return taken


def read_motion(path: Path) -> tuple[list[str], FloatArray, FloatArray]:
    """Read the six joints of a motion: their names, t (m,) and q (m, 6)."""
    names = path.read_text(encoding="utf-8").split("\n", 1)[0].strip().split(",")
    rows = np.loadtxt(path, delimiter=",", skiprows=1, ndmin=2)
    if len(rows) < 2:
        raise RunEndedError(f"{path} has no motion")
    joints = [name.removeprefix("q_") for name in names if name.startswith("q_")]
    if len(joints) != 6:
        raise RunEndedError(f"{path} moves {len(joints)} joints, and the arm has 6")
    return joints, rows[:, names.index("t")], rows[:, [names.index(f"q_{joint}") for joint in joints]]


def write_program(start: FloatArray, token: int, frequency: float) -> str:
    """Return the program that follows the registers on the controller."""
    registers = ", ".join(f"read_input_float_register({k})" for k in range(24, 30))
    posture = ", ".join(f"{angle:.6f}" for angle in start)
    return PROGRAM.format(
        start=posture, token=token, done=token + 1, registers=registers, period=1.0 / frequency, braking=BRAKING
    )


def follow(
    host: str,
    t: FloatArray,
    q: FloatArray,
    write_row: Callable[[Sequence[float]], object],
    frequency: float = FREQUENCY,
    ports: Sequence[int] = (RTDE_PORT, PROGRAM_PORT),
) -> None:
    """Move the arm along a motion; `write_row` gets time, positions and currents (13,) as the controller sends them."""
    rtde = Rtde(host, ports[0])
    try:
        rtde.start(frequency)
        actual = rtde.receive()["actual_q"]
        if not (np.abs(actual - q[0]) < NEAR).all():
            words = ", ".join(f"{angle:.3f}" for angle in q[0])
            raise RunEndedError(f"the arm does not stand at the first posture of the motion; move it to {words} rad")
        token = 2 * int(time.time() % 1e9)
        with socket.create_connection((host, ports[1]), timeout=PATIENCE) as program:
            program.sendall(write_program(q[0], token, frequency).encode())
            try:
                _stream(rtde, token, t, q, write_row)
            except BaseException:
                # A signal, too, ends a run early.
                with contextlib.suppress(OSError):
                    rtde.send(_BRAKE, q[0])
                raise
    finally:
        rtde.close()


def _stream(
    rtde: Rtde, token: int, t: FloatArray, q: FloatArray, write_row: Callable[[Sequence[float]], object]
) -> None:
    started, deadline = None, time.monotonic() + PATIENCE
    while True:
        package = rtde.receive()
        now, actual = float(package["timestamp"][0]), package["actual_q"]
        mode, message = int(package["safety_mode"][0]), int(package["output_int_register_24"][0])
        if mode not in _SAFE_MODES:
            raise RunEndedError(f"the controller stopped the arm (safety mode {mode})")
        if message == token + 1:
            return
        if started is None:
            rtde.send(_WAIT, q[0])
            if message == token:
                started = now
            elif time.monotonic() > deadline:
                raise RunEndedError("the program does not start; is the controller in remote control?")
            continue
        since = now - started
        if since > t[-1] + PATIENCE:
            raise RunEndedError("the program did not end")
        # The controller's own time: a package that it skipped shifts nothing.
        target = np.array([np.interp(since, t, column) for column in q.T])
        if not (np.abs(actual - target) < LARGEST_ERROR).all():
            joint = int(np.argmax(np.abs(actual - target))) + 1
            raise RunEndedError(f"joint {joint} does not follow after {since:.2f} s")
        rtde.send(_FOLLOW if since < t[-1] else _END, target)
        if since <= t[-1]:
            write_row([since, *actual, *package["actual_current"]])


def main(arguments: list[str] | None = None, ports: Sequence[int] = (RTDE_PORT, PROGRAM_PORT)) -> int:
    """Run the script; 0 where a recording was written."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("host", help="address of the controller")
    for name in ("motion", "recording"):
        parser.add_argument(name, type=Path)
    parser.add_argument("--frequency", type=float, default=FREQUENCY, help="packages per second: 500, or 125 of a CB3")
    given = parser.parse_args(arguments)
    unfinished = given.recording.with_name(f"{given.recording.name}.part")
    try:
        joints, t, q = read_motion(given.motion)
        with unfinished.open("w", encoding="utf-8", buffering=1) as rows:
            names = ["t", *(f"q_{joint}" for joint in joints), *(f"current_{joint}" for joint in joints)]
            rows.write(",".join(names) + "\n")

            def write_row(values: Sequence[float]) -> None:
                rows.write(",".join(f"{value:.9g}" for value in values) + "\n")

            follow(given.host, t, q, write_row, given.frequency, ports)
    except (RunEndedError, OSError, ValueError, struct.error) as error:
        print(f"run ended: {error}", file=sys.stderr)
        return 1
    unfinished.replace(given.recording)
    return 0


if __name__ == "__main__":
    signal.signal(signal.SIGTERM, lambda *_: sys.exit("ended by a signal"))
    sys.exit(main())
