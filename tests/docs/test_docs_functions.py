"""Every function of the language has an example in the reference that runs as it is printed."""

from __future__ import annotations

import numpy as np
import pytest

from deepbots_cli import api
from deepbots_cli.compiler import CheckedScenario, check
from deepbots_cli.document import loads
from deepbots_cli.expressions.dimensions import NUMBER
from deepbots_cli.expressions.functions import FUNCTIONS, Family
from deepbots_cli.expressions.types import Symbol
from tests.worlds import SCENARIOS


def scenario_with_examples(observation: dict[str, str]) -> CheckedScenario:
    """The model scenario with each example as a value that the policy may see: a draw as a parameter, all
    else as an augmentation."""
    drawn = [name for name, function in FUNCTIONS.items() if function.family is Family.DRAW]
    lines = ["deepbots: 1", "extends: reference.yaml", "parameters:"]
    lines += [f"  drawn_{name}: {FUNCTIONS[name].example}" for name in drawn]
    lines += [
        "augment:",
        *(
            f"  by_{name}: '{f'drawn_{name}' if name in drawn else FUNCTIONS[name].example}'"
            for name in FUNCTIONS
        ),
    ]
    lines += ["observation:", *(f"  {name}: {shown}" for name, shown in observation.items())]
    return check(loads("\n".join(lines), base=SCENARIOS))


def symbol(checked: CheckedScenario, name: str) -> Symbol:
    assert checked.namespace is not None
    symbol = checked.namespace.resolve(name)
    assert symbol is not None
    return symbol


def as_observed(symbol: Symbol) -> str:
    assert symbol.type is not None
    dimension = symbol.type.dimension
    return (
        "auto"
        if symbol.type.boolean
        else f"{{range: -1 .. 1{'' if dimension == NUMBER else f' {dimension}'}, clip: false}}"
    )


@pytest.fixture(scope="module")
def checked() -> CheckedScenario:
    first = scenario_with_examples({"rover.near": "0 .. 50 cm"})
    return scenario_with_examples(
        {f"by_{name}": as_observed(symbol(first, f"by_{name}")) for name in FUNCTIONS}
    )


@pytest.mark.parametrize("name", FUNCTIONS)
def test_an_example_is_about_its_function(name: str):
    assert FUNCTIONS[name].example.count(f"{name}(") == 1


def test_the_examples_have_no_findings(checked: CheckedScenario):
    assert [
        f"{finding.code} {finding.headline}" for finding in checked.findings if finding.severity == "error"
    ] == []


def test_the_examples_give_finite_values_in_every_step(checked: CheckedScenario):
    compiled = api.compile(checked)
    fields = [entry.name for entry in compiled.program.agent.numbers]
    env = api.build(compiled.program)
    observations = [env.reset(seed=1)[0]]
    env.action_space.seed(1)
    observations += [env.step(env.action_space.sample())[0] for _ in range(20)]
    env.close()
    values = np.array(observations)
    assert values.shape == (21, len(fields))
    assert [
        name for name, column in zip(fields, values.T, strict=True) if not np.isfinite(column).all()
    ] == []
