"""How often the columns of renamed, shuffled recordings in other units are told right: unasked, asked, silently wrong.

    python benchmarks/imports.py --draws 200 --seed 7

The recordings are those of ../shared/data. Names, order and units are drawn; `--tuning` draws from other schemes of
names, which the rules were made with.
"""

from __future__ import annotations

import argparse
from collections import Counter
from dataclasses import dataclass

import common
import numpy as np
import pyarrow.parquet as pq

from dynident.api.robot_files import load_robot
from dynident.identification.column_inference.column_statistics import Sample
from dynident.identification.column_inference.infer_columns import propose
from dynident.robot import Robot

DATA = common.RECORDINGS
SETS = ("ur10e", "tx40", "kr300", "ur10", "airbot_play", "dvrk_psm")
DEGREE = np.pi / 180

# Per signal: position, velocity, torque, current, time; {j} counts from 1, {z} from 0, {n} is the joint's name.
TUNING = {
    "q1": ("q{j}", "dq{j}", "tau{j}", "i{j}", "t"),
    "joint_1_position": ("joint_{j}_position", "joint_{j}_velocity", "joint_{j}_torque", "joint_{j}_current", "time"),
    "actual_q_0": ("actual_q_{z}", "actual_qd_{z}", "actual_torque_{z}", "actual_current_{z}", "timestamp"),
    "by joint": ("{n}_pos", "{n}_vel", "{n}_torque", "{n}_cur", "stamp"),
    "JointAngle1": ("JointAngle{j}", "JointSpeed{j}", "JointTorque{j}", "MotorCurrent{j}", "Time"),
    "column1": None,
    "ch": None,
}
JUDGED = {
    "ax1.pos": ("ax{j}.pos", "ax{j}.vel", "ax{j}.trq", "ax{j}.curr", "Clock"),
    "q[0]": ("q[{z}]", "qd[{z}]", "tau[{z}]", "current[{z}]", "time"),
    "states": (
        "joint_states/position_{n}", "joint_states/velocity_{n}", "joint_states/torque_{n}", "joint_states/current_{n}",
        "timestamp",
    ),
    "A1_winkel": ("A{j}_Winkel", "A{j}_Geschwindigkeit", "A{j}_Drehmoment", "A{j}_Strom", "Zeit"),
    "theta_1": ("theta_{j}", "omega_{j}", "torque_{j}", "I{j}", "t"),
    "measured": ("meas_angle_{j}", "meas_speed_{j}", "meas_moment_{j}", "meas_amps_{j}", "sec_elapsed_time"),
    "jnt_pos_1": ("msr_jnt_pos_{j}", "msr_jnt_vel_{j}", "msr_jnt_trq_{j}", "msr_jnt_cur_{j}", "time_stamp"),
    "letters": None,
    "column": None,
}  # fmt: skip
EXTRAS = {"q_ref": "target", "tau_des": "target", "current_des": "target", "tau_motor": "motor", "q_link": "link"}
UNITS = {
    "q": {"rad": 1.0, "deg": 1 / DEGREE},
    "dq": {"rad/s": 1.0, "deg/s": 1 / DEGREE, "rpm": 60 / (2 * np.pi)},
    "tau": {"N m": 1.0, "mN m": 1e3, "kN m": 1e-3},
    "current": {"A": 1.0, "mA": 1e3},
    "t": {"s": 1.0, "ms": 1e3, "us": 1e6, "ns": 1e9},
}
SLIDING = {"rad": ("m", 1.0), "deg": ("mm", 1e3), "N m": ("N", 1.0), "mN m": ("mN", 1e3), "kN m": ("kN", 1e-3)}
GAINS = (14.87, 13.26, 11.13, 10.62, 11.03, 11.47)


@dataclass
class Drawn:
    sample: Sample
    columns: dict[str, str]
    units: dict[str, str]
    told: str


def robot_of(name: str) -> Robot:
    folder = DATA / name
    robot = load_robot(folder / ("robot.json" if name == "dvrk_psm" else "robot.urdf"))
    if name == "airbot_play":
        return load_robot(folder / "robot.urdf", locked_joints=dict.fromkeys(robot.joint_names[6:], 0.0))
    if name == "ur10e":
        return load_robot(folder / "robot.urdf", drive_gains=GAINS)
    return robot


