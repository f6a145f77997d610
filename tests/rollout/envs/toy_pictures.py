"""Environments that draw pictures, or do not, or do it wrong; every one of them is otherwise a sound `Relay`."""

import os
import sys
import time
from contextlib import suppress

import numpy as np
from gymnasium import spaces

sys.path.insert(0, os.path.dirname(__file__))
from toy_env import Relay


class Drawn(Relay):
    """Shows its step number as a grey, in a picture of the given size; `how` says what goes wrong."""

    def __init__(self, render_mode=None, how="", height=6, width=9, seconds=0.0, leave=3, stay=5):
        if how == "making" and render_mode:
            raise RuntimeError("no display")
        while how == "waits" and render_mode:
            time.sleep(60)
        if how == "unbending" and render_mode:
            self._resist()
        if how == "aborts" and render_mode:
            os.abort()
        self.render_mode = "human" if how == "deaf" else render_mode
        self.how, self.size, self.seconds = how, (height, width), seconds
        super().__init__(leave, stay)
        if how == "team" and render_mode:
            self.possible_agents = ["runner_0", "keeper_0"]

    def action_space(self, agent):
        if self.how == "actions" and self.render_mode:
            return spaces.Box(np.array([0.0, -1.0]), np.array([1.0, 1.0]), dtype=np.float64)
        return super().action_space(agent)

    def reset(self, seed=None, options=None):
        if self.how == "reset" and self.render_mode:
            raise RuntimeError("No available video device")
        return super().reset(seed, options)

    def step(self, actions):
        found = super().step(actions)
        if self.how == "step" and self.render_mode and self.step_count == 2:
            raise RuntimeError("No available video device")
        return found

    def render(self):
        time.sleep(self.seconds)
        if self.how == "raises":
            raise ValueError("no such brush")
        if self.how == "text":
            return "a picture"
        if self.how == "hangs":
            while True:
                with suppress(Exception):
                    time.sleep(60)
        if self.how == "stubborn":
            self._resist()
        return np.full((*self.size, 3), self.step_count, np.uint8)

    def _resist(self):
        """Go on as code in C that no signal interrupts."""
        while True:
            with suppress(BaseException):
                time.sleep(60)


class Touchy(Drawn):
    """Raises when it is asked for its mode."""

    @property
    def render_mode(self):
        raise RuntimeError("no mode")

    @render_mode.setter
    def render_mode(self, mode):
        self.mode = mode


def any_keywords(**keywords):
    """Return an environment from whatever arguments there are, as PettingZoo's own makers do."""
    return Drawn(**keywords)
