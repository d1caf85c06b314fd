"""Is the default learner lost where plain control is not? `python -m research.studies.lost [NAME ...] [--file FILE]`.

Thirty cases that a robot may meet, and a rival, were written down by those who tuned `learned`, thirty more by someone
who had no part in that, thirty more after it had been mended by one of these, and thirty, with another rival, by
someone who knew none of this, each list before the first of it was run. `track` runs each case with `learned`,
`feedforward` and the rival: inverse dynamics of the URDF by Pinocchio at the reference's posture, and an integral, as
an engineer would write it. A run is lost where it does not complete, or where a joint errs by 1 rad, or the base by 1
m. Ratios are of errors in the second half of a run, the RMS of the arm's joints and of the base's position, over those
of `feedforward`. Rows are kept in FILE as they come, and not run again.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from xml.etree import ElementTree

import numpy as np

from mmnn_pin import Loop, Measurement, Setpoint, TorqueController, load, load_experiment
from mmnn_pin.errors import InputError
from mmnn_pin.lab.show.table import Column, Table, number, row_of, terminal_text
from mmnn_pin.model.dynamics import Dynamics
from mmnn_pin.model.robot import Robot
from mmnn_pin.recording.recording import Recording
from mmnn_pin.signals import Array, VelocityCommand
from mmnn_pin.torque.controller import CompiledController, Context


def pushes(force: float, frequency: float, *joints: int) -> str:
    """Sines of this amplitude [N m] and frequency [Hz] on joints of a Panda, as `disturbances` has them."""
    said = f'type="push",shape="sine",force={force},frequency={frequency:.4f}'
    return ",".join(f'{{{said},on="panda_joint{joint}"}}' for joint in joints)


HEAVY = "masses=1.2"
DRY = ("friction.coulomb=0.3", "friction.arm=0.3")
COARSE = ("sensor.resolution=0.0015", "sensor.wheel_resolution=0.0015", "time.control_period=0.002")
DIFFERENCES = (*COARSE, 'sensor.velocity="difference"')
FILTERED = (*COARSE, 'sensor.velocity="filtered"')
LATE = ("latency.command=0.003", "sensor.delay=2")
NOISE = ("sensor.noise=0.0002", "sensor.wheel_noise=0.0002", "sensor.velocity_noise=0.02")
PUSH = 'disturbances=[{type="push",on="panda_joint2",force=15.0,start=3.0,end=5.0}]'
BLOCK = 'disturbances=[{type="block",joint="elbow_joint",start=3.0,end=4.0}]'
HARDLY = ("reference.arm.amplitude=0.02", "time.duration=120")
FIRST: dict[str, tuple[str, ...]] = {  # by those who tuned `learned`
    "URDF right, sensors exact": ("robot=panda",),
    "masses a fifth wrong": ("robot=kinova", HEAVY),
    "dry friction that no file states": ("robot=ur5", *DRY),
    "differences of 12-bit encoders": ("robot=panda", HEAVY, *DIFFERENCES),
    "the same, a mobile base": ("robot=platform_arm", HEAVY, *DRY, *DIFFERENCES),
    "the same, a heavy arm": ("robot=ur10", HEAVY, *DIFFERENCES),
    "filtered 12-bit encoders": ("robot=panda", HEAVY, *FILTERED),
    "the same, with friction": ("robot=ur5", *DRY, *FILTERED),
    "noise of encoders": ("robot=tiago_no_hand", HEAVY, *NOISE),
    "a slow motion": ("robot=panda", *DRY, *FILTERED, "reference.arm.period=30", "time.duration=30"),
    "a fast motion": ("robot=ur10", HEAVY, "reference.arm.period=2"),
    "hobby servos": ("robot=so101", "hardware=feetech-sts3215", HEAVY),
    "hobby servos with friction": ("robot=so100", "hardware=feetech-sts3215", *DRY),
    "a robot by torque": ("robot=panda", "hardware=franka", HEAVY),
    "servos of an open manipulator": ("robot=so100", "hardware=dynamixel-xm430", HEAVY),
    "a payload is picked up": ("robot=panda", 'disturbances=[{type="payload",mass=2.0,start=4.0}]'),
    "and put down again": ("robot=ur5", 'disturbances=[{type="payload",mass=2.0,start=3.0,end=6.0}]'),
    "5 ms that nobody told of": ("robot=panda", HEAVY, "sensor.delay=2", "time.control_period=0.002"),
    "told delay and lag": ("robot=kinova", HEAVY, "actuator.lag=0.003", *LATE),
    "messages lost and late": ("robot=tiago_no_hand", HEAVY, "sensor.loss=0.1", "sensor.jitter=2"),
    "a hand pushes for 2 s": ("robot=panda", PUSH),
    "a blocked joint": ("robot=ur5", BLOCK, 'time.integrator="stick"'),
    "motors at their limit": ("robot=kinova", "masses=1.4", "reference.share=0.95"),
    "weak motors": ("robot=ur5", HEAVY, "actuator.torque_gain=0.8"),
    "gears with play": ("robot=platform_arm", "actuator.gap=0.002", "actuator.rotor_inertia=0.01"),
    "wheels of odometry, noise": ("robot=platform_arm", HEAVY, *DRY, *NOISE, 'sensor.pose="odometry"'),
    "a car": ("robot=car_arm", HEAVY, *DRY),
    "a minute": ("robot=platform_arm", HEAVY, *DRY, *DIFFERENCES, "time.duration=60"),
    "two minutes of hardly moving": ("robot=panda", HEAVY, *DIFFERENCES, *HARDLY),
    "learned light, goes on heavy": ("robot=panda",),
}  # fmt: skip
STICKY = ("friction.coulomb=3.0", "friction.breakaway=2.0", "friction.stribeck=0.02", 'time.integrator="stick"')
ENDS = ((0, 0.3), (1.45, 0.25), (0, 0.3), (-0.35, 0.25), (0, 0.3), (3.4, 0.25), (0, 0.3))  # middle, amplitude [rad]
AT_ENDS = ",".join(f'{{type="sine",amplitude={a},period=5.0,offset={m:.2f},phase=1.5707963}}' for m, a in ENDS)
FRESH: dict[str, tuple[str, ...]] = {  # by someone who did not
    "a table, taken away": (
        "robot=ur5", HEAVY, "reference.arm.amplitude=0.1", 'disturbances=[{type="surface",gap=0.02,end=6.0}]'
    ),
    "holds a door": (
        "robot=panda", HEAVY, "reference.arm.amplitude=0.1",
        'disturbances=[{type="door",grip=1000.0,start=3.0,end=7.0}]',
    ),
    "stretched, at joints' ends": ("robot=panda", *DRY, f"reference.arm=[{AT_ENDS}]"),
    "a load three times as heavy": ("robot=kinova", 'disturbances=[{type="payload",mass=1.5,start=3.0}]'),
    "a load dropped in a fast motion": (
        "robot=ur10", "reference.arm.period=3", 'disturbances=[{type="payload",mass=10.0,start=2.0,end=5.0}]'
    ),
    "zeros of encoders 0.05 rad off": ("robot=kinova", HEAVY, "sensor.offset=0.05"),
    "a third of the file's masses": ("robot=xarm7", "masses=0.33"),
    "sticks, breaks away at twice": ("robot=ur3", *STICKY, *FILTERED, "reference.arm.period=12"),
    "friction of the wrong sign": ("robot=panda", f"disturbances=[{pushes(-5.0, 1 / 6, 1, 2, 4, 6)}]"),
    "soft gears, encoders at motors": (
        "robot=platform_arm", HEAVY, *FILTERED, 'sensor.side="motor"', "actuator.gap=1e-6",
        "actuator.rotor_inertia=0.01", "actuator.stiffness=300.0",
    ),
    "motors give half": ("robot=ur10", HEAVY, "actuator.torque_gain=0.5"),
    "an empty battery": (
        "robot=panda", HEAVY, "actuator.voltage=12.0", "actuator.torque_constant=8.7", "actuator.resistance=1.6",
        "actuator.battery_resistance=0.05", "actuator.pwm_levels=256",
    ),
    "2 s at a motor's limit": (
        "robot=panda", 'disturbances=[{type="push",on="panda_joint2",force=60.0,start=3.0,end=5.0}]'
    ),
    "10 ms that no gain knows": ("robot=panda", HEAVY, 'disturbances=[{type="messages",fault="late",delay=10}]'),
    "a radio link": (
        "robot=tiago_no_hand", HEAVY,
        'disturbances=[{type="messages",fault="lost",start=3.0,end=3.3},'
        '{type="messages",fault="late",delay=15,start=5.0,end=6.0}]',
    ),
    "readings that jump": (
        "robot=ur5", HEAVY, 'disturbances=[{type="messages",fault="spike",size=0.02,start=3.0,end=6.0}]'
    ),
    "messages out of order, observed": (
        "robot=panda", HEAVY, *COARSE, 'sensor.velocity="observer"',
        'disturbances=[{type="messages",fault="shuffled",delay=3}]',
    ),
    "commands lost": (
        "robot=z1", HEAVY,
        'disturbances=[{type="commands",fault="lost",start=3.0,end=3.2},'
        '{type="commands",fault="lost",start=6.0,end=6.3}]',
    ),
    "a car parks in three strokes": (
        "robot=car_arm", HEAVY, *DRY, "time.duration=20",
        'reference.base={type="parking",aside=-1.2,radius=1.0,speed=0.4,strokes=3}',
    ),
    "a truck backs its trailer": (
        "robot=truck_trailer_arm", HEAVY, 'kinematic.guide="trailer"', "time.duration=20",
        'reference.base={type="parking",aside=-1.5,radius=4.0,speed=0.4}',
    ),
    "servos at 60 Hz, a load comes and goes": (
        "robot=so100", "hardware=feetech-sts3215", "hardware.rate=60", "time.duration=12",
        'disturbances=[{type="payload",mass=0.3,start=3.0,end=7.0}]',
    ),
    "corners": (
        "robot=casters_arm", HEAVY,
        'reference.base={type="waypoints",points=[[0,0],[2,0],[2,2],[0,2]],speed=0.6,radius=0.4}',
    ),
    "worn wheels, odometry": ("robot=platform_arm", HEAVY, *DIFFERENCES, "radii=0.97", 'sensor.pose="odometry"'),
    "ice under a wheel": (
        "robot=platform_arm", HEAVY, "plant=contact", 'contact.casters="soft"',
        "contact.patches=[{friction=0.045,x=[0.3,0.8],y=[0.0,1.0]}]",
    ),
    "gears that warm up, shaken": (
        "robot=panda", HEAVY,
        f'disturbances=[{pushes(12.0, 0.02, 2, 4)},{{type="push",on="panda_joint1",shape="noise",force=5.0}}]',
    ),
    "stop and go": (
        "robot=xarm7", HEAVY, 'reference.arm={type="points",time=[0,1.5,2.5,4,5,6.5,7.5,9],'
        "position=[0.3,0.3,0.8,0.8,0.3,0.3,0.8,0.8]}",
    ),
    "stands, then moves at once": (
        "robot=ur5", HEAVY, *DRY, 'reference.arm={type="minimum_jerk",start=0.2,goal=1.0,duration=1.0,begin=3.0}'
    ),
    "begins in mid-motion, off": (
        "robot=platform_arm", HEAVY, *DRY, "reference.base.ramp=0.0", "start.moving=true", "start.joint_offset=0.3",
        "start.pose_offset=[-0.1,0.1,0.2]", 'reference.arm={type="sine",amplitude=0.4,period=4.0}',
    ),
    "servos at 20 Hz, loaded": (
        "robot=so101", "hardware=feetech-sts3215", "hardware.rate=20",
        'disturbances=[{type="payload",mass=0.3,start=4.0}]',
    ),
    "differences of noise at 500 Hz": (
        "robot=ur5", HEAVY, *DRY, "sensor.noise=1e-4", 'sensor.velocity="difference"', "time.control_period=0.002"
    ),
}  # fmt: skip
UNSEEN: dict[str, tuple[str, ...]] = {  # after `learned` had been mended by a case of `FRESH`
    "somebody takes the hand and lets go": (
        "robot=ur3", HEAVY, 'disturbances=[{type="door",grip=400.0,inertia=0.5,start=2.5,end=4.5}]'
    ),
    "bumped three times": (
        "robot=ur3_gripper", HEAVY,
        'disturbances=[{type="push",on="elbow_joint",shape="impulse",force=2.0,start=2.0},'
        '{type="push",on="elbow_joint",shape="impulse",force=-2.0,start=4.0},'
        '{type="push",on="shoulder_pan_joint",shape="impulse",force=3.0,start=6.0}]',
    ),
    "leaned on for 6 s": (
        "robot=ur10", HEAVY, 'disturbances=[{type="push",on="shoulder_lift_joint",force=-90.0,start=2.0,end=8.0}]'
    ),
    "a load beside the hand is hit": (
        "robot=xarm7", 'disturbances=[{type="payload",mass=2.0,start=2.0,end=7.0,at=[0.0,0.1,0.0]},'
        '{type="push",on="joint1",shape="impulse",force=1.5,start=4.0}]',
    ),
    "a battery sags": (
        "robot=tracked_arm", HEAVY, "actuator.voltage=24.0", "actuator.torque_constant=6.0",
        "actuator.resistance=0.8", "actuator.battery_resistance=0.03",
    ),
    "a cable pulls back": (
        "robot=z1", HEAVY, 'disturbances=[{type="push",on="joint1",force=-3.0},{type="push",on="joint3",force=2.0}]'
    ),
    "noisy encoders, filtered": (
        "robot=xarm7", HEAVY, *DRY, "sensor.noise=0.0005", 'sensor.velocity="filtered"', "time.control_period=0.002"
    ),
    "control at 100 Hz": ("robot=ur3", HEAVY, *DRY, "time.control_period=0.01", "time.plant_step=0.001"),
    "hot gears": ("robot=ur5_gripper", "friction.coulomb=6.0", "friction.arm=4.0", HEAVY),
    "a soft tyre": ("robot=swerve_arm", HEAVY, "radii=0.95", 'sensor.pose="odometry"'),
    "half the masses on wheels": ("robot=tricycle_arm", "masses=0.5", *DRY),
    "stands for 15 s, then fast": (
        "robot=xarm7", HEAVY, *DRY, "time.duration=25",
        'reference.arm={type="minimum_jerk",start=0.2,goal=0.9,duration=0.8,begin=15.0}',
    ),
    "a minute for one swing": ("robot=ur3", HEAVY, *DRY, *FILTERED, "reference.arm.period=60", "time.duration=40"),
    "another tool than in the file": (
        "robot=ur5_gripper", 'disturbances=[{type="payload",mass=2.5,start=0.0,at=[0.0,0.08,0.05]}]'
    ),
    "stopped and sent on": (
        "robot=z1", HEAVY, 'reference.arm={type="points",time=[0,1.5,1.8,6.0,7.0,9],'
        "position=[0.3,0.7,0.75,0.75,0.4,0.7]}",
    ),
    "pushes against a wall, lets go": (
        "robot=xarm7", HEAVY, 'disturbances=[{type="surface",gap=0.01,stiffness=5000.0,friction=0.5,start=1.0,end=5.0}]'
    ),
    "a motor dies for half a second": (
        "robot=ur10", HEAVY, 'disturbances=[{type="dead_motor",joint="elbow_joint",start=4.0,end=4.5}]'
    ),
    "an encoder stands still for 0.1 s": (
        "robot=xarm7", HEAVY, 'disturbances=[{type="frozen_encoder",joint="joint4",start=4.0,end=4.1}]'
    ),
    "a machine shakes the table": (
        "robot=ur3", HEAVY, 'disturbances=[{type="push",on="shoulder_lift_joint",shape="sine",force=8.0,frequency=7.0}]'
    ),
    "gears with play, filtered": (
        "robot=two_axis_arm", HEAVY, "actuator.gap=0.005", "actuator.rotor_inertia=0.003", *FILTERED
    ),
    "motors give a third more": ("robot=z1", "actuator.torque_gain=1.33"),
    "messages late now and then": ("robot=z1", HEAVY, "sensor.jitter=4", "sensor.loss=0.2"),
    "a loader with a full bucket": (
        "robot=loader_arm", *DRY, 'disturbances=[{type="payload",mass=15.0,start=3.0,end=9.0}]', "time.duration=14"
    ),
    "an articulated base, played gears": ("robot=loader_arm", HEAVY, *DIFFERENCES, "actuator.lag=0.01"),
    "fast arm on slow wheels": ("robot=swerve_arm", HEAVY, *DRY, "reference.arm.period=1.5"),
    "scrubs on a carpet": ("robot=tracked_arm", "friction.coulomb=1.0", HEAVY, *NOISE),
    "a heavy door, half a minute": (
        "robot=ur10", HEAVY, "reference.arm.amplitude=0.1", "time.duration=36",
        'disturbances=[{type="door",grip=800.0,inertia=20.0,friction=10.0,start=3.0,end=31.0}]',
    ),
    "a humanoid's arm, its zero off": ("robot=talos_left_arm", HEAVY, *DRY, "sensor.offset=0.02"),
    "servos told wrong, loaded": (
        "robot=so100", "hardware=feetech-sts3215", "masses=0.8",
        'disturbances=[{type="payload",mass=0.2,start=2.0,end=6.0}]',
    ),
    "bumped while it is held": (
        "robot=panda", "masses=0.8", "reference.arm.amplitude=0.1",
        'disturbances=[{type="door",grip=500.0,start=2.0,end=5.0},'
        '{type="push",on="panda_joint2",shape="impulse",force=4.0,start=4.0}]',
    ),
}  # fmt: skip
EVERY_DAY = ("time.control_period=0.002", "time.plant_step=0.001")
TABLES = ",".join(f'{{type="surface",gap=0.01,start={at:.1f},end={at + 0.6:.1f}}}' for at in (1.0, 2.2, 3.4, 4.6, 5.8))
NAPS = ",".join(f'{{type="commands",fault="lost",start={at:.1f},end={at + 0.15:.2f}}}' for at in (1.5, 3.0, 4.5, 6.0))
REACHES = ((0, 0.3), (0, 0.2), (0, 0.15), (0, 0.3), (0, 0.3), (0, 0.3))  # of a UR: stretched, singular, most gravity
STRETCHED = ",".join(f'{{type="sine",amplitude={a},period=4.0,offset={m:.2f},phase=1.5707963}}' for m, a in REACHES)
EYES: dict[str, tuple[str, ...]] = {  # by someone who had no part in any of this, with `Clamped`
    "links longer than told": ("robot=ur5", HEAVY, *EVERY_DAY),
    "a wall that leans": ("robot=xarm7", *DRY, *EVERY_DAY),
    "hangs from the ceiling, told it stands": ("robot=z1", *EVERY_DAY),
    "axes 3 degrees off": ("robot=ur3", HEAVY, *FILTERED),
    "in oil": ("robot=ur5", "friction.arm=40.0", *EVERY_DAY),
    "kneads foam for 6 s": (
        "robot=xarm7", *EVERY_DAY, "reference.arm.amplitude=0.15",
        'disturbances=[{type="surface",gap=0.0,stiffness=800.0,damping=20.0,friction=0.6,start=1.0,end=7.0}]',
    ),
    "a table, five times": (
        "robot=panda", HEAVY, *EVERY_DAY, "reference.arm.amplitude=0.1", f"disturbances=[{TABLES}]"
    ),
    "a crate that slips off": (
        "robot=ur10", HEAVY, *EVERY_DAY, 'disturbances=[{type="payload",mass=14.0,start=2.0,end=2.6}]'
    ),
    "a long pipe": (
        "robot=panda", *EVERY_DAY, "reference.arm.period=3",
        'disturbances=[{type="payload",mass=1.0,at=[0.0,0.6,0.0],start=2.0,end=6.0}]',
    ),
    "sticks at every stop": (
        "robot=z1", *STICKY[1:], "friction.coulomb=1.5", "time.control_period=0.002",
        'reference.arm={type="points",time=[0,1,2.5,2.8,5,5.3,8,9],position=[0.3,0.6,0.6,0.5,0.5,0.7,0.7,0.3]}',
    ),
    "125 Hz, 8 ms late, slow currents": (
        "robot=ur5", HEAVY, *DRY, "time.control_period=0.008", "time.plant_step=0.001", "sensor.delay=1",
        "actuator.lag=0.01",
    ),
    "down a ramp of 8 degrees": (
        "robot=platform_arm", HEAVY, *EVERY_DAY, 'reference.base={type="line",speed=0.5,ramp=1.0}',
        'disturbances=[{type="push",on="v",force=160.0,start=2.0}]',
    ),
    "shoved from all sides": (
        "robot=casters_arm", HEAVY, *EVERY_DAY,
        'disturbances=[{type="push",on="vx",force=150.0,start=2.0,end=3.0},'
        '{type="push",on="vy",force=-150.0,start=4.0,end=5.0},{type="push",on="w",force=60.0,start=6.0,end=6.5}]',
    ),
    "one motor too weak to hold": ("robot=panda", *EVERY_DAY, "actuator.torque_limit=[87,38,87,87,12,12,12]"),
    "shaken where its gears ring": (
        "robot=two_axis_arm", HEAVY, "actuator.gap=1e-6", "actuator.rotor_inertia=0.01", "actuator.stiffness=300.0",
        'disturbances=[{type="push",on="arm_1_joint",shape="sine",force=2.0,frequency=27.0}]',
    ),
    "stretched out, elbow straight": ("robot=ur5", HEAVY, *EVERY_DAY, f"reference.arm=[{STRETCHED}]"),
    "as fast as it can": ("robot=z1", HEAVY, *EVERY_DAY, "reference.arm.period=1.0", "reference.share=0.95"),
    "differences of 10-bit encoders at 100 Hz": (
        "robot=xarm7", HEAVY, "sensor.resolution=0.006", 'sensor.velocity="difference"', "time.control_period=0.01",
        "time.plant_step=0.001",
    ),
    "a computer that naps": ("robot=ur3", HEAVY, *DRY, *EVERY_DAY, f"disturbances=[{NAPS}]"),
    "a loose encoder": (
        "robot=ur10", HEAVY, *EVERY_DAY, 'disturbances=[{type="frozen_encoder",joint="elbow_joint",start=3.0,end=3.3}]'
    ),
    "told to adapt at once": (
        "robot=ur5", HEAVY, *DRY, *EVERY_DAY, "learned.drift=1.0", "learned.change=10.0", "learned.load=10.0",
        "learned.alarm=1.5", "learned.noise=0.05", PUSH.replace("panda_joint2", "elbow_joint"),
    ),
    "told never to forget": (
        "robot=panda", *EVERY_DAY, "learned.drift=0.0", "learned.change=0.0", "learned.load=0.0", "learned.alarm=0.0",
        'disturbances=[{type="payload",mass=3.0,start=4.0,end=7.0}]',
    ),
    "an integral turned up, 4 ms late": (
        "robot=ur3", HEAVY, *DRY, *EVERY_DAY, "sensor.delay=2", "learned.rate=30.0", "feedforward.rate=30.0"
    ),
    "a wet floor": (
        "robot=platform_arm", HEAVY, "plant=contact", "contact.friction=0.08", "time.duration=8",
        "time.control_period=0.002",
    ),
    "a wheel without current": (
        "robot=platform_arm", HEAVY, *EVERY_DAY,
        'disturbances=[{type="dead_motor",joint="wheel_left_joint",start=3.0,end=3.4}]',
    ),
    "a car's steering bent": ("robot=car_arm", HEAVY, *DRY, *EVERY_DAY, "sensor.steering_offset=0.05"),
    "rotors that no file has": ("robot=ur10", "armature=2.0", *EVERY_DAY, "reference.arm.period=2.5"),
    "a child swings it": (
        "robot=ur5", HEAVY, *EVERY_DAY,
        'disturbances=[{type="push",on="elbow_joint",shape="sine",force=40.0,frequency=0.5,start=2.0,end=7.0},'
        '{type="push",on="shoulder_pan_joint",shape="sine",force=60.0,frequency=0.4,start=3.0,end=6.0}]',
    ),
    "a finger of grams": ("robot=finger_edu", "masses=0.8", *FILTERED, "time.plant_step=0.0005"),
    "every drive scaled wrong": ("robot=panda", *EVERY_DAY, "actuator.torque_gain=[0.6,1.4,0.7,1.3,0.6,1.5,0.5]"),
}  # fmt: skip
TRULY: dict[str, dict[str, tuple[float, ...]]] = {  # true places of joints beside the file's [m, m, m, rad, rad, rad]
    "links longer than told": {"elbow_joint": (0, 0, 0.06, 0, 0, 0), "wrist_1_joint": (0, 0, 0.04, 0, 0, 0)},
    "a wall that leans": {"joint1": (0, 0, 0, 0.2, 0.1, 0)},
    "hangs from the ceiling, told it stands": {"joint1": (0, 0, 0, np.pi, 0, 0)},
    "axes 3 degrees off": {
        "shoulder_lift_joint": (0, 0, 0, 0.05, 0, 0.05), "elbow_joint": (0, 0, 0, 0, 0.05, 0),
        "wrist_1_joint": (0, 0, 0, 0.05, -0.05, 0),
    },
}  # fmt: skip
CASES = FIRST | FRESH | UNSEEN | EYES
RESUMED = {"learned light, goes on heavy": (HEAVY,)}  # what is true in a second run that begins with what was learned
LOST = 1.0  # error of a joint or of the base [rad, m]


class Rival(TorqueController):
    """`tau = M nudot_ref + C nu_ref + g + K s + 10 K int s` of the URDF at the reference's posture."""

    name = "rival"

    def __init__(self, robot: Robot, K: Array) -> None:
        self.robot, self.model, self.K = robot, Dynamics(robot), K

    def init(self, context: Context) -> Any:
        """The integral and the period."""
        return {"I": np.zeros(self.K.size), "h": context.control_period}

    def step(
        self, time: float, reference: Setpoint, measurement: Measurement, command: VelocityCommand, state: Any
    ) -> Array:
        """Torque of one sample."""
        s, position = np.concatenate((command.z, command.r)), self.robot.neutral_position()
        position[self.robot.arm_index], position[self.robot.shape_index] = reference.q, measurement.shape
        state["I"] += 10.0 * state["h"] * self.K * s
        nu = command.nu_ref
        return self.K * s + state["I"] + self.model.psi(position, nu, nu, command.nudot_ref)


