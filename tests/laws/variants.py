"""Laws of variants: a changed condition changes what it names and nothing else, and a test of a case is the
test of the scenario with the settings of the case."""

from __future__ import annotations

import copy
import itertools
import json
import math
import re
from collections import Counter
from collections.abc import Iterator
from contextlib import chdir
from typing import Any

from hypothesis import reject
from hypothesis import strategies as st

from deepbots_cli import api
from deepbots_cli.cli.arguments import open_source
from deepbots_cli.document import MappingNode, Permissions
from deepbots_cli.expressions.parser import parse
from deepbots_cli.expressions.syntax import Number
from deepbots_cli.insight.inspection import in_written_units, scenario_tables
from deepbots_cli.insight.recorded_worlds import command_plans, friction_plans, latency_plans
from deepbots_cli.learning.robustness import (
    DELAY,
    FACTOR,
    MASS,
    Plan,
    base_document,
    changed_program,
    masses,
    plans,
)
from deepbots_cli.learning.scenario_tests import run_tests
from deepbots_cli.lint import all_findings
from deepbots_cli.lint.run import STATIC_RULES
from deepbots_cli.program import Program
from deepbots_cli.program.resets import EpisodeDraws
from deepbots_cli.rollout.source import Source, SourceKind
from tests.laws.expressions import chance, pick
from tests.laws.law import Case, law, reference
from tests.laws.records import printed
from tests.laws.scenarios import Profile
from tests.laws.writing import canonical

# Conditions of a robustness evaluation and of a comparison of worlds

_ROUTES = {"latency to the robot": "to_route", "latency from the robot": "from_route"}
_VARIATIONS = r"\.reset\.variations\["
_MOTORS = r"\.robots\[\d+\]\.(actuators|commands)\[|" + _VARIATIONS
_PLACES = {
    "message loss": r"\.robots\[\d+\]\.(to|from)_route\.",
    "observation noise": r"\.observation\[\d+\]\.noise",
    "motor strength": _MOTORS,
    "friction": r"\.world\.(ground|terrain|objects\[).*friction$|" + _VARIATIONS,
    MASS: r"\.world\.(objects\[\d+\].*\.mass$|robots\[\d+\]\.model\.links\[\d+\]\.inertial\.)|" + _VARIATIONS,
    "latency": r"\.robots\[\d+\]\.sensors\[\d+\]\.faults|" + _VARIATIONS,
    "command": r"\.robots\[\d+\]\.commands\[",
    "delay": _MOTORS,
    "time constant": _MOTORS,
}
"""The places of a program that a condition may change."""


def planned(root: MappingNode, program: Program) -> list[Plan]:
    """Return all conditions that `robustness` and `transfer` would try."""
    return [
        *plans(root, program),
        *masses(root, program, 3),
        *friction_plans(root, program),
        *latency_plans(root, program),
        *command_plans(root, program),
    ]


def differences(actual: Any, expected: Any, place: str = "") -> Iterator[str]:
    """Yield the places in which two values of JSON differ."""
    if isinstance(actual, dict) and isinstance(expected, dict) and actual.keys() == expected.keys():
        for key, value in actual.items():
            yield from differences(value, expected[key], f"{place}.{key}")
    elif isinstance(actual, list) and isinstance(expected, list) and len(actual) == len(expected):
        for number, (one, other) in enumerate(zip(actual, expected, strict=True)):
            yield from differences(one, other, f"{place}[{number}]")
    elif actual != expected:
        yield place


def simple(data: Any) -> Any:
    """Return JSON of a program without the operations `1 * x` and `0 + x`, and with its drawn values in the
    order of their owners."""
    if isinstance(data, list):
        return [simple(item) for item in data]
    if not isinstance(data, dict):
        return data
    data = {key: simple(value) for key, value in data.items()}
    if "variations" in data:
        data["variations"].sort(key=lambda drawn: json.dumps((drawn["what"], drawn["of"])))
    for operation, neutral in (("mul", 1.0), ("add", 0.0)):
        if data.get("is") == "Op" and data.get("op") == operation:
            first, *others = data["args"]
            if first == {"is": "Const", "value": neutral}:
                data = data | {"args": others} if len(others) > 1 else others[0]
    return data


def draws_of(program: Program) -> list[str]:
    return sorted(entry.name for entry in EpisodeDraws(program).noted)


