"""The run directory: made once, complete, and read with suspicion."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from threading import Timer
from typing import Any

import pytest
import stand_in
from filelock import FileLock
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from deepbots_cli import api
from deepbots_cli.document import shipped
from deepbots_cli.errors import RunError, UsageError
from deepbots_cli.learning import TrainingResult, evaluate, resume, train
from deepbots_cli.learning.runs.directories import new_directory, numbered_files, run_lock, write_numbered
from deepbots_cli.learning.runs.run import Run
from deepbots_cli.robots.model import Mesh


def test_a_run_keeps_everything_that_it_was_made_from(trained: TrainingResult) -> None:
    files = {str(path.relative_to(trained.run)) for path in trained.run.rglob("*") if path.is_file()}
    assert {
        "run.json",
        "resolved.yaml",
        "environment.py",
        "monitor.csv",
        "models/agent/best.zip",
        "models/agent/last.zip",
        "inputs/tests/learning/stand_in.yaml",
        "inputs/robots/urdf/cartpole.urdf",
    } <= files
    assert any(name.startswith("tensorboard/events") for name in files)
    record = json.loads((trained.run / "run.json").read_text())
    assert record["status"] == "finished"
    assert record["command"] == ["deepbots", "train", "stand_in"]
    assert record["seed"] == 3
    assert {"python", "torch", "stable-baselines3", "numpy", "gymnasium", "pybullet"} <= set(
        record["versions"]
    )
    assert record["result"]["steps"] == trained.steps


def test_a_run_is_never_overwritten(trained: TrainingResult) -> None:
    before = stand_in.tree_digest(trained.run)
    with pytest.raises(UsageError, match="not overwritten"):
        train(stand_in.compiled(), run=trained.run, build=stand_in.build)
    assert stand_in.tree_digest(trained.run) == before


def test_new_runs_are_numbered_past_all_that_exist(tmp_path: Path) -> None:
    (tmp_path / "cart_pole-0-7").mkdir()
    (tmp_path / "cart_pole-0-x").mkdir()
    assert [new_directory(None, tmp_path, "Cart Pole", 0).name for _ in range(2)] == [
        "cart_pole-0-8",
        "cart_pole-0-9",
    ]
    assert new_directory(None, tmp_path, "../..", 0).parent == tmp_path
    assert new_directory(None, tmp_path / "new" / "runs", "Cart Pole", 0).is_dir()


def test_a_folder_that_is_not_a_run_is_refused_in_one_sentence(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    (tmp_path / "empty").mkdir()
    for name, reason in (
        ("nothing", "no file, folder or shipped scenario"),
        ("file", "is a file"),
        ("empty", "without run.json"),
    ):
        with pytest.raises(RunError, match=reason) as caught:
            Run.open(tmp_path / name)
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize("version", [0, 2, 99])
def test_a_run_of_another_format_is_refused(run_copy: Path, version: int) -> None:
    edit(run_copy, format=version)
    with pytest.raises(RunError, match=f"format {version}"):
        evaluate(run_copy, build=stand_in.build)


def test_a_run_of_another_deepbots_warns(run_copy: Path) -> None:
    edit(run_copy, deepbots="9.9")
    assert "9.9" in evaluate(run_copy, episodes=1, build=stand_in.build).notes[0]


def test_a_scenario_that_was_changed_after_the_training_warns(run_copy: Path) -> None:
    rewrite(run_copy, "15 deg", "12 deg")
    (note,) = evaluate(run_copy, episodes=1, build=stand_in.build).notes
    assert "because it was changed after the training" in note
    edit(run_copy, deepbots="9.9")
    assert "with this version of deepbots" in Run.open(run_copy).notes()[1]


def test_a_changed_file_of_a_run_warns(run_copy: Path) -> None:
    robot = run_copy / "inputs" / "robots" / "urdf" / "cartpole.urdf"
    robot.write_text(robot.read_text().replace('<mass value="', '<mass value="1', 1))
    assert "because it was changed after the training" in Run.open(run_copy).notes()[0]


def test_a_scenario_that_no_longer_fits_its_policy_is_refused_item_by_item(run_copy: Path) -> None:
    rewrite(run_copy, "-0.8 .. 0.8 m/s", "-0.9 .. 0.8 m/s")
    with pytest.raises(
        RunError, match=r"observation\.speed: trained -0\.8 \.\. 0\.8 m/s, now -0\.9 \.\. 0\.8 m/s"
    ) as caught:
        evaluate(run_copy, build=stand_in.build)
    assert str(caught.value).count("\n") == 1


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("timestep: 32 ms", "timestep: 0 s"),
        ("timestep: 32 ms", "timestep: 1e-320 s"),
        ("timestep: 32 ms", "timestep: 1e308 s"),
        ("substeps: 4", "substeps: 1000000000000"),
        ("max_steps: 200", "max_steps: -1"),
        ("episodes: 20", "episodes: 0"),
        ("episodes: 20", f"episodes: {2**70}"),
        ("episodes: 20", f"episodes: {'9' * 5000}"),
        ("truncation:", "nothing:"),
        ("name: stand_in", 'name: "../../x"'),
        ("reward:", 'reward: {alive: \'__import__("os").system("touch pwned")\'}\nrewards:'),
        ("reward:", "reward: !!python/object/apply:os.system [touch pwned]\nrewards:"),
        ("- wheel_*", "- 'x'"),
        ("10 N*m", "-1e300 N*m"),
        ("deepbots: 1", "deepbots: 99"),
        ("deepbots: 1", "extends: resolved.yaml\ndeepbots: 1"),
        ("deepbots: 1", "extends: /etc/passwd\ndeepbots: 1"),
        ("deepbots: 1", "include: ../../secret.yaml\ndeepbots: 1"),
        ("inputs/robots/urdf/cartpole.urdf", "/etc/passwd"),
        ("inputs/robots/urdf/cartpole.urdf", "inputs/../../secret.urdf"),
        ("inputs/robots/urdf/cartpole.urdf", "package://os/../../etc/passwd"),
        ("inputs/robots/urdf/cartpole.urdf", "inputs"),
    ],
)
def test_a_forged_scenario_is_refused_in_a_sentence(
    run_copy: Path, old: str, new: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("secret.yaml", "secret.urdf"):
        (run_copy.parent / name).write_text("secret: 1\n")
    (run_copy.parent / "deepbots.toml").touch()  # what looks like a project around a run is not its project
    opened = watched(monkeypatch)
    rewrite(run_copy, old, new)
    assert "does not compile" in (message := refusal(run_copy))
    assert "\n" not in message
    assert len(message) < 1000
    assert not [path for path in opened() if path.name.startswith("secret") or path == Path("/etc/passwd")]


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('<mass value="', '<mass value="-'),
        ('<mass value="', '<mass value="1e308'),
        ('<child link="', '<child link="no_'),
        ('<parent link="', '<parent link="no_'),
        ('<joint name="', f'<joint name="{"x" * 100_000}'),
        ('<link name="', '<link name="&#xD800;'),
        ('<link name="', "<link nothing='"),
        ("<robot", '<!DOCTYPE robot [<!ENTITY e SYSTEM "file:///etc/passwd">]><robot'),
        ('<box size="', '<box size="-'),
        ('<box size="0.20 0.05 0.08"/>', '<mesh filename="../../../../../secret.obj"/>'),
        ('<box size="0.20 0.05 0.08"/>', '<mesh filename="/dev/zero"/>'),
        ("</robot>", ""),
    ],
)
def test_a_forged_robot_that_would_end_the_process_is_refused(run_copy: Path, old: str, new: str) -> None:
    robot = run_copy / "inputs" / "robots" / "urdf" / "cartpole.urdf"
    text = robot.read_text()
    assert old in text
    robot.write_text(text.replace(old, new, 1))
    assert "does not compile" in (message := refusal(run_copy))
    assert "\n" not in message


@pytest.mark.parametrize("radius", ["-1 m", "1e300 m", "0 m", ".nan"])
def test_a_forged_form_of_an_object_that_would_end_the_process_is_refused(
    run_copy: Path, radius: str
) -> None:
    forms = f"[{{shape: sphere, radius: 10 cm}}, {{shape: sphere, radius: {radius}}}]"
    rewrite(run_copy, "reward:", f"objects: {{thing: {{mass: 1 kg, variants: {forms}}}}}\nreward:")
    assert "does not compile" in refusal(run_copy)


@pytest.mark.parametrize("name", ["resolved.yaml", "inputs", "inputs/robots/urdf/cartpole.urdf"])
def test_a_run_without_one_of_its_files_is_refused_in_a_sentence(run_copy: Path, name: str) -> None:
    (run_copy / name).rename(run_copy / "lost")
    assert name.partition("/")[0] in (message := refusal(run_copy))
    assert "\n" not in message


@pytest.mark.parametrize(
    "name", ["resolved.yaml", "inputs", "inputs/robots", "inputs/robots/urdf/cartpole.urdf"]
)
def test_a_link_out_of_the_run_is_not_followed(run_copy: Path, tmp_path: Path, name: str) -> None:
    (run_copy / name).rename(tmp_path / "elsewhere")
    os.symlink(tmp_path / "elsewhere", run_copy / name)
    assert "is a symbolic link" in refusal(run_copy)
    assert (tmp_path / "elsewhere").exists()


def test_a_symbolic_link_in_a_run_is_not_followed(run_copy: Path, tmp_path: Path) -> None:
    victim = tmp_path / "victim"
    victim.write_text("precious")
    (run_copy / "monitor.csv").unlink()
    os.symlink(victim, run_copy / "monitor.csv")
    with pytest.raises(RunError, match="symbolic link"):
        resume(run_copy, total_timesteps=100_000, build=stand_in.build)
    assert victim.read_text() == "precious"


def test_a_lock_that_is_a_link_is_not_followed(run_copy: Path, tmp_path: Path) -> None:
    victim = tmp_path / "victim"
    victim.write_text("precious")
    (run_copy / ".lock").unlink(missing_ok=True)
    os.symlink(victim, run_copy / ".lock")
    with pytest.raises(RunError, match="symbolic link"):
        resume(run_copy, total_timesteps=100_000, build=stand_in.build)
    assert victim.read_text() == "precious"


def test_an_evaluation_is_kept_with_its_episodes(run_copy: Path) -> None:
    run = Run.open(run_copy)
    result = evaluate(run, episodes=2, build=stand_in.build).model_dump(mode="json")
    first, second = run.write_evaluation(result), run.write_evaluation(result)
    assert [first.name, second.name] == ["0001.json", "0002.json"]
    assert len(json.loads(first.read_text())["outcomes"]) == 2
    (run.evaluations / "9999.json").write_text("{}")
    assert [run.write_evaluation(result).name for _ in range(2)] == ["10000.json", "10001.json"]
    shutil.rmtree(run.evaluations)
    run.evaluations.write_text("no folder")
    with pytest.raises(RunError, match=r"evaluations.* cannot be written"):
        run.write_evaluation(result)


def test_a_run_whose_project_is_gone_finds_its_meshes_in_its_own_copies(tmp_path: Path) -> None:
    project = tmp_path / "project"
    project.mkdir()
    (project / "part.obj").write_bytes(
        b"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
    )
    robot = (
        shipped.robot_path("cartpole")
        .read_text()
        .replace('<box size="0.20 0.05 0.08"/>', '<mesh filename="part.obj"/>', 1)
    )
    (project / "mine.urdf").write_text(robot)
    scenario = (
        shipped.scenario_path("cartpole").read_text().replace("../robots/urdf/cartpole.urdf", "mine.urdf")
    )
    (project / "mine.yaml").write_text(scenario)
    compiled = api.compile(project / "mine.yaml")
    result = train(compiled, run=tmp_path / "run", total_timesteps=512, build=stand_in.build)
    shutil.rmtree(project)
    shutil.move(result.run, tmp_path / "moved")
    run = Run.open(tmp_path / "moved")
    assert (run.digest, run.notes()) == (run.record.digest, [])
    links = run.program.world.robots[0].model.links
    meshes = [
        part.shape.path
        for link in links
        for part in (*link.visuals, *link.collisions)
        if isinstance(part.shape, Mesh)
    ]
    assert meshes == [str(tmp_path / "moved" / "inputs" / "part.obj")]
    with closing(api.build(run.program)) as environment:
        environment.reset(seed=0)
    (tmp_path / "moved" / "inputs" / "part.obj").write_bytes(b"v 0 0 0\nf 1 1 999\n")
    assert "does not compile" in refusal(tmp_path / "moved")


@pytest.mark.parametrize("name", ["monitor.csv", "models/agent/last.zip", "resolved.yaml"])
def test_a_pipe_in_a_run_is_not_waited_for(run_copy: Path, name: str) -> None:
    (run_copy / name).unlink()
    os.mkfifo(run_copy / name)
    with pytest.raises(RunError, match="neither a file nor a directory"):
        Run.open(run_copy)


VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner, max_size=3),
    max_leaves=6,
)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_a_run_with_any_run_json_opens_or_is_refused_in_a_sentence(
    run_copy: Path, trained: TrainingResult, data: st.DataObject
) -> None:
    record = json.loads((trained.run / "run.json").read_text())
    key = data.draw(st.sampled_from(sorted(record)))
    if data.draw(st.booleans()):
        record[key] = data.draw(VALUES)
    else:
        del record[key]
    (run_copy / "run.json").write_text(json.dumps(record))
    compared = refusal(run_copy).split("\n")[1:]
    assert not compared or (key == "interface" and all(line.startswith("  ") for line in compared))


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"{",
        b"[" * 100_000,
        b"\xff\xfe\x00",
        b"NaN",
        b'{"format": 1e400}',
        b'{"format": ' + b"9" * 10_000 + b"}",
        b"[]",
        b" " * 5_000_000,
    ],
)
def test_content_that_is_not_a_record_or_not_a_scenario_is_refused(run_copy: Path, content: bytes) -> None:
    for name in ("run.json", "resolved.yaml"):
        shutil.copy(run_copy / name, run_copy / "kept")
        (run_copy / name).write_bytes(content)
        with pytest.raises(RunError) as caught:
            Run.open(run_copy)
        assert "\n" not in str(caught.value)
        shutil.move(run_copy / "kept", run_copy / name)


def refusal(path: Path) -> str:
    """Why a run is refused; nothing if it opens."""
    try:
        Run.open(path)
    except RunError as error:
        return str(error)
    return ""


def rewrite(path: Path, old: str, new: str) -> None:
    """Change the scenario of the run; what was quoted there need not be in `old`."""
    resolved = path / "resolved.yaml"
    text = resolved.read_text().replace('"', "")
    assert old in text
    resolved.write_text(text.replace(old, new, 1))


def watched(monkeypatch: pytest.MonkeyPatch) -> Callable[[], list[Path]]:
    """A function that returns the files that were opened since, links followed."""
    opened: list[Path] = []
    plain = Path.open

    def watching(path: Path, *arguments: Any, **settings: Any) -> Any:
        opened.append(path.resolve())
        return plain(path, *arguments, **settings)

    monkeypatch.setattr(Path, "open", watching)
    return lambda: opened


def edit(path: Path, **changes: object) -> None:
    record = json.loads((path / "run.json").read_text())
    (path / "run.json").write_text(json.dumps(record | changes))


def test_the_folder_of_runs_may_not_be_a_file(tmp_path: Path) -> None:
    (tmp_path / "runs").write_text("")
    with pytest.raises(UsageError, match="runs cannot be written: file exists"):
        new_directory(None, tmp_path / "runs", "Cart Pole", 0)


def test_an_empty_numbered_file_is_passed_over_and_never_overwritten(tmp_path: Path) -> None:
    """It belongs to a process that writes it now, or was killed before it wrote it."""
    (tmp_path / "0001.json").touch()
    assert numbered_files(tmp_path) == []
    path = write_numbered(tmp_path, "{}")
    assert (path.name, numbered_files(tmp_path)) == ("0002.json", [(2, path)])


def test_a_lock_that_is_free_after_a_moment_is_waited_for(tmp_path: Path) -> None:
    """`is_training` takes the lock for a moment, to find out whether it is free."""
    lock = FileLock(tmp_path / ".lock", thread_local=False)
    lock.acquire()
    release = Timer(0.2, lock.release)
    release.start()
    try:
        with run_lock(tmp_path):
            pass
    finally:
        release.join()
