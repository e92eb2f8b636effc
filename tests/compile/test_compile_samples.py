"""The language fits the thirteen sample scenarios: nothing is said but what this version does not run yet."""

import shutil
from pathlib import Path

import pytest

from deepbots_cli import api
from deepbots_cli.source import shipped

SAMPLES = Path(__file__).parents[1] / "data" / "samples"


@pytest.fixture(scope="session")
def project(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The samples beside the shipped robots."""
    root = tmp_path_factory.mktemp("samples")
    (root / "pyproject.toml").touch()
    shutil.copytree(SAMPLES, root / "scenarios")
    shutil.copytree(shipped.data_dir() / "robots", root / "robots")
    return root / "scenarios"


@pytest.mark.parametrize("sample", sorted(path.name for path in SAMPLES.glob("*.yaml")))
def test_a_sample_has_no_error_but_what_is_not_delivered_yet(project: Path, sample: str) -> None:
    errors = [finding for finding in api.lint(project / sample) if finding.severity == "error" and finding.code != "DB108"]
    assert [f"{finding.span.where}: {finding.headline}" for finding in errors] == []


def test_a_longer_pole_is_a_few_lines_upon_the_shipped_scenario() -> None:
    plain, long = api.compile("cartpole"), api.compile("cartpole_long")
    pole = long.ir.world.robots[0].model.link("pole")
    old = plain.ir.world.robots[0].model.link("pole")
    assert pole.inertial is not None
    assert old.inertial is not None
    assert pole.inertial.mass == pytest.approx(1.5 * old.inertial.mass)
    assert pole.inertial.ixx == pytest.approx(1.5**3 * old.inertial.ixx, rel=2e-3)
    assert long.ir.world.robots[0].model.joint("tip_mount").origin.xyz == (0.0, 0.0, 1.5)
    assert long.digest != plain.digest
