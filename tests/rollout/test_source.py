"""`Source.open` alone says which scenario is meant, and every command refuses the same in the same
sentence."""

import os
import re
import shutil
from pathlib import Path

import pytest

import deepbots_cli
from deepbots_cli import api
from deepbots_cli.cli import main
from deepbots_cli.document import Permissions
from deepbots_cli.errors import RunError, UsageError
from deepbots_cli.rollout.source import Source, SourceKind
from deepbots_cli.scenario import Scenario

SCENARIO = [
    ["train", "?", "--quiet"],
    ["try", "?"],
    ["bench", "?"],
    ["compile", "?"],
    ["compile", "?", "--project", "made"],
    ["lsp", "--schema", "--for", "?"],
]
RUN = [
    ["eval", "?"],
    ["resume", "?"],
    ["diagnose", "?"],
    ["report", "?", "-o", "out.html"],
    ["compare", "?", "?"],
    ["robustness", "?"],
    ["export", "?", "-o", "bundle"],
    ["diagnose", "?", "--episode", "0"],
]
EITHER = [
    ["inspect", "?"],
    ["diff", "?", "cartpole"],
    ["view", "?"],
    ["play", "?"],
]
RENDERED = [["render", "?", "-o", f"one.{suffix}"] for suffix in ("png", "gif", "mcap")]
FOLDER_OR_FILE = [["lint", "?"], ["test", "?"]]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    for name in ("empty", "pictures", "broken", "group/seed-0", "run/models/agent"):
        (tmp_path / name).mkdir(parents=True)
    (tmp_path / "pictures" / "one.png").write_bytes(b"\x89PNG")
    (tmp_path / "noise.bin").write_bytes(b"\0\1\2")
    (tmp_path / "robot.urdf").write_text("<robot/>")
    (tmp_path / "broken" / "run.json").write_text("{")
    (tmp_path / "run" / "run.json").write_text("{")
    (tmp_path / "run" / "models" / "agent" / "best.zip").write_bytes(b"")
    (tmp_path / "group" / "group.json").write_text("{}")
    shutil.copy(Source.open("cartpole").path, tmp_path / "cart.yaml")
    return tmp_path


def refusal_of(words: list[str], name: str, capsys: pytest.CaptureFixture[str]) -> str:
    """The error of a command for a source, which is a sentence in one line."""
    assert main([name if word == "?" else word for word in words]) == 2
    output = capsys.readouterr()
    assert output.out == ""
    assert output.err.count("\n") == 1
    return output.err.removeprefix("error: ").removesuffix("\n")


NOWHERE = "no file, folder or shipped scenario is called '{}'; "
NEAR_CARTPOLE = "did you mean cartpole? (`deepbots scenarios` shows all)"
NOT_A_SOURCE = "{} is not a run, a group or a scenario: it is a folder without run.json or group.json"


