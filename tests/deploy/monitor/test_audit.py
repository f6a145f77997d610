"""The audit explains what can be explained, and names what cannot."""

import json

import pytest

from eia_sec.common.errors import RunDirError
from eia_sec.common.history.history import End, Entry, History, Resume, Start
from eia_sec.deploy.cli import dispatch
from eia_sec.deploy.monitor.audit import NAMED, audit


def write(tmp_path, learner, worker=None, *, ended=False):
    """Write histories: entries of the learner and of worker a, start 1, in short."""
    folder = tmp_path / "history"
    for name, role, records in (("learner", "learner", learner), ("rollout-a", "rollout", worker)):
        if records is None:
            continue
        history = History(folder / f"{name}.jsonl")
        history.add(Start(role, name.removeprefix("rollout-"), 1))
        for record in records:
            history.add(Entry(record[0], "a", 1, *record[1:]) if isinstance(record, tuple) else record)
        if ended:
            history.add(End())
    return audit(tmp_path)


def made(count):
    return ("produced", 1, count, 10)


def test_all_fates(tmp_path):
    """Accepted, rejected, lost with the learner and in flight are kept apart, and their sum is what was produced."""
    learner = [("accepted", 1, 4, 10), ("refused", 5, 5, 0), Resume({"a": (1, 3)}), ("accepted", 6, 6, 10)]
    found = write(
        tmp_path, learner, [made(8), ("acknowledged", 1, 4, 10), ("refused", 5, 5, 10), ("acknowledged", 6, 6, 10)]
    )
    assert found.clean, found.unexplained
    assert dict(found.chunks) == {"accepted": 3, "lost": 2, "rejected": 1, "in_flight": 2}
    assert found.produced == 80
    assert found.lost_with == {"learner": 20}


def test_what_an_ended_worker_held_is_lost(tmp_path):
    """Nothing is in flight any more when its worker has ended."""
    found = write(tmp_path, [("accepted", 1, 1, 10)], [made(3), ("acknowledged", 1, 1, 10)], ended=True)
    assert found.clean
    assert (found.chunks["lost"], found.chunks["in_flight"]) == (2, 0)


@pytest.mark.parametrize(
    ("learner", "worker", "said"),
    [
        ([("accepted", 1, 2, 10)], [made(3), ("acknowledged", 1, 3, 10)], "chunk a/1/3 was answered"),
        ([("accepted", 1, 4, 10)], [made(3), ("acknowledged", 1, 3, 10)], "chunk a/1/4 was accepted"),
        ([("accepted", 1, 3, 20)], [made(3)], "chunks a/1/1 to 3 were produced with 10 steps"),
        ([("accepted", 1, 2, 10), ("accepted", 5, 5, 10)], None, "chunk a/1/3 to 4 never arrived"),
        ([("accepted", 5, 6, 10)], None, "chunk a/1/1 to 4 never arrived"),
        ([Resume({"a": (1, 4)}), ("accepted", 5, 6, 10)], None, "chunk a/1/4 to 4 never arrived"),
        ([("accepted", 1, 2, 10), Resume({"a": (1, 5)}), ("accepted", 5, 5, 10)], None, "chunk a/1/3 to 4 never"),
        (
            [("refused", 1, 1, 0)],
            [made(1), ("acknowledged", 1, 1, 10)],
            "chunk a/1/1 was refused, and its worker was answered",
        ),
        ([("accepted", 1, 1, 10)], [made(1), ("refused", 1, 1, 10)], "chunk a/1/1 was accepted, and its worker was"),
        (
            [("accepted", 1, 2, 10), Resume({"a": (1, 2)})],
            [made(2), ("acknowledged", 1, 1, 10), ("refused", 2, 2, 10)],
            "chunk a/1/2 was rolled back, and its worker was answered that it is refused",
        ),
        (
            [("accepted", 1, 1, 10)],
            [made(1), ("acknowledged", 1, 2, 10)],
            "chunk a/1/2 was answered as accepted, and never produced",
        ),
    ],
)
def test_what_nobody_can_explain_is_named(tmp_path, learner, worker, said):
    """An acknowledgement without a record, a chunk from nowhere, other steps, a gap, two verdicts are each named."""
    found = write(tmp_path, learner, worker)
    assert not found.clean
    assert found.unexplained[0].startswith(said)


