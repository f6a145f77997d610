"""What is written for systemd, Compose and Kubernetes is what these take, and starts what `eia-sec up` starts."""

import base64
import json
import re
import shutil
import stat
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any

import jsonschema
import kubernetes_validate
import pytest
import yaml

from eia_sec.common.config import RunConfig
from eia_sec.common.config.files import from_toml
from eia_sec.common.errors import ConfigError, RunDirError
from eia_sec.common.transport import credentials
from eia_sec.deploy.commands.fleet.fleet import command as fleet_command
from eia_sec.deploy.commands.training import elite, learner, rollout, router
from eia_sec.deploy.hosts import operations
from eia_sec.deploy.hosts.containers import as_yaml
from eia_sec.deploy.hosts.fleet_file import FleetSpec, read
from eia_sec.deploy.hosts.render import render
from eia_sec.deploy.hosts.systemd import _word
from eia_sec.deploy.local.run_directory import RunDirectory
from eia_sec.deploy.options import parse

ROOT = Path(__file__).resolve().parents[3]
SCHEMA = json.loads((Path(__file__).parent / "schemas" / "compose-spec.json").read_text())
OPTIONS = {
    "router": router.RouterArguments,
    "learner": learner.LearnerArguments,
    "elite": elite.EliteArguments,
    "rollout": rollout.RolloutArguments,
}
TEXT = """
run = "field_1"
[training]
preset = "quick"
set = ['learner.device = "cuda"']
[network]
endpoint = "{protocol}/farm-1:7447"
{keys}
{router}
[learner]
host = "farm-1"
gpus = 1
[hosts.farm-1]
command = "{command}"
workers = 1
[hosts.farm-2]
command = "{command}"
workers = 2
"""
VERSIONS = ("1.29", "1.34", "1.37")
"""Of Kubernetes; the manifests must be right for each."""


@pytest.fixture(params=["tls, router", "tls", "insecure"])
def fleet(request: pytest.FixtureRequest, tmp_path: Path) -> FleetSpec:
    """A fleet with certificates behind a router, one without router, and one without certificates."""
    program = tmp_path / "bin" / "eia-sec"
    program.parent.mkdir()
    program.write_text("#!/bin/sh\n")
    program.chmod(0o755)
    tls = "tls" in request.param
    text = TEXT.format(
        protocol="tls" if tls else "tcp",
        keys='keys = "keys"' if tls else "insecure = true",
        router='[router]\nhost = "farm-1"' if "router" in request.param else "",
        command=program,
    )
    (tmp_path / "fleet.toml").write_text(text)
    found = read(tmp_path / "fleet.toml")
    if tls:
        operations.issue_keys(found, 30)
    return found


def roles(fleet: FleetSpec) -> list[str]:
    """Return the roles that have to be started, once for each process."""
    return sorted([*(["router"] if fleet.router else []), "learner", "elite", *["rollout"] * 3])


def check_compose(document: dict[str, Any]) -> None:
    """Hold a document against the schema of the Compose specification."""
    jsonschema.Draft201909Validator(SCHEMA).validate(document)


def understood(arguments: list[str]) -> str:
    """Return the role whose command takes these arguments; fail when it would complain."""
    parse(OPTIONS[arguments[0]], arguments[1:], arguments[0])
    return arguments[0]


def test_units_are_what_systemd_takes(fleet, tmp_path):
    """`systemd-analyze verify` has nothing to say on any unit, and each starts a process with its certificate."""
    written = render(fleet, "systemd", tmp_path / "out")
    units = [path for path in written if path.suffix == ".service"]
    started = []
    for path in units:
        (line,) = re.findall(r"^ExecStart=(.*)$", path.read_text(), re.MULTILINE)
        words = line.split()
        started.append(understood(words[1:]))
        assert path.stat().st_mode & stat.S_IROTH
        assert ("PrivateDevices=yes" in path.read_text()) == (words[1] != "learner")
        if fleet.keys:
            assert words[words.index("--tls") + 1].rpartition("/")[2] in path.name
    assert sorted(started) == roles(fleet)
    assert "After=network-online.target time-sync.target" in units[0].read_text()
    assert from_toml(tmp_path / "out" / "farm-1" / "config.toml", RunConfig()) == fleet.config
    if shutil.which("systemd-analyze") is None:
        pytest.skip("the rest needs systemd-analyze")
    for host in ("farm-1", "farm-2"):
        paths = [str(path) for path in written if path.suffix in (".service", ".target") and path.parent.name == host]
        done = subprocess.run(["systemd-analyze", "verify", *paths], capture_output=True, text=True, check=False)
        ours = [line for line in done.stderr.splitlines() if "eia-sec" in line]
        assert (done.returncode, ours) == (0, []), done.stderr


