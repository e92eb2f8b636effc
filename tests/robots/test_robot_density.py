"""Masses of links from their density: closed forms at once, meshes when they are simulated."""

from __future__ import annotations

import hashlib
import math
import re
from contextlib import closing
from pathlib import Path

import pytest

from deepbots_cli import api, geometry
from deepbots_cli.errors import EngineError
from deepbots_cli.robots.model import (
    Box,
    Cylinder,
    Geometry,
    Inertial,
    Link,
    Mesh,
    Pose,
    RobotModel,
    Shape,
    Sphere,
    homogeneous_inertial,
    with_density,
    with_scale,
)
from tests.robots.meshes import ball, block

DENSITY = 700.0  # kg/m^3


def robot(shape: Shape, origin: Pose = Pose()) -> RobotModel:  # noqa: B008  # frozen
    return RobotModel("r", (Link("a", collisions=(Geometry(shape, origin),)),), (), "a")


def mesh(folder: Path, name: str, data: bytes, scale: tuple[float, float, float] = (1.0, 1.0, 1.0)) -> Mesh:
    (folder / name).write_bytes(data)
    return Mesh(str(folder / name), hashlib.sha256(data).hexdigest(), scale)


def weighed(model: RobotModel) -> Inertial:
    dense = with_density(model, "a", DENSITY)
    assert isinstance(dense, RobotModel)
    inertial = geometry.with_masses(dense).link("a").inertial
    assert inertial is not None
    return inertial


def moments(inertial: Inertial) -> list[float]:
    return [inertial.mass, *(entry for row in inertial.matrix for entry in row)]


@pytest.mark.parametrize("name", ["block.stl", "block.obj"])
@pytest.mark.parametrize("scale", [(1.0, 1.0, 1.0), (0.5, 2.0, -1.0)])
def test_a_block_of_triangles_weighs_what_a_box_does(
    tmp_path: Path, name: str, scale: tuple[float, float, float]
) -> None:
    inertial = weighed(
        robot(mesh(tmp_path, name, block(name, (0.1, 0.2, 0.3)), scale), Pose((1.0, 2.0, 3.0)))
    )
    size = (0.1 * scale[0], 0.2 * scale[1], 0.3 * abs(scale[2]))
    expected = homogeneous_inertial(Box(size), DENSITY * math.prod(size))
    assert moments(inertial) == pytest.approx(
        moments(expected), rel=1e-6, abs=1e-9
    )  # an STL file has 32-bit floats
    assert inertial.origin.xyz == pytest.approx((1.0, 2.0, 3.0))


def test_a_ball_of_triangles_weighs_nearly_what_a_sphere_does(tmp_path: Path) -> None:
    inertial = weighed(robot(mesh(tmp_path, "ball.obj", ball(0.5, 120))))
    expected = homogeneous_inertial(Sphere(0.5), DENSITY * 4 / 3 * math.pi * 0.5**3)
    assert moments(inertial) == pytest.approx(moments(expected), rel=2e-3, abs=1e-9)
    assert inertial.origin.xyz == pytest.approx((0.0, 0.0, 0.0), abs=1e-12)


def test_a_turned_block_has_the_inertia_of_a_turned_box(tmp_path: Path) -> None:
    inertial = weighed(
        robot(
            mesh(tmp_path, "block.obj", block("block.obj", (0.1, 0.2, 0.3))),
            Pose((0.0, 0.0, 0.0), (0.0, 0.0, math.pi / 2)),
        )
    )
    expected = homogeneous_inertial(Box((0.2, 0.1, 0.3)), DENSITY * 0.006)
    assert moments(inertial) == pytest.approx(moments(expected), abs=1e-12)


def test_a_mesh_that_is_inside_out_weighs_the_same(tmp_path: Path) -> None:
    inside_out = block("block.obj", (0.1, 0.2, 0.3), outward=False)
    assert weighed(robot(mesh(tmp_path, "block.obj", inside_out))).mass == pytest.approx(DENSITY * 0.006)


def test_an_open_mesh_has_no_mass(tmp_path: Path) -> None:
    open_box = b"\n".join(block("block.obj", (0.1, 0.2, 0.3)).splitlines()[:-1])
    with pytest.raises(EngineError, match="the mesh of link 'a' is not watertight"):
        weighed(robot(mesh(tmp_path, "block.obj", open_box)))


