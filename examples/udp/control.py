"""The control process: the controller of an experiment at a fixed rate, for a plant that is elsewhere."""

import gc
import signal
import time as clock
from itertools import pairwise
from pathlib import Path

import numpy as np
import task
from link import BYE, COMMAND, HELLO, MEASUREMENT, Channel

from mmnn_pin.errors import InputError
from mmnn_pin.loop.stepper import Stepper
from mmnn_pin.signals import Measurement

STOPS = (signal.SIGINT, signal.SIGTERM)  # they end the run between two cycles


class Pace:
    """Ticks of a fixed rate, counted from a start; those that have passed already are skipped and counted.

    Args:
        period: Between two ticks [s].
        ticks: How many.
    """

    def __init__(self, period, ticks):
        self.period, self.start, self.next, self.skipped = period, clock.monotonic(), 0, 0
        self.late = np.full(ticks, np.nan)  # start of every cycle after its tick [s]

    def wait(self):
        """Sleep until the next tick to come, and its number."""
        passed = int((clock.monotonic() - self.start) / self.period)
        if passed > self.next:
            self.skipped += min(passed, len(self.late)) - self.next
            self.next = passed
        k, self.next = self.next, self.next + 1
        if k < len(self.late):
            clock.sleep(max(0.0, self.start + k * self.period - clock.monotonic()))
            self.late[k] = clock.monotonic() - self.start - k * self.period
        return k


def greet(channel, patience):
    """Wait for a measurement of the plant where it stands.

    Raises:
        InputError: It does not.
    """
    deadline = clock.monotonic() + patience
    while channel.receive() != MEASUREMENT:
        if clock.monotonic() > deadline:
            why = f"nothing came within {patience:g} s"
            raise InputError(f"no plant at port {channel.peer[1]}", why=why, fix="start plant.py first, or see --port")
        channel.send(HELLO)
        clock.sleep(0.02)


def drive(cycle, motion, samples, channel, pace):
    """Control until the end, a trip or Ctrl-C; how it ended, and the age of the oldest measurement used [s]."""
    places = np.cumsum([0, *(getattr(cycle.measured, name).size for name in ("pose", "velocity", "q", "qdot"))])
    came = Measurement(*(channel.values[a:b] for a, b in pairwise(places)))
    oldest, start, signals, kind = 0.0, pace.start, [], MEASUREMENT  # the first one is there
    asked = motion
    before = [signal.signal(number, lambda came, _: signals.append(came)) for number in STOPS]
    try:
        while (k := pace.wait()) < samples and not cycle.is_over:
            if signals:
                return "interrupted", f"stopped by {signal.Signals(signals[0]).name}", oldest
            kind = channel.receive() or kind
            if kind == MEASUREMENT:
                measured = 1e-9 * channel.stamp - start
                oldest = max(oldest, clock.monotonic() - channel.stamp * 1e-9)
                command = cycle.step(k * cycle.period, came, asked, measured=measured)
            else:
                command = cycle.step(k * cycle.period, None, asked)
            channel.send(COMMAND, command.motor_effort)
            kind = asked = None
            cycle.record()
    finally:
        channel.send(BYE)
        for number, handler in zip(STOPS, before, strict=True):
            signal.signal(number, handler)
    return "completed", "", oldest


def control(options, experiment, robot, port, patience):
    """Run the controller of an experiment and tell how it went; the exit code."""
    loop = experiment.loop(robot, experiment.controller(options.controller, robot=robot))
    layout, path = robot.dimensions, Path(options.out) / "controller.h5"
    channel = Channel(layout.motors, layout.pose + layout.base + 2 * layout.arm, peer=("127.0.0.1", port))
    samples, duration = experiment.time.samples, experiment.time.duration
    with Stepper.of(loop, path=path, force=options.force, meta={"config": experiment.to_json()}) as cycle:
        motion = cycle.plan(loop.trajectory, duration)
        gc.collect()
        gc.freeze()  # what is there is no garbage: a collection looks only at what comes
        greet(channel, patience)
        before = [generation["collections"] for generation in gc.get_stats()]
        pace = Pace(cycle.period, samples)
        status, message, oldest = drive(cycle, motion, samples, channel, pace)
        collections = [g["collections"] - b for g, b in zip(gc.get_stats(), before, strict=True)]
        counts = {
            "packets out of order dropped": channel.out_of_order,
            "malformed packets dropped": channel.malformed,
            "cycles skipped by overruns": pace.skipped,
        }
        told = [f"{count} {what}" for what, count in counts.items() if count]
        message = "; ".join(text for text in (message, *told) if text)
        run = cycle.finish(status, message, {"late": pace.late, "collections": collections})
    late = pace.late[np.isfinite(pace.late)]
    print(f"{options.controller} on {robot.name}, {options.rate:g} Hz, recorded in {path}")
    print(f"  cycles     {len(run):,}, {pace.skipped:,} skipped by overruns")
    print(f"  jitter     {spread(late)} after its tick a cycle starts")
    print(f"  step       {spread(run.step_times)} from measurement to torque")
    lost = channel.newest - channel.received - channel.out_of_order
    print(f"  packets    {channel.received:,} received, {lost:,} lost, {channel.out_of_order:,} out of order, "
          f"{channel.malformed:,} malformed; the oldest one used was {1e3 * oldest:.1f} ms old")  # fmt: skip
    print(f"  collector  {' + '.join(map(str, collections))} garbage collections")
    print(f"  outcome    {run.outcome.status}: {run.outcome.message}".rstrip(": "))
    return {"completed": 0, "interrupted": 130}.get(run.outcome.status, 1)


def spread(times):
    """Median, 99.9th percentile and maximum of times [s]."""
    median, tail, most = 1e6 * np.percentile(times, (50, 99.9, 100)) if len(times) else (0, 0, 0)
    return f"median {median:.0f} us, p99.9 {tail:.0f} us, max {most:.0f} us"


def main():
    """Control a plant that another process is."""
    options = task.parser(__doc__)
    options.add_argument("--wait", type=float, default=30.0, help="how long to wait for the plant [s]")
    options = options.parse_args()
    return control(options, *task.task(options), options.port, options.wait)


if __name__ == "__main__":
    task.call(main)
