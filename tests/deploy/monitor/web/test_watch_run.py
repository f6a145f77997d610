"""`eia-sec watch` beside a learner and a worker, each a process of its own."""

import json
import signal
import struct

from websockets.sync.client import connect

from tests.system.conftest import processes  # noqa: F401  # the fixture of the tests with real processes
from tests.system.fleet import RUN, TINY, until


def test_a_run_is_watched_from_beside(processes):  # noqa: F811  # pytest hands fixtures over by their names
    """The command prints where the page is, the stream brings the worker's episodes, and Ctrl-C ends it with code 0."""
    processes.config.write_text(TINY.replace("episodes = 8", "episodes = 100000"), encoding="utf-8")
    processes.learner()
    processes.worker("w")
    where = ("--run", RUN, "--connect", str(processes.endpoint), "--patience", "60")
    watcher = processes.start("watch", "watch", *where, "--port", "0")
    until(lambda: "watch at" in processes.log("watch"), "the address")
    address = processes.log("watch").split("watch at ")[1].split()[0].rstrip("/")
    with connect(f"{address.replace('http', 'ws')}/stream", origin=address, open_timeout=60) as browser:
        packet = {}
        while packet.get("kind") != "frames" or packet["first"] + packet["arrays"][0][2][0] <= 40:
            data = browser.recv(timeout=60)
            packet = json.loads(data[4 : 4 + struct.unpack_from("<I", data)[0]])
        assert packet["farm"] in range(3)
        assert packet["arrays"][0][2][1:] == [5, 2]
    watcher.send_signal(signal.SIGINT)
    assert watcher.wait(30) == 0
