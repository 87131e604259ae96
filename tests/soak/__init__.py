"""Long runs: new simulated worlds, and beside them real processes that are killed, cut off and frozen.

`python -m tests.soak` (``make soak``) runs both parts for as long as told. pytest collects one short run of the real
part only (`test_soak`), so that the rest does not rot.

- `worlds` plays simulated worlds, one process each.
- `stage` is a bridge with real ROS on both sides: `processes`, `network` between them, `listeners` that listen.
- `faults` are what goes wrong there, `measures` and `ledgers` are what is measured, `audit` counts messages.
- `report` prints the figures and says in words which bound is broken.
"""
