"""The engine on a clock, a network and a ROS of its own: days in seconds, and a seed is a world.

Read in this order:

- `loop`: time.
- `network`: what lies between the machines; `machine`: they and their processes; `streams` and `sockets`: what a
  program sees of all that.
- `ros`: a ROS domain; `node`: what an engine sees of it; `station`: a machine with an engine in a domain.
- `flows`: topics, with what is counted at both ends; `services` and `exchanges`: services, and their calls;
  `action_server` and `errands`: actions, and their goals; `sessions` and `world`: all of these from a seed;
  `chronicle`: what has happened there.
- `climate`, `faults` and `operators`: what happens; `invariants`, `call_invariants`, `action_invariants` and `tables`:
  what must hold all along.

``python -m tests.simulation SEED`` plays a world.
"""
