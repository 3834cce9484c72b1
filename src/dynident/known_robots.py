"""Names of robots that need no file: bundled arms, and robots of the package example-robot-data.

Nothing slow is imported here, so that a command line can check a name at once.
"""

from __future__ import annotations

import sys
from importlib.resources import files
from pathlib import Path

from dynident.errors import DynidentError, suggest_names

_STOCK_PACKAGE = "example-robot-data"
_STOCK_FOLDER = Path("cmeel.prefix", "share", _STOCK_PACKAGE, "robots")
_PACKAGE_SUFFIX = "_description"


def list_library_arms() -> tuple[str, ...]:
    """Return the names of the arms that come with this package, sorted."""
    names = (entry.name for entry in (files("dynident") / "robot" / "bundled_arms").iterdir())
    return tuple(sorted(name.removesuffix(".json") for name in names if name.endswith(".json")))


def list_stock_robots() -> dict[str, Path]:
    """Return the URDF files of example-robot-data by name, such as "so101"; empty where it is not installed."""
    folders = (Path(entry) / _STOCK_FOLDER for entry in sys.path)
    folder = next((folder for folder in folders if folder.is_dir()), None)
    if folder is None:
        return {}
    descriptions: dict[str, list[Path]] = {}
    for path in sorted(folder.rglob("*.urdf")):
        descriptions.setdefault(path.stem, []).append(path)
    by_name = {}
    for stem, paths in descriptions.items():
        for path in paths:
            # Two packages may call their file alike; then the package tells them apart.
            package = path.relative_to(folder).parts[0].removesuffix(_PACKAGE_SUFFIX)
            by_name[stem if len(paths) == 1 else package] = path
    return by_name


def _describe_missing_file(path: Path) -> str:
    """Say that a path names no file, and what is there instead."""
    if path.is_symlink():
        return f"{path} is a link to {path.readlink()}, which does not exist"
    if path.is_dir():
        return f"{path} is a folder; name the file of the robot's description in it"
    if not path.parent.is_dir():
        return f"there is no file {path}: the folder {path.parent} does not exist"
    return f"there is no file {path}{suggest_names(path.name, (other.name for other in path.parent.iterdir()))}"


def _fold_name(name: str) -> str:
    """Return a name without what people write differently: capitals, hyphens, spaces."""
    return "".join(letter for letter in name.casefold() if letter.isalnum())


def find_library_arm(text: str) -> str | None:
    """Return the arm of this package that a name means, however it is written ("UR10e", "Franka Panda"), or None."""
    return next((name for name in list_library_arms() if text and _fold_name(name) == _fold_name(text)), None)


def locate_robot(text: str) -> Path | None:
    """Return the file that a text names: a path, or the name of a stock robot; None for an arm of this package.

    Raises
    ------
    DynidentError
        Where there is no such robot, or several robots begin with this name.
    """
    path = Path(text)
    if path.is_file():
        return path
    if text in list_library_arms():
        return None
    stock = list_stock_robots()
    if text in stock:
        return stock[text]
    if path.suffix or len(path.parts) > 1:
        raise DynidentError(_describe_missing_file(path), pointer="ROBOT", title="Unknown robot")
    if find_library_arm(text) is not None:
        return None
    alike = [name for name in stock if _fold_name(name) == _fold_name(text)]
    if len(alike) == 1:
        return stock[alike[0]]
    alike = [name for name in stock if name.startswith(f"{text}_")] if text else []
    # The plain machine, of which the others are variants: their names say the same and more ("with hand").
    plain = [name for name in alike if all(set(name.split("_")) <= set(other.split("_")) for other in alike)]
    if len(plain) == 1:
        return stock[plain[0]]
    if alike:
        detail = (
            f"several robots of {_STOCK_PACKAGE} begin with {text!r}; in place of {text!r} type one of: "
            f"{', '.join(alike)}"
        )
    else:
        names = (*list_library_arms(), *sorted(stock))
        if not stock:
            names = (*names, f"and, after `pip install {_STOCK_PACKAGE}`, its robots, such as so101")
        # A hundred names would hide the one that was meant.
        advice = suggest_names(text, names) or f". The robots are: {', '.join(names)}."
        detail = f"there is neither a file nor a well-known robot {text!r}{advice}"
    raise DynidentError(detail, pointer="ROBOT", title="Unknown robot")
