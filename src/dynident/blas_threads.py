"""A decorator that runs BLAS on one thread, for functions whose matrices are small.

On matrices of 100 x 60 a multi-threaded BLAS spends its time waking threads: the same identification takes up to ten
times as long, and the time varies from run to run.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import ParamSpec, TypeVar

from threadpoolctl import threadpool_limits

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
        with threadpool_limits(limits=1, user_api="blas"):
            return function(*args, **kwargs)

    return limited
