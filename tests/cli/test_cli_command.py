"""Commands in general: help, messages, files and progress.

* The command as a whole: help, versions, exit codes, imported modules.
* Messages of commands about mistakes that are not mistakes of a scenario. Each test is named after the report
  of a user.
* Files that commands write are whole or as they were, and nothing but a regular file is replaced.
* The bar that shows how many episodes a command has played.
* Columns of text.
* `python -OO -m deepbots_cli` prints the same: no text for users is a docstring, and no assertion is needed.
"""

from __future__ import annotations

import io
import json
import math
import os
import re
import subprocess
import sys
from importlib.machinery import PathFinder
from importlib.metadata import PackageNotFoundError, metadata
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

import deepbots_cli
from deepbots_cli import api
from deepbots_cli.cli import terminal
from deepbots_cli.cli.command import Commands, _command
from deepbots_cli.cli.commands import COMMANDS, EXCLUDES, GONE, GROUPS, NEEDS, REPLACEMENTS, TAKES, bench
from deepbots_cli.cli.tables import Measured, row_as_lines, table, write_tables
from deepbots_cli.cli.terminal import ProgressBar
from deepbots_cli.diagnostics.render import display_width
from deepbots_cli.engine_kinds import ENGINES
from deepbots_cli.errors import UsageError
from deepbots_cli.files import atomic_write
from deepbots_cli.installation import extra_with, install_hint, requirements
from deepbots_cli.learning.report import TrainingProgress
from deepbots_cli.processes import python_command, python_environment
from deepbots_cli.robots.kinematics import box_around
from deepbots_cli.runtime.overview import extent
from tests.few import few
from tests.golden import cases

EXTRA = ("numpy", "pybullet", "torch", "gymnasium", "stable_baselines3")


def in_process_of_its_own(code: str) -> str:
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout


@pytest.fixture
def hostile(tmp_path):
    """A folder with modules that leave a file beside them when they are imported, under names that deepbots
    and Python import."""
    folder = tmp_path / "hostile"
    folder.mkdir()
    for name in ("typer", "numpy", "torch", "yaml", "json", "pickle", "signal", "sitecustomize"):
        (folder / f"{name}.py").write_text("open(__file__ + '.ran', 'w').close()\n")
    return folder


