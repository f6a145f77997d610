"""Whatever bytes come in, only typed errors come out, and no memory is taken for them."""

import random
import time
from pathlib import Path

import psutil
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.faults.tools.harness import record_result
from tests.faults.tools.mutants import READERS, feed, mutant, pass_through, samples, sealed

CORPUS = Path(__file__).parent / "corpus"


def test_every_kind_of_message_has_a_sample():
    """Each kind of message has a whole frame among the samples, and its own decoder takes it."""
    assert set(samples()) == set(READERS)
    assert all(feed(data) for data in samples().values())


def test_the_corpus_of_the_fuzzer():
    """What coverage-guided fuzzing has found worth keeping raises nothing but typed errors."""
    files = sorted(CORPUS.glob("*"))
    assert len(files) >= len(READERS)
    taken = [feed(data) or feed(sealed(data)) for data in (file.read_bytes() for file in files)]
    assert sum(taken) >= len(READERS)


@settings(max_examples=150, deadline=None)
@given(st.sampled_from(sorted(samples())), st.integers(0, 2**32), st.binary(max_size=64))
def test_spoilt_frames_raise_typed_errors_only(name, seed, tail):
    """A spoilt frame, or one with a strange tail, is a ProtocolError or a message."""
    data = mutant(samples()[name], random.Random(seed))
    assert feed(data) in (True, False)
    assert feed(sealed(data + tail)) in (True, False)


def test_many_mutants():
    """Thousands of mutants raise typed errors only, and some are whole messages, so the deep checks are reached."""
    assert 0 < pass_through(10_000, seed=1) < 10_000


@pytest.mark.nightly
@pytest.mark.timeout(3600)
def test_a_million_mutants():
    """A million mutated frames raise typed errors only, and memory grows by at most 32 MiB."""
    pass_through(20_000, seed=0)
    own, started = psutil.Process(), time.process_time()
    before = own.memory_info().rss
    taken = pass_through(1_000_000, seed=2)
    grown = (own.memory_info().rss - before) / 2**20
    seconds = round(time.process_time() - started, 1)
    record_result(
        "mutated_frames", frames=1_000_000, messages=taken, grown_mib=round(grown, 2), processor_seconds=seconds
    )
    assert grown <= 32
