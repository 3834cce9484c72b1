"""Which extra of the distribution brings a package: for those who installed less than they use."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec
from importlib.util import find_spec
from types import ModuleType

# The import names of what [science] brings. What is neither here nor in FEW_NEED comes with [service].
SCIENCE = (
    "casadi",
    "clarabel",
    "coal",
    "jinja2",
    "llvmlite",
    "matplotlib",
    "numpy",
    "pinocchio",
    "platformdirs",
    "pyarrow",
    "pydantic",
    "rich",
    "ruckig",
    "scipy",
    "threadpoolctl",
    "typer",
    "typst",
)
FEW_NEED = {
    "h5py": "formats",
    "mcap": "formats",
    "mujoco": "formats",
    "opentelemetry": "otel",
    "psycopg": "postgresql",
    "rosbags": "formats",
    "xacro": "formats",
}
"""Import names, and the extra of each, of what is left out where it is not used."""
# These rooms of the library need none of them.
_LIGHT = ("errors", "extras", "lazy", "version")


def install_hint(package: str) -> str:
    """Say which extra brings a package that is missing."""
    name = package.partition(".")[0]
    extra = FEW_NEED.get(name, "science" if name in SCIENCE else "service")
    return f"install it with: pip install 'dynident[{extra}]'"


def missing_science() -> str | None:
    """The first package of [science] that is not installed; `None` where all are."""
    return next((name for name in SCIENCE if find_spec(name) is None), None)


class RoomsThatNeedScience(MetaPathFinder):
    """Stands in the way of `import dynident.robot` where `package` is missing, and says what to install."""

    def __init__(self, package: str) -> None:
        self._package = package

    def find_spec(
        self, fullname: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Leave all imports but those of the library's rooms to others.

        Raises
        ------
        ModuleNotFoundError
            A room is imported.
        """
        owner, _, room = fullname.partition(".")
        if owner != "dynident" or not room or room.partition(".")[0] in _LIGHT:
            return None
        raise ModuleNotFoundError(
            f"{fullname} needs the package {self._package}, which the light installation leaves out; "
            f"{install_hint(self._package)}",
            name=self._package,
        )
