"""Learning of agents whose episodes end while those of others go on."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import deepbots_cli
from deepbots_cli import api
from deepbots_cli.errors import UsageError
from deepbots_cli.learning.evaluation import evaluate
from deepbots_cli.learning.sb3.internals import samples_chosen
from deepbots_cli.rollout.batch_worlds import BatchWorlds
from deepbots_cli.rollout.collector import Decision, LocalCollector
from deepbots_cli.rollout.seats import SeatCollector
from deepbots_cli.rollout.worlds import SingleWorlds, Worlds
from deepbots_cli.runtime.agents import SeatLayout
from tests.agents.test_endings_alone import ALONE
from tests.learning.interruption import At, outcome

PPO = (
    "train: {algorithm: PPO, total_timesteps: 1024, n_steps: 64, n_epochs: 1,"
    " batch_size: 32, network: {hidden: [8]}}\n"
)
LEARNING = ALONE + PPO
NAMES = ["left", "right"]


@pytest.fixture
def carts(tmp_path: Path) -> Path:
    file = tmp_path / "carts.yaml"
    file.write_text(LEARNING)
    return file


def _worlds(file: Path, kind: str, count: int) -> Worlds:
    program = api.compile(file, overrides=["world.engine=mujoco"]).program
    terms = {name: [*member.terms.values()] for name, member in program.members.items()}
    options: dict[str, Any] = {"agent_terms": terms, "agents_alone": NAMES}
    if kind == "batch":
        return BatchWorlds(
            lambda stage: api.build_batch(program, count, engine="mujoco"), range(count), **options
        )
    return SingleWorlds([api.build(program) for _ in range(count)], range(count), **options)


def _ahead(observations: np.ndarray, starts: np.ndarray, masks: None) -> Decision:
    return Decision(np.tile(np.float32([1.0, 0.2]), (len(starts), 1)))


def test_the_episodes_of_an_agent_end_where_it_ends(carts: Path) -> None:
    fragments = {}
    for kind in ("single", "batch"):
        with closing(_worlds(carts, kind, 3)) as worlds:
            collector = LocalCollector(worlds)
            fragments[kind] = collector.collect(_ahead, 90)
            program = worlds.worlds[0].get_wrapper_attr("scenario")
    of_all = fragments["single"]
    assert of_all is not None
    assert fragments["batch"] is not None
    for name in NAMES:
        assert of_all.agent_phases[name].tolist() == fragments["batch"].agent_phases[name].tolist()
    seat = SeatCollector(SeatLayout(program.members["left"], program.agent), collector)
    seat.offer(of_all)
    own = seat.fetch(None, 90)  # type: ignore[arg-type]  # it has acted already
    assert own.taking_part is not None
    assert 0 < own.taking_part.sum() < own.taking_part.size
    assert not own.rewards[~own.taking_part].any()
    ended = of_all.agent_phases["left"] == 1
    assert own.starts[1:][ended[:-1]].all()
    assert (own.starts[1:] == (of_all.starts[1:] | ended[:-1])).all()
    for number, ending in own.endings:
        part = own.taking_part[: number + 1, ending.row]
        begun = np.flatnonzero(of_all.starts[: number + 1, ending.row])[-1]
        assert ending.episode.length == part[begun:].sum()
        assert ending.episode.ended_by == "left_fell"
        assert not ending.timed_out
        assert ending.episode.total_return == pytest.approx(
            own.rewards[begun : number + 1, ending.row].sum(), rel=1e-4
        )


@pytest.mark.slow
def test_a_learner_bootstraps_no_value_after_the_end_and_leaves_out_what_follows(
    carts: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from deepbots_cli.learning.sb3.learner import OnPolicyLearner

    seen = []
    usual = OnPolicyLearner.update

    def update(learner: OnPolicyLearner) -> None:
        buffer, part = learner.model.rollout_buffer, learner._participation
        assert part is not None
        ends = part[:-1] & ~part[1:]
        seen.append((ends.sum(), part.sum(), part.size))
        assert buffer.returns[:-1][ends] == pytest.approx(buffer.rewards[:-1][ends], rel=1e-5)
        drawn = []
        draw = buffer._get_samples
        monkeypatch.setattr(buffer, "_get_samples", lambda rows: drawn.append(rows) or draw(rows))
        usual(learner)
        monkeypatch.delattr(buffer, "_get_samples")
        # The first sample is drawn to flatten the arrays, and is not learned from.
        assert set(np.concatenate(drawn[1:]).tolist()) == set(np.flatnonzero(part.T).tolist())

    monkeypatch.setattr(OnPolicyLearner, "update", update)
    deepbots_cli.train(carts, run=tmp_path / "run", seed=1)
    assert sum(ends for ends, *_ in seen) > 0
    assert sum(size - part for _, part, size in seen) > 0


@pytest.mark.slow
def test_a_training_with_such_ends_resumes_exactly_and_is_evaluated(carts: Path, tmp_path: Path) -> None:
    whole, cut = tmp_path / "whole", tmp_path / "cut"
    deepbots_cli.train(carts, run=whole, seed=2)
    assert deepbots_cli.train(carts, run=cut, seed=2, progress=At(500)).interrupted
    deepbots_cli.resume(cut)
    assert outcome(cut) == outcome(whole)
    result = evaluate(whole, episodes=4, seed=5)
    assert {*result.agents} == {"left", "right"}


@pytest.mark.parametrize("algorithm", ["SAC", "RecurrentPPO"])
def test_an_algorithm_without_support_is_refused_in_one_sentence(
    carts: Path, tmp_path: Path, algorithm: str
) -> None:
    carts.write_text(ALONE + f"train: {{algorithm: {algorithm}, total_timesteps: 256}}\n")
    with pytest.raises(UsageError, match=f"`left_fell` ends the episode of `left` alone, which {algorithm}"):
        deepbots_cli.train(carts, run=tmp_path / "run", seed=1)


def test_mirror_images_are_left_out_too() -> None:
    from gymnasium.spaces import Box
    from stable_baselines3.common.buffers import RolloutBuffer

    buffer = RolloutBuffer(3, Box(-1, 1, (1,)), Box(-1, 1, (1,)), n_envs=2)
    buffer.rewards[...] = np.arange(6).reshape(3, 2)
    buffer.values[...] = buffer.rewards
    buffer.full = True
    chosen = np.array([[True, False], [True, True], [False, True]])
    with samples_chosen(buffer, chosen):
        batches = [batch.old_values.tolist() for batch in buffer.get(3)]
    assert sorted(value for batch in batches for value in batch) == [0.0, 2.0, 3.0, 5.0]
    assert [len(batch) for batch in batches] == [3, 1]
