"""Finding out what a route sends: its type, the type's hash and the QoS."""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec

from rsb_bridge.model.type_names import expand_type_name

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rsb_bridge.model.qos import Qos
    from rsb_bridge.ros.api import Endpoint, RosInterface
    from rsb_bridge.wire.messages import Propose


class UnresolvedError(Exception):
    """The type or the QoS is not known yet; the message says why, and is empty where there is no publisher.

    Attributes:
        stage: the one that fails.
    """

    def __init__(self, stage: str, why: str) -> None:
        super().__init__(why)
        self.stage = stage


def resolve(
    proposal: Propose,
    publishers: Sequence[Endpoint],
    publisher_qos: Qos | None,
    hint: tuple[str, str],
    ros: RosInterface,
) -> tuple[str, str, Qos]:
    """Find out what a route sends.

    Args:
        proposal: what an operator wants.
        publishers: on the topic.
        publisher_qos: what they offer together; None: there are none.
        hint: the type that the topic has on the receiving side, and its hash; empty: not known.
        ros: knows the hashes of the types that are installed here.

    Returns:
        The type, its hash, and the QoS to publish with.

    Raises:
        UnresolvedError: it is not known yet.
    """
    wanted = "" if proposal.type in ("", "auto") else expand_type_name(proposal.type)
    offered = sorted({each.type_name for each in publishers})
    if wanted and offered and offered != [wanted]:
        why = f"publishers send {', '.join(offered)}, not {wanted}: correct the type"
        raise UnresolvedError("type known", why)
    if len(offered) > 1:
        raise UnresolvedError("type known", f"publishers disagree: {', '.join(offered)}: name the type")
    name = wanted or (offered[0] if offered else hint[0])
    if not name:
        raise UnresolvedError("publisher seen", "")
    hashes = sorted({each.type_hash for each in publishers if each.type_hash})
    if len(hashes) > 1:
        why = f"publishers have different versions of {name}: {', '.join(hashes)}"
        raise UnresolvedError("type known", why)
    type_hash = hashes[0] if hashes else ros.installed_hash(name) or (hint[1] if hint[0] == name else "")
    if not type_hash:
        raise UnresolvedError("type known", f"{name} is not installed here, and nobody publishes it yet")
    qos = proposal.qos
    if qos is None and publisher_qos is not None:
        qos = msgspec.structs.replace(publisher_qos, depth=0)
    if qos is None:
        raise UnresolvedError("publisher seen", "")
    return name, type_hash, qos
