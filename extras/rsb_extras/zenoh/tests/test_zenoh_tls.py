"""A Zenoh network over TLS and QUIC, and the reasons that an operator gets for wrong certificates."""

from __future__ import annotations

import asyncio
import datetime
import json
from typing import TYPE_CHECKING, Any

import pytest
from tests.support.certificates import Authority
from tests.support.wording import says

from rsb_extras.zenoh import ZenohSettings
from rsb_extras.zenoh.network import Network
from rsb_extras.zenoh.tests import zenoh_places
from rsb_extras.zenoh.unreachable import CertificateRemedy, Unreachable

zenoh = pytest.importorskip("zenoh")
from rsb_extras.zenoh.tests.zenoh_router import Router  # noqa: E402 (it needs the package)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from rsb_extras.zenoh.endpoint import ZenohEndpoint

    Start = Callable[..., Router]

EXPIRED = datetime.timedelta(days=-1)


@pytest.fixture(autouse=True)
def patience(monkeypatch: pytest.MonkeyPatch) -> None:
    """A router on a busy machine may answer late."""
    zenoh_places.LOOK_WITHIN.set(monkeypatch, 60.0)


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Start]:
    made: list[Router] = []

    def begin(
        certificate: str, key: str, *, asks_of: str | None = None, protocol: str = "tls", **settings: Any
    ) -> Router:
        tls: dict[str, Any] = {
            "listen_certificate": str(tmp_path / certificate),
            "listen_private_key": str(tmp_path / key),
        }
        if asks_of is not None:
            tls |= {"enable_mtls": True, "root_ca_certificate": str(tmp_path / asks_of)}
        made.append(Router(protocol, transport={"link": {"tls": tls}}, **settings))
        return made[-1]

    yield begin
    for each in made:
        each.close()


def told(folder: Path, router: Router, **tls: Any) -> str:
    """Return the reason that an operator gets, or an empty string if it works.

    Files are relative to the configuration.
    """
    (folder / "zenoh.json5").write_text(json.dumps({"transport": {"link": {"tls": tls}}}))

    async def test() -> str:
        network = Network(ZenohSettings(connect=(router.endpoint,), config="zenoh.json5"), folder)
        try:
            await network.open()
        except OSError as error:
            return str(error)
        finally:
            network.close()
        return ""

    return asyncio.run(test())


@pytest.mark.parametrize("protocol", ["tls", "quic"])
def test_a_router_with_a_certificate_of_our_authority(tmp_path: Path, start: Start, protocol: str) -> None:
    authority = Authority(tmp_path)
    router = start(*authority.sign("hub"), protocol=protocol)
    assert told(tmp_path, router, root_ca_certificate=authority.file) == ""


@pytest.mark.parametrize(
    ("certificate", "remedy"),
    [
        ({}, CertificateRemedy.UNTRUSTED),
        ({"valid_for": EXPIRED}, CertificateRemedy.EXPIRED),
        ({"host": "hub.example"}, CertificateRemedy.WRONG_NAME),
    ],
    ids=["another authority", "expired", "another name"],
)
def test_a_router_whose_certificate_is_refused(
    certificate: dict[str, Any], remedy: CertificateRemedy, tmp_path: Path, start: Start
) -> None:
    authority = Authority(tmp_path)
    router = start(*authority.sign("hub", **certificate))
    trusted = authority if certificate else Authority(tmp_path, "other")
    said = told(tmp_path, router, root_ca_certificate=trusted.file)
    assert says(said, Unreachable.CERTIFICATE_REFUSED, remedy=remedy())


def test_a_router_that_asks_for_a_certificate(tmp_path: Path, start: Start) -> None:
    authority = Authority(tmp_path)
    router = start(*authority.sign("hub"), asks_of=authority.file)
    certificate, key = authority.sign("robot1")
    own = {"enable_mtls": True, "connect_certificate": certificate, "connect_private_key": key}
    assert told(tmp_path, router, root_ca_certificate=authority.file, **own) == ""
    said = told(tmp_path, router, root_ca_certificate=authority.file)
    assert says(said, Unreachable.OWN_CERTIFICATE_MISSING)