def test_a_broken_unit_would_be_found(fleet, tmp_path):
    """The check above sees an unknown key, a program that is not there, and a command that is relative."""
    if shutil.which("systemd-analyze") is None:
        pytest.skip("needs systemd-analyze")
    (path, *_) = [path for path in render(fleet, "systemd", tmp_path / "out") if path.suffix == ".service"]
    good = path.read_text()
    for broken in (good.replace("Restart=", "Restrat="), re.sub("ExecStart=", "ExecStart=/nowhere", good)):
        path.write_text(broken)
        done = subprocess.run(["systemd-analyze", "verify", str(path)], capture_output=True, text=True, check=False)
        assert [line for line in done.stderr.splitlines() if "eia-sec" in line]
    text = fleet.path.read_text()
    fleet.path.write_text(re.sub(r'command = ".*"', 'command = ".venv/bin/eia-sec"', text))
    with pytest.raises(ConfigError, match="absolute path for systemd"):
        render(read(fleet.path), "systemd", tmp_path / "out")


def test_words_reach_the_process_as_they_are():
    """What systemd would take for a specifier, a variable or the end of a word is written so that it does not."""
    assert [_word(word) for word in ("plain", "100%", "$HOME", 'a "b"')] == ["plain", "100%%", "$$HOME", '"a \\"b\\""']


def compose_program() -> list[str]:
    """Return the words that Compose is called by here; skip where there is none."""
    for words in (["docker", "compose"], ["docker-compose"]):
        if (
            shutil.which(words[0])
            and not subprocess.run([*words, "version"], capture_output=True, check=False).returncode
        ):
            return words
    pytest.skip("needs docker compose")


