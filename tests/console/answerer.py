"""A node with a service and a parameter, which runs until SIGTERM. usage: python answerer.py DOMAIN NODE SERVICE

The service is std_srvs/srv/SetBool, and the parameter a double, ``speed``, of at most 1.
"""

import signal
import sys
import threading
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from std_srvs.srv import SetBool


def _main(domain: int, name: str, service: str) -> None:
    stopping = threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: stopping.set())
    context = Context()
    context.init([], domain_id=domain)
    node = Node(name, context=context, enable_rosout=False, use_global_arguments=False)
    node.declare_parameter("speed", 0.5)

    def answer(request: Any, response: Any) -> Any:
        response.success, response.message = True, f"moved {'on' if request.data else 'off'}"
        return response

    def check(parameters: Any) -> SetParametersResult:
        too_fast = any(each.value > 1 for each in parameters)
        return SetParametersResult(successful=not too_fast, reason="too fast" if too_fast else "")

    node.create_service(SetBool, service, answer)
    node.add_on_set_parameters_callback(check)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    while not stopping.is_set():
        executor.spin_once(0.1)
    executor.shutdown()
    node.destroy_node()
    context.shutdown()


if __name__ == "__main__":
    _main(int(sys.argv[1]), sys.argv[2], sys.argv[3])
