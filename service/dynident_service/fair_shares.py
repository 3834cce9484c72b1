"""Places that several parties share: nobody can take all of them, and nobody waits behind all that another one sent.

A party is a key, by its name; where no key is asked for, the address that a request comes from.
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
"""A party that has places may take another while it has fewer than so many times those that would stay free: alone it
gets three quarters at most, of two that come in turn each gets three sevenths, and so on. What one leaves is there for
others who have less."""
PREFIX = 64
"""Leading bits of an IPv6 address that stand for one subscriber, who has all the addresses that begin so."""


def party_of_key(name: str) -> str:
    """Name the party that has a key."""
    return f"key {name}"


def party_of_address(scope: Scope) -> str:
    """Name the party that a request comes from where no key says who sent it."""
    client = scope.get("client")
    return f"address {_subscriber(client[0]) if client else ''}"


def _subscriber(host: str) -> str:
    try:
        address = ipaddress.ip_address(host.partition("%")[0])
    except ValueError:  # no address, as of a socket in the file system
        return host
    if isinstance(address, ipaddress.IPv4Address) or address.ipv4_mapped:
        return host
    return str(ipaddress.ip_network((address.packed, PREFIX), strict=False))


def is_share_left(held: int, free: int) -> bool:
    """Tell whether a party that holds so many places may take one of the free ones."""
    return free > 0 and (held == 0 or held < TIMES_THE_REST * (free - 1))


class SharedPlaces:
    """Counts who holds how many of some places."""

    def __init__(self, total: int) -> None:
        self.total = total
        self.held: Counter[str] = Counter()

    def may_take(self, party: str) -> bool:
        """Tell whether a party may take a place."""
        return is_share_left(self.held[party], self.total - self.held.total())

    def take(self, party: str) -> None:
        """Take a place for a party, which it is the caller's to ask for before."""
        self.held[party] += 1

    def give_back(self, party: str) -> None:
        """Give a place back."""
        self.held[party] -= 1
        if not self.held[party]:
            del self.held[party]


@dataclass(eq=False)
class Ticket:
    """One who waits in a queue, or whose turn it is."""

    party: str
    is_long: bool = False
    turn: anyio.Event = field(default_factory=anyio.Event)


class FairQueue:
    """Lets a few go on at a time; the next is the oldest of the party of whom the fewest go on."""

    def __init__(self, size: int) -> None:
        self.size = size
        self.under_way: list[Ticket] = []
        self._waiting: list[Ticket] = []

    async def wait(self, ticket: Ticket) -> None:
        """Wait until it is a ticket's turn; `leave` ends that."""
        self._waiting.append(ticket)
        self._go_on()
        try:
            await ticket.turn.wait()
        except BaseException:
            self.leave(ticket)
            raise

    def leave(self, ticket: Ticket) -> None:
        """Let the next one go on, or wait no longer."""
        (self.under_way if ticket.turn.is_set() else self._waiting).remove(ticket)
        self._go_on()

    @asynccontextmanager
    async def turn_of(self, ticket: Ticket) -> AsyncIterator[None]:
        """Enter when it is a ticket's turn, which ends with the block."""
        await self.wait(ticket)
        try:
            yield
        finally:
            self.leave(ticket)

    def may_go_on(self, ticket: Ticket) -> bool:
        """Tell whether the turn may be a ticket's while a place is free."""
        return True

    def _go_on(self) -> None:
        while len(self.under_way) < self.size:
            held = Counter(ticket.party for ticket in self.under_way)
            # Of those with the same number `min` gives the first, who came first.
            following = min(filter(self.may_go_on, self._waiting), key=lambda one: held[one.party], default=None)
            if following is None:
                return
            self._waiting.remove(following)
            self.under_way.append(following)
            following.turn.set()


class SharedQueue(FairQueue):
    """A queue for what may take long: of long ones a party cannot have all places, and one place is kept for the short.

    With a single place there is none to keep.
    """

    def may_go_on(self, ticket: Ticket) -> bool:
        """Tell whether a party may take another place with what is as long."""
        alike = [one for one in self.under_way if one.is_long == ticket.is_long]
        free = self.size - len(self.under_way)
        if ticket.is_long:
            free = min(free, max(1, self.size - 1) - len(alike))
        return is_share_left(sum(one.party == ticket.party for one in alike), free)
