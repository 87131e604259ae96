"""A link moves to a better way while its old connection still carries: its association goes on."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING
from unittest.mock import patch

import msgspec
import pytest
from tests.simulation.beds import until
from tests.simulation.sessions import SERVER_ADDRESS, SERVER_NAME

from rsb_bridge.link.link_server import Server
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.session import Topic
from rsb_bridge.wire.messages import Neighbours

if TYPE_CHECKING:
    from tests.simulation.beds import Yard

    from rsb_bridge.wire.messages import Hello, Welcome

_SLOW = 3.0  # s that the better way's first answer takes, in which the server pings on the old one


@pytest.fixture
def two_ways(yard: Yard) -> Yard:
    """Return a yard whose robot knows a better way to the server, which does not answer yet."""
    yard.robot.session = msgspec.structs.replace(yard.robot.session, server_ip=(SERVER_NAME, SERVER_ADDRESS))
    yard.world.network.names[SERVER_NAME] = None
    return yard


@pytest.mark.parametrize("is_lost", [False, True])
@pytest.mark.bed(Topic("/chat", "transmit"), outlive=60.0)
async def test_what_the_old_connection_acknowledges_ends_nothing(yard: Yard, two_ways: Yard, is_lost: bool) -> None:
    """The server answers on the better way, then handles one more message, and says so on the old one first.

    The old one may be lost before the answer comes.
    """
    yard.publish("/chat")
    link, far = yard.link(), yard.link(on_server=True)
    path = yard.world.network.path(yard.server.machine, yard.robot.machine)
    answers: list[Welcome] = []
    welcome = Server._welcome

    def answer(server: Server, hello: Hello) -> Welcome:
        if not answers:
            quick, path.latency = path.latency, (_SLOW, _SLOW)
            yard.world.loop.call_later(0.01, lambda: setattr(path, "latency", quick))
            link.send(Neighbours(bridges=("another",)))
        answers.append(welcome(server, hello))
        return answers[-1]

    await until(lambda: link.linked, 30.0)
    assert link.association is not None
    association = link.association.id
    with patch.object(Server, "_welcome", answer):
        yard.world.network.names[SERVER_NAME] = [SERVER_ADDRESS]
        await until(lambda: answers, 60.0)
        if is_lost:
            await asyncio.sleep(_SLOW / 2)
            link.channels.control.abort("reset")
        await until(lambda: link.connections > 1, 60.0)
    await asyncio.sleep(10.0)
    assert link.association is not None
    assert link.association.id == association
    assert answers[0].handled < answers[1].handled
    assert (link.connections, far.connections) == (2, 2)
    assert EventCode.ENGINE_ERROR not in {*yard.codes(), *yard.codes(on_server=True)}


@pytest.mark.bed(Topic("/chat", "transmit"), outlive=60.0)
async def test_what_the_old_connection_still_brings_ends_nothing(yard: Yard, two_ways: Yard) -> None:
    """A message of the client overtakes its confirmation, so the server has handled more than its answer says."""
    yard.publish("/chat")
    link, far = yard.link(), yard.link(on_server=True)
    path = yard.world.network.path(yard.robot.machine, yard.server.machine)
    answers: list[Welcome] = []
    welcome = Server._welcome

    def answer(server: Server, hello: Hello) -> Welcome:
        if not answers:
            link.send(Neighbours(bridges=("another",)))
            quick, path.latency = path.latency, (_SLOW, _SLOW)
            yard.world.loop.call_later(0.1, lambda: setattr(path, "latency", quick))
        answers.append(welcome(server, hello))
        return answers[-1]

    await until(lambda: link.linked, 30.0)
    assert link.association is not None
    association = link.association.id
    with patch.object(Server, "_welcome", answer):
        yard.world.network.names[SERVER_NAME] = [SERVER_ADDRESS]
        await until(lambda: len(answers) > 1 and link.linked and far.linked, 60.0)
    assert answers[0].handled < answers[1].handled
    assert link.association is not None
    assert (link.association.id, answers[1].association) == (association, association)
    assert EventCode.ENGINE_ERROR not in {*yard.codes(), *yard.codes(on_server=True)}
