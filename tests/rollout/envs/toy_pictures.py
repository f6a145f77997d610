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
        self.render_mode = "human" if how == "deaf" else render_mode
        self.how, self.size, self.seconds = how, (height, width), seconds
        super().__init__(leave, stay)
        if how == "team" and render_mode:
            self.possible_agents = ["runner_0", "keeper_0"]

    def action_space(self, agent):
        if self.how == "actions" and self.render_mode:
            return spaces.Box(np.array([0.0, -1.0]), np.array([1.0, 1.0]), dtype=np.float64)
        return super().action_space(agent)

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
        if self.how == "stubborn":  # as code in C that no signal interrupts
            while True:
                with suppress(BaseException):
                    time.sleep(60)
        return np.full((*self.size, 3), self.step_count, np.uint8)


def any_keywords(**keywords):
    """Return an environment from whatever arguments there are, as PettingZoo's own makers do."""
    return Drawn(**keywords)
