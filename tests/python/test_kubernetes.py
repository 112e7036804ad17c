"""The Kubernetes manifests, and what the overlays make of them, against the official schemas; no cluster is needed."""

import re
from pathlib import Path

import jsonpatch
import kubernetes_validate
import pytest
import yaml
from kustomize import documents, patched, rendered

ROOT = Path(__file__).resolve().parents[2]
K8S = ROOT / "deploy" / "k8s"
KUSTOMIZATIONS = sorted(path.parent for path in K8S.rglob("kustomization.yaml"))
MANIFESTS = sorted(path for path in K8S.rglob("*.yaml") if path.name != "kustomization.yaml")
VERSION = "1.37"


def pods(found):
    """Pod specifications of everything that makes pods."""
    kinds = ("StatefulSet", "Deployment", "Job")
    return [one["spec"]["template"]["spec"] for one in found if one["kind"] in kinds]


def name(path):
    return path.name


@pytest.mark.parametrize("path", [*MANIFESTS, *KUSTOMIZATIONS], ids=name)
def test_a_manifest_holds_what_its_schema_allows_and_nothing_else(path):
    for document in documents(path):
        kubernetes_validate.validate(document, VERSION, strict=True)


def test_a_misspelt_field_would_be_found():
    deployment = next(one for one in documents(K8S / "base/actor.yaml") if one["kind"] == "Deployment")
    deployment["spec"]["replica"] = 2
    with pytest.raises(kubernetes_validate.ValidationError):
        kubernetes_validate.validate(deployment, VERSION, strict=True)


def test_a_patch_of_what_is_not_there_would_be_found():
    learner = {"kind": "StatefulSet", "name": "learner"}
    with pytest.raises(jsonpatch.JsonPatchConflict):
        patched(rendered(K8S / "base"), learner, [{"op": "replace", "path": "/spec/replica", "value": 1}])
    with pytest.raises(AssertionError):
        patched(rendered(K8S / "base"), {"kind": "StatefulSet", "name": "teacher"}, [])


def test_every_pod_runs_without_privileges_on_a_read_only_root():
    found = [*pods(documents(K8S / "seeds.yaml")), *(pod for folder in KUSTOMIZATIONS for pod in pods(rendered(folder)))]
    assert len(found) == 1 + 2 * len(KUSTOMIZATIONS)
    for pod in found:
        assert pod["securityContext"]["runAsNonRoot"] and not pod["automountServiceAccountToken"]
        for container in pod["containers"]:
            context = container["securityContext"]
            assert context["readOnlyRootFilesystem"] and not context["allowPrivilegeEscalation"]
            assert context["capabilities"] == {"drop": ["ALL"]}


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
