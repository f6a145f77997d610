"""docs/reference/protocol.json says what the declarations say, and a reader that knows it alone reads every message."""

import dataclasses
import json
import math
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor, wait
from pathlib import Path

import numpy as np
import pytest
import reader

from eia_sec.common.actors import actor_parameters
from eia_sec.common.protocol import keys
from eia_sec.common.protocol.messages import ParametersMessage, ProgressMessage
from eia_sec.common.team import GroupSpec
from eia_sec.common.transport.bus import Bus
from eia_sec.common.transport.endpoint import free_endpoint
from research.pages.protocol_schema import schema
from tests.common.protocol.test_messages import EXAMPLES

ROOT = Path(__file__).resolve().parents[3]
PAGE = ROOT / "docs" / "reference" / "protocol.json"


def test_the_file_is_up_to_date():
    """`make docs` writes it."""
    assert json.loads(PAGE.read_text(encoding="utf-8")) == schema(), "run `make docs`"


@pytest.mark.parametrize("message", EXAMPLES, ids=lambda message: type(message).__name__)
def test_another_program_reads_every_message(message):
    """The example without this project finds the same values; a field that the schema does not know is an error."""
    known = schema()
    name, found = reader.decode(message.encode(), known)
    assert name == type(message).__name__
    for field in dataclasses.fields(message):
        np.testing.assert_equal(found.get(field.name), _plain(getattr(message, field.name)))
    del known["messages"][name]["fields"][0]
    with pytest.raises(ValueError, match=f"{name} has other fields"):
        reader.decode(message.encode(), known)


@pytest.mark.parametrize("payload", [b"", b"EIAS", b"EIAS\x05\xff" + bytes(18), b"EIAS\x04\x05" + bytes(18), bytes(24)])
def test_the_reader_says_what_is_no_message(payload):
    """Bytes that are no frame, of another protocol or of an unknown kind are a ValueError."""
    with pytest.raises(ValueError, match="no whole frame"):
        reader.decode(payload, schema())


def _plain(value):
    """Return a value as msgpack has it."""
    return [_plain(part) for part in value] if isinstance(value, tuple) else value


@pytest.mark.parametrize("memory", ["none", "gru"])
def test_weights_are_in_the_order_that_it_says(memory):
    """The parts of an actor's flat parameters have as many numbers as the actor."""
    sizes = {"o": 7, "h": 8, "3h": 24, "a": 4}
    parts = schema()["actors"]["memory"][memory]
    total = sum(math.prod(sizes[size] for size in part[1:]) for part in parts)
    assert total == actor_parameters(GroupSpec("a", 1, 7, 2), 8, "gaussian", memory)


def test_the_reader_prints_what_is_there_and_what_comes():
    """The newest states are had by a plain GET, without this project; what is published says its encoding."""
    endpoint = free_endpoint()
    with Bus.listen(endpoint, "control") as bus:
        progress = bus.publish_state(keys.PROGRESS.key("r"), keys.PROGRESS.encoding)
        actors = bus.publish_state(keys.PARAMETERS.key("r"), keys.PARAMETERS.encoding)
        progress.put(ProgressMessage(1, 2, 3, 4, 5, 6, "training").encode())
        flat = (np.ones((2, 3), np.float32),)
        actors.put(ParametersMessage(1, 2, 0, 4, 0.5, "ab", 8, "gaussian", flat).encode())
        program = ROOT / "docs" / "examples" / "reader.py"
        command = [sys.executable, "-P", str(program), endpoint.locator("control"), "r", str(PAGE)]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd="/", env={}) as process:
            try:
                assert process.stdout is not None
                first = process.stdout.readline()
                assert first.startswith("ProgressMessage {")
                assert "'environment_steps': 5" in first
                assert "'flat': [[2, 3]]" in process.stdout.readline()
                message = ProgressMessage(1, 2, 3, 4, 6, 6, "training").encode()
                with ThreadPoolExecutor(1) as pool:
                    line = pool.submit(process.stdout.readline)
                    while not line.done():
                        progress.put(message)
                        wait([line], 0.05)
                assert line.result().startswith(f"{keys.PROGRESS.key('r')} {keys.PROGRESS.encoding} ProgressMessage [")
            finally:
                process.kill()
