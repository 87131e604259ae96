#!/usr/bin/env bash
# Each client of a service is given the answers to all its clients, and they count against its depth.
#
# ros-rclpy 7.1.6 with rmw_fastrtps_cpp 8.4.3, from PyPI. A client's reader on Fast DDS gets each answer of the service.
# One for another client comes out of `take_response` as None, as if nothing more were there: a program that takes until
# None stops before its own answer. The answers for others also push its own out of the ten that a reader keeps, and
# rclpy's future then never ends. A client that spins seldom, of a service that others call often, feels it;
# `create_client(..., qos_profile=QoSProfile(depth=100))` helps.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
export ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST ROS_DOMAIN_ID=82
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install -q --no-compile --index-url https://pypi.org/simple ros-jazzy-rclpy==7.1.6 ros-rclpy==7.1.6 \
    ros-jazzy-rmw-fastrtps-cpp==8.4.3 ros-fastrtps==2.14.5 ros-jazzy-common-interfaces==5.3.6

cat >program.py <<'PYTHON'
import time
from importlib.metadata import version

from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from std_srvs.srv import SetBool

print("ros-rclpy", version("ros-rclpy"), "ros-fastrtps", version("ros-fastrtps"))


def spinner(name: str) -> tuple[Node, SingleThreadedExecutor]:
    context = Context()
    context.init()
    node = Node(name, context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    return node, executor


def answer(request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
    global answered
    answered += 1
    return response


def call(client, times: int):
    for _ in range(times):
        future, before = client.call_async(SetBool.Request()), answered
        while answered == before:
            serving.spin_once(timeout_sec=0.1)
    time.sleep(0.5)  # until the answers are with both
    return future


answered = 0
server, serving = spinner("server")
service = server.create_service(SetBool, "switch", answer)
(here, spinning), (there, _) = spinner("here"), spinner("there")
mine, theirs = here.create_client(SetBool, "switch"), there.create_client(SetBool, "switch")
mine.wait_for_service()
theirs.wait_for_service()
time.sleep(1)  # until the service knows both

call(theirs, 1)
call(mine, 1)
with mine.handle:
    takes = [mine.handle.take_response(SetBool.Response)[1] is not None for _ in range(3)]
print("after one call of each, my takes give an answer:", takes)
for others in (9, 10):
    future = call(mine, 1)
    call(theirs, others)
    until = time.monotonic() + 5
    while not future.done() and time.monotonic() < until:
        spinning.spin_once(timeout_sec=0.1)
    print(f"answered, then {others} calls of another: my future ends:", future.done())
PYTHON

cat >expected <<'TEXT'
ros-rclpy 7.1.6 ros-fastrtps 2.14.5
after one call of each, my takes give an answer: [False, True, False]
answered, then 9 calls of another: my future ends: True
answered, then 10 calls of another: my future ends: False
TEXT
venv/bin/python program.py | diff expected - && echo "as seen" || { echo "not as seen (< then, > now)"; exit 1; }
