"""The reasons why a Zenoh network reaches no router, each with its remedy: Zenoh's own error names none."""

from __future__ import annotations

import asyncio
import base64
import json
import socket
import ssl
from typing import TYPE_CHECKING, Any

from rsb_bridge.feature_api import Wording
from rsb_bridge.transport import tcp
from rsb_bridge.transport.streams import StreamHandler, StreamProblem
from rsb_extras.zenoh.zenoh_sockets import OVER_TCP

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    import zenoh

    from rsb_extras.zenoh import ZenohSettings

TLS = "transport/link/tls"
"""Where a configuration has its certificates."""
UNABLE = "Unable to connect"
"""What Zenoh says where it reaches nobody."""

_WITHIN = 2.0
"""s for each step of a look at an endpoint, which an operator waits for: a round figure."""
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


def why_unreachable(settings: ZenohSettings, config: zenoh.Config, error: str) -> str:
    """Return the problem of each endpoint; block for up to 2 s for each.

    Args:
        config: the configuration that failed.
    """
    endpoints = settings.connect or endpoints_of(config)
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


def endpoints_of(config: zenoh.Config) -> tuple[str, ...]:
    """Return a configuration's endpoints, which may be listed by mode, and each with its own settings."""
    found = json.loads(config.get_json("connect/endpoints"))
    if isinstance(found, dict):
        found = [endpoint for each in found.values() for endpoint in (each if isinstance(each, list) else [each])]
    return tuple(each for each in found if isinstance(each, str)) if isinstance(found, list) else ()


async def reach(endpoints: Sequence[str]) -> None:
    """Wait until one of the endpoints takes a TCP connection; whether one over another protocol would is not known.

    Zenoh itself goes on for 10 s with an attempt that began on a dead path.

    Raises:
        OSError: none does; the message says why.
    """
    if not all(protocol in OVER_TCP and port.isdecimal() for protocol, _, port in map(_parts, endpoints)):
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
    if protocol not in OVER_TCP or not port.isdecimal():
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
