"""A robot's own programs, which only talk: ``python -m tests.soak.talker DOMAIN PREFIX KIND...``.

It says ``{"ready": true}`` once it publishes. ``hush`` and ``talk`` on its standard input stop it and let it go on; it
answers each with how many messages it has published, by topic. It ends with its input.
"""

from __future__ import annotations

import json
import select
import sys
import time

from tests.soak.messages import KINDS, Kind, encode
from tests.support.domain import BEST_EFFORT, LATCHED, RELIABLE, Domain

_LONGEST_WAIT = 0.1


class _Talker:
    def __init__(self, domain: Domain, topic: str, kind: Kind, life: int) -> None:
        self.topic = topic
        self.number = 0
        self.due = time.monotonic()
        self._life = life
        self._interval = 1 / kind.rate
        self._filler = b"x" * kind.size
        qos = LATCHED if kind.latched else BEST_EFFORT if kind.best_effort else RELIABLE
        self._publisher = domain.publisher(topic, qos=qos)

    def work(self, now: float) -> None:
        if now < self.due:
            return
        self.due = now + self._interval if now - self.due > self._interval else self.due + self._interval
        self.number += 1
        self._publisher.publish(encode(self._life, self.number, time.time_ns(), self._filler))


def main(domain_id: int, *named: str) -> None:
    """Talk until the input ends.

    Args:
        named: ``PREFIX KIND`` each: the prefix of a topic in this domain, and its kind in `KINDS`.
    """
    domain, life = Domain(domain_id), time.time_ns()
    kinds = {kind.topic: kind for kind in KINDS}
    pairs = zip(named[::2], named[1::2], strict=True)
    talkers = [_Talker(domain, prefix + topic, kinds[topic], life) for prefix, topic in pairs]
    sys.stdout.write('{"ready": true}\n')
    sys.stdout.flush()
    talks = True
    while True:
        now = time.monotonic()
        due = min(talker.due for talker in talkers) - now if talks else _LONGEST_WAIT
        if select.select([sys.stdin], [], [], min(max(0.0, due), _LONGEST_WAIT))[0]:
            line = sys.stdin.readline()
            if not line:
                break
            talks = line == "talk\n"
            sys.stdout.write(json.dumps({"said": {talker.topic: talker.number for talker in talkers}}) + "\n")
            sys.stdout.flush()
        for talker in talkers if talks else ():
            talker.work(time.monotonic())
    domain.close()


if __name__ == "__main__":
    main(int(sys.argv[1]), *sys.argv[2:])
