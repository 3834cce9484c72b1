"""Zero-phase Butterworth filter of a stream, equal to `scipy.signal.sosfiltfilt` over the whole of it (§12.3.5)."""

from __future__ import annotations

from collections.abc import Iterator
from math import ceil, log

import numpy as np
from scipy import signal

from dynident.arrays import FloatArray

FORGOTTEN = 1e-16
"""The backward pass starts this far ahead: what it does not know of the future has decayed to rounding error."""

SETTLED = 1e-2
"""A transient of the filter counts as over once it has decayed to this share."""


class ZeroPhase:
    """Forward-backward Butterworth low-pass in second-order sections, applied to blocks of a segment.

    Parameters
    ----------
    rate, cutoff : float
        Sampling rate and cut-off frequency (half power of one pass) in Hz.
    order : int
        Order of one pass.
    """

    def __init__(self, rate: float, cutoff: float, order: int) -> None:
        self._sos = signal.butter(order, cutoff, fs=rate, output="sos")
        self._zi = signal.sosfilt_zi(self._sos)[:, :, None]
        poles = signal.butter(order, cutoff, fs=rate, output="zpk")[1]
        # A transient decays by this much (as an exponent) with each sample: by the slowest pole.
        self._decay = -log(min(float(np.abs(poles).max()), 1.0 - 1e-15))
        # The same extension at the ends as scipy.signal.sosfiltfilt takes by default.
        sections = len(self._sos)
        at_origin = min(int((self._sos[:, 2] == 0).sum()), int((self._sos[:, 5] == 0).sum()))
        self._pad = 3 * (2 * sections + 1 - at_origin)

    @property
    def lookahead(self) -> int:
        """Samples of the future that an output sample depends on."""
        return ceil(-log(FORGOTTEN) / self._decay) + 1

    @property
    def settling(self) -> int:
        """Samples at either end of a segment that its unknown surroundings spoil."""
        return ceil(-log(SETTLED) / self._decay)

    def stream(self, blocks: Iterator[FloatArray], length: int) -> Iterator[FloatArray]:
        """Filter blocks (m, n) that together hold `length` samples.

        Parameters
        ----------
        blocks : iterator of (m, n)
        length : int

        Yields
        ------
        (k, n)
            Of other lengths than the blocks, the same total.
        """
        pad = min(self._pad, length - 1)
        ahead = self.lookahead
        state: FloatArray | None = None
        tail = np.empty((0, 0))
        waiting: list[FloatArray] = []
        n_waiting = n_done = 0
        for block in blocks:
            n_done += len(block)
            last = n_done >= length
            if state is None and not last and len(block) <= pad:
                raise ValueError(f"the first block holds {len(block)} samples; at least {pad + 1} are needed")
            if state is None:
                # The odd extension that sosfiltfilt puts before the first sample: point-symmetric about it, so that
                # no step excites the filter.
                start = 2 * block[0] - block[pad:0:-1]
                block_ends = np.concatenate([start, block])
                state = self._zi * block_ends[0]
                if pad:
                    state = signal.sosfilt(self._sos, start, axis=0, zi=state)[1]
            tail = block if len(block) > pad else np.concatenate([tail, block])[-(pad + 1) :]
            forward, state = signal.sosfilt(self._sos, block, axis=0, zi=state)
            waiting.append(forward)
            n_waiting += len(forward)
            if last:
                end = 2 * tail[-1] - tail[-2 : -(pad + 2) : -1]
                if pad:
                    waiting.append(signal.sosfilt(self._sos, end, axis=0, zi=state)[0])
                yield self._filter_backward(waiting)[:n_waiting]
                return
            # The backward pass starts anew for each block, `ahead` samples further on, by which its unknown start has
            # died away: those samples are filtered again with the next block.
            if n_waiting >= 2 * ahead:
                joined = np.concatenate(waiting)
                yield self._filter_backward([joined])[: n_waiting - ahead]
                waiting = [joined[-ahead:].copy()]
                n_waiting = ahead

    def _filter_backward(self, parts: list[FloatArray]) -> FloatArray:
        """Filter the joined parts backward in time, from a steady state at their last sample."""
        forward = parts[0] if len(parts) == 1 else np.concatenate(parts)
        reverse: FloatArray = signal.sosfilt(self._sos, forward[::-1], axis=0, zi=self._zi * forward[-1])[0]
        return reverse[::-1]
