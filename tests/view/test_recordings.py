"""Frames of episodes, recordings, and policies in the page.

* Recordings: frames are read as they were recorded, a replay is the same to the bit, and damaged files do no
  harm.
* Frames have the values of the engine, and reading them changes nothing.
* Policies of runs in the page: masked and recurrent ones, and the newest one of a training that goes on.
"""

from __future__ import annotations

import base64
import io
import json
import lzma
import os
import random
import shutil
from contextlib import closing
from dataclasses import asdict, fields, replace
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer

import deepbots_cli
from deepbots_cli import learning
from deepbots_cli.analysis.shown_units import ShownUnits
from deepbots_cli.cli import main
from deepbots_cli.errors import RunError, UsageError
from deepbots_cli.insight.export.hub import hub_files
from deepbots_cli.learning.runs.directories import run_lock
from deepbots_cli.learning.runs.run import Run
from deepbots_cli.program import RANDOM, ZERO
from deepbots_cli.rollout.drivers import POLICY
from deepbots_cli.rollout.recordings import Recording, RecordingError
from deepbots_cli.view import recordings
from deepbots_cli.view.episodes import Player, Showing
from deepbots_cli.view.frames import FrameReader, WorldFrame, action_fields, observation_fields
from deepbots_cli.view.replay import ReplayPlayer, open_player, verify, version_changes
from tests.few import few
from tests.files import written

pytest.importorskip("mcap")


def _recorded(
    folder: Path, name: str, driver: str = "random", engine: str | None = None
) -> tuple[Path, list[WorldFrame]]:
    """A recording of the episodes 2 and 3, and their frames."""
    path = folder / f"{name}.mcap"
    kept = []

    class Kept(Player):
        def episode(self, *arguments):
            for frame in super().episode(*arguments):
                kept.append(frame)
                yield frame

    with closing(Kept(Showing(name, engine=engine).open(), driver)) as player:
        recordings.record(player, path, 1, [2, 3])
    return path, kept


@pytest.fixture(scope="module")
def find_ball(tmp_path_factory):
    return _recorded(tmp_path_factory.mktemp("recordings"), "find_ball", "around")


def _is_same(value, expected) -> bool:
    if isinstance(value, np.ndarray):
        return np.array_equal(value, expected)
    if hasattr(value, "__dataclass_fields__"):
        return all(
            _is_same(getattr(value, field.name), getattr(expected, field.name)) for field in fields(value)
        )
    if hasattr(value, "keys"):
        return value.keys() == expected.keys() and all(_is_same(value[key], expected[key]) for key in value)
    if isinstance(value, list | tuple):
        return len(value) == len(expected) and all(map(_is_same, value, expected))
    return value == expected or (value != value and expected != expected)


@pytest.mark.parametrize(
    ("name", "engine"),
    [
        ("cartpole_wireless", None),
        pytest.param("multi_cartpole", None, marks=pytest.mark.slow),
        pytest.param("cartpole_continuous", "mujoco", marks=pytest.mark.slow),
        pytest.param("see_ball", None, marks=pytest.mark.slow),
    ],
)
def test_frames_come_back_and_a_replay_is_the_same(tmp_path, name, engine):
    path, frames = _recorded(tmp_path, name, engine=engine)
    opened = Showing(str(path)).open()
    with closing(ReplayPlayer(opened)) as player:
        replayed = [frame for number in (2, 3) for frame in player.episode(0, number)]
    assert len(replayed) == len(frames)
    assert all(map(_is_same, frames, replayed))
    with closing(Player(opened, "zero")) as player:
        assert verify(opened.recording, player) is None


def test_a_package_that_was_not_there_is_not_called_none(tmp_path):
    recording = replace(Showing(str(_recorded(tmp_path, "cartpole")[0])).open().recording, metadata={})
    assert f"numpy was not installed when this was recorded, and is {np.__version__} now" in version_changes(
        recording
    )


