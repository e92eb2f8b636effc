"""Telling how a training goes: a bar on a terminal, a plain line every tenth elsewhere."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, TextIO

from deepbots_cli.progress import ProgressBar


@dataclass(frozen=True)
class Standing:
    """How far a training is; the means are over the recent episodes, None before the first has ended. `stage` is for people to read."""

    steps: int
    total_steps: int
    episodes: int
    mean_return: float | None
    success_rate: float | None
    simulated_hours: float
    stage: str = ""


class Reporter(Protocol):
    """Follows a training: `start` once, `update` from time to time, `stop` once, also after a failure."""

    def start(self, standing: Standing) -> None: ...
    def update(self, standing: Standing) -> None: ...
    def stop(self) -> None: ...


class Silence:
    """Tells nothing."""

    def start(self, standing: Standing) -> None:
        pass

    def update(self, standing: Standing) -> None:
        pass

    def stop(self) -> None:
        pass


class Display:
    """A bar on a terminal, a line for every tenth of the way elsewhere."""

    def __init__(self, stream: TextIO | None = None) -> None:
        self._stream = stream
        self._bar: ProgressBar | None = None

    def start(self, standing: Standing) -> None:
        self._bar = ProgressBar(standing.total_steps, "steps", done=standing.steps, stream=self._stream)

    def update(self, standing: Standing) -> None:
        if self._bar is not None:
            self._bar.update(standing.steps, figures(standing))

    def stop(self) -> None:
        if self._bar is not None:
            self._bar.close()


def reporter(wish: bool | Reporter) -> Reporter:
    """The reporter meant by `progress=`: none, one of the caller's, or a display on standard error."""
    if not isinstance(wish, bool):
        return wish
    if not wish:
        return Silence()
    return Display()


def figures(standing: Standing) -> str:
    """`return 182.4  success 40 %  0.21 simulated h`."""
    parts = [standing.stage] if standing.stage else []
    parts.append(f"{standing.episodes:,} episodes")
    if standing.mean_return is not None:
        parts.append(f"return {standing.mean_return:.1f}")
    if standing.success_rate:
        parts.append(f"success {standing.success_rate:.0%}")
    parts.append(f"{standing.simulated_hours:.2f} simulated h")
    return "  ".join(parts)
