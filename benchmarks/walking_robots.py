"""Robots on their feet, in MuJoCo: what is identified while nobody measures the forces of the ground.

    python benchmarks/walking_robots.py [--robots quadruped,humanoid] [--seed 1] [--draws 10] [--rate 200]

A quadruped (Go2, 12 joints) and a humanoid (G1, 29 joints) sway on their feet, and lift them one after the other
(`engine/walking.py`). The program gets the maker's description, whose masses, centres and inertias are some 15 % off
the robot that moves, the pose of the base with noise (0.3 mm, 0.5 mrad), positions of the joints with noise (0.1 mrad)
and torques with noise of 1 %. It identifies the robot from recordings of both kinds, and predicts two more.

`ratio`: error of the held-out torques over that of a model of the same structure, filters and methods that is fitted
to these recordings themselves, of all equations together, and of the worst one.

Then 0.5 kg are fixed to a shank or to the trunk, in turn, at a drawn place, and `changes` compares recordings before
and after. `right`: an added mass is named on that link and nothing else; `m l`: its first moment about the frame of
the link, within 10 %.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from pathlib import Path

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(name, "1")

import numpy as np
from common import show
from engine.walking import KINDS, Kind, build_walker, record_walk, write_log

import dynident as dy
from dynident.recordings.preprocessing import Preprocessing
from dynident.robot import Robot

LOAD = 0.5
"""Added mass, kg."""
PACES = (1.0, 0.7, 0.85)


def record(kind: Kind, seed: int, name: str, folder: Path, args: argparse.Namespace, load: int | None = None) -> Path:
    """Record a robot; `name` is "stand" or "step" with a number, `load` the number of a draw."""
    walker = build_walker(kind, seed)
    if load is not None:
        walker.load_link(*place_load(kind, seed, load))
    stepping, number = name.startswith("step"), int(name[-1])
    motion = 10_000 * seed + 100 * (0 if load is None else load + 1) + 10 * stepping + number
    log = record_walk(walker, motion, stepping=stepping, duration=args.duration, pace=PACES[number], rate=args.rate)
    return write_log(folder / f"{kind.name}_{name}_{'bare' if load is None else load}.csv", log)


def place_load(kind: Kind, seed: int, number: int) -> tuple[str, float, np.ndarray]:
    """Return the link, the mass and the place (m) of a drawn load: on a shank, or on the trunk."""
    rng = np.random.default_rng([seed, number, 9])
    if number % 2:
        place = rng.uniform([-0.1, -0.06, 0.0], [0.1, 0.06, 0.1])
        return kind.torso, LOAD, place
    return str(rng.choice(kind.shanks)), LOAD, rng.uniform([-0.03, -0.02, -0.18], [0.03, 0.02, -0.06])


def load_robot(kind: Kind) -> Robot:
    """Return the description, with the feet that the user names."""
    return dy.set_base(dy.load_robot(kind.name), "floating", kind.contacts)


def identify(kind: Kind, folder: Path, args: argparse.Namespace) -> tuple[dy.Model, list[Path], list[str]]:
    """Return a model, the recordings before a change, and the row of the table."""
    robot = load_robot(kind)
    names = ("stand0", "step0", "stand1", "step1", "stand2", "step2")
    files = [record(kind, args.seed, name, folder, args) for name in names]
    runs = dy.read_recordings(*files, robot=robot)
    start = time.process_time()
    model = dy.identify(robot, runs[:4], validation=runs[4:])
    duration = time.process_time() - start
    filters = model.identification.preprocessing
    same = dy.IdentificationChoices(
        preprocessing=Preprocessing(filters.position_cutoff, filters.torque_cutoff, filters.decimation)
    )
    floor = dy.identify(robot, runs[4:], choices=same).errors.to_frame()
    errors = model.errors.to_frame()
    held_out, fitted = errors["held_out_moving_rms"].to_numpy(), floor["fit_moving_rms"].to_numpy()
    mass = next(row for row in model.parameters if row.name == f"M{robot.n_base}")
    true_mass = build_walker(kind, args.seed).mass
    row = [
        kind.name,
        f"{np.sqrt((held_out**2).sum() / (fitted**2).sum()):.2f}",
        f"{(held_out / fitted).max():.2f}",
        f"{np.linalg.norm(held_out):.3f}",
        f"{mass.value:.2f} ± {mass.standard_deviation:.2f} kg",
        f"{true_mass:.2f} kg ({mass.value / true_mass - 1:+.2%})",
        f"{duration:.0f} s",
    ]
    return model, files[:2], row


def find_load(
    model: dy.Model, kind: Kind, before: list[Path], folder: Path, number: int, args: argparse.Namespace
) -> tuple[bool, float, list[str]]:
    """Return whether a load was named on its link alone, the relative error of m l, and the row of the table."""
    robot = model.robot
    link, mass, place = place_load(kind, args.seed, number)
    after = [record(kind, args.seed, name, folder, args, number) for name in ("stand0", "step0")]
    start = time.process_time()
    changes = dy.changes(
        model, before=dy.read_recordings(*before, robot=robot), after=dy.read_recordings(*after, robot=robot)
    )
    duration = time.process_time() - start
    links = {joint.name: joint.link for joint in robot.tree.joints}
    named = [
        f"{change.choice.effect} on {', '.join(links[joint] for joint in change.choice.joints)}" for change in changes
    ]
    right = named == [f"payload on {link}"]
    error, estimate = float("nan"), float("nan")
    if right:
        values = {value.parameter: value.value for value in (changes[0].main, *changes[0].more)}
        estimate, true_size = changes[0].main.value, mass * float(np.linalg.norm(place))
        error = values["m l"] / true_size - 1.0
    row = [
        str(number),
        link,
        "; ".join(named) or "nothing",
        f"{estimate:.3f} kg",
        f"m l {error:+.1%}",
        f"{duration:.0f} s",
    ]
    print("  ".join(row), flush=True)
    return right, error, row


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robots", default="quadruped,humanoid")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--draws", type=int, default=10)
    parser.add_argument("--duration", type=float, default=30.0, help="of a recording, s")
    parser.add_argument("--rate", type=float, default=200.0, help="of the recordings, Hz")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        rows, loads = [], []
        for kind in (KINDS[name] for name in args.robots.split(",")):
            model, before, row = identify(kind, folder, args)
            rows.append(row)
            print("  ".join(row), flush=True)
            outcomes = [find_load(model, kind, before, folder, number, args) for number in range(args.draws)]
            near = sum(right and abs(error) < 0.1 for right, error, _ in outcomes)
            loads.append([kind.name, f"{sum(right for right, *_ in outcomes)} of {len(outcomes)}", str(near)])
    head = ["robot", "ratio", "worst equation", "error, N and N m", "mass", "true mass", "processor time"]
    show("identified while standing and stepping", [head, *rows])
    if args.draws:
        show(f"{LOAD} kg added", [["robot", "right", "m l within 10 %"], *loads])


if __name__ == "__main__":
    main()