class Clamped(Rival):
    """The same at the measured posture, its integral at 5 1/s and never more than `K` times 1 m/s or rad/s."""

    name = "clamped"

    def step(
        self, time: float, reference: Setpoint, measurement: Measurement, command: VelocityCommand, state: Any
    ) -> Array:
        """Torque of one sample."""
        s, position = np.concatenate((command.z, command.r)), self.robot.neutral_position()
        position[self.robot.arm_index], position[self.robot.shape_index] = measurement.q, measurement.shape
        state["I"] = np.clip(state["I"] + 5.0 * state["h"] * self.K * s, -self.K, self.K)
        return self.K * s + state["I"] + self.model.psi(position, command.nu_ref, command.nu_ref, command.nudot_ref)


@dataclass(frozen=True, eq=False, kw_only=True)
class Mistold(Loop):
    """A loop whose robot is not as its file has it."""

    truth: Robot

    @property
    def true(self) -> Robot:
        """The true robot."""
        return self.truth


def truth_of(robot: Robot, moved: dict[str, tuple[float, ...]]) -> Robot:
    """A robot as its file describes it, with these joints moved beside their places there."""
    root = ElementTree.fromstring(robot.urdf)
    for joint in root.iter("joint"):
        if joint.get("name") in moved and (origin := joint.find("origin")) is not None:
            by = iter(moved[joint.get("name", "")])
            for key in ("xyz", "rpy"):
                place = [float(x) for x in origin.get(key, "0 0 0").split()]
                origin.set(key, " ".join(str(x + next(by)) for x in place))
    with TemporaryDirectory() as folder:
        (file := Path(folder) / "true.urdf").write_bytes(ElementTree.tostring(root))
        return load(file)


