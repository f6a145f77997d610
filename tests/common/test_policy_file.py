import json
import math
import os

import numpy as np
import pytest
from safetensors.numpy import save

from eia_sec.common import policy_file
from eia_sec.common.actors import TeamActors
from eia_sec.common.errors import PolicyError
from eia_sec.common.policy_file import MAX_FILE_BYTES, MAX_HEADER_BYTES, load_policy, save_policy
from eia_sec.common.team import GroupSpec, TeamSpec

TEAM = TeamSpec((GroupSpec("communication", 2, 5, 2), GroupSpec("monitoring", 3, 4, 2)))
PROVENANCE = {"command": "eia-sec train", "seed": "0", "commit": "abc"}


@pytest.fixture
def actors():
    return TeamActors.initial(TEAM, hidden=8, seed=1, per_type=False)


@pytest.fixture
def path(tmp_path, actors):
    save_policy(tmp_path / "policy.safetensors", actors, PROVENANCE)
    return tmp_path / "policy.safetensors"


def rewrite_header(path, change):
    data = path.read_bytes()
    length = int.from_bytes(data[:8], "little")
    header = json.loads(data[8 : 8 + length])
    change(header)
    text = json.dumps(header).encode()
    path.write_bytes(len(text).to_bytes(8, "little") + text + data[8 + length :])


def test_a_policy_comes_back_bit_equal_with_its_provenance(path, actors):
    """Saving and loading changes no parameter, and gives back exactly the metadata that went in."""
    loaded, metadata = load_policy(path)
    assert loaded.team == TEAM
    assert loaded.hidden == 8
    assert loaded.digest() == actors.digest()
    assert metadata == PROVENANCE


@pytest.mark.parametrize(("types", "fits"), [(1000, True), (20_000, False)])
def test_what_is_saved_can_be_loaded(tmp_path, types, fits):
    """A policy of many types comes back; one whose team's description is too long to load is not written."""
    team = TeamSpec(tuple(GroupSpec(f"agent_{index}", 1, 1, 1) for index in range(types)))
    actors, path = TeamActors.initial(team, hidden=1, seed=0, per_type=False), tmp_path / "policy.safetensors"
    if fits:
        save_policy(path, actors, {})
        assert load_policy(path)[0].digest() == actors.digest()
        return
    with pytest.raises(PolicyError, match="description of the policy's team takes more than 1024 KiB"):
        save_policy(path, actors, {})
    assert not path.exists()


@pytest.mark.parametrize("shared", [False, True])
@pytest.mark.parametrize("head", ["deterministic", "gaussian"])
def test_choices_masks_and_shared_actors_come_back(tmp_path, head, shared):
    """A type with discrete actions has one output for each option; shared actors are one row."""
    team = TeamSpec((GroupSpec("chooser", 3, 9, 2, choices=(2, 3), masked=True), GroupSpec("mover", 2, 4, 2)))
    actors = TeamActors.initial(team, 8, 1, head=head, shared=shared)
    save_policy(tmp_path / "policy", actors, {})
    loaded, _ = load_policy(tmp_path / "policy")
    assert (loaded.team, loaded.head, loaded.digest()) == (team, head, actors.digest())
    assert [len(flat) for flat in loaded.flat] == ([1, 1] if shared else [3, 2])
    rows = np.random.default_rng(0).uniform(-1, 1, (5, team.observation_size)).astype(np.float32)
    np.testing.assert_array_equal(loaded.environment_actions(rows), actors.environment_actions(rows))


@pytest.mark.parametrize("shared", [False, True])
def test_actors_with_memory_come_back(tmp_path, shared):
    """Their file names the memory, and the actors remember as before."""
    actors = TeamActors.initial(TEAM, 8, 1, head="gaussian", shared=shared, memory="gru")
    save_policy(tmp_path / "policy", actors, PROVENANCE)
    loaded, metadata = load_policy(tmp_path / "policy")
    assert (loaded.memory, loaded.head, loaded.digest(), metadata) == ("gru", "gaussian", actors.digest(), PROVENANCE)
    states = [each.initial_state(2) for each in (actors, loaded)]
    for seed in range(3):
        rows = np.random.default_rng(seed).uniform(-1, 1, (2, TEAM.observation_size)).astype(np.float32)
        np.testing.assert_array_equal(loaded.act(rows, states[1]), actors.act(rows, states[0]))
    np.testing.assert_array_equal(*states)


