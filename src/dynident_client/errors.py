"""Exceptions of the client: `ProblemError` (an answer that is a problem), `JobFailed`, `JobCancelled`."""

from __future__ import annotations

from dynident_client.answers import Problem, ProblemField


class ProblemError(Exception):
    """Raised where the service refuses a request (RFC 9457).

    Parameters
    ----------
    problem : Problem
        The body of the answer; `status`, `title` and `detail` are taken from it.
    """

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        # A problem need not state all of them: RFC 9457 leaves every member open.
        self.status = int(problem.get("status", 0))
        self.title = str(problem.get("title", ""))
        self.detail = str(problem.get("detail", ""))
        super().__init__(f"{self.title}: {self.detail}" if self.title else self.detail)

    @property
    def errors(self) -> list[ProblemField]:
        """The fields, columns or parameters that are wrong: pointer and detail of each."""
        return self.problem.get("errors") or []


class JobFailed(ProblemError):
    """Raised where a computation has failed.

    Parameters
    ----------
    problem : Problem
        Why it has failed, as the service states it.
    """


class JobCancelled(Exception):
    """Raised where a computation was cancelled."""
