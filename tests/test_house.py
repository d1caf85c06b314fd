"""The house: which floor a module stands on, what it may import, and that nothing imports itself over others."""

from __future__ import annotations

import ast
import re
import subprocess
from functools import cache
from pathlib import Path

import pytest
from places import ROOT

PACKAGE = ROOT / "mmnn_pin"

# From the ground up. A module may import its own floor and those below; type-only and late imports count, too.
FLOORS = (
    (
        "ground",
        (
            "errors",
            "files",
            "shown",
            "signals",
            "settings",
            "parts",
            "children",
            "program",
            "compiled",
            "by_address",
            "elementary",
        ),
    ),
    ("model", ("model",)),
    (
        "blocks",
        (
            "reference",
            "kinematic",
            "torque",
            "compliance",
            "safety",
            "touch",
            "actuator",
            "disturbance",
            "plant",
            "sensing",
        ),
    ),
    ("recording", ("recording",)),
    ("loop", ("loop",)),
    ("deploy", ("deploy",)),
    ("experiments", ("lab.experiments",)),
    ("studies and psi", ("lab.study", "lab.psi")),
    ("show", ("lab.show",)),
    ("command line", ("cli",)),
)
FLOOR = {name: floor for floor, (_, names) in enumerate(FLOORS) for name in names}
# What a controller imports is what it may know: nothing of the robot, or only how it moves.
GROUND = dict(FLOORS)["ground"]
KNOWS = {
    "torque.random_features": GROUND,
    "torque.two_layer": (*GROUND, "torque"),
    "torque.one_layer": (*GROUND, "torque"),
    "torque.neural": (*GROUND, "torque"),
    "torque.law": (*GROUND, "torque"),
    "torque": (*GROUND, "torque", "model.regressor"),
    "model.base": (*GROUND, "model"),
}
# These are handed a robot that somebody believes in: the oracle, and a nominal model. They hold it and pass it on.
HANDED = {"torque.model_based", "torque.two_layer_residual"}
# What differs by processor: a libm, and what numpy makes of it.
LIBM = {
    *("sin", "cos", "tan", "asin", "acos", "atan", "atan2", "arcsin", "arccos", "arctan", "arctan2", "sinc", "angle"),
    *("sinh", "cosh", "tanh", "exp", "exp2", "expm1", "log", "log2", "log10", "log1p", "pow", "power", "float_power"),
    *("hypot", "cbrt", "standard_normal", "normal", "exponential", "lognormal"),
}
# And a BLAS; in compiled code only, elsewhere it may judge and print.
BLAS = {"dot", "vdot", "inner", "matmul", "einsum", "linalg"}
# Modules that hand numbers to Pinocchio, or judge: none of theirs reaches a run's motion.
JUDGES = (
    *("model.structure", "model.dynamics", "model.checks", "model.regressor", "model.tree.tree"),
    *("model.base.differential", "model.base.wheels", "model.base.understanding", "model.urdf.document"),
    *("model.base.holonomic", "model.urdf.audit", "plant.contact.tree"),
    *("loop.sampled", "loop.stable_gains"),
)


@cache
def modules() -> dict[str, Path]:
    """Dotted names of all modules of the package, without `mmnn_pin`, and their files; "" is the package itself."""
    found = {}
    for file in PACKAGE.rglob("*.py"):
        parts = file.relative_to(PACKAGE).with_suffix("").parts
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = file
    return found


@cache
def imports(module: str) -> frozenset[str]:
    """Modules of the package that a module imports, anywhere in its text."""
    file = modules()[module]
    package = ("mmnn_pin", *file.relative_to(PACKAGE).parts[:-1])
    found = set()
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else ()
            where = ".".join((*base, *filter(None, [node.module])))
            for alias in node.names:
                inner = f"{where}.{alias.name}".removeprefix("mmnn_pin").removeprefix(".")
                found.add(inner if inner in modules() else where.removeprefix("mmnn_pin").removeprefix("."))
        elif isinstance(node, ast.Import):
            found |= {
                alias.name.removeprefix("mmnn_pin.") for alias in node.names if alias.name.startswith("mmnn_pin.")
            }
        elif isinstance(node, ast.Call) and ast.unparse(node.func).endswith("import_module"):
            found |= named_in(node)
    return frozenset((found & set(modules())) - {module, ""})


