"""The YAML language server, which VS Code and Neovim use, as a process of its own; `make editors` says where
it is.

Neovim with the settings of docs/editors.md shows findings, hover and completion of a scenario. It is
searched on the `PATH`, or named by `NEOVIM`.

What `--format sarif` writes, against the schema of the standard; `make editors` says where that is.

The YAML language server with the JSON Schema of deepbots: its completion, hover and problems.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import jsonschema
import pytest

from deepbots_cli import api
from deepbots_cli.cli.commands.lint import Format, report
from deepbots_cli.compiler.inventory import scenario_names
from deepbots_cli.diagnostics import Finding
from deepbots_cli.scenario.json_schema import FILE_NAME, schema_text
from deepbots_cli.scenario.sensors import SENSORS
from tests.golden.cases import write
from tests.lsp.client import Client, Message, position

ROOT = Path(__file__).parents[2]
CARTPOLE = (ROOT / "scenarios" / "cartpole.yaml").read_text(encoding="utf-8")
CURSOR = "§"


@dataclass(frozen=True)
class Typed:
    """What an editor shows while one types: the cursor is at `place` of the document at `uri`."""

    client: Client
    uri: str
    place: Message
    problems: list[Message]

    def _asked(self, method: str) -> Message:
        answer: Message = self.client.request(
            f"textDocument/{method}", {"textDocument": {"uri": self.uri}, "position": self.place}
        )
        return answer

    @property
    def hover(self) -> str:
        return str(self._asked("hover")["contents"]["value"])

    @property
    def offers(self) -> dict[str, Message]:
        return {item["label"]: item for item in self._asked("completion")["items"]}

    @property
    def messages(self) -> list[tuple[str, str]]:
        """The underlined text and the message of each problem."""
        lines = self.client.texts[self.uri].splitlines()
        return [(_underlined(lines, problem["range"]), problem["message"]) for problem in self.problems]


Type = Callable[[str, str], Typed]


def _underlined(lines: list[str], span: Message) -> str:
    start, end = span["start"], span["end"]
    line = lines[start["line"]]
    return line[start["character"] : end["character"] if end["line"] == start["line"] else None]


@pytest.fixture(scope="session")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the schemas; below `general` and `own` a comment leads to them."""
    root = tmp_path_factory.mktemp("scenarios")
    (root / FILE_NAME).write_text(schema_text(), encoding="utf-8")
    (root / "cartpole.schema.json").write_text(
        schema_text(scenario_names(api.load("cartpole"))), encoding="utf-8"
    )
    return root


@pytest.fixture(scope="session")
def client(folder: Path) -> Iterator[Client]:
    """The server, without its catalogs in the net."""
    server = os.environ.get("YAML_LANGUAGE_SERVER")
    if server is None:
        pytest.skip("`make editors` installs the server and runs this")
    settings = {
        "validate": True,
        "hover": True,
        "completion": True,
        "schemas": {(folder / FILE_NAME).as_uri(): "*.scenario.yaml"},
        "schemaStore": {"enable": False},
        "kubernetesCRDStore": {"enable": False},
    }
    capabilities = {
        "textDocument": {
            "hover": {"contentFormat": ["markdown"]},
            "completion": {"completionItem": {"snippetSupport": True, "documentationFormat": ["markdown"]}},
        },
        "workspace": {"configuration": True},
    }
    command = ["node", str(Path(server).resolve()), "--stdio"]
    with Client(folder, capabilities=capabilities, command=command, settings={"yaml": settings}) as connected:
        yield connected


def _typing(client: Client, folder: Path, ending: str, comment: str) -> Type:
    def typed(old: str, new: str) -> Typed:
        assert old in CARTPOLE
        text = comment + CARTPOLE.replace(old, new, 1)
        before, _, after = text.partition(CURSOR)
        uri = client.open(folder / f"case{len(client.texts)}{ending}", before + after)
        return Typed(client, uri, position(text, len(before)), client.published(uri))

    return typed


