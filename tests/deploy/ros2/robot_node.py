"""A simulated robot as a node of real ROS 2 (rclpy): two wheels with velocity servos, an arm with effort motors.

It knows nothing of this package. A line says when it drives at first; at the end it tells as JSON how it was driven.

    python robot_node.py SECONDS [FAULT@TIME ...] [JOINT=POSITION ...]        SIGTERM ends it earlier

Joints that are named are servos of positions, in place of the two on efforts.
"""

import contextlib
import json
import math
import os
import signal
import sys
import time

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, TransformStamped, Twist, TwistStamped, WrenchStamped
from nav_msgs.msg import Odometry, Path
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import serialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Empty, Float64MultiArray
from tf2_msgs.msg import TFMessage
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

RATE, STEP, INERTIA, DAMPING, LAG = 50.0, 0.0025, (1.2, 0.4), 0.5, 0.05
WHEELS, ARM = ("wheel_left_joint", "wheel_right_joint"), {"arm_1_joint": 0.2, "arm_2_joint": -0.3}
HAND = (0.85, 0.1)  # where the hand is to be [m]
TIMEOUT = 0.5  # of the base's controller, as that of diff_drive_controller [s]


class Robot:
    """State, and what is commanded."""

    def __init__(self, node, faults, servos):
        self.node, self.faults, self.t, self.drove = node, faults, 0.0, False
        self.names, self.q = zip(*(servos or ARM).items(), strict=True)
        self.q, self.place = list(self.q), list(self.q) if servos else None
        self.pose, self.v, self.qdot = [0.0, 0.0, 0.0], [0.0, 0.0], [0.0] * len(self.q)
        self.asked, self.effort, self.heard, self.counts = [0.0, 0.0], [0.0, 0.0], -math.inf, {"twist": 0, "effort": 0}
        self.log, self.told, self.waited, self.commands = [], 0, [], []
        node.create_subscription(TwistStamped, "/diff_drive_controller/cmd_vel", self.on_twist, 10)
        node.create_subscription(Float64MultiArray, "/effort_controller/commands", self.on_effort, 10)
        node.create_subscription(DiagnosticArray, "/diagnostics", self.on_diagnostics, 10)
        node.create_subscription(JointTrajectory, "/arm_controller/joint_trajectory", self.on_place, 10)
        if "no_joystick" not in faults:
            self.drive = node.create_publisher(TwistStamped if "stamped" in faults else Twist, "/cmd_vel", 10)
        self.route = node.create_publisher(Path, "/plan", 1)
        self.plan = node.create_publisher(JointTrajectory, "/mmnn/joint_trajectory", 10)
        self.hand = [
            node.create_publisher(kind, f"/mmnn/hand/{name}", 10)
            for kind, name in zip(
                (PoseStamped, TwistStamped, Float64MultiArray, WrenchStamped),
                ("pose", "twist", "stiffness", "force"),
                strict=True,
            )
        ]
        self.maps = node.create_publisher(TFMessage, "/tf", 20) if "map" in faults else None
        self.simulator = node.create_publisher(Clock, "/clock", 10) if "sim_time" in faults else None
        node.create_subscription(Empty, "/speak", lambda _: self.faults.pop("silent", None), 10)
        self.open()

    def open(self):
        kind = ReliabilityPolicy.BEST_EFFORT if "best_effort" in self.faults else ReliabilityPolicy.RELIABLE
        self.joints = self.node.create_publisher(JointState, "/joint_states", QoSProfile(depth=1, reliability=kind))
        self.odom = self.node.create_publisher(Odometry, "/odom", 10)

    def close(self):
        self.node.destroy_publisher(self.joints)
        self.node.destroy_publisher(self.odom)
        self.joints = None

    def on_twist(self, message):
        self.asked, self.heard = [message.twist.linear.x, message.twist.angular.z], self.t
        stamp = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
        self.commands.append([time.monotonic(), stamp, *self.asked])
        self.counts["twist"] += 1

    def on_effort(self, message):
        self.effort, self.counts["effort"] = list(message.data), self.counts["effort"] + 1

    def on_place(self, message):
        point, self.counts["effort"] = message.points[0], self.counts["effort"] + 1
        order = [message.joint_names.index(name) for name in self.names]
        self.place = [point.positions[i] for i in order]
        self.waited.append(point.time_from_start.sec + 1e-9 * point.time_from_start.nanosec)

    def on_diagnostics(self, message):
        self.told += 1

    def active(self, name):
        """Whether a fault is on: from its time on, and for a second where it says so."""
        return (
            name in self.faults
            and self.t >= self.faults[name]
            and (self.t < self.faults[name] + 1 or "for" not in name)
        )

    def step(self, h):
        asked = self.asked if self.t - self.heard < TIMEOUT else [0.0, 0.0]
        for i in range(2):
            self.v[i] += h / LAG * (asked[i] - self.v[i])
        for i in range(len(self.q)):
            if self.place is None:
                self.qdot[i] += h / INERTIA[i] * (self.effort[i] - DAMPING * self.qdot[i])
            else:
                self.qdot[i] = (self.place[i] - self.q[i]) / LAG  # a servo of positions
            self.q[i] += h * self.qdot[i]
        self.pose[0] += h * self.v[0] * math.cos(self.pose[2])
        self.pose[1] += h * self.v[0] * math.sin(self.pose[2])
        self.pose[2] += h * self.v[1]
        self.t += h
        if self.v[0] > 0.15 and not self.drove:
            self.drove = True
            print("drives", flush=True)
        self.log.append([self.t, *self.pose, *self.v, *self.q, *self.qdot, *self.asked, *self.effort])

    def tell(self, k):
        """Publish what is measured, with what is broken about it."""
        if self.active("kill"):
            os._exit(9)
        if self.active("restart_for") and self.t < self.faults["restart_for"] + 0.2:
            if self.joints is not None:
                self.close()
            return
        if self.joints is None:
            self.open()
        if self.active("silent"):
            return
        stamp = self.node.get_clock().now().to_msg()
        if self.simulator is not None:
            told = self.t + 100.0 - (10.0 if self.active("sim_back") else 0.0)
            stamp.sec, stamp.nanosec = int(told), int(1e9 * (told % 1.0))
            self.simulator.publish(Clock(clock=stamp))
        stamp.sec += 3600 if self.active("ahead") else -3600 if self.active("back") else 0
        state = dict.fromkeys(WHEELS, (0.0, 0.0)) | dict(
            zip(self.names, zip(self.q, self.qdot, strict=True), strict=True)
        )
        names = [WHEELS[0], self.names[0], WHEELS[1], *self.names[1:]]
        if self.active("permuted_for") and k % 2:
            names.reverse()
        if self.active("missing"):
            names.remove("arm_2_joint")
        message = JointState(name=names, position=[state[n][0] for n in names], velocity=[state[n][1] for n in names])
        message.header.stamp = stamp
        if self.active("nan") or (self.active("nan_for") and k % 3 == 0):
            message.position[names.index("arm_1_joint")] = math.nan
        if self.active("half") or (self.active("half_for") and k % 2):
            whole = serialize_message(message)
            self.joints.publish(whole[: len(whole) // 2])
        else:
            self.joints.publish(message)
        if self.active("duplicate_for"):
            if not hasattr(self, "second"):
                self.second = self.node.create_publisher(JointState, "/joint_states", 10)
            message.position = [1.0] * len(names)
            self.second.publish(message)
        elif hasattr(self, "second"):
            self.node.destroy_publisher(self.second)
            del self.second
        odometry = Odometry(child_frame_id="base_footprint")
        odometry.header.stamp, odometry.header.frame_id = stamp, "odom"
        odometry.pose.pose.position.x, odometry.pose.pose.position.y = self.pose[:2]
        odometry.pose.pose.orientation.z, odometry.pose.pose.orientation.w = (
            math.sin(self.pose[2] / 2),
            math.cos(self.pose[2] / 2),
        )
        odometry.twist.twist.linear.x, odometry.twist.twist.angular.z = self.v
        self.odom.publish(odometry)

    def localise(self, since):
        """Tell where the map is, which is corrected 2.5 s after the first command."""
        there = TransformStamped(child_frame_id="odom")
        there.header.frame_id, there.header.stamp = "map", self.node.get_clock().now().to_msg()
        there.transform.translation.y = 0.25 if since > 2.5 else 0.0
        self.maps.publish(TFMessage(transforms=[there]))

    def lead(self, k, since):
        """Lead the hand: to a place, with stiffness that can be had and that cannot, then at a velocity."""
        pose, twist, stiffness, force = self.hand
        if 0.5 < since < 2.5 and k % 20 == 0:
            there = PoseStamped()
            there.header.frame_id = "odom"
            there.pose.position.x, there.pose.position.y, there.pose.orientation.w = *HAND, 1.0
            pose.publish(there)
        if since > 0.5 and k % 100 == 0:
            stiffness.publish(Float64MultiArray(data=[[80.0], [1e9], [1.0, 2.0]][k // 100 % 3]))
        if 3.0 < since < 4.0 and k % 20 == 0:
            moving = TwistStamped()
            moving.header.frame_id, moving.twist.linear.y = "odom", 0.05
            twist.publish(moving)
        if 1.0 < since < 2.0 and k % 20 == 0:
            pushing = WrenchStamped()
            pushing.header.frame_id, pushing.wrench.force.z = "odom", 3.0
            pushing.wrench.torque.x = 1.0 if since > 1.9 else 0.0
            force.publish(pushing)

    def ask(self, k, begun):
        """Drive the base and move the arm from half a second after the first command on."""
        since = self.t - begun
        if self.maps is not None:
            self.localise(since)
        if "hand" in self.faults:
            self.lead(k, since)
            return
        if since > 0.5 and ("map" in self.faults or "path" in self.faults):
            if not hasattr(self, "asked_base"):
                self.asked_base, path = self.t, Path()
                path.header.frame_id = "map" if "map" in self.faults else "odom"
                for i in range(41):
                    pose = PoseStamped()
                    pose.pose.position.x, pose.pose.orientation.w = 0.05 * i, 1.0
                    path.poses.append(pose)
                self.route.publish(path)
        elif since > 0.5 and k % 5 == 0 and not (self.active("silent_joystick") or "no_joystick" in self.faults):
            command = TwistStamped() if "stamped" in self.faults else Twist()
            twist = command.twist if "stamped" in self.faults else command
            if "stamped" in self.faults:
                command.header.stamp = self.node.get_clock().now().to_msg()
            twist.linear.x, twist.angular.z = 0.2, 0.3
            self.drive.publish(command)
        if 0.5 < since < 2.5 and k % 4 == 0 and "jog" in self.faults:  # a point every 80 ms, 0.15 s ahead
            point = JointTrajectoryPoint(positions=[0.2 + 0.3 * (since - 0.5 + 0.15)])
            point.time_from_start.nanosec = 150_000_000
            self.plan.publish(JointTrajectory(joint_names=["arm_1_joint"], points=[point]))
        elif since > 0.5 and not hasattr(self, "asked_arm") and not {"no_plan", "jog"} & set(self.faults):
            self.asked_arm = self.t
            message = JointTrajectory(joint_names=["arm_2_joint", "arm_1_joint"])
            for i, q in enumerate(([-0.3, 0.2], [0.1, 0.5], [0.4, 0.8])):
                point = JointTrajectoryPoint(positions=[float(x) for x in q])
                point.time_from_start.sec = i
                message.points.append(point)
            self.plan.publish(message)


def main():
    seconds, faults = float(sys.argv[1]), {}
    servos = {name: float(q) for name, is_servo, q in (word.partition("=") for word in sys.argv[2:]) if is_servo}
    for word in sys.argv[2:]:
        name, _, at = word.partition("@")
        faults[name] = float(at or 0.0)
    with contextlib.suppress(
        AttributeError, OSError
    ):  # a robot is a machine of its own: what else runs does not delay it
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(40))
    rclpy.init()
    node = rclpy.create_node("robot")
    robot, k, begun = Robot(node, dict.fromkeys(faults, math.inf), servos), 0, math.inf
    start, limit, told = time.monotonic(), time.monotonic() + 1200.0, []
    rate = 4.0 * RATE if "hand" in faults else RATE
    signal.signal(signal.SIGTERM, lambda *_: told.append(time.monotonic() + 0.1))
    while time.monotonic() < min([limit, *told]):
        for _ in range(40):  # all that waits, however late it is
            before = robot.told, *robot.counts.values()
            rclpy.spin_once(node, timeout_sec=0.0)
            if before == (robot.told, *robot.counts.values()):
                break
        if robot.counts["effort"] and begun == math.inf:
            begun, robot.faults = robot.t, {name: at + robot.t for name, at in faults.items()}
            limit = time.monotonic() + seconds
        while robot.t < time.monotonic() - start:  # its time is the wall's, however busy the machine
            robot.step(STEP)
        robot.tell(k)
        if begun < math.inf:
            robot.ask(k, begun)
        k += 1
        time.sleep(max(0.0, 1.0 / rate - (time.monotonic() - start) % (1.0 / rate)))
    signal.signal(signal.SIGTERM, signal.SIG_IGN)  # one that comes while it writes would cut what it tells
    begun = begun if begun < math.inf else 0.0
    rows = [[row[0] - begun, *row[1:]] for row in robot.log if row[0] >= begun]
    asked = getattr(robot, "asked_arm", math.nan) - begun
    print(
        json.dumps(
            {
                "counts": robot.counts,
                "diagnostics": robot.told,
                "asked_arm": asked,
                "rows": rows[::8],
                "waited": robot.waited[:1],
                "commands": robot.commands,
            }
        ),
        flush=True,
    )
    os._exit(0)  # rclpy's destructors are not what is tested


if __name__ == "__main__":
    main()
