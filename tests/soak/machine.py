"""What the soak needs of the machine: a learner that can be started again, a proxy, and what /proc says."""

import contextlib
import json
import os
import pathlib
import socket
import subprocess
import threading
import time

MOST_HELD_OPEN = 16


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        return listener.getsockname()[1]


def resident_kib(pid: int) -> int:
    status = pathlib.Path(f"/proc/{pid}/status").read_text()
    return int(next(line.split()[1] for line in status.splitlines() if line.startswith("VmRSS")))


def file_count(pid: int) -> int:
    return len(os.listdir(f"/proc/{pid}/fd"))


def slope_per_minute(samples: list[tuple[float, float]]) -> float:
    """Least squares through (seconds, value)."""
    count = len(samples)
    times, values = zip(*samples)
    middle, mean = sum(times) / count, sum(values) / count
    spread = sum((when - middle) ** 2 for when in times)
    return 60 * sum((when - middle) * (value - mean) for when, value in samples) / spread


class Learner:
    """A learner on one port and one run folder, through all its lives."""

    def __init__(self, program: str, settings: list[str], folder: pathlib.Path, port: int, host: str) -> None:
        self.port, self.run = port, folder / "run"
        self.log = open(folder / "learner.log", "w")
        listen = ["--listen", f"{host}:{port}", *([] if host == "127.0.0.1" else ["--insecure-allow-remote"])]
        self.command = [program, "learner", *listen, *settings, f"run.dir={self.run}"]
        self.held: list[socket.socket] = []
        self.start()

    def start(self, fail_at: str = "") -> None:
        """Starts it; it fails at this point, if one is given."""
        self.started = time.monotonic()
        environment = {**os.environ, "S2MIA_FAIL_AT": fail_at}
        self.process = subprocess.Popen(self.command, env=environment, stdout=self.log, stderr=self.log)

    def finished(self) -> bool:
        """Whether it came to the run's last iteration."""
        return self.process.poll() == 0 and "finished after" in self.last_words()

    def last_words(self) -> str:
        lines = pathlib.Path(self.log.name).read_text(errors="replace").splitlines()
        return lines[-1] if lines else ""

    def up_secs(self) -> float:
        return time.monotonic() - self.started

    def iteration(self) -> int:
        """Finished iterations, as the last whole line of the metrics says."""
        with contextlib.suppress(OSError, IndexError, ValueError), open(self.run / "metrics.jsonl", "rb") as file:
            file.seek(max(0, os.fstat(file.fileno()).st_size - 16_384))
            return json.loads(file.read().splitlines()[-1])["iteration"]
        return 0

    def hold_open(self, greeting: bytes) -> None:
        """A peer that says this and no more; the oldest of many goes."""
        with contextlib.suppress(OSError):
            peer = socket.create_connection(("127.0.0.1", self.port))
            peer.sendall(greeting)
            self.held.append(peer)
        for old in self.held[:-MOST_HELD_OPEN]:
            old.close()
        del self.held[:-MOST_HELD_OPEN]


class Proxy:
    """Passes bytes on between actors and the learner, until told otherwise."""

    def __init__(self, target: int) -> None:
        self.target = target
        self.stalled_until = 0.0
        self.pairs: list[tuple[socket.socket, socket.socket]] = []
        self.listener = socket.create_server(("127.0.0.1", 0))
        self.port = self.listener.getsockname()[1]
        threading.Thread(target=self._accept, daemon=True).start()

    def cut(self) -> None:
        """Closes every connection at once."""
        pairs, self.pairs = self.pairs, []
        for pair in pairs:
            for end in pair:
                with contextlib.suppress(OSError):
                    end.shutdown(socket.SHUT_RDWR)

    def stall(self, secs: float) -> None:
        """Passes nothing on for a while."""
        self.stalled_until = time.monotonic() + secs

    def close(self) -> None:
        self.listener.close()
        self.cut()

    def _accept(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                near, _ = self.listener.accept()
                try:
                    far = socket.create_connection(("127.0.0.1", self.target))
                except OSError:
                    near.close()
                    continue
                self.pairs.append((near, far))
                for ends in ((near, far), (far, near)):
                    threading.Thread(target=self._pass_on, args=ends, daemon=True).start()

    def _pass_on(self, source: socket.socket, sink: socket.socket) -> None:
        with contextlib.suppress(OSError):
            while data := source.recv(65_536):
                time.sleep(max(0.0, self.stalled_until - time.monotonic()))
                sink.sendall(data)
        for end in (source, sink):
            with contextlib.suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)
            end.close()
