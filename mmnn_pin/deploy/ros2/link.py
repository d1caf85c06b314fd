"""Topics of a ROS 2 graph by Cyclone DDS, and what is checked before a message is believed.

Who sends: an address that is no peer is not listened to, and of more publishers than a topic may have only those that
came first, until they fall silent. How much: of a flood the newest messages that fit into a topic's depth are looked
at, once per control sample. What: a message that is too large, or that does not end where its type ends, is dropped.
All of it is counted. Addresses are those that a participant tells: a check against mistakes; against forgers there is
DDS security (`network.config`).
"""

from __future__ import annotations

import re
import socket
from collections.abc import Iterable
from typing import Any
from xml.sax.saxutils import escape

from cyclonedds._clayer import ddspy_take, ddspy_write
from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsParticipant
from cyclonedds.core import DDSException, InstanceState, Listener, SampleState, ViewState
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.idl import make_idl_struct
from cyclonedds.idl.types import uint8
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic as DdsTopic
from cyclonedds.util import duration

from ...errors import ConfigError, MmnnError
from .messages import ros, type_hash
from .settings import Network
from .wiring import resolved

# Vendors whose description of types is not compared with ours: Cyclone does not follow that of Fast DDS where a type
# has sequences, and readers here describe only the beginning of a message, so that torn ones are counted, not hidden.
VENDORS = "1.15,1.16"
ALL = SampleState.Any | ViewState.Any | InstanceState.Any
COUNTS = ("malformed", "foreign", "surplus", "refused")  # of an inlet, what is told at the end
XML = """<CycloneDDS><Domain Id="any">
<General><Interfaces><NetworkInterface {interface} multicast="false"/></Interfaces>
<AllowMulticast>false</AllowMulticast></General>
<Discovery><ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>{participants}</MaxAutoParticipantIndex>
<Peers>{peers}</Peers></Discovery>
<Compatibility><IgnoreTypeInformation>{vendors}</IgnoreTypeInformation></Compatibility>
{config}</Domain></CycloneDDS>"""


class Torn(MmnnError):
    """Bytes that are no message of a type."""


def beginning_of(kind: type[Any]) -> type[Any]:
    """A type of the same name with nothing but the first byte: what comes is taken as bytes."""
    return make_idl_struct("Beginning", kind.__idl_typename__, {"first": uint8})


def decoded(data: bytes, kind: type[Any]) -> Any:
    """A message.

    Raises:
        Torn: The bytes are none.
    """
    try:
        return kind.deserialize(data)
    except Exception as error:  # whatever a torn message makes of its decoder
        raise Torn(f"no {ros(kind)}: {error}") from error


class Inlet:
    """A topic that is listened to.

    Attributes:
        name: As people know it.
        kind: Type of its messages.
        received: How many messages were taken.
        malformed: Dropped: too large, or not of the type.
        foreign: Dropped: from an address that is no peer.
        surplus: Dropped: from more publishers than there may be.
        refused: Dropped for what they say, counted by those who read them.
        clashes: Publishers that offer less than is asked for, which are never heard.
        why: What was wrong with the last one that was dropped.
    """

    def __init__(self, link: Link, name: str, kind: type[Any], settings: Any, *, latched: bool = False) -> None:
        self.link, self.name, self.kind = link, link.resolved(name), kind
        self.depth, self.silence, self.most = settings.depth, settings.age, settings.publishers
        self.received = self.malformed = self.foreign = self.surplus = self.refused = self.clashes = 0
        self.why = ""
        self.heard: dict[int, float] = {}  # publishers that are believed, and when they were heard last
        self.known: dict[int, bool] = {}  # publishers, and whether their address is that of a peer
        listener = Listener()
        listener.set_on_requested_incompatible_qos(self._clash)
        self.reader = DataReader(
            link.participant, link.topic(self.name, beginning_of(kind)), quality(settings, latched), listener
        )

    def take(self, now: float) -> list[Any]:
        """The messages that came, oldest first, at most as many as the topic's depth.

        Args:
            now: By the steady clock [s].
        """
        return [message for data in self._admitted(now) if (message := self._read(data)) is not None]

    def newest(self, now: float, raw: bool = False) -> Any:
        """The newest message that came and is in order, or None; raw as bytes, for `decoded` in another thread."""
        came = reversed(self._admitted(now))
        return next((message for data in came if (message := data if raw else self._read(data)) is not None), None)

    @property
    def dropped(self) -> int:
        """How many were dropped for any reason."""
        return self.malformed + self.foreign + self.surplus + self.refused

    @property
    def publishers(self) -> int:
        """How many publishers are matched."""
        return len(self.reader.get_matched_publications())

    def refuse(self, why: str) -> None:
        """Count a message that is dropped for what it says."""
        self.refused, self.why = self.refused + 1, why

    def counted(self) -> list[str]:
        """What was dropped, a few words each."""
        counts = [f"{getattr(self, name)} {name}" for name in COUNTS if getattr(self, name)]
        return [f"{self.name}: {', '.join(counts)} messages dropped"] if counts else []

    def _admitted(self, now: float) -> list[bytes]:
        """What came from those who may speak; what comes without data tells that a publisher left."""
        found, admitted = ddspy_take(self.reader._ref, ALL, self.depth), []
        if isinstance(found, int):
            raise DDSException(found, f"while taking from {self.name}")
        for data, info in found:
            if not info.valid_data:
                self.heard.pop(info.publication_handle, None)
                continue
            self.received += 1
            if not self._may_speak(info.publication_handle, now):
                continue
            if len(data) > self.link.network.largest:
                self.malformed, self.why = self.malformed + 1, f"a message of {len(data):,} bytes"
            else:
                admitted.append(data)
        return admitted

    def _read(self, data: bytes) -> Any:
        """A message, or None where the bytes are none."""
        try:
            return decoded(data, self.kind)
        except Torn as error:
            self.malformed, self.why = self.malformed + 1, str(error)
            return None

    def _may_speak(self, source: int, now: float) -> bool:
        """Whether a publisher is a peer, and among those that came first."""
        if source not in self.heard:
            if source not in self.known and (address := self.link.address_of(self.reader, source)) is not None:
                self.known[source] = address in self.link.allowed
                self.why = self.why if self.known[source] else f"{address} is not among network.peers"
            if not self.known.get(source, False):
                self.foreign += 1
                return False
            self.heard = {one: last for one, last in self.heard.items() if now - last <= self.silence}
            if len(self.heard) >= self.most:
                self.surplus += 1
                self.why = f"more publishers than {self.most}"
                return False
        self.heard[source] = now
        return True

    def _clash(self, reader: DataReader[Any], status: Any) -> None:
        self.clashes += 1


