"""`deepbots webots --view`: the page of a run, its pace, and keys for a Keyboard.

Cameras and range finders of worlds, drawn with OpenGL.
"""

from __future__ import annotations

import http.client
import math
import os
import re
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("viser")

import imageio.v3 as iio
import msgspec
import viser
import zstandard
from websockets.exceptions import InvalidStatus
from websockets.sync.client import ClientConnection, connect

from deepbots_cli.engines.mujoco import cameras
from deepbots_cli.view import server
from deepbots_webots import supervisor
from deepbots_webots.project import Program
from deepbots_webots.runner import Runner
from deepbots_webots.scene import build_scene
from deepbots_webots.sensors import NotImplementedCallError
from deepbots_webots.shapes import MAX_PICTURE_BYTES
from deepbots_webots.simulation import MAX_DELAY_S, Pace, Simulation
from deepbots_webots.supervisor import Keyboard
from deepbots_webots.tree import Node
from deepbots_webots.viewer import FRAME_RATE, Viewer
from tests.commands import until
from tests.files import written
from tests.view.browser import CHROMIUM, browser
from tests.view.test_page import CAMERA
from tests.webots.conftest import Project
from tests.webots.exported_projects import HEADER, device, read, simulate, solid

ROOT = Path(__file__).parents[2]
SHAPES = """Solid { children [ Shape { geometry Plane { size 3 3 } } Shape { geometry Cone { } }
  Shape { geometry ElevationGrid { xDimension 3 yDimension 3 height [ 0 0 0 0 1 0 0 0 0 ] } }
  Shape { geometry Capsule { } } Shape { geometry Cylinder { } } Shape { geometry Sphere { } }
  Shape { geometry IndexedFaceSet { coord Coordinate { point [ 0 0 0 1 0 0 0 1 0 0 0 1 ] }
    coordIndex [ 0 2 1 -1 0 1 3 -1 1 2 3 -1 2 0 3 -1 ] } } ] }"""
BALL = solid("Sphere { radius 0.2 }", "translation 0 0 2 children [ Shape { geometry Sphere { } } ]")


class Page:
    """What a browser asks a viewer for."""

    def __init__(self, viewer: Viewer) -> None:
        self.origin, _, self.token = viewer.address.partition("/?token=")
        self.port = int(self.origin.rpartition(":")[2])

    def get(self, path: str = "/", cookie: str = "") -> http.client.HTTPResponse:
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=10)
        connection.request("GET", path, headers={"Cookie": cookie} if cookie else {})
        answer = connection.getresponse()
        answer.read()
        connection.close()
        return answer

    @property
    def cookie(self) -> str:
        return self.get(f"/?token={self.token}").headers["Set-Cookie"].partition(";")[0]

    def open(self, path: str = "/", cookie: str = "") -> ClientConnection:
        return connect(
            f"ws://127.0.0.1:{self.port}{path}",
            origin=self.origin,
            subprotocols=[f"viser-v{viser.__version__}"],
            additional_headers={"Cookie": cookie},
            max_size=None,
            max_queue=None,
        )


@contextmanager
def viewed(simulation: Simulation, pace: Pace | None = None) -> Iterator[tuple[Viewer, Page]]:
    """A viewer of a world, which `supervisor` acts on."""
    pace = pace or Pace(simulation, is_fast=True)
    with Viewer(simulation, pace, "w.wbt", server.LOOPBACK, 0) as viewer:
        supervisor.activate(simulation)
        try:
            yield viewer, Page(viewer)
        finally:
            supervisor.deactivate()


def _messages(wire: ClientConnection) -> list[dict[str, Any]]:
    """The next messages of viser, which come packed behind a header of 16 bytes."""
    packet = wire.recv(timeout=20)
    assert isinstance(packet, bytes)
    text = zstandard.ZstdDecompressor().decompressobj().decompress(packet[16:])
    return msgspec.msgpack.decode(text)["messages"]


