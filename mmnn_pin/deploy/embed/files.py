"""The files of an exported controller."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from hashlib import sha256
from string import ascii_letters, digits
from typing import Any

import jinja2
import numpy as np

from ... import __version__
from ...loop.servo import needs_torques
from ...loop.stepper import Stepper
from ...model.tree.motion import NUMBER
from ...recording.versions import versions
from ...settings.meanings import meanings
from ...signals import SIGNALS, Array
from ...torque.law import ROUNDING, LawNumbers, numbers_of
from . import board, body
from .golden import Answer, GoldenEvent
from .program import CFunction, CProgram
from .tunables import Carrier, Tunable, carrier_of, gains_of, limits_of
from .values import Number, Root, Static, spelled

TEMPLATES = jinja2.Environment(
    loader=jinja2.PackageLoader("mmnn_pin.deploy.embed"), undefined=jinja2.StrictUndefined, keep_trailing_newline=True
)
ENTRIES = (board.step, board.pause, board.resume, board.stop, board.reset, board.is_over)
FEW = 3  # numbers that are set one by one at the start
SPARSE = 2  # times as much code as a number of a table takes one that is set by itself
KEPT = frozenset(ascii_letters + digits + " _-+.,:()/")  # signs of names that mean nothing in C, printf, XML, Markdown
LICENCE = "Apache-2.0"
# Reference interfaces of a base by its velocities, as diff_drive_controller and mecanum_drive_controller name them.
REFERENCES: dict[int, tuple[str, ...]] = {
    2: ("linear/velocity", "angular/velocity"),
    3: ("linear/x/velocity", "linear/y/velocity", "angular/z/velocity"),
}
DEPENDS = (
    "control_msgs", "controller_interface", "generate_parameter_library", "geometry_msgs", "hardware_interface",
    "nav_msgs", "pluginlib", "rclcpp", "rclcpp_lifecycle", "trajectory_msgs",
)  # fmt: skip
COMMENTS = {"md": ("<!-- ", " -->"), "xml": ("<!-- ", " -->")}
COMMENTS |= dict.fromkeys(("c", "h", "ld", "cpp"), ("/* ", " */"))
TOLERANCE = 1e-3  # of torques in single precision, over the largest


@dataclass(frozen=True)
class StructField:
    """A field of a struct that a board may change, and the members of the controller in which it stands."""

    tunable: Tunable
    places: list[tuple[str, int]]


@dataclass(frozen=True)
class Export:
    """A translated controller."""

    stepper: board.Fresh  # the stepper that it was made from
    program: CProgram  # its functions
    title: str  # controller and robot in words
    structs: dict[str, list[StructField]]  # fields of what a board may change, `gains` and `limits`
    carrier: Carrier | None  # what carries a payload, of a controller that believes in a model; None for others
    units: Mapping[str, tuple[str, float]]  # of motors that take a "current" or "pwm": which, and the torque per unit

    @cached_property
    def settings(self) -> str:
        """A hash of all that the controller is: functions, tables, initial values and what may be changed."""
        tables = [table(self.program, root) for root in [*self.tables, *starts(self)]]
        texts = [self.title, *(f.text for f in self.functions), *tables, initial(self), str(structs_of(self))]
        return sha256("\n".join(texts).encode()).hexdigest()[:16]

    @property
    def saved(self) -> list[Root]:
        """Members that hold what is learned."""
        pieces = {id(piece) for (root, _), piece in self.program.pieces.items() if root == "learned"}
        return [m for m in self.members if m.name == "learned" or id(m) in pieces]

    @property
    def members(self) -> list[Root]:
        """Members of the struct by their size: small ones first, for short offsets of most."""
        roots = [*self.program.roots.values(), *self.program.pieces.values()]
        members = [root for root in roots if root.name in self.program.written and not root.parts]
        return sorted(members, key=lambda root: root.data.size)

    @property
    def remembered(self) -> list[Root]:
        """Members that a checksum covers: without integers and room to work in."""
        lasting = {id(root) for root in self.program.pieces.values()}
        first = ("row", "guide_now", "guide_aim", "guide_wanted", "learned")
        return [m for m in self.members if m.kind == "real" and (m.name in first or id(m) in lasting)]

    @property
    def tables(self) -> list[Root]:
        """Constant tables that the functions read."""
        text = "\n".join(function.text for function in self.functions)
        roots = [*self.program.roots.values(), *self.program.pieces.values()]
        return [r for r in roots if r.name not in self.program.written and re.search(rf"\blaw_{r.name}\b", text)]

    @property
    def functions(self) -> list[CFunction]:
        """All functions that do something and are called, callees first."""
        found = [function for function in self.program.functions.values() if not function.is_empty]
        entries = {f"board_{function.__name__}" for function in ENTRIES}
        while True:
            text = "\n".join(function.text for function in found)
            called = [f for f in found if f.name in entries or re.search(rf"\b{f.name}\(", text)]
            if len(called) == len(found):
                return found
            found = called


def translated(
    stepper: board.Fresh,
    title: str,
    real: str = "double",
    diagnostics: bool = True,
    units: Mapping[str, tuple[str, float]] = {},
) -> Export:
    """Translate the step of a stepper; without diagnostics what only tells of the excitation is left out.

    Raises:
        Untranslatable: Something in its functions cannot be said in C.
    """
    program, b = CProgram(body.write, real), board.board_of(stepper)
    program.memory(b.row, "row")
    for i, name in enumerate(name for name, *_ in SIGNALS):
        program.hints["at", i] = f"MMNN_ROW_{name}"
    program.memory(b.at, "at")
    for name in ("incoming", "asked"):
        program.memory(getattr(b, name), name)
        program.written.add(name)
    program.memory(b.motor_velocity, "motor_velocity")
    program.memory(b.motor_position, "motor_position")
    law = b.control.law
    named = prefixed("law", numbers_of(law.settings, law.sizes))
    rows = named.pop("law_gains")
    named |= {f"law_gains{i}": row for i, row in enumerate(rows)}
    program.memory(law.settings, "law", cut(law.settings, named))
    said = meanings(LawNumbers)
    for piece in program.pieces.values():
        piece.about = said.get(re.sub(r"law_|\d+$", "", piece.name), "")
    program.memory(b.control.gains, "kinematic_gains")
    program.memory(b.control.K, "joint_gains")
    for name in ("base", "arm", "ends"):
        program.memory(getattr(b.guide, name), f"reference_{name}")
    structs = {name: placed(program, fields) for name, fields in tunables(stepper).items()}
    carrier = None if b.model is None else carrier_of(stepper.robot, b.model.body.tree.numbers)
    if carrier is not None:
        program.written.add(program.memory(carrier.numbers, "carried").name)
    way = stepper.hardware.way
    program.dropped |= {"motor_states", "sent"}  # what only simulated motors and lines read
    program.dropped |= {
        program.memory(part, "unread").name for part in (way.totals.force, way.totals.hand, way.shorted)
    }
    if b.ahead is None and b.steering is None:
        program.dropped.add(program.memory(b.before, "before").name)
    learned = stepper.state
    if getattr(learned, "values", None) is not None and learned.values.size:
        sizes = {name: int(np.prod(shape)) for name, shape in learned.shapes.items()}
        program.memory(learned.values, "learned", None if goes_back(stepper) else sizes)
        program.dropped |= {"gram"} if not diagnostics else set()
    program.memory(stepper.hardware.state, "hardware", parts_of(stepper))
    whole = Static(b, "board")
    time, measured = Number("real", "time"), Number("real", "measured")
    is_measured, wish = Number("bool", "is_measured"), Number("int", "wish")
    calls: list[tuple[Any, dict[str, Any]]] = [
        (board.step, {"time": time, "is_measured": is_measured, "measured": measured, "wish": wish}),
        *((function, {}) for function in ENTRIES[1:]),
    ]

    def call_all() -> None:
        for function, arguments in calls:
            program.function(program.source(function), {"b": whole, **arguments})

    program.translate(call_all)
    return Export(stepper, program, title, structs, carrier, units)


def goes_back(stepper: Stepper) -> bool:
    """Whether contact takes back all that was learned, so that it is one member."""
    touch = stepper.hardware.touch
    return touch is not None and touch.state.saved.size > 0


def placed(program: CProgram, fields: Iterable[Tunable]) -> list[StructField]:
    """Fields with the members of the struct in which they stand, which become memory."""
    found = list[StructField]()
    for field in fields:
        places = list[tuple[str, int]]()
        for array in field.arrays:
            whole = program.array(array, f"limits_{field.name}")
            assert isinstance(whole.base, Root)
            program.written.add(whole.base.name)
            places.append((whole.base.name, whole.offset.value))
        found.append(StructField(field, places))
    return found


def tunables(stepper: Stepper) -> dict[str, list[Tunable]]:
    """Tunables of a stepper by the name of their struct; those that hold nothing are left out."""
    found = {"gains": gains_of(stepper), "limits": limits_of(stepper)}
    return {name: fields for name, fields in found.items() if fields}


def parts_of(stepper: Stepper) -> dict[str, int]:
    """The members that the state of supervisor, motors and servos is split into, in the order of its memory."""
    hardware = stepper.hardware
    supervisor = hardware.way.supervisor
    named = prefixed("supervisor", supervisor)
    for name in ("values", "asked"):
        del named[f"supervisor_{name}"]
    named |= prefixed("supervisor_is", supervisor.state)
    named |= {"motor_states": hardware.motors.states.values, "sent": hardware.way.sent}
    if hardware.touch is not None:
        named |= prefixed("touch", hardware.touch.state)
    named |= {} if hardware.task is None else {"compliance_state": hardware.task.state}
    if hardware.split is not None:
        named |= prefixed("servo", hardware.split)
    return cut(hardware.state, named)


def prefixed(prefix: str, parts: Any) -> dict[str, Any]:
    """The parts of a named tuple by their names in C."""
    return {f"{prefix}_{name}": part for name, part in parts._asdict().items()}


def cut(whole: Array, named: Mapping[str, Any]) -> dict[str, int]:
    """Names and sizes of the parts of an array, of which some are named, in the order of its memory."""
    found = list[tuple[int, str, int]]()
    first = whole.__array_interface__["data"][0]
    for name, part in named.items():
        if isinstance(part, np.ndarray) and part.size and np.shares_memory(part, whole):
            found.append(((part.__array_interface__["data"][0] - first) // 8, name, part.size))
    sizes, end = dict[str, int](), 0
    for start, name, size in [*sorted(found), (whole.size, "", 0)]:
        if start > end:
            sizes[f"unused{end}"] = start - end
        if size:
            sizes[name] = size
        end = max(end, start + size)
    return sizes


# -- text ------------------------------------------------------------------------------------------------------------


def numbers(values: Array, kind: str, single: bool, per_line: int = 6) -> str:
    """Numbers as the lines of a table."""
    end = "f" if single and kind == "real" else ""
    texts = [str(int(x)) if kind == "int" else spelled(float(x)) + (end if np.isfinite(x) else "") for x in values]
    lines = (", ".join(texts[i : i + per_line]) for i in range(0, len(texts), per_line))
    return ",\n".join(f"    {line}" for line in lines)


def definitions(functions: list[CFunction], public: Iterable[CFunction] = ()) -> list[str]:
    """Functions with their comments; compilers are kept from copying what is called from several places into each.

    So they are of the supervisor's checks, which they would unroll with the loops around them. Functions of controllers
    that make a number of numbers, without a loop, are algebra, and faster where they are copied.
    """
    text, made = "\n".join(function.text for function in functions), []
    for function in functions:
        is_algebra = not (function.result is None or function.uses_self or function.is_math or "for (" in function.text)
        is_one = function.name.startswith("supervisor_check_")
        is_one = is_one or (not is_algebra and len(re.findall(rf"\b{function.name}\(", text)) > 1)
        head = f"{'' if function in public else 'static '}{'MMNN_ONCE ' if is_one else ''}{function.head}"
        made.append(f"{function.comment}\n{head}\n{{\n{function.text}\n}}\n")
    return made


def constants_in(program: CProgram, text: str) -> str:
    """Definitions of the named constants that a text mentions."""
    used = set(re.findall(r"\b[A-Z][A-Z0-9_]+\b", text))
    single = program.real != "double"
    lines = []
    for name, value in program.constants.items():
        if name in used and not name.startswith("MMNN_ROW_"):
            said = str(value) if isinstance(value, int) else spelled(value)
            said += "f" if single and isinstance(value, float) and np.isfinite(value) else ""
            lines.append(f"#define {name} {f'({said})' if said.startswith('-') else said}")
    return "\n".join(lines)


def files_of(export: Export) -> dict[str, str]:
    """Names and texts of the files, without the self-test."""
    return {name: headed(export, name, text) for name, text in bare_files_of(export).items()}


def headed(export: Export, name: str, text: str) -> str:
    """A file with its licence, and with what it was written by, of which settings."""
    made = f"Written by mmnn embed of mmnn_pin {__version__}, commit {commit()}, settings {export.settings}."
    suffix = name.rpartition(".")[2]
    start, end = COMMENTS.get(suffix, ("# ", ""))
    head = "".join(f"{start}{line}{end}\n" for line in (f"SPDX-License-Identifier: {LICENCE}", made))
    first, _, rest = text.partition("\n")
    return f"{first}\n{head}{rest}" if first.startswith("<?xml") else head + text


def commit() -> str:
    """The commit of this package."""
    return versions().get("commit", "unknown")


def bare_files_of(export: Export) -> dict[str, str]:
    """Names and texts of the files, without the self-test and without their heads."""
    program = export.program
    ours = [f for f in export.functions if not f.is_math]
    maths = [f for f in export.functions if f.is_math]
    math_text, text = "\n".join(f.text for f in maths), "\n".join(f.text for f in ours)
    tables = [t for t in export.tables if re.search(rf"\blaw_{t.name}\b", text)]
    own_tables = [t for t in export.tables if t not in tables]
    public = [f for f in maths if re.search(rf"\b{f.name}\(", text)]
    every = [*tables, *starts(export)]
    double = CProgram(body.write)
    double.constants = program.constants
    return {
        "controller.h": render("controller.h", export),
        "controller.c": render(
            "controller.c", export, functions=definitions(ours), init=initial(export),
            constants=constants_in(program, text),
        ),
        "tuning.c": render("tuning.c", export, carried=carried_row(export)),
        "robot_law.h": render("robot_law", export, is_header=True, tables="\n".join(
            f"extern const {program.c_type(t.kind)} law_{t.name}[{room(t)}];" for t in every
        )),
        "robot_law.c": render(
            "robot_law", export, is_header=False, tables="\n\n".join(table(program, t) for t in every)
        ),
        "mmnn_math.h": render("mmnn_math.h", export, types=types(program), prototypes="\n".join(
            f"{f.comment}\n{f.head};\n" for f in public
        )),
        "mmnn_math.c": render(
            "mmnn_math.c", export, functions=definitions(maths, public), constants=constants_in(double, math_text),
            tables="\n\n".join("static " + table(double, t) for t in own_tables),
        ),
        "CMakeLists.txt": render("CMakeLists.txt", export, package=package_of(export), depends=()),
        "qemu_mps2/startup.c": render("startup.c", export),
        "qemu_mps2/mps2.ld": render("mps2.ld", export),
        "in_the_loop/link.c": link(export),
        **({} if export.stepper.robot.steers else plugin(export)),  # its odometry says nothing of u
    }  # fmt: skip


def render(template: str, export: Export, **values: Any) -> str:
    """A file from its template, the facts of an export and more values; runs of empty lines become one."""
    text = TEMPLATES.get_template(f"{template}.j2").render(facts(export) | values)
    return re.sub(r"\n{3,}", "\n\n", "\n".join(line.rstrip() for line in text.splitlines())).strip("\n") + "\n"


def table(program: CProgram, root: Root) -> str:
    """The definition of a constant table."""
    kind = program.c_type(root.kind)
    body = numbers(root.data if root.data.size else np.zeros(1), root.kind, program.real != "double")
    about = f"/* {root.about} */\n" if root.about else ""
    return f"{about}const {kind} law_{root.name}[{room(root)}] = {{\n{body}\n}};"


def starts(export: Export) -> list[Root]:
    """Tables of what members hold at the start, of those that are not mostly zeros."""
    found = []
    for member in export.members:
        count = np.count_nonzero(member.data)
        if count > FEW and SPARSE * count > member.data.size and member.kind == "real":
            found.append(replace(member, name=f"start_{member.name}"))
    return found


def room(member: Root) -> int:
    """Numbers that a member takes in the struct, or a table: C has no empty arrays."""
    return max(member.data.size, 1)


def initial(export: Export) -> str:
    """The lines that give a controller its first values, after all bytes were set to zero."""
    lines, tables = list[str](), {t.name for t in starts(export)}
    for m in export.members:
        if f"start_{m.name}" in tables:
            lines.append(f"    mmnn_take(law_start_{m.name}, self->{m.name}, {m.data.size});")
            continue
        for i in np.flatnonzero(np.asarray(m.data, float).view(np.int64)):  # minus zero, too
            x = m.data[i]
            lines.append(f"    self->{m.name}[{i}] = {spelled(float(x)) if m.kind == 'real' else int(x)};")
    return "\n".join(lines)


def types(program: CProgram) -> str:
    """The structs of several numbers."""
    lines = []
    for size in sorted(program.vecs):
        lines.append(f"typedef struct {{\n    double v[{size}];\n}} mmnn_vec{size};\n")
        if program.real != "double":
            lines.append(f"typedef struct {{\n    float v[{size}];\n}} mmnn_single{size};\n")
            parts = ", ".join(f"(float)x.v[{i}]" for i in range(size))
            lines.append(
                f"static inline mmnn_single{size} mmnn_to_single{size}(mmnn_vec{size} x)\n{{\n"
                f"    return MMNN_OF(mmnn_single{size}){{{{{parts}}}}};\n}}\n"
            )
    for kinds in sorted(program.records, key=str):
        is_math = all(isinstance(kind, str) for kind in kinds)  # functions of controllers return structs side by side
        members = "\n".join(f"    {program.c_type(kind, is_math=is_math)} n{i};" for i, kind in enumerate(kinds))
        lines.append(f"typedef struct {{\n{members}\n}} {program.record_type(kinds)};\n")
    return "\n".join(lines)


def facts(export: Export) -> dict[str, Any]:
    """The facts of an export that templates mention: its numbers, its interface, the members of its struct."""
    stepper, program = export.stepper, export.program
    layout, unit = stepper.setup.layout, stepper.setup.layout.unit
    here = [(name, layout.where(name)) for name, *_ in SIGNALS]
    d = layout
    measured = ranges(pose=d.pose, velocity=d.base, q=d.arm, qdot=d.arm, shape=d.shape)
    asked = ranges(pose=d.pose, velocity=d.twist, acceleration=d.twist, q=d.arm, qdot=d.arm, qddot=d.arm)
    units = {name: unit(name) for name in ("pose", "velocity", "q", "qdot", "shape")}
    units |= {"acceleration": unit("acceleration_ref"), "qddot": unit("qddot_ref")}
    return {
        "title": export.title,
        "version": __version__,
        "real": program.real,
        "is_exact": program.real == "double",
        "tolerance": TOLERANCE,
        "has_split": stepper.hardware.split is not None,
        "period": stepper.period,
        "motors": layout.motors,
        "motor_names": [plain(name) for name in stepper.robot.actuator_names],
        "sent": sent(export),
        "timeout": stepper.follower.timeout,
        "measurement": [(name, size, units[name]) for name, _, size in measured],
        "setpoint": [(name, size, units[name]) for name, _, size in asked],
        "measured": measured,
        "asked": asked,
        "signals": [(name.upper(), at.start, f"{at.stop - at.start} {unit(name)}".strip()) for name, at in here],
        "width": layout.width,
        "members": [(program.c_type(m.kind), m.name, room(m), m.about) for m in export.members],
        "commit": commit(),
        "settings": export.settings,
        "structs": structs_of(export),
        "tiny": "1e-9" + ("f" if program.real != "double" else ""),
        "nearly": spelled(1.0 - ROUNDING),
        "carrier": plain(export.carrier.joint) if export.carrier else "",
        "saved": [(m.name, m.data.size) for m in export.saved],
        "saved_numbers": sum(m.data.size for m in export.saved),
        "identity": identity(export),
        "has_positions": bool(export.stepper.placed),
        "number_bytes": 8 if program.real == "double" else 4,
        "remembered": [(m.name, m.data.size) for m in export.remembered],
    }


def sent(export: Export) -> list[tuple[int, str, str]]:
    """Motors that take a torque in another unit: place, what is sent as a comment, and the torque per unit in C."""
    single, found = export.program.real != "double", []
    for j, name in enumerate(export.stepper.robot.actuator_names):
        if name in export.units:
            kind, constant = export.units[name]
            unit = "A, with N m/A or N/A" if kind == "current" else "share of full duty, with N m or N at all of it"
            number = numbers(np.array([constant]), "real", single, 1).strip()
            found.append((j, f"{plain(name)}: {kind} [{unit}]", number))
    return found


def structs_of(export: Export) -> list[dict[str, Any]]:
    """The structs that a board may change, with the bounds of their fields and where these stand."""
    single, found = export.program.real != "double", list[dict[str, Any]]()
    for name, fields in export.structs.items():
        rows = []
        for field in fields:
            one = field.tunable
            bounds = [numbers(bound, "real", single, bound.size).strip() for bound in (one.least, one.most)]
            rows.append((one.name, one.most.size, one.about, *bounds, field.places))
        found.append({"name": name, "fields": rows})
    return found


def carried_row(export: Export) -> dict[str, str] | None:
    """Where a payload goes: the numbers of what carries it without one, and how the frames are turned."""
    if export.carrier is None:
        return None
    carrier, single = export.carrier, export.program.real != "double"
    row = carrier.numbers[carrier.row]
    texts = {"empty": row[NUMBER.mass : NUMBER.weight], "turn": carrier.turn.ravel()}
    found = {name: numbers(values, "real", single, values.size).strip() for name, values in texts.items()}
    member = next(
        r.name for r in export.program.roots.values() if r.live.base is carrier.numbers or r.name == "carried"
    )
    return found | {"member": member, "at": str(carrier.row * row.size + NUMBER.mass)}


def identity(export: Export) -> str:
    """A number of what is saved: of whom, and which arrays of which sizes."""
    text = repr((export.title, export.program.real, [(m.name, m.data.size) for m in export.saved]))
    return sha256(text.encode()).hexdigest()[:16]


def ranges(**sizes: int) -> list[tuple[str, int, int]]:
    """Name, start and size of the parts of a measurement or a setpoint that the robot has."""
    ends = np.cumsum(list(sizes.values())).tolist()
    return [(name, end - size, size) for (name, size), end in zip(sizes.items(), ends, strict=True) if size]


def selftest(export: Export, events: list[GoldenEvent], answers: list[Answer]) -> str:
    """The self-test with its golden vectors."""
    received = [e.received for e in events if e.received is not None]
    asked = [e.asked for e in events if e.wish]
    text = render(
        "selftest.c",
        export,
        steps=len(events),
        events=",\n".join(
            f"    {{{exact(e.time)}, {exact(e.measured)}, {int(e.received is not None)}, {e.wish}, {e.action}}}"
            for e in events
        ),
        measurement_size=len(received[0]) if received else 0,
        measurements=rows(received),
        setpoint_size=len(asked[0]) if asked else 0,
        setpoints=rows(asked),
        torques=rows(answer.torque for answer in answers),
        sums=",\n".join(f"    UINT64_C({answer.checksum:#x})" for answer in answers),
    )
    return headed(export, "selftest.c", text)


def link(export: Export) -> str:
    """The controller as a process."""
    guide, received = export.stepper.follower.guide, export.stepper.received
    return render(
        "link.c", export, measurement_size=received.size, frame=5 + received.size + guide.wanted.size,
        answer=2 + sum(member.data.size for member in export.remembered),
    )  # fmt: skip


def package_of(export: Export) -> str:
    """Name of the package and of its C++ namespace."""
    name = re.sub(r"[^a-z0-9]+", "_", f"{export.stepper.robot.name}_{export.stepper.setup.controller.name}".lower())
    return f"mmnn_{name.strip('_')}"


def plugin(export: Export) -> dict[str, str]:
    """The package of a plugin of ros2_control."""
    robot, stepper = export.stepper.robot, export.stepper
    d, names, kinds = robot.dimensions, robot.actuator_names, stepper.setup.interfaces
    sources = {"effort": "torque", "velocity": "velocity", "position": "position"}
    interfaces = [(name, kinds.get(name, "effort")) for name in names]
    command = "mmnn_motor_torque(&controller_)[j]"
    for kind in sorted({kind for _, kind in interfaces} - {"effort"}):
        command = f'motor_interfaces[j] == "{kind}" ? mmnn_motor_{sources[kind]}(&controller_)[j] : {command}'
    tuned = {name: [row for row in rows if np.isfinite(row.most).all()] for name, rows in by_struct(export).items()}
    values = {
        "package": package_of(export), "base_size": d.base, "arm_size": d.arm, "motors": quoted(names),
        "motor_interfaces": quoted(kind for _, kind in interfaces), "arm": quoted(robot.joint_names),
        "base_references": quoted(REFERENCES.get(d.base, ())), "reference_names": REFERENCES.get(d.base, ()),
        "looks_back": needs_torques(stepper.setup.controller, stepper.setup.context()), "command": command,
        "depends": DEPENDS, "licence": LICENCE, "rate": round(1.0 / stepper.period),
        "odometry_at": spelled_row(robot.frame if d.base else np.zeros(3)), "joints": [*map(plain, robot.joint_names)],
        "interfaces": [(plain(name), kind) for name, kind in interfaces],
        "tuned": {name: [(row.name, row.most.size) for row in rows] for name, rows in tuned.items()},
        "parameters": {name: [as_parameter(row) for row in rows] for name, rows in tuned.items()},
    }  # fmt: skip
    files = {
        "package.xml": "package.xml",
        "ros2_control/plugin.cpp": "plugin.cpp",
        "ros2_control/plugin.xml": "plugin.xml",
    }
    files |= {f"ros2_control/{name}.yaml": f"{name}.yaml" for name in ("parameters", "controllers")}
    files |= {"ros2_control/README.md": "plugin.md", "CMakeLists.txt": "CMakeLists.txt"}
    return {name: render(template, export, **values) for name, template in files.items()}


def by_struct(export: Export) -> dict[str, list[Tunable]]:
    """Tunables of an export by the name of their struct."""
    return {name: [field.tunable for field in fields] for name, fields in export.structs.items()}


def as_parameter(row: Tunable) -> dict[str, Any]:
    """A parameter of the plugin."""
    values = spelled_row(row.arrays[0])
    least, most = (spelled_row(np.array([bound])) for bound in (row.least.min(), row.most.max()))
    return {
        "name": row.name,
        "about": row.about,
        "size": row.most.size,
        "spelled": values,
        "least": least,
        "most": most,
    }


def spelled_row(values: Array) -> str:
    """Numbers of a list in YAML, which takes 1e-06 for a text."""
    return ", ".join(re.sub(r"^(-?\d+)e", r"\1.0e", spelled(float(x))) for x in values)


def quoted(names: Iterable[str]) -> str:
    """Names as the entries of a list in C; what could end a string, or be a trigraph, as octal numbers."""
    safe = {ord(sign) for sign in KEPT}
    texts = ("".join(chr(b) if b in safe else f"\\{b:03o}" for b in name.encode()) for name in names)
    return ", ".join(f'"{text}"' for text in texts)


def plain(name: str) -> str:
    """A robot's or a joint's name for comments, prints and pages, where it can neither end nor begin anything."""
    return "".join(sign if sign in KEPT else "_" for sign in name)


def readme(export: Export, steps: int, ram: int) -> str:
    """The page that a firmware engineer reads first."""
    return headed(export, "README.md", render("README.md", export, steps=steps, ram=ram))


def exact(value: float) -> str:
    """A number as C reads it back exactly."""
    return float(value).hex() if np.isfinite(value) else spelled(value)


def rows(arrays: Iterable[Array]) -> str:
    """The rows of a table of exact numbers."""
    return ",\n".join("    {" + ", ".join(exact(x) for x in array) + "}" for array in arrays)
