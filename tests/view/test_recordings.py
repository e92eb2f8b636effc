"""Recordings: frames are read as they were recorded, a replay is the same to the bit, and damaged files do no
harm."""

from __future__ import annotations

import io
import json
import lzma
import os
import random
import re
from contextlib import closing
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("mcap")
from mcap.reader import make_reader
from mcap.writer import Writer

from deepbots_cli.cli import main
from deepbots_cli.rollout.recordings import Recording, RecordingError
from deepbots_cli.view import recordings
from deepbots_cli.view.episodes import Player, Showing
from deepbots_cli.view.frames import SensorRays, WorldFrame
from deepbots_cli.view.replay import ReplayPlayer, verify


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


def test_the_first_step_and_quantity_that_differ_are_named(find_ball, tmp_path, capsys):
    """A step of the script is 0.128 s."""

    def edit(place, topic, content):
        if topic == "/tf" and content["transforms"][0]["timestamp"] == {"sec": 1, "nsec": 280_000_000}:
            moved = next(
                each for each in content["transforms"] if each["child_frame_id"] == "epuck/left_wheel"
            )
            moved["translation"]["y"] = np.nextafter(moved["translation"]["y"], 9.0)
        return content

    path = _changed(find_ball[0], tmp_path / "changed.mcap", payload=edit)
    assert main(["replay", "--verify", str(path)]) == 1
    assert "episode 2, step 10: tf epuck/left_wheel.translation.y differs" in capsys.readouterr().out
    assert main(["replay", "--verify", str(find_ball[0])]) == 0
    assert "2 episodes and " in capsys.readouterr().out


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
    path = tmp_path / f"{name}.mcap"
    path.write_bytes(lzma.decompress((Path(__file__).parent / "golden" / f"{name}.mcap.xz").read_bytes()))
    assert main(["replay", "--verify", str(path), "--tolerance", "1e-6"]) == 0, capsys.readouterr()
    assert "are the same within 1e-06" in capsys.readouterr().out


def test_a_friction_of_one_percent_more_is_noticed_and_named(tmp_path, capsys):
    pytest.importorskip("pybullet")  # with which the golden recording was made
    path = tmp_path / "find_ball.mcap"
    path.write_bytes(lzma.decompress((Path(__file__).parent / "golden" / "find_ball.mcap.xz").read_bytes()))
    again = ["replay", "--verify", str(path), "--tolerance", "1e-6", "--scenario", "find_ball"]
    assert main(again) == 0
    assert main([*again, "--set", "world.arena.friction=1.01"]) == 1
    output = capsys.readouterr()
    assert "world.arena.friction: recorded (not written), now 1.01" in output.err
    assert re.search(r"episode 0, step \d+: .* differs", output.out)
    assert main(["replay", "--verify", str(path), "--scenario", "cartpole"]) == 2
    assert "observation.apart: recording 0 .. 1.5 m, scenario has none" in capsys.readouterr().err


@pytest.mark.parametrize(("by", "same"), [(5e-7, True), (2e-6, False)])
def test_a_tolerance_bears_small_differences_only(find_ball, tmp_path, by, same):
    def edit(place, topic, content):
        if topic == "/tf":
            content["transforms"][0]["translation"]["x"] += by
        return content | {"hash": "other", "velocities": "other"} if topic == "/step" else content

    path = _changed(find_ball[0], tmp_path / "changed.mcap", payload=edit)
    assert main(["replay", "--verify", str(path), "--tolerance", "1e-6"]) == (0 if same else 1)
    assert main(["replay", "--verify", str(path)]) == 1


@pytest.mark.slow
def test_a_hundred_recordings_happen_again_to_the_bit(tmp_path, capsys):
    for name in ("cartpole", "find_ball", "line_follower", "panda_reach", "quadrotor", "tag_scripted"):
        path = tmp_path / f"{name}.mcap"
        assert (
            main(["render", name, "--seed", "7", "--episodes", "17", "--steps", "40", "--output", str(path)])
            == 0
        )
        assert main(["replay", "--verify", str(path)]) == 0
        assert "17 episodes and " in capsys.readouterr().out


