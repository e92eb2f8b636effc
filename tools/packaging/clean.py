"""Builds all sdists, the wheels from the sdists, and uses the wheels in new environments, from an empty
folder.

The first environment has deepbots-cli, trains, exports a policy once deepbots-robot is there, too, and reads a
world of Webots once deepbots-webots is. The second one has deepbots-robot alone, without any other package of this environment, and answers a robot over
ZeroMQ.

    python -m tools.packaging.clean           this environment lends what the wheels need; no downloads
    python -m tools.packaging.clean --fetch   pip installs it, with the extra `export`
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import sysconfig
import tarfile
import tomllib
from collections.abc import Iterable, Iterator, Sequence
from importlib.metadata import PackageNotFoundError, distribution, requires
from pathlib import Path
from tempfile import TemporaryDirectory
from time import monotonic

ROOT = Path(__file__).resolve().parents[2]
PROJECTS = {
    "deepbots-cli": ROOT,
    "deepbots-robot": ROOT / "deepbots_robot",
    "deepbots-webots": ROOT / "deepbots_webots",
}
"""The folder that builds each distribution."""
ROBOT_EXTRAS = ("log", "zmq")
MAX_ROBOT_MB = 15.0
"""What deepbots-robot takes with the extra `zmq`, beside numpy, onnxruntime and the packages that onnxruntime
requires."""
CLIENT = """
import json, sys, zmq
bundle, address, steps = json.load(open(sys.argv[1])), sys.argv[2], int(sys.argv[3])
socket = zmq.Context.instance().socket(zmq.DEALER)
socket.connect(address)
fields = {each["name"]: [0.0] * each["shape"][0] for each in bundle["inputs"]}
wanted = {each["name"] for each in bundle["outputs"]}
robot = bundle["outputs"][0]["robot"]
for step in range(1, steps + 1):
    commands = {}
    socket.send_json({"robot": robot, "stamp": step * bundle["timestep_s"], "fields": fields})
    while not wanted <= set(commands):
        assert socket.poll(20_000), f"no commands in step {step}"
        commands |= socket.recv_json().get("fields", {})
