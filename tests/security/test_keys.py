"""The authority and its certificates: files, refusals, expiry."""

import datetime
import os
import stat
from pathlib import Path

import pytest
from cryptography.hazmat.primitives.serialization import (
    BestAvailableEncryption,
    Encoding,
    PrivateFormat,
    load_pem_private_key,
)

from eia_sec.common.errors import CredentialsError, EndpointError
from eia_sec.common.transport.credentials import Identity, load, read_members
from eia_sec.common.transport.endpoint import Endpoint
from eia_sec.deploy.commands.fleet.keys import command
from eia_sec.deploy.security import authority
from tests.security.conftest import YEAR


@pytest.fixture
def own(tmp_path: Path) -> Path:
    """An authority that a test may spoil."""
    authority.create(tmp_path / "keys")
    return tmp_path / "keys"


def issued(
    own: Path, name: str = "rollout.a", lifetime: datetime.timedelta = YEAR, hosts: tuple[str, ...] = ()
) -> Path:
    return authority.issue(own, Identity.parse(name), hosts, lifetime)


def test_every_file_is_its_owners_alone(own):
    """Folders are 0700 and files 0600, whatever the umask, and nothing temporary stays."""
    before = os.umask(0)
    try:
        issued(own, "learner.learner", hosts=("127.0.0.1",))
    finally:
        os.umask(before)
    modes = {path: stat.S_IMODE(path.stat().st_mode) for path in (own, *own.rglob("*"))}
    assert {path for path, mode in modes.items() if mode != (0o700 if path.is_dir() else 0o600)} == set()
    assert not [path for path in modes if path.name.startswith(".")]


def test_a_certificate_says_who_and_until_when(own):
    """Loading gives back role, name, hosts, end and, for a listener, the members."""
    issued(own)
    learner = load(issued(own, "learner.learner", hosts=("farm-1.example", "::1")))
    assert (learner.identity, learner.hosts) == (Identity("learner", "learner"), ("farm-1.example", "::1"))
    assert learner.members == (Identity("learner", "learner"), Identity("rollout", "a"))
    assert abs(learner.expires - datetime.datetime.now(datetime.UTC) - YEAR) < datetime.timedelta(minutes=1)
    assert (load(own / "rollout.a").hosts, load(own / "rollout.a").members) == ((), ())


def test_nothing_is_overwritten(own):
    """A second authority or a second certificate of one name is refused, and the first stays."""
    before = issued(own).joinpath("key.pem").read_bytes()
    with pytest.raises(CredentialsError, match="never overwritten"):
        authority.create(own)
    with pytest.raises(CredentialsError, match="renew"):
        issued(own)
    assert (own / "rollout.a" / "key.pem").read_bytes() == before


def test_renewal_keeps_name_and_hosts_and_changes_the_key(own):
    """A renewed certificate is loadable, ends later, and has another key."""
    folder = issued(own, "router.main", datetime.timedelta(days=2), ("farm-1.example",))
    old, key = load(folder), (folder / "key.pem").read_bytes()
    new = load(authority.renew(own, old.identity, YEAR))
    assert (new.identity, new.hosts) == (old.identity, old.hosts)
    assert new.expires > old.expires
    assert (folder / "key.pem").read_bytes() != key


def test_listeners_learn_who_is_issued_and_who_is_struck(own):
    """The list of members in a listener's folder follows issue and revoke."""
    learner = issued(own, "learner.learner", hosts=("127.0.0.1",))
    issued(own)
    assert Identity("rollout", "a") in load(learner).members
    authority.revoke(own, Identity("rollout", "a"))
    assert Identity("rollout", "a") not in load(learner).members
    with pytest.raises(CredentialsError, match="not on the list"):
        authority.revoke(own, Identity("rollout", "a"))


def test_a_key_that_others_can_read_is_refused(own):
    """A group-readable key does not load, and a readable authority does not sign."""
    folder = issued(own)
    (folder / "key.pem").chmod(0o640)
    with pytest.raises(CredentialsError, match=r"others may read .* 0640"):
        load(folder)
    (own / "ca.key").chmod(0o644)
    with pytest.raises(CredentialsError, match="others may read"):
        issued(own, "rollout.b")


def test_expired_early_swapped_and_foreign_certificates_are_refused(own, other_folder):
    """What is not valid now, not of this key, or not of this authority, does not load."""
    with pytest.raises(CredentialsError, match="expired on"):
        load(issued(own, "rollout.old", datetime.timedelta(seconds=-1)))
    folder = issued(own)
    with pytest.raises(CredentialsError, match="is not valid before"):
        load(folder, datetime.datetime.now(datetime.UTC) - YEAR)
    swapped = issued(own, "rollout.swapped")
    authority.replace(swapped / "key.pem", (folder / "key.pem").read_bytes())
    with pytest.raises(CredentialsError, match="is not the key of"):
        load(swapped)
    authority.replace(folder / "ca.pem", (other_folder / "ca.pem").read_bytes())
    with pytest.raises(CredentialsError, match="was not signed by"):
        load(folder)


@pytest.mark.parametrize("name", ["ca.pem", "cert.pem", "key.pem"])
@pytest.mark.parametrize("content", [None, b"", b"-----BEGIN CERTIFICATE-----\nAAAA\n", b"x" * 70_000])
def test_missing_and_damaged_files_are_one_sentence(own, name, content):
    """A file that is missing, empty, damaged or far too large is a CredentialsError that names it."""
    folder = issued(own)
    (folder / name).unlink()
    if content is not None:
        authority.write_new(folder / name, content)
    with pytest.raises(CredentialsError, match=name):
        load(folder)


