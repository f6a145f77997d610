"""Environments that each do one thing that they should not; every one of them begins as a sound `Relay`."""

import atexit
import ctypes
import os
import signal
import subprocess
import sys
import threading
import time
import warnings

import numpy as np
from gymnasium import spaces

sys.path.insert(0, os.path.dirname(__file__))
from toy_env import Relay

from eia_sec import EnvironmentOutageError

MARK = os.environ.get("TOY_MARK", "toy")
REWARDS = {"none": None, "list": np.ones(1), "huge": 3e7, "long": 10**400, "nan": np.nan}


class Raising(Relay):
    """Raises an exception in the named method."""

    def __init__(self, where="step", exits=False):
        self.where, self.exits = where, exits
        super().__init__()
        self.fail("construction")

    def fail(self, method):
        if method == self.where:
            if self.exits:
                sys.exit(0)
            raise ValueError("no such gear")

    def reset(self, seed=None, options=None):
        self.fail("reset")
        return super().reset(seed)

    def step(self, actions):
        self.fail("step")
        return super().step(actions)

    def observation_space(self, agent):
        self.fail("observation_space")
        return super().observation_space(agent)

    def close(self):
        super().close()
        self.fail("close")


class Wrong(Relay):
    """Returns something else than PettingZoo asks for."""

    def __init__(self, what):
        super().__init__()
        self.what = what
        if what == "twice":
            self.possible_agents = ["runner_0", "runner_0", "keeper_0"]
        if what == "lists":
            self.possible_agents = ["runner_0", ["runner_1"], "keeper_0"]

    def observation_space(self, agent):
        found = super().observation_space(agent)
        if self.what == "space":
            return (2,)
        if self.what == "pixels" and agent == "keeper_0":
            return spaces.Box(0, 255, (210, 261, 3), np.uint8)
        return found

    def reset(self, seed=None, options=None):
        seen, infos = super().reset(seed)
        if self.what == "observations alone":
            return seen
        if self.what == "unseen":
            del seen["keeper_0"]
        if self.what in ("alive twice", "nobody"):
            self.agents = [] if self.what == "nobody" else [*self.agents, self.agents[0]]
        if self.what == "infos":
            infos["runner_1"] = None
        return seen, infos

    def step(self, actions):
        seen, rewards, *others = super().step(actions)
        if self.what == "four":
            return seen, rewards, others[0], others[2]
        rewards["keeper_0"] = REWARDS.get(self.what, 1.0)
        if self.what == "rewardless":
            del rewards["keeper_0"]
        if self.what == "endless":
            del others[0]["keeper_0"]
        if self.what in ("texts", "flags"):
            others[1]["keeper_0"] = "False" if self.what == "texts" else np.array([True, False])
        if self.what in ("far", "infinite"):
            seen["runner_1"][1] = 2.5e7 if self.what == "far" else np.inf
        if self.what == "short":
            seen["runner_1"] = np.zeros(1)
        return seen, rewards, *others


class Meddling(Relay):
    """Sets what belongs to the whole process, and needs it so."""

    def __init__(self):
        super().__init__()
        import torch  # noqa: PLC0415  # as late as a user's might

        self.meddle(torch)

    def meddle(self, torch):
        np.seterr(all="raise")
        torch.set_default_dtype(torch.float64)
        warnings.simplefilter("error")
        os.chdir("/")
        sys.argv = ["mine"]
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGCHLD):
            signal.signal(number, signal.SIG_IGN)

    def step(self, actions):
        import torch  # noqa: PLC0415  # loaded by then

        assert np.geterr()["over"] == "raise"
        assert torch.get_default_dtype() == torch.float64
        assert os.getcwd() == "/"
        assert sys.argv == ["mine"]
        return super().step(actions)


class Late(Relay):
    """Shows a runner something far away from the hundredth step on."""

    steps = 0

    def step(self, actions):
        seen, *others = super().step(actions)
        Late.steps += 1
        if Late.steps > 100 and "runner_0" in seen:
            seen["runner_0"][1] = -4e8
        return seen, *others


class Simulated(Relay):
    """Holds a process of its own, which only `close` ends; may crash or hang after some steps."""

    def __init__(self, crash=0, hang=0, pause=0.0):
        super().__init__()
        self.crash, self.hang, self.pause, self.made = crash, hang, pause, 0
        # The last word is what a test looks for.
        self.process = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)", MARK])

    def step(self, actions):
        self.made += 1
        time.sleep(self.pause)
        if self.made == self.crash:
            os.kill(os.getpid(), signal.SIGKILL)
        if self.made == self.hang:
            time.sleep(600)
        return super().step(actions)

    def close(self):
        super().close()
        self.process.kill()
        self.process.wait()


class Away(Relay):
    """Is away in its seventh step, and for two resets after that."""

    def __init__(self):
        super().__init__()
        self.made = self.missed = 0

    def reset(self, seed=None, options=None):
        if self.made == 7 and self.missed < 2:
            self.missed += 1
            raise EnvironmentOutageError("the arm is in emergency stop")
        return super().reset(seed)

    def step(self, actions):
        self.made += 1
        if self.made == 7:
            raise EnvironmentOutageError("the arm is in emergency stop")
        return super().step(actions)


class AwayAt(Relay):
    """Is away for the first two calls of the named method, over all its instances."""

    missed = 0

    def __init__(self, where):
        self.where = where
        super().__init__()
        self.miss("construction")

    def miss(self, method):
        if method == self.where and AwayAt.missed < 2:
            AwayAt.missed += 1
            raise EnvironmentOutageError("no link to the arm")

    def observation_space(self, agent):
        self.miss("observation_space")
        return super().observation_space(agent)

    def reset(self, seed=None, options=None):
        self.miss("reset")
        return super().reset(seed)

    def step(self, actions):
        self.miss("step")
        return super().step(actions)


class Leaving(Relay):
    """Ends the process past everything, at once or after some steps, from the main thread or another one."""

    def __init__(self, after=0, code=7, thread=False):
        super().__init__()
        self.remaining, self.code, self.thread = after, code, thread
        self.depart()

    def depart(self):
        self.remaining -= 1
        if self.remaining < 0:
            if self.thread:
                threading.Thread(target=os._exit, args=[self.code]).start()
                time.sleep(60)
            os._exit(self.code)

    def step(self, actions):
        self.depart()
        return super().step(actions)


class Exiting(Leaving):
    """The same by the C library, which tells nobody."""

    def depart(self):
        self.remaining -= 1
        if self.remaining < 0:
            ctypes.CDLL(None)._exit(self.code)


class Lingering(Relay):
    """Leaves a thread that never ends, and a library that ends the process with a code of its own at its exit."""

    def __init__(self, **arguments):
        super().__init__(**arguments)
        threading.Thread(target=time.sleep, args=[600.0]).start()
        atexit.register(lambda: ctypes.CDLL(None)._exit(7))
