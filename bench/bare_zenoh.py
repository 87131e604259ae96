"""`bench.bare` over Zenoh instead of TCP: ``python -m bench.bare_zenoh send|receive DOMAIN TOPIC PORT``."""

from __future__ import annotations

import sys

import zenoh
from bench.bare import publisher, send_all

_KEY = "rsb_bench/bare"


def main() -> None:
    part, domain, topic, port = sys.argv[1:]
    config = zenoh.Config()
    config.insert_json5("mode", '"peer"')
    config.insert_json5("scouting/multicast/enabled", "false")
    # By default, a peer listens at a port of its own, too.
    config.insert_json5("listen/endpoints", "[]")
    config.insert_json5(f"{'connect' if part == 'send' else 'listen'}/endpoints", f'["tcp/127.0.0.1:{port}"]')
    with zenoh.open(config) as session:
        if part == "send":
            samples = session.declare_publisher(_KEY, congestion_control=zenoh.CongestionControl.BLOCK)
            send_all(int(domain), topic, samples.put)
        else:
            publish = publisher(int(domain), topic)
            session.declare_subscriber(_KEY, lambda sample: publish(sample.payload.to_bytes()))
            print("ready", flush=True)
            sys.stdin.read()


if __name__ == "__main__":
    main()
