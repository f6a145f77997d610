"""Checkpoints: whole or not at all, and any damage is noticed."""

import json
import random
import shutil

import pytest
import torch

from eia_sec.common.errors import CheckpointError
from eia_sec.learner.checkpoint import files

TENSORS = {
    "a": torch.arange(12, dtype=torch.float32).view(3, 4),
    "halved": torch.tensor([[0.1, -3.0], [1e38, 0.0]], dtype=torch.bfloat16),
    "flags": torch.tensor([1, 0, 4], dtype=torch.uint8),
}
BODY = {"updates": 7, "name": "run", "nested": {"random": [2**63, 0.1]}}


def test_what_is_saved_is_loaded(tmp_path):
    """Tensors and manifest come back as they were, of the newest checkpoint."""
    files.save(tmp_path, {"a": torch.zeros(2)}, {}, keep=3)
    files.save(tmp_path, TENSORS, BODY, keep=3)
    found = files.load_latest(tmp_path)
    assert found is not None
    assert found.manifest == BODY
    assert found.skipped == ()
    assert found.tensors.keys() == TENSORS.keys()
    for name, tensor in TENSORS.items():
        assert torch.equal(found.tensors[name], tensor)
        assert found.tensors[name].dtype == tensor.dtype


def test_only_the_newest_are_kept(tmp_path):
    """Of five checkpoints the newest two remain, and numbers go on rising."""
    for number in range(5):
        files.save(tmp_path, TENSORS, {"number": number}, keep=2)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["checkpoint-00000004", "checkpoint-00000005"]
    assert files.load_latest(tmp_path).manifest == {"number": 4}


def test_nothing_saved_is_nothing_found(tmp_path):
    """A folder that is empty, missing, or holds only an unfinished write has no checkpoint."""
    assert files.load_latest(tmp_path) is None
    assert files.load_latest(tmp_path / "missing") is None
    (tmp_path / "partial-00000001").mkdir()
    assert files.load_latest(tmp_path) is None
    files.save(tmp_path, TENSORS, BODY, keep=2)
    assert [path.name for path in tmp_path.iterdir()] == ["checkpoint-00000001"]


def damaged(data, way, draw):
    if way == "cut":
        return data[: draw.randrange(len(data))]
    if way == "longer":
        return data + b"\0"
    place = draw.randrange(len(data))
    return data[:place] + bytes([data[place] ^ 1 << draw.randrange(8)]) + data[place + 1 :]


@pytest.mark.parametrize("file", ["tensors.safetensors", "manifest.json"])
@pytest.mark.parametrize("way", ["cut", "flip", "longer"])
def test_any_damage_is_noticed_and_the_one_before_is_used(tmp_path, file, way):
    """Files cut, lengthened or bit-flipped at random places are refused, and the checkpoint before is loaded."""
    draw = random.Random(f"{file} {way}")
    files.save(tmp_path, TENSORS, {"number": 1}, keep=2)
    path = files.save(tmp_path, TENSORS, {"number": 2}, keep=2) / file
    whole = path.read_bytes()
    for _ in range(60):
        path.write_bytes(damaged(whole, way, draw))
        found = files.load_latest(tmp_path)
        assert found.manifest == {"number": 1}
        assert len(found.skipped) == 1
        assert "checkpoint-00000002" in found.skipped[0][1]
    path.write_bytes(whole)
    assert files.load_latest(tmp_path).manifest == {"number": 2}


def test_a_damaged_checkpoint_takes_no_place_of_a_whole_one(tmp_path):
    """Of two that are kept the newer is damaged: the next one leaves the whole one alone, which may be wanted again."""
    for number in (1, 2):
        path = files.save(tmp_path, TENSORS, {"number": number}, keep=2)
    for number in (3, 4):
        (path / "tensors.safetensors").write_bytes(b"")
        found = files.load_latest(tmp_path)
        assert found.manifest == {"number": 1}
        files.set_aside([damaged for damaged, _ in found.skipped])
        path = files.save(tmp_path, TENSORS, {"number": number}, keep=2)
    assert files.load_latest(tmp_path).manifest == {"number": 4}
    names = sorted(path.name for path in tmp_path.iterdir())
    assert names == ["checkpoint-00000001", "checkpoint-00000002", "damaged-checkpoint-00000002"]


