"""The scalars that a training logs beside those of its learner."""

from __future__ import annotations

import time

import numpy as np

from deepbots_cli.learning.active import ActiveTraining
from deepbots_cli.learning.runs.episodes import Summary, agent_returns
from deepbots_cli.learning.teaching.teacher import Plan, Teaching


class Scalars:
    """Records scalars of the episodes, the policy, the evaluations and the teacher of a training."""

    def __init__(self, active: ActiveTraining) -> None:
        self._active = active
        agent = active.run.program.agent
        newest = zip(agent.numbers, agent.newest, strict=True)
        self._seen = {
            number.full_name: index for number, index in newest if number.clip and not number.is_truth
        }
        """The place of the newest value of each clipped number in an observation. Truth values are left out,
        because they are always at an end of their range."""
        self._began = time.monotonic(), active.statistics.steps

    def record_episodes(self) -> None:
        """Record scalars beside those of the learner, which writes them with its own."""
        log = self._active.log
        statistics = self._active.statistics
        curriculum = self._active.curriculum
        log.record("rollout/episodes", statistics.episodes)
        log.record("rollout/simulated_hours", statistics.simulated_hours)
        began, steps = self._began
        simulated = (statistics.steps - steps) * statistics.period
        log.record("time/real_time_factor", simulated / max(1e-9, time.monotonic() - began))
        value = curriculum.value(statistics.steps)
        if curriculum.stages:
            log.record("curriculum/stage", curriculum.index + 1)
        if (levels := curriculum.levels) is not None:
            log.record("curriculum/mean_level", levels.mean)
            log.record("curriculum/lowest_level", levels.lowest)
            log.record("curriculum/highest_level", levels.highest)
            for with_value, mean_level in levels.by_value.items():
                log.record(f"curriculum/mean_level/{with_value}", mean_level)
        if curriculum.criterion is not None and value is not None:
            log.record(f"curriculum/{curriculum.criterion.metric}", value)
            log.record("curriculum/threshold", curriculum.criterion.threshold)
        for name, mean in statistics.term_means().items():
            log.record(f"reward/{name}", mean)
        for name, share in statistics.ended_by().items():
            log.record(f"ended_by/{name}", share)

    def record_policy(self) -> None:
        """Record scalars about the policy in the last rollout, or in the last steps of the replay buffer.

        `saturation/NAME` is the share of observations at the ends of their range, `action/OPTION` is the
        share of steps in which an option was chosen, and `action/probability` the mean probability of the
        chosen actions.
        """
        log, learner = self._active.log, self._active.learner
        choices = self._active.run.program.agent.choices
        observations, actions, log_probs = learner.recent()
        if log_probs is not None and choices:
            log.record("action/probability", float(np.exp(log_probs).mean()))
        if isinstance(observations, dict):
            observations = observations.get("observation")
        # A world of the caller may have other observations.
        if observations is not None and observations.shape[-1] > max(self._seen.values(), default=0):
            shares = (np.abs(observations) >= 1.0).mean(axis=(0, 1))
            for name, number_index in self._seen.items():
                log.record(f"saturation/{name}", float(shares[number_index]))
        for part, column in zip(
            choices, np.asarray(actions).reshape(-1, max(1, len(choices))).T, strict=False
        ):
            for index, option in enumerate(part.options):
                name = f"{part.name}/{option.name}" if len(choices) > 1 else option.name
                log.record(f"action/{name}", float((column == index).mean()))

    def record_evaluation(self, summary: Summary) -> None:
        log = self._active.log
        members = self._active.run.program.members
        for name, mean in agent_returns(members, summary.term_means).items():
            log.record(f"{name}/eval/mean_return", mean)
        log.record("eval/mean_return", summary.mean_return)
        log.record("eval/mean_length", summary.mean_length)
        if self._active.defines_success:
            log.record("eval/success_rate", summary.success_rate)

    def record_teacher(self, teaching: Teaching, plan: Plan) -> None:
        log = self._active.log
        log.record("teacher/weight", plan.weight)
        if teaching.demonstrations is None and teaching.policy is None:
            driven = 0 if plan.lesson is None else plan.lesson.worlds
            log.record("teacher/driven_worlds", driven / self._active.learner.setup.training.environments)
        if teaching.score is not None:  # each stage of a curriculum has its own score
            log.record("teacher/mean_return", teaching.score.mean_return)
            if self._active.defines_success:
                log.record("teacher/success_rate", teaching.score.success_rate)
