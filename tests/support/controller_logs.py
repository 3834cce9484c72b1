"""One recording as controllers, scopes and simulators write it, with the faults of their files, from any robot."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from support.logger_layouts import FloatArray, Recorded, cells, counted, number, table, written

Layout = Callable[[Path, Recorded], Path]


def in_units(run: Recorded) -> FloatArray:
    """The positions in degrees and millimetres."""
    return np.asarray(np.where(run.slides, 1e3, 180 / np.pi) * run.q)


def german(text: str) -> str:
    return text.replace(".", ",")


def scope(folder: Path, run: Recorded) -> Path:
    """TwinCAT Scope: a head of keys, then time and value of each channel side by side."""
    names = [*counted("Axis{}.ActPos", run.n, 1), *counted("Axis{}.ActTorque", run.n, 1)]
    values = np.column_stack([run.q, run.tau]).T
    head = ["Name\tScope01", "StartRecord\t128783093223690000\tThursday, 5 February 2009\t13:08:42", ""]
    for key, texts in (
        ("Name", names),
        ("SampleTime[ms]", ["4"] * len(names)),
        ("SymbolName", [f"MAIN.{name}" for name in names]),
        ("SymbolComment", [""] * len(names)),
        ("Data-Type", ["REAL64"] * len(names)),
    ):
        head.append("\t".join(f"{key}\t{text}" for text in texts))
    t = [number(1e3 * t) for t in run.t]
    columns = [[german(cell) for cell in column] for value in cells(values.T) for column in (t, value)]
    return written(folder / "scope.csv", "\r\n".join([*head, "", table([], columns, "\t", "\r\n")]))


def scope_of_two_rates(folder: Path, run: Recorded) -> Path:
    """A scope whose torques have half the rate: their columns end in the middle of the file."""
    half = slice(None, None, 2)
    names = [*counted("J{}.Position", run.n, 1), *counted("J{}.Torque", run.n, 1)]
    head = [";".join(f"Name;{name}" for name in names)]
    rows = len(run.t)

    def pad(values: Sequence[str]) -> list[str]:
        return [*values, *[""] * (rows - len(values))]

    columns = [column for q in cells(run.q) for column in ([number(1e3 * t) for t in run.t], q)]
    late = run.t[half]
    columns += [column for tau in cells(run.tau[half]) for column in (pad([number(1e3 * t) for t in late]), pad(tau))]
    return written(folder / "rates.csv", "\n".join([*head, table([], columns, ";")]))


def filetime(folder: Path, run: Recorded) -> Path:
    """Times in ticks of 100 ns since 1601, and a last line that says so."""
    ticks = 133_500_000_000_000_000 + np.round(1e7 * run.t).astype(np.int64)
    header = ["Time", *counted("stAxis[{}].fActPos", run.n, 1), *counted("stAxis[{}].fActTorque", run.n, 1)]
    columns = [[str(tick) for tick in ticks], *([german(cell) for cell in column] for column in both(run))]
    return written(folder / "full.csv", table(header, columns, ";", "\r\n") + "EOF\r\n")


def both(run: Recorded) -> list[list[str]]:
    return [*cells(run.q), *cells(run.tau)]


def labview(folder: Path, run: Recorded) -> Path:
    n = 2 * run.n
    head = ["LabVIEW Measurement\t", "Separator\tTab", "Decimal_Separator\t,", "***End_of_Header***\t", ""]
    head += ["\t".join([f"Channels\t{n}", *[""] * (n - 1)]), "\t".join(["Delta_X", *["0,004"] * n])]
    head += ["\t".join(["***End_of_Header***", *[""] * n])]
    header = ["X_Value", *counted("Position_{}", run.n), *counted("Torque_{}", run.n), "Comment"]
    columns = [[german(number(t)) for t in run.t], *([german(cell) for cell in column] for column in both(run))]
    return written(folder / "run.lvm", "\r\n".join([*head, table(header, [*columns, [""] * len(run.t)], "\t", "\r\n")]))


def thousands(folder: Path, run: Recorded) -> Path:
    """A German sheet whose milliseconds have a point between thousands, and units below the names."""
    header = ["Zeit", *counted("Winkel {}", run.n, 1), *counted("Moment {}", run.n, 1)]
    units = ["ms", *("mm" if slides else "°" for slides in run.slides), *("N" if one else "Nm" for one in run.slides)]
    t = [f"{1e3 * t:,.1f}".replace(",", "_").replace(".", ",").replace("_", ".") for t in run.t]
    columns = [t, *([german(cell) for cell in column] for column in (*cells(in_units(run)), *cells(run.tau)))]
    path = folder / "sheet.csv"
    text = "\r\n".join(["sep=;", ";".join(header), ";".join(units), table([], columns, ";", "\r\n")])
    path.write_bytes(text.encode("cp1252"))
    return path


def quoted(folder: Path, run: Recorded) -> Path:
    header = ["Time [ms]", *(f"Joint {k} position [{'mm' if s else 'deg'}]" for k, s in enumerate(run.slides, 1))]
    header += [f"Joint {k} effort [{'mN' if slides else 'N.mm'}]" for k, slides in enumerate(run.slides, 1)]
    columns = [[number(1e3 * t) for t in run.t], *cells(in_units(run)), *cells(1e3 * run.tau)]
    marked = [[f'"{cell}"' for cell in column] for column in columns]
    return written(folder / "quoted.csv", table([f'"{name}"' for name in header], marked, ", "))


def plain_table(run: Recorded, names: str = "q{},tau{}") -> str:
    position, torque = names.split(",")
    header = ["t", *counted(position, run.n, 1), *counted(torque, run.n, 1)]
    return table(header, [[number(t) for t in run.t], *both(run)])


def separator_at_the_end(folder: Path, run: Recorded) -> Path:
    first, *rows = plain_table(run).splitlines()
    return written(folder / "ends.csv", "\r\n".join([first, *(f"{row}," for row in rows), ""]))


def cut_off(folder: Path, run: Recorded) -> Path:
    return written(folder / "cut.csv", plain_table(run)[:-61])


def runs_end_to_end(folder: Path, run: Recorded) -> Path:
    """Several files put together, each with its line of names."""
    first, *rows = plain_table(run, "position{},effort{}").splitlines()
    third = len(rows) // 3
    return written(folder / "all.csv", "\n".join([first, *rows[:third], first, *rows[third:], ""]))


def fortran(folder: Path, run: Recorded) -> Path:
    header = "".join(f"{name:>18}" for name in ["t", *counted("q{}", run.n, 1), *counted("tau{}", run.n, 1)])
    values = np.column_stack([run.t, run.q, run.tau])
    rows = ["".join(f"{value:18.9E}" for value in row).replace("E", "D") for row in values]
    return written(folder / "run.dat", "\n".join([header, *rows, ""]))


def same_names(folder: Path, run: Recorded) -> Path:
    """Columns of all joints with one name, as a table of arrays is written."""
    header = ["time", *["position"] * run.n, *["torque"] * run.n]
    return written(folder / "same.csv", table(header, [[number(t) for t in run.t], *both(run)]))


def other_senders(folder: Path, run: Recorded) -> Path:
    """`ros2 topic echo --csv` with the messages of a gripper between those of the arm, the first among them."""
    run, lines = run.shuffled(), []
    for k, t in enumerate(run.t):
        stamp = f"{1_700_000_000 + int(t)},{round(1e9 * (t % 1.0))},"
        if k % 6 == 0:
            lines.append(f"{stamp},finger_left,finger_right,0.03,0.03,0.0,0.0,0.0,0.0")
        values = (number(value) for one in (run.q, run.dq, run.tau) for value in one[k])
        lines.append(",".join([stamp, *run.joints, *values]))
    return written(folder / "states.csv", "\n".join([*lines, ""]))


def empty_places(folder: Path, run: Recorded) -> Path:
    """An array of ten motors, of which the robot has fewer."""
    rest = 10 - run.n
    header = ["tick", *(f"motor_state[{k}].{name}" for name in ("q", "tau_est", "temperature") for k in range(10))]
    zeros = np.zeros((len(run.t), rest))
    values = [run.q, zeros, run.tau, zeros, np.full((len(run.t), 10), 31.0)]
    return written(folder / "state.csv", table(header, [[number(1e3 * t) for t in run.t], *cells(np.hstack(values))]))


def numbers_of_servos(folder: Path, run: Recorded) -> Path:
    """Servos are numbered from 11."""
    header = ["time", *counted("id{}_position", run.n, 11), *counted("id{}_torque", run.n, 11)]
    return written(folder / "servos.csv", table(header, [[number(t) for t in run.t], *both(run)]))


def names_with_a_prefix(folder: Path, run: Recorded) -> Path:
    run = run.shuffled()
    header = ["time", *(f"/lab/arm_1/{joint}/{name}" for name in ("position", "effort") for joint in run.joints)]
    return written(folder / "prefix.csv", table(header, [[number(t) for t in run.t], *both(run)]))


def raw_beside_filtered(folder: Path, run: Recorded) -> Path:
    header = ["time", *counted("positions{}", run.n), *counted("torques{}", run.n), *counted("torques_raw{}", run.n)]
    raw = run.tau + 0.05 * run.tau.std(axis=0) * run.rng.normal(size=run.tau.shape)
    return written(folder / "raw.csv", table(header, [[number(t) for t in run.t], *both(run), *cells(raw)]))


def objects_beside_arrays(folder: Path, run: Recorded) -> Path:
    contacts = np.array({}, dtype=object)
    np.savez(folder / "run.npz", positions=run.q, torques=run.tau, times=run.t, contacts=contacts)
    return folder / "run.npz"


def forces_of_a_simulator(folder: Path, run: Recorded) -> Path:
    np.savez(folder / "run.npz", time=run.t, qpos=run.q, qfrc_actuator=run.tau, qfrc_bias=0.8 * run.tau, ctrl=run.q)
    return folder / "run.npz"


def console(folder: Path, run: Recorded) -> Path:
    """What a program printed: numbers with words before them, below lines of words alone."""
    lines = ["[INFO] controller started", "[INFO] homing done"]
    for t, q, tau in zip(run.t, run.q, run.tau, strict=True):
        lines.append(f"[{t:.6f}] q: {' '.join(map(number, q))} | tau: {' '.join(map(number, tau))}")
    return written(folder / "console.txt", "\n".join([*lines, ""]))


def structures(folder: Path, run: Recorded) -> Path:
    """Parquet with messages as structures of lists, the joints in the order of their names."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    run = run.sorted()
    messages = [
        {"name": list(run.joints), "position": q.tolist(), "effort": tau.tolist()}
        for q, tau in zip(run.q, run.tau, strict=True)
    ]
    stamps = pa.array((1_700_000_000_000_000 + np.round(1e6 * run.t)).astype("datetime64[us]"))
    pq.write_table(pa.table({"stamp": stamps, "joint_state": pa.array(messages)}), folder / "run.parquet")
    return folder / "run.parquet"


