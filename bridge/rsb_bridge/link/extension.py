"""The parts of a link, their base class, and the error with which they deny a command or a proposal."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any, TypeVar

from rsb_bridge.config.name_rules import name_problems
from rsb_bridge.installed_features import failed
from rsb_bridge.model.limits import TEXT_LENGTH
from rsb_bridge.model.snapshot import State
from rsb_bridge.model.text import is_clean, sanitize_text
from rsb_bridge.model.verdict import Verdict
from rsb_bridge.model.wording import Wording
from rsb_bridge.route.message_transform import FailedTransform
from rsb_bridge.tasks import in_slices

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Mapping

    from rsb_bridge.channel.data_keys import Meter
    from rsb_bridge.config.rights import DeniedUse, Rights
    from rsb_bridge.link.control_channel import Slices
    from rsb_bridge.model.purposes import Purpose
    from rsb_bridge.route.message_transform import FindTransform, FindTransforms, MessageTransform, Transforms
    from rsb_bridge.route.route import Route
    from rsb_bridge.wire.records import RefuseCode

_E = TypeVar("_E", bound="Extension")


class Extension:
    """A feature of one link, which takes part in connections, messages and regular work.

    `rsb_bridge.link.link.Link` registers it; it overrides what it needs.

    Attributes:
        feature: name of the `rsb_bridge.feature.Feature` that brings it, or an empty string for one of the core. It is
            told of connections only if the peer has that, too.
        messages: its handlers of control messages, by type. A handler may return work to be done in slices.
        purpose: the purpose of the internal routes that it serves, or None.
        explanation: returns the core's verdict on one of its routes with more in its text, or None if it knows nothing
            more. State and cause stay as they are. It is asked when `verdict` is, of what is not fine. None if it never
            knows more.
        transform: returns None at once if the messages of a topic that comes in stay as they are, or an async function
            that finds what changes them, if anything does. It is asked in each opening once the topic's type is known,
            whose first messages wait for the answer, and again after `Receiver.choose_transforms`. None if it changes
            nothing.
    """

    feature: str = ""
    messages: Mapping[type, Callable[[Any], Slices | None]] = {}
    purpose: Purpose | None = None
    explanation: Callable[[Any, Verdict], Verdict | None] | None = None
    transform: Callable[[Any], FindTransform | None] | None = None

    def connected(self) -> None:
        """Begin an association: the peer is authenticated."""

    def disconnected(self) -> None:
        """End an association. The extension that was registered last comes first."""

    def suspend(self) -> None:
        """Wait: the connection is lost, and the association lives on. The last registered extension comes first."""

    def resume(self) -> None:
        """Go on: the association has another connection."""

    def leaving(self) -> None:
        """Send what the peer has to know before this side's goodbye."""

    def tick(self) -> None:
        """Do the regular work, once a second, linked or not."""

    def link_fields(self) -> Mapping[str, Any]:
        """Return the values of its `rsb_bridge.feature.ShownField`s of the link."""
        return {}

    def route_fields(self, route: Route) -> Mapping[str, Any]:
        """Return the values of one of its routes."""
        return {}

    def verdict(self, route: Route) -> Verdict | None:
        """Return a feature's verdict on one of its routes, or None if it finds nothing.

        It is asked once a second, while messages come and the link is up, of what is neither refused nor paused nor
        disarmed. If the answer changes for another reason than a message, call `route.judge_again`. The worst of all
        verdicts counts. Its `cause` begins with the feature's name and a dot: ``watch.low``.
        """
        return None

    def removed(self, route: Route) -> None:
        """End what a route was for: an operator of this side removes it."""

    def denial(self, rights: Rights, *, sends: bool) -> DeniedUse | None:
        """Return why a peer with these rights may have no internal route of its purpose, or None if it may.

        Args:
            sends: whether the peer is to send on it.
        """
        return None

    def refusal(self, name: str) -> str:
        """Return why the peer may not have an internal route by that name now, or an empty string."""
        return ""

    def meter_of(self, route_id: int) -> Meter | None:
        """Return what counts the bytes that arrive for a route, or None."""
        return None


