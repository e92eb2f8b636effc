"""Laws of trainings: each number of a run is that of its recorded steps, an interrupted training is an
uninterrupted one, and what is exported acts as the run does."""

from __future__ import annotations

import copy
import csv
import io
import json
import math
from contextlib import chdir, closing, redirect_stderr, redirect_stdout
from dataclasses import replace
from itertools import islice
from pathlib import Path
from statistics import fmean
from typing import Any, NamedTuple

import numpy as np
from hypothesis import reject
from hypothesis import strategies as st
from stable_baselines3 import PPO

from deepbots_cli import api
from deepbots_cli.cli import main
from deepbots_cli.errors import EvaluationError, UsageError
from deepbots_cli.insight.export.devices import recorded_steps
from deepbots_cli.insight.export.parity import Comparison
from deepbots_cli.learning import load_policy, resume, train
from deepbots_cli.program import Program
from deepbots_cli.rollout import Start
from deepbots_cli.rollout.policies import PolicyDriver
from deepbots_cli.rollout.recordings import Recording, actions
from deepbots_cli.runtime import Supervisor
from deepbots_cli.runtime.spaces import FORWARD_BATCH_SIZE
from tests.bundle.untrained import untrained_bundle
from tests.laws.expressions import chance, pick
from tests.laws.law import Case, law, reference, same
from tests.laws.scenarios import ALONE, PLAIN
from tests.learning.interruption import At, outcome

SMALL = replace(PLAIN, bodies=PLAIN.bodies[:3])
WINDOW = 100
"""The number of recent episodes in the means of a training without `solved`."""


class Played(NamedTuple):
    """A finished episode: what its steps add up to."""

    total: float
    length: int
    is_success: bool
    ended_by: str


class Worlds:
    """Makes worlds, and adds up the steps of each episode that one of them finishes."""

    def __init__(self) -> None:
        self.worlds: list[list[Played]] = []

    @property
    def finished(self) -> list[Played]:
        """The episodes of all worlds."""
        return [episode for world in self.worlds for episode in world]

    def __call__(self, program: Program, *, render_mode: str | None = None) -> Supervisor:
        world = api.build(program, render_mode=render_mode)
        rewards: list[float] = []
        finished: list[Played] = []
        self.worlds.append(finished)
        reset, step = world.reset, world.step

        def begin(**options: Any) -> Any:
            rewards.clear()
            return reset(**options)

        def go_on(action: Any) -> Any:
            observation, reward, terminated, truncated, info = step(action)
            rewards.append(float(reward))
            if terminated or truncated:
                total = sum(rewards)
                finished.append(Played(total, len(rewards), bool(info["is_success"]), info["ended_by"]))
            return observation, reward, terminated, truncated, info

        world.reset, world.step = begin, go_on  # type: ignore[method-assign]
        return world


def with_training(case: Case) -> api.Compiled:
    """Compile the scenario with a small training."""
    case.compile()  # rejects a scenario with errors
    data = copy.deepcopy(case.drawn.data)
    data["truncation"] = {"max_steps": min(data["truncation"]["max_steps"], 12)}
    data["train"] = {
        "algorithm": "PPO",
        "total_timesteps": case.draw(st.integers(3, 8)) * 32,
        "environments": pick(case.draw, (1, 2, 3)),
        "n_steps": 16,
        "batch_size": 16,
        "n_epochs": 1,
        "network": {"hidden": [4]},
    }
    other = {"set": {"reward.extra": pick(case.draw, ("-1000", "1000"))}, "episodes": 1}
    data["evaluation"] = {"episodes": pick(case.draw, (2, 3)), "cases": {"other": other}}
    data["agent"] = {"action_repeat": case.draw(st.integers(1, 3))}
    if chance(case.draw, 60):
        count = pick(case.draw, (2, 3, 5))
        limit = pick(case.draw, (0, -100, 1, 1000))
        data["solved"] = f"mean_return >= {limit} over {count} episodes"
    return case.compile(case.write(data, "drawn.yaml"))


def printed(*words: str) -> Any:
    """Return what a command prints as JSON."""
    with redirect_stdout(io.StringIO()) as text:
        code = main([*words, "--json"])
    assert code in (0, 1), (words, code, text.getvalue())
    return json.loads(text.getvalue())


def record(path: str, *options: str) -> None:
    """Record an episode of the scenario.

    Raises:
        EvaluationError: It cannot be played.
    """
    with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()) as problem:
        if main(["render", "scenario.yaml", "--driver", "random", *options, "-o", path]):
            raise EvaluationError(problem.getvalue())


