"""All benchmarks of speed and memory, each with its rival in the same run, and the table of benchmarks/README.md.

    python benchmarks/run.py              every one of them three times; writes the table and ratios.json (15 min)
    python benchmarks/run.py extending    some of them; the table keeps the other rows
    python benchmarks/run.py --repeat     as the first, but writes nothing: fails where a ratio is more than a fifth off
    python benchmarks/run.py --quick      the short ones; fails where a ratio has fallen below half of the one kept

`--quick` takes the best of its runs, since a busy machine spoils some, and writes nothing.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import re
import statistics
import subprocess
import sys
import tempfile
import time
from importlib.metadata import version
from pathlib import Path

from compared import FILE, Comparison, read_comparisons

HERE = Path(__file__).resolve().parent
PAGE, KEPT = HERE / "README.md", HERE / "ratios.json"
BEGIN, END = "<!-- python benchmarks/run.py -->", "<!-- end of the table -->"
QUICK = ("regressor_throughput", "extending", "identification_speed")
LONG = (
    "large_recording",
    "diagnosis_ranking",
    "feasible_estimator",
    "reidentification",
    "design_speed",
    "night_of_robots",
)
RUNS, QUICK_RUNS = 3, 2
FALLEN = 0.5
"""Share of the kept ratio below which a benchmark has failed."""
REPEATED = 0.2
"""By how much of the kept ratio another run on an idle machine of the same kind may differ."""
PACKAGES = ("numpy", "scipy", "casadi", "pin", "llvmlite")

Rows = dict[tuple[str, str], list[Comparison]]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scripts", nargs="*", metavar="SCRIPT", help="all where none is named")
    parser.add_argument("--quick", action="store_true", help="the short ones, against the ratios kept")
    parser.add_argument("--repeat", action="store_true", help="hold all of them against the table, which stays")
    parser.add_argument("--runs", type=int, default=RUNS)
    asked = parser.parse_args()
    if unknown := set(asked.scripts) - {*QUICK, *LONG}:
        parser.error(f"no benchmark {', '.join(sorted(unknown))}; there are {', '.join([*QUICK, *LONG])}")
    if asked.quick:
        check(asked.scripts or QUICK)
        return
    if asked.repeat:
        repeat(asked.scripts or [*QUICK, *LONG], asked.runs)
        return
    rows = measured(asked.scripts or [*QUICK, *LONG], asked.runs)
    kept = json.loads(KEPT.read_text(encoding="utf-8")) if KEPT.exists() else []
    entries = [entry(key, found) for key, found in rows.items()]
    names = {(one["what"], one["rival"]) for one in entries}
    others = [one for one in kept if asked.scripts and (one["what"], one["rival"]) not in names]
    KEPT.write_text(json.dumps([*others, *entries], indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    text = PAGE.read_text(encoding="utf-8")
    new = f"{BEGIN}\n{table([*others, *entries])}\n{END}"
    PAGE.write_text(re.sub(f"{re.escape(BEGIN)}.*?{re.escape(END)}", lambda _: new, text, flags=re.DOTALL), "utf-8")


def measured(scripts: list[str] | tuple[str, ...], runs: int) -> Rows:
    """What the scripts stated, run so often one after the other; in every process one thread."""
    found: Rows = {}
    threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    with tempfile.TemporaryDirectory() as folder:
        for k in range(runs):
            for script in scripts:
                file, begun = Path(folder) / f"{script}{k}.jsonl", time.monotonic()
                environment = {**os.environ, **threads, FILE: str(file)}
                subprocess.run([sys.executable, HERE / f"{script}.py"], check=True, env=environment)
                print(f"-- {script}, run {k + 1} of {runs}: {time.monotonic() - begun:.0f} s", flush=True)
                for one in read_comparisons(file):
                    found.setdefault((one.what, one.rival), []).append(one)
    return found


def check(scripts: list[str] | tuple[str, ...]) -> None:
    """Fail where the best of a few runs is less than half as far ahead of its rival as the ratio kept."""
    kept = ratios_kept()
    fallen, compared = [], 0
    for key, found in measured(scripts, QUICK_RUNS).items():
        if key not in kept:
            continue
        compared += 1
        best = max(one.times_better for one in found)
        if best < FALLEN * kept[key]:
            fallen.append(f"{key[0]}, beside {key[1]}: {best:.2g} times better, it was {kept[key]:.2g}")
    if not compared:
        sys.exit("none of these has a ratio in benchmarks/ratios.json: run python benchmarks/run.py")
    if fallen:
        sys.exit("fallen below half:\n" + "\n".join(fallen))
    print(f"{compared} ratios, none fell below half of the one kept")


def repeat(scripts: list[str] | tuple[str, ...], runs: int) -> None:
    """Say how far the ratios are from those of the table; fail where one is more than a fifth off."""
    kept = ratios_kept()
    off = 0
    print(f"{machine()}:")
    for key, found in measured(scripts, runs).items():
        ratio = statistics.median(one.times_better for one in found)
        if key not in kept:
            print(f"  {'; beside '.join(key)}: {number(ratio)} times better; the table has no such row")
            continue
        apart = ratio / kept[key] - 1
        off += abs(apart) > REPEATED
        print(
            f"  {'; beside '.join(key)}: {number(ratio)} times better, in the table {number(kept[key])}: {apart:+.0%}"
        )
    if off:
        sys.exit(f"{off} of the ratios are more than {REPEATED:.0%} from those of the table")


def ratios_kept() -> dict[tuple[str, str], float]:
    """The ratios of the table, by what was measured and beside what."""
    return {(one["what"], one["rival"]): one["times better"] for one in json.loads(KEPT.read_text(encoding="utf-8"))}


def entry(key: tuple[str, str], found: list[Comparison]) -> dict[str, object]:
    """One row: medians, and the range of the ratio over the runs."""
    ratios = [one.times_better for one in found]
    return {
        "what": key[0],
        "rival": key[1],
        "kind": found[0].kind,
        "ours": statistics.median(one.ours for one in found),
        "theirs": statistics.median(one.theirs for one in found),
        "times better": statistics.median(ratios),
        "lowest": min(ratios),
        "highest": max(ratios),
        "runs": len(found),
        "on": machine(),
    }


def table(entries: list[dict[str, object]]) -> str:
    """The rows as Markdown, under the machine and the versions that they were measured with."""
    parts = []
    for place in dict.fromkeys(str(one["on"]) for one in entries):
        lines = [
            f"{place}:",
            "",
            "| what | dynident | beside | times better (lowest to highest) |",
            "|---|---|---|---|",
        ]
        for one in entries:
            if one["on"] == place:
                ours, theirs = (said(float(str(one[side])), str(one["kind"])) for side in ("ours", "theirs"))
                span = f"{number(one['lowest'])} to {number(one['highest'])}, {one['runs']} runs"
                better = f"{number(one['times better'])} ({span if one['runs'] != 1 else 'one run'})"
                lines.append(f"| {one['what']} | {ours} | {one['rival']}, {theirs} | {better} |")
        parts.append("\n".join(lines))
    return "\n\n".join(parts)


def said(value: float, kind: str) -> str:
    """A quantity with its unit."""
    if kind == "seconds":
        return f"{1e3 * value:.3g} ms" if value < 0.9995 else f"{value:,.3g} s" if value < 99.95 else f"{value:,.0f} s"
    return f"{float(f'{value:.3g}'):,.0f} {'samples/s' if kind == 'samples a second' else kind}"


def number(value: object) -> str:
    return f"{float(f'{float(str(value)):.2g}'):,g}"


def machine() -> str:
    """The processor and what is installed, in one line."""
    model = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.exists() and (named := re.search(r"model name\s*: (.+)", info.read_text())):
        model = named[1]
    versions = ", ".join(f"{name} {version(name)}" for name in PACKAGES)
    return f"{model}, {os.cpu_count()} cores, {platform.system()}, Python {platform.python_version()}, {versions}"


if __name__ == "__main__":
    main()
