"""An experiment on a real Slurm: `cargo build && python3 tests/tools/slurm.py`. Needs root.

Two nodes on this host, each with a host name of its own, compute twelve runs as a job array. Two jobs are requeued, one is stopped as
before its time limit, and one node is lost with everything on it. The record must be that of the same experiment without Slurm.
Ends with 0 if it is, and with 3 where Debian's packages or the rights cannot be had.
"""

import contextlib
import os
import pathlib
import re
import secrets
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator

from debian import UNREACHABLE, program
from runs import PROGRAM, free_port

ARCHITECTURE = f"{os.uname().machine}-linux-gnu"
# Programs and libraries that a small installation of Debian lacks, by package, each with one of its files.
PACKAGES = {
    "slurmctld": "usr/sbin/slurmctld-wlm",
    "slurmd": "usr/sbin/slurmd-wlm",
    "slurm-client": "usr/bin/sbatch",
    "slurm-wlm-basic-plugins": f"usr/lib/{ARCHITECTURE}/slurm-wlm/libslurmfull.so",
    "munge": "usr/sbin/munged",
    "libmunge2": f"usr/lib/{ARCHITECTURE}/libmunge.so.2",
    "libhwloc15": f"usr/lib/{ARCHITECTURE}/libhwloc.so.15",
    "libnuma1": f"usr/lib/{ARCHITECTURE}/libnuma.so.1",
}
NODES = ["node1", "node2"]
# Names the node of a daemon in its environment; Slurm itself does so for the processes of a job.
MARK = "S2MIA_TEST_NODE"
TIMEOUT_SECS = 300

SLURM_CONF = """
ClusterName=test
SlurmctldHost={host}(127.0.0.1)
SlurmctldPort={control}
SlurmUser=root
SlurmdUser=root
AuthType=auth/munge
# A requeued job waits until its credential expires.
AuthInfo=socket={folder}/munge/socket,cred_expire=5
CredType=cred/munge
PluginDir={plugins}
MpiDefault=none
SwitchType=switch/none
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
JobAcctGatherType=jobacct_gather/none
AccountingStorageType=accounting_storage/none
SelectType=select/cons_tres
SelectTypeParameters=CR_CPU
StateSaveLocation={folder}/state
SlurmdSpoolDir={folder}/spool-%n
SlurmctldPidFile={folder}/slurmctld.pid
SlurmdPidFile={folder}/slurmd-%n.pid
SlurmctldLogFile={folder}/slurmctld.log
SlurmdLogFile={folder}/slurmd-%n.log
SlurmdTimeout=6
KillWait=10
NodeName=node1 NodeHostname={host} NodeAddr=127.0.0.1 Port={first} CPUs=2 RealMemory=16000
NodeName=node2 NodeHostname={host} NodeAddr=127.0.0.1 Port={second} CPUs=2 RealMemory=16000
PartitionName=test Nodes=ALL Default=YES MaxTime=10 State=UP
"""

STUDY = """
folder = "runs"
record = "record.csv"
env_steps = 60_000
seeds = [0, 1, 2, 3, 4, 5]
tasks = ["cue-2x1"]
settings.checkpoint.every = 2

[[variants]]
algorithm = "happo"

[[variants]]
algorithm = "happo-s2mia"
"""


def not_run(why: str) -> None:
    print(f"slurm.py not run: {why}")
    raise SystemExit(UNREACHABLE)


def eventually(holds: Callable[[], bool], missing: str) -> None:
    deadline = time.monotonic() + TIMEOUT_SECS
    while not holds():
        if time.monotonic() > deadline:
            raise SystemExit(f"{missing} after {TIMEOUT_SECS} s")
        time.sleep(0.2)


