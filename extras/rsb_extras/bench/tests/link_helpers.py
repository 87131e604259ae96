"""Helpers of `test_link` and others."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import msgspec
import pytest
from tests.support.ports import free_port
from tests.support.waiting import eventually

from rsb_bridge.api import EngineError
from rsb_bridge.config.keys import write_key
from rsb_bridge.engine import Engine
from rsb_bridge.model.session import Client, Session
from rsb_bridge.model.snapshot import State
from rsb_bridge.ros.no_ros import NoRos
from rsb_extras.bench import LIMITS, BenchmarkLimits
from rsb_extras.bench.benchmark import Bench, BenchmarkStep

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from rsb_bridge.ros.ros_interface import TopicSpec
    from rsb_extras.bench.benchmark import Outcome


LEAVE = BenchmarkLimits(seconds=60.0, max_rate=5_000.0, megabytes=50.0)


WITHIN = 180.0


class Endpoint:
    gid = b"0123456789abcdef"
    lost = subscriber_count = 0
    acknowledged = True

    def publish(self, payload: bytes) -> None:
        pass

    def close(self) -> None:
        pass


class QuietRos(NoRos):
    """Takes the bridge's own announcements, and nothing comes of them."""

    def __init__(self, instance_id: str = NoRos.instance_id) -> None:
        self.instance_id = instance_id
        self.node_name = f"rsb_quiet_{instance_id}"

    def subscribe(self, spec: TopicSpec, *_: object, **__: object) -> Any:
        assert "bench" not in spec.topic, "DDS hears of it"
        return Endpoint()

    advertise = subscribe


@pytest.fixture
def linked(tmp_path: Path) -> Iterator[Callable[..., list[Engine]]]:
    """Makes engines of sessions, and waits until all links are up."""
    started: list[Engine] = []

    def make(*sessions: Session) -> list[Engine]:
        common = {"server_ip": "127.0.0.1", "server_port": free_port(), "shutdown_topic": None}
        for number, each in enumerate(sessions):
            session = msgspec.structs.replace(each, domain_id=number, **common)
            started.append(Engine(session, base=tmp_path, ros=QuietRos(f"{number:08x}")))
            started[-1].start()
        eventually(lambda: all(link.state is State.OK for each in started for link in each.snapshot().links), WITHIN)
        return started

    yield make
    for engine in started:
        engine.stop()


class Pair:
    def __init__(self, server: Engine, client: Engine) -> None:
        self.server = server
        self.client = client

    def run(self, engine: Engine, **order: Any) -> Outcome:
        wanted = {"transport": "tcp", "size": 2500, "rate": 200.0, "count": 40, **order}
        return engine.do(Bench(BenchmarkStep(**wanted))).result(WITHIN)

    def refused(self, engine: Engine, **order: Any) -> str:
        with pytest.raises(EngineError) as refused:
            self.run(engine, **order)
        return str(refused.value)

    def topics(self) -> list[str]:
        return [route.topic for engine in (self.server, self.client) for route in engine.snapshot().routes]


@pytest.fixture
def pair(tmp_path: Path, linked: Callable[..., list[Engine]]) -> Callable[..., Pair]:
    """Makes a linked pair; what each gives the other leave for."""

    def make(to_client: BenchmarkLimits | None = None, to_server: BenchmarkLimits | None = None) -> Pair:
        write_key(tmp_path / "k.key")
        clients = (Client("robot1", "k.key", features={LIMITS.name: to_client}),)
        server = Session(name="pc", role="server", server_ip="", use_name=True, clients=clients)
        leave = {LIMITS.name: to_server}
        client = Session(name="robot1", role="client", server_ip="", key_file="k.key", features=leave)
        return Pair(*linked(server, client))

    return make
