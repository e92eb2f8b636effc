"""The causes that the logs of a training have: each case is named after the right diagnosis, which was once
missing, false or in the wrong place.

Why a training fell apart: the setting that explains the fall comes first, and its advice is a value that
the scenario does not have.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

pytest.importorskip("stable_baselines3")

from deepbots_cli import api
from deepbots_cli.cli import main
from deepbots_cli.document import shipped
from deepbots_cli.insight.causes import CAUSES, causes_after, diagnose, verdict
from deepbots_cli.insight.learner import suspects
from deepbots_cli.insight.stages import PRESENT_STAGE
from deepbots_cli.insight.statements import Statement, statements_about
from deepbots_cli.insight.training import TrainingEvidence, read_training, run_probes
from deepbots_cli.learning import train
from deepbots_cli.learning.runs.episodes import SolvedAt
from deepbots_cli.learning.runs.evaluations import EvaluationResult
from deepbots_cli.learning.runs.run import Run
from deepbots_cli.learning.runs.verdict import Decline, RunVerdict
from deepbots_cli.rollout import Episode
from tests.commands import Deepbots
from tests.few import few
from tests.insight.collapses import CASES as COLLAPSES
from tests.insight.collapses import has_fallen, named, trained
from tests.insight.logs import (
    SHUTTLE,
    causes_of,
    evaluations_with,
    outcomes,
    returns_of,
    statement_of,
    train_shuttle,
    with_logs,
)


class Case(NamedTuple):
    """Logs of a training, and what is said of them.

    Attributes:
        run: A fixture with a run, or the changes of the carriage on its rail.
        logs: The arguments of `with_logs`.
        fields: Further fields of the evidence.
        first: The first causes.
        only: All causes; None for any.
        lacks: Causes that are not named.
        order: Causes in their order.
        says: Parts of the text and the advice of causes.
        silent: What they do not say.
        settings: The advised settings.
        evidence: Numbers of the evidence.
        commands: The commands that show more.
    """

    run: str | tuple[str, ...]
    logs: Mapping[str, Any]
    fields: Mapping[str, Any] = {}
    first: Sequence[str] = ()
    only: Sequence[str] | None = None
    lacks: Sequence[str] = ()
    order: Sequence[str] = ()
    says: Mapping[str, Sequence[str]] = {}
    silent: Mapping[str, Sequence[str]] = {}
    settings: Mapping[str, Mapping[str, str]] = {}
    evidence: Mapping[str, Mapping[str, Any]] = {}
    commands: Mapping[str, str] = {}


STAGES = (
    "[{name: wide, set: {near: 6 cm}, until: success_rate >= 80 % over 40 episodes}, {name: exact, set:"
    " {near: 1 mm}}]"
)
STAGED = (f"curriculum={STAGES}",)
CARRIAGE = tuple[str, ...]()
LEVELS = ("curriculum={set: {mark: 0.1 .. 0.4 m}, levels: 4, up: parked, down: truncation}",)
HIT = "termination.failure={hit: abs(shuttle.place) > 0.49 m}"
FAR = (
    "termination={}",
    "reward={far: 10 * delta(shuttle.place) / m}",
    "solved=mean_return >= 60 over 100 episodes",
)
ALIVE = ("termination={}", "reward={alive: 1}")
TEACHER = ("scripts={by_hand: {drive: 4 * gap / m if mark > 0 m else 0}}", "train.teacher=by_hand")
FLAT = np.full(400, 60)
NOISE = np.random.default_rng(0).normal(0, 3, 200)
RISING = 30 + np.arange(200) / 4 + NOISE
NONE = np.zeros(400)


def lasting(success: Any, *means: float, **further: Any) -> dict[str, Any]:
    """Logs of the carriage with these successes, in episodes of 60 steps."""
    success = np.asarray(success, float)
    return {
        "returns": returns_of(success, *(means or (0,))),
        "lengths": np.full(len(success), 60),
        "success": success,
        **further,
    }


def poor(won: int, count: int = 100) -> list[Episode]:
    """Episodes of an evaluation of which so many succeed."""
    return [Episode(0.0, 60, number < won, "max_steps") for number in range(count)]


def evenly(*rates: float) -> dict[str, Any]:
    """1,700 episodes whose successes are spread as evenly as their rate allows."""
    rate = np.interp(np.linspace(0, 1, 1700), np.linspace(0, 1, len(rates)), rates)
    good = np.diff(np.floor(np.cumsum(rate)), prepend=0.0)
    return {"returns": 5 * good, "lengths": np.full(1700, 60), "success": good}


def drawing(values: Mapping[str, np.ndarray], success: np.ndarray, **further: Any) -> dict[str, Any]:
    """Logs of episodes that draw these values."""
    rows = [dict(zip(values, row, strict=True)) for row in zip(*values.values(), strict=True)]
    return lasting(success, drawn=[json.dumps(row) for row in rows], **further)


def _early_failures() -> dict[str, Any]:
    lengths = np.concatenate([np.full(60, 60.0), np.full(340, 20.0)])
    lengths += np.random.default_rng(3).normal(0, 1, 400)
    returns = -0.5 * lengths + np.random.default_rng(4).normal(0, 6, 400)
    ending = np.array(["max_steps"] * 60 + ["hit"] * 340, object)
    return {"returns": returns, "lengths": lengths, "ending": ending}


def _deaths() -> dict[str, Any]:
    """A step costs 2, a hit 5, and a success earns 10."""
    rest = np.random.default_rng(5).integers(8, 20, 360)
    lengths = np.concatenate([np.full(20, 60), np.full(20, 30), rest]).astype(float)
    good = np.repeat([0.0, 1.0, 0.0], [20, 20, 360])
    ending = np.array(["max_steps"] * 20 + ["parked"] * 20 + ["hit"] * 360, object)
    returns = -2 * lengths + 40 * good - 5 * (ending == "hit")
    return {"returns": returns, "lengths": lengths, "success": good, "ending": ending}


EARLY, DEATHS = _early_failures(), _deaths()
EFFORT = {
    "reward__effort": [-28.0] + [-9.0] * 19,
    "reward__closer": [1.0] * 20,
    "reward__time": [-1.2] + [-0.4] * 19,
}
LEVELED = 100 - 70 * np.exp(-np.arange(200) / 40) + NOISE
LOCAL = 100 - 70 * np.exp(-np.arange(200) / 20) + NOISE
GROWN = 39.2 - 30 * np.exp(-np.arange(400) / 20) + np.random.default_rng(2).normal(0, 0.02, 400)
UNEVEN = np.where(np.arange(400) % 8 == 0, 45.0, 60.0)
CEILING = {"lengths": FLAT, "ending": "max_steps", "train__std": [0.5] + [0.01] * 19}
SOLVING = {"returns": [200.0] * 20, "successes": [False] * 20}
ONCE = np.eye(1, 2706, 1200)[0]
PLACES, OTHERS = np.random.default_rng(1).uniform(-1, 1, (2, 400))
NEARER = ((PLACES > -0.5) & (np.random.default_rng(6).random(400) < 0.8)).astype(float)
STARTS = np.random.default_rng(5).uniform(-1, 1, 400)
HALF, THIRD = outcomes(400, 0.5, 0.5), outcomes(400, 0.3, 0.3)
SECOND_STAGE = {
    "stages": np.repeat(["wide", "exact"], [200, 400]).astype(object),
    "success": np.concatenate([outcomes(200, 0.5, 0.9), outcomes(400, 0.5, 0.5)]),
}
HARD_STAGE = np.concatenate([outcomes(200, 0.5, 0.9), NONE])
EASY = outcomes(400, 0.7, 0.95)
WIDE = {"stages": "wide"}
HIDDEN = {
    **lasting(outcomes(400, 0.0, 0.05)),
    **WIDE,
    "evaluations": evaluations_with(*[1.0] * 20, stage="wide"),
}
NEEDED = outcomes(400, 0.2, 0.9, 1.0, 1.0)
TAUGHT = outcomes(400, 0.3, 0.51, 0.51)
PUPIL = lasting(TAUGHT, evaluations=evaluations_with(0.5, 0.5, 0.5))
OTHER_ACTION = "observation.previous_action=auto"
TD3 = "train={algorithm: TD3, total_timesteps: 24000, action_noise: {type: normal, sigma: %s}}"

CASES: dict[str, Case] = {
    "failing early pays": Case(
        "short", {"returns": -30 + NOISE, "lengths": 30 - NOISE}, first=["ending_early_pays"]
    ),
    "episodes end at once": Case("short", {"returns": np.full(50, 3.0)}, first=["ending_at_once"]),
    "the training is too short": Case(
        "short",
        {"returns": RISING},
        first=["too_few_steps"],
        says={"too_few_steps": ["10,984 steps in 200 episodes; the scenario sets 100,000"]},
    ),
    "a return that has leveled off does not still rise": Case(
        "short", {"returns": LEVELED}, silent={"too_few_steps": ["still learns"]}
    ),
    "after 1 % of the planned steps, later episodes may end in other ways": Case(
        "short",
        {"returns": 30 + NOISE},
        only=["too_few_steps"],
        says={"too_few_steps": ["The training is short"]},
    ),
    "the exploration has collapsed": Case(
        "short",
        {"returns": 30 + NOISE, "train__entropy_loss": [-0.6] * 4 + [-0.001] * 10},
        says={"exploration_collapsed": ["the entropy of the policy"]},
    ),
    "a rise that is far from its goal is not advised to go on": Case(
        "short",
        {"returns": 30 + np.arange(200) / 400 + NOISE / 30},
        only=["too_few_steps"],
        says={
            "too_few_steps": [
                "The policy learns too slowly: ",
                "At this rate, 195 is about 2,200,000 steps away",
                "Change something before you train longer: ",
            ]
        },
        settings={"too_few_steps": {}},
    ),
    "the term that pays a local optimum": Case(
        CARRIAGE,
        {"returns": LOCAL, "lengths": np.full(200, 100), "reward__closer": LOCAL},
        first=["success_never_seen"],
        says={"success_never_seen": ["'closer' gives 100% of the positive reward of late", "path_distance"]},
        silent={"success_never_seen": ["a reward term for progress"]},
        evidence={"success_never_seen": {"term": "closer", "term_share": 1.0}},
    ),
    "a training without a success is not first advised to continue": Case(
        "aiming",
        {"returns": RISING, "lengths": np.full(200, 100), "reward__alive": RISING},
        first=["success_never_seen"],
        lacks=["too_few_steps"],
    ),
    "a policy that succeeds in a later evaluation is not advised to continue": Case(
        "aiming",
        {
            "returns": 30 + np.arange(200) / 4,
            "lengths": np.full(200, 100),
            "evaluations": [{"returns": [100.0] * 30, "successes": [True] * 29 + [False]}],
        },
        first=["exploration_hides_success"],
        says={"exploration_hides_success": ["in 97% (83% to 99%) of 30 episodes"]},
    ),
    "an evaluation that solves the task": Case(
        "aiming",
        {
            "returns": 30 + np.arange(200) / 4,
            "lengths": np.full(200, 100),
            "evaluations": [{"returns": [300.0] * 30, "successes": [True] * 29 + [False]}],
        },
        only=[],
    ),
    "the logs of a collapsed exploration, and an evaluation that solves the task": Case(
        "short",
        {
            "returns": np.full(200, 200.0),
            "ending": "max_steps",
            "train__entropy_loss": [-0.001] * 20,
            "evaluations": [SOLVING],
        },
        only=[],
    ),
    "evaluations of an easy stage do not count as solved": Case(
        STAGED,
        lasting(EASY, 1, **WIDE, evaluations=evaluations_with(*[0.95] * 20, stage="wide")),
        first=["easy_stage_counted"],
        says={"easy_stage_counted": ["stage 'wide' (1 of 2)", "`until: success_rate >= 80 % in evaluation`"]},
    ),
    "an easy stage beside the evaluation of the scenario itself": Case(
        STAGED,
        lasting(EASY, 1, **WIDE, evaluations=evaluations_with(*[0.95] * 20, stage="wide")),
        {"final_episodes": [Episode(1.0, 60, number < 6, "max_steps") for number in range(100)]},
        says={"easy_stage_counted": ["in the scenario itself in 6% (3% to 12%) of 100 episodes"]},
    ),
    "returns of different stages are not compared": Case(
        STAGED,
        {
            **SECOND_STAGE,
            "returns": returns_of(SECOND_STAGE["success"], 0) + np.repeat([0.0, 10.0], [200, 400]),
            "lengths": np.full(600, 60),
        },
        first=["success_plateau"],
        lacks=["too_few_steps", "reward_apart_from_success"],
    ),
    "a step to a stage that is too hard, with the settings that change": Case(
        STAGED,
        lasting(HARD_STAGE, 0, 1, stages=SECOND_STAGE["stages"]),
        first=["stage_too_hard"],
        says={"stage_too_hard": ["near: 6 cm -> 1 mm"]},
    ),
    "a stage that never ends, with the value that it reaches": Case(
        STAGED,
        lasting(outcomes(400, 0.2, 0.5, 0.5, 0.5), **WIDE),
        first=["stuck_in_stage"],
        says={"stuck_in_stage": ["the stage ends at 80%", "`until: success_rate >= 4"]},
    ),
    "a stage that never ends, with a return that it reaches": Case(
        (f"curriculum={STAGES.replace('success_rate >= 80 %', 'mean_return >= 4')}",),
        lasting(outcomes(400, 0.2, 0.5, 0.5, 0.5), **WIDE, returns=np.full(400, 3.4574)),
        first=["stuck_in_stage"],
        says={"stuck_in_stage": ["`until: mean_return >= 3.111 over"]},
    ),
    "a stage in which the success rises": Case(
        STAGED, lasting(outcomes(400, 0, 0.1, 0.2, 0.75), **WIDE), lacks=["stuck_in_stage"]
    ),
    "a success rate that is flat is a plateau whatever the return does": Case(
        CARRIAGE,
        lasting(outcomes(400, 0, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5), 0, 4),
        first=["success_plateau"],
        lacks=["too_few_steps"],
    ),
    "a success rate that rises": Case(
        CARRIAGE, lasting(outcomes(400, 0, 0.2, 0.4, 0.7), 0, 4), only=["too_few_steps"]
    ),
    **{
        f"success rates {rates}": Case(CARRIAGE, evenly(*rates), says={cause: [text]}, lacks=lacks)
        for rates, cause, text, lacks in (
            (
                (0.01, 0.06),
                "too_few_steps",
                "The policy still learns: the success rate rises from 3.1% ",
                ["success_plateau"],
            ),
            (
                (0.05, 0.12),
                "too_few_steps",
                "The policy still learns: the success rate rises from ",
                ["success_plateau"],
            ),
            ((0.5, 0.58), "success_plateau", "The success rate may still rise: it was 53% ", []),
            ((0.3, 0.3), "success_plateau", "The success rate no longer rises: it was 30% ", []),
            (
                (0.0, 0.6, 0.6, 0.6, 0.6),
                "success_plateau",
                "The success rate no longer rises: it was 60% ",
                [],
            ),
            ((0.0, 0.6, 0.5, 0.4), "success_plateau", "The success rate falls: it was 56% ", []),
        )
    },
    "the starts that fail, with the value that they draw": Case(
        CARRIAGE,
        drawing({"other": OTHERS, "reset.place.bar.y": PLACES}, NEARER),
        first=["some_starts_fail"],
        says={"some_starts_fail": ["(0% to "]},
        evidence={"some_starts_fail": {"drawn": "reset.place.bar.y"}},
    ),
    "starts that fail though the evaluations succeed in four of five": Case(
        CARRIAGE,
        drawing({"place": STARTS}, (STARTS > -0.5).astype(float), evaluations=evaluations_with(*[0.8] * 20)),
        only=["some_starts_fail"],
    ),
    "one success among thousands is as good as none": Case(
        CARRIAGE,
        lasting(ONCE),
        first=["success_never_seen"],
        says={
            "success_never_seen": [
                "Only 1 of 2,706 episodes is a success",
                "'closer', which leads towards success",
            ]
        },
        silent={"success_never_seen": ["Add a reward term for progress"]},
    ),
    "a reward without what the success measures": Case(
        ("reward={time: -0.02, parked: 5 when parked}",),
        lasting(ONCE),
        first=["success_never_seen"],
        says={"success_never_seen": ["and no reward term depends on `abs(gap)`; their returns"]},
        settings={"success_never_seen": {"reward.towards_parked": "-10 * delta(abs(gap)) / m"}},
        evidence={"success_never_seen": {"likelihood": 0.94}},
    ),
    "success has just begun": Case(
        CARRIAGE,
        lasting(np.concatenate([np.zeros(380), np.tile([0.0, 1.0], 10)]), 0, 2),
        lacks=["success_never_seen"],
    ),
    "advice on exploration names only options that the algorithm has": Case(
        STAGED,
        HIDDEN,
        first=["exploration_hides_success"],
        says={"exploration_hides_success": ["with `in evaluation` in its `until`"]},
        silent={"exploration_hides_success": ["ent_coef", "action_noise"]},
    ),
    "a weight of the entropy is lowered": Case(
        (*STAGED, "train.ent_coef=0.05"),
        HIDDEN,
        first=["exploration_hides_success"],
        says={"exploration_hides_success": ["lower `train.ent_coef` from 0.05 to 0.005"]},
        settings={"exploration_hides_success": {"train.ent_coef": "0.005"}},
    ),
    "action noise of zero is raised to a number above zero": Case(
        (TD3 % 0,),
        {"returns": returns_of(NONE, 0)},
        says={"exploration_collapsed": ["aise `train.action_noise.sigma` from 0 to 0.3"]},
        settings={"exploration_collapsed": {"train.action_noise.sigma": "0.3"}},
    ),
    "noise that is large already is raised and not lowered": Case(
        (TD3 % 0.5,),
        {"returns": returns_of(NONE, 0), "lengths": FLAT, "train__std": [0.01] * 20},
        settings={"exploration_collapsed": {"train.action_noise.sigma": "1"}},
    ),
    "a learning rate that is far too low": Case(
        ("train.learning_rate=1e-5",),
        lasting(NONE, train__approx_kl=[1e-7] * 20),
        first=["learning_rate_too_low"],
        says={"learning_rate_too_low": ["300 times lower than the usual 0.003"]},
        settings={"learning_rate_too_low": {"train.learning_rate": "0.003"}},
    ),
    "a low learning rate that changes the policy": Case(
        ("train.learning_rate=1e-5",),
        lasting(NONE, train__approx_kl=[0.01] * 20),
        lacks=["learning_rate_too_low"],
    ),
    "a low learning rate with a rising return": Case(
        ("train.learning_rate=1e-5",),
        lasting(NONE, 0, 9, train__approx_kl=[1e-7] * 20),
        lacks=["learning_rate_too_low"],
    ),
    "rewards that the critic cannot follow": Case(
        "short",
        {"returns": 30_000 + 1000 * NOISE, "lengths": 30 + NOISE, "train__explained_variance": [0.02] * 20},
        settings={"rewards_too_large": {"train.normalize": "reward"}},
    ),
    "large rewards that the critic follows": Case(
        "short",
        {"returns": 30_000 + 1000 * NOISE, "lengths": 30 + NOISE, "train__explained_variance": [0.9] * 20},
        lacks=["rewards_too_large"],
    ),
    "small rewards": Case(
        "short",
        {"returns": 30 + NOISE, "lengths": 30 + NOISE, "train__explained_variance": [0.02] * 20},
        lacks=["rewards_too_large"],
    ),
    "a discount factor that hides the success": Case(  # at most 60 steps: 0.95^60 is 5 %
        ("train.gamma=0.4",),
        lasting(NONE),
        first=["horizon_too_short"],
        settings={"horizon_too_short": {"train.gamma": "0.95"}},
    ),
    "a usual discount factor": Case(("train.gamma=0.95",), lasting(NONE), lacks=["horizon_too_short"]),
    "a low discount factor with a late reward": Case(
        ("train.gamma=0.85",), lasting(HALF), says={"horizon_too_short": ["0.85"]}
    ),
    "a low discount factor where no reward comes late": Case(
        ("train.gamma=0.85", "reward={near: exp(-abs(gap) / m)}"), lasting(HALF), lacks=["horizon_too_short"]
    ),
    "worlds that stay at the lowest level": Case(
        LEVELS,
        lasting(NONE, ending="max_steps", curriculum__mean_level=[1.0, 0.5, 0.2, 0.0, 0.0, 0.0, 0.0, 0.0]),
        says={"levels_stay_lowest": ["in level 0 of 0 to 3", "0% ended by `parked`"]},
    ),
    "worlds that do not": Case(
        LEVELS,
        lasting(NONE, ending="max_steps", curriculum__mean_level=[0.2] * 8),
        lacks=["levels_stay_lowest"],
    ),
    "a success that needs exploration": Case(
        CARRIAGE,
        lasting(NEEDED, evaluations=evaluations_with(*[0.3] * 20)),
        {"final_episodes": poor(29)},
        first=["success_needs_exploration"],
        says={"success_needs_exploration": ["--timesteps 50_000`. The noise", "`previous_action: auto`"]},
        settings={"success_needs_exploration": {"train.total_timesteps": "50_000"}},
    ),
    "previous_action is not advised to a scenario that has it": Case(
        (OTHER_ACTION,),
        lasting(NEEDED, evaluations=evaluations_with(*[0.3] * 20)),
        {"final_episodes": poor(29)},
        silent={"success_needs_exploration": ["`previous_action"]},
    ),
    "evaluations that succeed without exploration": Case(
        CARRIAGE,
        lasting(NEEDED, evaluations=evaluations_with(*[0.9] * 20)),
        {"final_episodes": poor(29)},
        lacks=["success_needs_exploration"],
    ),
    "a success that earns less than its absence": Case(
        CARRIAGE,
        {**lasting(THIRD), "returns": returns_of(THIRD, 5) - 12 * THIRD},
        first=["reward_apart_from_success"],
        says={"reward_apart_from_success": ["the mean return is -1.97 in "]},
    ),
    "a success that falls while the return rises": Case(
        CARRIAGE,
        lasting(outcomes(400, 0.6, 0.1, 0.1), 0, 9, reward__closer=np.arange(20.0)),
        first=["reward_apart_from_success"],
        evidence={"reward_apart_from_success": {"term": "closer"}},
    ),
    "a reward that disagrees with the success comes before the noise on the actions": Case(
        CARRIAGE,
        {
            **lasting(outcomes(400, 0.5, 0.7, 0.7), evaluations=evaluations_with(*[0.2] * 20)),
            "returns": returns_of(outcomes(400, 0.5, 0.7, 0.7), 5) - 12 * outcomes(400, 0.5, 0.7, 0.7),
        },
        order=["reward_apart_from_success", "success_needs_exploration"],
    ),
    "dying early, with the success rate from which going on pays": Case(
        (HIT, "reward.time=-2"),
        DEATHS,
        first=["ending_early_pays"],
        says={"ending_early_pays": ["continuing pays only if at least 8"]},
        evidence={
            "ending_early_pays": {
                "break_even": pytest.approx((-5 - 2 * DEATHS["lengths"][40:].mean() + 120) / 100, abs=1e-6)
            }
        },
    ),
    "the terms that make an early failure pay": Case(
        (HIT, "reward.effort=-0.5 * drive^2"),
        {**EARLY, **EFFORT},
        first=["ending_early_pays"],
        says={
            "ending_early_pays": [
                "'hit' ends 100% of them after 20 steps on average; the first episodes of the training lasted"
                " 60",
                "'effort' went from -28 to -9 per episode and 'time' went from -1.2 to -0.4",
            ]
        },
    ),
    "an early failure on a way that pays": Case(
        (HIT, "reward.effort=-0.5 * drive^2"),
        {**EARLY, **EFFORT, "returns": -EARLY["returns"], "reward__effort": [-9.0] * 20}
        | {"reward__closer": [-9.0] + [9.0] * 19},
        lacks=["ending_early_pays"],
    ),
    "a return that every episode reaches has no advice to explore more": Case(
        FAR,
        {"returns": GROWN, **CEILING},
        first=["return_at_ceiling"],
        says={"return_at_ceiling": ["it no longer grows, and", "`solved` asks for 60", "mean_return >= 38"]},
        lacks=["exploration_collapsed"],
    ),
    "an episode returned more": Case(
        FAR,
        {"returns": np.where(np.arange(400) == 9, 50.0, GROWN), **CEILING},
        says={"exploration_collapsed": ["the standard deviation"]},
        lacks=["return_at_ceiling"],
    ),
    "a return near its bound is not the same in all episodes": Case(
        ALIVE,
        {"returns": UNEVEN, "lengths": FLAT, "ending": "max_steps"},
        says={"return_at_ceiling": ["58.2 on average in 100 late episodes of the training (from 45 to 60)"]},
    ),
    "a return near its bound that rises": Case(
        ALIVE,
        {"returns": np.linspace(50, 60, 400), "lengths": FLAT, "ending": "max_steps"},
        lacks=["return_at_ceiling"],
    ),
    "a return near its bound of which more is asked": Case(
        (*ALIVE, "solved=mean_return >= 59 over 100 episodes"),
        {"returns": UNEVEN, "lengths": FLAT, "ending": "max_steps"},
        lacks=["return_at_ceiling"],
    ),
    "a teacher that fails itself": Case(
        TEACHER,
        {**PUPIL, "teacher__success_rate": [0.55]},
        says={"teacher_fails": ["'by_hand' succeeds in 55% (34% to 74%) of 20 episodes"]},
        commands={"teacher_fails": f"deepbots try {SHUTTLE} --driver by_hand --episodes 20"},
    ),
    "a teacher that succeeds": Case(
        TEACHER, {**PUPIL, "teacher__success_rate": [1.0]}, lacks=["teacher_fails"]
    ),
    "a teacher that meets a low bar": Case(
        (*TEACHER, "solved=success_rate >= 60 % over 20 episodes"),
        {**PUPIL, "teacher__success_rate": [0.55]},
        lacks=["teacher_fails"],
    ),
    "a pupil that is worse than a poor teacher": Case(
        TEACHER,
        {**PUPIL, "teacher__success_rate": [0.55]},
        {"final_episodes": poor(10)},
        lacks=["teacher_fails"],
    ),
    "a finding of lint that the training refutes is not a likely cause": Case(
        ("reward.stay=1",),
        {
            "returns": 117 + 266 * (np.arange(200) % 2) + NOISE,
            "lengths": np.full(200, 30),
            "success": np.arange(200) % 2,
        },
        says={"lint_warns": ["Lint warns about "]},
        evidence={"lint_warns": {"likelihood": 0.3}},
    ),
    "a finding of lint that the training confirms": Case(
        ("reward.stay=1",),
        {
            "returns": 117 - 66 * (np.arange(200) % 2) + NOISE,
            "lengths": np.full(200, 30),
            "success": np.arange(200) % 2,
        },
        says={"lint_warns": ["Avoiding the success pays more than the success: "]},
        evidence={"lint_warns": {"likelihood": 0.91}},
    ),
}
SLOW = (
    "action noise of zero is raised to a number above zero",
    "noise that is large already is raised and not lowered",
)


@pytest.fixture(scope="module")
def run_of(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Callable[[Any], Path]:
    """Return the run of a case; not to be changed."""

    @cache
    def run(name: str | tuple[str, ...]) -> Path:
        if isinstance(name, str):
            return Path(request.getfixturevalue(name))
        return train_shuttle(tmp_path_factory.mktemp("runs"), *name)

    return run


@pytest.fixture(scope="session")
def aiming(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A training of all its timesteps in a task with a success; not to be changed."""
    sets = [
        "termination.success={there: x > 0.3 m}",
        "reward.there=300 when there",
        "train.total_timesteps=512",
    ]
    return train(
        api.compile(api.load("cartpole", overrides=sets)),
        total_timesteps=512,
        seed=2,
        run=tmp_path_factory.mktemp("runs") / "aiming",
    ).run


