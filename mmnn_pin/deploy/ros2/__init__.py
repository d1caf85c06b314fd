"""A stepper as a node of a ROS 2 graph, by DDS and without an installation of ROS 2 (extra `ros2`).

settings ─▶ link: topics, sources, floods ─▶ sensing: measurement ─┐
│                                                  ├─▶ node: clock, stepper ─▶ outputs ─▶ link
└────────▶ asking, action: setpoints ──────────────┘
"""
