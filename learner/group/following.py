"""The loop of a learner that follows: it computes what the leader orders, and nothing of the run is its own.

Orders, and the numbers that come with them:

    NOTHING              the leader is there
    ITERATION separate   networks and this learner's rows; 1 if agents have networks of their own
    VALUES               V of each row, back to the leader
    NEWEST               log-probabilities by the present actors, back to the leader
    LEARN                what is learned from each row, and the networks as they then are
    UPDATE progress stopped sizes   one update; `stopped` has a bit for each type whose actors have stopped, and `sizes`
                         are each learner's samples in the minibatch
    COMPARE              the end of the iteration: all must hold the same parameters
    END                  the end of the run

The leader gives them in this order, VALUES and NEWEST where an iteration needs them.
"""

import torch

from eia_sec.common.config import RunConfig
from eia_sec.common.config.files import read_saved, to_toml
from eia_sec.common.log import log
from eia_sec.common.protocol.messages import ConfigurationMessage
from eia_sec.common.team import TeamSpec
from eia_sec.learner.group.process_group import Order, Ordered, ProcessGroup
from eia_sec.learner.group.updates import FollowingUpdates
from eia_sec.learner.trainer import flushed_denormals


def introduce(group: ProcessGroup, config: RunConfig, team: TeamSpec) -> None:
    """Tell the others which run they update (rank 0)."""
    group.broadcast_text(ConfigurationMessage(0, to_toml(config), team.to_dict(), lockstep=False).encode())


def follow(group: ProcessGroup) -> None:
    """Follow the leader's orders to the end of the run.

    Raises:
        GroupError: when another learner is gone, or sends what cannot be.
        ProtocolError, ConfigError: when the run's configuration cannot be read.
    """
    told = ConfigurationMessage.decode(group.broadcast_text())
    config, team = read_saved(told.toml), TeamSpec.from_dict(told.team)
    torch.set_num_threads(config.learner.threads)
    updates = FollowingUpdates(config.on_policy, team, config.network_seed, config.learner, group)
    updates.most_rows = _most_rows(config)
    log(f"learner {group.rank} of {group.size} follows.")
    with flushed_denormals():
        while (ordered := group.next_order()).order is not Order.END:
            updates = _obey(updates, ordered)


def _most_rows(config: RunConfig) -> int:
    """Return a bound of an iteration's rows: two of each step, whose episode may end, and a chunk too many."""
    chunk = config.rollout.environments * config.rollout.chunk_steps
    return 2 * (config.on_policy.iteration_steps + chunk)


def _obey(updates: FollowingUpdates, ordered: Ordered) -> FollowingUpdates:
    """Do what is ordered; return the updates of the next order."""
    match ordered.order:
        case Order.ITERATION:
            if ordered.numbers[0] and not updates.separate:
                updates = updates.parted()
            updates.take_rows()
        case Order.VALUES:
            updates.send_values()
        case Order.NEWEST:
            updates.send_newest()
        case Order.LEARN:
            updates.take_computed()
        case Order.UPDATE:
            updates.follow_update(ordered)
        case Order.COMPARE:
            updates.compare()
        case Order.NOTHING | Order.END:
            pass
    return updates
