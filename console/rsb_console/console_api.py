"""The interface of the app that screens and operations use."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol, TypeVar

if TYPE_CHECKING:
    from concurrent.futures import Future
    from contextlib import AbstractContextManager, ExitStack
    from pathlib import Path

    from textual.notifications import SeverityLevel
    from textual.screen import Screen

    from rsb_bridge.api import EngineApi
    from rsb_bridge.config.session_file import SessionFile
    from rsb_bridge.model.session import Session
    from rsb_bridge.model.snapshot import Snapshot
    from rsb_console.actions.action import Action
    from rsb_console.notation.formats import Row
    from rsb_console.preferences import Preferences, Setting
    from rsb_console.session.changes import Changes
    from rsb_console.terminal.input_queue import Sight

T = TypeVar("T")


class OperatorWatch(Protocol):
    """Finds out whether the operator watches what is armed.

    Attributes:
        held: keys of the routes that this console holds.
    """

    held: frozenset[str]

    def armed_on(self, screen: Screen[Any]) -> None:
        """Note that a topic is armed on a screen, whose keys count from then on."""


class ConsoleShell(Protocol):
    """An app in a terminal, and its operator.

    Attributes:
        preferences: the user's themes and keys.
        config: the folder that those are in.
        terminal: file descriptor of the terminal.
        refresh_rate: how often a second it shows the present state.
        writer: tells what the terminal has of the screen.
    """

    preferences: Preferences
    config: Path
    terminal: int
    refresh_rate: float

    @property
    def writer(self) -> Sight: ...

    @property
    def readonly(self) -> bool:
        """Whether all changes are forbidden."""

    def as_seen(self, seconds: float) -> float:
        """Return an age or the present time (s) as it is when the operator sees it, on a terminal that is late."""

    async def ask(self, dialog: Screen[T]) -> T | None:
        """Show a dialog and wait for its answer. Only from a worker."""

    def notify(
        self,
        message: str,
        *,
        title: str = "",
        severity: SeverityLevel = "information",
        timeout: float | None = None,
        markup: bool = True,
    ) -> None:
        """Show a message for a while (Textual's)."""

    def bell(self) -> None:
        """Ring the terminal's bell (Textual's)."""

    def suspend(self) -> AbstractContextManager[None]:
        """Leave the terminal to another program meanwhile (Textual's)."""

    def key_labels(self, action: Action) -> list[str]:
        """Return the keys of an action, as written on a keyboard."""

    def pull(self) -> None:
        """Show the present state now."""

    def remember(self, name: str, value: Setting) -> bool:
        """Keep a choice of the operator for the next start; tell the operator, and return False, if that fails."""


class Console(ConsoleShell, Protocol):
    """One engine under one session, shown by one app.

    Attributes:
        engine: the engine that runs or ran last, or None before the first.
        base: the folder that the session's key files are relative to.
        path: the session file, or None without a file.
        saved: the session in the file, or None without a file.
        file: that file as it was opened, with its comments, or None without a file or after changes to it.
        temporary: whether the session's file is deleted when the session ends, like the demo's.
        attached_to: name of the attached bridge of another process, or empty if the engine is the console's own.
        note: the console's present work on the session (``starting``), or empty.
        changes: this console's changes to the engine that can be undone.
    """

    engine: EngineApi | None
    base: Path
    path: Path | None
    saved: Session | None
    file: SessionFile | None
    temporary: bool
    attached_to: str
    note: str
    changes: Changes

    # --- the session

    async def run_session(
        self, session: Session, path: Path | None, resources: ExitStack | None = None, *, temporary: bool = False
    ) -> None:
        """Stop the engine, and start one for another session.

        Args:
            path: its file, or None without a file.
            resources: closed when the session ends.
            temporary: whether the file is one of those resources, so that saving to it keeps nothing.
        """

    async def start_again(self) -> None:
        """Start the same session on a new engine, after the old one has ended or could not start."""

    async def attach(self, path: Path) -> None:
        """Stop the engine, and attach to a bridge of another process by its control socket."""

    def saved_to(self, session: Session, path: Path | None) -> None:
        """Remember that a file holds the session."""

    # --- the engine

    @property
    def linked(self) -> bool:
        """Whether any link is up."""

    def snapshot(self) -> Snapshot:
        """Return the engine's state, or an empty one without an engine.

        Its time is `as_seen`, so that ages are.
        """

    def peer_of(self, route: Row) -> str:
        """Return the name of a route's other side, or its address on a client, whose link has the client's own name."""

    async def command(self, future: Future[T], done: str = "") -> bool:
        """Wait for a command to the engine, and notify the operator if it failed.

        Args:
            done: text to show on success, or empty because the log has one.

        Returns:
            Whether it succeeded.
        """

    # --- the operator

    @property
    def deadman(self) -> OperatorWatch:
        """The proof to the engine that the operator watches what is armed."""

    def request_quit(self) -> None:
        """Quit, after a question if that loses something."""
