"""Open-loop drift of an identified model beside that of MuJoCo's own system identification, on the same recordings.

    python benchmarks/drift_beside_mujoco_sysid.py [--seconds 30] [--iterations 60] [--pieces 40] [--only simulated]

Both begin with the same description of the robot and the same recording for the fit. Ours is identified with default
effects and offsets, diagnosed, and extended by what the diagnosis recommends. `mujoco.sysid` optimises links (its
feasible parametrisation), armature, damping and frictionloss of every joint so that simulations of half a second,
spread over the recording, follow the robot. Both are then simulated from the same measured states of recordings that
neither saw, under the measured torque. The starting states come from the same filtered positions.

Needs the Python of an environment with dynident and the wheels of `mujoco[sysid]`. The UR10e is read from
../shared/data, where that exists; the other arm is a UR10 that MuJoCo moves, with friction that falls with the speed
and grows with the load.
"""

from __future__ import annotations

import argparse
import importlib
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from common import RECORDINGS, FloatArray, show
from engine import Arm, Instruments, fourier_motion, record, usual_drives
from engine.friction import LoadFriction, Stribeck
from engine.scene import Scene
from mujoco.rollout import rollout

import dynident as dy
from dynident.identification.estimators.identified_robot_simulator import RecordedMotion, read_pieces
from dynident.recordings import (
    RecordedJoints,
    Recording,
    RecordingMetadata,
    import_recording,
    recording_from_arrays,
)
from dynident.robot import Robot, robot_from_library
from dynident.validation.open_loop_drift import choose_drift_starts, compute_open_loop_drift

# Where one of its wheels is missing, the package is there and empty.
sysid: Any = importlib.import_module("mujoco.sysid")
if not hasattr(sysid, "optimize"):
    sys.exit("this benchmark needs the wheels of mujoco[sysid]")

HORIZONS = (0.1, 0.5, 2.0)
STEP = 0.002
PIECE = 0.5
EVERY = 0.01
GAINS = (14.87, 13.26, 11.13, 10.62, 11.03, 11.47)


@dataclass(frozen=True, eq=False)
class Case:
    """A robot, the recording that models are fitted to, and the recordings that they are judged on."""

    title: str
    robot: Robot
    fit: Recording
    held_out: tuple[Recording, ...]


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seconds", type=float, default=30.0, help="length of the recordings of the simulated arm")
    parser.add_argument("--iterations", type=int, default=60, help="at most so many iterations of mujoco.sysid")
    parser.add_argument("--pieces", type=int, default=40, help="at most so many half seconds for mujoco.sysid")
    parser.add_argument("--only", choices=("simulated", "ur10e"))
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        for case in read_cases(options.only, options.seconds, Path(folder)):
            compare_drift(case, options.iterations, options.pieces)


def read_cases(only: str | None, seconds: float, folder: Path) -> Iterator[Case]:
    if only != "ur10e":
        yield simulate_arm(seconds)
    if only != "simulated" and RECORDINGS.is_dir():
        robot = dy.load_robot(RECORDINGS / "ur10e" / "robot.urdf")
        joints = RecordedJoints(robot.joint_names, gains=GAINS)
        fit, *held_out = (
            import_recording(
                RECORDINGS / "ur10e" / f"{name}.parquet",
                folder / f"{name}.parquet",
                joints,
                metadata=RecordingMetadata(name=name),
            )[0]
            for name in ("id_30s_12harm", "val_ptp10", "id_50s_12harm")
        )
        yield Case("UR10e, fitted to id_30s_12harm", robot, fit, tuple(held_out))


def simulate_arm(seconds: float) -> Case:
    """Return a UR10 with sharp friction that falls with the speed and grows with the load, moved by MuJoCo."""
    robot = robot_from_library("ur10")
    drives = usual_drives(robot)
    hidden = [Stribeck(j, 0.4 * float(drives.coulomb[j]), 0.1) for j in range(robot.n)]
    arm = Arm(robot, drives, (*hidden, LoadFriction(1, 0.03), LoadFriction(2, 0.05)))
    recordings = []
    for seed in (0, 1):
        run = record(arm, fourier_motion(robot, seconds, seed), Instruments(rate=250.0), seed)
        recordings.append(
            recording_from_arrays(run.t, run.q, run.tau, joint_names=robot.joint_names, name=f"seed {seed}")
        )
    return Case(f"UR10 in MuJoCo, {seconds:g} s each", robot, recordings[0], tuple(recordings[1:]))


