"""Demands to be armed belong to names, between two real domains, whose nodes count the messages that cross."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import msgspec
import pytest
from tests.support.bridge import happened, linked, now, route
from tests.support.domain import text
from tests.support.long import long_cases
from tests.support.waiting import eventually, holds

from rsb_bridge.api import EngineError
from rsb_bridge.config.session_file import load, save
from rsb_bridge.model.codes import EventCode
from rsb_bridge.model.demands import PEER_DEMANDS
from rsb_bridge.model.session import ArmedName, Client, Topic
from rsb_bridge.model.snapshot import Reloaded

if TYPE_CHECKING:
    from collections.abc import Callable

    from rclpy.publisher import Publisher
    from tests.support.bridge import Bridge
    from tests.support.domain import Domain, Listener

    from rsb_bridge.engine import Engine
    from rsb_bridge.model.session import Kind

COMMANDS = Topic("/cmd_vel", "receive", arm=True, deadman=0.0)
FREE = Topic("/free", "receive")
DEMANDING: dict[str, tuple[tuple[Topic, ...], tuple[str, ...]]] = {
    "by name": ((Topic("/cmd_vel", "receive", arm=True),), ()),
    "pattern": ((Topic("/cmd_*", "receive", arm=True),), ()),
    "armed": ((), ("/cmd_vel",)),
}
"""Entries, and what `armed` has, of a session that demands /cmd_vel."""


class Yard:
    """Publishers and listeners of topics at the ends of a bridge."""

    def __init__(self, robot: Domain, pc: Domain) -> None:
        self._robot, self._pc = robot, pc
        self._out: list[Publisher] = []
        self.heard: dict[str, Listener] = {}

    def add(self, name: str) -> None:
        self._out.append(self._pc.publisher(name))
        self.heard[name] = self._robot.listener(name)

    def publish(self) -> None:
        for out in self._out:
            out.publish(text("go"))

    def crossed(self) -> set[str]:
        """The topics of which a message has crossed."""
        return {name for name, listener in self.heard.items() if listener.payloads}

    def publish_until(self, crossed: set[str]) -> None:
        def have() -> bool:
            self.publish()
            return crossed <= self.crossed()

        eventually(have)

    def clear(self) -> None:
        for listener in self.heard.values():
            listener.payloads.clear()


@pytest.fixture
def yard(robot: Domain, pc: Domain) -> Yard:
    return Yard(robot, pc)


def required(engine: Engine, name: str) -> bool:
    found = [each for each in now(engine).routes if each.topic == name and each.link == "robot1"]
    return bool(found) and all(each.arming is not None for each in found)


def set_up(engines: tuple[Engine, Engine], name: str) -> bool:
    """Whether a name's routes are open, and have to be armed, on both sides."""
    of_name = [each for engine in engines for each in now(engine).routes if each.topic == name]
    states = {each.state for each in of_name if each.link == "robot1"}
    return states == {"disarmed"} and all(required(each, name) for each in engines)


def by_server(bridge: Bridge, yard: Yard, *entries: Topic, **changes: Any) -> tuple[Engine, Engine]:
    """A server whose session demands, and a robot that lists /cmd_vel, and /free, by itself."""
    yard.add("/cmd_vel")
    yard.add("/free")
    server = bridge.server(clients=(Client("robot1", topics=entries),), **changes)
    client = bridge.client(msgspec.structs.replace(COMMANDS, arm=False, deadman=None), FREE)
    eventually(lambda: linked(client) and linked(server))
    eventually(lambda: set_up((server, client), "/cmd_vel"))
    return server, client


def stays_demanded(yard: Yard, server: Engine, client: Engine) -> None:
    yard.clear()
    yard.publish_until({"/free"})

    def nothing() -> bool:
        yard.publish()
        return yard.crossed() <= {"/free"}

    holds(nothing, 1.0)
    assert happened(server, EventCode.OPERATOR_ARM_DROPPED) is None
    assert happened(client, EventCode.OPERATOR_ARM_DROPPED) is None