class Extensions:
    """The extensions of one link, in the order of their calls."""

    def __init__(self) -> None:
        self._all: list[Extension] = []
        self._ticking: list[Extension] = []
        # Each snapshot of a route asks them: an extension that shows nothing costs nothing.
        self._showing_links: list[Extension] = []
        self._showing_routes: list[Extension] = []
        self.judging: list[Extension] = []  # of features; one whose `verdict` has failed is asked no more
        self.explaining: list[Extension] = []  # the same of `explanation`
        self.transforming: list[Extension] = []  # of features
        self._told: list[Extension] = []  # of the present connection, if the peer has their feature, too

    def add(self, extension: Extension) -> None:
        self._all.append(extension)
        kind = type(extension)
        if kind.tick is not Extension.tick:
            self._ticking.append(extension)
        if kind.link_fields is not Extension.link_fields:
            self._showing_links.append(extension)
        if kind.route_fields is not Extension.route_fields:
            self._showing_routes.append(extension)
        if kind.verdict is not Extension.verdict:
            self.judging.append(extension)
        if extension.explanation is not None:
            self.explaining.append(extension)
        if extension.transform is not None:
            self.transforming.append(extension)

    def find(self, kind: type[_E]) -> _E:
        return next(each for each in self._all if isinstance(each, kind))

    def connected(self, features: Collection[str]) -> None:
        """Begin a connection to a peer with these features."""
        self._told = [each for each in self._all if not each.feature or each.feature in features]
        for each in self._told:
            each.connected()

    def disconnected(self) -> None:
        for each in reversed(self._told):
            each.disconnected()
        self._told = []

    def suspend(self) -> None:
        for each in reversed(self._told):
            each.suspend()

    def resume(self) -> None:
        for each in self._told:
            each.resume()

    def leaving(self) -> None:
        for each in self._told:
            each.leaving()

    async def tick(self, guarded: Callable[[Callable[[], None]], None]) -> None:
        """Do their regular work once a second, in slices: each may look at all routes."""
        await in_slices([each.tick for each in self._ticking], guarded)

    def removed(self, route: Route) -> None:
        for each in self._all:
            each.removed(route)

    def serving(self, purpose: Purpose) -> Extension:
        """Return the one that serves the internal routes of a purpose."""
        return next(each for each in self._all if each.purpose is purpose)

    def meter_of(self, route_id: int) -> Meter | None:
        meters = (each.meter_of(route_id) for each in self._all)
        return next((each for each in meters if each is not None), None)

    def link_fields(self) -> dict[str, Any]:
        shown: dict[str, Any] = {}
        for each in self._showing_links:
            shown.update(each.link_fields())
        return shown

    def verdicts(self, route: Route) -> Iterable[Verdict]:
        """Return the verdicts of features on a route."""
        found = []
        for each in tuple(self.judging):
            try:
                if (verdict := each.verdict(route)) is not None:
                    found.append(_checked(verdict, each.feature))
            except Exception as error:  # noqa: BLE001 -- of code that is not ours; a route's state must not depend on it
                self.judging.remove(each)
                failed(each.feature, "verdict", error)
        return found

    def explain(self, route: Route, verdict: Verdict) -> Verdict:
        """Return a verdict of the core's with what features know about its cause."""
        for each in tuple(self.explaining):
            try:
                if each.explanation is not None and (found := each.explanation(route, verdict)) is not None:
                    return replace(verdict, text=sanitize_text(found.text), since=found.since)
            except Exception as error:  # noqa: BLE001 -- as above
                self.explaining.remove(each)
                failed(each.feature, "explanation", error)
        return verdict

    def transforms(self, route: Route) -> FindTransforms | None:
        """Look for what changes a route's messages; None if nothing does."""
        asked: list[tuple[str, FindTransform]] = []
        for each in self.transforming:
            try:
                found = None if each.transform is None else each.transform(route)
            except Exception as error:  # noqa: BLE001 -- as above
                found = partial(_failed, each.feature, error)
            if found is not None:
                asked.append((each.feature, found))
        return partial(_found, asked) if asked else None

    def route_fields(self, route: Route) -> dict[str, Any]:
        shown: dict[str, Any] = {}
        for each in self._showing_routes:
            shown.update(each.route_fields(route))
        return shown