def rows_of(run: Path) -> list[Played]:
    """Return the episodes of a log, which are numbered from 1."""
    rows = list(csv.DictReader((run / "monitor.csv").read_text(encoding="utf-8").splitlines()[1:]))
    assert [int(row["episode"]) for row in rows] == [*range(1, len(rows) + 1)]
    return [Played(float(row["r"]), int(row["l"]), row["is_success"] == "1", row["ended_by"]) for row in rows]


def rounded(episode: Played) -> Played:
    return episode._replace(total=round(episode.total, 6))


def scalars_of(run: Path) -> dict[str, dict[int, float]]:
    """Return the last value of each scalar at each step."""
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    events = EventAccumulator(str(run / "tensorboard"), size_guidance={"scalars": 0})
    events.Reload()
    return {
        tag: {event.step: event.value for event in events.Scalars(tag)} for tag in events.Tags()["scalars"]
    }


def close(actual: float, expected: float, place: object = "") -> None:
    """Require equal numbers, but for the last digits of a sum in another order."""
    assert abs(actual - expected) <= 1e-9 * max(1.0, abs(expected)), (place, actual, expected)


OF_TRAININGS = (
    "no start was found",
    "is not stable",
    "infinite or NaN",
    "no value for",
    "is not finite",
)


@law(cost=1000, profile=SMALL)
def a_run_has_the_numbers_of_its_episodes(case: Case) -> None:
    """The log, the record, TensorBoard and `runs` have the numbers of the same steps."""
    compiled = with_training(case)
    worlds = Worlds()
    with chdir(case.folder):
        with reference(*OF_TRAININGS):
            result = train(compiled, run="run", seed=3, build=worlds)
        require_agreement(compiled.program, worlds, Path("run"))
        assert record_of(Path("run"))["steps"] == result.steps


def require_agreement(program: Program, worlds: Worlds, run: Path) -> None:
    """Require all numbers of a run to be those of the episodes of its worlds."""
    training = program.agent.training
    assert training is not None
    rows = rows_of(run)
    # The first world is only looked at.
    own = worlds.worlds[1 : training.environments + 1]
    assert sorted(rows) == sorted(rounded(episode) for world in own for episode in world)
    entries = evaluations_of(run)
    evaluated = sorted(
        Played(*numbers, "")
        for entry in entries
        for numbers in zip(entry["returns"], entry["lengths"], entry["successes"], strict=True)
    )
    others = [
        episode._replace(ended_by="")
        for world in worlds.worlds[training.environments + 1 :]
        for episode in world
    ]
    for episode in evaluated:
        assert any(is_close(episode, other) for other in others), episode
    recent = newest(own, program.agent.solved.episodes if program.agent.solved else WINDOW)
    record = record_of(run)
    assert record["episodes"] == len(rows)
    hours = record["steps"] * program.world.timestep * program.action_repeat / 3600
    close(record["simulated_hours"], hours, "simulated time")
    if recent:
        close(record["mean_return"], fmean(episode.total for episode in recent), "record")
        if program.defines_success:
            close(record["success_rate"], fmean(episode.is_success for episode in recent), "record")
    listed = printed("runs", ".")[0]
    assert (listed["steps"], listed["episodes"]) == (record["steps"], len(rows))
    assert listed["solved"] is None or listed["score"] == "evaluation", listed
    if listed["score"] == "training" and recent:
        close(listed["mean_return"], record["mean_return"], "runs")
    if listed["score"] == "evaluation":
        kept = (json.loads(path.read_text(encoding="utf-8")) for path in (run / "evaluations").glob("*.json"))
        means = [*(fmean(entry["returns"]) for entry in entries), *(one["mean_return"] for one in kept)]
        assert any(abs(mean - listed["mean_return"]) < 1e-6 * max(1.0, abs(mean)) for mean in means), listed
    if listed["score"] == "evaluation" and len(entries) and listed["evaluated_episodes"]:
        best = [entry for entry in entries if entry["steps"] == listed["best_steps"]]
        assert best, (listed, entries)
    scalars = scalars_of(run)
    for steps, shares in ended_shares(scalars).items():
        assert abs(sum(shares) - 1.0) < 1e-5, ("ended_by", steps, shares)
    for tag, key in (("eval/mean_return", "returns"), ("eval/mean_length", "lengths")):
        for entry in entries:
            value = scalars.get(tag, {}).get(entry["steps"])
            if value is not None and math.isfinite(value):
                assert abs(value - fmean(entry[key])) < 1e-5 * max(1.0, abs(value)), (tag, entry, value)


def newest(worlds: list[list[Played]], count: int) -> list[Played]:
    """Return the newest episodes of each world, equally many, which are at least `count` if there are so
    many."""
    of_each = min(math.ceil(count / len(worlds)), *map(len, worlds))
    return [episode for world in worlds for episode in world[len(world) - of_each :]]


def is_close(one: Played, other: Played) -> bool:
    return one[1:] == other[1:] and abs(one.total - other.total) <= 1e-9 * max(1.0, abs(one.total))


