"""Collected histories: each host's own files are written, and nothing else."""

import gzip
import io
import os
import subprocess
import sys
import tarfile
from pathlib import Path

import pytest

from eia_sec.common.config import RunConfig
from eia_sec.common.errors import ConfigError, HostError, UsageError
from eia_sec.deploy.cli import dispatch
from eia_sec.deploy.hosts import archive as archives
from eia_sec.deploy.hosts import history_collection, operations, remote
from eia_sec.deploy.hosts.archive import unpack
from eia_sec.deploy.hosts.fleet_file import FleetRun, FleetSpec, Host, LearnerSpec, read
from eia_sec.deploy.hosts.history_collection import own_names, pack
from eia_sec.deploy.hosts.remote import Link

RUN = FleetRun("farm", LearnerSpec("one"), RunConfig())
FLEET = FleetSpec(learner=RUN.learner, hosts={"one": Host(), "one-1": Host()}, runs=(RUN,))


def archive(*entries, **options):
    """Return an archive of (name, data) or of ready entries."""
    packed = io.BytesIO()
    with tarfile.open(fileobj=packed, mode="w:gz", **options) as file:
        for entry in entries:
            if isinstance(entry, tarfile.TarInfo):
                file.addfile(entry)
                continue
            name, data = entry
            info = tarfile.TarInfo(name)
            info.size = len(data)
            file.addfile(info, io.BytesIO(data))
    return packed.getvalue()


def brought(tmp_path, data, host="one"):
    """Unpack what a host sent; return the files that are there then, and what was left out."""
    (tmp_path / "history").mkdir(exist_ok=True)
    files, left_out = unpack(io.BytesIO(data), tmp_path, own_names(FLEET, host))
    found = {path.relative_to(tmp_path).as_posix(): path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    assert len(found) == files
    return found, left_out


def test_what_is_packed_comes_out(tmp_path):
    """Histories, metrics, configuration and policy, as far as they are there, also of more than one piece."""
    run = tmp_path / "far" / "run"
    (run / "history").mkdir(parents=True)
    wanted = {
        "history/learner.jsonl": b"[1]\n",
        "history/rollout-one-0.jsonl": os.urandom(3 * archives.PIECE // 2),
        "metrics.jsonl": b"",
        "policy.safetensors": bytes(513),
    }
    for name, data in wanted.items():
        (run / name).write_bytes(data)
    (run / "history" / "notes.txt").write_text("no history")
    packed = io.BytesIO()
    pack(tmp_path / "far", packed)
    (tmp_path / "near").mkdir()
    assert brought(tmp_path / "near", packed.getvalue()) == (wanted, [])


def test_a_host_reports_its_own_workers_and_the_learners_host_of_the_learner(tmp_path):
    """Others' files are left out and named: where the learner once was, nothing can overwrite its present files."""
    names = ("history/learner.jsonl", "metrics.jsonl", "history/rollout-one-0.jsonl", "history/rollout-one-1-0.jsonl")
    data = archive(*((name, name.encode()) for name in names))
    assert brought(tmp_path, data, "one-1") == ({names[3]: names[3].encode()}, list(names[:3]))
    (tmp_path / names[3]).unlink()
    found, left_out = brought(tmp_path, data, "one")
    assert (sorted(found), left_out) == (sorted(names[:3]), [names[3]])


@pytest.mark.parametrize("name", ["../outside", "/etc/passwd", "history/../../outside", "config.toml/x", "x" * 90, ""])
def test_no_name_leads_outside(tmp_path, name):
    """Only names that are expected are written."""
    inside = tmp_path / "inside"
    inside.mkdir()
    assert brought(inside, archive((name, b"x"))) == ({}, [name])
    assert sorted(path.name for path in tmp_path.iterdir()) == ["inside"]


def link_to(target):
    entry = tarfile.TarInfo("config.toml")
    entry.type, entry.linkname = tarfile.SYMTYPE, target
    return entry


LONG = tarfile.TarInfo("metrics.jsonl")
LONG.pax_headers = {"comment": "x" * 100_000}


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (archive(link_to("/etc/passwd")), "not a regular file"),
        (archive(LONG, format=tarfile.PAX_FORMAT), "not a regular file"),
        (archive(("config.toml", b"1"), ("config.toml", b"2")), "twice"),
        (archive(("config.toml", bytes(5000)))[:-30], "incomplete or malformed"),
        (gzip.compress(gzip.decompress(archive(("config.toml", bytes(5000))))[:3000]), "incomplete or malformed"),
        (gzip.compress(b"x" * 512), "incomplete or malformed"),
        (b"ssh banner", "incomplete or malformed"),
        (b"", "incomplete or malformed"),
    ],
)
def test_what_is_no_archive_of_ours_is_refused(tmp_path, data, said):
    """Links, headers of any length, names that come twice and archives that end too early."""
    with pytest.raises(HostError, match=said):
        brought(tmp_path, data)
    assert not [path for path in tmp_path.iterdir() if path.is_symlink()]


