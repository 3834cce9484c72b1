"""Error messages and exit codes of the command line."""

from __future__ import annotations

import json
import sys

from dynident.errors import DynidentError

EXIT_MISUSED = 2
"""Exit code after an error that the user can mend; typer ends with the same one for wrong options."""
EXIT_CANCELLED = 130
"""Exit code after Ctrl-C: 128 plus the number of SIGINT, as shells have it."""


def print_error(error: DynidentError, as_json: bool) -> None:
    """Print what is wrong, where, and how to mend it.

    Parameters
    ----------
    error : DynidentError
        The error. It is printed on stderr for people.
    as_json : bool
        Whether to print it on stdout, too, as the problem document that the service answers with (RFC 9457).
    """
    # Many messages name the place already.
    where = f"{error.pointer}: " if error.pointer and error.pointer not in error.detail else ""
    print(f"dynident: {error.title}\n  {where}{error.detail}", file=sys.stderr)
    # A file may fail several checks; the first is the error itself.
    checks = [
        check for check in getattr(error, "checks", ()) if check.status == "error" and check.detail not in error.detail
    ]
    for check in checks:
        print(f"  also {check.name.replace('_', ' ')}: {check.detail}", file=sys.stderr)
    if as_json:
        print(json.dumps(_problem_document(error), indent=2))


def _problem_document(error: DynidentError) -> dict[str, object]:
    from dynident.recordings import RecordingError
    from dynident_service.adapters.measurements import describe_file_problem
    from dynident_service.problems import to_problem

    problem = describe_file_problem(error) if isinstance(error, RecordingError) else to_problem(error)
    document: dict[str, object] = problem.model_dump(exclude_none=True)
    return document