def _positions(wire: ClientConnection) -> dict[str, tuple[float, float, float]]:
    """The next positions that a browser gets, by node."""
    while True:
        moved = [each for each in _messages(wire) if each["type"] == "SetPositionMessage"]
        if moved:
            return {each["name"]: each["position"] for each in moved}


# The page


def test_the_page_and_its_sockets_need_the_token():
    with viewed(simulate(BALL)) as (_, page):
        assert page.get("/?token=wrong").status == 403
        for path in ("/", "/drive"):
            with pytest.raises(InvalidStatus, match="403"):
                page.open(path)


def test_a_browser_gets_each_shape_and_then_what_moves():
    simulation = simulate(SHAPES + BALL)
    with viewed(simulation) as (viewer, page), page.open(cookie=page.cookie) as wire:
        wire.send(msgspec.msgpack.encode(CAMERA))
        kinds = {each["name"]: each["type"] for each in _messages(wire) if "props" in each and "name" in each}
        assert [kinds[f"/world/0/shape{number}"] for number in range(7)] == [
            *("MeshMessage", "MeshMessage", "GlbMessage", "MeshMessage", "CylinderMessage"),
            *("IcosphereMessage", "MeshMessage"),
        ]
        assert kinds["/world/1/shape7"] == "IcosphereMessage"
        _fall(simulation, viewer)
        moved = _positions(wire)
        assert moved["/world/1"] == pytest.approx(simulation.physics.poses()[1, :3])
        assert "/world/0" not in moved


def test_a_browser_gets_the_color_of_the_sky():
    simulation = simulate(BALL + "Background { skyColor [ 0 0.4 0.8 ] }")
    with viewed(simulation) as (_, page), page.open(cookie=page.cookie) as wire:
        wire.send(msgspec.msgpack.encode(CAMERA))
        sky = next(each for each in _messages(wire) if each["type"] == "BackgroundImageMessage")
    assert iio.imread(sky["rgb_data"])[0, 0].astype(int) == pytest.approx([0, 102, 204], abs=8)


def test_the_world_moves_below_a_viewpoint_that_follows():
    view = 'Viewpoint { position -5 0 1 follow "ball" }'
    simulation = simulate(view + BALL.replace("DEF BODY Solid {", 'DEF BODY Solid { name "ball"'))
    with viewed(simulation) as (viewer, page), page.open(cookie=page.cookie) as wire:
        wire.send(msgspec.msgpack.encode(CAMERA))
        _messages(wire)
        _fall(simulation, viewer)
        moved = _positions(wire)
        assert moved["/world/0"][2] < 1.9
        assert moved["/world"] == pytest.approx((0.0, 0.0, 2.0 - moved["/world/0"][2]))


def _fall(simulation: Simulation, viewer: Viewer) -> None:
    """Run for 0.2 s, and let the viewer see where it led."""
    for _ in range(25):
        simulation.run_step()
    time.sleep(1 / FRAME_RATE)
    viewer()


# Keys


def test_keys_of_the_page_reach_the_keyboard_and_are_released(capsys):
    simulation = simulate(BALL, step=8)
    with viewed(simulation) as (_, page):
        keyboard, other = Keyboard(), Keyboard()
        keyboard.enable(8)
        other.enable(16)
        shift_a = ord("A") + Keyboard.SHIFT
        with page.open("/drive", page.cookie) as wire:
            for keys, reader, expected in (
                ([shift_a, Keyboard.LEFT], keyboard, [shift_a, Keyboard.LEFT, -1]),
                ([shift_a, Keyboard.LEFT], other, [shift_a, Keyboard.LEFT, -1]),
                ([*range(65, 75)], keyboard, [*range(65, 72), -1]),
            ):
                until(lambda: _pressed(simulation, reader, len(expected), wire, keys) == expected)  # noqa: B023
        until(lambda: _pressed(simulation, keyboard, 1) == [-1], 2.0)
        keyboard.disable()
        assert (keyboard.getSamplingPeriod(), keyboard.getKey()) == (0, -1)
    assert capsys.readouterr().err == ""


