"""Both consoles in real terminals while a tunnel between the two sides carries too little."""

from __future__ import annotations

import contextlib
from pathlib import Path

import msgspec
import pytest
from tests.console.live import HERE, THERE, Pair, running
from tests.console.nodes import Spec, encoded
from tests.console.side import Side, every_so_often
from tests.support.relay import Relay
from tests.support.waiting import eventually

from rsb_bridge.config.session_file import save
from rsb_bridge.model.session import Topic
from rsb_bridge.model.snapshot import State
from rsb_bridge.model.verdict import LinkCause


def test_both_first_screens_say_that_link_is_full(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("rclpy", reason="needs ROS 2")
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    pair = Pair(tmp_path, Topic("/chat", "transmit"), domains=(HERE, THERE), stale_after=120.0)
    with contextlib.ExitStack() as stack:
        relay = stack.enter_context(Relay(("127.0.0.1", pair.client.server_port), rate=1_000_000))
        save(msgspec.structs.replace(pair.client, server_port=relay.port), pair.client_path)
        for domain, spec in ((HERE, Spec("talker", "/chat", 200)), (THERE, Spec("listener", "/chat"))):
            stack.enter_context(running("tests.console.nodes", str(domain), encoded([spec])))
        sides = []
        for role, path in (("server", pair.server_path), ("client", pair.client_path)):
            side = Side(tmp_path / role, tmp_path / f"{role}.sock", "run", str(path))
            stack.callback(side.close)
            sides.append(side)
        every_so_often(lambda: all(side.route("/chat").get("state") == "ok" for side in sides), "ok on both sides")
        relay.rate = 3_000

        def full() -> bool:
            return all(side.status()["links"].get("robot1", {}).get("cause") == LinkCause.FULL for side in sides)

        every_so_often(full, "full on both sides")
        for side in sides:
            eventually(lambda side=side: "link full" in side.screen.picture, what=side.screen.picture)
            every_so_often(
                lambda side=side: side.route("/chat").get("state", State.OK) != State.OK, "/chat is not said to be ok"
            )
