"""A user's environment as it is served: one PettingZoo parallel environment, or several alike that move together."""

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from eia_sec.common.errors import ContractError, SchemaError
from eia_sec.common.protocol.environment_messages import MOST_COPIES
from eia_sec.common.protocol.environment_values import PART_BYTES, described, form_of

MASK: Final = "action_mask"
"""Key of an action mask in an agent's info."""
MOST_INFO: Final = 64
"""Most numbers of one agent's info that travel; further ones are left out."""


class Copies:
    """The environments that one name serves.

    Args:
        environments: PettingZoo parallel environments with the same agents and spaces.

    Attributes:
        description: what a claim's answer says of them: copies, agents, observation_spaces and action_spaces.
        most_request: most bytes of a step request.

    Raises:
        ContractError: there are none, too many or different ones, or something does not travel.
    """

    def __init__(self, environments: Sequence[Any]) -> None:
        if not 0 < len(environments) <= MOST_COPIES:
            raise ContractError(f"1 to {MOST_COPIES} environments can be served together, not {len(environments)}.")
        self._environments = list(environments)
        found = [_description(environment) for environment in environments]
        if any(other != found[0] for other in found):
            raise ContractError("environments that are served together must have the same agents and spaces.")
        self._names = {str(name): name for name in environments[0].possible_agents}
        self.description = {"copies": len(environments), **found[0]}
        spaces = zip(self._names, found[0]["observation_spaces"], found[0]["action_spaces"], strict=True)
        forms = {name: (form_of(seen), form_of(acts)) for name, seen, acts in spaces}
        self._seen = {name: seen for name, (seen, _) in forms.items()}
        self._acts = {name: acts for name, (_, acts) in forms.items()}
        actions = sum(form.most + 4 * len(name) + 8 for name, form in self._acts.items())
        self.most_request = 4096 + len(environments) * (actions + PART_BYTES)
        self._living: list[set[str]] = [set() for _ in environments]

    def read(self, orders: Sequence[Any]) -> list[Any]:
        """Return what to do with each copy: nothing, a seed, or actions by the agents' own names.

        Raises:
            SchemaError: it does not fit the copies, or the actions are not those of the living agents.
        """
        if len(orders) != len(self._environments):
            raise SchemaError(f"a step of {len(orders)} copies; {len(self._environments)} are served.")
        return [self._order(order, living) for order, living in zip(orders, self._living, strict=True)]

    def _order(self, order: Any, living: set[str]) -> Any:
        if order is None or (type(order) is int and 0 <= order < 2**63):
            return order
        if not isinstance(order, dict) or order.keys() != living or not living:
            raise SchemaError("an order is neither null, a seed, nor an action of each living agent.")
        return {self._names[name]: self._acts[name].unpack(raw) for name, raw in order.items()}

    def move(self, orders: Sequence[Any]) -> list[Any]:
        """Carry out orders that `read` returned, and return what a step's answer says of each copy.

        Raises:
            ContractError: an environment returned something else than PettingZoo asks for.
            Exception: whatever the environment's code raises.
        """
        return [None if order is None else self._moved(index, order) for index, order in enumerate(orders)]

    def _moved(self, index: int, order: Any) -> dict[str, Any]:
        environment = self._environments[index]
        if isinstance(order, int):
            observations, infos = environment.reset(seed=order)
            ends: dict[str, Any] = {}
        else:
            observations, rewards, terminations, truncations, infos = environment.step(order)
            ends = {
                "rewards": self._by_name("rewards", rewards, float),
                "terminations": self._by_name("terminations", terminations, bool),
                "truncations": self._by_name("truncations", truncations, bool),
            }
        living = [str(name) for name in environment.agents]
        self._living[index] = set(living)
        return {
            "observations": self._seen_by(observations),
            **ends,
            "infos": {str(name): found for name, info in infos.items() if (found := _told(info))},
            "agents": living,
        }

    def _seen_by(self, observations: Mapping[Any, Any]) -> dict[str, Any]:
        found = {}
        for name, value in observations.items():
            try:
                found[str(name)] = self._seen[str(name)].pack(value)
            except (ValueError, TypeError, KeyError, IndexError) as error:
                raise ContractError(f"the observation of agent {name} does not fit its space: {error!r}.") from error
        return found

    def _by_name(self, what: str, values: Mapping[Any, Any], kind: Any) -> dict[str, Any]:
        try:
            return {str(name): kind(value) for name, value in values.items()}
        except (ValueError, TypeError) as error:
            raise ContractError(f"step() returned {what} that are no {kind.__name__}: {error}.") from error


def _description(environment: Any) -> dict[str, Any]:
    agents = getattr(environment, "possible_agents", None)
    if not isinstance(agents, Sequence) or isinstance(agents, str) or not agents:
        raise ContractError(
            f"{type(environment).__name__} has no possible_agents; a PettingZoo ParallelEnv can be served."
        )
    names = [str(name) for name in agents]
    if len(set(names)) != len(names):
        raise ContractError("two agents have the same name.")
    try:
        spaces = [(described(environment.observation_space(a)), described(environment.action_space(a))) for a in agents]
    except SchemaError as error:
        raise ContractError(f"{type(environment).__name__}: {error}") from None
    seen, acts = zip(*spaces, strict=True)
    return {"agents": names, "observation_spaces": list(seen), "action_spaces": list(acts)}


def _told(info: Mapping[str, Any]) -> dict[str, Any]:
    """Return what of an agent's info travels: its action mask, and numbers."""
    found: dict[str, Any] = {}
    for key, value in info.items():
        if key == MASK:
            parts = value if isinstance(value, tuple | list) else (value,)
            found[key] = np.concatenate([np.ravel(part) for part in parts]).astype(np.uint8).tobytes()
        elif isinstance(value, int | float | np.number | np.bool_) and len(found) < MOST_INFO:
            found[str(key)] = float(value)
    return found
