"""Links over a Zenoh network: streams and datagrams in samples, through any number of routers.

`pipe.Pipe` stands between a stream and the network: `outbox.SampleOutbox.put` sends, on a thread if that could block;
frames for `endpoint.ZenohEndpoint` are taken on Zenoh's thread if the loop waits.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar

import msgspec

from rsb_bridge.feature_api import Feature, SessionKey

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from pathlib import Path

    from rsb_bridge.feature_api import Session, Transport, TransportTraits
    from rsb_bridge.model.budgets import Strangers

ZENOH_HOST = "zenoh"
"""The `rsb_bridge.model.session.Session.server_ip` of a link over Zenoh."""
HOW_TO_INSTALL = "the package eclipse-zenoh is not installed: pip install 'rsb-console[zenoh]'"


class ZenohSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """The Zenoh network of a session.

    Attributes:
        connect: endpoints of routers, or of a bridge that listens: ``tls/hub:7447``; the first that answers is used.
        listen: endpoints to bind, for links without a router: ``tcp/0.0.0.0:7447``.
        config: path of a Zenoh configuration (JSON5), relative to the session file, for certificates and the like.
        fleet: tells the bridges of one fleet from others in the same network: only links within a fleet are possible.
    """

    connect: tuple[str, ...] = ()
    listen: tuple[str, ...] = ()
    config: str | None = None
    fleet: str = "fleet"

    @property
    def place(self) -> str:
        """The network's endpoints, for an operator."""
        return ", ".join(self.connect or self.listen) or f"the endpoints of {self.config}"


ZENOH: SessionKey[ZenohSettings | None] = SessionKey("zenoh", ZenohSettings | None, None)
"""The Zenoh network, for links over it, and to be seen in its fleet even if links use another transport; or None."""


class Zenoh(Feature):
    name = "zenoh"
    libraries: ClassVar[Mapping[str, str]] = {"zenoh": "zenoh"}

    def session_keys(self) -> Iterable[SessionKey[Any]]:
        return (ZENOH,)

    def problems(self, session: Session) -> Iterable[tuple[str, str]]:
        from rsb_extras.zenoh import zenoh_rules  # noqa: PLC0415 -- `Feature` says why, here and below

        return zenoh_rules.problems(session)

    def advice(self, session: Session, file: Path | None) -> Iterable[tuple[str, str]]:
        from rsb_extras.zenoh import zenoh_rules  # noqa: PLC0415

        return zenoh_rules.advice(session)

    def client_session(self, session: Session, client: Session, address: str, port: int | None) -> Session:
        from rsb_extras.zenoh import zenoh_rules  # noqa: PLC0415

        return zenoh_rules.client_session(session, client, address, port)

    def transport_traits(self) -> Iterable[type[TransportTraits]]:
        from rsb_extras.zenoh.zenoh_traits import ZenohDropTraits, ZenohTraits  # noqa: PLC0415

        return ZenohTraits, ZenohDropTraits

    def transports(self, session: Session, base: Path, random: Any, strangers: Strangers) -> Iterable[Transport]:
        settings = ZENOH.of(session)
        if settings is None:
            return ()
        from rsb_extras.zenoh.network import Network  # noqa: PLC0415
        from rsb_extras.zenoh.zenoh_transport import Links, ZenohDropTransport, ZenohTransport  # noqa: PLC0415

        links = Links(Network(settings, base, strangers, random.random()), session.name)
        return ZenohTransport(links), ZenohDropTransport(links)


FEATURE = Zenoh()
