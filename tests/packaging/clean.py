"""Builds the sdist, the wheel from the sdist, and uses the wheel in a new environment, from an empty folder.

python -m tests.packaging.clean           what deepbots needs is lent by this environment; nothing is downloaded
python -m tests.packaging.clean --fetch   pip installs it with the extra `train`
"""

from __future__ import annotations

import json
import subprocess
import sys
import sysconfig
import tarfile
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from time import monotonic

ROOT = Path(__file__).resolve().parents[2]


def build(folder: Path) -> Path:
    """The wheel that the files of the sdist alone make."""
    _run([sys.executable, "-m", "hatchling", "build", "-t", "sdist", "-d", str(folder)], ROOT)
    (sdist,) = folder.glob("*.tar.gz")
    with tarfile.open(sdist) as archive:
        archive.extractall(folder / "sources", filter="data")
    (sources,) = (folder / "sources").iterdir()
    _run([sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)], sources)
    (wheel,) = folder.glob("*.whl")
    return wheel


def install(wheel: Path, folder: Path, *, fetch: bool) -> Path:
    """The folder of commands of a new environment with the wheel."""
    _run([sys.executable, "-m", "venv", "--without-pip", str(folder)], folder.parent)
    scripts, packages = (
        Path(sysconfig.get_path(name, vars={"base": str(folder), "platbase": str(folder)})) for name in ("scripts", "purelib")
    )
    pip = [sys.executable, "-m", "pip", "--python", str(folder), "install", "-q"]
    if fetch:
        _run([*pip, f"{wheel}[train]"], folder)
    else:
        _run([*pip, "--no-deps", "--no-index", str(wheel)], folder)
        lent = [path for path in sys.path if Path(path).name == "site-packages"]
        (packages / "lent.pth").write_text("\n".join(lent), encoding="utf-8")
    return scripts


def use(scripts: Path, folder: Path) -> None:
    """Lint and train a shipped scenario.

    Raises:
        AssertionError: The commands use files outside of the environment, or do not do their work.
    """
    place = _run([str(scripts / "python"), "-c", "import deepbots_cli; print(deepbots_cli.__file__)"], folder)
    assert Path(place.strip()).is_relative_to(scripts.parent), place
    deepbots = str(scripts / "deepbots")
    assert len(json.loads(_run([deepbots, "scenarios", "--json"], folder))["scenarios"]) == len(list((ROOT / "scenarios").glob("*.yaml")))
    _run([deepbots, "lint", "cartpole"], folder)
    result = json.loads(_run([deepbots, "train", "cartpole", "--timesteps", "2_000", "--json"], folder))
    assert result["training"]["status"] == "finished", result


def _run(command: Sequence[str], folder: Path) -> str:
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise AssertionError(f"{' '.join(command)}\n{done.stdout}{done.stderr}")
    return done.stdout


def main(*, fetch: bool = False) -> None:
    with TemporaryDirectory() as name:
        folder, start = Path(name), monotonic()
        for part in ("dist", "empty"):
            (folder / part).mkdir()
        wheel = build(folder / "dist")
        scripts = install(wheel, folder / "environment", fetch=fetch)
        use(scripts, folder / "empty")
        print(f"{wheel.name} lints and trains in a new environment: {monotonic() - start:.0f} s")


if __name__ == "__main__":
    main(fetch="--fetch" in sys.argv[1:])