def evaluations_of(run: Path) -> list[dict[str, Any]]:
    path = run / "evaluations" / "training.jsonl"
    text = path.read_text(encoding="utf-8") if path.exists() else ""
    return [json.loads(line) for line in text.splitlines()]


def record_of(run: Path) -> dict[str, Any]:
    result: dict[str, Any] = json.loads((run / "run.json").read_text(encoding="utf-8"))["result"]
    return result


def ended_shares(scalars: dict[str, dict[int, float]]) -> dict[int, list[float]]:
    """Return the shares of all endings at each step."""
    shares: dict[int, list[float]] = {}
    for tag, values in scalars.items():
        if tag.startswith("ended_by/"):
            for step, value in values.items():
                shares.setdefault(step, []).append(value)
    return shares


@law(cost=2400, profile=SMALL)
def an_evaluation_has_the_numbers_of_its_episodes(case: Case) -> None:
    """`eval` and `compare` play the episodes of their seed with the policy, and print what these add up
    to."""
    compiled = with_training(case)
    with chdir(case.folder):
        with reference(*OF_TRAININGS):
            train(compiled, run="run", seed=3)
            train(compiled, run="other", seed=4)
            seed = pick(case.draw, (0, 5))
            expected = {name: episodes_of(compiled, name, seed) for name in ("run", "other")}
        results = [printed("eval", "run", "--episodes", "3", "--seed", str(seed))]
        require_verdict(compiled.program, results[0], printed("runs", "."))
        require_case(compiled.program, printed("eval", "run", "--case", "other", "--seed", str(seed)), seed)
        compared = printed("compare", "run", "other", "--episodes", "3", "--seed", str(seed))
        names = ["run"]
        for group in compared["groups"]:
            results += group["runs"]
            names.append(group["name"])
        assert sorted(names) == ["other", "run", "run"], names
        for name, result in zip(names, results, strict=True):
            episodes = expected[name]
            outcomes = [
                Played(one["total_return"], one["length"], one["is_success"], one["ended_by"])
                for one in result["outcomes"]
            ]
            assert all(map(is_close, outcomes, episodes)), (name, outcomes, episodes)
            close(result["mean_return"], fmean(episode.total for episode in episodes), name)
            close(result["mean_length"], fmean(episode.length for episode in episodes), name)
            if compiled.program.defines_success:
                assert result["successes"] == sum(episode.is_success for episode in episodes), name
            close(sum(result["term_means"].values()), result["mean_return"], name)


def require_verdict(program: Program, result: Any, runs: Any) -> None:
    """Require a criterion to be met by no fewer episodes than it says, and by their mean; whether they are
    enough to be sure of it is another question. The list has the same answer."""
    criterion = program.agent.solved
    returns = [one["total_return"] for one in result["outcomes"]]
    if criterion is None or len(returns) < criterion.episodes:
        assert result["solved"] is None, result["verdict"]
    elif fmean(returns) < criterion.mean_return:
        assert result["solved"] is False, result["verdict"]
    listed = next(run for run in runs if run["name"] == "run")
    is_confirmed = listed["stopped_as_solved"]  # the list then has the confirmation
    assert listed["solved"] == (is_confirmed or result["solved"]), listed
    assert is_confirmed or listed["evaluated_episodes"] == len(returns), listed


def require_case(program: Program, result: Any, seed: int) -> None:
    """Require an evaluation in a case to have its own number of episodes, its rewards and its bounds."""
    case = program.cases[0]
    episodes = episodes_of(case.program, "run", seed, case.episodes)
    returns = [one["total_return"] for one in result["outcomes"]]
    assert len(returns) == len(episodes) == result["episodes"], result
    low, high = result["return_bounds"]
    for total, episode in zip(returns, episodes, strict=True):
        close(total, episode.total, "case")
        slack = 1e-6 * max(1.0, abs(total))
        assert low is None or low - slack <= total, result
        assert high is None or total <= high + slack, result


def episodes_of(source: Any, run: str, seed: int, count: int = 3) -> list[Played]:
    """Play episodes of an evaluation with the policy of a run, step by step.

    Episode k has row k of a forward pass. A row alone has other roundings of float32: of three returns of
    about 14, the largest difference was 9e-8.
    """
    policy = load_policy(run)
    episodes = []
    with closing(api.make(source)) as world:
        for number in range(count):
            observation, _ = world.reset(seed=Start.of_evaluation(seed, number).seed)
            rewards: list[float] = []
            while True:
                rows = np.zeros((FORWARD_BATCH_SIZE, *observation.shape), observation.dtype)
                rows[number] = observation
                observation, reward, terminated, truncated, info = world.step(policy(rows)[number])
                rewards.append(float(reward))
                if terminated or truncated:
                    break
            episodes.append(Played(sum(rewards), len(rewards), info["is_success"], info["ended_by"]))
    return episodes


