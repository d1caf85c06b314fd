"""The judgement of one run: each part computed when it is first asked for, and why a part cannot be had."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cached_property
from typing import Any, ClassVar, TypeVar
from weakref import WeakKeyDictionary

from ...errors import ConfigError, InputError, UnknownName
from ...recording.recording import Recording
from ...settings import require_gain
from ...settings.arguments import checked, faced
from ...shown import AsText, shown
from .psi import WINDOWS, ProgressCallback, Psi, psi_of
from .subject import Subject

J = TypeVar("J", bound="Judgement")
KEPT: WeakKeyDictionary[Recording, Judgement] = WeakKeyDictionary()


@faced
class Judgement(AsText):
    """Whether a run learned Psi. A part is computed once, when it is first asked for, and may raise an `InputError`.

    Args:
        recording: The run.
        payload: Load for the frozen weights [kg]; None for a usual one.
        windows: Number of windows of the online FVU.
        progress: Called with what is being done and the fraction done.

    Raises:
        InputError: The run's robot cannot be built, or its recording does not hold what all parts need.
    """

    PARTS: ClassVar[tuple[str, ...]] = ("psi",)

    def __init__(
        self,
        recording: Recording,
        *,
        payload: float | None = None,
        windows: int = WINDOWS,
        progress: ProgressCallback | None = None,
    ) -> None:
        require_gain(payload or 0.0, "payload")
        if windows < 1:
            raise ConfigError(f"{windows}", fix="use at least one", key="windows")
        self.subject, self.payload, self.windows = Subject.of(recording), payload, windows
        self.progress = progress

    @cached_property
    def psi(self) -> Psi:
        """Psi_hat against the truth, see `psi_of`."""
        return psi_of(self.subject, self.payload, self.windows, self.progress)

    @cached_property
    def missing(self) -> dict[str, InputError]:
        """The parts that cannot be had, and why; computes all of them."""
        return {name: error for name in self.PARTS if (error := self._try(name)) is not None}

    @property
    def worth_telling(self) -> dict[str, InputError]:
        """Of the parts that cannot be had, those of which a remark says why."""
        return self.missing

    def has(self, part: str) -> bool:
        """Whether a part can be had; computes it.

        Raises:
            UnknownName: There is no such part.
        """
        if not isinstance(getattr(type(self), part, None), cached_property):
            raise UnknownName("part", part, self.PARTS)
        return self._try(part) is None

    def require_any(self) -> None:
        """Refuse a run of which nothing can be said (`InputError`)."""
        if len(self.missing) == len(self.PARTS):
            why = "; ".join(map(sentence, self.missing.values()))
            raise InputError("nothing to judge", why=why, file=self.subject.recording.path)

    def remarks(self) -> list[str]:
        """Reservations about the numbers, one line each."""
        subject, result = self.subject, []
        outcome = subject.recording.outcome
        if outcome.status != "completed":
            result.append(
                f"the run was {outcome.status}; this is about the time before {subject.signal('time')[-1, 0]:.3g} s"
            )
        result += map(sentence, self.worth_telling.values())
        if subject.plant != "ideal":
            result.append(f"Psi is that of wheels that roll; on the {subject.plant} plant they may slip")
        if self.has("psi"):
            result += self.psi.remarks
            if self.psi.frozen and self.psi.weights_time < outcome.time - subject.timing.control_period / 2:
                result.append(f"frozen weights are those of t = {self.psi.weights_time:.3g} s, the last that are known")
        return result

    def to_dict(self) -> dict[str, Any]:
        """Everything that `mmnn judge` tells, for JSON; a part that cannot be had is null, and `remarks` say why."""
        recording = self.subject.recording
        return {
            "run": str(recording.path) if recording.path else None,
            "controller": self.subject.controller,
            "robot": self.subject.robot.name,
            "outcome": recording.outcome.status,
            "psi": self.psi.to_dict() if self.has("psi") else None,
            "remarks": self.remarks(),
        }

    def __repr__(self) -> str:
        return f"<{type(self).__name__}: {self.subject.controller} on {self.subject.robot.name}>"

    def __str__(self) -> str:
        return str(shown(self, "text"))

    def _try(self, part: str) -> InputError | None:
        errors: dict[str, InputError | None] = self.__dict__.setdefault("_errors", {})
        if part not in errors:
            try:
                getattr(self, part)
                errors[part] = None
            except InputError as error:
                errors[part] = error
        return errors[part]


@checked
def judge(
    recording: Recording,
    *,
    payload: float | None = None,
    windows: int = WINDOWS,
    progress: Callable[[str, float], None] | None = None,
) -> Judgement:
    """Judge one recorded run: did it learn Psi, or only follow it? `print` shows the tables.

    Args:
        recording: The run.
        payload: Load of the changed robot on which frozen weights are tried [kg]; None for a usual one.
        windows: Number of windows of the online FVU.
        progress: Called with what is being done and the fraction done.

    Raises:
        InputError: The recording does not hold what there is to judge, with every reason.

    >>> robot = load("platform_arm")
    >>> path = Trajectory.of(robot, base=Line(speed=0.3), arm={"arm_1_joint": Sine(0.5, period=4.0)})
    >>> run = Loop(robot, path, Neural(), timing=Timing(duration=0.6)).run()
    >>> sorted(judge(run).psi.frozen)
    ['held_out', 'payload', 'same']
    """
    found = Judgement(recording, payload=payload, windows=windows, progress=progress)
    found.require_any()
    return found


def sentence(error: InputError) -> str:
    """An error on one line: what is wrong, and why."""
    return " ".join(": ".join(part for part in (error.what, error.why) if part).split())


def keep(judgement: Judgement) -> None:
    """Remember a judgement for the figures of its recording."""
    KEPT[judgement.subject.recording] = judgement


def judgement_of(recording: Recording) -> Judgement:
    """The judgement of a recording; errors as of `Judgement`."""
    if (judgement := KEPT.get(recording)) is None:
        judgement = KEPT[recording] = Judgement(recording)
    return judgement


def with_part(
    recordings: Mapping[str, Recording], part: str, of: Callable[[Recording], J]
) -> tuple[dict[str, J], list[str]]:
    """The judgements that have a part, by name, and why the others have none.

    Args:
        recordings: The runs by name.
        part: Of their judgements.
        of: The judgement of a recording.
    """
    result, reasons = {}, []
    for name, recording in recordings.items():
        if not len(recording):
            continue
        try:
            found = of(recording)
            getattr(found, part)
            result[name] = found
        except InputError as error:
            reasons.append(f"{name}: {' '.join(str(error).split())}")
    return result, reasons
