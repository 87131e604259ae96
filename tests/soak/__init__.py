"""Long runs of new simulated worlds, and at the same time of real processes that are killed, cut off and frozen.

`python -m tests.soak` (``make soak``) runs both parts for as long as told. pytest collects one short run of the real
part only (`test_soak`), so that the rest does not rot.

- `worlds` plays simulated worlds, one process each.
- `stage` is a bridge with real ROS on both sides: `processes`, `network` between them, and a `listener` of each topic.
- `faults` breaks something there, `measures` and `ledgers` collect figures, `audit` counts messages.
- `report` prints the figures and names each broken bound.
"""
