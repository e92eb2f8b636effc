"""The pages of the gallery: one for each shipped scenario that extends no other, with its variants as
sections.

A page begins with the text of docs/scenarios, if there is one. Spaces, rewards and endings are read from the
compiled scenarios. Results are the cards of tools.results. Nothing is simulated or trained here. Paths are
relative to the root of the repository.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cache
from itertools import groupby
from pathlib import Path
from typing import Any, NamedTuple

from deepbots_cli.cli.arguments import open_source
from deepbots_cli.document import Permissions
from deepbots_cli.insight.inspection import Tables, scenario_tables
from deepbots_cli.program import Program
from tools.results.card import card
from tools.results.experiment import experiments
from tools.results.measure import Places, read
from tools.results.standing import Headline, Standing

ROOT = Path(__file__).resolve().parents[1]
NOTES = "docs/scenarios"
INDEX = "docs/worlds.md"
CLIPS = "docs/images/policies"
_CARDS = re.compile(r"<!-- cards -->.*<!-- end of cards -->", re.DOTALL)
_EXTENDS = re.compile(r"^extends: (\w+)", re.MULTILINE)
_DIGITS = 4
_DIFFICULTIES = {60: "CPU 0 to 1 min", 300: "CPU 1 to 5 min", math.inf: "CPU over 5 min"}


class Clip(NamedTuple):
    """Of which training a moving picture shows a held-out episode: its seed, and other options of `train` and
    `render`."""

    seed: int
    train: str = ""
    render: str = ""


POLICIES = {
    "balancer": Clip(1, "--engine mujoco", "--seconds 4 --size 300x200"),
    "biped": Clip(121, render="--case forward --episode 2 --seconds 2.4 --size 300x200"),
    "carry": Clip(101, render="--episode 1 --from 0,-1.9,1.7 --at -0.05,0,0 --size 400x267"),
    "cartpole": Clip(0, render="--seconds 5"),
    "find_and_avoid": Clip(1, render="--speed 3"),
    "find_ball": Clip(301, "--engine mujoco", "--speed 3"),
    "find_ball_random": Clip(1, "--engine mujoco", "--case many --episode 1 --speed 3"),
    "line_follower": Clip(301, "--engine mujoco", "--speed 3"),
    "panda_push": Clip(4101, "--engine mujoco", "--engine pybullet"),
    "panda_reach": Clip(1, "--engine mujoco"),
    "pit_escape": Clip(1, "--engine mujoco"),
    "quadrotor": Clip(1, render="--seconds 6 --from 0.9,-0.9,1.4 --at 0,0,1 --size 400x267"),
    "quadruped": Clip(111, render="--case half_speed --seconds 2 --size 300x200"),
    "quadruped_rough": Clip(
        134, render="--case up --episode 1 --follow dog --seconds 6 --speed 2 --size 300x200"
    ),
    "see_ball": Clip(1, render="--speed 3"),
    "sumo": Clip(1, render="--seconds 6 --from 0,-1.1,1 --at 0,0,0 --size 400x267"),
    "tag": Clip(101, render="--episode 1 --speed 3"),
    "tag_scripted": Clip(1, "--engine mujoco", "--speed 3"),
}
"""The moving picture of each page, in the folder `CLIPS`."""


class World(NamedTuple):
    """A shipped scenario: its name, what it compiles to, and the tables of `deepbots inspect`."""

    name: str
    program: Program
    tables: Tables

    def row(self, table: str) -> Mapping[str, Any]:
        found = self.tables.get(table, {})
        assert isinstance(found, Mapping)
        return found

    def rows(self, table: str) -> Sequence[Mapping[str, Any]]:
        found = self.tables.get(table, [])
        assert isinstance(found, list)
        return found

    @property
    def title(self) -> str:
        return str(self.row("scenario")["name"])

    @property
    def summary(self) -> str:
        return str(self.row("scenario")["summary"])

    @property
    def algorithm(self) -> str:
        return str(self.row("training").get("algorithm", "none"))

    @property
    def models(self) -> list[str]:
        """The robots as their files call them."""
        return list(dict.fromkeys(str(row["model"]) for row in self.rows("robots")))

    @property
    def sensors(self) -> list[str]:
        return list(dict.fromkeys(str(row["type"]).replace("_", " ") for row in self.rows("sensors")))


@cache
def families() -> dict[str, tuple[str, ...]]:
    """The scenarios that extend no other one, and the variants of each."""
    parents = {}
    for path in sorted((ROOT / "scenarios").glob("*.yaml")):
        found = _EXTENDS.search(path.read_text(encoding="utf-8"))
        parents[path.stem] = found[1] if found else None
    return {
        name: tuple(other for other, above in parents.items() if above == name)
        for name, parent in parents.items()
        if parent is None
    }


@cache
def world(name: str) -> World:
    opened = open_source(name, (), Permissions())
    assert opened.root is not None
    return World(name, opened.program, scenario_tables(opened.program, opened.root, None, opened.learner))


def merged() -> dict[str, str]:
    """Return the pages about variants, which are sections of the page of their scenario."""
    return {
        f"{NOTES}/{variant}.md": f"{NOTES}/{base}.md"
        for base, variants in families().items()
        for variant in variants
    }


def listed() -> list[tuple[str, str, str]]:
    """Path, title and summary of each page."""
    return [(f"{NOTES}/{name}.md", world(name).title, world(name).summary) for name in families()]


def pages() -> dict[str, str]:
    """The text of each page of the gallery by its path, and that of the index with a card for each page."""
    index = (ROOT / INDEX).read_text(encoding="utf-8")
    assert _CARDS.search(index), f"{INDEX}: no place for the cards"
    found = {INDEX: _CARDS.sub(lambda _: "\n".join(_cards()), index)}
    return found | {
        f"{NOTES}/{base}.md": "\n".join(_page(base, variants)) for base, variants in families().items()
    }


def clip_of(name: str) -> str:
    """The moving picture of a trained policy, and how it was made."""
    clip, file = POLICIES[name], f"{name}.gif"
    train = " ".join(filter(None, [f"deepbots train {name} --seed {clip.seed}", clip.train]))
    render = " ".join(filter(None, ["deepbots render RUN", clip.render, f"-o {file}"]))
    caption = f"*`{train}` trained this policy. The picture shows a held-out episode: `{render}`.*"
    return f"![{world(name).summary}](../images/policies/{file})\n\n{caption}"


# Index


def _cards() -> Iterator[str]:
    """A card for each page, with a line of robots, sensors, algorithms and difficulties, which
    theme/static/gallery.js filters by."""
    yield "````{container} cards"
    for base, variants in families().items():
        here = world(base)
        family = [here, *map(world, variants)]
        robots = dict.fromkeys(model for one in family for model in one.models)
        sensors = dict.fromkeys(sensor for one in family for sensor in one.sensors)
        algorithms = dict.fromkeys(one.algorithm for one in family)
        difficulties = dict.fromkeys(filter(None, (difficulty(one.name) for one in family)))
        yield from ("```{container} card", "")
        yield from (f"[![{here.title}](images/policies/{base}.gif)](scenarios/{base}.md)", "")
        yield from (f"[**{here.title}**](scenarios/{base}.md) {here.summary}", "")
        yield f"*{' · '.join(', '.join(names) or 'none' for names in (robots, sensors, algorithms, difficulties))}*"
        if variants:
            yield from ("", f"Variants: {', '.join(f'`{variant}`' for variant in variants)}")
        yield from ("```", "")
    yield "````"


# Pages


def _page(base: str, variants: tuple[str, ...]) -> Iterator[str]:
    here = world(base)
    lead, heading, notes = "\n".join(_notes(base)).partition("\n## ")
    yield from (lead.rstrip(), "", "## Spaces and rewards", "", *_facts(here), *_spaces(here), *_task(here))
    yield from _results(base)
    yield f"{heading}{notes}"
    yield from ("", "## The file", "", *_file(base))
    for variant in variants:
        other = world(variant)
        yield from (
            "",
            f"## {other.title}",
            "",
            *_variant_notes(variant),
            "",
            *_differences(here, other),
            "",
            *_file(variant),
        )
        yield from _results(variant, level="###")


def _notes(name: str) -> Iterator[str]:
    """The written part of a page, whose picture gives way to the moving one."""
    path = ROOT / NOTES / f"{name}.md"
    if path.is_file():
        title, _, text = path.read_text(encoding="utf-8").rstrip().partition("\n\n")
        first, _, rest = text.partition("\n\n")
        yield from (title, "", clip_of(name), "", rest if first.startswith("![") else text)
    else:
        yield from (f"# {world(name).title}", "", clip_of(name), "", world(name).summary)


def _variant_notes(name: str) -> Iterator[str]:
    """The written part of a variant, one level deeper and without its title."""
    path = ROOT / NOTES / f"{name}.md"
    yield world(name).summary
    if path.is_file():
        _, _, text = path.read_text(encoding="utf-8").rstrip().partition("\n\n")
        yield from ("", re.sub(r"^## ", "### ", text, flags=re.MULTILINE))


def _facts(here: World) -> Iterator[str]:
    scenario = here.row("scenario")
    repeat = here.program.action_repeat
    often = f"; an action is held for {repeat} timesteps" if repeat > 1 else ""
    engine = f", engine `{here.program.engine}`" if here.program.engine else ""
    chosen = [
        f"{row['hyperparameter']} {_value(row['value'])}"
        for row in here.rows("hyperparameters")
        if row["from"] == "scenario"
    ]
    limits = [
        f"{scenario['max_steps']:,} steps" if scenario["max_steps"] else "",
        f"{scenario['max_time_s']:g} s" if scenario["max_time_s"] else "",
    ]
    rows = [
        (
            "robots",
            ", ".join(
                f"{row['robot']} ({row['model']}, {_number(row['mass_kg'])} kg)"
                for row in _distinct_robots(here)
            ),
        ),
        ("sensors", ", ".join(here.sensors) or "none"),
        (
            "timestep",
            f"{_number(1000 * scenario['timestep_s'])} ms, {scenario['substeps']} physics"
            f" steps{engine}{often}",
        ),
        ("time limit", " or ".join(filter(None, limits)) or "none"),
        ("action space", f"`{scenario['action_space']}`"),
        ("observation space", f"`{scenario['observation_space']}`"),
        ("solved", scenario["solved"] or "no criterion"),
        (
            "algorithm",
            f"{here.algorithm}, {here.row('training').get('total_timesteps', 0):,} steps;"
            f" {', '.join(chosen)}",
        ),
        ("watch, train", f"`deepbots view {here.name}`, `deepbots train {here.name}`"),
    ]
    yield from _table(("", ""), rows)


def _distinct_robots(here: World) -> list[Mapping[str, Any]]:
    """One of each set of copies, which are named `cart#0`, `cart#1`."""
    named = [{**row, "robot": str(row["robot"]).partition("#")[0]} for row in here.rows("robots")]
    return list({row["robot"]: row for row in named}.values())


def _spaces(here: World) -> Iterator[str]:
    actions = [
        (f"`{row['action']}`", row["kind"], _options(row), f"`{row.get('unit', '1')}`")
        for row in here.rows("action")
    ]
    yield from ("", *_table(("action", "kind", "values", "unit"), actions))
    rows = []
    for row in _grouped(here.rows("observation")):
        index = "image" if row["index"] is None else str(row["index"])
        span = "" if row.get("low") is None else f"{_number(row['low'])} .. {_number(row['high'])}"
        age = f", {row['steps_ago']} step{'s' * (row['steps_ago'] > 1)} ago" if row.get("steps_ago") else ""
        rows.append(
            (index, f"`{row['name']}`{age}", span, f"`{row.get('unit', '1')}`", str(row.get("seen_as", "")))
        )
    if rows:
        yield from ("", *_table(("index", "observation", "range", "unit", "seen as"), rows))
    if "goal" in here.tables:
        yield from (
            "",
            *_table(("goal", "value"), [(key, f"`{text}`") for key, text in here.row("goal").items()]),
        )


def _options(row: Mapping[str, Any]) -> str:
    if row["kind"] == "range":
        parts = f" each of {', '.join(row['of'])}" if row["of"] else ""
        return f"{_number(row['low'])} .. {_number(row['high'])}{parts}"
    return _cell(str(row["options"]).replace(" | ", ", "))


def _grouped(rows: Sequence[Mapping[str, Any]]) -> Iterator[Mapping[str, Any]]:
    """Consecutive entries of one vector or history with the same range as one row."""

    def vector(row: Mapping[str, Any]) -> tuple[object, ...]:
        name = re.sub(r"\d+|\.[xyzw]\b", "", str(row["name"]))
        if name.count(".") > 1 or name.startswith(
            "previous_action."
        ):  # a component of a reading, or of an action
            name = name.rpartition(".")[0]
        return (name, *(row.get(key) for key in ("steps_ago", "low", "high", "unit", "seen_as")))

    for _, group in groupby(rows, vector):
        first, *others = group
        last = others[-1] if others else first
        yield (
            first
            if not others
            else {**first, **{key: f"{first[key]} .. {last[key]}" for key in ("index", "name")}}
        )


def _value(value: object) -> str:
    """A hyperparameter as the language writes it."""
    if isinstance(value, list):
        return " ".join(map(str, value))
    return f"`{value}`" if isinstance(value, str) else f"{value:,}" if isinstance(value, int) else str(value)


def _outcome(row: Mapping[str, object]) -> str:
    """Return what an ending is: for the agent, or for each of several agents."""
    if "outcome" in row:
        return str(row["outcome"])
    return ", ".join(
        f"{outcome} of {name}" for name, outcome in row.items() if name not in ("ending", "when")
    )


def _task(here: World) -> Iterator[str]:
    rows = [(f"`{row['term']}`", f"`{_cell(str(row['is']))}`") for row in here.rows("reward")]
    yield from ("", *_table(("reward term", "value per step"), rows))
    rows = [
        (f"`{row['ending']}`", _outcome(row), f"`{_cell(str(row['when']))}`") for row in here.rows("endings")
    ]
    yield from ("", *_table(("ending", "outcome", "condition"), rows)) if rows else ()


_COMPARED = {
    "timestep": lambda one: f"{_number(1000 * one.row('scenario')['timestep_s'])} ms",
    "action space": lambda one: one.row("scenario")["action_space"],
    "observation space": lambda one: one.row("scenario")["observation_space"],
    "reward terms": lambda one: ", ".join(str(row["term"]) for row in one.rows("reward")),
    "endings": lambda one: ", ".join(str(row["ending"]) for row in one.rows("endings")),
    "messages": lambda one: one.row("scenario")["messages"],
    "solved": lambda one: one.row("scenario")["solved"] or "no criterion",
    "algorithm": lambda one: one.algorithm,
}


def _differences(base: World, other: World) -> Iterator[str]:
    values = [(name, str(value(base)), str(value(other))) for name, value in _COMPARED.items()]
    rows = [row for row in values if row[1] != row[2]]
    if rows:
        yield from _table(("", base.title, other.title), rows)


def _file(name: str) -> Iterator[str]:
    text = (ROOT / "scenarios" / f"{name}.yaml").read_text(encoding="utf-8").rstrip()
    yield from (
        f"`deepbots new mine --from {name}` writes a copy of [{name}.yaml](../../scenarios/{name}.yaml).",
        "",
        f"```yaml\n{text}\n```",
    )


# Results


def _results(name: str, *, level: str = "##") -> Iterator[str]:
    """The card of its results, below a heading of the level; nothing for a scenario that has no experiment."""
    if name not in experiments():
        return
    text = card(Standing.of(experiments()[name], read(Places().record(name))))
    yield from ("", text[text.index("# Results") :].rstrip().replace("#", level, 1), "")


def difficulty(name: str) -> str | None:
    """By the CPU time of a training, the median of the seeds; None where nothing is measured."""
    if name not in experiments():
        return None
    found = Headline.of(Standing.of(experiments()[name], read(Places().record(name))))
    return found and next(words for limit, words in _DIFFICULTIES.items() if found.cpu_seconds < limit)


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> Iterator[str]:
    yield f"| {' | '.join(head)} |"
    yield "|" + "---|" * len(head)
    for row in rows:
        yield f"| {' | '.join(row)} |"


def _number(value: float) -> str:
    return f"{value:.{_DIGITS}g}" if abs(value) < 1e5 else f"{value:,.0f}"


def _cell(text: str) -> str:
    return text.replace("|", "\\|").replace("\n", " ")
