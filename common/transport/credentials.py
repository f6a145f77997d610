"""A process's certificate: reads and checks the folder that `eia-sec keys issue` writes."""

import datetime
import stat
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from cryptography import x509
from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm
from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat, load_pem_private_key
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from eia_sec.common.errors import CredentialsError
from eia_sec.common.names import is_name

ROLES: Final = (
    "learner",
    "router",
    "site",
    "flight",
    "rollout",
    "elite",
    "operator",
    "monitor",
    "watcher",
    "vehicle",
    "environment",
)
"""Roles that a certificate can name; only the first four listen."""
LISTENING: Final = ("learner", "router", "site", "flight")
CA, CERTIFICATE, KEY, MEMBERS = "ca.pem", "cert.pem", "key.pem", "members.txt"
MAX_PEM: Final = 64 * 1024
"""Largest certificate or key file that is read, bytes."""
MAX_MEMBERS: Final = 10_000
SOON: Final = datetime.timedelta(days=30)
"""A certificate that expires within this time raises a warning."""


@dataclass(frozen=True, order=True)
class Identity:
    """Role and name of a process; its certificate's common name is "role.name".

    Attributes:
        role: one of ROLES.
        name: a key segment; the process's name inside its role.
    """

    role: str
    name: str

    @classmethod
    def parse(cls, text: str) -> "Identity":
        """Return the identity in a common name; raise CredentialsError when the name holds none."""
        role, dot, name = text.partition(".")
        if role not in ROLES or not dot or not is_name(name):
            raise CredentialsError(f"{text[:80]!r} is not a role and a name, such as rollout.worker-7.")
        return cls(role, name)

    def __str__(self) -> str:
        return f"{self.role}.{self.name}"


@dataclass(frozen=True)
class Credentials:
    """A process's certificate, its key, and the authority that it trusts.

    Attributes:
        folder: where the files are.
        identity: the process that the certificate names.
        expires: when the certificate expires, UTC.
        hosts: names and addresses that the certificate may serve; empty for processes that only connect.
        members: the processes that a listening process admits.
    """

    folder: Path
    identity: Identity
    expires: datetime.datetime
    hosts: tuple[str, ...] = ()
    members: tuple[Identity, ...] = ()

    @property
    def ca(self) -> Path:
        """Return the path of the authority's certificate."""
        return self.folder / CA

    @property
    def certificate(self) -> Path:
        """Return the path of this process's certificate."""
        return self.folder / CERTIFICATE

    @property
    def key(self) -> Path:
        """Return the path of this process's private key."""
        return self.folder / KEY

    def require(self, role: str, name: str | None = None) -> None:
        """Raise CredentialsError unless the certificate has this role (and this name, if one is given)."""
        if self.identity.role != role or name not in (None, self.identity.name):
            wanted = role if name is None else Identity(role, name)
            raise CredentialsError(
                f"the certificate in {self.folder} belongs to {self.identity}, but this process is {wanted}."
            )

    def expiry_alarm(self, now: datetime.datetime | None = None) -> str:
        """Return a sentence if the certificate has expired or expires within SOON, else an empty string.

        When the certificate of either side expires, Zenoh closes the link without a message.
        """
        left = self.expires - (now or datetime.datetime.now(datetime.UTC))
        if left >= SOON:
            return ""
        ends = (
            "has expired, which closed its links"
            if left.total_seconds() <= 0
            else f"expires on {self.expires:%Y-%m-%d}"
        )
        return f"the certificate of {self.identity} {ends}: renew it with eia-sec keys renew and restart the process."

    def __str__(self) -> str:
        return f"{self.identity} (certificate {self.certificate}, valid until {self.expires:%Y-%m-%d})"


