"""`eia-sec host`: the remote end of `eia-sec up`, `down`, `status`, `logs` and `fleet`, which call it over SSH."""

import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from eia_sec.common.errors import HostError
from eia_sec.deploy.exit_codes import DONE
from eia_sec.deploy.hosts import agent, learner_move
from eia_sec.deploy.hosts.history_collection import pack
from eia_sec.deploy.hosts.keeper import keep
from eia_sec.deploy.hosts.log_stream import follow
from eia_sec.deploy.options import parse

MAX_REQUEST = 64 * 1024 * 1024
"""Longest request, bytes; the largest part of one is a farm of many sensors."""


@dataclass(frozen=True)
class HostArguments:
    """Act in one host's folder. The request is JSON on standard input, the answer JSON on standard output."""

    verb: Annotated[
        tyro.conf.Positional[
            Literal["up", "down", "status", "logs", "follow", "collect", "release", "take-in", "forget", "keep"]
        ],
        tyro.conf.arg(metavar="VERB"),
    ]
    """up, down, status, logs, follow, collect, release, take-in, forget (the learner's files on their way to another
    host), or keep, which stays and supervises the processes."""
    folder: Path = Path()
    """The host's folder."""


def command(arguments: Sequence[str]) -> int:
    """Do what the verb asks for; return 0."""
    options = parse(HostArguments, arguments, "host")
    folder = options.folder.expanduser()
    if options.verb == "keep":
        keep(folder)
        return DONE
    if options.verb == "collect":
        pack(folder, sys.stdout.buffer)
        return DONE
    if options.verb == "release":
        learner_move.release(folder, sys.stdout.buffer)
        return DONE
    if options.verb == "take-in":
        learner_move.take_in(folder, sys.stdin.buffer)
        return DONE
    if options.verb == "follow":
        follow(folder, sys.stdin.buffer, sys.stdout.buffer)
        return DONE
    request = _request()
    try:
        answer = _answer(options.verb, folder, request)
    except (KeyError, TypeError, ValueError) as error:
        raise HostError(f"this version of eia-sec does not understand the request: {error!r}.") from error
    sys.stdout.write(json.dumps(answer) + "\n")
    return DONE


def _request() -> dict[str, Any]:
    data = sys.stdin.buffer.read(MAX_REQUEST + 1)
    try:
        found = json.loads(data) if len(data) <= MAX_REQUEST else None
    except ValueError:
        found = None
    if not isinstance(found, dict):
        raise HostError("the request on standard input is not a JSON object.")
    return found


def _answer(verb: str, folder: Path, request: dict[str, Any]) -> dict[str, Any]:
    if verb == "up":
        words = request["processes"], request["files"], request["start"]
        return agent.up(folder, *words, again=[str(name) for name in request["again"]])
    if verb == "down":
        return agent.down(folder, request["roles"], float(request["seconds"]), bool(request["kill"]))
    if verb == "logs":
        return agent.logs(folder, request["names"], int(request["lines"]))
    if verb == "forget":
        return {"kept": learner_move.forget(folder)}
    return agent.status(folder, request.get("learners", {}), request.get("probes", {}))
