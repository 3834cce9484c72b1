"""One recording as controllers, scopes and simulators write it, with the faults of their files, from any robot."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import h5py
import numpy as np
from scipy.io import savemat
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


def without_a_name_for_rows(folder: Path, run: Recorded) -> Path:
    """R's write.table: rows have names, and their column has none."""
    header = " ".join(f'"{name}"' for name in ["t", *counted("q{}", run.n, 1), *counted("tau{}", run.n, 1)])
    rows = table([], [[f'"{k + 1}"' for k in range(len(run.t))], [number(t) for t in run.t], *both(run)], " ")
    return written(folder / "r.txt", f"{header}\n{rows}")


def quoted_decimal_commas(folder: Path, run: Recorded) -> Path:
    header = ["Zeit [s]", *counted("Achse {} Lage", run.n, 1), *counted("Achse {} Moment", run.n, 1)]
    columns = [[f'"{german(cell)}"' for cell in column] for column in ([number(t) for t in run.t], *both(run))]
    return written(folder / "commas.csv", table([f'"{name}"' for name in header], columns, end="\r\n"))


def names_on_several_lines(folder: Path, run: Recorded) -> Path:
    header = ['"Time\n[s]"', *counted('"Joint {}\nangle"', run.n, 1), *counted('"Joint {}\ntorque"', run.n, 1)]
    return written(folder / "lines.csv", table(header, [[number(t) for t in run.t], *both(run)]))


def labels_of_series(folder: Path, run: Recorded) -> Path:
    """Grafana: names with labels."""
    run = run.shuffled()
    header = ["Time", *(f'"{name} {{joint=""{joint}"", robot=""r1""}}"' for name in ("position", "effort")
                        for joint in run.joints)]  # fmt: skip
    return written(folder / "series.csv", table(header, [[number(t) for t in run.t], *both(run)]))


def days(folder: Path, run: Recorded) -> Path:
    """Times as a spreadsheet counts them."""
    header = ["Date", *counted("q{}", run.n, 1), *counted("tau{}", run.n, 1)]
    return written(folder / "days.csv", table(header, [[f"{45418.25 + t / 86400:.12f}" for t in run.t], *both(run)]))


def compact_stamps(folder: Path, run: Recorded) -> Path:
    header = ["stamp", *counted("q{}", run.n, 1), *counted("tau{}", run.n, 1)]
    stamps = [f"20240506T1015{int(t):02d}.{round(1e6 * (t % 1.0)):06d}" for t in run.t]
    return written(folder / "compact.csv", table(header, [stamps, *both(run)]))


