"""Stacks: layers are views of one tensor, and passes of both types of numbers agree."""

import re

import numpy as np
import pytest
import torch

from eia_sec.common.actors import layer_shapes
from eia_sec.learner.networks.recurrent import RecurrentStack
from eia_sec.learner.networks.stack import Stack
from eia_sec.learner.on_policy.trainer import OnPolicyTrainer
from tests.learner.on_policy.recurrent_runs import remembered_chunk, with_memory
from tests.learner.on_policy.small_runs import ENDS, TEAM, chunk, configured

INPUTS, HIDDEN, OUTPUTS = 7, 16, 3


def stack_of(count):
    """Return a stack of so many networks."""
    stack = Stack(count, INPUTS, HIDDEN, OUTPUTS)
    stack.draw(1.0, [(0, "network", index) for index in range(count)])
    return stack


@pytest.mark.parametrize("count", [1, 3])
def test_passes_of_bfloat16_are_near_those_of_float32(count):
    """Outputs and gradients are float32 in both, and differ by the rounding of hidden layers."""
    stack, x = stack_of(count), torch.randn(50, 3, INPUTS, generator=torch.Generator().manual_seed(0))
    exact, rough = stack(x), stack(x.bfloat16())
    assert exact.dtype == rough.dtype == torch.float32
    torch.testing.assert_close(rough, exact, atol=0.05, rtol=0.0)
    found = [torch.autograd.grad(outputs.square().mean(), stack.flat)[0] for outputs in (exact, rough)]
    assert found[0].shape == found[1].shape == stack.flat.shape
    assert found[1].dtype == torch.float32
    assert float((found[1] - found[0]).norm()) < 0.05 * float(found[0].norm())


@pytest.mark.parametrize("count", [1, 3])
def test_layers_are_the_parameters(count):
    """They lie one after another in `eia_sec.common.actors`' order, and who writes to one changes the network."""
    stack = stack_of(count)
    shapes = layer_shapes(INPUTS, HIDDEN, OUTPUTS)
    assert [tuple(layer.shape) for layer in stack.layers] == [(count, *shape) for shape in shapes]
    assert torch.equal(torch.cat([layer.reshape(count, -1) for layer in stack.layers], dim=1), stack.flat)
    stack.layers[-1][:, 1] = 5.0
    assert torch.equal(stack.flat[:, -2], torch.full((count,), 5.0))


def test_an_export_is_a_copy_and_loads_again():
    """Training on does not change it; parameters of another shape are refused, and not repeated for all networks."""
    stack, other = stack_of(3), stack_of(3)
    exported = stack.export()
    before = exported.copy()
    with torch.no_grad():
        stack.flat.add_(1.0)
    assert np.array_equal(exported, before)
    other.load(stack.export())
    assert torch.equal(other.flat, stack.flat)
    for wrong in (before[:1], before[:, :1], before[:, :-1]):
        with pytest.raises(AssertionError):
            other.load(wrong)


@pytest.mark.parametrize("memory", [False, True])
def test_checkpoints_name_every_layer_and_its_moments(memory):
    """Each layer has its own name, with those of Adam's moments after it."""
    config = with_memory("ippo") if memory else configured("ippo", shared_until=0.0)
    trainer = OnPolicyTrainer(config, TEAM)
    trainer.absorb(remembered_chunk(trainer.actors(), 0) if memory else chunk(trainer.actors(), 0, ENDS))
    trainer.train(2)
    tensors = {name: tensor for name, tensor in trainer.state()[0].items() if name.startswith("networks.")}
    layers = range(8 if memory else 6)
    owners = [
        f"{owner}{kind}{rest}" for kind in range(2) for owner, rest in (("actors.types.", ""), ("values.", ".network"))
    ]
    wanted = {
        f"networks.{owner}.layers.{layer}{moment}"
        for owner in owners
        for layer in layers
        for moment in ("", ".step", ".exp_avg", ".exp_avg_sq")
    }
    assert set(tensors) == wanted
    for name, tensor in tensors.items():
        layer = tensors[re.sub(r"\.(step|exp_avg|exp_avg_sq)$", "", name)]
        assert tensor.shape == (() if name.endswith(".step") else layer.shape)
        assert bool(tensor.any())
    kinds = {type(stack) for stack in trainer._updates.policies.stacks}
    assert kinds == {RecurrentStack if memory else Stack}
