"""A network that sees any number of neighbours, in any order."""

import torch
from torch import nn

from crowd.env import NEIGHBOUR, OWN


class Attention(nn.Module):
    """Attention of an agent over its neighbours; those that are not there count for nothing."""

    def __init__(self, shape, outputs, options):
        super().__init__()
        (size,) = shape
        if (size - OWN) % NEIGHBOUR:
            raise ValueError(f"{size} numbers are not {OWN} of an agent and {NEIGHBOUR} of each of its neighbours")
        width = options.width
        self.own = nn.Sequential(nn.Linear(OWN, width), nn.ReLU())
        self.each = nn.Sequential(nn.Linear(NEIGHBOUR, width), nn.ReLU())
        self.query, self.key, self.value = nn.Linear(width, width), nn.Linear(width, width), nn.Linear(width, width)
        self.layers = nn.Sequential(nn.Linear(2 * width, width), nn.ReLU())
        self.last = nn.Linear(width, outputs)
        nn.init.orthogonal_(self.last.weight, 0.01)
        nn.init.zeros_(self.last.bias)

    def forward(self, x):
        own, neighbours = self.own(x[:, :OWN]), x[:, OWN:].unflatten(1, (-1, NEIGHBOUR))
        each = self.each(neighbours)
        score = (self.key(each) * self.query(own)[:, None]).sum(dim=2) / own.shape[1] ** 0.5
        weight = torch.softmax(score.masked_fill(neighbours[..., 0] < 0.5, -1e9), dim=1)
        gathered = (weight[..., None] * self.value(each)).sum(dim=1)
        return self.last(self.layers(torch.cat([own, gathered], dim=1)))
