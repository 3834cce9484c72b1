"""Which optional package belongs to which extra, and the hint to install it where it is missing."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec
from importlib.util import find_spec
from types import ModuleType

# The import names of the packages in [science]. A package that is neither here nor in FEW_NEED comes with [service].
SCIENCE_PACKAGES = (
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
EXTRA_OF_PACKAGE = {
    "h5py": "formats",
    "mcap": "formats",
    "mcp": "mcp",
    "mujoco": "formats",
    "opentelemetry": "otel",
    "pandas": "frames",
    "psycopg": "postgresql",
    "rosbags": "formats",
    "xacro": "formats",
}
"""Import names of packages that only some users need, with the extra that brings each."""
# These modules of the library need none of the packages, so that they can be imported everywhere.
_LIGHT_MODULES = ("errors", "extras", "lazy", "version")


def format_install_hint(package: str) -> str:
    """Return the sentence that says how to install a missing package.

    Parameters
    ----------
    package : str
        Its import name, or that of a module in it.

    Returns
    -------
    str
        A part of a sentence that names the extra to install.
    """
    # Python names the innermost module that it could not find; the package around it is what has to be installed.
    name = package.partition(".")[0]
    extra = EXTRA_OF_PACKAGE.get(name, "science" if name in SCIENCE_PACKAGES else "service")
    return f"install it with: pip install 'dynident[{extra}]'"


def find_missing_package() -> str | None:
    """Return the import name of the first package of [science] that is not installed; `None` where all are."""
    return next((name for name in SCIENCE_PACKAGES if find_spec(name) is None), None)


class MissingPackageFinder(MetaPathFinder):
    """An import hook that refuses the modules of this library which need a package that is not installed.

    Without it, `import dynident.robot` would end in an error about a package that the user never asked for.

    Parameters
    ----------
    package : str
        Import name of the missing package.
    """

    def __init__(self, package: str) -> None:
        self._package = package

    def find_spec(
        self, fullname: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Return None for all modules but those of this library, which leaves them to the other finders.

        Parameters
        ----------
        fullname : str
            Dotted name of the module that is imported.
        path, target
            Unused; the protocol of import hooks has them.

        Returns
        -------
        None

        Raises
        ------
        ModuleNotFoundError
            For a module of this library that needs the missing package; it says what to install.
        """
        owner, _, module_name = fullname.partition(".")
        if owner != "dynident" or not module_name or module_name.partition(".")[0] in _LIGHT_MODULES:
            return None
        raise ModuleNotFoundError(
            f"{fullname} needs the package {self._package}, which the light installation leaves out; "
            f"{format_install_hint(self._package)}",
            name=self._package,
        )
