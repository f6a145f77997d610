"""Fleet files: what they say is what is started, and a mistake is one sentence that names the place."""

import dataclasses
import re
import tomllib
from pathlib import Path
from typing import Any

import pytest

from eia_sec.common.config.presets import PRESETS
from eia_sec.common.errors import ConfigError, CredentialsError
from eia_sec.common.transport import credentials
from eia_sec.common.transport.credentials import Identity
from eia_sec.deploy.hosts import operations
from eia_sec.deploy.hosts.fleet_file import Containers, Coordinator, Host, LearnerSpec, Network, Router, Training, read
from eia_sec.deploy.hosts.plan import here, processes
from eia_sec.deploy.hosts.render import render
from eia_sec.deploy.options import PRESET_HELP

ROOT = Path(__file__).resolve().parents[3]
EXAMPLE = ROOT / "deploy" / "fleet.toml"
SMALL = '[learner]\nhost = "a"\n[hosts.a]\nhost = "local"\nworkers = 1\n'


def written(folder: Path, text: str) -> Path:
    path = folder / "fleet.toml"
    path.write_text(text)
    return path


def test_the_example_names_every_key_and_its_default():
    """Each key of each table stands in the example with a comment, and the defaults named there are the real ones."""
    table = tomllib.loads(EXAMPLE.read_text())
    sections: dict[str, tuple[type[Any], dict[str, Any]]] = {
        "training": (Training, table["training"]),
        "network": (Network, table["network"]),
        "router": (Router, table["router"]),
        "learner": (LearnerSpec, table["learner"]),
        "coordinator": (Coordinator, table["coordinator"]),
        "hosts.farm-1": (Host, table["hosts"]["farm-1"]),
        "containers": (Containers, table["containers"]),
    }
    for kind, held in sections.values():
        assert set(held) == {field.name for field in dataclasses.fields(kind)}
    place = ""
    for line in EXAMPLE.read_text().splitlines():
        if line.startswith("["):
            place = line[1 : line.index("]")]
        stated = re.match(r'(\w+) = .*default: ("[^"]*"|\d+|true|false)', line)
        if stated and place in sections:
            assert getattr(sections[place][0](), stated[1]) == tomllib.loads(f"x = {stated[2]}")["x"], line


@pytest.mark.parametrize("preset", PRESETS)
def test_every_preset_is_named_where_one_is_chosen(preset):
    """The help of the commands that take one, and the fleet file, list all of them."""
    (line,) = [line for line in EXAMPLE.read_text().splitlines() if line.startswith("preset =")]
    stated = [PRESET_HELP, line.partition("#")[2]]
    assert all(re.search(rf"\b{preset}\b", text.partition("; default")[0]) for text in stated)


def test_the_example_becomes_command_lines():
    """Router, learner, coordinator and ten workers come out of it, each with its own certificate."""
    fleet = read(EXAMPLE)
    found = {str(process.identity): process for process in processes(fleet, here(fleet))}
    assert len(found) == 13
    assert {process.host for process in found.values()} == {"farm-1", "farm-2"}
    for identity, process in found.items():
        words = list(process.arguments)
        assert words[words.index("--tls") + 1] == f"keys/{identity}"
        assert ("--listen" in words) == (process.role == "router")
    learner = found["learner.learner"].arguments
    assert "--resume-if-any" in learner
    assert "--preset" not in learner
    assert "farm-2-7" in found["rollout.farm-2-7"].arguments


def test_without_a_router_the_learner_listens(tmp_path):
    """The smallest file has a learner that listens on loopback, a coordinator beside it, and workers."""
    fleet = read(written(tmp_path, SMALL))
    router, *others = processes(fleet, here(fleet))
    assert router.arguments[:5] == ("learner", "--run", "farm", "--listen", "tcp/127.0.0.1:7447")
    assert [str(process.identity) for process in others] == ["elite.coordinator", "rollout.a-0"]
    assert fleet.listener == ("learner", "learner")


def test_several_learners_are_the_learners_option(tmp_path):
    """The fleet's one learner process starts the others itself."""
    fleet = read(written(tmp_path, SMALL.replace("learner]", "learner]\nlearners = 2")))
    learner, *others = processes(fleet, here(fleet))
    assert learner.arguments[learner.arguments.index("--learners") + 1] == "2"
    assert len(others) == 2


