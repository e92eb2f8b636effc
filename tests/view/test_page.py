"""The page without a browser, and its server.

* The page without a browser: time, drivers, and files that change.
* The server of the page: who may call it, and what rubbish does to it.
* viser has the private members that deepbots uses, and one module names them.
"""

from __future__ import annotations

import http.client
import math
import os
import re
import signal
import socket
import threading
import time
from contextlib import closing, contextmanager, redirect_stdout, suppress
from io import StringIO
from pathlib import Path

import msgspec
import numpy as np
import pytest
import viser
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

import deepbots_cli.codegen
from deepbots_cli.cli import main
from deepbots_cli.document import shipped
from deepbots_cli.errors import UsageError
from deepbots_cli.frames import roll_pitch_yaw
from deepbots_cli.program import RANDOM
from deepbots_cli.rollout import Start
from deepbots_cli.rollout.drivers import HAND
from deepbots_cli.rollout.recordings import Recording
from deepbots_cli.view import server
from deepbots_cli.view.episodes import Showing
from deepbots_cli.view.frames import PlottedField
from deepbots_cli.view.page import Page
from deepbots_cli.view.playback import ManualInput
from deepbots_cli.view.replay import open_player
from tests.files import written
from tests.private_members import private_members

pytest.importorskip("viser")

CARTPOLE = (
    (Path(__file__).parents[2] / "scenarios" / "cartpole.yaml")
    .read_text(encoding="utf-8")
    .replace("../robots/urdf/cartpole.urdf", "cartpole")
)


CAMERA = {
    "type": "ViewerCameraMessage",
    "wxyz": (1, 0, 0, 0),
    "position": (0, -3, 2),
    "fov": 0.7,
    "near": 0.01,
    "far": 100.0,
    "image_height": 500,
    "image_width": 800,
    "look_at": (0, 0, 0),
    "up_direction": (0, 0, 1),
}
"""What a browser tells first."""


@contextmanager
def _browser(address):
    """Open a page as a browser does. The value is the connection for keys."""
    host, _, token = address.removeprefix("http://").rstrip("/").partition("/?token=")
    allowed = {
        "origin": f"http://{host}",
        "additional_headers": {"Cookie": f"deepbots-{host.rpartition(':')[2]}={token}"},
    }
    protocol = [f"viser-v{viser.__version__}"]
    with (
        connect(f"ws://{host}/", subprotocols=protocol, max_size=None, max_queue=None, **allowed) as browser,
        connect(f"ws://{host}/drive", **allowed) as keys,
    ):
        browser.send(msgspec.msgpack.encode(CAMERA))
        yield keys


def _client(page):
    """A browser that reads nothing; with a limit on what waits to be read, closing takes 10 s."""
    return connect(
        page.address.replace("http", "ws"),
        subprotocols=[f"viser-v{viser.__version__}"],
        max_size=None,
        max_queue=None,
    )


def _run(page, until, seconds=30.0):
    """Serve the page to a client until something holds, and say that it came to hold."""
    end = time.monotonic() + seconds
    with _client(page) as wire:
        wire.send(msgspec.msgpack.encode(CAMERA))
        page.run(lambda: until() or time.monotonic() > end)
    assert until()


def _control(page, label):
    handles = page.server.gui._gui_input_handle_from_uuid.values()
    return next(handle for handle in handles if handle.label == label)


@pytest.mark.parametrize(("goal", "color"), [(5, "#009E73"), (6, "#808080")])
def test_an_episode_that_reaches_the_return_of_a_solved_task_is_green(tmp_path, goal, color):
    path = tmp_path / "mine.yaml"
    short = CARTPOLE.replace("max_steps: 200", "max_steps: 5").replace(">= 195", f">= {goal}")
    path.write_text(short, encoding="utf-8")
    with closing(Page(Showing(str(path)), port=0, driver="zero")) as page:
        for _ in range(5):
            page.playback.step_once()
        assert page.player.frame.truncated
        assert f"return so far 5, goal {goal}" in page.banner.content
        assert color in page.banner.content


def test_keys_drive_and_let_go():
    with closing(Page(Showing("find_ball"), port=0, playing=True)) as page:
        assert page.player.driver_name == HAND
        page.playback.manual_input.hold(frozenset({"KeyW", "KeyD"}), ())
        page.playback.step_once()
        assert page.player.frame.agents["agent"].action == pytest.approx((1.0, 1.0))
        time.sleep(0.3)
        page.playback.step_once()
        assert page.player.frame.agents["agent"].action == pytest.approx((0.625, 0.0))
        assert page.playback.rival.driver_name == "onward"
        assert "onward" in page.banner.content