def _changed(path: Path, out: Path, **change) -> Path:
    """The recording written again, with other metadata, other attachments, or another payload of a topic in
    one step."""
    with path.open("rb") as stream, out.open("wb") as target:
        reader = make_reader(stream)
        writer = Writer(target)
        channels = {}
        writer.start("", "test")
        for entry in reader.iter_metadata():
            writer.add_metadata(entry.name, entry.metadata | change.get("metadata", {}))
        for entry in reader.iter_attachments():
            writer.add_attachment(
                0, 0, change.get("attachments", {}).get(entry.name, entry.name), entry.media_type, entry.data
            )
        for place, (schema, channel, message) in enumerate(reader.iter_messages()):
            if channel.topic not in channels:
                schema_id = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.topic] = writer.register_channel(channel.topic, "json", schema_id)
            edit = change.get("payload", lambda place, topic, content: content)
            content = edit(place, channel.topic, json.loads(message.data))
            writer.add_message(
                channels[channel.topic],
                message.log_time,
                json.dumps(content, separators=(",", ":")).encode(),
                message.log_time,
            )
        writer.finish()
    return out


def test_the_first_step_and_quantity_that_differ_are_named(find_ball, tmp_path, deepbots):
    """A step of the script is 0.128 s."""

    def edit(place, topic, content):
        if topic == "/tf" and content["transforms"][0]["timestamp"] == {"sec": 1, "nsec": 280_000_000}:
            moved = next(
                each for each in content["transforms"] if each["child_frame_id"] == "epuck/left_wheel"
            )
            moved["translation"]["y"] = np.nextafter(moved["translation"]["y"], 9.0)
        return content

    path = _changed(find_ball[0], tmp_path / "changed.mcap", payload=edit)
    assert (
        "episode 2, step 10: tf epuck/left_wheel.translation.y differs"
        in deepbots("replay", "--verify", path, code=1).out
    )
    assert "2 episodes and " in deepbots("replay", "--verify", find_ball[0]).out


@pytest.mark.parametrize(
    "name",
    [
        "cartpole",
        "find_ball",
        *(
            pytest.param(n, marks=pytest.mark.slow)
            for n in ("line_follower", "panda_reach", "quadrotor", "tag_scripted")
        ),
    ],
)
def test_what_was_recorded_once_happens_again(name, tmp_path, capsys):
    """Recordings in the folder `golden`, which `deepbots render NAME --seed 1 --steps N` wrote; the tolerance
    is for other machines."""
    pytest.importorskip("pybullet")  # with which they were recorded
    path = written(
        tmp_path / f"{name}.mcap",
        lzma.decompress((Path(__file__).parent / "golden" / f"{name}.mcap.xz").read_bytes()),
    )
    assert main(["replay", "--verify", str(path), "--tolerance", "1e-6"]) == 0, capsys.readouterr()
    assert "are the same within 1e-06" in capsys.readouterr().out


@pytest.mark.parametrize(("by", "same"), [(5e-7, True), (2e-6, False)])
def test_a_tolerance_bears_small_differences_only(find_ball, tmp_path, by, same):
    def edit(place, topic, content):
        if topic == "/tf":
            content["transforms"][0]["translation"]["x"] += by
        return content | {"velocities": "other"} if topic == "/step" else content

    path = _changed(find_ball[0], tmp_path / "changed.mcap", payload=edit)
    assert main(["replay", "--verify", str(path), "--tolerance", "1e-6"]) == (0 if same else 1)
    assert main(["replay", "--verify", str(path)]) == 1


def test_foxglove_finds_its_types(find_ball):
    with find_ball[0].open("rb") as stream:
        reader = make_reader(stream)
        summary = reader.get_summary()
        names = {channel.topic: summary.schemas[channel.schema_id] for channel in summary.channels.values()}
        assert names["/tf"].name == "foxglove.FrameTransforms"
        assert names["/scan/epuck.proximity"].name == "foxglove.PointCloud"
        assert json.loads(names["/scan/epuck.proximity"].data)["properties"]["data"] == {
            "type": "string",
            "contentEncoding": "base64",
        }
        first = next(
            json.loads(message.data)
            for _, channel, message in reader.iter_messages()
            if channel.topic == "/tf"
        )
    frame = find_ball[1][0]
    for each in first["transforms"]:
        place, turn = frame.links[tuple(each["child_frame_id"].split("/"))]
        assert (tuple(each["translation"].values()), tuple(each["rotation"].values())) == (place, turn)
    with find_ball[0].open("rb") as stream:
        messages = make_reader(stream).iter_messages(topics="/scan/epuck.proximity")
        cloud = json.loads(next(messages)[2].data)
    with closing(open_player(Showing(str(find_ball[0])).open())) as player:
        beams = player.reader.layout.sensor_rays["epuck.proximity"]
    ends = beams.lines(frame, "epuck.proximity")[:, 1, :3]
    assert np.frombuffer(base64.b64decode(cloud["data"]), "<f4").reshape(-1, 3) == pytest.approx(ends)


