"""The log, for people and as JSON for shippers."""

import datetime
import json

import pytest

from eia_sec.common import log as module
from eia_sec.common.log import FORMAT, SEPARATOR, log, name_process


def test_json_has_one_object_a_line(monkeypatch, capsys):
    """Whatever a message holds, an entry is one line that says when, who and what."""
    monkeypatch.setenv(FORMAT, "json")
    monkeypatch.setattr(module, "_process", {"role": "", "name": ""})
    name_process("rollout", "7")
    log("worker 7 \x1b[2J says" + SEPARATOR + "second")
    (line,) = capsys.readouterr().err.splitlines()
    entry = json.loads(line)
    assert datetime.datetime.fromisoformat(entry["time"]).tzinfo is not None
    assert (entry["role"], entry["name"], entry["unwritten"]) == ("rollout", "7", 0)
    assert entry["message"] == "worker 7 ?[2J says\nsecond"


@pytest.mark.parametrize("format_", ["text", ""])
def test_text_is_the_default(format_, monkeypatch, capsys):
    """Without the option, and with text, an entry is the time of day and the message."""
    monkeypatch.setenv(FORMAT, format_)
    log("joined.")
    assert capsys.readouterr().err.partition(" ")[2] == "joined.\n"
