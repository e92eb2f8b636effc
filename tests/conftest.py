"""Puts the engine `exact` where engines of other packages are found, and keeps temporary files of the package
in folders of pytest.

Where PyBullet is not installed, as beyond Python 3.11, tests on the engine `pybullet` and tests that ask for
PyBullet or for a file of pybullet_data are skipped.
"""

import gc
import os
import sys
import tempfile
from collections.abc import Generator, Iterator
from contextlib import closing
from pathlib import Path

import hypothesis
import pytest

from deepbots_cli.document import Permissions
from deepbots_cli.engine_kinds import ENGINES
from tests.commands import Deepbots, Ran
from tests.worlds import Make, Maker

sys.path.insert(0, str(Path(__file__).parent / "exact"))

# The workers of pytest take all cores. Further threads of torch and BLAS wait for each other: a forward pass
# of a small network took 60 ms.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# Bytecode is cached whatever the shell says: tests start a hundred processes, and without it each takes 6 s of
# CPU instead of 3 to import torch and deepbots.
sys.dont_write_bytecode = False
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

# No deadline: a busy machine, or the first import of scipy, takes seconds. A run draws other examples than
# the one before.
hypothesis.settings.register_profile("few", deadline=None, max_examples=20)
hypothesis.settings.register_profile("nightly", deadline=None, max_examples=200)
hypothesis.settings.load_profile("few")

WITHOUT = None if ENGINES.built_in["pybullet"].is_installed else ENGINES.built_in["pybullet"].missing
_NEEDS = (
    "No module named 'pybullet",
    "the engine 'pybullet' cannot be used",
    "engine `pybullet` cannot be used",
    "pybullet_data",
    "or the engine `pybullet`",
)
"""What an error says that is raised for lack of PyBullet."""


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Collect no garbage while tests are found: it is 5 s of CPU in 16, for thousands of items that all
    stay."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()
        # As the command does. At the usual 700, garbage of tests is 8 % of their time.
        gc.set_threshold(50_000)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Skip what has the engine `pybullet` or a file of pybullet_data as a parameter, where it is not
    installed."""
    for item in items if WITHOUT else ():
        values = getattr(getattr(item, "callspec", None), "params", {}).values()
        texts = [
            value.read_text("utf-8") if isinstance(value, Path) and value.suffix == ".yaml" else str(value)
            for value in values
        ]
        if any(text == "pybullet" or "pybullet_data/" in text for text in texts):
            item.add_marker(pytest.mark.skip(reason=str(WITHOUT)))


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Generator[None, object, object]:
    """Skip a test that fails for lack of PyBullet alone."""
    try:
        return (yield)
    except Exception as error:
        if WITHOUT and any(text in str(error) for text in (WITHOUT, *_NEEDS)):
            pytest.skip(WITHOUT)
        raise


@pytest.fixture
def make(tmp_path: Path) -> Iterator[Maker]:
    """Makes environments, and closes them after the test."""
    with closing(Maker(tmp_path)) as maker:
        yield maker


@pytest.fixture
def small(make: Maker) -> Make:
    return make.small


@pytest.fixture
def deepbots(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> Deepbots:
    """Runs `deepbots` with the given words in `tmp_path`, and asserts its exit code. Wrong usage prints
    nothing on standard output."""
    from deepbots_cli.cli import main

    monkeypatch.chdir(tmp_path)

    def run(*words: object, code: int | None = 0) -> Ran:
        capfd.readouterr()
        ran = Ran(main([str(word) for word in words]), *capfd.readouterr())
        assert code is None or ran.code == code, ran.err + ran.out
        assert ran.code != 2 or not ran.out
        return ran

    return run


@pytest.fixture
def simulated_here(monkeypatch: pytest.MonkeyPatch) -> None:
    """Lint simulates in this process: one of its own costs 1 s of CPU, and `lint/test_simulation_process.py`
    has it."""
    from deepbots_cli.compiler.inputs import Inputs
    from deepbots_cli.lint.rollouts import Simulator, compiled
    from deepbots_cli.lint.search import ExploitSearch
    from deepbots_cli.lint.simulation import Done, Entry, Limits, SimulationReport, decode, encode

    def measure(
        inputs: Inputs, limits: Limits, permissions: Permissions, search: bool = False
    ) -> SimulationReport:
        report = SimulationReport()

        def write(entry: Entry) -> None:
            read = decode(encode(entry))
            assert read is not None
            report.add(read)

        def begin_step(number: int) -> None:
            report.where = report.where._replace(step=number)

        with tempfile.TemporaryDirectory() as folder:
            inputs.write(Path(folder))
            (ExploitSearch if search else Simulator)(
                compiled(Path(folder)), write, begin_step, permissions=permissions
            ).run()
        report.add(Done())
        return report

    monkeypatch.setattr("deepbots_cli.lint.run.measure", measure)


@pytest.fixture(scope="session", autouse=True)
def _no_wait_for_the_disk() -> Iterator[None]:
    """Nobody cuts the power: 4,400 calls of fsync made tests of training wait for 15 s."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(os, "fsync", lambda descriptor: None)
        yield


@pytest.fixture(scope="session", autouse=True)
def _temporary_files(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """A command that fails writes a report into the folder for temporary files."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setenv("TMPDIR", str(tmp_path_factory.mktemp("temporary")))
        patched.setattr(tempfile, "tempdir", None)
        yield
