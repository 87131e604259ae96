"""One process's place in a Zenoh network: opening it, its TCP sockets, and what to tell an operator where that fails.

The `zenoh` package is an extra. It is imported when a network is opened, and by nothing else.
"""

from __future__ import annotations

import asyncio
import base64
import contextlib
import json
import os
import re
import socket
import ssl
import threading
from functools import partial
from ipaddress import IPv6Address, ip_address
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rsb_bridge.feature_api import Wording
from rsb_bridge.model.budgets import Strangers
from rsb_bridge.python_internals.threading_internals import before_waiting_for_threads
from rsb_bridge.tasks import in_thread
from rsb_bridge.transport import tcp
from rsb_bridge.transport.streams import StreamHandler, StreamProblem
from rsb_extras.zenoh import HOW_TO_INSTALL
from rsb_extras.zenoh.endpoint import ROUTER_LOST, ZenohEndpoint

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    import zenoh

    from rsb_extras.zenoh import ZenohSettings

TLS = "transport/link/tls"
"""Where a configuration has its certificates."""
UNABLE = "Unable to connect"
"""What Zenoh says where it reaches nobody."""

_WITHIN = 2.0
"""s for each step of a look at an endpoint, which an operator waits for: a round figure."""
_IP = (socket.AF_INET, socket.AF_INET6)
_OVER_TCP = ("tcp", "tls", "ws")
_ZONE = re.compile(r"(?<=%)[^\]]+(?=\]:\d)")
_NOT_CONNECTED = (OSError, OverflowError, UnicodeError)
_MOST = 4
"""Endpoints that are looked at, one after another: a round figure."""
_EXPIRED, _NOT_YET_VALID, _WRONG_NAMES = 10, 9, (62, 64)
"""X509_V_ERR_… of OpenSSL's x509_vfy.h: the host and the IP address do not match."""


class Unreachable(Wording):
    """The reasons why Zenoh reaches no router at an endpoint, each with its remedy."""

    ERROR = "Zenoh: {error}"
    NO_ANSWER_WITHIN = "no answer within {seconds:g} s: is it on, and does no firewall drop it?"
    NOBODY_LISTENS = "nothing listens there: is the router running?"
    NO_ZENOH = (
        "something listens there, but does not speak Zenoh with this side: is it a Zenoh router, and does it let this "
        "side in?"
    )
    NO_TLS = "no TLS there: is it a Zenoh router, and does it listen for tls? Else the endpoint is tcp/{host}:…"
    CERTIFICATES_UNREADABLE = "the certificates of zenoh.config can't be read: {error}"
    CERTIFICATE_REFUSED = "its certificate is refused: {error}; {remedy}"
    OWN_CERTIFICATE_REFUSED = "it refuses this side's certificate ({error}): connect_certificate in zenoh.config"
    OWN_CERTIFICATE_MISSING = "it asks for a certificate ({error}): enable_mtls and connect_certificate in zenoh.config"


class CertificateRemedy(Wording):
    """Changes that help where a router's certificate is refused."""

    EXPIRED = "renew the router's listen_certificate, or set this machine's clock"
    NOT_YET_VALID = "set this machine's clock"
    WRONG_NAME = "connect by a name in the certificate, or verify_name_on_connect: false in zenoh.config"
    UNTRUSTED = "check root_ca_certificate in zenoh.config: it names the trusted issuers"


class NetworkProblem(Wording):
    """Problems of the whole process with its Zenoh network."""

    CLOSED = "{place}: closed meanwhile"
    CONFIG = "zenoh.config: {path}: {error}"
    NO_INTERFACE = "{endpoint}: this machine has no interface {name}: correct it (ip addr shows them)"


def why_unreachable(settings: ZenohSettings, config: zenoh.Config, error: str) -> str:
    """Return the problem of each endpoint; block for up to 2 s for each.

    Args:
        config: the configuration that failed.
    """
    endpoints = settings.connect or _endpoints(config)
    if not endpoints or UNABLE not in error:
        return Unreachable.ERROR(error=first_sentence(error))
    return _nobody_answers({endpoint: _why(endpoint, config) for endpoint in endpoints[:_MOST]}, len(endpoints))


