"""The short episodes of a training: of its policy, of random and constant actions, of scripts, and episodes
that failed."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from contextlib import closing
from functools import partial
from itertools import islice
from typing import Any

from deepbots_cli import api
from deepbots_cli.document import Permissions
from deepbots_cli.errors import DeepbotsError
from deepbots_cli.insight.conditions import instrument_program
from deepbots_cli.insight.trace import Trace, TraceRecorder, trace_episodes
from deepbots_cli.insight.training import TrainingEvidence
from deepbots_cli.learning.runs.verdict import quoted_episodes
from deepbots_cli.program.task import idle_action
from deepbots_cli.rollout import Driver, Start, steps
from deepbots_cli.rollout.drivers import action_from_values, constant_driver, named_driver, random_driver
from deepbots_cli.runtime import Supervisor
from deepbots_cli.runtime.streams import derive_seed

_PROBE_EPISODES, _PROBE_STEPS, _CONSTANT_ACTION_STEPS = 4, 300, 40
"""The number of short episodes of each driver (policy, random actions, no commands), the largest number of
their steps, and the number of steps of an episode with a constant action."""
_MAX_OPTIONS, _MAX_RANGES = 4, 8
"""The options of each choice, and the ranges, that have an episode with a constant action."""
_SCRIPT_EPISODES = 8
"""The number of whole episodes of each script. If all 8 succeed, the lower end of the 95 % interval (Wilson)
of the success rate is 68 %."""
_FAILED_EPISODES = 6
"""The number of episodes without success of the quoted evaluation that are repeated."""


def run_probes(
    evidence: TrainingEvidence,
    *,
    permissions: Permissions = Permissions(),
    on_episode: Callable[[int, int], object] | None = None,
    seconds: float = math.inf,
) -> None:
    """Run the short episodes of a training, all from the same starts, and put them into its evidence. No
    episode continues after `seconds`."""
    from deepbots_cli.learning.sb3.algorithms import torch_settings

    probes = _Probes(evidence, time.monotonic() + seconds, permissions, on_episode)
    with torch_settings(), closing(probes.world):
        probes.play()
    evidence.failed = _repeat_failed(evidence, probes.deadline, permissions)


class _Probes:
    """The short episodes of a training.

    Args:
        evidence: Takes their traces.
        deadline: The end by the monotonic clock, in s; no episode continues after it.
        permissions: The permissions of the scenario.
        on_episode: Called after each episode with the number so far and in total.
    """

    def __init__(
        self,
        evidence: TrainingEvidence,
        deadline: float,
        permissions: Permissions,
        on_episode: Callable[[int, int], object] | None,
    ) -> None:
        self._evidence, self.deadline, self._on_episode = evidence, deadline, on_episode
        run, watch = evidence.run, instrument_program(evidence.program, include_observation=True)
        program = api.build(watch.program, engine=run.record.engine, permissions=permissions)
        self.world = TraceRecorder(program, watch, run.compiled.units)
        self._done, self._total = 0, 0

    def play(self) -> None:
        evidence, world = self._evidence, self.world
        constant, idle = _constant_actions(world.world), self._idle_action()
        policy, scripts = self._policy_driver(), _scripts_to_play(evidence)
        kinds = 1 + (idle is not None) + (policy is not None)
        self._total = _PROBE_EPISODES * kinds + sum(map(len, constant.values()))
        self._total += _SCRIPT_EPISODES * len(scripts)
        seeds = self._seeds(_PROBE_EPISODES)
        random, played, still = list[Trace](), list[Trace](), list[Trace]()
        for (
            seed
        ) in seeds:  # one of each kind in turn, so that there are some of every kind after a few seconds
            random += self._episode(seed, random_driver(world))
            if policy is not None:
                played += self._episode(seed, policy())
            if idle is not None:
                still += self._episode(seed, constant_driver(world.world.make_action(*idle)))
        evidence.random, evidence.policy, evidence.idle = random, played, still
        for part, actions in constant.items():
            traces = {
                name: self._episode(seeds[0], constant_driver(action), _CONSTANT_ACTION_STEPS)
                for name, action in actions.items()
            }
            evidence.constant_actions[part] = {
                name: action_traces[0] for name, action_traces in traces.items() if action_traces
            }
        longest = evidence.program.truncation.max_episode_steps(evidence.program.period)
        for name in scripts:
            episodes = [
                trace
                for seed in self._seeds(_SCRIPT_EPISODES)
                for trace in self._episode(seed, named_driver(world, name), longest)
            ]
            # Episodes that the deadline has cut are left out.
            evidence.scripts[name] = [trace for trace in episodes if trace.outcome != "not ended"]

    def _seeds(self, count: int) -> list[int]:
        seed = self._evidence.run.record.seed
        return [derive_seed(seed, "diagnosis", number) for number in range(count)]

    def _idle_action(self) -> Any:
        """Return the action that commands zeros; None where a range has no zero."""
        agent = self._evidence.program.agent
        has_zeros = all(interval.low <= 0.0 <= interval.high for interval in agent.ranges)
        return idle_action(agent.action) if has_zeros else None

    def _policy_driver(self) -> Callable[[], Driver] | None:
        """Make a driver of the last policy; None before there is one."""
        from deepbots_cli.learning.policy import load_model
        from deepbots_cli.rollout.policies import PolicyDriver

        run = self._evidence.run
        name: Any = next((name for name in ("last", "best") if run.model(name).is_file()), None)
        return None if name is None else partial(PolicyDriver, load_model(run, name, self.world), self.world)

    def _episode(self, seed: int, driver: Driver, count: int = _PROBE_STEPS) -> list[Trace]:
        """Return the trace of an episode of at most `count` steps, in a list; empty after the deadline."""
        if time.monotonic() > self.deadline:
            return []
        error = ""
        try:
            for _ in islice(steps(self.world, driver, Start(seed)), count + 1):
                if time.monotonic() > self.deadline:
                    break
        except DeepbotsError as failed:
            error = str(failed)
        self._done += 1
        if self._on_episode is not None:
            self._on_episode(self._done, self._total)
        return [self.world.trace("a short episode", error=error)]


def _repeat_failed(evidence: TrainingEvidence, deadline: float, permissions: Permissions) -> list[Trace]:
    """Repeat the first episodes without success of the quoted evaluation, until the deadline."""
    quoted = (
        quoted_episodes(evidence.run)
        if evidence.final_episodes and evidence.run.program.defines_success
        else None
    )
    if quoted is None or evidence.run.program.agent.copies is not None or time.monotonic() > deadline:
        return []
    numbers = [number for number, episode in enumerate(evidence.final_episodes) if not episode.is_success]
    numbers = numbers[:_FAILED_EPISODES]
    traces = []
    try:
        for trace in trace_episodes(evidence.run, numbers, **quoted.replay_options, permissions=permissions):
            traces.append(trace)
            if time.monotonic() > deadline:
                break
    except DeepbotsError:  # its model is missing, for example
        pass
    return traces


def _scripts_to_play(evidence: TrainingEvidence) -> list[str]:
    """Return the script that teaches the policy, or else those that could teach it; empty if no success
    allows a comparison."""
    agent = evidence.program.agent
    if (
        evidence.agent
        or not evidence.program.defines_success
        or agent.copies is not None
        or agent.training is None
    ):
        return []
    if agent.training.teacher is not None:
        return [agent.training.teacher.script]
    return [script.name for script in agent.scripts]


def _constant_actions(env: Supervisor) -> dict[str, dict[str, Any]]:
    """Return, for each part of the action, constant actions in which it alone differs: the first options of a
    choice, both ends of a range."""
    agent = env.scenario.agent
    picks = {
        choice.name: {option.name: n for n, option in enumerate(choice.options[:_MAX_OPTIONS])}
        for choice in agent.choices
    }
    values: dict[str, Mapping[str, float]] = {
        **picks,
        **{name: {"-1": -1.0, "1": 1.0} for name in agent.range_names[:_MAX_RANGES]},
    }
    return {
        name: {word: action_from_values(env, {name: value}) for word, value in by_name.items()}
        for name, by_name in values.items()
    }