@pytest.mark.parametrize(
    "name", ["find_ball", "mine.yaml"]
)  # to the right is positive in one, and to the left in the other
def test_the_right_arrow_turns_the_robot_to_the_right(tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    assert main(["new", "mine", "--template", "wheeled", "--json"]) == 0
    with closing(Page(Showing(name), port=0, playing=True)) as page:
        yaws = []
        for key in ("ArrowRight", "ArrowLeft"):
            page.playback.begin()
            (robot,), before = page.player.env.world.robots, page.player.frame.links
            for _ in range(5):
                page.playback.manual_input.hold(frozenset({key}), ())
                page.playback.step_once()
            first, last = (
                roll_pitch_yaw(links[robot.name, robot.model.root][1])[2]
                for links in (before, page.player.frame.links)
            )
            yaws.append(math.remainder(last - first, math.tau))
        assert yaws[0] < -0.05
        assert yaws[1] > 0.05


def test_an_episode_waits_for_the_first_key_of_the_person_who_was_chosen_as_driver():
    with closing(Page(Showing("cartpole"), port=0)) as page:
        playback = page.playback
        playback.set_driver(HAND)
        playback.pass_time(0.5, continues=True)
        assert playback.waiting
        assert len(playback.worlds[0].frames) == 1
        playback.manual_input.hold(frozenset({"Digit1"}), ())
        playback.pass_time(0.5, continues=True)
        assert not playback.waiting
        assert len(playback.worlds[0].frames) > 1
        playback.begin()
        assert playback.waiting
        playback.manual_input.hold(frozenset({"Digit1"}), ())
        playback.manual_input.hold(frozenset(), ())  # a tap between two moments of the page
        playback.pass_time(0.5, continues=True)
        assert not playback.waiting
        playback.begin()
        playback.pass_time(0.5, continues=True)
        assert playback.waiting
        playback.set_driver(RANDOM)
        assert not playback.waiting


def test_released_keys_give_zero_where_the_range_holds_it():
    hand = ManualInput(
        [PlottedField("gas", "gas", -0.3, 1.0, ""), PlottedField("turn", "turn", 0.5, 1.0, "rad")],
        turns_left=True,
    )
    assert hand.values() == pytest.approx({"gas": -0.35 / 0.65, "turn": 0.0})
    assert (
        hand.help()
        == "W / up arrow: more gas; S / down arrow: less gas; A / left arrow: more turn; D / right arrow:"
        " less turn"
    )
    assert hand.effects()[0] == (("W", "up arrow"), "more gas")
    for keys, axes, values in (
        ({"KeyW", "KeyD"}, (), (1.0, -1.0)),
        ({"KeyS", "KeyA"}, (), (-1.0, 1.0)),
        (set(), (-0.5,), (-0.35 / 0.65, 0.5)),
    ):
        hand.hold(frozenset(keys), axes)
        assert tuple(hand.values().values()) == pytest.approx(values)


def test_rays_are_drawn_between_two_steps_as_the_robot_is(monkeypatch):
    lines_of = {}
    add = viser.SceneApi.add_line_segments

    def added(self, name, *arguments, **options):
        lines_of[name.rpartition("/")[2]] = lines = add(self, name, *arguments, **options)
        return lines

    monkeypatch.setattr(viser.SceneApi, "add_line_segments", added)
    with closing(Page(Showing("find_ball"), port=0, driver="around")) as page:
        ends = []
        for _ in range(2):
            page.playback.step_once()
            page.playback.worlds[0].scene.draw(1.0)
            ends.append(lines_of["rays"].points.copy())
        assert np.abs(ends[1] - ends[0]).max() > 1e-3
        page.playback.worlds[0].scene.draw(0.25)
        assert lines_of["rays"].points == pytest.approx(0.75 * ends[0] + 0.25 * ends[1], abs=1e-6)
        frame, layout = page.player.frame, page.player.reader.layout
        key = next(iter(layout.sensor_rays))
        lines = layout.sensor_rays[key].lines(frame, key)
        assert np.linalg.norm(lines[:, 1, :3] - lines[:, 0, :3], axis=1) == pytest.approx(
            frame.rays[key], abs=1e-6
        )


def test_a_link_without_visuals_shows_its_collision_shapes(tmp_path, monkeypatch):
    names = []
    add = viser.SceneApi.add_cylinder

    def added(self, name, *arguments, **options):
        names.append(name)
        return add(self, name, *arguments, **options)

    monkeypatch.setattr(viser.SceneApi, "add_cylinder", added)
    robot = shipped.robot_path("cartpole").read_text("utf-8")
    (tmp_path / "bare.urdf").write_text(re.sub(r"(?s)<visual>.*?</visual>", "", robot), encoding="utf-8")
    file = written(tmp_path / "mine.yaml", CARTPOLE.replace("urdf: cartpole\n", "urdf: bare.urdf\n"))
    with closing(Page(Showing(str(file)), port=0, driver="zero")):
        assert len([name for name in names if "/cart/wheel" in name]) == 4


def test_an_episode_that_was_driven_is_recorded_to_the_bit(tmp_path, monkeypatch):
    pytest.importorskip("mcap")
    monkeypatch.chdir(tmp_path)
    with closing(Page(Showing("find_ball"), port=0, playing=True, seed=4)) as page:
        assert "press a key to begin" in page.banner.content
        for keys in ({"KeyW"}, {"KeyW", "KeyD"}, {"KeyA"}):
            page.playback.manual_input.hold(frozenset(keys), ())
            page.playback.step_once()
        page.playback.record()
        page.playback.record()
        driven = page.player.frame
    with closing(open_player(Showing("find_ball-4-0-played1.mcap").open())) as replayed:
        *_, last = replayed.episode(4, 0, 3)
        assert (last.links, replayed.recording.metadata["driver"]) == (driven.links, HAND)


def _banner(page):
    page.panel.update_texts()
    return page.banner.content


def _drive_to_the_end(page):
    while page.player.frame.ended_by is None:
        page.playback.manual_input.hold(frozenset({"KeyD"}), ())
        page.playback.step_once()


def test_only_whole_episodes_of_the_person_are_recorded(tmp_path, monkeypatch, deepbots):
    pytest.importorskip("mcap")
    path = tmp_path / "drive.mcap"
    with closing(Page(Showing("cartpole"), port=0, playing=True, seed=4, output=path)) as page:
        page.playback.step_once()
        page.playback.begin()  # which leaves out the episode before
        assert not path.exists()
        _drive_to_the_end(page)
        first = path.read_bytes()
        assert "1 episode recorded in drive.mcap<" in _banner(page)
        page.playback.set_driver("zero")
        _drive_to_the_end(page)
        assert path.read_bytes() == first
        assert "not this one, which zero drives" in _banner(page)
        page.playback.set_driver(HAND)
        page.playback.set_seed(5)
        _drive_to_the_end(page)
        monkeypatch.setattr("deepbots_cli.view.recordings.MAX_DRIVEN_BYTES", len(path.read_bytes()))
        second = path.read_bytes()
        page.playback.begin(1)
        _drive_to_the_end(page)
        assert "it takes no more, since the next one goes beyond" in _banner(page)
        assert path.read_bytes() == second
    recording = Recording.read(path)
    seeds = [Start.of_evaluation(seed, 0).seed for seed in (4, 5)]
    assert [(each.number, each.seed) for each in recording.episodes] == list(enumerate(seeds))
    assert "2 episodes" in deepbots("replay", "--verify", path).out


def test_the_world_stands_still_while_its_page_is_hidden():
    with closing(Page(Showing("cartpole"), port=0, driver="zero")) as page:

        def begins_within(seconds):
            """Whether a step is made within this time."""
            begin = page.player.frame.time
            end = time.monotonic() + seconds
            while page.player.frame.time == begin and time.monotonic() < end:
                time.sleep(0.01)
            return page.player.frame.time != begin

        ended = threading.Event()
        server = threading.Thread(target=page.run, args=(ended.is_set,))
        server.start()
        try:
            assert not begins_within(0.5)
            with _browser(page.address) as keys:
                assert begins_within(20)
                keys.send("||hidden")
                assert any(not begins_within(0.5) for _ in range(20))
                keys.send("||")
                assert begins_within(20)
                keys.send("||hidden")
            assert not begins_within(0.5)
            with _browser(page.address):
                assert begins_within(20)
        finally:
            ended.set()
            server.join()


def _driven(capsys, path, *words):
    """Play by holding a key in a browser until an episode has ended, and end the command. Returns its
    output."""

    def drive():
        try:
            while not (address := capsys.readouterr().out.strip()):
                time.sleep(0.05)
            with _browser(address) as keys:
                end = time.monotonic() + 30.0
                while not path.exists() and time.monotonic() < end:
                    keys.send("KeyD||")
                    time.sleep(0.05)
        finally:
            os.kill(os.getpid(), signal.SIGTERM)

    person = threading.Thread(target=drive)
    person.start()
    assert main(["play", *words, "--port", "0", "--output", str(path)]) == 130
    person.join()
    return capsys.readouterr()


def test_driven_episodes_are_in_the_file_when_the_command_is_ended(tmp_path, capsys):
    pytest.importorskip("mcap")
    path = tmp_path / "drive.mcap"
    output = _driven(capsys, path, "cartpole")
    assert f"{path} (1 episode, " in output.out
    for following in (f"deepbots replay --verify {path}", f"deepbots train cartpole --teacher {path}"):
        assert following in output.err
    assert main(["replay", "--verify", str(path)]) == 0
    assert main(["play", "cartpole", "--output", str(path)]) == 2
    assert "already exists; overwrite it with --force" in capsys.readouterr().err


@pytest.fixture
def steep(tmp_path, monkeypatch):
    pytest.importorskip("mcap")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "steep.yaml").write_text(
        "deepbots: 1\nextends: cartpole\ntruncation: {max_steps: 3}\ncurriculum: [{name: first}]\n"
        "evaluation: {cases: {steep: {set: {world.gravity: 0 0 -12 m/s^2}}}}\n"
    )
    return tmp_path / "drive.mcap"


