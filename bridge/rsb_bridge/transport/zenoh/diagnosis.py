"""Why a Zenoh network is not reached, in words: Zenoh itself says only that no endpoint could be connected."""

from __future__ import annotations

import json
import socket
import ssl
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import zenoh

    from rsb_bridge.model.session import ZenohSettings

_WITHIN = 2.0
_TLS = "transport/link/tls"
_REMEDY = "is it a Zenoh router, and does it let this side in?"
_MOST = 4
"""Endpoints that are looked at, one after another."""


def why_unreachable(settings: ZenohSettings, config: zenoh.Config, error: str) -> str:
    """What is wrong with each endpoint; blocks for up to 2 s for each.

    Args:
        settings: name the endpoints.
        config: what was tried.
        error: what Zenoh says.
    """
    endpoints = settings.connect or tuple(_endpoints(config))
    if not endpoints or "Unable to connect" not in error:
        return f"Zenoh: {error.partition(' at /')[0].strip().rstrip('.')}"
    found = [f"{endpoint}: {_why(endpoint, config)}" for endpoint in endpoints[:_MOST]]
    return f"no Zenoh router answers: {'; '.join(found)}"


def _endpoints(config: zenoh.Config) -> list[str]:
    found = json.loads(config.get_json("connect/endpoints"))
    return [str(each) for each in found] if isinstance(found, list) else []


def _why(endpoint: str, config: zenoh.Config) -> str:
    protocol, _, address = endpoint.partition("/")
    host, _, port = address.partition("?")[0].partition("#")[0].rpartition(":")
    if protocol not in {"tcp", "tls", "ws"}:
        return "no answer: is the router running there, and does no firewall drop UDP?"
    try:
        with socket.create_connection((host.strip("[]"), int(port)), _WITHIN) as connection:
            if protocol == "tls":
                return _tls(connection, host.strip("[]"), config)
    except TimeoutError:
        return f"no answer within {_WITHIN:g} s: is it on, and does no firewall drop it?"
    except socket.gaierror as error:
        return f"the name is not known ({error.strerror})"
    except ConnectionRefusedError:
        return "nobody listens there: is the router running?"
    except OSError as error:
        return error.strerror or str(error)
    return f"somebody listens there, and does not speak Zenoh with this side: {_REMEDY}"


def _tls(connection: socket.socket, host: str, config: zenoh.Config) -> str:
    """What TLS itself says of the two certificates."""
    settings = json.loads(config.get_json(_TLS))
    try:
        context = ssl.create_default_context(cafile=settings.get("root_ca_certificate"))
        context.check_hostname = settings.get("verify_name_on_connect") is not False
        if settings.get("connect_certificate"):
            context.load_cert_chain(settings["connect_certificate"], settings.get("connect_private_key"))
    except (OSError, ssl.SSLError) as error:
        return f"the certificates of zenoh.config can't be read: {error.strerror or error}"
    try:
        with context.wrap_socket(connection, server_hostname=host) as encrypted:
            encrypted.settimeout(_WITHIN)
            encrypted.recv(1)  # a router that wants a certificate of ours refuses now
    except ssl.SSLCertVerificationError as error:
        why = f"its certificate is refused: {error.verify_message}"
        return f"{why}; root_ca_certificate in zenoh.config says whose are trusted"
    except ssl.SSLError as error:
        if "CERTIFICATE" in (error.reason or "") or "ALERT" in (error.reason or ""):
            return "it refuses this side's certificate: connect_certificate in zenoh.config says which that is"
        return f"TLS fails: {error.reason or error}"
    except TimeoutError:
        pass
    return f"TLS works there, and Zenoh does not: {_REMEDY}"
