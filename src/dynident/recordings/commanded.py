"""A recording with the commanded positions in place of the measured ones."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

from dynident.recordings.types import Recording, SampleSource, StoredRows


@dataclass(frozen=True, eq=False)
class _CommandedSource:
    """Rows of another source with the commanded positions."""

    source: SampleSource

    def rows(self, first: int, length: int, block_length: int) -> Iterator[StoredRows]:
        for rows in self.source.rows(first, length, block_length):
            assert rows.command is not None
            yield rows._replace(q=rows.command)


def replace_by_command(recording: Recording) -> Recording:
    """Return the recording as it was commanded: with the positions that the robot was told to take.

    Parameters
    ----------
    recording : Recording

    Returns
    -------
    Recording

    Raises
    ------
    ValueError
        If it holds no commanded positions.
    """
    if not recording.has_command:
        raise ValueError(f"{recording.name} holds no commanded positions")
    return replace(recording, source=_CommandedSource(recording.source), path=None)
