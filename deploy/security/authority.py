"""The certificate authority of an installation: created once, kept offline, issues one certificate per process."""

import datetime
import fcntl
import ipaddress
import os
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Final

from cryptography import x509
from cryptography.exceptions import UnsupportedAlgorithm
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import (
    Encoding,
    NoEncryption,
    PrivateFormat,
    load_pem_private_key,
)
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from eia_sec.common.config.checks import within
from eia_sec.common.errors import CredentialsError
from eia_sec.common.transport import credentials
from eia_sec.common.transport.credentials import CA, CERTIFICATE, KEY, LISTENING, MEMBERS, Identity

CA_KEY: Final = "ca.key"
LOCK: Final = "members.lock"
CA_DAYS: Final = 3650
BACKDATED: Final = datetime.timedelta(minutes=5)
"""Certificates are valid from this long ago, for machines whose clocks are slightly behind."""


def lasting(days: int) -> datetime.timedelta:
    """Return the lifetime of a certificate; raise ConfigError if the authority's would end before."""
    within(1, CA_DAYS, days=days)
    return datetime.timedelta(days=days)


def create(folder: Path, days: int = CA_DAYS) -> None:
    """Make an authority: its certificate, its key and an empty list of members.

    Raises:
        CredentialsError: when the folder already holds one, or cannot be written.
    """
    _make_folder(folder)
    key = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, f"eia-sec authority {os.urandom(4).hex()}")])
    usage = x509.KeyUsage(
        digital_signature=False,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        key_cert_sign=True,
        crl_sign=True,
        encipher_only=False,
        decipher_only=False,
    )
    certificate = (
        _builder(name, key.public_key(), name, _now(), datetime.timedelta(days=days))
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .add_extension(usage, critical=True)
        .sign(key, hashes.SHA256())
    )
    with ExitStack() as on_failure:
        files = ((CA_KEY, _pem(key)), (CA, certificate.public_bytes(Encoding.PEM)), (MEMBERS, b""))
        for file, data in files:
            write_new(folder / file, data)
            # Half an authority would be in the way of the next try.
            on_failure.callback((folder / file).unlink, missing_ok=True)
        on_failure.pop_all()


def issue(folder: Path, identity: Identity, hosts: Sequence[str], lifetime: datetime.timedelta) -> Path:
    """Make a key and a certificate for one process, and put its name on the list of members.

    Args:
        folder: the authority's folder; the process's folder is made inside it.
        identity: whom the certificate names.
        hosts: names and addresses under which it listens; only for roles that listen, and then at least one.
        lifetime: how long it is valid.

    Returns:
        The process's folder.

    Raises:
        CredentialsError: when there is no authority, a host is malformed, or there is such a certificate already.
    """
    issuer = _Authority(folder)
    if bool(hosts) != (identity.role in LISTENING):
        raise CredentialsError(
            f"a {identity.role} needs --host, the name or address under which the others reach it."
            if not hosts
            else f"--host is for {' and '.join(LISTENING)}; a {identity.role} only connects."
        )
    names = [_general_name(host) for host in hosts]
    target = folder / str(identity)
    if (target / CERTIFICATE).exists():
        raise CredentialsError(f"{target} already has a certificate; `eia-sec keys renew` replaces it.")
    _make_folder(target)
    key = ec.generate_private_key(ec.SECP256R1())
    certificate = issuer.certify(identity, key.public_key(), names, lifetime)
    # The certificate comes last: what an interrupted call has left counts for nothing, and is replaced.
    replace(target / CA, (folder / CA).read_bytes())
    replace(target / KEY, _pem(key))
    with _locked(folder):
        _admit(folder, {*credentials.read_members(folder / MEMBERS), identity})
    write_new(target / CERTIFICATE, certificate.public_bytes(Encoding.PEM))
    return target


def renew(folder: Path, identity: Identity, lifetime: datetime.timedelta, more: Sequence[str] = ()) -> Path:
    """Replace a process's key and certificate by new ones for the same name and hosts; return its folder.

    Args:
        folder: the authority's folder.
        identity: whom the certificate names.
        lifetime: how long the new one is valid.
        more: names and addresses that it serves besides those of the old one.
    """
    target = folder / str(identity)
    old = credentials.read_certificate(target / CERTIFICATE)
    key = ec.generate_private_key(ec.SECP256R1())
    names = [_general_name(host) for host in (*credentials.hosts_of(old), *more)]
    certificate = _Authority(folder).certify(identity, key.public_key(), names, lifetime)
    replace(target / KEY, _pem(key))
    replace(target / CERTIFICATE, certificate.public_bytes(Encoding.PEM))
    return target


def not_served(folder: Path, identity: Identity, hosts: Sequence[str]) -> list[str]:
    """Return those of some names and addresses that a process's certificate does not serve."""
    served = credentials.hosts_of(credentials.read_certificate(folder / str(identity) / CERTIFICATE))
    return [host for host in hosts if str(_general_name(host).value) not in served]