@pytest.mark.parametrize("fate", ["accepted", "refused"])
def test_a_repeated_chunk_is_a_duplicate_whatever_became_of_it(tmp_path, fate):
    """A worker whose first answer was lost hears only that the chunk came again, also when it had been refused."""
    steps = 10 if fate == "accepted" else 0
    found = write(tmp_path, [(fate, 1, 1, steps), ("duplicate", 1, 1, 1)], [made(1), ("repeated", 1, 1, 10)])
    assert found.clean, found.unexplained
    assert found.chunks["accepted" if fate == "accepted" else "rejected"] == 1


@pytest.mark.parametrize("before", [Resume({"a": (1, 5)}), ("missing", 5, 5, 40)])
def test_a_late_beginning_that_is_explained(tmp_path, before):
    """A checkpoint that knows of the chunks before the history, or their declared loss, is an explanation."""
    found = write(tmp_path, [before, ("accepted", 5, 6, 10)])
    assert found.clean, found.unexplained
    assert found.chunks["accepted"] == 2


@pytest.mark.parametrize("late", [True, False])
def test_a_late_beginning_beside_workers_that_remember_all(tmp_path, late):
    """Answers from before the checkpoint with which the history begins are believed; without one they are not."""
    worker = [made(6), ("acknowledged", 1, 3, 10), ("refused", 4, 4, 10), ("acknowledged", 5, 6, 10)]
    found = write(tmp_path, [*([Resume({"a": (1, 5)})] if late else []), ("accepted", 5, 6, 10)], worker)
    assert found.clean == late, found.unexplained
    assert not late or dict(found.chunks) == {"accepted": 5, "rejected": 1}


def test_a_start_before_a_late_beginning(tmp_path):
    """A start that had ended before the checkpoint is not in it, and the answers that it got are believed, too."""
    learner = [Resume({"a": (2, 3)}), Entry("accepted", "a", 2, 3, 3, 10, 30, 30)]
    worker = [made(2), ("acknowledged", 1, 2, 10), Start("rollout", "a", 2)]
    worker += [Entry(verdict, "a", 2, 1, 3, 10, 30, 30) for verdict in ("produced", "acknowledged")]
    found = write(tmp_path, learner, worker)
    assert found.clean, found.unexplained
    assert found.chunks["accepted"] == 5


@pytest.mark.parametrize("resumed", [False, True])
@pytest.mark.parametrize("remembers", [False, True])
def test_steps_of_a_replaced_start_are_lost_once(tmp_path, remembers, resumed):
    """A worker's own history says which chunks it never delivered; without it the learner's account does."""
    undelivered = Entry("undelivered", "a", 1, 3, 3, 20, 40, 40)
    again = [Resume({"a": (1, 3)}), undelivered] if resumed else []
    learner = [("accepted", 1, 2, 10), undelivered, *again, Entry("accepted", "a", 2, 1, 1, 10, 10, 10)]
    worker = [made(4), ("acknowledged", 1, 2, 10), Start("rollout", "a", 2)]
    worker += [Entry(verdict, "a", 2, 1, 1, 10, 10, 10) for verdict in ("produced", "acknowledged")]
    found = write(tmp_path, learner, worker if remembers else None)
    assert found.clean, found.unexplained
    assert found.steps["lost"] == 20
    assert found.lost_with == ({"worker": 20} if remembers else {"unknown": 20})


def test_a_start_that_delivers_to_a_resumed_learner_after_all_has_lost_nothing(tmp_path):
    """A checkpoint from before the newer start does not know that the earlier one was replaced."""
    undelivered = Entry("undelivered", "a", 1, 3, 3, 20, 40, 40)
    found = write(tmp_path, [("accepted", 1, 2, 10), undelivered, Resume({"a": (1, 3)}), ("accepted", 3, 4, 10)])
    assert found.clean, found.unexplained
    assert (found.steps["accepted"], found.steps["lost"]) == (40, 0)