def edited(server: Engine, client: Engine) -> None:
    found = route(server, "/cmd_vel")
    with pytest.raises(EngineError, match="drop-arm"):
        server.edit_topic(found.key, msgspec.structs.replace(found.spec, arm=False, deadman=None)).result(60)
    server.edit_topic(found.key, msgspec.structs.replace(found.spec, compression="zstd")).result(60)


def removed(server: Engine, client: Engine) -> None:
    assert server.remove_topic(route(server, "/cmd_vel").key).result(60), "it says that its demand stays"
    client.restart().result(60)
    client.add_topic(Topic("/cmd_vel", "receive")).result(60)


def removed_there(server: Engine, client: Engine) -> None:
    client.remove_topic(route(client, "/cmd_vel").key).result(60)
    eventually(lambda: not any(each.topic == "/cmd_vel" for each in now(server).routes))
    client.add_topic(Topic("/cmd_vel", "receive")).result(60)


CHANGES = (edited, removed, removed_there)


@pytest.mark.parametrize("change", CHANGES, ids=lambda each: each.__name__)
def test_change_that_does_not_name_demand_keeps_it(
    change: Callable[[Engine, Engine], None], bridge: Bridge, yard: Yard
) -> None:
    server, client = by_server(bridge, yard, COMMANDS)
    change(server, client)
    eventually(lambda: set_up((server, client), "/cmd_vel"))
    stays_demanded(yard, server, client)
    kept = [each for each in server.session.armed if "/cmd_vel" in str(each)]
    still = [each for each in server.session.accepted_clients[0].topics if each.arm]
    assert kept or still
    assert all(not isinstance(each, ArmedName) or each.deadman == 0.0 for each in kept)


def test_narrowed_or_removed_pattern_leaves_demand(bridge: Bridge, yard: Yard) -> None:
    pattern = Topic("/cmd*", "transmit", arm=True)
    server, client = by_server(bridge, yard, pattern)
    (shown,) = [each for link in now(server).links for each in link.patterns]
    for excepts in (("/cmd_vel",), ("/cmd_*",)):
        spec = msgspec.structs.replace(pattern, excepts=excepts)
        server.edit_topic(shown.key, spec).result(60)
        assert any("/cmd*" in str(each) for each in server.session.armed)
    stays_demanded(yard, server, client)
    server.remove_topic(shown.key).result(60)
    stays_demanded(yard, server, client)
    assert any("/cmd*" in str(each) for each in server.session.armed)


def test_demand_is_dropped_only_by_agreed_edit(bridge: Bridge, yard: Yard) -> None:
    server, client = by_server(bridge, yard, COMMANDS)
    key = route(server, "/cmd_vel").key
    plain = Topic("/cmd_vel", "receive")
    server.edit_topic(key, plain, drop_arm=True).result(60)
    yard.publish_until({"/cmd_vel", "/free"})
    assert server.session.armed == ()
    assert not any(each.arm for each in server.session.listed_clients[0].topics)
    here = eventually(lambda: happened(server, EventCode.OPERATOR_ARM_DROPPED))
    there = eventually(lambda: happened(client, EventCode.OPERATOR_ARM_DROPPED))
    assert (here.topic, here.from_peer, there.topic, there.from_peer) == ("/cmd_vel", False, "/cmd_vel", True)


