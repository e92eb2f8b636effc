"""Names of a scenario that mean something in Python or to the compiler keep the meaning of the scenario.

Memories of stateful functions that several methods of generated code update.

Hostile texts and values in any place of a scenario: refused in words, or quoted in code that runs.
"""

from __future__ import annotations

import ast
import copy
import io
import json
import random
import re
import tokenize
from collections.abc import Iterator
from contextlib import closing, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from deepbots_cli import api
from deepbots_cli.codegen import generate_module
from deepbots_cli.codegen.names import Constants, docstring
from deepbots_cli.compiler import check
from deepbots_cli.compiler.inputs import RESOLVED_NAME
from deepbots_cli.document.load import loads
from deepbots_cli.errors import DeepbotsError
from deepbots_cli.expressions.scalar import NamedFloat
from deepbots_cli.runtime.spaces import observation_space
from tests.few import every
from tests.worlds import CART, Make, begun

# Python's words, the words of generated code, and what the compiler would call its own variables.
AWKWARD = [
    *(
        "self",
        "lambda",
        "match",
        "float",
        "abs",
        "print",
        "pi",
        "hypot",
        "copysign",
        "engine",
        "message",
        "stamp",
        "reward",
        "observed",
    ),
    *(
        "cart_joints",
        "cart_cart_pose",
        "cart_place",
        "seen_first",
        "clipped",
        "pack",
        "physics",
        "step_count",
        "robot_cart",
        "drive_pick",
    ),
    *(
        "told_first",
        "term_first",
        "parameter_first",
        "delta_signals_rise_0",
        "ended_by",
        "_private",
        "__dunder__",
        "a1",
        "memory",
    ),
]
SCENARIO = """\
deepbots: 1
name: {name}
summary: {summary}
world: {{timestep: 20 ms, substeps: 2}}
robots:
  cart:
    urdf: cartpole_rail
    base: fixed
    sensors:
      place: {{type: joint_position, joint: slider}}
      swing: {{type: joint_position, joint: hinge}}
    actuators: {{motor: {{type: velocity_motor, joint: slider, max_torque: 10 N}}}}
    receive:
      {awkward}: drive
    emit: [place, swing]
    apply: {{motor: {awkward} * 0.02 m/s + 0 * swing * (m/s) / rad}}
action: {{drive: -1 .. 1}}
augment:
  first: position(cart.cart).x
  {awkward}_: first
signals:
  {awkward}: 2 * first
  rise: delta({awkward})
observation:
  first: -1 .. 1 m
  cart.swing: -4 .. 4 rad
reward:
  {awkward}: {awkward} / m
  first: rise / m
truncation: {{max_steps: 50}}
reset: {{joints: {{cart.hinge: 1 rad}}}}
"""


def scenario(folder: Path, awkward: str = "plain", name: str = "Odd", summary: str = "none") -> Path:
    file = folder / "odd.yaml"
    file.write_text(SCENARIO.format(awkward=awkward, name=name, summary=summary), encoding="utf-8")
    return file


RESERVED = {"lambda", "pi"}


@pytest.mark.parametrize("awkward", every(3, AWKWARD))
def test_a_name_is_never_taken_for_something_else(tmp_path: Path, awkward: str) -> None:
    expected, actual = [], []
    for name, rows in (("plain", expected), (awkward, actual)):
        checked = api.load(scenario(tmp_path, name))
        assert bool(checked.findings.errors) == (name in RESERVED), list(checked.findings)
        if checked.findings.errors:
            return
        environment = begun(api.make(checked, engine="exact"))
        for _ in range(4):
            observation, reward, _, _, info = environment.step(np.array([0.5]))
            rows.append((observation.tolist(), reward, list(info["reward_terms"].values())))
        environment.close()
    assert actual == expected


def test_a_sensor_with_the_name_of_a_link_is_not_sampled_for_a_function_of_the_link(tmp_path: Path) -> None:
    unused = "robots.cart.sensors.cart={type: joint_position, joint: slider, noise: 1 mm}"
    assert "sense_cart" not in api.compile(scenario(tmp_path), overrides=[unused]).code


