"""A side keeps the control messages of a session that the other side has not handled, each once."""

from __future__ import annotations

import pytest
from tests.support.wording import pattern

from rsb_bridge.link.link_session import MOST_KEPT, LinkSession
from rsb_bridge.wire.messages import Lease, Neighbours, Ping, Receipts, Settled
from rsb_bridge.wire.protocol_error import Broken, ProtocolError


def sent(session: LinkSession, count: int) -> list[Settled]:
    messages = [Settled(number) for number in range(1, count + 1)]
    for message in messages:
        session.sends(message)
    return messages


def test_what_the_peer_has_not_handled_is_sent_again() -> None:
    session = LinkSession(bytes(8))
    messages = sent(session, 5)
    session.acknowledge(2)
    assert session.again(3) == tuple(messages[3:])
    session.sends(more := Neighbours(bridges=()))
    assert session.again(3) == (*messages[3:], more)
    assert session.again(6) == ()


def test_what_belongs_to_a_connection_does_not_count() -> None:
    session = LinkSession(bytes(8))
    for message in (Ping(1, 2), Receipts(), Lease(1)):
        session.sends(message)
        session.handles(type(message))
    session.handles(Neighbours)
    assert (session.again(0), session.handled) == ((), 1)


@pytest.mark.parametrize("count", [1, 5])
def test_peer_that_has_handled_what_cannot_be_is_found(count: int) -> None:
    session = LinkSession(bytes(8))
    sent(session, 4)
    session.acknowledge(2)
    assert session.lacks(count) is None
    with pytest.raises(ProtocolError, match=pattern(Broken.HANDLED_WRONG)):
        session.acknowledge(count)
    assert session.lacks(4) == 0
    assert session.lacks(2) == 2


def test_it_is_full_at_its_limit() -> None:
    session = LinkSession(bytes(8))
    sent(session, MOST_KEPT)
    assert not session.full
    session.sends(Settled(1))
    assert session.full
