"""Files in deploy/ are valid for the tools that read them, and agree with the service and the image."""

import re
import shutil
import subprocess
import sys
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
import yaml

from service.cli.server import MAX_CONNECTIONS
from service.settings import Settings
from tests.container.dockerfile import ROOT, read

DEPLOY = ROOT / "deploy"
UNIT = (DEPLOY / "ricochet.service").read_text(encoding="utf-8")
MANIFESTS = [
    manifest
    for name in ("kubernetes.yaml", "kubernetes-key.yaml", "kubernetes-ingress.yaml")
    for manifest in yaml.safe_load_all((DEPLOY / name).read_text(encoding="utf-8"))
]
PODS = [manifest["spec"]["template"]["spec"] for manifest in MANIFESTS if "template" in manifest["spec"]]
KINDS = {manifest["kind"]: manifest for manifest in MANIFESTS}
IMAGE = read()[-1]
EXPOSURE = 25
"""Largest accepted exposure by `systemd-analyze security`, which rates 20 of 100 as OK."""


def settings_in(monkeypatch: pytest.MonkeyPatch, given: dict[str, str]) -> Settings:
    """Return the settings in environment variables; a variable for an unknown setting is an error."""
    variables = {name: value for name, value in given.items() if name.startswith("RICOCHET_")}
    assert {name.removeprefix("RICOCHET_").lower() for name in variables} <= Settings.model_fields.keys()
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    return Settings()


UNITS = ("ricochet.service", "ricochet-worker.service", "ricochet-backup.service", "ricochet-backup.timer")
PROGRAM = re.compile(r"/(?:opt|usr/local)/(?:[\w.-]+/)*[\w.-]+")
"""Path of an installed program in a unit."""


