"""Fair queues and shares: no API key or address takes all places; which party a request belongs to.

A party is an API key, by its name; without keys it is the address that a request comes from.
"""

from __future__ import annotations

import ipaddress
from collections import Counter
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass, field

import anyio
from starlette.types import Scope

TIMES_THE_REST = 3
"""A party may take a further place while it has fewer than this many times the places that would remain free. Alone it
gets at most three quarters, of two that arrive in turn each gets three sevenths, and so on. The places that it leaves
are for parties that have fewer.
"""
PREFIX = 64
"""Leading bits of an IPv6 address that identify a subscriber, who owns all addresses with that prefix."""


def name_key_party(name: str) -> str:
    """Return the name of the party with a key."""
    return f"key {name}"


def name_address_party(scope: Scope) -> str:
    """Return the name of the party that a request without a known key comes from."""
    client = scope.get("client")
    return f"address {_get_subscriber(client[0]) if client else ''}"


def _get_subscriber(host: str) -> str:
    try:
        address = ipaddress.ip_address(host.partition("%")[0])
    except ValueError:  # no address, as of a socket in the file system
        return host
    # An IPv4 address stands for one subscriber; an IPv6 subscriber could use a new address for each request.
    if isinstance(address, ipaddress.IPv4Address) or address.ipv4_mapped:
        return host
    return str(ipaddress.ip_network((address.packed, PREFIX), strict=False))


def is_share_left(held: int, free: int) -> bool:
    """Return whether a party that holds `held` places may take one of `free` ones."""
    return free > 0 and (held == 0 or held < TIMES_THE_REST * (free - 1))


class SharedPlaces:
    """Count of places by the party that holds them."""

    def __init__(self, total: int) -> None:
        self.total = total
        self.held: Counter[str] = Counter()

    def may_take(self, party: str) -> bool:
        """Return whether a party may take a place."""
        return is_share_left(self.held[party], self.total - self.held.total())

    def take(self, party: str) -> None:
        """Take a place for a party; the caller has asked `may_take` before."""
        self.held[party] += 1

    def give_back(self, party: str) -> None:
        """Release a place of a party."""
        self.held[party] -= 1
        # Parties without a place are forgotten: addresses would otherwise gather for as long as the service runs.
        if not self.held[party]:
            del self.held[party]


@dataclass(eq=False)
class Ticket:
    """Place in a queue; `turn` is set when it has been admitted."""

    party: str
    is_long: bool = False
    turn: anyio.Event = field(default_factory=anyio.Event)


class FairQueue:
    """Queue that admits a few at a time; the next is the oldest of the party with the fewest admitted ones."""

    def __init__(self, size: int) -> None:
        self.size = size
        self.under_way: list[Ticket] = []
        self._waiting: list[Ticket] = []

    async def wait(self, ticket: Ticket) -> None:
        """Wait until a ticket is admitted; `leave` gives the place back."""
        self._waiting.append(ticket)
        self._admit_next()
        try:
            await ticket.turn.wait()
        except BaseException:
            self.leave(ticket)
            raise

    def leave(self, ticket: Ticket) -> None:
        """Give back the place of a ticket, or stop waiting, and admit the next one."""
        # Whoever leaves while waiting holds no place: its ticket is in the other list.
        (self.under_way if ticket.turn.is_set() else self._waiting).remove(ticket)
        self._admit_next()

    @asynccontextmanager
    async def wait_for_turn(self, ticket: Ticket) -> AsyncIterator[None]:
        """Wait until a ticket is admitted, and give its place back at the end of the block."""
        await self.wait(ticket)
        try:
            yield
        finally:
            self.leave(ticket)

    def may_proceed(self, ticket: Ticket) -> bool:
        """Return whether a ticket may be admitted while a place is free."""
        return True

    def _admit_next(self) -> None:
        while len(self.under_way) < self.size:
            held = Counter(ticket.party for ticket in self.under_way)
            # Among equal numbers `min` returns the first one, which has waited longest.
            following = min(
                filter(self.may_proceed, self._waiting), key=lambda candidate: held[candidate.party], default=None
            )
            if following is None:
                return
            self._waiting.remove(following)
            self.under_way.append(following)
            following.turn.set()


class SharedQueue(FairQueue):
    """Queue for long and short computations: a party never gets all places for long ones, and one is kept for short.

    A single place cannot be reserved.
    """

    def may_proceed(self, ticket: Ticket) -> bool:
        """Return whether the party of a ticket may have another place for a computation of its length."""
        alike = [other for other in self.under_way if other.is_long == ticket.is_long]
        free = self.size - len(self.under_way)
        # One place of several stays free for short computations, whoever asks for them.
        if ticket.is_long:
            free = min(free, max(1, self.size - 1) - len(alike))
        return is_share_left(sum(other.party == ticket.party for other in alike), free)
