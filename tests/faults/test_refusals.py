"""Whole frames that do not belong here are refused with a typed error and counted, and the others go on."""

import json
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from eia_sec.common.config import ReplayConfig
from eia_sec.common.protocol import frame, keys
from eia_sec.common.protocol.chunk_messages import MOST_BYTES, MOST_CHUNKS, to_message, to_request
from eia_sec.common.protocol.messages import ChunkMessage, DeliveryMessage, Envelope
from eia_sec.common.transitions import Chunk, Rows
from eia_sec.learner.intake.peer_penalties import LIMIT
from tests.faults.tools.channel import RUN, TEAM, Parcel, a_chunk, front_door, next_arrival, shut
from tests.faults.tools.harness import LONG, FaultRun, record_result, run
from tests.system.fleet import RUN as RUN_NAME
from tests.system.fleet import until

FAST = LONG.replace("updates_per_step = 0.5", "updates_per_step = 0.05")
"""A run whose pace the workers set."""


def spoilt(**parts: Any) -> Chunk:
    """Return a chunk with some arrays replaced."""
    rows = a_chunk(1).rows
    return Chunk(Rows(**{**vars(rows), **parts}))


def request(payload: bytes, number: int = 1, name: str = "w") -> Parcel:
    return Parcel(keys.TRANSITION.key(RUN, worker=name), payload, Envelope("rollout", name, 1, number, 1).encode())


def parcel(*chunks: ChunkMessage | bytes, number: int = 1, name: str = "w") -> Parcel:
    """Return a request with chunks, the first of which bears a number and is the oldest that is held."""
    sealed = [chunk if isinstance(chunk, bytes) else chunk.encode() for chunk in chunks]
    return request(to_request(sealed, number, number + len(sealed) - 1), number, name)


def of(chunk: Chunk, number: int = 1, version: int = 1) -> ChunkMessage:
    return to_message(chunk, TEAM, version, number)


ROWS = a_chunk(1).rows
NAN, INF = np.full_like(ROWS.observation, np.nan), np.full_like(ROWS.reward, np.inf)
WRONG = {
    "another observation size": of(spoilt(observation=np.zeros((2, 99), np.float32))),
    "another action size": of(spoilt(action=np.zeros((2, 1), np.float32))),
    "rows that do not agree": of(spoilt(reward=np.zeros((3, TEAM.agents), np.float32))),
    "not a number": of(spoilt(observation=NAN)),
    "infinite": of(spoilt(reward=INF)),
    "an action out of range": of(spoilt(action=ROWS.action + 1.0)),
    "impossible flags": of(spoilt(flag=np.array([9, 0], np.uint8))),
    "too many rows": of(
        Chunk(
            Rows(
                *(np.repeat(a, 300, axis=0) for a in (ROWS.observation, ROWS.action, ROWS.reward)),
                np.zeros(600, np.uint8),
            )
        )
    ),
    "another team": ChunkMessage(**{**vars(of(a_chunk(1))), "team": "0" * 16}),
    "a field too many": frame.encode(ChunkMessage.KIND, {"more": 1}, {}),
    "fewer steps than it holds": to_message(a_chunk(1), TEAM, 1, 0),
    "more steps than anybody flies": to_message(a_chunk(1), TEAM, 1, 2**63 - 1),
    "arrays of another type": of(spoilt(observation=ROWS.observation.astype(np.float64))),
}


@pytest.mark.parametrize("what", WRONG)
def test_what_does_not_fit_is_refused_and_the_next_chunk_taken(what):
    """The number is spent, the reason given, and the worker's next whole chunk is accepted."""
    receiver, door = front_door()
    try:
        answer = door.pass_on(parcel(WRONG[what])).answer
        assert answer is not None
        assert (answer.verdicts, answer.expected) == (("refused",), 2)
        assert answer.reasons[0]
        assert door.pass_on(parcel(of(a_chunk(2), 2), number=2)).verdict == "accepted"
        totals = receiver.ledger.totals()
        assert (totals["refused"], totals["rejected"], totals["accepted"], totals["lost"]) == (1, 1, 1, 0)
    finally:
        shut(receiver, door)


