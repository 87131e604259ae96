"""The process that attacks: ``python -m bench.attacks.attacker NAME TARGET``; a line asks for its tally, as JSON."""

from __future__ import annotations

import json
import os
import sys
import threading
import time
import traceback
from collections import Counter

from bench.attacks import callers, peers, strangers
from bench.attacks.target import Tally, Target

ATTACKS = strangers.ATTACKS | peers.ATTACKS | callers.ATTACKS


def main() -> None:
    name, target = sys.argv[1], Target(*json.loads(sys.argv[2]))
    tally: Tally = Counter()
    threading.Thread(target=_attack, args=(name, target, tally), daemon=True).start()
    deadline = time.monotonic() + 10
    # The attack begins before this line is printed: no measured second is without it.
    while not tally and time.monotonic() < deadline:
        time.sleep(0.01)
    print("begun", flush=True)
    for _ in sys.stdin:
        print(json.dumps(dict(tally)), flush=True)
    # Attacks never return, and a usual exit would close their connections in order.
    os._exit(0)


def _attack(name: str, target: Target, tally: Tally) -> None:
    try:
        ATTACKS[name].run(target, tally)
    except Exception as error:  # noqa: BLE001 - the tally is all that is heard of this process
        tally[f"ended by {error!r}"] += 1
        traceback.print_exc()


if __name__ == "__main__":
    main()
