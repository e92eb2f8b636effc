"""`deepbots lint`: its output and its exit code, for good files and bad ones."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from deepbots_cli.cli import main
from deepbots_cli.document import shipped

CARTPOLE = shipped.scenario_path("cartpole").read_text(encoding="utf-8")

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


def test_text_that_would_crash_a_parser_in_c_ends_in_findings(tmp_path):
    for number, text in enumerate(("[" * 100_000, "? " * 100_000, "{a: " * 100_000)):
        (tmp_path / f"{number}.yaml").write_text(text)
    command = [
        sys.executable,
        "-m",
        "deepbots_cli",
        "lint",
        "0.yaml",
        "1.yaml",
        "2.yaml",
        "--format",
        "concise",
    ]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert {line.partition(":")[0] for line in done.stdout.splitlines()} >= {"0.yaml", "1.yaml", "2.yaml"}
    assert "Traceback" not in done.stderr


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    content=st.one_of(
        st.binary(max_size=300), st.text(max_size=300).map(lambda text: text.encode("utf-8", "replace"))
    )
)
def test_arbitrary_bytes_never_end_in_a_fault(tmp_path, content):
    path = tmp_path / "any.yaml"
    path.write_bytes(content)
    assert main(["lint", str(path), "--format", "json"]) == 1


@given(
    value=st.text(max_size=40),
    path=st.sampled_from(["world.timestep", "fall_angle", "reward.alive", "name", "", "action"]),
)
def test_arbitrary_assignments_never_end_in_a_fault(value, path):
    assert main(["lint", "cartpole", "--set", f"{path}={value}", "--format", "json"]) in (0, 1)


def test_a_folder_stands_for_the_scenarios_in_it(deepbots, tmp_path):
    (tmp_path / "s").mkdir()
    for name in ("b", "a"):
        (tmp_path / "s" / f"{name}.yaml").write_text(
            CARTPOLE.replace("../robots/urdf/cartpole.urdf", "cartpole") + "oops: 1\n"
        )
    (tmp_path / "s" / "other.yaml").write_text("jobs: []\n")
    (tmp_path / "s" / "short.yml").write_text("deepbots: 2\n")
    (tmp_path / "s" / "quoted.yaml").write_text('"deepbots": 2\n')
    (tmp_path / "s" / "within.yaml").write_text("# not at the top level\njobs:\n  deepbots: 1\n")
    ran = deepbots("lint", "s", "--format", "concise", code=1)
    assert list(dict.fromkeys(line.split(":")[0] for line in ran.out.splitlines())) == [
        "s/a.yaml",
        "s/b.yaml",
        "s/quoted.yaml",
        "s/short.yml",
    ]


def test_the_root_of_a_project_stands_for_the_scenarios_of_all_its_folders(deepbots, tmp_path):
    places = (
        "top",
        "worlds/one",
        "worlds/deep/two",
        ".hidden/three",
        "runs/cartpole-0/scenario",
        "env/lib/four",
        "node_modules/p/five",
    )
    for place in (*places, "old/six", "worlds/deep/old/seven"):
        path = tmp_path / f"{place}.yaml"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("deepbots: 1\n")
    (tmp_path / "runs" / "cartpole-0" / "run.json").touch()
    (tmp_path / "env" / "pyvenv.cfg").touch()
    (tmp_path / "worlds" / "again").symlink_to(tmp_path / "worlds", target_is_directory=True)
    (tmp_path / "deepbots.toml").write_text('[lint]\nexclude = ["old"]\n')
    ran = deepbots("lint", ".", "--format", "concise", code=1)
    files = list(dict.fromkeys(line.split(":")[0] for line in ran.out.splitlines()))
    assert files == ["top.yaml", "worlds/deep/old/seven.yaml", "worlds/deep/two.yaml", "worlds/one.yaml"]


@pytest.mark.skipif(os.name != "posix", reason="links need rights on Windows")
def test_a_folder_stands_for_no_file_to_which_a_link_leads_out_of_the_project(deepbots, tmp_path):
    inside = tmp_path / "project"
    inside.mkdir()
    (inside / "deepbots.toml").touch()
    (tmp_path / "private.yaml").write_text("deepbots: 1\nmesages: {}\n")
    (inside / "x.yaml").symlink_to(tmp_path / "private.yaml")
    (inside / "system.yaml").symlink_to("/proc/kmsg")
    (inside / "loop.yaml").symlink_to("loop.yaml")
    deepbots("lint", "project", "--fix", code=2)
    (inside / "real.yaml").write_text("deepbots: 1\n")
    assert {
        finding["file"]
        for finding in json.loads(deepbots("lint", "project", "--json", code=1).out)["findings"]
    } == {"project/real.yaml"}
    assert (tmp_path / "private.yaml").read_text() == "deepbots: 1\nmesages: {}\n"


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
    assert ran.out[:10] == "real.yaml:"
    assert ran.err == ""


def test_several_files_are_linted_at_once(deepbots, tmp_path):
    (tmp_path / "a.yaml").write_text("deepbots: 1\n")
    ran = deepbots("lint", "cartpole", "a.yaml", "--json", code=1)
    report = json.loads(ran.out)
    assert report["version"] == 1
    assert {finding["file"] for finding in report["findings"]} == {"a.yaml"}
    assert report["counts"]["error"] == len(report["findings"])


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


def test_color_is_for_terminals_only(deepbots, tmp_path):
    (tmp_path / "a.yaml").write_text("deepbots: 1\n")
    assert "\x1b[" not in deepbots("lint", "a.yaml", code=1).out