async def _found(asked: Iterable[tuple[str, FindTransform]]) -> Transforms:
    found: list[MessageTransform] = []
    for feature, find in asked:
        try:
            transform = await find()
        except Exception as error:  # noqa: BLE001 -- of code that is not ours; its messages are kept back
            transform = await _failed(feature, error)
        if transform is not None:
            transform.feature = feature
            found.append(transform)
    return tuple(found)


async def _failed(feature: str, error: Exception) -> MessageTransform:
    failed(feature, "transform", error)
    return FailedTransform(feature)


def _checked(verdict: Verdict, feature: str) -> Verdict:
    """Return a feature's verdict; raise `ValueError` if programs and the other side could mistake it."""
    if not isinstance(verdict, Verdict) or not isinstance(verdict.state, State):
        raise TypeError("verdict returns a Verdict with a State, or None")
    if len(verdict.cause) > TEXT_LENGTH or not is_clean(verdict.cause):
        raise ValueError(f"the cause of a verdict has at most {TEXT_LENGTH} printable characters")
    if not verdict.cause.startswith(f"{feature}."):
        raise ValueError(f"the cause {verdict.cause!r} of a verdict has to begin with {feature}.")
    return verdict


class Denied(Wording):
    """Reasons why a link does not do what an operator or the other side asks for."""

    WHICH_CLIENT = "name the client: one of {clients}"
    RESTARTING = "a restart is already running"
    SERVER_STOPS = "the server stops"
    RESTART_FAILED = "{failure}. The server keeps trying"
    NO_ROUTE = "there is no route {key!r} any more"
    NO_LINK = "there is no link {name!r}"
    NOT_LINKED = "{name} is not linked: {reason}"
    LINK_LOST = "the link was lost"
    NOT_CALLED = "{topic} is a topic: it cannot be called"
    CHANGED = "{topic} was changed meanwhile ({differences}): open it again"
    LISTED_TOO = "the other side's session lists {topic}, too"
    LISTED_DIFFERENTLY = (
        "listed on both sides: {here} here: {mine}; {there} there: {theirs}; make them equal, or remove one"
    )
    THIS_SESSION = "this session"
    ITS_SESSION = "its session"
    NOT_LISTED = "{topic} is not listed there any more: look at it again"
    OUT_OF_REACH = "the other side lists {topic}, and is out of reach: edit it there, or once the link is up"
    ARMED_THERE = "{topic} has to be armed: rename it on the side that lists it"
    AGE_OF_ARMED = "{topic} has to be armed: let it have older messages on the side that lists it"
    PORT_OF_SERVER = "{topic} is listed on the server, and so is its port: change that there"
    LIMITS_OF_PEER = "the other side lists {topic}: set its limits there, or here under armed"
    KEY_OF_SIDE = "the other side lists {topic}, and {keys} is no key for the other side: set it there, in its session"
    EDIT_THAT_ROUTE = "{topic} is bridged in that direction already: edit or remove that route"
    FOLLOWED_ALREADY = "{topic} is followed in that direction already: edit or remove that pattern"
    TOO_MANY_PATTERNS = "this link has {limit} patterns already, which is the limit"
    TOO_MANY_ROUTES = "this link has {limit} topics and services already, which is the limit"
    TOO_MANY_OF_SERVER = (
        "the server's session lists {count} topics and services for {client} already, which is the limit: "
        "list further ones in the session file of {client}"
    )
    TOO_MANY_CALLS = "{limit} manual calls are already running: wait until one of them ends"
    SHUTDOWN_TOPIC = "{topic} is this side's shutdown topic: only its own domain may publish on it"
    NO_ANSWER = "the other side did not answer"
    TYPE_NOT_HERE = "{type_name} is not installed here, and the other side can't be asked: the topic is not open"
    TYPE_NOT_INSTALLED = "{type_name} is not installed on either side, and no node of the topic describes it"


class LinkError(Exception):
    """A link denies or fails a command; the message gives the reason."""


def check_names(topics: Iterable[str]) -> None:
    """Raise `LinkError` if a name is not absolute: rights and the graph know a topic by one, which ROS would expand."""
    for topic in topics:
        for problem in name_problems(topic, "topic"):
            raise LinkError(str(problem))


class RefusedError(LinkError):
    """A proposal of the peer is refused for a reason that has a code of its own."""

    def __init__(self, code: RefuseCode, text: str) -> None:
        super().__init__(text)
        self.code = code
