"""`mmnn list`."""

from __future__ import annotations

from typing import Any

import click

from .options import examples, shared
from .output import DONE, say, say_json


@click.command(
    "list",
    short_help="List experiments, robots, controllers, references.",
    epilog=examples("mmnn list", "mmnn list --json"),
)
@shared
def list_(as_json: bool) -> int:
    """List the bundled experiments and robots, the controllers and the references."""
    from ..experiments.controllers import CONTROLLERS
    from ..experiments.files import bundled, read_toml, variants
    from ..experiments.references import ARM_PROFILES, BASE_PATHS
    from ..model.robots import bundled as robots
    from ..model.robots import extra

    there_is: dict[str, dict[str, Any]] = {
        "experiments": {name: read_toml(path).get("title", "") for name, path in bundled().items()},
        "variants": {name: list(variants(path)) for name, path in bundled().items()},
        "robots": {name: str(path) for name, path in (robots() | extra()).items()},
        "controllers": CONTROLLERS,
        "references": {"base": about(BASE_PATHS), "arm": about(ARM_PROFILES)},
    }
    if as_json:
        say_json(there_is)
        return DONE
    references, readings = there_is.pop("references"), there_is.pop("variants")
    for name in [name for name, known in readings.items() if known]:
        there_is["experiments"][name] += f" (--variant {', '.join(readings[name])})"
    there_is |= {f"references of the {part}": kinds for part, kinds in references.items()}
    for kind, entries in there_is.items():
        say("\n".join([kind, *(f"  {name:24}{text}" for name, text in entries.items())]))
    return DONE


def about(kinds: dict[str, Any]) -> dict[str, str]:
    """First line of the docstring of every class."""
    return {name: (kind.__doc__ or "").partition("\n")[0] for name, kind in kinds.items()}
