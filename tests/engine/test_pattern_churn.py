"""Topics that come and go by a pattern, for as long as a bridge runs: nothing of them is left but their history."""

from __future__ import annotations

import gc
import time
from collections import Counter
from typing import TYPE_CHECKING, Any

from tests.engine.churn_helpers import Publisher, Subscription
from tests.support import constants
from tests.support.inside import inside
from tests.support.ports import free_port
from tests.support.waiting import eventually

from rsb_bridge.config.keys import write_key
from rsb_bridge.engine import Engine
from rsb_bridge.model.qos import Qos
from rsb_bridge.model.session import Client, Session, Topic
from rsb_bridge.ros.no_ros import NoRos
from rsb_bridge.ros.ros_interface import Endpoint, RawMessage, TopicSpec

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    import pytest

TYPE, HASH = "std_msgs/msg/String", "RIHS01_" + "1" * 64
TOPICS = 20
"""At a time; a pattern may bridge 100."""
KEPT = {"TrackRecord", "MinuteSeries", "Ended", "_Open", "Event", "Sought"}
"""History, events, and answers of searches have limits of their own (docs/budgets.md). Topics that wait for their
publisher for long, as on a busy machine, are searched for."""


class Ros(NoRos):
    """A graph whose topics come and go."""

    def __init__(self, instance_id: str) -> None:
        self.instance_id, self.node_name = instance_id, f"rsb_churn_{instance_id}"
        self.present: dict[str, bytes] = {}
        self.subscribed: dict[str, Subscription] = {}
        self.published: list[bytes] = []
        self.changed: Callable[[], None] = lambda: None
        self._made = 0

    def watch(self, on_graph_change: Callable[[], None], _: Callable[[str], None]) -> None:
        self.changed = on_graph_change

    def topics(self) -> dict[str, list[str]]:
        return {topic: [TYPE] for topic in tuple(self.present)}

    def publishers(self, topic: str) -> list[Endpoint]:
        gid = self.present.get(topic)
        return [Endpoint("/talker", TYPE, HASH, Qos(), gid)] if gid else []

    def subscribe(self, spec: TopicSpec, sink: Any, *_: Any, **__: Any) -> Any:
        made = self.subscribed[spec.topic] = Subscription(sink)
        return made

    def advertise(self, spec: TopicSpec, *_: Any) -> Any:
        self._made += 1
        taken = [] if spec.topic.startswith("/_") else self.published
        return Publisher(b"%016d" % self._made, taken)


def counts() -> Counter[str]:
    gc.collect()
    kinds = (type(each) for each in gc.get_objects())
    return Counter(kind.__qualname__ for kind in kinds if str(kind.__module__).startswith("rsb_bridge."))


def test_topics_of_patterns_leave_nothing_behind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    constants.NAMES_GONE_AFTER.set(monkeypatch, 0.05)
    write_key(tmp_path / "k.key")
    common: dict[str, Any] = {"server_ip": "127.0.0.1", "server_port": free_port(), "shutdown_topic": None}
    here, there = Ros("00000001"), Ros("00000002")
    server_session = Session(name="pc", role="server", domain_id=1, clients=(Client("robot", "k.key"),), **common)
    client_session = Session(
        name="robot", role="client", domain_id=2, key_file="k.key", topics=(Topic("/dyn/*", "transmit"),), **common
    )
    engines = Engine(server_session, base=tmp_path, ros=there), Engine(client_session, base=tmp_path, ros=here)

    def seen(condition: Callable[[], bool]) -> bool:
        here.changed()
        return condition()

    def come_and_go(turn: int) -> None:
        names = [f"/dyn/topic_{turn}_{number}" for number in range(TOPICS)]
        for number, name in enumerate(names):
            here.present[name] = b"%08d%08d" % (turn, number)
        eventually(lambda: seen(lambda: here.subscribed.keys() >= set(names)))
        for name in names:
            here.subscribed[name].sink([RawMessage(bytes(100), time.time_ns(), here.present[name], 1)])
        eventually(lambda: len(there.published) == TOPICS)
        here.present.clear()
        eventually(lambda: seen(lambda: not any(engine.snapshot().routes for engine in engines)))
        for name in names:
            del here.subscribed[name]
        there.published.clear()

    try:
        for engine in engines:
            engine.start()
        for turn in range(2):
            come_and_go(turn)
        before = counts()
        for turn in range(2, 4):
            come_and_go(turn)

        def grown() -> dict[str, int]:
            return {kind: more for kind, more in (counts() - before).items() if more > TOPICS // 2 and kind not in KEPT}

        eventually(lambda: not grown(), what="what grows goes again")
        bridge = inside(engines[1])
        (link,) = bridge.role.links()
        # Plain values are not among the objects that are counted.
        tables = link.patterns.names, bridge._names
        eventually(lambda: seen(lambda: not any(each._known for each in tables)), what="names are gone")
    except AssertionError as error:
        raise AssertionError(f"{error}: {counts() - before}") from None
    finally:
        for engine in engines:
            engine.stop()