def test_a_frame_of_another_protocol_is_asked_for_again_and_then_refused():
    """A frame that stays unreadable is refused after a few times, so that its worker is not held up for ever."""
    receiver, door = front_door()
    newer = bytearray(of(a_chunk(1)).encode())
    newer[4] += 1
    answers = [door.pass_on(parcel(bytes(newer))).verdict for _ in range(8)]
    assert answers == ["damaged"] * 7 + ["refused"]
    assert door.pass_on(parcel(of(a_chunk(2), 2), number=2)).verdict == "accepted"
    shut(receiver, door)


def test_a_damaged_chunk_that_overtook_spends_no_number():
    """An unreadable frame ahead of its turn leaves the numbers before it free."""
    receiver, door = front_door()
    for _ in range(LIMIT - 1):
        assert door.pass_on(parcel(b"junk", number=3)).verdict == "damaged"
    for number in (1, 2, 3):
        assert door.pass_on(parcel(of(a_chunk(number), number), number=number)).verdict == "accepted"
    shut(receiver, door)


def test_one_bad_chunk_among_good_ones_is_refused_alone():
    """In one request each chunk has its own verdict: what does not fit spends its number, the others are taken."""
    receiver, door = front_door()
    answer = door.pass_on(parcel(of(a_chunk(1)), of(spoilt(observation=NAN), 2), of(a_chunk(3), 3))).answer
    assert answer.verdicts == ("accepted", "refused", "accepted")
    assert [bool(reason) for reason in answer.reasons] == [False, True, False]
    assert answer.expected == 4
    totals = receiver.ledger.totals()
    assert (totals["accepted"], totals["rejected"], totals["lost"], totals["in_flight"]) == (2, 1, 0, 0)
    assert receiver.peer_penalties.counts() == {"w": 1}
    assert [receiver.arrivals.get_nowait().sender.sequence for _ in range(2)] == [1, 3]
    shut(receiver, door)


def test_a_damaged_chunk_stops_its_request_there():
    """What is before it is taken, it and all behind it come again, and then nothing is taken twice."""
    receiver, door = front_door()
    whole = [of(a_chunk(number), number).encode() for number in (1, 2, 3)]
    torn = whole[1][:-1] + bytes([whole[1][-1] ^ 1])
    answer = door.pass_on(parcel(whole[0], torn, whole[2])).answer
    assert (answer.verdicts, answer.expected) == (("accepted", "damaged"), 2)
    assert door.pass_on(parcel(*whole)).answer.verdicts == ("duplicate", "accepted", "accepted")
    totals = receiver.ledger.totals()
    assert (totals["accepted"], totals["damaged"], totals["duplicates"], totals["lost"]) == (3, 1, 1, 0)
    shut(receiver, door)


def test_a_chunk_that_stays_damaged_does_not_hold_up_those_behind_it():
    """After a few tries it is refused, and in the same request the rest is taken."""
    receiver, door = front_door()
    torn, good = of(a_chunk(1)).encode()[:-1], of(a_chunk(2), 2)
    answers = [door.pass_on(parcel(torn, good)).answer.verdicts for _ in range(8)]
    assert answers == [("damaged",)] * 7 + [("refused", "accepted")]
    shut(receiver, door)


def test_old_chunks_are_refused_beside_new_ones():
    """The limit of age looks at the version of each chunk, not of the request."""
    receiver, door = front_door(most_lag=5)
    receiver.room.set_version(10)
    answer = door.pass_on(parcel(of(a_chunk(1), 1, 4), of(a_chunk(2), 2, 5))).answer
    assert answer.verdicts == ("refused", "accepted")
    assert [receiver.arrivals.get_nowait().sender.version] == [5]
    shut(receiver, door)


