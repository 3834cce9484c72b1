"""Pack the files of one recording into one."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from pathlib import Path
from zipfile import ZIP_STORED, ZipFile, ZipInfo

MOST_FILES = 64
"""Files of one recording; signals of joints need fewer than ten."""


def pack_files(files: Sequence[tuple[str, Path]], target: Path) -> None:
    """Write an archive (.zip) of files by their names; the same files give the same bytes."""
    with ZipFile(target, "w", ZIP_STORED) as archive:
        for name, path in files:
            # ZipInfo without a date: the archive depends on the content alone.
            with path.open("rb") as source, archive.open(ZipInfo(name), "w", force_zip64=True) as member:
                shutil.copyfileobj(source, member, 1 << 20)
