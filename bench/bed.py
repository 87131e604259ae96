"""Test beds: no bridge, a relay, our bridge, another one or the thesis's pipeline between a talker and a listener.

The rest is in `rsb_extras.bench`, which `rsb-console bench` uses, too.
"""

from __future__ import annotations

import base64
import contextlib
import os
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from bench import installed_bridges, zenoh_bridge

from rsb_extras.bench import loopback
from rsb_extras.bench.loopback import TOPIC, Bed, ready
from rsb_extras.demo.demo_session import free_port
from rsb_extras.demo.processes import Process

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from contextlib import AbstractContextManager

__all__ = [
    "BEDS",
    "FAR",
    "NEAR",
    "OURS",
    "TOPIC",
    "Bed",
    "Process",
    "bridged",
    "free_port",
    "headless",
    "ready",
    "relayed",
]

ROOT = Path(__file__).parents[1]
NEAR, FAR = 94, 95  # tests take domains up to 80, `bench.run` 66 to 91; a demo may take these (82 to 101)


# Children don't look for `bench` in their working folder.
os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, (str(ROOT), os.environ.get("PYTHONPATH"))))


def bridged(protocol: str, client: Callable[[Path], Process] | None = None) -> AbstractContextManager[Bed]:
    """Put our bridge between talker and listener: two processes, encrypted; `client` may start another client."""
    return loopback.bridged(protocol, NEAR, FAR, side=headless, client=client)


def headless(session: Path, log: Path | None = None) -> Process:
    """Start one side of our bridge, served at the place that this process's environment names."""
    return Process("-m", "rsb_console", "run", "--no-ui", str(session), log=log)


@contextlib.contextmanager
def relayed(near: int = NEAR, far: int = FAR) -> Iterator[Bed]:
    """Put a relay of raw messages between talker and listener: the cost of a bridge without a link."""
    with loopback.ends(near, far) as bed, Process("-m", "bench.relay", str(near), str(far), TOPIC) as relay:
        bed.between.append(relay)
        yield ready(bed)


@contextlib.contextmanager
def _bare(program: str, near: int, far: int) -> Iterator[Bed]:
    """Put the least that two processes with a connection can be between talker and listener."""
    port = str(free_port())
    receiver = Process("-m", program, "receive", str(far), TOPIC, port)
    with loopback.ends(near, far) as bed, receiver as receiving:
        receiving.line()  # it is ready
        with Process("-m", program, "send", str(near), TOPIC, port) as sending:
            sending.line()
            bed.between += [sending, receiving]
            yield ready(bed)


@contextlib.contextmanager
def _thesis(near: int, far: int) -> Iterator[Bed]:
    """Put the thesis's pipeline between talker and listener."""
    port, key = str(free_port()), base64.urlsafe_b64encode(os.urandom(32)).decode()
    with (
        loopback.ends(near, far) as bed,
        Process("-m", "bench.thesis", "receive", str(far), TOPIC, port, key) as receiving,
    ):
        receiving.line()  # it is ready
        with Process("-m", "bench.thesis", "send", str(near), TOPIC, port, key) as sending:
            sending.line()
            bed.between += [sending, receiving]
            yield ready(bed)


@contextlib.contextmanager
def _zenoh_bridge(near: int, far: int, *, tls: bool = False) -> Iterator[Bed]:
    """Put zenoh-bridge-ros2dds between talker and listener."""
    with zenoh_bridge.between(near, far, tls=tls) as sides, loopback.ends(near, far) as bed:
        bed.between += sides
        yield ready(bed)


@contextlib.contextmanager
def _installed(name: str, near: int, far: int) -> Iterator[Bed]:
    """Put a bridge of the ROS installation between talker and listener."""
    with loopback.ends(near, far) as bed, installed_bridges.between(name, near, far, TOPIC) as between:
        bed.between += between
        yield ready(bed)


BEDS: dict[str, Callable[[int, int], AbstractContextManager[Bed]]] = {
    "drained": lambda near, _: loopback.direct(near),
    "relay": relayed,
    "bare-tcp": partial(_bare, "bench.bare"),
    "bare-zenoh": partial(_bare, "bench.bare_zenoh"),
    "tcp": lambda near, far: loopback.bridged("tcp", near, far),
    "udp": lambda near, far: loopback.bridged("udp", near, far),
    "zenoh": lambda near, far: loopback.bridged("zenoh", near, far, zenoh="peer"),
    "zenoh-router": lambda near, far: loopback.bridged("zenoh", near, far, zenoh="router"),
    "zenoh-drop": lambda near, far: loopback.bridged("zenoh-drop", near, far, zenoh="router"),
    "thesis": _thesis,
    zenoh_bridge.NAME: _zenoh_bridge,
    zenoh_bridge.WITH_TLS: partial(_zenoh_bridge, tls=True),
    **{name: partial(_installed, name) for name in (installed_bridges.DOMAIN_BRIDGE, installed_bridges.ROSBRIDGE)},
}
"""By name, for a talker's and a listener's domain. Without a bridge, both are in the talker's domain."""
OURS = ("tcp", "udp", "zenoh", "zenoh-router", "zenoh-drop")