def _pressed(
    simulation: Simulation,
    keyboard: Keyboard,
    count: int,
    wire: ClientConnection | None = None,
    keys: Sequence[int] = (),
) -> list[int]:
    """Hold keys on the page for a step, and return the first keys that a keyboard reads."""
    if wire is not None:
        wire.send("+".join(map(str, keys)) + "||")
    simulation.run_step()
    return [keyboard.getKey() for _ in range(count)]


def test_rubbish_for_keys_presses_none():
    with pytest.raises(ValueError, match="KeyW"):
        Viewer.hold(object(), ["KeyW"], {})


# Time


def test_a_world_in_real_time_waits_and_does_not_catch_up():
    simulation = simulate(BALL, step=20)
    pace = Pace(simulation, is_fast=False)
    begin = time.monotonic()
    for _ in range(10):
        pace.wait()
        simulation.run_step()
    assert time.monotonic() - begin > 0.17
    time.sleep(0.4)  # such as the training of a controller
    begin = time.monotonic()
    for _ in range(20):
        pace.wait()
        simulation.run_step()
    assert time.monotonic() - begin > 0.38 - MAX_DELAY_S


def paused(folder: Path, **options: float) -> tuple[Pace, Runner]:
    """Return a run of a controller that only steps, and its pace, which is paused."""
    program = written(
        folder / "c.py", "from controller import Robot\nrobot = Robot()\nwhile robot.step(8) != -1: pass\n"
    )
    simulation = simulate('Robot { controller "c" }')
    pace = Pace(simulation, is_fast=True)
    pace.pause()
    return pace, Runner(
        simulation, [(simulation.scene.robots[0], Program("c", program))], pace=pace, **options
    )


def test_a_paused_world_makes_single_steps_and_no_timeout_ends_it(tmp_path):
    pace, runner = paused(tmp_path, steps=40, timeout=0.3)
    simulation = runner.simulation
    outcomes = []
    thread = threading.Thread(target=lambda: outcomes.append(runner.run()))
    thread.start()
    time.sleep(1.0)
    assert simulation.ticks == 0
    for _ in range(3):
        pace.step_once()
    until(lambda: simulation.ticks == 3 * 8)
    time.sleep(0.1)
    assert simulation.ticks == 3 * 8
    pace.run(is_fast=True)
    thread.join(20)
    assert [(outcome.exit_code, outcome.steps) for outcome in outcomes] == [(0, 40)]


def test_a_run_leaves_the_environment_of_the_process_as_it_was(tmp_path, monkeypatch):
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    before = dict(os.environ)
    path = written(tmp_path / "program.py", "import os\nassert os.environ['OMP_NUM_THREADS'] == '1'\n")
    simulation = simulate('Robot { name "box" controller "program" }')
    runner = Runner(simulation, [(simulation.scene.robots[0], Program("program", path))])
    assert (runner.run().exit_code, dict(os.environ)) == (0, before)


def test_a_node_that_comes_is_shown():
    simulation = simulate(BALL)
    with viewed(simulation) as (viewer, page):
        children = Node(simulation, simulation.scene.root).getField("children")
        children.importMFNodeFromString(-1, BALL.replace("BODY", "SECOND"))
        _fall(simulation, viewer)
        with page.open(cookie=page.cookie) as wire:
            wire.send(msgspec.msgpack.encode(CAMERA))
            names = [each["name"] for each in _messages(wire) if "props" in each and "name" in each]
        assert [name for name in names if "/shape" in name] == ["/world'/0/shape0", "/world'/1/shape1"]


# Runs

WORLD = f"""{HEADER}WorldInfo {{ basicTimeStep 32 gravity 0 }}
Viewpoint {{ position -4 0 0 }}
DEF BALL Solid {{ translation 0 0 0
  children [ DEF SHAPE Shape {{ appearance PBRAppearance {{ baseColor 1 0 0 }} geometry Sphere {{ radius 0.4 }} }} ]
  boundingObject USE SHAPE physics Physics {{ }} }}
Robot {{ name "boss" supervisor TRUE controller "boss" }}"""
BOSS = """
from controller import Keyboard, Supervisor
boss = Supervisor()
boss.keyboard.enable(32)
ball = boss.getFromDef("BALL").getField("translation")
for step in range({steps}):
    boss.step(32)
    while (key := boss.keyboard.getKey()) != -1:
        ball.setSFVec3f([0, {{Keyboard.LEFT: 1.0, ord("A") + Keyboard.SHIFT: -1.0}}.get(key, 0), 0])
        if key == ord("Q") + Keyboard.CONTROL:
            raise SystemExit(3)
print(boss.getFromDef("BALL").getPosition())
"""


