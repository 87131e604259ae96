"""The two sides of taking over an arming: how to get it from its holder, and whether the holder gives it."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

from textual.binding import Binding
from textual.widgets import Button, Static

from rsb_bridge.model.by_hand import ASKED_FOR
from rsb_bridge.model.commands import Effect
from rsb_bridge.model.wording import Wording
from rsb_console.notation import formats
from rsb_console.screens.dialog import ConfirmScreen

if TYPE_CHECKING:
    from collections.abc import Iterable

    from textual.app import ComposeResult

    from rsb_bridge.model.snapshot import RouteSnapshot, Snapshot
    from rsb_console.console_api import Console

_LOOK_EVERY = 0.2  # s. A round figure: a question stays so much longer at most


class HandOverText(Wording):
    """Texts about an arming that goes over."""

    HELD = "{topic} is armed by somebody else"
    MEANS = (
        "{holder} holds it, and drives alone.\n"
        "y asks for it: without an answer it goes over after {seconds:.0f} s, and the robot stops in between.\n"
        "{takes}A disarms it at once.\n"
        "{drivers}"
    )
    ASK, TAKE, DISARM = "Ask", "Take", "Disarm"
    KEYS = "y ask   {take}A disarm   n no"
    TAKE_KEY = "t take   "
    GIVE = "Give {topic} of {link} to somebody else?"
    ASKS = (
        "{who} asks for it, to drive instead.\n"
        "Without an answer it goes over in {seconds:.0f} s; the robot stops in between."
    )


class AskHolderScreen(ConfirmScreen):
    """Asks how to get what another console holds. Only an operator who `may_take` it at once is offered that.

    Attributes:
        choice: ``ask`` its holder, ``take`` it at once, or ``disarm`` it.
    """

    BINDINGS: ClassVar = [
        Binding("t", "choose('take')", show=False),
        Binding("A", "choose('disarm')", show=False),
    ]
    SAFE_KEYS = ConfirmScreen.SAFE_KEYS | {"A"}

    def __init__(self, console: Console, route: RouteSnapshot, *, may_take: bool) -> None:
        holder = "" if route.arming is None else route.arming.by
        title, takes = HandOverText.HELD(topic=route.topic), "t takes it at once. " if may_take else ""
        drivers = formats.drivers_now(route)
        means = HandOverText.MEANS(holder=holder, seconds=ASKED_FOR, takes=takes, drivers=drivers)
        super().__init__(title, means, HandOverText.ASK(), Effect.MOVES)
        self.console, self._key, self._holder = console, route.key, holder
        self.choice = "ask"
        self._may_take = may_take
        self.KEYS, self.MORE_KEYS = HandOverText.KEYS(take=HandOverText.TAKE_KEY() if may_take else ""), ()

    def on_mount(self) -> None:
        self.set_interval(_LOOK_EVERY, self.show)

    def show(self) -> None:
        """Close the question once its holder has let go: to ask would then arm at once."""
        routes = self.console.snapshot().routes
        holders = [each.arming.by for each in routes if each.key == self._key and each.arming is not None]
        if self._holder not in holders and self.is_active:
            self.notify("it has another holder, or none any more: look again", markup=False)
            self.dismiss(False)

    def compose_buttons(self) -> ComposeResult:
        yield Button(self._yes, id="yes", variant=self.VARIANT, compact=True)
        if self._may_take:
            yield Button(HandOverText.TAKE(), id="take", variant=self.VARIANT, compact=True)
        yield Button(HandOverText.DISARM(), id="disarm", compact=True)
        yield Button("No", id="no", compact=True)

    def on_button_pressed(self, event: Button.Pressed) -> None:
        # For the other buttons, Textual calls the handler of ConfirmScreen itself. A second dismissal would close the
        # screen below.
        if event.button.id in ("take", "disarm"):
            event.prevent_default()
            self.action_choose(event.button.id)

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        return (self._may_take or parameters != ("take",)) and super().check_action(action, parameters)

    def action_choose(self, choice: str) -> None:
        self.choice = choice
        self.dismiss(True)


class HandOverScreen(ConfirmScreen):
    """Asks the holder whether another operator, `who`, gets it; it closes once the question is over."""

    # Not even n and escape: they may be for the screen below, and would decide for the holder.
    SAFE_KEYS = frozenset({"ctrl+c"})
    opens_itself = True

    def __init__(self, console: Console, route: RouteSnapshot) -> None:
        title = HandOverText.GIVE(topic=route.topic, link=route.link)
        super().__init__(title, "", "Give", Effect.MOVES)
        self.console, self._key, self.who = console, route.key, asker_of(route)
        self._text = Static(_asks(route), markup=False)

    def compose_message(self) -> ComposeResult:
        yield self._text

    def on_mount(self) -> None:
        self.set_interval(_LOOK_EVERY, self.show)

    def show(self) -> None:
        """Show the seconds that are left; close the question if it is over."""
        route = asked_about(self.console.snapshot(), self._key)
        if route is None or asker_of(route) != self.who:
            # Textual closes the screen on top, which may be the help. `is_current` is true below that, too.
            if self.is_active:
                self.dismiss(None)
        else:
            self._text.update(_asks(route))


def _asks(route: RouteSnapshot) -> str:
    assert route.arming is not None
    return HandOverText.ASKS(who=route.arming.asked_by, seconds=route.arming.goes_in or 0.0)


def asker_of(route: RouteSnapshot) -> str:
    """Return the operator who asks for a route's arming, or an empty string."""
    return "" if route.arming is None else route.arming.asked_by


def asked_about(snapshot: Snapshot, key: str) -> RouteSnapshot | None:
    """Return a route for whose arming somebody asks its holder, or None."""
    return next((route for route in snapshot.routes if route.key == key and asker_of(route)), None)


class NewQuestions:
    """Finds the questions that a holder has not seen yet."""

    def __init__(self) -> None:
        self._asked: set[tuple[str, str]] = set()

    def find_new(self, snapshot: Snapshot, held: Iterable[str]) -> list[RouteSnapshot]:
        """Return the routes of `held` for whose arming somebody has begun to ask."""
        routes = [route for key in held if (route := asked_about(snapshot, key)) is not None]
        before, self._asked = self._asked, {(route.key, asker_of(route)) for route in routes}
        return [route for route in routes if (route.key, asker_of(route)) not in before]
