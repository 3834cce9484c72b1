"""Preprocessing: cut-off frequencies, filter order and decimation, between a recording and the equations."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from math import isfinite

from dynident.recordings.metadata import PreprocessingChoices, RecordingError


@dataclass(frozen=True)
class Preprocessing:
    """How positions are filtered and how Y and the columns of W are filtered and decimated together (§12.4).

    Parameters
    ----------
    position_cutoff : float or None
        Cut-off of the zero-phase Butterworth filter on q in Hz; None: no filter.
    torque_cutoff : float or None
        Cut-off of the parallel filter in Hz; None: no filter.
    decimation : int
        Every how many-th row the parallel filter gives.
    filter_order : int
        Order of one pass of the Butterworth filter.
    reasons : tuple of str
        Why these values, a sentence each.
    """

    position_cutoff: float | None
    torque_cutoff: float | None
    decimation: int = 1
    filter_order: int = 4
    reasons: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for name in ("position_cutoff", "torque_cutoff"):
            value = getattr(self, name)
            if value is not None and not (isfinite(value) and value > 0):
                raise _impossible_value_error(
                    name, f"{name} is {value}; give a frequency in Hz above 0, or null for no filter."
                )
        if self.decimation < 1:
            raise _impossible_value_error(
                "decimation", f"decimation is {self.decimation}; give a whole number of at least 1."
            )
        if not 1 <= self.filter_order <= 12:
            raise _impossible_value_error(
                "filter_order", f"filter_order is {self.filter_order}; give a number from 1 to 12."
            )

    def check_against(self, rate: float) -> None:
        """Raise `RecordingError` where a value is impossible at this sampling rate (Hz)."""
        for name in ("position_cutoff", "torque_cutoff"):
            value = getattr(self, name)
            if value is not None and value >= 0.5 * rate:
                raise _impossible_value_error(
                    name,
                    f"{name} is {value:g} Hz, but the recording is sampled at {rate:.6g} Hz, so only frequencies below "
                    f"{0.5 * rate:.6g} Hz (Nyquist) are in it.",
                )
        # What the filter passes has to lie below half of the rate that decimation leaves.
        decimated = rate / self.decimation
        if self.torque_cutoff is not None and self.decimation > 1 and decimated < 2.0 * self.torque_cutoff:
            raise _impossible_value_error(
                "decimation",
                f"Decimation by {self.decimation} leaves {decimated:.4g} Hz, less than twice the torque cut-off of "
                f"{self.torque_cutoff:g} Hz: the rows would be aliased. Give at most "
                f"{max(1, int(rate / (2.0 * self.torque_cutoff)))}.",
            )


FIELDS = tuple(field.name for field in fields(PreprocessingChoices))


def values_from_request(request: object) -> dict[str, float | int | None]:
    """Return the fields that a user has set, checked for their kind; "auto" counts as not set.

    Parameters
    ----------
    request : mapping
        As it came from the user.

    Returns
    -------
    dict
        Values by field, None for no filter.

    Raises
    ------
    RecordingError
        With a pointer to an unknown field or to a value that is no number.
    """
    if not isinstance(request, Mapping):
        raise RecordingError(
            f'preprocessing is {request!r}; give "auto", or an object with any of {", ".join(FIELDS)}.',
            pointer="/preprocessing",
            title="Impossible preprocessing",
        )
    values: dict[str, float | int | None] = {}
    for name, value in request.items():
        if name not in FIELDS:
            raise _impossible_value_error(
                name, f"There is no preprocessing choice {name!r}; there are {', '.join(FIELDS)}."
            )
        if value == "auto":
            continue
        if value is None and name.endswith("cutoff"):
            values[name] = None
        # JSON's true would otherwise count as 1, since a bool is an int.
        elif isinstance(value, bool) or not isinstance(value, int | float) or not isfinite(value):
            raise _impossible_value_error(
                name, f"{name} is {value!r}; give a number" + (" or null." if "cut" in name else ".")
            )
        elif name.endswith("cutoff"):
            values[name] = float(value)
        elif value != int(value):
            raise _impossible_value_error(name, f"{name} is {value}; give a whole number.")
        else:
            values[name] = int(value)
    return values


def _impossible_value_error(name: str, detail: str) -> RecordingError:
    return RecordingError(detail, pointer=f"/preprocessing/{name}", title="Impossible preprocessing")