def _start(project: Project, steps: int, *options: str) -> subprocess.Popen[str]:
    project.write("worlds/w.wbt", WORLD)
    project.controller("boss", BOSS.format(steps=steps))
    return project.start(*options)


@contextmanager
def ended(process: subprocess.Popen[str]) -> Iterator[None]:
    """End a process that a failed test leaves."""
    try:
        yield
    finally:
        process.kill()


@pytest.mark.slow
def test_a_run_with_a_page_is_the_same_run(project: Project):
    plain, seen = (
        _start(project, 60, "--fast", *more).communicate(timeout=120)
        for more in ([], ["--view", "--port", "0"])
    )
    assert seen[0] == plain[0]
    assert "no key of the Keyboard is ever pressed: there is no window; with --view" in plain[1]
    assert re.search(r"^http://127\.0\.0\.1:\d+/\?token=\S{20,}\nCtrl-C ends it$", seen[1], re.MULTILINE)
    assert "Keyboard" not in seen[1]


def test_a_port_needs_the_page(project: Project):
    assert "--port needs --view" in project.run("--port", "0", code=2).err


@pytest.mark.browser
@pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium")
def test_a_person_sees_the_world_and_drives_it_by_keys(project: Project):
    process = _start(project, 100_000, "--view", "--port", "0")
    assert process.stderr is not None

    def press(key: str, code: str, modifiers: int = 0, *, down: bool = True) -> None:
        kind = "rawKeyDown" if down else "keyUp"
        tab.call("Input.dispatchKeyEvent", type=kind, key=key, code=code, modifiers=modifiers)

    def reds() -> int:
        """The mean column of the ball."""
        image = tab.see()[:, :450].astype(int)
        columns = np.flatnonzero((image[..., 0] - image[..., 1:].max(axis=2) > 60).any(axis=0))
        return int(columns.mean()) if len(columns) > 10 else -1

    with ended(process), browser() as new_tab:
        tab = new_tab()
        tab.open(process.stderr.readline().strip())
        until(lambda: reds() > 0, 120)
        middle = reds()
        press("ArrowLeft", "ArrowLeft")
        until(lambda: 0 < reds() < middle - 30, 60)
        press("ArrowLeft", "ArrowLeft", down=False)
        press("A", "KeyA", 8)
        until(lambda: reds() > middle + 30, 60)
        tab.run("dispatchEvent(new Event('blur')); 1")
        tab.click("pause")
        tab.wait("document.body.innerText.includes('paused')")
        time.sleep(1.0)  # the step that was under way ends
        state = tab.text
        time.sleep(0.5)
        assert tab.text == state
        tab.click("step")
        tab.wait(f"document.body.innerText != {state!r}")
        tab.click("real time")
        press("q", "KeyQ", 2)
        tab.wait("document.body.innerText.includes('the run has ended')")
        assert tab.errors == []
        process.communicate(timeout=60)
        assert process.returncode == 3


without_opengl = not (cameras.is_available() and cameras.opens_context())
needs_opengl = pytest.mark.skipif(without_opengl, reason="there is no OpenGL")

WALL = """DEF WALL Solid { translation 2.1 %s 0 children [ Shape {
  appearance PBRAppearance { baseColor %s } geometry Box { size 0.2 %s 8 } } ] }"""
SKY = "Background { skyColor [ 0 0 1 ] }"


def robot(camera: str, fields: str = "") -> str:
    return f"Robot {{ {fields} children [ {camera} ] }}"


