"""Budget of a search: time and number of starts."""

from __future__ import annotations

import time


class Budget:
    """Limits of an optimisation's time and number of starts.

    Parameters
    ----------
    starts : int, optional
        Largest number of starts.
    seconds : float, optional
        Longest time, counted from now.
    """

    def __init__(self, starts: int | None, seconds: float | None) -> None:
        self.starts, self.seconds = starts, seconds
        self._began = time.monotonic()

    @property
    def elapsed(self) -> float:
        """Seconds that have passed, those before an interruption included."""
        return time.monotonic() - self._began

    def add_elapsed(self, seconds: float) -> None:
        """Count the time that passed before the search was interrupted."""
        self._began -= seconds

    @property
    def share_spent(self) -> float:
        """Share of the time that has passed; 0 where time is not limited."""
        return 0.0 if self.seconds is None else (time.monotonic() - self._began) / self.seconds

    @property
    def is_spent(self) -> bool:
        """Whether the time is over."""
        return self.share_spent >= 1.0

    def fraction(self, starts: float) -> float:
        """Return the share of the budget used when so many starts are done, parts of them included."""
        shares = [] if self.starts is None else [starts / self.starts]
        if self.seconds is not None:
            shares.append(self.share_spent)
        return min(1.0, max(shares))
