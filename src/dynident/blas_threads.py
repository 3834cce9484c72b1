"""`single_threaded`: a decorator that runs BLAS on one thread.

On matrices of 100 x 60 a multi-threaded BLAS spends its time waking threads: the same identification takes up to ten
times as long, and the time varies from run to run.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import lru_cache, wraps
from typing import ParamSpec, TypeVar

from threadpoolctl import ThreadpoolController

_Arguments = ParamSpec("_Arguments")
_Result = TypeVar("_Result")


def single_threaded(function: Callable[_Arguments, _Result]) -> Callable[_Arguments, _Result]:
    """Decorate a function so that BLAS uses one thread while it runs.

    Parameters
    ----------
    function : callable
        A function whose matrices are small.

    Returns
    -------
    callable
        The function with the same signature.
    """

    @wraps(function)
    def limited(*args: _Arguments.args, **kwargs: _Arguments.kwargs) -> _Result:
        with _find_libraries(len(sys.modules)).limit(limits=1, user_api="blas"):
            return function(*args, **kwargs)

    return limited


@lru_cache(maxsize=1)
def _find_libraries(n_modules: int) -> ThreadpoolController:  # noqa: ARG001 - the key of the cache
    """Return what limits the threads of all BLAS libraries of this process.

    Looking for them reads the list of all loaded files, which takes milliseconds. A library comes with a module, so
    that they are looked for again only when modules were imported since.

    Parameters
    ----------
    n_modules : int
        Number of modules that are imported now.
    """
    return ThreadpoolController()