@pytest.mark.parametrize("name", ["team", "hidden", "head", "memory", "digest"])
def test_a_file_that_lacks_a_part_of_its_description_is_refused(path, name):
    """Its error says which."""
    rewrite_header(path, lambda header: header["__metadata__"].pop(name))
    with pytest.raises(PolicyError, match=f"not a valid policy file: '{name}' is missing"):
        load_policy(path)


@pytest.mark.parametrize("memory", ["gru", "lstm", ""])
def test_a_memory_that_the_numbers_do_not_have_is_refused(path, memory):
    """A file without the unit's numbers is none of actors with memory, and other names are none at all."""
    rewrite_header(path, set_metadata("memory", memory))
    with pytest.raises(PolicyError, match="not a valid policy file"):
        load_policy(path)


def test_half_storage_halves_the_file_and_keeps_sixteen_bits(tmp_path):
    """With `half` the parameters come back as float32 rounded to 11 significant bits, from half the bytes."""
    actors = TeamActors.initial(TEAM, hidden=64, seed=1)
    save_policy(tmp_path / "whole", actors, {})
    save_policy(tmp_path / "half", actors, {}, half=True)
    loaded, _ = load_policy(tmp_path / "half")
    for was, now in zip(actors.flat, loaded.flat, strict=True):
        assert now.dtype == np.float32
        np.testing.assert_array_equal(now, was.astype(np.float16).astype(np.float32))
    assert (tmp_path / "half").stat().st_size < 0.55 * (tmp_path / "whole").stat().st_size


def test_half_storage_refuses_what_sixteen_bits_cannot_hold(tmp_path, actors):
    """A parameter beyond float16 is an error and leaves no file."""
    actors.flat[0][0, 0] = 1e6
    with pytest.raises(PolicyError, match="16-bit"):
        save_policy(tmp_path / "half", actors, {}, half=True)
    assert list(tmp_path.iterdir()) == []


def test_reserved_metadata_is_refused(tmp_path, actors):
    """Provenance cannot overwrite the keys that describe the policy."""
    with pytest.raises(PolicyError, match="'team'"):
        save_policy(tmp_path / "policy", actors, {"team": "mine"})


@pytest.mark.parametrize("name", ["../../pwn", "/tmp/pwn", "..", "a/b", "a\0b", "a\x1b[2J", "a\nb", "", "x" * 64, 7])
def test_a_type_of_agent_with_an_impossible_name_is_refused(path, name):
    """A team's names may become files' names and words in a terminal; one that is no name makes the file none."""

    def rename(header):
        groups = json.loads(header["__metadata__"]["team"])
        groups["groups"][0][0] = name
        header["__metadata__"]["team"] = json.dumps(groups)
        header[str(name)] = header.pop("communication")

    rewrite_header(path, rename)
    with pytest.raises(PolicyError, match="not a valid policy file: not a team description"):
        load_policy(path)


def test_a_file_cut_anywhere_is_refused(path):
    """Whatever length is left, loading says so with a PolicyError."""
    data = path.read_bytes()
    for length in [0, 4, 8, 9, 60, *range(100, len(data), 97), len(data) - 1]:
        path.write_bytes(data[:length])
        with pytest.raises(PolicyError, match="not a valid policy file"):
            load_policy(path)


@pytest.mark.parametrize("missing", [1, 1000])
def test_a_truncated_file_is_called_truncated(path, missing):
    """The sentence has the bytes of parameters that are there, and those that there should be, however few are lost."""
    data = path.read_bytes()
    whole = len(data) - 8 - int.from_bytes(data[:8], "little")
    path.write_bytes(data[:-missing])
    with pytest.raises(PolicyError, match=f"it is truncated: it holds {whole - missing:,} of {whole:,} bytes of param"):
        load_policy(path)


def test_a_flipped_bit_among_the_numbers_is_noticed(path):
    """The digest in the header covers every parameter."""
    data = bytearray(path.read_bytes())
    data[-7] ^= 1
    path.write_bytes(data)
    with pytest.raises(PolicyError, match="do not match its digest"):
        load_policy(path)


