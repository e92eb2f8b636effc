"""The tutorials, done word by word in an empty folder: files are written, edits are made, and commands print
what the page shows."""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
from importlib import import_module, util
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from deepbots_cli import api
from deepbots_cli.cli import main
from deepbots_cli.codegen import batch_obstacles

DOCS = Path(__file__).parents[2] / "docs"
TUTORIALS = ("start", "what-is-rl", "first", "rewards-that-cheat", "own-robot", "teach")
BLOCK = re.compile(r"^```(\w+)[ ]?([^\n]*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
QUICK = {"new", "lint", "inspect", "explain"}
"""Commands that run no simulation; what they print is the same on every machine."""
SERVED = {"view", "play"}
"""Commands that serve a page until Ctrl-C."""


@pytest.mark.parametrize("page", TUTORIALS)
def test_the_files_of_a_tutorial_are_what_its_page_says(
    page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    follow(page, tmp_path, monkeypatch, capsys, whole=False)


@pytest.mark.slow
@pytest.mark.parametrize("page", TUTORIALS)
def test_a_tutorial_done_word_by_word(
    page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    follow(page, tmp_path, monkeypatch, capsys, whole=True)


def follow(
    page: str,
    folder: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    *,
    whole: bool,
) -> None:
    """Follow the page; without `whole`, leave out simulations and their output."""
    monkeypatch.chdir(folder)
    printed = ""
    exact = True
    complete = False
    for language, mark, text in BLOCK.findall((DOCS / f"{page}.md").read_text(encoding="utf-8")):
        kind, _, file = mark.rpartition(" ")
        if language == "console":
            lines = [
                shlex.split(line.removeprefix("$ "))
                for line in text.splitlines()
                if line.startswith("$ deepbots ")
            ]
            wanted = [line for line in lines if whole or is_quick(line)]
            complete = len(wanted) == len(lines)
            exact = all(is_quick(line) for line in lines)
            for _, *words in wanted:
                if words[0] in SERVED:
                    continue
                assert main(words) == (1 if mark == "fails" else 0), words
            captured = capsys.readouterr()
            printed = captured.out + captured.err
        elif language == "text" and mark == "output" and complete:
            assert [line for line in text.splitlines() if not is_shown(line, printed, exact=exact)] == []
        elif language == "yaml" and kind == "part":
            with Path(file).open("a", encoding="utf-8") as target:
                target.write(text)
        elif language == "xml" and file:
            Path(file).write_text(text, encoding="utf-8")
        elif language == "diff":
            edit(Path(file), text)


def is_quick(line: list[str]) -> bool:
    return line[1] in QUICK and not any(
        word.startswith("runs/") or word in ("--deep", "--exploits") for word in line
    )


def edit(file: Path, text: str) -> None:
    """Replace the lines with a minus by those with a plus."""
    old = "".join(f"{line[1:]}\n" for line in text.splitlines() if line[0] in " -")
    new = "".join(f"{line[1:]}\n" for line in text.splitlines() if line[0] in " +")
    before = file.read_text(encoding="utf-8")
    assert before.count(old) == 1, old
    file.write_text(before.replace(old, new), encoding="utf-8")


def is_shown(line: str, printed: str, *, exact: bool) -> bool:
    """Whether a line was printed; `...` matches the rest of a line, or any lines."""
    start, rest, _ = line.partition("...")
    lines = [plain(printed_line, exact=exact) for printed_line in printed.splitlines()]
    return any(
        printed_line.startswith(plain(start, exact=exact))
        if rest
        else printed_line == plain(line, exact=exact)
        for printed_line in ["", *lines]
    )


def plain(line: str, *, exact: bool) -> str:
    """The words of a line; unless it must be exact, without numbers, which depend on the machine."""
    return " ".join((line if exact else re.sub(r"[-+]?\d[\d,.:]*%?", "0", line)).split())


# The diffs of docs/change-it.md apply, each alone and all together, and give what the page shows


ROOT = Path(__file__).parents[2]
SECTIONS = dict(
    re.findall(
        r"^## (.*?)\n(.*?)(?=^## |\Z)", (ROOT / "docs/change-it.md").read_text(encoding="utf-8"), re.M | re.S
    )
)

TRAINING = ["An algorithm", "An engine"]
"""The sections whose commands take more than 1 s of CPU."""


def block(section: str, language: str) -> str:
    """The fenced block of a section, empty without one."""
    match = re.search(rf"^```{language}\n(.*?)^```$", SECTIONS[section], re.M | re.S)
    return match[1] if match else ""


def apply(section: str, folder: Path) -> None:
    diff = block(section, "diff")
    subprocess.run(["git", "apply", "-"], input=diff, cwd=folder, text=True, check=True)


@pytest.fixture(scope="module")
def changed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the package with all diffs."""
    folder = tmp_path_factory.mktemp("changed")
    for name in ("deepbots_cli", "scenarios", "robots"):
        shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("*.pyc.*"))
    for section in SECTIONS:
        apply(section, folder)
    return folder


def test_the_files_that_the_page_names_exist() -> None:
    text = re.sub(r"^```.*?^```$", "", "\n".join(SECTIONS.values()), flags=re.M | re.S)
    names = re.findall(r"`((?:\w+/)+\w+\.(?:py|yaml))", text)
    assert "learning/sb3/networks.py" in names
    assert [
        name for name in names if not any((ROOT / part / name).is_file() for part in ("", "deepbots_cli"))
    ] == []


@pytest.mark.parametrize("section", SECTIONS)
def test_a_diff_changes_three_files_at_most(section: str) -> None:
    files = re.findall(r"^\+\+\+ b/(.*)$", block(section, "diff"), re.M)
    assert files
    assert len(files) <= (3 if section in ("A rule of lint", "A command") else 2)  # these have texts too


COMMANDS = """
import contextlib, io, json, shlex, sys
from deepbots_cli.cli import main
for line in sys.argv[1:]:
    with io.StringIO() as out, contextlib.redirect_stdout(out), contextlib.redirect_stderr(out):
        main(shlex.split(line)[1:])
        printed = out.getvalue()
    print(json.dumps([line, printed]), flush=True)
"""


def commands(section: str) -> list[list[str]]:
    """The commands of a section, each with the lines that the page shows below it."""
    return [part.rstrip().splitlines() for part in block(section, "text run").split("$ ")[1:]]


@pytest.fixture(scope="module")
def written(changed: Path) -> Path:
    """The copy with the diffs and the scenarios of the page."""
    for name, text in re.findall(
        r"^```text (\S+\.yaml)\n(.*?)^```$", "".join(SECTIONS.values()), re.M | re.S
    ):
        (changed / name).write_text(text)
    return changed


def printed(folder: Path, lines: list[str]) -> dict[str, str]:
    """What each command prints. One process runs them all, whose start takes 1 s of CPU."""
    ran = subprocess.run(
        [sys.executable, "-c", COMMANDS, *lines],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(folder)},
        stdout=subprocess.PIPE,
        text=True,
    )
    return dict(map(json.loads, ran.stdout.splitlines()))


@pytest.mark.parametrize(
    "sections",
    [
        pytest.param([name for name in SECTIONS if name not in TRAINING], id="most"),
        pytest.param(TRAINING, id="those that train", marks=pytest.mark.slow),
    ],
)
def test_the_commands_below_a_diff_print_what_the_page_shows(sections: list[str], written: Path) -> None:
    pytest.importorskip("stable_baselines3")
    examples = [lines for section in sections for lines in commands(section)]
    outputs = printed(written, [command for command, *_ in examples])
    for command, *lines in examples:
        for line in lines:
            assert line in outputs[command].splitlines(), (command, outputs[command])


# The programs of docs/python.md run; whole, they reach what the page says


FOLDER = Path(__file__).parents[2] / "docs" / "examples"


def main_of(name: str) -> Any:
    spec = util.spec_from_file_location(f"docs_example_{name}", FOLDER / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.main


def test_the_agent_in_numpy_runs() -> None:
    assert main_of("numpy_agent")(generations=1, candidates=3, elite=2) > 0.0


def test_ppo_in_one_file_runs() -> None:
    assert len(main_of("ppo")(total_timesteps=256, copies=2, steps=64)) > 2


def test_stable_baselines3_by_hand_runs(tmp_path: Path) -> None:
    assert main_of("sb3_by_hand")(total_timesteps=256, folder=str(tmp_path)) > 0.0


def test_the_loop_in_the_vector_api_runs() -> None:
    assert main_of("vector_loop")(steps=40, copies=2) != {}


def test_the_scenario_of_the_stair_has_no_findings_and_runs_as_a_batch() -> None:
    pytest.importorskip("pybullet_data")
    path = FOLDER / "climb.yaml"
    assert api.lint(path) == []
    assert batch_obstacles(api.compile(path).program) == []


def test_the_package_for_sbx_is_loaded_without_jax_and_stores_weights_as_tensors(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.syspath_prepend(str(FOLDER / "sbx"))
    package = import_module("deepbots_sbx")
    assert [(model.base(), model.import_path) for model in (package.JaxPPO, package.JaxSAC)] == [
        ("PPO", "deepbots_sbx.algorithms:JaxPPO"),
        ("SAC", "deepbots_sbx.algorithms:JaxSAC"),
    ]
    pytest.importorskip("sbx")
    algorithms = import_module("deepbots_sbx.algorithms")
    space = gym.spaces.Box(-1, 1, (4,), np.float32)
    trained, restored = (
        algorithms.JaxPPO("MlpPolicy", _Still(space), n_steps=8, batch_size=8, seed=seed) for seed in (0, 1)
    )
    trained.learn(16)
    for part in trained._get_torch_save_params()[0]:
        getattr(restored, part).load_state_dict(getattr(trained, part).state_dict())
    observations = np.linspace(-1, 1, 40, dtype=np.float32).reshape(10, 4)
    assert all(
        np.array_equal(
            trained.predict(observations, deterministic=d)[0],
            restored.predict(observations, deterministic=d)[0],
        )
        for d in (True, False)
    )


class _Still(gym.Env[Any, Any]):
    """Gives the same observation."""

    def __init__(self, space: gym.spaces.Box) -> None:
        self.observation_space = space
        self.action_space = gym.spaces.Discrete(2)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        return np.zeros(4, np.float32), {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        return np.zeros(4, np.float32), 1.0, False, False, {}


def test_the_page_names_every_program() -> None:
    page = (FOLDER.parent / "python.md").read_text(encoding="utf-8")
    assert all(f"(examples/{path.name})" in page for path in FOLDER.glob("*.py"))


@pytest.mark.slow
def test_whole_they_learn(tmp_path: Path) -> None:
    assert main_of("numpy_agent")() > 150.0
    assert np.mean(main_of("ppo")()[-50:]) > 150.0
    assert main_of("sb3_by_hand")(folder=str(tmp_path)) > 150.0
