"""The least that can stand between a service's clients and its server in another domain, for comparison.

One process, no link, no limits, no timeouts: requests and responses are handed on as bytes, by the calls into ROS that
the bridge makes, too. ``python -m bench.proxy NEAR FAR SERVICE TYPE``
"""

from __future__ import annotations

import sys
import threading
from typing import TYPE_CHECKING

from rsb_bridge.ros.node import RosNode

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rsb_bridge.ros.ros_interface import Request, Response


def main() -> None:
    near_domain, far_domain, service, type_name = sys.argv[1:]
    near, far = (RosNode(int(domain), f"proxy{domain}") for domain in (near_domain, far_domain))
    near.start()
    far.start()
    type_hash = near.installed_service_hash(type_name)
    assert type_hash is not None
    waiting: dict[int, bytes] = {}
    numbered = threading.Lock()  # an answer may come before its call's number is written down

    def ask(requests: Sequence[Request]) -> None:
        for request in requests:
            with numbered:
                waiting[client.call(request.payload)] = request.caller

    def answer(responses: Sequence[Response]) -> None:
        for response in responses:
            with numbered:
                caller = waiting.pop(response.number)
            server.answer(caller, response.payload)

    client = far.call_service(service, type_name, type_hash, answer)
    server = near.serve(service, type_name, type_hash, ask)
    sys.stdin.read()


if __name__ == "__main__":
    main()
