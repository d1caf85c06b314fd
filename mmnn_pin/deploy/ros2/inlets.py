"""Topics of a ROS 2 graph by rclpy, and what is checked before a message is believed.

Messages are taken by the control loop itself, once per sample: no executor stands between, and none is woken by them.
Of more publishers than a topic may have, those that were there first count; what others say is dropped and counted,
and the node does not start on it. A message that does not end where its type ends is dropped by ROS 2.
"""

from __future__ import annotations

from typing import Any

from rclpy.callback_groups import CallbackGroup
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.node import Node as RosNode
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions

BEST, LATCHED = ReliabilityPolicy.BEST_EFFORT, DurabilityPolicy.TRANSIENT_LOCAL
OVERRIDES = QoSOverridingOptions.with_default_policies()


class UnservedGroup(CallbackGroup):
    """Of subscriptions that no executor serves."""

    def can_execute(self, entity: Any) -> bool:
        """Never."""
        return False

    beginning_execution = can_execute

    def ending_execution(self, entity: Any) -> None:
        """Nothing was begun."""


class Inlet:
    """A topic that is listened to.

    Args:
        node: The node.
        name: Of the topic.
        kind: Type of its messages.
        depth: How many messages wait at most, and are looked at per sample.
        reliable: Whether publishers have to be; else it hears both kinds.
        publishers: How many there may be.
        latched: Whether it is told what was published before it came.

    Attributes:
        name: As the graph has it, remapped.
        received: How many messages were believed.
        surplus: Dropped: from more publishers than there may be.
        refused: Dropped for what they say, counted by those who read them.
        clash: The policy of a publisher that offers less than is asked for; empty for none.
        why: What was wrong with the last one that was dropped.
    """

    def __init__(
        self,
        node: RosNode,
        name: str,
        kind: type[Any],
        *,
        depth: int = 4,
        reliable: bool = False,
        publishers: int = 1,
        latched: bool = False,
    ) -> None:
        self.node, self.kind, self.depth, self.most = node, kind, depth, publishers
        self.received = self.surplus = self.refused = 0
        self.clash = self.why = ""
        self.heard: list[Any] = []  # who was believed last, as many as there may be
        quality = QoSProfile(depth=depth)
        quality.reliability = ReliabilityPolicy.RELIABLE if reliable else BEST
        quality.durability = LATCHED if latched else DurabilityPolicy.VOLATILE
        events = SubscriptionEventCallbacks(incompatible_qos=self._clash)
        self.subscription = node.create_subscription(
            kind, name, print, quality, callback_group=UnservedGroup(), event_callbacks=events,
            qos_overriding_options=OVERRIDES,
        )  # fmt: skip
        self.name = str(self.subscription.topic_name)

    @property
    def publishers(self) -> int:
        """How many publishers are matched."""
        return int(self.subscription.get_publisher_count())

    @property
    def dropped(self) -> int:
        """How many were dropped for any reason."""
        return self.surplus + self.refused

    def take(self) -> list[Any]:
        """The messages that came, oldest first, at most as many as the topic's depth."""
        handle, found = self.subscription.handle, []
        with handle:
            for _ in range(self.depth):
                if (came := handle.take_message(self.kind, False)) is None:
                    break
                if self._may_speak(came[1].get("publisher_gid")):
                    found.append(came[0])
        self.received += len(found)
        return found

    def newest(self) -> Any:
        """The newest message that came, or None."""
        return next(reversed(self.take()), None)

    def refuse(self, why: str) -> None:
        """Count a message that is dropped for what it says."""
        self.refused, self.why = self.refused + 1, why

    def crowd(self) -> str:
        """Who publishes, where there are more than there may be; empty else."""
        if self.publishers <= self.most:
            return ""
        found = [one.node_name for one in self.node.get_publishers_info_by_topic(self.name)]
        return f"{len(found)} publishers ({', '.join(found)}), there may be {self.most}"

    def counted(self) -> list[str]:
        """A line on dropped messages, with the number of each kind; empty without any."""
        counts = [f"{getattr(self, name)} {name}" for name in ("surplus", "refused") if getattr(self, name)]
        return [f"{self.name}: {', '.join(counts)} messages dropped"] if counts else []

    def _may_speak(self, who: Any) -> bool:
        """Whether a publisher is believed: anyone while there are few enough, then those that were heard before."""
        name = None if who is None else bytes(who["data"])
        if name is not None and name in self.heard:
            return True
        if self.publishers > self.most:
            self.surplus, self.why = self.surplus + 1, f"more publishers than {self.most}"
            return False
        self.heard = [name, *self.heard][: self.most]
        return True

    def _clash(self, event: Any) -> None:
        self.clash = event.last_policy_kind.name.lower()


class Outlet:
    """A topic that is published.

    Args:
        node: The node.
        name: Of the topic.
        kind: Type of its messages.
        depth: How many messages wait for readers at most.
    """

    def __init__(self, node: RosNode, name: str, kind: type[Any], depth: int = 1) -> None:
        self.node, self.kind, self.clash = node, kind, ""
        self.publisher = node.create_publisher(
            kind, name, QoSProfile(depth=depth), qos_overriding_options=OVERRIDES,
            event_callbacks=PublisherEventCallbacks(incompatible_qos=self._clash),
        )  # fmt: skip
        self.name, self.send = str(self.publisher.topic_name), self.publisher.publish

    @property
    def readers(self) -> int:
        """How many readers are matched."""
        return int(self.publisher.get_subscription_count())

    def others(self) -> list[str]:
        """Other nodes that publish it; a node is known before its name is."""
        found = sorted(
            (one.node_name for one in self.node.get_publishers_info_by_topic(self.name)),
            key=lambda name: name != self.node.get_name(),
        )
        return found[1:]  # one of them is ours

    def _clash(self, event: Any) -> None:
        self.clash = event.last_policy_kind.name.lower()
