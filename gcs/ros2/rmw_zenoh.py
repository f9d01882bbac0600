"""Keys, tokens and attachments of rmw_zenoh, the middleware by which nodes of ROS 2 use Zenoh.

As in rmw_zenoh_cpp since 0.2.4 (Jazzy) and 0.6.0 (Kilted), whose attachments have no names; Humble's keys have no
hashes of types, and are not supported. Described in its docs/design.md, `liveliness_utils.cpp` and
`attachment_helpers.cpp`.
"""

import re
import struct
from dataclasses import dataclass
from hashlib import sha256

from gcs.errors import InputError

NODE = "cordon"
GID_BYTES = 16
_ATTACHMENT = struct.Struct(f"<qqB{GID_BYTES}s")
_TOPIC = re.compile(r"[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*")
_QOS = "::,10:,:,:,,"
"""The default quality of service: reliable, volatile, the last ten messages."""


def topic_of(option: str, name: str) -> str:
    """Return the name of a topic without its leading slash; raises InputError that names the option."""
    topic = name.removeprefix("/")
    if not _TOPIC.fullmatch(topic):
        raise InputError([f"{option}: {name!r} is no topic of ROS such as /target/pose, of letters, digits and '_'"])
    return topic


def dds_type(kind: str) -> str:
    """Return a type such as geometry_msgs/msg/PoseStamped as it is in keys."""
    package, folder, name = kind.split("/")
    return f"{package}::{folder}::dds_::{name}_"


@dataclass(frozen=True, slots=True)
class RosEndpoint:
    """A publisher or subscription of a node: its topic (`target/pose`), type, the type's hash, and its domain."""

    domain: int
    topic: str
    kind: str
    type_hash: str

    @property
    def key(self) -> str:
        """The key of its messages."""
        return f"{self.domain}/{self.topic}/{dds_type(self.kind)}/{self.type_hash}"

    def token(self, session_id: str, number: int, role: str) -> str:
        """Return the key of the liveliness token by which ROS lists it; the role is MP of a publisher, else MS."""
        topic = f"%{self.topic.replace('/', '%')}"
        begin = f"@ros2_lv/{self.domain}/{session_id}/0/{number}/{role}/%/%/{NODE}"
        return f"{begin}/{topic}/{dds_type(self.kind)}/{self.type_hash}/{_QOS}"


def node_token(domain: int, session_id: str) -> str:
    """Return the key of the liveliness token of cordon's node."""
    return f"@ros2_lv/{domain}/{session_id}/0/0/NN/%/%/{NODE}"


def gid(token: str) -> bytes:
    """Return an identifier of a publisher, unique as its token is."""
    return sha256(token.encode()).digest()[:GID_BYTES]


def attachment(number: int, stamp_ns: int, publisher: bytes) -> bytes:
    """Return the attachment of a message, without which ROS drops it: its number, the time, and the publisher."""
    return _ATTACHMENT.pack(number, stamp_ns, GID_BYTES, publisher)
