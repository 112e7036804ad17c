"""The Kubernetes manifests, against the official schemas; no cluster is needed."""

import re
from pathlib import Path

import kubernetes_validate
import pytest
import yaml

ROOT = Path(__file__).resolve().parents[2]
MANIFESTS = sorted(
    path for path in (ROOT / "deploy" / "k8s").rglob("*.yaml") if path.name != "kustomization.yaml"
)
VERSION = "1.37"


def documents(path):
    return list(yaml.safe_load_all(path.read_text()))


def pods(path):
    """Pod specifications of everything that makes pods."""
    kinds = ("StatefulSet", "Deployment", "Job")
    return [one["spec"]["template"]["spec"] for one in documents(path) if one["kind"] in kinds]


@pytest.mark.parametrize("path", MANIFESTS, ids=lambda path: path.name)
def test_a_manifest_holds_what_its_schema_allows_and_nothing_else(path):
    for document in documents(path):
        kubernetes_validate.validate(document, VERSION, strict=True)


def test_a_misspelt_field_would_be_found():
    deployment = next(one for one in documents(ROOT / "deploy/k8s/base/actor.yaml") if one["kind"] == "Deployment")
    deployment["spec"]["replica"] = 2
    with pytest.raises(kubernetes_validate.ValidationError):
        kubernetes_validate.validate(deployment, VERSION, strict=True)


def test_every_pod_runs_without_privileges_on_a_read_only_root():
    found = [pod for path in MANIFESTS for pod in pods(path)]
    assert len(found) == 3
    for pod in found:
        assert pod["securityContext"]["runAsNonRoot"] and not pod["automountServiceAccountToken"]
        for container in pod["containers"]:
            context = container["securityContext"]
            assert context["readOnlyRootFilesystem"] and not context["allowPrivilegeEscalation"]
            assert context["capabilities"] == {"drop": ["ALL"]}


def test_kustomizations_name_files_that_exist():
    for path in (ROOT / "deploy" / "k8s").rglob("kustomization.yaml"):
        for resource in yaml.safe_load(path.read_text())["resources"]:
            assert (path.parent / resource).exists(), f"{path}: {resource}"


def test_settings_are_ones_that_the_program_knows():
    lines = (ROOT / "deploy/k8s/base/settings.env").read_text().splitlines()
    names = [re.match(r"S2MIA__([A-Z_]+)=", line).group(1) for line in lines]
    base = (ROOT / "configs" / "base.toml").read_text()
    for name in names:
        key = name.lower().split("__")[-1]
        assert key in ("task", "algorithm") or re.search(rf"^{key} ?=", base, re.MULTILINE), name
