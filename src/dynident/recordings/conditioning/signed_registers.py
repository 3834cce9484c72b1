"""Repair step for signed registers that were logged as unsigned numbers; a check for signs that were lost."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from dynident.array_types import BoolArray, FloatArray
from dynident.recordings.conditioning.windows_and_changed_rows import ChangedRows, Signals, Window
from dynident.recordings.recording_metadata import Check
from dynident.recordings.signal_spectra import find_step

_FEWEST_JUMPS = 3
"""Jumps across zero that tell a register: a corrupted sample makes two."""

_JUMPS_LEFT = 0.4
"""Share of the jumps that may be left once the sign is read: torques of friction alone jump where joints reverse."""

_SMOOTH = 0.1
"""Share of the times that a signal passes the sign's place at which it may do so without a jump: one that is no
register passes any place so."""

_POSITIVE = 0.1
"""Share of the numbers other than 0 that are below the sign's place where both signs occur."""

BITS, WIDE_BITS = range(7, 32), (15, 31)
"""Bits that signs of torques stand in, of registers of 8 to 32 bits; and of positions, since one that wraps after a
turn, as those of absolute encoders do, is none whose sign was not read."""

_FIRST = 64
"""Rows that tell of most signals that they are no registers."""

BITS_OF: Mapping[str, Collection[int]] = {"q": WIDE_BITS, "tau": BITS}

_WHOLE, _OF_STEP = 1e-3, 0.05
"""How far a whole number may be from one, after its unit was taken into account and out again; and one that a log holds
times a constant, with the digits that it prints."""


@dataclass(frozen=True)
class Register:
    """A signed register: `bit` holds the sign, of a magnitude, or of a two's complement.

    The log may hold its numbers times a constant: `steps` are what one count is in each column.
    """

    bit: int
    is_magnitude: bool
    steps: tuple[float, ...] = (1.0,)

    def decode(self, raw: FloatArray) -> FloatArray:
        """Return the signed numbers of a register that was read as unsigned."""
        size, counts = 2.0**self.bit, np.rint(raw / self.steps)
        negative = size - counts if self.is_magnitude else counts - 2.0 * size
        return np.where(counts >= size, negative * self.steps, raw)

    def __str__(self) -> str:
        size = 2**self.bit
        times = "" if set(self.steps) == {1.0} else f" times their step, {min(self.steps):.4g},"
        if self.is_magnitude:
            return f"the values jump by {size}{times} around zero, so bit {self.bit} is the sign: {size} + x means -x"
        return (
            f"the values jump by {2 * size}{times} around zero, as signed numbers of {self.bit + 1} bits do when they "
            "are read as unsigned"
        )


def find_register(raw: FloatArray, together: BoolArray, bits: Collection[int] = BITS) -> Register | None:
    """Return the register that columns are of, if their sign was not read; None if they are no such registers.

    Parameters
    ----------
    raw : (m, k)
        Numbers as the file has them, of one kind of signal; NaN where one is missing.
    together : (m - 1,)
        Which rows follow the one before without a gap.
    bits : collection of int
        Where the sign may stand.

    Returns
    -------
    Register or None
        The register, which decodes the numbers.
    """
    # What was read as unsigned is never below zero, which the first rows of most signals refute.
    if (raw[:_FIRST] < -_WHOLE).any() or (raw < -_WHOLE).any():
        return None
    steps = tuple(map(_find_count, raw.T))
    if not all(steps):
        return None
    raw = raw / steps
    # If the sign was not read, negative numbers have the highest bit set: it shows in the largest number.
    bit = int(np.floor(np.log2(max(float(np.nanmax(raw, initial=0.0)), 1.0))))
    if bit not in bits:
        return None
    kinds = (Register(bit, is_magnitude=True), Register(bit, is_magnitude=False))
    # Of the two codings the right one makes the jumps across zero vanish.
    jumps = _count_jumps(raw, together, bit)
    remaining_jumps, register = min(
        ((_count_jumps(candidate.decode(raw), together, bit), candidate) for candidate in kinds),
        key=lambda pair: pair[0],
    )
    # An ordinary signal passes the place of the sign in small steps; a register whose sign was not read jumps there.
    passes = np.diff(raw >= 2.0**bit, axis=0)[together]
    smooth = int(np.count_nonzero(passes & (np.abs(np.diff(raw, axis=0)[together]) <= 0.5 * 2.0**bit)))
    is_register = jumps >= _FEWEST_JUMPS and remaining_jumps <= _JUMPS_LEFT * jumps and smooth <= _SMOOTH * passes.sum()
    return replace(register, steps=steps) if is_register else None


