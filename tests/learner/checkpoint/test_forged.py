"""Forged and damaged checkpoints: each is refused with a typed error before it changes anything, or is harmless."""

import copy
import hashlib
import json
import random
import struct
from pathlib import Path

import pytest
import torch

from eia_sec.common.errors import CheckpointError, RunDirError
from eia_sec.learner.checkpoint import files
from eia_sec.learner.checkpoint.storage import CHECKPOINTS, SLACK_BYTES, RunStorage
from eia_sec.learner.intake.ledger import Ledger
from eia_sec.learner.off_policy.trainer import OffPolicyTrainer
from tests.learner.checkpoint.test_resume import CONFIG, TEAM, play, recorded

ODD = (None, True, -1, 2**62, 2**63, 2**70, 1e300, "7", "", [], {}, [[]], {"a": 1}, ["x"] * 3, 0.5)


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    """A run directory with one checkpoint, and the trainer behind it."""
    directory = tmp_path_factory.mktemp("run")
    trainer, ledger, storage = OffPolicyTrainer(CONFIG, TEAM), Ledger(), RunStorage(directory, CONFIG)
    play(trainer, ledger, recorded(12), 0, 12)
    storage.save(trainer, ledger, 1.0, 3, wait=True)
    assert storage.alarm == ""
    return directory, trainer


def places(value, path=()):
    """Yield the path of every value inside nested maps and lists."""
    inner = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for name, part in inner:
        yield (*path, name)
        yield from places(part, (*path, name))


def put(body, path, value):
    """Return a copy of the body with another value at a path."""
    changed = copy.deepcopy(body)
    inner = changed
    for name in path[:-1]:
        inner = inner[name]
    inner[path[-1]] = value
    return changed


def restored(directory, tensors, body):
    """Write a checkpoint with valid checksums; return a trainer and a ledger that resumed from it, or None."""
    files.save(directory / CHECKPOINTS, tensors, body, keep=1)
    trainer, ledger = OffPolicyTrainer(CONFIG, TEAM), Ledger()
    try:
        RunStorage(directory, CONFIG).restore(trainer, ledger)
    except (CheckpointError, RunDirError):
        return None
    return trainer, ledger


def works(trainer, ledger):
    """Train on, publish and write another checkpoint, as a learner would after it resumed."""
    play(trainer, Ledger(), recorded(4, 1), 0, 4)
    assert trainer.next_version() < 2**63
    trainer.statistics()
    ledger.accounts()
    RunStorage(None, CONFIG).save(trainer, ledger, 0.0, 1)
    return all(torch.isfinite(tensor).all() for tensor in trainer.engine.algorithm.actors.networks.flat.detach())


def check_forged_manifests(found, directory, values, share):
    """Put odd values into the manifest, with valid checksums; what is taken can be used. Return how many were tried."""
    draw, refused, tried = random.Random(1), 0, 0
    every = [path for path in places(found.manifest) if len(path) < 4 or draw.random() < share]
    for path in every:
        for value in draw.sample(ODD, values):
            tried += 1
            result = restored(directory, found.tensors, put(found.manifest, path, value))
            refused += result is None
            assert result is None or works(*result), (path, value)
    assert refused > tried // 2
    return tried


def test_a_forged_manifest_is_refused_or_harmless(saved, tmp_path):
    """Each value in the manifest becomes two of some odd ones."""
    assert check_forged_manifests(files.load_latest(saved[0] / CHECKPOINTS), tmp_path, 2, 0.05) > 150


@pytest.mark.nightly
@pytest.mark.timeout(1800)
def test_thousands_of_forged_manifests_are_refused_or_harmless(saved, tmp_path):
    """Each value in the manifest becomes each of some odd ones."""
    assert check_forged_manifests(files.load_latest(saved[0] / CHECKPOINTS), tmp_path, len(ODD), 0.2) > 1000


@pytest.mark.parametrize("name", ["observation", "reward", "flag", "successor", "drawable", "version", "uses"])
def test_forged_replay_rows_are_refused_or_harmless(saved, tmp_path, name):
    """Indices beyond the ring, rows without a step, numbers that are not finite, and other shapes and types."""
    found = files.load_latest(saved[0] / CHECKPOINTS)
    key = f"replay.{name}"
    tensor = found.tensors[key]
    number, byte = tensor.is_floating_point(), tensor.dtype == torch.uint8
    large, negative = tensor.clone(), tensor.clone()
    large.view(-1)[0] = float("nan") if number else 127 if byte else 2**62
    negative.view(-1)[0] = float("inf") if number else 0 if byte else -(2**62)
    others = [tensor[:-1].clone(), tensor.double(), tensor[None].clone(), tensor.reshape(-1)[:0].clone()]
    results = [restored_tensor(tmp_path, found, key, forged) for forged in (large, negative, *others)]
    assert name == "drawable" or all(result is None for result in results[2:])
    assert all(result is None or works(*result) for result in results)
    assert name in ("version", "uses", "flag") or results[:2] == [None, None]


