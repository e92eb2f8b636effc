"""The compiled scenario as canonical JSON, and its digest, which means what it says."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest

from deepbots_cli import api
from deepbots_cli.codegen import generate_module
from deepbots_cli.program.identity import digest, interface, to_json
from tests.named import constant


def test_minus_zero_and_infinity_are_told_apart() -> None:
    cartpole = api.compile("cartpole").program
    one, *others = (
        digest(cartpole.with_agents(reward=(constant(value),)))
        for value in (0.0, -0.0, float("inf"), float("-inf"))
    )
    assert len({one, *others}) == 4


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
    program = api.compile("tag", overrides=sets).program
    assert program.agents == {"agent": program.agent}
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
def test_the_digest_tells_scenarios_apart(workshop, cartpole, old: str, new: str) -> None:
    assert digest_of(workshop, cartpole()) != digest_of(workshop, cartpole((old, new)))