def _find_count(raw: FloatArray) -> float:
    """Return what one count is in a column (m,): 1 of whole numbers, the step of others; 0 where they have none."""
    finite = raw[np.isfinite(raw)]
    if (np.abs(finite - np.rint(finite)) <= _WHOLE).all():
        return 1.0
    step = find_step(finite) if len(finite) else 0.0
    if not step:
        return 0.0
    # The whole range tells the step closer than single gaps, whose digits are rounded.
    step = float(finite.max()) / float(np.rint(finite.max() / step))
    return step if (np.abs(finite / step - np.rint(finite / step)) <= _OF_STEP).all() else 0.0


def _count_jumps(values: FloatArray, together: BoolArray, bit: int) -> int:
    """Return the number of changes from row to row by more than half of what a register holds.

    Those to and from 0 count only in columns that hold positive numbers of a register as well: a drive that is switched
    off between its moves jumps there, too.
    """
    works = values != 0.0
    has_positive = ((values > 0.0) & (values < 2.0**bit)).sum(axis=0) > _POSITIVE * works.sum(axis=0)
    jumps = (np.abs(np.diff(values, axis=0)) > 0.5 * 2.0**bit) & (has_positive | (works[1:] & works[:-1]))
    return int(np.count_nonzero(jumps[together]))


class SignedRegisters:
    """Reads the sign of torques, and of positions, that a log holds as unsigned registers."""

    name = "registers"

    def __init__(self, signals: Signals) -> None:
        self._signals = signals
        self._registers: dict[str, Register] = {}
        self._found: dict[str, ChangedRows] = {}

    def apply(self, window: Window) -> None:
        """Read the signs in a window; from the first window on in which a register shows itself."""
        together = np.diff(window.run) == 0
        for kind, columns in self._signals.registers.items():
            at = list(columns)
            factors, offsets = self._signals.factors[at], self._signals.offsets[at]
            # A factor of 0 stands for a column that is read as zero: there are no numbers of the file behind it.
            if not factors.all():
                continue
            # Bits are those of the file's own numbers: back from SI units.
            raw = (window.values[:, at] - offsets) / factors
            register = self._registers.get(kind) or find_register(raw, together, BITS_OF[kind])
            if register is None:
                continue
            self._registers[kind] = register
            decoded = register.decode(raw)
            changed = decoded != raw
            window.values[:, at] = np.where(changed, decoded * factors + offsets, window.values[:, at])
            found_rows = self._found.setdefault(kind, ChangedRows())
            for place, column in enumerate(columns):
                own = window.select_own_rows(np.flatnonzero(changed[:, place] & np.isfinite(raw[:, place])))
                found_rows.add(column, own, window.t[own - 1 - window.first_row])

    def checks(self) -> list[Check]:
        """Report which columns are registers, and how they are read."""
        if not self._registers:
            return [Check(self.name, "ok", "No column is a signed number that was read as unsigned.")]
        return [self._report_register(kind, register) for kind, register in self._registers.items()]

    def _report_register(self, kind: str, register: Register) -> Check:
        rows, sources = self._found[kind], self._signals.sources
        names = [sources[column] for column in self._signals.registers[kind]]
        detail = (
            f"{' … '.join(dict.fromkeys((names[0], names[-1])))} are signed numbers that were read as unsigned: "
            f"{register}. {rows.n} samples are corrected; if the recorded values are right"
        )
        return rows.warn_of_correction(self.name, detail, sources)


