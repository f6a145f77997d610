"""Packets for the browser about environments that are no farms: the agents' numbers, and pictures if any."""

from typing import Any

import numpy as np

from eia_sec.common.protocol.messages import StepsMessage, WatchTerms
from eia_sec.common.team import TeamSpec
from eia_sec.deploy.monitor.web.packets import Array, Packet, course, pack
from eia_sec.rollout.rendering.palette import PART_COLOURS


def scene(run: str, worker: str, environment: str, team: TeamSpec, terms: WatchTerms) -> Packet:
    """Return what the page needs once: the agents and their types."""
    types: list[dict[str, Any]] = [
        {
            "name": group.name,
            "count": group.count,
            "actions": group.action_size,
            "choices": list(group.choices),
            "colour": PART_COLOURS[place % len(PART_COLOURS)],
        }
        for place, group in enumerate(team.groups)
    ]
    fields = {
        "title": environment,
        "run": run,
        "worker": worker,
        "agents": list(terms.agents),
        "types": types,
        "pace": terms.steps_per_second,
    }
    return pack("scene", fields, {})


def frames(message: StepsMessage, version: int) -> Packet:
    """Return consecutive steps of an episode; `parts` [F, agents, 1] are the rewards, as farms have parts of theirs."""
    fields = {"scenario": str(message.scenario), **course(message, version), "silence": message.silence}
    arrays: dict[str, Array] = {
        "parts": message.reward[:, :, None],
        "action": message.action,
        "seen": message.seen,
        "alive": message.alive,
        "ends": message.ends.astype(np.float32),  # exact, as all pictures together are shorter than 2**24
        "pictures": message.pictures,
    }
    return pack("frames", fields, arrays, message.frames)
