"""What goes wrong between a program and the service."""

from __future__ import annotations

from dynident_client.answers import Problem, ProblemField


class ProblemError(Exception):
    """The service refused a request (RFC 9457): `problem` is its answer, `status`, `title` and `detail` of it."""

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        self.status = int(problem.get("status", 0))
        self.title = str(problem.get("title", ""))
        self.detail = str(problem.get("detail", ""))
        super().__init__(f"{self.title}: {self.detail}" if self.title else self.detail)

    @property
    def errors(self) -> list[ProblemField]:
        """The fields, columns or parameters that are wrong: pointer and detail of each."""
        return self.problem.get("errors") or []


class JobFailed(ProblemError):
    """A computation could not be done."""


class JobCancelled(Exception):
    """A computation was cancelled."""
