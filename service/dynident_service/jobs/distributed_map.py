"""Share parts of one job among other workers; from which size on it is worth it.

The child process is a client of the scheduler for this. Whatever fails on the way, be it a worker, the scheduler or the
network, the child computes those parts itself. A worker accepts parts only while it has nothing else to do, so jobs
never wait for each other.
"""

from __future__ import annotations

import logging
import pickle
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from typing import TYPE_CHECKING, Any, TypeVar

from dynident.errors import Cancelled
from dynident.parallel import RemoteWorkersBusy, RemoteWorkFailed, share_work_with
from dynident.progress import Progress
from dynident.version import __version__
from dynident_service.jobs.task_input_output import ClusterAddresses, JobEnvironment, JobPart, PartFailed, pack_value
from dynident_service.storage.job_transitions import Claim
from dynident_service.storage.object_store import ObjectStore

if TYPE_CHECKING:
    from distributed import Client

WORTH = 4_000_000
"""Number of samples, some seconds of work, from which sharing is worthwhile: the first part waits 0.5 s for Dask."""
MOST = 10_000_000
"""Upper limit in bytes for a part, apart from its files; larger ones are not worth sending."""
PATIENCE = 10.0
"""Seconds to wait for an answer of the scheduler."""
LOOK, CHECK = 0.1, 2.0
"""Seconds between looks whether a part is still wanted, and whether its worker is still there."""
log = logging.getLogger("dynident.job")

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")


@contextmanager
def share_with_workers(claim: Claim, place: JobEnvironment, objects: ObjectStore) -> Iterator[None]:
    """Let other workers of the cluster compute parts of what runs in this context, if the job is on a cluster."""
    if place.colleagues is None:
        yield
        return
    others = OtherWorkers(claim, place, place.colleagues, objects)
    try:
        with share_work_with(others):
            yield
    finally:
        others.close()


class OtherWorkers:
    """The other workers of the cluster; the connection is made when they are first needed."""

    def __init__(self, claim: Claim, place: JobEnvironment, colleagues: ClusterAddresses, objects: ObjectStore) -> None:
        self._claim = claim
        self._place = place
        self._colleagues = colleagues
        self._objects = objects
        self._client: Client | None = None
        self._given_up = False
        self._done: Counter[str] = Counter()

    def list_workers(
        self, work: Callable[[_Item, Progress], _Result], size: float
    ) -> Sequence[Callable[[_Item, Progress], _Result]]:
        """Return a callable for each thread of each other worker; see `dynident.parallel.RemoteWorkers`.

        Parameters
        ----------
        work : callable
            Function of an item and of progress.
        size : float
            Number of samples of the whole computation.
        """
        if size < WORTH or self._given_up:
            return ()
        try:
            content = pack_value(work, self._objects)
        except Exception as error:  # whatever is in it
            log.debug("not shared, as it cannot be sent: %s", error)
            return ()
        if len(content) > MOST:
            return ()
        try:
            client = self._get_client()
            workers = _count_threads(client)
        except Exception as error:  # whatever a network does
            log.warning("not shared, as the scheduler does not answer: %s: %s", type(error).__name__, error)
            self._given_up = True
            return ()
        return [
            partial(self._compute_remotely, client, address, content)
            for address, threads in workers.items()
            if address != self._colleagues.own
            for _ in range(threads)
        ]

    def close(self) -> None:
        """Log which worker did how many parts, and leave the cluster."""
        for address, count in self._done.items():
            log.info("%d parts were done by the worker at %s", count, address)
        self._disconnect()

    def _get_client(self) -> Client:
        from distributed import Client

        if self._client is not None and self._client.status != "running":
            self._disconnect()
        if self._client is None:
            logging.getLogger("distributed").setLevel(logging.ERROR)
            self._client = Client(self._colleagues.scheduler, timeout=f"{PATIENCE}s", set_as_default=False)
        return self._client

    def _disconnect(self) -> None:
        client, self._client = self._client, None
        if client is not None:
            with suppress(Exception):  # whatever became of the scheduler, what was computed counts
                client.close(timeout=PATIENCE)

    def _compute_remotely(self, client: Client, address: str, work: bytes, item: object, progress: Progress) -> Any:
        try:
            result = self._send_part(client, address, work, pack_value(item, self._objects), progress)
        except (Cancelled, RemoteWorkersBusy):
            raise
        except Exception as error:  # whatever happens to a worker, a scheduler or a network
            log.warning("a part comes back from the worker at %s: %s: %s", address, type(error).__name__, error)
            raise RemoteWorkFailed from error
        self._done[address] += 1
        return pickle.loads(result)

    def _send_part(self, client: Client, address: str, work: bytes, item: bytes, progress: Progress) -> bytes:
        from dynident_service.jobs.dask_cluster import run_part

        if len(item) > MOST or client.status != "running":
            raise PartFailed("it cannot be sent")
        part = JobPart(self._claim, self._place, work, item)
        future = client.submit(run_part, part, __version__, workers=[address], pure=False)
        try:
            checked = time.monotonic()
            while future.status == "pending":
                # The report says nothing new; it raises if nobody waits for the part any more.
                progress(0.0, "")
                time.sleep(LOOK)
                if time.monotonic() - checked >= CHECK:
                    checked = time.monotonic()
                    if address not in _count_threads(client, [address]):
                        raise PartFailed("the worker is gone")
            result: bytes | None = future.result(timeout=PATIENCE)
        finally:
            future.release()
        if result is None:
            raise RemoteWorkersBusy
        return result


def _count_threads(client: Client, workers: Sequence[str] | None = None) -> Mapping[str, int]:
    """Return the number of threads of the workers that are there, by address."""
    threads_by_address = client.nthreads(workers, callback_timeout=PATIENCE)
    return {str(address): int(threads) for address, threads in threads_by_address.items() if threads}
