"""All networks of a role by one call: compiled and by torch, with their gradients."""

import pytest
import torch

from eia_sec.learner.networks.stacks import Changes, Shape, Stacks

LIKE = torch.empty(0, dtype=torch.float64)
CRITICS = (
    Shape(3, 5, 1, 5, Changes(0, 1, 1, 2)),
    Shape(2, 6, 1, 5, Changes(30, 2, 0, 3)),
    Shape(2, 3, 1, 10, Changes(60, 1, 0, 2, shared=True)),
)
ACTORS = (Shape(3, 4, 2, 5), Shape(1, 6, 3, 5))
CORES = [0, 1, 2]


def drawn(*size, seed=0):
    """Return random numbers."""
    return torch.randn(*size, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def stacks_of(shapes, cores):
    """Return networks and inputs, the same for any number of cores; critics of the second type see the same rows."""
    stacks = Stacks(shapes, 6, LIKE, cores=cores)
    for number, stack in enumerate(stacks.stacks):
        stack.load(drawn(stack.count, stack.size, seed=number).numpy())
    sizes = [(1 if number == 1 else s.count) * s.rows * s.inputs for number, s in enumerate(shapes)]
    parts = torch.split(drawn(sum(sizes), seed=1), sizes)
    inputs = [part.view(-1, s.rows, s.inputs).expand(s.count, -1, -1) for part, s in zip(parts, shapes, strict=True)]
    return stacks, inputs


def found_by(shapes, cores, seen=None):
    """Return outputs and gradients by the parameters, for the first `seen` stacks."""
    stacks, inputs = stacks_of(shapes, cores)
    output = stacks(inputs[:seen])
    (drawn(len(output), seed=2) * output).sum().backward()
    return output.detach(), stacks.flat.grad


@pytest.mark.parametrize("cores", CORES[1:])
@pytest.mark.parametrize("seen", [None, 1])
@pytest.mark.parametrize("shapes", [CRITICS, ACTORS], ids=["critics", "actors"])
def test_kernels_return_what_torch_returns(shapes, seen, cores):
    """Outputs and gradients by the parameters agree, of all stacks and of the first alone."""
    torch.testing.assert_close(found_by(shapes, cores, seen), found_by(shapes, 0, seen), rtol=0, atol=1e-12)


def changed_by(cores):
    """Return outputs with a change of the inputs, and their gradient by it."""
    stacks, inputs = stacks_of(CRITICS, cores)
    change = drawn(100, seed=3).requires_grad_()
    output = stacks(inputs, change)
    (drawn(len(output), seed=2) * output).sum().backward()
    assert stacks.flat.grad is None
    return output.detach(), change.grad


@pytest.mark.parametrize("cores", CORES[1:])
def test_changes_do_by_kernels_what_they_do_by_torch(cores):
    """Outputs agree, and so do gradients by what is added, to one network's inputs or to those of all."""
    torch.testing.assert_close(changed_by(cores), changed_by(0), rtol=0, atol=1e-12)


@pytest.mark.parametrize("cores", CORES)
def test_gradients_are_those_of_finite_differences(cores):
    """The gradients by a parameter and by a change are what a small change of each does to the outputs."""
    stacks, inputs = stacks_of(CRITICS, cores)
    output = stacks(inputs)
    before = float(output.detach().sum())
    output.sum().backward()
    gradient, flat, step = stacks.flat.grad, stacks.flat.detach(), 1e-7
    for index in (0, 40, len(flat) - 1):
        flat[index] += step
        slope = (float(stacks(inputs).detach().sum()) - before) / step
        flat[index] -= step
        assert slope == pytest.approx(float(gradient[index]), abs=1e-5)
    change = torch.zeros(100, dtype=torch.float64, requires_grad=True)
    stacks(inputs, change).sum().backward()
    for index in (3, 31, 61, 99):
        moved = torch.zeros(100, dtype=torch.float64)
        moved[index] = step
        slope = (float(stacks(inputs, moved).sum()) - before) / step
        assert slope == pytest.approx(float(change.grad[index]), abs=1e-5)


@pytest.mark.parametrize("later", ["networks", "twin"])
def test_the_gradient_of_an_overwritten_pass_is_refused(later):
    """Activations are those of the newest pass of the networks and their twins, so an older one's gradient raises."""
    stacks, inputs = stacks_of(CRITICS, 1)
    twin = stacks.twin()
    first = stacks(inputs)
    (stacks if later == "networks" else twin)(inputs)
    with pytest.raises(RuntimeError, match="overwritten"):
        first.sum().backward()


@pytest.mark.parametrize("cores", CORES)
def test_a_twin_follows_and_is_not_trained(cores):
    """It begins with the same parameters, moves a share of the way, and its outputs have no gradient."""
    stacks, inputs = stacks_of(CRITICS, cores)
    twin = stacks.twin()
    assert torch.equal(twin(inputs), stacks(inputs))
    assert not twin(inputs).requires_grad
    start = stacks.flat.detach().clone()
    stacks.flat.detach().add_(1.0)
    twin.follow(stacks, 0.25)
    torch.testing.assert_close(twin.flat, start + 0.25)


def test_a_clip_shortens_what_is_longer():
    """Each network has its own norm; those above the limit come down to it, and the norms are those before."""
    stacks, inputs = stacks_of(CRITICS, 1)
    stacks(inputs).sum().backward()
    before = stacks.norms()
    limit = float(before.median())
    torch.testing.assert_close(stacks.clip(limit), before)
    torch.testing.assert_close(stacks.norms(), before.clamp_max(limit))
    assert before.max() > limit > before.min()
