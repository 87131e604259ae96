"""Features: all that a package adds to bridges and consoles, in one object.

A package names its `Feature` as an entry point of the group `rsb_console.feature`; this project's own are the folders
of `extras/rsb_extras`. `docs/a-feature.md` shows one from its message to its key. Each method returns what the feature
adds in one place, and imports what it needs when it is called: a bridge without a console loads no screen, and a
feature that a session does not use costs nothing.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Any, ClassVar, Generic, Literal, TypeVar

import msgspec

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping
    from pathlib import Path

API = 1
"""Version of `Feature`, `rsb_bridge.feature_api` and `rsb_console.feature_console`.

It grows when something of these changes its meaning or goes; what is only added leaves it as it is.
"""
GROUP = "rsb_console.feature"
"""The entry points, each of which names an instance of a subclass of `Feature`."""

BRINGS: Mapping[str, str] = {
    "bench": "bench",
    "graph": "mirrored_nodes",
    "groups": "node_control",
    **dict.fromkeys(("hear_rosout", "show_nodes"), "nodes"),
    **dict.fromkeys(("diagnostics_topic", "driver_topic", "metrics", "on_fault"), "exporters"),
    "record": "recording",
    "recordings": "courier",
    **dict.fromkeys(("frame_prefix", "restamp", "restamp_within"), "frames"),
    "units": "units",
    "zenoh": "zenoh",
}
"""Keys of session files, with the feature of this project that brings each, for messages where it is missing."""
BRINGS_RIGHTS: Mapping[str, str] = {"nodes": "node_control", "recordings": "courier", "units": "units"}
"""The same of rights of a link's other side, the keys of `MAY`."""
BRINGS_TRANSPORTS: Mapping[str, str] = {"zenoh": "zenoh", "zenoh-drop": "zenoh"}
"""The same of transports."""
BRINGS_COMMANDS: Mapping[str, str] = {
    "audit": "audit", "bench": "bench", "demo": "demo", "doctor": "doctor", "fleet": "fleet", "import": "imports",
    "lifecycle": "node_control", "look": "pictures", "mcp": "mcp_server", "nodes": "nodes", "pub": "driving",
    "record": "recording",
    "report": "history", "service": "service", "units": "units",
    **dict.fromkeys(("component", "param"), "node_control"), **dict.fromkeys(("play", "review"), "playing"),
}  # fmt: skip
"""The same of subcommands."""
BRINGS_ACTIONS: Mapping[str, str] = {
    "demo": "demo", "drive": "driving", "history": "history", "import_session": "imports", "keep_event": "disk_ring",
    "lifecycle": "node_control",
    "look": "pictures", "nodes": "nodes", "parameters": "node_control", "publish": "driving", "record": "recording",
    "recordings": "courier", "units": "units",
    **dict.fromkeys(("dismiss", "edit_marked", "mark", "open_robot"), "fleet"),
}  # fmt: skip
"""The same of actions of the console, by their ids in ``keys.yaml``."""
BRINGS_SETTINGS: Mapping[str, str] = {"commands": "own_commands", "layouts": "pictures", "picture_age": "driving"}
"""The same of settings in ``console.yaml``."""

MAY = "may"
"""The section of a session file, and of a client's entry on a server, that has the `PeerRight`s of features."""

T = TypeVar("T")


def late_names(module: str, names: Mapping[str, Iterable[str]]) -> Callable[[str], Any]:
    """Return a module's ``__getattr__`` (PEP 562), which imports each name from its home when it is asked for.

    Args:
        names: by their homes.
    """
    homes = {name: home for home, of_home in names.items() for name in of_home}

    def get(name: str) -> Any:
        if name not in homes:
            raise AttributeError(f"module {module} has no {name}")
        return getattr(import_module(homes[name]), name)

    return get