print(json.dumps(commands))
"""
"""A robot whose sensors measure zeros: `CLIENT bundle.json ADDRESS STEPS`."""


def build(sources: Path, folder: Path) -> Path:
    """The wheel that the files of the sdist of `sources` alone make."""
    folder.mkdir(parents=True, exist_ok=True)
    # -P: the folders of some distributions are packages, whose modules are not modules of Hatchling.
    build = [sys.executable, "-P", "-m", "hatchling", "build", "-d", str(folder), "-t"]
    _run([*build, "sdist"], sources)
    (sdist,) = folder.glob("*.tar.gz")
    with tarfile.open(sdist) as archive:
        # Python before 3.11.4 has no filters; the archive is our own.
        filters = {"filter": "data"} if hasattr(tarfile, "data_filter") else {}
        archive.extractall(folder / "sources", **filters)  # type: ignore[arg-type]
    (unpacked,) = (folder / "sources").iterdir()
    _run([*build, "wheel"], unpacked)
    (wheel,) = folder.glob("*.whl")
    return wheel


class Environment:
    """A new environment of Python in `folder`, without pip."""

    def __init__(self, folder: Path) -> None:
        _run([sys.executable, "-m", "venv", "--without-pip", str(folder)], folder.parent)
        self.folder = folder
        self.scripts, self.packages = (
            Path(sysconfig.get_path(name, vars={"base": str(folder), "platbase": str(folder)}))
            for name in ("scripts", "purelib")
        )

    def install(self, *wheels: str, fetch: bool) -> None:
        """Install wheels, of which `PATH[EXTRA]` may name extras, with what they require only if `fetch`."""
        pip = [sys.executable, "-m", "pip", "--python", str(self.folder), "install", "-q"]
        if fetch:
            _run([*pip, *wheels], self.folder)
        else:
            _run(
                [*pip, "--no-deps", "--no-index", *(wheel.partition("[")[0] for wheel in wheels)], self.folder
            )

    def lend_everything(self) -> None:
        """Make all packages of this environment importable."""
        lent = [path for path in sys.path if Path(path).name == "site-packages"]
        (self.packages / "lent.pth").write_text("\n".join(lent), encoding="utf-8")

    def lend(self, packages: Sequence[str]) -> None:
        """Link some packages of this environment, with their metadata."""
        for package in packages:
            here = distribution(package)
            for name in {Path(file).parts[0] for file in here.files or ()} - {"..", "__pycache__"}:
                if not (self.packages / name).exists():  # packages of one namespace share a folder
                    (self.packages / name).symlink_to(str(here.locate_file(name)))

    def run(self, command: str, *arguments: str, folder: Path) -> str:
        """What a command of the environment prints."""
        return _run([str(self.scripts / command), *arguments], folder)

    def size(self, packages: Sequence[str]) -> float:
        """MB of the files of some packages, without compiled Python."""
        paths = {path.resolve() for package in packages for path in _files(self.packages, package)}
        return sum(path.stat().st_size for path in paths if path.is_file() and path.suffix != ".pyc") / 1e6


def _files(folder: Path, package: str) -> Iterator[Path]:
    # A requirement of another platform is not installed.
    for record in folder.glob(f"{package.replace('-', '_')}-*.dist-info/RECORD"):
        for line in record.read_text(encoding="utf-8").splitlines():
            yield folder / line.rsplit(",", 2)[0].strip('"')


def required(package: str, extras: Sequence[str] = ()) -> dict[str, None]:
    """The packages that one requires on this machine, with what they require themselves, by the metadata of
    this environment."""
    packages: dict[str, None] = {}
    for requirement in _requirements(package, extras):
        name = re.match(r"[\w.-]+", requirement)
        assert name is not None, requirement
        packages |= {name[0].lower(): None} | required(name[0])
    return packages


def _requirements(package: str, extras: Sequence[str]) -> Iterator[str]:
    if package in PROJECTS:  # which need not be installed here
        project = tomllib.loads((PROJECTS[package] / "pyproject.toml").read_text(encoding="utf-8"))["project"]
        yield from project["dependencies"]
        for extra in extras:
            yield from project["optional-dependencies"][extra]
    else:
        yield from (text for text in requires(package) or () if "extra ==" not in text and _is_here(text))


def _is_here(requirement: str) -> bool:
    """Whether the package of a requirement is installed; if not, its marker is about another machine."""
    name = re.match(r"[\w.-]+", requirement)
    try:
        return name is not None and bool(distribution(name[0]))
    except PackageNotFoundError:
        return False


def train(environment: Environment, folder: Path) -> Path:
    """The run of a shipped scenario, which is linted and trained.

    Raises:
        AssertionError: The commands use files outside of the environment, or do not do their work.
    """
    place = environment.run(
        "python", "-c", "import deepbots_cli; print(deepbots_cli.__file__)", folder=folder
    )
    assert Path(place.strip()).is_relative_to(environment.folder), place
    shipped = json.loads(environment.run("deepbots", "scenarios", "--json", folder=folder))["scenarios"]
    assert len(shipped) == len(list((ROOT / "scenarios").glob("*.yaml")))
    environment.run("deepbots", "lint", "cartpole", folder=folder)
    result = json.loads(
        environment.run("deepbots", "train", "cartpole", "--timesteps", "2_000", "--json", folder=folder)
    )
    assert result["training"]["status"] == "finished", result
    (run,) = (folder / "runs").iterdir()
    return run


def check_world(environment: Environment, folder: Path) -> None:
    """Export a scenario as a project of Webots, and check its world.

    Raises:
        AssertionError: The command does not read the world.
    """
    environment.run("deepbots", "export", "cartpole", "--to", "webots", "-o", "project", folder=folder)
    checked = environment.run("deepbots", "webots", "project/worlds/cart_pole.wbt", "--json", folder=folder)
    assert len(json.loads(checked)) == 2, checked
    shutil.rmtree(folder / "project")


def serve(environment: Environment, bundle: Path, folder: Path, *, steps: int = 50) -> None:
    """Check a bundle, and let its policy act for a robot over ZeroMQ.

    Raises:
        AssertionError: The commands use files outside of the environment, or the policy does not answer.
    """
    place = environment.run(
        "python", "-c", "import deepbots_robot; print(deepbots_robot.__file__)", folder=folder
    )
    assert Path(place.strip()).is_relative_to(environment.folder), place
    assert (
        json.loads(environment.run("deepbots-robot", "check", str(bundle), "--json", folder=folder))[
            "scenario"
        ]
        == "CartPole"
    )
    address = f"ipc://{folder}/link"
    arguments = [str(bundle), "--zmq", address, "--lockstep", "--json", "--log", str(folder / "robot.mcap")]
    command = [str(environment.scripts / "deepbots-robot"), "serve", *arguments]
    with subprocess.Popen(
        command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as server:
        try:
            environment.run(
                "python", "-c", CLIENT, str(bundle / "bundle.json"), address, str(steps), folder=folder
            )
        finally:
            server.terminate()
            out, err = server.communicate(timeout=30)
    assert json.loads(out)["steps"] == steps, out + err


def _run(command: Sequence[str], folder: Path) -> str:
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise AssertionError(f"{' '.join(command)}\n{done.stdout}{done.stderr}")
    return done.stdout


def try_wheels(wheels: Iterable[Path], folder: Path, *, fetch: bool) -> None:
    """Train and export with the wheels of `PROJECTS`, and serve with that of deepbots-robot alone, in new environments in
    `folder`.

    Raises:
        AssertionError: The commands do not do their work, or deepbots-robot takes more than `MAX_ROBOT_MB`.
    """
    cli, robot, webots = wheels
    start, empty = monotonic(), folder / "empty"
    empty.mkdir()
    full = Environment(folder / "full")
    full.install(f"{cli}[train]", fetch=fetch)
    if not fetch:
        full.lend_everything()
    run = train(full, empty)
    full.install(str(robot), f"{cli}[export]", fetch=fetch)
    bundle = folder / "bundle"
    full.run("deepbots", "export", str(run), "-o", str(bundle), folder=empty)
    full.install(str(webots), f"{cli}[webots]", fetch=fetch)
    check_world(full, empty)
    print(
        f"{cli.name} lints, trains and exports, also to Webots, in a new environment: {monotonic() - start:.0f} s"
    )

    start = monotonic()
    alone = Environment(folder / "robot")
    alone.install(f"{robot}[{','.join(ROBOT_EXTRAS)}]", fetch=fetch)
    if not fetch:
        alone.lend(list(required("deepbots-robot", ROBOT_EXTRAS)))
    shutil.rmtree(empty / "runs")
    serve(alone, bundle, empty)
    heavy = {"numpy": None, "onnxruntime": None, **required("onnxruntime")}
    packages = [
        "deepbots-robot",
        *(name for name in required("deepbots-robot", ["zmq"]) if name not in heavy),
    ]
    size = alone.size(packages)
    print(f"{robot.name} checks and serves a bundle in a new environment: {monotonic() - start:.0f} s")
    print(f"  {size:.1f} MB of {', '.join(packages)}; {alone.size(list(heavy)):.0f} MB of {', '.join(heavy)}")
    assert size <= MAX_ROBOT_MB


def main(*, fetch: bool = False) -> None:
    with TemporaryDirectory() as name:
        folder = Path(name).resolve()
        wheels = (build(sources, folder / "dist" / project) for project, sources in PROJECTS.items())
        try_wheels(wheels, folder, fetch=fetch)


if __name__ == "__main__":
    main(fetch="--fetch" in sys.argv[1:])