def judged(name: str, controller: str) -> dict[str, Any]:
    """The outcome of a case with a controller: why it is lost, empty where it is not, and errors of arm and base."""
    try:
        heavy = (*CASES[name], *RESUMED.get(name, ()))
        experiment = load_experiment("track", heavy if controller == "rival" else CASES[name])
        robot = experiment.load_robot()
        loop = experiment.loop(
            robot, experiment.controller("feedforward" if controller == "rival" else controller, robot=robot)
        )
        if controller == "rival":
            file = load_experiment("track", CASES[name][:1]).load_robot()
            assert isinstance(loop.controller, CompiledController)
            kind = Clamped if name in EYES else Rival
            loop = replace(loop, controller=kind(file, loop.controller.feedback.vector(robot.dimensions)))
        if name in TRULY:
            said = {one.name: getattr(loop, one.name) for one in fields(Loop) if one.init}
            loop = Mistold(**said, truth=experiment.made_true(truth_of(robot, TRULY[name])))
        run = loop.run()
        if name in RESUMED and controller != "rival":
            other = load_experiment("track", heavy)
            again = other.loop(other.load_robot(), loop.controller)
            state = loop.controller.init(loop.context())
            state.values[:] = run.final["controller_state"]
            run = again.run(state=state)
    except InputError as error:
        return {"lost": "", "refused": str(error)}
    return errors_of(run, robot)


