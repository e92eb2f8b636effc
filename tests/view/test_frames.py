"""Frames have the values of the engine, and reading them changes nothing."""

from __future__ import annotations

from contextlib import closing
from dataclasses import asdict

import numpy as np
import pytest

import deepbots_cli
from deepbots_cli.analysis.shown_units import ShownUnits
from deepbots_cli.errors import UsageError
from deepbots_cli.program.members import RANDOM, ZERO
from deepbots_cli.rollout.drivers import HAND
from deepbots_cli.view.episodes import Player, Showing
from deepbots_cli.view.frames import FrameReader, action_fields, observation_fields
from deepbots_cli.view.players import open_player
from tests.few import few

SCENARIOS = (
    "cartpole",
    "find_ball_random",
    "quadruped",
    "multi_cartpole",
    "see_ball",
    "panda_push",
    "line_follower",
)
BATCHES = ("cartpole_wireless", "find_and_avoid", "multi_cartpole", "quadruped", "panda_push")


@pytest.mark.slow
@pytest.mark.parametrize("name", few(SCENARIOS, SCENARIOS[1:4]))
def test_an_episode_is_the_same_with_and_without_frames(name):
    episodes = []
    for read in (False, True):
        with closing(deepbots_cli.make(name)) as env:
            observation, _ = env.reset(seed=3)
            reader = FrameReader(env) if read else None
            rewards = []
            for _ in range(15):
                action = env.action_space.sample()
                observation, reward, terminated, truncated, _ = env.step(action)
                rewards.append(reward)
                if reader is not None:
                    reader.read(observation, action)
                if terminated or truncated:
                    break
            episodes.append((rewards, str(observation)))
    assert episodes[0] == episodes[1]


def test_no_message_of_the_episode_before_is_in_the_first_frame():
    with closing(Player(Showing("cartpole").open(), ZERO)) as player:
        first = player.begin(0, 0).messages
        assert first["cart/to_robot"].values == (None,)
        assert player.step().messages["cart/to_robot"].values != (None,)
        assert player.begin(0, 0).messages == first


def test_a_frame_has_the_values_of_the_engine():
    with closing(deepbots_cli.make("find_ball")) as env:
        observation, _ = env.reset(seed=0)
        reader = FrameReader(env)
        frame = reader.read(observation)
        assert frame.links["epuck", "base_link"] == env.engine.pose("epuck")()
        assert frame.links["ball", "ball"][0] == pytest.approx((0.38, 0.38, 0.07))
        assert len(frame.rays["epuck.proximity"]) == len(reader.layout.sensor_rays["epuck.proximity"].starts)
        assert all(0 <= free <= 0.1 for free in frame.rays["epuck.proximity"])
        assert frame.readings["epuck.proximity"] == pytest.approx(
            env.controllers["epuck"].devices["proximity"].reading
        )
        fields = dict(
            zip([f.name for f in reader.layout.observation], frame.agents["agent"].observation, strict=True)
        )
        (x, y, _), _ = frame.links["epuck", "base_link"]
        assert fields["apart"] == pytest.approx(np.hypot(0.38 - x, 0.38 - y), abs=1e-6)
        assert frame.agents["agent"].action is None
        moved = reader.read(env.step(env.action_space.sample())[0], env.action_space.sample())
        assert {body for body, _ in moved.forces} == {"epuck"}
        assert sum(moved.forces.values()) > 0.5


def test_returns_and_endings_are_those_of_the_episode():
    with closing(Player(Showing("find_ball").open(), "around")) as player:
        frames = list(player.episode(0, 0))
    rewards = [frame.agents["agent"].reward for frame in frames[1:]]
    assert frames[-1].agents["agent"].episode_return == pytest.approx(sum(rewards))
    assert frames[-1].ending == "success: found"
    assert [frame.step for frame in frames] == list(range(len(frames)))
    assert frames[-1].time == pytest.approx(0.128 * (len(frames) - 1))


@pytest.mark.slow
@pytest.mark.parametrize("name", few(BATCHES, BATCHES[1:3]))
def test_a_world_of_a_batch_has_the_frames_of_a_single_world(name):
    with closing(open_player(Showing(name, engine="mujoco", worlds=3).open(), RANDOM)) as batch:
        batch.world = 2
        with closing(open_player(Showing(name, engine="mujoco").open(), RANDOM)) as single:
            pairs = [(batch.begin(7, 0), single.begin(7, 2))]
            while len(pairs) < 15 and not pairs[-1][1].ended_by:
                pairs.append((batch.step(), single.step()))
        for of_batch, of_single in pairs:
            actual, expected = dict(_leaves(asdict(of_batch))), dict(_leaves(asdict(of_single)))
            assert actual.keys() == expected.keys()
            for path, value in expected.items():
                assert actual[path] == (
                    pytest.approx(value, rel=1e-9, abs=1e-9) if isinstance(value, float) else value
                ), path


