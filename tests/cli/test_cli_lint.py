"""`deepbots lint` and `deepbots explain`.

* `deepbots lint`: its output and its exit code, for good files and bad ones.
* What `deepbots lint` is asked for, by options and by the settings of a project.
* `deepbots lint --deep`, on the command line.
* `deepbots lint --exploits`, on the command line.
* A rule or the compiler that raises an exception on one file: a finding of that file, and everything else is
  linted all the same.
* Files for other programs that run `deepbots lint` or read its output: a hook and a problem matcher.
* `deepbots explain`: the meaning of a finding, in the terminal and for programs.
* The files that `lint --watch`, `view --watch` and the studio watch, against those that the interpreter opens.
"""

from __future__ import annotations

import io
import json
import os
import re
import shlex
import shutil
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from xml.etree import ElementTree

import numpy as np
import pytest
import yaml
from hypothesis import example, given, settings
from hypothesis import strategies as st

from deepbots_cli import api
from deepbots_cli.cli import main, written_files
from deepbots_cli.cli.command import Commands
from deepbots_cli.cli.commands.lint import LintOptions
from deepbots_cli.cli.explanations import Topic, topics
from deepbots_cli.compiler import check
from deepbots_cli.diagnostics import RULES, Finding
from deepbots_cli.diagnostics import Source as SourceText
from deepbots_cli.document import loads, shipped
from deepbots_cli.files import recorded_reads
from deepbots_cli.installation import install_hint
from deepbots_cli.lint import all_findings, run
from deepbots_cli.lint.context import RuleContext, Simulation, rule
from deepbots_cli.lint.pages import every_page
from deepbots_cli.lint.settings import settings as project_settings
from deepbots_cli.lsp.server import diagnostics
from deepbots_cli.lsp.workspace import Document, analyze, uri_of
from deepbots_cli.processes import VERDICT_FILE
from deepbots_cli.view.episodes import Showing
from tests.commands import Ran
from tests.worlds import CART

CARTPOLE = (
    shipped.scenario_path("cartpole")
    .read_text(encoding="utf-8")
    .replace("../robots/urdf/cartpole.urdf", "cartpole")
)

BAD = {
    "empty": b"",
    "blank": b"\n  \n",
    "tabs": b"deepbots: 1\nworld:\n\ttimestep: 1 s\n",
    "binary": bytes(range(256)),
    "zeros": b"\0" * 1000,
    "utf16": "deepbots: 1".encode("utf-16"),
    "latin1": "name: Pöl".encode("latin-1"),
    "list": b"- 1\n- 2\n",
    "scalar": b"hello\n",
    "brackets": b"[" * 100_000,
    "braces": b"{" * 100_000,
    "dashes": b"- " * 100_000,
    "aliases": b"a: &a [x,x,x,x,x,x,x,x,x]\n"
    + b"".join(b"%c: &%c [%s]\n" % (98 + i, 98 + i, b",".join([b"*%c" % (97 + i)] * 9)) for i in range(9)),
    "itself": b"a: &a [*a]\n",
    "newer": b"deepbots: 99\n",
    "escapes": b'deepbots: 1\nname: "\\e[2J"\n',
}


@pytest.mark.parametrize("content", BAD.values(), ids=BAD.keys())
def test_no_file_whatever_gives_more_than_findings(deepbots, tmp_path, content):
    (tmp_path / "bad.yaml").write_bytes(content)
    ran = deepbots("lint", "bad.yaml", code=1)
    assert "error DB" in ran.out
    assert "Traceback" not in ran.err
    assert "\x1b" not in ran.out


@given(
    value=st.text(max_size=40),
    path=st.sampled_from(["world.timestep", "fall_angle", "reward.alive", "name", "", "action"]),
)
def test_arbitrary_assignments_never_end_in_a_fault(value, path):
    assert main(["lint", "cartpole", "--set", f"{path}={value}", "--format", "json"]) in (0, 1)


@pytest.mark.skipif(os.name != "posix", reason="Windows has no paths of that length")
def test_folders_in_folders_by_the_hundred_are_searched_without_a_fault(deepbots, tmp_path, monkeypatch):
    (tmp_path / "real.yaml").write_text("deepbots: 1\n")
    monkeypatch.chdir(tmp_path)
    for _ in range(1200):
        os.mkdir("a")
        os.chdir("a")
    deepest = Path.cwd()
    monkeypatch.chdir(tmp_path)
    ran = deepbots("lint", ".", "--format", "concise", code=1)
    os.chdir(deepest)
    for _ in range(1200):  # what pytest removes folders with calls itself as well
        os.chdir("..")
        os.rmdir("a")
    assert (ran.out[:10], ran.err) == ("real.yaml:", "")


