"""Which connections a listening socket of this process takes, decided by the kernel: on Linux only.

A port of this computer is open to all its users. Where only this process is to connect, the kernel drops the packets
of all others before the listener, which may be a library's, knows of them.
"""

import ctypes
import os
import socket
import struct
import sys
from collections.abc import Collection
from contextlib import suppress
from pathlib import Path

LOOPBACK = "127.0.0.1"

_SO_ATTACH_FILTER = 26
"""Of asm-generic/socket.h; Python does not name it."""
_LOAD_WORD, _LOAD_HALF, _IF_EQUAL, _RETURN = 0x20, 0x28, 0x15, 0x06
"""Instructions of the classic Berkeley Packet Filter (linux/bpf_common.h)."""
_IP_SOURCE, _TCP_SOURCE = 0xFFF00000 + 12, 0
"""Where a packet holds them: from the beginning of its IP header, and of its TCP header (linux/filter.h)."""
_DROP, _WHOLE = 0, 0xFFFFFFFF


def listener_at(port: int) -> socket.socket | None:
    """Return the socket of this process that listens at a port of the loopback address; None where none is found.

    It shares the listener's connections, and has to be closed with it.
    """
    if sys.platform != "linux":
        return None
    for path in Path("/proc/self/fd").iterdir():
        with suppress(OSError):  # closed meanwhile
            if not path.is_socket():
                continue
            found = socket.socket(fileno=os.dup(int(path.name)))
            if found.getsockname() == (LOOPBACK, port) and found.getsockopt(socket.SOL_SOCKET, socket.SO_ACCEPTCONN):
                return found
            found.close()
    return None


def admit(listener: socket.socket, ports: Collection[int]) -> None:
    """Let a listener take connections from these ports of the loopback address only.

    Who has bound them in this process keeps other users from them. Raises OSError.
    """
    own = int.from_bytes(socket.inet_aton(LOOPBACK))
    steps = [
        (_LOAD_WORD, 0, 0, _IP_SOURCE),
        (_IF_EQUAL, 1, 0, own),
        (_RETURN, 0, 0, _DROP),
        (_LOAD_HALF, 0, 0, _TCP_SOURCE),
    ]
    for port in ports:
        steps += [(_IF_EQUAL, 0, 1, port), (_RETURN, 0, 0, _WHOLE)]
    steps.append((_RETURN, 0, 0, _DROP))
    program = ctypes.create_string_buffer(b"".join(struct.pack("HBBI", *step) for step in steps))
    listener.setsockopt(socket.SOL_SOCKET, _SO_ATTACH_FILTER, struct.pack("HP", len(steps), ctypes.addressof(program)))