@pytest.mark.parametrize(
    ("name", "commands", "sentence"),
    [
        ("cartpool", [*SCENARIO, *RUN, *EITHER, *RENDERED, *FOLDER_OR_FILE], NOWHERE + NEAR_CARTPOLE),
        ("cartpole.yaml", [SCENARIO[0], RUN[0]], NOWHERE + "the shipped scenario is called `cartpole`;"
                                                           " `deepbots new cartpole"),
        ("cart", [*SCENARIO, *RUN, *EITHER, *RENDERED, *FOLDER_OR_FILE], NOWHERE + "did you mean cart.yaml?"),
        ("empty", [*SCENARIO, *RUN, *EITHER, *RENDERED], NOT_A_SOURCE),
        ("pictures", [*SCENARIO, *RUN, *EITHER, *RENDERED], NOT_A_SOURCE),
        ("x" * 300, [*SCENARIO, *RUN, *EITHER, *RENDERED], "{} cannot be read: file name too long"),
        ("robot.urdf", [*SCENARIO, *RUN, *EITHER[1:], *FOLDER_OR_FILE], "{0} is a robot file, not a"
                                                                        " scenario; `deepbots inspect {0}`"),
        ("noise.bin", RUN[:7], "{} is a file, and not a run"),
        ("cart.yaml", RUN[:7], "{} is a scenario, and not a run"),
        ("broken", SCENARIO, "{} is a run, and not a scenario"),
        ("broken", [*RUN[:7], *EITHER, *RENDERED], "{}/run.json is damaged: it is not valid JSON"),
        ("group", [*SCENARIO], "{} is a group of runs, and not a scenario"),
        ("group", [["export", "?", "-o", "bundle"], ["view", "?"]], "{} is a group of runs, and not a "),
        ("run/models/agent/best.zip", [["diagnose", "?"], ["resume", "?"]], "{} is a model of a run, and not"
                                                                            " a run"),
        ("run/models/agent/best.zip", [RUN[0], *RUN[4:], *EITHER, *RENDERED], "run/run.json is damaged: it"
                                                                              " is not valid JSON"),
    ],
)  # fmt: skip
def test_every_command_refuses_a_source_in_the_same_sentence(
    folder: Path, capsys: pytest.CaptureFixture[str], name: str, commands: list[list[str]], sentence: str
) -> None:
    for words in commands:
        assert refusal_of(words, name, capsys).startswith(sentence.format(name)), words


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="root may enter every folder")
def test_a_folder_that_may_not_be_entered_is_refused(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "empty").chmod(0)
    for words in (*SCENARIO, *RUN, *EITHER):
        assert refusal_of(words, "empty", capsys) == "empty cannot be read: permission denied"


def test_a_scenario_in_memory_is_no_run(folder: Path) -> None:
    scenario = Scenario.from_yaml(Source.open("cartpole").path)
    with pytest.raises(RunError, match="<Scenario CartPole> is a scenario, and not a run"):
        Source.open(scenario, Permissions(), SourceKind.RUN)


def test_a_source_says_what_it_is(folder: Path) -> None:
    kinds = {
        "cartpole": SourceKind.SCENARIO,
        "cart.yaml": SourceKind.SCENARIO,
        "run": SourceKind.RUN,
        "group": SourceKind.GROUP,
    }
    kinds |= {"run/models/agent/best.zip": SourceKind.CHECKPOINT}
    (folder / "cartpole").mkdir()  # does not hide the shipped scenario
    assert {name: Source.open(name).kind for name in kinds} == kinds
    checkpoint = Source.open("run/models/agent/best.zip")
    assert (checkpoint.path, checkpoint.model) == (Path("run"), "best")
    (folder / "one.mcap").touch()
    assert Source.open("one.mcap").kind is SourceKind.RECORDING
    scenario = Scenario.from_yaml(Source.open("cartpole").path)
    assert Source.open(scenario).checked().program is not None
    with pytest.raises(RunError, match="run is a run, and not a group of runs"):
        Source.open("run", Permissions(), SourceKind.GROUP)


def test_the_python_api_refuses_as_the_commands_do(folder: Path) -> None:
    for call in (api.load, api.compile, api.make, api.lint, deepbots_cli.train):
        with pytest.raises(UsageError, match=re.escape(NOT_A_SOURCE.format("empty"))):
            call("empty")
    for call in (deepbots_cli.evaluate, deepbots_cli.resume, deepbots_cli.load_policy):
        with pytest.raises(RunError, match=re.escape(NOT_A_SOURCE.format("empty"))):
            call("empty")


def test_one_module_alone_resolves_the_name_of_a_scenario() -> None:
    """The files by which a run, a group and a recording are known are looked for in one module."""
    root = Path(deepbots_cli.__file__).parent
    looks = re.compile(
        r"""RECORD_NAME\)\.(is_file|exists)|(run|group)\.json["']\)\.(is_file|exists)|["']\.mcap["']"""
    )
    assert [
        path.relative_to(root).as_posix()
        for path in root.rglob("*.py")
        if looks.search(path.read_text("utf-8"))
    ] == ["rollout/source.py"]
