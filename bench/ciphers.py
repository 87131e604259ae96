"""Prints the cost of encryption and compression a byte, here and on small computers: ``python -m bench.ciphers``.

Measured here: each cipher with this processor's instructions for AES, and in a child process whose OpenSSL does not use
them (OPENSSL_ia32cap, x86 only; that takes wide vectors away, too). Other computers' figures are estimates from
published figures of their cores; unpublished ones are scaled from this computer's (`Core.slower`).
"""

from __future__ import annotations

import json
import os
import random
import subprocess
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import zstandard
from cryptography.hazmat.primitives.ciphers.aead import AESGCM, ChaCha20Poly1305

if TYPE_CHECKING:
    from collections.abc import Callable

SIZES = (256, 2_500, 100_000)
_LEVEL = 3
_TRIES, _TRY = 300, 0.001
_WITHOUT = {"OPENSSL_ia32cap": "~0x200000200000000"}  # neither AES-NI nor PCLMULQDQ, OPENSSL_ia32cap(3)


class Core(NamedTuple):
    """A core without instructions for AES.

    Attributes:
        name: name of the core, and a computer that has it.
        ghz: its clock.
        aes: cycles a byte of AES-256-GCM: github.com/lelegard/aesbench, RESULTS.md, OpenSSL 3.0.
        chacha: of ChaCha20-Poly1305: OpenSSL, chacha-armv8.pl and poly1305-armv8.pl, the sum of both; of the
            Cortex-A57, which the A72 succeeds.
        slower: cycles that zstd takes there for one here: an assumption.
    """

    name: str
    ghz: float
    aes: float
    chacha: float
    slower: float


CORES = (
    Core("Cortex-A53 (Raspberry Pi 3)", 1.2, 8 / 0.236, 4.72 + 1.47, 3.0),
    Core("Cortex-A72 (Raspberry Pi 4)", 1.8, 8 / 0.129, 4.43 + 1.14, 2.0),
)


def main() -> None:
    if sys.argv[1:] == ["child"]:
        print(json.dumps(_ciphers()))
        return
    ghz = _ghz()
    print(f"here, ns a byte ({ghz:.1f} GHz)")
    _row("bytes", "AES-GCM", "ChaCha20", "AES-GCM, no AES", "ChaCha20, no AES")
    with_aes, without = _in_child({}), _in_child(_WITHOUT)
    for size in SIZES:
        costs = (*with_aes[str(size)], *without[str(size)])
        _row(size, *(f"{cost:.2f}" for cost in costs))
    print(f"\nzstd at level {_LEVEL}, here, ns a byte of the message")
    _row("", "bytes", "packed to", "pack", "unpack")
    packing = {name: _zstd(content) for name, content in _contents().items()}
    for name, each in packing.items():
        _row(name, each.size, f"{each.share:.2f}", f"{each.pack:.1f}", f"{each.unpack:.1f}")
    print("\nestimates: ms a MB, and MB/s of one core that does nothing else")
    _row("", "AES-GCM", "", "ChaCha20", "", "pack a map", "", "unpack it", "")
    grid = packing["map"]
    for core in CORES:
        cycles = (core.aes, core.chacha, grid.pack * ghz * core.slower, grid.unpack * ghz * core.slower)
        cells = [cell for each in cycles for cell in (f"{each / core.ghz:.1f}", f"{1000 * core.ghz / each:.0f}")]
        _row(core.name, *cells)


def _in_child(environment: dict[str, str]) -> dict[str, list[float]]:
    inherited = {name: value for name, value in os.environ.items() if name not in _WITHOUT}
    done = subprocess.run(
        [sys.executable, "-m", "bench.ciphers", "child"], env=inherited | environment, capture_output=True, check=True
    )
    costs: dict[str, list[float]] = json.loads(done.stdout)
    return costs


def _ciphers() -> dict[str, list[float]]:
    """Nanoseconds a byte of each cipher, by size."""
    return {str(size): [_sealing(AESGCM, size), _sealing(ChaCha20Poly1305, size)] for size in SIZES}


def _sealing(cipher: type[AESGCM | ChaCha20Poly1305], size: int) -> float:
    content, nonce, seal = os.urandom(size), bytes(12), cipher(bytes(range(32))).encrypt
    return _cost(lambda: seal(nonce, content, b""), size)


class Packing(NamedTuple):
    """The effect of zstd on a message: its bytes, the remaining share, and ns a byte to pack and to unpack it."""

    size: int
    share: float
    pack: float
    unpack: float


def _zstd(content: bytes) -> Packing:
    packer, unpacker = zstandard.ZstdCompressor(_LEVEL), zstandard.ZstdDecompressor()
    packed, size = packer.compress(content), len(content)
    pack = _cost(lambda: packer.compress(content), size)
    return Packing(size, len(packed) / size, pack, _cost(lambda: unpacker.decompress(packed), size))


def _contents() -> dict[str, bytes]:
    """Return messages' contents: an occupancy grid with few obstacles, and a laser scan's floats with noise."""
    noise = random.Random(1)
    grid = bytes(noise.choices((0, 100, 255), (90, 3, 7))[0] for _ in range(384 * 384))
    ranges = memoryview(bytearray(4 * 720)).cast("f")
    for index in range(720):
        ranges[index] = 3 + noise.gauss(0, 0.01)
    return {"map": grid, "scan": ranges.tobytes()}


def _cost(work: Callable[[], object], size: int) -> float:
    """Nanoseconds a byte: the best of many tries, each so short that hardly anything comes between."""
    began = time.perf_counter()
    work()
    count = max(1, int(_TRY / (time.perf_counter() - began)))
    best = float("inf")
    for _ in range(_TRIES):
        began = time.perf_counter()
        for _ in range(count):
            work()
        best = min(best, time.perf_counter() - began)
    return best / count / size * 1e9


def _ghz() -> float:
    """Return this processor's clock rate from the kernel."""
    lines = Path("/proc/cpuinfo").read_text(encoding="ascii", errors="replace").splitlines()
    return next((float(line.split(":")[1]) / 1000 for line in lines if line.startswith("cpu MHz")), 1.0)


def _row(*cells: object) -> None:
    print(f"{cells[0]!s:<28}" + " ".join(f"{cell!s:>16}" for cell in cells[1:]))


if __name__ == "__main__":
    main()