def test_a_file_that_is_named_in_two_ways_is_linted_once(deepbots, tmp_path, monkeypatch):
    (tmp_path / "a.yaml").write_text("deepbots: 1\n")
    monkeypatch.chdir(tmp_path)
    once = deepbots("lint", "a.yaml", code=1).out
    assert deepbots("lint", "a.yaml", "./a.yaml", tmp_path / "a.yaml", code=1).out == once


@pytest.mark.parametrize("format", ["github", "sarif", "junit"])
def test_a_report_for_other_programs_goes_to_standard_output_and_is_the_same_each_time(
    deepbots, tmp_path, format
):
    (tmp_path / "a.yaml").write_text("deepbots: 1\n")
    ran = deepbots("lint", tmp_path / "a.yaml", "cartpole", "--format", format, code=1)
    assert ran.err == ""
    assert "DB102" in ran.out
    assert str(tmp_path) not in ran.out
    assert deepbots("lint", tmp_path / "a.yaml", "cartpole", "--format", format, code=1).out == ran.out


WARNED = CARTPOLE.replace("summary:", "summary: on #").replace("15 deg", "15 rad")
BROKEN = CARTPOLE.replace("abs(x) > track", "abs(xx) > track")


@pytest.fixture
def files(deepbots, tmp_path):
    """Two scenarios: one with a DB003 and a DB504, one with a DB402."""
    (tmp_path / "warned.yaml").write_text(WARNED)
    (tmp_path / "broken.yaml").write_text(BROKEN)
    return tmp_path


def codes(ran):
    return [finding["code"] for finding in json.loads(ran.out)["findings"]]


def feed(monkeypatch, data: bytes) -> None:
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(data)))


def test_standard_input_is_linted_as_the_file_that_it_is_of(deepbots, files, monkeypatch):
    (files / "worlds").mkdir()
    (files / "worlds" / "base.yaml").write_text(CARTPOLE)
    feed(monkeypatch, b"deepbots: 1\nextends: base.yaml\nsummary: on\n")
    assert deepbots(
        "lint", "-", "--stdin-filename", "worlds/unsaved.yaml", "--format", "concise"
    ).out.startswith("worlds/unsaved.yaml:3:10: warning DB003")
    feed(monkeypatch, CARTPOLE.replace("truncation:", "truncaton:").encode())
    assert "--fix" not in deepbots("lint", "-", code=1).err  # which takes files only


def test_standard_input_needs_no_name_and_is_any_bytes(deepbots, files, monkeypatch):
    feed(monkeypatch, b"\xff\xfe\x00")
    ran = deepbots("lint", "-", "--json", code=1)
    assert {finding["file"] for finding in json.loads(ran.out)["findings"]} == {"<stdin>"}


def test_several_processes_say_the_same_in_the_same_order(deepbots, files):
    for name in ("b", "a", "c"):
        (files / f"{name}.yaml").write_text(WARNED)
    single = deepbots("lint", "c.yaml", ".", "--format", "concise", code=1)
    assert deepbots("lint", "c.yaml", ".", "--format", "concise", "--jobs", 3, code=1) == single
    assert len(single.out.splitlines()) == 9


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[lint]\nselct = ['DB5']\n", "unknown key 'selct'; did you mean 'select'?"),
        ("[lnt]\nselect = ['DB5']\n", "unknown key 'lnt'; did you mean 'lint'?"),
        ("[lint]\nselect = 'DB5'\n", "'select' must be a list of codes in quotes"),
        ("[lint]\nselect = ['DB77']\n", "deepbots.toml: there is no finding 'DB77'"),
        ("[lint]\nfail-on = 'errors'\n", "did you mean 'error'?"),
        ("[lint]\nformat = 3\n", "use one of full, concise"),
        ("[lint]\npreview = 'yes'\n", "'preview' must be true or false"),
        ("[lint]\nexclude = [3]\n", "'exclude' must be a list of patterns"),
        ("lint = 3\n", "'lint' must be a table of settings"),
        ("[lint\n", "deepbots.toml cannot be read"),
        ("select = " + "[" * 10_000, "its values are nested too deep"),
        ("# " + "x" * 300_000, "deepbots.toml is larger than the limit of 256 KiB"),
        ("[lint]\nexclude = [" + "'*', " * 2000 + "]\n", "'exclude' has 2,000 entries; the limit is 1,000"),
    ],
)
def test_settings_that_mean_nothing_are_wrong_usage_in_one_line(deepbots, files, text, message):
    (files / "deepbots.toml").write_text(text)
    ran = deepbots("lint", "warned.yaml", code=2)
    assert message in ran.err
    assert ran.err.count("\n") == 1


