"""zenoh-bridge-ros2dds between two domains, for comparison: its plugin in a program that ``make peers`` builds.

``python -m bench.zenoh_bridge KEY=JSON5...`` becomes one side of it, with these keys of its configuration; `arguments`
makes them. It ends with its standard input.
"""

from __future__ import annotations

import contextlib
import datetime
import json
import os
import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec

from rsb_extras.demo.demo_session import free_port
from rsb_extras.demo.processes import Process, listening

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

NAME, WITH_TLS = "zenoh-bridge", "zenoh-bridge-tls"
PROGRAM = Path(__file__).parent / "peers/zenoh_bridge/target/release/zenoh_bridge"
_CYCLONE = (
    "<CycloneDDS><Domain><General>"
    "<Interfaces><NetworkInterface name='lo'/></Interfaces>"
    "</General></Domain></CycloneDDS>"
)
"""Without it, Cyclone DDS takes another interface than loopback, on which nodes of `LOCALHOST` do not answer."""


def check_built() -> None:
    """End this process with a sentence if the program is not built."""
    if not PROGRAM.exists():
        raise SystemExit("zenoh-bridge-ros2dds is not built: run `make peers`")


@contextlib.contextmanager
def between(near: int, far: int, *, tls: bool = False) -> Iterator[list[Process]]:
    """Start a side in each domain, and yield the sending and the receiving one. Their topics open some time later."""
    check_built()
    with tempfile.TemporaryDirectory(prefix="rsb-bench-") as folder:
        port = free_port()
        endpoint, keys = f"tcp/127.0.0.1:{port}", {}
        if tls:
            endpoint, keys = f"tls/127.0.0.1:{port}", tls_keys(Path(folder))
        with Process(*arguments(far, "listen", endpoint, keys)) as receiving:
            listening(receiving, port)
            with Process(*arguments(near, "connect", endpoint, keys)) as sending:
                yield [sending, receiving]


def arguments(domain: int, part: str, endpoint: str, keys: Mapping[str, object] | None = None) -> list[str]:
    """Return the arguments with which Python becomes a side.

    Args:
        part: ``listen`` or ``connect``.
        endpoint: as Zenoh writes it, ``tcp/HOST:PORT``.
        keys: more of its configuration.
    """
    config = {
        "mode": "router",  # the default of zenoh-bridge-ros2dds, not of the library
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "listen/endpoints": [],  # a router listens at a fixed port, and there are two
        f"{part}/endpoints": [endpoint],
        "plugins/ros2dds/domain": domain,
        **(keys or {}),
    }
    return ["-m", "bench.zenoh_bridge", *(f"{key}={json.dumps(value)}" for key, value in config.items())]


def tls_keys(folder: Path) -> dict[str, object]:
    """Write a certificate that signs itself into a folder; return what both sides' configuration says of it."""
    key, name = ec.generate_private_key(ec.SECP256R1()), x509.Name.from_rfc4514_string("CN=localhost")
    now = datetime.datetime.now(datetime.UTC)
    certificate = (
        x509.CertificateBuilder(name, name, key.public_key(), x509.random_serial_number())
        .not_valid_before(now)
        .not_valid_after(now + datetime.timedelta(days=1))
        .add_extension(x509.SubjectAlternativeName([x509.DNSName("localhost")]), critical=False)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .sign(key, hashes.SHA256())
    )
    pem, private = folder / "certificate.pem", folder / "private.pem"
    pem.write_bytes(certificate.public_bytes(serialization.Encoding.PEM))
    private.write_bytes(
        key.private_bytes(serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption())
    )
    tls = "transport/link/tls"
    return {
        f"{tls}/listen_certificate": str(pem),
        f"{tls}/listen_private_key": str(private),
        f"{tls}/root_ca_certificate": str(pem),
        f"{tls}/verify_name_on_connect": False,  # the endpoint is an address
    }


def main() -> None:
    os.environ["CYCLONEDDS_URI"] = _CYCLONE
    # The process stays the same, so that its CPU time and memory are found by its number.
    os.execv(PROGRAM, [PROGRAM.name, *sys.argv[1:]])


if __name__ == "__main__":
    main()
