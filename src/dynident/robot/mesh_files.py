"""Find the file that a mesh's name in a description means."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path, PurePosixPath

from dynident.errors import DynidentError
from dynident.robot.json_pointer import join_names

_PREFIXES = ("package://", "model://", "file://")


def find_mesh_file(uri: str, folders: Iterable[Path]) -> Path | None:
    """Return the file that a mesh's name means, below one of some folders.

    Parameters
    ----------
    uri : str
        Name of the mesh in the description.
    folders : iterable of Path
        Where it is looked for, in this order.

    Returns
    -------
    Path or None
        None if there is no such file.
    """
    return next((path for path in list_candidate_files(uri, folders) if _is_file(path)), None)


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except OSError:  # a name that no file can have
        return False


def list_candidate_files(uri: str, folders: Iterable[Path]) -> list[Path]:
    """Return the files that a mesh's name may mean, in the order of the search.

    For package://robot/meshes/x.stl both robot/meshes/x.stl and meshes/x.stl are looked for in the folders.

    Parameters
    ----------
    uri : str
        Name of the mesh in the description.
    folders : iterable of Path
        Where it is looked for, in this order.

    Returns
    -------
    list of Path
        Whether or not they exist; none outside of the folders.
    """
    packaged = not uri.startswith("file://") and any(uri.startswith(prefix) for prefix in _PREFIXES)
    name = uri
    for prefix in _PREFIXES:
        name = name.removeprefix(prefix)
    path, search_folders = Path(name), list(folders)
    candidates = [folder / part for folder in search_folders for part in _list_tails(path, packaged)]
    # A description may come from anywhere: it opens no file outside of the folders that its user names.
    if path.is_absolute() and any(path.resolve().is_relative_to(folder.resolve()) for folder in search_folders):
        candidates.insert(0, path)
    return candidates


def _list_tails(path: Path, packaged: bool) -> list[Path]:
    # Without ".." and the root, a name cannot lead out of the folder that it is looked for in.
    parts = [part for part in path.parts if part not in ("/", "..")]
    if not parts:
        return []
    return [Path(*parts), Path(*parts[1:])] if packaged and len(parts) > 1 else [Path(*parts)]


def link_mesh_files(folder: Path, files: Mapping[str, Path]) -> None:
    """Link the files of meshes into a folder, so that `find_mesh_file` finds them there.

    Parameters
    ----------
    folder : Path
        The folder, which need not be empty.
    files : mapping of str to Path
        Files by the mesh's name in the description.

    Raises
    ------
    DynidentError
        If no file can have the name of a mesh, or two names exclude each other as files.
    """
    for uri, file in files.items():
        link = list_candidate_files(uri, [folder])[0]
        try:
            link.parent.mkdir(parents=True, exist_ok=True)
            if not link.exists():
                link.symlink_to(file.resolve())
        except (OSError, ValueError) as error:
            detail = f"no file can have the name of the mesh {uri[:200]!r} ({error.__class__.__name__}); rename it"
            raise DynidentError(detail, pointer="/files", title="Unusable name of a mesh") from None


def match_mesh_files(uris: Iterable[str], names: Sequence[str]) -> dict[str, str]:
    """Match meshes of a description to files by their names.

    A file matches if it has the same file name, upper or lower case; of several the one with most folders in common.

    Parameters
    ----------
    uris : iterable of str
        Names of meshes in the description.
    names : sequence of str
        Paths or bare names of the files.

    Returns
    -------
    dict of uri to name
        Meshes without a file are left out.

    Raises
    ------
    DynidentError
        If two files match a mesh equally well, or a file matches two meshes equally well.
    """
    best_match: dict[str, tuple[str, int]] = {}
    for uri in uris:
        path = list_candidate_files(uri, [Path()])[:1]
        # Zero means another file name: such a file never matches.
        likeness = [_count_common_parts(path[0].as_posix(), name) if path else 0 for name in names]
        most = max(likeness, default=0)
        best = [name for name, value in zip(names, likeness, strict=True) if value == most > 0]
        if len(best) > 1:
            raise _make_ambiguity_error(f"{join_names(best)} may each be {uri}")
        if best:
            best_match[uri] = best[0], most
    return {
        uri: name for uri, (name, likeness) in best_match.items() if _is_best_match(uri, name, likeness, best_match)
    }


def _is_best_match(uri: str, name: str, likeness: int, best_match: Mapping[str, tuple[str, int]]) -> bool:
    """Return whether no other mesh matches a file better; raise if another matches it equally well."""
    others = {other: value for other, (file, value) in best_match.items() if file == name and other != uri}
    if any(value > likeness for value in others.values()):
        return False
    alike = [other for other, value in others.items() if value == likeness]
    if alike:
        raise _make_ambiguity_error(f"{name} may be {uri} or {join_names(alike)}")
    return True


def _count_common_parts(first: str, second: str) -> int:
    """Return how many parts two paths have in common, counted from the end."""
    number = 0
    for a, b in zip(reversed(_split_path(first)), reversed(_split_path(second)), strict=False):
        if a != b:
            break
        number += 1
    return number


def _split_path(path: str) -> tuple[str, ...]:
    return tuple(part.casefold() for part in PurePosixPath(path.replace("\\", "/")).parts)


def _make_ambiguity_error(problem: str) -> DynidentError:
    detail = f"{problem}; send them with their folders, as the description has them"
    return DynidentError(detail, pointer="/files", title="Ambiguous mesh")
