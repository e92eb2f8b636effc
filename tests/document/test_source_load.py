"""Whole documents: reading files, `extends`, `include`, `remove`, `--set`, and which files may be read."""

from __future__ import annotations

import os
import tracemalloc
from pathlib import Path

import pytest

from deepbots_cli.document import Document, MappingNode, Permissions, load, loads, shipped, to_data
from deepbots_cli.document.files import UnusableFile, project_root, resolve_reference
from deepbots_cli.errors import UsageError
from deepbots_cli.files import read_at_most


def write(folder: Path, **files: str) -> Path:
    """Files named by their stem; the first one is returned."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in files.items():
        (folder / f"{name}.yaml").write_text(text, encoding="utf-8")
    return folder / f"{next(iter(files))}.yaml"


def data(document: Document) -> object:
    assert document.root is not None, [f.headline for f in document.findings]
    assert not list(document.findings), [f.headline for f in document.findings]
    return to_data(document.root)


def codes(document: Document) -> list[str]:
    return [finding.code for finding in document.findings]


# Reading


def test_a_missing_file_a_folder_and_a_pipe_are_wrong_usage(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path / "none.yaml", tmp_path, tmp_path / "pipe", tmp_path / ("x" * 300), Path("a\0b")):
        with pytest.raises(UsageError) as raised:
            load(path)
        assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    ("content", "code", "where"),
    [
        (b"", "DB107", (1, 1)),
        (b"a: \x00\x01", "DB001", (1, 4)),
        (b"\x7fELF\x02\x01\x00\x00", "DB001", (1, 1)),
        ("a: é".encode("latin-1"), "DB001", (1, 4)),
        ("ä: é\nb: ".encode() + b"\xff", "DB001", (2, 4)),
        ("a: 1".encode("utf-16"), "DB001", (1, 1)),
        (b"a: 1\rb: 2", "DB001", (1, 5)),
        ("a: 1\u2028b: 2".encode(), "DB001", (1, 5)),
        (b"a: 1\n" * 300_000, "DB005", (1, 1)),
        (b"just text", "DB103", (1, 1)),
        (b"- a\n- b", "DB103", (1, 1)),
    ],
)
def test_a_file_that_is_not_a_scenario_gets_one_finding_at_the_place(
    tmp_path: Path, content: bytes, code: str, where: tuple[int, int]
) -> None:
    path = tmp_path / "a.yaml"
    path.write_bytes(content)
    document = load(path, display="a.yaml")
    assert document.root is None
    assert [(f.code, f.span.start_position, f.span.source.name) for f in document.findings] == [
        (code, where, "a.yaml")
    ]


def test_a_byte_order_mark_and_windows_line_ends_are_read(tmp_path: Path) -> None:
    path = tmp_path / "a.yaml"
    path.write_bytes("\ufeffa: 1\r\nb:\r\n  c: 2\r\n".encode())
    document = load(path)
    assert data(document) == {"a": 1, "b": {"c": 2}}
    assert document.root is not None
    assert document.root.entries["b"].value.span.start_position == (3, 3)


# extends, include, remove


def test_an_extending_file_merges_by_key_and_keeps_the_order_of_the_base(tmp_path: Path) -> None:
    path = write(
        tmp_path,
        child="extends: base.yaml\nobservation:\n  speed: 2\n  new: 3\nlist: [c]\n",
        base="observation:\n  x: 1\n  speed: 1\n  y: 1\nlist: [a, b]\nkept: true\n",
    )
    document = load(path)
    assert data(document) == {
        "observation": {"x": 1, "speed": 2, "y": 1, "new": 3},
        "list": ["c"],
        "kept": True,
    }
    assert document.root is not None
    observation = document.root.get("observation")
    assert isinstance(observation, MappingNode)
    assert list(observation.entries) == ["x", "speed", "y", "new"]
    assert observation.entries["speed"].value.span.source is document.source
    assert observation.entries["x"].value.span.source.name.endswith("base.yaml")


def test_extending_goes_over_several_files(tmp_path: Path) -> None:
    path = write(tmp_path, c="extends: b.yaml\nx: 3\n", b="extends: a.yaml\ny: 2\n", a="x: 1\ny: 1\nz: 1\n")
    document = load(path)
    assert data(document) == {"x": 3, "y": 2, "z": 1}
    assert [source.name.split("/")[-1] for source in document.sources] == ["c.yaml", "b.yaml", "a.yaml"]


def test_a_changed_type_shape_or_algorithm_replaces_its_mapping(tmp_path: Path) -> None:
    path = write(
        tmp_path,
        child="extends: base.yaml\ns: {type: camera}\nt: {algorithm: PPO, rate: 2}\nreward: {shape: 3}\n",
        base="s: {type: gyro, noise: 1}\nt: {algorithm: PPO, size: 1}\nreward: {shape: 1, other: 2}\n",
    )
    expected = {
        "s": {"type": "camera"},
        "t": {"algorithm": "PPO", "size": 1, "rate": 2},
        "reward": {"shape": 3, "other": 2},
    }
    assert data(load(path)) == expected


def test_an_included_mapping_lies_beneath_its_siblings(tmp_path: Path) -> None:
    robot = "urdf: urdf/epuck.urdf\nsensors: {a: {type: gyro}}\n"
    (tmp_path / "robots").mkdir()
    (tmp_path / "robots" / "epuck.yaml").write_text(robot)
    path = write(
        tmp_path,
        main="robots:\n  r:\n    include: robots/epuck.yaml\n    sensors: {b: {type: touch}}\n    emit:"
        " [a]\n",
    )
    document = load(path)
    robots = {
        "r": {
            "urdf": "urdf/epuck.urdf",
            "sensors": {"a": {"type": "gyro"}, "b": {"type": "touch"}},
            "emit": ["a"],
        }
    }
    assert data(document) == {"robots": robots}


def test_paths_are_relative_to_the_file_that_wrote_them(tmp_path: Path) -> None:
    (tmp_path / "robots").mkdir()
    (tmp_path / "robots" / "epuck.yaml").write_text("urdf: epuck.urdf\n")
    path = write(tmp_path, main="r: {include: robots/epuck.yaml}\n")
    document = load(path, ["r.extra=mine.urdf"])
    robot = document.root.get("r") if document.root else None
    assert isinstance(robot, MappingNode)
    assert document.directory_of(robot.entries["urdf"].value.span) == tmp_path / "robots"
    assert document.directory_of(robot.span) == tmp_path
    assert document.directory_of(robot.entries["extra"].value.span) == Path.cwd()


def test_a_finding_in_an_included_file_has_the_chain_of_inclusions(tmp_path: Path) -> None:
    path = write(tmp_path, main="r:\n  include: part.yaml\n", part="a: 1\na: 2\n")
    (finding,) = load(path).findings
    included_from = finding.span.source.included_from
    assert finding.span.source.name.endswith("part.yaml")
    assert included_from is not None
    assert included_from.start_position == (2, 12)


@pytest.mark.parametrize("word", ["extends: ", "r:\n  include: "])
def test_a_file_that_leads_back_to_itself_is_reported(tmp_path: Path, word: str) -> None:
    path = write(tmp_path, a=f"{word}b.yaml\n", b=f"{word}a.yaml\n")
    document = load(path)
    (finding,) = document.findings
    assert (finding.code, finding.span.text) == ("DB204", "a.yaml")
    assert finding.notes == ("a.yaml -> b.yaml -> a.yaml",)


def test_a_missing_file_is_reported_once_and_the_nearest_name_is_suggested(tmp_path: Path) -> None:
    path = write(tmp_path, main="r: {include: epuk.yaml}\ns: 1\n", epuck="a: 1\n")
    document = load(path)
    (finding,) = document.findings
    assert finding.code == "DB204"
    assert finding.span.text == "epuk.yaml"
    assert finding.help == "did you mean epuck.yaml?"
    assert document.root is not None
    assert to_data(document.root) == {"r": {}, "s": 1}


@pytest.mark.parametrize(
    "reference",
    ["/etc/passwd", "../../secret.yaml", "link.yaml", "~/x.yaml", '"a\\0b"', "x" * 5000, ".", "loop"],
)
def test_no_reference_leads_out_of_the_project(tmp_path: Path, reference: str) -> None:
    project = tmp_path / "far" / "project"
    (tmp_path / "secret.yaml").write_text("password: 1\n")
    path = write(project, main=f"extends: {reference}\n")
    (project / "link.yaml").symlink_to(tmp_path / "secret.yaml")
    (project / "loop").symlink_to(project / "loop")
    document = load(path)
    assert codes(document) == ["DB204"]
    assert document.root is None
    assert len(document.sources) == 1


def test_a_symbolic_link_that_leads_outside_is_called_one(tmp_path: Path) -> None:
    (tmp_path / "secret.yaml").write_text("password: 1\n")
    path = write(tmp_path / "project", main="extends: link.yaml\n")
    (tmp_path / "project" / "link.yaml").symlink_to(tmp_path / "secret.yaml")
    (finding,) = load(path).findings
    assert finding.headline == "`link.yaml` leads outside the project through a symbolic link"
    path.write_text("extends: ../secret.yaml\n")
    (finding,) = load(path).findings
    assert finding.headline == "`../secret.yaml` lies outside the project"


def test_an_allowed_path_may_be_read(tmp_path: Path) -> None:
    path = write(tmp_path / "project", main="extends: ../shared/base.yaml\n")
    write(tmp_path / "shared", base="a: 1\n")
    assert codes(load(path)) == ["DB204"]
    assert data(load(path, permissions=Permissions([tmp_path / "shared"]))) == {"a": 1}


def test_allowed_paths_may_be_text_and_a_single_one(tmp_path: Path) -> None:
    path = write(tmp_path / "project", main="extends: ../shared/base.yaml\n")
    write(tmp_path / "shared", base="a: 1\n")
    for allowed in ([str(tmp_path / "shared")], str(tmp_path / "shared"), tmp_path / "shared"):
        assert data(load(str(path), permissions=Permissions(allowed))) == {"a": 1}


def test_the_project_is_the_nearest_folder_with_a_marker(tmp_path: Path) -> None:
    (tmp_path / "deepbots.toml").touch()
    path = write(tmp_path / "deep" / "down", main="extends: ../../base.yaml\n")
    write(tmp_path, base="a: 1\n")
    assert project_root(path.parent) == tmp_path
    assert data(load(path)) == {"a": 1}


def test_shipped_files_may_be_read_from_anywhere(tmp_path: Path) -> None:
    for root in shipped.data_roots():
        for path in root.rglob("*.*"):
            assert resolve_reference(str(path), tmp_path, shipped.data_roots()) == path
    assert isinstance(
        resolve_reference(str(shipped.data_dir() / "pyproject.toml"), tmp_path, shipped.data_roots()),
        UnusableFile,
    )


@pytest.mark.parametrize("name", ["../x", "", "a/b", "x" * 10_000, "a\0", "nothing-like-it"])
def test_an_unknown_name_is_not_a_shipped_file(name: str) -> None:
    assert shipped.scenario_path(name) is None
    assert shipped.robot_path(name) is None


def test_many_files_cannot_expand_beyond_the_limit(tmp_path: Path) -> None:
    files = {f"f{i}": "\n".join(f"k{j}: {{include: f{i + 1}.yaml}}" for j in range(10)) for i in range(10)}
    path = write(tmp_path, **files, f10="a: 1\n")
    assert "DB005" in codes(load(path))


def test_a_long_chain_of_files_is_refused(tmp_path: Path) -> None:
    path = write(tmp_path, **{f"f{i}": f"extends: f{i + 1}.yaml\n" for i in range(100)}, f100="a: 1\n")
    assert codes(load(path)) == ["DB204"]


def test_remove_takes_paths_out_also_those_with_a_dot_in_a_key(tmp_path: Path) -> None:
    file = write(
        tmp_path,
        one="extends: base.yaml\nremove: [observation.cart.pole, observation.cart.x, list.0]\n",
        base="observation: {cart.pole: 1, cart: {x: 2, y: 2}, z: 3}\nlist: [a, b]\n",
    )
    assert data(load(file)) == {"observation": {"cart": {"y": 2}, "z": 3}, "list": ["b"]}


def test_what_a_file_writes_and_removes_itself_is_reported(tmp_path: Path) -> None:
    file = write(tmp_path, one="extends: base.yaml\na: {b: 2, c: 3}\nremove: [a.b]\n", base="a: {b: 1}\n")
    document = load(file)
    (finding,) = document.findings
    assert finding.code == "DB205"
    assert finding.span.location == f"{file}:2:5"
    assert finding.labels[0].span.text == "a.b"
    assert document.root is not None
    assert to_data(document.root) == {"a": {"b": 2, "c": 3}}


def test_a_mapping_that_is_removed_and_written_replaces_the_inherited_one(tmp_path: Path) -> None:
    file = write(
        tmp_path,
        one="extends: base.yaml\nremove: [reward, d]\nreward: {new: 2}\nd: {include: part.yaml, f: 3}\n",
        base="reward: {old: 1}\nd: {e: 1}\n",
        part="g: 4\n",
    )
    assert data(load(file)) == {"reward": {"new": 2}, "d": {"g": 4, "f": 3}}


def test_removing_what_is_not_there_is_reported_where_the_path_goes_wrong() -> None:
    (finding,) = loads("a: {b: 1}\nremove: [a.c]\n").findings
    assert (finding.code, finding.span.text) == ("DB201", "c")
    assert "b" in (finding.help or "")


@pytest.mark.parametrize(
    "text",
    ["extends: [a]", "extends: 3", "remove: a", "remove: [[a]]", "r: {include: {a: 1}}", "remove: [3]"],
)
def test_the_words_of_the_source_take_only_their_type(text: str) -> None:
    assert codes(loads(f"a: 1\n{text}\n")) == ["DB103"]


# --set

BASE = (
    "parameters: {pole: 1, track: 2 m}\nworld: {timestep: 32 ms, arena: {size: 1 m}}\nobservation:"
    " {cart.pole: 1, x: 2}\nlist: [a, b]\n"
)


@pytest.mark.parametrize(
    ("assignment", "path", "expected"),
    [
        ("pole=1.5", ("parameters", "pole"), 1.5),
        ("world.timestep=8 ms", ("world", "timestep"), "8 ms"),
        ("observation.cart.pole=-1 .. 1", ("observation", "cart.pole"), "-1 .. 1"),
        ("world.arena={size: 2 m, wall: 1}", ("world", "arena"), {"size": "2 m", "wall": 1}),
        ("world.new=3", ("world", "new"), 3),
        ("seed=0", ("seed",), 0),
        ("list.1=c", ("list", 1), "c"),
        ("list=[]", ("list",), []),
        ("pole='a = b'", ("parameters", "pole"), "a = b"),
    ],
)
def test_an_assignment_replaces_the_value_at_its_path(
    assignment: str, path: tuple[str | int, ...], expected: object
) -> None:
    value: object = data(loads(BASE, overrides=[assignment]))
    for step in path:
        value = value[step]  # type: ignore[index]
    assert value == expected


def test_an_assigned_value_has_its_place_in_the_assignment() -> None:
    document = loads(BASE, overrides=["world.timestep=8 ms"])
    world = document.root.get("world") if document.root else None
    assert isinstance(world, MappingNode)
    span = world.entries["timestep"].value.span
    assert (span.text, span.location) == ("8 ms", "--set world.timestep:1:16")


@pytest.mark.parametrize(
    ("assignment", "code", "marked", "hint"),
    [
        ("poel=3", "DB201", "poel", "did you mean `pole`?"),
        ("wrld.timestep=3", "DB201", "wrld", "did you mean `world`?"),
        ("world.arena.size.x=3", "DB201", "x", "whole value"),
        ("world.area.size=3", "DB201", "area", "did you mean `arena`?"),
        ("world..x=3", "DB201", ".", "there are"),
        ("world.arena.door.width=3", "DB201", "door", "set it whole: `world.arena.door={width: ...}`"),
        ("pole", "DB107", "pole", "path=value"),
        ("pole=", "DB107", "pole=", "path=value"),
        ("pole=null", "DB107", "pole", "no null"),
        ("pole= #fff", "DB107", "pole= #fff", "quotes"),
        ("=3", "DB102", "=3", "path=value"),
        ("pole=a: b: c", "DB001", ":", "quotes"),
        ("pole=[[", "DB001", "[", "closing"),
        ("pole=*x", "DB001", "*x", "quotes"),
        ("pole=\x1b", "DB001", "\x1b", "escape"),
        ("pole=\udc80", "DB001", "\udc80", "remove it"),
    ],
)
def test_an_assignment_that_cannot_be_made_is_reported_in_its_own_text(
    assignment: str, code: str, marked: str, hint: str
) -> None:
    document = loads(BASE, overrides=[assignment])
    (finding,) = document.findings
    assert (finding.code, finding.span.text) == (code, marked)
    assert finding.span.source.name == f"--set {assignment.partition('=')[0] or assignment}"
    assert hint in (finding.help or "")
    assert document.root is not None
    assert to_data(document.root) == to_data(loads(BASE).root)  # type: ignore[arg-type]


def test_a_section_that_the_file_leaves_out_is_begun_by_an_assignment() -> None:
    document = loads(
        "deepbots: 1\nname: X\n",
        overrides=["messages.format=none", "train.network.hidden=[8]", "train.replay.type=her"],
    )
    assert document.root is not None
    assert to_data(document.root) == {
        "deepbots": 1,
        "name": "X",
        "messages": {"format": "none"},
        "train": {"network": {"hidden": [8]}, "replay": {"type": "her"}},
    }


def test_a_misspelled_section_in_an_assignment_is_not_begun() -> None:
    document = loads("deepbots: 1\nname: X\nmessages: {format: csv}\n", overrides=["mesages.format=none"])
    assert [finding.code for finding in document.findings] == ["DB201"]


def test_extends_takes_the_name_of_a_shipped_scenario_and_a_file_of_that_name_comes_first(
    tmp_path: Path,
) -> None:
    path = write(tmp_path, main="deepbots: 1\nextends: cartpole\nname: Mine\n")
    shipped_root = data(load(Path(shipped.scenario_path("cartpole") or "")))
    document = load(path)
    assert data(document) == {key: value for key, value in shipped_root.items() if key != "tests"} | {
        "name": "Mine"
    }
    assert [source.name.split("/")[-1] for source in document.sources] == ["main.yaml", "cartpole.yaml"]
    (tmp_path / "cartpole").write_text("a: 1\n")
    assert data(load(path)) == {"deepbots": 1, "name": "Mine", "a": 1}


def test_an_unknown_name_under_extends_is_reported_with_the_nearest_shipped_scenario() -> None:
    (finding,) = loads("deepbots: 1\nextends: cartpoel\n").findings
    assert finding.code == "DB204"
    assert finding.help == "did you mean `cartpole`, which is shipped with deepbots?"
    assert finding.notes[0].startswith("shipped scenarios are balancer, biped, carry, cartpole, ")


def test_a_folder_to_be_allowed_that_is_not_there_is_wrong_usage(tmp_path: Path) -> None:
    file = write(tmp_path, a="deepbots: 1\n")
    with pytest.raises(UsageError, match="is not a folder"):
        load(file, permissions=Permissions([tmp_path / "nowhere"]))


# Files are read up to a limit, and memory is asked for by what they hold


@pytest.mark.parametrize(
    ("size", "most"), [(0, 5), (4, 5), (5, 5), (6, 5), (70_000, 5), (70_000, 70_001), (70_000, 1 << 25)]
)
def test_a_file_is_read_to_its_end_or_to_the_limit(tmp_path, size, most):
    data = bytes(number % 251 for number in range(size))
    (tmp_path / "file").write_bytes(data)
    assert read_at_most(tmp_path / "file", most) == data[:most]


@pytest.mark.skipif(not Path("/proc/version").exists(), reason="no file here says less than it holds")
def test_a_file_that_says_that_it_is_empty_is_read_all_the_same():
    whole = Path("/proc/version").read_bytes()
    assert Path("/proc/version").stat().st_size == 0 < len(whole)
    assert read_at_most(Path("/proc/version"), 1000) == whole
    assert read_at_most(Path("/proc/version"), 3) == whole[:3]


def test_a_small_file_takes_no_memory_for_the_largest_that_might_be(tmp_path):
    (tmp_path / "file").write_text("deepbots: 1\n")
    tracemalloc.start()
    try:
        read_at_most(tmp_path / "file", 1 << 25)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 1 << 20
