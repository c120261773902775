"""Compose and Helm start a cluster: the file compose.cluster.yaml, and the chart as Helm renders it."""

from __future__ import annotations

import re
import shlex
from functools import cache
from pathlib import Path
from typing import Any

import click
import pytest
import yaml

from tests.support.proxy import CADDYFILE
from unbend import __version__
from unbend.api import create_app
from unbend.api.routes import health
from unbend.api.server.configuration import OTHER_VARIABLES
from unbend.api.server.settings import Settings
from unbend.cli import main
from unbend.library.storage.schema import jobs

ROOT = Path(__file__).parent.parent
COMPOSE = ROOT / "compose.cluster.yaml"
CHART = ROOT / "charts" / "unbend"
PAGE = ROOT / "docs" / "operations" / "cluster.md"
UNBEND = ("api-1", "api-2", "worker", "migrate")
KUBERNETES = "1.33"
"""A version that is neither the oldest nor the newest which the chart supports."""

MINIMAL = {"library": {"existingSecret": {"name": "database"}}}
FULL = {
    "image": {"repository": "registry.example.org/unbend", "digest": f"sha256:{'0' * 64}"},
    "imagePullSecrets": [{"name": "registry"}],
    "library": {"url": "postgresql+psycopg://app@db-rw/app", "passwordSecret": {"name": "db-app"}},
    "rootPath": "/shapes",
    "settings": {"max_upload_mb": 128, "job_days": 0.5, "max_faces": 4_000_000, "allowed_hosts": "shapes.example.org"},
    "envFrom": [{"secretRef": {"name": "objects"}}],
    "api": {"autoscaling": {"enabled": True}, "nodeSelector": {"disk": "fast"}, "podAnnotations": {"team": "shapes"}},
    "worker": {
        "slots": 4,
        "drainSeconds": 600,
        "autoscaling": {"kind": "keda", "keda": {"connectionSecret": {"name": "db-app"}}},
        "tolerations": [{"key": "compute", "operator": "Exists"}],
        "affinity": {"podAntiAffinity": {}},
    },
    "serviceAccount": {"annotations": {"example.org/role": "objects"}},
    "service": {"annotations": {"example.org/scheme": "http"}},
    "ingress": {"enabled": True, "className": "traefik", "host": "shapes.example.org", "tlsSecret": "certificate"},
    "networkPolicy": {
        "enabled": True,
        "apiFrom": [{"namespaceSelector": {"matchLabels": {"name": "proxy"}}}],
        "egress": [{"ports": [{"port": 5432}]}],
    },
    "monitors": {"enabled": True, "labels": {"release": "prometheus"}, "apiKeySecret": {"name": "reader"}},
}
BY_PROCESSORS = MINIMAL | {"worker": {"autoscaling": {"kind": "cpu"}}, "disruptionBudgets": {"enabled": False}}
SERVED_BY_OTHERS = {"ServiceMonitor", "PodMonitor", "ScaledObject", "TriggerAuthentication"}
"""Kinds that Kubernetes itself does not define."""


@cache
def compose() -> dict[str, Any]:
    """The file, as Compose reads it with a password in .env."""
    return yaml.safe_load(substituted())


@cache
def substituted() -> str:
    def value(found: re.Match[str]) -> str:
        name, default = found[1], found[3]
        return "secret" if name == "POSTGRES_PASSWORD" else default

    text = re.sub(r"\$\{(\w+)(:[-?])([^}]*)\}", value, COMPOSE.read_text())
    assert "$" not in re.sub(r"^\s*#.*$", "", text, flags=re.MULTILINE)
    return text


@cache
def rendered(name: str) -> list[dict[str, Any]]:
    """The objects that Helm makes of values of this module."""
    helm = pytest.importorskip("helm_python", reason="helm-python-sdk is not installed")
    values = {"minimal": MINIMAL, "full": FULL, "by processors": BY_PROCESSORS}[name]
    with helm.Chart.load(CHART) as chart:
        files = chart.render(values, name="shapes", namespace="research")
    documents = [yaml.safe_load_all(text) for path, text in files.items() if path.endswith(".yaml")]
    return [found for each in documents for found in each if found]


def kind(objects: list[dict[str, Any]], name: str) -> dict[str, dict[str, Any]]:
    return {each["metadata"]["name"]: each for each in objects if each["kind"] == name}


