"""Why a Zenoh network is not reached, in words: Zenoh itself says only that no endpoint could be connected."""

from __future__ import annotations

import base64
import json
import socket
import ssl
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import zenoh

    from rsb_bridge.model.session import ZenohSettings

TLS = "transport/link/tls"
"""Where a configuration has its certificates."""
UNABLE = "Unable to connect"
"""What Zenoh says where it reaches nobody."""

_WITHIN = 2.0
_REMEDY = "is it a Zenoh router, and does it let this side in?"
_MOST = 4
"""Endpoints that are looked at, one after another."""
_EXPIRED, _NOT_YET_VALID, _WRONG_NAMES = 10, 9, (62, 64)
"""X509_V_ERR_… of OpenSSL's x509_vfy.h: the host and the IP address do not match."""


def why_unreachable(settings: ZenohSettings, config: zenoh.Config, error: str) -> str:
    """What is wrong with each endpoint; blocks for up to 2 s for each.

    Args:
        settings: name the endpoints.
        config: what was tried.
        error: what Zenoh says.
    """
    endpoints = settings.connect or tuple(_endpoints(json.loads(config.get_json("connect/endpoints"))))
    if not endpoints or UNABLE not in error:
        return f"Zenoh: {first_sentence(error)}"
    found = [f"{endpoint}: {_why(endpoint, config)}" for endpoint in endpoints[:_MOST]]
    if len(endpoints) > _MOST:
        found.append(f"and {len(endpoints) - _MOST} more")
    return f"no Zenoh router answers: {'; '.join(found)}"


def first_sentence(text: str) -> str:
    """What Zenoh says of an error, on one line, without where in its own code that was."""
    return " ".join(text.partition(" at /")[0].split()).rstrip(".")


def _endpoints(found: Any) -> list[str]:
    """Those of a configuration, which may have them by mode, and each with settings of its own."""
    if isinstance(found, dict):
        found = [endpoint for each in found.values() for endpoint in (each if isinstance(each, list) else [each])]
    return [each for each in found if isinstance(each, str)] if isinstance(found, list) else []


def _why(endpoint: str, config: zenoh.Config) -> str:
    protocol, _, address = endpoint.partition("/")
    host, _, port = address.partition("?")[0].partition("#")[0].rpartition(":")
    host = host.strip("[]")
    if protocol in {"quic", "udp"}:
        return "no answer: is the router running there, and does no firewall drop UDP?"
    if protocol not in {"tcp", "tls", "ws"} or not port.isdecimal():
        return f"no answer: {_REMEDY}"
    try:
        with socket.create_connection((host, int(port)), _WITHIN) as connection:
            if protocol == "tls":
                return _tls(connection, host, json.loads(config.get_json(TLS)) or {})
    except TimeoutError:
        return f"no answer within {_WITHIN:g} s: is it on, and does no firewall drop it?"
    except socket.gaierror as error:
        return f"the name is not known ({error.strerror})"
    except UnicodeError:
        return "no host can be called so: correct the name"
    except ConnectionRefusedError:
        return "nobody listens there: is the router running?"
    except (OSError, OverflowError) as error:
        return getattr(error, "strerror", None) or str(error)
    return f"somebody listens there, and does not speak Zenoh with this side: {_REMEDY}"


def _tls(connection: socket.socket, host: str, settings: dict[str, Any]) -> str:
    """What TLS itself says of the two certificates."""
    shows_own = bool(settings.get("enable_mtls"))
    try:
        context = _context(settings, shows_own=shows_own)
    except (OSError, ValueError) as error:
        return f"the certificates of zenoh.config can't be read: {getattr(error, 'strerror', None) or error}"
    try:
        encrypted = context.wrap_socket(connection, server_hostname=host)
    except ssl.SSLCertVerificationError as error:
        return f"its certificate is refused: {error.verify_message}; {_remedy(error.verify_code)}"
    except OSError:
        return f"no TLS there: is it a Zenoh router, and does it listen for tls? Else the endpoint is tcp/{host}:…"
    try:
        encrypted.settimeout(_WITHIN)
        encrypted.recv(1)  # a router that wants a certificate of ours refuses now
    except ssl.SSLError as error:
        if shows_own:
            return f"it refuses this side's certificate ({_plain(error)}): connect_certificate in zenoh.config"
        return f"it asks for a certificate ({_plain(error)}): enable_mtls and connect_certificate in zenoh.config"
    except OSError:
        pass
    finally:
        encrypted.close()
    return f"TLS works there, and Zenoh does not: {_REMEDY}"


def _context(settings: dict[str, Any], *, shows_own: bool) -> ssl.SSLContext:
    """As Zenoh has it.

    Raises:
        OSError: a file can't be read, or has no certificate.
        ValueError: likewise of what stands in the configuration itself.
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


def _remedy(code: int) -> str:
    """What to change where the router's certificate is refused."""
    if code == _EXPIRED:
        return "renew the router's listen_certificate, or set this machine's clock"
    if code == _NOT_YET_VALID:
        return "set this machine's clock"
    if code in _WRONG_NAMES:
        return "connect by a name that it has, or verify_name_on_connect: false in zenoh.config"
    return "root_ca_certificate in zenoh.config says whose are trusted"


def _plain(error: ssl.SSLError) -> str:
    return (error.reason or "TLS fails").lower().replace("_", " ")