def seeing(text: str, name: str):
    """Return a device with a picture, after its first measurement."""
    simulation = simulate(text)
    camera = device(simulation, name)
    camera.enable(8)
    simulation.run_step()
    return camera


@needs_opengl
def test_a_camera_sees_what_is_left_red_and_what_is_right_green():
    text = SKY + WALL % ("2", "1 0 0", "4") + WALL % ("-2", "0 1 0", "4")
    camera = seeing(text + robot("Camera { width 8 height 6 }"), "camera")
    image = camera.getImage()
    array = camera.getImageArray()
    assert (len(image), len(array), len(array[0])) == (8 * 6 * 4, 8, 6)
    left = [camera.imageGetRed(image, 8, 1, 3), camera.imageGetGreen(image, 8, 1, 3)]
    right = [camera.imageGetRed(image, 8, 6, 3), camera.imageGetGreen(image, 8, 6, 3)]
    assert left[0] > 100 > 20 > left[1]
    assert right[1] > 100 > 20 > right[0]
    assert array[1][3][:2] == left
    assert camera.imageGetGray(image, 8, 1, 3) == pytest.approx(sum(array[1][3]) / 3)


@needs_opengl
def test_a_camera_sees_the_sky_and_turns_with_its_robot():
    text = SKY + WALL % ("0", "1 0 0", "8")
    camera = seeing(text + robot("Camera { width 4 height 4 rotation 0 0 1 3.1416 }"), "camera")
    assert camera.getImageArray()[2][2] == [0, 0, 255]


def textured(tmp_path, address: str, geometry: str = "Box { size 0.2 4 4 }", transform: str = ""):
    """Return the picture of a wall ahead, whose texture has this address, in a project in `tmp_path`."""
    wall = f"""Solid {{ translation 2.1 0 0 children [ Shape {{ appearance PBRAppearance {{ {transform}
      baseColorMap ImageTexture {{ url [ "{address}" ] }} }} geometry {geometry} }} ] }}"""
    eye = robot("Camera { width 40 height 40 fieldOfView 1.57 }")
    world = read(f"WorldInfo {{ basicTimeStep 8 }} {SKY} {wall} {eye}", tmp_path)
    simulation = Simulation(build_scene(world), world.span)
    world.findings.require_none()
    camera = device(simulation, "camera")
    camera.enable(8)
    simulation.run_step()
    return np.array(camera.getImageArray()).transpose(1, 0, 2)


@pytest.fixture
def red_and_green(tmp_path):
    """A project with a texture that is red on the left, green on the right, and blue below."""
    pixels = np.zeros((64, 64, 3), np.uint8)
    pixels[:32, :32], pixels[:32, 32:], pixels[32:] = (255, 0, 0), (0, 255, 0), (0, 0, 255)
    folder = tmp_path / "project" / "worlds" / "textures"
    folder.mkdir(parents=True)
    iio.imwrite(folder / "tiles.png", pixels)
    return tmp_path / "project"


def colors(picture) -> set[str]:
    """Return the names of the strong colors of a picture."""
    names = {(True, False, False): "red", (False, True, False): "green", (False, False, True): "blue"}
    return {names.get(tuple(pixel > 90), "other") for pixel in picture.reshape(-1, 3)}


@needs_opengl
def test_a_wall_has_the_texture_of_the_project(red_and_green):
    picture = textured(red_and_green, "textures/tiles.png")
    top, bottom = picture[2:18], picture[22:]
    assert (colors(bottom), {*colors(top[:, :18]), *colors(top[:, 22:])}) == ({"blue"}, {"red", "green"})
    assert colors(top[:, :18]) != colors(top[:, 22:])


@needs_opengl
def test_a_texture_repeats_as_its_transform_says(red_and_green):
    transform = "textureTransform TextureTransform { scale 1 2 }"
    column = textured(red_and_green, "textures/tiles.png", transform=transform)[:, 5]
    assert abs(np.diff((column[:, 2] > 90).astype(int))).sum() == 3


@needs_opengl
def test_a_sphere_has_the_mean_color_of_its_texture(red_and_green):
    ball = textured(red_and_green, "textures/tiles.png", "Sphere { radius 1 }")[20, 20]
    assert ball / ball.sum() == pytest.approx([0.25, 0.25, 0.5], abs=0.03)