@pytest.mark.parametrize("shared", [False, True])
def test_compose_takes_the_file(fleet, tmp_path, shared):
    """`docker compose config` has nothing to say, and finds every service."""
    words = compose_program()
    render(sharing(fleet) if shared else fleet, "compose", tmp_path / "out")
    services = yaml.safe_load((tmp_path / "out" / "compose.yaml").read_text())["services"]
    done = subprocess.run(
        [
            *words,
            "--project-directory",
            str(tmp_path / "out"),
            "-f",
            str(tmp_path / "out" / "compose.yaml"),
            "config",
            "--services",
        ],
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert set(done.stdout.split()) == set(services)


def test_compose_file_is_what_the_specification_says(fleet, tmp_path):
    """The file passes the schema of the specification, and its services are the fleet's processes."""
    render(fleet, "compose", tmp_path / "out")
    document = yaml.safe_load((tmp_path / "out" / "compose.yaml").read_text())
    check_compose(document)
    services = document["services"]
    assert sorted(understood(service["command"]) for service in services.values()) == roles(fleet)
    role = fleet.listener[0]
    for name, service in services.items():
        assert ("ports" in service) == (name == role and fleet.keys is not None)
        if service["command"][0] not in (role, "router"):
            assert service["command"][service["command"].index("--connect") + 1].endswith(f"/{role}:7447")
        for source in (volume.split(":")[0] for volume in service["volumes"]):
            assert (tmp_path / "out" / source).exists(), source
    if fleet.keys is not None:
        for folder in (tmp_path / "out" / "keys").iterdir():
            assert str(credentials.load(folder).identity) == folder.name
        assert (
            role
            in credentials.load(
                tmp_path / "out" / "keys" / ("router.main" if fleet.router else "learner.learner")
            ).hosts
        )
    order = ["router", "learner", "elite", "rollout"]
    place = {name: order.index(name.split("-")[0]) for name in services}
    for name, service in services.items():
        assert set(service.get("depends_on", [])) == {other for other in services if place[other] < place[name]}
        asked = service["healthcheck"]["test"]
        assert asked[asked.index("--connect") + 1].endswith("/127.0.0.1:7447" if name == role else f"/{role}:7447")
    for key, wrong in (("restart", 3), ("volumes", "run"), ("helthcheck", {})):
        with pytest.raises(jsonschema.ValidationError):
            check_compose({**document, "services": {"learner": {**services["learner"], key: wrong}}})


def manifests(folder: Path) -> list[dict[str, Any]]:
    """Return every object that was written."""
    return [found for path in sorted(folder.glob("*.yaml")) for found in yaml.safe_load_all(path.read_text())]


@pytest.mark.parametrize("version", VERSIONS)
def test_manifests_are_what_kubernetes_takes(fleet, tmp_path, version):
    """Every object passes the schemas of several versions of Kubernetes, strictly."""
    render(fleet, "kubernetes", tmp_path / "out")
    for found in manifests(tmp_path / "out"):
        kubernetes_validate.validate(found, version, strict=True)
    found["spec"] = {"replicaz": 1}
    with pytest.raises(kubernetes_validate.ValidationError):
        kubernetes_validate.validate({**found, "apiVersion": "apps/v1", "kind": "Deployment"}, version, strict=True)


def test_manifests_start_the_fleet(fleet, tmp_path):
    """A StatefulSet with a volume for the learner, Deployments for the others, Secrets and Services that fit them."""
    render(fleet, "kubernetes", tmp_path / "out")
    objects = {(found["kind"], found["metadata"]["name"]): found for found in manifests(tmp_path / "out")}
    assert len(objects) == len(manifests(tmp_path / "out"))
    workloads = [found for (kind, _), found in objects.items() if kind in ("Deployment", "StatefulSet")]
    started = []
    for found in workloads:
        spec, pod = found["spec"], found["spec"]["template"]["spec"]
        (container,) = pod["containers"]
        arguments = [word.replace("$(POD_NAME)", "pod-1") for word in container["args"]]
        started += [understood(arguments)] * spec["replicas"]
        assert (found["kind"] == "StatefulSet") == (arguments[0] == "learner") == ("volumeClaimTemplates" in spec)
        assert spec["selector"]["matchLabels"].items() <= spec["template"]["metadata"]["labels"].items()
        assert "eia-sec alive" in " ".join(container["livenessProbe"]["exec"]["command"])
        mounted = {
            mount["name"] for part in (container, *pod.get("initContainers", [])) for mount in part["volumeMounts"]
        }
        claimed = {claim["metadata"]["name"] for claim in spec.get("volumeClaimTemplates", [])}
        assert mounted == {volume["name"] for volume in pod["volumes"]} | claimed
        for volume in pod["volumes"]:
            if "secret" in volume:
                assert ("Secret", volume["secret"]["secretName"]) in objects
        if arguments[0] == "learner":
            assert container["resources"]["limits"] == {"nvidia.com/gpu": 1}
        for part in (container, *pod.get("initContainers", [])):
            assert part["imagePullPolicy"] == "IfNotPresent"
    assert sorted(started) == roles(fleet)
    name = f"field-1-{fleet.listener[0]}"
    assert chosen_by(objects["Service", name], workloads) == [name]
    assert "clusterIP" not in objects["Service", name]["spec"]
    assert from_toml(objects["ConfigMap", "field-1-config"]["data"]["config.toml"], RunConfig()) == fleet.config
    if fleet.keys is not None:
        certificate = base64.b64decode(objects["Secret", f"{name}-keys"]["data"]["cert.pem"])
        (tmp_path / "cert.pem").write_bytes(certificate)
        assert name in credentials.hosts_of(credentials.read_certificate(tmp_path / "cert.pem"))
        assert stat.S_IMODE((tmp_path / "out" / "secrets.yaml").stat().st_mode) == 0o600
        assert "PRIVATE KEY" not in (tmp_path / "out" / "fleet.yaml").read_text()


def chosen_by(service: dict[str, Any], workloads: list[dict[str, Any]]) -> list[str]:
    """Return the names of the workloads whose pods a Service chooses."""
    wanted = service["spec"]["selector"].items()
    return [w["metadata"]["name"] for w in workloads if wanted <= w["spec"]["template"]["metadata"]["labels"].items()]


def test_each_stateful_set_has_its_headless_service(fleet, tmp_path):
    """The Service that a StatefulSet names is among the rendered ones, headless, and chooses its pods alone."""
    render(fleet, "kubernetes", tmp_path / "out")
    found = manifests(tmp_path / "out")
    services = {entry["metadata"]["name"]: entry for entry in found if entry["kind"] == "Service"}
    workloads = [entry for entry in found if entry["kind"] in ("Deployment", "StatefulSet")]
    (learner,) = [entry for entry in workloads if entry["kind"] == "StatefulSet"]
    governing = services[learner["spec"]["serviceName"]]
    assert governing["spec"]["clusterIP"] == "None"
    assert chosen_by(governing, workloads) == [learner["metadata"]["name"]]
    assert len(services) == 2


def sharing(fleet: FleetSpec) -> FleetSpec:
    """Return a fleet whose transitions go through memory."""
    return replace(fleet, network=replace(fleet.network, shared_memory=True))


def test_containers_that_share_memory_have_the_same_shm(fleet, tmp_path):
    """Processes that share memory mount the same tmpfs at /dev/shm; no other process does."""
    render(sharing(fleet), "compose", tmp_path / "out")
    document = yaml.safe_load((tmp_path / "out" / "compose.yaml").read_text())
    check_compose(document)
    mounting = {name for name, service in document["services"].items() if "--shared-memory" in service["command"]}
    assert mounting == set(document["services"]) - {"elite"}
    mounts = {
        name: [volume["source"] for volume in service["volumes"] if isinstance(volume, dict)]
        for name, service in document["services"].items()
    }
    (volume,) = document["volumes"]
    assert mounts == {name: [volume] if name in mounting else [] for name in document["services"]}
    targets = [v["target"] for s in document["services"].values() for v in s["volumes"] if isinstance(v, dict)]
    assert set(targets) == {"/dev/shm"}
    assert document["volumes"][volume]["driver_opts"]["type"] == "tmpfs"


def test_without_the_option_nothing_is_shared(fleet, tmp_path):
    """Containers keep their own /dev/shm, and the file names no volume."""
    render(fleet, "compose", tmp_path / "out")
    text = (tmp_path / "out" / "compose.yaml").read_text()
    assert "/dev/shm" not in text
    assert "volumes" not in yaml.safe_load(text)


def test_pods_do_not_share_memory(fleet, tmp_path):
    """A fleet whose transitions go through memory is refused for Kubernetes, before anything is written."""
    with pytest.raises(ConfigError, match=r"pods do not share memory; remove network\.shared_memory"):
        render(sharing(fleet), "kubernetes", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_containers_without_certificates_need_a_word(tmp_path):
    """A fleet that trains on one machine without certificates is not put into containers unless that is meant."""
    (tmp_path / "fleet.toml").write_text('[learner]\nhost = "a"\n[hosts.a]\nhost = "local"\n')
    for form in ("compose", "kubernetes"):
        with pytest.raises(ConfigError, match="insecure = true"):
            render(read(tmp_path / "fleet.toml"), form, tmp_path / "out")


@pytest.mark.parametrize("form", ["systemd", "compose", "kubernetes"])
def test_a_learner_that_moves_begins_nothing_anew(fleet, tmp_path, form, capsys):
    """A unit for another host only resumes, also when it is rendered again; each form says where the run is."""
    out = tmp_path / "out"
    command = ["render", form, str(fleet.path), "--out", str(out)]
    assert fleet_command(command) == 0
    assert "the learner keeps run field_1 in" in capsys.readouterr().out
    if form != "systemd":
        return
    unit = "eia-sec-field_1-learner.learner.service"
    assert " --resume-if-any " in (out / "farm-1" / unit).read_text()
    text = fleet.path.read_text()
    fleet.path.write_text(re.sub(r'(\[learner\]\s+host = )"farm-1"', r'\1"farm-2"', text))
    assert fleet_command(command) == 0
    said = capsys.readouterr().out
    assert "the learner moves from farm-1 to farm-2: stop the fleet, copy /var/lib/eia-sec/field_1/run there" in said
    (out / "farm-1" / unit).unlink()
    assert fleet_command(command) == 0
    (line,) = re.findall(r"^ExecStart=(.*)$", (out / "farm-2" / unit).read_text(), re.MULTILINE)
    assert " --resume " in line
    assert "--resume-if-any" not in line
    assert understood(line.split()[1:]) == "learner"
    with pytest.raises(RunDirError, match="holds no run to resume"):
        RunDirectory(tmp_path / "empty").prepare(RunConfig(), resume=True)


@pytest.mark.parametrize("form", ["systemd", "compose"])
def test_what_a_removed_worker_left_is_named(fleet, tmp_path, form, capsys):
    """Its unit would be installed by the page's command; its keys are of no use any more."""
    command = ["render", form, str(fleet.path), "--out", str(tmp_path / "out")]
    (tmp_path / "out" / "farm-2").mkdir(parents=True)
    (tmp_path / "out" / "farm-2" / "eia-sec-field_1-b-rollout.farm-2-1.service").write_text("of another run")
    other = {"systemd": "compose", "compose": "systemd"}[form]
    assert fleet_command(["render", other, *command[2:]]) == 0
    assert fleet_command(command) == 0
    assert "no longer" not in capsys.readouterr().out
    fleet.path.write_text(fleet.path.read_text().replace("workers = 2", "workers = 1"))
    assert fleet_command(command) == 0
    said = [line for line in capsys.readouterr().out.splitlines() if line.startswith("no longer in the fleet; ")]
    unit, keys = "farm-2/eia-sec-field_1-rollout.farm-2-1.service", "keys/rollout.farm-2-1"
    left = [unit] if form == "systemd" else [keys] if fleet.keys else []
    assert [line.rpartition(": ")[2] for line in said] == [str(tmp_path / "out" / name) for name in left]


@pytest.mark.parametrize("form", ["compose", "kubernetes"])
def test_a_container_gets_the_accelerator_that_its_learner_uses(fleet, tmp_path, form):
    """A device without a GPU for the container is refused, and a GPU that nobody would use, too."""
    text = fleet.path.read_text()
    mistakes = (("gpus = 1", "gpus = 0", "set gpus = 1 in"), ("cuda", "cpu", "set learner.device = cuda in"))
    for old, new, said in mistakes:
        fleet.path.write_text(text.replace(old, new))
        with pytest.raises(ConfigError, match=said):
            render(read(fleet.path), form, tmp_path / "out")
    assert not (tmp_path / "out").exists()


MARKS = ("a: b", "- a", "{a: 1}", "&a", "*a", "!!python/object:os.system", "'", '"', "#", "%", "|")
ODD_TEXTS = (*MARKS, "a\n- b", "\n", " a\n  b\n", "é\x85", "\t", "\0", "null", "1e3", "")


@pytest.mark.parametrize("text", ODD_TEXTS)
def test_no_text_becomes_yaml(text):
    """Whatever a text holds, a YAML reader finds that text and nothing beside it."""
    document = {"image": text, "list": [text, text], text: {"a": text}}
    assert yaml.safe_load(as_yaml([document])) == document


@pytest.mark.parametrize("image", ["a\nprivileged: true", "a: b", "a #", "$HOME", "${HOME}", "a b", "", "-a", "'a'"])
def test_an_image_is_a_name_and_nothing_more(fleet, image):
    """A fleet file whose image would add to a manifest, or would be replaced by a variable, is refused."""
    text = f"{fleet.path.read_text()}[containers]\nimage = {json.dumps(image)}\n"
    fleet.path.write_text(text)
    with pytest.raises(ConfigError, match=r"containers\.image"):
        read(fleet.path)


def test_several_learners_request_what_they_need(fleet, tmp_path):
    """A pod with two learners asks for twice the processors and memory of one."""
    render(replace(fleet, learner=replace(fleet.learner, learners=2)), "kubernetes", tmp_path / "out")
    sets = [found for found in manifests(tmp_path / "out") if found["kind"] == "StatefulSet"]
    (container,) = sets[0]["spec"]["template"]["spec"]["containers"]
    assert container["resources"]["requests"] == {"cpu": "1000m", "memory": "2Gi"}