def draw(rng: np.random.Generator, schemes: dict, robots: dict[str, Robot]) -> Drawn:
    name = SETS[rng.integers(len(SETS))]
    robot = robots[name]
    files = sorted((DATA / name).glob("*.parquet"))
    path = files[rng.integers(len(files))]
    table = pq.read_table(path).slice(0, 1 << 16)
    scheme = list(schemes)[rng.integers(len(schemes))]
    patterns = schemes[scheme]
    effort = "tau" if "tau1" in table.column_names else "current"
    signals = ["q", *(["dq"] if "dq1" in table.column_names and rng.random() < 0.7 else []), effort]
    units = {signal: list(UNITS[signal])[rng.integers(len(UNITS[signal]))] for signal in (*signals, "t")}
    named = rng.random() < 0.4
    columns: dict[str, str] = {}
    truth: dict[str, str] = {}
    values: dict[str, np.ndarray] = {}
    order: list[str] = []

    def add(ours: str, theirs: str, data: np.ndarray, unit: str) -> None:
        theirs = f"{theirs} [{unit}]" if named and patterns is not None else theirs
        columns[ours], values[theirs] = theirs, data
        order.append(theirs)

    t = table["t"].to_numpy()
    add(
        "t",
        "t0" if patterns is None else patterns[4],
        (t + rng.integers(2) * 1.7e9) * UNITS["t"][units["t"]],
        units["t"],
    )
    truth["t"] = units["t"]
    count = 0
    for signal in signals:
        for joint in range(robot.n):
            factor, unit = UNITS[signal][units[signal]], units[signal]
            if robot.joints[joint].kind == "prismatic":
                unit, factor = SLIDING.get(unit, (unit, factor))
            count += 1
            place = {"q": 0, "dq": 1, "tau": 2, "current": 3}[signal]
            theirs = (
                f"{'column' if scheme.startswith('column') else 'ch'}{count}"
                if patterns is None
                else (patterns[place].format(j=joint + 1, z=joint, n=robot.joint_names[joint]))
            )
            add(f"{signal}{joint + 1}", theirs, table[f"{signal}{joint + 1}"].to_numpy() * factor, unit)
            truth[f"{signal}{joint + 1}"] = unit
    if patterns is not None and rng.random() < 0.5:
        for extra, word in EXTRAS.items():
            base = "q" if extra.startswith("q") else "tau" if extra.startswith("tau") else "current"
            pattern = patterns[{"q": 0, "tau": 2, "current": 3}[base]]
            for joint in range(robot.n):
                if f"{extra}{joint + 1}" in table.column_names:
                    theirs = f"{word}_" + pattern.format(j=joint + 1, z=joint, n=robot.joint_names[joint])
                    values[theirs] = table[f"{extra}{joint + 1}"].to_numpy() * UNITS[base].get(units.get(base, ""), 1.0)
                    order.append(theirs)
    # Without any word in the names, shuffled columns are left to the reader of the question.
    if rng.random() < (0.6 if patterns is not None else 0.15):
        rng.shuffle(order)
    sample = Sample(tuple(order), np.column_stack([values[one] for one in order]), {})
    return Drawn(sample, columns, truth, f"{name}/{path.stem} {scheme} {units}{' named' if named else ''}")


def judged(drawn: Drawn, robot: Robot) -> tuple[str, str]:
    found = propose(drawn.sample, robot)
    wrong = [f"{ours}: {found.columns.get(ours)!r}" for ours, theirs in drawn.columns.items()
             if found.columns.get(ours) != theirs and not ours.startswith("dq")
             and not (ours[:-1] in ("tau", "current") and theirs in found.columns.values())]  # fmt: skip
    wrong += [f"{ours} is {theirs!r}" for ours, theirs in found.columns.items()
              if ours in drawn.columns and drawn.columns[ours] != theirs]  # fmt: skip
    for ours, unit in drawn.units.items():
        if ours not in found.columns:
            continue
        kind = ours.rstrip("0123456789")
        told = found.units.get(ours, found.units.get(kind))
        usual = {"t": "s", "q": "rad", "dq": "rad/s", "tau": "N m", "current": "A"}[kind]
        usual = {"m": "m", "mm": "m", "N": "N", "mN": "N", "kN": "N"}.get(unit, usual)
        if (told or usual) != unit:
            wrong.append(f"unit of {ours} is {unit}, told {told}")
    asked = [one for one in found.questions if one.field != "drives"]
    if any(ours.startswith("current") for ours in drawn.columns) and any(
        ours.startswith("tau") for ours in found.columns
    ):
        wrong.append("currents are taken for torques")
    verdict = "asked" if asked else "silently wrong" if wrong else "right"
    return verdict, "; ".join(wrong[:3]) + " | " + "; ".join(f"{one.field}: {one.detail[:90]}" for one in asked[:3])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--draws", type=int, default=200)
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--tuning", action="store_true")
    options = parser.parse_args()
    rng = np.random.default_rng(options.seed)
    robots = {name: robot_of(name) for name in SETS}
    counts: Counter[str] = Counter()
    for number in range(options.draws):
        drawn = draw(rng, TUNING if options.tuning else JUDGED, robots)
        verdict, why = judged(drawn, robots[drawn.told.split("/")[0]])
        counts[verdict] += 1
        if verdict != "right":
            print(f"{number} {verdict}: {drawn.told}: {why}", flush=True)
    print({verdict: f"{count} ({count / options.draws:.1%})" for verdict, count in counts.items()})


if __name__ == "__main__":
    main()