def test_the_command_that_trains_by_driven_episodes_has_the_options_of_the_session(steep, capsys):
    session = "--stage first --engine mujoco"
    output = _driven(capsys, steep, "steep.yaml", *session.split(), "--allow-code")
    assert f"deepbots train steep.yaml {session} --teacher {steep} --allow-code\n" in output.err


def test_episodes_of_a_case_teach_nothing(steep, capsys):
    (following,) = re.findall(r"deepbots \w+", _driven(capsys, steep, "steep.yaml", "--case", "steep").err)
    assert following == "deepbots replay"
    assert main(["train", "steep.yaml", "--timesteps", "1000", "--teacher", str(steep)]) == 2
    assert "its episodes ran in the case 'steep'" in capsys.readouterr().err


def test_driven_episodes_of_rivals_have_no_sum_of_their_returns(steep, capsys):
    output = _driven(capsys, steep, "sumo", "--set", "truncation.max_time=1 s")
    assert "return" not in output.out
    assert "deepbots train" not in output.err  # a recording teaches one agent


@pytest.mark.parametrize("kind", ["playing", "embedded"])
def test_a_page_to_play_in_or_in_another_page_asks_for_its_token_on_loopback(kind):
    with closing(Page(Showing("cartpole"), port=0, **{kind: True})) as page:
        address, _, token = page.address.partition("?token=")
        assert len(token) > 16
        with pytest.raises(InvalidStatus, match="403"):  # a program of another user of the machine
            connect(address.replace("http", "ws"), subprotocols=[f"viser-v{viser.__version__}"])