@pytest.mark.parametrize("name", few(CASES, [name for name in CASES if name not in SLOW]))
def test_the_logs_of_a_training_have_these_causes(name: str, run_of: Callable[[Any], Path]) -> None:
    case = CASES[name]
    training = replace(with_logs(run_of(case.run), **case.logs), **case.fields)
    statements = {statement.cause: statement for statement in diagnose(training)}
    causes = list(statements)
    assert causes[: len(case.first)] == [*case.first]
    assert case.only is None or causes == [*case.only]
    assert not {*case.lacks} & {*causes}
    assert [cause for cause in causes if cause in case.order] == [*case.order]
    for cause, parts in case.says.items():
        text = f"{statements[cause].text} {statements[cause].advice}"
        assert [part for part in parts if part not in text] == [], text
    for cause, parts in case.silent.items():
        text = f"{statements[cause].text} {statements[cause].advice}" if cause in statements else ""
        assert [part for part in parts if part in text] == []
    for cause, settings in case.settings.items():
        assert statements[cause].settings == settings
    for cause, numbers in case.evidence.items():
        assert {key: statements[cause].evidence[key] for key in numbers} == numbers
    for cause, command in case.commands.items():
        assert statements[cause].command == command


def test_a_verdict_names_each_cause_in_a_few_words() -> None:
    assert [cause.name for cause in CAUSES if not 0 < len(cause.title.split()) <= 14] == []