@pytest.fixture
def typed(client: Client, folder: Path) -> Type:
    """CartPole with a change, in a file that settings give the general schema; where the change has a `§`,
    the cursor is."""
    return _typing(client, folder, ".scenario.yaml", "")


@pytest.fixture
def typed_for(client: Client, folder: Path) -> Type:
    """The same in a file whose first line names the schema made for CartPole."""
    return _typing(client, folder, ".yaml", "# yaml-language-server: $schema=cartpole.schema.json\n")


pytestmark = pytest.mark.editors

NEOVIM = os.environ.get("NEOVIM", "nvim")


def version() -> tuple[int, ...]:
    if shutil.which(NEOVIM) is None:
        return (0,)
    output = subprocess.run([NEOVIM, "--version"], capture_output=True, text=True, check=True).stdout
    return tuple(map(int, re.findall(r"\d+", output)[:2]))


@pytest.fixture(scope="module")
def answers(tmp_path_factory: pytest.TempPathFactory) -> Message:
    if version() < (0, 11):
        pytest.skip("Neovim 0.11 or newer is not there")
    folder = tmp_path_factory.mktemp("neovim")
    for name in ("scenarios", "robots"):
        shutil.copytree(ROOT / name, folder / name)
    (folder / "deepbots.toml").touch()
    page = (ROOT / "docs" / "editors.md").read_text(encoding="utf-8")
    (folder / "init.lua").write_text(
        "\n".join(
            re.findall(
                r"^```lua\n(.*?)^```", page.partition("## The JSON Schema")[0], re.MULTILINE | re.DOTALL
            )
        )
    )
    command = folder / "bin" / "deepbots"
    command.parent.mkdir()
    command.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m deepbots_cli "$@"\n')
    command.chmod(0o755)
    places = {f"XDG_{kind}_HOME": str(folder / kind) for kind in ("CONFIG", "DATA", "STATE", "CACHE")}
    environment = {**os.environ, **places, "PYTHONPATH": str(ROOT), "SEEN": str(folder / "seen.json")}
    environment["PATH"] = f"{command.parent}{os.pathsep}{environment['PATH']}"
    script = Path(__file__).with_name("neovim.lua")
    arguments = [NEOVIM, "--headless", "-u", "init.lua", "-c", f"luafile {script}"]
    ran = subprocess.run(
        arguments, cwd=folder, env=environment, capture_output=True, text=True, timeout=120, check=False
    )
    assert (folder / "seen.json").exists(), ran.stderr
    answer: Message = json.loads((folder / "seen.json").read_text(encoding="utf-8"))
    assert answer.get("fault") is None
    return answer


def test_findings_underline_the_right_letters_behind_an_emoji(answers: Message) -> None:
    assert ["DB104", "gyros"] in answers["findings"]


def test_a_quick_fix_and_all_fixes_at_once_change_the_text(answers: Message) -> None:
    assert '"😀ü": {type: gyro, link: ball}' in answers["fixed"]  # that all fixes were made was waited for


def test_hover_shows_type_and_value(answers: Message) -> None:
    assert "a length (m), 2.7 m, fixed" in answers["hover"]


def test_completion_offers_the_names_that_begin_so(answers: Message) -> None:
    assert answers["offered"][0] == "metric"


def test_the_definition_of_a_joint_is_in_its_robot_file(answers: Message) -> None:
    assert '<joint name="pitch"' in answers["definition"]


def test_formatting_makes_what_fmt_makes(answers: Message) -> None:
    assert answers["formatted"] == "world: {timestep: 32 ms"


@pytest.fixture(scope="session")
def schema() -> jsonschema.Draft7Validator:
    place = os.environ.get("SARIF_SCHEMA")
    if place is None:
        pytest.skip("`make editors` installs the schema and runs this")
    return jsonschema.Draft7Validator(json.loads(Path(place).read_text(encoding="utf-8")))


def sarif(findings: list[Finding]) -> object:
    return json.loads(report(findings, Format.sarif, (), ("error",)))


