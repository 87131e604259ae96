"""One process's place in a Zenoh network: its session, which is opened, watched, opened anew and closed.

The `zenoh` package is an extra. It is imported when a network is opened, and by nothing else.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import socket
import threading
from functools import partial
from typing import TYPE_CHECKING, Any

from rsb_bridge.feature_api import Wording, in_thread
from rsb_bridge.model.budgets import Strangers
from rsb_bridge.python_internals.threading_internals import before_waiting_for_threads
from rsb_extras.zenoh import HOW_TO_INSTALL
from rsb_extras.zenoh.endpoint import ROUTER_LOST, ZenohEndpoint
from rsb_extras.zenoh.unreachable import TLS, UNABLE, Unreachable, endpoints_of, first_sentence, reach, why_unreachable
from rsb_extras.zenoh.zenoh_sockets import prepare_socket

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    import zenoh

    from rsb_extras.zenoh import ZenohSettings

LARGEST_SAMPLE = 2 * 1024 * 1024
"""Bytes. This side's own samples have at most half; Zenoh refuses longer ones before it assembles them."""

_OPEN_WITHIN = 20.0
_HANDSHAKE = 3000
"""ms that one endpoint has for Zenoh's own handshake. A round figure, as the two around it."""
_CLOSE_WITHIN = 1.0
_QUEUES = ("control", "real_time", "interactive_high", "interactive_low", "data_high", "data", "data_low", "background")
_BATCHES = 16
"""Of 64 kB, in each priority's queue; the most that Zenoh allows. `endpoint` relies on it."""
_LEASE = 5000
"""ms without a byte after which a router counts as lost: as a link is given up, and `outbox` relies on it."""
_UNLESS_SAID = {
    "scouting/multicast/enabled": False,
    "scouting/gossip/autoconnect": {"router": [], "peer": [], "client": []},
}
"""Unless the session's own configuration says else: nobody is called who is not named."""
_FILES = (
    "root_ca_certificate",
    "listen_private_key",
    "listen_certificate",
    "connect_private_key",
    "connect_certificate",
)
_RETRY = {"period_init_ms": 500, "period_max_ms": 4000, "period_increase_factor": 2}
"""Round figures: a router that is back is found within 4 s."""
_ZONE = re.compile(r"(?<=%)[^\]]+(?=\]:\d)")


class NetworkProblem(Wording):
    """Problems of the whole process with its Zenoh network."""

    CLOSED = "{place}: closed meanwhile"
    CONFIG = "zenoh.config: {path}: {error}"
    NO_INTERFACE = "{endpoint}: this machine has no interface {name}: correct it (ip addr shows them)"


