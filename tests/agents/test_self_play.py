"""One policy for two equal agents, which plays against itself and against past versions of itself."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import deepbots_cli
from deepbots_cli import api
from deepbots_cli.errors import RunError, UsageError
from deepbots_cli.learning.agents import self_play
from deepbots_cli.learning.agents.self_play import SelfPlayLearner, Sides, SidesCollector
from deepbots_cli.learning.checkpoint_files import latest_checkpoint
from deepbots_cli.learning.evaluation import load_model
from deepbots_cli.learning.runs.run import Run
from deepbots_cli.rollout.collector import Decision, LocalCollector
from deepbots_cli.rollout.worlds import SingleWorlds
from deepbots_cli.runtime.agents import SeatLayout
from tests.agents.test_multi_agent_training import SHARED, write_scenario
from tests.learning.interruption import At, outcome

PLAYED = SHARED.replace(
    "total_timesteps: 768,",
    "total_timesteps: 1536, environments: 4, self_play: {every: 256, pool: 3, newest: 50 %},",
).replace("n_steps: 64", "n_steps: 32")


SCRIPTED = PLAYED.replace("newest: 50 %", "newest: 25 %, scripts: 50 %").replace(
    "5 * left.angle / rad}", "5 * left.angle / rad}, ahead: {drive: 1}"
)


@given(worlds=st.integers(1, 200), newest=st.floats(0, 1), scripts=st.floats(0, 1))
def test_the_policy_plays_one_or_both_sides_of_each_world(worlds: int, newest: float, scripts: float) -> None:
    sides = Sides.divided(worlds, newest, scripts)
    assert set(sides.scripted) <= set(sides.others)
    assert len(sides.scripted) == min(len(sides.others), round(scripts * worlds))
    first, second, past = set(sides.first), set(sides.second), set(sides.others)
    assert first | second == set(range(worlds))
    assert past == first ^ second  # there another policy plays the other side
    assert abs(len(first) - len(second)) <= 1
    assert len(past) == worlds - round(newest * worlds)


def test_the_policy_learns_from_the_sides_that_it_plays(tmp_path: Path) -> None:
    program = api.compile(write_scenario(tmp_path, PLAYED)).program
    generator = np.random.default_rng(0)

    def act(observations: np.ndarray, starts: np.ndarray, masks: None) -> Decision:
        return Decision(generator.uniform(-1, 1, (4, 2)).astype(np.float32))

    terms = {name: [*member.terms.values()] for name, member in program.members.items()}
    seats = [SeatLayout(member, program.agent) for member in program.members.values()]
    sides = Sides.divided(4, 0.5)
    assert (sides.first.tolist(), sides.second.tolist()) == ([0, 1, 2], [0, 1, 3])
    with closing(SingleWorlds([api.build(program) for _ in range(4)], range(4), agent_terms=terms)) as worlds:
        of_all = LocalCollector(worlds)
        fragment = of_all.collect(act, 40)
        collector = SidesCollector(of_all, seats, sides)
        assert fragment is not None
        part = collector.part_of(fragment)
    for row, (world, side, name) in enumerate(
        [(0, 0, "left"), (1, 0, "left"), (2, 0, "left"), (0, 1, "right"), (1, 1, "right"), (3, 1, "right")]
    ):
        seen = seats[side].observation(fragment.observations)
        assert part.observations[:, row].tolist() == seen[:, world].tolist()
        assert part.actions[:, row, 0].tolist() == fragment.actions[:, world, side].tolist()
        assert part.rewards[:, row].tolist() == fragment.agent_rewards[name][:, world].tolist()
        assert part.starts[:, row].tolist() == fragment.starts[:, world].tolist()
    ended = [(number, ending.row) for number, ending in fragment.endings]
    expected = [
        (number, row) for number, world in ended for row in {0: (0, 3), 1: (1, 4), 2: (2,), 3: (5,)}[world]
    ]
    assert [(number, ending.row) for number, ending in part.endings] == sorted(expected)


@pytest.mark.parametrize(
    ("text", "worlds"),
    [
        pytest.param(PLAYED, 4, id="past policies", marks=pytest.mark.slow),
        pytest.param(SCRIPTED, 4, id="scripts too", marks=pytest.mark.slow),
        pytest.param(SCRIPTED, 16, id="scripts in a batch", marks=pytest.mark.slow),
    ],
)
def test_an_interrupted_training_with_self_play_becomes_the_same(
    tmp_path: Path, text: str, worlds: int
) -> None:
    scenario = write_scenario(tmp_path, text.replace("environments: 4", f"environments: {worlds}"))
    deepbots_cli.train(scenario, run=tmp_path / "whole", seed=2)
    assert deepbots_cli.train(scenario, run=tmp_path / "cut", seed=2, progress=At(900)).interrupted
    resumed = deepbots_cli.resume(tmp_path / "cut")
    assert outcome(tmp_path / "cut") == outcome(tmp_path / "whole")
    assert resumed.ratings == Run.open(tmp_path / "whole").record.result.ratings  # type: ignore[union-attr]


@pytest.mark.slow
def test_both_agents_of_a_model_have_the_same_policy(tmp_path: Path) -> None:
    result = deepbots_cli.train(write_scenario(tmp_path, PLAYED), run=tmp_path / "run", seed=2)
    weights = load_model(Run.open(tmp_path / "run"), "best").weights()
    left = {name.partition("/")[2]: array for name, array in weights.items() if name.startswith("left/")}
    assert left
    for name, array in left.items():
        assert np.array_equal(weights[f"right/{name}"], array)
    steps = [rating.steps for rating in result.ratings]
    assert steps == [256, 512, 768, 1024, 1280, 1536, 1536]
    assert result.ratings[0].mean == 25.0  # nobody was in the pool
    assert result.ratings[-1].deviation < 25 / 3


@pytest.mark.slow
def test_past_policies_act_with_the_weights_of_their_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pools: list[list[int]] = []
    act = SelfPlayLearner._let_opponents_act

    def watched(
        learner: SelfPlayLearner, worlds: np.ndarray, seen: np.ndarray, masks: None, actions: np.ndarray
    ) -> None:
        pools.append([past.rating.steps for past in learner.pool])
        for past in learner.pool:
            assert past.policy.digest() == digests.setdefault(past.rating.steps, past.policy.digest())
        act(learner, worlds, seen, masks, actions)

    digests: dict[int, str] = {}
    monkeypatch.setattr(SelfPlayLearner, "_let_opponents_act", watched)
    deepbots_cli.train(write_scenario(tmp_path, PLAYED), run=tmp_path / "run", seed=2)
    assert pools[0] == []
    assert pools[-1] == [768, 1024, 1280]  # a pool of three, the oldest ones gone
    assert len(set(digests.values())) == len(digests) == 5


@pytest.mark.slow
@pytest.mark.parametrize("engine", [pytest.param("pybullet", marks=pytest.mark.slow), "mujoco"])
def test_scripts_of_the_scenario_play_the_other_side(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, engine: str
) -> None:
    seen = []
    collect = SelfPlayLearner.collect

    def watched(learner: SelfPlayLearner) -> bool:
        collected = collect(learner)
        seen.append((learner._last.columns["opponents"], learner._last.actions, learner._sides))
        return collected

    monkeypatch.setattr(SelfPlayLearner, "collect", watched)
    text = SCRIPTED.replace("environments: 4", "environments: 16").replace(
        "arena:", f"engine: {engine}, arena:"
    )
    deepbots_cli.train(write_scenario(tmp_path, text), run=tmp_path / "run", seed=2)
    ahead = 0
    for opponents, actions, sides in seen:
        assert set(np.unique(opponents[:, sides.scripted])) <= {-2, -3}  # lean and ahead
        assert opponents[:, sides.others].max() < 3
        for side, worlds in ((1, sides.others[::2]), (0, sides.others[1::2])):
            is_ahead = opponents[:, worlds] == -3
            ahead += is_ahead.sum()
            assert (actions[:, worlds, side][is_ahead] == 1).all()
    assert ahead > 100


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("newest: 50 %, scripts: 20 %", "newest: 50 %, scripts: 60 %", "`scripts` of `self_play` are shares"),
        ("scripts: {lean: {drive: 5 * left.angle / rad}}", "", "needs agents with `scripts`"),
        (
            "{like: left, robots: [right]}",
            "{like: left, robots: [right], reward: {alive: 1}}",
            "two equal agents",
        ),
        (
            "{like: left, robots: [right]}",
            "{like: left, robots: [right], train: {n_epochs: 2}}",
            "same `train`",
        ),
        ("algorithm: PPO", "algorithm: RecurrentPPO", "use PPO"),
        ("environments: 4,", "environments: 4, shards: 2,", "`shards`"),
    ],
)
def test_self_play_of_unequal_agents_is_refused(tmp_path: Path, old: str, new: str, message: str) -> None:
    text = PLAYED.replace("newest: 50 %", "newest: 50 %, scripts: 20 %") if "scripts" in message else PLAYED
    assert old in text
    with pytest.raises(UsageError, match=message):
        deepbots_cli.train(write_scenario(tmp_path, text.replace(old, new)), run=tmp_path / "run")
    assert not (tmp_path / "run").exists()


@pytest.mark.slow
def test_a_damaged_pool_is_refused(tmp_path: Path) -> None:
    deepbots_cli.train(write_scenario(tmp_path, PLAYED), run=tmp_path / "run", seed=2)
    folder = latest_checkpoint(Run.open(tmp_path / "run"))
    assert folder is not None
    arrays = dict(np.load(folder / "arrays.npz"))
    arrays["opponents"] = arrays["opponents"] + 7
    np.savez(folder / "arrays.npz", **arrays)  # type: ignore[arg-type]
    with pytest.raises(RunError, match="damaged"):
        deepbots_cli.resume(tmp_path / "run", total_timesteps=3_000)


def test_a_rating_follows_the_results_of_games() -> None:
    rater = self_play._Rater()
    winner, loser = rater.new(), rater.new()
    for _ in range(20):
        winner, loser = rater.rated(winner, loser, 1)
    assert winner.mean > 25 > loser.mean
    assert winner.deviation < rater.new().deviation
    drawn, _ = rater.rated(rater.new(), rater.new(), 0)
    assert drawn.mean == 25.0
