"""`eia_sec.remote` is light enough for a robot."""

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[3]
ALLOWED = ("zenoh", "msgpack", "numpy", "eia_sec", "tests")
PROGRAM = """
import sys, threading

class Doorman:
    def find_spec(self, name, path=None, target=None):
        top = name.partition(".")[0]
        if top not in sys.stdlib_module_names and top not in {allowed!r}:
            raise ModuleNotFoundError(f"{{name}} is not there", name=name)
        return None

sys.meta_path.insert(0, Doorman())
from eia_sec.common.transport.bus import Bus
from eia_sec.common.transport.endpoint import free_endpoint
from eia_sec.remote import serve
from eia_sec.common.protocol import keys
from eia_sec.common.protocol.environment_messages import ClaimAnswer, ClaimRequest, StepAnswer, StepRequest

sys.path.insert(0, {root!r})
from tests.rollout.remote.toy_served import Line

endpoint = free_endpoint()
with Bus.listen(endpoint, "control") as bus:
    threading.Thread(target=serve, args=(Line(), "site-a", str(endpoint)), daemon=True).start()
    ask = lambda verb, message: bus.ask(keys.ENVIRONMENT.key(environment="site-a", verb=verb), message.encode(), 5.0)
    while (answer := ask("claim", ClaimRequest("w", 1))) is None:
        pass
    granted = ClaimAnswer.decode(answer)
    answer = StepAnswer.decode(ask("step", StepRequest(granted.incarnation, granted.lease, 1, [3])))
    print(answer.status, sorted({{name.partition(".")[0] for name in sys.modules}} & {{"torch", "numba", "gymnasium"}}))
    import os
    sys.stdout.flush()
    os._exit(0)
"""


def test_serving_needs_zenoh_msgpack_and_numpy_only() -> None:
    """With every other package out of reach, an environment is claimed and makes a step."""
    program = PROGRAM.format(allowed=ALLOWED, root=str(ROOT))
    found = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=False)
    assert found.stdout == "done []\n", found.stderr