class Network:
    """A Zenoh session of this process, opened when it is first needed, and shared by all its users.

    It reconnects by itself after a router was lost. It may be opened anew before that; then the earlier session ends
    with the last endpoint there. Its endpoints may be on several event loops.

    Args:
        base: the folder that `ZenohSettings.config` is relative to.
        strangers: of all networks of this process, or None for a budget of its own.
        jitter: a number from 0 to 1, different in each process, that delays its retries.

    Attributes:
        strangers: the budget of samples from strangers in the network.
    """

    def __init__(
        self, settings: ZenohSettings, base: Path, strangers: Strangers | None = None, jitter: float = 0.0
    ) -> None:
        self.settings = settings
        self.strangers = strangers or Strangers()
        self._base = base
        self._jitter = jitter
        self._lock = threading.Lock()  # never held for long: the loops take it, too
        self._opening = threading.Lock()
        self._session: zenoh.Session | None = None  # of new endpoints
        self._sessions: set[zenoh.Session] = set()  # with those that have endpoints yet
        self._deleted: Any = None
        self._config_used: zenoh.Config | None = None
        self._endpoints: list[ZenohEndpoint] = []
        self._closed = False
        self._cut_off = False

    async def open(self, doubted: Callable[[], bool] | None = None) -> None:
        """Be in the network, if no earlier call has seen to it.

        Args:
            doubted: whether the present session may be cut off, which Zenoh finds out after 5 s. It is opened anew.

        Raises:
            OSError: it is not reached; the message says why, and what to do.
        """
        before, config = self._session, self._config_used
        anew = False
        if before is not None and config is not None and doubted is not None and doubted() and _is_client(config):
            await reach(endpoints_of(config))
            anew = doubted()
        if self.connected and not anew:
            return
        try:
            await in_thread("zenoh-open", lambda: self._open(before if anew else None), _OPEN_WITHIN)
        except TimeoutError:
            raise OSError(f"{self.place}: no answer within {_OPEN_WITHIN:g} s") from None

    @property
    def place(self) -> str:
        """The network's endpoints, for an operator."""
        return self.settings.place

    @property
    def connected(self) -> bool:
        """Whether there is somebody to talk to, or somebody may come: who listens waits for peers."""
        session = self._session
        return session is not None and bool(self.settings.listen or session.info.transports())

    @property
    def problem(self) -> str:
        """The lost router and the remedy, or an empty string."""
        return f"{self.place}: {ROUTER_LOST}: check that it runs, and firewalls" if self._cut_off else ""

    async def endpoint(self, service: str, label: str, watched: Sequence[str]) -> ZenohEndpoint:
        """Return a new endpoint on the running loop, and announce it to the fleet.

        Args:
            service: its service: ``server``, ``client``, ``engine``, ``console``.
            label: any text, for readers of the announcement.
            watched: the services whose comings and goings it watches.

        Raises:
            OSError: the network is not reached.
        """
        while True:
            await self.open()
            with self._lock:
                session, fleet = self._session, self.settings.fleet
                if session is None:
                    raise OSError(NetworkProblem.CLOSED(place=self.place))
                endpoint = ZenohEndpoint(session, fleet, service, label, watched, self.strangers, self._left)
                self._endpoints.append(endpoint)
            try:
                await endpoint.announce()
            except BaseException:
                endpoint.close()
                raise
            if self.is_in(endpoint):
                return endpoint
            endpoint.close()  # the network has been opened anew meanwhile

    def is_in(self, endpoint: ZenohEndpoint) -> bool:
        """Whether an endpoint is in the present session."""
        return endpoint.session is self._session

    def close(self) -> None:
        """Leave the network once the last endpoint is closed; it may be now. From any thread."""
        with self._lock:
            self._closed = True
        self._leave()

    def _left(self, endpoint: ZenohEndpoint) -> None:
        with self._lock:
            if endpoint in self._endpoints:
                self._endpoints.remove(endpoint)
        self._leave()

    def _leave(self) -> None:
        with self._lock:
            if self._closed and not self._endpoints:
                self._session = None
            used = {self._session, *(each.session for each in self._endpoints)}
            left = self._sessions - used
            self._sessions -= left
        for session in left:  # without the lock, which the loops take: closing may take seconds
            _close(session, wait=self._closed)

    # --- in a thread

    def _open(self, instead: zenoh.Session | None) -> None:
        """Open a session, if there is none, or the one that it is to replace."""
        if not self._opening.acquire(timeout=_OPEN_WITHIN):
            raise TimeoutError  # an earlier call is still at it
        try:
            if self._session is instead and not self._closed:
                self._begin()
            if not self.connected:
                raise OSError(self._why_lost())
        finally:
            self._opening.release()

    def _begin(self) -> None:
        try:
            import zenoh  # noqa: PLC0415 (an extra)
        except ImportError:
            raise OSError(HOW_TO_INSTALL) from None
        try:
            config = self._config(zenoh)
        except zenoh.ZError as error:  # it takes no such endpoint
            raise OSError(Unreachable.ERROR(error=first_sentence(str(error)))) from None
        try:
            session = zenoh.open(config)
        except zenoh.ZError as error:
            raise OSError(why_unreachable(self.settings, config, str(error))) from None
        self._deleted = zenoh.SampleKind.DELETE
        try:
            changes = session.info.declare_transport_events_listener()
            links = session.info.declare_link_events_listener(history=True)
        except zenoh.ZError as error:  # it has been closed already
            _close(session, wait=True)
            raise OSError(Unreachable.ERROR(error=first_sentence(str(error)))) from None
        watchers = [_started(partial(self._watch, session), changes), _started(self._prepare, links)]
        _open_sessions[session] = watchers
        with self._lock:
            self._sessions.add(session)
            if not self._closed:
                self._session, self._config_used, self._cut_off = session, config, False
            endpoints = [each for each in self._endpoints if each.session is not session]
        for each in endpoints:
            each.retire()
        self._leave()  # the session that nobody uses any more, or this one, if nobody waits for it

    def _why_lost(self) -> str:
        """Return the reason why an open session reaches no router. The session itself tries again."""
        if self._config_used is None:
            return NetworkProblem.CLOSED(place=self.place)
        return why_unreachable(self.settings, self._config_used, UNABLE)

    def _config(self, package: Any) -> zenoh.Config:
        settings = self.settings
        config: zenoh.Config = package.Config()
        if settings.config is not None:
            path = self._base / settings.config
            try:
                config = package.Config.from_json5(path.read_text(encoding="utf-8"))
            except OSError as error:
                raise OSError(NetworkProblem.CONFIG(path=path, error=os.strerror(error.errno or 0))) from None
            except (package.ZError, ValueError) as error:
                raise OSError(NetworkProblem.CONFIG(path=path, error=first_sentence(str(error)))) from None
            _from_its_folder(config, path.parent)
        for key, usual in _UNLESS_SAID.items():
            if json.loads(config.get_json(key)) is None:
                _set(config, key, usual)
        if json.loads(config.get_json("mode")) is None:
            _set(config, "mode", "peer" if settings.listen else "client")
        if settings.connect:
            _set(config, "connect/endpoints", [_with_zone_number(each) for each in settings.connect])
        if settings.listen:
            _set(config, "listen/endpoints", [_with_zone_number(each) for each in settings.listen])
        _set(config, "connect/retry", {**_RETRY, "period_init_ms": int(_RETRY["period_init_ms"] * (1 + self._jitter))})
        _set(config, "transport/unicast/open_timeout", _HANDSHAKE)
        _set(config, "transport/link/tx/lease", _LEASE)
        _set(config, "transport/shared_memory/enabled", value=False)  # a killed process would leave segments behind
        _set(config, "transport/link/rx/max_message_size", 2 * LARGEST_SAMPLE)
        _set(config, "transport/link/tx/queue/size", dict.fromkeys(_QUEUES, _BATCHES))
        # Datagrams are put on the loop's thread, where Zenoh would wait for room before it drops one.
        _set(config, "transport/link/tx/queue/congestion_control/drop/wait_before_drop", 0)
        return config

    def _watch(self, session: zenoh.Session, changes: zenoh.TransportEventsListener[Any]) -> None:
        """See routers and peers come and go, until the session is closed."""
        for event in changes:
            self._changed(session, event)

    def _prepare(self, links: zenoh.LinkEventsListener[Any]) -> None:
        """Prepare the sockets of links to routers and peers, until the session is closed."""
        for event in links:
            if event.kind == self._deleted:
                continue
            # Without descriptors, or with an address of another form, the link works as Zenoh made it.
            with contextlib.suppress(OSError, ValueError):
                prepare_socket(event.link)

    def _changed(self, session: zenoh.Session, event: zenoh.TransportEvent) -> None:
        """Handle a router or peer that has come or gone."""
        gone, is_cut_off = event.transport.zid, event.kind == self._deleted
        if session not in self._sessions:  # it is being closed
            return
        if is_cut_off and any(each.zid != gone for each in session.info.transports()):  # it may still be listed
            return
        with self._lock:
            if session is self._session:
                self._cut_off = is_cut_off and not self.settings.listen  # peers can still reach a side that listens
            endpoints = [each for each in self._endpoints if each.session is session] if is_cut_off else []
        for endpoint in endpoints:
            endpoint.cut_off(self.problem or ROUTER_LOST)


