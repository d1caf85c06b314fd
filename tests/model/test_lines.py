"""The text that a recording keeps of a robot has the lines of its file: `inspect` and a report name the same ones."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mmnn_pin import PD, Loop, Timing, Trajectory, load
from mmnn_pin.model import bundled
from mmnn_pin.model.urdf.document import text_of
from mmnn_pin.model.urdf.reading import parse_xml
from mmnn_pin.recording.recording import recorded_robot

URDF = bundled()["platform_arm"].read_text()
pieces = st.sampled_from(
    ["", "\n", "<!-- one -->", "<!-- two\nlines -->\n\n", "<?pi x?>\n", " <!-- a --> <!--\n\n\n-->"]
)


def lines_of(data: bytes) -> list[tuple[str, int]]:
    root, findings = parse_xml(data)
    assert root is not None, findings
    return [(element.tag, element.sourceline) for element in root.iter()]


@settings(max_examples=25, deadline=None)
@given(st.lists(pieces, min_size=6, max_size=30), st.booleans())
def test_every_element_keeps_its_line(between: list[str], broken: bool) -> None:
    """Comments between tags, before the root and after it; start tags over several lines."""
    parts = re.split(r"(?=<(?:link|joint|visual|inertial)\b)", URDF)
    text = "".join(part + between[i % len(between)] for i, part in enumerate(parts))
    if broken:
        text = text.replace('<link name="base_link"', '<link\n\n    name="base_link"').replace("<origin ", "<origin\n ")
    found = lines_of(text.encode())
    again = text_of(parse_xml(text.encode())[0]).encode()
    assert lines_of(again) == found and b"<!--" not in again
    assert text_of(parse_xml(again)[0]).encode() == again


@pytest.mark.parametrize("name", ["platform_arm", "two_axis_arm", "tiago"])
def test_a_recorded_robot_has_the_findings_of_its_file_with_their_lines(name: str, tmp_path: Path) -> None:
    robot = load(name)
    run = Loop(robot, Trajectory.of(robot), PD(), timing=Timing(duration=0.004)).run()

    def told(r):
        return {(f.line, f.message) for f in r.findings if "mesh" not in f.message and "xacro" not in f.message}

    assert told(recorded_robot(run)) >= told(robot)
    run.meta["urdf_file"] = str(tmp_path / f"{name}.urdf")  # elsewhere the file is gone
    assert {line for line, _ in told(recorded_robot(run))} == {line for line, _ in told(robot)}