SITES = """[router]
host = "a"
[network]
endpoint = "tls/farm:7447"
keys = "k"
[sites.barn]
host = "b"
endpoint = "tls/barn:7500"
names = ["10.0.0.7"]
[hosts.b]
host = "local"
folder = "b"
workers = 2
site = "barn"
"""


def test_a_site_has_a_router_for_its_hosts(tmp_path):
    """Its workers connect to it, and it to the main router; everybody else stays with that."""
    fleet = read(written(tmp_path, SMALL + SITES))
    found = {process.label: process for process in processes(fleet, here(fleet))}
    words = {name: dict(zip(one.arguments, one.arguments[1:], strict=False)) for name, one in found.items()}
    assert (words["site.barn"]["--listen"], words["site.barn"]["--connect"]) == ("tls/0.0.0.0:7500", "tls/farm:7447")
    assert words["site.barn"]["--tls"] == "keys/site.barn"
    met = {name: given.get("--connect") for name, given in words.items() if name != "site.barn"}
    main, site = (
        dict.fromkeys(("learner.learner", "elite.coordinator", "rollout.a-0"), "tls/farm:7447"),
        "tls/barn:7500",
    )
    assert met == main | dict.fromkeys(("rollout.b-0", "rollout.b-1"), site) | {"router.main": None}
    assert Identity("site", "barn") in operations.issue_keys(fleet, 30)
    assert {"barn", "10.0.0.7"} <= set(operations.served_names(fleet, Identity("site", "barn")))
    wider = read(written(tmp_path, SMALL + SITES.replace("10.0.0.7", "10.0.0.8")))
    assert operations.issue_keys(wider, 30) == [Identity("site", "barn")]
    with pytest.raises(ConfigError, match="containers are all at one place"):
        render(fleet, "compose", tmp_path / "rendered")


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('[router]\nhost = "a"\n', "", r"add \[router\]"),
        ('endpoint = "tls/barn:7500"\n', "", r"sites.barn.endpoint must say where"),
        ("tls/barn:7500", "nowhere", "nowhere"),
        ("tls/barn:7500", "tls/farm:7447", "sites.barn.endpoint is that of the main router"),
        (
            '[sites.barn]\nhost = "b"\nendpoint = "tls/barn:7500"',
            '[sites.barn]\nhost = "a"\nendpoint = "tls/a:7448"',
            "two ports",
        ),
        ('site = "barn"', 'site = "shed"', r"hosts.b.site must be one of the sites \(barn\), not 'shed'"),
        ('[sites.barn]\nhost = "b"', '[sites.barn]\nhost = "c"', "sites.barn.host must be one of the hosts a, b"),
    ],
)
def test_a_mistake_about_sites_is_named(tmp_path, old, new, said):
    """Before anything starts."""
    assert old in SITES
    with pytest.raises(ConfigError, match=said):
        read(written(tmp_path, SMALL + SITES.replace(old, new)))


def test_shared_memory_is_for_those_that_move_transitions(tmp_path):
    """Router, learner and workers get the option; the coordinator has nothing to do with transitions."""
    text = SMALL + '[router]\nhost = "a"\n[network]\nshared_memory = true\n'
    fleet = read(written(tmp_path, text))
    stated = {process.role for process in processes(fleet, here(fleet)) if "--shared-memory" in process.arguments}
    assert stated == {"router", "learner", "rollout"}
    assert not any("--shared-memory" in process.arguments for process in processes(read(EXAMPLE), here(read(EXAMPLE))))


