"""What a Dask worker of the tests loads before it begins whose children share what is small, too."""

from __future__ import annotations

from fork_servers import Sharing

from dynident_service.jobs.child_pool import ForkServer

ForkServer.PROGRAM = Sharing.PROGRAM
