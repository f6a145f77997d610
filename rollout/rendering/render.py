"""Rendering one environment of a batch: as an array, as text, or in a window."""

import importlib
from typing import Any, Final, Protocol

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.control import Control

from eia_sec.common.errors import ConfigError
from eia_sec.rollout.rendering.scene import Observer, Scene
from eia_sec.rollout.rendering.terminal import coloured, fitting_width, terminal_text
from eia_sec.rollout.sim.batch import FarmBatch

RENDER_MODES: Final = ("rgb_array", "ansi", "human")
"""rgb_array: an image [H, W, 3] uint8; ansi: coloured text; human: a window if one can open, else the terminal."""
FRAMES_PER_SECOND: Final = 10
"""A comfortable speed for watching an episode."""


class Picture(Protocol):
    """Draws scenes, as `eia_sec.rollout.rendering.picture.FarmPicture` does."""

    def draw(self, scene: Scene) -> NDArray[np.uint8]:
        """Return a scene as an RGB image, [H, W, 3] uint8."""


class Screen(Protocol):
    """Shows scenes to people."""

    def show(self, scene: Scene) -> None:
        """Show a scene."""

    def close(self) -> None:
        """Close the display."""


def require_mode(mode: str | None) -> None:
    """Raise ConfigError unless the mode is None or one of RENDER_MODES."""
    if mode is not None and mode not in RENDER_MODES:
        raise ConfigError(f"unknown render mode {mode!r}; choose from {', '.join(RENDER_MODES)}.")


class Renderer:
    """Renders one environment of a batch.

    Args:
        batch: the simulator.
        index: index of the environment.
    """

    def __init__(self, batch: FarmBatch, index: int) -> None:
        self._observer = Observer(batch, index)
        self._picture: Picture | None = None
        self._screen: Screen | None = None

    def observe(self) -> None:
        """Record the current state for trails and charts. Call it after every reset and every step."""
        self._observer.observe()

    def render(self, mode: str) -> Any:
        """Render the current state.

        Args:
            mode: one of RENDER_MODES.

        Returns:
            an image [H, W, 3] uint8, a text, or None for "human".

        Raises:
            SimulationError: the environment was never reset.
        """
        scene = self._observer.scene()
        if mode == "ansi":
            return coloured(terminal_text(scene))
        if mode == "human":
            self._screen = self._screen or open_screen()
            self._screen.show(scene)
            return None
        self._picture = self._picture or make_picture(scene)
        return self._picture.draw(scene)

    def close(self) -> None:
        """Release the picture and close the window."""
        self._picture = None
        if self._screen is not None:
            self._screen.close()
            self._screen = None


def make_picture(scene: Scene) -> Picture:
    """Return a picture that can draw this farm. matplotlib is imported here so that workers never load it."""
    picture: Picture = importlib.import_module("eia_sec.rollout.rendering.picture").FarmPicture(scene)
    return picture


def open_screen() -> Screen:
    """Return a window if matplotlib can open one, else this process's terminal."""
    pyplot = importlib.import_module("matplotlib.pyplot")
    return Window(pyplot) if _has_windows(pyplot) else Terminal(Console())


class Window:
    """A matplotlib window.

    Args:
        pyplot: matplotlib.pyplot with an interactive backend.
    """

    def __init__(self, pyplot: Any) -> None:
        self._pyplot = pyplot
        self._figure: Any = None
        self._image: Any = None
        self._picture: Picture | None = None

    def show(self, scene: Scene) -> None:
        """Show a scene and let the window handle its events."""
        self._picture = self._picture or make_picture(scene)
        pixels = self._picture.draw(scene)
        if self._figure is None:
            height, width = pixels.shape[:2]
            self._figure = self._pyplot.figure("EIA-SEC farm", figsize=(width / 100, height / 100), dpi=100)
            self._image = self._figure.figimage(pixels)
            self._figure.show()
        self._image.set_data(pixels)
        self._figure.canvas.draw_idle()
        self._figure.canvas.flush_events()

    def close(self) -> None:
        """Close the window."""
        if self._figure is not None:
            self._pyplot.close(self._figure)


class Terminal:
    """Text on a console. On a terminal, each scene overwrites the one before.

    Args:
        console: the console to write to.
    """

    def __init__(self, console: Console) -> None:
        self._console = console
        self._shown = False

    def show(self, scene: Scene) -> None:
        """Write a scene."""
        if self._console.is_terminal:
            self._console.control(Control.home() if self._shown else Control.clear(), Control.home())
        width = fitting_width(self._console.width, self._console.height, scene.config.world)
        self._console.print(terminal_text(scene, width), end="", soft_wrap=True)
        self._shown = True

    def close(self) -> None:
        """Leave the last scene on the screen."""


def _has_windows(pyplot: Any) -> bool:
    """Return whether matplotlib's backend opens windows. Without a display, matplotlib picks one that does not."""
    backends = importlib.import_module("matplotlib.backends")
    windowed = backends.backend_registry.list_builtin(backends.BackendFilter.INTERACTIVE)
    return pyplot.get_backend().lower() in {name.lower() for name in windowed}
