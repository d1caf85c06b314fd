"""What `mmnn ros2` tells, live in Foxglove by its own library: `pip install foxglove-sdk`, then open ws://localhost:8765.

    python live.py [--port 8765] [--node /mmnn]        where rclpy and control_msgs are

/joints has what the arm's joints are asked for, where they are and their errors; /base the same of the base; /node the
numbers of its diagnostics: errors, Psi_hat, torques, the learned share. Plot any of them by name.
"""

import argparse

import foxglove
import rclpy
from control_msgs.msg import JointTrajectoryControllerState
from diagnostic_msgs.msg import DiagnosticArray

STATES = ("reference", "feedback", "error")


def on_state(message):
    """The controller's state, by names of the joints."""
    names, told = message.joint_names, {}
    for state in STATES:
        point = getattr(message, state)
        told[state] = {
            part: dict(zip(names, getattr(point, part), strict=False)) for part in ("positions", "velocities")
        }
    foxglove.log("/joints", told)
    base = {state: getattr(message, f"multi_dof_{state}").transforms for state in STATES}
    places = {state: one[0].translation for state, one in base.items() if one}
    if places:
        foxglove.log("/base", {state: {"x": place.x, "y": place.y} for state, place in places.items()})


def on_diagnostics(message):
    """All numbers of the diagnostics."""
    told = {
        one.name.removeprefix("mmnn: "): {pair.key: float(pair.value) for pair in one.values} for one in message.status
    }
    foxglove.log("/node", told)


def main():
    """Stream until Ctrl-C."""
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--port", type=int, default=8765)
    options.add_argument("--node", default="/mmnn")
    options = options.parse_args()
    server = foxglove.start_server(name="mmnn", port=options.port)
    rclpy.init(args=[])
    node = rclpy.create_node("live")
    node.create_subscription(JointTrajectoryControllerState, f"{options.node}/controller_state", on_state, 10)
    node.create_subscription(DiagnosticArray, "/diagnostics", on_diagnostics, 10)
    print(f"open ws://localhost:{server.port} in Foxglove", flush=True)
    try:
        rclpy.spin(node)
    except (KeyboardInterrupt, rclpy.executors.ExternalShutdownException):
        server.stop()


if __name__ == "__main__":
    main()