def test_foxglove_finds_its_types(find_ball):
    with find_ball[0].open("rb") as stream:
        reader = make_reader(stream)
        summary = reader.get_summary()
        names = {channel.topic: summary.schemas[channel.schema_id] for channel in summary.channels.values()}
        assert names["/tf"].name == "foxglove.FrameTransforms"
        assert names["/scan/epuck.proximity"].name == "foxglove.PointCloud"
        data = json.loads(names["/scan/epuck.proximity"].data)["properties"]["data"]
        assert data == {"type": "string", "contentEncoding": "base64"}
        first = next(
            json.loads(message.data)
            for _, channel, message in reader.iter_messages()
            if channel.topic == "/tf"
        )
    frame = find_ball[1][0]
    for each in first["transforms"]:
        place, turn = frame.links[tuple(each["child_frame_id"].split("/"))]
        assert tuple(each["translation"].values()) == place
        assert tuple(each["rotation"].values()) == turn


@pytest.mark.parametrize("count", [3, 90, 360])
def test_the_points_of_a_scan_are_where_the_rays_end(count):
    """A scan is in the plane of its frame: range r at angle a is (r cos a, r sin a, 0) there."""
    angles = np.linspace(-2.5, 2.5, count)
    tilt = np.array([[1, 0, 0], [0, 0.6, -0.8], [0, 0.8, 0.6]])
    ways = np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=1) @ tilt.T
    beams = SensorRays(("robot", "base"), np.tile([0.1, 0.2, 0.3], (count, 1)), ways, 4.0)
    free = list(np.linspace(1.0, 3.0, count))
    scan = recordings._scan(beams, recordings._fan(beams), free, (0.0, 0.0, 0.0, 1.0), {})
    from scipy.spatial.transform import Rotation

    at = np.linspace(scan["start_angle"], scan["end_angle"], count)
    flat = np.array(scan["ranges"])[:, None] * np.stack([np.cos(at), np.sin(at), 0 * at], axis=1)
    points = Rotation.from_quat(list(scan["pose"]["orientation"].values())).apply(flat) + list(
        scan["pose"]["position"].values()
    )
    assert points == pytest.approx(beams.starts + np.array(free)[:, None] * ways, abs=1e-6)


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
                "transforms": [
                    each | {"translation": dict.fromkeys("xyz", 1e300)} for each in content["transforms"]
                ]
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
def test_an_impossible_step_is_refused_in_a_sentence(find_ball, tmp_path, capsys, topic, edit):
    path = _changed(
        find_ball[0],
        tmp_path / "changed.mcap",
        payload=lambda _, name, content: edit(content) if name == topic else content,
    )
    assert main(["render", str(path), "--episode", "2", "--output", str(tmp_path / "x.png")]) == 2
    assert "is damaged: a step of it cannot be read" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize(
    "action",
    [{}, {"action": {"dtype": "object", "rows": 0, "data": ""}}, {"action": {"dtype": "int64", "data": ""}}],
)
def test_an_impossible_action_is_refused_in_a_sentence(find_ball, tmp_path, capsys, action):
    path = _changed(
        find_ball[0],
        tmp_path / "changed.mcap",
        payload=lambda _, name, content: (
            content | {"action": action} if name == "/step" and content["step"] else content
        ),
    )
    assert main(["replay", "--verify", str(path)]) == 2
    assert "is damaged: a step of it cannot be read" in capsys.readouterr().err


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
    path = tmp_path / "bomb.mcap"
    path.write_bytes(stream.getvalue())
    with pytest.raises(RecordingError, match="larger than 512 MiB when decompressed"):
        Recording.read(path)


def test_options_and_files_of_the_command(tmp_path, monkeypatch, capsys, find_ball):
    monkeypatch.chdir(tmp_path)
    assert main(["render", "cartpole", "--episodes", "2", "--json", "-o", "two.mcap"]) == 0
    (recording,) = json.loads(capsys.readouterr().out)["files"]
    assert recording["file"] == "two.mcap"
    assert [episode["episode"] for episode in recording["episodes"]] == [0, 1]
    assert main(["render", "cartpole", "-o", "two.mcap"]) == 2
    assert "two.mcap already exists" in capsys.readouterr().err
    assert main(["render", str(find_ball[0]), "--episode", "7", "--output", "x.gif"]) == 2
    assert "contains no episode 7; it contains 2 to 3" in capsys.readouterr().err
    assert main(["replay", "two.mcap", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["scenario"] == "CartPole"