class Outlet:
    """A topic that is sent on."""

    def __init__(self, link: Link, name: str, kind: type[Any], settings: Any, *, latched: bool = False) -> None:
        self.name, self.kind, self.clashes = link.resolved(name), kind, 0
        listener = Listener()
        listener.set_on_offered_incompatible_qos(self._clash)
        said = Policy.Userdata(f"typehash={type_hash(kind)};".encode())
        qos = Qos(said, base=quality(settings, latched))
        self.writer = DataWriter(link.participant, link.topic(self.name, kind), qos, listener)

    def send(self, message: Any) -> None:
        """Send a message; it waits nowhere."""
        data = message.serialize(use_version_2=False)
        ddspy_write(self.writer._ref, data.ljust((len(data) + 3) & ~3, b"\0"))

    @property
    def readers(self) -> int:
        """How many readers are matched."""
        return len(self.writer.get_matched_subscriptions())

    def _clash(self, writer: DataWriter[Any], status: Any) -> None:
        self.clashes += 1


class Link:
    """One participant of a ROS 2 graph.

    Args:
        network: Where it speaks.

    Attributes:
        allowed: Addresses that are listened to.

    Raises:
        ConfigError: No such interface or peer, or more settings that Cyclone DDS does not take.
    """

    def __init__(self, network: Network) -> None:
        self.network, self.topics = network, dict[str, DdsTopic[Any]]()
        addresses = [address_of(peer) for peer in network.peers]
        self.allowed = {*addresses, "localprocess"}
        try:
            self.domain = Domain(network.domain, configuration(network, addresses))
            self.participant = DomainParticipant(network.domain, Qos(Policy.Userdata(b"enclave=/;")))
        except DDSException as error:
            fix = f"see the interfaces of this machine, and network.config; '{network.interface}' is asked for"
            why = "Cyclone DDS says above what is wrong"
            raise ConfigError("no way into the network", why=why, fix=fix, key="network.interface") from error
        self.participants = BuiltinDataReader(self.participant, BuiltinTopicDcpsParticipant)

    def resolved(self, name: str) -> str:
        """A topic's full name."""
        return resolved(self.network, name)

    def topic(self, name: str, kind: type[Any], prefix: str = "rt") -> DdsTopic[Any]:
        """A topic by its name and the prefix of its kind."""
        full = f"{prefix}{name}"
        if full not in self.topics:
            self.topics[full] = DdsTopic(self.participant, full, kind)
        return self.topics[full]

    def address_of(self, reader: DataReader[Any], source: int) -> str | None:
        """Address of the participant to which a publisher belongs; None where discovery does not know it yet."""
        try:
            owner = reader.get_matched_publication_data(source).participant_key
        except (DDSException, AttributeError):
            return None
        for one in self.participants.read(1000):
            if getattr(one, "key", None) == owner:
                told = [policy.value for policy in one.qos if getattr(policy, "key", "") == "__NetworkAddresses"]
                return host_of(told[0]) if told else None
        return None

    def close(self) -> None:
        """Leave the graph."""
        del self.participants, self.participant, self.domain
        self.topics.clear()


def quality(settings: Any, latched: bool = False) -> Qos:
    """Quality of service as ROS 2 has it; what is latched is kept for those who come late."""
    reliable = settings.reliability == "reliable"
    return Qos(
        Policy.Reliability.Reliable(duration(milliseconds=1)) if reliable else Policy.Reliability.BestEffort,
        Policy.Durability.TransientLocal if latched else Policy.Durability.Volatile,
        Policy.History.KeepLast(settings.depth),
        Policy.DataRepresentation(use_cdrv0_representation=True),
    )


def configuration(network: Network, addresses: Iterable[str]) -> str:
    """Cyclone DDS's configuration."""
    kind = "address" if re.fullmatch(r"[\d.]+|.*:.*", network.interface) else "name"
    peers = "".join(f'<Peer Address="{escape(address)}"/>' for address in addresses)
    interface = f'{kind}="{escape(network.interface)}"'
    return XML.format(
        interface=interface, participants=network.participants, peers=peers, vendors=VENDORS, config=network.config
    )


def address_of(peer: str) -> str:
    """The address of a peer.

    Raises:
        ConfigError: Nobody knows it.
    """
    try:
        return socket.gethostbyname(peer)
    except (OSError, UnicodeError) as error:
        fix = "name hosts, or give addresses"
        raise ConfigError(f"no address of '{peer}'", why=str(error), fix=fix, key="network.peers") from error


def host_of(text: str) -> str:
    """The host in Cyclone's word for an address, `udp/192.0.2.2:7411@1`."""
    found = re.match(r"\w+/\[?([\w.:]+?)\]?:\d+", text)
    return found[1] if found else text
