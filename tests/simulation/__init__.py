"""The engine on a simulated clock, network and ROS: a day takes a minute, and a seed decides all that happens.

Read in this order:

- `loop`: time.
- `network`: the paths between machines; `machine`: machines and their processes; `streams` and `sockets`: the sockets
  of a process.
- `ros`: a ROS domain; `node`: an engine's view of it; `engine_host`: a machine with an engine in a domain.
- `flow`: a route's nodes; `topic_flow`, `service_flow` and `action_flow`: those of topics, services and actions, with
  their counts; `services` and `action_server`: servers and clients; `sessions` and `world`: all of these from a seed;
  `world_log`: what happened.
- `conditions`, `faults` and `operators`: causes of change; `invariants`, `call_invariants`, `action_invariants` and
  `tables`: conditions that are checked every few seconds.
- `beds` and `call_harness`: worlds without faults, in which tests live that are coroutines (`conftest`).

``python -m tests.simulation SEED`` plays a world.
"""
