"""Actions of a world: clients at the near end, and a server at the far end."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING, Any

from tests.simulation.action_server import CDR, SERVICES, ActionServer, Plan, lane_type, names
from tests.simulation.flow import CallFlow
from tests.simulation.goals import Asked, Goal
from tests.simulation.ros import Reader
from tests.simulation.services import Client

from rsb_bridge.model.calls import CANCEL_GOAL, FEEDBACK, GET_RESULT, LANES, SEND_GOAL, STATUS
from rsb_bridge.route.calls.goals import STATES

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from rsb_bridge.ros.ros_interface import RawMessage, Response

_ID = struct.Struct("<4sIII")
_ASKED_AGAIN_EVERY = 1.0
"""s until a client looks whether the server that it asked is gone, and asks again."""
_REMEMBERED = 2000


class ActionFlow(CallFlow[ActionServer]):
    """An action, with its client and its server.

    Its period may be 0: it sends no goals by itself.

    Attributes:
        asks_again: whether its clients repeat requests whose server is gone, as those of rclpy do not.
        explains: whether events of the world explain that a goal's result is unknown.
        log: goals and cancels that reached its servers, in order: ``goal`` or ``cancel``, and the goal.
    """

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.goals: dict[bytes, Goal] = {}
        self.heard = b""
        self.asks_again = True
        self.explains: Callable[[Goal], bool] = lambda _: True
        self.log: list[tuple[str, Goal]] = []
        self.near_services = [names(self.near_name)[lane] for lane in SERVICES]
        self.far_services = [names(self.far_name)[lane] for lane in SERVICES]
        self._life = 0
        self._sent = 0
        self._clients: dict[int, Client] = {}
        self._readers: list[Reader] = []
        self._calls: dict[tuple[int, int], Goal] = {}  # that wait for their answers, by lane and number

    def __str__(self) -> str:
        return f"{self.robot}'s action {self.near_name}"

    # --- the nodes at its ends

    def _new_server(self) -> ActionServer:
        return ActionServer(self.far, self.far_name, f"/doer{self.number}", self)

    def call(self) -> None:
        """Start a new client in place of the previous one; it knows none of the earlier goals."""
        for client in self._clients.values():
            client.close()
        for reader in self._readers:
            reader.close()
        self._life += 1
        self._calls.clear()
        self.heard = b""
        called, node = names(self.near_name), f"/client{self.number}"
        takes = {SEND_GOAL: self._take_answer, CANCEL_GOAL: self._take_cancelled, GET_RESULT: self._take_result}
        self._clients = {
            lane: Client(self.near.services, node, called[lane], *lane_type(lane), take) for lane, take in takes.items()
        }
        hears = {FEEDBACK: self._hear_feedback, STATUS: self._hear_status}
        self._readers = [
            Reader(self.near, node, called[lane], *lane_type(lane), qos, hear)
            for lane, hear in hears.items()
            if (qos := LANES["action"][lane].qos) is not None
        ]
        life = self._life
        self._later(_ASKED_AGAIN_EVERY, self._ask_again, life)
        if self.period:
            self._later(self._random.uniform(0.0, self.period), self._beat, life)

    def rest(self) -> None:
        self.period = 0.0

    def busy(self, period: float) -> None:
        self.period = period
        self._beat(self._life)

    def _beat(self, life: int) -> None:
        if life != self._life or not self.period:
            return
        for _ in range(self._random.choice((1, 1, 1, 4))):
            goal = self.send(self._plan())
            if goal is not None and self._random.random() < 0.3:
                after = self._random.uniform(0.0, 2.0 * goal.plan.runs)
                self._later(after, self._cancel_if, life, goal)
        self._soon_again(self._beat, life)

    def _plan(self) -> Plan:
        random = self._random
        if self._slow:
            after = random.choice((None, random.uniform(0.0, 20.0), random.uniform(0.0, 5.0)))
        else:
            after = random.uniform(0.0, 0.1)
        runs = random.choice((random.uniform(0.1, 5.0), random.uniform(1.0, 40.0), random.uniform(10.0, 200.0)))
        return Plan(random.random() < 0.9, after, runs, random.choice(("succeeded", "succeeded", "aborted")))

    # --- what clients do

    @property
    def ready(self) -> bool:
        return self._clients[SEND_GOAL].ready and self.answers

    @property
    def answers(self) -> bool:
        """Whether its clients see a server that they can ask about goals."""
        return self._clients[GET_RESULT].ready and self._clients[CANCEL_GOAL].ready

    def send(self, plan: Plan | None = None) -> Goal | None:
        """Send a goal, and return it, or None if the client sees no server."""
        plan = plan or Plan()
        if not self.ready:
            return None
        self._sent += 1
        goal = Goal(_ID.pack(b"goal", self.number, self._life, self._sent), plan, self._loop.time(), self._life)
        if len(self.goals) >= _REMEMBERED:
            del self.goals[next(iter(self.goals))]
        self.goals[goal.id] = goal
        self._calls[SEND_GOAL, self._clients[SEND_GOAL].call(CDR + goal.id + bytes(self._random.randrange(500)))] = goal
        return goal

    def cancel(self, goal: Goal) -> None:
        goal.cancel = goal.cancel or Asked()
        self._ask(CANCEL_GOAL, goal, goal.cancel, CDR + goal.id + bytes(8))

    def _cancel_if(self, life: int, goal: Goal) -> None:
        if life == self._life and goal.told and not goal.result:
            self.cancel(goal)

    def ask_result(self, goal: Goal) -> None:
        goal.asks = goal.asks or Asked()
        self._ask(GET_RESULT, goal, goal.asks, CDR + goal.id)

    def _ask(self, lane: int, goal: Goal, asked: Asked, request: bytes) -> None:
        client = self._clients[lane]
        if client.ready:
            asked.at, asked.servers = self._loop.time(), [each for each in client.matched if not each.closed]
            self._calls[lane, client.call(request)] = goal

    def _ask_again(self, life: int) -> None:
        """Repeat requests whose server is gone because the client's bridge was restarted."""
        if life != self._life or not self.asks_again:
            return
        for goal in [each for each in self.goals.values() if each.client == life and each.told and not each.result]:
            if goal.cancel is not None and goal.cancel.is_lost:
                self.cancel(goal)
            if goal.asks is not None and goal.asks.is_lost:
                self.ask_result(goal)
        self._later(_ASKED_AGAIN_EVERY, self._ask_again, life)

    def waiting(self) -> list[Goal]:
        """The goals of the present client that were accepted, and whose result has not come."""
        return [each for each in self.goals.values() if each.client == self._life and each.told and not each.result]

    @property
    def goes_on(self) -> bool:
        return self.server is not None and any(self.server.runs(each) for each in self.goals)

    def to_cancel(self) -> list[Goal]:
        """The goals of the present client that go on, though it has asked for their cancel."""
        return [
            each
            for each in self.waiting()
            if each.cancel is not None and each.cancel.at is not None and not each.cancelled
            if self.server is not None and self.server.runs(each.id)
        ]

    # --- what clients hear

    def _asked(self, lane: int, response: Response) -> Goal | None:
        goal = self._calls.pop((lane, response.number), None)
        if goal is None:
            self._on_wrong(f"{self}: an answer to nothing, or a second one: {lane} {response}")
        return goal

    def _take_answer(self, batch: Sequence[Response]) -> None:
        for response in batch:
            if (goal := self._asked(SEND_GOAL, response)) is None:
                return
            goal.told = response.payload[4] != 0
            if goal.told != (goal.server is not None) and goal.arrived:
                self._on_wrong(f"{self}: the client of {goal} is told {goal.told}, its server said {goal.server}")
            if goal.told and not goal.arrived:
                self._on_wrong(f"{self}: {goal} is accepted, and no server has seen it")
            if goal.told:
                self.ask_result(goal)

    def _take_cancelled(self, batch: Sequence[Response]) -> None:
        for response in batch:
            if (goal := self._asked(CANCEL_GOAL, response)) is None:
                return
            assert goal.cancel is not None
            goal.cancel.done = True
            if response.payload != CDR + goal.id:
                self._on_wrong(f"{self}: {goal} got the answer to another's cancel: {response.payload!r}")
            elif not goal.cancelled:
                self._on_wrong(f"{self}: the cancel of {goal} is answered, and no server has seen it")

    def _take_result(self, batch: Sequence[Response]) -> None:
        for response in batch:
            if (goal := self._asked(GET_RESULT, response)) is None:
                return
            assert goal.asks is not None
            goal.asks.done = True
            goal.result, about = STATES[response.payload[4]], response.payload[5:]
            self.answered += 1
            if goal.result == "unknown":
                if not self.explains(goal):
                    self._on_wrong(f"{self}: the result of {goal} is unknown, and nothing explains that")
            elif about != goal.id:
                self._on_wrong(f"{self}: {goal} got the result of another goal: {about!r}")
            elif goal.result != goal.state:
                self._on_wrong(f"{self}: {goal} got the result {goal.result}, and is {goal.state or 'not over'}")

    def _hear_feedback(self, batch: Sequence[RawMessage]) -> None:
        for message in batch:
            goal, part = self.goals.get(message.payload[4:20]), message.payload[20]
            if goal is None or goal.server is None or part <= goal.fed:
                self._on_wrong(f"{self}: feedback {part} of {goal}, after {goal.fed if goal else 'nothing'}")
            else:
                goal.fed = part

    def _hear_status(self, batch: Sequence[RawMessage]) -> None:
        self.heard = batch[-1].payload

    # --- what the server says: `tests.simulation.action_server.ActionServer`

    def arrived(self, server: ActionServer, goal: bytes) -> Plan:
        known = self.goals[goal]
        known.arrived += 1
        self.log.append(("goal", known))
        if known.arrived > 1:
            self._on_wrong(f"{self}: {known} came to the server {known.arrived} times")
        if known.told is not None:
            self._on_wrong(f"{self}: {known} came to the server after its client got the answer {known.told}")
        return known.plan

    def accepted(self, server: ActionServer, goal: bytes) -> None:
        if self.goals[goal].told is not None:
            self._on_wrong(f"{self}: {self.goals[goal]} begins after its client got the answer {self.goals[goal].told}")
        self.goals[goal].server = server

    def ended(self, goal: bytes, state: str) -> None:
        known = self.goals[goal]
        known.state, known.ended = state, self._loop.time()

    def cancelled(self, goal: bytes) -> None:
        known = self.goals[goal]
        known.cancelled = True
        self.log.append(("cancel", known))
        if known.cancel is None:
            self._on_wrong(f"{self}: {known} is cancelled, and nobody asked for that")
