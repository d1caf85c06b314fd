"""Of more publishers than a topic may have the first alone is believed, at whatever rates they speak."""

from __future__ import annotations

import importlib
import sys
from collections import deque
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

import pytest
from hypothesis import given
from hypothesis import strategies as st

MODULES = ("", ".callback_groups", ".event_handler", ".node", ".qos", ".qos_overriding_options")
INLETS = "mmnn_pin.deploy.ros2.inlets"


class Topic:
    """A topic whose queue loses its oldest messages where more come than are taken, as DDS does."""

    def __init__(self, depth: int) -> None:
        self.queue, self.matched = deque[tuple[str, dict[str, Any]]](maxlen=depth), list[str]()
        self.handle, self.topic_name = self, "/joint_states"

    def __enter__(self) -> None:
        """Locked, as a handle is."""

    def __exit__(self, *_: object) -> None:
        """And let go."""

    def take_message(self, kind: type, raw: bool) -> tuple[str, dict[str, Any]] | None:
        return self.queue.popleft() if self.queue else None

    def get_publisher_count(self) -> int:
        return len(self.matched)

    def says(self, who: str, times: int, known: bool) -> None:
        for _ in range(times):
            self.queue.append((who, {"publisher_gid": {"data": who.encode()} if known else None}))


@pytest.fixture(scope="module")
def inlets() -> Iterator[Any]:
    """The module, over a ROS 2 that does nothing."""
    with pytest.MonkeyPatch.context() as patch:
        for name in MODULES:
            patch.setitem(sys.modules, f"rclpy{name}", MagicMock(CallbackGroup=object))
        patch.delitem(sys.modules, INLETS, raising=False)
        yield importlib.import_module(INLETS)
        sys.modules.pop(INLETS, None)


def listening(inlets: Any, topic: Topic, depth: int, most: int = 1) -> Any:
    infos = [SimpleNamespace(node_name=name) for name in ("robot", "other")]
    node = SimpleNamespace(create_subscription=lambda *_, **__: topic, get_publishers_info_by_topic=lambda _: infos)
    return inlets.Inlet(node, "joint_states", None, depth=depth, publishers=most)


rates = st.lists(st.tuples(st.integers(0, 3), st.integers(0, 400), st.booleans()), min_size=1, max_size=30)


@given(rates=rates, depth=st.integers(1, 8), later=st.integers(0, 10))
def test_a_second_publisher_is_never_believed_beside_the_first(inlets, rates, depth, later) -> None:
    topic = Topic(depth)
    topic.matched.append("robot")
    inlet = listening(inlets, topic, depth)
    topic.says("robot", 1, True)
    assert inlet.take() == ["robot"]
    for k, (own, foreign, first) in enumerate(rates):
        if k == later:
            topic.matched.append("other")
        for who, times in (("robot", own), ("other", foreign))[:: 1 if first else -1]:
            topic.says(who, times if who in topic.matched else 0, True)
        foreign_left = sum(who == "other" for who, _ in topic.queue)
        before, own_left = inlet.surplus, len(topic.queue) - foreign_left
        assert inlet.take() == ["robot"] * own_left  # what the flood left of it
        assert inlet.surplus - before == foreign_left
    crowd = "2 publishers (robot, other), there may be 1" if len(topic.matched) == 2 else ""
    assert inlet.crowd() == crowd and bool(inlet.counted()) == (inlet.surplus > 0)


@given(own=st.integers(0, 8), foreign=st.integers(0, 8), known=st.booleans())
def test_of_two_that_were_there_before_or_cannot_be_told_apart_none_is(inlets, own, foreign, known) -> None:
    topic = Topic(16)
    topic.matched += ["robot", "other"]
    inlet = listening(inlets, topic, 16)
    topic.says("robot", own, known)
    topic.says("other", foreign, known)
    assert inlet.take() == [] and inlet.surplus == own + foreign
    topic.matched.remove("other")
    topic.says("robot", 1, known)
    assert inlet.take() == ["robot"]
