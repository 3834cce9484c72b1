"""Other choices on data that are reduced already, against identifying anew from the recordings.

python benchmarks/reidentification.py
"""

from __future__ import annotations

from dataclasses import replace

from common import median_time, show, simulated_samples
from compared import compared

from dynident.effects import EffectChoice
from dynident.identification import IdentificationChoices, identify, reidentify
from dynident.recordings import Preprocessing, recording_from_arrays
from dynident.robot import robot_from_library, to_pinocchio

EFFECTS = tuple(EffectChoice(name) for name in ("rigid_body", "rotor_inertia", "coulomb", "viscous", "offset"))
N_SAMPLES, RATE, REPEATS = 20_000, 500.0, 7


def main() -> None:
    robot = robot_from_library("franka_panda")
    samples = simulated_samples(to_pinocchio(robot), N_SAMPLES, RATE)
    recording = recording_from_arrays(samples.t, samples.q, samples.tau, joint_names=robot.joint_names)
    choices = IdentificationChoices(EFFECTS, preprocessing=Preprocessing(10.0, 10.0, 10))
    known = identify(robot, [recording], [], choices)
    others = {
        "ordinary least squares": replace(choices, estimator="ols"),
        "weighted least squares": choices,
        "with the description as prior": replace(choices, prior="description"),
        "without offsets": replace(choices, effects=EFFECTS[:4]),
        "links alone": replace(choices, effects=EFFECTS[:1]),
        "wrist, then shoulder": replace(choices, strategy="sequential", steps="wrist_then_shoulder"),
        "link by link": replace(choices, strategy="sequential"),
        "physically feasible": replace(choices, estimator="feasible"),
    }
    rows = [("", "from reduced data", "from the recording", "ratio")]
    for name, other in others.items():
        again = median_time(lambda other=other: reidentify(known, other), REPEATS)
        anew = median_time(lambda other=other: identify(robot, [recording], [], other), 3)
        rows.append((name, f"{1e3 * again:.0f} ms", f"{1e3 * anew:.0f} ms", f"{again / anew:.2f}"))
        compared(f"7 joints again from reduced data: {name}", again, "from the recording", anew)
    print(f"{robot.name}: {N_SAMPLES} samples x {robot.n} joints, {known.model.n_parameters} parameters; ", end="")
    print(f"median of {REPEATS} runs")
    show("The same data with other choices", rows)


if __name__ == "__main__":
    main()
