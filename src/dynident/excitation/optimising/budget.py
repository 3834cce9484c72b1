"""How long, and how often, a search may try."""

from __future__ import annotations

import time


class Budget:
    """How long, and how often, an optimisation may try.

    Parameters
    ----------
    starts : int, optional
        At most so many starts.
    seconds : float, optional
        At most so long, counted from now.
    """

    def __init__(self, starts: int | None, seconds: float | None) -> None:
        self.starts, self.seconds = starts, seconds
        self._began = time.monotonic()

    @property
    def taken(self) -> float:
        """Seconds that have passed, those before it was stopped included."""
        return time.monotonic() - self._began

    def go_on_after(self, seconds: float) -> None:
        """Count the time that was taken before the search was stopped."""
        self._began -= seconds

    @property
    def share_spent(self) -> float:
        """Share of the time that has passed; 0 where time does not matter."""
        return 0.0 if self.seconds is None else (time.monotonic() - self._began) / self.seconds

    @property
    def spent(self) -> bool:
        """Whether the time is over."""
        return self.share_spent >= 1.0

    def fraction(self, starts: float) -> float:
        """Share of the budget used when so many starts are done, parts of them included."""
        shares = [] if self.starts is None else [starts / self.starts]
        if self.seconds is not None:
            shares.append(self.share_spent)
        return min(1.0, max(shares))
