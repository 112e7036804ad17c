"""The Kubernetes manifests, and what the overlays make of them, against the official schemas; no cluster is needed."""

import re
from pathlib import Path

import jsonpatch
import kubernetes_validate
import pytest
import yaml
from conftest import s2mia
from kustomize import documents, patched, rendered

ROOT = Path(__file__).resolve().parents[2]
K8S = ROOT / "deploy" / "k8s"
KUSTOMIZATIONS = sorted(path.parent for path in K8S.rglob("kustomization.yaml"))
MANIFESTS = sorted(path for path in K8S.rglob("*.yaml") if path.name != "kustomization.yaml")
VERSION = "1.37"


def of_kind(found, kind):
    """Specifications by name."""
    return {one["metadata"]["name"]: one["spec"] for one in found if one["kind"] == kind}


def pods(found):
    """Pod specifications of everything that makes pods."""
    return [job["template"]["spec"] for job in of_kind(found, "Job").values()]


def name(path):
    return path.name


@pytest.mark.parametrize("path", [*MANIFESTS, *KUSTOMIZATIONS], ids=name)
def test_a_manifest_holds_what_its_schema_allows_and_nothing_else(path):
    for document in documents(path):
        kubernetes_validate.validate(document, VERSION, strict=True)


def test_a_misspelt_field_would_be_found():
    (job,) = documents(K8S / "base/actor.yaml")
    job["spec"]["parallel"] = 2
    with pytest.raises(kubernetes_validate.ValidationError):
        kubernetes_validate.validate(job, VERSION, strict=True)


def test_a_patch_of_what_is_not_there_would_be_found():
    learner = {"kind": "Job", "name": "learner"}
    with pytest.raises(jsonpatch.JsonPatchConflict):
        patched(rendered(K8S / "base"), learner, [{"op": "replace", "path": "/spec/parallel", "value": 1}])
    with pytest.raises(AssertionError):
        patched(rendered(K8S / "base"), {"kind": "Job", "name": "teacher"}, [])


def test_every_pod_runs_without_privileges_on_a_read_only_root():
    found = [*pods(documents(K8S / "seeds.yaml")), *(pod for folder in KUSTOMIZATIONS for pod in pods(rendered(folder)))]
    assert len(found) == 1 + 2 * len(KUSTOMIZATIONS)
    for pod in found:
        assert pod["securityContext"]["runAsNonRoot"] and not pod["automountServiceAccountToken"]
        for container in pod["containers"]:
            context = container["securityContext"]
            assert context["readOnlyRootFilesystem"] and not context["allowPrivilegeEscalation"]
            assert context["capabilities"] == {"drop": ["ALL"]}


@pytest.mark.parametrize("path", [K8S / "seeds.yaml", *KUSTOMIZATIONS], ids=name)
def test_pods_end_with_their_run_and_are_replaced_if_they_fail_or_move(path):
    found = documents(path)
    assert not {one["kind"] for one in found} & {"Deployment", "StatefulSet", "DaemonSet", "ReplicaSet", "Pod", "CronJob"}
    for job in of_kind(found, "Job").values():
        pod = job["template"]["spec"]
        (container,) = pod["containers"]
        assert "s2mia-job" in " ".join([*container["command"], *container.get("args", [])])
        assert pod["restartPolicy"] == "Never" and job["podReplacementPolicy"] == "Failed" and job["backoffLimit"]
        fail, ignore = job["podFailurePolicy"]["rules"]
        assert fail["action"] == "FailJob" and fail["onExitCodes"]["containerName"] == container["name"]
        assert ignore == {"action": "Ignore", "onPodConditions": [{"type": "DisruptionTarget", "status": "True"}]}


EXPERIMENT = """ # A file whose first line begins with a space: "quotes", 'quotes' and $(variables).
env_steps = 1_000_000
seeds = [0, 1]
tasks = ["ant-4x2", "walker2d-2x3"]
threads = 4

[[variants]]
algorithm = "happo"
"""


