"""Several agents as an environment of PettingZoo, and the window that shows it."""

from __future__ import annotations

import time
import warnings
from collections.abc import Mapping
from typing import Any

import numpy as np
from pettingzoo import ParallelEnv

from deepbots_cli.errors import MissingExtraError, UsageError
from deepbots_cli.runtime.agents import combined_action, seats_of
from deepbots_cli.runtime.formulas import total
from deepbots_cli.runtime.streams import derive_seed
from deepbots_cli.runtime.supervisor import Supervisor

RGB_ARRAY, HUMAN = "rgb_array", "human"
IGNORED = "options"
"""The one key of `options` of a reset that names no draw: the tests of PettingZoo pass it."""


class ParallelEnvironment(ParallelEnv[str, Any, Any]):  # type: ignore[misc]  # PettingZoo has no types
    """All agents of a scenario, which act at the same time.

    An episode ends for all agents at once, unless an ending ends that of some agents alone: these are then no
    longer among `agents`, and their robots stop. `infos[agent]` has `is_success`, `ended_by`, `endings` and
    `reward_terms`, and `action_mask` if the action of the agent has choices that may be forbidden.

    Attributes:
        world: The supervisor of the world.

    Args:
        render_mode: That of the world, or `human`: a window then shows each step, for which the world needs
            the mode `rgb_array`.
    """

    def __init__(self, world: Supervisor, render_mode: str | None = None) -> None:
        self.world = world
        self._seats = seats_of(world)
        self.possible_agents = list(self._seats)
        self.agents: list[str] = []
        modes = world.metadata["render_modes"]
        self.metadata = {
            **world.metadata,
            "render_modes": [HUMAN, *modes] if RGB_ARRAY in modes else modes,
            "name": world.scenario.name,
            "is_parallelizable": True,
        }
        self.render_mode = HUMAN if render_mode == HUMAN else world.render_mode
        self._window = (
            Window(world.scenario.name, world.scenario.period) if self.render_mode == HUMAN else None
        )
        self.observation_spaces = {name: seat.observation_space for name, seat in self._seats.items()}
        self.action_spaces = {name: seat.action_space for name, seat in self._seats.items()}
        self._observed: Any = None

    def observation_space(self, agent: str) -> Any:
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> Any:
        return self.action_spaces[agent]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, dict[str, Any]]]:
        """Begin an episode; see `Supervisor.reset`.

        Args:
            seed: It determines this episode and all following ones until the next seed.
            options: Values in place of draws, by the names of `drawn`, which each info has.

        Raises:
            UsageError: `options` contains an unknown name, or a value that the episode cannot draw.
        """
        values = {name: value for name, value in (options or {}).items() if name != IGNORED}
        self._observed, info = self.world.reset(seed=seed, options=values)
        if seed is not None:
            for name, space in self.action_spaces.items():
                space.seed(derive_seed(seed, "actions", name))
        self.agents = list(self.possible_agents)
        self._show()
        return self._observations(), {name: seat.info(info) for name, seat in self._seats.items()}

    def step(
        self, actions: dict[str, Any]
    ) -> tuple[dict[str, Any], dict[str, float], dict[str, bool], dict[str, bool], dict[str, dict[str, Any]]]:
        """Advance by one step of all agents.

        Raises:
            UsageError: No episode runs, or the action of an agent is missing or does not fit its space.
        """
        if not self.agents:
            raise UsageError("call reset() before step()")
        acting = self.agents
        if len(acting) < len(self._seats):
            resting = {name: seat.still for name, seat in self._seats.items() if name not in acting}
            actions = {**actions, **resting}
        together = combined_action(self.world, self._seats, actions)
        self._observed, _, terminated, truncated, info = self.world.step(together)
        alone = self.world.agent_endings
        ends, cuts = dict.fromkeys(acting, terminated), dict.fromkeys(acting, truncated)
        if terminated or truncated or alone:
            for name in alone.keys() & ends.keys():
                ends[name], cuts[name] = True, False
            self.agents = [name for name in acting if not (ends[name] or cuts[name])]
        self._show()
        observations = {name: self._seats[name].observation(self._observed) for name in acting}
        infos = {name: self._seats[name].info(info) for name in acting}
        rewards = {name: total(agent_info["reward_terms"].values()) for name, agent_info in infos.items()}
        return observations, rewards, ends, cuts, infos

    def state(self) -> Any:
        """Return the observations of all agents in a row, float32: for training with a central critic.

        Raises:
            UsageError: No episode has begun, or the scenario has pictures.
        """
        if self._observed is None:
            raise UsageError("call reset() before state()")
        if isinstance(self._observed, Mapping):
            raise UsageError("a scenario with pictures has no state of all agents; use the observations")
        return np.array(self._observed)

    def render(self) -> Any:
        """Return an image of the world, uint8 of shape (rows, columns, 3). Without a render mode, and in the
        mode `human`, whose window shows each step, return None."""
        return None if self._window is not None else self.world.render()

    def _show(self) -> None:
        if self._window is not None:
            self._window.show(self.world.render())

    def close(self) -> None:
        """Release the engine, and close the window."""
        if self._window is not None:
            self._window.close()
        self.world.close()

    def _observations(self) -> dict[str, Any]:
        return {name: seat.observation(self._observed) for name, seat in self._seats.items()}


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
        self._pyplot = pyplot
        self._period = period
        self._due = 0.0
        # Without the `matplotlibrc` of the current folder, and without a change of the caller's settings.
        with pyplot.style.context("default"):
            self._figure = pyplot.figure(layout="tight")
        if self._figure.canvas.manager is not None:
            self._figure.canvas.manager.set_window_title(title)
        self._picture: Any = None
        # None for a backend without windows, such as Agg, which matplotlib takes without a display.
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
            with self._pyplot.style.context("default"):
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