def test_a_page_to_play_in_records_up_to_a_limit(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("deepbots_cli.view.playback.MAX_RECORDINGS", 2)
    monkeypatch.setattr("deepbots_cli.view.playback.record", lambda player, path, *_, **__: path.touch())
    with closing(Page(Showing("cartpole"), port=0, playing=True)) as page:
        for _ in range(30):
            page.playback.record()
    assert len(list(tmp_path.iterdir())) == 2


def test_a_value_that_no_control_offers_changes_nothing_and_prints_nothing(capfd):
    with closing(Page(Showing("find_ball"), port=0)) as page:
        handles = {handle.label: handle for handle in page.server.gui._gui_input_handle_from_uuid.values()}
        wrong = {
            "driver": ["nobody", 5],
            "seed": [-1, "x", 1e300],
            "speed": [0, 99.0, "fast", math.nan],
            "time": ["explode", [1]],
        }
        updates = [(handles[name]._impl.uuid, {"value": value}) for name in wrong for value in wrong[name]]
        updates += [
            (handles["driver"]._impl.uuid, {"props": 5}),
            ("nothing", {"value": 1}),
            (handles["seed"]._impl.uuid, {"value": 7}),
        ]
        with _client(page) as wire:
            wire.send(msgspec.msgpack.encode(CAMERA))
            for uuid, update in updates:
                wire.send(
                    msgspec.msgpack.encode({"type": "GuiUpdateMessage", "uuid": uuid, "updates": update})
                )
            end = time.monotonic() + 30.0
            page.run(lambda: page.playback.seed == 7 or time.monotonic() > end)
        assert page.playback.seed == 7  # all of them have arrived, and the last one counts
        assert (page.playback.speed, page.player.driver_name) == (1.0, "onward")
    assert "Traceback" not in capfd.readouterr().err


def test_hands_know_options_by_their_names():
    hand = ManualInput([PlottedField("move", "move", 0, 2, "", ("left", "right", "stop"))])
    assert hand.values() == {"move": 2.0}
    hand.hold(frozenset({"ArrowLeft"}), ())
    assert hand.values() == {"move": 0.0}
    hand.hold(frozenset({"Digit2"}), ())
    assert hand.values() == {"move": 1.0}
    hand.hold(frozenset(), ())
    assert hand.values() == {"move": 2.0}


def test_the_arrows_to_the_sides_also_drive_where_nothing_turns():
    hand = ManualInput([PlottedField("drive", "drive", 0, 1, "", ("forward", "backward"))])
    for key, option in (("ArrowRight", 0.0), ("ArrowLeft", 1.0)):
        hand.hold(frozenset({key}), ())
        assert hand.values() == {"drive": option}
    assert (("W", "up arrow", "right arrow"), "forward") in hand.effects()


@pytest.mark.parametrize("is_moved", [False, True])
def test_a_longer_robot_is_seen_from_the_place_before_for_a_moment(tmp_path, monkeypatch, is_moved):
    monkeypatch.setattr("deepbots_cli.view.scene._SETTLING_S", 0.5)
    file = written(tmp_path / "mine.yaml", CARTPOLE)
    with closing(Page(Showing(str(file)), port=0, driver="zero")) as page, _client(page) as wire:

        def serve(seconds):
            end = time.monotonic() + seconds
            page.run(lambda: time.monotonic() > end)

        def place():
            (client,) = page.server.get_clients().values()
            return tuple(client.camera.position)

        wire.send(msgspec.msgpack.encode(CAMERA))
        serve(1.0)
        if is_moved:
            wire.send(msgspec.msgpack.encode({**CAMERA, "position": (3.0, 3.0, 3.0)}))
            serve(0.5)
        before = place()
        file.write_text(
            CARTPOLE.replace("urdf: cartpole\n", "urdf: cartpole\n    links: {pole: {scale: 1 1 3}}\n")
        )
        page.reload()
        assert place() == before
        serve(1.0)
        assert (place() == before) is is_moved


def test_a_saved_file_shows_its_findings_and_then_its_world(tmp_path):
    file = written(tmp_path / "mine.yaml", CARTPOLE)
    with closing(Page(Showing(str(file)), port=0, watch=True, seed=3)) as page:
        _run(page, lambda: page.player.frame.step > 1)
        world = page.player
        file.write_text(CARTPOLE.replace("fall_angle", "fall_angel", 1))
        _run(page, lambda: "mine.yaml" in page.banner.content)
        assert page.player is world
        step = page.player.frame.step
        page.playback.pass_time(1.0, continues=True)
        assert page.player.frame.step == step
        assert "fall_ang" in page.banner.content
        began = time.monotonic()
        file.write_text(CARTPOLE.replace("timestep: ", "timestep:  ", 1))
        _run(page, lambda: page.player is not world)
        assert time.monotonic() - began < 2.0 or os.getloadavg()[0] > 4
        assert page.playback.seed == 3
        assert page.playback.stopped is None
        assert page.playback.paused is False


def test_a_page_that_its_user_paused_stays_paused_after_an_error_is_fixed(tmp_path):
    file = written(tmp_path / "mine.yaml", CARTPOLE)
    with closing(Page(Showing(str(file)), port=0)) as page:
        page.playback.play(False)
        for text in (CARTPOLE.replace("fall_angle", "fall_angel", 1), CARTPOLE):
            file.write_text(text)
            page.reload()
        assert page.playback.stopped is None
        assert page.playback.paused


@pytest.mark.parametrize("driver", ["backward", "forward,backward"])
def test_a_saved_file_leaves_the_actions_that_drive_the_page(tmp_path, driver):
    file = written(tmp_path / "mine.yaml", CARTPOLE)
    with closing(Page(Showing(str(file)), port=0, driver=driver)) as page:
        file.write_text(CARTPOLE.replace("timestep: ", "timestep:  ", 1))
        page.reload()
        assert page.player.driver_name == driver


def test_a_page_goes_on_with_its_default_driver_when_a_script_goes(tmp_path):
    file = written(tmp_path / "mine.yaml", CARTPOLE + "scripts: {onward: {drive: forward}}\n")
    with closing(Page(Showing(str(file)), port=0, driver="onward")) as page:
        file.write_text(CARTPOLE)
        page.reload()
        assert page.player.driver_name == "random"


def test_a_page_shows_a_saved_file_of_the_scenario_beside(tmp_path):
    one, other = tmp_path / "one.yaml", tmp_path / "other.yaml"
    one.write_text(CARTPOLE)
    other.write_text(CARTPOLE)
    compare = Showing(str(other))
    with closing(Page(Showing(str(one)), compare=compare, port=0, watch=True)) as page:
        for text, has_errors in (
            (CARTPOLE.replace("fall_angle", "fall_angel", 1), True),
            (CARTPOLE.replace("timestep: 32 ms", "timestep: 16 ms"), False),
        ):
            other.write_text(text)
            _run(page, lambda has_errors=has_errors: bool(page.playback.stopped) is has_errors)
        assert page.playback.worlds[1].player.program.world.timestep == 0.016


@pytest.mark.slow
def test_a_save_while_the_one_before_is_read_is_not_lost(tmp_path, monkeypatch):
    file = written(tmp_path / "mine.yaml", CARTPOLE)
    with closing(Page(Showing(str(file)), port=0, watch=True)) as page:
        read = Showing.open
        world = page.player
        saves = [CARTPOLE.replace("timestep: ", "timestep:  ", 1)]

        def read_and_save(self):
            opened = read(self)
            if saves:
                file.write_text(saves.pop())
            return opened

        monkeypatch.setattr(Showing, "open", read_and_save)
        file.write_text("")
        _run(page, lambda: page.player is not world)
        assert page.playback.stopped is None


def test_a_scenario_with_errors_opens_with_its_findings(tmp_path):
    file = written(tmp_path / "mine.yaml", CARTPOLE.replace("velocity_motor", "velocity_moto<b>r", 1))
    with closing(Page(Showing(str(file)), port=0, watch=True)) as page:
        assert page.player is None
        assert "mine.yaml" in page.banner.content
        assert "<b>r" not in page.banner.content
        file.write_text(CARTPOLE)
        _run(page, lambda: page.player is not None)


def test_a_source_that_cannot_be_opened_is_an_error(deepbots):
    with pytest.raises(UsageError, match="no file, folder or shipped scenario"):
        Page(Showing("nothing_here"), port=0)
    with pytest.raises(UsageError, match="there is no driver 'nobody'"):
        Page(Showing("find_ball"), port=0, driver="nobody")
    for wrong, message in (
        (["find_ball", "--world", "3"], "there is no world 3; add --worlds N"),
        (["find_ball", "--worlds", "4", "--world", "4"], "--worlds 4 creates the worlds 0 to 3"),
        (["find_ball", "--worlds", "4", "--driver", "around"], "'around' cannot drive a batch"),
        (["find_ball", "--worlds", "4", "--engine", "pybullet"], "the engine 'pybullet' has no batches"),
        (["see_ball", "--worlds", "4"], "it has cameras"),
    ):
        assert message in deepbots("view", *wrong, code=2).err


def test_a_recording_is_played_and_scrubbed(tmp_path):
    pytest.importorskip("mcap")
    path = tmp_path / "cartpole.mcap"
    assert main(["render", "cartpole", "--episodes", "2", "--output", str(path)]) == 0
    with closing(Page(Showing(str(path)), port=0)) as page:
        page.playback.play(False)
        page.playback.seek(7)
        assert [frame.step for frame in page.playback.worlds[0].frames] == list(range(8))
        assert "step 7," in page.banner.content
        page.panel.update_texts()
        assert page.panel.slider.value == 7
        page.playback.play(True)
        _run(page, lambda: page.player.frame.ended_by is not None)
        page.playback.begin(1)
        assert page.playback.episode == 1
        page.playback.begin(1)
        assert page.playback.episode == 0
        page.playback.seek(page.player.length - 1)
        page.playback.step_once()
        assert page.playback.episode == 1


@pytest.mark.slow
def test_two_worlds_begin_alike_and_go_on_until_both_have_ended():
    with closing(Page(Showing("cartpole"), compare=Showing("cartpole"), port=0, driver="zero")) as page:
        first, second = page.playback.worlds
        page.playback.speed = 5.0
        assert first.player.frame.links == second.player.frame.links
        assert first.player.seed == second.player.seed
        _run(page, lambda: first.has_ended and second.has_ended)
        assert "A: cartpole" in page.banner.content
        assert "B: cartpole" in page.banner.content


def test_the_plots_are_those_of_the_scenario_whose_robot_is_chosen():
    with closing(Page(Showing("line_follower"), compare=Showing("cartpole"), port=0, driver="zero")) as page:
        _control(page, "field").value = "action: turn"
        _control(page, "robot").value = "B: cartpole: agent"
        _run(page, lambda: "x" in _control(page, "field").options)
        page.panel.update()


def test_a_page_shows_one_world_of_a_batch_after_another():
    batch = Showing("cartpole", engine="mujoco", worlds=4)
    with (
        closing(Page(batch, port=0, driver="zero", world=3)) as page,
        closing(Page(Showing("cartpole", engine="mujoco"), port=0)) as single,
    ):
        single.playback.episode = 3
        single.playback.begin()
        assert page.player.frame.links == single.player.frame.links
        assert "episode 3, step 0" in page.banner.content
        assert "world 3 of 4 (running 4)" in page.banner.content
        third = page.player.frame
        page.playback.choose_world(1)
        assert page.player.frame.links != third.links
        assert len(page.playback.worlds[0].frames) == 1
        _run(page, lambda: page.player.frame.step > 3)
        assert page.player.batch.step_count.min() > 3
        page.playback.begin(1)
        assert "episode 5, step 0" in page.banner.content


def test_time_does_not_stand_still_at_a_chosen_world_whose_episode_has_ended():
    with closing(Page(Showing("cartpole", engine="mujoco", worlds=4), port=0, driver="random")) as page:
        while "running 4" in page.player.note:
            page.playback.step_once()
        for world in range(4):
            if page.player.frame.ended_by is None:
                page.playback.choose_world(world)
        page.playback.step_once()
        assert page.playback.episode == 4


def test_a_changed_parameter_counts_at_the_same_seed():
    with closing(Page(Showing("find_ball"), port=0)) as page:
        start, panel = page.player.frame.links, page.panel.values
        page.change_parameter("goal", "31 cm")
        old = page.player
        _run(page, lambda: page.player is not old)
        assert page.playback.worlds[0].frames[0].links == start
        assert page.panel.values is panel  # and the panel stays as it is
        assert "0.31" in deepbots_cli.codegen.generate_module(page.player.program)
        page.change_parameter("goal", "31 kg")
        _run(page, lambda: "DB503" in page.banner.content)
        page.change_parameter("goal", "20 cm")
        _run(page, lambda: "DB503" not in page.banner.content)


def test_a_slider_begins_at_the_value_that_was_saved(tmp_path):
    file = written(tmp_path / "mine.yaml", CARTPOLE)
    with closing(Page(Showing(str(file)), port=0)) as page:
        assert _control(page, "fall_angle (deg)").value == 15.0
        file.write_text(CARTPOLE.replace("15 deg", "12 deg", 1))
        page.reload()
        assert _control(page, "fall_angle (deg)").value == 12.0


def test_a_parameter_that_has_to_be_whole_has_whole_steps_and_a_vector_no_slider():
    with closing(Page(Showing("find_and_avoid"), port=0)) as page:
        assert _control(page, "obstacles").step == 1.0
    with closing(Page(Showing("quadrotor"), port=0)) as page:
        assert _control(page, "home").value == "0 0 1 m"


def test_messages_are_shown_with_their_age():
    with closing(Page(Showing("cartpole_wireless"), port=0)) as page:
        page.playback.step_once()
        page.panel.update_texts()
        assert "message to cart" in page.panel.values.content
        assert re.findall(r"\d+ ms old", page.panel.values.content) == 2 * ["32 ms old"]


@pytest.fixture
def page():
    """The port of a server on loopback, and what arrived by `/drive`."""
    arrived: list[object] = []
    running, address = server.serve(
        server.LOOPBACK, 0, "test", lambda keys, axes: arrived.append((keys, axes))
    )
    assert address == f"http://127.0.0.1:{running.get_port()}/"
    yield running.get_port(), arrived
    server.stop(running)


def _get(port, path="/", **headers):
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=10)
    connection.request(
        "GET", path, headers={name.replace("_", "-"): value for name, value in headers.items()}
    )
    answer = connection.getresponse()
    body = answer.read()
    connection.close()
    return answer, body


