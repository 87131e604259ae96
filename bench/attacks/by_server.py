"""A server that turns on its client: topics that the client never listed, very many of them, and then Shutdown."""

from __future__ import annotations

import contextlib
import tempfile
import time
from pathlib import Path

from bench import bed
from bench.attacks.stage import Watch, Watched, domains, seen_in
from tests.support.ports import free_port
from tests.support.rogue import BLOB
from tests.support.rogue_server import RogueServer

from rsb_bridge.config.keys import write_key
from rsb_bridge.config.session_file import save
from rsb_bridge.model.qos import Qos
from rsb_bridge.model.session import Session, Topic
from rsb_bridge.wire.messages import Accept, Describe, Ping, Propose, Ready, Refuse, Shutdown
from rsb_bridge.wire.records import Source

NAME = "server"
WHAT = "a server that has its client publish /cmd_vel and 995 other topics, read 100, and then says Shutdown"
_PUBLISHED, _READ = 996, 100  # together more than the 1,000 topics of a link (docs/budgets.md)


def perform() -> tuple[list[str], list[str]]:
    """Attack a headless client and print its rows; return the observations and the attacker's failures."""
    with contextlib.ExitStack() as resources:
        folder = Path(resources.enter_context(tempfile.TemporaryDirectory()))
        key, port, log = write_key(folder / "robot1.key").secret, free_port(), folder / "client.log"
        save(
            Session(
                name="robot1", role="client", server_ip="127.0.0.1", server_port=port, domain_id=domains()[0],
                key_file="robot1.key", topics=(Topic("/bench", "transmit"),),
            ),
            folder / "client.yaml",
        )  # fmt: skip
        server = resources.enter_context(RogueServer(port, key, timeout=20.0))
        client = resources.enter_context(bed.headless(folder / "client.yaml", log))
        server.accept()
        _print("before", _watched(client, log, server, 3.0))
        server.say(*_proposals())
        _print("during", _watched(client, log, server, 6.0, lambda route: Describe(
            route, *BLOB, Qos(), (Source((f"rsb_rogue/t{route}",)),)
        )))  # fmt: skip
        said = server.heard
        accepted = {each.route: each.topic for each in said if isinstance(each, Accept)}
        refused = {each.code for each in said if isinstance(each, Refuse)}
        ready = sum(1 for each in said if isinstance(each, Ready))
        server.say(Shutdown("bye", retry_after=None))
        watch = Watch(client, log)
        comes_back = _comes_back(server)
        _print("after", watch.end())
        notes = [
            f"{sum(route <= 2 * _PUBLISHED for route in accepted)} of {_PUBLISHED} topics to publish accepted",
            f"{'with' if 2 in accepted else 'without'} /cmd_vel, {ready} published",
            f"{sum(route > 2 * _PUBLISHED for route in accepted)} of {_READ} to read; refused with {sorted(refused)}",
            f"after Shutdown the client is {'up' if client.running else 'DOWN'}, {comes_back}",
            *seen_in(log),
        ]
        answered = len({each.route for each in said if isinstance(each, Accept | Refuse)})
        return notes, [] if answered >= _PUBLISHED else ["answered proposals"]


def _proposals() -> list[Propose]:
    published = ["/cmd_vel", *(f"/rogue{number}" for number in range(_PUBLISHED - 1))]
    read = [f"/secret{number}" for number in range(_READ)]
    return [
        Propose(
            route=2 * number, topic=name, remote_topic=name, from_client=name in read, type=BLOB[0], transport="udp"
        )
        for number, name in enumerate([*published, *read], 1)
    ]


def _watched(client: bed.Process, log: Path, server: RogueServer, seconds: float, describe: object = None) -> Watched:
    """Go on as a server does for a while."""
    watch, until, described = Watch(client, log), time.monotonic() + seconds, 0
    while time.monotonic() < until:
        server.say(Ping(1, 0))
        if not server.hear():
            break
        if callable(describe):
            for message in server.heard[described:]:
                if isinstance(message, Accept) and message.route <= 2 * _PUBLISHED:
                    server.say(describe(message.route))
            described = len(server.heard)
        time.sleep(0.1)
    return watch.end()


def _comes_back(server: RogueServer) -> str:
    began = time.monotonic()
    try:
        server.accept()
    except OSError:
        return f"and has not come back within {time.monotonic() - began:.0f} s"
    return f"and comes back after {time.monotonic() - began:.1f} s"


def _print(phase: str, seen: Watched) -> None:
    name = f"{NAME} (the client's)" if phase == "before" else ""
    print(
        f"| {name} | {phase} | | | | | | | | {seen.cpu:.0f} | {seen.memory:.0f} | {seen.descriptors} | {seen.log:,} |"
    )