def other_units(folder: Path, run: Recorded) -> Path:
    """Minutes, and torques in kilogram-force centimetres."""
    header = ["Time [min]", *counted("q{}", run.n, 1)]
    header += [f"torque{k}_{'kgf' if slides else 'kgf.cm'}" for k, slides in enumerate(run.slides, 1)]
    effort = run.tau / np.where(run.slides, 9.80665, 0.0980665)
    return written(folder / "units.csv", table(header, cells(np.column_stack([run.t / 60.0, run.q, effort]))))


def units_in_cells(folder: Path, run: Recorded) -> Path:
    header = ["time", *counted("q{}", run.n, 1), *counted("tau{}", run.n, 1)]
    units = ["s", *("mm" if slides else "deg" for slides in run.slides), *("N" if s else "Nm" for s in run.slides)]
    columns = cells(np.column_stack([run.t, in_units(run), run.tau]))
    marked = [[f"{cell} {unit}" for cell in column] for column, unit in zip(columns, units, strict=True)]
    return written(folder / "cells.csv", table(header, marked))


def means_below(folder: Path, run: Recorded) -> Path:
    values = np.column_stack([run.q, run.tau])
    means = [f"{name},{','.join(map(number, of(values, axis=0)))}" for name, of in (("mean", np.mean), ("std", np.std))]
    return written(folder / "means.csv", "\n".join([plain_table(run).rstrip("\n"), *means, ""]))


