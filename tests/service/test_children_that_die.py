"""A computing process that is gone is known by its pipe, however that breaks."""

from __future__ import annotations

import os
import socket
from typing import Any, cast

import pytest

from dynident_service.jobs.child_pool import ChildProcess, ProcessExit
from dynident_service.jobs.confinement import Confinement
from dynident_service.jobs.task_input_output import Call


class Orphanage:
    """Forks nothing: gives the child's end of the pipe to nobody, or reads nothing of what it is sent and leaves."""

    def __init__(self, leaves_unread: bool) -> None:
        self._leaves_unread = leaves_unread
        self.end: socket.socket | None = None

    def fork(self, jobs: int, lifeline: int) -> None:
        if self._leaves_unread:
            self.end = socket.socket(fileno=os.dup(jobs))

    def exit_of(self, pid: int, *, reap: bool) -> ProcessExit | None:
        return None


@pytest.mark.parametrize("leaves_unread", [False, True])
def test_what_is_sent_to_a_process_that_is_gone_is_told_as_its_death(leaves_unread: bool) -> None:
    orphanage = Orphanage(leaves_unread)
    child = ChildProcess(cast(Any, orphanage), Confinement())
    call = Call("module:name", {})
    if orphanage.end is not None:
        child.send(call)
        orphanage.end.close()
    with pytest.raises(EOFError):
        child.send(call)
    with pytest.raises(EOFError):
        child.receive(0.0)
    assert not child.is_alive()
    child.kill()
