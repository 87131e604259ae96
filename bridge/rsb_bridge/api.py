"""The interface of an engine to consoles, whether it runs in this process or another one."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, Self

from rsb_bridge.model import commands
from rsb_bridge.model.wording import Wording

if TYPE_CHECKING:
    from collections.abc import Callable
    from concurrent.futures import Future
    from pathlib import Path

    from rsb_bridge.model.by_hand import Held
    from rsb_bridge.model.commands import Command, R
    from rsb_bridge.model.session import Client, Session, Topic
    from rsb_bridge.model.snapshot import Event, PeekedMessage, Reloaded, Snapshot, State, TopicInfo


class Unable(Wording):
    """Reasons why an engine refuses any command, or one about clients or files."""

    INTERNAL = "internal error, please report it: {problem}"
    NOT_RUNNING = "the engine is not running"
    STOPPED_BEFORE_START = "the engine was stopped before it had started"
    NOT_A_SERVER = "only a server has clients"
    NO_FILE = "this session has no file yet: save it first"
    SAVED_ELSEWHERE = "its key files are in another folder than its file: save it in the bridge's own console (w)"
    DISK_SILENT = "the session's files are not read within {seconds:g} s: look at their disk"
    TOO_LATE = "not done: it waited too long behind another change; give it again"
    RELOADS_OTHER = "nothing is reloaded: the file or the bridge was changed meanwhile, look again"


class EngineError(Exception):
    """The engine cannot execute a command; the message tells the operator the reason and the remedy."""


class NoAnswerError(EngineError):
    """The answer to a command has not come: the engine may have executed it."""


class InvalidRequestError(EngineError):
    """The request itself is wrong, for example a misspelt field: to repeat it does not help."""


class EngineApi(ABC):
    """An engine as a console sees it. Every method may be called from any thread.

    Nothing here waits for the network. Commands return a future, whose exception is an `EngineError`.

    Attributes:
        read_only: whether the engine refuses this console all changes.
        may_take: whether this console may take an arming from its holder without asking.
        trusted: whether the engine runs on this machine, as this user or root: what it says is taken as it is, and the
            files that it names are used.
    """

    read_only: bool = False
    may_take: bool = True
    trusted: bool = True

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    @property
    @abstractmethod
    def session(self) -> Session:
        """The session with the topics and clients that operators have changed since it was loaded."""

    @property
    @abstractmethod
    def waits_for_operator(self) -> bool:
        """Whether this side's operator shut a client's link down, so that it does not come back by itself."""

    @property
    @abstractmethod
    def unreachable(self) -> str:
        """The reason the state of an attached engine is unknown at present, or an empty string."""

    @abstractmethod
    def start(self) -> None:
        """Join the ROS domain, and bind or begin to connect; or attach to an engine that has done so.

        Raises:
            EngineError: it cannot, or `stop` was called; nothing is left running.
        """

    @abstractmethod
    def stop(self, timeout: float = 5.0) -> None:
        """Tell the peers, close everything, and end the threads within `timeout` s, even if peers do not answer.

        It also ends a `start` that another thread has not finished yet. An attached engine goes on; only this console
        is gone.
        """

    @abstractmethod
    def snapshot(self) -> Snapshot:
        """Return the state of everything at one moment, recent and immutable."""

    def recorded(self) -> Snapshot:
        """Return the newest state that is there, without asking for one.

        States are up to date, figures and what features show may be older. It is renewed once a second as long as the
        engine works.
        """
        return self.snapshot()

    @abstractmethod
    def events(self, after: int = 0) -> list[Event]:
        """Return the events numbered above `after` that are still remembered, oldest first."""

    @abstractmethod
    def wait_for_events(self, after: int, timeout: float) -> list[Event]:
        """Return the same events as `events`; wait up to `timeout` s for one."""

    @abstractmethod
    def use_file(self, path: Path | None, holds: Session | None = None) -> None:
        """Have `reload` and `save` use this session file, or none. An attached engine keeps its own.

        Args:
            holds: the session that is in the file, or None for the present one.
        """

    @abstractmethod
    def do(self, command: Command[R], step: Callable[[str], None] | None = None) -> Future[R]:
        """Execute a command.

        Args:
            command: to be executed. Cancelling the future ends the work on a command that is `cancellable`.
            step: called with each step of a restart, on a thread of the engine.
        """

    # --- the same for each command with several users; `rsb_bridge.model.commands` documents them

    def add_topic(self, topic: Topic, link: str = "") -> Future[str]:
        return self.do(commands.AddTopic(topic, link))

    def edit_topic(self, key: str, topic: Topic, *, drop_arm: bool = False, seen: Topic | None = None) -> Future[str]:
        return self.do(commands.EditTopic(key, topic, drop_arm, seen))

    def remove_topic(self, key: str, *, drop_arm: bool = False) -> Future[str]:
        return self.do(commands.RemoveTopic(key, drop_arm))

    def pause(self, key: str, paused: bool) -> Future[None]:
        return self.do(commands.PauseTopics(key, paused))

    def acknowledge(
        self, key: str, acknowledged: bool = True, *, link: str = "", seen: tuple[State, str] | None = None
    ) -> Future[None]:
        return self.do(commands.Acknowledge(key, acknowledged, link, seen))

    def arm(self, key: str, *, shared: bool = False) -> Future[None]:
        return self.do(commands.ArmTopic(key, shared))

    def ask_holder(self, key: str, *, shared: bool = False) -> Future[None]:
        return self.do(commands.AskHolder(key, shared))

    def take_arming(self, key: str, *, shared: bool = False) -> Future[None]:
        return self.do(commands.TakeArming(key, shared))

    def answer_asker(self, key: str, *, gives: bool, who: str = "") -> Future[None]:
        return self.do(commands.AnswerAsker(key, gives, who))

    def disarm(self, key: str, *, own: bool = False) -> Future[None]:
        return self.do(commands.DisarmTopic(key, own))

    def keep_armed(self, *, pressed: bool) -> Future[Held]:
        return self.do(commands.KeepArmed(pressed))

    def add_client(self, client: Client) -> Future[None]:
        return self.do(commands.AddClient(client))

    def change_client(self, client: Client) -> Future[None]:
        return self.do(commands.ChangeClient(client))

    def remove_client(self, name: str) -> Future[None]:
        return self.do(commands.RemoveClient(name))

    def retry(self, link: str = "") -> Future[None]:
        return self.do(commands.Retry(link))

    def shut_down(self) -> Future[None]:
        return self.do(commands.ShutDownLinks())

    def restart(self, step: Callable[[str], None] | None = None) -> Future[None]:
        return self.do(commands.Restart(), step)

    def reload(self, *, dry_run: bool = False, drop_arm: bool = False, seen: str = "") -> Future[Reloaded]:
        return self.do(commands.Reload(dry_run, drop_arm, seen))

    def topics(self, link: str | None = None) -> Future[tuple[TopicInfo, ...]]:
        return self.do(commands.Topics(link))

    def peek(self, key: str, *, kept: bool = False) -> Future[PeekedMessage | None]:
        return self.do(commands.Peek(key, kept))

    def describe(self, key: str) -> Future[str]:
        return self.do(commands.DescribeType(key))

    def call(self, key: str, request: str, lane: str = "") -> Future[str]:
        return self.do(commands.Call(key, request, lane))

    def call_whole(self, key: str, request: str, lane: str = "") -> Future[commands.WholeAnswer]:
        return self.do(commands.CallWhole(key, request, lane))

    def stop_bridge(self) -> Future[None]:
        return self.do(commands.Stop())
