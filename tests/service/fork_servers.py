"""The processes that children of the tests are forked from, which begin sooner than those of the service.

Their children do not stand back behind other processes: beside the other tests, each would wait for a processor. Those
`without_science` begin at once; what a job needs of it, its child loads.
"""

from __future__ import annotations

import sys
from pathlib import Path

from dynident_service.jobs import child_process, fork_server_main, job_engine
from dynident_service.jobs.child_pool import ForkServer

HEARTBEAT = 0.4
"""Seconds from one to the next, so that one who has none is found out soon."""


class OfTests(ForkServer):
    """One with the science."""

    PROGRAM = (str(Path(__file__)), "with_science")


class WithoutScience(ForkServer):
    """One for small jobs."""

    PROGRAM = (str(Path(__file__)), "without_science")


class StandingBack(ForkServer):
    """One for small jobs whose children stand back as those of the service do."""

    PROGRAM = (str(Path(__file__)), "standing_back")


def bring_up_without_science() -> None:
    """Let a service, or a worker of a cluster, in this process have its children from there, and load none itself."""
    ForkServer.PROGRAM = WithoutScience.PROGRAM
    job_engine.load_science = lambda: None  # type: ignore[attr-defined]  # a name that it imports


def main() -> None:
    what = sys.argv.pop(1)
    child_process.HEARTBEAT = HEARTBEAT
    if what != "standing_back":
        child_process.STANDS_BACK = 0
    if what != "with_science":
        fork_server_main.PRELOADED = ()
    fork_server_main.main()


if __name__ == "__main__":
    main()
