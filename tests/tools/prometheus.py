"""A real Prometheus watches a real run: `cargo build && python3 tests/tools/prometheus.py`.

promtool checks the configuration, the alerts with their own tests, and what the learner shows. Then Prometheus reads a run, and
every figure that an alert asks for must be there. Ends with 0 if all of it holds, and with 3 where no Debian package
can be had.
"""

import contextlib
import json
import pathlib
import re
import shutil
import subprocess
import tempfile
import urllib.parse
import urllib.request
from collections.abc import Iterator

from debian import ROOT, program
from runs import eventually, free_port, training

DEPLOY = ROOT / "deploy" / "prometheus"
# It is not shown before there is a refusal.
NOT_BEFORE_THE_FIRST = {"s2mia_messages_refused_total"}


def get(url: str) -> str:
    with urllib.request.urlopen(url, timeout=5) as answer:
        return answer.read().decode()


def promtool(*arguments: str, given: str | None = None) -> None:
    tool = program("prometheus", "usr/bin/promtool")
    subprocess.run([tool, *arguments], cwd=DEPLOY, input=given, text=True, check=True)


class Prometheus:
    """A server that reads the learner at `page` by the deployed configuration and alerts."""

    def __init__(self, folder: pathlib.Path, page: str) -> None:
        text = (DEPLOY / "prometheus.yml").read_text()
        (folder / "prometheus.yml").write_text(text.replace("learner:50080", page).replace("5s", "1s"))
        shutil.copy(DEPLOY / "alerts.yml", folder)
        self.url = f"http://127.0.0.1:{free_port()}"
        self.command = [
            program("prometheus", "usr/bin/prometheus"),
            f"--config.file={folder / 'prometheus.yml'}",
            f"--storage.tsdb.path={folder / 'series'}",
            f"--web.listen-address={self.url.removeprefix('http://')}",
            "--log.level=warn",
        ]

    @contextlib.contextmanager
    def started(self) -> Iterator["Prometheus"]:
        with subprocess.Popen(self.command) as process:
            try:
                yield self
            finally:
                process.kill()

    def value(self, query: str) -> float | None:
        answer = json.loads(get(f"{self.url}/api/v1/query?" + urllib.parse.urlencode({"query": query})))
        results = answer["data"]["result"]
        return float(results[0]["value"][1]) if results else None

    def names(self) -> set[str]:
        return set(json.loads(get(f"{self.url}/api/v1/label/__name__/values"))["data"])

    def rules(self) -> list[dict]:
        groups = json.loads(get(f"{self.url}/api/v1/rules"))["data"]["groups"]
        return [rule for group in groups for rule in group["rules"]]


def asked_for() -> set[str]:
    """Every figure that an alert names."""
    text = (DEPLOY / "alerts.yml").read_text()
    return set(re.findall(r"\b(?:s2mia|process)_[a-z_]+", text)) - NOT_BEFORE_THE_FIRST


def watch(folder: pathlib.Path) -> None:
    page = f"127.0.0.1:{free_port()}"
    metrics = f"http://{page}/metrics"
    server = Prometheus(folder, page)
    with training(folder / "run", page), server.started():
        eventually(lambda: "s2mia_checkpoint_seconds" in get(metrics), "no checkpoint")
        promtool("check", "metrics", given=in_the_older_form(get(metrics)))
        eventually(lambda: (server.value("s2mia_iteration") or 0) > 2, "Prometheus saw no iteration")
        eventually(lambda: asked_for() <= server.names(), f"{asked_for() - server.names()} missing")
        eventually(lambda: (server.value("rate(s2mia_env_steps_total[10s])") or 0) > 0, "no steps")
        broken = [rule for rule in server.rules() if rule["health"] == "err" or rule["alerts"]]
        if broken or server.value("up") != 1:
            raise SystemExit(f"a run that goes well is not seen as one: {broken}")


def in_the_older_form(scrape: str) -> str:
    """promtool reads the text format before OpenMetrics, in which a counter bears its ending in its description, too."""
    counters = re.findall(r"^# TYPE (\w+) counter$", scrape, flags=re.MULTILINE)
    for name in counters:
        scrape = re.sub(rf"^# (HELP|TYPE) {name} ", rf"# \1 {name}_total ", scrape, flags=re.MULTILINE)
    return scrape.replace("# EOF\n", "")


def main() -> None:
    promtool("check", "config", "prometheus.yml", "kubernetes.yml")
    # Its certificates are in the cluster only.
    promtool("check", "config", "--syntax-only", "kubernetes.mtls.yml")
    promtool("test", "rules", "alerts_test.yml")
    with tempfile.TemporaryDirectory() as folder:
        watch(pathlib.Path(folder))
    print("Prometheus reads a run, knows every figure that is asked for, and raises no alert")


if __name__ == "__main__":
    main()