def test_every_mistake_of_the_golden_cases_becomes_valid_sarif(
    schema: jsonschema.Draft7Validator, tmp_path: Path
) -> None:
    (tmp_path / "deepbots.toml").touch()
    findings = [
        finding
        for path in sorted(write(tmp_path / "golden").glob("lint/err/*.yaml"))
        for finding in api.lint(path, preview=True)
    ]
    assert len(findings) > 200
    assert [error.message for error in schema.iter_errors(sarif(findings))] == []


def test_no_findings_become_valid_sarif(schema: jsonschema.Draft7Validator) -> None:
    assert [error.message for error in schema.iter_errors(sarif([]))] == []


SAMPLES = sorted(ROOT.glob("scenarios/*.yaml"))
JOINTS = {"pole_hinge", "wheel_front_left", "wheel_front_right", "wheel_rear_left", "wheel_rear_right"}
SENSOR = "{type: joint_position, joint: pole_hinge}"


# What it offers


def test_the_keys_of_a_section_are_offered(typed: Type) -> None:
    offers = typed("  substeps: 4\n", "  substeps: 4\n  §\n").offers
    assert {"gravity", "ground", "walls", "light"} <= set(offers)
    assert not {"substeps", "urdf", "reward"} & set(offers)


def test_a_key_comes_with_an_example_of_its_value(typed: Type) -> None:
    offer = typed("  timestep: 32 ms\n", "  §\n").offers["timestep"]
    assert offer["insertText"] == "timestep: ${1:32 ms}"
    assert "Unit: s" in str(offer["documentation"])


def test_the_kinds_of_sensors_are_offered(typed: Type) -> None:
    assert sorted(typed(SENSOR, "{type: §}").offers) == sorted(SENSORS)


def test_before_its_kind_is_known_a_sensor_is_offered_the_key_for_it(typed: Type) -> None:
    assert set(typed(SENSOR, "\n        §").offers) == {"type", "include"}


@pytest.mark.parametrize(
    ("kind", "own", "others"),
    [
        ("joint_position", {"joint", "joints", "noise"}, {"link", "fov", "rays"}),
        ("camera", {"link", "resolution", "fov", "noise"}, {"joint", "rays", "lookup"}),
        ("lidar", {"link", "rays", "angle_range", "measure"}, {"joint", "fov", "spot"}),
    ],
)
def test_a_sensor_is_offered_the_keys_of_its_kind_alone(
    typed: Type, kind: str, own: set[str], others: set[str]
) -> None:
    offers = set(typed(SENSOR, f"\n        type: {kind}\n        §").offers)
    assert own <= offers
    assert not others & offers


@pytest.mark.parametrize(
    ("old", "new", "offered", "others"),
    [
        (
            "  drive: {choices: {forward: 1, backward: -1}}",
            "  drive:\n    §",
            {"range", "each", "choices", "forbid"},
            set(),
        ),
        (
            "{choices: {forward: 1, backward: -1}}",
            "\n    choices: {a: 1, b: 2}\n    §",
            {"forbid"},
            {"range", "each", "choices"},
        ),
        ("\nreset:\n", "\nreset:\n  layouts:\n    one:\n      §\n", {"map", "cell"}, set()),
        (
            "\nreset:\n",
            "\nreset:\n  layouts:\n    one:\n      cell: 10 cm\n      §\n",
            {"map", "legend"},
            {"cell"},
        ),
    ],
    ids=["an action", "a choice", "a layout", "a map"],
)
def test_of_several_forms_the_keys_of_all_are_offered_until_one_is_chosen(
    typed: Type, old: str, new: str, offered: set[str], others: set[str]
) -> None:
    offers = set(typed(old, new).offers)
    assert offered <= offers
    assert not others & offers


