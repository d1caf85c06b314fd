"""A stepper as an rclpy lifecycle node of a ROS 2 graph (rclpy of an installation, or of the extra `ros2`).

parameters ─▶ settings ─▶ node: states, services, live parameters ──────────────┐
inlets ─▶ sensing: measurement ─┐                                               ▼
inlets, action ─▶ asking ─▶ planned, mapped, whole_body: wishes ─┴─▶ bridge: clock, stepper ─▶ outputs
"""