def test_a_process_of_ours_does_not_import_from_the_working_directory(hostile, monkeypatch):
    command = python_command("deepbots_cli", "--version")
    monkeypatch.setenv("PYTHONPATH", os.pathsep)  # empty entries are the working directory too
    done = subprocess.run(
        command, cwd=hostile, env=python_environment(), capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout == f"deepbots {deepbots_cli.__version__}\n", done.stderr
    assert not list(hostile.glob("*.ran"))


def test_a_process_of_ours_imports_this_deepbots_before_one_on_the_path(hostile, monkeypatch):
    (hostile / "deepbots_cli.py").write_text("open(__file__ + '.ran', 'w').close()\n")
    monkeypatch.setenv("PYTHONPATH", str(hostile))
    path = python_environment()["PYTHONPATH"].split(os.pathsep)
    assert PathFinder.find_spec("deepbots_cli", path).origin == deepbots_cli.__file__


@pytest.mark.slow  # two interpreters start
def test_lint_in_several_processes_does_not_import_from_the_working_directory(hostile, tmp_path):
    script = tmp_path / "lint.py"  # where processes are not forked, as on macOS and Windows
    lines = [
        "import multiprocessing, sys",
        "from deepbots_cli.cli import main",
        "if __name__ == '__main__':",
        "    multiprocessing.set_start_method('spawn')",
        "    sys.exit(main(['lint', 'cartpole', 'find_ball', '--jobs', '2']))",
    ]
    script.write_text("\n".join(lines))
    done = subprocess.run([sys.executable, script], cwd=hostile, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert not list(hostile.glob("*.ran"))


def test_only_one_module_starts_python():
    package = Path(deepbots_cli.__file__).parent
    naming = [
        path.name for path in package.rglob("*.py") if "sys.executable" in path.read_text(encoding="utf-8")
    ]
    assert sorted(naming) == ["bench.py", "processes.py"]  # the former prints it


@pytest.mark.parametrize("verb", COMMANDS)
def test_every_verb_explains_itself_with_examples(deepbots, verb):
    ran = deepbots(verb, "--help")
    assert COMMANDS[verb] in ran.out
    assert f"  deepbots {verb} " in ran.out or f"  deepbots {verb}\n" in ran.out


def test_the_help_of_test_names_a_test_of_the_scenario(deepbots):
    (example,) = [
        line.split()
        for line in deepbots("test", "--help").out.splitlines()
        if " -k " in line and "deepbots test" in line
    ]
    assert any(
        example[example.index("-k") + 1] in test.name for test in api.load("cartpole", tests=True).tests
    )


@pytest.mark.parametrize(
    ("line", "expected"),
    [("deepbots tr", ["try", "train", "transfer"]), ("deepbots train --se", ["--set", "--seed", "--seeds"])],
)
def test_a_shell_completes_commands_and_options(deepbots, monkeypatch, line, expected):
    for name, value in {
        "_DEEPBOTS_COMPLETE": "complete_bash",
        "COMP_WORDS": line,
        "COMP_CWORD": str(len(line.split()) - 1),
    }.items():
        monkeypatch.setenv(name, value)
    assert deepbots().out.split() == expected


def test_eval_has_at_most_twelve_options_outside_advanced(deepbots):
    output = deepbots("eval", "--help").out
    common = output[output.index("\nOptions:") : output.index("\nAdvanced:")]
    assert len([line for line in common.splitlines() if line.startswith("  -")]) <= 12
    assert all(
        option in output[output.index("\nAdvanced:") :]
        for option in ("--allow-code", "--force", "--stochastic")
    )


def test_the_overview_has_at_most_36_commands_in_groups_and_begins_with_three(deepbots):
    output = deepbots("--help").out
    assert len(COMMANDS) <= 36
    assert all(verb in output and summary in output for verb, summary in COMMANDS.items())
    assert [line[:-1] for line in output.splitlines() if line in {f"{group}:" for group in GROUPS}] == list(
        GROUPS
    )
    assert len([line for line in output.splitlines() if line.startswith("    deepbots ")]) == 3


@pytest.mark.parametrize(("words", "instead"), GONE.items())
@pytest.mark.parametrize("joint", [" ", "="])
def test_an_option_that_is_gone_says_what_to_do_instead(deepbots, words, instead, joint):
    verb = "export" if words.startswith("--to") else "train"
    assert (
        f"{words} is gone; {instead}"
        in deepbots(verb, "cartpole", *words.replace(" ", joint).split(), code=2).err
    )


@pytest.mark.parametrize(("old", "new"), REPLACEMENTS.items())
def test_a_command_or_option_of_another_name_says_what_to_write(deepbots, old, new):
    verb = {"--driver": "eval", "--out": "render", "--ros1": "serve"}.get(old, "try")
    words = (verb, "cartpole", old, "x") if old.startswith("--") else (old, "cartpole")
    assert f"use `{new}`" in deepbots(*words, code=2).err
    meant = new.split()[1] if new.startswith("deepbots ") else new.split()[0]
    assert meant in COMMANDS or any(
        meant in parameter.opts
        for verb in COMMANDS
        for parameter in Commands().get_command(None, verb).params
    )


@pytest.mark.parametrize(
    ("gone", "message"),
    [
        (("pygls",), "everything works except what needs a missing extra: the language server, the studio"),
        ((), "everything works"),
        (
            ("torch",),
            "everything works except what needs a missing extra: training, MaskablePPO, RecurrentPPO and"
            " TQC, the studio, policies as ONNX,"
            " --cluster, searches by tune",
        ),
        (
            ("mujoco",),
            "everything works except what needs a missing extra:"
            " simulation, training, MaskablePPO, RecurrentPPO and TQC,"
            " several agents as an environment of PettingZoo, self-play, the page of view and play, videos of"
            " Gymnasium, the studio, policies as ONNX, --cluster, projects of Webots, searches by tune",
        ),
    ],
)
def test_the_doctor_does_not_say_that_everything_works_where_an_extra_is_missing(
    deepbots, monkeypatch, gone, message
):
    def version(name):
        if name in gone:
            raise PackageNotFoundError(name)
        return "1.0"

    monkeypatch.setattr(bench, "version", version)
    assert deepbots("doctor").err == f"{message}\n"


def test_the_doctor_knows_all_extras_of_users(deepbots):
    extras = set(metadata("deepbots-cli").get_all("Provides-Extra")) - {"dev", "docs"}
    checks = json.loads(deepbots("doctor", "--json").out)["checks"]
    assert {check["what"] for check in checks} >= {f"extra {extra}" for extra in extras}


def test_a_missing_module_names_its_extra():
    assert extra_with("PIL") == "sim"  # of the package pillow
    assert extra_with("optuna") == "tune"
    assert extra_with("no_such_module") is None


def test_the_doctor_misses_nothing_that_is_for_other_systems(monkeypatch):
    monkeypatch.setattr(
        "importlib.metadata.requires",
        lambda _: ["lost; sys_platform != 'win32' and extra == 'sim'", "there; extra == 'sim'"],
    )
    assert requirements()["sim"] == ["lost", "there"]
    monkeypatch.setattr(sys, "platform", "win32")
    assert requirements()["sim"] == ["there"]


def test_the_largest_seed_does_not_fill_the_help(deepbots):
    assert all("9223372036854775807" not in deepbots(verb, "--help").out for verb in ("try", "train", "eval"))


def test_an_internal_error_has_its_own_exit_code_and_its_traceback_is_kept(deepbots, monkeypatch, tmp_path):
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", None)
    monkeypatch.setattr(api, "all_findings", lambda *_, **__: 1 // 0)
    ran = deepbots("compile", "cartpole", code=3)
    (kept,) = tmp_path.glob("deepbots-*.txt")
    assert [word for word in ("ZeroDivisionError", str(kept)) if word not in ran.err] == []
    assert "Traceback" not in ran.err
    assert re.search(r"Traceback(.|\n)*1 // 0", kept.read_text())
    monkeypatch.setenv("DEEPBOTS_DEBUG", "1")
    with pytest.raises(ZeroDivisionError):
        deepbots("compile", "cartpole")


def test_a_terminal_with_ascii_only_gets_escapes_instead_of_an_error(tmp_path):
    (tmp_path / "a.yaml").write_text("deepbots: 1\nname: Pölé\n", encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "-m", "deepbots_cli", "lint", "a.yaml"],
        cwd=tmp_path,
        env=os.environ | {"PYTHONIOENCODING": "ascii"},
        capture_output=True,
        check=False,
    )
    assert done.returncode == 1
    assert done.stdout.isascii()
    assert b"Traceback" not in done.stderr


@pytest.mark.parametrize(
    ("words", "absent"),
    [
        (["lint", "cartpole"], (*EXTRA, "rich", "jinja2", "deepbots_webots")),
        (
            ["--help"],
            (*EXTRA, "yaml", "deepbots_cli.scenario", "deepbots_cli.cli.commands.train", "deepbots_webots"),
        ),
    ],
)
def test_a_command_imports_only_what_it_needs(words, absent):
    code = f"import sys; from deepbots_cli.cli import main; main({words}); print([*sys.modules])"
    loaded = in_process_of_its_own(code)
    assert not [name for name in absent if f"'{name}'" in loaded]


WITHOUT = [
    ("bench cartpole", "msgspec", "sim"),
    ("try cartpole", "gymnasium", "sim"),
    ("view cartpole", "gymnasium", "sim"),
    ("serve cartpole --as-robot", "gymnasium", "sim"),
    ("render cartpole -o x.png", "gymnasium", "sim"),
    ("train cartpole", "torch", "train"),
]
"""A command, a package that it needs, and the extra that brings it; a package is imported by none of the
commands before."""


def test_a_missing_extra_is_one_line_with_the_command_that_installs_it():
    code = f"""
import sys
from deepbots_cli.cli import main
for line, absent, _ in {WITHOUT}:
    sys.modules[absent] = None
    print("exit", main(line.split()), file=sys.stderr)
    del sys.modules[absent]
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    lines = done.stderr.splitlines()
    assert lines[1::2] == ["exit 2"] * len(WITHOUT)
    for line, (_, _, extra) in zip(lines[::2], WITHOUT, strict=True):
        assert line.startswith("error: ")
        assert line.endswith(install_hint(extra))


@pytest.mark.slow
def test_commands_that_run_nothing_need_no_extra(tmp_path):
    lines = [
        "lint cartpole",
        "compile cartpole",
        "inspect cartpole",
        "scenarios",
        "lsp --schema --for cartpole",
        "new cartpole there --from cartpole",
        "compile cartpole --project here",
        "explain DB603",
    ]
    block = "".join(f"sys.modules['{name}'] = None; " for name in EXTRA)
    code = (
        f"import sys; {block}from deepbots_cli.cli import main; print([main(line.split()) for line in"
        f" {lines}], file=sys.stderr)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.stderr.splitlines()[-1] == str([0] * len(lines)), done.stderr


def test_the_doctor_finds_this_installation_in_order(deepbots):
    report = json.loads(deepbots("doctor", "--json").out)
    assert report["ok"]
    assert {"mujoco", "scenarios", "engine pybullet", "engine mujoco", "learning"} <= {
        look["what"] for look in report["checks"]
    }
    absent = set() if ENGINES["pybullet"].is_installed else {"engine pybullet"}
    assert {look["what"] for look in report["checks"] if look["state"] != "ok"} == absent


PRINTING = (
    "lint golden --json --preview",
    "inspect multi_cartpole",
    "compile find_ball",
    "diff cartpole find_ball",
    "explain",
    "explain sensor",
    "lsp --schema",
    "nonsense",
)


@pytest.mark.slow  # three interpreters, 10 s of CPU each
def test_output_does_not_depend_on_the_hash_seed(tmp_path):
    cases.write(tmp_path / "golden")
    (tmp_path / "deepbots.toml").touch()
    code = f"from deepbots_cli.cli import main\nfor line in {PRINTING}: print(main(line.split()), flush=True)"
    first, *others = (
        subprocess.run(
            [sys.executable, "-c", code],
            cwd=tmp_path,
            env=python_environment() | {"PYTHONHASHSEED": seed},
            capture_output=True,
            check=True,
        )
        for seed in "123"
    )
    assert len(first.stdout) > 100_000
    assert [(other.stdout, other.stderr) for other in others] == [(first.stdout, first.stderr)] * 2


def test_printed_findings_can_be_read():
    findings = api.load("cartpole", overrides=["fall_angle=1lm"]).findings
    assert repr(findings) == "Findings(['--set fall_angle:1:13: DB501 unknown unit `lm`'])"


def _in_shell(line: str) -> str:
    command = f"{sys.executable} -m deepbots_cli"
    return subprocess.run(
        ["bash", "-c", line.replace("deepbots", command, 1)],
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    ).stdout


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="a shell's pipes")
@pytest.mark.parametrize(
    "verb",
    few(
        ["inspect cartpole", "compile cartpole --program", "lint cartpole", "scenarios", "--help"],
        ("scenarios", "--help"),
    ),
)
def test_the_exit_code_is_the_same_when_nobody_reads_the_output_and_no_error_is_printed(verb):
    *notes, code = _in_shell(f"(deepbots {verb} 2>&3 | true; echo ${{PIPESTATUS[0]}}) 3>&1").splitlines()
    assert (code, [note for note in notes if "rror" in note]) == ("0", [])


@pytest.mark.skipif(os.name != "posix", reason="a shell's pipes")
def test_findings_count_when_nobody_reads_them(tmp_path):
    (tmp_path / "empty.yaml").touch()
    assert _in_shell(f"deepbots lint {tmp_path / 'empty.yaml'} 2>&1 | true; echo ${{PIPESTATUS[0]}}") == "1\n"


@pytest.mark.skipif(os.name != "posix", reason="a shell's redirections")
@pytest.mark.parametrize("closed", [">&-", "2>&- >/dev/null", ">&- 2>&-"])
@pytest.mark.parametrize("verb", few(["--help", "scenarios"], "--help"))
def test_streams_that_were_closed_from_the_start_are_not_a_failure(verb, closed):
    assert _in_shell(f"(deepbots {verb} {closed}; echo $? >&9) 9>&1") == "0\n"


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
@pytest.mark.parametrize("verb", [pytest.param("lsp --schema", marks=pytest.mark.slow), "--help"])
def test_a_full_disk_is_one_clear_line(verb):
    message, code = _in_shell(f"(deepbots {verb} >/dev/full) 2>&1; echo $?").splitlines()
    assert message.startswith("error: ")
    assert message.endswith("no space left on device")
    assert code == "2"


@pytest.mark.parametrize(
    "arguments", [("compile", "cartpole.yaml"), ("lsp", "--schema", "--for", "cartpole.yaml")]
)
def test_a_dash_as_output_file_is_standard_output(deepbots, tmp_path, arguments):
    deepbots("new", "cartpole", "--from", "cartpole", "--json")
    (tmp_path / "-").write_bytes((tmp_path / "cartpole.yaml").read_bytes())
    assert deepbots(*arguments) == deepbots(*arguments, "-o", "-")


def test_the_first_seconds_of_a_training_say_no_time_to_go():
    """The first updates of a training were slow, and it seemed to take 20 min; it took 4."""
    progress = TrainingProgress(
        steps=100, total_steps=100_000, episodes=1, mean_return=None, success_rate=None
    )
    assert progress.seconds_left(0, 1.0) is None
    assert progress.seconds_left(0, 60.0) == pytest.approx(60.0 * 999)
    assert not math.isnan(progress.seconds_left(0, 60.0) or math.nan)


def test_a_robot_on_a_large_field_is_not_a_dot(tmp_path):
    field = "deepbots: 1\nextends: quadruped\nname: Field\n"
    field += "world: {terrain: {type: formula, heights: 1 cm * sin(x / m * 90 deg), size: 40 40 m}}\n"
    (tmp_path / "field.yaml").write_text(field)
    low, high = box_around(extent(api.compile(tmp_path / "field.yaml").program))
    assert max(b - a for a, b in zip(low, high, strict=True)) < 10.0


def put(path: Path, text: str) -> None:
    with atomic_write(path) as draft:
        draft.write_text(text)


def test_a_file_is_replaced_as_a_whole_or_stays_and_keeps_its_permissions_and_links(tmp_path):
    path, link = tmp_path / "there" / "a.txt", tmp_path / "link.txt"
    path.parent.mkdir()
    put(path, "one")
    path.chmod(0o640)
    link.symlink_to(path)
    put(link, "two")
    with pytest.raises(TypeError, match="str"):
        put(path, 2)  # after the draft was opened for writing
    assert (path.read_text(), path.stat().st_mode & 0o777, link.is_symlink()) == ("two", 0o640, True)
    assert {*tmp_path.rglob("*")} == {path.parent, path, link}


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs pipes with names")
def test_a_file_that_is_not_regular_is_written_to_and_not_replaced(tmp_path):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    with open(os.open(pipe, os.O_RDWR), "rb", buffering=0) as reader:
        put(pipe, "through")
        assert (reader.read(20), pipe.is_fifo()) == (b"through", True)


def test_a_folder_that_is_not_there_is_wrong_usage(tmp_path):
    with pytest.raises(UsageError, match="cannot be written: no such file"):
        put(tmp_path / "nowhere" / "a.txt", "")


WRITING = {
    "lsp": ("lsp", "--schema", "-o", "mine.json"),
    "compile": ("compile", "cartpole", "-o", "mine.py"),
    "report": ("report", "run", "-o", "mine.html"),
    "report by its own name": ("report", "mine"),
    "plot": ("plot", "run", "-o", "mine.png"),
    **{
        f"render, {kind}": ("render", "cartpole", "-o", f"mine.{kind}")
        for kind in ("png", "gif", "mp4", "mcap")
    },
    "render by its own name": ("render", "mine.yaml"),
    "test": ("test", "cartpole", "--junit", "mine.xml"),
    "eval, CSV": ("eval", "run", "--csv", "mine.csv"),
    "eval, JUnit": ("eval", "run", "--min-return", "0", "--junit", "mine.xml"),
    "new": ("new", "mine", "--template", "pit"),
    "new, project": ("new", "mine", "--template", "pit", "--project", "."),
    "new, schema": ("new", "mine", "--template", "pit", "--schema"),
    "new, copy": ("new", "mine", "--from", "cartpole"),
    "compile, project": ("compile", "cartpole", "--project", "mine"),
    "export": ("export", "run", "-o", "mine"),
}
PRESENT = (
    "mine.json",
    "mine.py",
    "mine.html",
    "mine.png",
    "mine.gif",
    "mine.mcap",
    "mine.xml",
    "mine.csv",
    "mine.mp4",
    "mine.yaml",
)
"""The files of a user that the commands would write."""


@pytest.mark.parametrize("words", WRITING.values(), ids=WRITING)
def test_no_command_overwrites_a_file_without_force(deepbots, tmp_path, words):
    present = [tmp_path / name for name in (*PRESENT, "cartpole.yaml", "mine/kept.txt")]
    (tmp_path / "mine").mkdir()
    for path in present:
        path.write_text("of the user")
    assert re.fullmatch(
        r"error: ((mine\S*|cartpole.yaml) already exists; overwrite it|mine is not empty; .*) with --force"
        r" .*\n",
        deepbots(*words, code=2).err,
    )
    assert [path.read_text() for path in present] == ["of the user"] * len(present)
    assert {path for path in tmp_path.rglob("*") if path.is_file()} == {*present}


def test_with_force_commands_overwrite(deepbots, tmp_path):
    for words in (
        ("lsp", "--schema", "-o", "mine.json"),
        ("compile", "cartpole", "-o", "mine.py"),
        ("new", "mine", "--template", "pit", "--schema"),
    ):
        for name in PRESENT:
            (tmp_path / name).write_text("of the user")
        (tmp_path / "mine.schema.json").write_text("of the user")
        deepbots(*words, "--force")
        written = {"lsp": "mine.json", "compile": "mine.py", "new": "mine.yaml"}[words[0]]
        assert (tmp_path / written).read_text() != "of the user"
    assert "of the user" not in (tmp_path / "mine.schema.json").read_text()
    deepbots("compile", "cartpole", "--project", ".", "--force")


@pytest.mark.parametrize("table", [NEEDS, EXCLUDES, TAKES])
def test_options_that_go_together_are_options_of_their_command(table):
    for name, entries in table.items():
        known = (
            {option for parameter in _command(name).params for option in parameter.opts} if name else set()
        )
        for options, text in entries.items():
            subject = () if table is TAKES else options.split()
            named = {*subject, *text.partition("; ")[0].removeprefix("all but ").split()}
            assert not name or named <= known, name


def test_every_command_that_writes_a_file_has_force(deepbots):
    for words in WRITING.values():
        assert "--force" in deepbots(words[0], "--help").out


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize("stream", [Terminal(), io.StringIO()])
def test_a_terminal_has_one_line_that_is_erased_and_a_log_a_line_for_every_tenth(stream: io.StringIO) -> None:
    bar = ProgressBar(40, "episodes", stream=stream)
    for number in range(1, 41):
        bar.update(number)
    bar.close()
    text = stream.getvalue()
    if stream.isatty():
        assert "1 of 40 episodes" in text
        assert text.rpartition("40 of 40 episodes")[2].endswith("\x1b[2K")
    else:
        assert [line.partition(" ")[0] for line in text.splitlines()] == [*map(str, range(4, 41, 4))]


@pytest.mark.parametrize(("count", "speed"), [(10, "1 episode/s"), (30, "3 episodes/s")])
def test_a_speed_of_one_is_in_the_singular(monkeypatch: pytest.MonkeyPatch, count: int, speed: str) -> None:
    clock = iter([0.0, 10.0])
    monkeypatch.setattr(terminal.time, "perf_counter", lambda: next(clock))
    stream = io.StringIO()
    ProgressBar(count, "episodes of zero", stream=stream).update(count)
    assert stream.getvalue() == f"{count} of {count} episodes of zero  {speed}\n"


def test_a_second_row_of_episodes_is_counted_and_timed_from_its_own_first_one_on(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    now = 0.0
    monkeypatch.setattr(terminal.time, "perf_counter", lambda: now)
    with terminal.progress() as show:
        for now in (10.0, 20.0, 30.0, 40.0, 50.0, 60.0):
            show(int(now / 10.0 - 1.0) % 3 + 1, 3)
    row = "1 of 3 episodes  20 s to go\n2 of 3 episodes  10 s to go\n3 of 3 episodes\n"
    assert capsys.readouterr().err == row * 2


CELLS = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(),
    st.floats(),
    st.text(max_size=12),
    st.lists(st.text(max_size=3), max_size=3),
)
ROWS = st.lists(st.fixed_dictionaries({"a": CELLS, "b": CELLS, "c": CELLS}), min_size=1, max_size=5)


def test_rows_are_columns_of_text_and_numbers():
    assert table([{"name": "x", "steps": 5}, {"name": "longer", "steps": 12_000}], indent="") == (
        "name     steps\n------  ------\nx            5\nlonger  12,000"
    )
    assert "empty" not in table([{"name": "x", "empty": None, "also": []}])
    assert row_as_lines({"name": "x", "empty": ""}, indent="") == "name  x"
    first, _, second, third = table([{"n": "日本", "m": "x"}, {"n": "ab", "m": "y"}], indent="").splitlines()
    assert display_width(second[: second.index("x")]) == third.index("y") == first.index("m")
    long = [f"j{n}" for n in range(12)]
    assert [row_as_lines({"joints": joints}, indent="") for joints in (long, long[:5])] == [
        "joints  j0, j1, j2, j3, ... 12 in all",
        "joints  j0, j1, j2, j3, j4",
    ]


def test_a_table_has_texts_in_latex_and_numbers_in_csv(tmp_path):
    rows = [
        {
            "run": "a_b & 50% {x}",
            "solved": "[0.9 .. 1]",
            "return": 1.5,
            "success": Measured("33.3%", 1 / 3),
            "success_95 %": Measured("1.0% .. 2.0%", (0.01, 0.02)),
            "empty": None,
        },
        {"run": r"\input|<*>~^#$", "solved": "", "return": None, "success": "", "empty": ""},
    ]
    write_tables(rows, tmp_path / "table.csv", tmp_path / "table.tex", [{"group": "a"}])
    assert [(tmp_path / name).read_text("utf-8").splitlines() for name in ("table.csv", "table.tex")] == [
        [
            "run,solved,return,success,success_low,success_high,empty",
            "a_b & 50% {x},[0.9 .. 1],1.5,0.3333333333333333,0.01,0.02,",
            r"\input|<*>~^#$,,,,,,",
        ],
        [
            r"\begin{tabular}{llrll}",
            r"\toprule",
            r"run & solved & return & success & success\_95 \% \\",
            r"\midrule",
            r"a\_b \& 50\% \{x\} & {[}0.9 .. 1] & 1.5 & 33.3\% & 1.0\% .. 2.0\% \\",
            r"\textbackslash{}input\textbar{}\textless{}{*}\textgreater{}\textasciitilde{}\textasciicircum{}\#\$"
            r" & - & - & - & - \\",
            r"\bottomrule",
            r"\end{tabular}",
            "",
            r"\begin{tabular}{l}",
            r"\toprule",
            r"group \\",
            r"\midrule",
            r"a \\",
            r"\bottomrule",
            r"\end{tabular}",
        ],
    ]


@given(rows=ROWS)
def test_any_values_make_lines_that_no_terminal_obeys(rows):
    text = table(rows)
    assert text.replace("\n", "").isprintable()
    assert text.count("\n") == len(rows) + 1


@example(rows=[{"a": "&", "b": "}", "c": "\\"}])
@given(rows=ROWS)
def test_any_values_make_a_table_of_latex_with_all_columns_and_matching_braces(rows):
    with TemporaryDirectory() as folder:
        write_tables(rows, None, file := Path(folder, "table.tex"))
        begin, _, head, _, *lines, _, _ = file.read_text(encoding="utf-8").splitlines()
    columns = len(begin.rpartition("{")[2]) - 1
    assert len(lines) == len(rows)
    for line in (head, *lines):
        marks = re.sub(r"\\[^a-z]", "", line.removesuffix(r" \\"))
        assert marks.count("&") == columns - 1
        assert not {*re.sub(r"\{.?\}", "", marks)} & {*"{}%$#_^~"}


LINES = [
    *([name, "--help"] for name in COMMANDS),
    ["--help"],
    ["explain", "DB603"],
    ["explain", "DB611"],
    ["explain", "gyro"],
    ["lint", "cartpole"],
]


@pytest.fixture
def same_width(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "100")


def without_docstrings(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-OO", *words], cwd=folder, capture_output=True, text=True, check=True
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    "lines",
    [LINES, pytest.param([["lint", "cartpole", "--deep"]], marks=pytest.mark.slow)],
    ids=["all", "deep"],
)
def test_a_command_prints_the_same_without_docstrings(deepbots, tmp_path, lines, same_width):
    code = f"from deepbots_cli.cli import main\nfor line in {lines}:\n    main(line)"
    printed = [deepbots(*line).out for line in lines]
    assert all(printed)
    assert without_docstrings(tmp_path, "-c", code).stdout == "".join(printed)


@pytest.mark.slow
def test_a_training_is_diagnosed_the_same_without_docstrings(deepbots, tmp_path, same_width):
    trained = without_docstrings(
        tmp_path, "-m", "deepbots_cli", "train", "cartpole", "--timesteps", "2000", "--run", "mine"
    )
    assert "most likely cause: the training is too short" in trained.stdout + trained.stderr
    diagnosis = without_docstrings(tmp_path, "-m", "deepbots_cli", "diagnose", "mine").stdout
    assert "Try: Continue the training" in diagnosis
    assert diagnosis == deepbots("diagnose", "mine").out