@law(cost=350, profile=replace(ALONE, agents=1, bodies=SMALL.bodies))
def a_recording_is_its_episode(case: Case) -> None:
    """A recording has the scenario, the seed and the actions of an episode, so the same steps have the same
    rewards and the same end, also in a case or a stage."""
    program = case.compile().program
    variants: list[tuple[str | None, str | None]] = [(None, None)]
    variants += [(one.name, None) for one in program.cases]
    variants += [(None, one.name) for one in program.curriculum]
    name, stage = pick(case.draw, variants)
    options = [*(("--case", name) if name else ()), *(("--stage", stage) if stage else ())]
    with chdir(case.folder):
        with closing(api.build(program.variant(name, stage))) as world, reference(*OF_TRAININGS):
            record("one.mcap", "--episodes", "2", *options)
            recording = Recording.read(Path("one.mcap"))
            listed = printed("replay", "one.mcap")["episodes"]
            for recorded, shown in zip(recording.episodes, listed, strict=True):
                world.reset(seed=recorded.seed)
                rewards = []
                for action in actions(recording, recorded, world.action_space):
                    _, reward, terminated, truncated, _ = world.step(action)
                    rewards.append(float(reward))
                assert terminated or truncated
                assert (shown["steps"], shown["ended_by"]) == (len(rewards), world.ended_by), shown
                close(shown["return"], sum(rewards), "replay")
        assert printed("replay", "--verify", "one.mcap")["same"]


@law(cost=2000, profile=SMALL)
def an_interrupted_training_is_an_uninterrupted_one(case: Case) -> None:
    """A checkpoint has the whole state of a training, so one that is stopped and resumed, even twice, becomes
    to the bit what it would have become. Meanwhile, the list shows what its episodes add up to."""
    compiled = with_training(case)
    training = compiled.program.agent.training
    assert training is not None
    with chdir(case.folder):
        with reference(*OF_TRAININGS):
            train(compiled, run="whole/run", seed=3)
        stops = sorted({case.draw(st.integers(1, training.total_timesteps - 1)) for _ in range(2)})
        worlds = Worlds()
        first = train(compiled, run="parts/run", seed=3, progress=At(stops[0]), build=worlds)
        if first.status == "interrupted":
            with chdir("parts"):
                require_agreement(compiled.program, worlds, Path("run"))
        for stop in stops[1:]:
            if record_of(Path("parts/run"))["status"] == "interrupted":
                resume("parts/run", progress=At(stop))
        if record_of(Path("parts/run"))["status"] == "interrupted":
            resume("parts/run")
        expected, continued = outcome(Path("whole/run")), outcome(Path("parts/run"))
        for state in (expected, continued):
            state["scalars"] = dict(sorted(state["scalars"].items()))
        for part in ("result", "monitor", "scalars", "evaluations", "models"):
            same(continued[part], expected[part], part)


@law(cost=350, profile=SMALL)
def a_bundle_commands_what_the_simulation_applies(case: Case) -> None:
    """The graph of an exported policy has the arithmetic of supervisor, network and robots, so its commands
    are those of the simulation, to 1e-5 of their range: the network computes in float32."""
    compiled = with_training(case)
    try:
        step, learner, bundle = untrained_bundle.__wrapped__(str(compiled.source))
    except UsageError:
        reject()  # what no bundle can have
    comparison = Comparison(bundle)
    with closing(recorded_steps(step, lambda world: PolicyDriver(learner, world))) as recorded:
        with reference(*OF_TRAININGS):
            steps = list(islice(recorded, 30))
        for one in steps:
            comparison.add(one)
    assert comparison.worst <= 1e-5, comparison


@law(cost=900, profile=SMALL)
def a_model_acts_by_itself_as_in_its_run(case: Case) -> None:
    """The model of a run is a model of Stable-Baselines3, whose own `predict` gives the actions of the
    policy."""
    compiled = with_training(case)
    with chdir(case.folder):
        with reference(*OF_TRAININGS):
            train(compiled, run="run", seed=3)
        policy = load_policy("run")
        model = PPO.load("run/models/agent/best.zip", device="cpu")
        with closing(api.make(compiled)) as world, reference(*OF_TRAININGS):
            observation, _ = world.reset(seed=5)
            for _ in range(12):
                expected = policy(observation)
                action, _ = model.predict(observation, deterministic=True)
                difference = np.abs(np.asarray(action, float) - np.asarray(expected, float))
                assert np.all(difference <= 1e-6), (action, expected)
                observation, _, terminated, truncated, _ = world.step(expected)
                if terminated or truncated:
                    break
