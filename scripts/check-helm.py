"""Renders the Helm chart in the ways that it is meant to be used and checks what comes out.

Usage: check-helm.py CHART OUT; writes OUT/NAME.yaml, without resources whose schemas are not Kubernetes'
own. Needs helm-python-sdk (Helm itself in a wheel) and PyYAML.
"""

import pathlib
import re
import sys

import helm_python as helm
import yaml

SHARED = {
    "database": {"secret": "postgres"},
    "storage": {"url": "s3://dances/jobs", "endpoint": "http://store:9000", "secret": "store"},
    "worker": {"enabled": True},
}
WAYS = {
    "alone": {},
    "shared": SHARED,
    "everything": {
        **SHARED,
        "apiKeys": {"secret": "keys"},
        "callbacks": {"allow": ["hooks.example.com"], "secret": "hooks"},
        "serviceMonitor": {"enabled": True, "labels": {"release": "prometheus"}},
        "settings": {"BAILANDO_RATE_LIMIT": "60"},
        "image": {"pullSecrets": ["registry"]},
        "nodeSelector": {"kubernetes.io/arch": "amd64"},
        "tolerations": [{"key": "dance", "operator": "Exists"}],
        "podAnnotations": {"a": "b"},
    },
    "gpu": {
        **SHARED,
        "image": {"tag": "1.0"},
        "worker": {"enabled": True, "tag": "1.0-cuda", "resources": {"limits": {"nvidia.com/gpu": 1}}},
    },
    "any-user": {**SHARED, "user": None},
    "fixed": {
        **SHARED,
        "api": {"role": "api", "autoscaling": {"enabled": False}},
        "worker": {"enabled": True, "autoscaling": {"by": "cpu"}},
        "networkPolicy": {"egress": [{"to": [{"ipBlock": {"cidr": "10.0.0.0/8"}}]}]},
    },
}
# Settings that contradict each other, and what is said of them.
REFUSED = {
    "storage.url": {"database": {"secret": "postgres"}},
    "database.secret": {"worker": {"enabled": True}},
    "worker.enabled": {"api": {"role": "api"}},
    "callbacks.secret": {"callbacks": {"allow": ["a.example"]}},
    "role": {"api": {"role": "boss"}},
    "PATH": {"settings": {"PATH": "/"}},
}
OWN = ("keda.sh", "monitoring.coreos.com")


def render(chart, values, name="dance"):
    texts = chart.render(values, name=name, namespace="stage")
    manifests = [text for file, text in texts.items() if file.endswith(".yaml")]
    return [part for text in manifests for part in yaml.safe_load_all(text) if part]


def covers(selector, labels):
    return selector.items() <= labels.items()


