"""Supervise one running job: renew its lease, cancel it, detect a child that hangs or died.

Holds the times.

A process that hangs is recognised by its heartbeat or by the processor time that it uses.
"""

from __future__ import annotations

import logging
import os
import signal
import time
from pathlib import Path
from typing import Literal

from dynident_service.jobs.child_pool import ChildPool, ChildProcess, ProcessExit
from dynident_service.jobs.task_input_output import End, JobEnvironment, JobOrder, Receipt, make_memory_problem
from dynident_service.problems import make_problem
from dynident_service.storage.database import AWAY, describe_error, retry_while_away
from dynident_service.storage.job_queue import JobQueue
from dynident_service.storage.job_transitions import Claim

TICKS = os.sysconf("SC_CLK_TCK")
LEAST = 0.005
"""Smallest share of a processor that a computation gets, even on a busy machine; a thread that only waits for the
interpreter uses a tenth of it.
"""
PROCESSES = Path("/proc")
"""Linux's folder with the state of all processes."""
Condition = Literal["alive", "stopped", "still"]


class ActivityMonitor:
    """Watch over one process group.

    A thread inside the computation sends heartbeats, but a solver may hold the interpreter for minutes; then the
    processor time of the group decides. If neither advances, the process was stopped from outside or hangs.
    """

    def __init__(self, patience: float) -> None:
        self._patience = patience
        self._since = time.monotonic()
        self._heartbeats = 0
        self._used = 0

    def check_activity(self, pid: int, heartbeats: int) -> Condition:
        """Return the condition of the group that a process leads."""
        elapsed = time.monotonic() - self._since
        if heartbeats == self._heartbeats and elapsed < self._patience:
            return "alive"
        used, state = measure_group(pid)
        # A process that waits for a disk (state D) is no hanging one. Without /proc the state is unknown, and the
        # process gets the benefit of the doubt.
        computes = used - self._used >= max(2.0, LEAST * elapsed * TICKS) or state in ("D", "")
        if heartbeats != self._heartbeats or computes:
            self._since, self._heartbeats, self._used = time.monotonic(), heartbeats, used
            return "alive"
        return "stopped" if state in ("T", "t") else "still"


