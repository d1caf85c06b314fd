"""The curves of recorded runs, in the units that people read: one source for the pictures and for the report's plots.

A chart is a function from runs to panels; `chart` names it and says what to know of it. `plots` draws the panels with
matplotlib, `report` packs them for the page's script.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ...errors import RecordingError
from ...recording.metrics import TRUE
from ...recording.recording import Recording, guided_pose, recorded_robot
from ...recording.tracking import prismatic_joints
from ...signals import ALONG, Array
from ..experiments.controllers import ORACLES
from ..experiments.hand import HandErrors, hand_errors

Recordings = Mapping[str, Recording]
CurvePoints = tuple[Array, Array]  # times and values, (N,) each
Curves = Mapping[str, CurvePoints]  # by run

NETWORKS = ("base", "arm")
FELT = 1.0  # of a wrench's axis, below which it says nothing [N, N m]
RESIDUALS = {
    "constraint_residual": ("wheels' constraint", "mm/s", 1e3),
    "energy_residual": ("energy balance", "mJ", 1e3),
}


@dataclass(frozen=True)
class Panel:
    """The content of one axes."""

    title: str  # what it is, where it stands alone
    unit: str  # of its values
    curves: Curves = field(default_factory=dict)  # curve of every run that has one
    label: str = ""  # what it is among the panels of its group; by default the title
    group: str = ""  # the panels that it belongs to
    truth: CurvePoints | None = None  # what the curves should be, where that is known
    # in the plane instead of curves over time: poses (N, 3) by run, of None for a reference
    tracks: tuple[tuple[str | None, Array], ...] = ()
    step: bool = False  # whether values hold until the next one
    scale: str = "linear"  # `linear`, `log`, or `symlog`: logarithmic on both sides of zero
    limit: float = np.inf  # largest value that a motor gives

    @property
    def axis(self) -> str:
        """Label of the axis of its values."""
        return f"{self.label or self.title} [{self.unit}]" if self.unit else self.label or self.title


@dataclass(frozen=True)
class Chart:
    """A figure of runs as data."""

    title: str  # its heading
    about: str  # what to know of it
    # runs by name to its panels; none where the runs have nothing for it
    panels: Callable[[Recordings], Iterable[Panel]]
    judged: bool = False  # whether it stands with what was learned
    # runs by name to why some are not in it, one line each
    lacks: Callable[[Recordings], list[str]] = lambda recordings: []


CHARTS: dict[str, Chart] = {}


def chart(
    name: str, title: str, about: str, **more: Any
) -> Callable[[Callable[[Recordings], Iterable[Panel]]], Callable[[Recordings], Iterable[Panel]]]:
    """Register the panels of a chart: what the report shows, and what a figure of that name may draw.

    Args:
        name: By which a figure asks for it.
        title: As of `Chart`, like `about` and what else is given.
        about: Likewise.
        more: Likewise.
    """

    def register(panels: Callable[[Recordings], Iterable[Panel]]) -> Callable[[Recordings], Iterable[Panel]]:
        CHARTS[name] = Chart(title, about, panels, **more)
        return panels

    return register


# -- charts ------------------------------------------------------------------------------------------------------------


@chart("errors", "Tracking errors", "Reference minus robot. Pose errors are in the base frame.")
def errors(recordings: Recordings) -> Iterator[Panel]:
    """True tracking errors of pose, velocities and joints, by which runs are judged; measured ones of old runs."""
    for signal, words in (("pose_error", "pose"), ("z", "velocity"), ("e", "joint")):
        known = all(TRUE[signal] in recording for recording in recordings.values() if signal in recording)
        for panel in signal_panels(recordings, TRUE[signal] if known else signal):
            yield replace(panel, title=f"{words} {panel.label}", group=words)


@chart("path", "Path", "Arrows show the heading, ten along each path.")
def path(recordings: Recordings) -> Iterator[Panel]:
    """The base in the plane, wanted and driven, and its distance to where it should be."""
    driven = {name: r for name, r in recordings.items() if "pose" in r and "pose_ref" in r and len(r)}
    if driven:
        wanted = [(None, pose) for pose in distinct([r["pose_ref"] for r in driven.values()])]
        yield Panel("y over x", "m", tracks=(*wanted, *((name, guided_pose(r)) for name, r in driven.items())))
        gaps = {name: (r.time, distance(r)) for name, r in driven.items()}
        yield Panel("distance to the reference", "mm", gaps)


@chart("hand", "The hand", "The true hand against its path, and what of that the reference itself leaves.")
def hand(recordings: Recordings) -> Iterator[Panel]:
    """Distance of the true hand from its path, its turning, and the share that is the reference's own."""
    judged = {name: recorded_hand(recording) for name, recording in recordings.items()}
    for i in range(max(map(len, judged.values()), default=0)):
        found = {name: errors[i] for name, errors in judged.items() if i < len(errors)}
        frame = next(iter(found.values())).frame
        yield Panel(f"distance of {frame}", "mm", {n: (e.time, 1e3 * e.distance()) for n, e in found.items()})
        if turned := {n: (e.time, 1e3 * e.angle()) for n, e in found.items() if e.turned}:
            yield Panel("turned by", "mrad", turned)
        kinematic = {n: (e.time, 1e3 * np.linalg.norm(e.vectors()["kinematic"], axis=1)) for n, e in found.items()}
        yield Panel("of the reference itself", "mm", kinematic)


