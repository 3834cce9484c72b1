"""Which file a mesh's name in a description means."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path, PurePosixPath

from dynident.errors import DynidentError
from dynident.robot.pointers import listed

_PREFIXES = ("package://", "model://", "file://")


def mesh_file(uri: str, folders: Iterable[Path]) -> Path | None:
    """The file that a mesh's name means, below one of the folders; `None` where there is none."""
    return next((one for one in sought_files(uri, folders) if _is_file(one)), None)


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except OSError:  # a name that no file can have
        return False


def sought_files(uri: str, folders: Iterable[Path]) -> list[Path]:
    """The files that a mesh's name may mean, in the order in which they are looked for.

    Of package://robot/meshes/x.stl both robot/meshes/x.stl and meshes/x.stl are looked for in the folders.
    """
    packaged = not uri.startswith("file://") and any(uri.startswith(prefix) for prefix in _PREFIXES)
    name = uri
    for prefix in _PREFIXES:
        name = name.removeprefix(prefix)
    path, given = Path(name), list(folders)
    tried = [folder / part for folder in given for part in _tails(path, packaged)]
    # A description may come from anywhere: it opens no file outside of the folders that its user names.
    if path.is_absolute() and any(path.resolve().is_relative_to(folder.resolve()) for folder in given):
        tried.insert(0, path)
    return tried


def _tails(path: Path, packaged: bool) -> list[Path]:
    parts = [part for part in path.parts if part not in ("/", "..")]
    if not parts:
        return []
    return [Path(*parts), Path(*parts[1:])] if packaged and len(parts) > 1 else [Path(*parts)]


def placed_below(folder: Path, files: Mapping[str, Path]) -> None:
    """Make links in a folder, so that `mesh_file` finds there the files of meshes (by name).

    Raises
    ------
    DynidentError
        No file can have the name of a mesh, beside those of the others.
    """
    for uri, file in files.items():
        link = sought_files(uri, [folder])[0]
        try:
            link.parent.mkdir(parents=True, exist_ok=True)
            if not link.exists():
                link.symlink_to(file.resolve())
        except (OSError, ValueError) as error:
            detail = f"no file can have the name of the mesh {uri[:200]!r} ({error.__class__.__name__}); rename it"
            raise DynidentError(detail, pointer="/files", title="Unusable name of a mesh") from None


def matched(uris: Iterable[str], names: Sequence[str]) -> dict[str, str]:
    """Which of the files with these names (paths, or bare file names) is meant by each mesh's name, as far as any is.

    A file is meant that has the same file name, the one with most folders in common, upper and lower case alike.

    Raises
    ------
    DynidentError
        Two files would do as well, or one without its folder for two meshes.
    """
    found: dict[str, tuple[str, int]] = {}
    for uri in uris:
        path = sought_files(uri, [Path()])[:1]
        likeness = [_in_common(path[0].as_posix(), name) if path else 0 for name in names]
        most = max(likeness, default=0)
        best = [name for name, value in zip(names, likeness, strict=True) if value == most > 0]
        if len(best) > 1:
            raise _doubtful(f"{listed(best)} may each be {uri}")
        if best:
            found[uri] = best[0], most
    return {uri: name for uri, (name, likeness) in found.items() if _is_meant(uri, name, likeness, found)}


def _is_meant(uri: str, name: str, likeness: int, found: Mapping[str, tuple[str, int]]) -> bool:
    """Whether no other mesh's name is more like a file's; raises where one is as much."""
    others = {other: value for other, (file, value) in found.items() if file == name and other != uri}
    if any(value > likeness for value in others.values()):
        return False
    alike = [other for other, value in others.items() if value == likeness]
    if alike:
        raise _doubtful(f"{name} may be {uri} or {listed(alike)}")
    return True


def _in_common(one: str, other: str) -> int:
    """How many parts at the end two paths have in common."""
    number = 0
    for a, b in zip(reversed(_parts(one)), reversed(_parts(other)), strict=False):
        if a != b:
            break
        number += 1
    return number


def _parts(path: str) -> tuple[str, ...]:
    return tuple(part.casefold() for part in PurePosixPath(path.replace("\\", "/")).parts)


def _doubtful(what: str) -> DynidentError:
    detail = f"{what}; send them with their folders, as the description has them"
    return DynidentError(detail, pointer="/files", title="Ambiguous mesh")