def test_the_verdict_names_the_first_of_the_listed_causes(carriage: Path) -> None:
    titles = {
        "changed_since_solved": "values changed since runs/a, which was solved",
        "too_few_steps": "short",
    }
    causes = [Statement(cause, "", "", {}, title=title) for cause, title in titles.items()]
    training = with_logs(carriage, **lasting(np.zeros(400)))
    assert verdict(training, causes) == titles["changed_since_solved"]


def test_a_diagnosis_writes_the_value_of_the_line_that_lint_names(run_of: Callable[[Any], Path]) -> None:
    case = CASES["a finding of lint that the training confirms"]
    lower = statement_of(with_logs(run_of(case.run), **case.logs), "lint_warns")
    ((path, value),) = lower.settings.items()
    assert path == "reward.stay"
    assert f"to `{value}` or less" in lower.advice
    assert lower.command.endswith(f"--set reward.stay={value}")


def test_a_stage_is_told_with_the_value_of_its_criterion(run_of: Callable[[Any], Path]) -> None:
    case = CASES["evaluations of an easy stage do not count as solved"]
    training = with_logs(run_of(case.run), **case.logs)
    assert not training.solved
    text = statements_about((PRESENT_STAGE,), training)[0].text
    assert "is in stage 'wide' (1 of 2), which began at step 0 of 24,000" in text
    # Of the same starts, so without an interval.
    assert "succeeds in 95% of the episodes in 2 evaluations" in text
    case = CASES["returns of different stages are not compared"]
    second = with_logs(run_of(case.run), **case.logs)
    assert (second.first_step, second.stage_steps) == (12_000, 24_000)