def test_in_an_empty_file_the_sections_are_offered(client: Client, folder: Path) -> None:
    uri = client.open(folder / "empty.yaml", f"# yaml-language-server: $schema={FILE_NAME}\n")
    client.published(uri)
    place = {"line": 1, "character": 0}
    items = client.request("textDocument/completion", {"textDocument": {"uri": uri}, "position": place})[
        "items"
    ]
    texts = {item["label"]: item["insertText"] for item in items}
    assert {"deepbots", "world", "robots", "reward", "extends"} <= set(texts)
    assert (texts["deepbots"], [text for text in texts.values() if ":" not in text]) == (
        "deepbots: ${1:1}",
        [],
    )


def test_an_algorithm_is_offered_its_own_hyperparameters(typed: Type) -> None:
    offers = set(typed("  algorithm: PPO\n", "  algorithm: DQN\n  §\n").offers)
    assert {"exploration_fraction", "buffer_size"} <= offers
    assert "clip_range" not in offers


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("format: csv", "format: §", {"csv", "json", "struct", "msgpack", "none"}),
        ("size: 1 1 m}", "size: 1 1 m, color: §}", {"red", "green", "tan"}),
        ("urdf: ../robots/urdf/cartpole.urdf", "urdf: §", {"cartpole", "epuck", "rover"}),
        ("algorithm: PPO", "algorithm: SAC\n  replay: §", {"uniform", "her"}),
        ("speed:           -0.8 .. 0.8 m/s", "speed: §", {"auto"}),
    ],
    ids=["a word", "a color", "a shipped robot", "a word beside a mapping", "a range"],
)
def test_the_words_of_a_key_are_offered(typed: Type, old: str, new: str, words: set[str]) -> None:
    assert words <= set(typed(old, new).offers)


def test_the_joints_of_the_robot_are_offered(typed_for: Type) -> None:
    assert set(typed_for(SENSOR, "{type: joint_position, joint: §}").offers) == JOINTS


def test_the_joints_of_the_robot_are_offered_in_a_list(typed_for: Type) -> None:
    assert set(typed_for("[wheel_*]", "[wheel_front_left, §]").offers) >= JOINTS


@pytest.mark.parametrize(
    ("old", "new", "names"),
    [
        ("    apply: {wheels", "    emit: [§]\n    apply: {wheels", {"pole_angle"}),
        ("  alive: 1\n", "  alive: §\n", {"x", "speed", "cart.pole_angle", "fall_angle"}),
        ("  tip_speed:       -2 .. 2 m/s\n", "  §\n", {"tip_speed", "previous_action"}),
        ("joints: {cart.pole_hinge: uniform(-1 .. 1 deg)}", "joints:\n    §", {"cart.pole_hinge"}),
    ],
    ids=["sensors", "signals", "values", "joints by their full names"],
)
def test_names_of_the_scenario_are_offered_where_they_may_stand(
    typed_for: Type, old: str, new: str, names: set[str]
) -> None:
    assert names <= set(typed_for(old, new).offers)


# What it explains


@pytest.mark.parametrize(
    ("old", "new", "shown"),
    [
        (
            "timestep:",
            "time§step:",
            ["Duration of one control step", "Unit: s", "Required", "Example: timestep: 32 ms"],
        ),
        (
            "size: 1 1 m}",
            "size: 1 1 m, wall§_height: 20 cm}",
            ["Height of the walls", "Unit: m", "Default: 0", "20 cm"],
        ),
        ("gae_lambda:", "gae§_lambda:", ["trade-off between bias and variance", "Example: gae"]),
        ("  alive: 1", "  al§ive: 1", ["Terms of the reward"]),
        ("pole_angle: {", "pole§_angle: {", ["Measures one joint, or several joints by name."]),
    ],
    ids=["a key", "a key with a default", "a key of a kind", "a name of one's own", "a part of a kind"],
)
def test_a_key_is_explained_with_unit_default_and_example(
    typed: Type, old: str, new: str, shown: list[str]
) -> None:
    hover = typed(old, new).hover
    assert [text for text in shown if text not in hover] == []
    assert hover.count("```yaml") <= 1


