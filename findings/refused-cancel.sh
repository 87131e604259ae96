#!/usr/bin/env bash
# An action server that refuses to cancel says that there was no error.
#
# ros-rclpy 7.1.6, from PyPI. `action_msgs/srv/CancelGoal` has ERROR_REJECTED for it. rclpy's default callback refuses each
# cancel, and the response then has ERROR_NONE and an empty list of goals that are being cancelled: only the list tells. A client that asks the code alone believes that the robot
# is about to stop.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
export ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST ROS_DOMAIN_ID=83
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install -q --no-compile --index-url https://pypi.org/simple ros-jazzy-rclpy==7.1.6 ros-rclpy==7.1.6 \
    ros-jazzy-rmw-fastrtps-cpp==8.4.3 ros-jazzy-test-msgs==2.0.3

cat >program.py <<'PYTHON'
import threading
from importlib.metadata import version

import rclpy
from action_msgs.srv import CancelGoal
from rclpy.action import ActionClient, ActionServer
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import MultiThreadedExecutor
from test_msgs.action import Fibonacci

print("ros-rclpy", version("ros-rclpy"))
rclpy.init()
node = rclpy.create_node("both")
may_end = threading.Event()


def execute(goal):
    may_end.wait()
    goal.succeed()
    return Fibonacci.Result()


server = ActionServer(node, Fibonacci, "go", execute, callback_group=ReentrantCallbackGroup())
client = ActionClient(node, Fibonacci, "go", callback_group=ReentrantCallbackGroup())
executor = MultiThreadedExecutor(4)
executor.add_node(node)


def result_of(future):
    executor.spin_until_future_complete(future)
    return future.result()


client.wait_for_server()
goal = result_of(client.send_goal_async(Fibonacci.Goal()))
answer = result_of(goal.cancel_goal_async())
codes = {getattr(CancelGoal.Response, name): name for name in ("ERROR_NONE", "ERROR_REJECTED")}
print("cancel:", codes[answer.return_code], "goals that are being cancelled:", len(answer.goals_canceling))
may_end.set()
print("the goal has ended as succeeded:", result_of(goal.get_result_async()).status == 4)
PYTHON

cat >expected <<'TEXT'
ros-rclpy 7.1.6
cancel: ERROR_NONE goals that are being cancelled: 0
the goal has ended as succeeded: True
TEXT
venv/bin/python program.py | diff expected - && echo "as seen" || { echo "not as seen (< then, > now)"; exit 1; }