def test_a_file_that_is_gone_is_noticed(tmp_path):
    """A checkpoint without its tensors is damaged, and when no other is left the error says so."""
    path = files.save(tmp_path, TENSORS, BODY, keep=2)
    (path / "tensors.safetensors").unlink()
    with pytest.raises(CheckpointError, match="are damaged"):
        files.load_latest(tmp_path)


def test_swapped_tensors_are_noticed(tmp_path):
    """Tensors of another checkpoint, whole in themselves, do not pass for this one's."""
    first = files.save(tmp_path, TENSORS, {}, keep=2)
    second = files.save(tmp_path, {"a": torch.ones(3, 4)}, {}, keep=2)
    shutil.copy(first / "tensors.safetensors", second / "tensors.safetensors")
    with pytest.raises(CheckpointError, match="checksums"):
        files.load(second)


@pytest.mark.parametrize("content", ["[]", "null", '{"format":1}', '{"format":2,"body":{}}', "[" * 100_000, "nonsense"])
def test_a_manifest_of_another_kind_is_refused(tmp_path, content):
    """A manifest that is no manifest of this format raises CheckpointError, whatever else it is."""
    path = files.save(tmp_path, TENSORS, BODY, keep=1)
    (path / "manifest.json").write_text(content)
    with pytest.raises(CheckpointError):
        files.load(path)


def test_a_failed_write_leaves_the_checkpoint_before(tmp_path, monkeypatch):
    """When the disk refuses the manifest, the error is raised, no remains stay and the older checkpoint loads."""
    files.save(tmp_path, TENSORS, {"number": 1}, keep=1)
    write = files._write

    def refuse(path, data):
        if path.name == "manifest.json":
            raise OSError(28, "no space left on device")
        write(path, data)

    monkeypatch.setattr(files, "_write", refuse)
    with pytest.raises(OSError, match="no space"):
        files.save(tmp_path, TENSORS, {"number": 2}, keep=1)
    assert [path.name for path in tmp_path.iterdir()] == ["checkpoint-00000001"]
    assert files.load_latest(tmp_path).manifest == {"number": 1}


def test_the_manifest_is_plain_json(tmp_path):
    """Anybody can read the manifest without this project."""
    path = files.save(tmp_path, TENSORS, BODY, keep=1)
    assert json.loads((path / "manifest.json").read_text())["body"] == BODY


@pytest.mark.parametrize("limit", ["MAX_MANIFEST", "MAX_TENSORS"])
def test_what_could_not_be_read_is_not_written(tmp_path, monkeypatch, limit):
    """A checkpoint beyond what `load` takes would cost the readable ones before it their place."""
    files.save(tmp_path, {"a": torch.zeros(8)}, {"n": 1}, keep=1)
    monkeypatch.setattr(files, limit, 10)
    with pytest.raises(CheckpointError, match="more than a checkpoint holds"):
        files.save(tmp_path, {"a": torch.zeros(8)}, {"n": 2}, keep=1)
    monkeypatch.undo()
    assert files.load_latest(tmp_path).manifest == {"n": 1}
    assert [path.name for path in tmp_path.iterdir()] == ["checkpoint-00000001"]


@pytest.mark.parametrize("dtype", [torch.float32, torch.bfloat16, torch.float64])
@pytest.mark.parametrize("value", [torch.inf, -torch.inf, torch.nan])
def test_numbers_that_are_not_finite_are_not_saved(tmp_path, dtype, value):
    """The name of the tensor is stated, and the checkpoint before stays."""
    files.save(tmp_path, TENSORS, BODY, keep=1)
    with pytest.raises(CheckpointError, match="spoilt holds a number that is not finite"):
        files.save(tmp_path, {"spoilt": torch.tensor([0.0, value], dtype=dtype)}, {}, keep=1)
    assert files.load_latest(tmp_path).manifest == BODY
