"""The language fits the thirteen sample scenarios: nothing is said but what this version does not run yet."""

import shutil
from pathlib import Path

import pytest

from deepbots_cli import api
from deepbots_cli.source import shipped

SAMPLES = Path(__file__).parents[1] / "data" / "samples"
ROBOTS = Path(__file__).parents[1] / "data" / "robots"

# The robots of the samples that are not shipped: the links beside the base, and the joints that turn.
STAND_INS = {
    "balancer": ("body", (), ("left_wheel", "right_wheel")),
    "epuck": ("base_link", (), ("left_wheel", "right_wheel")),
    "rover": ("base_link", ("bumper_left", "bumper_right"), ("left_wheel", "right_wheel")),
    "roller": ("ball", (), ("pitch", "yaw")),
    "quadrotor": ("base_link", ("prop_fl", "prop_fr", "prop_rl", "prop_rr"), ()),
}
INERTIAL = '<inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>'


def stand_in(name: str) -> str:
    base, links, joints = STAND_INS[name]
    parts = [f'<link name="{link}">{INERTIAL}</link>' for link in (base, *links, *(f"{joint}_link" for joint in joints))]
    parts += [f'<joint name="{link}_mount" type="fixed"><parent link="{base}"/><child link="{link}"/></joint>' for link in links]
    parts += [
        f'<joint name="{joint}" type="continuous"><parent link="{base}"/><child link="{joint}_link"/><axis xyz="0 0 1"/></joint>'
        for joint in joints
    ]
    return f'<robot name="{name}">{"".join(parts)}</robot>'


@pytest.fixture(scope="session")
def project(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The samples beside the robots that they name."""
    root = tmp_path_factory.mktemp("samples")
    (root / "pyproject.toml").touch()
    shutil.copytree(SAMPLES, root / "scenarios")
    shutil.copytree(ROBOTS, root / "robots")
    urdf = root / "robots" / "urdf"
    urdf.mkdir(exist_ok=True)
    for name in STAND_INS:
        (urdf / f"{name}.urdf").write_text(stand_in(name), encoding="utf-8")
    cartpole = shipped.robot_path("cartpole")
    assert cartpole is not None
    shutil.copy(cartpole, urdf)
    return root / "scenarios"


@pytest.mark.parametrize("sample", sorted(path.name for path in SAMPLES.glob("*.yaml")))
def test_a_sample_has_no_error_but_what_is_not_delivered_yet(project: Path, sample: str) -> None:
    errors = [finding for finding in api.lint(project / sample) if finding.severity == "error" and finding.code != "DB108"]
    assert [f"{finding.span.where}: {finding.headline}" for finding in errors] == []


def test_a_longer_pole_is_a_few_lines_upon_the_shipped_scenario(tmp_path: Path) -> None:
    scenario, robot = shipped.scenario_path("cartpole"), shipped.robot_path("cartpole")
    assert scenario is not None
    assert robot is not None
    for folder in ("scenarios", "robots/urdf"):
        (tmp_path / folder).mkdir(parents=True)
    (tmp_path / "pyproject.toml").touch()
    shutil.copy(scenario, tmp_path / "scenarios")
    shutil.copy(robot, tmp_path / "robots" / "urdf")
    shutil.copy(SAMPLES / "long_pole.yaml", tmp_path / "scenarios")
    plain, long = (api.compile(tmp_path / "scenarios" / name) for name in ("cartpole.yaml", "long_pole.yaml"))
    pole = long.ir.world.robots[0].model.link("pole")
    old = plain.ir.world.robots[0].model.link("pole")
    assert pole.inertial is not None
    assert old.inertial is not None
    assert pole.inertial.mass == pytest.approx(1.5 * old.inertial.mass)
    assert pole.inertial.ixx == pytest.approx(1.5**3 * old.inertial.ixx, rel=2e-3)
    assert long.ir.world.robots[0].model.joint("tip_mount").origin.xyz == (0.0, 0.0, 1.5)
    assert long.digest != plain.digest
