"""A scenario may be written in Python: a mistake is raised at once, and the scenario compiles as the file
does."""

from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError

import deepbots_cli
from deepbots_cli import Scenario, api
from deepbots_cli.errors import ScenarioError
from deepbots_cli.scenario.actuators import VelocityMotor
from deepbots_cli.scenario.world import Arena, World

ROOT = Path(__file__).parents[2]
SAMPLES = sorted(ROOT.glob("scenarios/*.yaml"))


def cartpole(**changes: Any) -> Scenario:
    sections: dict[str, Any] = {
        "deepbots": 1,
        "name": "Built",
        "world": World(timestep="32 ms", arena=Arena(size="1 1 m")),
        "robots": {
            "cart": {
                "urdf": "cartpole",
                "sensors": {"pole": {"type": "joint_position", "joint": "pole_hinge"}},
                "actuators": {
                    "wheels": VelocityMotor(type="velocity_motor", joints=["wheel_*"], max_torque="10 N*m")
                },
                "emit": ["pole"],
                "apply": {"wheels": "drive * 5 rad/s"},
            }
        },
        "action": {"drive": {"choices": {"forward": 1, "backward": -1}}},
        "observation": {"cart.pole": "-20 .. 20 deg"},
        "reward": {"alive": 1},
        "termination": {"failure": {"fallen": "abs(cart.pole) > 15 deg"}},
        "truncation": {"max_steps": 200},
    }
    return Scenario(**sections | changes)


def test_models_mappings_and_plain_values_make_a_scenario_that_compiles() -> None:
    scenario = cartpole()
    assert isinstance(scenario.robots["cart"].actuators["wheels"], VelocityMotor)
    assert [finding.headline for finding in api.lint(scenario) if finding.severity == "error"] == []
    assert deepbots_cli.compile(scenario).program.name == "Built"
    assert scenario == cartpole()
    assert scenario.model_copy(update={"name": "Other"}) != scenario


@pytest.mark.parametrize(
    ("changes", "place", "message"),
    [
        ({"wurld": {}}, ("wurld",), "not permitted"),
        ({"world": {"timestep": 0.032j}}, ("world", "timestep"), "expected a duration"),
        ({"world": {"timestep": "10 parsec"}}, ("world", "timestep"), "unknown unit `parsec`"),
        ({"world": {"timestep": "10 kg"}}, ("world", "timestep"), "not a duration"),
        ({"world": {"timestep": "32 * (ms"}}, ("world", "timestep"), "parenthesis"),
        ({"world": {"timestep": "32 ms", "substeps": 4.5}}, ("world", "substeps"), "expected a whole number"),
        (
            {"world": {"timestep": "32 ms", "terrain": {"type": "hills"}}},
            ("world", "terrain", "type"),
            "unknown type `hills`",
        ),
        (
            {"world": {"timestep": "32 ms", "ground": {}, "terrain": {"type": "pit", "height": "1 m"}}},
            ("world", "terrain"),
            "be combined",
        ),
        ({"truncation": {}}, ("truncation",), "missing key `max_steps` or `max_time`"),
        ({"reward": {"alive": "1 +"}}, ("reward", "alive"), ""),
        ({"reward": {}}, ("reward",), "is empty"),
    ],
)
def test_a_mistake_is_raised_at_once_with_its_place(
    changes: dict[str, Any], place: tuple[str, ...], message: str
) -> None:
    with pytest.raises(ValidationError) as caught:
        cartpole(**changes)
    (error,) = caught.value.errors()
    assert error["loc"] == place
    assert message in error["msg"]


def test_a_scenario_cannot_be_changed() -> None:
    with pytest.raises(ValidationError):
        cartpole().name = "Other"


def test_a_mistake_that_only_the_whole_scenario_shows_is_a_finding_at_its_line() -> None:
    with pytest.raises(ScenarioError, match=r"<Scenario Built>:\d+:\d+: DB402"):
        deepbots_cli.compile(cartpole(reward={"alive": "2 * nothing"}))


@pytest.mark.parametrize("path", SAMPLES, ids=lambda path: path.stem)
def test_a_file_goes_to_python_and_back(path: Path) -> None:
    scenario = Scenario.from_yaml(path)
    assert Scenario.model_validate_json(scenario.model_dump_json(exclude_unset=True)) == scenario


@pytest.mark.parametrize("name", ["cartpole", "find_ball", "quadrotor", "tag", "carry"])
def test_a_file_that_went_through_python_compiles_to_the_same(name: str) -> None:
    path = ROOT / "scenarios" / f"{name}.yaml"
    assert deepbots_cli.compile(Scenario.from_yaml(path)).digest == deepbots_cli.compile(path).digest


def test_a_scenario_of_several_agents_is_changed_in_python() -> None:
    scenario = Scenario.from_yaml(ROOT / "scenarios" / "sumo.yaml")
    assert scenario.agents is not None
    red = scenario.agents["red"].model_copy(update={"reward": {"win": "20 when blue_out"}})
    changed = Scenario(
        **scenario.model_dump(exclude_unset=True) | {"agents": {**scenario.agents, "red": red}}
    )
    assert [term.text for term in deepbots_cli.compile(changed).program.agent.reward] == [
        "20 when blue_out",
        "20 when red_out",
    ]


def test_without_agents_the_sections_of_one_agent_are_required() -> None:
    with pytest.raises(ValidationError, match="reward"):
        Scenario(**cartpole().model_dump(exclude_unset=True, exclude={"reward"}))


def test_a_file_with_mistakes_is_not_read(tmp_path: Path) -> None:
    file = tmp_path / "broken.yaml"
    file.write_text("deepbots: 1\nname: Broken\n", encoding="utf-8")
    with pytest.raises(ScenarioError, match="missing keys"):
        Scenario.from_yaml(file)


def test_the_json_schema_of_the_model_is_the_one_for_editors() -> None:
    assert Scenario.model_json_schema()["title"] == "deepbots scenario"
