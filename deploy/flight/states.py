"""The states of actors with memory in flight: one step for each observation that an agent decided on.

A decision on an observation that is held for several periods starts from the same state each time, so it stays the
same. A vehicle's new start begins an episode, so the state begins at 0.
"""

from eia_sec.common.actors import TeamActors
from eia_sec.common.team import Float32

Mark = tuple[int, int]
"""A vehicle's incarnation, and the number of one of its observations."""


class AgentStates:
    """The states of one team's agents; those of actors without memory are None.

    Args:
        actors: the actors.
    """

    def __init__(self, actors: TeamActors) -> None:
        self._before, self._after = actors.initial_state(1), actors.initial_state(1)
        self._working = actors.initial_state(1)
        self._decided: dict[int, Mark] = {}

    def begin(self, observed: dict[int, Mark]) -> Float32 | None:
        """Return the state [1, agents, h] from which agents decide, for the actors to update in place.

        Args:
            observed: the newest observation of each agent.
        """
        before, after, working = self._before, self._after, self._working
        if before is None or after is None or working is None:
            return None
        for agent, mark in observed.items():
            decided = self._decided.get(agent, (0, 0))
            if decided[0] != mark[0]:
                after[0, agent] = 0.0
            if decided != mark:
                before[0, agent] = after[0, agent]
        working[:] = before
        return working

    def keep(self, agent: int, mark: Mark) -> None:
        """Note that an agent has decided on this observation."""
        if self._after is not None and self._working is not None:
            self._after[0, agent] = self._working[0, agent]
            self._decided[agent] = mark
