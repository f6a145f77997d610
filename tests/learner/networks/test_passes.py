"""Forward passes and their gradients, compiled and by torch."""

import pytest
import torch

from eia_sec.learner.networks.compiled_pass import make_pass
from eia_sec.learner.networks.stacked import Networks, Stack

LIKE = torch.empty(0, dtype=torch.float64)


def critics(cores):
    """Return a pass of three networks with four inputs, of which the last two are the action, and its arguments."""
    networks = Networks([Stack(3, 4, 1, 5, action=3, action_size=2)], hidden=6)
    generator = torch.Generator().manual_seed(0)
    parameters = networks.parameters(torch.randn(networks.size, generator=generator, dtype=torch.float64))
    inputs = torch.randn(3, 5, 5, generator=generator, dtype=torch.float64)
    inputs[:, :, 0] = 1.0
    return make_pass(networks, LIKE, cores=cores), parameters, [inputs]


@pytest.mark.parametrize("cores", [0, 1])
def test_gradients_are_those_of_finite_differences(cores):
    """The gradients by a parameter and by an action are what a small change of each does to the outputs."""
    networks, parameters, inputs = critics(cores)
    gradient = networks.networks.parameters(torch.zeros_like(parameters.flat))
    by_action, ones = torch.zeros(3, 5, 2, dtype=torch.float64), torch.ones(15, dtype=torch.float64)
    forward = networks.forward(parameters, inputs)
    before = float(forward.output.sum())
    networks.parameter_gradient(forward, ones, gradient)
    networks.action_gradient(forward, ones, [by_action])
    step = 1e-7
    for index in (0, 40, parameters.flat.shape[0] - 1):
        parameters.flat[index] += step
        change = float(networks.forward(parameters, inputs).output.sum()) - before
        parameters.flat[index] -= step
        assert change / step == pytest.approx(float(gradient.flat[index]), abs=1e-5)
    delta = torch.zeros_like(by_action)
    delta[1, 2, 1] = step
    change = float(networks.forward(parameters, inputs, [delta]).output.sum()) - before
    assert change / step == pytest.approx(float(by_action[1, 2, 1]), abs=1e-5)


@pytest.mark.parametrize("cores", [0, 1])
def test_the_gradient_of_an_overwritten_pass_is_refused(cores):
    """Activations are those of the newest forward pass, so gradients of an older one raise."""
    networks, parameters, inputs = critics(cores)
    first = networks.forward(parameters, inputs)
    networks.forward(parameters, inputs)
    with pytest.raises(RuntimeError, match="overwritten"):
        networks.parameter_gradient(first, torch.ones(15, dtype=torch.float64), parameters)
    with pytest.raises(RuntimeError, match="overwritten"):
        networks.action_gradient(first, torch.ones(15, dtype=torch.float64), [torch.zeros(3, 5, 2)])