def signs_of_print(folder: Path, run: Recorded) -> Path:
    """Swiss thousands, and the minus of a word processor."""
    header = ["t [us]", *counted("q{}", run.n, 1), *counted("tau{}", run.n, 1)]
    t = [f"{1e6 * t:,.0f}".replace(",", "'") for t in run.t]
    text = table(header, [t, *([cell.replace("-", "\u2212") for cell in column] for column in both(run))], ";")
    return written(folder / "print.csv", text.replace("e\u2212", "e-"))


def utf16_without_a_mark(folder: Path, run: Recorded) -> Path:
    path = folder / "run.csv"
    path.write_bytes(plain_table(run).encode("utf-16-le"))
    return path


def names_with_commas(folder: Path, run: Recorded) -> Path:
    """Commas between the names, and semicolons between the numbers."""
    first, *rows = plain_table(run).splitlines()
    return written(folder / "mixed.csv", "\n".join([first, *(row.replace(",", ";") for row in rows), ""]))


def english_thousands(folder: Path, run: Recorded) -> Path:
    header = ["t_us", *counted("q{}", run.n, 1), *counted("tau{}", run.n, 1)]
    t = [f"{1e6 * t:,.0f}" for t in run.t]
    columns = [t, *cells(run.q), *([f"{value:,.6f}" for value in column] for column in 1e3 * run.tau.T)]
    header = [
        f"{name}_{'mN' if run.slides[int(name[3:]) - 1] else 'mNm'}" if "tau" in name else name for name in header
    ]
    return written(folder / "thousands.tsv", table(header, columns, "\t"))


def pages(folder: Path, run: Recorded) -> Path:
    """A listing with the names and the units at the head of each page."""
    first, *rows = plain_table(run).splitlines()
    units = ",".join(["s", *["rad"] * run.n, *["Nm"] * run.n])
    lines = [first, units, *rows[:700], "", "Page 2", first, units, *rows[700:], ""]
    return written(folder / "pages.csv", "\n".join(lines))


CONTROLLER_LOGS: dict[str, Layout] = {
    layout.__name__: layout
    for layout in (
        scope, scope_of_two_rates, filetime, labview, thousands, quoted, separator_at_the_end, cut_off,
        runs_end_to_end, fortran, same_names, other_senders, empty_places, numbers_of_servos, names_with_a_prefix,
        raw_beside_filtered, objects_beside_arrays, forces_of_a_simulator, console, structures, other_units,
        units_in_cells, means_below, signs_of_print, utf16_without_a_mark, names_with_commas,
        english_thousands, pages,
    )
}  # fmt: skip
INTERPOLATED = frozenset({"scope_of_two_rates"})
