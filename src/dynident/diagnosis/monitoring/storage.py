"""Store reduced days in one file, so that one more day costs its own recordings alone."""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Sequence
from typing import Any

import numpy as np

from dynident.diagnosis.monitoring.days import Day, Measure, build_measure
from dynident.errors import DynidentError
from dynident.estimation import EquationFactors, Reduction
from dynident.identification import Identification

_FORMAT = "dynident days 1"


def days_to_bytes(measure: Measure, days: Sequence[Day]) -> bytes:
    """Write days as the bytes of an .npz file, with the digest of their measure.

    Parameters
    ----------
    measure : Measure
        Columns that the days were reduced to.
    days : sequence of Day
        Days in their order.

    Returns
    -------
    bytes
        Content of the file.
    """
    header = {
        "format": _FORMAT,
        "measure": measure.digest,
        "equations": len(days[0].reduction.equations) if days else 0,
        "days": [{"name": day.name, "source": day.source} for day in days],
    }
    # An .npz file holds nothing but arrays, so that the JSON text is stored as bytes.
    arrays: dict[str, Any] = {"header": np.frombuffer(json.dumps(header).encode(), dtype=np.uint8)}
    for number, day in enumerate(days):
        arrays |= {f"{number}/floor": day.floor, f"{number}/spans": day.reduction.spans}
        for k, equation in enumerate(day.reduction.equations):
            arrays |= {
                f"{number}/{k}/columns": equation.columns,
                f"{number}/{k}/factors": equation.factors,
                f"{number}/{k}/counts": equation.counts,
            }
    file = io.BytesIO()
    np.savez(file, **arrays)
    return file.getvalue()


def days_from_bytes(measure: Measure, content: bytes) -> tuple[Day, ...]:
    """Read stored days.

    Parameters
    ----------
    measure : Measure
        Columns that the days were reduced to.
    content : bytes
        Content of the file.

    Returns
    -------
    tuple of Day
        Days in their order.

    Raises
    ------
    DynidentError
        Where this is no such file, or the days were reduced for another model.
    """
    header = _read_header(content)
    if header["measure"] != measure.digest:
        raise DynidentError(
            "these days were reduced for another model, or without the temperatures; begin anew",
            title="Days of another model",
        )
    with np.load(io.BytesIO(content), allow_pickle=False) as file:
        arrays = {name: file[name] for name in file.files}
    return tuple(
        Day(
            entry["name"],
            Reduction(
                measure.observation.n_columns,
                tuple(_read_equation(arrays, f"{number}/{k}") for k in range(header["equations"])),
                arrays[f"{number}/spans"],
            ),
            arrays[f"{number}/floor"],
            measure.digest,
            entry["source"],
        )
        for number, entry in enumerate(header["days"])
    )


def load_days(identification: Identification, content: bytes) -> tuple[Measure, tuple[Day, ...]]:
    """Read the stored days of a model together with their measure, with temperatures or without.

    Parameters
    ----------
    identification : Identification
        The model that the days were reduced for.
    content : bytes
        Content of the file.

    Returns
    -------
    tuple of Measure, tuple of Day
        The measure that fits the file, and the days.

    Raises
    ------
    DynidentError
        Where this is no such file, or the days were reduced for another model.
    """
    # The file does not say whether the days have temperatures; the digest of the measure tells.
    measure = build_measure(identification)
    if _read_header(content)["measure"] != measure.digest:
        measure = build_measure(identification, with_temperature=True)
    return measure, days_from_bytes(measure, content)


def check_days(content: bytes) -> None:
    """Raise `DynidentError` where this is no file of days that this version reads."""
    _read_header(content)


def _read_header(content: bytes) -> dict[str, Any]:
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as file:
            header = json.loads(file["header"].tobytes())
        known = header["format"] == _FORMAT and "measure" in header
    # Whatever file somebody gives, the answer is a sentence.
    except (ValueError, KeyError, OSError, TypeError, zipfile.BadZipFile) as error:
        raise DynidentError("this is no file of days", title="Unusable file") from error
    if not known:
        raise DynidentError(f"this is no file of days but of {header['format']!r}", title="Unusable file")
    return dict(header)


def _read_equation(arrays: dict[str, Any], name: str) -> EquationFactors:
    columns = arrays[f"{name}/columns"].astype(np.intp)
    return EquationFactors(columns, arrays[f"{name}/factors"], arrays[f"{name}/counts"].astype(np.intp))
