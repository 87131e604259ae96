"""The least that two processes between two domains cost, for comparison: they take raw, pass bytes on, and publish raw.

No cipher, no limits, no counts, nothing but one topic or service.

- ``python -m bench.bare send|receive DOMAIN TOPIC PORT``: over TCP
- ``python -m bench.bare serve|call DOMAIN SERVICE PORT TYPE``: the callers' side, and the side of the node that answers
"""

from __future__ import annotations

import itertools
import socket
import struct
import sys
import threading
from typing import TYPE_CHECKING

from bench.relay import node_in
from rclpy.qos import QoSProfile
from std_msgs.msg import String

from rsb_bridge.ros.node import RosNode
from rsb_extras.bench.measured_stream import DEPTH, drain

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from rsb_bridge.ros.ros_interface import Request, Response

_LENGTH = struct.Struct("<I")
_READ = 256 * 1024


def main() -> None:
    part, domain, name, port, *type_name = sys.argv[1:]
    match part:
        case "send":
            send_all(int(domain), name, _tcp_sender(int(port)))
        case "receive":
            publish = publisher(int(domain), name)
            _read(_accept(int(port)), publish)
        case "serve":
            _serve(_node(int(domain), part), name, type_name[0], _connect(int(port)))
        case "call":
            _call(_node(int(domain), part), name, type_name[0], _accept(int(port)))


def publisher(domain: int, topic: str) -> Callable[[bytes], None]:
    """Return what publishes raw messages."""
    publish: Callable[[bytes], None] = (
        node_in(domain).create_publisher(String, topic, QoSProfile(depth=DEPTH)).handle.publish_raw
    )
    return publish


def send_all(domain: int, topic: str, send: Callable[[bytes], object]) -> None:
    """Pass on each message of a topic until standard input ends."""
    node = node_in(domain)
    subscription = node.create_subscription(String, topic, lambda _: None, QoSProfile(depth=DEPTH), raw=True)

    def until_told() -> None:
        sys.stdin.read()
        node.context.try_shutdown()

    threading.Thread(target=until_told, daemon=True).start()
    print("ready", flush=True)
    drain(node.context, [subscription.handle], send)


def _connect(port: int) -> socket.socket:
    connection = socket.create_connection(("127.0.0.1", port))
    # Without NODELAY, a small message waits for the acknowledgement of the one before (Nagle).
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return connection


def _accept(port: int) -> socket.socket:
    with socket.create_server(("127.0.0.1", port)) as listener:
        print("ready", flush=True)
        connection, _ = listener.accept()
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return connection


def _tcp_sender(port: int) -> Callable[[bytes], None]:
    write = _connect(port).sendall
    return lambda payload: write(_LENGTH.pack(len(payload)) + payload)


def _read(connection: socket.socket, take: Callable[[bytes], object]) -> None:
    buffer = bytearray()
    while data := connection.recv(_READ):
        buffer += data
        at = 0
        while len(buffer) - at >= _LENGTH.size:
            end = at + _LENGTH.size + _LENGTH.unpack_from(buffer, at)[0]
            if end > len(buffer):
                break
            take(bytes(memoryview(buffer)[at + _LENGTH.size : end]))
            at = end
        del buffer[:at]


def _node(domain: int, part: str) -> RosNode:
    node = RosNode(domain, f"bare_{part}")
    node.start()
    return node


def _write(connection: socket.socket, number: int, payload: bytes) -> None:
    connection.sendall(_LENGTH.pack(_LENGTH.size + len(payload)) + _LENGTH.pack(number) + payload)


def _serve(node: RosNode, service: str, type_name: str, connection: socket.socket) -> None:
    """Pass requests on, each with a number, and answer them."""
    numbers, callers = itertools.count(), dict[int, bytes]()

    def ask(requests: Sequence[Request]) -> None:
        for request in requests:
            number = next(numbers)
            callers[number] = request.caller
            _write(connection, number, request.payload)

    def answer(data: bytes) -> None:
        server.answer(callers.pop(_LENGTH.unpack_from(data)[0]), data[_LENGTH.size :])

    server = node.serve(service, type_name, _hash(node, type_name), ask)
    print("ready", flush=True)
    _read(connection, answer)


def _call(node: RosNode, service: str, type_name: str, connection: socket.socket) -> None:
    """Call for the other side, and return the answers with its numbers."""
    numbers = dict[int, int]()
    noted = threading.Lock()  # an answer may come before its call's number is written down

    def call(data: bytes) -> None:
        with noted:
            numbers[client.call(data[_LENGTH.size :])] = _LENGTH.unpack_from(data)[0]

    def answer(responses: Sequence[Response]) -> None:
        for response in responses:
            with noted:
                number = numbers.pop(response.number)
            _write(connection, number, response.payload)

    client = node.call_service(service, type_name, _hash(node, type_name), answer)
    _read(connection, call)


def _hash(node: RosNode, type_name: str) -> str:
    type_hash = node.installed_service_hash(type_name)
    assert type_hash is not None
    return type_hash


if __name__ == "__main__":
    main()