def revoke(folder: Path, identity: Identity) -> None:
    """Remove a process from the list of members; raise CredentialsError if it is not on it."""
    with _locked(folder):
        members = set(credentials.read_members(folder / MEMBERS))
        if identity not in members:
            raise CredentialsError(f"{identity} is not on the list of members of {folder}.")
        _admit(folder, members - {identity})


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """Keep others from changing the list of members meanwhile."""
    try:
        held = os.open(folder / LOCK, os.O_WRONLY | os.O_CREAT | os.O_CLOEXEC, 0o600)
    except OSError as error:
        raise CredentialsError(f"{folder / LOCK} cannot be written: {error.strerror}.") from error
    try:
        fcntl.flock(held, fcntl.LOCK_EX)
        yield
    finally:
        os.close(held)


def _admit(folder: Path, members: Iterable[Identity]) -> None:
    """Write the list of members, for the authority and into the folder of each process that listens."""
    text = "".join(f"{member}\n" for member in sorted(members)).encode()
    replace(folder / MEMBERS, text)
    for role in LISTENING:
        for listening in folder.glob(f"{role}.*"):
            replace(listening / MEMBERS, text)


class _Authority:
    def __init__(self, folder: Path) -> None:
        if not (folder / CA_KEY).exists():
            raise CredentialsError(f"{folder} holds no authority; `eia-sec keys init --dir {folder}` makes one.")
        credentials.require_secret(folder / CA_KEY)
        self._certificate = credentials.read_certificate(folder / CA)
        credentials.require_valid(self._certificate, folder / CA)
        try:
            key = load_pem_private_key(credentials.read_bounded(folder / CA_KEY), None)
        except (ValueError, TypeError, UnsupportedAlgorithm) as error:
            raise CredentialsError(f"{folder / CA_KEY} is not a private key without a password.") from error
        if not isinstance(key, ec.EllipticCurvePrivateKey):
            raise CredentialsError(f"{folder / CA_KEY} is not a key that `eia-sec keys init` made.")
        self._key = key

    def certify(
        self,
        identity: Identity,
        key: ec.EllipticCurvePublicKey,
        names: list[x509.GeneralName],
        lifetime: datetime.timedelta,
    ) -> x509.Certificate:
        """Sign a certificate; only one that names hosts may listen, so that a worker cannot pose as a learner."""
        begin = _now()
        lifetime = min(lifetime, self._certificate.not_valid_after_utc - begin)
        subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, str(identity))])
        usages = [ExtendedKeyUsageOID.CLIENT_AUTH, *([ExtendedKeyUsageOID.SERVER_AUTH] if names else [])]
        builder = _builder(subject, key, self._certificate.subject, begin, lifetime)
        builder = builder.add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        builder = builder.add_extension(x509.ExtendedKeyUsage(usages), critical=False)
        if names:
            builder = builder.add_extension(x509.SubjectAlternativeName(names), critical=False)
        return builder.sign(self._key, hashes.SHA256())


def _builder(
    subject: x509.Name,
    key: ec.EllipticCurvePublicKey,
    issuer: x509.Name,
    begin: datetime.datetime,
    lifetime: datetime.timedelta,
) -> x509.CertificateBuilder:
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(key)
        .serial_number(x509.random_serial_number())
        .not_valid_before(min(begin, begin + lifetime) - BACKDATED)
        .not_valid_after(begin + lifetime)
    )


def _now() -> datetime.datetime:
    return datetime.datetime.now(datetime.UTC).replace(microsecond=0)


def _general_name(host: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(host.strip("[]")))
    except ValueError:
        pass
    labels = host.split(".")
    if not host.isascii() or not all(label and label.replace("-", "").isalnum() for label in labels):
        raise CredentialsError(f"{host!r} is not a host name or address.")
    return x509.DNSName(host)


def _pem(key: ec.EllipticCurvePrivateKey) -> bytes:
    return key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())


def _make_folder(folder: Path) -> None:
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        folder.chmod(0o700)
    except OSError as error:
        raise CredentialsError(f"{folder} cannot be made: {error.strerror}.") from error


def write_new(path: Path, data: bytes) -> None:
    """Write an owner-only file atomically; raise CredentialsError if it exists."""
    temporary = _write_beside(path, data)
    try:
        os.link(temporary, path)
    except FileExistsError as error:
        raise CredentialsError(f"{path} already exists, and keys are never overwritten.") from error
    except OSError as error:
        raise CredentialsError(f"{path} cannot be written: {error.strerror}.") from error
    finally:
        temporary.unlink(missing_ok=True)


def replace(path: Path, data: bytes) -> None:
    """Replace a file atomically by an owner-only one."""
    os.replace(_write_beside(path, data), path)


def _write_beside(path: Path, data: bytes) -> Path:
    temporary = path.with_name(f".{path.name}.{os.getpid()}.{os.urandom(4).hex()}")
    try:
        descriptor = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
        with os.fdopen(descriptor, "wb") as target:
            target.write(data)
            target.flush()
            os.fsync(target.fileno())
    except OSError as error:
        raise CredentialsError(f"{path} cannot be written: {error.strerror}.") from error
    return temporary