def test_training_is_resolved(tmp_path):
    """Preset, file and single values go over one another, and paths are relative to the fleet file."""
    (tmp_path / "mine.toml").write_text("episodes = 9\nseed = 3\n")
    fleet = read(
        written(tmp_path, SMALL + '[training]\npreset = "quick"\nconfig = "mine.toml"\nset = ["episodes = 5"]\n')
    )
    assert (fleet.config.episodes, fleet.config.seed, fleet.config.algorithm.hidden) == (5, 3, 128)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("run =", "not valid TOML"),
        ("run = " + "[" * 5000, "not valid TOML"),
        ("run = 1" + "0" * 5000, "not valid TOML"),
        (SMALL + 'command = "/srv/it\'s/eia-sec"\n', "hosts.a.command .* has an unclosed quote"),
        (SMALL + 'command = " "\n', "hosts.a.command is empty"),
        (SMALL + 'command = "+eia-sec"\n', "does not begin with a program's name or path"),
        (SMALL + "command = \"eia-sec 'a\\nUser=root'\"\n", "hosts.a.command .* holds a line end"),
        (SMALL + 'folder = "a\\u001b[2J"\n', "hosts.a.folder .* control character"),
        (SMALL + 'ssh = ["-p", "2\\n2"]\n', "hosts.a.ssh .* holds a line end"),
        (SMALL + '[containers]\nimage = "a\\nprivileged: true"\n', "containers.image .* holds a line end"),
        (SMALL + '[containers]\nimage = "a: b"\n', "containers.image 'a: b' is not of the form"),
        (SMALL + '[containers]\nimage = "${HOME}"\n', "containers.image .* is not of the form"),
        (SMALL + '[containers]\nstorage = "10Gi}"\n', "containers.storage .* is not of the form of 10Gi"),
        (SMALL + '[containers]\nstorage_class = "A b"\n', "containers.storage_class"),
        ("", "the file has no host"),
        (SMALL + "[trainer]\n", "unknown key 'trainer' at the top"),
        (SMALL + "worker = 2\n", r"unknown key 'worker' in \[hosts.a\]; the keys are host, ssh"),
        (SMALL.replace("= 1", '= "1"'), "hosts.a.workers must be a whole number, not '1'"),
        (SMALL.replace("= 1", "= true"), "hosts.a.workers must be a whole number"),
        (SMALL.replace("= 1", "= 5000"), "hosts.a.workers must be 0 to 1024"),
        (SMALL.replace("learner]", "learner]\ngpus = -1"), "learner.gpus"),
        (SMALL.replace("learner]", "learner]\nlearners = 0"), "learners"),
        (
            SMALL.replace("learner]", "learner]\nlearners = 2") + '[training]\npreset = "eia-sec"\n',
            "eia-sec learns from a replay buffer",
        ),
        (SMALL + '[training]\nset = ["population.members=2"]\n', r"no table \[population.member-0\] says where"),
        (SMALL + 'member = "member-0"\n', r"hosts.a.member must be a member of the population \(none\)"),
        (SMALL.replace('= "a"', '= "b"'), "learner.host must be one of the hosts a, not 'b'"),
        (SMALL + '[router]\nhost = "c"\n', "router.host"),
        (SMALL + '[hosts."a b"]\n', "'a b' must be"),
        (SMALL + '[hosts.b]\nhost = "-oProxyCommand=x"\n', "must be 'local', HOST or USER@HOST"),
        (SMALL + '[hosts.b]\nssh = "-p 22"\n', "hosts.b.ssh must be a list of texts"),
        (SMALL + '[hosts.b]\nstart = "cron"\n', "must be 'detached' or 'systemd', not 'cron'"),
        (SMALL + '[hosts.b]\nhost = "local"\nfolder = "runs/farm/a"\n', "two hosts use the same folder"),
        ("hosts = 3\n", r"must be a section \[hosts\]"),
        (SMALL + '[network]\nendpoint = "tls/farm:7447"\n', "network.endpoint needs TLS"),
        (SMALL + '[network]\nendpoint = "tcp/farm:7447"\n', "insecure = true"),
        (SMALL + '[network]\nendpoint = "farm"\n', "not an endpoint"),
        (SMALL + '[training]\npreset = "huge"\n', "no preset 'huge'"),
        (SMALL + '[training]\nset = ["episodes = 0"]\n', "episodes and steps are both 0"),
        (SMALL + '[training]\nset = ["farm.battery.power = 9.0"]\n', "no effect while farm.battery.capacity is 0"),
        (SMALL + '[training]\nset = ["algorithm.hidden = 4096"]\n', "lower algorithm.hidden"),
        (SMALL + '[training]\nconfig = "none.toml"\n', "none.toml cannot be read"),
    ],
)
def test_mistakes_name_the_place(tmp_path, text, said):
    """Every mistake is reported in one sentence with the file and the place, before anything starts."""
    path = written(tmp_path, text)
    with pytest.raises(ConfigError, match=said) as refusal:
        read(path)
    assert str(refusal.value).startswith(str(path))
    assert "\n" not in str(refusal.value)


