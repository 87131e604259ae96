"""Files of other bridges."""

from __future__ import annotations

BRINGUP = """\
client_node:
  ros__parameters:
    server_ip: '127.0.0.1'
    server_port: 3000
    receive_topics: ['topic']
    receive_msg_types: ['String']
    receive_ports: [12001]
    receive_protocols: ['TCP']
    receive_qos: ['10']
"""
DOMAINS = """\
name: hall
from_domain: 2
to_domain: 3
topics:
  clock:
    type: rosgraph_msgs/msg/Clock
  battery:
    type: sensor_msgs/msg/BatteryState
    remap: hall/battery
    qos: {reliability: best_effort, durability: volatile, depth: 5, deadline: 500000000, lifespan: -1,
          liveliness: manual_by_topic, liveliness_lease_duration: 2000000000}
  goal_pose:
    type: geometry_msgs/msg/PoseStamped
    reversed: True
  chat:
    type: std_msgs/msg/String
    bidirectional: True
"""
ZENOH = """\
plugins:
  ros2dds:
    namespace: /robot1
    domain: 7
    allow:
      publishers: [".*/scan", "/(map|tf)"]
      subscribers: ["/cmd_vel"]
      service_servers: [".*/light"]
      action_servers: ["/dock"]
    pub_max_frequencies: ["/tf=10", ".*/scan=5"]
    pub_priorities: ["/map=7", ".*/scan=2"]
    queries_timeout: {default: 8.0}
connect: {endpoints: [tcp/192.168.1.10:7447]}
"""