def test_the_settings_in_the_docs_are_settings(deepbots, files):
    page = (Path(__file__).parents[2] / "docs" / "linting.md").read_text(encoding="utf-8")
    (example,) = re.findall(r"```toml\n(.*?)```", page, re.DOTALL)
    (files / "deepbots.toml").write_text(example)
    ran = deepbots("lint", "warned.yaml", code=1)
    assert [line.split()[2] for line in ran.out.splitlines()] == [
        "DB003[yaml11-boolean]",
        "DB504[degrees-as-radians]",
    ]


@pytest.fixture
def watched(deepbots, monkeypatch):
    """Watch while these files get contents one after the other, until Ctrl-C."""

    def watch(changes: Iterable[tuple[Path, bytes]], *words: str) -> Ran:
        changes = iter(changes)

        def save_or_interrupt(_):
            file, content = next(changes, (None, b""))
            if file is None:
                raise KeyboardInterrupt
            file.write_bytes(content)

        monkeypatch.setattr("time.sleep", save_or_interrupt)
        return deepbots("lint", *words, "--watch")

    return watch


def test_watching_lints_again_when_a_file_is_saved(deepbots, files, watched):
    texts = (CARTPOLE, CARTPOLE.replace("alive: 1", "alive: 1 m"))
    ran = watched(
        [(files / "broken.yaml", text.encode()) for text in texts], "broken.yaml", "--format", "concise"
    )
    codes_shown = re.findall(r"DB\d+", ran.out)
    assert (codes_shown[0], codes_shown[-1], len(codes_shown)) == ("DB402", "DB503", 2)
    assert ran.err.count("watching 2 files; Ctrl-C ends it") == 3
    deepbots("lint", "broken.yaml", "--watch", "--fix", code=2)


def test_watching_lints_again_when_a_file_is_saved_while_it_is_linted(deepbots, files, watched, monkeypatch):
    saved = iter([CARTPOLE])

    def save(_format):
        for text in saved:
            (files / "broken.yaml").write_text(text)
        return "12:00:00"

    monkeypatch.setattr("time.strftime", save)  # after the files were read, and before the first look at them
    assert watched([], "broken.yaml").err.count("Ctrl-C ends it") == 2


def test_without_the_simulator_it_is_wrong_usage_that_says_what_to_install(deepbots, monkeypatch):
    for engine in ("pybullet", "mujoco"):
        monkeypatch.setitem(sys.modules, engine, None)  # as if it were not installed
    assert install_hint("sim") in deepbots("lint", "cartpole", "--deep", code=2).err


HERE = Path(__file__).parents[1] / "lint"
PARKED = """\
deepbots: 1
extends: arm.yaml
name: Parked
reward:
  high: arm.angle / (90 deg)
"""


@pytest.fixture
def parked(deepbots, tmp_path):
    for name in ("arm.yaml", "arm.urdf"):
        shutil.copy(HERE / name, tmp_path)
    (tmp_path / "parked.yaml").write_text(PARKED)
    return tmp_path


def test_an_exploit_is_a_finding_like_any_other_and_its_recording_is_exact(deepbots, parked, monkeypatch):
    monkeypatch.setenv(VERDICT_FILE, "verdict")
    deepbots("lint", "parked.yaml", "--exploits", "--select", "DB713", "--fail-on", "warning", code=1)
    # The studio shows the finding, and plays the recording.
    recording = "; `deepbots view exploits/parked/pays-without-success.mcap` shows the episode"
    verdict = Path("verdict").read_text("utf-8")
    assert re.fullmatch(rf"1 warning\nparked\.yaml:5:9: .*{re.escape(recording)}", verdict)
    assert (
        deepbots("replay", "--verify", "exploits/parked/pays-without-success.mcap").out.split(": ")[1]
        == "1 episode and 60 steps are the same to the bit\n"
    )
    assert written_files.was_searched(api.compile("parked.yaml").program)
    assert not written_files.was_searched(api.compile("parked.yaml", overrides=["reward.high=0"]).program)