def test_a_training_that_stopped_by_luck_is_continued_to_its_planned_steps(carriage: Path) -> None:
    """Its episodes and an evaluation met `solved`, but 100 further episodes did not. Such a training needs a
    cause."""
    training = with_logs(carriage, **lasting(np.ones(400)))
    record = training.run.record
    met = SolvedAt(
        episode=200, steps=12_000, simulated_hours=1.0, cpu_seconds=1.0, mean_return=4.0, success_rate=1.0
    )
    result = record.result.model_copy(update={"solved_at": met, "steps": 24_000})
    training.run.record = record.model_copy(update={"total_timesteps": 48_000, "result": result})
    episodes = [Episode(4.0, 100, number < 87, None) for number in range(100)]
    evaluation = EvaluationResult.of_episodes(
        episodes, model="best", seed=0, success_defined=True, solved=False
    )
    (statement,) = diagnose(replace(training, verdict=RunVerdict(False, evaluation)))
    assert (statement.cause, statement.settings) == ("stopped_early", {"train.total_timesteps": "48_000"})
    assert statement.command == f"deepbots resume {carriage} --timesteps 48_000"
    assert "success rate 87.0% (95 % interval 79.0% .. 92.2%)" in statement.text
    assert diagnose(replace(training, verdict=RunVerdict(True, evaluation))) == []


