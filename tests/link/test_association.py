"""A side keeps the control messages of an association that the other side has not handled, each once."""

from __future__ import annotations

from types import SimpleNamespace
from typing import TYPE_CHECKING, Any
from unittest.mock import MagicMock

import msgspec
import pytest
from tests.support.wording import pattern

from rsb_bridge.link.association import MOST_BYTES, MOST_KEPT, Association
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


def keep(association: Association, message: ControlMessageBase) -> None:
    association.sends(message, encode(message))


def sent(association: Association, count: int) -> list[Settled]:
    messages = [Settled(number) for number in range(1, count + 1)]
    for message in messages:
        keep(association, message)
    return messages


def association_of() -> Association:
    """Return an association whose channels only note what is proposed again."""
    return Association(bytes(8), "there", MagicMock())


def again(association: Association, count: int) -> tuple[ControlMessageBase, ...]:
    """Return what a peer lacks that has handled so many messages."""
    event: Any = SimpleNamespace(peer=SimpleNamespace(handled=count), keys=None)
    association.take_up(count)
    return tuple(decode(each.content) for each in association.resume(MagicMock(), event))


def test_what_the_peer_has_not_handled_is_sent_again() -> None:
    association = association_of()
    messages = sent(association, 5)
    association.acknowledge(2)
    assert again(association, 3) == tuple(messages[3:])
    keep(association, more := Neighbours(bridges=("there",)))
    assert again(association, 3) == (*messages[3:], more)
    assert again(association, 6) == ()


def test_messages_sent_while_it_resumes_are_sent_again() -> None:
    association = association_of()
    association.channels.resume = lambda *_: keep(association, Settled(9))  # type: ignore[method-assign]
    assert again(association, 0) == (Settled(9),)


def test_what_belongs_to_a_connection_does_not_count() -> None:
    association = association_of()
    for message in (Ping(1, 2), Receipts(), Lease(1), Report((), ()), TopicList(1, bytes(9)), TypeText(1)):
        keep(association, message)
        association.handles(type(message))
    association.handles(Neighbours)
    assert (again(association, 0), association.handled) == ((), 1)


@pytest.mark.parametrize("count", [1, 5])
def test_peer_that_has_handled_what_cannot_be_is_found(count: int) -> None:
    association = association_of()
    sent(association, 4)
    association.acknowledge(2)
    assert not association.could_have_handled(count)
    with pytest.raises(ProtocolError, match=pattern(Broken.HANDLED_WRONG)):
        association.acknowledge(count)
    assert association.could_have_handled(4)
    assert association.could_have_handled(2)


@pytest.mark.parametrize(
    ("hello", "resumes"),
    [
        ({}, True),
        ({"instance": "another"}, False),
        ({"association": b"another."}, False),
        ({"association": b""}, False),
        ({"handled": 5}, False),
    ],
    ids=str,
)
def test_only_its_process_resumes_it(hello: dict[str, Any], resumes: bool) -> None:
    association = association_of()
    sent(association, 4)
    client = Hello("1", "robot1", "there", 0, association=bytes(8), handled=4)
    assert association.may_resume(msgspec.structs.replace(client, **hello)) is resumes


def test_it_is_over_beyond_its_limit() -> None:
    association = association_of()
    sent(association, MOST_KEPT)
    assert not association.is_over
    keep(association, Settled(1))
    assert association.is_over
    association.acknowledge(MOST_KEPT)
    assert not association.could_have_handled(MOST_KEPT)


def test_bytes_that_wait_are_limited() -> None:
    association = association_of()
    long = Neighbours(bridges=("x" * 250,) * 40)
    size = len(encode(long))
    for _ in range(MOST_BYTES // size):
        keep(association, long)
    assert not association.is_over
    association.acknowledge(2)
    keep(association, long)
    keep(association, long)
    assert not association.is_over, "what was handled takes no room"
    keep(association, long)
    assert association.is_over


@pytest.mark.parametrize("accepted", [False, True])
def test_peer_cannot_lack_proposal_it_accepted(accepted: bool) -> None:
    association = association_of()
    sent(association, 2)
    keep(association, Propose(route=3, topic="/a", remote_topic="/a", from_client=True))
    association.channels.is_accepted = lambda route_id: accepted  # type: ignore[method-assign]
    client = Hello("1", "robot1", "there", 0, association=bytes(8), handled=2)
    assert association.may_resume(client) is not accepted
    assert association.may_resume(msgspec.structs.replace(client, handled=3))
    if accepted:
        with pytest.raises(ProtocolError, match=pattern(Broken.HANDLED_WRONG)):
            association.take_up(2)
    else:
        assert len(again(association, 2)) == 1