def named_in(call: ast.Call) -> set[str]:
    """Modules of the package that the texts of a call name: an import made of a string."""
    texts = (node.value for node in ast.walk(call) if isinstance(node, ast.Constant) and isinstance(node.value, str))
    return {text.strip(".").removeprefix("mmnn_pin").strip(".") for text in texts if text.startswith("mmnn_pin")}


def block_of(module: str) -> str:
    """The entry of `FLOORS` that a module belongs to; "" for the package and for `lab` themselves."""
    return next((name for name in FLOOR if module == name or module.startswith(f"{name}.")), "")


def test_every_module_stands_on_a_floor() -> None:
    assert [module for module in modules() if module not in ("", "lab") and not block_of(module)] == []


def test_nothing_imports_what_stands_above_it() -> None:
    upward = [
        f"{module} imports {other}"
        for module in modules()
        if block_of(module)
        for other in imports(module)
        if block_of(other) and FLOOR[block_of(other)] > FLOOR[block_of(module)]
    ]
    assert upward == []


def test_imports_made_of_strings_are_seen() -> None:
    (call,) = (n for n in ast.walk(ast.parse('import_module("mmnn_pin.lab.show.gallery")')) if isinstance(n, ast.Call))
    assert named_in(call) == {"lab.show.gallery"}


def test_nothing_imports_research() -> None:
    """Not even by a string: what research adds to the package registers itself from above."""
    assert [
        module for module, file in modules().items() if re.search(r"(from|import) research\b", file.read_text())
    ] == []


def test_blocks_meet_only_in_the_loop() -> None:
    blocks = dict(FLOORS)["blocks"]
    meetings = [
        f"{module} imports {other}"
        for module in modules()
        if block_of(module) in blocks
        for other in imports(module)
        if block_of(other) in blocks and block_of(other) != block_of(module)
    ]
    assert meetings == []


def test_no_module_imports_itself_over_others() -> None:
    assert rings({module: set(imports(module)) for module in modules()}) == []


def test_what_moves_a_robot_uses_no_libm() -> None:
    """`mmnn_pin.elementary` instead: exact bits everywhere. Of `math`, sqrt and what is exact remains."""
    found = [
        f"{module}:{node.lineno} {node.attr}"
        for module, file in modules().items()
        if block_of(module) and FLOOR[block_of(module)] <= FLOOR["loop"] and not module.startswith(JUDGES)
        for node in ast.walk(ast.parse(file.read_text()))
        if isinstance(node, ast.Attribute) and node.attr in LIBM
        if isinstance(node.value, ast.Name) and node.value.id in ("math", "np", "rng", "normal", "stream")
    ]
    assert found == []


def test_compiled_code_uses_neither_a_libm_nor_a_blas() -> None:
    found = []
    for module, file in modules().items():
        for function in ast.walk(ast.parse(file.read_text())):
            if not isinstance(function, ast.FunctionDef) or not any(
                isinstance(mark, ast.Name) and mark.id in ("compiled", "linked", "internal", "inlined")
                for mark in function.decorator_list
            ):
                continue
            for node in ast.walk(ast.Module(function.body, [])):
                product = isinstance(node, ast.BinOp) and isinstance(node.op, ast.MatMult)
                power = isinstance(node, ast.BinOp) and isinstance(node.op, ast.Pow) and not is_two(node)
                called = isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name)
                if product or power or (called and node.value.id in ("math", "np") and node.attr in LIBM | BLAS):
                    found.append(f"{module}:{node.lineno} {ast.unparse(node)}")
    assert found == []


def is_two(power: ast.BinOp) -> bool:
    """Whether a power is of a constant, which is computed before, exactly."""
    return isinstance(power.left, ast.Constant)