def test_a_picture_of_a_recording_is_that_of_the_episode(find_ball, tmp_path):
    live, replayed = tmp_path / "live.png", tmp_path / "replayed.png"
    options = ["--size", "240x180", "--steps", "40", "--rays", "--episode", "2", "--output"]
    assert main(["render", "find_ball", "--driver", "around", "--seed", "1", *options, str(live)]) == 0
    assert main(["render", str(find_ball[0]), *options, str(replayed)]) == 0
    assert live.read_bytes() == replayed.read_bytes()


# Files of others
@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"metadata": {"format": "99"}}, "format 99"),
        ({"attachments": {"inputs/scenarios/find_ball.yaml": "inputs/../../evil"}}, "damaged"),
        ({"attachments": {"inputs/scenarios/find_ball.yaml": "/etc/evil"}}, "damaged"),
        ({"attachments": {"resolved.yaml": "inputs/other.yaml"}}, "no scenario|damaged"),
    ],
)
def test_a_file_that_cannot_be_read_is_refused_in_a_sentence(find_ball, tmp_path, change, message):
    with pytest.raises(RecordingError, match=message) as caught:
        Recording.read(_changed(find_ball[0], tmp_path / "changed.mcap", **change))
    assert "\n" not in str(caught.value)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("topic", "edit"),
    [
        ("/tf", lambda content: {"transforms": content["transforms"][1:2]}),
        ("/world", lambda content: content | {"rays": {}}),
        ("/world", lambda content: content | {"time": "soon"}),
        ("/world", lambda content: content | {"time": 1e300}),
        ("/world", lambda content: content | {"time": 10**400}),
        ("/episode", lambda content: content | {"seed": -1}),
        (
            "/tf",
            lambda content: {
                "transforms": [each | {"translation": dict.fromkeys("xyz")} for each in content["transforms"]]
            },
        ),
        (
            "/tf",
            lambda content: {
                "transforms": [
                    each | {"rotation": dict.fromkeys("xyzw", 0.0)} for each in content["transforms"]
                ]
            },
        ),
        ("/agent/agent", lambda content: content | {"observation": {"apart": 1.0}}),
        ("/agent/agent", lambda content: content | {"terms": [1, 2]}),
        ("/message/epuck/to_robot", lambda content: []),
    ],
)
def test_an_impossible_step_is_refused_in_a_sentence(find_ball, tmp_path, deepbots, topic, edit):
    path = _changed(
        find_ball[0],
        tmp_path / "changed.mcap",
        payload=lambda _, name, content: edit(content) if name == topic else content,
    )
    assert (
        "is damaged: a step of it cannot be read"
        in deepbots("render", path, "--episode", "2", "--output", tmp_path / "x.png", code=2).err
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    "action",
    [{}, {"action": {"dtype": "object", "rows": 0, "data": ""}}, {"action": {"dtype": "int64", "data": ""}}],
)
def test_an_impossible_action_is_refused_in_a_sentence(find_ball, tmp_path, deepbots, action):
    path = _changed(
        find_ball[0],
        tmp_path / "changed.mcap",
        payload=lambda _, name, content: (
            content | {"action": action} if name == "/step" and content["step"] else content
        ),
    )
    assert "is damaged: a step of it cannot be read" in deepbots("replay", "--verify", path, code=2).err


def test_a_pipe_is_not_a_recording(tmp_path):
    os.mkfifo(tmp_path / "pipe.mcap")
    with pytest.raises(RecordingError, match="not a regular file"):
        Recording.read(tmp_path / "pipe.mcap")


def test_a_file_that_is_a_folder_too_is_refused_in_a_sentence(find_ball, tmp_path):
    path = _changed(
        find_ball[0], tmp_path / "changed.mcap", attachments={"inputs/scenarios/find_ball.yaml": "inputs"}
    )
    with pytest.raises(RecordingError, match="a file and a folder of the same name"):
        Recording.read(path)


