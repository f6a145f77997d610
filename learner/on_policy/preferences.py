"""What fresh actors prefer before they have learned anything, as the environment's action adapter says.

They take options that the environment suggests, or else moves that serve much and do little harm. Relays rest, and in
the last steps fly where a potential falls. Otherwise a fresh policy is nearly uniform. Preferences are weights of the
networks, so training can unlearn them.
"""

from typing import Final

import numpy as np
import torch

from eia_sec.common.actions.adapters import Headings, NineMoves
from eia_sec.common.errors import ConfigError
from eia_sec.common.team import GroupSpec
from eia_sec.learner.networks.stack import Stack

REST: Final = 2.5
"""Logit of a resting option in a fresh policy."""
FOLLOW: Final = 4.0
"""Logit of an option that is marked with 1 in a fresh policy unless `suggestion_logits` names another. If all others
are marked with 0, the policy follows the mark seven times in eight (of nine)."""
HARM: Final = 2.0
"""What a unit of harm lowers a move's logit by, where a unit of worth raises it by 1; both times the type's logit."""
DESCENT: Final = 5.0
"""What a heading's logit rises by for each unit that the potential falls beyond the share of the last steps that is
left, times the type's logit."""
DESCENT_SPEEDS: Final = (0.0, 0.9, 1.0)
"""Shares of that which slow, medium and fast flight on the heading have."""
HEADINGS: Final = (Headings.options - 1) // len(DESCENT_SPEEDS)
"""Headings of each speed of `Headings`, in equal angles; the option before them is to rest."""


def prefer(stack: Stack, group: GroupSpec, logit: float) -> None:
    """Let fresh networks of a type prefer what its action adapter says.

    Networks with memory only prefer to rest. Those too narrow for the hints (18 units for nine moves, 9 for headings)
    do without them.

    Args:
        stack: the networks.
        group: the type.
        logit: of a suggested option that is marked with 1; the weight of the hints is proportional to it.

    Raises:
        ConfigError: the hidden layers are too narrow for a suggestion.
    """
    adapter = group.adapters[0] if group.adapters else None
    if isinstance(adapter, Headings):
        stack.layers[-1][:, adapter.resting] = REST
    if stack.memory != "none" or not isinstance(adapter, Headings | NineMoves):
        return
    if isinstance(adapter, Headings):
        if adapter.potential >= 0:
            favour_descent(stack, adapter.potential, adapter.time_left, logit)
    elif adapter.suggestion >= 0:
        favour_suggestion(stack, adapter.suggestion, group.choices[0], logit)
    elif adapter.worth >= 0:
        favour_worth(stack, adapter.worth, adapter.harm, logit)


def favour_suggestion(stack: Stack, first: int, options: int, logit: float) -> None:
    """Let fresh networks without memory favour options as far as their input marks them, from 0 to 1.

    A unit of each hidden layer for each option hands its mark on, and gives the option a logit of about `logit` times
    the mark.

    Args:
        stack: the networks.
        first: index of the first of the marks in an input.
        options: number of marks, and of outputs.
        logit: of an option that is marked with 1.

    Raises:
        ConfigError: the hidden layers are too narrow.
    """
    if stack.layers[0].shape[2] < options:
        raise ConfigError(f"algorithm.hidden must be at least {options} where the environment suggests a move.")
    w1, w2, w3 = _cleared(stack, options)
    eye = torch.eye(options)
    w1[:, first : first + options, :options] = eye
    w2[:, :options, :options] = eye
    w3[:, :options, :options] = logit * eye


def favour_worth(stack: Stack, worth: int, harm: int, logit: float) -> None:
    """Let fresh networks without memory give moves of `NineMoves` the logit `logit` (worth - HARM harm).

    Networks narrower than eighteen units have no room for it and stay as they are. Negative numbers count as 0.

    Args:
        stack: the networks; their outputs are the nine moves.
        worth: index of the first of nine numbers in an input.
        harm: index of the first of nine more.
        logit: weight of the preference.
    """
    moves = NineMoves.options
    if stack.layers[0].shape[2] < 2 * moves:
        return
    w1, w2, w3 = _cleared(stack, 2 * moves)
    eye = torch.eye(moves)
    w1[:, worth : worth + moves, :moves] = eye
    w1[:, harm : harm + moves, moves : 2 * moves] = eye
    w2[:, : 2 * moves, : 2 * moves] = torch.eye(2 * moves)
    w3[:, : 2 * moves] = torch.cat([logit * eye, -HARM * logit * eye])


def favour_descent(stack: Stack, potential: int, time_left: int, logit: float) -> None:
    """Let fresh networks without memory fly on `Headings` where a potential falls, in the last steps.

    The logit of a heading is about DESCENT `logit` max(0, how far the move lowers the potential - time_left), times the
    speed's share. Networks narrower than nine units have no room for it and stay as they are.

    Args:
        stack: the networks; their outputs are the options of `Headings`.
        potential: index of the first of nine numbers in an input, by which each of nine moves raises the potential.
        time_left: index of the number that falls from 1 to 0.
        logit: weight of the preference.
    """
    if stack.layers[0].shape[2] < NineMoves.options:
        return
    w1, w2, w3 = _cleared(stack, NineMoves.options)
    angles = np.arange(HEADINGS) * 2.0 * np.pi / HEADINGS
    moves = 3 * np.rint(1.0 + np.cos(angles)).astype(int) + np.rint(1.0 + np.sin(angles)).astype(int)
    w1[:, time_left, HEADINGS] = 1.0
    w2[:, HEADINGS, :HEADINGS] = -DESCENT * logit
    for heading, move in enumerate(moves.tolist()):
        w1[:, potential + move, heading] = -1.0
        w2[:, heading, heading] = DESCENT * logit
        for speed, share in enumerate(DESCENT_SPEEDS):
            w3[:, heading, 1 + HEADINGS * speed + heading] = share


def _cleared(stack: Stack, units: int) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Return the weights of all layers. Nothing reaches the hidden layers' first units, or the outputs from them."""
    w1, b1, w2, b2, w3, _ = stack.layers
    w1[:, :, :units], w2[:, :, :units], w3[:, :units] = 0.0, 0.0, 0.0
    b1[:, :units], b2[:, :units] = 0.0, 0.0
    return w1, w2, w3
