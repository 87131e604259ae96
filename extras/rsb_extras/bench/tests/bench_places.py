"""Names of the benchmark that its tests read or replace (`tests.support.places`)."""

from __future__ import annotations

from tests.support.places import Place

BENCH_LATE = Place("rsb_extras.bench.bench_ends", "_LATE_SECONDS")
BENCH_QUIET = Place("rsb_extras.bench.link_bench", "_QUIET")
BENCH_IDLE = Place("rsb_extras.bench.link_bench", "_IDLE_FOR")
ASK_PEER = Place("rsb_extras.bench.link_bench", "LinkBench._ask")
LOOPBACK = Place("rsb_extras.bench.bench_command", "Loopback")
WRITE_RECORDINGS = Place("rsb_extras.bench.bench_recording", "BenchRecording.write")
MOST_BYTES = Place("rsb_extras.bench.bench_recording", "MOST_BYTES")
MOST_MESSAGES = Place("rsb_extras.bench.kept_messages", "MOST_MESSAGES")
MOST_FOREIGN = Place("rsb_extras.bench.kept_messages", "MOST_FOREIGN")