def load(folder: Path, now: datetime.datetime | None = None) -> Credentials:
    """Read and check a folder of `eia-sec keys issue`.

    Args:
        folder: holds ca.pem, cert.pem, key.pem and, for a process that listens, members.txt.
        now: the time to check against; None means the current time.

    Raises:
        CredentialsError: when a file is missing or malformed, when other users can read the key, when the key does not
            belong to the certificate, or when the certificate is not signed by the authority or not valid now.
    """
    require_secret(folder / KEY)
    authority, certificate = read_certificate(folder / CA), read_certificate(folder / CERTIFICATE)
    try:
        certificate.verify_directly_issued_by(authority)
    except (ValueError, TypeError, InvalidSignature) as error:
        raise CredentialsError(f"{folder / CERTIFICATE} was not signed by {folder / CA}.") from error
    try:
        key = load_pem_private_key(read_bounded(folder / KEY), None)
    except (ValueError, TypeError, UnsupportedAlgorithm) as error:
        raise CredentialsError(f"{folder / KEY} is not a private key, or is protected by a password.") from error
    form = (Encoding.DER, PublicFormat.SubjectPublicKeyInfo)
    if key.public_key().public_bytes(*form) != certificate.public_key().public_bytes(*form):
        raise CredentialsError(f"{folder / KEY} is not the key of {folder / CERTIFICATE}.")
    identity = identity_of(certificate, folder / CERTIFICATE)
    require_valid(certificate, folder / CERTIFICATE, now)
    require_valid(authority, folder / CA, now)
    listens = identity.role in LISTENING
    members = read_members(folder / MEMBERS) if listens else ()
    return Credentials(folder, identity, certificate.not_valid_after_utc, hosts_of(certificate), members)


def require_secret(path: Path) -> None:
    """Raise CredentialsError when a key file is missing or other users may read it."""
    try:
        mode = stat.S_IMODE(path.stat().st_mode)
    except OSError as error:
        raise CredentialsError(f"{path} cannot be read: {error.strerror}; `eia-sec keys issue` writes it.") from error
    if mode & 0o077:
        raise CredentialsError(f"others may read {path} (mode {mode:04o}); run chmod 600 on it, or issue a new key.")


def require_valid(certificate: x509.Certificate, path: Path, now: datetime.datetime | None = None) -> None:
    """Raise CredentialsError unless a certificate is valid now."""
    now = now or datetime.datetime.now(datetime.UTC)
    if now > certificate.not_valid_after_utc:
        raise CredentialsError(
            f"the certificate {path} expired on {certificate.not_valid_after_utc:%Y-%m-%d %H:%M} UTC; "
            "`eia-sec keys renew` makes a new one."
        )
    if now < certificate.not_valid_before_utc:
        raise CredentialsError(
            f"the certificate {path} is not valid before {certificate.not_valid_before_utc:%Y-%m-%d %H:%M} UTC; "
            "is this machine's clock right?"
        )


def read_bounded(path: Path, limit: int = MAX_PEM) -> bytes:
    """Return a small file's bytes; raise CredentialsError when it cannot be read or is larger than `limit` bytes."""
    try:
        with path.open("rb") as source:
            data = source.read(limit + 1)
    except OSError as error:
        raise CredentialsError(f"{path} cannot be read: {error.strerror}.") from error
    if len(data) > limit:
        raise CredentialsError(f"{path} is larger than the {limit} bytes that such a file may have.")
    return data


def read_certificate(path: Path) -> x509.Certificate:
    """Return the certificate in a PEM file; raise CredentialsError when there is none."""
    try:
        return x509.load_pem_x509_certificate(read_bounded(path))
    except ValueError as error:
        raise CredentialsError(f"{path} is not a certificate in PEM form.") from error


def identity_of(certificate: x509.Certificate, path: Path) -> Identity:
    """Return the identity that a certificate names; raise CredentialsError unless there is exactly one."""
    names = certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)
    if len(names) != 1:
        raise CredentialsError(f"{path} names {len(names)} subjects, not one.")
    return Identity.parse(str(names[0].value))


def hosts_of(certificate: x509.Certificate) -> tuple[str, ...]:
    """Return the names and addresses that a certificate may serve."""
    try:
        usage = certificate.extensions.get_extension_for_class(x509.ExtendedKeyUsage).value
        names = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    except x509.ExtensionNotFound:
        return ()
    if ExtendedKeyUsageOID.SERVER_AUTH not in usage:
        return ()
    addresses = names.get_values_for_type(x509.IPAddress)
    return (*names.get_values_for_type(x509.DNSName), *map(str, addresses))


def read_members(path: Path) -> tuple[Identity, ...]:
    """Return the identities in a members file, one per line; raise CredentialsError for a malformed file."""
    try:
        lines = read_bounded(path, 1024 * 1024).decode("ascii").split()
    except UnicodeDecodeError as error:
        raise CredentialsError(f"{path} is not a list of common names.") from error
    if len(lines) > MAX_MEMBERS:
        raise CredentialsError(f"{path} names more than {MAX_MEMBERS} processes.")
    try:
        return tuple(sorted({Identity.parse(line) for line in lines}))
    except CredentialsError as error:
        raise CredentialsError(f"{path}: {error}") from error