@pytest.mark.parametrize("fault", ["stranger", "expired"])
def test_a_certificate_of_ours_that_is_refused(tmp_path: Path, start: Start, fault: str) -> None:
    authority = Authority(tmp_path)
    router = start(*authority.sign("hub"), asks_of=authority.file)
    if fault == "stranger":
        certificate, key = Authority(tmp_path, "other").sign("robot1")
    else:
        certificate, key = authority.sign("robot1", valid_for=EXPIRED)
    own = {"enable_mtls": True, "connect_certificate": certificate, "connect_private_key": key}
    said = told(tmp_path, router, root_ca_certificate=authority.file, **own)
    assert says(said, Unreachable.OWN_CERTIFICATE_REFUSED)


def test_a_file_that_is_missing(tmp_path: Path, start: Start) -> None:
    router = start(*Authority(tmp_path).sign("hub"))
    said = told(tmp_path, router, root_ca_certificate="nowhere.pem")
    assert "No such file" in said


def test_a_router_that_speaks_no_tls(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    zenoh_places.LOOK_WITHIN.set(monkeypatch, 2.0)  # it may wait for more of what it takes for Zenoh
    plain = Router()
    try:
        authority = Authority(tmp_path)
        (tmp_path / "zenoh.json5").write_text("{}")

        class Asked:
            endpoint = plain.endpoint.replace("tcp/", "tls/")

        said = told(tmp_path, Asked, root_ca_certificate=authority.file)  # type: ignore[arg-type]
        assert says(said, Unreachable.NO_TLS, host="127.0.0.1")
    finally:
        plain.close()


def access_control(*names: str) -> dict[str, Any]:
    """Return the access control of zenoh.md: only these certificates' owners may be in the fleet."""
    messages = [
        "put",
        "declare_subscriber",
        "liveliness_token",
        "declare_liveliness_subscriber",
        "liveliness_query",
        "reply",
    ]
    rule = {"id": "fleet", "permission": "allow", "flows": ["ingress", "egress"], "messages": messages}
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": [{**rule, "key_exprs": ["rsb_console/fleet/**"]}],
        "subjects": [{"id": "robots", "cert_common_names": [*names]}],
        "policies": [{"rules": ["fleet"], "subjects": ["robots"]}],
    }


def test_access_control_keeps_others_out_of_the_fleet(tmp_path: Path, start: Start) -> None:
    authority = Authority(tmp_path)
    router = start(*authority.sign("hub"), asks_of=authority.file, access_control=access_control("pc", "robot1"))
    networks: list[Network] = []

    async def join(name: str, service: str) -> ZenohEndpoint:
        certificate, key = authority.sign(name)
        own = {"enable_mtls": True, "connect_certificate": certificate, "connect_private_key": key}
        tls = {"root_ca_certificate": authority.file, **own}
        (tmp_path / f"{name}.json5").write_text(json.dumps({"transport": {"link": {"tls": tls}}}))
        networks.append(Network(ZenohSettings(connect=(router.endpoint,), config=f"{name}.json5"), tmp_path))
        return await networks[-1].endpoint(service, name, ("client",))

    async def test() -> None:
        server = await join("pc", "server")
        came: list[bytes] = []
        server.on_datagram = lambda _, payload: came.append(payload)
        refused = await join("visitor", "client")
        server.trust(refused.address, "")
        refused.outbox.drop(refused.key(server.address), b"no")
        robot = await join("robot1", "client")
        server.trust(robot.address, "")
        async with asyncio.timeout(180):
            while robot.address not in server.seen or not came:
                robot.outbox.drop(robot.key(server.address), b"yes")
                await asyncio.sleep(0.01)
            assert [each.address for each in await robot.ask("server")] == [server.address]
            assert await refused.ask("server") == []
        assert refused.address not in server.seen
        assert {*came} == {b"yes"}
        for endpoint in (server, refused, robot):
            endpoint.close()

    asyncio.run(test())
    for network in networks:
        network.close()