_TIMES = ("20 ms if load > 0.5 else 40 ms", "15 ms when load > 0.5", "uniform(0 .. 20 ms) each step")
_FACTORS = ("0.8 if load > 0.5 else 1.1", "1.2 when load > 0.5", "uniform(0.5 .. 1.5)")
_LINKS: tuple[dict[str, Any], ...] = (
    {"mass": "urdf * 1.2"},
    {"mass": "urdf * uniform(0.5 .. 2)"},
    {"mass": "urdf * (1 + load)"},
    {"density": "900 kg/m^3"},
)
_BALL = {"shape": "sphere", "radius": "4 cm"}
_BODIES: tuple[dict[str, Any], ...] = (
    _BALL,
    {"one_of": {"light": {**_BALL, "mass": "20 g"}, "heavy": _BALL}, "mass": "3 kg"},
    {"one_of": {"still": {**_BALL, "fixed": True, "friction": 0.4}, "free": _BALL}},
)


def with_forms(case: Case) -> dict[str, Any]:
    """Return the scenario with values in all the forms in which they may be written."""
    data = copy.deepcopy(case.drawn.data)
    data.setdefault("parameters", {})["load"] = "uniform(0 .. 1)"
    for direction in ("to_robot", "from_robot"):
        if chance(case.draw, 30):
            data.setdefault("messages", {}).setdefault(direction, {})["latency"] = pick(case.draw, _TIMES)
    for robot in data["robots"].values():
        if chance(case.draw, 40):
            pattern = "*" if chance(case.draw, 80) else "?*"
            robot.setdefault("links", {})[pattern] = dict(pick(case.draw, _LINKS))
        for actuator in robot.get("actuators", {}).values():
            if chance(case.draw, 20):
                actuator["strength"] = pick(case.draw, _FACTORS)
    if chance(case.draw, 40):
        body = {**copy.deepcopy(pick(case.draw, _BODIES)), "pose": {"y": "5 m"}}
        data.setdefault("objects", {})["extra"] = body
    if "terrain" not in data["world"] and chance(case.draw, 30):
        data["world"].setdefault("ground", {})["friction"] = pick(case.draw, _FACTORS)
    return data


@law(cost=450)
def a_condition_changes_what_it_names(case: Case) -> None:
    """A level of a condition is the scenario with another amount of one property: it compiles, it is the
    scenario itself if the amount changes nothing, and all other properties and draws are the same."""
    path = case.write(with_forms(case), "drawn.yaml")
    if any(finding.severity == "error" for finding in api.lint(path, overrides=case.overrides)):
        reject()
    document = base_document(Source.open(path, Permissions(), SourceKind.SCENARIO), case.overrides)
    assert document.root is not None
    nominal = changed_program(document, {})
    conditions = planned(document.root, nominal)
    require_conditions(conditions, nominal)
    family = pick(case.draw, tuple(dict.fromkeys(plan.family for plan in conditions)))
    conditions = [plan for plan in conditions if plan.family == family]
    plan = conditions[case.draw(st.integers(0, len(conditions) - 1))]
    expected = canonical(nominal)
    neutral = {FACTOR: 1.0, DELAY: 0.0}.get(plan.form)
    if neutral is not None:
        unchanged = changed_program(document, plan.change(neutral))
        places = list(differences(simple(canonical(unchanged)), simple(expected)))
        if plan.family == MASS:  # a mass that a pattern draws has another stream where it is written anew
            places = [place for place in places if not place.endswith(".stream")]
        assert not places, (plan.name, plan.change(neutral), places)
    allowed = _PLACES.get(plan.family) or rf"\.robots\[\d+\]\.{_ROUTES[plan.family]}\."
    for amount in amounts_of(plan, nominal):
        label, change = plan.level(amount)
        program = changed_program(document, change)
        places = list(differences(canonical(program), expected))
        strange = [place for place in places if not re.search(allowed, place)]
        assert not strange, (plan.name, label, change, strange)
        if neutral is not None:
            assert draws_of(program) == draws_of(nominal), (plan.name, label, change)
        if plan.family == MASS:
            require_mass(plan.subject, program, nominal, amount)


def require_conditions(conditions: list[Plan], program: Program) -> None:
    """Require noise where an observation has a range, and a mass of each object that can move."""
    names = {plan.name for plan in conditions}
    is_noisy = any(not one.is_truth and 0 < one.high - one.low < 1e9 for one in program.agent.numbers)
    assert ("observation noise" in names) == is_noisy, names
    for body in program.world.objects:
        kinds = [kind.fixed for kind in body.variants] or [body.fixed]
        if body.solid and not all(kinds):
            assert f"mass of {body.name.partition('#')[0]}" in names, (body.name, names)


def amounts_of(plan: Plan, program: Program) -> tuple[float, ...]:
    if plan.form == DELAY:
        return tuple(1000 * program.world.timestep * count for count in (1, 2, 8))
    return tuple(itertools.chain(*plan.sides.values()))