def test_a_learner_that_ends_takes_the_beginning_of_a_request():
    """What found room is accepted, the next is answered with "closed", and the worker keeps it and the rest."""
    receiver, door = front_door(chunks=2)
    delivered: list[Parcel] = []
    waiting = parcel(*(of(a_chunk(number), number) for number in (1, 2, 3, 4)))
    sending = threading.Thread(target=lambda: delivered.append(door.pass_on(waiting)))
    sending.start()
    until(receiver.arrivals.full, "a full queue")
    receiver.close()
    sending.join(10.0)
    assert delivered[0].answer.verdicts == ("accepted", "accepted", "closed")
    shut(receiver, door)


@pytest.mark.parametrize("room", [16, 2])
def test_who_waits_for_chunks_is_woken(room):
    """A whole request wakes the learner, and so does a full queue, while the rest of the request waits for room."""
    receiver, door = front_door(chunks=room)
    sending = threading.Thread(target=door.pass_on, args=[parcel(*(of(a_chunk(n), n) for n in range(1, 6)))])
    sending.start()
    taken: list[int] = []
    while len(taken) < 5:
        began = time.monotonic()
        arrival = next_arrival(receiver, 30.0)
        assert arrival is not None or time.monotonic() - began < 30.0, "nobody woke it"
        if arrival is not None:
            taken.append(arrival.sender.sequence)
    sending.join(10.0)
    assert taken == [1, 2, 3, 4, 5]
    assert next_arrival(receiver, 0.001) is None
    shut(receiver, door)


