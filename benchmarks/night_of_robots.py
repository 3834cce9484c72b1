"""Many robots of one type in a night: the model of each from yesterday's motion, and what has changed today.

    python benchmarks/night_of_robots.py [--robots 20] [--seconds 30] [--seed 1]

Each robot has its own motion on each day, and its own friction; on every fifth one joint has half as much Coulomb
friction more on the second day. The rival is the plain script: it identifies each day, and calls a parameter changed
that differs by more than four of its standard deviations.
"""

from __future__ import annotations

import argparse
import time

import numpy as np
import pinocchio
from common import (
    Samples,
    independent_columns,
    peak_memory,
    plain_identification,
    show,
    simulated_samples,
)
from compared import compared

from dynident.diagnosis import diagnose
from dynident.identification import identify
from dynident.recordings import Recording, recording_from_arrays
from dynident.robot import Robot, robot_from_library, to_pinocchio

RATE, CUTOFF, DECIMATION = 100.0, 8.0, 5
SURE = 4.0
"""Standard deviations of a difference from which on the rival calls it a change."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robots", type=int, default=20)
    parser.add_argument("--seconds", type=float, default=30.0, help="length of each recording")
    parser.add_argument("--seed", type=int, default=1)
    asked = parser.parse_args()
    robot = robot_from_library("ur10")
    model = to_pinocchio(robot)
    length = int(asked.seconds * RATE)
    nights = [two_days(model, length, asked.seed, number) for number in range(asked.robots)]
    ours_is_changed(robot, nights[0])
    before = time.process_time()
    ours = [ours_is_changed(robot, night) for night in nights]
    between = time.process_time()
    columns = independent_columns(model)
    theirs = [theirs_is_changed(model, columns, night) for night in nights]
    ours_time, theirs_time = (between - before) / asked.robots, (time.process_time() - between) / asked.robots
    changed = [is_changed(number) for number in range(asked.robots)]
    rows = [
        (name, f"{1e3 * seconds:.0f} ms", f"{seconds * 1000 / 2 / 60:.1f} min", *told(said, changed))
        for name, seconds, said in (("dynident", ours_time, ours), ("plain, each day", theirs_time, theirs))
    ]
    show(
        f"{asked.robots} robots x 2 x {asked.seconds:g} s x {robot.n} joints, seed {asked.seed}",
        [("", "a robot", "1,000 on two cores", "changed, told", "unchanged, told as changed"), *rows],
    )
    print(f"  largest memory of the process: {peak_memory():.0f} MB")
    what = f"a robot of a night, 2 x {asked.seconds:g} s x {robot.n} joints: model, and all that has changed"
    compared(what, ours_time, "plain Pinocchio and numpy, both days", theirs_time)


def is_changed(number: int) -> bool:
    """Whether the robot with this number has more friction on the second day."""
    return number % 5 == 4


def two_days(model: pinocchio.Model, length: int, seed: int, number: int) -> tuple[Samples, Samples]:
    """The robot's motions on both days."""
    days = [simulated_samples(model, length, RATE, seed=hash((seed, number, day)) % 2**32) for day in range(2)]
    if is_changed(number):
        joint = number // 5 % model.nv
        days[1].tau[:, joint] += 2.5 * np.sign(np.gradient(days[1].q[:, joint]))
    return days[0], days[1]


def ours_is_changed(robot: Robot, night: tuple[Samples, Samples]) -> bool:
    """Whether dynident names a change, from arrays."""
    yesterday, today = (recorded(robot, samples, f"day {k}") for k, samples in enumerate(night, start=1))
    identified = identify(robot, [yesterday])
    return bool(diagnose(identified, [today], baseline=[yesterday]).changes)


def recorded(robot: Robot, samples: Samples, name: str) -> Recording:
    """A day's recording."""
    return recording_from_arrays(samples.t, samples.q, samples.tau, joint_names=robot.joint_names, name=name)


def theirs_is_changed(model: pinocchio.Model, columns: np.ndarray, night: tuple[Samples, Samples]) -> bool:
    """Whether a parameter of the plain script differs."""
    a, b = (plain_identification(model, samples, columns, cutoff=CUTOFF, decimation=DECIMATION) for samples in night)
    return bool((np.abs(a.values - b.values) > SURE * np.hypot(a.deviations, b.deviations)).any())


def told(said: list[bool], changed: list[bool]) -> tuple[str, str]:
    """How many changed robots were told, and how many of the others."""
    pairs = list(zip(said, changed, strict=True))
    right, wrong = (sum(one for one, is_so in pairs if is_so == kind) for kind in (True, False))
    return f"{right} of {sum(changed)}", f"{wrong} of {len(changed) - sum(changed)}"


if __name__ == "__main__":
    main()