def require_mass(subject: str, program: Program, nominal: Program, factor: float) -> None:
    """Require the masses of a link or an object, fixed or in the middle of their draws, to be those of the
    nominal program times a factor, and all others to be equal."""
    changed, expected = masses_of(program), masses_of(nominal)
    assert changed.keys() == expected.keys()
    for name, mass in expected.items():
        is_meant = name[: len(subject) + 1] in (subject, f"{subject}#", f"{subject}:")
        wanted = mass * factor if is_meant else mass
        assert math.isclose(changed[name], wanted, rel_tol=1e-9), (name, changed[name], mass, factor)


def masses_of(program: Program) -> dict[str, float]:
    masses_kg = {
        f"{body.name}.{link.name}": link.inertial.mass
        for body in program.world.robots
        for link in body.model.links
        if link.inertial is not None
    }
    for body in program.world.objects:
        if body.variants:
            masses_kg |= {f"{body.name}:{kind.name}": kind.mass for kind in body.variants if not kind.fixed}
        else:
            masses_kg[body.name] = body.mass
    return masses_kg


# Tests of a case

_VERSION = re.compile(r"^in (case|stage) `other`, ")


def with_setting(data: dict[str, Any], path: str, value: Any) -> None:
    """Write a setting of a case into the scenario."""
    *steps, last = ("parameters", path) if path in data.get("parameters", {}) else path.split(".")
    section = data
    for step in steps:
        section = section.setdefault(step, {})
    section[last] = copy.deepcopy(value)


def settings(case: Case, data: dict[str, Any]) -> dict[str, Any]:
    """Draw settings of a case: those of the scenario, other limits, and further endings."""
    drawn: dict[str, Any] = dict(data.get("evaluation", {}).get("cases", {}).get("other", {}).get("set", {}))
    if chance(case.draw, 50):
        limit = case.draw(st.integers(2, 60))
        drawn["truncation.max_steps"] = {"limit": limit, "success": "all"} if chance(case.draw, 20) else limit
    if chance(case.draw, 20):
        drawn["truncation.max_time"] = pick(case.draw, ("100 ms", "2 s"))
    if chance(case.draw, 30):
        drawn["reward.extra"] = pick(case.draw, (0, "-1", "1 / (step - 3)", "1 when step > 1000"))
    for word in ("success", "failure"):
        if chance(case.draw, 40):
            condition = pick(case.draw, ("step >= 4", "time > 0.2 s", "step > 100"))
            drawn[f"termination.{word}"] = {f"{word}1": condition}
    return drawn


def test_of(case: Case, data: dict[str, Any]) -> dict[str, Any]:
    """Draw a test; now and then one with a mistake."""
    scripts = list(data.get("scripts", {}))
    drawn: dict[str, Any] = {"driver": pick(case.draw, ("zero", "random", *scripts, *(["nobody"] * 1)))}
    if chance(case.draw, 30):
        drawn["max_steps"] = case.draw(st.integers(1, 50))
    if chance(case.draw, 30):
        drawn["episodes"] = 2
    names = ["success1", "failure1", "success0", "failure0", "max_steps", "max_time"]
    values = ["time < 0.3 s", "step < 20", "step >= 10", "success1", "failure1", "not failure0"]
    expected: dict[str, Any] = {}
    for key in ("always", "eventually"):
        if chance(case.draw, 30):
            expected[key] = pick(case.draw, values)
    if chance(case.draw, 40):
        expected["ends_by"] = case.draw(st.lists(st.sampled_from(names), min_size=1, max_size=3, unique=True))
    for key in ("success_rate", "failure_rate"):
        if chance(case.draw, 30):
            expected[key] = pick(case.draw, ("100 %", "0 .. 50 %", 0))
    drawn["expect"] = expected or {"mean_return": "-1 .. 1"}
    return drawn


def outcome(case: Case, data: dict[str, Any], name: str) -> tuple[Counter[tuple[str, str]], Any]:
    """Return the findings about the test of a scenario, and its result; None with errors."""
    path = case.write(data, name)
    begin = path.read_text(encoding="utf-8").index("\ntests:")
    checked = api.load(path, tests=True)
    findings = all_findings(checked)
    errors = [finding for finding in findings if finding.severity == "error"]
    about = [finding for finding in findings if finding.span.start > begin]
    if any(finding not in about for finding in errors):
        reject()  # a mistake of the case itself
    messages = Counter((finding.code, _VERSION.sub("", finding.headline)) for finding in about)
    program, tests = checked.program, checked.tests
    checked.release_names()
    if errors or program is None:
        return messages, None
    with reference():
        results = [
            (
                result.episodes,
                result.steps,
                [(one.expected, one.measured, one.episode, one.step) for one in result.unmet],
            )
            for result in run_tests(program, tests)
        ]
    return messages, results


