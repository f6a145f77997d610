"""Requests spoilt in every field of their declarations: all are answered, and an honest worker is served."""

import json
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path
from typing import Any

import pytest

from eia_sec.common.protocol import keys
from tests.faults.test_refusals import of, parcel
from tests.faults.tools.channel import RULES, RUN, TEAM, Parcel, a_chunk, front_door, shut
from tests.faults.tools.harness import LONG, FaultRun, memory, record_result, run
from tests.faults.tools.hostile import PER_NAME, kinds, request
from tests.system.fleet import until

FAST = LONG.replace("updates_per_step = 0.5", "updates_per_step = 0.05")
"""A run whose pace the workers set."""
KINDS = 1_000


def test_every_kind_is_answered_and_no_ledger_is_spoilt():
    """Of over a thousand kinds none ends the receiver, and an honest worker's chunks are taken in between."""
    receiver, door = front_door(chunks=8192)
    every, honest, fates = kinds(TEAM, RULES), 0, Counter[str]()
    assert len({kind.label for kind in every}) >= KINDS
    for index, kind in enumerate(every):
        name = f"h{index // PER_NAME}"
        payload, attachment = request(kind, TEAM, RULES, name, 1 + index)
        answered = door.pass_on(Parcel(keys.TRANSITION.key(RUN, worker=name), payload, attachment))
        fates[answered.verdict if answered.answer is not None else "turned down"] += 1
        if index % 10 == 0:
            honest += 1
            assert door.pass_on(parcel(of(a_chunk(honest), honest), number=honest)).verdict == "accepted"
    totals = receiver.ledger.totals()
    assert not receiver.failed
    assert receiver.ledger.unexplained() == 0
    assert (receiver.ledger.workers["w"].accepted, receiver.ledger.workers["w"].lost) == (honest, 0)
    # A start may say that its spool is full when it ends, and no more than that.
    assert totals["lost"] <= RULES.spool_chunks * RULES.steps
    # What is still lawful, another seed of a farm for instance, is taken.
    assert 0 < fates["accepted"] < len(every) / 4
    shut(receiver, door)


def attack(directory: Path, seconds: float) -> dict[str, Any]:
    """Send all kinds to the learner of a real run beside an honest worker; return how both fared."""
    with run(directory, FAST) as fleet:
        learner = fleet.learner()
        fleet.worker("a")
        until(lambda: fleet.taken("a") > 20, "chunks of the honest worker", 240.0)
        rates: dict[str, float] = {}
        measured: dict[str, Any] = {}
        for case in ("alone", "under attack"):
            count, started = _accepted(fleet), time.monotonic()
            if case == "alone":
                time.sleep(seconds)
            else:
                measured = _send(fleet, seconds, learner)
            rates[case] = (_accepted(fleet) - count) / (time.monotonic() - started)
        until(lambda: fleet.status().get("ledger"), "a status")
        fleet.end()
        found, ledger = fleet.audit(), fleet.status()["ledger"]
        return {
            **measured,
            "share_kept": round(rates["under attack"] / rates["alone"], 3),
            **{f"chunks_per_second {case}": round(rate, 1) for case, rate in rates.items()},
            "unexplained": len(found.unexplained) + ledger["unexplained"],
        }


def _accepted(fleet: FaultRun) -> int:
    return sum(len(entry.numbers) for entry in fleet.accepted("a"))


def _send(fleet: FaultRun, seconds: float, learner: "subprocess.Popen[bytes]") -> dict[str, Any]:
    """Attack from a process that comes after all others; return its counts, and how the learner's memory grew.

    The learner keeps the memory of its largest message, so what counts is growth after every kind has come once.
    """
    where = (str(fleet.endpoint), str(fleet.config), str(seconds))
    command = ["nice", "-n", "10", sys.executable, "-m", "tests.faults.tools.hostile", *where]
    before = memory(learner)
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as attacker:
        assert attacker.stdout is not None
        attacker.stdout.readline()  # it has sent every kind once
        once = memory(learner)
        answer = json.loads(attacker.stdout.readline())
        grown = {"first_round_mib": round(once - before, 1), "learner_grew_mib": round(memory(learner) - once, 1)}
    return {**answer, **grown}


@pytest.mark.nightly
@pytest.mark.timeout(900)
def test_hostile_chunks_at_full_dose(tmp_path):
    """All kinds, again and again for a minute: all answered, memory flat, four fifths of the honest worker's rate."""
    measured = attack(tmp_path, 60.0)
    record_result("hostile_chunks", **measured)
    assert measured["kinds"] >= KINDS
    assert measured["answered"] == measured["requests"]
    assert measured["unexplained"] == 0
    assert measured["share_kept"] >= 0.8
    assert measured["learner_grew_mib"] <= 32
