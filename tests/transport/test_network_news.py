"""News of this machine's network, from a real kernel in namespaces of their own, and from a socket in its place."""

from __future__ import annotations

import asyncio
import errno
import socket
from typing import TYPE_CHECKING

import pytest
from tests.support import replaced
from tests.support.addresses import foreign_address
from tests.support.coroutines import until

from rsb_bridge.transport.network_news import NetworkNews, device_of, news_of_kernel, open_news
from rsb_bridge.transport.tcp import Tcp

if TYPE_CHECKING:
    from collections.abc import Iterator


@pytest.fixture
def kernel(monkeypatch: pytest.MonkeyPatch) -> Iterator[socket.socket]:
    """The end of a socket on which a test tells changes in the kernel's place."""
    telling, told = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    told.setblocking(False)
    replaced.OPEN_NEWS.set(monkeypatch, lambda: told)
    with telling:
        yield telling


async def test_changes_of_a_moment_are_told_once(kernel: socket.socket) -> None:
    told: list[float] = []
    news = NetworkNews(lambda: told.append(asyncio.get_running_loop().time()))
    for _ in range(8):
        kernel.send(b"changed")
    await until(lambda: told)
    kernel.send(b"changed")
    await until(lambda: len(told) > 1)
    assert len(told) == 2
    assert told[1] - told[0] >= 0.04  # at most so often in a storm of changes
    news.close()


async def test_closed_news_tell_nothing(kernel: socket.socket) -> None:
    told: list[object] = []
    asyncio.get_running_loop().set_exception_handler(lambda _, context: told.append(context))
    news = NetworkNews(lambda: told.append(True))
    kernel.send(b"changed")
    for _ in range(3):  # it has begun to wait for further changes
        await asyncio.sleep(0)
    news.close()
    await asyncio.sleep(0.1)
    assert not told


async def test_refused_socket_is_no_news(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse() -> socket.socket:
        raise OSError(errno.EAFNOSUPPORT, "Address family not supported by protocol")

    replaced.OPEN_NEWS.set(monkeypatch, refuse)
    assert news_of_kernel(lambda: None) is None
    assert Tcp().network_news(lambda: None) is None


async def test_addresses_lead_to_their_devices() -> None:
    foreign = foreign_address()
    assert device_of("127.0.0.1") == "lo"
    assert not device_of(foreign)
    open_news().close()  # this machine lets us have them
    news = Tcp().network_news(lambda: None)
    assert news is not None
    assert not news.why_silent("127.0.0.1")
    assert not news.why_silent("23772509d18c9f91")  # of an endpoint of Zenoh's
    assert news.why_silent(foreign) == f"{foreign} is no address of this machine any more"
    news.close()
