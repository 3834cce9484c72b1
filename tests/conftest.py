"""What all tests share: slow ones run only when asked for with --slow, and as long studies with --thorough."""

from __future__ import annotations

import gc
import hashlib
import os
import pickle
import sys
import zlib
from collections import Counter
from collections.abc import Generator, Iterator, Sequence
from functools import wraps
from typing import TYPE_CHECKING

# Small matrices jitter in a multi-threaded BLAS, the more so beside other work.
for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(name, "1")

# Ten thousand tests are objects that stay: looking through them for garbage again and again takes a sixth of the time
# of their collection.
gc.set_threshold(100_000, 50, 50)

import pytest  # noqa: E402

from dynident.parallel import count_processors  # noqa: E402

if TYPE_CHECKING:
    from dynident.identification.recording_faults.fault_checks import DynamicsCheck
    from dynident.recordings import Recording
    from dynident.robot import Robot


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--slow", action="store_true", help="also run the tests that take more than a few seconds")
    parser.addoption(
        "--installation",
        default="sqlite_and_folder",
        choices=("sqlite_and_folder", "postgresql_and_s3", "postgresql_s3_and_cluster"),
        help="what the service is made of that the tests of the client speak to",
    )
    parser.addoption("--thorough", action="store_true", help="with all their cases: about an hour; implies --slow")


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers(config: pytest.Config) -> int:
    """As many as processors that this process may use, not as the machine has cores."""
    asked = os.environ.get("PYTEST_XDIST_AUTO_NUM_WORKERS")
    return int(asked) if asked else count_processors()


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    thorough = config.getoption("--thorough")
    left_out = {"thorough": not thorough, "slow": not (thorough or config.getoption("--slow"))}
    for item in items:
        for name, out in left_out.items():
            if out and name in item.keywords:
                item.add_marker(pytest.mark.skip(reason=f"{name}: run with --{name}"))
    if not thorough:
        _sample_sweeps(config, items)
    gc.freeze()


def _sample_sweeps(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave out four of five cases of a sweep: by their names, so that every machine runs the same ones."""
    sampled: set[tuple[object, ...]] = set()
    kept, left_out = [], []
    for item in items:
        is_sweep, group = _find_like_cases(item)
        # The first of like cases runs in any case: no test falls out as a whole.
        is_kept = not is_sweep or group not in sampled or zlib.crc32(item.nodeid.encode()) % 5 == 0
        sampled.add(group)
        (kept if is_kept else left_out).append(item)
    if left_out:
        config.hook.pytest_deselected(items=left_out)
        items[:] = kept


def _find_like_cases(item: pytest.Item) -> tuple[bool, tuple[object, ...]]:
    """Return whether a case is one of a sweep, and what it has in common with the cases that are like it.

    All cases of a test that is marked are a sweep, and those of any test that differ in nothing but a seed.
    """
    test = item.nodeid.partition("[")[0]
    indices: dict[str, int] = item.callspec.indices if hasattr(item, "callspec") else {}
    if "sweep" in item.keywords or "seed" not in indices:
        return "sweep" in item.keywords, (test,)
    return True, (test, *sorted(indices.items() - {("seed", indices["seed"])}))


@pytest.fixture(scope="session")
def thorough(pytestconfig: pytest.Config) -> bool:
    """Whether all cases of a study are wanted, and not only as many as show that something broke."""
    return bool(pytestconfig.getoption("--thorough"))


@pytest.fixture(scope="session", autouse=True)
def _the_same_rows_are_checked_once() -> Iterator[None]:
    """Check rows that tests read from many files, and import again and again, against their robot once in a process."""
    checks = sys.modules.get("dynident.identification.recording_faults.fault_checks")
    if checks is None:
        yield
        return
    import casadi
    from support.rows_alike import outline_rows

    compute, known = checks.check_recording_faults, {}
    sound: dict[bytes, DynamicsCheck] = {}

    @wraps(compute)
    def check(robot: Robot, recording: Recording, q: Sequence[str], tau: Sequence[str]) -> DynamicsCheck:
        read = [rows[:2] for rows in recording.source.rows(0, sum(one.length for one in recording.segments), 100_000)]
        said = (recording.joint_names, recording.joints_without_torque, recording.torque_from_commands)
        rate, segments, windows = recording.sampling_rate, recording.segments, recording.windows
        begun = segments[0].start_time if segments else 0.0
        spans = [(one.first_row, one.length, one.label, f"{one.start_time - begun:.4f}") for one in segments]
        # Robots with closed loops keep CasADi's expressions, which ask for this.
        with casadi.global_pickle_context():
            same = _digest(robot, said, rate, segments, windows, tuple(q), tuple(tau), read)
            alike = _digest(robot, said, f"{rate:.5g}", spans, windows, outline_rows(read))
        if same not in known:
            known[same] = sound.get(alike) or compute(robot, recording, q, tau)
            # What is found is said with the names of the columns, and with numbers.
            if all(one.status == "ok" for one in known[same].checks):
                sound[alike] = known[same]
        return known[same]

    with pytest.MonkeyPatch.context() as patch:
        for module in list(sys.modules.values()):
            if getattr(module, "__name__", "").startswith("dynident") and vars(module).get(compute.__name__) is compute:
                patch.setattr(module, compute.__name__, check)
        yield


def _digest(*contents: object) -> bytes:
    # Each by itself: what is the same object within one pickle is written there once.
    return hashlib.sha256(b"".join(hashlib.sha256(pickle.dumps(one)).digest() for one in contents)).digest()


_BEGUN = pytest.StashKey[float]()


def _processor_seconds() -> float:
    """Those of this process, and of its children that have ended."""
    return sum(os.times()[:4])


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    item.stash[_BEGUN] = _processor_seconds()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item, call: pytest.CallInfo[None]) -> Generator[None, object, object]:
    if call.when == "teardown" and _BEGUN in item.stash:
        item.user_properties.append(("processor_seconds", _processor_seconds() - item.stash[_BEGUN]))
    return (yield)


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Say where the processor time of a whole run is: in the dearest files, with fixtures and ended children."""
    seconds: Counter[str] = Counter()
    for report in (report for reports in terminalreporter.stats.values() for report in reports):
        if getattr(report, "when", None) == "teardown":
            seconds[report.nodeid.partition("::")[0]] += dict(report.user_properties).get("processor_seconds", 0.0)
    if terminalreporter.config.getoption("--slow") and len(seconds) > 10:
        terminalreporter.section(f"dearest files, of {seconds.total():.0f} s of processor time")
        for path, spent in seconds.most_common(10):
            terminalreporter.write_line(f"{spent:7.1f} s  {path}")
