"""A Fibonacci action's server and client as a robot's own programs have them: typed, each spun by a thread.

`python -m tests.support.fibonacci DOMAIN` is a server in a process of its own, which computes what it is asked for: a
number every 0.1 s, with feedback.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from typing import TYPE_CHECKING, Any, Self

import pytest
from tests.support.forker import Forked
from tests.support.spun import Spun
from tests.support.waiting import eventually

pytest.importorskip("test_msgs", reason="no package with an action is installed (ros-jazzy-test-msgs)")

from action_msgs.msg import GoalStatus
from rclpy.action import ActionClient, ActionServer, CancelResponse, GoalResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from test_msgs.action import Fibonacci

if TYPE_CHECKING:
    from collections.abc import Callable

    from rclpy.action.client import ClientGoalHandle
    from rclpy.action.server import ServerGoalHandle
    from rclpy.task import Future

ACTION = "/fibonacci"
TYPE = "test_msgs/action/Fibonacci"
STATES = {
    GoalStatus.STATUS_UNKNOWN: "unknown",
    GoalStatus.STATUS_ACCEPTED: "accepted",
    GoalStatus.STATUS_EXECUTING: "executing",
    GoalStatus.STATUS_CANCELING: "canceling",
    GoalStatus.STATUS_SUCCEEDED: "succeeded",
    GoalStatus.STATUS_CANCELED: "canceled",
    GoalStatus.STATUS_ABORTED: "aborted",
}


class FibonacciServer(Spun):
    """Accepts goals, and does with them what the test says.

    Args:
        result_timeout: s that it keeps results; rcl_action's default.
        accepts: whether it accepts goals.
        hesitates: whether it answers no goal until the test allows it.

    Attributes:
        goals: the accepted ones, in order.
        orders: the orders of all goals, rejected ones too.
        cancels: the ids of goals that were to be cancelled, in order.
        log: goals and cancels in the order in which they came, in words.
        hesitates: set while it answers to no goal.
    """

    threads = 8

    def __init__(
        self, domain_id: int, *, result_timeout: float = 10.0, accepts: bool = True, hesitates: bool = False
    ) -> None:
        self.goals: list[ServerGoalHandle] = []
        self.orders: list[int] = []
        self.cancels: list[str] = []
        self.log: list[str] = []
        self.hesitates = threading.Event()
        if hesitates:
            self.hesitates.set()
        self._accepts = accepts
        self._result_timeout = result_timeout
        self._ends: dict[str, threading.Event] = {}
        self._results: dict[str, tuple[str, list[int]]] = {}
        super().__init__(domain_id, "fibonacci_server", start_parameter_services=False)

    def _create(self) -> None:
        self._server = ActionServer(
            self.node,
            Fibonacci,
            ACTION,
            self._execute,
            goal_callback=self._asked,
            handle_accepted_callback=self._accepted,
            cancel_callback=self._cancel,
            callback_group=ReentrantCallbackGroup(),
            result_timeout=self._result_timeout,
        )

    def goal(self, number: int = 0) -> ServerGoalHandle:
        """A goal, once it has been accepted."""
        return eventually(lambda: self.goals[number] if len(self.goals) > number else None, what=f"goal {number}")

    def number_of(self, goal: Goal) -> int:
        """A client's goal, by the order in which goals were accepted."""
        wanted = id_of(goal.handle())
        return eventually(lambda: next((i + 1 for i, each in enumerate(self.goals) if id_of(each) == wanted), 0)) - 1

    @property
    def remembers(self) -> set[str]:
        """The ids of goals whose results it still has, or will have."""
        return {goal.hex() for goal in tuple(self._server._goal_handles)}

    def feedback(self, *sequence: int, number: int = 0) -> None:
        self.goal(number).publish_feedback(Fibonacci.Feedback(sequence=sequence))

    @property
    def is_heard(self) -> bool:
        """Whether somebody listens to feedback."""
        return bool(self.node.count_subscribers(f"{ACTION}/_action/feedback"))

    def finish(self, *sequence: int, number: int = 0, state: str = "succeeded") -> None:
        goal = id_of(self.goal(number))
        self._results[goal] = (state, list(sequence))
        self._ends[goal].set()

    def close(self) -> None:
        for event in self._ends.values():
            event.set()
        eventually(lambda: not any(goal.is_active for goal in self.goals), what="all goals are over")
        super().close()

    def _destroy(self) -> None:
        self._server.destroy()

    def _asked(self, goal: Any) -> GoalResponse:
        self.log.append(f"goal {goal.order}")
        self.orders.append(goal.order)
        eventually(lambda: not self.hesitates.is_set())
        return GoalResponse.ACCEPT if self._accepts else GoalResponse.REJECT

    def _accepted(self, handle: ServerGoalHandle) -> None:
        self._ends[id_of(handle)] = threading.Event()
        self.goals.append(handle)
        handle.execute()

    def _cancel(self, handle: ServerGoalHandle) -> CancelResponse:
        self.cancels.append(id_of(handle))
        self.log.append(f"cancel {id_of(handle)}")
        return CancelResponse.ACCEPT

    def _execute(self, handle: ServerGoalHandle) -> Any:
        self._ends[id_of(handle)].wait()
        state, sequence = self._results.get(id_of(handle), ("aborted", []))
        {"succeeded": handle.succeed, "canceled": handle.canceled, "aborted": handle.abort}[state]()
        return Fibonacci.Result(sequence=sequence)