def test_a_cut_or_flipped_file_is_refused_or_read(find_ball, tmp_path):
    data = find_ball[0].read_bytes()
    rng = random.Random(1)
    path = tmp_path / "other.mcap"
    for number in range(60):
        changed = bytearray(data[: rng.randrange(len(data))] if number % 2 else data)
        for _ in range(rng.randrange(4) if number % 2 else 1 + rng.randrange(30)):
            if changed:
                changed[rng.randrange(len(changed))] = rng.randrange(256)
        path.write_bytes(changed)
        if number % 2:
            with pytest.raises(RecordingError):
                Recording.read(path)
        else:
            try:
                Recording.read(path)
            except RecordingError:
                continue


def test_a_bomb_is_not_unpacked(find_ball, tmp_path):
    import zstandard
    from mcap.data_stream import RecordBuilder
    from mcap.records import Chunk, DataEnd, Footer, Header

    packer = zstandard.ZstdCompressor().compressobj(size=1 << 34)  # what the frame promises
    packed = packer.compress(bytes(1000)) + packer.flush(zstandard.COMPRESSOBJ_FLUSH_BLOCK)
    builder = RecordBuilder()
    stream = io.BytesIO(b"\x89MCAP0\r\n")
    stream.seek(0, 2)
    for record in (Header("", ""), Chunk("zstd", packed, 0, 0, 0, 100), DataEnd(0), Footer(0, 0, 0)):
        record.write(builder)
    stream.write(builder.end())
    stream.write(b"\x89MCAP0\r\n")
    path = written(tmp_path / "bomb.mcap", stream.getvalue())
    with pytest.raises(RecordingError, match="larger than 512 MiB when decompressed"):
        Recording.read(path)


def test_options_and_files_of_the_command(tmp_path, monkeypatch, deepbots, find_ball):
    monkeypatch.chdir(tmp_path)
    (recording,) = json.loads(
        deepbots("render", "cartpole", "--episodes", "2", "--json", "-o", "two.mcap").out
    )["files"]
    assert recording["file"] == "two.mcap"
    assert [episode["episode"] for episode in recording["episodes"]] == [0, 1]
    assert "two.mcap already exists" in deepbots("render", "cartpole", "-o", "two.mcap", code=2).err
    assert (
        "contains no episode 7; it contains 2, 3"
        in deepbots("render", find_ball[0], "--episode", "7", "--output", "x.gif", code=2).err
    )
    assert json.loads(deepbots("replay", "two.mcap", "--json").out)["scenario"] == "CartPole"


BATCHES = ("cartpole_wireless", "find_and_avoid", "multi_cartpole", "quadruped", "panda_push")


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
    assert frames[-1].agents["agent"].episode_return == pytest.approx(
        sum(frame.agents["agent"].reward for frame in frames[1:])
    )
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
    with closing(
        open_player(Showing("cartpole_wireless", engine="mujoco", worlds=4).open(), RANDOM)
    ) as player:
        player.begin(0, 0)
        while player._running.resting.sum() < 2:
            player.step()
        world = int(player._running.resting.argmax())
        ended = player.choose(world)
        assert (ended.ending, ended.agents["agent"].episode_return) == ("failure: fallen", ended.step)
        player.step()
        assert asdict(player.choose(world)) == asdict(ended)
        assert "fallen 2" in player.note
        assert player.next_episode(0) == 4
        with pytest.raises(UsageError, match="leave out --worlds"):
            player.set_driver("balance")


def test_worlds_that_have_ended_rest_beside_others_whose_actions_have_choices_and_ranges(tmp_path):
    both = tmp_path / "both.yaml"
    apply = "robots: {cart: {apply: {wheels: drive * wheel_speed * (1 + boost)}}}"
    both.write_text(f"deepbots: 1\nextends: cartpole\nremove: [train]\naction: {{boost: 0 .. 1}}\n{apply}\n")
    with closing(open_player(Showing(str(both), worlds=3).open(), RANDOM)) as player:
        player.begin(0, 0)
        while not player._running.resting.all():
            player.step()
        lengths = [player.choose(world).step for world in range(3)]
        assert len(set(lengths)) > 1


