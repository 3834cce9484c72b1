"""Compute in three threads at once from nothing; run as a program, since what it looks for ends the process.

`python three_threads.py expressions` builds expressions in all of them. `python three_threads.py models` does so in
one of them, while the others do what a user does: identify, extend, predict, export, diagnose, compare, report.
"""

from __future__ import annotations

import faulthandler
import random
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime
from hashlib import sha256


def build_expressions(seed: int, is_enough: Callable[[], bool] = lambda: False) -> None:
    """Make and drop expressions whose constants other threads make and drop, too."""
    import casadi as ca

    draw = random.Random(seed)
    for _ in range(3000):
        if is_enough():
            return
        numbers = ca.SX([draw.randrange(50) for _ in range(40)] + [draw.randrange(30) * 0.1 for _ in range(40)])
        numbers * 3 + 0.5


def model_a_robot() -> str:
    """Return a hash of all that comes of an arm's recordings."""
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
        f'<joint name="j{k}" type="revolute"><origin xyz="0.3 0 {0.1 * k}"/><parent link="l{k - 1}"/>'
        f'<child link="l{k}"/><axis xyz="0 1 0"/><limit lower="-2.5" upper="2.5" velocity="3" effort="120"/></joint>'
        for k in (1, 2)
    )
    robot = robot_from_urdf("arm", f'<robot name="arm"><link name="l0"/>{links}</robot>')
    draw = np.random.default_rng(1)
    t = np.arange(600) / 100
    recordings = []
    for name in ("first", "second"):
        phases = draw.uniform(0, 6, (5, 2))
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


def main(task: str) -> None:
    """Run one task in all threads."""
    faulthandler.enable()
    # Threads are changed as often as Python can.
    sys.setswitchinterval(1e-5)
    import dynident.expressions  # noqa: F401 - the task "expressions" imports no more of the project than this

    with ThreadPoolExecutor(3) as pool:
        if task == "expressions":
            list(pool.map(build_expressions, range(3)))
            return
        models = [pool.submit(model_a_robot) for _ in range(2)]
        while not all(model.done() for model in models):
            build_expressions(3, lambda: all(model.done() for model in models))
        print(*(model.result() for model in models))


if __name__ == "__main__":
    main(sys.argv[1])