@pytest.mark.usefixtures("simulated_here")
def test_a_search_replaces_the_recordings_of_an_earlier_one_and_no_other_file(deepbots, parked):
    kept = parked / "exploits" / "parked" / "mine.mcap"
    old = parked / "exploits" / "parked" / "early-end-pays.mcap"
    kept.parent.mkdir(parents=True)
    for file in (kept, old):
        file.touch()
    assert (
        deepbots("lint", "parked.yaml", "--exploits", "--ignore", "DB7").out
        == "parked.yaml: no findings among the selected rules, including the search for exploits\n"
    )
    assert sorted(file.name for file in kept.parent.iterdir()) == [
        "mine.mcap",
        "pays-without-success.mcap",
        "searched.json",
    ]


@pytest.mark.parametrize("content", ["", "[]", "{", '{"task": 1}', "\xff", "[" * 5000])
def test_a_damaged_record_counts_as_no_search(deepbots, parked, content):
    record = parked / "exploits" / "parked" / "searched.json"
    record.parent.mkdir(parents=True)
    record.write_text(content, encoding="latin-1")
    assert not written_files.was_searched(api.compile("parked.yaml").program)


def test_a_folder_that_cannot_be_written_is_named_before_the_search(deepbots, parked):
    (parked / "exploits").touch()
    assert (
        deepbots("lint", "parked.yaml", "--exploits", code=2).err
        == f"error: exploits/parked cannot be written: {parked / 'exploits'} is not a directory\n"
    )


@pytest.mark.parametrize(("module", "extra"), [("mcap", "sim"), ("gymnasium", "sim")])
def test_without_the_extra_it_says_how_to_install_it(deepbots, parked, monkeypatch, module, extra):
    monkeypatch.setitem(sys.modules, module, None)
    assert install_hint(extra) in deepbots("lint", "parked.yaml", "--exploits", code=2).err


@rule("DB801")
def breaking(context: RuleContext) -> Iterator[Finding]:
    """Fails on the scenario that is named Broken."""
    if context.program.name == "Broken":
        raise IndexError("tuple index\nout of range")
    yield from ()