def analyze(verb: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    if shutil.which("systemd-analyze") is None:
        pytest.skip("systemd-analyze is not there to check the unit")
    command = ["systemd-analyze", verb, *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)


@pytest.fixture
def units(tmp_path: Path) -> dict[str, Path]:
    """The units, with every program replaced by an existing one, because systemd checks that programs exist."""
    for name in UNITS:
        text = (DEPLOY / name).read_text(encoding="utf-8")
        start = re.compile(r"(?m)^ExecStart=.*$")
        (tmp_path / name).write_text(start.sub(lambda line: PROGRAM.sub(sys.executable, line[0], count=1), text))
    return {name: tmp_path / name for name in UNITS}


@pytest.mark.parametrize("name", UNITS)
def test_systemd_accepts_the_units(units: dict[str, Path], name: str) -> None:
    done = analyze("verify", "--man=no", str(units[name]))
    own = [line for line in done.stderr.splitlines() if "ricochet" in line]
    assert (done.returncode, own) == (0, [])


@pytest.mark.parametrize("name", [name for name in UNITS if name.endswith(".service")])
def test_exposure_of_the_units_is_low(units: dict[str, Path], name: str) -> None:
    done = analyze("security", "--offline=yes", f"--threshold={EXPOSURE}", "--no-pager", str(units[name]))
    if "unrecognized option" in done.stderr:
        pytest.skip("this systemd-analyze does not look at files")
    assert done.returncode == 0, done.stdout


def test_units_use_the_paths_that_their_comments_install() -> None:
    for name in UNITS:
        head, _, body = (DEPLOY / name).read_text(encoding="utf-8").partition("[Unit]")
        for path in re.findall(r"ExecStart=(/usr/local/\S+)", body):
            assert path in head
    assert "/usr/bin/python3 -m venv /opt/ricochet\n" in UNIT  # ProtectHome would hide a program below /home.
    assert "--require-hashes" in UNIT


def test_unit_has_valid_settings_and_lets_the_service_stop_by_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    given = dict(line.split("=", 1) for line in re.findall(r"(?m)^Environment=(.+)$", UNIT))
    settings = settings_in(monkeypatch, given)
    assert settings.on_loopback
    assert settings.trusted_proxies == ("127.0.0.1",)
    assert f"StateDirectory={settings.data_dir.name}\n" in UNIT
    [patience] = re.findall(r"TimeoutStopSec=(\d+)", UNIT)
    assert int(patience) > settings.grace_seconds
    assert "RestartPreventExitStatus=2 3\n" in UNIT
    assert "MemoryDenyWriteExecute=" not in UNIT  # The solver is compiled at run time.
    [files] = re.findall(r"LimitNOFILE=(\d+)", UNIT)
    assert int(files) > 2 * MAX_CONNECTIONS


@pytest.fixture(scope="module")
def kubernetes() -> Any:
    """Module that validates Kubernetes manifests; it is imported only here, because that takes two seconds."""
    return import_module("kubernetes_validate")


@pytest.mark.parametrize("manifest", MANIFESTS, ids=lambda manifest: manifest["kind"])
def test_manifests_match_the_kubernetes_schemas(kubernetes: Any, manifest: dict[str, Any]) -> None:
    kubernetes.validate(manifest, kubernetes.latest_version(), strict=True)


def test_manifest_with_a_wrong_field_is_refused(kubernetes: Any) -> None:
    wrong = {**KINDS["Service"], "spec": {**KINDS["Service"]["spec"], "port": 80}}
    with pytest.raises(kubernetes.ValidationError):
        kubernetes.validate(wrong, kubernetes.latest_version(), strict=True)


@pytest.mark.parametrize("pod", PODS)
def test_pods_run_the_image_as_its_user_without_privileges(pod: dict[str, Any]) -> None:
    [container] = pod["containers"]
    assert str(pod["securityContext"]["runAsUser"]) == IMAGE.last("USER").text
    assert pod["securityContext"]["runAsNonRoot"]
    assert pod["securityContext"]["seccompProfile"] == {"type": "RuntimeDefault"}
    assert container["securityContext"] == {
        "allowPrivilegeEscalation": False,
        "readOnlyRootFilesystem": True,
        "capabilities": {"drop": ["ALL"]},
    }
    assert not pod["automountServiceAccountToken"]
    assert not pod["enableServiceLinks"]  # Service links would set RICOCHET_PORT to tcp://...
    mounted = {mount["mountPath"] for mount in container["volumeMounts"]}
    assert IMAGE.last("VOLUME").text in mounted
    assert container["resources"]["limits"]["memory"]


def test_deployment_has_settings_probes_and_replaces_its_only_pod(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    deployment = KINDS["Deployment"]["spec"]
    assert (deployment["replicas"], deployment["strategy"]) == (1, {"type": "Recreate"})
    pod = deployment["template"]["spec"]
    [container] = pod["containers"]
    settings = settings_in(monkeypatch, {each["name"]: each["value"] for each in container["env"]})
    assert settings.access == "keys"
    assert str(settings.workers) == container["resources"]["limits"]["cpu"]
    assert str(container["ports"][0]["containerPort"]) == IMAGE.last("EXPOSE").text
    paths = {name: container[f"{name}Probe"]["httpGet"]["path"] for name in ("startup", "liveness", "readiness")}
    assert paths == {"startup": "/livez", "liveness": "/livez", "readiness": "/readyz"}
    assert container["readinessProbe"]["timeoutSeconds"] > settings.probe_seconds
    assert pod["terminationGracePeriodSeconds"] > settings.grace_seconds
    mounts = {mount["mountPath"]: mount["name"] for mount in container["volumeMounts"]}
    compiled_code = mounts[IMAGE.environment()["XDG_CACHE_HOME"]]
    assert {"name": compiled_code, "emptyDir": {"sizeLimit": "256Mi"}} in pod["volumes"]  # The root is read-only.
    claims = [volume["persistentVolumeClaim"]["claimName"] for volume in pod["volumes"] if "emptyDir" not in volume]
    assert claims == [KINDS["PersistentVolumeClaim"]["metadata"]["name"]]
    assert KINDS["Service"]["spec"]["selector"] == deployment["template"]["metadata"]["labels"]


def test_job_of_the_key_runs_where_the_volume_is_mounted() -> None:
    assert KINDS["PersistentVolumeClaim"]["spec"]["accessModes"] == ["ReadWriteOnce"]
    affinity = KINDS["Job"]["spec"]["template"]["spec"]["affinity"]["podAffinity"]
    [term] = affinity["requiredDuringSchedulingIgnoredDuringExecution"]
    assert term["topologyKey"] == "kubernetes.io/hostname"
    assert term["labelSelector"]["matchLabels"] == KINDS["Deployment"]["spec"]["template"]["metadata"]["labels"]


def test_ingress_leads_to_the_service_with_tls() -> None:
    ingress = KINDS["Ingress"]["spec"]
    [rule] = ingress["rules"]
    [path] = rule["http"]["paths"]
    assert ingress["tls"][0]["hosts"] == [rule["host"]]
    service = KINDS["Service"]
    [port] = service["spec"]["ports"]
    assert path["backend"]["service"] == {"name": service["metadata"]["name"], "port": {"name": port["name"]}}


def test_manual_includes_the_files_themselves() -> None:
    page = (ROOT / "docs" / "how-to" / "deploy.md").read_text(encoding="utf-8")
    shown = set(re.findall(r"\{literalinclude\} \.\./\.\./deploy/(\S+)", page))
    assert shown == {path.name for path in DEPLOY.iterdir()}
    assert "```nginx" not in page
    assert "```ini" not in page


def test_labels_of_the_image_describe_it() -> None:
    labels: dict[str, str] = {}
    for step in IMAGE.steps:
        if step.instruction == "LABEL":
            labels |= step.assignments()
    names = {name.removeprefix("org.opencontainers.image.") for name in labels}
    assert names >= {"title", "description", "licenses", "version", "revision", "base.name"}
    assert labels["org.opencontainers.image.base.name"].endswith(IMAGE.tag)
