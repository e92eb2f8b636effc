"""`deepbots new --from` and `deepbots compile --project`: the files that they write, and those that they
leave alone."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

from deepbots_cli import api
from deepbots_cli.cli.commands import new
from deepbots_cli.document import shipped
from tests.few import LIGHT, few


@pytest.mark.slow
@pytest.mark.parametrize("name", few(shipped.scenario_names(), (*LIGHT, "carry")))
def test_a_copy_of_any_shipped_scenario_means_the_same_from_any_folder(deepbots, tmp_path, name):
    deepbots("new", name, "a/b", "--from", name)
    copied = api.compile(tmp_path / "a" / "b" / f"{name}.yaml")
    assert copied.digest == api.compile(name).digest
    assert all(
        path.is_relative_to(tmp_path)
        for path in api.load(tmp_path / "a" / "b" / f"{name}.yaml").document.files
    )


def test_a_copy_keeps_comments_and_reads_its_own_robot(deepbots, tmp_path):
    deepbots("new", "cartpole", "--from", "cartpole", "--json")
    before = shipped.scenario_path("cartpole").read_text(encoding="utf-8")
    after = (tmp_path / "cartpole.yaml").read_text(encoding="utf-8")
    changed = [line for line in after.splitlines() if line not in before.splitlines()]
    assert len(changed) == 1
    assert "urdf: robots/urdf/cartpole.urdf" in changed[0]
    robot = tmp_path / "robots" / "urdf" / "cartpole.urdf"
    robot.write_text(robot.read_text().replace('name="pole_hinge"', 'name="other_hinge"'))
    deepbots("lint", "cartpole.yaml", code=1)


def test_a_copy_of_another_name_is_that_scenario_under_the_name(deepbots, tmp_path):
    assert deepbots("new", "my_cart", "--from", "cartpole_continuous").out.split()[:2] == [
        "my_cart.yaml",
        "cartpole.yaml",
    ]
    assert (
        (tmp_path / "my_cart.yaml")
        .read_text(encoding="utf-8")
        .startswith("deepbots: 1\nextends: cartpole.yaml\nname: MyCart\n")
    )
    deepbots("diff", "my_cart.yaml", "cartpole_continuous")


def test_a_copy_is_not_called_as_a_scenario_that_it_reads(deepbots, tmp_path):
    ran = deepbots("new", "cartpole", "--from", "cartpole_continuous", code=2)
    assert (
        ran.err
        == "error: 'cartpole' is the name of a file that cartpole_continuous reads; choose another name\n"
    )
    assert not any(tmp_path.iterdir())


def test_a_copy_says_what_to_do_next(deepbots):
    ran = deepbots("new", "cartpole", "--from", "cartpole")
    assert ran.out.split() == ["cartpole.yaml", "robots/urdf/cartpole.urdf"]
    assert "deepbots lint cartpole.yaml" in ran.err
    assert "deepbots train cartpole.yaml" in ran.err


def test_nothing_is_overwritten_and_nothing_half_written(deepbots, tmp_path):
    (tmp_path / "cartpole.yaml").write_text("mine\n")
    ran = deepbots("new", "cartpole", "--from", "cartpole", code=2)
    assert "cartpole.yaml" in ran.err
    assert (tmp_path / "cartpole.yaml").read_text() == "mine\n"
    assert not (tmp_path / "robots").exists()


def test_a_second_copy_changes_nothing(deepbots, tmp_path):
    deepbots("new", "cartpole", "--from", "cartpole", "--json")
    stamp = (tmp_path / "cartpole.yaml").stat().st_mtime_ns
    deepbots("new", "cartpole", "--from", "cartpole", "--json")
    assert (tmp_path / "cartpole.yaml").stat().st_mtime_ns == stamp


@pytest.mark.parametrize("name", ["cartpol", "../cartpole", "", "cartpole.yaml", "/etc/passwd", "x" * 500])
def test_only_shipped_scenarios_are_copied(deepbots, tmp_path, name):
    ran = deepbots("new", "mine", "--from", name, code=2)
    assert "cartpole" in ran.err
    assert not any(tmp_path.iterdir())


def test_a_file_in_place_of_the_folder_is_one_line(deepbots, tmp_path):
    (tmp_path / "taken").write_text("")
    ran = deepbots("new", "cartpole", "taken", "--from", "cartpole", code=2)
    assert ran.err.startswith("error: ")
    assert "Traceback" not in ran.err


def test_what_a_scenario_extends_and_includes_comes_along(tmp_path, monkeypatch):
    data = tmp_path / "data"
    for folder in ("scenarios/more", "robots/urdf", "robots/meshes"):
        (data / folder).mkdir(parents=True)
    text = "# a comment\nextends: more/base.yaml\nrobots: {arm: {include: ../robots/arm.yaml}}  # kept\n"
    (data / "scenarios" / "top.yaml").write_text(text)
    (data / "scenarios" / "more" / "base.yaml").write_text(
        "deepbots: 1\nobjects: {a: {mesh: '../../robots/meshes/a b.stl'}}\n"
    )
    (data / "robots" / "arm.yaml").write_text("urdf: arm\n")
    (data / "robots" / "urdf" / "arm.urdf").write_text("<robot name='arm'><link name='base'/></robot>")
    (data / "robots" / "meshes" / "a b.stl").write_text("solid a\nendsolid a\n")
    monkeypatch.setattr(shipped, "data_dir", lambda: data)
    files = {str(path): content.decode() for path, content in new.from_shipped("top", "top").items()}
    assert next(iter(files)) == "top.yaml"
    assert set(files) == {
        "top.yaml",
        "more/base.yaml",
        "robots/arm.yaml",
        "robots/urdf/arm.urdf",
        "robots/meshes/a b.stl",
    }
    assert files["top.yaml"] == text.replace("../robots", "robots")
    assert '"../robots/meshes/a b.stl"' in files["more/base.yaml"]
    assert files["robots/arm.yaml"] == "urdf: urdf/arm.urdf\n"


def test_a_compiled_project_runs_on_its_own(deepbots, tmp_path):
    ran = deepbots("compile", "cartpole", "--project", "mine", "--set", "truncation.max_steps=7")
    project = tmp_path / "mine"
    assert "python run.py" in ran.err
    assert (project / "environment.py").read_text() == deepbots(
        "compile", "cartpole", "--set", "truncation.max_steps=7"
    ).out
    assert api.compile(project / "resolved.yaml").program.truncation.max_steps == 7
    done = subprocess.run(
        [sys.executable, "run.py"], cwd=project, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("return") == 3
    assert "7 steps" in done.stdout


@pytest.mark.slow
def test_what_is_edited_in_a_compiled_project_is_what_runs(deepbots, tmp_path):
    deepbots("compile", "cartpole", "--project", "mine")
    code = tmp_path / "mine" / "environment.py"
    text = code.read_text()
    assert "self.term_alive = 1.0" in text
    code.write_text(text.replace("self.term_alive = 1.0", "self.term_alive = 5.0"))
    done = subprocess.run(
        [sys.executable, "run.py"], cwd=tmp_path / "mine", capture_output=True, text=True, check=True
    )
    words = done.stdout.split()
    assert float(words[3]) == 5 * int(words[5])


def test_a_project_is_never_written_over_anything(deepbots, tmp_path):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "notes.txt").write_text("mine\n")
    ran = deepbots("compile", "cartpole", "--project", "mine", "--json", code=2)
    assert (
        "mine is not empty; choose another folder, or replace files of the same name with --force" in ran.err
    )
    assert [path.name for path in (tmp_path / "mine").iterdir()] == ["notes.txt"]


def test_programs_get_the_list_of_files(deepbots):
    copied = json.loads(deepbots("new", "cartpole", "--json", "--from", "cartpole").out)
    assert copied == {"scenario": "cartpole.yaml", "files": ["cartpole.yaml", "robots/urdf/cartpole.urdf"]}
    assert (
        "mine/README.md"
        in json.loads(deepbots("compile", "cartpole", "--project", "mine", "--json").out)["files"]
    )