def restored_tensor(directory, found, key, forged):
    try:
        return restored(directory, {**found.tensors, key: forged}, found.manifest)
    except CheckpointError:  # `save` itself refuses numbers that are not finite
        return None


def test_forged_moments_are_refused(saved, tmp_path):
    """Counts of updates and mean squares below zero, means of gradients too large for them; possible ones are taken."""
    found = files.load_latest(saved[0] / CHECKPOINTS)
    counts = [name for name in found.tensors if name.startswith("engine.") and name.endswith(".step")]
    squares = [name for name in found.tensors if name.startswith("engine.") and name.endswith(".exp_avg_sq")]
    assert len(counts) == len(squares) > 1
    for name in (*counts, *squares):
        tensor = found.tensors[name]
        assert restored_tensor(tmp_path, found, name, tensor - tensor.max() - 1) is None
    for name in squares:
        mean = found.tensors[name.removesuffix("_sq")]
        assert mean.any()
        assert restored_tensor(tmp_path, found, name, torch.zeros_like(mean)) is None
        assert restored_tensor(tmp_path, found, name, (mean / 8.0) ** 2) is None
        # The most that gradients can leave behind, and gradients whose squares are too small for float32.
        assert restored_tensor(tmp_path, found, name, (mean / 7.27) ** 2 + 1e-30) is not None
    assert restored_tensor(tmp_path, found, counts[0], found.tensors[counts[0]] + 7) is not None


def test_rows_that_are_not_finite_are_refused_on_reading_as_well(saved):
    """A forger does not use our `save`."""
    found = files.load_latest(saved[0] / CHECKPOINTS)
    found.tensors["replay.reward"][0] = float("nan")
    with pytest.raises(CheckpointError, match="not finite"):
        OffPolicyTrainer(CONFIG, TEAM).restore(found.tensors, found.manifest["trainer"])


def forge(path, data):
    """Replace a checkpoint's tensors' file, and its manifest by one with the checksums of the new file."""
    manifest = json.loads((path / "manifest.json").read_bytes())
    (path / "tensors.safetensors").write_bytes(data)
    digest = hashlib.sha256(data).hexdigest()
    (path / "manifest.json").write_bytes(files._manifest(manifest["body"], len(data), digest))


def header(entries, body=b"\0" * 64):
    """Return a safetensors file with a header of these entries."""
    text = entries if isinstance(entries, bytes) else json.dumps(entries).encode()
    return struct.pack("<Q", len(text)) + text + body


def entry(dtype="F32", shape=(16,), offsets=(0, 64)):
    return {"dtype": dtype, "shape": list(shape), "data_offsets": list(offsets)}


HEADERS = {
    "empty": b"",
    "cut length": b"\1\2\3",
    "length beyond the file": struct.pack("<Q", 2**40) + b"{}",
    "largest length": struct.pack("<Q", 2**64 - 1) + b"{}",
    "no JSON": header(b"not json at all"),
    "not UTF-8": header(b'{"\xff\xfe": 1}'),
    "a list": header([1, 2]),
    "nested deeply": header(b'{"a":' * 100_000),
    "deep list": header(b"[" * 200_000),
    "no fields": header({"a": {}}),
    "unknown type": header({"a": entry("F99")}),
    "type of another kind": header({"a": entry(7)}),
    "shape with a negative size": header({"a": entry(shape=(-16,))}),
    "shape that overflows": header({"a": entry(shape=(2**32, 2**32))}),
    "shape of 2^63": header({"a": entry(shape=(2**63,))}),
    "shape of 2^62 floats": header({"a": entry(shape=(2**60,), offsets=(0, 2**62))}),
    "shape with a fraction": header({"a": entry(shape=(1.5,))}),
    "offsets beyond the file": header({"a": entry(offsets=(0, 2**40))}),
    "offsets reversed": header({"a": entry(offsets=(64, 0))}),
    "offsets negative": header({"a": entry(offsets=(-64, 0))}),
    "offsets that overlap": header({"a": entry(), "b": entry()}),
    "offsets with a hole": header({"a": entry(shape=(8,), offsets=(0, 32)), "b": entry(shape=(4,), offsets=(48, 64))}),
    "bytes behind": header({"a": entry()}, b"\0" * 128),
    "bytes missing": header({"a": entry()}, b"\0" * 8),
    "size and shape differ": header({"a": entry(shape=(3,))}),
    "metadata that are no strings": header({"__metadata__": {"a": 1}, "a": entry()}),
    "many entries": header({f"t{n}": entry(shape=(0,), offsets=(0, 0)) for n in range(20_000)}, b""),
    "a name of a megabyte": header({"a" * 2**20: entry()}),
    "duplicate names": header(
        b'{"a":{"dtype":"F32","shape":[16],"data_offsets":[0,64]},"a":{"dtype":"F32","shape":[16],"data_offsets":[0,64]}}'
    ),
    "names of ours, empty": header({"replay.flag": entry("U8", (0,), (0, 0))}, b""),
}