def measure_processor_time(pid: int) -> float:
    """Return the processor time of a process in seconds, or 0 if it is unknown."""
    try:
        # The name of the program stands in parentheses and may hold spaces, so fields are counted from the last
        # parenthesis.
        fields = (PROCESSES / str(pid) / "stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    return (int(fields[11]) + int(fields[12])) / TICKS


def measure_group(leader: int) -> tuple[int, str]:
    """Return the processor time of a process group in ticks and the state of its leader, or "" if it is unknown."""
    used, state = 0, ""
    for path in PROCESSES.glob("[0-9]*/stat"):
        try:
            fields = path.read_text().rpartition(")")[2].split()
        except OSError:
            continue  # it has ended meanwhile
        if int(fields[2]) == leader:
            used += int(fields[11]) + int(fields[12])
        if path.parent.name == str(leader):
            state = fields[0]
    return used, state


LOOK = 0.25
"""Seconds between looks whether the job is to be cancelled."""
RENEW = 5.0
"""Seconds between renewals of the lease."""
VITALS = 1.0
"""Seconds between looks whether the child is alive."""
STILL_FOR = 30.0
"""Seconds without heartbeat and without processor time after which a child is killed."""
START_UP = 300.0
"""Seconds that a child may take to begin: the science is imported, perhaps on a busy machine."""
PATIENCE = 15 * 60.0
"""Seconds to wait for a database that is away, before a job is left to its lease."""
MUCH_MEMORY = 0.5
"""Share of a job's memory limit. A process that was killed with more was most probably killed for it, by the system or
by a library that could not allocate more, and would be again.
"""
LAST_PATIENCE = 3.0
"""Seconds to wait for the database while the service ends."""
AWAY_PAUSE = 1.0
"""Seconds between attempts to reach a database that is away."""
FIRST_REST, LONGEST_REST = 0.1, 15.0
"""Seconds before a job that met no database or no object store begins again, doubled each time up to the second value.
A store that refuses for minutes, for example because its credentials expired, then does not exhaust a job.
"""
REST_LOOK = 0.2
log = logging.getLogger("dynident.supervisor")


def supervise_job(claim: Claim, place: JobEnvironment, pool: ChildPool, job_queue: JobQueue) -> None:
    """Have a child do a job; return when it has ended, was cancelled, or was lost to another worker."""
    if pool.closed:
        retry_while_away(lambda: job_queue.release(claim), LAST_PATIENCE)
        return
    child = pool.take()
    try:
        child.send(JobOrder(claim, place))
        ended = _watch_child(claim, child, job_queue, place.deadline)
    except EOFError:
        end = pool.replace(child)
        if pool.closed:
            retry_while_away(lambda: job_queue.release(claim), LAST_PATIENCE)
        # A job that exhausts the memory fails at once: repeated attempts would only kill the process again.
        elif end is not None and end.code < 0 and end.peak_memory > MUCH_MEMORY * place.memory:
            retry_while_away(lambda: job_queue.record_failure(claim, make_memory_problem(place.memory)), PATIENCE)
        else:
            retry_while_away(lambda: job_queue.record_death(claim, _describe_exit(end)), PATIENCE)
        return
    except BaseException:
        pool.replace(child)
        raise
    if isinstance(ended, Receipt):
        pool.put_back(child, ended)
        if ended.trouble:
            _wait_before_retry(claim, pool, job_queue)
            retry_while_away(lambda: job_queue.record_loss(claim, ended.trouble), PATIENCE)
    else:
        pool.replace(child)
        retry_while_away(lambda: ended(job_queue), PATIENCE)


def _wait_before_retry(claim: Claim, pool: ChildPool, job_queue: JobQueue) -> None:
    """Wait before a job begins again, while it is still wanted; shorter than its lease."""
    until = time.monotonic() + min(LONGEST_REST, FIRST_REST * 2.0 ** min(claim.attempt, 10))
    while time.monotonic() < until and not pool.closed:
        try:
            if job_queue.get_standing(claim) != "held":
                return
        except AWAY as error:
            log.warning("job %s: %s", claim.job_id, describe_error(error))
            time.sleep(AWAY_PAUSE)
        time.sleep(REST_LOOK)


def _watch_child(claim: Claim, child: ChildProcess, job_queue: JobQueue, deadline: float) -> Receipt | End:
    """Wait for the end of a job; return the child's receipt, or what to record once the child is killed."""
    began = renewed = looked = time.monotonic()
    vitals = ActivityMonitor(STILL_FOR)
    while (receipt := child.receive(LOOK)) is None:
        moment = time.monotonic()
        if moment - looked >= VITALS:
            looked = moment
            if (end := _find_trouble(claim, child, vitals, moment - began, deadline)) is not None:
                return end
        try:
            is_due = moment - renewed >= RENEW
            standing = job_queue.renew(claim) if is_due else job_queue.get_standing(claim)
        except AWAY as error:  # the work goes on: if it ends, its end is written down once the database is there
            log.warning("job %s: %s", claim.job_id, describe_error(error))
            time.sleep(AWAY_PAUSE)
            continue
        if is_due:
            renewed = moment
        if standing != "held":
            # The child may just have ended the job by itself.
            ended = child.receive(0.0)
            return ended if isinstance(ended, Receipt) else (lambda job_queue: job_queue.record_cancellation(claim))
    assert isinstance(receipt, Receipt)
    return receipt


def _find_trouble(
    claim: Claim, child: ChildProcess, vitals: ActivityMonitor, took: float, deadline: float
) -> End | None:
    """Return what to record of a job that takes too long or whose process does not move; None if all is well."""
    if took > deadline:
        detail = f"The computation took longer than {deadline:.0f} s (DYNIDENT_JOB_DEADLINE_SECONDS) and was stopped."
        problem = make_problem(500, detail, title="Deadline passed")
        return lambda job_queue: job_queue.record_failure(claim, problem)
    if child.pid is None:
        return None if took < START_UP else lambda job_queue: job_queue.record_loss(claim, "its process did not start")
    match vitals.check_activity(child.pid, child.heartbeats):
        case "stopped":
            return lambda job_queue: job_queue.record_loss(claim, "its process was stopped from outside")
        case "still":
            return lambda job_queue: job_queue.record_death(
                claim, f"its process made no progress for {STILL_FOR:.0f} s"
            )
    return None


def _describe_exit(end: ProcessExit | None) -> str:
    if end is None:
        return "the process of the computation broke its connection"
    if end.code < 0:
        return f"the process of the computation was killed by {signal.Signals(-end.code).name}"
    return f"the process of the computation ended with code {end.code}"