SMALL = of(a_chunk(1)).encode()
TOO_MUCH = {
    "no chunk at all": DeliveryMessage(1, 1, ()).encode(),
    "too many chunks": to_request([SMALL] * (MOST_CHUNKS + 1), 1, 1),
    "too many bytes": to_request([bytes(MOST_BYTES // 2 + 1)] * 2, 1, 1),
}


@pytest.mark.parametrize("what", TOO_MUCH)
def test_requests_beyond_the_limits_are_refused_and_counted(what):
    """A request that breaks the declared limits is not looked into; its first number is spent, its sender noted."""
    receiver, door = front_door()
    assert door.pass_on(request(TOO_MUCH[what])).verdict == "refused"
    assert receiver.peer_penalties.counts() == {"w": 1}
    assert door.pass_on(parcel(of(a_chunk(2), 2), number=2)).verdict == "accepted"
    shut(receiver, door)


def test_sizes_that_promise_what_did_not_come():
    """Sizes are held against what is there before anything is cut out; a promise takes no memory."""
    receiver, door = front_door()
    for sizes in ((2**62,), (len(SMALL), 2**40), (len(SMALL) - 1,)):
        assert door.pass_on(request(DeliveryMessage(1, 1, sizes).encode() + SMALL)).verdict == "damaged"
    assert door.pass_on(parcel(SMALL)).verdict == "accepted"
    shut(receiver, door)


def test_a_receiver_that_waits_for_room_ends_when_nobody_makes_any():
    """With a full queue and a chunk in hand it can be joined, and the chunk is answered: not taken."""
    receiver, door = front_door(chunks=1)
    assert door.pass_on(parcel(of(a_chunk(1)))).verdict == "accepted"
    late = parcel(of(a_chunk(2), 2), number=2)
    door.push(late)
    door.close()
    receiver.close()
    door.thread.join()
    assert late.answer is not None
    assert late.verdict == "closed"


JUNK = parcel(b"junk", number=9), "damaged"
AGAIN = parcel(of(a_chunk(1))), "duplicate"
AHEAD = request(to_request([of(a_chunk(9), 9).encode()], 2, 9), 9), "gap"


@pytest.mark.parametrize(("sent", "answer"), [JUNK, AGAIN, AHEAD], ids=["junk", "again", "ahead"])
def test_whoever_keeps_sending_what_brings_nothing_is_blocked(sent, answer):
    """Unreadable, the same again or out of turn: after LIMIT in a row the answers are held back; others go on."""
    receiver, door = front_door()
    assert door.pass_on(parcel(of(a_chunk(1)))).verdict == "accepted"
    answers = [door.pass_on(Parcel(sent.key, sent.payload, sent.attachment)).verdict for _ in range(LIMIT)]
    assert answers == [answer] * LIMIT
    late = Parcel(sent.key, sent.payload, sent.attachment)
    door.push(late)
    assert door.pass_on(parcel(of(a_chunk(1)), name="other")).verdict == "accepted"
    assert (late.answer, late.refused, receiver.throttle.turned_away) == (None, "", 1)
    assert "worker w is blocked" in receiver.peer_penalties.alarms()[0]
    shut(receiver, door)


def test_chunks_of_a_policy_that_is_too_old_are_refused_and_counted():
    """Beyond `replay.max_age_versions` a chunk is refused with the reason; its steps are rejected, and exactly so."""
    receiver, door = front_door(most_lag=5)
    receiver.room.set_version(10)
    assert door.pass_on(parcel(of(a_chunk(1), 1, 4))).verdict == "refused"
    assert "6 versions old" in door.pass_on(parcel(of(a_chunk(2), 2, 4), number=2)).answer.reasons[0]
    totals = receiver.ledger.totals()
    assert (totals["aged"], totals["rejected"], totals["produced"], totals["in_flight"]) == (2, 2, 2, 0)
    assert door.pass_on(parcel(of(a_chunk(3), 3, 5), number=3)).verdict == "accepted"
    assert receiver.ledger.totals()["lost"] == 0
    shut(receiver, door)


def test_no_limit_of_age_is_the_default():
    """Without the setting a chunk of any version is taken."""
    assert ReplayConfig().max_age_versions == 0
    receiver, door = front_door()
    receiver.room.set_version(1_000_000)
    assert door.pass_on(parcel(of(a_chunk(1)))).verdict == "accepted"
    shut(receiver, door)


def flood(directory: Path, seconds: float) -> dict[str, Any]:
    """Let three workers deliver, without and with a fourth process that floods with junk; return their rates."""
    with run(directory, FAST) as fleet:
        fleet.learner()
        for name in "abc":
            fleet.worker(name)
        until(lambda: all(fleet.taken(name) > 20 for name in "abc"), "chunks of all")
        rates, made = {}, 0
        for case in ("alone", "with a flood"):
            before, started = fleet.taken(), time.monotonic()
            if case == "alone":
                time.sleep(seconds)
            else:
                made = _junk(fleet, seconds)
            rates[case] = (fleet.taken() - before) / (time.monotonic() - started)
        peer_penalties = fleet.status()["malformed_by"]
        fleet.end()
        audited = fleet.audit()
    return {
        "share_kept": round(rates["with a flood"] / rates["alone"], 3),
        **{f"chunks_per_second {case}": round(rate, 1) for case, rate in rates.items()},
        "junk_requests": made,
        "peer_penalties": peer_penalties,
        "unexplained": len(audited.unexplained),
    }


def _junk(fleet: FaultRun, seconds: float) -> int:
    """Flood for some seconds from a process that comes after all others; return its requests."""
    where = (fleet.endpoint.locator("bulk"), keys.TRANSITION.key(RUN_NAME, worker="flood"), str(seconds))
    command = ["nice", "-n", "10", sys.executable, "-m", "tests.faults.tools.flooder", *where]
    done = subprocess.run(command, capture_output=True, check=True, timeout=seconds + 60.0)
    return int(json.loads(done.stdout)["requests"])


def test_a_flood_of_junk_by_one_worker(tmp_path):
    """While one worker floods, everything of the others is taken, exactly; who floods is blocked and named."""
    measured = flood(tmp_path, 2.0)
    assert measured["junk_requests"] > 20
    assert measured["peer_penalties"]["flood"] >= 20
    assert measured["unexplained"] == 0


@pytest.mark.nightly
def test_a_flood_at_full_dose(tmp_path):
    """The others keep four fifths of their rate."""
    measured = flood(tmp_path, 20.0)
    record_result("flood", **measured)
    assert measured["unexplained"] == 0
    assert measured["share_kept"] >= 0.8
