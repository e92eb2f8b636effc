"""The files that a scenario was made from, and the scenario made again from their copies."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from deepbots_cli import api
from deepbots_cli.codegen import generate_module
from deepbots_cli.compiler.inputs import copy_names
from deepbots_cli.document import shipped
from deepbots_cli.program import identity
from deepbots_cli.program.identity import digest, interface, to_json
from tests.few import LIGHT, few
from tests.named import constant

MESH = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"


def unpack(compiled: api.Compiled, folder: Path) -> Path:
    """The scenario and its inputs as a run keeps them."""
    for name, content in compiled.inputs.items():
        copy = folder / "inputs" / name
        copy.parent.mkdir(parents=True, exist_ok=True)
        copy.write_bytes(content)
    (folder / "resolved.yaml").write_text(compiled.resolved, encoding="utf-8")
    return folder / "resolved.yaml"


@pytest.fixture
def meshed(workshop, cartpole):
    """A project whose robot is drawn with a mesh that lies in a folder beside that of the robot."""
    folder = workshop.file.parent
    robot = shipped.robot_path("cartpole").read_text(encoding="utf-8")
    for name in ("robots", "meshes"):
        (folder / name).mkdir()
    (folder / "meshes" / "part.obj").write_bytes(MESH)
    (folder / "robots" / "mine.urdf").write_text(
        robot.replace('<box size="0.20 0.05 0.08"/>', '<mesh filename="../meshes/part.obj"/>', 1),
        encoding="utf-8",
    )
    (folder / "scenarios").mkdir()
    workshop.file = folder / "scenarios" / "scenario.yaml"
    return workshop.write(cartpole(("urdf: cartpole", "urdf: ../robots/mine.urdf")))


def test_inputs_are_all_files_and_stand_to_each_other_as_they_did(meshed):
    inputs = api.compile(meshed).inputs
    assert list(inputs) == ["scenarios/scenario.yaml", "robots/mine.urdf", "meshes/part.obj"]
    assert inputs["meshes/part.obj"] == MESH


@pytest.mark.parametrize("overrides", [(), ("world.gravity=0 0 -9.8 m/s^2", "world.substeps=5")])
@pytest.mark.parametrize("name", few(shipped.scenario_names(), LIGHT))
def test_a_resolved_scenario_compiles_to_the_same_from_its_copies(tmp_path, name, overrides):
    compiled = api.compile(name, overrides=overrides)
    assert api.compile(unpack(compiled, tmp_path)).digest == compiled.digest


def test_so_does_one_whose_project_is_gone(meshed, tmp_path_factory):
    compiled = api.compile(meshed)
    resolved = unpack(compiled, tmp_path_factory.mktemp("elsewhere"))
    shutil.rmtree(meshed.parents[1])
    again = api.compile(resolved)
    assert again.digest == compiled.digest
    assert identity.to_json(again.program) == identity.to_json(
        compiled.program
    )  # where the mesh lies does not count


def test_so_does_one_with_a_file_that_only_an_evaluation_case_names(meshed, tmp_path_factory):
    folder = meshed.parents[1]
    shutil.copy(folder / "robots" / "mine.urdf", folder / "robots" / "other.urdf")
    case = "evaluation:\n  cases:\n    other: {set: {robots.cart.urdf: ../robots/other.urdf}}\n"
    meshed.write_text(meshed.read_text(encoding="utf-8") + case, encoding="utf-8")
    compiled = api.compile(meshed)
    assert "robots/other.urdf" in compiled.inputs
    resolved = unpack(compiled, tmp_path_factory.mktemp("elsewhere"))
    shutil.rmtree(folder)
    assert api.compile(resolved).digest == compiled.digest


def test_another_mesh_is_another_scenario(meshed):
    before = api.compile(meshed).digest
    (meshed.parents[1] / "meshes" / "part.obj").write_bytes(MESH + b"v 2 2 2\n")
    assert api.compile(meshed).digest != before


def test_files_of_other_homes_get_folders_of_their_own():
    files = [
        Path(name)
        for name in (
            "/mine/a/x.yaml",
            "/ours/r/x.urdf",
            "/ours/m/x.stl",
            "/mine/b/y.yaml",
            "/far/z.urdf",
            "/mine/elsewhere_1/y.urdf",
            "/mine/a/x.yaml",
        )
    ]
    named = copy_names(files, (Path("/mine"), Path("/ours")))
    assert list(named.values()) == [
        "a/x.yaml",
        "b/y.yaml",
        "elsewhere_1/y.urdf",  # the project has such a folder
        "elsewhere_2/r/x.urdf",
        "elsewhere_2/m/x.stl",
        "elsewhere_3/z.urdf",
    ]


# The compiled scenario as canonical JSON, and its digest, which means what it says


def test_minus_zero_and_infinity_have_other_digests() -> None:
    cartpole = api.compile("cartpole").program
    first, *others = (
        digest(cartpole.with_agent(reward=(constant(value),)))
        for value in (0.0, -0.0, float("inf"), float("-inf"))
    )
    assert len({first, *others}) == 4


def test_the_text_is_json_with_sorted_keys() -> None:
    text = to_json(api.compile("cartpole").program)
    assert json.dumps(json.loads(text), sort_keys=True, separators=(",", ":")) == text


@pytest.mark.parametrize(
    ("sets", "robots"),
    [
        ((), ("hunter",)),
        (("signals.pull=turn", "robots.prey.receive={whim: whim + pull, threat: 0 rad}"), ("hunter", "prey")),
    ],
)
def test_an_agent_commands_the_robots_whose_messages_depend_on_its_action_and_agrees_with_them(
    sets, robots
) -> None:
    program = api.compile("tag_scripted", overrides=sets).program
    assert program.agent.robots == robots
    items = [name for name in interface(program)["agent"] if name.startswith("message")]
    assert {name.partition(".")[0].split()[-1] for name in items} == set(robots)


@pytest.mark.parametrize(
    "text", ['"""\nimport os\n"""', "'''", "\\", "\\u0022", "a\r\nb", "{x}", "\x00", 'Ends with a quote"']
)
def test_the_summary_stays_text_in_the_code(text: str) -> None:
    cartpole = api.compile("cartpole").program
    code = generate_module(replace(cartpole, summary=text))
    plain = generate_module(cartpole)
    assert len(code.splitlines()) == len(plain.splitlines())
    names = compile(code, "generated", "exec").co_names
    assert names == compile(plain, "generated", "exec").co_names


def digest_of(workshop, text: str) -> str:
    return workshop.compile(text).digest


def test_the_digest_depends_on_what_a_file_means_only(workshop, cartpole) -> None:
    plain = digest_of(workshop, cartpole())
    assert plain == digest_of(workshop, cartpole())
    assert plain == digest_of(workshop, cartpole(("substeps: 4", "substeps:   4   # of 8 ms")))
    assert plain == digest_of(workshop, cartpole(("  timestep:", '  "timestep":')))
    assert plain == digest_of(workshop, cartpole(("15 deg", "0.015e3 deg")))
    assert plain == digest_of(workshop, cartpole(("timestep: 32 ms", "timestep: 0.032 s")))
    assert plain == digest_of(workshop, cartpole(("{max_steps: 200}", "\n  max_steps: 200")))
    assert plain == digest_of(
        workshop, cartpole(("track:       0.39 m", "track:       0.39")).replace("> track", "> track * 1 m")
    )


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("15 deg", "15.1 deg"),
        ("substeps: 4", "substeps: 5"),
        ("alive: 1", "alive: 2"),
        ("alive: 1", "alife: 1"),
        ("format: csv", "format: json"),
        ("max_torque: 10 N*m", "max_torque: 9 N*m"),
        ("gamma: 0.98", "gamma: 0.99"),
        ("{z: 0.04 m}", "{z: 0.05 m}"),
        ("uniform(-1 .. 1 deg)", "uniform(-1 .. 2 deg)"),
        ("abs(x) > track", "abs(x) >= track"),
    ],
)
def test_the_digest_distinguishes_scenarios(workshop, cartpole, old: str, new: str) -> None:
    assert digest_of(workshop, cartpole()) != digest_of(workshop, cartpole((old, new)))
