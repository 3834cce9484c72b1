"""Descriptions of well-known arms that are part of the package, by name."""

from __future__ import annotations

import json
from importlib.resources import files

from dynident.errors import DynidentError
from dynident.known_robots import list_library_arms
from dynident.robot.json_fields import join_names
from dynident.robot.modified_dh import robot_from_modified_dh
from dynident.robot.robot_model import Robot

_FOLDER = files("dynident.robot") / "bundled_arms"


def library_names() -> tuple[str, ...]:
    """Return the names of the arms in the library.

    Returns
    -------
    tuple of str
        Sorted.
    """
    return list_library_arms()


def library_table(name: str) -> str:
    """Return the modified Denavit-Hartenberg table of an arm as JSON text.

    Parameters
    ----------
    name : str
        One of `library_names()`.

    Returns
    -------
    str
        As `robot_from_modified_dh` reads it.

    Raises
    ------
    DynidentError
        If there is no arm of that name; the message lists those there are.
    """
    if name not in library_names():
        raise DynidentError(
            f"There is no arm '{name}'; choose from: {join_names(library_names())}.", title="Unknown robot"
        )
    return (_FOLDER / f"{name}.json").read_text(encoding="utf-8")


def library_source(name: str) -> str:
    """Return a text on which data of an arm are published and which are merely plausible.

    Parameters
    ----------
    name : str
        One of `library_names()`.

    Returns
    -------
    str
        Some sentences.

    Raises
    ------
    DynidentError
        If there is no arm of that name.
    """
    source: str = json.loads(library_table(name))["source"]
    return source


def robot_from_library(name: str) -> Robot:
    """Return a well-known arm with its limits and inertial parameters.

    `library_source` tells where they are from.

    Parameters
    ----------
    name : str
        One of `library_names()`.

    Returns
    -------
    Robot
        The arm, without drive chains.

    Raises
    ------
    DynidentError
        If there is no arm of that name.

    Examples
    --------
    >>> robot_from_library("ur5").n
    6
    """
    return robot_from_modified_dh(name, library_table(name))
