"""Two hosts on one machine: two network namespaces, and between them a link that delays, loses and reorders packets.

Each namespace has a TUN device; its other end is a file here, so the packets pass through this process. This needs no traffic control in
the kernel, and a lost packet is drawn from a seed. Needs Linux, iproute2, and the right to make network namespaces.
"""

import contextlib
import ctypes
import fcntl
import heapq
import itertools
import os
import random
import select
import shutil
import struct
import subprocess
import threading
import time

# Of linux/if_tun.h: set up a device; IP packets; nothing before each packet.
TUNSETIFF, IFF_TUN, IFF_NO_PI = 0x400454CA, 0x0001, 0x1000
# Of linux/sched.h.
CLONE_NEWNET = 0x40000000
LARGEST_PACKET = 65_536
# A queue of this many packets is full, as that of a router: further ones are lost.
MOST_WAITING = 4096
ADDRESSES = {"near": "10.213.0.1", "far": "10.213.0.2"}


class NoNamespaces(Exception):
    """This machine, or this user, cannot have network namespaces."""


def command(*words: str) -> None:
    ended = subprocess.run(words, capture_output=True, text=True)
    if ended.returncode:
        raise NoNamespaces(f"`{' '.join(words)}` says: {ended.stderr.strip()}")


class Link:
    """The hosts `near` and `far`. Packets are undisturbed until a method changes that."""

    def __init__(self, seed: int) -> None:
        self.random = random.Random(seed)
        self.names = {host: f"s2mia-{os.getpid()}-{host}" for host in ADDRESSES}
        self.devices = {host: f"s2mia{os.getpid()}{host[0]}" for host in ADDRESSES}
        self.files: dict[str, int] = {}
        self.heal()
        self.lost = 0
        try:
            self.make()
        except (OSError, NoNamespaces) as error:
            self.close()
            raise NoNamespaces(str(error)) from error
        threading.Thread(target=self.pass_on, daemon=True).start()

    def make(self) -> None:
        if shutil.which("ip") is None:
            raise NoNamespaces("there is no `ip` here (Debian: iproute2)")
        for host, name in self.names.items():
            device = self.devices[host]
            self.files[host] = os.open("/dev/net/tun", os.O_RDWR | os.O_CLOEXEC | os.O_NONBLOCK)
            fcntl.ioctl(self.files[host], TUNSETIFF, struct.pack("16sH", device.encode(), IFF_TUN | IFF_NO_PI))
            command("ip", "netns", "add", name)
            command("ip", "link", "set", device, "netns", name)
            command("ip", "-n", name, "address", "add", f"{ADDRESSES[host]}/30", "dev", device)
            command("ip", "-n", name, "link", "set", device, "up")
            command("ip", "-n", name, "link", "set", "lo", "up")

    def on(self, host: str) -> list[str]:
        """What comes before a command that is to run on a host."""
        return ["ip", "netns", "exec", self.names[host]]

    def enter(self, host: str) -> None:
        """Moves this thread to a host; the threads and processes that it starts later are there, too."""
        with open(f"/run/netns/{self.names[host]}") as namespace:
            if ctypes.CDLL(None, use_errno=True).setns(namespace.fileno(), CLONE_NEWNET):
                raise OSError(ctypes.get_errno(), "setns")

    def heal(self) -> None:
        """Passes every packet on at once."""
        self.disturb()

    def disturb(self, delay: float = 0.0, jitter: float = 0.0, loss: float = 0.0, cut: tuple = ()) -> None:
        """Delays each packet by `delay` and up to `jitter` more seconds, which changes their order; loses a share; loses all that come
        from the hosts in `cut`."""
        self.delay, self.jitter, self.loss, self.cut = delay, jitter, loss, frozenset(cut)

    def pass_on(self) -> None:
        """Passes packets on, each when it is due, until the files are closed."""
        due: list[tuple] = []
        order = itertools.count()
        other = {self.files["near"]: "far", self.files["far"]: "near"}
        sender = {file: host for host, file in self.files.items()}
        with contextlib.suppress(OSError, ValueError):
            while True:
                wait = max(0.0, due[0][0] - time.monotonic()) if due else 0.5
                for file in select.select(list(other), [], [], wait)[0]:
                    packet = os.read(file, LARGEST_PACKET)
                    if sender[file] in self.cut or self.random.random() < self.loss or len(due) >= MOST_WAITING:
                        self.lost += 1
                        continue
                    when = time.monotonic() + self.delay + self.random.random() * self.jitter
                    heapq.heappush(due, (when, next(order), self.files[other[file]], packet))
                while due and due[0][0] <= time.monotonic():
                    _, _, file, packet = heapq.heappop(due)
                    # A device whose queue is full loses the packet.
                    with contextlib.suppress(BlockingIOError):
                        os.write(file, packet)

    def close(self) -> None:
        """Removes both hosts; their processes must have ended."""
        for name in self.names.values():
            subprocess.run(["ip", "netns", "delete", name], capture_output=True)
        files, self.files = self.files, {}
        for file in files.values():
            os.close(file)
