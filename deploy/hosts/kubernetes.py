"""Kubernetes manifests of a fleet: a StatefulSet for the learner, Deployments for everybody else, Secrets for keys."""

import base64
import re
from typing import Any, Final

from eia_sec.common.config.files import to_toml
from eia_sec.common.errors import ConfigError
from eia_sec.deploy.hosts import containers
from eia_sec.deploy.hosts.containers import USER_ID, as_yaml, environment, inside, key_files, port_of, probe
from eia_sec.deploy.hosts.fleet_file import FleetSpec
from eia_sec.deploy.hosts.operations import service_name
from eia_sec.deploy.hosts.plan import Places, Process, processes, worker

_LABEL: Final = re.compile(r"[a-z]([-a-z0-9]{0,61}[a-z0-9])?")
_POD: Final = "$(POD_NAME)"
"""The pod's own name, which Kubernetes substitutes in arguments."""

Object = dict[str, Any]


def kubernetes(fleet: FleetSpec) -> dict[str, str]:
    """Return the manifests: fleet.yaml, and secrets.yaml when there are keys.

    With certificates every worker is its own Deployment, because it has its own key. Without certificates each host of
    the file is one Deployment with a replica for each of its workers.

    Raises:
        ConfigError: there are no certificates and `insecure` is not set, Kubernetes does not accept a name, or the
            fleet shares transitions through memory, which pods cannot do.
        CredentialsError: a certificate is missing or cannot be used.
    """
    if fleet.network.shared_memory:
        raise ConfigError(f"{fleet.path}: pods do not share memory; remove network.shared_memory for Kubernetes.")
    places = inside(fleet, service_name(fleet, fleet.listener[0]))
    planned = [process for process in processes(fleet, places) if fleet.keys is not None or process.role != "rollout"]
    workloads = [(_name(fleet, process), process, 1) for process in planned]
    if fleet.keys is None:
        for host, described in fleet.hosts.items():
            if described.workers:
                process = worker(fleet, places, fleet.runs[0], host, _POD)
                workloads.append((_label(f"{fleet.run}-rollout-{host}"), process, described.workers))
    names = [name for name, _, _ in workloads]
    if len(set(names)) < len(names):
        raise ConfigError(
            f"{fleet.path}: names that differ only in case or punctuation would be the same in Kubernetes."
        )
    config = _object(
        "v1", "ConfigMap", _label(f"{fleet.run}-config"), fleet, data={"config.toml": to_toml(fleet.config)}
    )
    objects = [config, _service(fleet), *(_headless(fleet, name) for name, process, _ in workloads if _stays(process))]
    objects += [_workload(fleet, places, *workload) for workload in workloads]
    files = {"fleet.yaml": as_yaml(objects)}
    if fleet.keys is not None:
        files["secrets.yaml"] = as_yaml([_secret(fleet, name, process) for name, process, _ in workloads])
    return files


def _label(text: str) -> str:
    name = re.sub(r"[._]", "-", text.lower())
    if not _LABEL.fullmatch(name):
        raise ConfigError(f"{name!r} is no valid Kubernetes name: a letter, then at most 62 letters, digits and '-'.")
    return name


def _name(fleet: FleetSpec, process: Process) -> str:
    single = process.role in ("learner", "router", "elite")
    return _label(f"{fleet.run}-{process.role}" if single else f"{fleet.run}-{process.role}-{process.name}")


def _object(version: str, kind: str, name: str, fleet: FleetSpec, **parts: Any) -> Object:
    labels = {"app.kubernetes.io/name": "eia-sec", "app.kubernetes.io/instance": _label(fleet.run)}
    return {"apiVersion": version, "kind": kind, "metadata": {"name": name, "labels": labels}, **parts}


def _secret(fleet: FleetSpec, name: str, process: Process) -> Object:
    files = key_files(fleet, process.identity)
    data = {file: base64.b64encode(content).decode() for file, content in files.items()}
    return _object("v1", "Secret", f"{name}-keys", fleet, type="Opaque", data=data)


def _service(fleet: FleetSpec) -> Object:
    """Return the Service through which both lanes of the listener are reached."""
    role, port = fleet.listener[0], port_of(fleet)
    ports = [{"name": lane, "port": port + k, "targetPort": port + k} for k, lane in enumerate(("control", "bulk"))]
    spec = {"selector": _selector(fleet, service_name(fleet, role)), "ports": ports}
    return _object("v1", "Service", service_name(fleet, role), fleet, spec=spec)


def _headless(fleet: FleetSpec, name: str) -> Object:
    """Return the headless Service that a StatefulSet requires. Others reach the learner by the listener's, if any."""
    spec = {"clusterIP": "None", "selector": _selector(fleet, name)}
    return _object("v1", "Service", _headless_name(name), fleet, spec=spec)


def _headless_name(name: str) -> str:
    return _label(f"{name}-pods")


def _stays(process: Process) -> bool:
    """Return whether a process keeps a volume and is therefore a StatefulSet."""
    return process.role == "learner"


