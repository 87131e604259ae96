"""A poor wire: passes Ethernet frames between two devices, and loses, doubles and delays some.

Linux's netem does that too, but not every kernel has it. `python -m tests.network.wire DEVICE DEVICE LOSS DOUBLED DELAY
JITTER`: probabilities, and s. Each frame is delayed on its own, so the next one may overtake it.
"""

from __future__ import annotations

import heapq
import itertools
import random
import select
import socket
import sys
import time

_ALL_PROTOCOLS = socket.htons(3)
_SOL_PACKET, _PACKET_VNET_HDR, _PACKET_IGNORE_OUTGOING = 263, 15, 23
_FRAME = 70_000


def _open(device: str) -> socket.socket:
    sock = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, _ALL_PROTOCOLS)
    # Frames come with what the sending host left to the hardware (checksums, segmentation), and are passed on so.
    sock.setsockopt(_SOL_PACKET, _PACKET_VNET_HDR, 1)
    sock.setsockopt(_SOL_PACKET, _PACKET_IGNORE_OUTGOING, 1)
    sock.bind((device, 0))
    return sock


def _main(devices: list[str], loss: float, doubled: float, delay: float, jitter: float) -> None:
    one, other = (_open(device) for device in devices)
    far = {one: other, other: one}
    dice = random.Random(1)  # the same wire each time
    order = itertools.count()
    waiting: list[tuple[float, int, socket.socket, bytes]] = []
    while True:
        pause = max(0.0, waiting[0][0] - time.monotonic()) if waiting else None
        for sock in select.select([one, other], [], [], pause)[0]:
            frame = sock.recv(_FRAME)
            for _ in range((dice.random() >= loss) + (dice.random() < doubled)):
                due = time.monotonic() + delay + jitter * dice.random()
                heapq.heappush(waiting, (due, next(order), far[sock], frame))
        while waiting and waiting[0][0] <= time.monotonic():
            _, _, sock, frame = heapq.heappop(waiting)
            sock.send(frame)


if __name__ == "__main__":
    _main(sys.argv[1:3], *(float(word) for word in sys.argv[3:]))