def _open(port, path="/", origin=None, cookie=None, protocol=f"viser-v{viser.__version__}"):
    headers = {"Cookie": cookie} if cookie else {}
    return connect(
        f"ws://127.0.0.1:{port}{path}",
        origin=origin,
        subprotocols=[protocol],
        additional_headers=headers,
        max_size=None,
    )


def test_it_serves_its_page_with_keys_and_no_other_source(page):
    answer, body = _get(page[0])
    assert answer.status == 200
    assert b'WebSocket("drive")' in body
    assert "connect-src 'self'" in answer.headers["Content-Security-Policy"]


@pytest.mark.parametrize(
    "path",
    [
        "/etc/passwd",
        "/../../../etc/passwd",
        "/%2e%2e/%2e%2e/etc/passwd",
        "/index.html",
        "//etc/passwd",
        "/x\\y",
    ],
)
def test_it_serves_no_file(page, path):
    answer, body = _get(page[0], path)
    assert answer.status == 404
    assert b"root:" not in body


def test_beyond_loopback_a_token_is_asked_for():
    running, address = server.serve("0.0.0.0", 0, "test", lambda keys, axes: None)
    try:
        port = running.get_port()
        token = address.partition("?token=")[2]
        assert len(token) > 16
        assert (_get(port)[0].status, _get(port, "/?token=wrong")[0].status) == (403, 403)
        answer, _ = _get(port, f"/?token={token}")
        cookie = answer.headers["Set-Cookie"].partition(";")[0]
        assert (answer.status, answer.headers["Location"]) == (302, "/")
        assert "HttpOnly" in answer.headers["Set-Cookie"]
        assert (_get(port, Cookie=cookie)[0].status, _get(port, Cookie=cookie + "x")[0].status) == (200, 403)
        origin = f"http://127.0.0.1:{port}"
        for path in ("/", "/drive"):
            with pytest.raises(InvalidStatus, match="403"):
                _open(port, path, origin=origin)
            _open(port, path, origin=origin, cookie=cookie).close()
        assert _get(port, Host=f"evil.example:{port}", Cookie=cookie)[0].status == 403
    finally:
        server.stop(running)