def test_shapes_in_closed_form_are_weighed_at_once() -> None:
    dense = with_density(robot(Cylinder(0.1, 0.5), Pose((0.0, 0.0, 0.2))), "a", DENSITY)
    assert isinstance(dense, RobotModel)
    volume = math.pi * 0.1**2 * 0.5
    assert dense.link("a").inertial == homogeneous_inertial(
        Cylinder(0.1, 0.5), DENSITY * volume, Pose((0.0, 0.0, 0.2))
    )
    assert dense.link("a").density is None


def test_a_link_without_a_volume_is_an_error_that_says_why(tmp_path: Path) -> None:
    assert "has 0 shapes" in str(with_density(RobotModel("r", (Link("a"),), (), "a"), "a", DENSITY))
    assert "is a COLLADA file" in str(with_density(robot(Mesh("/m.DAE", "")), "a", DENSITY))


def test_a_stretched_mesh_weighs_more(tmp_path: Path) -> None:
    model = robot(mesh(tmp_path, "block.stl", block("block.stl", (0.1, 0.2, 0.3))))
    long = with_scale(model, "a", (1.0, 1.0, 2.0))
    assert isinstance(long, RobotModel)
    assert weighed(long).mass == pytest.approx(2.0 * weighed(model).mass)


ROOT = Path(__file__).parents[2]
CARTPOLE = ROOT / "robots/urdf/cartpole.urdf"
SCENARIO = (ROOT / "scenarios/cartpole.yaml").read_text(encoding="utf-8")


def cartpole(folder: Path, pole: str) -> str:
    """A CartPole whose pole is a mesh with an inertial or without, and what the scenario says of it; the
    codes of the findings."""
    (folder / "pole.obj").write_bytes(block("pole.obj", (0.02, 0.02, 1.0)))
    box = homogeneous_inertial(Box((0.02, 0.02, 1.0)), DENSITY * 0.0004, Pose((0.0, 0.0, 0.5)))
    assert box is not None
    moments = f'<inertia ixx="{box.ixx!r}" iyy="{box.iyy!r}" izz="{box.izz!r}"/>'
    written = f'<inertial><origin xyz="0 0 0.5"/><mass value="{box.mass!r}"/>{moments}</inertial>'
    shape = '<collision><origin xyz="0 0 0.5"/><geometry><mesh filename="pole.obj"/></geometry></collision>'
    text = re.sub(
        r'<link name="pole">.*?</link>',
        f'<link name="pole">{written if pole == "written" else ""}{shape}</link>',
        CARTPOLE.read_text(encoding="utf-8"),
        flags=re.DOTALL,
    )
    (folder / f"{pole}.urdf").write_text(text, encoding="utf-8")
    links = "\n    links: {pole: {density: 700 kg/m^3}}" if pole == "dense" else ""
    return SCENARIO.replace("urdf: ../robots/urdf/cartpole.urdf", f"urdf: {pole}.urdf{links}")


def test_a_link_of_a_scenario_takes_its_mass_from_its_density(tmp_path: Path) -> None:
    rolls, codes = {}, {}
    for pole in ("written", "dense", "bare"):
        file = tmp_path / f"{pole}.yaml"
        file.write_text(cartpole(tmp_path, pole), encoding="utf-8")
        codes[pole] = {finding.code for finding in api.lint(file)} & {"DB305", "DB301", "DB105"}
        if pole != "bare":
            with closing(api.make(file)) as environment:
                environment.reset(seed=0)
                rolls[pole] = [environment.step(step % 2)[0].tolist() for step in range(40)]
    assert codes == {"written": set(), "dense": set(), "bare": {"DB305"}}
    assert rolls["dense"] == [pytest.approx(row, abs=1e-3) for row in rolls["written"]]


@pytest.mark.parametrize(
    ("says", "code", "words"),
    [
        ("density: 700 kg/m^3, mass: 1 kg", "DB202", "cannot be combined"),
        ("density: 7 kg", "DB503", "density"),
        ("density: 0 kg/m^3", "DB105", "0"),
    ],
)
def test_a_density_that_cannot_be_meant_is_a_finding(
    tmp_path: Path, says: str, code: str, words: str
) -> None:
    text = SCENARIO.replace(
        "urdf: ../robots/urdf/cartpole.urdf", f"urdf: cartpole\n    links: {{pole: {{{says}}}}}"
    )
    (tmp_path / "a.yaml").write_text(text, encoding="utf-8")
    assert [finding.code for finding in api.lint(tmp_path / "a.yaml") if words in finding.headline] == [code]
