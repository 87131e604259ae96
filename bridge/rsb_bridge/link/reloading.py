"""Applies a changed session to a running bridge, step by step.

Each step describes its change and makes it, so that operators see in advance exactly what will happen.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from itertools import zip_longest
from typing import TYPE_CHECKING

from rsb_bridge.config.keys import fingerprint
from rsb_bridge.config.rights import rights_of_server
from rsb_bridge.config.session_changes import changes, described, named
from rsb_bridge.link.proposals import denied
from rsb_bridge.model.session import Topic, peer_keys
from rsb_bridge.model.wording import Wording

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from rsb_bridge.config.keys import Key
    from rsb_bridge.config.rights import Rights
    from rsb_bridge.link.client_end import ClientEnd
    from rsb_bridge.link.link import Link
    from rsb_bridge.link.link_patterns import LinkPatterns
    from rsb_bridge.link.link_server import Server
    from rsb_bridge.link.server_end import ClientEntry, ServerEnd
    from rsb_bridge.model.session import Identity, Session
    from rsb_bridge.route.route import Route


class ClientStep(Wording):
    """Changes of a server's clients."""

    REMOVED = "client {name}: removed: it is no longer accepted"
    REMOVED_WHILE_LINKED = "client {name}: removed: its link is closed, and it is no longer accepted"


_NOT_IN_FILE = "removed from the session file"


@dataclass(frozen=True, slots=True)
class ReloadStep:
    """One change."""

    text: str
    apply: Callable[[], object]  # makes the change; if it raises `LinkError`, nothing has changed


def client_steps(end: ClientEnd, session: Session, key: Key | None) -> Iterator[ReloadStep]:
    """Yield the changes of a client; its new key is None without encryption."""
    link = end.link
    if end.key != key:
        effect = "the link is closed, and connects again with the new key"
        (change,) = _key_changes(end.fingerprints, (fingerprint(key) if key is not None else "", ""))
        yield ReloadStep(f"{change}: {effect}", partial(end.change_key, key))
    yield from _topic_steps(link, session.topics)
    listed = {topic.identity for topic in session.topics}
    own = {route.spec.identity for route in link.routes.values() if route.proposed_here or route.listed}
    for identity in sorted(link.table.listed - listed - own):  # the other side has removed it already
        kind, name, direction = identity
        text = f"{named(Topic(name, direction, kind=kind))}: no longer listed"
        yield ReloadStep(text, partial(link.table.listed.discard, identity))
    differs = changes(link.context.session, session, only=("allow", "deny", *peer_keys()))
    effect = _denial_effect(link, rights_of_server(session, listed))
    if differs or effect:
        yield ReloadStep(": ".join(filter(None, (", ".join(differs), effect))), partial(end.change_listed, listed))


def server_steps(server: Server, entries: list[ClientEntry]) -> Iterator[ReloadStep]:
    """Yield the changes of a server."""
    wanted = {entry.client.name: entry for entry in entries}
    for name, entry in tuple(server.entries.items()):
        end, new = server.ends[name], wanted.get(name)
        if new is None:
            text = ClientStep.REMOVED_WHILE_LINKED if end.link.linked else ClientStep.REMOVED
            yield ReloadStep(text(name=name), partial(server.remove_client, name))
        elif parts := _client_changes(entry, new):
            effect = _client_effect(end, new)
            yield ReloadStep(f"client {name}: {', '.join(parts)}{effect}", partial(server.change_client, new))
    for name, entry in wanted.items():
        if name not in server.entries:
            yield ReloadStep(
                f"client {name}: added, key {', next key '.join(entry.fingerprints) or 'none'}",
                partial(server.add_client, entry),
            )
            for topic in entry.client.topics:
                yield ReloadStep(f"client {name}: {_added(topic)}", partial(_add_to_client, server, name, topic))
        else:
            for step in _topic_steps(server.ends[name].link, entry.client.topics):
                yield ReloadStep(f"client {name}: {step.text}", step.apply)


def _client_changes(old: ClientEntry, new: ClientEntry) -> list[str]:
    parts = changes(old.client, new.client, leave_out=("key_file", "next_key_file", "topics", "use_name"))
    if old.use_name != new.use_name:
        parts.append(f"use_name {str(old.use_name).lower()} → {str(new.use_name).lower()}")
    parts += _key_changes(old.fingerprints, new.fingerprints)
    # If nothing else differs, these changes have no effect, but the operator made them.
    return parts or changes(old.client, new.client, leave_out=("topics",))