def _is_client(config: zenoh.Config) -> bool:
    """Whether a session reaches others, and is not reached, so that there may be a second one beside it."""
    return bool(json.loads(config.get_json("mode")) == "client")


def _set(config: zenoh.Config, key: str, value: object) -> None:
    config.insert_json5(key, json.dumps(value))


def _with_zone_number(endpoint: str) -> str:
    """Return an endpoint with its zone's number instead of an interface's name, which Zenoh does not read."""
    zone = _ZONE.search(endpoint)
    if zone is None or zone[0].isdecimal():
        return endpoint
    try:
        number = socket.if_nametoindex(zone[0])
    except OSError:
        raise OSError(NetworkProblem.NO_INTERFACE(endpoint=endpoint, name=zone[0])) from None
    return f"{endpoint[: zone.start()]}{number}{endpoint[zone.end() :]}"


def _from_its_folder(config: zenoh.Config, folder: Path) -> None:
    """Have files that a configuration names be relative to it; Zenoh itself takes the process's folder."""
    settings = json.loads(config.get_json(TLS)) or {}
    for key in _FILES:
        if settings.get(key):
            _set(config, f"{TLS}/{key}", str((folder / settings[key]).absolute()))


_open_sessions: dict[zenoh.Session, list[threading.Thread]] = {}
"""Each with the threads that watch it. A process that ended with one of them open would wait for ever."""


def _started(watch: Callable[[Any], None], events: object) -> threading.Thread:
    watcher = threading.Thread(target=watch, args=(events,), name="zenoh-watch", daemon=True)
    watcher.start()
    return watcher


def _close_all() -> None:
    for session in tuple(_open_sessions):
        _close_now(session)


def _close_now(session: zenoh.Session) -> None:
    """Close it, and have its watchers end: a thread that is in Zenoh when the interpreter ends aborts the process.

    So does a callback on one of Zenoh's own threads, which tells of its links after the session is closed, too. So
    events wait for threads of ours.
    """
    import zenoh  # noqa: PLC0415 (an extra)

    watchers = _open_sessions.pop(session, ())
    with contextlib.suppress(zenoh.ZError):  # after 10 s with a router that takes nothing, it leaves the rest as it is
        session.close()  # type: ignore[no-untyped-call]
    for watcher in watchers:
        watcher.join(_CLOSE_WITHIN)


before_waiting_for_threads(_close_all)  # Zenoh has each callback on a thread of its own


def _close(session: zenoh.Session, *, wait: bool) -> None:
    """Close it, and perhaps wait a little for that: with a router that takes nothing, Zenoh waits for seconds."""
    closing = threading.Thread(target=_close_now, args=(session,), name="zenoh-close", daemon=True)
    closing.start()
    if wait:
        closing.join(_CLOSE_WITHIN)