@pytest.mark.parametrize(("name", "limit"), [("MAX_UNPACKED", 1500), ("MAX_FILES", 1)])
def test_what_unpacks_to_too_much_is_refused(tmp_path, monkeypatch, name, limit):
    """By bytes and by files, before they are written."""
    monkeypatch.setattr(archives, name, limit)
    with pytest.raises(HostError, match="more than"):
        brought(tmp_path, archive(("config.toml", bytes(1000)), ("metrics.jsonl", bytes(1000))))
    assert not (tmp_path / "metrics.jsonl").exists()


def one_host(tmp_path):
    """Return a fleet with one host, this machine."""
    path = tmp_path / "fleet.toml"
    path.write_text('[learner]\nhost = "one"\n[hosts.one]\nhost = "local"\nworkers = 1\n')
    return read(path)


def test_a_target_that_cannot_be_written_is_one_sentence(tmp_path):
    """A file where the folder should be is the user's mistake; a full disk is reported with the host."""
    fleet = tmp_path / "fleet.toml"
    fleet.write_text(
        'run = "test"\n[network]\nendpoint = "tcp/127.0.0.1:7447"\n[learner]\nhost = "one"\n'
        '[hosts.one]\nhost = "local"\n'
    )
    (tmp_path / "out").write_text("a file")
    with pytest.raises(ConfigError, match="cannot be made"):
        history_collection.collect(read(fleet), tmp_path / "out")
    (tmp_path / "history").mkdir()
    (tmp_path / "config.toml").mkdir()
    with pytest.raises(HostError, match="cannot be written: Is a directory"):
        unpack(io.BytesIO(archive(("config.toml", b"1"))), tmp_path, own_names(FLEET, "one"))


def test_no_link_in_the_target_is_followed(tmp_path):
    """A linked folder is the user's to remove, and a linked file is replaced: what a host sends stays in the target."""
    target, outside = tmp_path / "target", tmp_path / "outside"
    for folder in (target, outside):
        folder.mkdir()
    (outside / "learner.jsonl").write_text("mine")
    (target / "history").symlink_to(outside)
    (target / "config.toml").symlink_to(outside / "learner.jsonl")
    own = own_names(FLEET, "one")
    with pytest.raises(UsageError, match="history is a symbolic link"):
        unpack(io.BytesIO(archive(("history/learner.jsonl", b"theirs"))), target, own)
    assert unpack(io.BytesIO(archive(("config.toml", b"theirs"))), target, own) == (1, [])
    assert (target / "config.toml").read_bytes() == b"theirs"
    assert [(path.name, path.read_text()) for path in outside.iterdir()] == [("learner.jsonl", "mine")]


STATE = {"keeper": 1, "processes": {}, "alarms": [], "holds": "run", "members": {"member-0": "run"}}
STATE |= {"over": ["x"], "alive": ["y"]}


