"""Former paths and names of modules, which can be imported for one more release, with a warning.

Packages with effects, estimators or fields of their own import such paths. Delete this module, its table
`former_modules.json`, and what installs it in `src/dynident/__init__.py`, with the next release.
"""

from __future__ import annotations

import json
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from importlib.resources import files
from types import ModuleType


@dataclass(frozen=True)
class FormerNames:
    """Former names, with the present ones.

    Parameters
    ----------
    modules : mapping of str to str
        The present module of each former one.
    names : mapping of str to mapping of str to str
        By present module, the present name of each former name in it.
    """

    modules: Mapping[str, str]
    names: Mapping[str, Mapping[str, str]]

    def is_package(self, module: str) -> bool:
        """Tell whether a former module was a package of other former modules."""
        return any(name.startswith(f"{module}.") for name in self.modules)


@cache
def read_former_names() -> FormerNames:
    """Read the table of former names."""
    table = json.loads((files("dynident") / "former_modules.json").read_text(encoding="utf-8"))
    return FormerNames(table["modules"], table["names"])


class FormerModuleFinder(MetaPathFinder, Loader):
    """Finds modules by their former paths; each gives what its present module has, by former and by present names."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Return a spec if the module is a former one."""
        # Python asks for every module that it does not find; the table is read for this library's alone.
        if not fullname.startswith("dynident.") or fullname not in read_former_names().modules:
            return None
        return ModuleSpec(fullname, self, is_package=read_former_names().is_package(fullname))

    def exec_module(self, module: ModuleType) -> None:
        """Let the module look up its names in the present one."""
        former = read_former_names()
        present = former.modules[module.__name__]
        warnings.warn(
            f"{module.__name__} is now {present}; the next release removes the old path.",
            DeprecationWarning,
            stacklevel=2,
        )

        def get(name: str) -> object:
            # Python itself asks modules for names such as __path__; a present module's answer would be about that
            # module.
            if name.startswith("__"):
                raise AttributeError(name)
            return getattr(import_module(present), former.names.get(present, {}).get(name, name))

        module.__dict__["__getattr__"] = get