def compare_drift(case: Case, iterations: int, pieces: int) -> None:
    plain = dy.identify(case.robot, [case.fit], effects=("default", "offset"))
    grown = plain.extend(dy.diagnose(plain))
    rival = SysidModel(case.robot)
    preprocessing = plain.identification.preprocessing
    evaluations = rival.fit(read_pieces(case.fit, preprocessing), iterations, pieces)
    together: dict[str, list[FloatArray]] = {}
    for held_out in case.held_out:
        motions = read_pieces(held_out, preprocessing)
        ours = {"default effects": plain.identification, "after a diagnosis": grown.identification}
        drifts = {
            f"dynident, {title}": compute_open_loop_drift(model, [held_out], HORIZONS).distance
            for title, model in ours.items()
        }
        drifts[f"mujoco.sysid, {evaluations}"] = rival.compute_drift(motions)
        show_drifts(f"{case.title}, judged on {held_out.name}", drifts)
        for name, distance in drifts.items():
            together.setdefault(name, []).append(distance)
    if len(case.held_out) > 1:
        mean = {name: np.sqrt(np.mean(np.square(each), axis=0)) for name, each in together.items()}
        show_drifts(f"{case.title}, all {len(case.held_out)} recordings together", mean)


def show_drifts(title: str, drifts: dict[str, FloatArray]) -> None:
    """Print the rms drift over all joints after each time, and by joint after half a second."""
    rows = [("", *(f"after {horizon:g} s" for horizon in HORIZONS), "by joint after 0.5 s")]
    for name, distance in drifts.items():
        totals = np.sqrt(np.mean(distance**2, axis=1))
        joints = " ".join(f"{1e3 * value:.1f}" for value in distance[1])
        rows.append((name, *(f"{1e3 * total:.2f}" for total in totals), joints))
    show(f"{title}: rms drift in mrad", rows)


class SysidModel:
    """A robot as a user of `mujoco.sysid` describes it: links, armature, damping and sharp frictionloss."""

    def __init__(self, robot: Robot) -> None:
        drives = usual_drives(robot)
        self.n = robot.n
        # The description's inertias, and friction and rotors of a usual size, are where the optimiser begins.
        self.spec = mujoco.MjSpec.from_string(Scene.of(robot, drives, STEP).mjcf())
        for j in range(robot.n):
            self.spec.joint(f"j{j}").armature = drives.rotor[j]
        for name, kind in (("position", mujoco.mjtSensor.mjSENS_JOINTPOS), ("speed", mujoco.mjtSensor.mjSENS_JOINTVEL)):
            for j in range(robot.n):
                joint = mujoco.mjtObj.mjOBJ_JOINT
                self.spec.add_sensor(name=f"{name}{j}", type=kind, objtype=joint, objname=f"j{j}")
        self.model = self.spec.compile()
        self.parameters = sysid.ParameterDict()
        for body in self.spec.bodies[1:]:
            self.parameters.add(
                sysid.body_inertia_param(
                    self.spec,
                    self.model,
                    body.name,
                    sysid.InertiaType.Pseudo,
                    mass_bound_mult=np.array([0.05, 20.0]),
                    stretch_bound_mult=np.array([0.05, 20.0]),
                    modifier=set_of_body(body.name),
                )
            )
        for j in range(robot.n):
            for name, value in (
                ("armature", drives.rotor[j]),
                ("damping", drives.viscous[j]),
                ("frictionloss", drives.coulomb[j]),
            ):
                self.parameters.add(
                    sysid.Parameter(f"{name}{j}", value, 1e-3 * value, 20 * value, modifier=set_of_joint(name, f"j{j}"))
                )

    def fit(self, motions: Sequence[RecordedMotion], iterations: int, most: int) -> str:
        """Fit the parameters to simulations of half a second each; return how long the optimiser worked."""
        residual = self.build_residual(list_pieces(motions, most))
        scale = np.concatenate([parameter_scale(parameter) for parameter in self.parameters.values()])
        self.parameters, result = sysid.optimize(
            self.parameters, residual, verbose=False, max_iters=iterations, x_scale=scale
        )
        self.model = sysid.apply_param_modifiers(self.parameters, self.spec)
        return f"{len(result.extras['objective'])} iterations"

    def build_residual(self, pieces: Sequence[tuple[RecordedMotion, int]]) -> Any:
        """Return the residual that `sysid.optimize` takes: that of `sysid.residual`, all pieces in one rollout.

        It is the difference of positions and velocities over the rms of each signal. The package computes it piece by
        piece in Python, which takes four times as long, and takes the rms of each piece, in which a standing joint
        would count for more than all others.
        """
        steps = STEP * np.arange(round(PIECE / STEP))
        rows = np.arange(EVERY, PIECE + 1e-9, EVERY)
        states, torques, measured = [], [], []
        for motion, start in pieces:
            whole = motion.reference
            here = whole.t[start]
            states.append(sysid.create_initial_state(self.model, whole.q[start], whole.dq[start]))
            torques.append(interpolate(here + steps, whole.t, motion.tau))
            measured.append(np.hstack([interpolate(here + rows, whole.t, signal) for signal in (whole.q, whole.dq)]))
        initial, control, moved = np.array(states), np.array(torques), np.array(measured)
        size = np.sqrt(np.mean(moved**2, axis=(0, 1)))
        kept = np.rint(rows / STEP).astype(int) - 1
        data = mujoco.MjData(self.model)

        def residual(x: FloatArray, parameters: Any) -> tuple[list[FloatArray], None, None]:
            columns = []
            for values in x.reshape(len(x), -1).T:
                parameters.update_from_vector(values)
                model = sysid.apply_param_modifiers(parameters, self.spec)
                simulated, _ = rollout(model, data, initial, control)
                columns.append(((simulated[:, kept, 1 : 1 + 2 * self.n] - moved) / size).ravel())
            return [np.column_stack(columns) if x.ndim > 1 else columns[0]], None, None

        return residual

    def compute_drift(self, motions: Sequence[RecordedMotion]) -> FloatArray:
        """Return the rms distance (h, n) of the simulated from the measured positions, from the same starts as ours."""
        data, far = mujoco.MjData(self.model), []
        for motion, start in choose_drift_starts(motions, HORIZONS):
            whole = motion.reference
            t = whole.t[start] + STEP * np.arange(round(HORIZONS[-1] / STEP))
            state = sysid.create_initial_state(self.model, whole.q[start], whole.dq[start])
            states, _ = rollout(self.model, data, state, interpolate(t, whole.t, motion.tau))
            rows = [round(horizon / STEP) for horizon in HORIZONS]
            measured = interpolate(whole.t[start] + np.array(HORIZONS), whole.t, whole.q)
            distance = states[0, np.array(rows) - 1, 1 : 1 + self.n] - measured
            # A piece that ends before the horizon says nothing about it, as for ours.
            distance[whole.t[start] + np.array(HORIZONS) > whole.t[-1] + 1e-9] = np.nan
            far.append(distance)
        return np.asarray(np.sqrt(np.nanmean(np.square(far), axis=0)))


