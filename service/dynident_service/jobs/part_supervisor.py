"""Supervision of a part of a job that another worker does: a child computes it and is killed when the job ends."""

from __future__ import annotations

import logging

from dynident_service.jobs.calls import Answer, Call
from dynident_service.jobs.pool import ChildPool
from dynident_service.jobs.remote_parts import JobPart, PartFailed
from dynident_service.storage.job_queue import JobQueue
from dynident_service.storage.job_transitions import Claim
from dynident_service.storage.retry import AWAY, describe_error

LOOK = 1.0
"""Seconds between looks whether the job still runs."""
log = logging.getLogger("dynident.supervisor")


def supervise_part(part: JobPart, pool: ChildPool, ledger: JobQueue) -> bytes:
    """Have a child do a part while its job runs.

    Parameters
    ----------
    part : Part
        What to compute.
    pool : ChildPool
        Child processes of this worker.
    ledger : Ledger
        Queue, which knows whether the job still runs.

    Returns
    -------
    bytes
        The pickled result.

    Raises
    ------
    PartFailed
        If the child died, the computation failed, or the job has ended.
    """
    child = pool.take()
    try:
        child.send(_make_call(part))
        while (answer := child.receive(LOOK)) is None:
            if pool.closed or not _is_job_running(part.claim, ledger):
                raise PartFailed(f"job {part.claim.job_id} has ended meanwhile")
    except EOFError as error:
        pool.replace(child)
        raise PartFailed("its process died") from error
    except BaseException:
        pool.replace(child)
        raise
    pool.put_back(child, answer)
    if not isinstance(answer, Answer) or answer.problem is not None:
        raise PartFailed(answer.problem.detail if isinstance(answer, Answer) and answer.problem else "no answer")
    return bytes(answer.value)


def _make_call(part: JobPart) -> Call:
    arguments = {
        "job_id": part.claim.job_id,
        "url": part.place.object_store_url,
        "cache_dir": part.place.cache_dir,
        "work": part.work,
        "item": part.item,
    }
    return Call(
        "dynident_service.jobs.remote_parts:compute_part",
        arguments,
        part.claim.request_id,
        part.claim.trace,
        of_a_job=True,
    )


def _is_job_running(claim: Claim, ledger: JobQueue) -> bool:
    try:
        return ledger.get_standing(claim) == "held"
    # While the database is away, nobody can have cancelled the job.
    except AWAY as error:
        log.warning("job %s: %s", claim.job_id, describe_error(error))
        return True
