"""Helpers of `test_loops` and others."""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING, Any, NamedTuple

import pytest
from tests.support.bridge import linked
from tests.support.domain import Domain
from tests.support.ports import free_port
from tests.support.waiting import eventually

from rsb_bridge.model.session import Topic

if TYPE_CHECKING:
    from collections.abc import Iterator
    from typing import Literal

    from tests.support.bridge import Bridge

    from rsb_bridge.engine import Engine


CHAT = "/chat"


DEEP = 1000  # messages kept: none is lost in a burst


_names = (f"robot{number}" for number in itertools.count(1))


@pytest.fixture
def robot(_domains: int) -> Iterator[Domain]:
    """Its node is new: here and there one that has seen many engines come and go is not discovered by the next."""
    yield from new_domain(_domains)


def new_domain(domain_id: int) -> Iterator[Domain]:
    domain = Domain(domain_id)
    yield domain
    domain.close()


class Pair(NamedTuple):
    """A bridge: two engines, linked."""

    server: Engine
    client: Engine


def connect(
    bridge: Bridge, here: Domain, there: Domain, *directions: Literal["transmit", "receive"], qos: Any = DEEP
) -> Pair:
    """A bridge of the chat: `transmit` is from here to there."""
    name = next(_names)
    changes: dict[str, Any] = {"name": name, "server_port": free_port()}
    topics = [Topic(CHAT, direction, qos=qos) for direction in directions]
    server = bridge.start(bridge.server_session(domain_id=there.id, **changes))
    client = bridge.start(bridge.client_session(*topics, domain_id=here.id, **changes))
    eventually(lambda: linked(client, name) and linked(server, name), what="linked")
    return Pair(server, client)