@pytest.mark.parametrize("name", ["maximum", "minimum", "np"])
def test_a_name_is_no_function_of_a_batch(tmp_path: Path, name: str) -> None:
    file = tmp_path / "named.yaml"
    file.write_text(
        f"deepbots: 1\nextends: cartpole\nname: N\naugment: {{{name}: 'max(0.1, min(time / s, 0.5)) + 1'}}\n"
        f"observation: {{{name}: 0 .. 2}}\n",
        encoding="utf-8",
    )
    with closing(api.make_vec(api.compile(file), 2)) as worlds:
        worlds.reset(seed=0)
        worlds.step(np.array([0, 1]))


@pytest.mark.parametrize("name", ["class", "None", "lambda", "Any", "float", "Supervisor"])
def test_a_name_of_a_scenario_that_is_a_word_of_python_gives_a_class(tmp_path: Path, name: str) -> None:
    environment = begun(api.make(api.load(scenario(tmp_path, name=f'"{name}"')), engine="exact"))
    environment.close()


@pytest.mark.parametrize("names", [("robot", "other"), ("arm_1", "arm1")])
def test_each_robot_has_a_controller_of_its_own(make: Make, names: tuple[str, str]) -> None:
    first, second = names
    environment = begun(
        make(f"""\
deepbots: 1
name: Two
world: {{timestep: 20 ms}}
robots:
  {first}:
    urdf: cartpole_rail
    base: fixed
    sensors: {{place: {{type: joint_position, joint: slider}}}}
    actuators: {{motor: {{type: velocity_motor, joint: slider, max_torque: 10 N}}}}
    emit: {{smooth: "low_pass(place, 0.1 s)"}}
    apply: {{motor: drive * 0.1 m/s}}
  {second}: {{urdf: cartpole_rail, base: fixed, actuators: {{motor: {{type: velocity_motor, joint: slider}}}},
    apply: {{motor: -drive * 0.1 m/s}}}}
action: {{drive: -1 .. 1}}
observation: {{{first}.smooth: -1 .. 1 m}}
reward: {{apart: "(joint_position({first}.slider) - joint_position({second}.slider)) / m"}}
truncation: {{max_steps: 10}}
""")
    )
    assert [environment.step([1.0])[1] for _ in range(5)][-1] > 0.01


@pytest.mark.parametrize("name", ["line follower", "3 carts", "Ünïcode", "a'b\\\"c", "x y-z_w", "..."])
def test_a_name_of_a_scenario_without_the_form_of_a_name_is_refused(tmp_path: Path, name: str) -> None:
    checked = api.load(scenario(tmp_path, name=f'"{name}"'))
    assert [finding.code for finding in checked.findings.errors] == ["DB105"]


@pytest.mark.parametrize(
    "summary",
    [
        '"\\"\\"\\""',
        '"\\\\"',
        '"a\\nb"',
        "'quote \" and '' quote'",
        '"🚗 車 é"',
        '"\\u2028 a \\t b \\x85"',
        "it's",
    ],
)
def test_any_summary_can_be_printed(tmp_path: Path, summary: str) -> None:
    exec(
        compile(api.compile(scenario(tmp_path, summary=summary)).code, "printed", "exec"),
        {"__name__": "printed"},
    )


@pytest.mark.parametrize(
    ("source", "overrides"),
    [
        ("cartpole", []),
        ("cartpole", ["observation={cart.pole_angle: {range: -12 .. 12 deg, clip: false}}"]),
        ("see_ball", []),
    ],
)
def test_only_an_observation_of_clipped_numbers_is_float32_from_minus_one_to_one_in_the_code(
    source: str, overrides: list[str]
) -> None:
    compiled = api.compile(source, overrides=overrides)
    space = observation_space(compiled.program.agent)
    is_scaled = space.dtype == np.float32 and space.is_bounded()
    assert ("What the policy sees, float32 in [-1, 1]: " in compiled.code) == is_scaled