def test_an_interrupted_training_goes_on_to_its_own_total(carriage: Path) -> None:
    training = with_logs(carriage, **lasting(outcomes(400, 0, 0.2, 0.4, 0.7)))
    changes = {"status": "interrupted", "total_timesteps": training.length()["more"]}
    training.run.record = training.run.record.model_copy(update=changes)
    (statement,) = diagnose(training)
    assert (statement.cause, statement.command) == ("too_few_steps", f"deepbots resume {carriage}")
    assert statement.advice == f"Continue the training with `deepbots resume {carriage}`."


def test_a_confirmation_counts_as_an_evaluation_and_not_as_episodes_of_the_training(tmp_path: Path) -> None:
    """A confirmation does not explore, and it was taken for episodes of the training."""
    run = train_shuttle(tmp_path, "solved=success_rate >= 90 % over 100 episodes")
    training = with_logs(run, returns_of(NONE, 0), FLAT, evaluations=evaluations_with(1.0, 1.0))
    record = training.run.record
    at = SolvedAt(episode=9, steps=9, simulated_hours=1.0, cpu_seconds=1.0, mean_return=4.0, success_rate=1.0)
    changes = {"solved_at": at, "confirmations": 1}
    training.run.record = record.model_copy(update={"result": record.result.model_copy(update=changes)})
    assert training.learned == "evaluated"
    poorly = [Episode(5.0, 60, number >= 7, "parked") for number in range(100)]
    assert training.solved
    assert not replace(training, final_episodes=poorly, verdict=RunVerdict(False, None)).solved