@chart("force", "Forces", "Of the world on the hand, and what a compliant hand asks for; the door that it holds.")
def force(recordings: Recordings) -> Iterator[Panel]:
    """Forces at the hand in the world's axes, the energy of its springs, and the angle of a door."""
    for name, about in (("hand_force", "on the hand"), ("asked_force", "asked of it")):
        for panel in signal_panels(recordings, name):
            title = f"{about}, {panel.label}"
            yield replace(panel, title=title, label=title)
    opened = {n: r for n, r in recordings.items() if "opening" in r and np.any(r["opening"])}
    if opened:
        angles = {n: (r.time, np.degrees(np.ravel(r["opening"]))) for n, r in opened.items()}
        yield Panel("door", "deg", angles)


@chart(
    "torque",
    "Torques",
    "Dashed lines are the motors' limits where they are near; only motors that are simulated keep them.",
)
def torques(recordings: Recordings) -> Iterator[Panel]:
    """Forces on the base, torques of the motors with their limits; without motors, those on the arm."""
    on_base, limits = base_labels(recordings), effort_limits(recordings)
    motors = signal_panels(recordings, "motor_torque")
    for panel in signal_panels(recordings, "torque"):
        if panel.label in on_base:
            yield replace(panel, title=f"on the base, {panel.label}", group="base", step=True)
        elif not motors:
            yield replace(panel, group="arm", step=True)
    for panel in motors:
        yield replace(panel, group="motors", step=True, limit=float(limits.get(panel.label, np.inf)))


@chart(
    "psi",
    "\u03a8 and what was learned of it",
    "Grey is the true \u03a8 of the Pinocchio model, what is to be learned; the curve is what was learned. A "
    "small tracking error does not mean that \u03a8 was learned.",
)
def psi(recordings: Recordings) -> Iterator[Panel]:
    """True and learned Psi, a panel per component and learner; the group is the learner."""
    runs = learners(recordings)
    true = signal_panels(runs, "psi")
    learned = {panel.label: panel.curves for panel in signal_panels(runs, "psi_hat")}
    for panel in true:
        for name, truth in panel.curves.items():
            curves = {name: learned[panel.label][name]}
            yield replace(panel, title=f"{panel.label}, {name}", group=name, curves=curves, truth=truth)


@chart(
    "gains",
    "Effective gains",
    "The whole gain on z (base) or r (arm), robust term included. PD at a learner's effective gain has the same.",
)
def gains(recordings: Recordings) -> Iterator[Panel]:
    """Effective gains of base and arm."""
    on_base = base_labels(recordings)
    for panel in signal_panels(recordings, "effective_gain"):
        yield replace(panel, group="base" if panel.label in on_base else "arm", step=True)


@chart("touch", "Touch", "What is felt of the world: contact, wrench of the hand, and torques that leave their band.")
def touch(recordings: Recordings) -> Iterator[Panel]:
    """Contact, the axes of the wrench that are felt, and the external torques that are ever three times their band."""
    yield from (replace(panel, group="hand") for panel in signal_panels(recordings, "contact"))
    for panel in signal_panels(recordings, "external_wrench"):
        if any(np.abs(values).max(initial=0.0) > FELT for _, values in panel.curves.values()):
            yield replace(panel, title=f"hand {panel.label}", group="hand")
    bands = {panel.label: panel.curves for panel in signal_panels(recordings, "external_band")}
    for panel in signal_panels(recordings, "external_torque"):
        band = bands[panel.label]
        if any(np.any(np.abs(felt) > 3.0 * band[name][1]) for name, (_, felt) in panel.curves.items()):
            yield replace(panel, title=f"on {panel.label}", group="on")


@chart("weights", "Norms of the weights", "Frobenius norm of all weights of a network.")
def weights(recordings: Recordings) -> Iterator[Panel]:
    """Norm of the weights of every network, of the runs that have some."""
    for column, network in enumerate(NETWORKS):
        norms = {n: (r.time, r["weight_norm"][:, column]) for n, r in recordings.items() if "weight_norm" in r}
        if shown := {name: curve for name, curve in norms.items() if curve[1].any()}:
            yield Panel(f"\u2016Z\u2016 of the {network}'s network", "", shown)