class Slurm:
    """A cluster of two nodes in `folder`."""

    def __init__(self, folder: pathlib.Path) -> None:
        self.folder = folder
        found = {name: program(name, path) for name, path in PACKAGES.items()}
        libraries = {str(found[name].parent) for name in PACKAGES if "/lib" in PACKAGES[name]}
        self.programs = {name: str(found[name]) for name in ("slurmctld", "slurmd", "munge")}
        self.stepd = str(found["slurmd"].parent / "slurmstepd-wlm")
        path = f"{found['slurm-client'].parent}:{os.environ['PATH']}"
        self.environment = {
            **os.environ,
            "PATH": path,
            "LD_LIBRARY_PATH": ":".join(sorted(libraries)),
            "SLURM_CONF": str(folder / "slurm.conf"),
        }
        control, first, second = (free_port() for _ in range(3))
        plugins = found["slurm-wlm-basic-plugins"].parent
        host = os.uname().nodename
        values = {"host": host, "folder": folder, "plugins": plugins, "control": control, "first": first, "second": second}
        (folder / "slurm.conf").write_text(SLURM_CONF.format(**values))

    @contextlib.contextmanager
    def started(self) -> Iterator["Slurm"]:
        munge = self.folder / "munge"
        munge.mkdir(mode=0o755)
        (munge / "key").write_bytes(secrets.token_bytes(128))
        (munge / "key").chmod(0o400)
        files = [f"--{name}={munge / name.split('-')[0]}" for name in ("key-file", "socket", "pid-file", "log-file", "seed-file")]
        try:
            self.call(self.programs["munge"], "--force", *files, environment={MARK: "control"})
            self.call(self.programs["slurmctld"], environment={MARK: "control"})
            for node in NODES:
                slurmd = [self.programs["slurmd"], "-N", node, "-d", self.stepd]
                own_name = ["unshare", "--uts", "sh", "-c", 'hostname "$0" && exec "$@"', node]
                self.call(*own_name, *slurmd, environment={MARK: node})
            eventually(lambda: self.call("sinfo", "-h", "-t", "idle", "-o", "%D").strip() == "2", "two idle nodes")
            yield self
        finally:
            for node in (*NODES, "control"):
                self.lose(node)

    def call(self, *command: str, environment: dict[str, str] | None = None, cwd: pathlib.Path | None = None) -> str:
        whole = {**self.environment, **(environment or {})}
        # A daemon must not keep a pipe of this process open.
        with tempfile.TemporaryFile("w+") as output:
            done = subprocess.run(command, env=whole, cwd=cwd, stdin=subprocess.DEVNULL, stdout=output, stderr=output)
            output.seek(0)
            text = output.read()
        if done.returncode != 0:
            raise SystemExit(f"{command} ended with {done.returncode}: {text}")
        return text

    def lose(self, node: str) -> None:
        """Kills everything on a node; first the daemons, which would report the end of the others."""
        conf = f"SLURM_CONF={self.folder / 'slurm.conf'}"
        for mark in (f"{MARK}={node}", f"SLURMD_NODENAME={node}"):
            for process in pathlib.Path("/proc").glob("[0-9]*"):
                with contextlib.suppress(OSError):
                    if {mark, conf} <= set((process / "environ").read_text(errors="replace").split("\0")):
                        os.kill(int(process.name), signal.SIGKILL)

    def job(self, job: str) -> dict[str, str]:
        return dict(re.findall(r"(\w+)=(\S*)", self.call("scontrol", "show", "job", "--oneliner", job)))


def run_of(index: int, study: pathlib.Path) -> pathlib.Path:
    """The folder of the run with this index: the variants take turns."""
    variant = ("happo", "happo-s2mia")[index % 2]
    return study / "runs" / f"cue-2x1-{variant}-seed{index // 2}"


def disturbed(slurm: Slurm, study: pathlib.Path) -> list[str]:
    """Submits the experiment and disturbs four of its jobs or more; returns their ids."""
    told = slurm.call(PROGRAM, "experiment", "study.toml", "--submit", "slurm", "--time", "5", cwd=study)
    array = told.split()[-1]
    computes = lambda index: (run_of(index, study) / "metrics.jsonl").exists()
    # The first is what Slurm sends before the time limit.
    for index, order in enumerate([("scancel", "--batch", "--signal=TERM"), ("scontrol", "requeue"), ("scontrol", "requeue")]):
        eventually(lambda: computes(index), f"run {index}")
        slurm.call(*order, f"{array}_{index}")
    lost: list[str] = []

    def is_on_the_second_node() -> bool:
        running = [line.split() for line in slurm.call("squeue", "-h", "-r", "-t", "R", "-o", "%K %N").splitlines()]
        on_node = [index for index, node in running if node == "node2"]
        lost[:] = [index for index in on_node if int(index) > 2 and computes(int(index))]
        return bool(lost)

    eventually(is_on_the_second_node, "a run on node2")
    slurm.lose("node2")
    print(f"two jobs were requeued, one was stopped, and node2 was lost with {', '.join(lost)}")
    return [f"{array}_{index}" for index in ("0", "1", "2", *lost)]


def demand_restarts(slurm: Slurm, study: pathlib.Path, disturbed: list[str]) -> None:
    """Waits for the end of the array and checks that each of these jobs started again."""
    eventually(lambda: not slurm.call("squeue", "-h").strip(), "the end of all jobs")
    restarts = {job: int(slurm.job(job)["Restarts"]) for job in disturbed}
    if min(restarts.values()) < 1:
        raise SystemExit(f"restarts of the disturbed jobs: {restarts}")
    log = next((study / "runs").glob("slurm-*_0.log")).read_text()
    if "stopped with 0 of 1 runs finished" not in log:
        raise SystemExit(f"the run before its time limit was not stopped:\n{log}")


def record(study: pathlib.Path) -> str:
    subprocess.run([PROGRAM, "experiment", "study.toml", "--report"], cwd=study, check=True, stdout=subprocess.DEVNULL)
    return (study / "record.csv").read_text()


def main() -> None:
    if os.geteuid() != 0:
        not_run("needs root")
    if subprocess.run(["unshare", "--uts", "hostname", "node1"], capture_output=True).returncode != 0:
        not_run("unshare --uts cannot set a host name here")
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as name:
        folder = pathlib.Path(name)
        folder.chmod(0o755)
        # A path that a shell would split.
        local, cluster = folder / "local", folder / "it's a cluster"
        for study in (local, cluster):
            study.mkdir()
            (study / "study.toml").write_text(STUDY)
        with Slurm(folder).started() as slurm:
            jobs = disturbed(slurm, cluster)
            subprocess.run([PROGRAM, "experiment", "study.toml"], cwd=local, check=True, stdout=subprocess.DEVNULL)
            demand_restarts(slurm, cluster, jobs)
        if record(cluster) != record(local):
            raise SystemExit("runs on Slurm differ from local runs")
    print("12 runs on two nodes of Slurm have the results and hashes of local runs")


if __name__ == "__main__":
    sys.exit(main())