def test_edit_that_names_demand_needs_agreement(bridge: Bridge, yard: Yard) -> None:
    yard.add("/cmd_vel")
    server, client = bridge.both(COMMANDS)
    eventually(lambda: set_up((server, client), "/cmd_vel"))
    key, plain = route(client, "/cmd_vel").key, Topic("/cmd_vel", "receive")
    with pytest.raises(EngineError, match="drop-arm"):
        client.edit_topic(key, plain).result(60)
    with pytest.raises(EngineError, match="arm=false"):
        client.edit_topic(key, msgspec.structs.replace(COMMANDS, max_rate=5.0), drop_arm=True).result(60)
    assert not happened(server, EventCode.OPERATOR_ARM_DROPPED)
    there = route(server, "/cmd_vel")
    with pytest.raises(EngineError, match=PEER_DEMANDS):
        server.edit_topic(
            there.key, msgspec.structs.replace(there.spec, arm=False, deadman=None), drop_arm=True
        ).result(60)
    assert required(client, "/cmd_vel")
    client.edit_topic(key, plain, drop_arm=True).result(60)
    yard.publish_until({"/cmd_vel"})


def test_refused_edit_drops_nothing_and_tells_nobody(bridge: Bridge, yard: Yard) -> None:
    """The other side read that the demand was dropped, though the edit had failed."""
    pattern, other = Topic("/arm*", "receive", arm=True), Topic("/leg*", "receive")
    yard.add("/cmd_vel")
    server, client = bridge.both(COMMANDS, FREE, pattern, other)
    eventually(lambda: set_up((server, client), "/cmd_vel"))
    shown = next(each for link in now(client).links for each in link.patterns if each.spec.topic == "/arm*")
    refused = (
        (route(client, "/cmd_vel").key, FREE),
        (route(client, "/cmd_vel").key, Topic("/cmd_vel", "receive", max_rate=-1.0)),
        (shown.key, other),
    )
    for key, topic in refused:
        with pytest.raises(EngineError):
            client.edit_topic(key, topic, drop_arm=True).result(60)
    client.edit_topic(route(client, "/free").key, msgspec.structs.replace(FREE, max_rate=5.0)).result(60)
    eventually(lambda: happened(server, EventCode.OPERATOR_EDITED))  # comes after everything sent before
    for engine in (server, client):
        assert happened(engine, EventCode.OPERATOR_ARM_DROPPED) is None
    assert required(client, "/cmd_vel")
    assert client.session.armed == ()
    assert [each.topic for each in client.session.topics if each.arm] == ["/cmd_vel", "/arm*"]


def test_line_that_limits_age_has_no_demand(bridge: Bridge, yard: Yard) -> None:
    yard.add("/cmd_vel")
    limited = Topic("/cmd_vel", "receive", max_age=5.0)
    server, client = bridge.server(armed=("/cmd_vel",)), bridge.client(limited)
    eventually(lambda: set_up((server, client), "/cmd_vel"))
    with pytest.raises(EngineError, match=PEER_DEMANDS):
        client.edit_topic(route(client, "/cmd_vel").key, Topic("/cmd_vel", "receive"), drop_arm=True).result(60)
    assert required(client, "/cmd_vel")


def test_demand_of_another_line_is_not_dropped(bridge: Bridge, yard: Yard) -> None:
    server, client = by_server(bridge, yard, COMMANDS, Topic("/cmd*", "transmit", arm=True))
    with pytest.raises(EngineError, match=r"/cmd\*"):
        server.edit_topic(route(server, "/cmd_vel").key, Topic("/cmd_vel", "receive"), drop_arm=True).result(60)
    assert server.session.armed == ()
    stays_demanded(yard, server, client)


def test_adding_a_demand_closes_what_is_open(bridge: Bridge, yard: Yard) -> None:
    yard.add("/cmd_vel")
    yard.add("/free")
    server, client = bridge.both(Topic("/cmd_vel", "receive"), FREE)
    yard.publish_until({"/cmd_vel", "/free"})
    server.add_topic(Topic("/cmd*", "transmit", arm=True)).result(60)
    eventually(lambda: set_up((server, client), "/cmd_vel"))
    stays_demanded(yard, server, client)


