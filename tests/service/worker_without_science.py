"""What a Dask worker loads before it begins that does small jobs alone."""

from __future__ import annotations

from fork_servers import bring_up_without_science

bring_up_without_science()