# The reward against the success of a script


@pytest.fixture(scope="module")
def held(tmp_path_factory: pytest.TempPathFactory) -> TrainingEvidence:
    """A training of the shuttle with its short episodes. Being at the mark pays in every step, and the
    success, which ends the episode, asks for staying there."""
    run = train_shuttle(
        tmp_path_factory.mktemp("held"),
        "signals={there: abs(gap) < near}",
        "scripts={by_hand: {drive: 4 * gap / m}}",
        "termination.success={held: duration(there) > 0.5 s}",
        "reward={closer: -10 * delta(abs(gap)) / m, time: -0.02, parked: 10 when there}",
    )
    training = read_training(Run.open(run))
    run_probes(training)
    return training


def test_a_reward_that_cheats_is_named_first_with_the_term_that_pays(held: TrainingEvidence) -> None:
    """Returns of 268 against the 57.6 of the script, with a success rate of 9 %, once had no diagnosis."""
    script = np.mean([trace.returns for trace in held.scripts["by_hand"]])
    curves = {"reward__parked": np.linspace(50, 5 * script, 20), "reward__closer": [2.0] * 20}

    def logged(returns: np.ndarray, success: Any) -> TrainingEvidence:
        logs = with_logs(held.run.path, returns, FLAT, success=success, **curves)
        return replace(logs, scripts=held.scripts, policy=held.policy, random=held.random)

    good = outcomes(400, 0.2, 0.09, 0.09)
    first = diagnose(logged(np.linspace(0, 5 * script, 400), good))[0]
    assert first.cause == "reward_exploited"
    assert (first.evidence["term"], first.evidence["example"]) == ("parked", "the script 'by_hand'")
    assert "the script in 100% (68% to 100%) of 8 episodes" in first.text
    assert "Let 'parked' pay once" in first.advice
    assert "reward_exploited" not in causes_of(logged(np.linspace(0, 0.5 * script, 400), good))
    assert "reward_exploited" not in causes_of(logged(np.full(400, 5 * script), 1.0))