def _nobody_answers(reasons: Mapping[str, str], count: int) -> str:
    """Return the reason of all endpoints, of which there are so many."""
    found = [f"{endpoint}: {reason}" for endpoint, reason in reasons.items()][:_MOST]
    if count > _MOST:
        found.append(f"and {count - _MOST} more")
    return f"no Zenoh router answers: {'; '.join(found)}"


def first_sentence(text: str) -> str:
    """Return Zenoh's text of an error on one line, without the place in its code."""
    return " ".join(text.partition(" at /")[0].split()).rstrip(".")


def _endpoints(config: zenoh.Config) -> tuple[str, ...]:
    """Return a configuration's endpoints, which may be listed by mode, and each with its own settings."""
    found = json.loads(config.get_json("connect/endpoints"))
    if isinstance(found, dict):
        found = [endpoint for each in found.values() for endpoint in (each if isinstance(each, list) else [each])]
    return tuple(each for each in found if isinstance(each, str)) if isinstance(found, list) else ()


def _is_client(config: zenoh.Config) -> bool:
    """Whether a session reaches others, and is not reached, so that there may be a second one beside it."""
    return bool(json.loads(config.get_json("mode")) == "client")


async def _reach(endpoints: Sequence[str]) -> None:
    """Wait until one of the endpoints takes a TCP connection; whether one over another protocol would is not known.

    Zenoh itself goes on for 10 s with an attempt that began on a dead path.

    Raises:
        OSError: none does; the message says why.
    """
    if not all(protocol in _OVER_TCP and port.isdecimal() for protocol, _, port in map(_parts, endpoints)):
        return
    reasons: dict[str, str] = {}

    async def knock(endpoint: str) -> bool:
        _, host, port = _parts(endpoint)
        try:
            stream = await tcp.Tcp().connect(host, int(port), StreamHandler())
        except _NOT_CONNECTED as error:
            reasons[endpoint] = _why_not_connected(error, tcp.CONNECT_TIMEOUT)
            return False
        stream.abort(StreamProblem.CLOSED_HERE())
        return True

    knocking = [asyncio.create_task(knock(each)) for each in endpoints]
    try:
        for each in asyncio.as_completed(knocking):
            if await each:
                return
    finally:
        for task in knocking:
            task.cancel()
    raise OSError(_nobody_answers({each: reasons[each] for each in endpoints}, len(endpoints)))


def _parts(endpoint: str) -> tuple[str, str, str]:
    """Return an endpoint's protocol, host and port."""
    protocol, _, address = endpoint.partition("/")
    host, _, port = address.partition("?")[0].partition("#")[0].rpartition(":")
    return protocol, host.strip("[]"), port


def _why(endpoint: str, config: zenoh.Config) -> str:
    protocol, host, port = _parts(endpoint)
    if protocol in {"quic", "udp"}:
        return "no answer: is the router running there, and does no firewall drop UDP?"
    if protocol not in _OVER_TCP or not port.isdecimal():
        return "no answer: is it a Zenoh router, and does it accept this side?"
    try:
        with socket.create_connection((host, int(port)), _WITHIN) as connection:
            if protocol == "tls":
                return _tls(connection, host, json.loads(config.get_json(TLS)) or {})
    except _NOT_CONNECTED as error:
        return _why_not_connected(error, _WITHIN)
    return Unreachable.NO_ZENOH()


def _why_not_connected(error: Exception, seconds: float) -> str:
    if isinstance(error, TimeoutError):
        return Unreachable.NO_ANSWER_WITHIN(seconds=seconds)
    if isinstance(error, socket.gaierror):
        return f"the name is not known ({error.strerror})"
    if isinstance(error, UnicodeError):
        return "not a valid host name: correct it"
    if isinstance(error, ConnectionRefusedError):
        return Unreachable.NOBODY_LISTENS()
    return getattr(error, "strerror", None) or str(error)