class FibonacciProcess:
    """A server in a process of its own."""

    def __init__(self, domain_id: int, start: Callable[..., Any] = Forked) -> None:
        self._process = start("tests.support.fibonacci", str(domain_id), stdout=subprocess.PIPE)
        assert self._process.stdout
        assert self._process.stdout.readline() == "ready\n"

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        """Leave the domain in any state."""
        self._end(signal.SIGTERM)

    def kill(self) -> None:
        """kill -9: others see its endpoints for another 20 s."""
        self._end(signal.SIGKILL)

    def _end(self, number: signal.Signals) -> None:
        if self._process.poll() is None:
            self._process.send_signal(number)
            self._process.communicate()


class _Computing(FibonacciServer):
    def _execute(self, handle: ServerGoalHandle) -> Any:
        sequence = [0, 1]
        for _ in range(handle.request.order):
            if handle.is_cancel_requested:
                handle.canceled()
                return Fibonacci.Result(sequence=sequence)
            time.sleep(0.1)
            sequence.append(sequence[-1] + sequence[-2] & 0x7FFFFFFF)
            handle.publish_feedback(Fibonacci.Feedback(sequence=sequence))
        handle.succeed()
        return Fibonacci.Result(sequence=sequence)

    def leave(self) -> None:
        """Leave the domain in any state."""
        self.context.shutdown()
        self._thread.join()
        self._destroy()
        self.node.destroy_node()
        self.context.destroy()
        os._exit(0)


def fibonacci(order: int) -> list[int]:
    """Return the sequence that a `FibonacciProcess` computes."""
    sequence = [0, 1]
    for _ in range(order):
        sequence.append(sequence[-1] + sequence[-2] & 0x7FFFFFFF)
    return sequence


class Goal:
    """A goal as its client sees it."""

    def __init__(self, client: ActionClient, order: int) -> None:
        self.feedbacks: list[list[int]] = []
        self._sent = client.send_goal_async(
            Fibonacci.Goal(order=order), lambda message: self.feedbacks.append(list(message.feedback.sequence))
        )
        self._result: Future | None = None

    @property
    def answered(self) -> bool:
        """Whether it was accepted or rejected."""
        done: bool = self._sent.done()
        return done

    def handle(self) -> ClientGoalHandle:
        """Once the server has answered."""
        eventually(self._sent.done, what="the goal is accepted or rejected")
        return self._sent.result()

    def ask(self) -> Goal:
        """Ask for its result, now; `result` waits for it."""
        self._result = self.handle().get_result_async()
        return self

    def result(self) -> tuple[str, list[int]]:
        """Return the goal's final state and its sequence."""
        assert self._result is not None
        eventually(self._result.done, what="a result")
        answer = self._result.result()
        return STATES[answer.status], list(answer.result.sequence)

    @property
    def has_result(self) -> bool:
        return self._result is not None and self._result.done()

    def cancel(self) -> Future:
        return self.handle().cancel_goal_async()


class _ActionClient(ActionClient):  # type: ignore[misc]  # rclpy has no types
    """rclpy notes what it asks for only after it has asked: no answer may be looked at in between, or it is ignored."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        self._asking = threading.Lock()
        super().__init__(*args, **kwargs)

    def send_goal_async(self, *args: Any, **kwargs: Any) -> Future:
        with self._asking:
            return super().send_goal_async(*args, **kwargs)

    def _cancel_goal_async(self, goal_handle: ClientGoalHandle) -> Future:
        with self._asking:
            return super()._cancel_goal_async(goal_handle)

    def _get_result_async(self, goal_handle: ClientGoalHandle) -> Future:
        with self._asking:
            return super()._get_result_async(goal_handle)

    async def execute(self, taken_data: Any) -> None:
        with self._asking:
            pass  # the caller has noted it
        await super().execute(taken_data)


class FibonacciClient(Spun):
    threads = 8

    def __init__(self, domain_id: int) -> None:
        super().__init__(domain_id, "fibonacci_client", start_parameter_services=False)

    def _create(self) -> None:
        self.client = _ActionClient(self.node, Fibonacci, ACTION, callback_group=ReentrantCallbackGroup())

    def _destroy(self) -> None:
        self.client.destroy()

    @property
    def ready(self) -> bool:
        """Whether the condition of `ActionClient.wait_for_server` holds."""
        ready: bool = self.client.server_is_ready()
        return ready

    def send(self, order: int = 5) -> Goal:
        eventually(lambda: self.ready, what="an action server")
        return Goal(self.client, order)


def id_of(handle: Any) -> str:
    """A goal's id, as snapshots have it."""
    return bytes(handle.goal_id.uuid).hex()


def main() -> None:
    """Serve until a signal comes."""
    signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGTERM])
    server = _Computing(int(sys.argv[1]))
    print("ready", flush=True)  # noqa: T201
    signal.sigwait([signal.SIGTERM])
    server.leave()


if __name__ == "__main__":
    main()