def errors_of(run: Recording, robot: Robot) -> dict[str, Any]:
    """Whether a run is lost, and RMS errors in its second half [rad, m]."""
    e = run["true_e"]
    base = np.hypot(*run["true_pose_error"][:, :2].T) if robot.dimensions.base else np.zeros(len(e))
    lost = "" if run.outcome.status == "completed" else run.outcome.message
    if not lost and max(np.abs(e).max(initial=0.0), base.max(initial=0.0)) > LOST:
        lost = "errs by 1 rad or 1 m"
    late = slice(len(e) // 2, None)
    return {
        "lost": lost,
        "arm": float(np.sqrt((e[late] ** 2).mean())),
        "base": float(np.sqrt((base[late] ** 2).mean())),
    }


def main(arguments: Sequence[str] | None = None) -> None:
    """Parse the command line, run what is missing, print."""
    parser = argparse.ArgumentParser(prog="python -m research.studies.lost", description=__doc__.partition("\n")[0])
    parser.add_argument("names", nargs="*", default=list(CASES))
    parser.add_argument("--file", type=Path, default=Path("runs/lost.jsonl"))
    options = parser.parse_args(arguments)
    options.file.parent.mkdir(parents=True, exist_ok=True)
    rows = [json.loads(line) for line in options.file.read_text().splitlines()] if options.file.exists() else []
    found = {(row["case"], row["controller"]): row for row in rows}
    shown = []
    for name in options.names:
        for controller in ("feedforward", "learned", "rival"):
            if (name, controller) not in found:
                found[name, controller] = {"case": name, "controller": controller, **judged(name, controller)}
                with options.file.open("a", encoding="utf-8") as sink:
                    sink.write(json.dumps(found[name, controller]) + "\n")
        plain, ours, rival = (found[name, each] for each in ("feedforward", "learned", "rival"))
        shown.append(row_of(name, *cells(plain, ours), *cells(plain, rival)))
    heads = (Column("learned\n", text=True), Column("base\n"), Column("rival\n", text=True), Column("base\n"))
    print(
        terminal_text(
            [Table("errors over those of feedforward", (Column(text=True), *heads), tuple(shown))], False, 120
        )
    )


def cells(plain: dict[str, Any], own: dict[str, Any]) -> tuple[str, str]:
    """Ratios of arm and base, or what was instead."""
    for one in (plain, own):
        if "refused" in one:
            return "refused", ""
    if own["lost"]:
        return "lost" if not plain["lost"] else "both lost", ""
    ratios = (own[each] / plain[each] if plain[each] else float("nan") for each in ("arm", "base"))
    return tuple(number(ratio, "") for ratio in ratios)  # type: ignore[return-value]


if __name__ == "__main__":
    main()