@dataclass(frozen=True)
class SessionKey(Generic[T]):
    """A key of session files that a feature brings.

    Attributes:
        type: of its value, as msgspec knows it: a number, a text, a frozen Struct, or a tuple of such.
        default: without the key.
        live: whether a running bridge takes a new value (`rsb-console reload`); else it has to be started again.
        of_peer: whether it is about the other side of a link: then a server has it for each client, in `clients`.
        own_topic: whether its value names a topic of the bridge itself.
        shared_topic: whether nodes publish on that topic, too: patterns take it if one does, and leave out others.
        hidden_as: what logs call the value instead of showing it. Operators elsewhere do not see it at all. Or empty.
    """

    name: str
    type: Any
    default: T
    live: bool = False
    of_peer: bool = False
    own_topic: bool = False
    shared_topic: bool = False
    hidden_as: str = ""

    def of(self, holder: Any) -> T:
        """Return the key's value in a session; that of a peer also in a client's entry, or a peer's rights."""
        value: T = holder.features.get(self.name, self.default)
        return value


@dataclass(frozen=True)
class PeerRight(Generic[T]):
    """A right that a session gives the other side of a link, a key of `MAY`; a reload changes it at once.

    Attributes:
        type: of its value, as of a `SessionKey`.
        default: without the key, which gives nothing.
    """

    name: str
    type: Any
    default: T

    def of(self, holder: Any) -> T:
        """Return what a peer's rights (`link.end.rights`), a session or a client's entry give."""
        given = holder.features.get(MAY)
        value: T = self.default if given is None else getattr(given, self.name, self.default)  # it may be left out
        return value

    def entry(self, value: str) -> str:
        """Return the entry of a session file that gives the right, of its value there: ``may: {units: [nav]}``."""
        return f"{MAY}: {{{self.name}: {value}}}"


@dataclass(frozen=True)
class EntryKey(Generic[T]):
    """A key that a feature gives to the entries of topics, services, actions and parameters in session files.

    A running bridge takes a new value at once, and the topic's route stays open.

    Attributes:
        type: of its value: float, str or bool.
        default: without the key, of that type or None.
        label: of its field in the console's form.
        help: of that field, one sentence.
        unit: of a number, or empty.
        limits: the lowest and the highest number, or None for any.
        kinds: the entries that may have it: of topics, of what is called, or all.
        of_peer: whether the other side gets the value, too, if it has this feature.
    """

    name: str
    type: type[float] | type[str] | type[bool]
    default: T
    label: str
    help: str
    unit: str = ""
    limits: tuple[float, float] | None = None
    kinds: Literal["all", "topics", "calls"] = "all"
    of_peer: bool = False

    def of(self, entry: Any) -> T:
        """Return the key's value in a `rsb_bridge.model.session.Topic`, such as a route's `spec`."""
        value: T = entry.features.get(self.name, self.default)
        return value


@dataclass(frozen=True)
class ShownField(Generic[T]):
    """A value that a feature adds to the snapshots of links or routes, for screens and ``--json``.

    Attributes:
        type: of the value. Attached consoles get it as plain data, of which `of` makes this type again.
        default: of a link or a route without this value.
    """

    name: str
    type: Any
    default: T

    def of(self, shown: Any) -> T:
        """Return the value in a snapshot of a link or a route; the default if an attached bridge sends nonsense."""
        value = shown.features.get(self.name, msgspec.UNSET)
        if value is msgspec.UNSET:
            return self.default
        try:
            found: T = msgspec.convert(value, self.type)
        except msgspec.ValidationError:
            return self.default
        return found


@dataclass(frozen=True)
class MachineReport:
    """Findings about a machine.

    Attributes:
        data: for programs, with JSON's types.
        source: the command or the program that has found them.
        lines: the same for people.
    """

    data: Mapping[str, Any]
    source: str
    lines: tuple[str, ...]


