"""Which learner of a group learns from which rows of an iteration.

Learner r has the rows from one place to the next, so that only they travel to it. A minibatch takes from every learner
as many samples as from every other one, in whole blocks of k: an ensemble's member learns from every k-th row, and has
the same share everywhere.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Numbers = NDArray[np.int64]


def sizes_of(samples: int, learners: int, block: int) -> list[int]:
    """Return how many of a minibatch's samples each learner has: whole blocks, and the last one what is left."""
    blocks, left = divmod(samples, block)
    each, more = divmod(blocks, learners)
    sizes = [block * (each + (rank >= learners - more)) for rank in range(learners)]
    sizes[-1] += left
    return sizes


@dataclass(frozen=True)
class Shares:
    """An iteration's rows, dealt out.

    Attributes:
        block: k.
        starts: of each learner, its first row, beginning with 0; then the number of all rows.
    """

    block: int
    starts: tuple[int, ...]

    @classmethod
    def of(cls, samples: Numbers, rows: int, minibatches: int, learners: int, block: int) -> "Shares":
        """Deal out rows.

        Args:
            samples: rows from which a step follows, ascending.
            rows: number of all rows.
            minibatches: how many an epoch has.
            learners: N.
            block: k.
        """
        sizes = [sizes_of(len(part), learners, block) for part in np.array_split(samples, minibatches)]
        firsts = np.cumsum(np.sum(sizes, axis=0))[:-1]
        inner = (int(samples[first]) if first < len(samples) else rows for first in firsts)
        return cls(block, (0, *inner, rows))

    @property
    def learners(self) -> int:
        """N."""
        return len(self.starts) - 1

    def rows(self, rank: int) -> slice:
        """Return the rows of a learner."""
        return slice(self.starts[rank], self.starts[rank + 1])

    def split(self, samples: Numbers) -> list[Numbers]:
        """Return each learner's samples among some, in their order, as numbers of its own rows."""
        owner = np.searchsorted(self.starts[1:], samples, side="right")
        return [samples[owner == rank] - self.starts[rank] for rank in range(self.learners)]

    def minibatches(self, shuffled: Numbers, minibatches: int) -> list[Numbers]:
        """Cut shuffled samples into minibatches of equal size, but for one sample, each with equal shares."""
        parts = [own + start for own, start in zip(self.split(shuffled), self.starts[:-1], strict=True)]
        sizes = [sizes_of(len(part), self.learners, self.block) for part in np.array_split(shuffled, minibatches)]
        ends = np.cumsum(sizes, axis=0)[:-1]
        cut = [np.split(part, ends[:, rank]) for rank, part in enumerate(parts)]
        return [np.concatenate(pieces) for pieces in zip(*cut, strict=True)]
