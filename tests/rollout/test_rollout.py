"""Episodes as a stream of steps, their source, and fragments of experience for learners.

* Episodes as a stream of steps.
* `Source.open` alone says which scenario is meant, and every command refuses the same in the same sentence.
* Fragments of experience: the same wherever the worlds of a shard go on.
"""

from __future__ import annotations

import ast
import json
import os
import re
import shutil
from collections.abc import Iterator, Sequence
from contextlib import closing
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from stable_baselines3.common.logger import Logger

import deepbots_cli
from deepbots_cli import api
from deepbots_cli.cli import main
from deepbots_cli.document import Permissions
from deepbots_cli.errors import RunError, UsageError
from deepbots_cli.learning import learner
from deepbots_cli.learning.learner import Setup
from deepbots_cli.program.task import Hyperparameter, Training
from deepbots_cli.rollout import Driver, Start, play, result_of, steps
from deepbots_cli.rollout.collector import (
    Actor,
    Decision,
    Fragment,
    Lesson,
    LocalCollector,
    OnStep,
    ShardState,
    join,
)
from deepbots_cli.rollout.drivers import named_driver, random_driver, sequence_driver
from deepbots_cli.rollout.episode import Step, random_state
from deepbots_cli.rollout.source import Source, SourceKind
from deepbots_cli.rollout.worlds import BatchWorlds, SingleWorlds
from deepbots_cli.runtime.batch import EpisodeHistory
from deepbots_cli.scenario import Scenario

PACKAGE = Path(deepbots_cli.__file__).parent
STEPPING = {
    *("rollout/episode.py", "rollout/worlds.py"),
    "insight/speed.py",  # a benchmark
}