def test_an_exploit_that_only_the_exploration_uses_is_named_although_the_policy_succeeds(
    held: TrainingEvidence,
) -> None:
    """The policy succeeded in all episodes with 295, and those of the training returned 829 without a
    success."""
    curves = {"reward__parked": np.linspace(50, 800, 20), "reward__closer": [2.0] * 20}
    succeeding = [Episode(295.0, 117, True, "found", {"parked": 242.0, "closer": 3.0}) for _ in range(100)]

    def solved(returns: np.ndarray, success: float) -> TrainingEvidence:
        logs = with_logs(held.run.path, returns, FLAT, success=success, **curves)
        return replace(logs, final_episodes=succeeding, verdict=replace(logs.verdict, solved=True))

    exploit = statement_of(solved(np.linspace(0, 829, 400), 0.0), "reward_exploited")
    example = "more than the 295 of the successful episodes of the evaluation, but the policy succeeds in 0%"
    assert example in exploit.text
    assert "'parked' pays most of the difference" in exploit.text
    assert "reward_exploited" not in causes_of(solved(np.full(400, 250.0), 0.5))


# A training that fell apart

MEANS = (20, 60, 200, 200, 195, 200, 60, 40, 30, 50)


def _lines(means: Sequence[float] = MEANS, every: int = 6000) -> list[dict[str, Any]]:
    """Evaluations of 20 episodes whose returns have these means."""
    spread = np.linspace(-3, 3, 20)
    return [
        {
            "steps": every * (number + 1),
            "stage": "",
            "is_best": False,
            "returns": (mean + spread).tolist(),
            "successes": [0.0] * 20,
        }
        for number, mean in enumerate(means)
    ]


def _fallen(
    run: Path, *settings: str, scenario: str = "cartpole", means: Sequence[float] = MEANS, **scalars: Any
) -> TrainingEvidence:
    """A training of another scenario and with other logs, in the folder of a short one."""
    training = read_training(Run.open(run))
    opened = replace(
        training.run,
        record=training.run.record.model_copy(update={"total_timesteps": 60_000}),
        compiled=api.compile(api.load(scenario, overrides=settings)),
    )
    curves = {
        name.replace("__", "/"): (np.linspace(0, 60_000, len(values)), np.asarray(values, float))
        for name, values in scalars.items()
    }
    return replace(training, run=opened, all_evaluations=_lines(means), scalars=curves)


TUNED = {"train__approx_kl": [0.01, 0.2] * 10, "train__entropy_loss": [-0.6, -0.4, -0.5, -0.65]}
LARGE = {"means": [100 * mean for mean in MEANS], "train__explained_variance": [0.1] * 20}
BRIEF = "train={%s, total_timesteps: 60_000, environments: 8}"
# The weight of the teacher falls from 37,900 steps on, the evaluations from 42,000.
WEIGHTS = [1.0] * 12 + [0.5] * 2 + [0.0] * 6
FALLS: dict[str, tuple[list[str], dict[str, Any], str | None, dict[str, str] | None]] = {
    "rate": (
        ["train.learning_rate=2e-2"],
        TUNED,
        "learning_rate",
        {"train.learning_rate": "0.003 -> 0.0003"},
    ),
    "epochs": (["train.n_epochs=100"], TUNED, "n_epochs", {"train.n_epochs": "10"}),
    "entropy": (["train.ent_coef=0.2"], TUNED, "ent_coef", {"train.ent_coef": "0.01"}),
    "clip": (["train.clip_range=0.9"], TUNED, "clip_range", {"train.clip_range": "0.2"}),
    "batch": (["train.batch_size=8"], TUNED, "batch_size", {"train.batch_size": "256"}),
    "norm": (["train.max_grad_norm=50"], TUNED, "max_grad_norm", {"train.max_grad_norm": "0.5"}),
    "gamma": (["train.gamma=0.5"], TUNED, "gamma", {"train.gamma": "0.98"}),
    "large rewards": (["reward.alive=100"], LARGE, "normalize", {"train.normalize": "reward"}),
    "DQN": ([BRIEF % "algorithm: DQN"], {}, None, None),
    "buffer": ([BRIEF % "algorithm: DQN, buffer_size: 500"], {}, "buffer_size", None),
    "target": ([BRIEF % "algorithm: DQN, target_update_interval: 1"], {}, "target_update_interval", None),
    "rate of DQN": ([BRIEF % "algorithm: DQN, learning_rate: 1e-2"], {}, "learning_rate", None),
    "A2C": ([BRIEF % "algorithm: A2C"], {}, None, None),
    "usual settings": ([], {}, None, {"train.learning_rate": "0.005 -> 0.0005"}),
    "after the teacher": (
        [],
        {"teacher__weight": WEIGHTS},
        "learning_rate",
        {"train.learning_rate": "0.001"},
    ),
    "during the teacher": ([], {"teacher__weight": [1.0] * 20}, None, None),
}
"""Settings of CartPole, curves, the setting that is suspected first, and the advised settings."""
QUICK = [name for name in FALLS if name not in ("epochs", "entropy", "clip", "norm")]


