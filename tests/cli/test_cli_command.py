"""The command as a whole: help, versions, exit codes, imported modules."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from importlib.machinery import PathFinder
from importlib.metadata import PackageNotFoundError, metadata
from pathlib import Path

import pytest

import deepbots_cli
from deepbots_cli import api
from deepbots_cli.cli.command import Commands
from deepbots_cli.cli.commands import COMMANDS, GONE, GROUPS, REPLACEMENTS, doctor
from deepbots_cli.engine_kinds import ENGINES
from deepbots_cli.installation import extra_with, install_hint, requirements
from deepbots_cli.processes import python_command, python_environment
from tests.few import few

EXTRA = ("numpy", "pybullet", "torch", "gymnasium", "stable_baselines3")


def in_process_of_its_own(code: str) -> str:
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return done.stdout


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
    assert sorted(naming) == ["doctor.py", "processes.py"]  # the former prints it


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


@pytest.mark.parametrize("verb", COMMANDS)
def test_every_example_in_the_help_is_a_command_line_that_parses(deepbots, verb):
    command = Commands().get_command(None, verb)
    examples = [line.strip().split("  ")[0].split(" && ")[0].split() for line in command.help.splitlines()]
    for words in [words for words in examples if words[:2] == ["deepbots", verb]]:
        command.make_context(verb, words[2:]).close()


def test_the_overview_lists_every_verb(deepbots):
    ran = deepbots("--help")
    assert all(verb in ran.out and summary in ran.out for verb, summary in COMMANDS.items())


@pytest.mark.parametrize(
    ("line", "expected"),
    [("deepbots tr", ["try", "train", "transfer"]), ("deepbots train --se", ["--set", "--seed", "--seeds"])],
)
def test_a_shell_completes_commands_and_options(deepbots, monkeypatch, line, expected):
    words = line.split()
    for name, value in {
        "_DEEPBOTS_COMPLETE": "complete_bash",
        "COMP_WORDS": line,
        "COMP_CWORD": str(len(words) - 1),
    }.items():
        monkeypatch.setenv(name, value)
    assert deepbots().out.split() == expected


def test_the_version_is_that_of_the_package(deepbots):
    assert deepbots("--version").out == f"deepbots {deepbots_cli.__version__}\n"


def test_eval_has_at_most_twelve_options_outside_advanced(deepbots):
    output = deepbots("eval", "--help").out
    common = output[output.index("\nOptions:") : output.index("\nAdvanced:")]
    assert len([line for line in common.splitlines() if line.startswith("  -")]) <= 12
    assert all(
        option in output[output.index("\nAdvanced:") :]
        for option in ("--allow-code", "--force", "--stochastic")
    )


def test_the_overview_has_at_most_33_commands_in_groups_and_begins_with_three(deepbots):
    output = deepbots("--help").out
    assert len(COMMANDS) <= 33
    assert [line[:-1] for line in output.splitlines() if line in {f"{group}:" for group in GROUPS}] == list(
        GROUPS
    )
    assert len([line for line in output.splitlines() if line.startswith("    deepbots ")]) == 3


@pytest.mark.parametrize(("words", "instead"), GONE.items())
@pytest.mark.parametrize("joint", [" ", "="])
def test_an_option_that_is_gone_says_what_to_do_instead(deepbots, words, instead, joint):
    verb = "export" if words.startswith("--to") else "train"
    ran = deepbots(verb, "cartpole", *words.replace(" ", joint).split(), code=2)
    assert f"{words} is gone; {instead}" in ran.err


@pytest.mark.parametrize(("old", "new"), REPLACEMENTS.items())
def test_a_command_or_option_of_another_name_says_what_to_write(deepbots, old, new):
    verb = "eval" if old == "--driver" else "try"
    words = (verb, "cartpole", old, "x") if old.startswith("--") else (old, "cartpole")
    ran = deepbots(*words, code=2)
    assert f"use `{new}`" in ran.err
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
            " several agents as an environment of PettingZoo, self-play, the page of view and play, the studio,"
            " PROTOs of Webots with JavaScript, policies as ONNX,"
            " --cluster, searches by tune",
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

    monkeypatch.setattr(doctor, "version", version)
    ran = deepbots("doctor")
    assert ran.err == f"{message}\n"


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
    assert "ZeroDivisionError" in ran.err
    assert "Traceback" not in ran.err
    (kept,) = tmp_path.glob("deepbots-*.txt")
    assert str(kept) in ran.err
    assert "Traceback" in kept.read_text()
    assert "1 // 0" in kept.read_text()


def test_a_fault_of_ours_is_raised_for_those_who_debug(deepbots, monkeypatch):
    monkeypatch.setenv("DEEPBOTS_DEBUG", "1")
    monkeypatch.setattr(api, "all_findings", lambda *_, **__: 1 // 0)
    with pytest.raises(ZeroDivisionError):
        deepbots("compile", "cartpole")


def test_a_terminal_with_ascii_only_gets_escapes_instead_of_an_error(tmp_path):
    (tmp_path / "a.yaml").write_text("deepbots: 1\nname: Pölé\n", encoding="utf-8")
    command = [sys.executable, "-m", "deepbots_cli", "lint", "a.yaml"]
    done = subprocess.run(
        command,
        cwd=tmp_path,
        env=os.environ | {"PYTHONIOENCODING": "ascii"},
        capture_output=True,
        check=False,
    )
    assert done.returncode == 1
    assert done.stdout.isascii()
    assert b"Traceback" not in done.stderr


def test_linting_imports_neither_simulator_nor_learner():
    code = (
        "import sys; from deepbots_cli.cli import main; assert main(['lint', 'cartpole']) == 0;"
        " print([*sys.modules])"
    )
    loaded = in_process_of_its_own(code)
    assert not [name for name in (*EXTRA, "rich", "jinja2") if f"'{name}'" in loaded]


WITHOUT = [
    ("try cartpole", "gymnasium", "sim"),
    ("bench cartpole", "msgspec", "sim"),
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


def test_the_overview_imports_no_verb_and_not_even_the_language():
    code = "import sys; from deepbots_cli.cli import main; main(['--help']); print([*sys.modules])"
    loaded = in_process_of_its_own(code)
    assert "'deepbots_cli.scenario'" not in loaded
    assert "'deepbots_cli.cli.commands.train'" not in loaded


def test_the_package_runs_as_a_module():
    done = subprocess.run(
        [sys.executable, "-m", "deepbots_cli", "--version"], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0
    assert done.stdout == f"deepbots {deepbots_cli.__version__}\n"


def test_scenarios_and_runs_are_listed_even_damaged_ones(deepbots, tmp_path):
    (tmp_path / "runs" / "broken").mkdir(parents=True)
    (tmp_path / "runs" / "broken" / "run.json").write_text("{")
    (tmp_path / "runs" / "no_run").mkdir()
    assert "cartpole" in [row["name"] for row in json.loads(deepbots("scenarios", "--json").out)["scenarios"]]
    assert "free pole" in deepbots("scenarios").out
    assert [(row["name"], row["state"]) for row in json.loads(deepbots("runs", "--json").out)] == [
        ("broken", "unreadable")
    ]
    ran = deepbots("runs")
    assert "broken: runs/broken/run.json is damaged: it is not valid JSON" in ran.err


def test_without_runs_the_list_says_how_to_make_one(deepbots):
    ran = deepbots("runs")
    assert ran.out == ""
    assert "deepbots train cartpole" in ran.err


def test_the_doctor_finds_this_installation_in_order(deepbots):
    ran = deepbots("doctor", "--json")
    report = json.loads(ran.out)
    assert report["ok"]
    assert {"mujoco", "scenarios", "engine pybullet", "engine mujoco", "learning"} <= {
        look["what"] for look in report["checks"]
    }
    absent = set() if ENGINES["pybullet"].is_installed else {"engine pybullet"}
    assert {look["what"] for look in report["checks"] if look["state"] != "ok"} == absent


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
    assert code == "0"
    assert [note for note in notes if "rror" in note] == []


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
@pytest.mark.parametrize("verb", ["lsp --schema", "--help"])
def test_a_full_disk_is_one_clear_line(verb):
    message, code = _in_shell(f"(deepbots {verb} >/dev/full) 2>&1; echo $?").splitlines()
    assert message.startswith("error: ")
    assert message.endswith("no space left on device")
    assert code == "2"


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_a_full_disk_of_a_file_with_a_name_is_one_clear_line_with_the_remedy(deepbots):
    ran = deepbots("compile", "cartpole", "-o", "/dev/full", code=2)
    assert (ran.code, ran.err.count("\n")) == (2, 1)
    assert ran.err.startswith("error: ")
    assert ran.err.endswith("no space left on device; free some space there, and try again\n")


def test_compile_does_not_write_over_the_scenario(deepbots, tmp_path):
    deepbots("new", "cartpole", "--from", "cartpole", "--json")
    before = (tmp_path / "cartpole.yaml").read_bytes()
    ran = deepbots("compile", "cartpole.yaml", "-o", "cartpole.yaml", code=2)
    assert "cartpole.yaml is an input of the scenario" in ran.err
    assert (tmp_path / "cartpole.yaml").read_bytes() == before


@pytest.mark.parametrize(
    "arguments", [("compile", "cartpole.yaml"), ("lsp", "--schema", "--for", "cartpole.yaml")]
)
def test_a_dash_as_output_file_is_standard_output(deepbots, tmp_path, arguments):
    deepbots("new", "cartpole", "--from", "cartpole", "--json")
    (tmp_path / "-").write_bytes((tmp_path / "cartpole.yaml").read_bytes())
    printed = deepbots(*arguments)
    assert deepbots(*arguments, "-o", "-") == printed