@rule("DB702")
def breaking_too(simulation: Simulation) -> Iterator[Finding]:
    """Fails on every scenario."""
    raise KeyError(simulation.checked.document.path.name)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Two scenarios, each with a warning; a rule fails on the first."""
    for file, name in (("a.yaml", "Broken"), ("b.yaml", "Whole")):
        text = CARTPOLE.replace("name: CartPole", f"name: {name}")
        (tmp_path / file).write_text(text + "\nsignals: {spare: abs(x)}\n")
    monkeypatch.setattr(run, "STATIC_RULES", (breaking, *run.STATIC_RULES))
    return tmp_path


def test_a_rule_that_fails_hides_neither_other_findings_nor_other_files(deepbots, folder) -> None:
    ran = deepbots("lint", ".", "--format", "concise", code=3)
    rows = [line.split()[:3] for line in ran.out.splitlines()]
    assert rows == [
        ["a.yaml:1:1:", "error", "DB903[rule-failed]"],
        [rows[1][0], "warning", "DB205[unused-definition]"],
        [rows[1][0].replace("a.", "b."), "warning", "DB205[unused-definition]"],
    ]
    assert "the rule DB801 failed on this file: IndexError: tuple index out of range" in ran.out
    assert re.search(r" \(deepbots_cli\.lint\.context:\d+\)", ran.out), "the innermost place in deepbots"
    assert "Traceback" not in ran.out + ran.err


@pytest.mark.parametrize(
    "words", [("--select", "DB7"), ("--ignore", "DB903"), ("--exit-zero",), ("--jobs", "2")]
)
def test_no_option_hides_a_rule_that_failed(deepbots, folder, words) -> None:
    assert "DB903" in deepbots("lint", ".", *words, code=3).out


def test_those_who_debug_get_the_exception_of_a_rule(deepbots, folder, monkeypatch) -> None:
    monkeypatch.setenv("DEEPBOTS_DEBUG", "1")
    with pytest.raises(IndexError):
        deepbots("lint", "a.yaml")


def test_every_format_reports_a_rule_that_failed_at_the_start_of_the_file(deepbots, folder) -> None:
    (finding, _) = json.loads(deepbots("lint", "a.yaml", "--json", code=3).out)["findings"]
    assert (finding["code"], finding["severity"]) == ("DB903", "error")
    assert finding["start"] == {"line": 1, "column": 1}
    assert "report this message" in finding["help"]
    assert deepbots("lint", "a.yaml", "--format", "github", code=3).out.startswith(
        "::error title=DB903 rule-failed,file=a.yaml,line=1,"
    )
    (run,) = json.loads(deepbots("lint", "a.yaml", "--format", "sarif", code=3).out)["runs"]
    assert [(result["ruleId"], result["level"]) for result in run["results"]] == [
        ("DB903", "error"),
        ("DB205", "warning"),
    ]
    report = ElementTree.fromstring(deepbots("lint", "a.yaml", "--format", "junit", code=3).out)
    assert (report.get("errors"), report.get("failures")) == ("1", "0")
    assert [error.get("type") for error in report.iter("error")] == ["DB903"]


def test_an_exception_of_the_compiler_on_one_file_is_a_finding_of_it(deepbots, folder, monkeypatch) -> None:
    load = api.load
    monkeypatch.setattr(api, "load", lambda name, **options: load(name, **options) if "b" in name else 1 // 0)
    ran = deepbots("lint", ".", "--format", "concise", code=3)
    assert ran.out.startswith(
        "a.yaml:1:1: error DB903[rule-failed] the compiler failed on this file: ZeroDivisionError"
    )
    assert "b.yaml" in ran.out


def test_a_scenario_on_which_a_rule_fails_still_compiles(folder) -> None:
    assert [finding.code for finding in api.compile(folder / "a.yaml").findings] == ["DB903", "DB205"]


def test_an_editor_shows_a_rule_that_failed_beside_the_other_findings(folder) -> None:
    path = folder / "a.yaml"
    document = Document(path.as_uri(), 1, path.read_text(encoding="utf-8"), path)
    (diagnostic, _) = diagnostics(analyze(document, {}), {})[path.as_uri()]
    assert (diagnostic.code, diagnostic.range.start.line, diagnostic.range.start.character) == ("DB903", 0, 0)


@pytest.mark.slow
def test_a_rule_that_fails_after_a_simulation_does_not_hide_what_the_others_measure(
    deepbots, folder, monkeypatch
) -> None:
    monkeypatch.setattr(run, "SIMULATED_RULES", (breaking_too, *run.SIMULATED_RULES))
    ran = deepbots(
        "lint",
        "b.yaml",
        "--deep",
        "--preview",
        "--set",
        "observation={cart.pole_angle: -20 .. 20 deg, x: 5 .. 6 m}",
        code=3,
    )
    assert "the rule DB702 failed on this file: KeyError: 'b.yaml'" in ran.out
    assert "DB611" in ran.out


def test_the_message_of_an_exception_is_cut() -> None:
    from deepbots_cli.diagnostics.findings import exception_finding

    fault = ValueError("long " * 10_000)
    assert len(exception_finding("the rule DB801", SourceText("a.yaml", ""), fault).headline) < 300


ROOT = Path(__file__).parents[2]


@pytest.fixture
def hook():
    (only,) = yaml.safe_load((ROOT / ".pre-commit-hooks.yaml").read_text())
    return only


@pytest.fixture
def pattern():
    (matcher,) = json.loads((ROOT / ".github" / "deepbots-problem-matcher.json").read_text())[
        "problemMatcher"
    ]
    (only,) = matcher["pattern"]
    return only


def test_the_hook_for_commits_lints_the_scenarios_of_a_repository(deepbots, tmp_path, hook):
    command, *words = [*shlex.split(hook["entry"]), *hook["args"]]
    assert (command, hook["language"], hook["pass_filenames"]) == ("deepbots", "python", False)
    for name in ("scenarios/a.yaml", "robots/a.urdf", "b.yml"):
        assert re.search(hook["files"], name)
        assert not re.search(hook["files"], name + ".orig")
    (tmp_path / "scenarios").mkdir()
    (tmp_path / "scenarios" / "mine.yaml").write_text(CARTPOLE)
    (tmp_path / "scenarios" / "part.yaml").write_text("a: 1\n")
    deepbots(*words)
    (tmp_path / "scenarios" / "mine.yaml").write_text(CARTPOLE.replace("timestep:", "timestop:"))
    assert deepbots(*words, code=1).out.startswith("scenarios/mine.yaml:")


@pytest.mark.parametrize("name", ["a.yaml", "my worlds/a.yaml", "a:1:2: b.yaml"])
def test_the_problem_matcher_reads_each_line_of_the_concise_format(deepbots, tmp_path, pattern, name):
    (tmp_path / name).parent.mkdir(exist_ok=True)
    (tmp_path / name).write_text(
        CARTPOLE.replace("timestep:", "timestop:").replace("summary:", "summary: on #")
    )
    lines = deepbots("lint", name, "--format", "concise", code=1).out.splitlines()
    report = json.loads(deepbots("lint", name, "--json", code=1).out)["findings"]
    assert [finding["code"] for finding in report] == ["DB003", "DB101"]
    for line, finding in zip(lines, report, strict=True):
        match = re.match(pattern["regexp"], line)
        read = {part: match[pattern[part]] for part in ("file", "severity", "code", "line", "column")}
        assert read == {
            "file": name,
            "severity": finding["severity"],
            "code": f"{finding['code']}[{finding['name']}]",
            **{part: str(number) for part, number in finding["start"].items()},
        }
        assert match[pattern["message"]].startswith(finding["message"])


def test_the_command_lines_of_the_page_on_linting_parse():
    page = (ROOT / "docs" / "linting.md").read_text(encoding="utf-8")
    lines = re.findall(r"deepbots (lint [^`|\n]*?)(?: <.*| >.*)?$", page, re.MULTILINE)
    assert len(lines) >= 4
    for line in lines:
        Commands().get_command(None, "lint").make_context("lint", shlex.split(line)[1:]).close()


@pytest.mark.parametrize(
    "word",
    ["db603", "saturates-before-termination", "saturates_before_termination", "Saturates-Before-Termination"],
)
def test_case_and_underscores_do_not_matter_and_a_name_does_as_well(deepbots, word):
    assert deepbots("explain", word).out == deepbots("explain", "DB603").out


def test_the_page_on_linting_marks_what_needs_preview_beside_deep():
    page = (ROOT / "docs" / "linting.md").read_text(encoding="utf-8")
    assert {*re.findall(r"(DB\d+)\*", page)} == {code for code, rule in RULES.items() if rule.deep_preview}


def test_the_text_is_that_of_the_reference(deepbots):
    for page in every_page():
        (explained,) = json.loads(deepbots("explain", page.code, "--json").out)["rules"]
        assert {"about": page.about, "example": page.example, "instead": page.instead} in explained["pages"]


def test_without_a_code_every_finding_has_its_line(deepbots):
    assert [line.split()[0] for line in deepbots("explain").out.splitlines()[2:]] == [*RULES]
    report = json.loads(deepbots("explain", "--json").out)
    assert (report["version"], [entry["code"] for entry in report["rules"]]) == (1, [*RULES])


def test_json_has_the_text_of_each_meaning_of_a_word(deepbots):
    report = json.loads(deepbots("explain", "noise", "--json").out)
    assert (report["version"], report["see_also"][:2]) == (1, ["exploration", "action_noise"])
    assert [entry["title"] for entry in report["entries"]][:2] == [
        "noise: a concept",
        "noise: a key of `world.terrain` with `type: pit`",
    ]
    assert "Value: a number; default 0." in report["entries"][1]["text"]


@pytest.mark.parametrize(
    ("word", "concept"),
    [
        ("HER", "hindsight"),
        ("hindsight", "hindsight"),
        ("domain randomisation", "domain randomization"),
        ("Domain Randomization", "domain randomization"),
        ("domain-randomization", "domain randomization"),
        ("camera", "camera"),
        ("noise", "noise"),
        ("curriculum", "curriculum"),
        ("latency", "latency"),
        ("frame_stack", "frame stack"),
        ("reward shaping", "reward shaping"),
        ("success", "success"),
        ("seed", "seeds"),
        ("observation noise", "noise"),
        ("privileged information", "privileged information"),
        ("asymmetric critic", "privileged information"),
        ("TimeLimit", "time limit"),
        ("truncated", "time limit"),
        ("action repeat", "action repeat"),
        ("frame skip", "action repeat"),
        ("sim-to-real", "sim-to-real"),
        ("sim2real", "sim-to-real"),
        ("delays", "latency"),
        ("baselines", "baseline"),
        ("held-out", "evaluation"),
        ("success rate", "success"),
        ("observation normalization", "normalization"),
        ("action scaling", "action scaling"),
        ("discount factor", "discount"),
        ("VecEnv", "vectorized environments"),
        ("vectorised environments", "vectorized environments"),
        ("checkpoints", "checkpoint"),
        ("resume", "resume"),
        ("record", "video"),
        ("normalise", "normalization"),
        ("mask", "action mask"),
        ("observation group", "privileged information"),
        ("return", "return"),
        ("episode", "episode"),
        ("exploration", "exploration"),
        ("policy", "policy"),
        ("entropy", "entropy"),
        ("local optimum", "local optimum"),
        ("mimic", "mimic joint"),
        ("passive joint", "passive joint"),
        ("two policies", "several policies"),
        ("scenario", "scenario"),
        ("step", "step"),
        ("training", "training"),
        ("run", "run"),
        ("reinforcement learning", "reinforcement learning"),
        ("agent", "agent"),
        ("reward", "reward"),
        ("URDF", "robot file"),
        ("95 %", "confidence interval"),
    ],
)
def test_a_concept_is_explained_by_its_name_and_by_usual_others(deepbots, word, concept):
    ran = deepbots("explain", word)
    assert ran.err == ""
    assert ran.out.startswith(f"{concept}: a concept\n")
    assert "Read more: docs/" in ran.out


@pytest.mark.parametrize("topic", topics(), ids=lambda topic: topic.name)
def test_the_example_of_a_concept_lints_clean_and_its_page_has_the_section(topic: Topic):
    text = f"deepbots: 1\nextends: cartpole.yaml\n{topic.example}\n"
    assert [finding.headline for finding in all_findings(check(loads(text, base=ROOT / "scenarios")))] == []
    page, _, section = topic.read.partition("#")
    heads = re.findall(r"^#+ (.*)$", (ROOT / page).read_text(encoding="utf-8"), re.MULTILINE)
    assert section in {"", *(re.sub(r"[^a-z0-9 _-]", "", head.lower()).replace(" ", "-") for head in heads)}


def test_no_two_concepts_share_a_name():
    names = [name.lower() for topic in topics() for name in (topic.name, *topic.names)]
    assert len(names) == len(set(names))


def test_two_words_need_no_quotes(deepbots):
    assert deepbots("explain", "success", "rate").out == deepbots("explain", "success rate").out


PARTS = """<robot xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:macro name="part" params="name">
  <link name="${name}"><visual><geometry>%s</geometry></visual>
    <inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
