"""A window with images of a world, by matplotlib."""

from __future__ import annotations

import time
import warnings
from typing import Any

from deepbots_cli.errors import MissingExtraError


class Window:
    """A window that shows one image after another, in the time of the world.

    Without a display it shows nothing, and warns.

    Args:
        title: The title of the window.
        period: The time between two images in s.

    Raises:
        MissingExtraError: matplotlib is not installed.
    """

    def __init__(self, title: str, period: float) -> None:
        try:
            from matplotlib import pyplot
        except ModuleNotFoundError as error:
            raise MissingExtraError("view", "a window") from error
        self._pyplot, self._period, self._due = pyplot, period, 0.0
        self._figure = pyplot.figure(layout="tight")
        if self._figure.canvas.manager is not None:
            self._figure.canvas.manager.set_window_title(title)
        self._picture: Any = None
        self._has_display = self._figure.canvas.required_interactive_framework is not None
        if not self._has_display:
            warnings.warn(
                'there is no display for render mode "human"; use "rgb_array"', RuntimeWarning, stacklevel=3
            )

    def show(self, image: Any) -> None:
        """Show an image, uint8 of shape (rows, columns, 3)."""
        if not self._has_display:
            return
        if self._picture is None:
            axes = self._figure.add_subplot()
            axes.set_axis_off()
            self._picture = axes.imshow(image)
            self._pyplot.show(block=False)
        self._picture.set_data(image)
        self._figure.canvas.draw_idle()
        self._figure.canvas.flush_events()
        time.sleep(max(0.0, self._due - time.monotonic()))
        self._due = time.monotonic() + self._period

    def close(self) -> None:
        self._pyplot.close(self._figure)
