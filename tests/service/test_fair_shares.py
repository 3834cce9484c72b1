"""Nobody takes all places of the service, and nobody waits behind all that another one sent."""

from __future__ import annotations

from typing import Any

import anyio
import pytest

from dynident_service.fair_queue import FairQueue, SharedPlaces, SharedQueue, Ticket, name_address_party


def fill(places: SharedPlaces, party: str) -> int:
    """Take as many as a party may; gives how many it has."""
    while places.may_take(party):
        places.take(party)
    return places.held[party]


@pytest.mark.parametrize(("total", "alone"), [(1, 1), (2, 1), (3, 2), (4, 3), (8, 6), (64, 48), (100, 75)])
def test_one_party_alone_takes_at_most_three_quarters(total: int, alone: int) -> None:
    assert fill(SharedPlaces(total), "a") == alone


@pytest.mark.parametrize(("total", "greedy"), [(4, 1), (8, 1), (64, 3), (100, 4)])
def test_there_is_a_place_for_who_has_none_while_others_take_all_that_they_may(total: int, greedy: int) -> None:
    places = SharedPlaces(total)
    for party in range(greedy):
        assert fill(places, f"party {party}") >= 1
    assert places.may_take("late")


def test_parties_that_come_in_turn_have_the_same_share_in_the_end() -> None:
    places = SharedPlaces(100)
    for _ in range(50):
        for party in ("a", "b"):
            if places.may_take(party):
                places.take(party)
    assert sorted(places.held.values()) == [42, 43]


def test_what_is_given_back_may_be_taken_again() -> None:
    places = SharedPlaces(4)
    assert fill(places, "a") == 3
    places.give_back("a")
    assert places.may_take("a")
    for _ in range(2):
        places.give_back("a")
    assert not places.held


@pytest.mark.parametrize(
    ("client", "party"),
    [
        (("192.0.2.7", 1), "address 192.0.2.7"),
        (("2001:db8:1:2:3:4:5:6", 1), "address 2001:db8:1:2::/64"),
        (("::ffff:192.0.2.7", 1), "address ::ffff:192.0.2.7"),
        (("fe80::1%eth0", 1), "address fe80::/64"),
        (("testclient", 1), "address testclient"),
        (None, "address "),
    ],
)
def test_an_address_of_version_six_stands_for_its_subscriber(client: Any, party: str) -> None:
    assert name_address_party({"client": client}) == party


async def come_in_turn(queue: FairQueue, tickets: list[Ticket], number: int) -> list[str]:
    """Have tickets wait in this order; each that is let in leaves when as many have come as can. Gives who came."""
    came: list[str] = []

    async def take(ticket: Ticket) -> None:
        async with queue.wait_for_turn(ticket):
            came.append(ticket.party)
            if number > len(came):
                await anyio.sleep(0.01)
            else:
                await anyio.sleep_forever()

    async with anyio.create_task_group() as group:
        for ticket in tickets:
            group.start_soon(take, ticket)
            await anyio.sleep(0)
        with anyio.move_on_after(0.3):
            await anyio.sleep_forever()
        group.cancel_scope.cancel()
    assert queue.under_way == []
    return came


def test_the_next_is_of_the_party_of_whom_the_fewest_go_on() -> None:
    tickets = [Ticket("many") for _ in range(5)] + [Ticket("few"), Ticket("other")]
    came = anyio.run(come_in_turn, FairQueue(2), tickets, 100)
    assert came == ["many", "many", "few", "many", "other", "many", "many"]


def test_one_who_stops_to_wait_keeps_no_place() -> None:
    async def leave() -> list[str]:
        queue = FairQueue(1)
        held = Ticket("a")
        await queue.wait(held)
        with anyio.move_on_after(0.01):
            await queue.wait(Ticket("b"))
        queue.leave(held)
        return await come_in_turn(queue, [Ticket("c")], 100)

    assert anyio.run(leave) == ["c"]


@pytest.mark.parametrize(
    ("size", "tickets", "expected"),
    [
        (2, [("a", True), ("b", True), ("a", False), ("b", False)], ["a", "a"]),  # one is kept for short ones
        (4, [("a", True)] * 4 + [("b", True)], ["a", "a", "b"]),  # and of the others one for another party
        (4, [("a", False)] * 5 + [("b", False)], ["a", "a", "a", "b"]),
        (1, [("a", True), ("b", False)], ["a"]),
    ],
)
def test_what_takes_long_leaves_a_place_to_the_short_and_to_others(
    size: int, tickets: list[tuple[str, bool]], expected: list[str]
) -> None:
    several = [Ticket(party, is_long) for party, is_long in tickets]
    assert anyio.run(come_in_turn, SharedQueue(size), several, 0) == expected
