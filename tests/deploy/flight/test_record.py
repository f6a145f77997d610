"""A flight's record, read again with MCAP's own reader."""

import json
from contextlib import suppress

import numpy as np
import pytest
from mcap.exceptions import EndOfFile
from mcap.reader import NonSeekingReader, make_reader

from eia_sec.common.config import RunConfig
from eia_sec.common.config.files import from_toml, to_toml
from eia_sec.common.config.presets import PRESETS
from eia_sec.common.errors import UsageError
from eia_sec.deploy.flight.record import FlightRecord
from tests.deploy.flight.air import NOW
from tests.deploy.flight.test_pilot import FARM, UAV, Team

ABOUT = {"policy": "test"}


def begin(path) -> FlightRecord:
    """Begin a record."""
    return FlightRecord(path, ABOUT, to_toml(RunConfig(farm=FARM)), FARM)


def note(record, team, periods):
    """Fly some periods and note them as the flight node does."""
    for number in range(periods):
        team.tell() if number % 4 else team.tell(UAV)
        for name, vehicle in team.pilot.vehicles.items():
            if vehicle.newest is not None and not (number % 4 == 0 and name == UAV):
                record.pose(name, vehicle.newest, vehicle.raw, team.now)
        for name, message in team.period(0.9).items():
            record.setpoint(name, message, team.now)
        record.farm(team.pilot.map.farm, team.now)


def test_a_record_holds_poses_set_points_reasons_and_the_map(tmp_path):
    """Every message is read again as it was, in the order of time, with schemas, configuration and what it is about."""
    path, team = tmp_path / "flight.mcap", Team()
    with begin(path) as record:
        note(record, team, 8)
    with path.open("rb") as file:
        reader = make_reader(file)
        messages = list(reader.iter_messages())
        (about,) = reader.iter_metadata()
        (attached,) = reader.iter_attachments()
    assert len(messages) == record.written
    by_topic = {}
    for schema, channel, message in messages:
        assert (schema.encoding, channel.message_encoding) == ("jsonschema", "json")
        whole = json.loads(message.data)
        assert set(whole) == set(json.loads(schema.data)["properties"])
        by_topic.setdefault(channel.topic, []).append((message, whole))
    setpoints = [whole for _, whole in by_topic[f"/vehicle/{UAV}/setpoint"]]
    assert any(whole["hover"] and "no pose" in whole["reason"] for whole in setpoints)
    assert any(not whole["hover"] for whole in setpoints)
    maps = [whole for _, whole in by_topic["/farm/map"]]
    assert maps[-1]["step"] == team.pilot.map.steps
    np.testing.assert_array_equal(maps[-1]["vdf"], team.pilot.map.farm.vdf[0].ravel())
    np.testing.assert_array_equal(maps[-1]["aoi"], team.pilot.map.farm.aoi[0])
    (message, transform), *_ = by_topic["/tf"]
    assert transform["transforms"][0]["translation"] == {"x": 200.0, "y": 150.0, "z": 20.0}
    assert NOW * 1e9 <= message.log_time <= team.now * 1e9
    assert about.metadata == ABOUT
    assert from_toml_text(attached.data.decode(), tmp_path) == FARM
    assert record.alarms() == []


def from_toml_text(text, folder):
    """Return the farm of a configuration's text."""
    path = folder / "attached.toml"
    path.write_text(text)
    return from_toml(path, PRESETS["study"]).farm


def test_a_node_that_is_killed_leaves_a_record_that_can_be_read(tmp_path):
    """Without the file's end, all but the last chunk is there."""
    path, team = tmp_path / "flight.mcap", Team()
    record = begin(path)
    note(record, team, 60)
    record._file.flush()
    with path.open("rb") as file:
        steps, whole = [], 0
        with suppress(EndOfFile):
            for _, channel, message in NonSeekingReader(file).iter_messages(log_time_order=False):
                whole += 1
                if channel.topic == "/farm/map":
                    steps.append(json.loads(message.data)["step"])
    assert whole > 0.5 * record.written
    assert steps == sorted(steps)
    assert len(steps) > 10


def test_a_record_that_cannot_be_written_ends_and_the_flight_goes_on(tmp_path, monkeypatch):
    """A full disk is told once, what comes later is counted, and nothing is raised."""
    team = Team()
    with begin(tmp_path / "flight.mcap") as record:
        note(record, team, 2)
        before = record.written

        def full(*arguments):
            raise OSError(28, "No space left on device")

        monkeypatch.setattr(record._writer, "add_message", full)
        note(record, team, 2)
        assert (record.written, record.lost > 0) == (before, True)
        assert "No space left" in record.alarms()[0]


def test_no_record_is_overwritten(tmp_path):
    """A file that exists, and a folder that does not, are a user's mistakes."""
    path = tmp_path / "flight.mcap"
    path.write_bytes(b"mine")
    with pytest.raises(UsageError, match="cannot be made: File exists"):
        begin(path)
    with pytest.raises(UsageError, match="cannot be made"):
        begin(tmp_path / "missing" / "flight.mcap")
    assert path.read_bytes() == b"mine"