@needs_opengl
@pytest.mark.parametrize(
    "address",
    [
        *("https://example.org/tiles.png", "../../secret.png", "textures/broken.png"),
        pytest.param("textures/huge.png", marks=pytest.mark.slow),
        pytest.param("textures/heavy.png", marks=pytest.mark.slow),
    ],
)
def test_a_texture_that_cannot_be_read_is_squares(red_and_green, address: str):
    folder = red_and_green / "worlds" / "textures"
    (folder / "broken.png").write_bytes((folder / "tiles.png").read_bytes()[:90])
    (folder / "heavy.png").write_bytes((folder / "tiles.png").read_bytes() + bytes(MAX_PICTURE_BYTES))
    iio.imwrite(folder / "huge.png", np.zeros((1, 5000, 3), np.uint8))
    iio.imwrite(red_and_green.parent / "secret.png", np.full((8, 8, 3), (255, 0, 0), np.uint8))
    picture = textured(red_and_green, address)
    assert (picture.max(axis=2) == picture.min(axis=2)).all()  # gray
    light, dark = picture[..., 0].max(), picture[..., 0].min()
    assert light > 1.5 * dark > 0


@needs_opengl
def test_the_background_of_the_library_is_bright_and_its_floor_is_not_gray():
    lying = "Camera { width 4 height 40 fieldOfView 1 }"
    camera = seeing(
        f"TexturedBackground {{ }} Floor {{ }} Robot {{ translation 0 0 1 children [ {lying} ] }}", "camera"
    )
    column = camera.getImageArray()[1]
    assert 150 < column[2][0] < column[2][2]
    red, _, blue = column[-2]
    assert red > 1.3 * blue


@needs_opengl
def test_a_wall_fills_the_pixels_of_its_angle():
    """Of a wall of 1 m at 2 m, a camera of 90 degrees and 40 pixels sees 40 * (0.5 / 2) / tan(45 degrees)."""
    camera = seeing(
        SKY + WALL % ("0", "1 0 0", "1") + robot(f"Camera {{ width 40 height 2 fieldOfView {math.pi / 2} }}"),
        "camera",
    )
    red = [column for column in range(40) if camera.getImageArray()[column][1][0] > 100]
    assert red == list(range(15, 25))


@needs_opengl
def test_noise_of_a_camera_has_its_deviation():
    grey = WALL % ("0", "0.5 0.5 0.5", "8")
    camera = seeing(grey + robot("Camera { width 64 height 64 noise 0.04 }"), "camera")
    values = [channel for column in camera.getImageArray() for pixel in column for channel in pixel]
    mean = sum(values) / len(values)
    deviation = math.sqrt(sum((value - mean) ** 2 for value in values) / len(values))
    assert deviation == pytest.approx(0.04 * 255, rel=0.05)


@needs_opengl
def test_a_camera_has_no_picture_before_its_first_measurement():
    camera = device(simulate(robot("Camera { }")), "camera")
    camera.enable(32)
    assert camera.getImage() is None
    assert camera.getImageArray() is None
    assert camera.getWidth() == 64
    camera._simulation.run_step()  # of 8 ms
    assert camera.getImage() == bytes(4 * 64 * 64)


@needs_opengl
def test_a_range_finder_measures_along_its_axis():
    """The face of the wall is a plane 2 m ahead: all pixels read 2 m, whatever their angle."""
    finder = seeing(
        WALL % ("0", "1 0 0", "8") + robot("RangeFinder { width 6 height 4 fieldOfView 1.2 maxRange 3 }"),
        "range-finder",
    )
    assert finder.getRangeImage() == pytest.approx([2.0] * 24, abs=1e-3)
    assert ([len(row) for row in finder.getRangeImageArray()], len(finder.getRangeImage("buffer"))) == (
        [6] * 4,
        24 * 4,
    )
    assert finder.rangeImageGetDepth(finder.getRangeImage(), 6, 5, 3) == pytest.approx(2.0, abs=1e-3)


