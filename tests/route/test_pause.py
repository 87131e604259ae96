"""Operators of both sides pause and resume at once, and both sides end up alike."""

from __future__ import annotations

import itertools
from collections import deque

from hypothesis import given, settings
from hypothesis import strategies as st

from rsb_bridge.route.lifecycle import PauseState, Revisions


class Side:
    def __init__(self, *, is_client: bool) -> None:
        self.state = PauseState(Revisions(), paused=False, is_client=is_client)
        self.inbox: deque[tuple[bool, int]] = deque()
        self.other: Side

    def change(self, paused: bool) -> None:
        self.state.change(paused=paused)
        self.tell()

    def tell(self) -> None:
        self.other.inbox.append((self.state.paused, self.state.revision))

    def hear(self) -> None:
        if self.inbox:
            paused, revision = self.inbox.popleft()
            self.state.merge(paused=paused, revision=revision)


def pair() -> tuple[Side, Side]:
    client, server = Side(is_client=True), Side(is_client=False)
    client.other, server.other = server, client
    return client, server


def hear_all(*sides: Side) -> None:
    for side in sides:
        while side.inbox:
            side.hear()


def test_every_interleaving_of_three_presses_ends_alike() -> None:
    """With every choice of what is pressed."""
    orders = sorted(set(itertools.permutations(("client", "client", "server", "C", "C", "S"))))
    assert len(orders) == 180
    for order, presses in itertools.product(orders, itertools.product((False, True), repeat=3)):
        client, server = pair()
        chosen = iter(presses)
        for step in order:
            match step:
                case "client":
                    client.change(next(chosen))
                case "server":
                    server.change(next(chosen))
                case "C":
                    client.hear()
                case "S":
                    server.hear()
        hear_all(client, server)
        assert client.state.paused == server.state.paused, (order, presses)


def test_of_two_presses_at_once_client_s_counts() -> None:
    for paused in (True, False):
        client, server = pair()
        client.change(paused)
        server.change(not paused)
        hear_all(client, server)
        assert client.state.paused is server.state.paused is paused


def test_of_two_presses_after_one_another_later_counts() -> None:
    for first, second in (pair(), pair()[::-1]):
        first.change(True)
        hear_all(first, second)
        second.change(False)
        hear_all(first, second)
        assert first.state.paused is second.state.paused is False


steps = st.sampled_from(["client on", "client off", "server on", "server off", "C", "S", "cut"])


@given(st.lists(steps, max_size=40))
@settings(max_examples=settings().max_examples * 2, deadline=None)
def test_a_cut_loses_messages_but_not_the_agreement(taken: list[str]) -> None:
    """After a cut the proposer tells its state, and the other side its own if that is later (PROTOCOL.md, 3)."""
    client, server = pair()
    for step in taken:
        match step.split():
            case ["client", state]:
                client.change(state == "on")
            case ["server", state]:
                server.change(state == "on")
            case ["C"]:
                client.hear()
            case ["S"]:
                server.hear()
            case ["cut"]:
                client.inbox.clear()
                server.inbox.clear()
                client.tell()
                server.hear()
                server.tell()
    hear_all(client, server)
    assert client.state.paused == server.state.paused


def test_a_revision_that_is_absurd_does_no_harm() -> None:
    client, server = pair()
    server.state.merge(paused=True, revision=2**53)
    server.change(False)
    hear_all(client, server)
    client.change(True)
    hear_all(client, server)
    assert client.state.paused is server.state.paused is True
    assert max(client.state.revision, server.state.revision) == 2**53