def test_a_world_that_is_chosen_at_the_reset_has_the_messages_of_its_own_reset():
    with closing(open_player(Showing("cartpole", worlds=2).open(), ZERO)) as player:
        for _ in range(2):
            player.begin(0, 0)
            messages = player.choose(1).messages
            assert messages["cart/from_robot"].received
            assert messages["cart/to_robot"].values == (None,)
            player.choose(0)
            assert player.choose(1).messages == messages
            player.step()
            player.choose(0)


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
        assert len({frame.links[name, "pole"][0] for name in frame.agents}) == 9


@pytest.mark.parametrize(("duration", "steps"), [("100 ms", 5), ("20 ms", 1), ("10 ms", 1)])
def test_a_push_is_in_the_frames_of_the_steps_in_which_it_acts(duration, steps):
    push = f"{{body: cart, force: 1 0 0 N, at: 0.2 s, duration: {duration}}}"
    settings = ("world.timestep=20 ms", f"disturbances={{push: {push}}}")
    with closing(Player(Showing("cartpole", settings).open(), ZERO)) as player:
        pushed = [bool(frame.pushes) for frame in player.episode(0, 0, 20)]
    assert sum(pushed) == steps


def test_fields_have_units_ranges_and_options():
    program = deepbots_cli.compile("find_ball").program
    angle = observation_fields(program, ShownUnits())[-1]
    assert (angle.name, angle.unit, round(angle.high, 3)) == ("angle", "rad", 3.142)
    assert [field.name for field in action_fields(program, ShownUnits())] == ["gas", "wheel"]
    (choice,) = action_fields(deepbots_cli.compile("cartpole").program, ShownUnits())
    assert choice.text(1.0) == choice.options[1]


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


SMALL = ["train.environments=1", "train.n_steps=64", "train.batch_size=64", "train.n_epochs=1"]


def _trained(folder, name, *overrides):
    pytest.importorskip("sb3_contrib")
    return learning.train(
        deepbots_cli.compile(name, overrides=[*SMALL, *overrides]), run=folder / "run", total_timesteps=64
    ).run


@pytest.mark.parametrize(
    ("name", "algorithm"),
    [pytest.param("find_and_avoid", "MaskablePPO", marks=pytest.mark.slow), ("cartpole", "RecurrentPPO")],
)
def test_the_policy_of_the_page_acts_as_in_an_evaluation(tmp_path, name, algorithm):
    run = _trained(tmp_path, name, f"train.algorithm={algorithm}")
    evaluated = learning.evaluate(run, episodes=2, seed=5)
    with closing(open_player(Showing(str(run)).open())) as player:
        for number, episode in enumerate(evaluated.outcomes):
            *_, last = player.episode(5, number)
            assert player.driver_name == POLICY
            assert (last.step, last.ended_by) == (episode.length, episode.ended_by)
            assert last.agents["agent"].episode_return == pytest.approx(episode.total_return)


def test_a_training_is_followed_to_its_newest_policy(tmp_path):
    run = Run.open(_trained(tmp_path, "cartpole"))
    kept = tmp_path / "kept.zip"
    shutil.copyfile(run.model("last"), kept)
    for name in ("best", "last"):
        run.model(name).unlink(missing_ok=True)
    with pytest.raises(RunError, match="has no model yet"):
        open_player(Showing(str(run.path)).open())
    run.update(status="running")
    with run_lock(run.path), closing(open_player(Showing(str(run.path)).open())) as player:
        player.begin(0, 0)
        assert "no policy yet" in player.driver.note
        player.step()
        for name, time in (("last", 1_000), ("best", 2_000)):
            shutil.copyfile(kept, run.model(name))
            os.utime(run.model(name), (time, time))
            before = player.driver._policy
            player.begin(0, 0)
            assert player.driver._policy is not before
            assert player.driver.note == "policy after 64 steps"
            assert np.isfinite(player.step().agents["agent"].reward)
        before = player.driver._policy
        player.begin(0, 1)
        assert player.driver._policy is before
        run.model("best").write_bytes(b"")  # newer, and would be refused
        with closing(open_player(Showing(str(run.model("last"))).open())) as named:
            named.begin(0, 0)
            assert named.driver.note == "policy after 64 steps"


