"""A client that the server accepts, and which topics it may have."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import msgspec

from rsb_bridge.config.keys import fingerprint
from rsb_bridge.model.names import client_topic, server_topic

if TYPE_CHECKING:
    from rsb_bridge.config.keys import Key
    from rsb_bridge.config.rights import Rights
    from rsb_bridge.model.session import Client, Kind, Topic


@dataclass(frozen=True, slots=True)
class Entry:
    """A client that the server accepts.

    Attributes:
        client: its entry in the session.
        keys: those that are valid, the next one last; none: unencrypted.
        use_name: whether its topics have its name before them here.
        rights: what it may do here.
    """

    client: Client
    keys: tuple[Key, ...]
    use_name: bool
    rights: Rights

    @property
    def fingerprints(self) -> tuple[str, ...]:
        """Of its keys; of none, an empty one."""
        return tuple(map(fingerprint, self.keys)) or ("",)

    def server_name(self, topic: str) -> str:
        """The server's name of a topic; the client's name may be before it already."""
        name = self.client.name
        return server_topic(topic, name) if self.use_name and client_topic(topic, name) is None else topic

    def client_names(self, topic: Topic) -> Topic:
        """A topic as the client sees it, though an operator of the server may name it as the server does.

        Where `use_name` is set, ``/robot1/scan`` is robot1's ``/scan``. A topic with a `remote_topic` has both names.
        """
        name = client_topic(topic.topic, self.client.name) if self.use_name and topic.remote_topic is None else None
        return topic if name is None else msgspec.structs.replace(topic, topic=name)

    def shows(self, topic: str, kind: Kind = "topic") -> bool:
        """Whether the client may know of a topic of the server, or of what else there is."""
        reachable = not self.use_name or client_topic(topic, self.client.name) is not None
        return reachable and self.rights.shows(topic, kind)