@pytest.mark.parametrize(
    ("side", "way"),
    [("client", "by name"), ("server", "pattern"), ("server", "armed"), *long_cases(("client", "armed"))],
)
def test_reload_drops_demand_only_if_operator_agrees(side: str, way: str, bridge: Bridge, yard: Yard) -> None:
    """The file demands nothing any more, and neither it nor a restart of the links ends a demand."""
    yard.add("/cmd_vel")
    yard.add("/free")
    plain = Topic("/cmd_vel", "receive")
    entries, armed = DEMANDING[way]
    clients = (Client("robot1"),)
    if side == "client":
        server, engine = bridge.server(clients=clients), bridge.client(FREE, *(entries or (plain,)), armed=armed)
        client, without = engine, bridge.client_session(FREE, plain)
    else:
        engine = server = bridge.server(clients=(Client("robot1", topics=entries),), armed=armed)
        client, without = bridge.client(FREE, plain), bridge.server_session(clients=clients)
    eventually(lambda: set_up((server, client), "/cmd_vel"))
    path = bridge.folder / "without.yaml"
    save(without, path)
    engine.use_file(path)

    would = engine.reload(dry_run=True).result(30)
    assert any("/cmd_" in each and "--drop-arm" in each for each in would.changed)
    assert engine.reload().result(60) == would
    engine.restart().result(60)
    eventually(lambda: set_up((server, client), "/cmd_vel"))
    stays_demanded(yard, server, client)
    assert any("/cmd_" in str(each) for each in engine.session.armed)

    would = engine.reload(dry_run=True, drop_arm=True).result(30)
    assert happened(engine, EventCode.OPERATOR_ARM_DROPPED) is None
    assert engine.reload(drop_arm=True).result(60) == would
    yard.publish_until({"/cmd_vel", "/free"})
    for each in (server, client):
        eventually(lambda each=each: happened(each, EventCode.OPERATOR_ARM_DROPPED))
    assert engine.session == without
    assert engine.reload(dry_run=True).result(30) == Reloaded()


def test_saved_session_demands_what_its_removed_entry_did(bridge: Bridge, yard: Yard) -> None:
    server, client = by_server(bridge, yard, COMMANDS)
    server.remove_topic(route(server, "/cmd_vel").key).result(60)
    path = bridge.folder / "saved.yaml"
    save(server.session, path)
    server.stop()
    again = bridge.start(load(path))
    assert again.session.armed == (ArmedName("/cmd_vel", "topic", client="robot1", deadman=0.0),)
    client.add_topic(Topic("/cmd_vel", "receive")).result(60)
    eventually(lambda: linked(client) and linked(again))
    eventually(lambda: set_up((again, client), "/cmd_vel"))
    stays_demanded(yard, again, client)


def test_server_removes_client_and_keeps_what_it_demands(bridge: Bridge, yard: Yard) -> None:
    bridge.make_key("robot2")
    clients = (Client("robot1"), Client("robot2", key_file="robot2.key", topics=(COMMANDS,)))
    yard.add("/cmd_vel")
    server = bridge.server(clients=clients)
    client = bridge.client(Topic("/cmd_vel", "receive"))
    eventually(lambda: set_up((server, client), "/cmd_vel"))
    server.remove_client("robot2").result(60)
    assert server.session.armed == (ArmedName("/cmd_vel", "topic", client="robot2", deadman=0.0),)
    assert set_up((server, client), "/cmd_vel")


def test_the_lines_are_named_on_both_sides(bridge: Bridge, yard: Yard) -> None:
    server_file, client_file = bridge.folder / "pc.yaml", bridge.folder / "robot.yaml"
    server, client = by_server(bridge, yard, Topic("/cmd*", "transmit", arm=True))
    for engine, path in ((server, server_file), (client, client_file)):
        save(engine.session, path)
        engine.use_file(path)
    (line,) = [at for at, each in enumerate(server_file.read_text().splitlines(), 1) if "/cmd*" in each]

    def lines(engine: Engine) -> tuple[str, ...]:
        arming = route(engine, "/cmd_vel").arming
        return () if arming is None else arming.demanded_by

    eventually(lambda: lines(server) == (f"pattern /cmd* in pc.yaml:{line}",))
    assert lines(client) == (PEER_DEMANDS,)