@pytest.mark.parametrize("late", [True, False])
def test_the_ledger_is_held_against_a_whole_history_only(tmp_path, late):
    """A ledger of the whole run says more than a history that begins with a checkpoint, and that is no defect."""
    status = {"kind": "status", "environment_steps": 60, "ledger": {"accepted": 60, "lost": 0}}
    (tmp_path / "metrics.jsonl").write_text(json.dumps(status) + "\n" + json.dumps({"kind": "end"}) + "\n")
    found = write(tmp_path, [Resume({"a": (1, 5)}), ("accepted", 5, 6, 10)] if late else [("accepted", 1, 2, 10)])
    assert found.steps["accepted"] == 20
    assert found.clean == late, found.unexplained


def damage(path, number):
    """Spoil one line of a file; return how many it has."""
    lines = path.read_text().splitlines(keepends=True)
    lines[number - 1] = lines[number - 1].replace("]", "")
    path.write_text("".join(lines))
    return len(lines)


@pytest.mark.parametrize("name", ["learner", "rollout-a"])
def test_a_damaged_line_is_named_also_after_its_process_came_back(tmp_path, name):
    """A line in the middle that nobody can read is not clean, and going on with the file does not wipe it out."""
    write(tmp_path, [("accepted", 1, 2, 10), ("missing", 3, 3, 0)], [made(2), ("acknowledged", 1, 2, 10)])
    path = tmp_path / "history" / f"{name}.jsonl"
    assert damage(path, 2) == 4
    said = f"line 2 of {name}.jsonl is unreadable, and not a torn last line."
    for _ in range(2):
        found = audit(tmp_path)
        assert (found.named(), found.clean, found.damaged, found.torn) == ([said], False, 1, 0)
        History(path)


def test_a_torn_last_line_is_no_defect(tmp_path):
    """What a killed process left half written is counted, and the chunk is still in flight."""
    write(tmp_path, [("accepted", 1, 1, 10)], [made(2), ("acknowledged", 1, 1, 10)])
    with (tmp_path / "history" / "rollout-a.jsonl").open("a") as file:
        file.write('["acknowledged","a",1,2,')
    found = audit(tmp_path)
    assert found.clean, found.unexplained
    assert (found.torn, found.damaged, found.chunks["in_flight"]) == (1, 0, 1)


def test_more_lines_than_memory_holds_are_refused(tmp_path, monkeypatch):
    """Histories of all processes together may hold so many lines, however many chunks these are about."""
    monkeypatch.setattr("eia_sec.deploy.monitor.audit.MOST_LINES", 4)
    learner = [("accepted", 1, 10, 10), ("duplicate", 1, 1000, 5)]
    with pytest.raises(RunDirError, match=r"rollout-a.jsonl the histories hold 5 lines, more than 4"):
        write(tmp_path, learner, [made(10)])
    monkeypatch.setattr("eia_sec.deploy.monitor.audit.MOST_LINES", 5)
    assert audit(tmp_path).held == 5


@pytest.mark.timeout(60)  # a loop over the chunks would take an hour
def test_forged_lines_about_millions_of_chunks_take_no_time(tmp_path):
    """Forty lines of 2^24 chunks, in either history, are compared as ranges, and each is named."""
    size = 2**24
    forged = [("accepted", 3 + k * size, 2 + (k + 1) * size, 10) for k in range(20)]
    learner = [("accepted", 1, 2, 10), *forged, Resume({"a": (1, 3 + 19 * size)}), ("accepted", 3, 2 + size, 10)]
    worker = [made(2), *[("acknowledged", first + size, last + size, 10) for _, first, last, _ in forged]]
    found = write(tmp_path, learner, worker)
    assert found.chunks["accepted"] == 2
    assert found.doubled == [f"chunks a/1/3 to {2 + size} were accepted after it had been accepted."]
    assert found.unexplained == [
        f"chunks a/1/{3 + 20 * size} to {2 + 21 * size} were answered as accepted, and never produced by its worker.",
        f"chunks a/1/3 to {2 + size} were accepted, and never produced by its worker.",
        f"chunks a/1/{3 + size} to {2 + 19 * size} were accepted, and never produced by its worker.",
        f"chunks a/1/{3 + 19 * size} to {2 + 20 * size} were rolled back, and never produced by its worker.",
    ]


