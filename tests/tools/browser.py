"""A headless Chromium, spoken to over its two pipes by the DevTools protocol."""

import base64
import contextlib
import json
import os
import pathlib
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator

NAMES = ["chromium", "chromium-browser", "google-chrome", "chromium-headless-shell"]
TIMEOUT_SECS = 60
# How a test ends on a machine without a browser.
MISSING = 3


class Tab:
    """A page that is open."""

    def __init__(self, to: int, back: int) -> None:
        self.to, self.back = os.fdopen(to, "wb"), os.fdopen(back, "rb")
        self.asked, self.unread = 0, b""
        self.session: str | None = None
        self.complaints: list[str] = []

    def show(self, url: str) -> None:
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        self.session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Runtime", "Log", "Page"):
            self.call(f"{domain}.enable")
        self.call("Page.navigate", url=url)
        self.wait_until("location.href !== 'about:blank' && document.readyState === 'complete'")

    def call(self, method: str, **parameters) -> dict:
        """What the browser answers; what the page complains about in between is kept."""
        self.asked += 1
        message = {"id": self.asked, "method": method, "params": parameters}
        if self.session:
            message["sessionId"] = self.session
        self.to.write(json.dumps(message).encode() + b"\0")
        self.to.flush()
        while (answer := self.read()).get("id") != self.asked:
            self.listen(answer)
        if "error" in answer:
            raise RuntimeError(f"{method}: {answer['error']}")
        return answer["result"]

    def read(self) -> dict:
        while b"\0" not in self.unread:
            self.unread += os.read(self.back.fileno(), 1 << 20)
        message, self.unread = self.unread.split(b"\0", 1)
        return json.loads(message)

    def listen(self, event: dict) -> None:
        if event.get("method") == "Runtime.exceptionThrown":
            self.complaints.append(json.dumps(event["params"]["exceptionDetails"]))
        if event.get("method") == "Log.entryAdded" and event["params"]["entry"]["source"] == "security":
            self.complaints.append(event["params"]["entry"]["text"])

    def evaluate(self, expression: str):
        answer = self.call("Runtime.evaluate", expression=expression, returnByValue=True)
        if "exceptionDetails" in answer:
            raise RuntimeError(f"{expression}: {answer['exceptionDetails']}")
        return answer["result"].get("value")

    def wait_until(self, expression: str) -> None:
        deadline = time.monotonic() + TIMEOUT_SECS
        while not self.evaluate(expression):
            if time.monotonic() > deadline:
                raise SystemExit(f"not true after {TIMEOUT_SECS} s: {expression}")
            time.sleep(0.2)

    def press(self, key: str) -> None:
        """A key that types a character, such as the space bar, into what has the focus."""
        for kind in ("keyDown", "keyUp"):
            self.call("Input.dispatchKeyEvent", type=kind, key=key, text=key, windowsVirtualKeyCode=ord(key))

    def screenshot(self, file: pathlib.Path) -> None:
        file.write_bytes(base64.b64decode(self.call("Page.captureScreenshot")["data"]))

    def look(self, scheme: str, width: int, height: int) -> None:
        """Chooses the size of the window, and between light and dark."""
        self.call("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": scheme}])
        metrics = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
        self.call("Emulation.setDeviceMetricsOverride", **metrics)


@contextlib.contextmanager
def tab() -> Iterator[Tab]:
    """A browser with one page, for as long as it is needed; without any browser, one line says so and all ends with 3."""
    program = next((found for name in NAMES if (found := shutil.which(name))), None)
    if program is None:
        print(f"{pathlib.Path(sys.argv[0]).name} not run: none of {', '.join(NAMES)} is installed")
        raise SystemExit(MISSING)
    their_in, our_out = os.pipe()
    our_in, their_out = os.pipe()

    def take_pipes() -> None:
        # The protocol wants its pipes at 3 and 4; copies first, so that neither is overwritten.
        end_in, end_out = os.dup(their_in), os.dup(their_out)
        os.dup2(end_in, 3)
        os.dup2(end_out, 4)

    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        options = ["--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", "--remote-debugging-pipe"]
        process = subprocess.Popen(
            [program, *options, f"--user-data-dir={profile}"],
            stderr=subprocess.DEVNULL, close_fds=False, preexec_fn=take_pipes,
        )
        os.close(their_in)
        os.close(their_out)
        try:
            yield Tab(our_out, our_in)
        finally:
            process.kill()
            process.wait()
