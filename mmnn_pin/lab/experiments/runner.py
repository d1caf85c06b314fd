"""Runs all controllers of an experiment from equal starts and compares them."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path

import msgspec
import numpy as np

from ...errors import RecordingError, few
from ...loop.servo import EFFORT, hidden_torques, needs_torques
from ...loop.suited import tightest
from ...model.inspection import interfaces_of as offered_by
from ...model.robot import Robot, lacking_rotors
from ...recording.metrics import metrics
from ...recording.recording import Recording, as_columns
from ...reference import Trajectory, warnings
from ...reference.steerable import Enlarged
from ...reference.trajectory import still
from ...sensing import Sensor
from ...settings import finite, one_or_each
from ...settings.arguments import checked
from ...torque.controller import TorqueController
from ...torque.entries import CONTROLLERS as ENTRIES
from ...torque.entries import DESCRIBED, NOMINAL, PARAMETERS
from .beside_plain import YARDSTICKS, learners
from .controllers import EFFECTIVE, effective
from .experiment import Experiment
from .hand import hand_errors, hand_motion
from .hardware import lines
from .hardware_table import proposed
from .pushing import pushing_numbers
from .result import Result

REST, HELD = "'reference.base={type=\"line\", speed=0}'", "'reference.arm=[]'"
BEYOND = 0.02  # of a joint's range, past its limits, that is told


@checked
def run_experiment(
    experiment: Experiment,
    name: str,
    *,
    out: str | Path | None = None,
    force: bool = False,
    progress: Callable[[str, float], None] | None = None,
    leave_out: bool = False,
    understood: Callable[[Robot], None] | None = None,
) -> Result:
    """Run every controller of an experiment; a diverged run is part of the result.

    Args:
        experiment: The experiment.
        name: Its name, for the recordings.
        out: Folder for the recordings, one HDF5 file per controller; None keeps them in memory.
        force: Replace existing recordings.
        progress: Called now and then with the controller and the fraction done, first when one runs.
        leave_out: Leave out, with a note, controllers that cannot run on velocity interfaces; else they are refused.
        understood: Called with the robot before the first run.

    Raises:
        InputError: Bad robot, reference or gains, or recordings that exist; nothing has been written then.

    >>> short = load_experiment("chapter4", ["time.duration=0.1", "controllers=['pd']"])
    >>> run_experiment(short, "chapter4")
    <Result: pd completed>
    """
    robot = experiment.load_robot()
    experiment, left_out = without_unable(experiment, robot) if leave_out else (experiment, [])
    wanted = experiment.controllers
    files = {controller: Path(out) / f"{controller}.h5" if out else None for controller in wanted}
    config = msgspec.structs.replace(experiment, overrides=robot.overrides).to_json()
    require_runnable(experiment, robot)
    require_free([file for file in files.values() if file], force)
    if understood is not None:
        understood(robot)
    runs: dict[str, Recording] = {}
    notes = [] if experiment.hardware is None else [*lines(experiment.hardware)]
    notes += [*left_out, *window_notes(experiment), *reference_notes(experiment, robot)]
    notes += [*interface_notes(experiment, robot), *sensor_notes(experiment.sensor, robot)]
    notes += [*weak_notes(robot), *rotor_notes(robot), *knowledge_notes(robot, wanted)]
    duration, gain_of = experiment.time.duration, effective(wanted)
    for controller in in_order(wanted):
        learner = runs.get(gain_of.get(controller, ""))
        if learner is not None and not len(learner):
            notes.append(f"{controller} was not run: {gain_of[controller]} ended before its first sample")
            continue
        gains = None if learner is None else as_columns(learner["effective_gain"])
        loop = experiment.loop(robot, experiment.controller(controller, gains, robot))
        notes += [note for note in (*loop.controller.notes, *loop.reductions()) if note not in notes]
        runs[controller] = loop.run(
            files.get(controller),
            force=force,
            meta={"experiment": name, "config": config, "delay_margin": finite(loop.delay_margin())},
            progress=None if progress is None else lambda t, c=controller: progress(c, t / duration),  # type: ignore[misc]
        )
        if runs[controller].outcome.status == "interrupted":
            break
    kept = {controller: runs[controller] for controller in wanted if controller in runs}
    numbers = {controller: metrics(recording, experiment.windows) for controller, recording in kept.items()}
    hand, tables = {}, experiment.reference.hand
    pushes = {c: pushing_numbers(recording, robot) for c, recording in kept.items()}
    if tables is not None:
        hand = {c: hand_errors(recording, robot) for c, recording in kept.items()}
        notes += hand_notes(experiment, robot)
    notes += [*margin_notes(experiment, kept), *limit_notes(robot, kept), *unseen_notes(experiment.sensor, robot, kept)]
    plain = None
    if learners(kept) and not any(yardstick in kept for yardstick in YARDSTICKS):
        plain = plain_run(experiment, robot, progress)
    return Result(experiment, name, kept, numbers, tuple(notes), hand, pushes, plain)


def plain_run(experiment: Experiment, robot: Robot, progress: Callable[[str, float], None] | None) -> Recording:
    """A run of plain control in memory, that learners are measured by."""
    if progress is not None:
        progress(YARDSTICKS[0], 0.0)
    return experiment.loop(robot, experiment.controller(YARDSTICKS[0], robot=robot)).run()


def without_unable(experiment: Experiment, robot: Robot) -> tuple[Experiment, list[str]]:
    """An experiment without the controllers that cannot run on its velocity interfaces, and a note that names them.

    It is as it was where none could.
    """
    if hidden_torques(robot, experiment.interfaces, experiment.servo) is None:
        return experiment, []
    names = [name for name in experiment.controllers if name not in EFFECTIVE]
    loops = {name: experiment.loop(robot, experiment.controller(name, robot=robot)) for name in names}
    unable = [name for name, loop in loops.items() if needs_torques(loop.controller, loop.context())]
    able = tuple(name for name in experiment.controllers if name not in unable)
    if not unable or not able:
        return experiment, []
    why = "they go" if len(unable) > 1 else "it goes"
    note = f"{', '.join(unable)} left out: {why} by the torque of every joint, which not all servos tell"
    return msgspec.structs.replace(experiment, controllers=able), [note]


def knowledge_notes(robot: Robot, controllers: Iterable[str]) -> list[str]:
    """A note on which controllers know what of a robot whose masses are not those of its file."""
    if all(factor == 1.0 for factor in robot.masses.values()):
        return []
    known = {name: ENTRIES[name] for name in controllers if name in ENTRIES}
    groups = {
        "those of the file": [name for name, entry in known.items() if DESCRIBED in entry.told],
        "the true ones": [name for name, entry in known.items() if entry.oracle],
        "these times nominal.masses": [n for n, entry in known.items() if {NOMINAL, PARAMETERS} & {*entry.told}],
    }
    knows = [f"{', '.join(names)} know {what}" for what, names in groups.items() if names]
    rest = len(known) - sum(map(len, groups.values()))
    return [f"masses are not those of the file: {'; '.join([*knows, *['the others none'] * bool(rest)])}"]


def interface_notes(experiment: Experiment, robot: Robot) -> list[str]:
    """Notes on how motors are driven, where not all by effort, or where the URDF does not offer that."""
    said, offered = experiment.interfaces, offered_by(robot)["interfaces_offered"]
    kinds = {kind: [name for name, one in said.items() if one == kind] for kind in dict.fromkeys(said.values())}
    driven = [f"{', '.join(names)} by {kind}" for kind, names in kinds.items() if kind != EFFORT]
    others = [name for name in robot.actuator_names if said.get(name, EFFORT) == EFFORT]
    unoffered = [name for name in others if offered[name] and EFFORT not in offered[name]]
    hidden = hidden_torques(robot, said, experiment.servo)
    alike = "; no torque of a controller reaches any of them: all controllers move them alike"
    end = "; all others by effort" if others else alike if hidden is not None and hidden.all() else ""
    found = [f"driven {'; '.join(driven)}{end}"] if driven else []
    if unoffered:
        fix = f"--hardware {proposed(robot)} drives each as offered"
        found.append(f"the URDF offers no torque at {few(unoffered, 1)}, this run uses it; {fix}")
    return found


INEXACT = ("noise", "wheel_noise", "resolution", "wheel_resolution")  # of encoders


def sensor_notes(sensor: Sensor, robot: Robot) -> list[str]:
    """A note on what inexact encoders leave exact: velocities and pose that neither come from them nor have noise."""
    said = [f"sensor.{name}" for name in INEXACT if np.any(getattr(sensor, name))]
    exact = {
        "velocities": sensor.velocity == "true" and not np.any(sensor.velocity_noise),
        "the base's pose": robot.dimensions.base > 0 and sensor.pose == "true" and not np.any(sensor.pose_noise),
    }
    left = [name for name, is_exact in exact.items() if is_exact]
    if not said or "velocities" not in left:
        return []
    fix = 'sensor.velocity="filtered" takes velocities from the encoders, sensor.velocity_noise gives them noise'
    are = "are" if len(said) > 1 else "is"
    return [f"{' and '.join(said)} {are} of encoders alone: {' and '.join(left)} stay exact; {fix}"]


def weak_notes(robot: Robot) -> list[str]:
    """Joints that cannot hold themselves where the robot rests."""
    return [
        f"{name} cannot hold itself up: {why} by the URDF: correct its effort, or --lock {name}"
        for name, why in weak_joints(robot).items()
    ]


def weak_joints(robot: Robot) -> dict[str, str]:
    """Joint to what gravity takes and its motor gives [N m or N], of those too weak to hold where the robot rests."""
    held = np.abs(robot.gravity(robot.neutral())[robot.dimensions.base :])
    efforts = dict(zip(robot.actuator_names, robot.effort_limits, strict=True))
    return {
        name: f"gravity takes {needed:.3g}, its motor gives {efforts[name]:.3g}"
        for name, needed in zip(robot.joint_names, held, strict=True)
        if needed > efforts.get(name, np.inf)
    }


def rotor_notes(robot: Robot) -> list[str]:
    """A note of joints that lack a rotor."""
    lacking, way = lacking_rotors(robot)
    then = f"try {way}" if way else "state the effort limits of its motors"
    return [f"{lacking}: its gains are hardly a real motor's; {then}"] if lacking else []


def limit_notes(robot: Robot, runs: Mapping[str, Recording]) -> list[str]:
    """The joint that is farthest beyond its limits in any run; the plant has no end stops."""
    lower, upper = robot.lower[robot.arm_index], robot.upper[robot.arm_index]
    far = {
        (name, i): float(np.nanmax(beyond[:, i] / max(upper[i] - lower[i], 1e-9)))
        for name, run in runs.items()
        if len(run) and robot.dimensions.arm
        for beyond in [np.maximum(as_columns(run["q"]) - upper, lower - as_columns(run["q"]))]
        for i in range(len(lower))
        if np.isfinite(upper[i] - lower[i]) and upper[i] > lower[i]
    }
    name, i = max(far, key=far.__getitem__, default=("", 0))
    if not name or far[name, i] < BEYOND:
        return []
    most = far[name, i] * (upper[i] - lower[i])
    where = f"its limits {lower[i]:.3g} to {upper[i]:.3g}"
    return [f"{robot.joint_names[i]} goes {most:.3g} beyond {where} under {name}; the plant has no end stops"]


def unseen_notes(sensor: Sensor, robot: Robot, runs: Mapping[str, Recording]) -> list[str]:
    """Joints whose true errors are smaller than what rounding to a step of their encoders hides, a step / sqrt(12)."""
    step = np.array(one_or_each(sensor.resolution, robot.dimensions.arm, "joint", "sensor.resolution"))
    rms = [np.sqrt(np.mean(as_columns(r["true_e"]) ** 2, axis=0)) for r in runs.values() if "true_e" in r and len(r)]
    below = np.min(rms, axis=0) < step / math.sqrt(12.0) if rms and step.any() else np.zeros(step.size, bool)
    if not below.any():
        return []
    names = [name for name, is_below in zip(robot.joint_names, below, strict=True) if is_below]
    who = " and ".join(names) if len(names) < 3 else f"{len(names)} joints"
    most = step[below].max()
    return [
        f"true errors of {who} are smaller than rounding by the encoder ({most:.3g} rad or m): no robot shows these"
    ]


def margin_notes(experiment: Experiment, runs: Mapping[str, Recording]) -> list[str]:
    """A note on controllers that bear less delay beside their latency than the experiment wants."""
    margins = {name: run.meta["delay_margin"] for name, run in runs.items()}
    line = experiment.sensor.line(experiment.time.measurement_period)
    least = experiment.latency.margin + experiment.latency.total + line
    short = {name: m for name, m in margins.items() if m is not None and m < least}
    if not short:
        return []
    worst = min(short, key=short.__getitem__)
    these = worst if len(short) == 1 else f"{len(short)} controllers, least {worst}"
    return [f"delay margin below {1e3 * least:.3g} ms: {these} {1e3 * short[worst]:.3g} ms (mmnn docs latency.margin)"]


def in_order(wanted: Sequence[str]) -> list[str]:
    """Controllers in the order to run them: a learner before the PD that takes its effective gain."""
    learners = [learner for name, learner in effective(wanted).items() if name in wanted]
    first = [name for name in wanted if name not in EFFECTIVE]
    missing = [name for name in dict.fromkeys(learners) if name not in first]
    return [*first, *missing, *(name for name in wanted if name in EFFECTIVE)]


def require_runnable(experiment: Experiment, robot: Robot) -> None:
    """Refuse what cannot run, before anything is written (`InputError`)."""
    for controller in in_order(experiment.controllers):
        if controller not in EFFECTIVE:
            loop = experiment.loop(robot, experiment.controller(controller, robot=robot))
            with experiment.in_its_keys():
                loop.require_stable_gains()
            loop.start.state(robot, loop.table()[0])
            if isinstance(loop.controller, TorqueController):
                loop.rehearse()
            if experiment.plant == "contact" or loop.layout.hardware or not loop.sensor.exact:
                loop.engine_at()


def require_free(files: Sequence[Path], force: bool) -> None:
    """Refuse to write where recordings are, before anything is written; folders are made with their first recording.

    Raises:
        RecordingError: A file exists and `force` is off, or the folder cannot be made or written to.
    """
    for file in files:
        if file.exists() and not force:
            raise RecordingError(
                "the recording exists", fix="choose another folder with --out, or replace it with --force", file=file
            )
    for folder in {file.parent for file in files}:
        existing = next(place for place in (folder, *folder.parents) if place.exists())
        if not existing.is_dir():
            raise RecordingError("the folder cannot be made", why="there is a file of that name", file=existing)
        if not os.access(existing, os.W_OK):
            raise RecordingError("the folder cannot be written to", fix="choose another with --out", file=existing)


TimeWindow = tuple[float, float]


def window_notes(experiment: Experiment) -> list[str]:
    """Notes on windows that lie beyond the end of a run or go on after it; none where all are within."""
    end = experiment.time.duration
    beyond = [window for window in experiment.windows if window[0] >= end]
    cut = [window for window in experiment.windows if window[0] < end < window[1]]
    found = []
    if beyond:
        found.append(f"no errors in {words(beyond)}: the run is over after {end:g} s; --set windows=... for others")
    if cut:
        found.append(f"errors in {words(cut)} count to the end of the run, {end:g} s")
    return found


def words(windows: Sequence[TimeWindow]) -> str:
    """Windows in words."""
    return "the window" + "s" * (len(windows) > 1) + " " + ", ".join(f"{start:g}-{stop:g} s" for start, stop in windows)


def reference_notes(experiment: Experiment, robot: Robot) -> list[str]:
    """Notes on the reference, such as stretches without stabilisation."""
    if experiment.reference.hand is not None:
        return []
    reference, notes = experiment.trajectory_of(robot), []
    path, times = reference.base, np.arange(experiment.time.samples) * experiment.time.control_period
    if isinstance(path, Enlarged):
        notes.append(f"the path is drawn {path.factor:.3g} times as large: what steers asks for it")
    if reference.slowness > 1.0:
        why = tightest(robot, reference, experiment.time.duration, experiment.reference.share)
        notes.append(f"the reference takes {reference.slowness:.3g} times as long: {why or 'what steers asks for it'}")
    notes += reference.notes
    if experiment.reference.file:
        notes += file_notes(experiment, reference, Trajectory.from_csv(robot, experiment.reference.file))
    return notes + (warnings(path.sample(times / reference.slowness)) if path is not None else [])


def file_notes(experiment: Experiment, reference: Trajectory, read: Trajectory) -> Iterator[str]:
    """Notes on what a reference has beside what was read from its file, and on what the runs leave out."""
    file, end, now = Path(experiment.reference.file).name, reference.slowness * read.duration, experiment.time.duration
    if now + experiment.time.control_period < end < np.inf:
        yield f"{file} goes on to {end:.4g} s, the runs end at {now:g} s: --set time.duration={end:.4g}"
    if still(read.base) and not still(reference.base):
        yield f"{file} does not move the base: it drives as the experiment says; --set {REST} lets it rest"
    if all(map(still, read.arm)) and not all(map(still, reference.arm)):
        yield f"{file} moves no joint of the arm: it moves as the experiment says; --set {HELD} holds it"


def hand_notes(experiment: Experiment, robot: Robot) -> list[str]:
    """Notes on a motion of the hand: its frames, how far the program itself stays from the path, misses."""
    assert experiment.reference.hand is not None
    motion = hand_motion(experiment.reference.hand, robot, experiment.time)
    begins, ends, missed = motion.begins, motion.ends, motion.misses
    gap = 1e3 * float(motion.gap[round(begins / experiment.time.control_period) :].max())
    frames = motion.trajectory.watched.frames if motion.trajectory.watched else ()
    names, verb = " and ".join(frames), "follow their paths" if len(frames) > 1 else "follows its path"
    found = [f"{names} {verb} from t = {begins:.3g} s to {ends:.3g} s; the reference is off by at most {gap:.2g} mm"]
    return [*found, *([f"the program of the hand had no solution at {missed} samples: it braked"] if missed else [])]


def has_hardware(experiment: Experiment) -> bool:
    """Whether there is more between controller and robot than wires, see `hardware`."""
    perfect = experiment.sensor.exact and experiment.actuator.perfect
    return not perfect or experiment.safety is not None or bool(experiment.disturbances)
