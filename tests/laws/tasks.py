"""Strategies for what a scenario says about its task: who acts, goals, limits, cases, stages, training,
tests.

`Author` draws the world, the robots and their messages first, since all of this uses their names.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from copy import deepcopy
from typing import TYPE_CHECKING, Any

from hypothesis import strategies as st

from deepbots_cli.expressions.dimensions import NUMBER
from deepbots_cli.expressions.types import SPACE, Context, Known, ValueType
from deepbots_cli.scenario.base import section_fields
from deepbots_cli.scenario.quantities import Number, Quantity
from deepbots_cli.scenario.scenario import Scenario
from deepbots_cli.scenario.task import Disturbance, Expectation, Observed
from deepbots_cli.scenario.training import ALGORITHMS, SelfPlay, Training
from tests.laws.expressions import (
    CONDITION,
    SCALARS,
    Expressions,
    Names,
    UnavailableError,
    chance,
    literal,
    literal_range,
    pick,
)
from tests.laws.fields import Place, plain

if TYPE_CHECKING:
    from tests.laws.scenarios import Author

_UNTIL = ("success_rate >= 0.7 over 40 episodes", "50_000 steps", "mean_return >= 10 in evaluation")
_SOLVED = ("mean_return >= 100 over 20 episodes", "mean_return >= 10 over 100 episodes")
_BY_ITSELF = (
    "algorithm",
    "total_timesteps",
    "teacher",
    "self_play",
    "symmetry",
    "turns",
    "shards",
    "staleness",
)
"""Keys of a training that depend on what else the scenario has."""
_VARIED = ("world", "objects", "robots", "reset", "disturbances", "messages")
"""Sections that cases and stages change."""


def actions(author: Author, names: list[str], robots: Sequence[str]) -> dict[str, Any]:
    """Draw actions for robots: all ranges or all choices, since no algorithm learns both."""
    author.actions = {}
    is_choice = chance(author.draw, 50)
    drawn: dict[str, Any] = {}
    for name in names:
        kind = ValueType(known=Known.STEP)
        if is_choice:
            variables = [name] if chance(author.draw, 70) else [f"{name}_u", f"{name}_v"]
            options = {option: dict.fromkeys(variables, value) for option, value in _OPTIONS.items()}
            drawn[name] = {"choices": options if len(variables) > 1 else dict(_OPTIONS)}
            author.actions |= dict.fromkeys(variables, kind)
            continue
        drawn[name] = pick(author.draw, ("-1 .. 1", "0 .. 1"))
        groups = [(robot, group) for robot in robots for group in author.groups.get(robot, {})]
        if groups and chance(author.draw, 30):
            robot, group = pick(author.draw, groups)
            drawn[name] = {"range": drawn[name], "each": f"{robot}.{group}"}
            kind = kind._replace(components=author.groups[robot][group])
        author.actions[name] = kind
    return drawn


_OPTIONS: Mapping[str, Any] = {"left": -1, "rest": 0, "right": 1}


def forbid(author: Author, actions: Mapping[str, Any]) -> None:
    """Draw conditions under which an option must not be chosen; another one stays."""
    for action in actions.values():
        if "choices" in action and chance(author.draw, 20):
            with suppress(UnavailableError):
                action["forbid"] = {"left": author.condition(Context.FORBID)}


def script(author: Author, actions: Mapping[str, Any]) -> dict[str, Any]:
    """Draw a decision for each action."""
    decisions: dict[str, Any] = {}
    for name, action in actions.items():
        if "choices" not in action:
            decisions[name] = author.expression(Context.SCRIPT, ValueType())
        elif chance(author.draw, 50):
            decisions[name] = pick(author.draw, tuple(action["choices"]))
        else:
            decisions[name] = {"left": author.condition(Context.SCRIPT), "rest": True}
    return decisions


def goal(author: Author) -> tuple[dict[str, Any], str]:
    """Draw a goal, two values of one type, and a reward, which depends on nothing else."""
    kind = ValueType(pick(author.draw, SCALARS), pick(author.draw, (None, SPACE)))
    achieved, desired = (author.expression(Context.GOAL, kind) for _ in range(2))
    drawn = {"achieved": achieved, "desired": desired, "range": author.wide_range(Place(kind=kind))}
    drawn["tolerance"] = literal(author.draw, kind.dimension, low=0.05, high=0.5)
    if chance(author.draw, 30):
        drawn["noise"] = pick(author.draw, ("2 %", literal(author.draw, kind.dimension, low=0.01, high=0.1)))
    values = {"achieved": kind, "desired": kind, "goal_reached": CONDITION}
    reward = Expressions(author.draw, Names(Context.FIXED, values)).text(ValueType())
    return drawn, plain(reward)


def observed(author: Author, names: Mapping[str, ValueType], percent: int) -> dict[str, Any]:
    """Draw entries of an observation: at least one, others by chance."""
    entries: dict[str, Any] = {}
    for name, kind in names.items():
        if kind.boolean or kind.picture or (entries and not chance(author.draw, percent)):
            continue
        place = Place(kind=ValueType(kind.dimension, known=Known.STEP))
        is_long = chance(author.draw, 50)
        entries[name] = author.section(Observed, place) if is_long else author.wide_range(place)
    return entries


def endings(author: Author, words: tuple[str, ...]) -> dict[str, str]:
    """Draw conditions by name; one that is true at the start would be an error."""
    drawn = {}
    for word in words:
        if chance(author.draw, 50):
            drawn[f"{word}0"] = f"time > 50 ms and {author.condition(Context.ENDING)}"
    return drawn


def truncation(author: Author) -> dict[str, Any]:
    drawn: dict[str, Any] = {}
    way = author.draw(st.integers(0, 3))
    if way != 1:
        limit: Any = author.draw(st.integers(5, 30))
        drawn["max_steps"] = {"limit": limit, "success": "all"} if way == 3 else limit
    if way in (1, 2):
        drawn["max_time"] = pick(author.draw, ("600 ms", "1 s"))
    return drawn


# Cases, stages, tests


def pushed(author: Author) -> str:
    """Draw a body that is not fixed, or a link of it."""
    objects = author.data.get("objects", {})
    free = [
        name
        for name, entry in objects.items()
        if not entry.get("fixed") and entry.get("solid", True) and "count" not in entry
    ]
    free += [name for name, robot in author.data["robots"].items() if robot.get("base") != "fixed"]
    return pick(author.draw, free)


def settings(author: Author) -> dict[str, Any]:
    """Draw changes of one or two values: parameters by name, others by path."""
    changes: dict[str, Any] = {}
    paths = [
        (path, way) for path, way in author.leaves() if path[0] in _VARIED and not set("./") & set(path[-1])
    ]
    for _ in range(author.draw(st.integers(1, 2))):
        if author.parameters and chance(author.draw, 60):
            name = pick(author.draw, tuple(author.parameters))
            changes[name] = author.parameter_text(name, author.parameters[name])
        elif paths:
            path, draw_again = pick(author.draw, paths)
            changes[".".join(path)] = draw_again()
    return changes


def curriculum(author: Author) -> Any:
    """Draw stages, or levels of a parameter that is drawn from a range."""
    ranges = [
        name
        for name, text in author.data.get("parameters", {}).items()
        if str(text).startswith("uniform(") and author.parameters[name].known is Known.EPISODE
    ]
    if ranges and chance(author.draw, 60):
        name = pick(author.draw, ranges)
        span = re.sub(r"uniform\(([^()]*)\).*", r"\1", author.data["parameters"][name])
        drawn: dict[str, Any] = {"set": {name: span}, "levels": author.draw(st.integers(2, 5))}
        drawn["up"] = pick(author.draw, ("truncation", [*author.data["truncation"]]))
        if author.data.get("termination", {}).get("failure"):
            drawn["down"] = "failure"
        if chance(author.draw, 50):
            drawn["at_top"] = "random"
        if chance(author.draw, 50):
            drawn["start"] = pick(author.draw, (1, "0 .. 1"))
        return drawn
    untils = _UNTIL if has_success(author.data) else _UNTIL[1:]
    stages = [
        {"name": f"stage{number}", "set": settings(author), "until": pick(author.draw, untils)}
        for number in range(author.draw(st.integers(1, 2)))
    ]
    return [*stages, {"name": "whole"}]


def evaluation(author: Author) -> dict[str, Any]:
    drawn: dict[str, Any] = {"episodes": author.draw(st.integers(1, 20))}
    if chance(author.draw, 60):
        drawn["cases"] = {"other": {"set": settings(author)}}
        if chance(author.draw, 30):
            drawn["cases"]["other"]["episodes"] = author.draw(st.integers(1, 5))
    return drawn


def check(author: Author, data: Mapping[str, Any], names: Sequence[str], agent: str) -> dict[str, Any]:
    """Draw a test: who acts, and what comes of it. `data` has the actions and scripts, `names` the
    endings."""
    drawn: dict[str, Any] = {"agent": agent} if agent else {}
    names = [
        name for name in names if author.data.get("endings", {}).get(name, {}).get("ends", agent) == agent
    ]
    drivers = ("random", "zero", *data.get("scripts", {}))
    if not agent and chance(author.draw, 30):
        step = {
            name: "left" if "choices" in action else pick(author.draw, (0, 0.5, 1))
            for name, action in data["action"].items()
        }
        drawn["actions"] = [step, {**step}]
    else:
        drawn["driver"] = pick(author.draw, drivers if not agent else drivers[:2])
    for key, most in (("episodes", 3), ("seed", 9), ("max_steps", 9)):
        if chance(author.draw, 40):
            drawn[key] = author.draw(st.integers(1, most))
    if chance(author.draw, 20):
        drawn["max_time"] = pick(author.draw, ("100 ms", "0.2 s"))
    cases = author.data.get("evaluation", {}).get("cases", {})
    stages = author.data.get("curriculum", [])
    if cases and chance(author.draw, 30):
        drawn["case"] = pick(author.draw, tuple(cases))
    elif isinstance(stages, list) and stages and chance(author.draw, 50):
        drawn["stage"] = stages[0]["name"]
    drawn["expect"] = expectation(author, names, agent)
    return drawn


def expectation(author: Author, names: Sequence[str], agent: str) -> dict[str, Any]:
    """Draw what comes of the episodes of a test."""
    expected: dict[str, Any] = {}
    rates = {
        "success_rate": names and has_success(author.data),
        "failure_rate": author.data.get("termination", {}).get("failure"),
    }
    for key in section_fields(Expectation):
        if not chance(author.draw, 30):
            continue
        if key in ("always", "eventually"):
            expected[key] = author.condition(Context.TEST)
        elif key == "ends_by" and (names or author.data["truncation"]):
            expected[key] = list(names) or list(author.data["truncation"])
        elif rates.get(key) and not agent:
            expected[key] = pick(author.draw, ("0 .. 100 %", 0))
        elif key == "mean_return":
            expected[key] = "-1000000 .. 1000000"
    return expected or {"mean_return": "-1000000 .. 1000000"}


# Training


def training(author: Author, data: Mapping[str, Any]) -> dict[str, Any]:
    """Draw a training that can act as `data` says: an algorithm, and some of its keys."""
    is_choice = any("choices" in action for action in data["action"].values())
    has_forbid = any("forbid" in action for action in data["action"].values())

    def fits(model: type[Training]) -> bool:
        choice = "choice" if len(data["action"]) == 1 else "choices"
        wanted = choice if is_choice else "ranges"
        return (
            wanted in model.acts_by
            and (model.uses_masks or not has_forbid)
            and (model.has_critic or not data.get("critic"))
        )

    algorithms = [word for word, model in ALGORITHMS.built_in.items() if fits(model)]
    word = pick(author.draw, algorithms)
    model = ALGORITHMS[word]
    drawn: dict[str, Any] = {"algorithm": word, "total_timesteps": pick(author.draw, (1000, 50000))}
    fields = section_fields(model)
    for key in fields:
        if key not in _BY_ITSELF and chance(author.draw, 15):
            with suppress(UnavailableError):
                drawn[key] = author.value(fields[key], Place())
    if drawn.get("replay", "uniform") != "uniform" and not author.data.get("goal"):
        del drawn["replay"]
    if not model.on_policy and "learning_starts" in fields:
        drawn["learning_starts"] = 200
    if model.imitates and data.get("scripts") and not author.has_copies and chance(author.draw, 20):
        drawn["teacher"] = next(iter(data["scripts"]))
    return drawn


def self_play(author: Author, first: Mapping[str, Any]) -> dict[str, Any]:
    """Draw a training of two equal agents, one of which is `first`."""
    drawn: dict[str, Any] = {"algorithm": "PPO", "total_timesteps": 50000}
    if len(author.data["agents"]) == 2:
        drawn["environments"] = 4
        drawn["self_play"] = author.section(SelfPlay, Place())
    else:
        drawn["turns"] = 1000
    ranges = [name for name, action in first["action"].items() if "choices" not in action]
    learns_alone = any("train" in agent for agent in author.data["agents"].values())
    if ranges and not learns_alone and chance(author.draw, 50):
        drawn["symmetry"] = {"flip": ranges[:1]}
    return drawn


def search(author: Author) -> dict[str, Any]:
    """Draw a search over values."""
    space: dict[str, Any] = {"train.learning_rate": "1e-4 .. 1e-2 :log"}
    for name, kind in author.parameters.items():
        if kind.known is Known.FIXED and kind.dimension == NUMBER:
            space[name] = literal_range(author.draw, NUMBER, 0.5, 2.0)
    drawn: dict[str, Any] = {"search": space, "trials": 2, "seeds": 1, "timesteps": 1000}
    if chance(author.draw, 50):
        drawn["objective"] = "success_rate" if has_success(author.data) else "mean_return"
    if chance(author.draw, 50):
        drawn["prune"] = author.draw(st.booleans())
    return drawn


# Several agents


@contextmanager
def seen_by(author: Author, robot: str) -> Iterator[None]:
    """Let expressions use what one agent may: the values of its robot, and those of all agents."""
    sent, supervised, own = author.sent, author.supervised, f"{robot}."
    author.sent = {name: kind for name, kind in sent.items() if name.startswith(own)}
    author.seen = author.sent
    author.supervised = dict(supervised)
    try:
        yield
    finally:
        author.sent, author.supervised = sent, supervised


def agent(author: Author, robot: str, drawn: dict[str, Any]) -> None:
    """Draw the rest of an agent, which has its actions."""
    with seen_by(author, robot):
        author.define(drawn, "augment", author.signal, 2, prefix=f"{robot}_aug")
        visible = author.sent | {name: author.supervised[name] for name in drawn.get("augment", {})}
        author.define(drawn, "signals", author.signal, 1, prefix=f"{robot}_sig")
        drawn["observation"] = observed(author, visible, 60) or {"previous_action": "auto"}
        if chance(author.draw, 15):
            hidden = {name: kind for name, kind in visible.items() if name not in drawn["observation"]}
            drawn["critic"] = observed(author, hidden, 20)
        reward = section_fields(Scenario)["reward"].value
        drawn["reward"] = {f"{robot}_term": author.value(reward, Place())}
        if chance(author.draw, 40):
            drawn["scripts"] = {"written": script(author, drawn["action"])}
        drawn["frame_stack"] = author.draw(st.integers(1, 2))
        if chance(author.draw, 20):
            drawn["train"] = training(author, drawn)
        if chance(author.draw, 20):
            drawn["solved"] = pick(author.draw, _SOLVED)


def mirrored(data: Any, robot: str, other: str) -> Any:
    """Return a copy of the data of a robot or an agent in which another robot takes its place."""
    if isinstance(data, dict):
        return {mirrored(key, robot, other): mirrored(value, robot, other) for key, value in data.items()}
    if isinstance(data, list):
        return [mirrored(item, robot, other) for item in data]
    return re.sub(rf"\b{robot}\b", other, data) if isinstance(data, str) else deepcopy(data)


def outcomes(author: Author, agents: list[str]) -> dict[str, Any]:
    """Draw endings of several agents, with what they are for each whose episode ends."""
    drawn = {}
    for name, condition in endings(author, ("success", "failure")).items():
        winner = pick(author.draw, agents)
        ending: dict[str, Any] = {"when": condition}
        if chance(author.draw, 30):
            ending |= {"ends": winner, "success": winner}
        else:
            ending |= {"success": winner, "failure": [agent for agent in agents if agent != winner]}
        drawn[name] = ending
    return drawn


def disturbances(author: Author) -> dict[str, Any]:
    drawn = {}
    with suppress(UnavailableError):
        drawn["push0"] = author.section(Disturbance, Place())
    return drawn


def numeric(shape: object) -> bool:
    """Return whether a case may change a value of this shape without changing what the policy sees."""
    return isinstance(shape, Quantity | Number) and not getattr(shape, "whole", False)


def has_success(data: Mapping[str, Any]) -> bool:
    """Return whether an episode may succeed."""
    limits = data["truncation"].values()
    is_limit = any(isinstance(limit, dict) for limit in limits)
    return bool(data.get("termination", {}).get("success")) or "goal" in data or is_limit


def solved(author: Author) -> str:
    if has_success(author.data) and chance(author.draw, 50):
        return "success_rate >= 90 % over 20 episodes"
    return pick(author.draw, _SOLVED)