@pytest.mark.parametrize("options", [[], ["--queue=robots", "--array-limit=2", "--runs-per-job=3", "--image=registry:5000/s2mia:1"]])
def test_an_experiment_becomes_a_valid_job_whose_pods_are_its_shards(tmp_path, options):
    (tmp_path / "Study_1.toml").write_text(EXPERIMENT)
    found = list(yaml.safe_load_all(s2mia("experiment", tmp_path / "Study_1.toml", "--submit", "k8s", *options)))
    for document in found:
        kubernetes_validate.validate(document, VERSION, strict=True)
    configuration, claim, job = found
    assert {one["metadata"]["name"] for one in found} == {"s2mia-study-1"}
    assert configuration["data"] == {"Study_1.toml": EXPERIMENT}
    assert claim["kind"] == "PersistentVolumeClaim" and claim["spec"]["accessModes"] == ["ReadWriteMany"]
    shards = 2 if options else 4
    specification = job["spec"]
    assert specification["completionMode"] == "Indexed" and specification["backoffLimitPerIndex"]
    assert (specification["completions"], specification["parallelism"]) == (shards, 2 if options else 4)
    labels = job["metadata"].get("labels", {})
    assert labels == ({"kueue.x-k8s.io/queue-name": "robots"} if options else {})
    (pod,) = pods(found)
    (container,) = pod["containers"]
    assert container["image"] == ("registry:5000/s2mia:1" if options else "s2mia")
    assert container["command"][:3] == ["s2mia-job", "experiment", "/experiment/Study_1.toml"]
    assert container["command"][-2:] == ["--shard", f"$(JOB_COMPLETION_INDEX)/{shards}"]
    # The paths in the file are relative to its folder, which is the volume.
    assert container["workingDir"] == "/experiment"
    mounts = {one["mountPath"]: one["name"] for one in container["volumeMounts"]}
    assert mounts == {"/experiment": "runs", "/experiment/Study_1.toml": "experiment"}
    assert container["resources"]["requests"]["cpu"] == "4"
    context = container["securityContext"]
    assert pod["securityContext"]["runAsNonRoot"] and context["readOnlyRootFilesystem"] and context["capabilities"] == {"drop": ["ALL"]}


def test_prometheus_may_read_the_metrics_of_the_base_and_nothing_else():
    found = documents(K8S / "base")
    (job,) = yaml.safe_load((ROOT / "deploy" / "prometheus" / "kubernetes.yml").read_text())["scrape_configs"]
    host, port = job["static_configs"][0]["targets"][0].split(":")
    arguments = of_kind(found, "Job")["learner"]["template"]["spec"]["containers"][0]["args"]
    assert {f"--page=0.0.0.0:{port}", f"--page-host={host}"} <= set(arguments)
    service = of_kind(found, "Service")["learner"]
    assert host == "learner.s2mia.svc" and int(port) in [one["port"] for one in service["ports"]]
    admitted = {rule["ports"][0]["port"]: rule["from"] for rule in of_kind(found, "NetworkPolicy")["learner"]["ingress"]}
    assert admitted.keys() == {50051, int(port)}
    (prometheus,) = admitted[int(port)]
    assert prometheus["podSelector"]["matchLabels"] == {"app.kubernetes.io/name": "prometheus"}
    assert prometheus["namespaceSelector"]["matchLabels"] == {"kubernetes.io/metadata.name": "monitoring"}


def test_kustomizations_name_files_that_exist():
    for folder in KUSTOMIZATIONS:
        for resource in yaml.safe_load((folder / "kustomization.yaml").read_text())["resources"]:
            assert (folder / resource).exists(), f"{folder}: {resource}"


def test_settings_are_ones_that_the_program_knows():
    lines = (K8S / "base/settings.env").read_text().splitlines()
    names = [re.match(r"S2MIA__([A-Z_]+)=", line).group(1) for line in lines]
    base = (ROOT / "configs" / "base.toml").read_text()
    for name in names:
        key = name.lower().split("__")[-1]
        assert key in ("task", "algorithm") or re.search(rf"^{key} ?=", base, re.MULTILINE), name