def parameter_scale(parameter: Any) -> FloatArray:
    """Return how far each component may plausibly be from where it begins: 0.3, 5 cm or its own size."""
    if parameter.size == 1:
        return np.abs(parameter.nominal)
    return np.concatenate([np.full(7, 0.3), np.full(3, 0.05)])


def set_of_body(name: str) -> Any:
    """Return the function that writes a body's inertia."""

    def write(spec: mujoco.MjSpec, parameter: Any) -> None:
        sysid.apply_body_inertia(spec, name, parameter)
        # MuJoCo 4.0.0 leaves a quaternion that is no number, with which MuJoCo 4.0.0 compiles no body.
        spec.body(name).iquat[:] = (1.0, 0.0, 0.0, 0.0)

    return write


def set_of_joint(name: str, joint: str) -> Any:
    """Return the function that writes a parameter into an attribute of a joint."""

    def write(spec: mujoco.MjSpec, parameter: Any) -> None:
        value = float(parameter.value[0])
        # Damping has three coefficients, for polynomials of the speed; the first is linear.
        current = np.atleast_1d(getattr(spec.joint(joint), name))
        if current.size > 1:
            value = np.array([value, *np.zeros(current.size - 1)]).reshape(current.shape)
        setattr(spec.joint(joint), name, value)

    return write


def list_pieces(motions: Sequence[RecordedMotion], most: int) -> list[tuple[RecordedMotion, int]]:
    """Return motions and samples of them at which half seconds begin, at most so many, spread over all motions."""
    pieces = []
    for motion in motions:
        t = motion.reference.t
        starts = np.searchsorted(t, np.arange(t[0], t[-1] - PIECE - 2 * EVERY, PIECE))
        pieces += [(motion, int(k)) for k in starts]
    chosen = np.unique(np.linspace(0, len(pieces) - 1, min(len(pieces), most)).astype(int))
    return [pieces[index] for index in chosen]


def interpolate(t: FloatArray, times: FloatArray, signal: FloatArray) -> FloatArray:
    return np.column_stack([np.interp(t, times, column) for column in signal.T])


if __name__ == "__main__":
    main()
