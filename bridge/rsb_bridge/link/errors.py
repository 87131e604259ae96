"""Commands and proposals that a link denies, and its error for them."""

from __future__ import annotations

from rsb_bridge.model.wording import Wording


class Denied(Wording):
    """Reasons why a link does not do what an operator or the other side asks for."""

    WHICH_CLIENT = "name the client: one of {clients}"
    RESTARTING = "a restart is already running"
    SERVER_STOPS = "the server stops"
    RESTART_FAILED = "{failure}. The server keeps trying"
    NO_ROUTE = "there is no route {key!r} any more"
    CHANGED = "{topic} was changed meanwhile ({differences}): open it again"
    BRIDGED_ALREADY = "{topic} is bridged in that direction already"
    EDIT_THAT_ROUTE = "{topic} is bridged in that direction already: edit or remove that route"
    FOLLOWED_ALREADY = "{topic} is followed in that direction already: edit or remove that pattern"
    TOO_MANY_PATTERNS = "this link has {limit} patterns already, which is the limit"
    TOO_MANY_ROUTES = "this link has {limit} topics and services already, which is the limit"
    TOO_MANY_OF_SERVER = (
        "the server's session lists {count} topics and services for {client} already, which is the limit: "
        "list further ones in the session file of {client}"
    )
    TOO_MANY_CALLS = "{limit} manual calls are already running: wait until one of them ends"
    DRIVER_TOPIC = "{topic} is this side's driver_topic, which only the bridge publishes: choose another name"
    SHUTDOWN_TOPIC = "{topic} is this side's shutdown topic: only its own domain may publish on it"
    NO_ANSWER = "the other side did not answer"
    TYPE_NOT_HERE = "{type_name} is not installed here, and the other side can't be asked: the topic is not open"
    TYPE_NOT_INSTALLED = "{type_name} is not installed on either side, and no node of the topic describes it"


class LinkError(Exception):
    """A link denies or fails a command; the message gives the reason."""