def _leaves(value, path=""):
    """The numbers and names of a frame by their paths."""
    if not isinstance(value, (dict, tuple)):
        yield path, value
        return
    for key, part in value.items() if isinstance(value, dict) else enumerate(value):
        yield from _leaves(part, f"{path}/{key}")


def test_worlds_of_a_batch_that_have_ended_rest_until_the_next_episodes():
    with closing(open_player(Showing("cartpole", engine="mujoco", worlds=4).open(), RANDOM)) as player:
        player.begin(0, 0)
        while player._running.resting.sum() < 2:
            player.step()
        world = int(player._running.resting.argmax())
        ended = player.choose(world)
        assert ended.ending == "failure: fallen"
        assert ended.agents["agent"].episode_return == ended.step
        player.step()
        assert asdict(player.choose(world)) == asdict(ended)
        assert "fallen 2" in player.note
        assert player.next_episode(0) == 4
        with pytest.raises(UsageError, match="leave out --worlds"):
            player.set_driver("balance")


def test_bodies_that_take_no_part_in_the_episode_are_left_out():
    with closing(Player(Showing("find_ball_random").open(), ZERO)) as player:
        names_of_bodies = [
            {body for body, _ in player.begin(0, episode).links if body.startswith("obstacle")}
            for episode in range(6)
        ]
        assert len({len(bodies) for bodies in names_of_bodies}) > 1
        assert set(player.frame.variants.values()) <= {"cube", "plank"}


def test_every_copy_of_a_robot_has_frames_of_its_own():
    with closing(Player(Showing("multi_cartpole").open(), RANDOM)) as player:
        player.begin(0, 0)
        frame = player.step()
        assert list(frame.agents) == [f"cart#{number}" for number in range(1, 10)]
        assert len({agent.action for agent in frame.agents.values()}) == 2
        poles = {frame.links[name, "pole"][0] for name in frame.agents}
        assert len(poles) == 9


def test_a_push_is_in_the_frames_while_it_lasts():
    with closing(Player(Showing("quadruped", case="pushed").open(), ZERO)) as player:
        pushed = [bool(frame.pushes) for frame in player.episode(0, 0, 390)]
    assert 5 <= sum(pushed) <= 18  # one to three pushes of 100 ms within 7.8 s, in steps of 20 ms


def test_fields_have_units_ranges_and_options():
    program = deepbots_cli.compile("find_ball").program
    angle = observation_fields(program, ShownUnits())[-1]
    assert angle.name == "angle"
    assert angle.unit == "rad"
    assert round(angle.high, 3) == 3.142
    assert [field.name for field in action_fields(program, ShownUnits())] == ["gas", "wheel"]
    (choice,) = action_fields(deepbots_cli.compile("cartpole").program, ShownUnits())
    assert choice.text(1.0) == choice.options[1]


def test_a_person_drives_by_the_names_of_action_fields():
    with closing(Player(Showing("find_ball").open(), HAND)) as player:
        player.begin(0, 0)
        player.manual_values = {"gas": 1.0, "wheel": -0.5}
        assert player.step().agents["agent"].action == pytest.approx((1.0, -0.5))


def test_messages_are_those_that_receivers_go_by():
    """A message that arrives k ticks after it was sent has an age of k ticks, and the value of the tick in
    which it was sent."""
    with closing(Player(Showing("cartpole_wireless").open(), RANDOM)) as player:
        frames = list(player.episode(0, 0))
    for frame in frames[1:]:
        message = frame.messages["cart/from_robot"]
        sent_at = frame.step - round(message.age / player.program.period)
        assert message.values == frames[sent_at].readings["cart.pole_angle"]
    assert {frame.messages["cart/to_robot"].received for frame in frames} == {True, False}


def test_what_was_drawn_makes_the_same_episode():
    with closing(deepbots_cli.make("find_ball")) as env:
        reader = FrameReader(env)
        first = reader.read(env.reset(seed=5)[0])
        assert {"reset.place.epuck.x", "reset.place.epuck.y", "reset.place.epuck.yaw"} <= set(first.drawn)
        repeated = reader.read(env.reset(seed=6, options=dict(first.drawn))[0])
    assert repeated.links == first.links


def test_frames_contain_the_allowed_options():
    with closing(Player(Showing("find_and_avoid").open(), RANDOM)) as player:
        forbids = False
        for frame in player.episode(0, 3, 60):
            allowed = frame.agents["agent"].allowed
            assert allowed == () or (
                len(allowed) == sum(len(field.options) for field in player.reader.layout.action)
                and any(allowed)
            )
            if frame.ended_by is None:
                assert (allowed or (True,) * len(player.env.action_masks())) == tuple(
                    player.env.action_masks()
                )
            forbids = forbids or False in allowed
    assert forbids


def test_a_start_that_is_given_begins_every_episode():
    with closing(Player(Showing("find_ball", start={"reset.place.epuck.x": -0.4}).open(), RANDOM)) as player:
        assert [player.begin(0, number).drawn["reset.place.epuck.x"] for number in range(2)] == [-0.4, -0.4]
