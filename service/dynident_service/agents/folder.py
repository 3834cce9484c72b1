"""The one folder whose files the tools of an agent read and write."""

from __future__ import annotations

from pathlib import Path

from dynident.api.robot_files import needs_xacro
from dynident.errors import DynidentError
from dynident.known_robots import list_library_arms, list_stock_robots
from dynident.recordings.recording_files import JOINT, split_path

_TITLE = "Outside of the folder"


class Folder:
    """A folder, as far as tools may reach: files in it, and none that a link, `..` or an absolute path leads to.

    Parameters
    ----------
    root : Path
        The folder; the process works in it, so that paths of messages are relative to it.
    """

    def __init__(self, root: Path) -> None:
        self._root = root.resolve(strict=True)

    def find_recording(self, text: str, pointer: str) -> Path:
        """Return the path of a recording, whose files may be joined by +.

        Raises
        ------
        DynidentError
            Where a file is outside of the folder, or is not there.
        """
        # Parts are looked at one by one before any is opened: the second of `a.csv+../b.csv` could lead outside.
        for part in text.split(JOINT):
            self._check_inside(Path(part), pointer)
        for path in split_path(Path(text)):
            self._check_file(path, pointer)
        return Path(text)

    def find_file(self, text: str, pointer: str) -> Path:
        """Return the path of a file; `DynidentError` where it is outside of the folder or not there."""
        self._check_file(Path(text), pointer)
        return Path(text)

    def find_robot(self, text: str, pointer: str) -> str:
        """Return a robot's source: a file of the folder, or the name of a well-known arm."""
        if text in list_library_arms() or text in list_stock_robots():
            return text
        path = self.find_file(text, pointer)
        # Expanding would read whatever files it names, and evaluate its expressions.
        if needs_xacro(path.read_text(encoding="utf-8", errors="replace")):
            raise DynidentError(
                f"{text} is xacro, which can read files outside of the folder; expand it first "
                "(xacro robot.xacro > robot.urdf)",
                pointer=pointer,
                title="Unusable xacro",
            )
        return text

    def find_new_file(self, text: str, pointer: str) -> Path:
        """Return the path of a file to write.

        Raises
        ------
        DynidentError
            Where it is outside of the folder, or would replace a file: recordings lie there, too.
        """
        path = Path(text)
        self._check_inside(path, pointer)
        if path.is_symlink() or path.exists():
            raise DynidentError(f"there is already a file {text}; give another name", pointer=pointer, title="Exists")
        if not path.parent.is_dir():
            raise DynidentError(f"there is no folder {path.parent}", pointer=pointer, title="No such folder")
        return path

    def _check_file(self, path: Path, pointer: str) -> None:
        # Where it leads comes first: whether there is something outside is nobody's business.
        self._check_inside(path, pointer)
        if not path.is_file():
            raise DynidentError(f"there is no file {path}", pointer=pointer, title="No such file")

    def _check_inside(self, path: Path, pointer: str) -> None:
        try:
            target = (self._root / path).resolve()
            is_inside = target.is_relative_to(self._root)
            if is_inside:
                target.exists()  # raises for a name that no file can have
        # A NUL character, a loop of links, a name that is too long.
        except (OSError, RuntimeError, ValueError):
            is_inside = False
        if not is_inside:
            raise DynidentError(
                f"{str(path)!r:.200} does not lie in the folder that these tools work in; give a path relative to it",
                pointer=pointer,
                title=_TITLE,
            )