class Feature:
    """A package's additions. A subclass overrides the methods that it needs.

    Attributes:
        API: version of the door that the feature was written for; a feature for another one is left out.
        name: short, lower case; peers tell each other the names of their features.
        needs: names of the features without which this one does nothing.
        libraries: modules that some of its work needs, by the extra of rsb-console that installs each.
    """

    API: ClassVar[int] = API
    name: ClassVar[str]
    needs: ClassVar[tuple[str, ...]] = ()
    libraries: ClassVar[Mapping[str, str]] = {}

    # --- both sides of a link

    def messages(self) -> Iterable[type[msgspec.Struct]]:
        """Return control messages, subclasses of `rsb_bridge.wire.messages.ControlMessageBase`."""
        return ()

    def purposes(self) -> Iterable[Any]:
        """Return purposes of internal routes, each a `rsb_bridge.model.purposes.Purpose`."""
        return ()

    def extensions(self, link: Any) -> Iterable[Any]:
        """Return what takes part in a link's work.

        Args:
            link: the `rsb_bridge.link.link.Link`.

        Returns:
            `rsb_bridge.link.extension.Extension`s. They are told of connections to peers that have this feature, too.
        """
        return ()

    def transport_traits(self) -> Iterable[Any]:
        """Return the facts of transports, subclasses of `rsb_bridge.model.transport_traits.TransportTraits`."""
        return ()

    def transports(self, session: Any, base: Path, random: Any, strangers: Any) -> Iterable[Any]:
        """Return the transports of these that a session uses.

        Args:
            session: a `rsb_bridge.model.session.Session`.
            base: the folder that its files are relative to.
            random: a `random.Random`, for jitter.
            strangers: the `rsb_bridge.model.budgets.Strangers` of all transports.

        Returns:
            `rsb_bridge.transport.transport.Transport`s.
        """
        return ()

    # --- a session and its engine

    def session_keys(self) -> Iterable[SessionKey[Any]]:
        """Return keys of session files."""
        return ()

    def rights(self) -> Iterable[PeerRight[Any]]:
        """Return rights of a link's other side, which session files give in `MAY`."""
        return ()

    def topic_keys(self) -> Iterable[EntryKey[Any]]:
        """Return keys of the entries of topics, services, actions and parameters."""
        return ()

    def topic_problems(self, topic: Any) -> Iterable[tuple[str, str]]:
        """Return mistakes of a `rsb_bridge.model.session.Topic`, each as its key and its text with the remedy.

        Only an entry that has a feature's key is asked about. A key's type and limits are checked already.
        """
        return ()

    def problems(self, session: Any) -> Iterable[tuple[str, str]]:
        """Return mistakes of a `rsb_bridge.model.session.Session`, each as its key and its text with the remedy."""
        return ()

    def other_file(self, data: Any, path: Path) -> Iterable[str]:
        """Return what to do with a file that is no session but another program's, if this feature knows it.

        Args:
            data: of a YAML file as plain data, of any shape.
        """
        return ()

    def advice(self, session: Any, file: Path | None) -> Iterable[tuple[str, str]]:
        """Return what an operator should know before a session without mistakes runs, in the same form.

        Args:
            file: of the session, or None if files and programs of this machine are not to be looked at.
        """
        return ()

    def effects(self, session: Any) -> Iterable[str]:
        """Return lines on what a session without mistakes does, for ``rsb-console check``."""
        return ()

    def client_session(self, session: Any, client: Any, address: str, port: int | None) -> Any:
        """Return a client's new session with what this feature adds.

        Args:
            session: of its server.
            client: the client's so far.
            address: of the server as an operator gives it, or empty.
            port: the same, or None.
        """
        return client

    def refusal(self, session: Any, topic: str) -> str:
        """Return the reason why a topic of this side's domain is not bridged, or an empty string."""
        return ""

    def commands(self) -> Iterable[type[msgspec.Struct]]:
        """Return commands, subclasses of `rsb_bridge.model.commands.Command`."""
        return ()

    def parts(self, bridge: Any) -> Iterable[Any]:
        """Return what works in an engine.

        Args:
            bridge: the `rsb_bridge.engine.bridge.Bridge`.

        Returns:
            `rsb_bridge.engine.part.EnginePart`s.
        """
        return ()

    def observers(self, engine: Any) -> Iterable[Any]:
        """Return what watches an engine from outside, also one whose bridge hangs or has ended.

        Args:
            engine: the `rsb_bridge.engine.engine.Engine`.

        Returns:
            `rsb_bridge.engine.part.EngineObserver`s.
        """
        return ()

    def kept_logs(self, name: str) -> Iterable[Iterable[Any]]:
        """Return what bridges of a session's name have logged on this machine, as far as this user may read it.

        Returns:
            A log for each bridge: `rsb_bridge.model.snapshot.Event`s, in their order.
        """
        return ()

    def serve(self, server: Any) -> None:
        """Begin what lets consoles in that are not on this machine.

        Args:
            server: the `rsb_bridge.control.control_server.ControlServer` of an engine that is not started yet.
        """

    # --- a console

    def ways(self) -> Iterable[Any]:
        """Return ways to bridges of other machines, subclasses of `rsb_console.command.ways.RemoteWay`."""
        return ()

    def subcommands(self, add: Any, complete: Any) -> None:
        """Add subcommands of ``rsb-console``, each with a parser and a function that `late` imports when it is run.

        Args:
            add: a `rsb_console.command.remote_arguments.AddCommand`. That module has `late`, and common arguments.
            complete: completes an argument of a parser by one of the functions of `rsb_console.command.completion`.
        """

    def options(self, commands: Mapping[str, Any], complete: Any) -> None:
        """Add options to any subcommands, once all are there.

        An option that stores a function by ``dest="command"`` runs that instead.

        Args:
            commands: an `argparse.ArgumentParser` by each name.
            complete: as in `subcommands`.
        """

    def screens(self) -> Iterable[tuple[Any, ...]]:
        """Return all actions of each screen that takes the console's place, with their keys; ids are shared with it."""
        return ()

    def machine(self, columns: int) -> Iterable[MachineReport]:
        """Examine this machine for ``rsb-console report``, in lines of at most so many columns."""
        return ()

    def checks(self) -> Iterable[Any]:
        """Return checks of a machine for ``rsb-console doctor``, each a `rsb_bridge.model.finding.Check`."""
        return ()

    def actions(self) -> Iterable[Any]:
        """Return actions with their keys, each a `rsb_console.actions.action.Action` with `run`."""
        return ()

    def console_settings(self) -> Iterable[Any]:
        """Return settings of ``console.yaml``, each a `rsb_console.notation.console_setting.ConsoleSetting`."""
        return ()

    def listeners(self, console: Any) -> Iterable[Any]:
        """Return functions that hear of what a console shows, also one that is attached to a bridge.

        Args:
            console: the `rsb_console.console_api.Console`. It has `bell` and `notify`, and `engine` for commands.

        Returns:
            Functions, called several times a second with the newest `rsb_bridge.model.snapshot.Snapshot`, and with the
            `rsb_bridge.model.snapshot.Event`s since the last call. What was before the console shows a bridge is in no
            call.
        """
        return ()

    def own_actions(self, preferences: Any) -> Iterable[Any]:
        """Return actions that the user's settings make, of `rsb_console.actions.action.Group.OWN`.

        Args:
            preferences: the `rsb_console.preferences.Preferences`.
        """
        return ()

    def message_views(self) -> Iterable[Any]:
        """Return ways to show a topic's messages, each a `rsb_console.screens.message_screen.MessageView`."""
        return ()

    def columns(self) -> Iterable[Any]:
        """Return columns of the topics, each a `rsb_console.notation.topic_column.TopicColumn`."""
        return ()

    def tiles(self) -> Iterable[Any]:
        """Return tiles of lines beside pictures, subclasses of `rsb_console.widgets.tile_lines.TileLines`."""
        return ()

    def look_options(self) -> Iterable[Any]:
        """Return what else can be looked at now, each a `rsb_console.widgets.look_option.LookOption`."""
        return ()

    def link_facts(self) -> Iterable[Any]:
        """Return lines on links, each a `rsb_console.notation.link_fact.LinkFact`."""
        return ()

    def route_facts(self) -> Iterable[Any]:
        """Return lines on topics, services and the like, each a `rsb_console.notation.route_fact.RouteFact`."""
        return ()