@law(cost=300, profile=Profile(agents=1))
def a_test_of_a_case_is_a_test_of_its_settings(case: Case) -> None:
    """A case is the scenario with its settings, so a test of the case has the findings and the result of the
    test of a scenario in which they are written."""
    case.compile()
    base = copy.deepcopy(case.drawn.data)
    drawn = settings(case, base)
    for section in ("evaluation", "curriculum", "tests", "tune", "solved", "train"):
        base.pop(section, None)
    test = test_of(case, base)
    if chance(case.draw, 50):
        variant = {
            "evaluation": {"cases": {"other": {"set": drawn}}},
            "tests": {"one": test | {"case": "other"}},
        }
    else:
        stages = [{"name": "other", "set": drawn, "until": "50_000 steps"}, {"name": "whole"}]
        variant = {"curriculum": stages, "tests": {"one": test | {"stage": "other"}}}
    cased = base | variant
    plain = copy.deepcopy(base)
    for path, value in drawn.items():
        with_setting(plain, path, value)
    plain["tests"] = {"one": test}
    actual, expected = outcome(case, cased, "cased.yaml"), outcome(case, plain, "plain.yaml")
    assert actual[0] == expected[0], (actual[0] - expected[0], expected[0] - actual[0])
    assert actual[1] == expected[1]


OF_EACH_VERSION = {rule.code for rule in STATIC_RULES if rule.versions == "each"}


@law(cost=200, profile=Profile(agents=1))
def a_case_is_shown_with_its_settings(case: Case) -> None:
    """`inspect --case` shows the scenario in which the settings of the case are written, and `lint` finds what
    is wrong in it."""
    plain = copy.deepcopy(case.drawn.data)
    drawn = settings(case, plain)
    for section in ("evaluation", "curriculum", "tests", "tune", "solved", "train"):
        plain.pop(section, None)
    cased = plain | {"evaluation": {"episodes": 5, "cases": {"other": {"set": drawn, "episodes": 7}}}}
    plain = copy.deepcopy(plain)
    for path, value in drawn.items():
        with_setting(plain, path, value)
    case.write(cased, "cased.yaml")
    case.write(plain, "plain.yaml")
    with chdir(case.folder):
        said, wanted = api.lint("cased.yaml"), api.lint("plain.yaml")
        if any(finding.severity == "error" for finding in (*said, *wanted)):
            reject()
        assert [one.episodes for one in api.compile("cased.yaml").program.cases] == [7]
        # What the scenario itself has is not said of its cases again.
        of_all = {finding.code for finding in said if not _VERSION.match(finding.headline)}
        stated = {(finding.code, _VERSION.sub("", finding.headline)) for finding in said}
        missing = {(finding.code, finding.headline) for finding in wanted} - stated
        assert not [one for one in missing if one[0] in OF_EACH_VERSION - of_all], missing
        shown, expected = (
            printed("inspect", "cased.yaml", "--case", "other"),
            printed("inspect", "plain.yaml"),
        )
    for tables in (shown, expected):
        tables["scenario"].pop("digest")
        for key in ("cases", "training", "hyperparameters"):  # the learner is chosen for the scenario
            tables.pop(key, None)
    assert shown == expected, list(differences(shown, expected))


@law(cost=120, profile=Profile(agents=1))
def the_tables_have_the_ranges_of_the_program(case: Case) -> None:
    """`inspect` shows each range in a unit of its quantity, or in that of the file: in SI units, it is the
    range that the program maps."""
    case.compile()
    opened = open_source(str(case.path), (), Permissions())
    program, root = opened.program, opened.root
    assert root is not None
    tables = scenario_tables(program, root, None, opened.learner)
    if chance(case.draw, 50):
        tables = in_written_units(tables, program, root)
    numbers = {number.full_name: (number.low, number.high) for number in program.agent.numbers}
    stated = [(row, numbers.get(row["name"])) for row in tables.get("observation", [])]
    parts = {part.name: (part.low, part.high) for part in program.agent.action if hasattr(part, "low")}
    stated += [(row, parts.get(row["action"])) for row in tables["action"] if row["kind"] == "range"]
    for row, ends in stated:
        if ends is None or row.get("low") is None:
            continue
        unit = parse(f"1 {row['unit']}", lambda *_args, **_options: None)
        scale = 1.0 if not isinstance(unit, Number) or unit.unit is None else unit.unit.to_si(1.0)
        for end, value in zip(ends, (row["low"], row["high"]), strict=True):
            assert math.isclose(value * scale, end, rel_tol=1e-6, abs_tol=1e-9), (row, ends)