def seconds_and_microseconds(folder: Path, run: Recorded) -> Path:
    header = ["ZeitInSec", "ZeitInMicroSec", *counted("qMsr_LBR_14_R820_{}[rad]", run.n, 1)]
    header += counted("tauMsr_LBR_14_R820_{}[Nm]", run.n, 1)
    ticks = np.round(1e6 * run.t).astype(int)
    parts = [[str(1_700_000_000 + tick // 10**6) for tick in ticks], [str(tick % 10**6) for tick in ticks]]
    return written(folder / "parts.csv", table(header, [*parts, *both(run)], " "))


def times_since_the_row_before(folder: Path, run: Recorded) -> Path:
    header = ["dt [ms]", *counted("q{}", run.n, 1), *counted("tau{}", run.n, 1)]
    steps = 1e3 * np.diff(run.t, prepend=0.0)
    return written(folder / "steps.csv", table(header, [[number(step) for step in steps], *both(run)]))


def rare_units(folder: Path, run: Recorded) -> Path:
    """Gradians, and hundredths of N m."""
    header = ["t", *(f"q{k} [{'cm' if slides else 'gon'}]" for k, slides in enumerate(run.slides, 1))]
    header += [f"tau{k} [{'mN' if slides else 'cNm'}]" for k, slides in enumerate(run.slides, 1)]
    position = run.q * np.where(run.slides, 100.0, 200 / np.pi)
    effort = run.tau * np.where(run.slides, 1e3, 100.0)
    return written(folder / "gon.csv", table(header, cells(np.column_stack([run.t, position, effort]))))


def first_joints_in_degrees(folder: Path, run: Recorded) -> Path:
    """Two controllers in one file: the first joints are in degrees, the others in rad."""
    header = ["t", *counted("q{}", run.n, 1), *counted("tau{}", run.n, 1)]
    first = np.arange(run.n) < 2
    position = run.q * np.where(first & ~np.array(run.slides), 180 / np.pi, 1.0)
    return written(folder / "two.csv", table(header, cells(np.column_stack([run.t, position, run.tau]))))


def feather(folder: Path, run: Recorded) -> Path:
    from pyarrow import feather as arrow_files
    from pyarrow import table as arrow_table

    header = ["t", *counted("q{}", run.n, 1), *counted("tau{}", run.n, 1)]
    values = np.column_stack([run.t, run.q, run.tau]).T
    arrow_files.write_feather(
        arrow_table(dict(zip(header, values, strict=True))), folder / "run.feather", chunksize=999
    )
    return folder / "run.feather"


def signals_a_row(folder: Path, run: Recorded) -> Path:
    """A historian: each row is the value of one signal."""
    rows = ["timestamp,tag,value"]
    for t, q, tau in zip(run.t, run.q, run.tau, strict=True):
        for k in range(run.n):
            rows += [
                f"{number(t)},Axis{k + 1}.Position,{number(q[k])}",
                f"{number(t)},Axis{k + 1}.Torque,{number(tau[k])}",
            ]
    return written(folder / "tags.csv", "\n".join([*rows, ""]))


def arrays_with_names(folder: Path, run: Recorded) -> Path:
    """Arrays beside a list of the joints' names, in their order."""
    run = run.shuffled()
    np.savez(folder / "named.npz", time=run.t, joint_names=np.array(run.joints), position=run.q, effort=run.tau)
    return folder / "named.npz"


def names_in_hdf5(folder: Path, run: Recorded) -> Path:
    """NetCDF 4, which is HDF5: a dimension of joints has their names."""
    import h5py

    run = run.shuffled()
    with h5py.File(folder / "run.nc", "w") as file:
        file["time"], file["joint"] = run.t, [joint.encode() for joint in run.joints]
        file["position"], file["effort"] = run.q, run.tau
    return folder / "run.nc"


def durations(folder: Path, run: Recorded) -> Path:
    """Parquet with the time since the start as pandas has it."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    header = [*counted("q{}", run.n, 1), *counted("tau{}", run.n, 1)]
    columns = dict(zip(header, np.column_stack([run.q, run.tau]).T, strict=True))
    elapsed = pa.array(np.round(1e9 * run.t).astype("timedelta64[ns]"))
    pq.write_table(pa.table({"elapsed": elapsed, **columns}), folder / "run.parquet")
    return folder / "run.parquet"


def short_years(folder: Path, run: Recorded) -> Path:
    header = ["Time", *counted("J{}", run.n, 1), *counted("TQ{}", run.n, 1)]
    stamps = [f"06-MAY-24 10:15:{t:09.6f}" for t in run.t]
    return written(folder / "years.csv", table(header, [stamps, *both(run)]))


def rows_of_separators(folder: Path, run: Recorded) -> Path:
    first, *rows = plain_table(run).splitlines()
    return written(
        folder / "between.csv", "\n".join([first, *(line for row in rows for line in (row, "," * 2 * run.n))])
    )


def accounting_brackets(folder: Path, run: Recorded) -> Path:
    """Negative numbers in brackets."""
    header = ["t", *counted("q{}", run.n, 1), *counted("tau{}", run.n, 1)]
    columns = [[f"({cell[1:]})" if cell[0] == "-" else cell for cell in column] for column in both(run)]
    return written(folder / "brackets.csv", table(header, [[number(t) for t in run.t], *columns]))


def minus_behind(folder: Path, run: Recorded) -> Path:
    header = ["t", *counted("q{}", run.n, 1), *counted("tau{}", run.n, 1)]
    columns = [[f"{cell[1:]}-" if cell[0] == "-" else cell for cell in column] for column in both(run)]
    return written(folder / "behind.csv", table(header, [[number(t) for t in run.t], *columns], ";"))


def chinese(folder: Path, run: Recorded) -> Path:
    header = ["时间(s)", *(f"关节{k}角度({'mm' if slides else '°'})" for k, slides in enumerate(run.slides, 1))]
    header += [f"关节{k}力矩({'N' if slides else 'N·m'})" for k, slides in enumerate(run.slides, 1)]
    columns = cells(np.column_stack([run.t, in_units(run), run.tau]))
    return written(folder / "names.csv", table(header, columns))


def motors_beside_links(folder: Path, run: Recorded) -> Path:
    """Angles before and behind gears of 80 to 1; those of the links are the joints'."""
    names = ("motor_pos_{}", "link_pos_{}", "motor_torque_{}", "joint_torque_{}")
    header = ["t", *(name for pattern in names for name in counted(pattern, run.n, 1))]
    values = np.column_stack([run.t, 80.0 * run.q, run.q, run.tau / 80.0, run.tau])
    return written(folder / "sides.csv", table(header, cells(values)))


def japanese(folder: Path, run: Recorded) -> Path:
    return eastern(folder, run, ("時間(s)", "J{}位置({})", "J{}トルク({})"), "shift_jis")


def chinese_of_windows(folder: Path, run: Recorded) -> Path:
    return eastern(folder, run, ("时间(s)", "关节{}角度({})", "关节{}力矩({})"), "gb18030")


def russian_of_windows(folder: Path, run: Recorded) -> Path:
    return eastern(folder, run, ("время (s)", "угол {} [{}]", "момент {} [{}]"), "cp1251")


def eastern(folder: Path, run: Recorded, names: tuple[str, str, str], encoding: str) -> Path:
    header = [names[0], *(names[1].format(k, "mm" if slides else "deg") for k, slides in enumerate(run.slides, 1))]
    header += [names[2].format(k, "N" if slides else "Nm") for k, slides in enumerate(run.slides, 1)]
    path = folder / "names.csv"
    path.write_bytes(table(header, cells(np.column_stack([run.t, in_units(run), run.tau]))).encode(encoding))
    return path


def without_names_but_with_accelerations(folder: Path, run: Recorded) -> Path:
    values = np.column_stack([run.t, run.q, run.dq, np.gradient(run.dq, run.t, axis=0), run.tau])
    return written(folder / "values.csv", table(counted("V{}", values.shape[1], 1), cells(values)))


def gripper_behind(folder: Path, run: Recorded) -> Path:
    """A gripper counted behind the joints, which moves and has no torque."""
    header = ["t", *counted("q{}", run.n + 1, 1), *counted("tau{}", run.n + 1, 1)]
    opening = 0.04 + 0.04 * np.sign(np.sin(run.t))
    return written(
        folder / "hand.csv", table(header, cells(np.column_stack([run.t, run.q, opening, run.tau, 0.0 * run.t])))
    )


def cells_of_matlab(folder: Path, run: Recorded) -> Path:
    path = folder / "cells.mat"
    signals = {"t": run.t[:, None]}
    for name, values in (("q", run.q), ("tau", run.tau)):
        signals[name] = np.empty((1, run.n), dtype=object)
        for joint in range(run.n):
            signals[name][0, joint] = values[:, joint : joint + 1]
    savemat(path, signals)
    return path


def pages_of_hdf5(folder: Path, run: Recorded) -> Path:
    """Arrays of rows x 1 x joints, as visualisers of logs keep them."""
    path = folder / "pages.h5"
    with h5py.File(path, "w") as file:
        for name, values in (("positions", run.q), ("torques", run.tau)):
            file[f"joints_state/{name}/data"] = values[:, None, :]
            file[f"joints_state/{name}/timestamps"] = run.t[:, None]
    return path


def folders_of_yarp(folder: Path, run: Recorded) -> Path:
    """Files of one name in folders of their own, without names: a counter, the time and the values."""
    paths = []
    for name, values in (("encs", run.q), ("torque", run.tau)):
        (folder / name).mkdir()
        rows = [[str(k) for k in range(len(run.t))], *cells(np.column_stack([1700.0 + run.t, values]))]
        paths.append(written(folder / name / "data.log", table([], rows, " ")))
    return Path("+".join(map(str, paths)))


def names_but_for_units(folder: Path, run: Recorded) -> Path:
    """Only the unit in the name says which columns are positions, velocities and torques."""
    units = [("m", "m/s", "N") if slides else ("rad", "rad/s", "N m") for slides in run.slides]
    header = [f"Axis {k + 1} [{unit}]" for signal in range(3) for k, unit in enumerate(own[signal] for own in units)]
    columns = [[number(t) for t in run.t], *cells(np.column_stack([run.q, run.dq, run.tau]))]
    return written(folder / "units.csv", table(["Time [s]", *header], columns))


def interfaces_of_joints(folder: Path, run: Recorded) -> Path:
    """Flattened messages of ros2_control: a list of joints, and a list of effort, position and velocity of each."""
    run, m = run.shuffled(), len(run.t)
    header, columns = ["__time"], [[number(t) for t in run.t]]
    for k, joint in enumerate(run.joints):
        header += [f"/states/interface_values[{k}]/values[{place}]" for place in range(3)]
        header += [f"/states/joint_names[{k}]"]
        columns += [*cells(np.column_stack([run.tau[:, k], run.q[:, k], run.dq[:, k]])), [joint] * m]
    return written(folder / "interfaces.csv", table(header, columns))


CONTROLLER_LOGS: dict[str, Layout] = {
    layout.__name__: layout
    for layout in (
        scope, scope_of_two_rates, filetime, labview, thousands, quoted, separator_at_the_end, cut_off,
        runs_end_to_end, fortran, same_names, other_senders, empty_places, numbers_of_servos, names_with_a_prefix,
        raw_beside_filtered, objects_beside_arrays, forces_of_a_simulator, console, structures, other_units,
        units_in_cells, means_below, signs_of_print, utf16_without_a_mark, names_with_commas,
        english_thousands, pages, without_a_name_for_rows, quoted_decimal_commas, names_on_several_lines,
        labels_of_series, days, compact_stamps, seconds_and_microseconds, times_since_the_row_before, rare_units,
        first_joints_in_degrees, feather, signals_a_row, arrays_with_names, names_in_hdf5, durations, short_years,
        rows_of_separators, accounting_brackets, minus_behind, chinese, motors_beside_links,
        japanese, chinese_of_windows, russian_of_windows, without_names_but_with_accelerations, gripper_behind,
        cells_of_matlab, pages_of_hdf5, folders_of_yarp, names_but_for_units, interfaces_of_joints,
    )
}  # fmt: skip
INTERPOLATED = frozenset({"scope_of_two_rates"})
