"""The intake benchmark: what it counts, and that our own path really takes chunks in."""

import json
import sys

import numpy as np
import pytest

from research.benchmarks.intake import __main__ as driver
from research.benchmarks.intake.chunks import CAPACITY, NAMES, Ring, Window, read, steps_in_rows
from research.benchmarks.intake.page import SIZES, page
from research.benchmarks.intake.record import record, write
from research.benchmarks.peers.catalogue import ROOT


@pytest.mark.parametrize("size", SIZES.values())
def test_a_recorded_chunk_has_the_wanted_size(size, tmp_path):
    """It is real experience that the learner takes, within a tenth of the size, and the peers read the same arrays."""
    chunk = record(size)
    assert sum(getattr(chunk.rows, name).nbytes for name in NAMES) == pytest.approx(size, rel=0.1)
    write(chunk, tmp_path)
    for name, array in read(tmp_path).items():
        np.testing.assert_array_equal(array, getattr(chunk.rows, name))
    assert steps_in_rows(tmp_path) == chunk.rows.steps / len(chunk.rows.reward)


def test_the_ring_holds_the_newest_rows():
    """Rows go round, each chunk whole."""
    rows = CAPACITY // 3 + 1
    chunks = [{name: np.full((rows, 2), k, np.float32) for name in NAMES} for k in range(4)]
    ring = Ring(chunks[0])
    for chunk in chunks:
        ring.add(chunk)
    assert (ring.rows, ring.bytes) == (4 * rows, 4 * 3 * rows * 8)
    values, counts = np.unique(ring._arrays["reward"][:, 0], return_counts=True)
    assert dict(zip(values.tolist(), counts.tolist(), strict=True)) == {1.0: CAPACITY - 2 * rows, 2.0: rows, 3.0: rows}


def test_the_window_counts_between_two_looks(monkeypatch):
    """Only what comes after the warm-up counts, by the clock of the window."""
    now = [0.0]
    monkeypatch.setattr("research.benchmarks.intake.chunks.time.perf_counter", lambda: now[0])
    taken = (0, 0)
    window = Window(lambda: taken, seconds=3.0)
    for second in range(1, 20):
        now[0] = float(second)
        taken = (100 * (second - 9), 1_000_000 * (second - 9)) if second >= 10 else (0, 0)
        if window.over():
            break
    assert now[0] == 14.0
    assert window.report(0.5) == {"env_steps_per_second": 50.0, "mb_per_second": 1.0}


def test_a_window_that_nothing_comes_to_ends(monkeypatch):
    """A player that never plays is an error, not a rate of 0."""
    now = [0.0]
    monkeypatch.setattr("research.benchmarks.intake.chunks.time.perf_counter", lambda: now[0])
    window = Window(lambda: (0, 0), seconds=3.0)
    now[0] = 100.0
    with pytest.raises(TimeoutError):
        window.over()


@pytest.mark.parametrize("routed", [False, True])
def test_our_path_takes_chunks_in(routed, tmp_path, capsys):
    """Player and sink as processes, with and without a router between them; what they report becomes a page."""
    bench = driver.Bench(0.3, tmp_path, tmp_path, spool=4)
    assert bench.under_way == {"16 KB": 4, "128 KB": 4, "1 MB": 2}
    result = bench.ours("128 KB", 2, routed=routed, shared=False)
    assert result["env_steps_per_second"] > 0
    assert result["mb_per_second"] > 0
    data = {
        **{"command": "c", "commit": "d", "cores": 2, "workers": 2, "chunks_under_way": bench.under_way},
        "transports": {"ours": {"131072": result}},
    }
    assert f"{result['env_steps_per_second']:,.0f}" in page(data)
    assert "4 of 128 KB" in page(data)
    assert json.dumps(data)


@pytest.mark.parametrize("words", [["0"], ["8", "5000"], ["8", "8"], ["many"]])
def test_an_impossible_number_of_workers_is_refused(words, monkeypatch, capsys):
    """A mistake ends with one sentence and exit code 2, before anything is installed or measured."""
    monkeypatch.setattr("sys.argv", ["intake", "--workers", *words])
    with pytest.raises(SystemExit) as ended:
        driver.main()
    assert ended.value.code == 2
    assert "--workers" in capsys.readouterr().err


def test_children_import_this_checkout(tmp_path, monkeypatch):
    """Whatever is installed, a child finds the sources of its parent's checkout first."""
    monkeypatch.setattr(driver, "SIZES", {})
    bench = driver.Bench(0.1, tmp_path, tmp_path, spool=1)
    searched, _ = bench._start(sys.executable, "site").communicate(timeout=60)
    assert 0 < searched.index(f"'{ROOT / 'src'}'") < searched.index("site-packages")
