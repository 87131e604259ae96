"""What a user interface needs of an engine, be it in its own process or attached from elsewhere."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

from rsb_bridge.model.wording import Wording

if TYPE_CHECKING:
    from collections.abc import Callable
    from concurrent.futures import Future
    from pathlib import Path

    from rsb_bridge.model.benchmark import Order, Outcome
    from rsb_bridge.model.history import HistoryReport
    from rsb_bridge.model.session import Client, Session, Topic
    from rsb_bridge.model.snapshot import Event, PeekedMessage, Reloaded, Snapshot, TopicInfo


class Unable(Wording):
    """Reasons why an engine does not do what was asked, whatever its links do."""

    NOT_RUNNING = "the engine is not running"
    STOPPED_BEFORE_START = "the engine was stopped before it had started"
    NOT_A_SERVER = "only a server has clients"
    NO_FILE = "this session is in no file: save it first"


class EngineError(Exception):
    """The engine cannot do what was asked; the message tells the operator why, and what to do."""


class InvalidRequestError(EngineError):
    """The request itself is wrong, for example a misspelt field: to repeat it does not help."""


class ArmingApi(Protocol):
    """What a console may do about topics that have to be armed. Every method may be called from any thread.

    What a console has armed it has to keep armed: it disarms by itself when the console gives no sign of life for 5 s,
    or its operator presses no key within the topic's deadman time.
    """

    def arm(self, key: str) -> Future[None]:
        """Arm a topic; done once both sides hold it for armed."""
        ...

    def disarm(self, key: str) -> Future[None]:
        """Disarm a topic, whoever armed it."""
        ...

    def keep(self, *, pressed: bool) -> Future[None]:
        """Say that this console is there, at least every 2 s while it has armed anything.

        Args:
            pressed: its operator has pressed a key since the last call: the deadman times begin anew.
        """
        ...

    def release(self) -> Future[None]:
        """Disarm what this console has armed, because it goes."""
        ...


class EngineApi(Protocol):
    """An engine as a user interface sees it. Every method may be called from any thread.

    Nothing here waits for the network. Commands return a future; what is wrong with a request comes through it as an
    `EngineError`.

    Attributes:
        read_only: it refuses this console whatever would change anything.
        same_machine: the files that it names are this machine's.
    """

    read_only: bool = False
    same_machine: bool = True

    @property
    def session(self) -> Session:
        """The session as it is now: a client's topics as operators have left them."""
        ...

    @property
    def waits_for_operator(self) -> bool:
        """Whether this side's operator shut a client's link down, so that it does not come back by itself."""
        ...

    @property
    def unreachable(self) -> str:
        """Why the state of an attached engine is not known at present; empty: it is, as it always is in-process."""
        ...

    @property
    def arming(self) -> ArmingApi:
        """Arms and disarms topics, for this console."""
        ...

    def start(self) -> None:
        """Join the ROS domain, and bind or begin to connect; or attach to an engine that has done so.

        Raises:
            EngineError: it cannot, or `stop` was called; nothing is left running.
        """
        ...

    def stop(self, timeout: float = 5.0) -> None:
        """Tell the peers, close everything, end the threads: within `timeout` s, whatever the peers do.

        It also ends a `start` that another thread has not finished yet. An attached engine goes on; only this console
        is gone.
        """
        ...

    def snapshot(self) -> Snapshot:
        """The state of everything at one moment, recent and immutable."""
        ...

    def events(self, after: int = 0) -> list[Event]:
        """The events numbered above `after` that are still remembered, oldest first."""
        ...

    def wait_for_events(self, after: int, timeout: float) -> list[Event]:
        """As `events`, but waits up to `timeout` s for one to come."""
        ...

    def add_topic(self, topic: Topic, link: str = "") -> Future[str]:
        """Bridge one more topic. On a server `link` says with which client. Gives the route's key.

        A server also takes its own name of the topic, with the client's before it (`Session.use_name`).
        """
        ...

    def edit_topic(self, key: str, topic: Topic, *, drop_arm: bool = False) -> Future[str]:
        """Replace a route's topic. Gives the new route's key; if that fails, the old route stays.

        Args:
            key: of the route or the pattern.
            topic: the new entry.
            drop_arm: whether an operator has agreed to end the demand to be armed. Without that, a change from
                ``arm: true`` to false is refused, and any other change keeps the demand.
        """
        ...

    def remove_topic(self, key: str, *, drop_arm: bool = False) -> Future[None]:
        """Stop bridging a topic, on both sides. Its name has to be armed as before, unless `drop_arm` ends that."""
        ...

    def add_client(self, client: Client) -> Future[None]:
        """Let one more client in, on a server; its key file is read where the bridge runs."""
        ...

    def change_client(self, client: Client) -> Future[None]:
        """Put another entry in the place of a server's client of that name; its key file is read again."""
        ...

    def remove_client(self, name: str) -> Future[None]:
        """Let a server's client in no more, and end its link."""
        ...

    def pause(self, key: str, paused: bool) -> Future[None]:
        """Stop or resume carrying a topic's messages, on both sides."""
        ...

    def acknowledge(self, key: str, acknowledged: bool = True, *, link: str = "") -> Future[None]:
        """Acknowledge a fault until its state or its cause changes, or take that back.

        Args:
            key: of a route or a pattern. A route that is down with its link has the link's fault.
            acknowledged: whether the fault is acknowledged from now on.
            link: the name of a link, instead of a key.
        """
        ...

    def retry(self, link: str = "") -> Future[None]:
        """Connect now instead of later, and open refused topics again."""
        ...

    def shut_down(self) -> Future[None]:
        """Do what the shutdown topic does: close the sockets on both sides until an operator restarts."""
        ...

    def restart(self, step: Callable[[str], None] | None = None) -> Future[None]:
        """Close the links on both sides and open them again; `step` is told of each step, on the engine's thread."""
        ...

    def reload(self, *, dry_run: bool = False) -> Future[Reloaded]:
        """Read the session file again, and change what differs; links and topics that do not differ go on.

        What operators have changed since and not saved becomes what the file says, too. A file with mistakes changes
        nothing. With `dry_run` nothing changes anyway.
        """
        ...

    def use_file(self, path: Path | None) -> None:
        """Have `reload` read this session file; None: the session is in no file. An attached engine keeps its own."""
        ...

    def told_to_stop(self) -> None:
        """Record that an operator ends the process that this engine is in."""
        ...

    def history(self, seconds: float) -> Future[HistoryReport]:
        """What happened in the last so many s, 24 h at most: outages, rates, and what operators did."""
        ...

    def topics(self, link: str | None = None) -> Future[list[TopicInfo]]:
        """What can be bridged: of this side's graph, or with `link` of that peer's (of an older one, topics only)."""
        ...

    def peek(self, key: str, *, kept: bool = False) -> Future[PeekedMessage | None]:
        """Wait for a topic's next message. Cancelling the future ends the waiting.

        A topic shows a message every half second at most. Nothing is copied, and nothing added to the messages' way,
        while nobody waits.

        Args:
            key: of the route.
            kept: of a latched topic, take the message that a late joiner gets.

        Returns:
            The message; None: none has passed within some seconds. Ask again to look on.
        """
        ...

    def describe(self, key: str) -> Future[str]:
        """The text of the description of a topic's type (`rsb_bridge.cdr.description`), wherever it is known."""
        ...

    def call(self, key: str, request: str, lane: str = "") -> Future[str]:
        """Call what a route provides, by hand, from either side; its types have to be installed where the bridge runs.

        Args:
            key: of a route that is not a topic's.
            request: its fields, as YAML; empty: their defaults.
            lane: which of the route's services (`RouteSnapshot.lanes`).

        Returns:
            The response, as YAML.
        """
        ...

    def bench(self, order: Order) -> Future[Outcome]:
        """Send some messages over a link, on a topic that no node has, and see what comes.

        It needs the peer's leave (`rsb_bridge.model.benchmark.Leave`). The topic is removed when nothing is ordered for
        some seconds.
        """
        ...

    def template(self, key: str, lane: str = "") -> Future[str]:
        """What `call` may be given: all fields of the request with their defaults, as YAML."""
        ...