def pods(objects: list[dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """Return the specifications of all pods."""
    workloads = {name: each for of in ("Deployment", "Job") for name, each in kind(objects, of).items()}
    templates = {name: each["spec"]["template"]["spec"] for name, each in workloads.items()}
    return templates | {name: each["spec"] for name, each in kind(objects, "Pod").items()}


def container(objects: list[dict[str, Any]], pod: str) -> dict[str, Any]:
    (only,) = pods(objects)[pod]["containers"]
    return only


def variables(objects: list[dict[str, Any]]) -> dict[str, str]:
    """Return every UNBEND_ variable of a chart that does not come from a secret."""
    own = [each for pod in pods(objects).values() for of in pod["containers"] for each in of.get("env", [])]
    given = {each["name"]: each["value"] for each in own if "value" in each}
    given |= kind(objects, "ConfigMap")["shapes-unbend"]["data"]
    return {name: value for name, value in given.items() if name.startswith("UNBEND_")}


def parsed(command: list[str]) -> dict[str, Any]:
    """Return the options of a command line as the command reads them."""
    name, *arguments = command
    for needed in ("worker", name):  # only a version with workers has servers without them
        if needed not in main.commands:
            pytest.skip(f"this version has no command `{needed}`")
    return main.commands[name].make_context(name, list(arguments), parent=click.Context(main)).params


def check_settings(values: dict[str, str]) -> None:
    """Fail unless a server accepts these variables."""
    if "migrate" not in main.commands:
        pytest.skip("this version has no setting UNBEND_MIGRATE")
    settings = {name: value for name, value in values.items() if name not in OTHER_VARIABLES}
    fields = {name.removeprefix("UNBEND_").lower(): value for name, value in settings.items()}
    assert fields.keys() <= Settings.model_fields.keys()
    Settings(**fields)


def paths_of_the_api() -> set[str]:
    app = create_app(Settings(library=":memory:"))
    return set(app.openapi()["paths"])


def paths_of_a_worker() -> set[str]:
    return {route.path for route in health.router.routes}


def test_the_compose_file_follows_the_specification():
    compose_spec = pytest.importorskip("compose_spec", reason="compose-spec is not installed")
    found = compose_spec.PyOptions(apply_merge=True).from_yaml(substituted())
    found.validate()  # that networks and volumes exist
    assert set(found.service_names()) == {"proxy", "database", *UNBEND}


def test_no_password_is_in_the_compose_file():
    assert compose()["services"]["api-1"]["environment"]["PGPASSWORD"] == "secret"
    assert "secret" not in COMPOSE.read_text()
    urls = [each["environment"]["UNBEND_LIBRARY"] for name, each in compose()["services"].items() if name in UNBEND]
    assert set(urls) == {"postgresql+psycopg://unbend@database/unbend"}


@pytest.mark.parametrize("name", UNBEND)
def test_each_service_of_the_image_may_write_only_temporary_files(name):
    service = compose()["services"][name]
    assert service["read_only"]
    assert service["cap_drop"] == ["ALL"]
    assert service["security_opt"] == ["no-new-privileges:true"]
    assert "volumes" not in service
    assert service["image"] == yaml.safe_load((ROOT / "compose.yaml").read_text())["services"]["unbend"]["image"]


@pytest.mark.parametrize("name", UNBEND)
def test_the_commands_and_settings_of_the_compose_file_exist(name):
    service = compose()["services"][name]
    parsed(service["command"])
    check_settings({key: value for key, value in service["environment"].items() if key.startswith("UNBEND_")})


@pytest.mark.parametrize(("name", "paths"), [("api-1", paths_of_the_api), ("worker", paths_of_a_worker)])
def test_health_checks_ask_for_a_path_at_the_port_of_their_service(name, paths):
    service = compose()["services"][name]
    port, path = re.search(r"http://127\.0\.0\.1:(\d+)(/[\w/]+)'", service["healthcheck"]["test"][-1]).groups()
    assert service["command"][service["command"].index("--port") + 1] == port
    assert path in paths()


def test_replicas_trust_only_the_proxy_which_knows_each_of_them():
    services = compose()["services"]
    proxy, replicas = services["proxy"], {name for name in services if name.startswith("api-")}
    address = proxy["networks"]["front"]["ipv4_address"]
    assert {services[name]["environment"]["UNBEND_TRUSTED_PROXIES"] for name in replicas} == {address}
    assert set(proxy["environment"]["UPSTREAMS"].split()) == {f"{name}:8000" for name in replicas}
    (health,) = re.findall(r"health_uri (\S+)", CADDYFILE.read_text())
    assert health in paths_of_the_api()
    assert set(re.findall(r"\{\$(\w+)", CADDYFILE.read_text())) == proxy["environment"].keys()


def test_services_stop_later_than_their_jobs():
    for name in ("api-1", "worker"):
        service = compose()["services"][name]
        drain = float(service["environment"].get("UNBEND_DRAIN_SECONDS", Settings().drain_seconds))
        assert float(service["stop_grace_period"].removesuffix("s")) > drain


def test_helm_finds_nothing_wrong_with_the_chart():
    helm = pytest.importorskip("helm_python", reason="helm-python-sdk is not installed")
    for values in (MINIMAL, FULL, BY_PROCESSORS):
        report = helm.lint(CHART, values, strict=True, kube_version=f"v{KUBERNETES}.0")
        found = {each["error"] for each in report["messages"]} - {"icon is recommended"}
        assert (report["errors"], found) == ([], set())


@pytest.mark.parametrize(
    "wrong",
    [
        {"library": {"url": "postgresql+psycopg://app:password@db/app"}},
        {"library": {"url": "library.db"}},
        MINIMAL | {"settings": {"workers": 4}},
        MINIMAL | {"rootPath": "shapes/"},
        MINIMAL | {"worker": {"autoscaling": {"kind": "queue"}}},
        MINIMAL | {"replicas": 3},
    ],
)  # fmt: skip
def test_the_chart_refuses_wrong_values(wrong):
    helm = pytest.importorskip("helm_python", reason="helm-python-sdk is not installed")
    with helm.Chart.load(CHART) as chart, pytest.raises(helm.HelmError, match=r"^unbend:"):
        chart.validate_schema(wrong)


@pytest.mark.parametrize("missing", [{}, MINIMAL | {"worker": {"autoscaling": {"kind": "keda"}}}])
def test_the_chart_names_a_value_that_is_missing(missing):
    helm = pytest.importorskip("helm_python", reason="helm-python-sdk is not installed")
    with helm.Chart.load(CHART) as chart, pytest.raises(helm.HelmError, match=r"set \w+\.\w+"):
        chart.render(missing, name="shapes", namespace="research")


@pytest.mark.parametrize("version", ["1.30", KUBERNETES, "1.37"])
@pytest.mark.parametrize("name", ["minimal", "full", "by processors"])
def test_kubernetes_accepts_the_objects_of_the_chart(name, version):
    schemas = pytest.importorskip("kubernetes_validate", reason="kubernetes-validate is not installed")
    objects = rendered(name)
    checked = [each for each in objects if each["kind"] not in SERVED_BY_OTHERS]
    assert len(checked) >= 7
    for each in checked:
        schemas.validate(each, version, strict=True)


@pytest.mark.parametrize("name", ["minimal", "full"])
def test_pods_run_without_privileges_tokens_and_a_writable_disk(name):
    for pod in pods(rendered(name)).values():
        assert pod["automountServiceAccountToken"] is False
        assert pod["enableServiceLinks"] is False
        assert pod["securityContext"]["runAsNonRoot"]
        assert pod["securityContext"]["seccompProfile"] == {"type": "RuntimeDefault"}
        (only,) = pod["containers"]
        assert only["securityContext"] == {
            "allowPrivilegeEscalation": False, "readOnlyRootFilesystem": True, "capabilities": {"drop": ["ALL"]}
        }  # fmt: skip
        assert only["resources"].keys() >= {"requests", "limits"}


def test_pods_run_as_the_user_of_the_image():
    (user,) = re.findall(r"^USER (\d+)$", (ROOT / "Dockerfile").read_text(), re.MULTILINE)
    assert {pod["securityContext"]["runAsUser"] for pod in pods(rendered("full")).values()} == {int(user)}


def test_the_chart_starts_the_version_of_the_package():
    assert container(rendered("minimal"), "shapes-unbend-api")["image"] == f"unbend:{__version__}"


@pytest.mark.parametrize(
    ("pod", "paths"),
    [("shapes-unbend-api", paths_of_the_api), ("shapes-unbend-worker", paths_of_a_worker)],
)
def test_probes_ask_for_a_path_at_the_port_of_their_command(pod, paths):
    only = container(rendered("full"), pod)
    (port,) = only["ports"]
    assert only["args"][only["args"].index("--port") + 1] == str(port["containerPort"])
    for name in ("startupProbe", "livenessProbe", "readinessProbe"):
        assert only[name]["httpGet"]["port"] == port["name"]
        assert only[name]["httpGet"]["path"] in paths()


@pytest.mark.parametrize("name", ["minimal", "full"])
def test_the_commands_and_settings_of_the_chart_exist(name):
    objects = rendered(name)
    for pod in ("shapes-unbend-api", "shapes-unbend-worker", "shapes-unbend-migrate"):
        parsed(container(objects, pod)["args"])
    check_settings(variables(objects))


@pytest.mark.parametrize("name", ["minimal", "full"])
def test_pods_stop_later_than_their_jobs(name):
    for pod in ("shapes-unbend-api", "shapes-unbend-worker"):
        only = container(rendered(name), pod)
        (drain,) = [float(each["value"]) for each in only["env"] if each["name"] == "UNBEND_DRAIN_SECONDS"]
        pause = only.get("lifecycle", {}).get("preStop", {}).get("sleep", {}).get("seconds", 0)
        assert pods(rendered(name))[pod]["terminationGracePeriodSeconds"] > drain + pause


def test_migrations_run_before_anything_that_they_would_need():
    (job,) = kind(rendered("full"), "Job").values()
    assert job["metadata"]["annotations"]["helm.sh/hook"] == "pre-install,pre-upgrade"
    spec = job["spec"]["template"]["spec"]
    assert "serviceAccountName" not in spec
    assert "envFrom" not in spec["containers"][0]


def test_the_password_comes_from_a_secret():
    for name in ("shapes-unbend-api", "shapes-unbend-worker", "shapes-unbend-migrate"):
        given = {each["name"]: each for each in container(rendered("full"), name)["env"]}
        assert given["PGPASSWORD"]["valueFrom"]["secretKeyRef"] == {"name": "db-app", "key": "password"}
        given = {each["name"]: each for each in container(rendered("minimal"), name)["env"]}
        assert given["UNBEND_LIBRARY"]["valueFrom"]["secretKeyRef"] == {"name": "database", "key": "library"}


def test_workers_scale_with_the_unfinished_jobs():
    objects = rendered("full")
    (scaled,) = kind(objects, "ScaledObject").values()
    (trigger,) = scaled["spec"]["triggers"]
    (authentication,) = kind(objects, "TriggerAuthentication")
    assert trigger["authenticationRef"]["name"] == authentication
    assert scaled["spec"]["scaleTargetRef"]["name"] in kind(objects, "Deployment")
    assert "replicas" not in kind(objects, "Deployment")["shapes-unbend-worker"]["spec"]
    args = container(objects, "shapes-unbend-worker")["args"]
    assert trigger["metadata"]["targetQueryValue"] == args[args.index("--workers") + 1]
    assert re.search(r"FROM (\w+) WHERE (\w+) IN", trigger["metadata"]["query"]).groups() == (
        jobs.name,
        jobs.c.state.name,
    )


@pytest.mark.parametrize("name", ["minimal", "full", "by processors"])
def test_selectors_select_the_pods_of_one_part(name):
    objects = rendered(name)
    labels = {
        each["metadata"]["name"]: each["spec"]["template"]["metadata"]["labels"]
        for each in objects
        if each["kind"] in {"Deployment", "Job"}
    }

    def selected(selector: dict[str, str]) -> set[str]:
        return {pod for pod, own in labels.items() if selector.items() <= own.items()}

    (service,) = kind(objects, "Service").values()
    assert selected(service["spec"]["selector"]) == {"shapes-unbend-api"}
    for each in objects:
        if each["kind"] in {"Deployment", "PodDisruptionBudget"}:
            assert selected(each["spec"]["selector"]["matchLabels"]) == {each["metadata"]["name"]}
        if each["kind"] == "NetworkPolicy":
            assert selected(each["spec"]["podSelector"]["matchLabels"]) == {each["metadata"]["name"]}


def test_the_ingress_and_the_service_agree_about_the_prefix():
    objects = rendered("full")
    (ingress,) = kind(objects, "Ingress").values()
    (rule,) = ingress["spec"]["rules"]
    assert [path["path"] for path in rule["http"]["paths"]] == [variables(objects)["UNBEND_ROOT_PATH"]]
    assert container(objects, "shapes-unbend-test")["command"][-1] == "http://shapes-unbend:80/shapes/v1/readyz"


@pytest.mark.parametrize("value", list(yaml.safe_load((CHART / "values.yaml").read_text())))
def test_the_page_explains_each_part_of_the_values(value):
    assert re.search(rf"`{value}[`.]", PAGE.read_text())


def test_commands_of_the_page_use_files_that_exist():
    for line in re.findall(r"^    (docker compose .*|helm .*)$", PAGE.read_text(), re.MULTILINE):
        for word in shlex.split(line):
            if word.endswith(".yaml") or word.startswith("./charts"):
                assert (ROOT / word).exists() or word.startswith("my-"), word


def test_the_values_of_the_page_render():
    helm = pytest.importorskip("helm_python", reason="helm-python-sdk is not installed")
    (example,) = re.findall(r"^```yaml\n(.*?)^```", PAGE.read_text(), re.MULTILINE | re.DOTALL)
    values = yaml.safe_load(example)
    with helm.Chart.load(CHART) as chart:
        chart.validate_schema(values)
        files = chart.render(values, name="shapes", namespace="shapes")
    deployments = {name: text for name, text in files.items() if "kind: Deployment" in text}
    assert len(deployments) == 2
    named = {each["metadata"]["name"] for text in deployments.values() for each in yaml.safe_load_all(text)}
    assert set(re.findall(r"exec deploy/(\S+)", PAGE.read_text())) <= named
