"""What happens, one thing after the other, in an order that chance gives."""

from __future__ import annotations

import random
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

from mischief.databases import Losable
from mischief.parties import Party


@dataclass(frozen=True)
class Weather:
    """How bad the luck is, in seconds, and what happens."""

    between: tuple[float, float]
    stopped: tuple[float, ...]
    away: float
    deck: tuple[str, ...]
    shuffled: bool

    def for_a_cluster(self) -> Weather:
        """The same, and what happens to a scheduler."""
        return replace(self, deck=("scheduler", "stop of the scheduler", *self.deck))


STORM = Weather(
    between=(1.0, 5.0),
    stopped=(5.0, 15.0, 40.0),
    away=20.0,
    deck=("api", "worker", "child", "child", "child", "nursery", "stop", "database"),
    shuffled=True,
)
# Those first whose jobs are missed last, by their leases.
BRIEF = Weather(
    between=(0.5, 1.0),
    stopped=(2.0,),
    away=3.0,
    deck=("worker", "api", "child", "nursery", "database", "stop"),
    shuffled=False,
)


class Mischief:
    """Does what happens."""

    def __init__(self, party: Party, losable: Losable, weather: Weather, seed: int) -> None:
        self._party = party
        self._losable = losable
        self._weather = weather
        self._chance = random.Random(seed)
        self._deck: list[str] = []

    def next(self) -> str | None:
        """Wait a little, then let something happen; tells what. Everything happens once before anything does again.

        `None` where nothing did, as there was no such process just then: it comes again later.
        """
        if not self._deck:
            self._deck = list(self._weather.deck)
            if self._weather.shuffled:
                self._chance.shuffle(self._deck)
        time.sleep(self._chance.uniform(*self._weather.between))
        what = self._deck.pop(0)
        if self._actions()[what]() is False:
            self._deck.append(what)
            return None
        return what

    def _actions(self) -> dict[str, Callable[[], object]]:
        chance, party = self._chance, self._party
        computing, seconds = chance.choice(party.with_computations), chance.choice(self._weather.stopped)
        actions: dict[str, Callable[[], object]] = {
            "api": party.api.kill,
            "worker": chance.choice(party.workers).kill,
            "child": lambda: computing.kill_computation(chance),
            "nursery": lambda: computing.kill_nursery(chance),
            "stop": lambda: computing.stop(seconds),
            "database": lambda: self._losable.be_away(self._weather.away),
        }
        if party.scheduler is not None:
            scheduler = party.scheduler
            actions |= {"scheduler": scheduler.kill, "stop of the scheduler": lambda: scheduler.stop(seconds)}
        return actions
