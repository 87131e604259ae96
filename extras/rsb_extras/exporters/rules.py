"""The rules of the exporters' keys in a session, and advice on them."""

from __future__ import annotations

import importlib.util
import shlex
from typing import TYPE_CHECKING

from rsb_bridge.config.advice import interface_problem
from rsb_bridge.config.decoding import show
from rsb_bridge.config.name_rules import name_problems
from rsb_bridge.config.validation import SessionMistake, is_host, is_ip, lacks_zone
from rsb_bridge.feature_api import Wording
from rsb_bridge.model.demands import local_name
from rsb_bridge.model.limits import PORT
from rsb_extras.exporters import DIAGNOSTICS_TOPIC, DRIVER_TOPIC, METRICS, ON_FAULT
from rsb_extras.exporters.fault_command import command_warnings, command_words

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from rsb_bridge.feature_api import Session


class ExporterText(Wording):
    """A mistake in the exporters' keys, or what an operator should know of them."""

    METRICS_HOST_INVALID = "{host} is not an IPv4 or IPv6 address, or a host name"
    DRIVER_TOPIC_TAKEN = "{name} is {use} already: give a name of its own, as /rsb/driver"
    METRICS_NOT_INSTALLED = "not served, because prometheus-client is not installed: pip install 'rsb-console[metrics]'"
    METRICS_OPEN = "no password protects them: everyone who reaches this address can read all names and figures"


class AddressProblem(Wording):
    """A mistake in the address of an HTTP server."""

    NOT_ADDRESS_AND_PORT = '{address!r} is not ADDRESS:PORT, as in 127.0.0.1:9464, or "[::1]:9464" in quotes'
    NO_ADDRESS = (
        "{address!r} names no address: give 127.0.0.1:{port} for programs of this machine, 0.0.0.0:{port} for every "
        "network"
    )
    NO_BRACKETS = '{address!r}: put an IPv6 address in brackets, as in 127.0.0.1:9464, or "[::1]:9464" in quotes'
    INVALID_PORT = "{port!r} is not a port: {range}"


def host_and_port(text: str) -> tuple[str, int]:
    """Split an address into host and port. An IPv6 address is in brackets.

    Raises:
        ValueError: it is no address. The message shows the right form.
    """
    host, colon, port = text.rpartition(":")
    if not colon:
        raise ValueError(AddressProblem.NOT_ADDRESS_AND_PORT(address=text))
    if not host:
        raise ValueError(AddressProblem.NO_ADDRESS(address=text, port=port))
    bracketed = host.startswith("[") and host.endswith("]")
    if ":" in host and not bracketed:
        raise ValueError(AddressProblem.NO_BRACKETS(address=text))
    # isdecimal() takes digits of any script, and int() refuses thousands of them by an error of its own.
    if not (port.isascii() and port.isdecimal() and len(port) <= 5 and int(port) in PORT):
        raise ValueError(AddressProblem.INVALID_PORT(port=port, range=PORT))
    return (host[1:-1] if bracketed else host), int(port)


def is_loopback(host: str) -> bool:
    """Whether only programs of this machine reach it."""
    return host in ("localhost", "::1") or host.startswith("127.")


def problems(session: Session) -> Iterator[tuple[str, str]]:
    """Yield the mistakes, as `Feature.problems`."""
    for key in (DIAGNOSTICS_TOPIC, DRIVER_TOPIC):
        if (name := key.of(session)) is not None:
            yield from ((problem.location, problem.message) for problem in name_problems(name, key.name))
    if (name := DRIVER_TOPIC.of(session)) is not None:
        yield from _taken(session, name)
    if (address := METRICS.of(session)) is not None:
        yield from _metrics(address)
    if (command := ON_FAULT.of(session)) is not None:
        try:
            command_words(command)
        except ValueError as error:
            yield ON_FAULT.name, str(error)


def _taken(session: Session, name: str) -> Iterator[tuple[str, str]]:
    """Whether something else has the driver topic's name: nodes would take its messages for commands, or not at all."""
    on_server, use_name = session.role == "server", session.role == "server" and session.use_name
    lists = [(session.name, session.topics), *((client.name, client.topics) for client in session.listed_clients)]
    bridged = {
        local_name(topic, client, on_server=on_server, use_name=use_name)
        for client, topics in lists
        for topic in topics
        if topic.kind == "topic"
    }
    armed = {each if isinstance(each, str) else each.name for each in session.armed}
    uses = (
        ("the shutdown_topic", {session.shutdown_topic}),
        ("the diagnostics_topic", {DIAGNOSTICS_TOPIC.of(session)}),
        ("bridged", bridged),
        ("to be armed", armed),
    )
    use = next((use for use, names in uses if name in names), None)
    if use is not None:
        yield DRIVER_TOPIC.name, ExporterText.DRIVER_TOPIC_TAKEN(name=name, use=use)


def _metrics(address: str) -> Iterator[tuple[str, str]]:
    try:
        host, _ = host_and_port(address)
    except ValueError as error:
        yield METRICS.name, str(error)
        return
    if not (is_ip(host) or is_host(host)):
        yield METRICS.name, ExporterText.METRICS_HOST_INVALID(host=show(host))
    elif lacks_zone(host):
        yield METRICS.name, SessionMistake.ZONE_MISSING(address=host)


def advice(session: Session, file: Path | None) -> Iterator[tuple[str, str]]:
    """Yield advice, as `Feature.advice`."""
    if (address := METRICS.of(session)) is not None:
        if importlib.util.find_spec("prometheus_client") is None:
            yield METRICS.name, ExporterText.METRICS_NOT_INSTALLED()
        host, _ = host_and_port(address)
        if problem := interface_problem(host):
            yield METRICS.name, problem
        if not is_loopback(host):
            yield METRICS.name, ExporterText.METRICS_OPEN()
    if file is not None and (command := ON_FAULT.of(session)) is not None:
        yield from ((ON_FAULT.name, text) for text in command_warnings(command, file))


def effects(session: Session) -> Iterator[str]:
    """Yield the line of `rsb-console check` about the command."""
    if (command := ON_FAULT.of(session)) is not None:
        yield f"on a fault, {shlex.join(command_words(command))} is run"
