"""The evaluations of a training: held-out episodes of the present networks, the models with the best of them,
and the choice of the best model at the end."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from deepbots_cli.analysis import possible_returns
from deepbots_cli.learning.active import ActiveTraining
from deepbots_cli.learning.held_out import EVALUATION_EPISODES, evaluation_seeds
from deepbots_cli.learning.report import Activity
from deepbots_cli.learning.runs.confirmation_rule import COST_SHARE
from deepbots_cli.learning.runs.episodes import AGENTS_COLUMN, Summary, agents_line
from deepbots_cli.learning.runs.order import Candidate, Shortlist, measure_of, most_episodes
from deepbots_cli.learning.runs.statistics import Interval
from deepbots_cli.rollout import Episode

if TYPE_CHECKING:
    from deepbots_cli.learning.learner import Learner

EVALUATION_SHARE = 0.1
"""The largest ratio of the steps of evaluations to the steps of the training."""
URGENT_SHARE = 0.4
"""The same when an evaluation may end the training soon, because its recent episodes meet `solved` or a
teacher drives."""
UNLIMITED_SHARE = math.inf


class TrainingEvaluations:
    """Evaluates the networks of a training from the same starts each time.

    Attributes:
        shortlist: The models of the best evaluations.
        returns: The lowest and the highest return in the evaluations of the stage.
        evaluated_at: The steps of the training at the last evaluation.
        count: The number of evaluations in this process.
        newest: The result of the last one.
        has_new_weights: Whether the networks have changed since.
        chosen_steps: Steps of the episodes that chose the best model after the training.
        activity: The choice of the best model while it lasts.
    """

    def __init__(self, active: ActiveTraining) -> None:
        agent = active.run.program.agent
        self._active = active
        self.shortlist = Shortlist(
            active.run,
            measure_of(agent.solved, defines_success=active.defines_success),
            keeps_newest=active.run.program.has_rivals,
        )
        self.returns: Interval | None = None
        self.evaluated_at = -1
        self.count = 0
        self.newest: Candidate | None = None
        self.has_new_weights = True
        self.chosen_steps = 0
        self.activity: Activity | None = None

    def share(self, *, has_teacher: bool) -> float:
        """Return the largest ratio of the steps of evaluations to the steps of the training so far."""
        share = URGENT_SHARE if has_teacher or self._seems_solved() else EVALUATION_SHARE
        return self._active.off_policy_factor * share

    def _seems_solved(self) -> bool:
        """Return whether the recent episodes of the training, with exploration, meet `solved`, and no
        confirmation has shown it."""
        statistics = self._active.statistics
        if statistics.solved_at is not None or statistics.solved is None:
            return False
        newest = statistics.newest(EVALUATION_EPISODES) if self._active.curriculum.is_last else None
        return newest is not None and Summary.of_episodes(newest).meets_solved(statistics.solved)

    def is_due(self, share: float) -> bool:
        """Return whether there are enough episodes since the last evaluation, and evaluations do not take
        more than their `share` of the steps."""
        statistics = self._active.statistics
        steps = self._active.statistics.steps
        fits = self._active.evaluator.steps + EVALUATION_EPISODES * statistics.mean_length <= share * steps
        # In a long rollout, the same policy would play the same starts again without new weights.
        is_new = steps != self.evaluated_at and self.has_new_weights
        return statistics.has_episodes(EVALUATION_EPISODES) and is_new and fits

    def evaluate(self) -> list[Episode]:
        """Play the episodes of an evaluation of the present networks, which are kept if they are among the
        best."""
        active = self._active
        scenario = active.curriculum.scenario_of(active.curriculum.index)
        stage = active.curriculum.name
        episodes = active.evaluator.evaluate(active.learner, scenario, active.interruption, stage)
        summary = Summary.of_episodes(episodes)
        self.evaluated_at = active.statistics.steps
        self.has_new_weights = False
        lowest, highest = self.returns or (math.inf, -math.inf)
        self.returns = min(lowest, summary.least_return), max(highest, summary.greatest_return)
        self.newest = Candidate.of(self.evaluated_at, summary)
        is_best = self.shortlist.add(self.newest, active.learner.save)
        about = {"steps": self.evaluated_at, "stage": stage, "is_best": is_best}
        self._append("training.jsonl", about, episodes)
        self.count += 1
        return episodes

    def put_first(self, confirmed: Summary) -> None:
        """Make the evaluated model the best one, with the result of its confirmation."""
        candidate = Candidate.of(self.evaluated_at, confirmed)
        self.shortlist.put_first(candidate, self._active.learner.save)

    def possible_returns(self) -> Interval:
        """Return the lowest and the highest possible return; if they are unknown, those of all episodes of
        the stage so far."""
        low, high = possible_returns(self._active.run.program)
        intervals = [
            interval for interval in (self.returns, self._active.statistics.returns) if interval is not None
        ]
        return (
            low if math.isfinite(low) else min(lowest for lowest, _ in intervals),
            high if math.isfinite(high) else max(highest for _, highest in intervals),
        )

    def choose_best(self, load: Callable[[Path], Learner], report: Callable[[], None]) -> None:
        """Play new starts with the models of the best evaluations after the training, and keep the best one.

        Args:
            load: Makes a policy from the file of a model.
            report: Called once `activity` is set.
        """
        active = self._active
        count = len(self.shortlist.candidates)
        played = 0
        if count < 2:
            return
        scenario = active.curriculum.scenario_of(active.curriculum.index)
        stage = active.curriculum.name

        def play(model: Path, numbers: range) -> list[Episode]:
            nonlocal played
            self.activity = Activity(
                f"choosing the best of {count} models on new starts",
                f"{played} of at most {most_episodes(count)} episodes",
            )
            report()
            played += len(numbers)
            # The evaluations of the training have had the starts before.
            first = EVALUATION_EPISODES
            new = range(first + numbers.start, first + numbers.stop)
            seeds = evaluation_seeds(active.run.record.seed, new)
            episodes = active.evaluator.play(
                load(model), scenario, active.interruption, seeds, stage, without_shards=True
            )
            self._append("choice.jsonl", {"model": model.stem, "first_start": numbers.start}, episodes)
            return episodes

        self.chosen_steps = self.shortlist.choose(play, COST_SHARE * active.statistics.steps)
        self.activity = None
        best = self.shortlist.best
        if best is not None and self.chosen_steps:
            score = best.text(self.shortlist.measure, defines_success=active.defines_success)
            active.reporter.note(
                f"of the {count} best models, that of {best.steps:,} steps is the best on new starts"
                f" ({score})"
            )

    def _append(self, name: str, about: Mapping[str, Any], episodes: Sequence[Episode]) -> None:
        """Append a line for episodes to a file of `evaluations`."""
        line = {
            **about,
            "returns": [episode.total_return for episode in episodes],
            "lengths": [episode.length for episode in episodes],
            "successes": [episode.is_success for episode in episodes],
            "ended_by": [episode.ended_by for episode in episodes],
        }
        if members := self._active.run.program.members:
            line[AGENTS_COLUMN] = agents_line(members, episodes)
        with (self._active.run.evaluations / name).open("a", encoding="utf-8") as file:
            file.write(json.dumps(line) + "\n")
