"""Noise-free episodes that the elite coordinator requests from a worker."""

from collections.abc import Callable

from eia_sec.common.config import RunConfig
from eia_sec.common.errors import CancelledError, EnvironmentOutageError, ProtocolError
from eia_sec.common.policy_store import PolicyStore
from eia_sec.common.protocol import keys
from eia_sec.common.protocol.messages import EvaluationOrder, EvaluationResult
from eia_sec.common.transport.bus import Bus, Incoming
from eia_sec.rollout.worker.collector import run_noise_free_episodes

CAPACITY = 16
"""Orders that may wait."""
MOST_FARMS = 256
"""Most episodes of one order."""


class EvaluationService:
    """Answers the newest order, with its own actors as soon as they are new enough, or with those of the order.

    Args:
        control: the control lane.
        config: the run.
        run: the run's name.
        worker: the worker's name.
        store: the worker's actors.
        cancelled: asked again and again during an evaluation whether to give it up.

    Attributes:
        episodes: noise-free episodes run so far.
    """

    def __init__(
        self,
        control: Bus,
        config: RunConfig,
        run: str,
        worker: str,
        store: PolicyStore,
        cancelled: Callable[[], bool],
    ) -> None:
        self._config, self._store, self._cancelled = config, store, cancelled
        self._orders = control.serve(keys.EVALUATION.key(run, worker=worker), CAPACITY, newest=True)
        self._waiting: Incoming | None = None
        self.episodes = 0

    def poll(self) -> None:
        """Receive new orders, and answer the newest if that is possible now."""
        for incoming in self._orders.waiting():
            # The coordinator abandons its older orders before it sends a newer one.
            if self._waiting is not None:
                self._waiting.refuse("a newer order has arrived.")
            self._waiting = incoming
        order, self._waiting = self._waiting, None
        if order is not None:
            self._answer(order)

    def _answer(self, incoming: Incoming) -> None:
        try:
            order = EvaluationOrder.decode(incoming.payload)
            if not 0 < len(order.farms) == len(order.episodes) <= MOST_FARMS:
                raise ProtocolError(f"an evaluation needs one episode seed for each of 1 to {MOST_FARMS} farms.")
        except ProtocolError as error:
            incoming.refuse(str(error))
            return
        store = self._store
        if store.actors is not None and order.epoch < store.epoch:
            incoming.refuse("the order comes from a learner that has been replaced.")
            return
        needed = order.version if order.flat is None else 0
        if store.actors is None or (store.epoch, store.version) < (order.epoch, needed):
            self._waiting = incoming
            return
        actors, version = store.actors, store.version
        try:
            if order.flat is not None:
                actors, version = store.with_parameters(order.flat), order.version
        except ProtocolError as error:
            incoming.refuse(str(error))
            return
        try:
            reward, steps = run_noise_free_episodes(self._config, actors, order.farms, order.episodes, self._cancelled)
        except (CancelledError, EnvironmentOutageError) as error:
            incoming.refuse(str(error))
            return
        self.episodes += len(order.farms)
        incoming.reply(EvaluationResult(order.event, version, reward, steps).encode())
