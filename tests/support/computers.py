"""Several emulated computers on one network: network namespaces connected by a bridge."""

import os
import subprocess
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass

import pytest


@dataclass(frozen=True)
class Computer:
    """A network namespace with an address of its own."""

    namespace: str
    address: str

    def command(self, *arguments: str) -> list[str]:
        """Return a command line that runs there."""
        return ["ip", "netns", "exec", self.namespace, *arguments]


@contextmanager
def computers(count: int) -> Iterator[list[Computer]]:
    """Set up connected computers; skip the test if this is not permitted."""
    prefix = f"cd{os.getpid() % 100_000}"
    with ExitStack() as stack:
        switch = namespace(f"{prefix}s", stack)
        ip("-n", switch, "link", "add", "bridge", "type", "bridge")
        ip("-n", switch, "link", "set", "bridge", "up")
        made = []
        for k in range(1, count + 1):
            name, address = namespace(f"{prefix}c{k}", stack), f"10.77.0.{k}"
            ip("-n", name, "link", "add", "net", "type", "veth", "peer", "name", f"port{k}", "netns", switch)
            ip("-n", switch, "link", "set", f"port{k}", "master", "bridge", "up")
            ip("-n", name, "address", "add", f"{address}/24", "dev", "net")
            ip("-n", name, "link", "set", "net", "up")
            made.append(Computer(name, address))
        yield made


def namespace(name: str, stack: ExitStack) -> str:
    try:
        ip("netns", "add", name)
        stack.callback(ip, "netns", "delete", name)
        ip("-n", name, "link", "set", "lo", "up")
    except (OSError, subprocess.CalledProcessError) as error:
        pytest.skip(f"network namespaces are not permitted here: {getattr(error, 'stderr', '') or error}")
    return name


def ip(*arguments: str) -> None:
    subprocess.run(["ip", *arguments], check=True, capture_output=True, text=True)