FINDER = "RangeFinder { width %d height 1 %s }"


@needs_opengl
@pytest.mark.parametrize(
    ("wall", "finder", "expected"),
    [
        # A plane through x = 2 that is turned by 0.5 rad is met at x = 2 / (1 - tan(0.5) * tan(angle)).
        pytest.param(
            """Solid { translation 2 0 0 rotation 0 0 1 0.5 children [ Shape {
              geometry Box { size 0.0001 20 20 } } ] }""",
            FINDER % (5, "fieldOfView 1 maxRange 9"),
            [2 / (1 + math.tan(0.5) ** 2 * (1 - 2 * (column + 0.5) / 5)) for column in range(5)],
            id="a slanted wall",
        ),
        *(
            pytest.param(
                WALL % ("0", "1 0 0", wall), FINDER % (2, limits), [math.inf] * 2, id=f"infinity: {limits}"
            )
            for wall, limits in (
                ("8", "maxRange 1.9"),
                ("8", "minRange 2.1 maxRange 9"),
                ("0.001", "maxRange 5000"),
            )
        ),
    ],
)
def test_a_range_finder_reads(wall: str, finder: str, expected: list[float]):
    assert seeing(wall + robot(finder), "range-finder").getRangeImage() == pytest.approx(expected, rel=2e-3)


@needs_opengl
def test_all_geometries_are_seen():
    shapes = [
        "Box { size 1 1 1 }",
        "Sphere { radius 0.5 }",
        "Cylinder { radius 0.5 height 1 }",
        "Capsule { radius 0.5 height 1 }",
        "Cone { bottomRadius 0.5 height 1 }",
        """IndexedFaceSet { coord Coordinate { point [ 0 -0.5 -0.5, 0 0.5 -0.5, 0 0 0.5, 0.5 0 0 ] }
          coordIndex [ 0 2 1 -1 0 1 3 -1 1 2 3 -1 2 0 3 -1 ] }""",
    ]
    for shape in shapes:
        text = f"Solid {{ translation 3 0 0 children [ Shape {{ geometry {shape} }} ] }}"
        camera = seeing(SKY + text + robot("Camera { width 3 height 3 }"), "camera")
        assert camera.getImageArray()[1][1] != [0, 0, 255], shape


@needs_opengl
def test_saved_pictures_are_those_of_the_camera(tmp_path):
    from PIL import Image

    camera = seeing(WALL % ("0", "1 0 0", "8") + robot("Camera { width 4 height 3 }"), "camera")
    assert camera.saveImage(str(tmp_path / "a.png"), 90) == 0
    with Image.open(tmp_path / "a.png") as picture:
        assert (picture.size, list(picture.getpixel((1, 1)))) == ((4, 3), camera.getImageArray()[1][1])
    assert camera.saveImage(str(tmp_path / "a.world"), 90) == -1


@needs_opengl
@pytest.mark.parametrize("node", ["Camera", "RangeFinder"])
def test_another_projection_says_so(node: str):
    name = {"Camera": "camera", "RangeFinder": "range-finder"}[node]
    sensor = device(simulate(robot(f'{node} {{ projection "cylindrical" }}')), name)
    with pytest.raises(NotImplementedCallError, match="projection that is not planar is not implemented"):
        sensor.enable(8)


@pytest.mark.slow
def test_without_opengl_a_camera_says_so():
    script = """
from tests.webots.conftest import Project
from tests.webots.exported_projects import device, read, simulate
simulation = simulate("Robot { children [ Camera { } GPS { } ] }")
device(simulation, "gps").enable(8)
try:
    device(simulation, "camera").enable(8)
except Exception as error:
    print(error)
"""
    done = subprocess.run(
        [sys.executable, "-c", script],
        capture_output=True,
        text=True,
        env={**os.environ, "MUJOCO_GL": "disable", "PYTHONPATH": ":".join(sys.path)},
        check=False,
    )
    assert "Camera 'camera' cannot draw: MuJoCo finds no OpenGL" in done.stdout, done.stderr