def test_a_constant_is_explained_by_its_parameter_if_no_other_number_is_in_it() -> None:
    parts = [
        NamedFloat(number, "size", part, "[1, 2, 3]") for part, number in zip("xyz", (1, 2, 3), strict=True)
    ]
    constants = Constants()
    assert [constants.vector(parts), constants.vector([*parts[:2], 7.0])] == ["SIZE", "SIZE_1"]
    assert constants.lines == ["SIZE = (1.0, 2.0, 3.0)  # [1, 2, 3]", "SIZE_1 = (1.0, 2.0, 7.0)"]


@pytest.mark.parametrize(
    "text",
    ["", "plain", 'say "hello" \\ and go', '"', '"""', "\\", "many words " * 30, "new\nline\x00", "車 é 🚗"],
)
def test_a_docstring_says_what_the_text_says(text: str) -> None:
    assert ast.literal_eval("\n".join(docstring(text))).split() == text.split()


# Memories of stateful functions that several methods of generated code update


ALIVE = "reward: {alive: 1}\n"


@pytest.mark.parametrize("function", ["running_max", "previous", "low_pass"])
def test_a_sum_over_three_memories_drives_a_motor(make: Make, function: str) -> None:
    tau = ", 0.1 s" if function == "low_pass" else ""
    sum_of_three = f"sum({function}(vector(place, place, place){tau}))"
    environment = begun(make(CART.replace("drive * 0.02 m/s", f'"(0.3 m - {sum_of_three}) / s"') + ALIVE))
    for _ in range(60):
        observation, *_ = environment.step([0.0])
    # The motor moves until three times the place is 0.3 m.
    assert 2.4 * observation[0] == pytest.approx(0.1, abs=0.02)


def test_a_sum_of_four_products_with_a_largest_value_is_that_of_its_items(tmp_path: Path) -> None:
    (tmp_path / "four.yaml").write_text("""\
deepbots: 1
extends: cartpole
name: Four
robots: {cart: {sensors: {w: {type: joint_velocity, joints: [wheel_*]}}}}
augment: {load: abs(cart.w)}
reward:
  inner: sum(load * max(load * load)) / (1 rad/s)^3
  outer: sum(load) * max(load * load) / (1 rad/s)^3
""")
    with closing(api.make(tmp_path / "four.yaml")) as environment:
        environment.reset(seed=0)
        *_, info = environment.step(environment.action_space.sample())
    assert info["reward_terms"]["inner"] == pytest.approx(info["reward_terms"]["outer"])
    assert info["reward_terms"]["inner"] > 0


def test_a_sum_over_three_memories_is_sent_to_a_robot(make: Make) -> None:
    aim = '    receive: {aim: "sum(running_max(vector(0 m, 0 m, time * 1 m/s)))"}\n    apply:'
    environment = begun(make(CART.replace("    apply:", aim).replace("drive * 0.02 m/s", "aim / s") + ALIVE))
    for _ in range(50):
        observation, *_ = environment.step([0.0])
    # The speed is the time: 0.5 m after 1 s, less one timestep.
    assert 2.4 * observation[0] == pytest.approx(0.5, abs=0.03)


# Hostile texts and values in any place of a scenario: refused in words, or quoted in code that runs


TESTS = Path(__file__).parents[1]
SOURCES = [
    "cartpole",
    *(
        str(TESTS / "data" / "scenarios" / f"{name}.yaml")
        for name in ("drawn", "pair", "placed", "sensed", "drone")
    ),
    *(str(TESTS / "channel" / f"{name}.yaml") for name in ("radio", "copies")),
    str(TESTS / "placement" / "few.yaml"),
    str(TESTS / "world" / "hills.yaml"),
]
MARK = "intruder"
TEXTS = (
    f'"""\n{MARK}()\n"""',
    f"x\n{MARK} = 1",
    f'"; {MARK}(); "',
    f"'; {MARK}(); '",
    f"\\'; {MARK}() #",
    f"__import__('{MARK}')",
    f"x): {MARK}(",
    f"{{{MARK}}}",
    f"a\r{MARK}()",
    f"a\u2028{MARK}()\x0c",
    "\\",
    "",
)
OTHERS: tuple[Any, ...] = (
    None,
    True,
    -1,
    0,
    10**30,
    1e308,
    1e-320,
    -1e300,
    [],
    ["x"],
    {},
    "1e-320 s",
    "1e300 m",
    "-1 .. -2",
    "0 .. 1e-320",
)
NUMBERS = ("0", "-1", "1e-320", "1e300", "1e-9", "1000")

