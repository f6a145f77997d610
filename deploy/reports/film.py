"""Films: frames are piped to ffmpeg one by one, so none is kept in memory."""

import importlib
import os
import shutil
import subprocess
import tempfile
from pathlib import Path
from types import TracebackType
from typing import IO, Final, Self

import numpy as np
from numpy.typing import NDArray

from eia_sec.common.errors import EiaSecError, UsageError

GIF_WIDTH: Final = 960
"""Pixels; a GIF compresses little."""
CODECS: Final = {
    ".mp4": ("-c:v", "libx264", "-crf", "23", "-preset", "medium", "-pix_fmt", "yuv420p", "-movflags", "+faststart"),
    # A palette for each frame: one for the whole film would need all frames first.
    ".gif": (
        "-filter_complex",
        f"scale={GIF_WIDTH}:-2:flags=area,split[a][b];[a]palettegen=stats_mode=single[p];[b][p]paletteuse=new=1:dither=none",
    ),
}
"""ffmpeg's arguments by file suffix."""


def find_ffmpeg() -> str:
    """Return the path of ffmpeg: from the package imageio-ffmpeg, IMAGEIO_FFMPEG_EXE, or PATH.

    Raises:
        UsageError: it was not found.
    """
    try:
        return str(importlib.import_module("imageio_ffmpeg").get_ffmpeg_exe())
    except (ImportError, RuntimeError):
        found = os.environ.get("IMAGEIO_FFMPEG_EXE") or shutil.which("ffmpeg")
    if found is None:
        raise UsageError("films need ffmpeg: pip install 'eia-sec[replay]', or skip the film with --film none.")
    return found


class Film:
    """A film that is being written; use it as a context manager.

    The file appears when it is complete, and not at all after an error.

    Args:
        path: the file, .mp4 or .gif.
        size: width and height, pixels, both even.
        rate: frames per second.

    Raises:
        UsageError: there is no ffmpeg, or the file cannot be written there.
    """

    def __init__(self, path: Path, size: tuple[int, int], rate: float) -> None:
        self._path, self._size = path, size
        self._part = path.with_name(f".{path.stem}.part{path.suffix}")
        self._rate = rate
        self._command = find_ffmpeg()
        self._errors: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115  # it is closed with the film
        self._process: subprocess.Popen[bytes] | None = None

    def __enter__(self) -> Self:
        raw = ("-f", "rawvideo", "-pix_fmt", "rgb24", "-s", "{}x{}".format(*self._size), "-r", f"{self._rate:g}")
        command = [self._command, "-y", "-loglevel", "error", *raw, "-i", "-", *CODECS[self._path.suffix]]
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            self._process = subprocess.Popen([*command, str(self._part)], stdin=subprocess.PIPE, stderr=self._errors)
        except OSError as error:
            raise UsageError(f"{self._path} cannot be written: {error.strerror}.") from error
        return self

    def add(self, picture: NDArray[np.uint8]) -> None:
        """Append a frame [H, W, 3]; wait if the encoder is busy.

        Raises:
            EiaSecError: the encoder has given up.
        """
        assert self._process is not None
        assert self._process.stdin is not None
        if picture.shape != (self._size[1], self._size[0], 3):
            raise EiaSecError(f"a picture is {picture.shape}, the film is {self._size}.")
        try:
            self._process.stdin.write(np.ascontiguousarray(picture).data)
        except BrokenPipeError:
            raise EiaSecError(f"the film could not be written: {self._reason()}") from None

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        assert self._process is not None
        try:
            if kind is not None:
                self._process.kill()
            self._process.communicate()
            if kind is None and self._process.returncode != 0:
                raise EiaSecError(f"the film could not be written: {self._reason()}")
            if kind is None:
                self._part.replace(self._path)
        finally:
            self._part.unlink(missing_ok=True)
            self._errors.close()

    def _reason(self) -> str:
        assert self._process is not None
        self._process.wait()
        self._errors.seek(0)
        lines = self._errors.read(4096).decode(errors="replace").strip().splitlines()
        return lines[-1] if lines else f"ffmpeg ended with {self._process.returncode}."
