"""Cameras and range finders of worlds, drawn with OpenGL."""

from __future__ import annotations

import math
import os
import subprocess
import sys

import imageio.v3 as iio
import numpy as np
import pytest

from deepbots_cli.engines.mujoco import cameras
from deepbots_cli.webots.looks import MAX_PICTURE_BYTES
from deepbots_cli.webots.scene_builder import build_scene
from deepbots_cli.webots.simulation import Simulation
from deepbots_cli.webots.unimplemented import NotImplementedCallError
from tests.webots.worlds_of_webots import device, read, simulate

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
    assert colors(bottom) == {"blue"}
    assert {*colors(top[:, :18]), *colors(top[:, 22:])} == {"red", "green"}
    assert colors(top[:, :18]) != colors(top[:, 22:])


@needs_opengl
def test_a_texture_repeats_as_its_transform_says(red_and_green):
    transform = "textureTransform TextureTransform { scale 1 2 }"
    column = textured(red_and_green, "textures/tiles.png", transform=transform)[:, 5]
    is_blue = (column[:, 2] > 90).astype(int)
    assert abs(np.diff(is_blue)).sum() == 3


@needs_opengl
def test_a_sphere_has_the_mean_color_of_its_texture(red_and_green):
    ball = textured(red_and_green, "textures/tiles.png", "Sphere { radius 1 }")[20, 20]
    assert ball / ball.sum() == pytest.approx([0.25, 0.25, 0.5], abs=0.03)


@needs_opengl
@pytest.mark.parametrize(
    "address",
    [
        "https://example.org/tiles.png",
        *("../../secret.png", "textures/broken.png", "textures/huge.png", "textures/heavy.png"),
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


@needs_opengl
def test_a_zoom_sets_the_field_of_view(capsys):
    camera = seeing(robot("Camera { zoom Zoom { minFieldOfView 0.2 maxFieldOfView 1 } }"), "camera")
    camera.setFov(0.5)
    assert (camera.getFov(), camera.getMinFov(), camera.getMaxFov()) == (0.5, 0.2, 1)
    camera.setFov(1.5)
    assert camera.getFov() == 0.5
    assert "no effect" in capsys.readouterr().err


@needs_opengl
def test_a_range_finder_measures_along_its_axis():
    """The face of the wall is a plane 2 m ahead: all pixels read 2 m, whatever their angle."""
    finder = seeing(
        WALL % ("0", "1 0 0", "8") + robot("RangeFinder { width 6 height 4 fieldOfView 1.2 maxRange 3 }"),
        "range-finder",
    )
    assert finder.getRangeImage() == pytest.approx([2.0] * 24, abs=1e-3)
    assert [len(row) for row in finder.getRangeImageArray()] == [6] * 4
    assert len(finder.getRangeImage("buffer")) == 24 * 4
    assert finder.rangeImageGetDepth(finder.getRangeImage(), 6, 5, 3) == pytest.approx(2.0, abs=1e-3)


@needs_opengl
def test_a_range_finder_sees_a_slanted_wall_by_its_closed_form():
    """A plane through x = 2 that is turned by 0.5 rad is met at x = 2 / (1 - tan(0.5) * tan(angle))."""
    text = """Solid { translation 2 0 0 rotation 0 0 1 0.5 children [ Shape {
      geometry Box { size 0.0001 20 20 } } ] }"""
    finder = seeing(text + robot("RangeFinder { width 5 height 1 fieldOfView 1 maxRange 9 }"), "range-finder")
    slopes = [math.tan(0.5) * (1 - 2 * (column + 0.5) / 5) for column in range(5)]
    expected = [2 / (1 + math.tan(0.5) * slope) for slope in slopes]
    assert finder.getRangeImage() == pytest.approx(expected, rel=2e-3)


@needs_opengl
def test_a_range_finder_reads_infinity_beyond_its_range():
    for limits in ("maxRange 1.9", "minRange 2.1 maxRange 9"):
        finder = seeing(
            WALL % ("0", "1 0 0", "8") + robot(f"RangeFinder {{ width 2 height 1 {limits} }}"), "range-finder"
        )
        assert finder.getRangeImage() == [math.inf, math.inf]


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
    assert camera.saveImage(str(tmp_path / "a.bmp"), 90) == -1


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
from tests.webots.worlds_of_webots import device, read, simulate
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