def check(way, values, parts):
    """Whether the resources find each other, and pods have the least privileges and drain."""
    def of(kind):
        return [part for part in parts if part["kind"] == kind]

    names = [(part["kind"], part["metadata"]["name"]) for part in parts]
    assert len(set(names)) == len(names), names
    deployments = {part["metadata"]["name"]: part for part in of("Deployment")}
    scaled = {part["spec"]["scaleTargetRef"]["name"] for part in
              of("HorizontalPodAutoscaler") + of("ScaledObject")}
    accounts = {part["metadata"]["name"] for part in of("ServiceAccount")}
    pods = {}
    for name, deployment in deployments.items():
        spec = deployment["spec"]
        pods[name] = spec["template"]["metadata"]["labels"]
        assert covers(spec["selector"]["matchLabels"], pods[name])
        assert ("replicas" in spec) != (name in scaled), f"{name}: who sets its replicas?"
        assert spec["strategy"]["rollingUpdate"] == {"maxUnavailable": 0, "maxSurge": 1}
        check_pod(spec["template"]["spec"], values, accounts)
    assert scaled <= set(deployments), scaled
    for part in of("Service") + of("PodDisruptionBudget") + of("NetworkPolicy"):
        spec = part["spec"]
        selector = spec.get("podSelector", spec.get("selector"))
        selector = selector.get("matchLabels", selector)
        found = [name for name, labels in pods.items() if covers(selector, labels)]
        assert len(found) == 1, f"{part['kind']} {part['metadata']['name']} selects {found}"
    for kind in ("PodDisruptionBudget", "NetworkPolicy"):
        assert len(of(kind)) == len(deployments), kind
    for monitor in of("ServiceMonitor"):
        selector = monitor["spec"]["selector"]["matchLabels"]
        services = [part for part in of("Service") if covers(selector, part["metadata"]["labels"])]
        assert len(services) == len(deployments)
        ports = {port["name"] for service in services for port in service["spec"]["ports"]}
        assert {end["port"] for end in monitor["spec"]["endpoints"]} <= ports
    authentications = {part["metadata"]["name"] for part in of("TriggerAuthentication")}
    for part in of("ScaledObject"):
        kinds = {trigger["type"]: trigger for trigger in part["spec"]["triggers"]}
        assert set(kinds) == {"postgresql", "cpu"}
        assert kinds["postgresql"]["authenticationRef"]["name"] in authentications
        strings = [value for trigger in kinds.values() for value in trigger["metadata"].values()]
        assert all(isinstance(value, str) for value in strings), "KEDA wants strings"
    assert len(of("ScaledObject")) == (way in ("shared", "everything", "gpu", "any-user"))
    if way == "gpu":
        containers = [part["spec"]["template"]["spec"]["containers"][0] for part in of("Deployment")]
        tags = {container["image"]: container["resources"]["limits"].get("nvidia.com/gpu")
                for container in containers}
        assert tags == {"bailando:1.0": None, "bailando:1.0-cuda": 1}, tags
    for policy in of("NetworkPolicy"):
        ports = {port["port"] for rule in policy["spec"]["egress"] for port in rule.get("ports", [])}
        # Alone it opens no connections at all.
        assert ports == {"alone": set(), "fixed": {53}}.get(way, {53, 5432, 9000}), (way, ports)


def check_pod(pod, values, accounts):
    (container,) = pod["containers"]
    environment = {entry["name"]: entry.get("value") for entry in container["env"]}
    assert len(environment) == len(container["env"]), "a setting is given twice"
    shutdown = int(environment["BAILANDO_SHUTDOWN_TIMEOUT"])
    assert pod["terminationGracePeriodSeconds"] > shutdown
    assert pod["serviceAccountName"] in accounts and pod["automountServiceAccountToken"] is False
    assert pod["securityContext"]["runAsNonRoot"] is True
    chosen = {"runAsUser", "runAsGroup", "fsGroup"} & set(pod["securityContext"])
    assert len(chosen) == (0 if values.get("user", 1) is None else 3), chosen
    assert container["securityContext"]["readOnlyRootFilesystem"] is True
    assert container["securityContext"]["capabilities"]["drop"] == ["ALL"]
    unknown = {name for name in environment if name.startswith("BAILANDO_")} - settings()
    assert not unknown, f"the server has no settings {unknown}"


def settings():
    """The environment variables that the server's sources name."""
    sources = "".join(path.read_text() for path in pathlib.Path("src").rglob("*.rs"))
    return set(re.findall(r'"(BAILANDO_[A-Z0-9_]+)"', sources))


folder, out = sys.argv[1], pathlib.Path(sys.argv[2])
found = helm.lint(folder, strict=True)
problems = [message for message in found["messages"] if message["severity"] >= 2]
assert not problems and not found["errors"], found
out.mkdir(parents=True, exist_ok=True)
with helm.Chart.load(folder) as chart:
    version = re.search(r'^version = "(.*)"$', pathlib.Path("Cargo.toml").read_text(), re.M)[1]
    assert yaml.safe_load(open(f"{folder}/Chart.yaml"))["appVersion"] == version, version
    for way, values in WAYS.items():
        parts = render(chart, values)
        check(way, values, parts)
        core = [part for part in parts if not part["apiVersion"].startswith(OWN)]
        (out / f"{way}.yaml").write_text(yaml.safe_dump_all(core))
        print(f"{way}: {len(parts)} resources, {len(core)} of Kubernetes' own")
    for said, values in REFUSED.items():
        try:
            render(chart, values)
        except helm.HelmError as error:
            assert said in str(error), error
        else:
            raise AssertionError(f"{values} is not refused")