def test_the_kinds_are_explained(typed: Type) -> None:
    hover = typed("type: velocity_motor", "type: velo§city_motor").hover
    assert "* `velocity_motor`: Drives a joint at a commanded velocity." in hover
    assert "* `gripper`: Opens and closes fingers" in hover


def test_the_joints_of_the_robot_are_explained(typed_for: Type) -> None:
    hover = typed_for("joint: pole_hinge", "joint: pole§_hinge").hover
    assert "The joint that the sensor measures." in hover
    assert "* `pole_hinge`: revolute, -1." in hover
    assert "* `wheel_rear_left`: continuous" in hover


# What it marks


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("  substeps: 4", "  substep: 4", ("substep", "Property substep is not allowed.")),
        ("  timestep: 32 ms\n", "", ("world", 'Missing property "timestep".')),
        ("substeps: 4", "substeps: four", ("four", "expected a whole number")),
        ("gamma: 0.98", "gamma: 1.98", ("1.98", "Value is above the maximum of 1.")),
        (
            "-20 .. 20 deg",
            "20 deg",
            ("20 deg", "write it like `-1 .. 1 m` (a vector: `-1 -2 .. 1 2 m`), or `auto`"),
        ),
        (
            "-20 .. 20 deg",
            "{range: 20 deg}",
            ("20 deg", "write it like `-1 .. 1 m` (a vector: `-1 -2 .. 1 2 m`), or `auto`"),
        ),
        (
            ", joint: pole_hinge",
            ", joint: pole_hinge, joints: all",
            ("joints", "`joints` cannot be combined with `joint`"),
        ),
        ("joint: pole_hinge", "joint: pole_hinge, fov: 60 deg", ("fov", "Property fov is not allowed.")),
    ],
)
def test_a_mistake_is_marked_in_its_place_once(
    typed: Type, old: str, new: str, expected: tuple[str, str]
) -> None:
    assert typed(old, new).messages == [expected]


def test_an_unknown_kind_is_marked_with_the_known_kinds(typed: Type) -> None:
    ((place, message),) = typed("velocity_motor", "velocty_motor").messages
    assert place == "velocty_motor"
    assert '"velocity_motor", "position_motor", "torque_motor"' in message


@pytest.mark.parametrize(
    ("old", "new", "place"),
    [("joint: pole_hinge", "joint: pole_hing", "pole_hing"), ("[wheel_*]", "[wheel_*, pole]", "pole")],
    ids=["an unknown joint", "a link in a list of joints"],
)
def test_an_unknown_joint_is_marked_with_the_known_joints(
    typed_for: Type, old: str, new: str, place: str
) -> None:
    ((marked, message),) = typed_for(old, new).messages
    assert marked == place
    assert "wheel_front_left" in message
    assert "pole_hinge" in message


def test_without_the_names_of_the_scenario_any_joint_will_do(typed: Type) -> None:
    assert typed("joint: pole_hinge", "joint: pole_hing").messages == []


@pytest.mark.parametrize("path", SAMPLES, ids=lambda path: path.stem)
def test_in_a_shipped_scenario_nothing_is_marked(client: Client, folder: Path, path: Path) -> None:
    (folder / f"{path.stem}.own.json").write_text(
        schema_text(scenario_names(api.load(path))), encoding="utf-8"
    )
    text = path.read_text(encoding="utf-8")
    for schema in (FILE_NAME, f"{path.stem}.own.json"):
        comment = f"# yaml-language-server: $schema={schema}\n"
        assert client.published(client.open(folder / f"{schema}.{path.name}", comment + text)) == []


def test_the_comment_leads_to_the_schema_and_not_past_it(client: Client, folder: Path) -> None:
    """Without it, or where it leads nowhere, none of this would be marked."""
    nonsense = "deepbots: 1\nnonsense: true\n"
    led = client.published(
        client.open(folder / "led.yaml", f"# yaml-language-server: $schema={FILE_NAME}\n{nonsense}")
    )
    assert "Property nonsense is not allowed." in [problem["message"] for problem in led]
    assert client.published(client.open(folder / "unled.yaml", nonsense)) == []