def _selector(fleet: FleetSpec, name: str) -> Object:
    return {"app.kubernetes.io/instance": _label(fleet.run), "app.kubernetes.io/component": name}


def _workload(fleet: FleetSpec, places: Places, name: str, process: Process, replicas: int) -> Object:
    selector = _selector(fleet, name)
    template = {"metadata": {"labels": selector}, "spec": _pod(fleet, places, name, process)}
    spec: Object = {"replicas": replicas, "selector": {"matchLabels": selector}}
    if not _stays(process):
        # Two processes of one name must not run at the same time.
        spec |= {"strategy": {"type": "Recreate"}, "template": template}
        return _object("apps/v1", "Deployment", name, fleet, spec=spec)
    claim: Object = {"accessModes": ["ReadWriteOnce"], "resources": {"requests": {"storage": fleet.containers.storage}}}
    if fleet.containers.storage_class:
        claim["storageClassName"] = fleet.containers.storage_class
    volume = {"metadata": {"name": "data"}, "spec": claim}
    spec |= {"serviceName": _headless_name(name), "template": template, "volumeClaimTemplates": [volume]}
    return _object("apps/v1", "StatefulSet", name, fleet, spec=spec)


def _pod(fleet: FleetSpec, places: Places, name: str, process: Process) -> Object:
    learner, tls = _stays(process), fleet.keys is not None
    mounts = [{"name": "data", "mountPath": "/data"}]
    volumes: list[Object] = [] if learner else [{"name": "data", "emptyDir": {}}]
    pod: Object = {
        "terminationGracePeriodSeconds": 90,
        "automountServiceAccountToken": False,
        "securityContext": {
            "runAsNonRoot": True,
            "runAsUser": USER_ID,
            "runAsGroup": USER_ID,
            "fsGroup": USER_ID,
            "seccompProfile": {"type": "RuntimeDefault"},
        },
    }
    if learner:
        mounts.append({"name": "config", "mountPath": "/config"})
        volumes.append({"name": "config", "configMap": {"name": _label(f"{fleet.run}-config")}})
    if tls:
        mounts.append({"name": "keys", "mountPath": containers.KEYS})
        volumes.append({"name": "keys", "emptyDir": {"medium": "Memory"}})
        volumes.append({"name": "secret", "secret": {"secretName": f"{name}-keys"}})
        pod["initContainers"] = [_copier(fleet)]
    return pod | {"containers": [_container(fleet, places, process, mounts)], "volumes": volumes}


def _copier(fleet: FleetSpec) -> Object:
    """Return the container that copies the keys: files of a Secret are group-readable, which our processes refuse."""
    command = f"cp /secret/* {containers.KEYS}/ && chmod 600 {containers.KEYS}/*"
    mounts = [{"name": "secret", "mountPath": "/secret"}, {"name": "keys", "mountPath": containers.KEYS}]
    return {
        "name": "keys",
        **_image(fleet),
        "command": ["sh", "-c", command],
        "volumeMounts": mounts,
        "securityContext": _confined(),
    }


def _image(fleet: FleetSpec) -> Object:
    """Return the image, which a node that has it takes without asking a registry."""
    return {"image": fleet.containers.image, "imagePullPolicy": "IfNotPresent"}


def _confined() -> Object:
    return {"allowPrivilegeEscalation": False, "capabilities": {"drop": ["ALL"]}}


def _container(fleet: FleetSpec, places: Places, process: Process, mounts: list[dict[str, str]]) -> Object:
    pod_name = {"name": "POD_NAME", "valueFrom": {"fieldRef": {"fieldPath": "metadata.name"}}}
    variables: list[Object] = [pod_name] if process.name == _POD else []
    variables += [{"name": key, "value": value} for key, value in environment(process).items()]
    learners = fleet.learner.learners if process.role == "learner" else 1
    resources: Object = {"requests": {"cpu": f"{500 * learners}m", "memory": f"{learners}Gi"}}
    if process.role == "learner" and fleet.learner.gpus:
        resources["limits"] = {"nvidia.com/gpu": fleet.learner.gpus}
    container: Object = {
        "name": process.role,
        **_image(fleet),
        "args": list(process.arguments),
        "env": variables,
        "resources": resources,
        "volumeMounts": mounts,
        "securityContext": _confined(),
    }
    if process.role == fleet.listener[0]:
        port = port_of(fleet)
        container["ports"] = [{"containerPort": port}, {"containerPort": port + 1}]
        container["readinessProbe"] = {"tcpSocket": {"port": port}, "periodSeconds": 30}
    container["livenessProbe"] = {
        "exec": {"command": _probe(fleet, places, process)},
        "initialDelaySeconds": 120,
        "periodSeconds": 30,
        "timeoutSeconds": 20,
        "failureThreshold": 4,
    }
    return container


def _probe(fleet: FleetSpec, places: Places, process: Process) -> list[str]:
    """Return the probe's command; Kubernetes substitutes nothing in it, so a shell inserts the pod's name."""
    if process.name != _POD:
        return probe(fleet, places, process)
    return ["sh", "-c", " ".join(probe(fleet, places, process, '"$POD_NAME"'))]