def test_an_abbreviated_address_is_loopback():
    running, address = server.serve("127.1", 0, "test", lambda keys, axes: None)
    server.stop(running)
    assert address == f"http://127.0.0.1:{running.get_port()}/"


def test_keys_and_axes_arrive_and_rubbish_does_not(page, capfd):
    port, arrived = page
    origin = f"http://127.0.0.1:{port}"
    for text in ("KeyW|a,b|", b"\x00\xff", "x" * 1000, "KeyW|" + "1," * 90 + "|", "KeyW|", "|||"):
        with _open(port, "/drive", origin=origin) as wire:
            wire.send(text)
    with _open(port, "/drive", origin=origin) as wire:
        wire.send("KeyW+KeyA|0.5,-7|")
        wire.send("|nan,0.25|hidden")
        held = (frozenset({"KeyW", "KeyA"}), (0.5, -1.0))
        for sent in (held, (frozenset(), (0.0, 0.25))):
            end = time.monotonic() + 10
            while sent not in arrived and time.monotonic() < end:
                time.sleep(0.01)
            assert sent in arrived
    assert all(-1.0 <= value <= 1.0 for _, axes in arrived for value in axes)
    assert capfd.readouterr().err == ""


def test_rubbish_to_viser_changes_nothing_and_prints_nothing(page, capfd):
    port, _ = page
    origin = f"http://127.0.0.1:{port}"
    for message in (
        b"",
        b"\x00" * 100,
        b"\xff" * 10_000,
        "text",
        b"\x93\x01\x02\x03",
        b"\xdf\xff\xff\xff\xff",
        b"x" * (server.MAX_MESSAGE_BYTES + 1),
    ):
        with suppress(OSError, TimeoutError, ConnectionClosed), _open(port, origin=origin) as wire:
            wire.send(message)
            wire.recv(timeout=0.3)
    with socket.create_connection(("127.0.0.1", port)) as raw:
        raw.sendall(b"\x16\x03\x01 rubbish \r\n\r\n")
    time.sleep(0.3)
    assert _get(port)[0].status == 200
    printed = capfd.readouterr()
    assert "Traceback" not in printed.out + printed.err