def _tls(connection: socket.socket, host: str, settings: dict[str, Any]) -> str:
    """Return TLS's own verdict on the two certificates."""
    shows_own = bool(settings.get("enable_mtls"))
    try:
        context = _context(settings, shows_own=shows_own)
    except (OSError, ValueError) as error:
        return Unreachable.CERTIFICATES_UNREADABLE(error=getattr(error, "strerror", None) or error)
    try:
        encrypted = context.wrap_socket(connection, server_hostname=host)
    except ssl.SSLCertVerificationError as error:
        return Unreachable.CERTIFICATE_REFUSED(error=error.verify_message, remedy=_remedy(error.verify_code)())
    except OSError:
        return Unreachable.NO_TLS(host=host)
    try:
        encrypted.settimeout(_WITHIN)
        encrypted.recv(1)  # a router that wants a certificate of ours refuses now
    except ssl.SSLError as error:
        if shows_own:
            return Unreachable.OWN_CERTIFICATE_REFUSED(error=_plain(error))
        return Unreachable.OWN_CERTIFICATE_MISSING(error=_plain(error))
    except OSError:
        pass
    finally:
        encrypted.close()
    return "TLS works there, but Zenoh does not: is it a Zenoh router, and does it accept this side?"


def _context(settings: dict[str, Any], *, shows_own: bool) -> ssl.SSLContext:
    """Return a TLS context with Zenoh's settings.

    Raises:
        OSError: a file can't be read, or has no certificate.
        ValueError: a certificate in the configuration itself is invalid.
    """
    inline = settings.get("root_ca_certificate_base64")
    context = ssl.create_default_context(
        cafile=settings.get("root_ca_certificate"), cadata=base64.b64decode(inline).decode() if inline else None
    )
    context.verify_flags &= ~ssl.VERIFY_X509_STRICT  # Zenoh is not
    context.check_hostname = settings.get("verify_name_on_connect") is not False
    if shows_own and settings.get("connect_certificate"):
        context.load_cert_chain(settings["connect_certificate"], settings.get("connect_private_key"))
    return context


def _remedy(code: int) -> CertificateRemedy:
    """Return the remedy for a refused certificate of the router."""
    if code == _EXPIRED:
        return CertificateRemedy.EXPIRED
    if code == _NOT_YET_VALID:
        return CertificateRemedy.NOT_YET_VALID
    if code in _WRONG_NAMES:
        return CertificateRemedy.WRONG_NAME
    return CertificateRemedy.UNTRUSTED


def _plain(error: ssl.SSLError) -> str:
    return (error.reason or "TLS fails").lower().replace("_", " ")


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
            await _reach(_endpoints(config))
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


def prepare_socket(link: zenoh.Link) -> bool:
    """Set the options of this project's own TCP sockets on that of a link of this process.

    Zenoh has no settings for them. With the kernel's own, it takes twice as long as a cut lasted until a link carries
    again (retries double, up to 2 min), lost packets count as a full link, and what waits in the kernel is in no order
    of priority.

    Returns:
        whether the link has such a socket, and it was found.
    """
    protocol, _, here = link.src.partition("/")
    if protocol not in _OVER_TCP:
        return False
    ends = _socket_address(here), _socket_address(link.dst.partition("/")[2])
    for each in Path("/proc/self/fd").iterdir():
        with contextlib.suppress(OSError):  # it is closed meanwhile, or not connected
            if str(each.readlink()).startswith("socket:") and _prepared(int(each.name), ends):
                return True
    return False


def _prepared(descriptor: int, ends: tuple[object, object]) -> bool:
    # A copy: to close it leaves Zenoh's own open.
    with socket.socket(fileno=os.dup(descriptor)) as found:
        if found.family not in _IP or found.type != socket.SOCK_STREAM:
            return False
        if (_comparable(found.getsockname()), _comparable(found.getpeername())) != ends:
            return False
        tcp.set_options(found)
        return True


def _socket_address(address: str) -> tuple[object, int]:
    host, _, port = address.rpartition(":")
    return _comparable((host.strip("[]"), int(port)))


def _comparable(address: tuple[str, int] | tuple[str, int, int, int]) -> tuple[object, int]:
    ip = ip_address(address[0].partition("%")[0])
    return (isinstance(ip, IPv6Address) and ip.ipv4_mapped) or ip, address[1]


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
