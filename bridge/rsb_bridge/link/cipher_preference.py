"""Which cipher suite this machine prefers."""

from __future__ import annotations

from pathlib import Path

from rsb_bridge.wire.sealing import Suite


def preferred_suite() -> Suite:
    """AES-GCM where the processor has AES instructions (a flag in /proc/cpuinfo), else ChaCha20-Poly1305."""
    try:
        flags = Path("/proc/cpuinfo").read_text(encoding="ascii", errors="replace").split()
    except OSError:
        return Suite.CHACHAPOLY
    return Suite.AESGCM if "aes" in flags else Suite.CHACHAPOLY