def test_fifty_closed_connections_leave_nothing_behind(page):
    port, _ = page
    origin = f"http://127.0.0.1:{port}"

    def opened() -> tuple[int, int]:
        return len(os.listdir("/proc/self/fd")), threading.active_count()

    def connect() -> None:
        with _open(port, origin=origin) as wire:
            wire.recv(timeout=5)

    for _ in range(3):
        connect()
    before = opened()
    for _ in range(50):
        connect()
    end = time.monotonic() + 10
    while any(now > then for now, then in zip(opened(), before, strict=True)) and time.monotonic() < end:
        time.sleep(0.05)
    assert opened() <= before


def test_another_version_of_the_page_is_refused(page):
    with pytest.raises(InvalidStatus, match="400"):
        _open(page[0], origin=f"http://127.0.0.1:{page[0]}", protocol="viser-v0.0.1")


def test_a_port_in_use_and_an_unknown_host_are_errors(page):
    with pytest.raises(UsageError, match=f"port {page[0]} of 127.0.0.1 is in use"):
        server.serve(server.LOOPBACK, page[0], "test", lambda keys, axes: None)
    with pytest.raises(UsageError, match="there is no host"):
        server.serve("no-such-host.invalid", 0, "test", lambda keys, axes: None)


MODULE = Path(server.__file__)
USERS = [
    path for path in sorted(MODULE.parent.glob("*.py")) if "viser" in path.read_text() and path != MODULE
]


def test_the_library_has_each_private_member() -> None:
    with redirect_stdout(StringIO()):
        page = viser.ViserServer(server.LOOPBACK, 0, verbose=False)
    try:
        box = page.gui.add_checkbox("Box", initial_value=True)
        used = {name for _, name in private_members(MODULE)}
        assert len(used) == 5
        parts = (viser, page.gui, box)
        assert {name for name in used if not any(hasattr(part, name) for part in parts)} == set()
        assert page.gui._gui_input_handle_from_uuid[box._impl.uuid]._impl.value is True
    finally:
        server.stop(page)


@pytest.mark.parametrize("path", USERS, ids=lambda path: path.stem)
def test_no_other_module_names_a_private_member(path: Path) -> None:
    assert [*private_members(path)] == []
