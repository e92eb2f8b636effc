"""An episode as mp4."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import gymnasium as gym

from deepbots_cli.errors import MissingExtraError, UsageError
from deepbots_cli.files import atomic_write, check_output

_RATE = 30.0  # pictures per second


def check_video_path(path: Path, *, force: bool) -> None:
    """Find out before a long evaluation whether a video could be written to `path`, and overwrites no file unless `force`.

    Raises:
        MissingExtraError: Without imageio and its ffmpeg.
        UsageError: If the name does not end in .mp4, it exists, or its directory does not exist or may not be written to.
    """
    if find_spec("imageio") is None or find_spec("imageio_ffmpeg") is None:
        raise MissingExtraError("train", "writing a video")
    if path.suffix.lower() != ".mp4":
        raise UsageError(f"{path} cannot be a video: its name does not end in .mp4")
    check_output(path, force=force)  # ffmpeg would say so at length, and name a file that nobody asked for


@contextmanager
def recording_video(world: gym.Env[Any, Any], path: Path, period: float) -> Iterator[gym.Env[Any, Any]]:
    """`world`, with a picture of the reset and of every so many steps in `path`, about `_RATE` a second; `period` (s) is that of a step.

    The world must have been made with `render_mode="rgb_array"`.
    """
    import imageio.v2 as imageio

    # Pictures of even height and width are all that the codec asks for; by default they would be scaled to multiples of 16.
    every = max(1, round(1 / _RATE / period))
    with atomic_write(path) as draft, imageio.get_writer(draft, fps=1 / period / every, macro_block_size=2) as writer:
        yield _VideoRecorder(world, writer, every)


class _VideoRecorder(gym.Wrapper[Any, Any, Any, Any]):
    def __init__(self, world: gym.Env[Any, Any], writer: Any, every: int) -> None:
        super().__init__(world)
        self._writer, self._every, self._steps = writer, every, 0

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        first = self.env.reset(seed=seed, options=options)
        self._steps = 0
        self._writer.append_data(self.env.render())
        return first

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        outcome = self.env.step(action)
        self._steps += 1
        if self._steps % self._every == 0 or outcome[2] or outcome[3]:
            self._writer.append_data(self.env.render())
        return outcome
