"""What becomes of the process that simulates: killed, crashed, hanging, out of memory, slow; in each case
lint goes on."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path

import pytest

from deepbots_cli import api, processes
from deepbots_cli.compiler import CheckedScenario
from deepbots_cli.diagnostics import Finding
from deepbots_cli.document import Permissions, shipped
from deepbots_cli.lint import Limits, SimulationFindings, simulate
from deepbots_cli.lint.simulation import measure

CARTPOLE = (
    shipped.scenario_path("cartpole")
    .read_text(encoding="utf-8")
    .replace("../robots/urdf/cartpole.urdf", "cartpole")
)
CARTPOLE = CARTPOLE.replace("world:\n", "world:\n  engine: mujoco\n", 1)  # steps it four times as fast
MODULE = """\
import ctypes
def crash(supervisor):
    return ctypes.string_at(0)
def hang(supervisor):
    while supervisor.step_count >= 3:
        pass
    return 0.0
def hoard(supervisor):
    try:
        kept = bytearray(2 ** 40)
    except MemoryError:
        import os; os._exit(77)
def fail(supervisor):
    return 1 / (supervisor.step_count - 2)
def shout(supervisor):
    import os; os.write(1, b'{"done": true}\\n~99\\n'); print("{"); return 0.0
"""
TIGHT = Limits(cpu=60, step_seconds=1.0)


@pytest.fixture
def checked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """CartPole with a term of the reward that is this function."""
    (tmp_path / "hostile.py").write_text(MODULE)
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))

    def make(function: str = "") -> CheckedScenario:
        text = CARTPOLE.replace(
            "  alive: 1\n",
            f"  alive: 1\n  odd: {{python: 'hostile:{function}'}}\n" if function else "  alive: 1\n",
        )
        (tmp_path / "cartpole.yaml").write_text(text)
        return api.load(tmp_path / "cartpole.yaml", permissions=Permissions(code=True))

    return make


def only_finding(probed: SimulationFindings) -> Finding:
    (finding,) = probed.findings
    return finding


@pytest.mark.parametrize(
    ("function", "code", "place", "headline", "note"),
    [
        (
            "crash",
            "DB309",
            "cart",
            "the physics engine crashes (SIGSEGV)",
            "in step 1 (0.032 s) of the episode with seed 0 (random actions)",
        ),
        ("hang", "DB309", "cart", "a step does not return within 1 s of CPU time", "in step 3 "),
        pytest.param(
            "hoard",
            "DB309",
            "cart",
            "the simulation needs more memory than 4096 MiB",
            "",
            marks=pytest.mark.slow,
        ),
        ("fail", "DB707", "hostile:fail", "", "ZeroDivisionError"),
    ],
)
def test_a_step_that_goes_wrong_is_a_finding_at_its_place(
    checked, function, code, place, headline, note
) -> None:
    finding = only_finding(simulate(checked(function), limits=TIGHT))
    assert (finding.code, finding.span.text) == (code, place)
    assert headline in finding.headline
    assert any(note in text for text in finding.notes)


def test_a_world_that_does_not_fit_into_the_memory_is_a_finding(checked) -> None:
    """So little that not even the libraries can be loaded."""
    assert only_finding(simulate(checked(), limits=Limits(memory=120))).code == "DB309"


@pytest.mark.slow
def test_a_slow_scenario_has_no_finding_but_a_note(checked) -> None:
    """The system ends a process after whole seconds of CPU."""
    probed = simulate(checked("hang"), limits=Limits(cpu=1, step_seconds=60.0))
    assert probed.findings == []
    assert probed.incomplete is not None
    assert "after 1 s of CPU time" in probed.incomplete
    probed = simulate(checked(), limits=Limits(wall=0.01))
    assert (probed.findings, probed.incomplete) == ([], "while the world was built, after 0.01 s")


def test_an_exception_of_deepbots_in_the_process_is_reported_with_its_place(checked) -> None:
    """Here the process is given an empty scenario, which does not compile."""
    inputs = checked().inputs
    report = measure(replace(inputs, document=replace(inputs.document, root=None)), TIGHT)
    assert report.fault is not None
    assert re.match(r"\w+Error: .+ \(deepbots_cli\.[\w.]+:\d+\)$", report.fault.description)


def test_a_measurement_that_comes_in_parts_is_read(checked, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(processes, "_MAX_LINE_BYTES", 100)
    assert measure(checked().inputs, TIGHT).summary.measured


@pytest.mark.slow
def test_what_a_scenario_prints_is_not_taken_for_what_was_measured(checked) -> None:
    assert [finding.code for finding in simulate(checked("shout"), limits=TIGHT).findings] == []


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="children are found by way of /proc")
@pytest.mark.parametrize(
    ("number", "message"),
    [(signal.SIGKILL, "another process ended the simulation (SIGKILL)"), (signal.SIGBUS, "crashes (SIGBUS)")],
)
def test_a_process_that_is_killed_is_a_finding(checked, number: signal.Signals, message: str) -> None:
    """As the system does when memory runs out, or an engine that reads past its arrays."""
    scenario = checked("hang")
    findings = []
    task = threading.Thread(target=lambda: findings.append(only_finding(simulate(scenario, limits=Limits()))))
    task.start()
    children = Path(f"/proc/self/task/{task.native_id}/children")
    while not (pids := children.read_text().split()):
        time.sleep(0.01)
    os.kill(int(pids[0]), number)
    task.join(60)
    assert message in findings[0].headline


def test_the_linter_itself_imports_no_simulator(tmp_path: Path) -> None:
    (tmp_path / "cartpole.yaml").write_text(CARTPOLE)
    program = (
        "import sys; from deepbots_cli.cli import main; code = main(['lint', 'cartpole.yaml', '--deep',"
        " '--preview']);"
        "print(code, sorted({'numpy', 'pybullet', 'gymnasium', 'torch'} & set(sys.modules)))"
    )
    environment = {**os.environ, "PYTHONPATH": str(Path(api.__file__).parents[1])}
    ran = subprocess.run(
        [sys.executable, "-c", program],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        check=True,
        timeout=300,
    )
    assert (ran.stdout, ran.stderr) == ("cartpole.yaml: no findings, including the simulation\n0 []\n", "")


def test_modules_in_the_working_directory_are_not_run(
    checked, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scenario = checked()
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    for name in ("json", "numpy", "pybullet", "deepbots_cli"):
        Path(f"{name}.py").write_text("import os; os._exit(3)\n")
    assert simulate(scenario, limits=TIGHT).findings == []