def test_all_ids_are_named(tmp_path, capsys):
    """As JSON every range of ids; as a table the first, and how many more there are."""
    learner = [("accepted", number, number, 10) for number in range(1, 63, 2)]
    found = write(tmp_path, learner, [made(62), ("acknowledged", 1, 62, 10)])
    names = [f"chunk a/1/{number} " for number in range(2, 62, 2)]
    assert len(found.unexplained) == len(names) + 1
    names.append("chunk a/1/62 ")
    assert dispatch(["audit", str(tmp_path), "--json"]) == 1
    named = json.loads(capsys.readouterr().out)["named"]
    assert all(sentence.startswith(name) for sentence, name in zip(named, names, strict=True))
    assert dispatch(["audit", str(tmp_path)]) == 1
    said = capsys.readouterr().out
    assert said.count("chunk a/1/") == NAMED
    assert "and 11 more" in said


def test_a_chunk_that_was_taken_twice_is_named(tmp_path, capsys):
    """A number that was accepted twice is doubled, and the command says so with exit code 1."""
    found = write(tmp_path, [("accepted", 1, 3, 10), ("accepted", 2, 2, 10)], [made(3), ("acknowledged", 1, 3, 10)])
    assert found.doubled == ["chunk a/1/2 was accepted after it had been accepted."]
    assert dispatch(["audit", str(tmp_path)]) == 1
    assert "counted twice: 1" in capsys.readouterr().out


def test_the_ledger_is_held_against_the_histories(tmp_path):
    """A learner whose own ledger says something else than the histories is not believed."""
    status = {"kind": "status", "environment_steps": 20, "ledger": {"accepted": 20, "unexplained": 0, "lost": 0}}
    (tmp_path / "metrics.jsonl").write_text(json.dumps(status) + "\n" + json.dumps({"kind": "end"}) + "\n")
    assert write(tmp_path, [("accepted", 1, 2, 10)]).clean
    status["ledger"]["accepted"] = 30
    (tmp_path / "metrics.jsonl").write_text(json.dumps(status) + "\n" + json.dumps({"kind": "end"}) + "\n")
    assert not audit(tmp_path).clean


def test_the_command_in_json(tmp_path, capsys):
    """A clean run gives exit code 0 and one object."""
    write(tmp_path, [("accepted", 1, 2, 10)], [made(2), ("acknowledged", 1, 2, 10)])
    assert dispatch(["audit", str(tmp_path), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["steps"]["accepted"] == 20


@pytest.mark.parametrize("text", ["", '["start", "lear', '["end"]\n'])
def test_a_history_without_a_start_is_not_clean(tmp_path, text):
    """An empty file, also beside a worker's history, is no run that could be audited."""
    write(tmp_path, [("accepted", 1, 2, 10)], [made(2), ("acknowledged", 1, 2, 10)])
    (tmp_path / "history" / "learner.jsonl").write_text(text)
    with pytest.raises(RunDirError, match=r"learner\.jsonl holds no start of a learner"):
        dispatch(["audit", str(tmp_path)])


@pytest.mark.parametrize(
    "status",
    [
        "[" * 100_000,
        '{"kind": "status", "ledger": 5}',
        '{"kind": "status", "ledger": {"lost": null}}',
        '{"kind": "status", "ledger": {"lost": "7"}}',
    ],
)
def test_odd_records_of_a_learner_are_no_traceback(tmp_path, status):
    """Records of another host may hold anything: they are named, or count as none."""
    write(tmp_path, [("accepted", 1, 1, 10)], [made(1)])
    (tmp_path / "metrics.jsonl").write_text(f'{status}\n{{"kind": "end", "state": "finished"}}\n')
    assert audit(tmp_path).clean == status.startswith("[")