def test_a_command_is_split_by_the_shells_rules(tmp_path):
    """Wherever it is called, a path with blanks is one word."""
    fleet = read(written(tmp_path, SMALL + "command = \"'/usr/local/eia sec/bin/eia-sec' -v\"\n"))
    assert fleet.hosts["a"].words == ["/usr/local/eia sec/bin/eia-sec", "-v"]
    units = render(fleet, "systemd", tmp_path / "units")
    service = next(path for path in units if "rollout" in path.name)
    assert 'ExecStart="/usr/local/eia sec/bin/eia-sec" -v rollout' in service.read_text()


def test_an_endpoint_of_ipv6_is_listened_at_by_ipv6(tmp_path):
    """Without another word the listener is where the others look for it."""
    text = '[network]\nendpoint = "tcp/[2001:db8::1]:7447"\ninsecure = true\n'
    assert read(written(tmp_path, SMALL + text)).network.listen == "tcp/[::]:7447"
    assert read(written(tmp_path, SMALL + text.replace("[2001:db8::1]", "farm"))).network.listen == "tcp/0.0.0.0:7447"


def test_keys_are_made_for_everybody_once(tmp_path):
    """Every process gets a certificate of its own, the router's serves under every name, and nothing is made twice."""
    text = SMALL + '[router]\nhost = "a"\n[network]\nendpoint = "tls/farm:7447"\nkeys = "k"\nnames = ["10.0.0.1"]\n'
    fleet = read(written(tmp_path, text))
    with pytest.raises(CredentialsError, match="cannot be read"):
        operations.request_of(fleet, "a")
    made = {str(identity) for identity in operations.issue_keys(fleet, 30)}
    assert made >= {"router.main", "learner.learner", "elite.coordinator", "rollout.a-0", "monitor.monitor"}
    assert operations.issue_keys(fleet, 30) == []
    (router,) = [process.identity for process in processes(fleet, here(fleet)) if process.role == "router"]
    assert {"farm", "10.0.0.1", "router", "farm-router"} <= set(operations.served_names(fleet, router))
    request = operations.request_of(fleet, "a")
    assert "keys/router.main/members.txt" in request["files"]
    assert not any("ca.key" in name for name in request["files"])
    assert "BEGIN PRIVATE KEY" not in str(request["processes"])


def test_a_new_name_of_the_listener_renews_its_certificate(tmp_path):
    """The certificate serves the new names and addresses besides the old ones, and nobody else gets another one."""
    text = SMALL + '[router]\nhost = "a"\n[network]\nendpoint = "tls/farm:7447"\nkeys = "k"\nnames = ["10.0.0.1"]\n'
    operations.issue_keys(read(written(tmp_path, text)), 30)
    more = read(written(tmp_path, text.replace('"10.0.0.1"', '"[2001:db8::1]", "barn.local"')))
    assert [str(identity) for identity in operations.issue_keys(more, 30)] == ["router.main"]
    served = credentials.load(tmp_path / "k" / "router.main").hosts
    assert {"farm", "10.0.0.1", "2001:db8::1", "barn.local"} <= set(served)
    assert operations.issue_keys(more, 30) == []


def test_a_new_member_restarts_the_router_alone(tmp_path):
    """One more worker changes only the router's request, because the router holds the list of members."""
    text = SMALL + '[router]\nhost = "a"\n[network]\nkeys = "k"\n'
    before = read(written(tmp_path, text))
    operations.issue_keys(before, 30)
    old = operations.request_of(before, "a")["processes"]
    after = read(written(tmp_path, text.replace("workers = 1", "workers = 2")))
    operations.issue_keys(after, 30)
    new = operations.request_of(after, "a")["processes"]
    assert {name for name in old if old[name] != new[name]} == {"router.main"}
    assert set(new) - set(old) == {"rollout.a-1"}
