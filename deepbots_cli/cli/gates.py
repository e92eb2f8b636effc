"""The requirements on the result of an evaluation: `--min-success`, `--min-return`, `--require-solved`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

from deepbots_cli.analysis import possible_returns
from deepbots_cli.errors import UsageError
from deepbots_cli.learning.runs.episodes import check_common_measure, check_defines_success
from deepbots_cli.learning.runs.evaluations import in_parentheses
from deepbots_cli.learning.runs.statistics import Interval, Verdict, gate_mean, gate_rate
from deepbots_cli.words import beside, counted

if TYPE_CHECKING:
    from deepbots_cli.learning import EvaluationResult, GroupResult
    from deepbots_cli.program import Program
    from deepbots_cli.rollout import Episode
    from deepbots_cli.rollout.policies import StopCondition


class Requirement(NamedTuple):
    """A requirement in words, whether it is met, and the reason."""

    words: str
    met: bool
    reason: str

    def with_words(self, before: str = "", after: str = "") -> Requirement:
        """Return the requirement with further words around its own."""
        return self._replace(words=f"{before}{self.words}{after}")


@dataclass(frozen=True)
class Gates:
    """The requirements of `--min-success`, `--min-return` and `--require-solved`."""

    min_success: float | None
    min_return: float | None
    solved: bool

    def check(self, program: Program) -> None:
        """Check that the scenario has what the requirements need.

        Raises:
            UsageError: The scenario lacks success, or `solved`.
        """
        solved = program.agent.solved
        if self.solved or self.min_success is not None or self.min_return is not None:
            check_common_measure(program, "require something of one: --agent NAME")
        if self.min_success is not None:
            check_defines_success(
                program, "--min-return" if solved is None else "--min-return or --require-solved"
            )
        if self.solved and solved is None:
            alternatives = "--min-success or --min-return" if program.defines_success else "--min-return"
            raise UsageError(
                f"--require-solved: {program.name} has no `solved` criterion; use {alternatives},"
                " or add a criterion such as `solved: mean_return >= 195 over 100 episodes` to the scenario"
            )

    def verdicts(
        self, episodes: Sequence[Episode], planned: int, bounds: Interval
    ) -> Iterator[tuple[str, Verdict]]:
        """Yield each requirement of a number in words, and its answer after these of `planned` episodes;
        `bounds` are those of a return."""
        if self.min_success is not None:
            successes = sum(episode.is_success for episode in episodes)
            yield (
                f"success rate of at least {self.min_success:g}",
                gate_rate(self.min_success, successes, len(episodes), planned),
            )
        if self.min_return is not None:
            returns = [episode.total_return for episode in episodes]
            yield (
                f"mean return of at least {self.min_return:g}",
                gate_mean(self.min_return, returns, planned, bounds),
            )

    def decided(self, episodes: Sequence[Episode], planned: int, bounds: Interval) -> bool:
        """Return whether every requirement is certainly met, or one certainly not."""
        answers = [verdict.met for _, verdict in self.verdicts(episodes, planned, bounds)]
        return bool(answers) and (False in answers or None not in answers)

    def stop_condition(self, program: Program, planned: int) -> StopCondition | None:
        """Return the condition that ends the episodes once every requirement of a number is certain; None if
        all planned episodes are needed."""
        return (
            None if self.solved else partial(self.decided, planned=planned, bounds=possible_returns(program))
        )

    def requirements(self, result: EvaluationResult, planned: int) -> list[Requirement]:
        """Return the answers for a run. A requirement that another one has left undecided is left out."""
        requirements = []
        if self.solved:
            requirements.append(Requirement("the task is solved", bool(result.solved), result.answer))
        answers = self.verdicts(result.outcomes, planned, result.possible_returns)
        requirements += [
            Requirement(words, verdict.met, verdict.reason)
            for words, verdict in answers
            if verdict.met is not None
        ]
        remarks = in_parentheses(result.circumstances)
        return [requirement.with_words(after=remarks) for requirement in requirements]

    def decided_of_group(self, episodes: Sequence[Episode], planned: int) -> bool:
        """Return whether the remaining planned episodes of all runs cannot change the answer to
        `--min-success`.

        Other requirements need all episodes, because a confidence sequence does not cover other seeds, and
        returns have no limit.
        """
        if self.min_success is None or self.min_return is not None or self.solved:
            return False
        successes = sum(episode.is_success for episode in episodes)
        least, most = successes / planned, (successes + planned - len(episodes)) / planned
        return least >= self.min_success or most < self.min_success

    def requirements_of_group(self, group: GroupResult, planned: int) -> list[Requirement]:
        """Return the answers for the means over the seeds of a group."""
        left = planned - sum(result.episodes for result in group.evaluations)
        over = f"over {counted(len(group.evaluations), 'seed')}"
        over += f"; the remaining {left} episodes cannot change the result" if left > 0 else ""
        requirements = []
        if self.solved:
            unsolved = [result.run.name for result in group.evaluations if not result.solved]
            reason = f"not solved by {', '.join(unsolved)}" if unsolved else "solved by every seed"
            requirements.append(Requirement("the task is solved", not unsolved, reason))
        for name, required, mean in (
            ("success rate", self.min_success, group.success_rate),
            ("mean return", self.min_return, group.mean_return),
        ):
            if required is not None:
                measured, bar = beside(mean, required)
                words = f"{'' if name.startswith('mean') else 'mean '}{name} {measured} {over}"
                requirements.append(Requirement(f"{name} of at least {bar}", mean >= required, words))
        remarks = in_parentheses(
            words for evaluation in group.evaluations for words in evaluation.circumstances
        )
        return [requirement.with_words(after=remarks) for requirement in requirements]
