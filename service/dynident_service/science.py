"""The science, which a service loads beside its first requests: by one thread at a time.

Modules of SciPy import each other in a circle. Where two threads are in it at once, each waits for what the other one
imports, and Python ends that by an error in one of them.
"""

from __future__ import annotations

import importlib
import threading

MODULES = (
    "dynident_service.work",
    "dynident_service.adapters.exports",
    "dynident_service.adapters.lineages",
    "dynident_service.adapters.raw_signals",
)
"""With all that they import, everything of the science that requests use in this process."""
_lock = threading.Lock()


def load_science() -> None:
    """See to it that it is there: call this before anything of it is imported while requests are answered."""
    with _lock:
        for name in MODULES:
            importlib.import_module(name)
