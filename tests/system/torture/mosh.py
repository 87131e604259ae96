"""mosh between an operator's terminal and a console, over a line with a round trip that may hang."""

from __future__ import annotations

import contextlib
import os
import re
import signal
import subprocess
from typing import TYPE_CHECKING, Self

from tests.support.ports import free_port
from tests.support.relay import Relay

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

_UNICODE = {"LC_ALL": "C.UTF-8"}  # mosh demands it


class Mosh:
    """A server of mosh that runs a command, and the way to it. A context manager.

    Args:
        round_trip: s. mosh sends keys each half of it, in bunches.
    """

    def __init__(self, *command: str, round_trip: float) -> None:
        port = free_port()
        environ = os.environ | _UNICODE | {"TERM": "xterm-256color"}
        started = subprocess.run(
            ["mosh-server", "new", "-i", "127.0.0.1", "-p", str(port), "--", *command],
            env=environ, capture_output=True, text=True, check=True, timeout=60,
        )  # fmt: skip
        self._pid = int(_found(r"detached, pid = (\d+)", started.stderr))
        self._key = _found(rf"MOSH CONNECT {port} (\S+)", started.stdout)
        self._relay = Relay(("127.0.0.1", port))
        self._relay.delay = lambda: round_trip / 2

    @property
    def client(self) -> tuple[list[str], Mapping[str, str]]:
        """Return the command of its client, with its environment."""
        return ["mosh-client", self._relay.host, str(self._relay.port)], _UNICODE | {"MOSH_KEY": self._key}

    @contextlib.contextmanager
    def hung(self) -> Iterator[None]:
        """Let nothing pass for the length of the block; what is on its way then is lost."""
        ways = self._relay.to_server, self._relay.to_client
        self._relay.to_server = self._relay.to_client = lambda _datagram: []
        try:
            yield
        finally:
            self._relay.to_server, self._relay.to_client = ways

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        with contextlib.suppress(ProcessLookupError):  # it ends with its command
            os.kill(self._pid, signal.SIGTERM)
        self._relay.close()


def _found(pattern: str, output: str) -> str:
    found = re.search(pattern, output)
    assert found is not None, output
    return found[1]
