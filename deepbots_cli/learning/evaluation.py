"""Evaluation: a trained policy on held-out episodes, with intervals and a verdict.

Several worlds run at a time, singly or as a batch, with results that do not depend on how many. A matrix product may round a row
otherwise when it stands in another place or among another number of rows, and a rounding is enough to tip an action. Every forward
pass therefore has the same number of rows, and episode k always sits in row k mod ROWS; what the other rows hold does not touch it.
This, and the same starts for every policy, is what `evaluate_policy` of Stable-Baselines3 cannot do.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.policies import ActorCriticPolicy

from deepbots_cli import api
from deepbots_cli.analysis import possible_returns
from deepbots_cli.api import Compiled, build_batch
from deepbots_cli.compiler.inputs import RESOLVED_NAME
from deepbots_cli.document import Permissions
from deepbots_cli.errors import DeepbotsError, RunError, UsageError
from deepbots_cli.learning import batch, video
from deepbots_cli.learning.environments import VectorEnvironment, World, WorldFactory, default_factory, has_copies
from deepbots_cli.learning.episodes import UNBOUNDED, DrawnBin, Summary, by_drawn_value, statistics_of
from deepbots_cli.learning.failures import FailureRecorder
from deepbots_cli.learning.run import ModelName, Run, in_parentheses, remark_on_episodes
from deepbots_cli.learning.sb3 import algorithms, models
from deepbots_cli.learning.verdict import circumstances, solved_verdict
from deepbots_cli.program import Program, identity
from deepbots_cli.rollout import Driver, Episode, EpisodeAccumulator, Start, Step, play, steps
from deepbots_cli.rollout.drivers import RANDOM, ZERO, named_driver
from deepbots_cli.runtime.batch import BatchSupervisor
from deepbots_cli.runtime.streams import derive_seed
from deepbots_cli.scenario import Scenario

ROWS_PER_PASS = 8
"""A forward pass of a small policy takes about 0.1 ms for any number of rows up to 16; more worlds than 8 gain little."""

MAX_BATCH_WORLDS = 32
"""Worlds of a batch. What a batch does per step over arrays takes as long as 5 single worlds; those that end early rest at the end."""

OnEpisode = Callable[[int, int], None]
"""Is told after each episode how many are done, and of how many."""


StopCondition = Callable[[Sequence[Episode]], bool]
"""Whether the first episodes of an evaluation are enough."""


@dataclass(frozen=True)
class EvaluationResult(Summary):
    """What a policy did in held-out episodes: their summary, the circumstances, and the episodes themselves.

    `engine` is None for worlds that `build` made. `agent` names the agent whose return it is. `model` is `best` or `last`, or the name of
    a baseline: `random`, `zero`, `script NAME`. `case` and `stage` are None for the scenario itself. `elsewhere` names the scenario where
    it is not that of the training, `set` are the assignments of `--set` to it, and `digest` is its digest. `circumstances` puts in words
    what differs from an evaluation of the best model in the scenario of the training. `planned` is the number of episodes that were asked
    for: more than `episodes` where a requirement stopped the evaluation. `solved` is None where the scenario says nothing, or asks for
    more episodes (`required_episodes`) than there were; `verdict` puts it in words. `return_bounds` are the least and the largest
    possible return of an episode where rewards and time limit imply them, at which intervals are cut. `outcomes` are the episodes, in the
    order of their seeds. Where the scenario defines no success (`success_defined`), the success rate is 0 and means nothing.
    """

    run: Path
    scenario: str
    engine: str | None
    case: str | None
    stage: str | None
    elsewhere: str | None
    set: tuple[str, ...]
    digest: str
    agent: str
    model: str
    seed: int
    planned: int
    required_episodes: int | None
    deterministic: bool
    circumstances: tuple[str, ...]
    success_defined: bool
    solved: bool | None
    verdict: str
    video: Path | None
    notes: tuple[str, ...]
    return_bounds: tuple[float | None, float | None]
    outcomes: tuple[Episode, ...] = field(repr=False)

    @property
    def possible_returns(self) -> tuple[float, float]:
        """`return_bounds` with infinities."""
        low, high = self.return_bounds
        return -math.inf if low is None else low, math.inf if high is None else high

    @property
    def remarks(self) -> tuple[str, ...]:
        """`circumstances`, and what is to be said of the number of episodes."""
        return (*self.circumstances, *remark_on_episodes(self.episodes, self.planned, self.required_episodes))

    @property
    def by_drawn_value(self) -> dict[str, tuple[DrawnBin, ...]]:
        """Success and return by each value that the episodes drew, by its place in the scenario, in a few bins of its range."""
        return by_drawn_value(self.outcomes, self.possible_returns)


def evaluate(
    run: Run | str | Path,
    *,
    episodes: int | None = None,
    seed: int | None = None,
    deterministic: bool = True,
    model: ModelName = "best",
    scenario: Compiled | Scenario | str | Path | None = None,
    case: str | None = None,
    stage: str | None = None,
    video_to: str | Path | None = None,
    force: bool = False,
    copies: int | None = None,
    permissions: Permissions = Permissions(),
    engine: str | None = None,
    build: WorldFactory | None = None,
    on_episode: OnEpisode | None = None,
    until: StopCondition | None = None,
) -> EvaluationResult:
    """Evaluate the policy of a run on episodes that it was not trained on.

    Episode k starts from a seed of its own, derived from the stream `evaluation` of `seed`: the result is the same however
    many worlds run at once, and the first ten of a hundred episodes are those of an evaluation of ten. No episode of the
    training starts from such a seed. All cases take the same seeds, so that they differ by their settings alone.

    Args:
        run: The run, or its directory.
        episodes: The number of the scenario by default.
        seed: The root of the stream, from 0; the training's by default.
        deterministic: Whether the policy takes its likeliest action; else it samples, from seeded streams too.
        model: `best` by its evaluations during the training, or `last`.
        scenario: Another scenario to evaluate in, as for `train`; its observation, action and messages must be those of the run.
        case: One of the scenario's cases to evaluate in, by name.
        stage: One of the stages of its curriculum to evaluate in, by name.
        video_to: Where to write the first episode as mp4.
        force: Whether to overwrite a video that exists.
        copies: Single worlds at a time, 1 to 8. By default a batch of worlds if the engine has batches and the scenario fits one, else 8.
        permissions: With `code`, terms in Python run.
        engine: The physics engine; by default that of the training, or of `scenario` if it names another.
        build: Makes a world of the scenario in place of the generated supervisor.
        on_episode: Is told after each episode how many are done, and of how many.
        until: Takes the first k episodes, for k = 1, 2, ..., and returns whether they are enough. The result then holds these only.

    Raises:
        RunError: No run, a damaged one, or one that does not fit `scenario`; says field by field why.
        UsageError: The numbers make no sense, or the video cannot be written.
        MissingExtraError: A video is wanted and imageio is not installed.
    """
    known = run if isinstance(run, Run) else Run.open(run)
    judged = None if scenario is None else api.compile(scenario)
    program, count, root = _evaluation_settings(known, episodes, seed, judged, case, stage)
    video_to = None if video_to is None else Path(video_to)
    if video_to is not None:
        video.check_video_path(video_to, force=force)
    engine = engine or known.engine_for(program)
    make = build or default_factory(engine, permissions=permissions)
    seeds = [derive_seed(root, "evaluation", k) for k in range(count)]
    with algorithms.torch_settings(), ExitStack() as stack:
        done: list[Episode] | None = None
        together = min(count, MAX_BATCH_WORLDS)
        if deterministic and copies is None and not batch.reasons_against_batch(program, together, engine, make):
            many = stack.enter_context(closing(build_batch(program, together, engine=engine)))
            policy = load_model(known, model, many.singles[0])
            done = batch_rollout(policy, many, seeds, on_episode=on_episode, until=until)
        if done is None:
            worlds = []
            for _ in range(min(count, max(1, min(copies or ROWS_PER_PASS, ROWS_PER_PASS)) if deterministic else 1)):
                worlds.append(
                    FailureRecorder(make(program), known if scenario is None else None, program, seeds=seeds, case=case, stage=stage)
                )
                stack.callback(worlds[-1].close)
            policy = load_model(known, model, worlds[0])
            done = rollout(policy, worlds, seeds, deterministic=deterministic, on_episode=on_episode, until=until)
        if video_to is not None:
            world = stack.enter_context(closing(make(program, render_mode="rgb_array")))
            filmed = stack.enter_context(video.recording_video(world, video_to, program.period))
            rollout(policy, [filmed], seeds[:1], deterministic=deterministic)
    where: dict[str, Any] = {"case": case, "stage": stage, "seed": root, "planned": count, "video": video_to}
    return _result(known, judged, program, model, done, engine=None if build else engine, deterministic=deterministic, **where)


def evaluate_baselines(
    run: Run | str | Path,
    *,
    episodes: int | None = None,
    seed: int | None = None,
    scenario: Compiled | Scenario | str | Path | None = None,
    case: str | None = None,
    stage: str | None = None,
    permissions: Permissions = Permissions(),
    engine: str | None = None,
    build: WorldFactory | None = None,
    on_episode: OnEpisode | None = None,
) -> tuple[EvaluationResult, ...]:
    """Evaluate policies without learning on the starts of `evaluate`: random actions, zero actions, and each script of the scenario.

    Arguments and errors are as for `evaluate`. The `model` of a result is `random`, `zero` or `script NAME`. Random actions are sampled
    by the action space, which the seed of each episode seeds.
    """
    known = run if isinstance(run, Run) else Run.open(run)
    judged = None if scenario is None else api.compile(scenario)
    program, count, root = _evaluation_settings(known, episodes, seed, judged, case, stage)
    results = []
    engine = engine or known.engine_for(program)
    with closing((build or default_factory(engine, permissions=permissions))(program)) as world:
        scripts = {f"script {script.name}": script.name for script in program.agent.scripts}
        for name, driver in {RANDOM: RANDOM, ZERO: ZERO, **scripts}.items():
            done = []
            for number in range(count):
                done.append(play(world, named_driver(world, driver), Start.of_evaluation(root, number)))
                if on_episode is not None:
                    on_episode(len(done), count)
            where: dict[str, Any] = {"case": case, "stage": stage, "seed": root, "planned": count, "deterministic": True, "video": None}
            results.append(_result(known, judged, program, name, done, engine=None if build else engine, **where))
    return tuple(results)


def evaluate_cases(
    run: Run | str | Path, *, scenario: Compiled | Scenario | str | Path | None = None, stages: bool = False, **options: Any
) -> tuple[EvaluationResult, ...]:
    """Evaluate in every case of the scenario, in file order, and with `stages` in every stage of its curriculum too.

    `options` are those of `evaluate`, except for `case`, `stage` and `until`.
    """
    known = run if isinstance(run, Run) else Run.open(run)
    judged = None if scenario is None else api.compile(scenario)
    program = known.program if judged is None else judged.program
    cases = [evaluate(known, scenario=judged, case=case.name, **options) for case in program.cases]
    return (*cases, *(evaluate(known, scenario=judged, stage=stage.name, **options) for stage in program.curriculum if stages))


def load_model(run: Run, name: ModelName, world: World) -> BaseAlgorithm:
    """The model of a run, rebuilt from its scenario for the spaces of `world`, with the weights of `models/agent/<name>.zip`.

    Raises:
        RunError: The file is missing, damaged, or fits another policy.
    """
    training = run.program.agent.training
    if training is None:
        raise RunError(f"{run.path} holds a scenario without a 'train' section")
    algorithms.check(training)
    spaces = VectorEnvironment([world], [0])
    model = algorithms.create(training, spaces, seed=0, total_timesteps=1, to_learn=False, mixin=models.FinitePredictions)
    models.load(run.model(name), model)
    model.policy.set_training_mode(False)
    return model


def _require_same_interface(run: Run, program: Program) -> Program:
    differences = identity.differences(run.program, program)
    if differences:
        lines = "\n  ".join(differences)
        raise RunError(f"{run.path} was trained for another observation, action or messages than {program.name} has:\n  {lines}")
    return program


def _evaluation_settings(
    run: Run, episodes: int | None, seed: int | None, judged: Compiled | None, case: str | None, stage: str | None
) -> tuple[Program, int, int]:
    """The program to evaluate in, the number of episodes, and the root seed."""
    program = run.program if judged is None else _require_same_interface(run, judged.program)
    usual = program.evaluation.episodes if case is None else program.case(case).episodes
    program = program.variant(case, stage)
    count, root = usual if episodes is None else episodes, run.record.seed if seed is None else seed
    if count < 1 or root < 0:
        raise UsageError(f"{count} episodes from seed {root} cannot be evaluated; episodes count from 1, seeds from 0")
    return program, count, root


def _result(
    run: Run,
    judged: Compiled | None,
    program: Program,
    model: str,
    done: Sequence[Episode],
    *,
    engine: str | None,
    planned: int,
    case: str | None,
    stage: str | None,
    deterministic: bool,
    **where: Any,
) -> EvaluationResult:
    """What these episodes come to. `judged` is a scenario in the place of that of the run, and `program` its case or stage."""
    low, high = possible_returns(program) if engine else UNBOUNDED  # a world of the caller may pay anything
    found = statistics_of(done, (low, high))
    solved, verdict = solved_verdict(program.agent.solved, found["episodes"], found["mean_return"], found["success_rate"])
    digest = (judged or run).digest
    elsewhere, overrides = (None, ()) if judged is None or digest == run.record.digest else _elsewhere(run, judged, engine)
    differences = circumstances(
        run,
        digest,
        engine=engine,
        model=model,
        deterministic=deterministic,
        elsewhere=elsewhere,
        overrides=overrides,
        case=case,
        stage=stage,
    )
    return EvaluationResult(
        run=run.path,
        scenario=program.name,
        model=model,
        success_defined=program.defines_success,
        solved=solved,
        verdict=verdict + in_parentheses((*differences, *remark_on_episodes(len(done), planned, None))),
        circumstances=differences,
        engine=engine,
        case=case,
        stage=stage,
        elsewhere=elsewhere,
        set=overrides,
        digest=digest,
        agent=program.agent.name,
        planned=planned,
        required_episodes=program.agent.solved.episodes if program.agent.solved else None,
        deterministic=deterministic,
        notes=(*run.notes(), *identity.timing_differences(run.program, program)),
        outcomes=tuple(done),
        return_bounds=(low if low > -math.inf else None, high if high < math.inf else None),
        **where,
        **found,
    )


def _elsewhere(run: Run, judged: Compiled, engine: str | None) -> tuple[str | None, tuple[str, ...]]:
    """The name of a scenario that replaces that of the run, and the assignments of `--set`, without that of another engine."""
    own = judged.source.resolve() == (run.path / RESOLVED_NAME).resolve()
    name = judged.source.name if judged.source.name != RESOLVED_NAME else f"{judged.source.parent.name}/{RESOLVED_NAME}"
    others = tuple(text for text in judged.overrides if text != f"world.engine={engine}")
    return None if own else name, others or (judged.overrides if engine == run.record.engine else ())


# Episodes of a policy


def rollout(
    model: BaseAlgorithm,
    worlds: Sequence[World],
    seeds: Sequence[int],
    *,
    deterministic: bool,
    on_episode: OnEpisode | None = None,
    until: StopCondition | None = None,
) -> list[Episode]:
    """One episode from each seed, in the order of `seeds`; uses up to ROWS of the worlds, a sampling policy or a team only one.

    With `until`, the episodes end with the first one after which it returns True. Episodes count in the order of their seeds, so the result
    is the same for any number of worlds.
    """
    on_episode = on_episode or (lambda done, of: None)
    until = until or (lambda episodes: False)
    episodes: list[Episode] = []
    if has_copies(worlds[0]):
        driver = PolicyDriver(model, worlds[0], deterministic=deterministic)
        for seed in seeds:
            episodes.append(play(worlds[0], driver, Start(seed)))
            on_episode(len(episodes), len(seeds))
            if until(episodes):
                break
        return episodes
    together = min(len(worlds), ROWS_PER_PASS) if deterministic else 1
    forward = ForwardPass(worlds[0].observation_space, _choices(worlds[0]) if algorithms.takes_masks(model) else None)
    finished: dict[int, Episode] = {}
    for first in range(0, min(ROWS_PER_PASS, len(seeds)), together):
        rows = range(first, min(first + together, ROWS_PER_PASS, len(seeds)))
        lanes = [EvaluationLane(world, row, range(row, len(seeds), ROWS_PER_PASS), seeds) for world, row in zip(worlds, rows, strict=False)]
        running = [lane for lane in lanes if lane.begin(forward)]
        while running:
            actions = forward.predict(model, deterministic=deterministic)
            for lane in running:
                episode = lane.step(actions[lane.row], forward)
                if episode is not None:
                    finished[lane.number] = episode
                    on_episode(len(finished), len(seeds))
            while (following := finished.get(len(episodes))) is not None:
                episodes.append(following)
                if until(episodes):
                    return episodes
            running = [lane for lane in running if lane.number not in finished or lane.begin(forward)]
    return episodes


def batch_rollout(
    model: BaseAlgorithm,
    worlds: BatchSupervisor,
    seeds: Sequence[int],
    *,
    on_episode: OnEpisode | None = None,
    until: StopCondition | None = None,
) -> list[Episode] | None:
    """The episodes of `rollout` in a batch of worlds, with the likeliest actions; there are at least as many seeds as worlds.

    World i sits in row i mod ROWS of one of several forward passes, and goes through episodes that sit in the same row of `rollout`.

    Returns:
        The same as `rollout`. None if a world fails: `rollout` then says where, and keeps its episode.
    """
    on_episode = on_episode or (lambda done, of: None)
    until = until or (lambda episodes: False)
    count = worlds.count
    passes = [ForwardPass(worlds.observation_space, None) for _ in range(0, count, ROWS_PER_PASS)]
    waiting = [deque(range(count + (row - count) % ROWS_PER_PASS, len(seeds), ROWS_PER_PASS)) for row in range(ROWS_PER_PASS)]
    numbers, resting = list(range(count)), np.zeros(count, bool)
    sums = batch.BatchEpisodeAccumulator(worlds)
    finished: dict[int, Episode] = {}
    episodes: list[Episode] = []
    answers: list[Any] = [None] * len(passes)
    lost = len(worlds.losses)
    try:
        seen = worlds.reset(seeds[:count])
        drawn = [single.drawn() for single in worlds.singles]
        while not resting.all():
            for place, forward in enumerate(passes):
                those = slice(place * ROWS_PER_PASS, min(count, (place + 1) * ROWS_PER_PASS))
                if answers[place] is None or not resting[those].all():
                    forward.put_all(seen, those)
                    answers[place] = forward.predict(model, deterministic=True)
            outcome = worlds.advance(np.concatenate(answers)[:count], resting if resting.any() else None)
            if len(worlds.losses) > lost:
                return None
            sums.add(outcome.rewards, outcome.terms, ~resting)
            begun = []
            for place, world in enumerate(outcome.done.tolist()):
                number, row = numbers[world], world % ROWS_PER_PASS
                finished[number] = sums.close(world, outcome.infos[place], seeds[number], drawn[world])
                on_episode(len(finished), len(seeds))
                if waiting[row]:
                    numbers[world] = waiting[row].popleft()
                    passes[world // ROWS_PER_PASS].starts[row] = True
                    begun.append(world)
                else:
                    resting[world] = True
            while (following := finished.get(len(episodes))) is not None:
                episodes.append(following)
                if until(episodes):
                    return episodes
            if begun:
                worlds.begin(begun, [seeds[numbers[world]] for world in begun])
                for world in begun:
                    drawn[world] = worlds.singles[world].drawn()
            seen = worlds.observations() if begun else outcome.observations
    except DeepbotsError:
        return None
    return episodes


class PolicyDriver(Driver):
    """The policy of a model.

    In an episode with a number, the actions are to the bit those of the episode of this number in an evaluation. For copies of a robot
    they always are: each forward pass has a row for each copy.

    Args:
        rows: The number of worlds of a batch like `world`, whose episodes go on together.
    """

    def __init__(self, model: BaseAlgorithm, world: World, *, deterministic: bool = True, rows: int = 0) -> None:
        self._model, self._world, self._deterministic = model, world, deterministic
        self._size = rows or (len(world.get_wrapper_attr("agents")) if has_copies(world) else 0)
        self._takes_masks = algorithms.takes_masks(model) and not rows and world.has_wrapper_attr("action_masks")
        self._forward: ForwardPass | None = None
        self._row, self._starts = 0, np.ones(self._size or 1, bool)
        self._memory: Any = None

    def begin(self, start: Start) -> None:
        if start.seed is not None:  # only a policy that samples draws from it
            torch.manual_seed(derive_seed(start.seed, "policy"))
        self._memory, self._starts[:], self._forward = None, True, None
        if start.number is not None and not self._size:
            self._row = start.number % ROWS_PER_PASS
            self._forward = ForwardPass(self._world.observation_space, _choices(self._world) if self._takes_masks else None)

    def act(self, observation: Any) -> Any:
        if self._forward is not None:
            self._forward.put(self._row, observation, self._world)
            return self._forward.predict(self._model, deterministic=self._deterministic)[self._row]
        allowed = self._world.get_wrapper_attr("action_masks")() if self._takes_masks else None
        masks = {} if allowed is None else {"action_masks": allowed.reshape(self._size, -1) if self._size else allowed}
        action, self._memory = self._model.predict(
            observation, state=self._memory, episode_start=self._starts, deterministic=self._deterministic, **masks
        )
        self._starts = np.zeros_like(self._starts)
        return action


class ForwardPass:
    """The observations of one forward pass; rows of worlds that do not run keep what they last held.

    If the policy takes action masks, `masks` holds which of the `choices` of each row are allowed. A recurrent policy
    has a `memory` for each row, which it forgets where `starts` says that an episode begins.
    """

    def __init__(self, space: gym.Space[Any], choices: int | None) -> None:
        self.memory: Any = None
        self.starts = np.ones(ROWS_PER_PASS, dtype=bool)
        self.masks: dict[str, Any] = {} if choices is None else {"action_masks": np.ones((ROWS_PER_PASS, choices), dtype=bool)}
        self.observations: Any = (
            {key: _zeros(part) for key, part in space.spaces.items()} if isinstance(space, gym.spaces.Dict) else _zeros(space)
        )

    def predict(self, model: BaseAlgorithm, *, deterministic: bool) -> Any:
        """An action for each row."""
        actions, self.memory = model.predict(
            self.observations, state=self.memory, episode_start=self.starts, deterministic=deterministic, **self.masks
        )
        self.starts[:] = False
        return actions

    def put_all(self, observations: Any, worlds: slice) -> None:
        """Take the rows of these worlds of a batch, the first as the first row."""
        count = worlds.stop - worlds.start
        if isinstance(self.observations, dict):
            for key, rows in self.observations.items():
                rows[:count] = observations[key][worlds]
        else:
            self.observations[:count] = observations[worlds]

    def put(self, row: int, observation: Any, world: World) -> None:
        for masks in self.masks.values():
            masks[row] = world.get_wrapper_attr("action_masks")()
        if isinstance(self.observations, dict):
            for key, rows in self.observations.items():
                rows[row] = observation[key]
        else:
            self.observations[row] = observation


def _choices(world: World) -> int | None:
    """How many options the agent has, over all parts of its action; None where the world forbids none."""
    if not world.has_wrapper_attr("action_masks"):
        return None
    space: Any = world.action_space
    return int(space.n) if isinstance(space, gym.spaces.Discrete) else int(space.nvec.sum())


def _zeros(space: gym.Space[Any]) -> np.ndarray[Any, np.dtype[Any]]:
    return np.zeros((ROWS_PER_PASS, *(space.shape or ())), dtype=space.dtype)


class EvaluationLane:
    """One world that goes through its episodes `numbers`, in one row of a forward pass."""

    def __init__(self, world: World, row: int, numbers: Iterable[int], seeds: Sequence[int]) -> None:
        self.row = row
        self.number = row
        self._world = world
        self._episode_numbers = iter(numbers)
        self._seeds = seeds
        self._accumulator = EpisodeAccumulator()
        self._action: Any = None
        self._steps: Iterator[Step] = iter(())

    def begin(self, forward: ForwardPass) -> bool:
        """Start the next episode; whether there was one."""
        number = next(self._episode_numbers, None)
        if number is None:
            return False
        self.number = number
        seed = self._seeds[number]
        torch.manual_seed(derive_seed(seed, "policy"))  # only a policy that samples draws from it
        forward.starts[self.row] = True
        self._steps = steps(self._world, Driver(lambda _: self._action), Start(seed))
        first = next(self._steps)
        self._accumulator.begin(seed, first.info)
        forward.put(self.row, first.observation, self._world)
        return True

    def step(self, action: Any, forward: ForwardPass) -> Episode | None:
        """The episode, if this step was its last."""
        self._action = action
        step = next(self._steps)
        self._accumulator.add(step.reward, step.info)
        forward.put(self.row, step.observation, self._world)
        return self._accumulator.close(step.info) if step.is_last else None


def critic_values(model: Any, observations: Sequence[Any]) -> NDArray[np.float64] | None:
    """The critic's value of each observation: V, or Q of the action of the policy, the smaller one of two critics.

    None for a policy without a network of torch, or with a memory.
    """
    policy = model.policy
    if not observations or hasattr(policy, "lstm_actor") or next(policy.parameters(), None) is None:
        return None
    parts = observations[0].keys() if isinstance(observations[0], dict) else None
    stacked = {key: np.stack([each[key] for each in observations]) for key in parts} if parts else np.stack(observations)
    with torch.no_grad():
        seen, _ = policy.obs_to_tensor(stacked)
        if isinstance(policy, ActorCriticPolicy):
            values = policy.predict_values(seen).reshape(len(observations), -1)
        elif hasattr(policy, "q_net"):
            values = policy.q_net(seen).max(dim=1, keepdim=True).values
        else:
            found = policy.critic(seen, policy._predict(seen, deterministic=True))  # the actor of SAC and TQC would sample
            # TQC has an array of quantiles (rows, critics, quantiles), others a tuple of columns.
            values = found.mean(dim=2) if isinstance(found, torch.Tensor) else torch.cat(found, dim=1)
        return np.asarray(values.min(dim=1).values.cpu().numpy(), float)