def rings(graph: dict[str, set[str]]) -> list[list[str]]:
    """Groups of nodes that reach each other (Tarjan's strongly connected components of more than one node)."""
    index: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    found: list[list[str]] = []

    def visit(node: str) -> None:
        index[node] = low[node] = len(index)
        stack.append(node)
        for other in graph[node]:
            if other not in index:
                visit(other)
                low[node] = min(low[node], low[other])
            elif other in stack:
                low[node] = min(low[node], index[other])
        if low[node] == index[node]:
            ring = []
            while not ring or ring[-1] != node:
                ring.append(stack.pop())
            if len(ring) > 1:
                found.append(sorted(ring))

    for node in graph:
        if node not in index:
            visit(node)
    return found


def test_rings_are_found() -> None:
    assert rings({"a": {"b"}, "b": {"c"}, "c": {"b"}, "d": {"a"}}) == [["b", "c"]]
    assert rings({"a": {"b"}, "b": set()}) == []


@pytest.mark.parametrize("part", KNOWS)
def test_a_controller_knows_what_it_imports(part: str) -> None:
    own = [module for module in modules() if module == part or module.startswith(f"{part}.")]
    assert own
    too_much = [
        f"{module} imports {other}"
        for module in own
        for other in imports(module)
        if not any(other == name or other.startswith(f"{name}.") for name in KNOWS[part])
        if not (module in HANDED and other == "model.robot")
    ]
    assert too_much == []


def test_few_modules_stand_at_the_top() -> None:
    at_the_top = sorted(module for module, file in modules().items() if file.parent == PACKAGE)
    assert len(at_the_top) <= 10, at_the_top


@pytest.mark.parametrize("script", ["run", "full"])
def test_what_the_ci_runs_is_there(script: str) -> None:
    """A path that is gone ends pytest before its first test, beside which the rest goes on and passes."""
    named = re.findall(r"(?<![\w/])(?:research/)?tests/[^\s;)\\]+", (ROOT / ".ci" / script).read_text())
    paths = subprocess.run(["bash", "-c", f"echo {' '.join(named)}"], capture_output=True, text=True, check=True)
    assert named
    assert [path for path in paths.stdout.split() if not (ROOT / path).exists()] == []


def test_each_test_file_has_a_name_of_its_own() -> None:
    """Folders of tests are no packages: pytest refuses the second file of one name, but only when it collects both."""
    names = [file.name for file in (ROOT / "tests").rglob("*.py")]
    assert sorted(name for name in set(names) if names.count(name) > 1) == []


def test_a_type_name_means_one_type() -> None:
    """But `Array`, numpy's, which modules that may not import each other name alike."""
    names: dict[str, set[str]] = {}
    for module, file in modules().items():
        for name in type_names(ast.parse(file.read_text())) - {"Array"}:
            names.setdefault(name, set()).add(module)
    assert {name: found for name, found in names.items() if len(found) > 1} == {}


def type_names(tree: ast.Module) -> set[str]:
    """Public classes and aliases of types at the top level of a module: names in camel case."""
    classes = {node.name for node in tree.body if isinstance(node, ast.ClassDef)}
    assigned = {node.targets[0] for node in tree.body if isinstance(node, ast.Assign)}
    aliases = {node.id for node in assigned if isinstance(node, ast.Name) and re.fullmatch("[A-Z].*[a-z].*", node.id)}
    return {name for name in classes | aliases if not name.startswith("_")}


def test_type_names_are_found() -> None:
    tree = ast.parse("class Arm: ...\nclass _Own: ...\nEnds = tuple[float, float]\nMOST, T = 3, 4\nwide = 5")
    assert type_names(tree) == {"Arm", "Ends"}


def test_docstrings_begin_with_what_they_describe() -> None:
    vague = [
        f"{module}:{node.body[0].lineno} {text.splitlines()[0]}"
        for module, file in modules().items()
        for node in ast.walk(ast.parse(file.read_text()))
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef)
        if (text := ast.get_docstring(node) or "").startswith(("What ", "Itself", "The same"))
    ]
    assert vague == []