def decode_registers(raw: FloatArray, t: FloatArray, kind: str) -> tuple[FloatArray, Register | None]:
    """Read the signs of columns of one kind of signal, if they are registers.

    Parameters
    ----------
    raw : (m, k)
        Numbers as the file has them.
    t : (m,)
        Times in s.
    kind : "q" or "tau"
        Kind of signal of all columns.

    Returns
    -------
    values : (m, k)
        The numbers with their signs.
    register : Register or None
        What the columns were; None if they are returned as they came.
    """
    register = find_register(raw, np.diff(t) > 0.0, BITS_OF[kind])
    return (raw, None) if register is None else (register.decode(raw), register)


def check_lost_sign(tau: FloatArray, names: Sequence[str]) -> Check | None:
    """Report torques (m, n) that are the absolute values of others; None where none are.

    Parameters
    ----------
    tau : (m, n)
        Torques or currents that change.
    names : sequence of str
        What the user calls their columns.
    """
    # A torque that is never below 0 may be of a link that is held on one side, and then comes to 0 by chance alone.
    if not tau.size or not (tau >= 0.0).all():
        return None
    unsigned = [name for name, own in zip(names, tau.T, strict=True) if _has_lost_sign(own)]
    are_turns = f"and {', '.join(unsigned)} turn back there as an absolute value does"
    if not unsigned and len(names) >= _FEWEST_JOINTS and all(map(_comes_to_zero, tau.T)):
        # Not every link of an arm is held on one side.
        unsigned, are_turns = list(names), f"though {names[0]} … {names[-1]} all come down to it"
    if not unsigned:
        return None
    detail = (
        f"No torque is ever below 0, {are_turns}: the sign was lost. Record torques with their sign; a driver may give "
        "the direction in a bit or a column of its own."
    )
    return Check("lost_sign", "error", detail, unsigned[0])


NEAR_ZERO, AWAY, LEAST_TURNS, STRAIGHT = 0.01, 0.05, 3, 0.9
"""Shares of its largest value that a torque without its sign comes down to, and leaves again, at least so often; and
the share of the variance there that a line explains once the sign is back: of a step at most 0.75."""

_OFF = 0.2
"""Share of its rows that a torque is 0 at a stretch where the drive is off."""


_FEWEST_JOINTS, _WRAP = 3, 0.9
"""Joints of an arm, of which some are not held on one side. The share of its range that a register jumps by at 0."""


def _comes_to_zero(tau: FloatArray) -> bool:
    """Tell whether a torque (m,) that is never below 0 often comes down to it, and is no register whose sign is unread.

    What is 0 at the ends is a drive that is not on yet, or no longer; one that is off for a while does not say whether
    its torque had a sign.
    """
    is_register = np.count_nonzero(np.abs(np.diff(tau)) > _WRAP * np.ptp(tau)) >= _FEWEST_JUMPS
    away = np.flatnonzero(tau > AWAY * tau.max())
    dips = [tau[first + 1 : last] for first, last in pairwise(away) if last > first + 1]
    n_dips = sum(dip.min() < NEAR_ZERO * tau.max() for dip in dips)
    is_off = any(np.count_nonzero(dip == 0.0) > _OFF * len(tau) for dip in dips)
    return not is_register and not is_off and n_dips >= LEAST_TURNS


def _has_lost_sign(tau: FloatArray) -> bool:
    """Tell whether a torque (m,) that is never below 0 often turns back there, as the absolute value of another does.

    One that stays at 0 is cut off, or of a drive that is off; one that stays near 0 may carry its load otherwise; and
    one that jumps by most of its range from row to row is a register whose sign was not read.
    """
    if np.count_nonzero(np.abs(np.diff(tau)) > 0.5 * np.ptp(tau)) >= _FEWEST_JUMPS:
        return False
    share = tau / tau.max()
    away = np.flatnonzero(share > AWAY)
    are_turns = []
    for before in np.flatnonzero(np.diff(away) > 1):
        dip = share[away[before] : away[before + 1] + 1]
        rows, lowest = np.arange(len(dip)), int(np.argmin(dip))
        if dip[lowest] < NEAR_ZERO:
            signed = np.where(rows < lowest, dip, -dip)
            are_turns.append(np.corrcoef(rows, signed)[0, 1] ** 2 > STRAIGHT)
    is_often = sum(are_turns) >= max(LEAST_TURNS, len(are_turns) / 2)
    return bool(is_often and np.mean(share == 0.0) < NEAR_ZERO)
