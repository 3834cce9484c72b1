"""Move an arm of a MuJoCo scene along a planned motion, and record it as a real arm would be recorded.

    python mujoco_scene.py SCENE.xml MOTION.csv RECORDING.csv [--noise 0.005] [--seed 1]

Each joint of the motion has a position controller with gravity compensation; nothing compensates friction, so that
joints stick where the motion reverses. `frictionloss`, `damping` and `armature` of the joints come from the scene, its
actuators are not used. The recording has positions as an encoder counts them and the torque of the controllers with
noise. A run in which the arm touches something or does not follow is ended with its reason, and leaves no recording.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

STEP = 0.5e-3
"""Step of the simulation in s."""
RATE = 1000.0
"""Samples of the recording per second."""
BANDWIDTH = 8.0
"""Natural frequency of the position controllers in Hz: that of a stiff industrial arm."""
COUNTS = 2**19
"""Encoder counts per turn, or per 0.1 m of a prismatic joint."""
LARGEST_ERROR = 0.2
"""Distance from the motion at which a run is ended, rad or m."""
# MuJoCo's friction loss is a soft constraint, which by default smears Coulomb friction over some 0.1 rad/s. A time
# constant of two steps and an impedance near one make joints stick.
_SHARP = (0.9999, 0.9999, 0.001, 0.5, 2.0)


class RunEndedError(Exception):
    """The reason why a run was ended."""


@dataclass(frozen=True, eq=False)
class Motion:
    """A motion as `dynident campaign` writes it: t (m,), q and dq (m, n) of the named joints."""

    joints: list[str]
    t: FloatArray
    q: FloatArray
    dq: FloatArray


def read_motion(path: Path) -> Motion:
    """Read the columns t, q_NAME and dq_NAME of a motion."""
    names = path.read_text(encoding="utf-8").split("\n", 1)[0].strip().split(",")
    rows = np.loadtxt(path, delimiter=",", skiprows=1, ndmin=2)
    if len(rows) < 2:
        raise RunEndedError(f"{path} has no motion")
    joints = [name.removeprefix("q_") for name in names if name.startswith("q_")]
    q, dq = (rows[:, [names.index(kind + joint) for joint in joints]] for kind in ("q_", "dq_"))
    return Motion(joints, rows[:, names.index("t")], q, dq)


def load_scene(path: Path, joints: list[str]) -> tuple[mujoco.MjModel, list[int], list[int]]:
    """Load a scene with friction that sticks; return it with the joints' places in qpos and in qvel."""
    model = mujoco.MjModel.from_xml_path(str(path))
    scene = [model.joint(k).name for k in range(model.njnt)]
    absent = [joint for joint in joints if joint not in scene]
    if absent:
        raise RunEndedError(f"the scene has no joint {', '.join(absent)}; it has: {', '.join(scene)}")
    model.opt.timestep = STEP
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_ACTUATION)
    model.dof_solref[:] = (2 * STEP, 1.0)
    model.dof_solimp[:] = _SHARP
    positions = [int(model.joint(joint).qposadr[0]) for joint in joints]
    return model, positions, [int(model.joint(joint).dofadr[0]) for joint in joints]


def simulate_motion(path: Path, motion: Motion) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Move the arm along a motion; return the times (m,), positions and torques of the controllers (m, n)."""
    from scipy.interpolate import CubicHermiteSpline

    model, positions, dofs = load_scene(path, motion.joints)
    data = mujoco.MjData(model)
    data.qpos[positions] = motion.q[0]
    mujoco.mj_forward(model, data)
    inertia, column = np.empty(len(dofs)), np.empty(model.nv)
    for j, dof in enumerate(dofs):
        mujoco.mj_mulM(model, data, column, np.eye(model.nv)[dof])
        inertia[j] = column[dof]
    moved = np.isin(np.arange(model.nbody), model.dof_bodyid[dofs])
    for body, parent in enumerate(model.body_parentid):
        moved[body] |= moved[parent]
    rate = 2 * np.pi * BANDWIDTH
    stiffness, damping = inertia * rate**2, 2 * inertia * rate
    times = np.arange(0.0, motion.t[-1] + 0.5 * STEP, STEP)
    path_of = CubicHermiteSpline(motion.t, motion.q, motion.dq)
    wanted, wanted_speed = path_of(times), path_of.derivative()(times)
    q, tau = np.empty_like(wanted), np.empty_like(wanted)
    for k, time in enumerate(times):
        # qfrc_bias is gravity, Coriolis and centrifugal torque at the step before.
        torque = data.qfrc_bias[dofs] + stiffness * (wanted[k] - data.qpos[positions])
        torque += damping * (wanted_speed[k] - data.qvel[dofs])
        q[k], tau[k] = data.qpos[positions], torque
        data.qfrc_applied[dofs] = torque
        mujoco.mj_step(model, data)
        for contact in data.contact:
            bodies = [int(model.geom_bodyid[geom]) for geom in (contact.geom1, contact.geom2)]
            # Things in the scene may touch each other, and a margin makes contacts of what is near.
            if contact.dist < 0 and moved[bodies].any():
                names = " and ".join(model.body(body).name for body in bodies)
                raise RunEndedError(f"{names} touch after {time:.2f} s")
        apart = np.abs(data.qpos[positions] - wanted[k])
        if not (apart < LARGEST_ERROR).all():
            joint = motion.joints[int(np.argmax(apart))]
            raise RunEndedError(f"{joint} does not follow after {time:.2f} s: it is {apart.max():.2g} rad (m) away")
    every = round(1 / (RATE * STEP))
    return times[::every], q[::every], tau[::every]


def write_recording(path: Path, motion: Motion, rows: FloatArray) -> None:
    """Write t, q and tau (m, 1 + 2 n) of a recording; the file appears once it is complete."""
    names = ["t", *(f"q_{joint}" for joint in motion.joints), *(f"tau_{joint}" for joint in motion.joints)]
    unfinished = path.with_name(f"{path.name}.part")
    np.savetxt(unfinished, rows, fmt="%.9g", delimiter=",", header=",".join(names), comments="")
    unfinished.replace(path)


def main(arguments: list[str] | None = None) -> int:
    """Run the script; 0 where a recording was written."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    for name in ("scene", "motion", "recording"):
        parser.add_argument(name, type=Path)
    parser.add_argument("--noise", type=float, default=0.005, help="torque noise over the largest torque of the joint")
    parser.add_argument("--seed", type=int, help="seed of the noise; by default another one in each run")
    given = parser.parse_args(arguments)
    try:
        motion = read_motion(given.motion)
        times, q, tau = simulate_motion(given.scene, motion)
        rng = np.random.default_rng(given.seed)
        noise = given.noise * np.abs(tau).max(axis=0) * rng.standard_normal(tau.shape)
        model = mujoco.MjModel.from_xml_path(str(given.scene))
        is_linear = [model.joint(joint).type[0] == mujoco.mjtJoint.mjJNT_SLIDE for joint in motion.joints]
        count = np.where(is_linear, 0.1, 2 * np.pi) / COUNTS
        write_recording(given.recording, motion, np.column_stack([times, np.round(q / count) * count, tau + noise]))
    except (RunEndedError, OSError, ValueError) as error:
        print(f"run ended: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
