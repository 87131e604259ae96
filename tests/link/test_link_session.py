"""A side keeps the control messages of a session that the other side has not handled, each once."""

from __future__ import annotations

from types import SimpleNamespace
from typing import TYPE_CHECKING, Any
from unittest.mock import MagicMock

import msgspec
import pytest
from tests.support.wording import pattern

from rsb_bridge.link.link_session import MOST_BYTES, MOST_KEPT, LinkSession
from rsb_bridge.wire.codec import decode, encode
from rsb_bridge.wire.messages import (
    Hello,
    Lease,
    Neighbours,
    Ping,
    Propose,
    Receipts,
    Report,
    Settled,
    TopicList,
    TypeText,
)
from rsb_bridge.wire.protocol_error import Broken, ProtocolError

if TYPE_CHECKING:
    from rsb_bridge.wire.messages import ControlMessageBase


def keep(session: LinkSession, message: ControlMessageBase) -> None:
    session.sends(message, encode(message))


def sent(session: LinkSession, count: int) -> list[Settled]:
    messages = [Settled(number) for number in range(1, count + 1)]
    for message in messages:
        keep(session, message)
    return messages


def session_of() -> LinkSession:
    """Return a session whose channels only note what is proposed again."""
    return LinkSession(bytes(8), "there", MagicMock())


def again(session: LinkSession, count: int) -> tuple[ControlMessageBase, ...]:
    """Return what a peer lacks that has handled so many messages."""
    event: Any = SimpleNamespace(peer=SimpleNamespace(handled=count), keys=None)
    session.take_up(count)
    return tuple(decode(each.content) for each in session.resume(MagicMock(), event))  # type: ignore[misc]


def test_what_the_peer_has_not_handled_is_sent_again() -> None:
    session = session_of()
    messages = sent(session, 5)
    session.acknowledge(2)
    assert again(session, 3) == tuple(messages[3:])
    keep(session, more := Neighbours(bridges=("there",)))
    assert again(session, 3) == (*messages[3:], more)
    assert again(session, 6) == ()


def test_what_belongs_to_a_connection_does_not_count() -> None:
    session = session_of()
    for message in (Ping(1, 2), Receipts(), Lease(1), Report((), ()), TopicList(1, bytes(9)), TypeText(1)):
        keep(session, message)
        session.handles(type(message))
    session.handles(Neighbours)
    assert (again(session, 0), session.handled) == ((), 1)


@pytest.mark.parametrize("count", [1, 5])
def test_peer_that_has_handled_what_cannot_be_is_found(count: int) -> None:
    session = session_of()
    sent(session, 4)
    session.acknowledge(2)
    assert not session.could_have_handled(count)
    with pytest.raises(ProtocolError, match=pattern(Broken.HANDLED_WRONG)):
        session.acknowledge(count)
    assert session.could_have_handled(4)
    assert session.could_have_handled(2)


@pytest.mark.parametrize(
    ("hello", "resumes"),
    [
        ({}, True),
        ({"instance": "another"}, False),
        ({"session": b"another."}, False),
        ({"session": b""}, False),
        ({"handled": 5}, False),
    ],
    ids=str,
)
def test_only_its_process_resumes_it(hello: dict[str, Any], resumes: bool) -> None:
    session = session_of()
    sent(session, 4)
    client = Hello("1", "robot1", "there", 0, session=bytes(8), handled=4)
    assert session.may_resume(msgspec.structs.replace(client, **hello)) is resumes


def test_it_is_over_beyond_its_limit() -> None:
    session = session_of()
    sent(session, MOST_KEPT)
    assert not session.is_over
    keep(session, Settled(1))
    assert session.is_over
    session.acknowledge(MOST_KEPT)
    assert not session.could_have_handled(MOST_KEPT)


def test_bytes_that_wait_are_limited() -> None:
    session = session_of()
    long = Neighbours(bridges=("x" * 250,) * 40)
    size = len(encode(long))
    for _ in range(MOST_BYTES // size):
        keep(session, long)
    assert not session.is_over
    session.acknowledge(2)
    keep(session, long)
    keep(session, long)
    assert not session.is_over, "what was handled takes no room"
    keep(session, long)
    assert session.is_over


@pytest.mark.parametrize("accepted", [False, True])
def test_peer_cannot_lack_proposal_it_accepted(accepted: bool) -> None:
    session = session_of()
    sent(session, 2)
    keep(session, Propose(route=3, topic="/a", remote_topic="/a", from_client=True))
    session.channels.is_accepted = lambda route_id: accepted  # type: ignore[method-assign]
    client = Hello("1", "robot1", "there", 0, session=bytes(8), handled=2)
    assert session.may_resume(client) is not accepted
    assert session.may_resume(msgspec.structs.replace(client, handled=3))
    if accepted:
        with pytest.raises(ProtocolError, match=pattern(Broken.HANDLED_WRONG)):
            session.take_up(2)
    else:
        assert len(again(session, 2)) == 1