@chart(
    "residuals",
    "Residuals",
    "What should be zero: motion that the wheels forbid (contact plant), and energy out of nowhere.",
)
def residuals(recordings: Recordings) -> Iterator[Panel]:
    """Residuals that should be zero: of the wheels, of the energy."""
    for signal, (words, unit, scale) in RESIDUALS.items():
        if found := {n: (r.time, scale * r[signal]) for n, r in recordings.items() if signal in r}:
            yield Panel(words, unit, found)


def recorded_hand(recording: Recording) -> list[HandErrors]:
    """Errors of a run at the frames that its reference took along paths."""
    return hand_errors(recording, recorded_robot(recording)) if "hand" in recording and len(recording) else []


# -- what they are made of ---------------------------------------------------------------------------------------------


def signal_panels(recordings: Recordings, signal: str) -> list[Panel]:
    """A panel per column of a signal, of all that any recording has, in their order; errors in thousandths."""
    error = signal.removeprefix("true_")
    panels: dict[str, Panel] = {}
    for name, recording in recordings.items():
        if signal not in recording:
            continue
        table = recording[signal].reshape(len(recording), -1) if len(recording) else None
        for i, (label, unit) in enumerate(zip(recording.labels(signal), column_units(recording, signal), strict=True)):
            shown, scale = (milli(unit), 1e3) if error in TRUE else (unit, 1.0)
            title = "heading" if (error, label) == ("pose_error", "phi") else label
            panel = panels.setdefault(label, Panel(title, shown, {}, title))
            more = {} if table is None else {name: (recording.time, scale * table[:, i])}
            panels[label] = replace(panel, curves={**panel.curves, **more})
    return list(panels.values())


def require_comparable(recordings: Iterable[Recording]) -> None:
    """Refuse runs that cannot be shown over each other.

    Raises:
        RecordingError: One holds no rows, or they are of robots with different velocities.
    """
    every = list(recordings)
    for recording in every:
        if not len(recording):
            raise RecordingError("holds no rows", why="the run ended before its first sample", file=recording.path)
        if recording.labels("torque") != every[0].labels("torque"):
            here, there = (", ".join(r.labels("torque")) for r in (recording, every[0]))
            why = f"it moves in {here}; {every[0].path or 'the first'} in {there}"
            raise RecordingError("a recording of another robot", why=why, fix="show them apart", file=recording.path)


def base_labels(recordings: Recordings) -> set[str]:
    """Names of the base velocities; none for a fixed arm."""
    return {label for r in recordings.values() if "velocity" in r for label in r.labels("velocity")}


def effort_limits(recordings: Recordings) -> dict[str, float]:
    """Largest torques of the motors by name, where the recordings know them."""
    metas = [recording.meta for recording in recordings.values() if "effort_limits" in recording.meta]
    return {k: v for m in metas for k, v in zip(m["actuator_names"], m["effort_limits"], strict=True)}


def controller_of(name: str, recording: Recording) -> str:
    """Controller of a recording."""
    return str(recording.meta.get("controller", name))


def learners(recordings: Recordings) -> dict[str, Recording]:
    """Recordings of controllers that learn Psi: those with an estimate of their own."""
    return {
        name: rec
        for name, rec in recordings.items()
        if controller_of(name, rec) not in ORACLES and "psi_hat" in rec and rec["psi_hat"].any()
    }


def distance(recording: Recording) -> Array:
    """Distance of the base, or of a guided trailer, to its reference [mm], shape (N,)."""
    return 1e3 * np.hypot(*(recording["pose_ref"] - guided_pose(recording))[:, :2].T)


def distinct(references: Sequence[Array]) -> list[Array]:
    """References that are no beginning of another."""
    kept: list[Array] = []
    for reference in sorted(references, key=len, reverse=True):
        if not any(np.allclose(reference, other[: len(reference)]) for other in kept):
            kept.append(reference)
    return kept


# -- units -------------------------------------------------------------------------------------------------------------


def column_units(recording: Recording, name: str) -> list[str]:
    """Unit of every column of a signal: those of the base, then those of the arm by the types of its joints."""
    labels, slides = recording.labels(name), prismatic_joints(recording.urdf)
    if name in ("position", "motor_torque", "applied"):  # the base is pushed along x and y and turned
        along = slides | ({"x", "y"} if name == "position" else {"base_x", "base_y"})
        turning, sliding = ("rad", "m") if name == "position" else ("N m", "N")
        return [sliding if label in along else turning for label in labels]
    base, _, arm = recording.unit(name).partition("; ")
    if " or " in base:
        base, arm = "", base
    count = len(labels) if not arm else len(base_labels({"": recording})) if base else 0
    parts = base.split(", ")
    each = len(parts) == count
    units = parts if each else [parts[0] if label in ALONG else parts[-1] for label in labels[:count]]
    turning, _, sliding = arm.partition(" or ")
    return units + [sliding if label in slides else turning for label in labels[count:]]


def milli(unit: str) -> str:
    """The unit in which errors are shown: a thousandth."""
    return f"m{unit}" if unit else ""
