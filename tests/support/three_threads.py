"""Compute in three threads at once from nothing; run as a program, since what it looks for ends the process.

`python three_threads.py expressions` builds expressions alone, `python three_threads.py models ROUNDS` does what a user
does: identify, predict, extend, export, diagnose, report.
"""

from __future__ import annotations

import faulthandler
import random
import sys
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime
from hashlib import sha256

N_THREADS = 3


def build_expressions(seed: int) -> str:
    """Make and drop expressions whose constants other threads make and drop, too."""
    import casadi as ca

    draw = random.Random(seed)
    for _ in range(3000):
        numbers = ca.SX([draw.randrange(50) for _ in range(40)] + [draw.randrange(30) * 0.1 for _ in range(40)])
        numbers = numbers * 3 + 0.5
    return str(numbers.shape)


def model_a_robot(n_joints: int) -> str:
    """Return a hash of all that comes of a robot's recordings."""
    import numpy as np

    from dynident.diagnosis import compare, diagnose
    from dynident.effects import EffectChoice
    from dynident.export import export_model
    from dynident.identification import IdentificationChoices, extend, identify
    from dynident.identification.identified_models.torque_prediction import predict
    from dynident.recordings import recording_from_arrays
    from dynident.reports import ReportedRecording, html_report
    from dynident.robot import robot_from_urdf

    links = "".join(
        f'<link name="l{k}"><inertial><origin xyz="0.2 0.1 0"/><mass value="4"/>'
        '<inertia ixx="0.05" ixy="0" ixz="0" iyy="0.06" iyz="0" izz="0.04"/></inertial></link>'
        f'<joint name="j{k}" type="revolute"><origin xyz="0.3 0 {0.1 * k}"/><parent link="{f"l{k - 1}" if k else "base"}"/>'
        f'<child link="l{k}"/><axis xyz="0 1 0"/><limit lower="-2.5" upper="2.5" velocity="3" effort="120"/></joint>'
        for k in range(n_joints)
    )
    robot = robot_from_urdf(f"arm{n_joints}", f'<robot name="arm{n_joints}"><link name="base"/>{links}</robot>')
    draw = np.random.default_rng(n_joints)
    t = np.arange(1200) / 100
    recordings = []
    for name in ("first", "second"):
        phases = draw.uniform(0, 6, (5, n_joints))
        q = sum(np.sin(0.5 * (k + 1) * t[:, None] + phases[k]) / (k + 2) for k in range(5))
        dq = np.gradient(q, t, axis=0)
        tau = 5 * np.cos(q) + np.gradient(dq, t, axis=0) + np.sign(dq) + dq + draw.normal(0, 0.1, q.shape)
        recordings.append(recording_from_arrays(t, q, tau, joint_names=robot.joint_names, name=name))
    effects = tuple(EffectChoice(name) for name in ("rigid_body", "coulomb", "viscous"))
    first, second = recordings
    model = identify(robot, [first], [second], IdentificationChoices(effects))
    model = extend(model, [EffectChoice("stribeck", (robot.joint_names[0],))], [first], [second])
    torque = predict(model.estimate, q, dq, dq).torque
    files = [export_model(model, form).content for form in ("c", "casadi", "cpp_header")]
    diagnosis = diagnose(model, [first])
    reported = ReportedRecording(second, compare(model, second), True)
    page = html_report(model, (reported,), diagnosis=diagnosis, created=datetime(2026, 3, 4, tzinfo=UTC))
    return sha256(repr((torque.tolist(), files, page)).encode()).hexdigest()


def main(task: str, rounds: int = 1) -> None:
    """Run one task in all threads, as often as asked for."""
    faulthandler.enable()
    # Threads are changed as often as Python can.
    sys.setswitchinterval(1e-5)
    import dynident.expressions  # noqa: F401 - the task "expressions" imports no more of the project than this

    work = build_expressions if task == "expressions" else model_a_robot
    for _ in range(rounds):
        with ThreadPoolExecutor(N_THREADS) as pool:
            print(*pool.map(work, range(1, N_THREADS + 1)), flush=True)


if __name__ == "__main__":
    main(sys.argv[1], *map(int, sys.argv[2:]))