def _stepping(path: Path) -> Iterator[int]:
    """Lines that step an environment: calls of `step` with an action, or of `advance`, which a wrapper does
    not pass on."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
            wrapped = ast.unparse(node.func.value) in ("self.env", "super()")
            arguments = len(node.args) + any(keyword.arg == "action" for keyword in node.keywords)
            if (node.func.attr == "step" and arguments == 1 and not wrapped) or node.func.attr == "advance":
                yield node.lineno


@pytest.mark.slow
def test_an_environment_is_stepped_in_few_places() -> None:
    """Each place that steps an environment needs its own rules for the start and end of an episode and for
    the driver."""
    modules = {
        name
        for path in PACKAGE.rglob("*.py")
        if (name := path.relative_to(PACKAGE).as_posix()).partition("/")[0]
        not in ("runtime", "engines", "codegen")
        and any(_stepping(path))
    }
    assert modules == STEPPING


def test_steps_are_those_of_gymnasium() -> None:
    with closing(deepbots_cli.make("cartpole")) as plain, closing(deepbots_cli.make("cartpole")) as driven:
        observation, _ = plain.reset(seed=3)
        returned = 0.0
        for step in steps(driven, random_driver(driven), Start(3)):
            if step.number:
                observation, reward, terminated, truncated, _ = plain.step(plain.action_space.sample())
                returned += float(reward)
                assert (step.reward, step.is_last) == (reward, terminated or truncated)
            assert np.array_equal(step.observation, observation)
        episode = play(driven, random_driver(driven), Start(3))
        assert (episode.length, episode.total_return, episode.seed) == (step.number, returned, 3)


def test_an_episode_may_be_cut_and_begin_from_the_state_of_its_generators() -> None:
    with closing(deepbots_cli.make("cartpole")) as world:
        world.reset(seed=1)
        state = random_state(world)

        def cut() -> Iterator[Step]:
            return islice(steps(world, named_driver(world, "zero"), Start(state=state)), 4)

        episode = result_of(cut())
        assert episode.length == 3
        assert episode.ended_by is None
        assert episode.seed is None
        observations = [[step.observation.tolist() for step in cut()] for _ in range(2)]
        assert observations[0] == observations[1]


def test_a_driver_receives_the_number_of_the_episode_that_begins() -> None:
    begun = []

    class Noting(Driver):
        def begin(self, start: Start) -> None:
            begun.append(start)

    with closing(deepbots_cli.make("cartpole")) as world:
        start = Start.of_evaluation(5, 2)
        play(world, Noting(lambda _: 0), start)
    assert (begun, start.number) == ([start], 2)


def test_repeated_actions_begin_with_the_first_in_each_episode() -> None:
    with closing(deepbots_cli.make("cartpole")) as world:
        driver = named_driver(world, "forward * 3, backward*40")
        for _ in range(2):
            cut = islice(steps(world, driver, Start(0)), 1, 5)
            assert [step.action for step in cut] == [0, 0, 0, 1]


def test_an_episode_that_goes_on_after_the_last_action_is_an_error() -> None:
    with (
        closing(deepbots_cli.make("cartpole")) as world,
        pytest.raises(UsageError, match="did not end with the last of the given actions"),
    ):
        play(world, sequence_driver([0, 1]), Start(0))


SCENARIO = [
    ["train", "?", "--quiet"],
    ["try", "?"],
    ["bench", "?"],
    ["compile", "?"],
    ["compile", "?", "--project", "made"],
    ["lsp", "--schema", "--for", "?"],
]
RUN = [
    ["eval", "?"],
    ["resume", "?"],
    ["diagnose", "?"],
    ["report", "?", "-o", "out.html"],
    ["compare", "?", "?"],
    ["robustness", "?"],
    ["export", "?", "-o", "bundle"],
    ["diagnose", "?", "--episode", "0"],
]
EITHER = [
    ["inspect", "?"],
    ["diff", "?", "cartpole"],
    ["view", "?"],
    ["play", "?"],
]
RENDERED = [["render", "?", "-o", f"one.{suffix}"] for suffix in ("png", "gif", "mcap")]
FOLDER_OR_FILE = [["lint", "?"], ["test", "?"]]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    for name in ("empty", "pictures", "broken", "group/seed-0", "run/models/agent"):
        (tmp_path / name).mkdir(parents=True)
    (tmp_path / "pictures" / "one.png").write_bytes(b"\x89PNG")
    (tmp_path / "noise.bin").write_bytes(b"\0\1\2")
    (tmp_path / "robot.urdf").write_text("<robot/>")
    (tmp_path / "broken" / "run.json").write_text("{")
    (tmp_path / "run" / "run.json").write_text("{")
    (tmp_path / "run" / "models" / "agent" / "best.zip").write_bytes(b"")
    (tmp_path / "group" / "group.json").write_text("{}")
    shutil.copy(Source.open("cartpole").path, tmp_path / "cart.yaml")
    return tmp_path


def refusal_of(words: list[str], name: str, capsys: pytest.CaptureFixture[str]) -> str:
    """The error of a command for a source, which is a sentence in one line."""
    assert main([name if word == "?" else word for word in words]) == 2
    output = capsys.readouterr()
    assert (output.out, output.err.count("\n")) == ("", 1)
    return output.err.removeprefix("error: ").removesuffix("\n")


NOWHERE = "no file, folder or shipped scenario is called '{}'; "
NEAR_CARTPOLE = "did you mean cartpole? (`deepbots scenarios` shows all)"
NOT_A_SOURCE = "{} is not a run, a group or a scenario: it is a folder without run.json or group.json"


@pytest.mark.parametrize(
    ("name", "commands", "sentence"),
    [
        ("cartpool", [*SCENARIO, *RUN, *EITHER, *RENDERED, *FOLDER_OR_FILE], NOWHERE + NEAR_CARTPOLE),
        ("cartpole.yaml", [SCENARIO[0], RUN[0]], NOWHERE + "the shipped scenario is called `cartpole`;"
                                                           " `deepbots new cartpole"),
        ("cart", [*SCENARIO, *RUN, *EITHER, *RENDERED, *FOLDER_OR_FILE], NOWHERE + "did you mean cart.yaml?"),
        ("empty", [*SCENARIO, *RUN, *EITHER, *RENDERED], NOT_A_SOURCE),
        ("pictures", [*SCENARIO, *RUN, *EITHER, *RENDERED], NOT_A_SOURCE),
        ("x" * 300, [*SCENARIO, *RUN, *EITHER, *RENDERED], "{} cannot be read: file name too long"),
        ("robot.urdf", [*SCENARIO, *RUN, *EITHER[1:], FOLDER_OR_FILE[1]], "{0} is a robot file, not a"
                                                                        " scenario; `deepbots inspect {0}`"),
        ("noise.bin", RUN[:7], "{} is a file, and not a run"),
        ("cart.yaml", RUN[:7], "{} is a scenario, and not a run"),
        ("broken", SCENARIO, "{0} is a run, and not a scenario; its scenario is {0}/resolved.yaml;"
                             " `deepbots resume {0}` continues its training"),
        ("broken", [*RUN[:7], *EITHER, *RENDERED], "{}/run.json is damaged: it is not valid JSON"),
        ("group", [*SCENARIO], "{0} is a group of runs, and not a scenario; `deepbots resume {0}` continues it"),
        ("group", [["export", "?", "-o", "bundle"], ["view", "?"]], "{} is a group of runs, and not a "),
        ("run/models/agent/best.zip", [["diagnose", "?"], ["resume", "?"]], "{} is a model of a run, and not"
                                                                            " a run"),
        ("run/models/agent/best.zip", [RUN[0], *RUN[4:], *EITHER, *RENDERED], "run/run.json is damaged: it"
                                                                              " is not valid JSON"),
    ],
)  # fmt: skip
def test_every_command_refuses_a_source_in_the_same_sentence(
    folder: Path, capsys: pytest.CaptureFixture[str], name: str, commands: list[list[str]], sentence: str
) -> None:
    for words in commands:
        assert refusal_of(words, name, capsys).startswith(sentence.format(name)), words


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="root may enter every folder")
def test_a_folder_that_may_not_be_entered_is_refused(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "empty").chmod(0)
    for words in (*SCENARIO, *RUN, *EITHER):
        assert refusal_of(words, "empty", capsys) == "empty cannot be read: permission denied"


def test_a_scenario_in_memory_is_no_run(folder: Path) -> None:
    scenario = Scenario.from_yaml(Source.open("cartpole").path)
    with pytest.raises(RunError, match="<Scenario CartPole> is a scenario, and not a run"):
        Source.open(scenario, Permissions(), SourceKind.RUN)


def test_the_advice_for_a_scenario_without_a_run_is_a_command_that_works(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("cartpole", "cart.yaml"):
        assert f"train it first with `deepbots train {name}`," in refusal_of(["report", "?"], name, capsys)


def test_the_advice_for_a_group_or_a_study_names_a_run_that_exists(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "group" / "seed-3").mkdir()
    (folder / "group" / "seed-3" / "run.json").write_text("{}")
    (folder / "study" / "trial-0" / "seed-1").mkdir(parents=True)
    (folder / "study" / "study.json").write_text("{}")
    (folder / "study" / "trial-0" / "group.json").write_text("{}")
    (folder / "study" / "trial-0" / "seed-1" / "run.json").write_text("{}")
    assert refusal_of(["view", "?"], "group", capsys).endswith("; name one of its runs, such as group/seed-3")
    words = "; name one of its runs, such as study/trial-0/seed-1"
    assert refusal_of(["view", "?"], "study", capsys).endswith(words)
    words = "; name one of its trials, such as study/trial-0"
    assert refusal_of(["eval", "?"], "study", capsys).endswith(words)


def test_within_the_folder_of_the_runs_its_runs_are_listed(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (folder / "runs" / "cartpole-0-1").mkdir(parents=True)
    (folder / "runs" / "cartpole-0-1" / "run.json").write_text("{}")
    monkeypatch.chdir(folder / "runs")
    words = "its runs, the newest first, are cartpole-0-1"
    assert refusal_of(["eval", "?"], "cartpole-0-2", capsys).endswith(words)


def test_a_robot_file_that_is_missing_and_an_empty_name_are_refused_as_such(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert refusal_of(["try", "?"], "no.urdf", capsys).startswith(NOWHERE.format("no.urdf"))
    assert refusal_of(["try", "?"], "", capsys) == "the name is empty; name a scenario or a run"


def test_a_source_says_what_it_is(folder: Path) -> None:
    kinds = {
        "cartpole": SourceKind.SCENARIO,
        "cart.yaml": SourceKind.SCENARIO,
        "run": SourceKind.RUN,
        "group": SourceKind.GROUP,
    }
    kinds |= {"run/models/agent/best.zip": SourceKind.CHECKPOINT}
    (folder / "cartpole").mkdir()  # does not hide the shipped scenario
    assert {name: Source.open(name).kind for name in kinds} == kinds
    checkpoint = Source.open("run/models/agent/best.zip")
    assert (checkpoint.path, checkpoint.model) == (Path("run"), "best")
    (folder / "one.mcap").touch()
    assert Source.open("one.mcap").kind is SourceKind.RECORDING
    assert Source.open(Scenario.from_yaml(Source.open("cartpole").path)).checked().program is not None
    with pytest.raises(RunError, match="run is a run, and not a group of runs"):
        Source.open("run", Permissions(), SourceKind.GROUP)


def test_the_python_api_refuses_as_the_commands_do(folder: Path) -> None:
    for call in (api.load, api.compile, api.make, api.lint, deepbots_cli.train):
        with pytest.raises(UsageError, match=re.escape(NOT_A_SOURCE.format("empty"))):
            call("empty")
    for call in (deepbots_cli.evaluate, deepbots_cli.resume, deepbots_cli.load_policy):
        with pytest.raises(RunError, match=re.escape(NOT_A_SOURCE.format("empty"))):
            call("empty")


def test_one_module_alone_resolves_the_name_of_a_scenario() -> None:
    """The files by which a run, a group and a recording are known are looked for in one module."""
    root = Path(deepbots_cli.__file__).parent
    looks = re.compile(
        r"""RECORD_NAME\)\.(is_file|exists)|(run|group)\.json["']\)\.(is_file|exists)|["']\.mcap["']"""
    )
    assert [
        path.relative_to(root).as_posix()
        for path in root.rglob("*.py")
        if looks.search(path.read_text("utf-8"))
    ] == ["rollout/source.py"]


PROGRAM = api.compile("cartpole").program


def shard(number: int, kind: str, worlds: int = 2) -> LocalCollector:
    """Worlds of CartPole with the seeds 10, 11, ... for shard 0, 20, 21, ... for shard 1."""
    seeds = [10 + 10 * number + index for index in range(worlds)]
    if kind == "batch":
        pytest.importorskip("deepbots_cli.engines.mujoco")
        return LocalCollector(BatchWorlds(lambda stage: api.build_batch(PROGRAM, worlds), seeds))
    return LocalCollector(SingleWorlds([api.build(PROGRAM) for _ in seeds], seeds))


def act(observations: Any, starts: Any, masks: Any) -> Decision:
    """Drives to the side to which the pole leans; `lean` is a further column, as a policy may return it
    beside the action."""
    lean = observations[:, 2] + observations[:, 3]
    return Decision((lean > 0).astype(int), {"lean": lean})


def collected(collector: LocalCollector, steps: int) -> Fragment:
    fragment = collector.collect(act, steps)
    assert fragment is not None
    return fragment


def is_equal(first: Fragment, second: Fragment) -> bool:
    arrays = ("observations", "actions", "rewards", "starts", "following", "following_starts")
    same = all(np.array_equal(getattr(first, name), getattr(second, name)) for name in arrays)
    endings = [
        [(step, ending.row, ending.episode) for step, ending in fragment.endings]
        for fragment in (first, second)
    ]
    return same and np.array_equal(first.columns["lean"], second.columns["lean"]) and endings[0] == endings[1]


@pytest.mark.parametrize("kind", ["single", "batch"])
def test_a_fragment_has_rows_by_step_and_the_episodes_that_ended(kind: str) -> None:
    collector = shard(0, kind)
    with closing(collector.worlds):
        fragment = collected(collector, 80)
        assert fragment.observations.shape == (80, 2, 4)
        assert (fragment.rewards.shape, fragment.columns["lean"].shape) == ((80, 2), (80, 2))
        assert fragment.starts[0].all()
        begun = {(step + 1, ending.row) for step, ending in fragment.endings}
        assert {(step, row) for step, row in np.argwhere(fragment.starts).tolist() if step} == {
            pair for pair in begun if pair[0] < 80
        }
        assert begun
        assert np.array_equal(collected(collector, 1).observations[0], fragment.following)


@pytest.mark.parametrize("kind", ["single", "batch"])
def test_a_shard_goes_on_elsewhere_to_the_bit(kind: str) -> None:
    """From its state, which JSON can hold, in fresh worlds; the first shard meanwhile runs on."""
    original, restored = shard(0, kind), shard(1, kind)
    with closing(original.worlds), closing(restored.worlds):
        collected(original, 70)
        start = [(episode.start, np.array(episode.actions).tolist()) for episode in original.state().episodes]
        kept = json.loads(json.dumps(start))
        state = ShardState(
            [EpisodeHistory(begun, list(np.array(actions))) for begun, actions in kept],
            original.state().observed,
        )
        assert restored.restore(state, [0, 0])
        assert is_equal(collected(original, 60), collected(restored, 60))
        assert not restored.restore(state._replace(observed="of another world"), [3, 4])
        assert [episode.start for episode in restored.state().episodes] == [3, 4]


def test_joined_fragments_are_what_one_shard_with_all_worlds_collects() -> None:
    """The rows of shard 0 come first."""
    shards = [shard(number, "single") for number in (0, 1)]
    whole = LocalCollector(SingleWorlds([api.build(PROGRAM) for _ in range(4)], [10, 11, 20, 21]))
    with closing(whole.worlds), closing(shards[0].worlds), closing(shards[1].worlds):
        assert is_equal(join([collected(each, 50) for each in shards]), collected(whole, 50))


def test_a_fragment_may_be_ended_before_its_last_step() -> None:
    collector = shard(0, "single")
    with closing(collector.worlds):
        steps: list[int] = []
        assert collector.collect(act, 10, lambda step: steps.append(0) or len(steps) < 4) is None
        assert len(steps) == 4


class Shards:
    """Two shards as one collector, asked in the order of their numbers."""

    def __init__(self, *shards: LocalCollector) -> None:
        self.shards = shards
        self.rows = sum(shard.rows for shard in shards)
        self.observation_space, self.action_space = shards[0].observation_space, shards[0].action_space

    def collect(
        self,
        actor: Actor,
        steps: int,
        on_step: OnStep,
        *,
        with_masks: bool = False,
        lesson: Lesson | None = None,
    ) -> Fragment | None:
        fragments = [
            shard.collect(actor, steps, on_step, with_masks=with_masks, lesson=lesson)
            for shard in self.shards
        ]
        return join([fragment for fragment in fragments if fragment is not None])

    def state(self) -> ShardState:
        states = [shard.state() for shard in self.shards]
        return ShardState(
            [episode for state in states for episode in state.episodes],
            " ".join(state.observed for state in states),
        )

    def restore(self, state: ShardState, seeds: Sequence[int]) -> bool:
        raise NotImplementedError


def test_an_on_policy_learner_learns_from_any_collector_and_others_refuse_one() -> None:
    shards = Shards(shard(0, "single"), shard(1, "single"))
    spaces = shards.observation_space, shards.action_space
    with closing(shards.shards[0].worlds), closing(shards.shards[1].worlds):
        settings = tuple(Hyperparameter(name, 32) for name in ("n_steps", "batch_size"))
        ppo = learner.create(
            Setup(Training("PPO", 1000, environments=4, hyperparameters=settings), *spaces, collector=shards)
        )
        ppo.log = Logger(None, [])  # type: ignore[assignment]  # writes nothing
        ppo.begin(1000, Monitor())  # type: ignore[arg-type]  # what a learner calls of it
        ppo.start()
        before = ppo.digest()
        assert ppo.collect()
        assert (ppo.steps, ppo.recent()[1].shape[:2]) == (4 * 32, (32, 4))
        ppo.update()
        assert ppo.digest() != before
        with pytest.raises(UsageError, match="DQN needs its worlds in the training process"):
            learner.create(Setup(Training("DQN", 1000, environments=4), *spaces, collector=shards))


class Monitor:
    """Lets a training go on."""

    defines_success = False

    def on_step(self) -> bool:
        return True

    def on_collected(self) -> None:
        pass
