"""Adam is torch's own, without what torch's class loads."""

import subprocess
import sys

import torch

from eia_sec.learner.networks.adam import Adam

RATES = 1e-3, 3e-4
EPSILON = 1e-5


def test_steps_are_those_of_torch():
    """Bit by bit, with rates that fall, and with a tensor that has no gradient in some steps."""
    torch.manual_seed(0)
    own = [torch.nn.Parameter(torch.randn(2, 1000)) for _ in range(3)]
    other = [torch.nn.Parameter(parameter.detach().clone()) for parameter in own]
    adam = Adam([(own[:2], RATES[0]), (own[2:], RATES[1])], epsilon=EPSILON)
    reference = torch.optim.Adam([{"params": other[:2]}, {"params": other[2:]}], eps=EPSILON, fused=True)
    for step in range(20):
        share = 1.0 - step / 40
        for group, rate in zip(reference.param_groups, RATES, strict=True):
            group["lr"] = rate * share
        for index, (mine, theirs) in enumerate(zip(own, other, strict=True)):
            theirs.grad = None if index == 1 and step % 3 == 1 else torch.randn_like(theirs)
            mine.grad = None if theirs.grad is None else theirs.grad.clone()
        adam.step(share)
        reference.step()
    for mine, theirs in zip(own, other, strict=True):
        assert torch.equal(mine, theirs)
        for name, moment in adam.moments[mine]._asdict().items():
            assert torch.equal(moment, reference.state[theirs][name])
    adam.zero_grad()
    assert all(parameter.grad is None for parameter in own)


def test_a_share_may_be_a_tensor():
    """A step whose share of the rates is a tensor is that with the number."""
    own, other = (torch.nn.Parameter(torch.linspace(-1.0, 1.0, 9)) for _ in range(2))
    numbers, tensors = (Adam([([parameter], RATES[0])], epsilon=EPSILON) for parameter in (own, other))
    for share in (1.0, 0.5, 0.25):
        own.grad, other.grad = torch.sin(own.detach()), torch.sin(other.detach())
        numbers.step(share)
        tensors.step(torch.tensor(share))
    torch.testing.assert_close(own, other, atol=0.0, rtol=1e-6)


def test_a_learner_does_without_the_compiler_of_torch():
    """It takes as long to load as torch itself."""
    program = (
        "import sys\n"
        "from eia_sec.learner.trainers import make_trainer\n"
        "from tests.learner.on_policy.small_runs import TEAM, chunk, configured\n"
        "trainer = make_trainer(configured(), TEAM)\n"
        "trainer.absorb(chunk(trainer.actors(), 0, ((40, 0),)))\n"
        "trainer.train(trainer.updates_due())\n"
        "sys.exit('torch._dynamo' in sys.modules or trainer.updates == 0)"
    )
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0
