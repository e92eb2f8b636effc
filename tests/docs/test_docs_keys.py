"""Every key of the language has an example in the reference, which lints clean and runs in a scenario that
has a place for it."""

from __future__ import annotations

import json
from contextlib import closing
from dataclasses import replace
from functools import cache
from pathlib import Path as FilePath
from typing import NamedTuple

import pytest

from deepbots_cli import api, lint
from deepbots_cli.compiler import CheckedScenario, check
from deepbots_cli.diagnostics import Findings
from deepbots_cli.document import Document, load, loads
from deepbots_cli.document.load import merge
from deepbots_cli.document.nodes import (
    Entry,
    MappingNode,
    Node,
    NodePath,
    descend,
    to_data,
    walk,
    without_paths,
)
from deepbots_cli.document.nodes import with_entry as replaced
from deepbots_cli.scenario import Scenario
from deepbots_cli.scenario.base import Section, section_fields
from deepbots_cli.scenario.documentation import example_of, examples
from deepbots_cli.scenario.training import ALGORITHMS, Training
from deepbots_cli.scenario.walk import shape_at, walk_sections
from tests.few import every

ROOT = FilePath(__file__).parents[2]
FOLDERS = ("tests/data/hosts", "tests/data/scenarios", "tests/channel", "tests/placement", "scenarios")
HOSTS = [path for folder in FOLDERS for path in sorted((ROOT / folder).glob("*.yaml"))]
COSTLY = ("arm", "find_and_avoid", "panda_push", "panda_reach")
"""Hosts with a robot arm or many objects, which take 0.3 s of CPU to lint; the others take 0.02 s."""
LEARNER_HOSTS = {"DQN": "../../../scenarios/cartpole.yaml", "MaskablePPO": "choices.yaml"}
"""The scenario in which the examples of an algorithm are linted; ranges.yaml for the others."""
FOREIGN = frozenset({"python"})  # refused unless foreign code is allowed


class Key(NamedTuple):
    """A key of the language, and the part that declares it."""

    owner: type[Section]
    name: str

    def __str__(self) -> str:
        return f"{self.owner.__name__}.{self.name}"


class Place(NamedTuple):
    """A part of a scenario with the keys that it has."""

    document: Document
    path: NodePath
    part: type[Section]
    keys: frozenset[str]


def declared(part: type[Section], name: str) -> type[Section]:
    return [base for base in part.__mro__ if issubclass(base, Section) and name in base.model_fields][-1]


PARTS = list(
    dict.fromkeys(
        (section, kind) for _, section, kind in walk_sections(Scenario) if isinstance(section, type)
    )
)
KEYS = sorted(
    {
        Key(declared(part, name), name)
        for part, kind in PARTS
        for name in section_fields(part)
        if name != kind
    },
    key=str,
)
KEYS = [key for key in KEYS if not issubclass(key.owner, Training) or key.owner is Training]


@cache
def places() -> tuple[Place, ...]:
    hosts = []
    for host in HOSTS:
        document = load(host)
        assert document.root is not None
        data = to_data(document.root)
        for path, node in walk(document.root):
            if isinstance(node, MappingNode) and isinstance(part := shape_at(Scenario, data, path), type):
                hosts.append(Place(document, path, part, frozenset(node.entries)))
    return tuple(hosts)


def fitting(key: Key) -> list[Place]:
    """The places where an example may be tried, cheap hosts first: those that have the key already, those
    where nothing excludes it, then all others."""
    candidates = [
        place
        for place in places()
        if issubclass(place.part, key.owner) and key.name in section_fields(place.part)
    ]

    def order(place: Place) -> tuple[bool, ...]:
        costly = place.document.path.stem in COSTLY
        return costly, key.name not in place.keys, bool(excluded(place, key)), place.part is not key.owner

    return sorted(candidates, key=order)


def excluded(place: Place, key: Key) -> set[str]:
    """The keys that cannot stand beside this one."""
    groups = [set(keys.names) for keys in place.part.key_rules if keys.max == 1 and key.name in keys.names]
    return set().union(*groups) & place.keys - {key.name}


