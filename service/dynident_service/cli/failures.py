"""How the command line says that something is wrong."""

from __future__ import annotations

import json
import sys

from dynident.errors import DynidentError

MISUSED = 2
CANCELLED = 130


def tell_failure(error: DynidentError, as_json: bool) -> None:
    """What is wrong, where, and what would be right: for people on stderr, with `--json` also as a problem on stdout.

    The problem is the one that the service answers with (RFC 9457).
    """
    where = f"{error.pointer}: " if error.pointer and error.pointer not in error.detail else ""
    print(f"dynident: {error.title}\n  {where}{error.detail}", file=sys.stderr)
    checks = [
        check for check in getattr(error, "checks", ()) if check.status == "error" and check.detail not in error.detail
    ]
    for check in checks:
        print(f"  also {check.name.replace('_', ' ')}: {check.detail}", file=sys.stderr)
    if as_json:
        print(json.dumps(_problem(error), indent=2))


def _problem(error: DynidentError) -> dict[str, object]:
    from dynident.recordings import RecordingError
    from dynident_service.adapters.measurements import problem_with_file
    from dynident_service.problems import problem_of

    problem = problem_with_file(error) if isinstance(error, RecordingError) else problem_of(error)
    document: dict[str, object] = problem.model_dump(exclude_none=True)
    return document
