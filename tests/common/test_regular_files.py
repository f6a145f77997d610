"""Files that a user names: a pipe or device is refused at once, and a byte order mark is no part of a text."""

import os
from pathlib import Path

import pytest

from eia_sec.common import regular_files
from eia_sec.common.config.files import read_saved
from eia_sec.common.errors import ConfigError
from eia_sec.common.regular_files import read_regular_text
from eia_sec.deploy.hosts.fleet_file import read

FLEET = '[learner]\nhost = "a"\n[hosts.a]\nhost = "local"\n[network]\ninsecure = true\n'


@pytest.mark.timeout(30)
@pytest.mark.parametrize("kind", ["pipe", "device", "folder"])
def test_what_is_no_regular_file_is_refused_at_once(kind, tmp_path):
    """A pipe without a writer would be waited for, and a device has no end."""
    path = {"pipe": tmp_path / "pipe.toml", "device": Path("/dev/zero"), "folder": tmp_path}[kind]
    if kind == "pipe":
        os.mkfifo(path)
    with pytest.raises(OSError, match=r"regular file|directory"):
        read_regular_text(path)
    for reader in (read_saved, read):
        with pytest.raises(ConfigError, match=r"cannot be read: (it is not a regular file|Is a directory)\.$"):
            reader(path)


def test_a_text_has_a_largest_size_and_no_byte_order_mark(tmp_path, monkeypatch):
    """The size is known before anything is read; editors on Windows write the mark, in fleet files, too."""
    path = tmp_path / "fleet.toml"
    path.write_bytes(b"\xef\xbb\xbf" + FLEET.encode())
    assert read_regular_text(path) == FLEET
    assert read(path).learner.host == "a"
    monkeypatch.setattr(regular_files, "MOST_TEXT_BYTES", 10)
    with pytest.raises(OSError, match="it has more than 10 bytes"):
        read_regular_text(path)