def with_example(place: Place, key: Key) -> CheckedScenario:
    """The scenario with the example in this place, merged as a file that extends it would."""
    assert place.document.root is not None
    root: Node = without_paths(place.document.root, [(*place.path, other) for other in excluded(place, key)])
    here, _, _ = descend(root, place.path)
    assert isinstance(here, MappingNode)
    example = example_of(place.part, key.name)
    assert example is not None
    entry = example.entry
    old = here.get(key.name)
    value = (
        merge(old, entry.value, key.name)
        if isinstance(old, MappingNode) and isinstance(entry.value, MappingNode)
        else entry.value
    )
    changed = replaced(root, (*place.path, key.name), Entry(entry.key, value))
    assert isinstance(changed, MappingNode)
    return check(replace(place.document, root=changed, findings=Findings(), base=place.document.path.parent))


def findings_of(checked: CheckedScenario) -> list[str]:
    """The findings of lint without DB205, which is reported for every example that only defines something."""
    findings = [
        f"{finding.code} {finding.headline}"
        for finding in [*checked.findings, *lint.static_findings(checked)]
    ]
    return [finding for finding in findings if not finding.startswith("DB205")]


@cache
def known_findings(host: FilePath) -> frozenset[str]:
    """The findings of the scenario itself: warnings about robot files of packages."""
    return frozenset(findings_of(check(load(host))))


@cache
def tried(key: Key) -> tuple[CheckedScenario | None, str]:
    """The first scenario in which the example lints clean; None, with its findings in all scenarios."""
    problems = []
    for place in fitting(key)[:50]:
        checked = with_example(place, key)
        findings = set(findings_of(checked)) - known_findings(place.document.path)
        if not findings:
            return checked, ""
        problems.append(f"{place.document.path.name} {'.'.join(map(str, place.path))}: {sorted(findings)}")
    return None, "\n".join(problems) or "no scenario has a place for it"


@pytest.mark.parametrize("part", dict.fromkeys(part for part, _ in PARTS), ids=lambda part: part.__name__)
def test_every_key_has_an_example(part: type[Section]):
    kinds = {kind for model, kind in PARTS if model is part}
    assert [
        name for name in section_fields(part) if example_of(part, name) is None and name not in kinds
    ] == []


def test_every_example_is_of_a_key():
    fields = {
        base.__name__: set(base.model_fields)
        for part, _ in PARTS
        for base in part.__mro__
        if issubclass(base, Section)
    }
    fields["Training"] |= {
        name for part, _ in PARTS if issubclass(part, Training) for name in section_fields(part)
    }
    assert [
        f"{part}.{key}"
        for part, keys in examples().items()
        for key in keys
        if key not in fields.get(part, set())
    ] == []


@pytest.mark.parametrize(
    "part",
    dict.fromkeys(part for part, _ in PARTS if part.__module__.endswith(("sensors", "actuators", "world"))),
    ids=lambda part: part.__name__,
)
def test_every_part_is_used_in_a_scenario_that_runs(part: type[Section]):
    assert any(place.part is part for place in places())


@pytest.mark.parametrize("key", every(5, [key for key in KEYS if key.name not in FOREIGN]))
def test_an_example_lints_clean_in_its_place(key: Key):
    checked, problems = tried(key)
    assert checked is not None, problems


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_the_examples_of_an_algorithm_lint_clean_together(algorithm: str):
    own = {
        key: example.data
        for key in ALGORITHMS[algorithm].hyperparameter_names()
        if (example := example_of(ALGORITHMS[algorithm], key))
    }
    text = json.dumps({"deepbots": 1, "train": {"algorithm": algorithm, "total_timesteps": 100_000} | own})
    host = LEARNER_HOSTS.get(algorithm, "ranges.yaml")
    scenario = loads(f"{text[:-1]}, extends: {host}}}", base=ROOT / "tests" / "data" / "hosts")
    assert findings_of(check(scenario)) == []


@pytest.mark.slow
@pytest.mark.parametrize("key", KEYS, ids=str)
def test_a_scenario_with_the_example_runs(key: Key):
    checked, _ = tried(key)
    if checked is None:
        pytest.skip("what is wrong with it is said elsewhere")
    with closing(api.build(api.compile(checked).program)) as environment:
        environment.action_space.seed(1)
        environment.reset(seed=1)
        for _ in range(20):
            ended = environment.step(environment.action_space.sample())[2:4]
            if any(ended):
                environment.reset()