def test_a_named_model_is_drawn_while_a_newer_one_is_trained(tmp_path, deepbots):
    run = Run.open(_trained(tmp_path, "cartpole"))
    deepbots("eval", run.path, "--episodes", "2")
    run.model("last").write_bytes(b"")  # newer, and would be refused
    run.update(status="running")
    picture = ["-o", "episode.gif", "--size", "60x40", "--seconds", "0.1", "--force"]
    with run_lock(run.path):
        assert "episode.gif" in deepbots("render", run.model("best"), *picture).out
        assert "episode-0.gif" in deepbots("render", run.path, "--episodes", "failed", *picture).out
        assert "replay.mp4" in map(str, hub_files(run, "best"))


def test_a_picture_of_a_folder_has_its_whole_name(tmp_path, deepbots, monkeypatch):
    run = _trained(tmp_path, "cartpole").rename(tmp_path / "lr-0.001")
    assert deepbots("render", "lr-0.001", "--size", "60x40").out == "lr-0.001.png\n"
    monkeypatch.chdir(run / "models")
    assert deepbots("render", "..", "--size", "60x40").out == "lr-0.001.png\n"


def test_the_pictures_of_a_recording_have_the_numbers_of_its_episodes(deepbots, find_ball):
    drawn = ["render", find_ball[0], "--size", "60x40", "--seconds", "0.1"]
    first, both = (
        json.loads(deepbots(*drawn, *options, "--json").out)["files"]
        for options in (["-o", "first.gif"], ["--episodes", "2", "-o", "both.gif"])
    )
    assert [each["episode"] for each in first[0]["episodes"]] == [2]
    assert [each["file"] for each in both] == ["both-2.gif", "both-3.gif"]
    assert [each["episodes"][0]["episode"] for each in both] == [2, 3]
    for options, message in (
        (["--seed", "7"], "already contains its seeds; leave out --seed"),
        (["--episode", "0"], "contains no episode 0; it contains 2, 3"),
        (["--episodes", "3"], "contains 2 episodes; write --episodes 2 or less"),
        (["--episode", "3", "--episodes", "2"], "contains 1 episode from episode 3 on; write --episodes 1"),
    ):
        assert message in " ".join(deepbots(*drawn, *options, "-o", "wrong.gif", code=2).err.split())


def test_the_named_model_drives_a_batch_too_and_its_note_names_other_physics(tmp_path):
    run = Run.open(_trained(tmp_path, "cartpole"))
    run.model("best").write_bytes(b"")  # which would be refused
    run.update(physics=1)
    for worlds in (None, 2):
        shown = Showing(str(run.path), engine="mujoco", worlds=worlds, model="last")
        with closing(open_player(shown.open())) as player:
            player.begin(0, 0)
            assert player.step().step == 1
            assert "was trained with physics 1" in player.note


def test_the_page_of_a_training_names_the_stage_of_its_curriculum(tmp_path):
    pytest.importorskip("viser")
    from deepbots_cli.view.page import Page

    stages = "curriculum=[{name: wide, set: {fall_angle: 8 deg}, until: 24 steps}, {name: usual}]"
    run = Run.open(_trained(tmp_path, "cartpole", stages))
    run.update(status="running")
    with run_lock(run.path), closing(Page(Showing(str(run.path)), port=0)) as page:
        assert page.player.note == "policy after 64 steps, the training is in stage usual"


def test_a_parameter_of_a_run_changes_its_world_and_a_policy_that_does_not_fit_is_refused(tmp_path):
    run = str(_trained(tmp_path, "cartpole"))
    assert Showing(run).open().parameters["fall_angle"] == "15 deg"
    with closing(open_player(Showing(run, overrides=["parameters.fall_angle=1 deg"]).open())) as player:
        *_, last = player.episode(0, 0)
        assert (player.driver_name, last.ended_by) == (POLICY, "fallen")
        assert last.agents["agent"].episode_return < 60
    with pytest.raises(RunError, match="does not fit the changed scenario"):
        open_player(Showing(run, overrides=["action.drive.choices.stop=0"]).open())
    assert Showing(run, overrides=["parameters.fall_angle=1 kg"]).open().program is None
