"""Sessions and topics, as a seed has them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec

from rsb_bridge.model.session import Client, Session, Topic

if TYPE_CHECKING:
    from collections.abc import Sequence
    from random import Random

    from rsb_bridge.model.transports import Protocol

PORT = 49_152
SERVER_NAME = "control-pc"
"""Its host name; it may have more than one address."""
SERVER_ADDRESS = "10.0.0.1"


def server_session(clients: Sequence[str], random: Random, *, encrypted: bool, outlive: float) -> Session:
    alone = len(clients) == 1 and random.random() < 0.5
    return Session(
        name=clients[0] if alone else "pc",
        role="server",
        server_ip=random.choice(("0.0.0.0", SERVER_ADDRESS)),
        server_port=PORT,
        domain_id=1,
        use_name=True,
        use_encryption=encrypted,
        outlive=outlive,
        clients=None if alone else tuple(Client(name=each) for each in clients),
    )


def client_session(
    name: str, domain_id: int, topics: tuple[Topic, ...], random: Random, *, encrypted: bool, outlive: float
) -> Session:
    return Session(
        name=name,
        role="client",
        server_ip=random.choice((SERVER_NAME, SERVER_ADDRESS)),
        server_port=PORT,
        domain_id=domain_id,
        use_name=True,
        use_encryption=encrypted,
        outlive=outlive,
        topics=topics,
        allow=("/*",),  # the server's operators add and edit topics of both directions
    )


def kept(topic: Topic, seconds: float) -> Topic:
    """Return a topic that keeps all its messages of some time, if it is over a stream."""
    return topic if topic.protocol == "udp" else msgspec.structs.replace(topic, keep=seconds, max_rate=None)


def some_service(robot: str, number: int, random: Random) -> Topic:
    return Topic(
        topic=f"/service{number}",
        direction=random.choice(("transmit", "receive")),
        kind="service",
        protocol=random.choice(("tcp", None)),
        port=random.choice((None, None, None, 21_000 + number)),
        remote_topic=random.choice((None, None, f"/{robot}/served{number}")),
        compression=random.choice((None, None, "zstd")),
        timeout=random.choice((None, 2.0, 5.0)),
        paused=random.random() < 0.05,
    )


def some_action(robot: str, number: int, random: Random) -> Topic:
    return Topic(
        topic=f"/action{number}",
        direction=random.choice(("transmit", "receive")),
        kind="action",
        remote_topic=random.choice((None, None, f"/{robot}/done{number}")),
        compression=random.choice((None, None, "zstd")),
        timeout=random.choice((None, 5.0)),
    )


def some_topic(robot: str, number: int, random: Random) -> Topic:
    protocols: tuple[Protocol | None, ...] = ("tcp", "tcp", "udp", None)
    return Topic(
        topic=f"/topic{number}",
        direction=random.choice(("transmit", "receive")),
        type="auto",
        protocol=random.choice(protocols),
        port=random.choice((None, None, None, 20_000 + number)),
        qos=random.choice(("auto", "auto", 10)),
        remote_topic=random.choice((None, None, f"/{robot}/elsewhere{number}")),
        compression=random.choice((None, None, "zstd")),
        max_rate=random.choice((None, None, None, 5.0)),
        paused=random.random() < 0.05,
        lazy=True if number % 3 == 1 else None,
    )