@pytest.mark.parametrize("kind", HEADERS)
def test_a_hostile_header_is_refused(saved, tmp_path, kind):
    """Whatever the header of the tensors' file promises, resuming ends with a typed error and an unchanged trainer."""
    found = files.load_latest(saved[0] / CHECKPOINTS)
    path = files.save(tmp_path / CHECKPOINTS, found.tensors, found.manifest, keep=1)
    forge(path, HEADERS[kind])
    trainer = OffPolicyTrainer(CONFIG, TEAM)
    before = trainer.actors().digest()
    with pytest.raises(CheckpointError):
        RunStorage(tmp_path, CONFIG).restore(trainer, Ledger())
    assert trainer.actors().digest() == before


def test_a_file_larger_than_any_state_of_the_run_is_not_read(saved, tmp_path, monkeypatch):
    """A sparse file of a terabyte, or of the largest size that the format allows, is refused by its size alone."""
    found = files.load_latest(saved[0] / CHECKPOINTS)
    trainer = OffPolicyTrainer(CONFIG, TEAM)
    path = files.save(tmp_path / CHECKPOINTS, found.tensors, found.manifest, keep=1)
    tensors = path / "tensors.safetensors"
    most = trainer.largest_checkpoint() + SLACK_BYTES
    assert tensors.stat().st_size < most < 2**28
    for size in (most + 1, files.MAX_TENSORS, 2**40):
        with tensors.open("r+b") as file:
            file.truncate(size)
        with pytest.raises(CheckpointError, match="is larger than"):
            RunStorage(tmp_path, CONFIG).restore(trainer, Ledger())


@pytest.mark.parametrize("times", [1, 2])
def test_a_disk_that_returns_wrong_bytes(saved, tmp_path, monkeypatch, times):
    """A read that goes wrong once is repeated; when it goes wrong again, the checkpoint counts as damaged."""
    found = files.load_latest(saved[0] / CHECKPOINTS)
    files.save(tmp_path / CHECKPOINTS, found.tensors, found.manifest, keep=1)
    reads, read = [], files._read

    def wrong(path: Path, limit: int) -> bytes:
        data = read(path, limit)
        if path.name != "tensors.safetensors":
            return data
        reads.append(path)
        if len(reads) > times:
            return data
        place = random.Random(len(reads)).randrange(len(data))
        return data[:place] + bytes([data[place] ^ 4]) + data[place + 1 :]

    monkeypatch.setattr(files, "_read", wrong)
    if times == 1:
        assert RunStorage(tmp_path, CONFIG).restore(OffPolicyTrainer(CONFIG, TEAM), Ledger()) == (1.0, 3)
    else:
        with pytest.raises(CheckpointError, match="checksums"):
            RunStorage(tmp_path, CONFIG).restore(OffPolicyTrainer(CONFIG, TEAM), Ledger())
    assert len(reads) == 2


def test_a_run_directory_that_is_replaced_stops_the_learner(tmp_path):
    """Gone is an alarm, because it may come back; another directory under its name is an error."""
    run = tmp_path / "run"
    run.mkdir()
    storage = RunStorage(run, CONFIG)
    assert storage.alarms() == ["", ""]
    storage.require_same_directory()
    run.rename(tmp_path / "away")
    storage.require_same_directory()
    assert "is gone; nothing is kept" in storage.alarms()[1]
    storage.save(OffPolicyTrainer(CONFIG, TEAM), Ledger(), 0.0, 1, wait=True)
    assert "no checkpoint could be written" in storage.alarm
    assert not run.exists()
    run.mkdir()
    with pytest.raises(RunDirError, match="taken the place"):
        storage.require_same_directory()
    run.rmdir()
    (tmp_path / "away").rename(run)
    storage.require_same_directory()
    storage.save(OffPolicyTrainer(CONFIG, TEAM), Ledger(), 0.0, 1, wait=True)
    assert storage.alarms() == ["", ""]


def test_weights_that_overflow_are_refused(saved, tmp_path):
    """Finite weights of 1e38 would make every value NaN at the next update; large ones that networks have are taken."""
    found = files.load_latest(saved[0] / CHECKPOINTS)
    for size, refused in ((1e38, True), (1e9, False)):
        forged = found.tensors["engine.actors.parameters"].clone()
        forged.view(-1)[0] = size
        assert (restored_tensor(tmp_path, found, "engine.actors.parameters", forged) is None) == refused
