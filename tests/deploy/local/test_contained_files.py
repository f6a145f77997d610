"""Files whose names others chose: they are written into their folder or not at all."""

import pytest

from eia_sec.common.errors import UsageError
from eia_sec.deploy.local.contained_files import write, writing


@pytest.mark.parametrize("name", ["../outside", "/outside", "a/../../outside", "", ".", "a\x1b[2J", "a\0b"])
def test_no_name_leaves_the_folder(tmp_path, name):
    """Such a name is refused before anything is made."""
    with pytest.raises(UsageError, match="not a path inside a folder"):
        write(tmp_path / "inside", name, b"x")
    assert list(tmp_path.iterdir()) == []


def test_no_link_leads_out_of_the_folder(tmp_path):
    """A linked folder on the way is refused, and a linked file is replaced while its target stays."""
    inside, outside = tmp_path / "inside", tmp_path / "outside"
    inside.mkdir()
    outside.mkdir()
    (outside / "file").write_bytes(b"before")
    (inside / "linked").symlink_to(outside)
    (inside / "file").symlink_to(outside / "file")
    with pytest.raises(UsageError, match="symbolic link"):
        write(inside, "linked/file", b"after")
    write(inside, "file", b"after")
    assert (outside / "file").read_bytes() == b"before"
    assert (inside / "file").read_bytes() == b"after"
    assert not (inside / "file").is_symlink()


def test_a_file_is_whole_or_not_there(tmp_path):
    """An error while it is written leaves the old file and nothing beside it."""
    path = write(tmp_path, "a/b", b"old")

    def fail():
        with writing(tmp_path, "a/b") as file:
            file.write(b"new")
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail()
    assert path.read_bytes() == b"old"
    assert [found.name for found in path.parent.iterdir()] == ["b"]


def test_permissions_are_those_asked_for(tmp_path):
    """An owner-only file gets an owner-only folder."""
    path = write(tmp_path, "keys/key.pem", b"x")
    assert (path.stat().st_mode & 0o777, path.parent.stat().st_mode & 0o077) == (0o600, 0)
    assert write(tmp_path, "open.service", b"x", 0o644).stat().st_mode & 0o777 == 0o644
