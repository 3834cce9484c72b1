"""Does anything pass that cannot be right? Candidates are shifted in time, the final model stays as it is.

    python benchmarks/placebo.py [--seed 1 | --seed new] [--shifts 8] [--arms 8] [--only simulated | --only real]

Models are identified, diagnosed and grown by all that was recommended: arms of the benchmark of hidden effects, and
real arms where their recordings are at hand. Then the columns of every candidate are rolled within each run by a
random share of it, one for each effect and joint, and the decision rule is asked what is missing. Whatever it names is
made up. At most 2 % of the runs may name anything.
"""

from __future__ import annotations

import argparse
import json
import os
import secrets
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(name, "1")

import numpy as np
from common import show
from hiding.asking import kept
from hiding.case import Case
from hiding.drawing import PAIRS, Wanted, draw_cases
from hiding.families import FAMILIES
from placebos.decision import Question
from placebos.shifting import ShiftedCandidates, Shifts
from placebos.subjects import REAL_ARMS, Subject, real, simulated

from dynident.errors import DynidentError


@dataclass(frozen=True)
class Trial:
    """One subject: what its final model has in addition, what every shift made the rule name, seconds a shift."""

    subject: str
    added: tuple[str, ...]
    named: tuple[tuple[str, ...], ...]
    seconds: float
    failure: str = ""

    @property
    def passed(self) -> int:
        """Number of shifts in which anything passed."""
        return sum(map(bool, self.named))


def main() -> None:
    arguments = _arguments()
    seed = secrets.randbelow(10**6) if arguments.seed == "new" else int(arguments.seed)
    print(f"seed {seed}", flush=True)
    trials = []
    with tempfile.TemporaryDirectory() as folder:
        makers = _subjects(arguments, seed, Path(folder))
        for number, (name, make) in enumerate(makers):
            trial = tried(name, make, arguments.shifts, np.random.default_rng([seed, number]))
            trials.append(trial)
            said = trial.failure or "; ".join(" + ".join(names) for names in trial.named if names) or "nothing"
            print(f"  {trial.passed}/{len(trial.named)} {name}: {said} [{trial.seconds:.1f} s a shift]", flush=True)
    if arguments.json:
        arguments.json.write_text(json.dumps({"seed": seed, "trials": [asdict(trial) for trial in trials]}, indent=1))
    show(f"Placebo, seed {seed}", _table(trials))


def tried(name: str, make: Callable[[], Subject], shifts: int, rng: np.random.Generator) -> Trial:
    """What passes in one subject; where it cannot be identified, why."""
    try:
        subject = make()
        question = Question.of(subject.identification, subject.recordings)
        start = time.perf_counter()
        named = tuple(named_at(question, Shifts(rng)) for _ in range(shifts))
    except DynidentError as error:
        return Trial(name, (), (), 0.0, f"{type(error).__name__}: {error}")
    return Trial(name, subject.added, named, (time.perf_counter() - start) / shifts)


def named_at(question: Question, shifts: Shifts) -> tuple[str, ...]:
    """What the rule names where every candidate is shifted."""
    own = frozenset(column.key for column in question.identification.model.kept)
    return question.named(
        lambda observation, rows: ShiftedCandidates(observation, own, rows, shifts, question.kinds_of)
    )


def _subjects(arguments: argparse.Namespace, seed: int, folder: Path) -> Iterator[tuple[str, Callable[[], Subject]]]:
    if arguments.only != "real":
        for case in _cases(seed, arguments.arms):
            yield case.name, partial(simulated, case, arguments.cache)
    if arguments.only != "simulated":
        for arm in REAL_ARMS:
            if arm.is_here:
                yield arm.name, partial(real, arm, folder)


def _cases(seed: int, count: int) -> list[Case]:
    """Clean arms and arms with something hidden in turn."""
    rng = np.random.default_rng(seed)
    hidden = [*FAMILIES, *("+".join(pair) for pair in PAIRS)]
    drawn = [str(name) for name in rng.permutation(hidden)[: count // 2]]
    wanted = [name for pair in zip(["clean"] * len(drawn), drawn, strict=True) for name in pair]
    return draw_cases(Wanted(seed, 0, tuple([*wanted, "clean"][:count]), sizes=("full",)))


def _table(trials: Sequence[Trial]) -> list[tuple[str, ...]]:
    rows = [("", "added before", "shifts", "passed", "named")]
    for trial in trials:
        names = Counter(name.split(" on ")[0] for names in trial.named for name in names)
        told = ", ".join(f"{name} {count}" for name, count in names.most_common())
        rows.append((trial.subject, str(len(trial.added)), str(len(trial.named)), str(trial.passed), told or "-"))
    runs, passed = sum(len(trial.named) for trial in trials), sum(trial.passed for trial in trials)
    share = f"{passed / runs:.1%}" if runs else "-"
    return [*rows, ("in all", "", str(runs), str(passed), share)]


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--seed", default="1", help='a number, or "new"')
    parser.add_argument("--shifts", type=int, default=8, help="of every arm")
    parser.add_argument("--arms", type=int, default=8, help="simulated ones")
    parser.add_argument("--only", choices=("simulated", "real"))
    parser.add_argument("--json", type=Path, default=None, help="write every trial here")
    parser.add_argument("--cache", type=Path, default=kept())
    return parser.parse_args()


if __name__ == "__main__":
    main()