def test_pattern_bridged_by_peer_keeps_no_demand(bridge: Bridge, yard: Yard) -> None:
    """A kept name would stay demanded once an operator drops the pattern's demand, though nobody has asked for that."""
    server = bridge.server(clients=(Client("robot1", topics=(Topic("/cmd*", "receive", arm=True),)),))
    client = bridge.client(Topic("/motor", "receive", remote_topic="/cmd_vel"))
    eventually(lambda: linked(client) and linked(server))
    eventually(lambda: required(server, "/cmd_vel") and required(client, "/motor"))
    yard.add("/cmd_vel")
    eventually(lambda: route(server, "/cmd_vel").publishers)
    holds(lambda: server.session.armed == (), 2.0)


def test_second_route_of_name_has_demand_too(bridge: Bridge, robot: Domain, pc: Domain) -> None:
    """The server lists what the robot publishes under the name."""
    motors, other = robot.listener("/cmd_vel"), pc.listener("/other")
    out = [pc.publisher("/cmd_vel"), robot.publisher("/cmd_vel")]
    server = bridge.server(clients=(Client("robot1", topics=(Topic("/cmd_vel", "transmit", remote_topic="/other"),)),))
    client = bridge.client(COMMANDS)

    def both_wait() -> bool:
        routes = [each for each in now(client).routes if each.topic == "/cmd_vel"]
        return len(routes) == 2 and all(each.state == "disarmed" for each in routes)

    eventually(both_wait)
    for engine, names in ((client, ("/cmd_vel",)), (server, ("/cmd_vel", "/other"))):
        for name in names:  # each side judges by its own clock
            eventually(partial(required, engine, name), what=name)

    def nothing() -> bool:
        for each, words in zip(out, ("go", "gone"), strict=True):
            each.publish(text(words))
        return text("go") not in motors.payloads and not other.payloads

    holds(nothing, 1.0)


def test_called_entries_are_armed_by_name(bridge: Bridge) -> None:
    kinds: tuple[Kind, ...] = ("service", "action", "parameters")
    server = bridge.server(armed=("/arm/**",))
    client = bridge.client(
        *(Topic(f"/{name}/{kind}", "receive", kind=kind) for kind in kinds for name in ("arm", "two"))
    )
    eventually(lambda: linked(client) and linked(server))
    for kind in kinds:
        names = f"/arm/{kind}", f"/two/{kind}"
        eventually(lambda name=names[0]: required(client, name) and required(server, name))
        assert not required(client, names[1])


def test_edit_of_deadman_leaves_one_line(bridge: Bridge, yard: Yard) -> None:
    """An edit may make the deadman longer, which leaves neither the old line nor the new one under `armed`."""
    server, client = by_server(bridge, yard, msgspec.structs.replace(COMMANDS, deadman=30.0))
    found = route(server, "/cmd_vel")
    server.edit_topic(found.key, msgspec.structs.replace(found.spec, deadman=90.0)).result(60)
    (entry,) = server.session.accepted_clients[0].topics
    assert (entry.arm, entry.deadman, server.session.armed) == (True, 90.0, ())
    stays_demanded(yard, server, client)
    server.remove_topic(route(server, "/cmd_vel").key).result(60)
    assert server.session.armed == (ArmedName("/cmd_vel", "topic", client="robot1", deadman=90.0),)


def test_removal_that_drops_demand_is_told_twice(bridge: Bridge, yard: Yard) -> None:
    server, client = by_server(bridge, yard, COMMANDS)
    server.remove_topic(route(server, "/cmd_vel").key, drop_arm=True).result(60)
    for engine in (server, client):
        eventually(lambda engine=engine: happened(engine, EventCode.OPERATOR_ARM_DROPPED))
    client.add_topic(Topic("/cmd_vel", "receive")).result(60)
    yard.publish_until({"/cmd_vel"})
    assert server.session.armed == ()