@pytest.mark.parametrize("name", few(FALLS, QUICK))
def test_the_setting_that_explains_a_fall_comes_first(short: Path, name: str) -> None:
    settings, curves, path, advised = FALLS[name]
    first = diagnose(_fallen(short, *settings, **curves))[0]
    assert first.cause == "fell_apart"
    assert "the mean return of its evaluations fell from 20" in first.text
    assert " at 36,000 steps" in first.text
    paths = [suspect["path"] for suspect in first.evidence["suspects"]][:1]
    assert paths == ([] if path is None else [f"train.{path}"])
    assert advised is None or first.settings == advised
    assert all(f"`{key}: {value}`" in first.advice for key, value in (advised or {}).items())
    assert ("It fell after the teacher had ended, at 37,894 steps" in first.text) == (
        name == "after the teacher"
    )


def test_normalized_rewards_are_not_too_large(short: Path) -> None:
    normalized = _fallen(short, "reward.alive=100", "train.normalize=reward", **LARGE)
    assert "train.normalize" not in diagnose(normalized)[0].settings


def test_a_success_that_is_given_up_for_more_reward_is_not_a_matter_of_settings(short: Path) -> None:
    """As where a policy learns to stay beside the mark, which pays more than the mark."""
    training = _fallen(
        short, "train.n_epochs=100", scenario="pit_escape", means=(1, 3, 9, 9, 9, 10, 20, 30, 31, 34)
    )
    for number, each in enumerate(training.all_evaluations):
        each["successes"] = [float(2 <= number <= 5)] * 20
    unsolved = training.run.program.with_agent(solved=None)
    opened = replace(training.run, compiled=replace(training.run.compiled, program=unsolved))
    cause = statement_of(replace(training, run=opened), "fell_apart")
    assert cause.settings == {}
    assert "Meanwhile the mean return rose from" in cause.text


@pytest.mark.parametrize("scenario", few(shipped.scenario_names(), ["find_ball", "panda_push", "pit_escape"]))
def test_no_setting_of_a_shipped_scenario_is_suspected(short: Path, scenario: str) -> None:
    training = _fallen(short, scenario=scenario)
    fall = Decline("mean_return", 200.0, 36_000, 40.0, 42_000, 20, 60, "the last quarter", 45_000)
    assert suspects(replace(training, all_evaluations=[]), fall) == []


def test_a_healthy_training_has_not_fallen_apart(short: Path) -> None:
    assert "fell_apart" not in causes_of(_fallen(short, means=(20, 60, 150, 190, 200, 195, 200, 198)))


@pytest.fixture
def fallen(short: Path, tmp_path: Path) -> Path:
    """A run whose evaluations fell, of a training that records nothing else of it."""
    run = Path(shutil.copytree(short, tmp_path / "fallen"))
    (run / "evaluations" / "training.jsonl").write_text("".join(f"{json.dumps(line)}\n" for line in _lines()))
    return run


@pytest.mark.slow
def test_every_command_prints_the_same_sentence(fallen: Path, tmp_path: Path, deepbots: Deepbots) -> None:
    sentence = "the training got worse: the mean return of its evaluations fell from 200 at 36,000 steps to"
    assert f"fallen: {sentence}" in deepbots("runs", fallen.parent).err
    (listed,) = json.loads(deepbots("runs", fallen.parent, "--json").out)
    assert listed["decline"]["text"].startswith(sentence)
    assert (listed["decline"]["measure"], listed["decline"]["best_steps"]) == ("mean_return", 36_000)
    assert sentence[1:] in deepbots("diagnose", fallen, "--only-logs").out
    assert main(["eval", str(fallen), "--episodes", "2"]) == 0
    assert main(["report", str(fallen), "-o", str(tmp_path / "page.html")]) == 0
    assert sentence in (tmp_path / "page.html").read_text("utf-8")


def test_a_training_that_fell_apart_after_it_was_solved_has_the_cause_of_its_fall(fallen: Path) -> None:
    assert read_training(Run.open(fallen)).solved  # by an evaluation
    assert causes_after(fallen)[0].cause == "fell_apart"


@pytest.mark.slow
def test_the_planted_setting_is_among_the_first_two(tmp_path: Path) -> None:
    """Ten minutes of CPU time."""
    right = fell = 0
    for case in COLLAPSES:
        run = trained(case, tmp_path / case.name)
        is_named, paths = named(run)
        if case.planted and has_fallen(run):
            assert is_named, case
            fell += 1
            right += bool(set(paths[:2]) & set(case.planted))
        elif not case.planted and not has_fallen(run):
            assert not is_named, case
    assert fell > 0
    assert right >= 0.8 * fell