Place = tuple[Any, ...]


@pytest.fixture(scope="module", params=every(6, SOURCES, lambda source: Path(source).stem))
def opened(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[Any, Path]:
    """A scenario as data, and the folder that its files lie in."""
    checked = api.load(request.param)
    folder = tmp_path_factory.mktemp("copies")
    checked.inputs.write(folder)
    return yaml.load((folder / RESOLVED_NAME).read_text(), Words), folder


class Words(yaml.SafeLoader):
    """YAML 1.1 takes `5e-3` for a text, which JSON would then quote."""


Words.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(r"-?\d+(\.\d*)?e-?\d+"), list("-0123456789")
)


def places(data: Any, path: Place = ()) -> Iterator[Place]:
    """Where the scalars and keys of a document stand."""
    if isinstance(data, dict | list):
        for key, item in data.items() if isinstance(data, dict) else enumerate(data):
            yield from places(item, (*path, key))
    else:
        yield path


def replaced(data: Any, path: Place, value: Any, *, key: bool = False) -> str:
    """The document as text, with another value at a path, or another key."""
    data = copy.deepcopy(data)
    inner = data
    for step in path[:-1]:
        inner = inner[step]
    if key and isinstance(inner, dict):
        inner[value] = inner.pop(path[-1])
    else:
        inner[path[-1]] = value
    return json.dumps(data)


def at(data: Any, path: Place) -> Any:
    """The value at a path."""
    for step in path:
        data = data[step]
    return data


def with_other_number(value: Any, rng: random.Random) -> Any:
    """The value with another number and the same unit."""
    number = rng.choice(NUMBERS)
    return re.sub(r"-?\d+(\.\d+)?", number, value, count=1) if isinstance(value, str) else float(number)


def compiled(text: str, folder: Path) -> api.Compiled | None:
    """The scenario of a text, or None where it is refused in words."""
    try:
        return api.compile(check(loads(text, "hostile.yaml", folder)))
    except DeepbotsError:
        return None


def words(code: str) -> set[str]:
    """Everything in the code that is neither quoted nor a comment."""
    return {
        token.string
        for token in tokenize.generate_tokens(io.StringIO(code).readline)
        if token.type in (tokenize.NAME, tokenize.OP)
    }


def some(data: Any, seed: int, count: int = 40) -> list[Place]:
    everywhere = sorted(places(data), key=str)
    return random.Random(seed).sample(everywhere, min(count, len(everywhere)))


def test_text_in_any_place_is_quoted_or_refused(opened: tuple[Any, Path]) -> None:
    data, folder = opened
    assert compiled(json.dumps(data), folder) is not None
    rng = random.Random(1)
    for path in some(data, 1):
        hostile = compiled(replaced(data, path, rng.choice(TEXTS), key=rng.random() < 0.3), folder)
        if hostile is not None:
            compile(hostile.code, "printed", "exec")
            assert MARK not in words(hostile.code), path


def test_unusual_values_in_any_place_give_a_world_that_runs_or_are_refused(opened: tuple[Any, Path]) -> None:
    data, folder = opened
    rng = random.Random(2)
    running = 0
    for path in some(data, 2, count=24):
        value = with_other_number(at(data, path), rng) if rng.random() < 0.7 else rng.choice(OTHERS)
        hostile = compiled(replaced(data, path, value), folder)
        if hostile is not None:
            with suppress(DeepbotsError), closing(api.build(hostile.program)) as world:
                world.reset(seed=0)
                world.step(world.action_space.sample())
                running += 1
    assert running > 3


@pytest.mark.parametrize(
    "name", ['x"', "a\nimport os", '"""', "os.system", "A", "", "naïve", "a b", "1a", "a;b"]
)
def test_a_name_that_is_not_an_identifier_is_never_printed(name: str) -> None:
    """The compiler lets none through; should it do so by mistake, nothing is printed."""
    program = api.compile("cartpole").program
    with pytest.raises(ValueError, match="name"):
        generate_module(program.with_agent(reward=(replace(program.agent.reward[0], name=name),)))
