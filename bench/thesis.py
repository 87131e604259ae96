"""The thesis's own pipeline, rebuilt from its description for comparison only.

Typed subscription on the stock executor, pickle, Fernet, a separator between messages, one recv(1024) loop, typed
publisher. ``python -m bench.thesis send|receive DOMAIN TOPIC PORT KEY``
"""

from __future__ import annotations

import contextlib
import pickle
import socket
import sys
import threading

import rclpy
from cryptography.fernet import Fernet
from rclpy.qos import QoSProfile
from std_msgs.msg import String

_SEPARATOR = b"_split_"
_QOS = QoSProfile(depth=2000)


def main() -> None:
    part, domain, topic, port, key = sys.argv[1:]
    rclpy.init(domain_id=int(domain))
    node = rclpy.create_node(f"thesis_{part}")
    fernet = Fernet(key.encode())
    if part == "send":
        connection = socket.create_connection(("127.0.0.1", int(port)))

        def forward(message: String) -> None:
            connection.sendall(fernet.encrypt(pickle.dumps(message)) + _SEPARATOR)

        node.create_subscription(String, topic, forward, _QOS)
    else:
        publisher = node.create_publisher(String, topic, _QOS)
        listener = socket.create_server(("127.0.0.1", int(port)))

        def receive() -> None:
            connection, _ = listener.accept()
            buffer = b""
            while data := connection.recv(1024):
                buffer += data
                *whole, buffer = buffer.split(_SEPARATOR)
                for token in whole:
                    publisher.publish(pickle.loads(fernet.decrypt(token)))  # as the thesis does it

        threading.Thread(target=receive, daemon=True).start()
    print("ready", flush=True)
    with contextlib.suppress(KeyboardInterrupt, rclpy.executors.ExternalShutdownException):
        rclpy.spin(node)


if __name__ == "__main__":
    main()