def _client_effect(end: ServerEnd, new: ClientEntry) -> str:
    effects, link = [], end.link
    if link.linked and not end.stays_valid(new):
        effects.append("its link is closed, and comes back once the client has the new key")
    elif link.linked and end.entry.use_name != new.use_name:
        effects.append("its link is closed, and comes back at once")
    if denial := _denial_effect(link, new.rights):
        effects.append(denial)
    return f": {'; '.join(effects)}" if effects else ""


def _denial_effect(link: Link, rights: Rights) -> str:
    """Return the text on the peer's topics that end under other rights, or an empty string."""
    ended = denied(link, rights)
    return f"{', '.join(route.local_topic for route in ended)} may not cross any more" if ended else ""


# --- the topics that one side of a link proposes


def _topic_steps(link: Link, topics: Sequence[Topic]) -> Iterator[ReloadStep]:
    yield from _pattern_steps(link.patterns, {topic.identity: topic for topic in topics if topic.is_pattern})
    wanted = {topic.identity: topic for topic in topics if not topic.is_pattern}
    routes = {route.spec.identity: route for route in link.routes.values() if route.listed}  # others are in no file
    for identity, route in routes.items():
        if identity not in wanted:
            yield ReloadStep(_removed(route.spec), partial(_remove, link, identity))
    for identity, topic in wanted.items():
        if (listed := routes.get(identity)) is None:
            yield ReloadStep(_added(topic), partial(link.entries.add, topic))
        elif listed.spec != topic:
            goes_on = not listed.proposed_here or link.proposed.can_amend(listed, topic)
            effect = "" if goes_on else "; reopened, counted from 0"
            text = f"{named(topic)}: {', '.join(changes(listed.spec, topic))}{effect}"
            yield ReloadStep(text, partial(_replace, link, topic))


def _pattern_steps(patterns: LinkPatterns, wanted: dict[Identity, Topic]) -> Iterator[ReloadStep]:
    known = {topic.identity: topic for topic in patterns.all()}
    for identity, topic in known.items():
        if identity not in wanted:
            yield ReloadStep(_removed(topic), partial(patterns.remove, identity))
    for identity, topic in wanted.items():
        if identity not in known:
            yield ReloadStep(_added(topic), partial(patterns.add, topic))
        elif known[identity] != topic:
            text = f"{named(topic)}: {', '.join(changes(known[identity], topic))}"
            yield ReloadStep(text, partial(patterns.replace, identity, topic))
    stay, new = [each for each in known if each in wanted], [each for each in wanted if each not in known]
    if [*stay, *new] != [*wanted]:
        yield ReloadStep("the order of the patterns", partial(patterns.arrange, tuple(wanted)))


def _added(topic: Topic) -> str:
    return f"{named(topic)}: added: {described(topic)}"


def _removed(topic: Topic) -> str:
    return f"{named(topic)}: removed (it was {described(topic)})"


def _add_to_client(server: Server, name: str, topic: Topic) -> None:
    if name in server.ends:
        server.ends[name].link.entries.add(topic)


def _remove(link: Link, identity: Identity) -> None:
    route = _listed(link, identity)
    if route is not None and not route.proposed_here:
        link.proposed.unlist(route)
    elif route is not None:  # else the other side has removed it meanwhile
        link.table.remove(route, _NOT_IN_FILE)


def _replace(link: Link, topic: Topic) -> None:
    route = _listed(link, topic.identity)
    if route is not None and route.proposed_here:
        link.proposed.replace(route, link.proposed.entry(topic))
        return
    if route is not None:  # the other side has opened it: it stays listed here if the two still say the same
        link.proposed.unlist(route)
    link.proposed.add(topic)  # else the other side has removed it meanwhile, and the file lists it


def _listed(link: Link, identity: Identity) -> Route | None:
    """Return the present route of a topic that this side lists, which earlier steps may have replaced, or None."""
    routes = (route for route in link.routes.values() if route.listed)
    return next((route for route in routes if route.spec.identity == identity), None)


# --- keys


def _key_changes(old: tuple[str, ...], new: tuple[str, ...]) -> list[str]:
    """Return the changes of the fingerprints of a client's valid keys."""
    names = ("key", "next key")
    pairs = zip_longest(names, old, new, fillvalue="")
    return [f"{name} {before or 'none'} → {after or 'none'}" for name, before, after in pairs if before != after]