</xacro:macro></robot>"""
LINK = PARTS.partition("<link")[2].partition("</xacro")[0]
ROBOT = """<robot name="bot" xmlns:xacro="http://www.ros.org/wiki/xacro">%s
  <joint name="slider" type="prismatic"><parent link="base"/><child link="cart"/><axis xyz="1 0 0"/>
    <limit lower="-2" upper="2" effort="%s" velocity="3"/></joint>
  <joint name="hinge" type="continuous"><parent link="cart"/><child link="pole"/><axis xyz="0 1 0"/></joint>
</robot>"""
NAMES = ("base", "cart", "pole")
KINDS = {
    "robot": ["urdf", "xacro"],
    "mesh": ["none", "stl", "glb", "gltf"],
    "terrain": ["none", "hills.png"],
    "included": [False, True],
    "extended": [False, True],
}

_OPENED: list[str] | None = None


def _note(event: str, arguments: tuple[object, ...]) -> None:
    if event == "open" and _OPENED is not None and isinstance(arguments[0], str | os.PathLike):
        _OPENED.append(os.fspath(arguments[0]))


sys.addaudithook(_note)


@contextmanager
def opened_below(folder: Path) -> Iterator[set[Path]]:
    """Collect the files below a folder that the interpreter opens."""
    global _OPENED
    paths: set[Path] = set()
    _OPENED = []
    try:
        yield paths
    finally:
        opened, _OPENED = map(Path, _OPENED), None
        paths |= {path.resolve() for path in opened if path.resolve().is_relative_to(folder.resolve())}


def written(folder: Path, kinds: dict[str, object]) -> tuple[Path, Path]:
    """Write a project of these kinds of files; return its scenario and its robot file."""
    import trimesh
    from PIL import Image

    shape = '<box size="1 1 1"/>'
    if kinds["mesh"] != "none":
        shape = f'<mesh filename="body.{kinds["mesh"]}"/>'
        box = trimesh.creation.box()
        files = {
            "body.stl": box.export(file_type="stl"),
            "body.glb": trimesh.Scene(box).export(file_type="glb"),
        }
        if kinds["mesh"] == "gltf":
            exported = trimesh.Scene(box).export(file_type="gltf")
            files = {name.replace("model.gltf", "body.gltf"): data for name, data in exported.items()}
        for name, data in files.items():
            (folder / name).write_bytes(data)
    if kinds["robot"] == "xacro":
        (folder / "parts.xacro").write_text(PARTS % shape)
        (folder / "limits.yaml").write_text("effort: 10\n")
        links = "".join(f'<xacro:part name="{name}"/>' for name in NAMES)
        head = '<xacro:include filename="parts.xacro"/><xacro:property name="l" value="${xacro.load_yaml(\'limits.yaml\')}"/>'
        robot = ROBOT % (head + links, "${l['effort']}")
    else:
        links = "".join(f"<link{LINK.replace('${name}', name) % shape}" for name in NAMES)
        robot = ROBOT % (links, "10")
    robot_file = folder / f"bot.{kinds['robot']}"
    robot_file.write_text(robot)
    text = CART.replace("cartpole_rail", robot_file.name) + "reward: {alive: 1}\n"
    if kinds["included"]:
        text = text.replace(f"urdf: {robot_file.name}\n    base: fixed", "include: bot.yaml")
        (folder / "bot.yaml").write_text(f"urdf: {robot_file.name}\nbase: fixed\n")
    if kinds["terrain"] != "none":
        Image.fromarray(np.zeros((8, 8), np.uint8)).save(folder / "hills.png")
        terrain = "terrain: {type: heightfield, file: hills.png, size: 4 4 m, height: 1 m}"
        text = text.replace("substeps: 4}", f"substeps: 4, {terrain}}}")
    (folder / "mine.yaml").write_text(text)
    if kinds["extended"]:
        (folder / "base.yaml").write_text(text)
        (folder / "mine.yaml").write_text("deepbots: 1\nextends: base.yaml\nname: Mine\n")
    (folder / "deepbots.toml").write_text("[lint]\npreview = true\n")
    return folder / "mine.yaml", robot_file


@given(
    st.fixed_dictionaries({name: st.sampled_from(choices) for name, choices in KINDS.items()}),
    st.sampled_from(
        ["", "bot.urdf", "bot.xacro", "parts.xacro", "body.gltf", "hills.png", "bot.yaml", "mine.yaml"]
    ),
)
@example({"robot": "xacro", "mesh": "gltf", "terrain": "hills.png", "included": True, "extended": True}, "")
@example(
    {"robot": "urdf", "mesh": "none", "terrain": "none", "included": False, "extended": False}, "bot.urdf"
)
@settings(max_examples=40, deadline=None, derandomize=True)
def test_every_file_that_lint_view_or_the_studio_opens_is_watched_also_with_an_error_in_one(
    kinds: dict[str, object], faulty: str
) -> None:
    with TemporaryDirectory() as name:
        folder = Path(name)
        scenario, robot_file = written(folder, kinds)
        if faulty and (folder / faulty).exists():
            (folder / faulty).write_text("<: [")
        for reference in (str(scenario), str(robot_file)):
            with opened_below(folder) as opened, recorded_reads() as watched:
                project_settings(folder)
                findings = LintOptions().findings(reference)
            assert opened <= {path.resolve() for path in watched}
            if not (faulty and (folder / faulty).exists()):
                assert not [finding for finding in findings if finding.severity == "error"]
                assert robot_file.resolve() in opened
        with opened_below(folder) as opened:
            state = Showing(str(scenario)).open()
        assert opened <= {path.resolve() for path in state.files}
        document = Document(uri_of(scenario), 1, scenario.read_text(), scenario)
        with opened_below(folder) as opened:
            analysis = analyze(document, {})
        assert opened <= {path.resolve() for path in analysis.reads}


MESHED = {"robot": "xacro", "mesh": "stl", "terrain": "none", "included": True, "extended": False}


@pytest.mark.parametrize("missing", ["bot.yaml", "bot.xacro", "parts.xacro", "limits.yaml", "body.stl"])
def test_watching_lints_again_when_a_missing_file_comes(watched, tmp_path, missing):
    written(tmp_path, MESHED)
    content = (tmp_path / missing).read_bytes()
    (tmp_path / missing).unlink()
    assert watched([(tmp_path / missing, content)], "mine.yaml").err.count("Ctrl-C ends it") == 2


@pytest.mark.parametrize("jobs", [1, 2])
def test_watching_lints_again_for_each_file_of_a_robot(watched, tmp_path, jobs):
    scenario, _ = written(tmp_path, MESHED)
    (tmp_path / "other.yaml").write_text(scenario.read_text())
    names = ["mine.yaml", "bot.yaml", "bot.xacro", "parts.xacro", "limits.yaml", "body.stl", "deepbots.toml"]
    changes = [(tmp_path / name, (tmp_path / name).read_bytes() + b"\n") for name in names]
    ran = watched(changes, "mine.yaml", "other.yaml", "--jobs", str(jobs))
    assert ran.err.count("Ctrl-C ends it") == 1 + len(names)