@pytest.mark.parametrize(
    "change",
    [
        {"keeper": "1"},
        {"processes": []},
        {"processes": {"a": 1}},
        {"processes": {"a": {"state": 3, "pid": 1, "deaths": 0, "since": 0}}},
        {"processes": {"a": {"state": "x", "pid": "1", "deaths": 0, "since": 0}}},
        {"alarms": [1]},
        {"holds": "much"},
        {"members": []},
        {"members": {"member-0": ["run"]}},
        {"over": 5},
        {"over": [1]},
        {"alive": 5},
        {"alive": [1]},
    ],
)
def test_a_host_that_answers_nonsense_failed(tmp_path, monkeypatch, change):
    """The state of such a host is unknown, in one sentence, and the command goes on."""
    answers = iter([dict(STATE), STATE | change, {}])
    monkeypatch.setattr(Link, "call", lambda link, verb, request, seconds=0.0: next(answers))
    assert operations.status(one_host(tmp_path)) == ({"one": STATE}, {})
    for _ in range(2):
        states, failed = operations.status(one_host(tmp_path))
        assert (states, failed) == ({}, {"one": "one: its answer is not the state of a host."})


def test_what_a_host_reports_commands_no_terminal(tmp_path, monkeypatch, capsys):
    """Names, states, alarms and lines of logs are printed without control characters."""
    process = {"state": "up\x1b[2J", "pid": 1, "deaths": 0, "since": 0, "code": None}
    state = {"keeper": 1, "holds": "run", "processes": {"rollout.\x1b[2J": process}, "alarms": ["bad\x1b[2J"]}
    answers = {"status": state, "logs": {"a\x1b[2J": "line\x1b[2J\nnext\tline"}}
    monkeypatch.setattr(Link, "call", lambda link, verb, request, seconds=0.0: answers[verb])
    fleet = one_host(tmp_path)
    dispatch(["status", str(fleet.path)])
    dispatch(["logs", str(fleet.path)])
    printed = capsys.readouterr().out
    assert "\x1b" not in printed
    assert "bad?[2J" in printed
    assert "line?[2J\nnext    line" in printed


def host_that(monkeypatch, program):
    """Return a link to a host whose answer is what a line of Python writes."""
    monkeypatch.setattr(Link, "_command", lambda link, verb: [sys.executable, "-c", f"import sys, time; {program}"])
    return Link("far", Host(host="far"), Path(), Path())


def test_an_answer_without_end_is_cut_off(monkeypatch):
    """It is not held in memory, and the host is not waited for."""
    link = host_that(monkeypatch, "[sys.stdout.write('x' * 65536) for _ in iter(int, 1)]")
    with pytest.raises(HostError, match="far: its answer is longer than 1000000 bytes"):
        link.fetch("status", most=1_000_000)
    link = host_that(monkeypatch, "[sys.stderr.write('x' * 65536) for _ in iter(int, 1)]")
    with pytest.raises(HostError, match="longer than"):
        link.fetch("status")


def test_a_host_that_does_not_answer_is_given_up(monkeypatch):
    """After the time that a call has."""
    monkeypatch.setattr(remote, "CALL_SECONDS", 0.3)
    with pytest.raises(HostError, match="far did not answer within 0 s"):
        host_that(monkeypatch, "time.sleep(600)").fetch("status")


def test_what_a_host_answers_is_passed_on(monkeypatch):
    """The answer of one that works, the last line of one that fails."""
    assert host_that(monkeypatch, "sys.stdout.write(sys.stdin.read().upper())").call("up", {"a": 1}) == {"A": 1}
    with pytest.raises(HostError, match="far: no room"):
        host_that(monkeypatch, "sys.stderr.write('first\\neia-sec: no room'); sys.exit(1)").call("up", {})
    with pytest.raises(HostError, match="not a JSON object"):
        host_that(monkeypatch, "print([])").call("up", {})


def test_a_machine_without_ssh_says_so(tmp_path, monkeypatch):
    """Also when the connection that never was is closed."""
    monkeypatch.setenv("PATH", str(tmp_path))
    link = Link("far", Host(host="far"), tmp_path, tmp_path)
    with pytest.raises(HostError, match="far: ssh cannot be started: No such file or directory"):
        link.fetch("status")
    link.close()


def test_a_shared_connection_that_does_not_close_is_left(tmp_path, monkeypatch):
    """A client that hangs at its end holds nobody up."""
    monkeypatch.setattr(remote, "END_SECONDS", 0.2)
    program = tmp_path / "ssh"
    program.write_text("#!/bin/sh\nexec sleep 600\n")
    program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    Link("far", Host(host="far"), tmp_path, tmp_path).close()
    assert subprocess.run(["pgrep", "-f", f"{program}"], capture_output=True, check=False).returncode == 1
