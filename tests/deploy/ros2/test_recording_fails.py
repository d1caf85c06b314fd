"""A node whose recording cannot be written any more: the robot is let go before the error is told."""

from __future__ import annotations

import signal
from types import SimpleNamespace
from typing import Any

import pytest

pytest.importorskip("cyclonedds")

from mmnn_pin.deploy.ros2.node import Bridge
from mmnn_pin.errors import RecordingError


def test_a_full_disk_lets_the_efforts_fade(monkeypatch):
    bridge, did = object.__new__(Bridge), []
    bridge.switches = None

    def record() -> None:
        did.append("record")
        raise RecordingError("cannot write the recording")

    steps: dict[str, Any] = {"period": 0.002, "is_over": False, "record": record, "time": 0.0, "tripped": ""}
    bridge.stepper = SimpleNamespace(**steps)  # type: ignore[assignment]
    bridge.asking = SimpleNamespace(rehearse=lambda: None)  # type: ignore[assignment]
    bridge.clock = SimpleNamespace(now=0.0, start=lambda: None)  # type: ignore[assignment]
    bridge.sensing = SimpleNamespace(shift=lambda before: None)  # type: ignore[assignment]
    bridge.settings = SimpleNamespace(diagnostics=None)  # type: ignore[assignment]
    bridge.ticking, bridge.health, bridge.stopped = None, None, []
    monkeypatch.setattr(bridge, "meet", lambda patience: None)
    monkeypatch.setattr(bridge, "sample", lambda time, more=(): did.append("sample"))
    monkeypatch.setattr(bridge, "_leave", lambda: did.append("leave"))
    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(RecordingError):
        bridge.run(1.0)
    assert did == ["sample", "record", "leave"] and signal.getsignal(signal.SIGINT) is before
