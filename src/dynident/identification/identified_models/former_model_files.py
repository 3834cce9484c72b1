"""Read model files of every earlier format (1 to 5).

Format 1
    One model; the one below it on the ladder is a file inside it. Triangular factors are whole matrices. The base
    parameters were not stored.
Format 2
    All models of the ladder side by side, factors without their zeros, base parameters as they were determined.
Format 3
    As 2; an equation may have rows at rest, beside halts and at reversals apart.
Format 4
    As 3; rows beside halts are kept by blocks of time, and so are the reversals of held-out data.
Format 5
    As 4; factors have no more rows than the fullest block needs.
"""

from __future__ import annotations

import io
import json
import re
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynident.errors import DynidentError
from dynident.regressors.model_structure import Model

NAME = "dynident identification"
PRESENT = 5
Arrays = dict[str, NDArray[np.generic]]


def read_ladder(content: bytes) -> list[Arrays]:
    """Read the arrays of each model of a ladder, the lowest first.

    Raises
    ------
    DynidentError
        Where the file was written by a newer version.
    """
    arrays = _load(content)
    header = _read_header(arrays)
    number = _parse_format_number(header)
    # A newer file may hold fields that change the meaning of the others, so it is refused as a whole.
    if number > PRESENT:
        detail = f"the model has the format {number}, but this version reads formats 1 to {PRESENT}; update dynident"
        raise DynidentError(detail, title="Model of a newer version")
    if number == 1:
        return _read_first_format(arrays)
    ladder = []
    for position in range(int(header["rungs"])):
        prefix = f"{position}/"
        ladder.append({name.removeprefix(prefix): a for name, a in arrays.items() if name.startswith(prefix)})
    return ladder


def check_determined_base(model: Model, arrays: Mapping[str, NDArray[np.generic]], smallest_eigenvalue: float) -> None:
    """Raise DynidentError unless base parameters that a file does not store are determined as when it was written.

    Parameters
    ----------
    model : Model
        With the base parameters that this version determines.
    arrays : mapping
        Of the file: their columns in each joint's equation, and the smallest eigenvalue of the inertia matrix.
    smallest_eigenvalue : float
        What the values of the file make of it in `model`.
    """
    for joint in range(model.robot.n):
        if not np.array_equal(model.observation.joint_entries(joint)[1], arrays[f"training_{joint}_columns"]):
            raise other_parameters_error()
    stored = float(_read_header(arrays)["worst_inertia_eigenvalue"])
    # Both come from the same values by the same sums: they differ by rounding, or altogether.
    if not np.isclose(smallest_eigenvalue, stored, rtol=1e-6, atol=1e-9, equal_nan=True):
        raise other_parameters_error()


def other_parameters_error() -> DynidentError:
    """Return the error that this version gives the effects of a model other parameters than it has."""
    detail = "the effects of this model have other parameters in this version; identify it again from its recordings"
    return DynidentError(detail, title="Model of another version")


def _load(content: bytes) -> Arrays:
    # No pickles: a model file may come from anybody, and unpickling runs code.
    with np.load(io.BytesIO(content), allow_pickle=False) as file:
        return dict(file)


def _read_header(arrays: Mapping[str, NDArray[np.generic]]) -> dict[str, Any]:
    header: dict[str, Any] = json.loads(arrays["header"].tobytes())
    return header


def _parse_format_number(header: Mapping[str, Any]) -> int:
    matched = re.fullmatch(rf"{NAME} ([1-9]\d?)", header["format"])
    if matched is None:
        raise ValueError(header["format"])
    return int(matched[1])


def _read_first_format(arrays: Arrays) -> list[Arrays]:
    ladder = [arrays]
    # Each file holds the model below it, so the ladder is read from its top.
    while "parent" in ladder[-1]:
        parent = _load(ladder[-1].pop("parent").tobytes())
        if _parse_format_number(_read_header(parent)) != 1:
            raise ValueError("a model of another format inside a model of the first format")
        ladder.append(parent)
    for model in ladder:
        for name, array in model.items():
            if re.fullmatch(r"(training|held_out_data)_\d+_factors", name):
                # The first format stored whole square factors; only the upper triangle holds numbers.
                model[name] = array[:, *np.triu_indices(array.shape[-1])]
    return ladder[::-1]
