"""The files of the page, read once: by their content's hash they may be kept for good, and all come at once."""

from __future__ import annotations

import gzip
import hashlib
import posixpath
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

START, INDEX = "js/app.js", "index.html"
_IMPORTED = re.compile(r'^import [^"]*"(\.{1,2}/[^"]+)";$', re.MULTILINE)
_DIGITS = 16
# Not asked of the machine: some say that JavaScript is plain text, which browsers then refuse to run.
_TYPES = {".js": "text/javascript", ".css": "text/css", ".html": "text/html", ".svg": "image/svg+xml"}


@dataclass(frozen=True)
class PageFile:
    """One file of text: its bytes, and the same compressed."""

    content: bytes = field(repr=False)
    media_type: str
    compressed: bytes = field(repr=False)

    @classmethod
    def of(cls, name: str, content: bytes) -> PageFile:
        """A file by its name's ending."""
        media_type = _TYPES.get(posixpath.splitext(name)[1], "text/plain")
        return cls(content, media_type, gzip.compress(content, mtime=0))


@dataclass(frozen=True)
class PageFiles:
    """All files by their paths below the folder; `version` is the hash of all of them."""

    version: str
    files: Mapping[str, PageFile]
    index: PageFile

    @classmethod
    def read(cls, folder: Path, prefix: str) -> PageFiles:
        """Read a folder; the index names the files by their version, and the modules that it needs from the start."""
        paths = sorted(path for path in folder.rglob("*") if path.is_file())
        contents = {path.relative_to(folder).as_posix(): path.read_bytes() for path in paths}
        hashed = hashlib.sha256()
        for name, content in contents.items():
            hashed.update(f"{name}\0{len(content)}\0".encode() + content)
        version = hashed.hexdigest()[:_DIGITS]
        index = contents[INDEX].decode().replace(f"{prefix}/", f"{prefix}/{version}/")
        links = (f'<link rel="modulepreload" href="{prefix}/{version}/{name}">\n' for name in needed(contents, START))
        index = index.replace("</head>", f"{''.join(links)}</head>", 1)
        files = {name: PageFile.of(name, content) for name, content in contents.items() if name != INDEX}
        return cls(version, files, PageFile.of(INDEX, index.encode()))

    def current(self, path: str) -> str:
        """A path without the version that it begins with, this one or another."""
        first, _, rest = path.partition("/")
        return rest if re.fullmatch(f"[0-9a-f]{{{_DIGITS}}}", first) else path


def needed(contents: Mapping[str, bytes], start: str) -> list[str]:
    """The modules that one imports, and those that these do, in the order in which they are met."""
    found = [start]
    for name in found:
        for relative in _IMPORTED.findall(contents[name].decode()):
            path = posixpath.normpath(posixpath.join(posixpath.dirname(name), relative))
            if path not in found:
                found.append(path)
    return found
