"""Starts the service as `python -m dynident_service` does, for small jobs: nothing of the science is loaded ahead."""

from __future__ import annotations

from fork_servers import bring_up_without_science

from dynident_service.serve import serve

if __name__ == "__main__":
    bring_up_without_science()
    serve()
