"""A bridge as people run it: a server, clients, a network between them, and ROS nodes on all sides."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from pathlib import Path

import yaml
from tests.soak.listener import TopicListener
from tests.soak.messages import KINDS, Kind
from tests.soak.network import SERVER, ClientNetwork
from tests.soak.processes import Process, Program, Talkers
from tests.support.domain import Domain
from tests.support.ports import free_port
from tests.support.program import free_shared_memory

from rsb_bridge.config.keys import write_key

_STARTS_WITHIN = 120.0
_SAMPLE_EVERY = 1.0
_TURN = 0.02


class Stage:
    """All of it.

    Attributes:
        talkers: the PC's first, then each robot's.
    """

    def __init__(self, folder: Path, domains: Iterable[int]) -> None:
        """Prepare everything; nothing runs yet."""
        server_domain, *client_domains = domains
        names = [f"robot{number}" for number in range(1, len(client_domains) + 1)]
        port = free_port(SERVER)
        self.network = [ClientNetwork(number, port) for number in range(1, len(names) + 1)]
        self._domains = {
            name: Domain(each) for name, each in zip(("pc", *names), (server_domain, *client_domains), strict=True)
        }
        common = {"server_port": port, "use_name": True}
        clients = [{"name": name, "key_file": f"{name}.key"} for name in names]
        self.server = self._program(folder, "pc", common | {"role": "server", "server_ip": SERVER, "clients": clients})
        self.clients = [
            self._program(
                folder,
                name,
                common
                | {"role": "client", "server_ip": path.host, "key_file": f"{name}.key"}
                | {"topics": [kind.spec for kind in KINDS]},
            )
            for name, path in zip(names, self.network, strict=True)
        ]
        for name in names:
            write_key(folder / f"{name}.key")
        down = [(f"/{name}", kind.topic) for name in names for kind in KINDS if kind.direction == "receive"]
        up = [("", kind.topic) for kind in KINDS if kind.direction == "transmit"]
        self.talkers = [Talkers("pc's talkers", server_domain, down)]
        self.talkers += [
            Talkers(f"{name}'s talkers", each, up) for name, each in zip(names, client_domains, strict=True)
        ]
        self.listeners = [self._listener(name, kind) for name in names for kind in KINDS]
        self._sampled = 0.0

    @property
    def programs(self) -> list[Program]:
        return [self.server, *self.clients]

    @property
    def flows(self) -> bool:
        """Whether on each topic something has come that was published after the moment of `expect`."""
        return all(listener.flowed_at for listener in self.listeners)

    def _program(self, folder: Path, name: str, session: dict[str, object]) -> Program:
        path = folder / f"{name}.yaml"
        path.write_text(yaml.safe_dump({"name": name, "domain_id": self._domains[name].id} | session))
        return Program(name, path)

    def _listener(self, robot: str, kind: Kind) -> TopicListener:
        on_server = f"/{robot}{kind.topic}"
        where, topic = ("pc", on_server) if kind.direction == "transmit" else (robot, kind.topic)
        return TopicListener(on_server, self._domains[where], topic, kind)

    def late_listeners(self) -> list[TopicListener]:
        return [
            self._listener(listener.name.split("/")[1], listener.kind)
            for listener in self.listeners
            if listener.kind.latched
        ]

    def start(self) -> None:
        processes: list[Process] = [*self.programs, *self.talkers]
        for process in processes:
            process.start()
        if not self.live_until(lambda: all(process.ready for process in processes), _STARTS_WITHIN):
            late = [process.name for process in processes if not process.ready]
            raise TimeoutError(f"not started within {_STARTS_WITHIN:g} s: {', '.join(late)}")

    def restart(self, process: Process) -> None:
        """Restart a process, and wait for its first output, because the start of Python does not count as recovery."""
        process.start()
        if not self.live_until(lambda: process.ready, _STARTS_WITHIN):
            raise TimeoutError(f"{process.name} has not started within {_STARTS_WITHIN:g} s")

    def live(self, seconds: float) -> None:
        self.live_until(lambda: False, seconds)

    def live_until(self, condition: Callable[[], bool], within: float) -> bool:
        """Let time go by until something is the case, for `within` s at most. Returns whether it is."""
        deadline = time.monotonic() + within
        while True:
            for listener in self.listeners:
                listener.take(time.time)
            now = time.monotonic()
            if now - self._sampled >= _SAMPLE_EVERY:
                self._sampled = now
                for program in self.programs:
                    program.measure()
            if condition():
                return True
            if now >= deadline:
                return False
            time.sleep(_TURN)

    def expect(self) -> float:
        """Have all listeners wait for what is published from now on. Returns now, in s since the epoch."""
        now = time.time()
        for listener in self.listeners:
            listener.expect(now)
        return now

    def calm(self) -> None:
        for program in self.programs:
            program.measure(calm=True)

    def missing(self) -> str:
        told = []
        for listener in self.listeners:
            if listener.flowed_at:
                continue
            robot, topic = listener.name.strip("/").split("/")
            words = [
                f"{program.name}: {row['state']} {row['reason']!r} missing {row['missing']}"
                for program in self.programs
                for row in program.routes
                if (row["link"], row["topic"]) in ((robot, listener.name), (robot, f"/{topic}"))
                and program.name in ("pc", robot)
            ]
            told.append(f"{listener.name} ({'; '.join(words) or 'no route on either side'})")
        return ", ".join(told)

    def stop(self) -> None:
        for program in reversed(self.programs):
            program.stop()

    def close(self) -> None:
        for process in (*self.programs, *self.talkers):
            process.close()
        for path in self.network:
            path.close()
        for domain in self._domains.values():
            domain.close()
        free_shared_memory()