@pytest.mark.parametrize(
    "content", [b"", b"-----BEGIN PRIVATE KEY-----\nAAAA\n-----END PRIVATE KEY-----\n", "password"]
)
def test_an_authority_whose_key_cannot_be_used_is_one_sentence(own, content):
    """A damaged key and one with a password are refused by the name of their file, whatever is to be issued."""
    if isinstance(content, str):
        key = load_pem_private_key((own / "ca.key").read_bytes(), None)
        protected = BestAvailableEncryption(content.encode())
        content = key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, protected)
    authority.replace(own / "ca.key", content)
    with pytest.raises(CredentialsError, match=r"ca\.key is not a private key without a password"):
        issued(own)


def test_hosts_are_for_listeners(own):
    """A learner needs a host, a worker may have none, and a host is a name or an address."""
    with pytest.raises(CredentialsError, match="needs --host"):
        issued(own, "learner.learner")
    with pytest.raises(CredentialsError, match="only connects"):
        issued(own, "rollout.a", hosts=("127.0.0.1",))
    with pytest.raises(CredentialsError, match="not a host name or address"):
        issued(own, "learner.learner", hosts=("a b",))


@pytest.mark.parametrize(
    "text", ["", "rollout", "rollout.", "pilot.a", "rollout.*", "rollout.a/b", "rollout." + "x" * 64]
)
def test_names_that_are_no_identities_are_refused(text):
    """A common name without a role, or with a name that is no key segment, is refused."""
    with pytest.raises(CredentialsError):
        Identity.parse(text)


def test_a_member_that_is_no_identity_is_reported_with_its_file(tmp_path):
    """The file was edited by hand, and its name leads to the mistake."""
    (tmp_path / "members.txt").write_text("rollout.a\nrollout.b/c\n")
    with pytest.raises(CredentialsError, match=r"members\.txt: 'rollout\.b/c' is not a role and a name"):
        read_members(tmp_path / "members.txt")


def test_listening_elsewhere_needs_a_certificate_or_consent(keys_folder):
    """An address that others reach is refused with the reason, and accepted with a certificate."""
    with pytest.raises(EndpointError, match=r"--tls FOLDER .*--insecure"):
        Endpoint.parse("tcp/0.0.0.0:7447").require_private(insecure=False)
    with pytest.raises(EndpointError, match="needs a certificate"):
        Endpoint.parse("tls/127.0.0.1:7447")
    endpoint = Endpoint.parse("tcp/0.0.0.0:7447", keys_folder / "learner.learner")
    endpoint.require_private(insecure=False)
    assert str(endpoint) == "tls/0.0.0.0:7447"


def test_the_command_makes_shows_renews_and_strikes(tmp_path, capsys):
    """Each subcommand of `eia-sec keys` does its part, and show prints the ends."""
    folder = str(tmp_path / "keys")
    command(["init", "--dir", folder])
    command(["issue", "learner", "learner", "--host", "127.0.0.1", "--dir", folder])
    command(["issue", "rollout", "worker-7", "--dir", folder, "--days", "10"])
    command(["show", folder])
    shown = capsys.readouterr().out
    assert "rollout.worker-7" in shown
    assert "9 days, renew it" in shown
    assert "copy it to learner.learner" in shown
    command(["renew", "rollout", "worker-7", "--dir", folder])
    assert (load(tmp_path / "keys" / "rollout.worker-7").expires - datetime.datetime.now(datetime.UTC)).days == 364
    command(["revoke", "rollout", "worker-7", "--dir", folder])
    assert "worker-7" not in (tmp_path / "keys" / "learner.learner" / "members.txt").read_text()
    for wrong in (["issue", "pilot", "x"], ["issue", "learner", "x", "--host", "h"], ["renew", "rollout", "none"]):
        with pytest.raises(CredentialsError):
            command([*wrong, "--dir", folder])


def test_an_interrupted_issue_can_be_repeated(own, monkeypatch):
    """Without a certificate nothing has been issued, whatever lies there."""
    real = authority.write_new

    def full(path, data):
        raise CredentialsError(f"{path} cannot be written: No space left on device.")

    monkeypatch.setattr(authority, "write_new", full)
    with pytest.raises(CredentialsError, match="No space left"):
        issued(own, "rollout.late")
    monkeypatch.setattr(authority, "write_new", real)
    issued(own, "rollout.late")
    assert Identity("rollout", "late") in read_members(own / "members.txt")
    assert load(own / "rollout.late").identity == Identity("rollout", "late")


def test_half_an_authority_is_none(tmp_path, monkeypatch):
    """A call that fails leaves no files that would be in the way of the next one; a whole authority is kept."""
    real, calls = authority.write_new, []

    def full(path, data):
        calls.append(path)
        if len(calls) == 2:
            raise CredentialsError(f"{path} cannot be written: No space left on device.")
        real(path, data)

    monkeypatch.setattr(authority, "write_new", full)
    with pytest.raises(CredentialsError, match="No space left"):
        authority.create(tmp_path / "keys")
    assert not list((tmp_path / "keys").glob("*"))
    authority.create(tmp_path / "keys")
    with pytest.raises(CredentialsError, match="already exists"):
        authority.create(tmp_path / "keys")
    assert (tmp_path / "keys" / "ca.pem").exists()
