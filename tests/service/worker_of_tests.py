"""What a Dask worker of the tests loads before it begins: its children do not stand back."""

from __future__ import annotations

from fork_servers import OfTests

from dynident_service.jobs.child_pool import ForkServer

ForkServer.PROGRAM = OfTests.PROGRAM
