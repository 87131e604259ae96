"""A Zenoh router of a test's own, in a process that may be killed, stopped and started again at the same port."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from typing import Any

import zenoh
from tests.support.ports import free_port
from tests.support.stopping import stop

_PROGRAM = """
import sys, zenoh
session = zenoh.open(zenoh.Config.from_json5(sys.argv[1]))
print("up", flush=True)
sys.stdin.read()
"""
_NO_SHARED_MEMORY = {"shared_memory": {"enabled": False}}
"""A process that is killed would leave some behind."""


class Router:
    """Runs from the start on.

    Args:
        protocol: of its one endpoint.
        settings: of its configuration, in addition to those of every router here.

    Attributes:
        port: of its endpoint, which it keeps.
    """

    def __init__(self, protocol: str = "tcp", **settings: Any) -> None:
        self.port = free_port()
        self._protocol = protocol
        self._settings = settings
        self._process: subprocess.Popen[str] | None = None
        self.start()

    @property
    def endpoint(self) -> str:
        """Return its address."""
        return f"{self._protocol}/127.0.0.1:{self.port}"

    def start(self) -> None:
        """Run; returns once it listens."""
        config = {
            "mode": "router",
            "listen": {"endpoints": [self.endpoint]},
            "scouting": {"multicast": {"enabled": False}},
            **self._settings,
            "transport": {**_NO_SHARED_MEMORY, **self._settings.get("transport", {})},
        }
        self._process = subprocess.Popen(
            [sys.executable, "-c", _PROGRAM, json.dumps(config)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        assert self._process.stdout is not None
        assert self._process.stdout.readline() == "up\n", "it does not start"

    def kill(self) -> None:
        """End it as a power cut does."""
        process, self._process = self._process, None
        assert process is not None
        with process:  # waits, and closes its pipes
            process.kill()

    def pause(self) -> None:
        """Have it take nothing any more, with all its connections open; returns once it stands still."""
        assert self._process is not None
        stop(self._process.pid)

    def go_on(self) -> None:
        """Undo `pause`."""
        assert self._process is not None
        os.kill(self._process.pid, signal.SIGCONT)

    def close(self) -> None:
        """Be gone, whether it runs or not."""
        if self._process is not None:
            self.kill()


def stranger(router: Router, **settings: Any) -> Any:
    """Somebody else in the network: a `zenoh.Session`, of which some methods have no types."""
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([router.endpoint]))
    # Else a sample is dropped if the queue is full for a millisecond, as it is on a busy machine.
    config.insert_json5("transport/link/tx/queue/congestion_control/drop/wait_before_drop", "10000000")
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("transport/shared_memory/enabled", "false")
    for key, value in settings.items():
        config.insert_json5(key, json.dumps(value))
    return zenoh.open(config)