def test_an_oversized_file_is_refused_before_it_is_read(path):
    """A file beyond the limit, here a sparse one, is refused by its size."""
    with path.open("r+b") as file:
        file.truncate(MAX_FILE_BYTES + 1)
    with pytest.raises(PolicyError, match="at most"):
        load_policy(path)


@pytest.mark.parametrize("length", [MAX_HEADER_BYTES + 1, 2**63])
def test_an_oversized_header_is_refused(path, length):
    """A header that claims more bytes than the file or the limit holds is refused."""
    path.write_bytes(length.to_bytes(8, "little") + path.read_bytes()[8:])
    with pytest.raises(PolicyError, match="oversized"):
        load_policy(path)


def set_metadata(key, value):
    return lambda header: header["__metadata__"].update({key: value})


@pytest.mark.parametrize(
    "change",
    [
        set_metadata("format", "something else"),
        set_metadata("hidden", "9"),
        set_metadata("hidden", "100000000000"),
        set_metadata("hidden", "many"),
        set_metadata("team", '{"groups": [["communication", 4096, 65536, 2]]}'),
        set_metadata("team", "[" * 50_000),
        lambda header: header.pop("__metadata__"),
        lambda header: header.update({"__metadata__": 3}),
        lambda header: header.pop("monitoring"),
        lambda header: header.update({"monitoring": []}),
        lambda header: header["monitoring"].update({"dtype": "F64"}),
        lambda header: header["monitoring"].update({"shape": [10**9, 10**9]}),
        lambda header: header["monitoring"].update({"shape": [1, 130]}),
        lambda header: header["monitoring"].update({"shape": [2, 130]}),
        lambda header: header["monitoring"].update({"data_offsets": [0, 10**12]}),
    ],
)
def test_a_header_that_contradicts_the_numbers_is_refused(path, change):
    """Whatever the header promises is compared with team and size before arrays are made."""
    rewrite_header(path, change)
    with pytest.raises(PolicyError, match="not a valid policy file"):
        load_policy(path)


def test_a_missing_file_is_a_usage_error(tmp_path):
    """A path where nothing lies gives one sentence."""
    with pytest.raises(PolicyError, match="cannot be read"):
        load_policy(tmp_path / "nothing")


def test_an_unwritable_place_leaves_nothing_behind(tmp_path, actors):
    """Saving into a folder that does not exist is a PolicyError."""
    with pytest.raises(PolicyError, match="cannot be written"):
        save_policy(tmp_path / "no" / "policy", actors, {})


def test_saving_replaces_the_old_policy(path, actors):
    """A second save leaves one file, the new one."""
    other = TeamActors.initial(TEAM, hidden=8, seed=2)
    save_policy(path, other, {})
    assert load_policy(path)[0].digest() == other.digest() != actors.digest()
    assert [file.name for file in path.parent.iterdir()] == [path.name]


def test_not_a_number_cannot_be_saved(tmp_path, actors):
    """Actors that hold NaN make no file."""
    actors.flat[1][0, 0] = math.nan
    with pytest.raises(PolicyError, match="finite"):
        save_policy(tmp_path / "policy", actors, {})
    assert list(tmp_path.iterdir()) == []


def test_not_a_number_is_not_loaded(path, actors):
    """A whole file with NaN in it, as another program may write it, is refused and not scored."""
    actors.flat[0][0, 0] = math.nan
    names = [group.name for group in actors.team.groups]
    whole = path.read_bytes()
    metadata = json.loads(whole[8 : 8 + int.from_bytes(whole[:8], "little")])["__metadata__"]
    digest = policy_file._digest(actors.flat)
    path.write_bytes(save(dict(zip(names, actors.flat, strict=True)), metadata={**metadata, "digest": digest}))
    with pytest.raises(PolicyError, match="not finite numbers, because its training diverged"):
        load_policy(path)


@pytest.mark.timeout(20)
@pytest.mark.parametrize("make", [os.mkfifo, os.mkdir])
def test_what_is_no_regular_file_is_refused_at_once(tmp_path, make):
    """A pipe without a writer would be waited for without end."""
    make(tmp_path / "policy")
    with pytest.raises(PolicyError, match=r"is not a regular file|Is a directory"):
        load_policy(tmp_path / "policy")
