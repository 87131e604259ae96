"""A Zenoh router for benchmarks and the demo: ``python -m rsb_extras.demo.router ENDPOINT``.

It says "{}" once it listens, and ends when its standard input does.
"""

from __future__ import annotations

import json
import sys


def main() -> None:
    """Run until the parent process is gone."""
    import zenoh  # noqa: PLC0415 (an extra)

    config = zenoh.Config()
    config.insert_json5("mode", '"router"')
    config.insert_json5("listen/endpoints", json.dumps(sys.argv[1:]))
    # With multicast, other Zenoh programs of the network would find the router.
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("transport/shared_memory/enabled", "false")  # a killed process would leave segments behind
    with zenoh.open(config):
        sys.stdout.write("{}\n")
        sys.stdout.flush()
        sys.stdin.read()


if __name__ == "__main__":
    main()
