"""The tutorials, done word by word in an empty folder: files are written, edits are made, and commands print
what the page shows.

Every key of the language has an example in the reference, which lints clean and runs in a scenario that
has a place for it.

Every function of the language has an example in the reference that runs as it is printed.

What README and docs say is true: scenarios lint, Python runs, commands parse, links lead somewhere, tables
and maps are current.
"""

from __future__ import annotations

import ast
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from functools import cache
from importlib import import_module, util
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
import pytest

from deepbots_cli import api, lint
from deepbots_cli.cli import main
from deepbots_cli.cli.commands import COMMANDS, function_name
from deepbots_cli.codegen import batch_obstacles
from deepbots_cli.compiler import CheckedScenario, check
from deepbots_cli.diagnostics import Finding, Findings
from deepbots_cli.diagnostics.findings import suppress
from deepbots_cli.document import Document, load, loads
from deepbots_cli.document.layout import quoted
from deepbots_cli.document.load import LEVELS_OF_NAMES, merge
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
from deepbots_cli.expressions.dimensions import NUMBER
from deepbots_cli.expressions.functions import FUNCTIONS, Family
from deepbots_cli.expressions.types import Symbol
from deepbots_cli.learning.runs.run import RunRecord
from deepbots_cli.lint import static_findings as run_rules
from deepbots_cli.scenario import Scenario
from deepbots_cli.scenario.base import Section, section_fields, shape_at, walk_sections
from deepbots_cli.scenario.documentation import example_of, examples
from deepbots_cli.scenario.training import ALGORITHMS, Training
from tests.commands import refusal
from tests.few import every
from tests.worlds import SCENARIOS

DOCS = Path(__file__).parents[2] / "docs"
TUTORIALS = ("start", "what-is-rl", "first", "rewards-that-cheat", "own-robot")
BLOCK = re.compile(r"^```(\w+)[ ]?([^\n]*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
QUICK = {"new", "lint", "inspect", "explain"}
"""Commands that run no simulation; what they print is the same on every machine."""
SERVED = {"view", "play"}
"""Commands that serve a page until Ctrl-C."""


@pytest.mark.parametrize("page", TUTORIALS)
def test_the_files_of_a_tutorial_are_what_its_page_says(
    page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    follow(page, tmp_path, monkeypatch, capsys, whole=False)


@pytest.mark.slow
@pytest.mark.parametrize("page", TUTORIALS)
def test_a_tutorial_done_word_by_word(
    page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    follow(page, tmp_path, monkeypatch, capsys, whole=True)


def follow(
    page: str,
    folder: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    *,
    whole: bool,
) -> None:
    """Follow the page; without `whole`, leave out simulations and their output."""
    monkeypatch.chdir(folder)
    printed = ""
    exact = True
    complete = False
    for language, mark, text in BLOCK.findall((DOCS / f"{page}.md").read_text(encoding="utf-8")):
        kind, _, file = mark.rpartition(" ")
        if language == "console":
            lines = [
                shlex.split(line.removeprefix("$ "))
                for line in text.splitlines()
                if line.startswith("$ deepbots ")
            ]
            wanted = [line for line in lines if whole or is_quick(line)]
            complete = len(wanted) == len(lines)
            exact = all(is_quick(line) for line in lines)
            for _, *words in wanted:
                if words[0] in SERVED:
                    continue
                assert main(words) == (1 if mark == "fails" else 0), words
            captured = capsys.readouterr()
            printed = captured.out + captured.err
        elif language == "text" and mark == "output" and complete:
            assert [line for line in text.splitlines() if not is_shown(line, printed, exact=exact)] == []
        elif language == "yaml" and kind == "part":
            with Path(file).open("a", encoding="utf-8") as target:
                target.write(text)
        elif language == "xml" and file:
            Path(file).write_text(text, encoding="utf-8")
        elif language == "diff":
            edit(Path(file), text)


def is_quick(line: list[str]) -> bool:
    return line[1] in QUICK and not any(
        word.startswith("runs/") or word in ("--deep", "--exploits") for word in line
    )


def edit(file: Path, text: str) -> None:
    """Replace the lines with a minus by those with a plus."""
    old = "".join(f"{line[1:]}\n" for line in text.splitlines() if line[0] in " -")
    new = "".join(f"{line[1:]}\n" for line in text.splitlines() if line[0] in " +")
    before = file.read_text(encoding="utf-8")
    assert before.count(old) == 1, old
    file.write_text(before.replace(old, new), encoding="utf-8")


def is_shown(line: str, printed: str, *, exact: bool) -> bool:
    """Whether a line was printed; `...` matches the rest of a line, or any lines."""
    start, rest, _ = line.partition("...")
    lines = [plain(printed_line, exact=exact) for printed_line in printed.splitlines()]
    return any(
        printed_line.startswith(plain(start, exact=exact))
        if rest
        else printed_line == plain(line, exact=exact)
        for printed_line in ["", *lines]
    )


def plain(line: str, *, exact: bool) -> str:
    """The words of a line; unless it must be exact, without numbers, which depend on the machine."""
    return " ".join((line if exact else re.sub(r"[-+]?\d[\d,.:]*%?", "0", line)).split())


# The diffs of docs/change-it.md apply, each alone and all together, and give what the page shows


ROOT = Path(__file__).parents[2]
SECTIONS = dict(
    re.findall(
        r"^## (.*?)\n(.*?)(?=^## |\Z)", (ROOT / "docs/change-it.md").read_text(encoding="utf-8"), re.M | re.S
    )
)

TRAINING = ["An algorithm", "An engine"]
"""The sections whose commands take more than 1 s of CPU."""


def block(section: str, language: str) -> str:
    """The fenced block of a section, empty without one."""
    match = re.search(rf"^```{language}\n(.*?)^```$", SECTIONS[section], re.M | re.S)
    return match[1] if match else ""


def apply(section: str, folder: Path) -> None:
    diff = block(section, "diff")
    subprocess.run(["git", "apply", "-"], input=diff, cwd=folder, text=True, check=True)


@pytest.fixture(scope="module")
def changed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the package with all diffs."""
    folder = tmp_path_factory.mktemp("changed")
    for name in ("deepbots_cli", "scenarios", "robots"):
        shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("*.pyc.*"))
    for section in SECTIONS:
        apply(section, folder)
    return folder


def test_the_files_that_the_page_names_exist() -> None:
    text = re.sub(r"^```.*?^```$", "", "\n".join(SECTIONS.values()), flags=re.M | re.S)
    names = re.findall(r"`((?:\w+/)+\w+\.(?:py|yaml))", text)
    assert "learning/sb3/networks.py" in names
    assert [
        name
        for name in names
        if not any((ROOT / part / name).is_file() for part in ("", "deepbots_cli", "deepbots_webots"))
    ] == []


@pytest.mark.parametrize("section", SECTIONS)
def test_a_diff_changes_three_files_at_most(section: str) -> None:
    files = re.findall(r"^\+\+\+ b/(.*)$", block(section, "diff"), re.M)
    assert files
    assert len(files) <= (3 if section in ("A rule of lint", "A command") else 2)  # these have texts too


RUN_COMMANDS = """
import contextlib, io, json, shlex, sys
from deepbots_cli.cli import main
for line in sys.argv[1:]:
    with io.StringIO() as out, contextlib.redirect_stdout(out), contextlib.redirect_stderr(out):
        main(shlex.split(line)[1:])
        printed = out.getvalue()
    print(json.dumps([line, printed]), flush=True)
"""


def commands(section: str) -> list[list[str]]:
    """The commands of a section, each with the lines that the page shows below it."""
    return [part.rstrip().splitlines() for part in block(section, "text run").split("$ ")[1:]]


@pytest.fixture(scope="module")
def written(changed: Path) -> Path:
    """The copy with the diffs and the scenarios of the page."""
    for name, text in re.findall(
        r"^```text (\S+\.yaml)\n(.*?)^```$", "".join(SECTIONS.values()), re.M | re.S
    ):
        (changed / name).write_text(text)
    return changed


def printed(folder: Path, lines: list[str]) -> dict[str, str]:
    """What each command prints. One process runs them all, whose start takes 1 s of CPU."""
    ran = subprocess.run(
        [sys.executable, "-c", RUN_COMMANDS, *lines],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(folder)},
        stdout=subprocess.PIPE,
        text=True,
    )
    return dict(map(json.loads, ran.stdout.splitlines()))


@pytest.mark.parametrize(
    "sections",
    [
        pytest.param([name for name in SECTIONS if name not in TRAINING], id="most"),
        pytest.param(TRAINING, id="those that train", marks=pytest.mark.slow),
    ],
)
def test_the_commands_below_a_diff_print_what_the_page_shows(sections: list[str], written: Path) -> None:
    pytest.importorskip("stable_baselines3")
    examples = [lines for section in sections for lines in commands(section)]
    outputs = printed(written, [command for command, *_ in examples])
    for command, *lines in examples:
        for line in lines:
            assert line in outputs[command].splitlines(), (command, outputs[command])


# The programs of docs/python.md run; whole, they reach what the page says


FOLDER = Path(__file__).parents[2] / "docs" / "examples"


def main_of(name: str) -> Any:
    spec = util.spec_from_file_location(f"docs_example_{name}", FOLDER / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.main


def test_the_agent_in_numpy_runs() -> None:
    assert main_of("numpy_agent")(generations=1, candidates=3, elite=2) > 0.0


def test_ppo_in_one_file_runs() -> None:
    assert len(main_of("ppo")(total_timesteps=256, copies=2, steps=64)) > 2


def test_stable_baselines3_by_hand_runs(tmp_path: Path) -> None:
    assert main_of("sb3_by_hand")(total_timesteps=256, folder=str(tmp_path)) > 0.0


def test_the_loop_in_the_vector_api_runs() -> None:
    assert main_of("vector_loop")(steps=40, copies=2) != {}


def test_the_scenario_of_the_stair_has_no_findings_and_runs_as_a_batch() -> None:
    pytest.importorskip("pybullet_data")
    path = FOLDER / "climb.yaml"
    assert (api.lint(path), batch_obstacles(api.compile(path).program)) == ([], [])


def test_the_package_for_sbx_is_loaded_without_jax_and_stores_weights_as_tensors(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.syspath_prepend(str(FOLDER / "sbx"))
    package = import_module("deepbots_sbx")
    assert [(model.base(), model.import_path) for model in (package.JaxPPO, package.JaxSAC)] == [
        ("PPO", "deepbots_sbx.algorithms:JaxPPO"),
        ("SAC", "deepbots_sbx.algorithms:JaxSAC"),
    ]
    pytest.importorskip("sbx")
    algorithms = import_module("deepbots_sbx.algorithms")
    space = gym.spaces.Box(-1, 1, (4,), np.float32)
    trained, restored = (
        algorithms.JaxPPO("MlpPolicy", _Still(space), n_steps=8, batch_size=8, seed=seed) for seed in (0, 1)
    )
    trained.learn(16)
    for part in trained._get_torch_save_params()[0]:
        getattr(restored, part).load_state_dict(getattr(trained, part).state_dict())
    observations = np.linspace(-1, 1, 40, dtype=np.float32).reshape(10, 4)
    assert all(
        np.array_equal(
            trained.predict(observations, deterministic=d)[0],
            restored.predict(observations, deterministic=d)[0],
        )
        for d in (True, False)
    )


class _Calls:
    """Stands in for the two libraries, which the tests do not install: keeps the calls by name, and has their
    names of results."""

    def __init__(self) -> None:
        self.info = SimpleNamespace(run_id="7")
        self.experiment_id = "1"
        self.calls: dict[str, list[tuple[Any, ...]]] = {}

    def __getattr__(self, name: str) -> Any:
        def call(*arguments: Any, **options: Any) -> _Calls:
            self.calls.setdefault(name, []).append((*arguments, options))
            return self

        return call


@pytest.mark.parametrize(
    ("library", "logged"),
    [
        ("wandb", {"log": [({"reward/alive": 2.0, "time/fps": 3.0}, {"step": 5})], "finish": [({},)]}),
        (
            "mlflow",
            {
                "log_metric": [("7", "reward/alive", 2.0, {"step": 5}), ("7", "time/fps", 3.0, {"step": 5})],
                "set_terminated": [("7", {})],
            },
        ),
    ],
)
def test_a_tracker_gets_every_scalar_and_the_facts_of_the_run(
    library: str, logged: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sb3 = pytest.importorskip("stable_baselines3.common.logger")
    monkeypatch.syspath_prepend(str(FOLDER / "trackers"))
    recorder = _Calls()
    monkeypatch.setitem(sys.modules, library, recorder)
    entries = tomllib.loads((FOLDER / "trackers" / "pyproject.toml").read_text())["project"]["entry-points"]
    module, _, name = entries["deepbots.loggers"][library].partition(":")
    facts = {"scenario": "CartPole", "seed": 3, "engine": "mujoco", "digest": "0" * 64, "total_timesteps": 9}
    assert facts.keys() <= RunRecord.model_fields.keys()
    record = {**facts, "started": "2026-11-30T03:18:18+00:00"}
    (tmp_path / "run.json").write_text(json.dumps(record), encoding="utf-8")
    logger = sb3.Logger(None, [getattr(import_module(module), name)(tmp_path)])
    logger.record("reward/alive", np.float32(2.0))
    logger.record("time/fps", 3)
    logger.record("stage", "first")
    logger.dump(5)
    logger.close()
    assert {key: calls for key, calls in recorder.calls.items() if key in logged} == logged
    assert all(repr(value) in repr(recorder.calls) for value in facts.values())


class _Still(gym.Env[Any, Any]):
    """Gives the same observation."""

    def __init__(self, space: gym.spaces.Box) -> None:
        self.observation_space = space
        self.action_space = gym.spaces.Discrete(2)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        return np.zeros(4, np.float32), {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        return np.zeros(4, np.float32), 1.0, False, False, {}


def test_the_page_names_every_program() -> None:
    page = (FOLDER.parent / "python.md").read_text(encoding="utf-8")
    assert all(f"(examples/{path.name})" in page for path in FOLDER.glob("*.py"))


@pytest.mark.slow
def test_whole_they_learn(tmp_path: Path) -> None:
    assert main_of("numpy_agent")() > 150.0
    assert np.mean(main_of("ppo")()[-50:]) > 150.0
    assert main_of("sb3_by_hand")(folder=str(tmp_path)) > 150.0


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
        merge(old, entry.value, LEVELS_OF_NAMES.get(key.name, 0))
        if isinstance(old, MappingNode) and isinstance(entry.value, MappingNode)
        else entry.value
    )
    changed = replaced(root, (*place.path, key.name), Entry(entry.key, value))
    assert isinstance(changed, MappingNode)
    return check(replace(place.document, root=changed, findings=Findings(), base=place.document.path.parent))


def headlines_of(checked: CheckedScenario) -> list[str]:
    """The findings of lint without DB205, which is reported for every example that only defines something."""
    findings = [
        f"{finding.code} {finding.headline}"
        for finding in [*checked.findings, *lint.static_findings(checked)]
    ]
    return [finding for finding in findings if not finding.startswith("DB205")]


@cache
def known_findings(host: Path) -> frozenset[str]:
    """The findings of the scenario itself: warnings about robot files of packages."""
    return frozenset(headlines_of(check(load(host))))


@cache
def tried(key: Key) -> tuple[CheckedScenario | None, str]:
    """The first scenario in which the example lints clean; None, with its findings in all scenarios."""
    problems = []
    for place in fitting(key)[:50]:
        checked = with_example(place, key)
        findings = set(headlines_of(checked)) - known_findings(place.document.path)
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


@pytest.mark.parametrize("key", every(10, [key for key in KEYS if key.name not in FOREIGN]))
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
    assert headlines_of(check(scenario)) == []


@pytest.mark.slow
@pytest.mark.parametrize("key", KEYS, ids=str)
def test_a_scenario_with_the_example_runs(key: Key):
    checked, _ = tried(key)
    if checked is None or any(finding.severity == "error" for finding in api.all_findings(checked)):
        pytest.skip("what is wrong with it, or with its scenario, is said elsewhere")
    with closing(api.build(api.compile(checked).program)) as environment:
        environment.action_space.seed(1)
        environment.reset(seed=1)
        for _ in range(20):
            ended = environment.step(environment.action_space.sample())[2:4]
            if any(ended):
                environment.reset()


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


PACKAGES = sorted(
    path.parent
    for path in (
        *(ROOT / "deepbots_cli").rglob("__init__.py"),
        *(ROOT / "deepbots_webots").rglob("__init__.py"),
    )
)
PAGES = [
    *sorted(ROOT.glob("*.md")),
    *sorted((ROOT / "docs").rglob("*.md")),
    *sorted((ROOT / "course").glob("[0-9]*/text.md")),
]

BUILT = ("reference/", "../reference/", "benchmark.md", "course.md")
"""Pages that only the site has, whose test follows links to them. The first page links to none of them."""
TOPICS = "(?:cart|supervisor|deepbots)/"  # of ROS 2, in docs/ros.md
FORBIDDEN = re.compile(
    rf"(?<![\w.:/)\]}}*-])/(?!{TOPICS}|dev/null)[a-z]+/[A-Za-z]\w*|index-url|\bTODO\b"
)  # an absolute path is some machine's
UPON_CARTPOLE = "deepbots: 1\nextends: cartpole\n"


class Block(NamedTuple):
    """A fenced block: its page, first line, language, what follows the language, and its text."""

    page: str
    line: int
    language: str
    mark: str
    text: str

    def __str__(self) -> str:
        return f"{self.page}:{self.line}"


def blocks(language: str) -> list[Block]:
    return [block for page in PAGES for block in _blocks(page) if block.language == language]


def _blocks(page: Path) -> Iterator[Block]:
    text = page.read_text(encoding="utf-8")
    for match in re.finditer(r"^```(\w+)[ ]?([^\n]*)\n(.*?)^```$", text, re.MULTILINE | re.DOTALL):
        yield Block(
            str(page.relative_to(ROOT)), text[: match.start()].count("\n") + 1, match[1], match[2], match[3]
        )


def findings_of(text: str, base: Path = ROOT / "scenarios") -> list[Finding]:
    checked = check(loads(text, base=base))
    kept, unused = suppress(
        [*checked.findings, *run_rules(checked, preview=True)], checked.document.sources, quoted, preview=True
    )
    return [*kept, *unused]


@pytest.mark.parametrize("block", blocks("yaml"), ids=str)
def test_a_scenario_in_the_docs_is_what_the_text_says(block: Block, tmp_path: Path):
    if "pybullet_data" in block.text:
        pytest.importorskip("pybullet_data")
    mark, _, code = block.mark.partition(" ")
    if mark == "wrong":
        findings = findings_of(UPON_CARTPOLE + block.text)
        assert {finding.code for finding in findings} == {code}
    elif mark == "part":  # of a file, which the tests of the tutorials or of the course lint
        name = block.page.removeprefix("docs/").removesuffix(".md")
        assert name in TUTORIALS or name.startswith("course/")
    elif mark == "fragment":
        for file in _blocks(ROOT / block.page):
            if file.language == "xml" and file.mark:  # a robot file of the same page
                (tmp_path / file.mark).write_text(file.text, encoding="utf-8")
        findings = findings_of(UPON_CARTPOLE + block.text, tmp_path)
        assert [
            f"{finding.code} {finding.headline}" for finding in findings if finding.severity == "error"
        ] == []
    else:
        assert [f"{finding.code} {finding.headline}" for finding in findings_of(block.text)] == []


@pytest.mark.parametrize("block", blocks("python"), ids=str)
def test_python_in_the_docs_runs(block: Block, monkeypatch: pytest.MonkeyPatch):
    code = compile(block.text, str(block), "exec")
    if block.mark.startswith("skip"):
        pytest.skip(block.mark)
    monkeypatch.chdir(ROOT)
    exec(code, {"__name__": "__main__"})


def command_lines() -> list[tuple[str, str]]:
    lines = []
    for block in blocks("console"):
        lines += [
            (str(block), line.removeprefix("$ ")) for line in block.text.splitlines() if line.startswith("$ ")
        ]
    for page in PAGES:
        quoted = re.findall(r"`(deepbots [a-z][^`]*)`", page.read_text(encoding="utf-8"))
        lines += [(page.name, line) for line in quoted if not re.search("COMMAND|VERB|NAME", line)]
    return sorted(set(lines))


@pytest.mark.parametrize(("place", "line"), command_lines(), ids=str)
def test_a_command_in_the_docs_is_one(place: str, line: str):
    words = shlex.split(line)
    if words[0] == "make":
        targets = re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
        assert words[1] in targets
        return
    if words[0] != "deepbots":
        assert words[:2] in (["pip", "install"], ["python3.11", "-m"]) or words[0] in (
            ".",
            "mkdir",
            "cd",
            "optuna-dashboard",
        )
        return
    assert refusal(place, line) == ""


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_somewhere(page: Path):
    for target in re.findall(r"\]\(([^)\s]+)\)", page.read_text(encoding="utf-8")):
        if target.startswith("https://"):
            continue
        path, _, fragment = target.partition("#")
        if path.startswith(BUILT) and page != ROOT / "README.md":
            continue
        there = (page.parent / path).resolve() if path else page
        assert there.exists(), target
        assert not fragment or fragment in anchors(there), target


def linked(page: Path) -> set[Path]:
    targets = re.findall(r"\]\(([^)\s#]+)", page.read_text(encoding="utf-8"))
    return {
        (page.parent / target).resolve()
        for target in targets
        if target.endswith(".md") and "://" not in target and not target.startswith(BUILT)
    }


def test_every_page_is_reached_from_the_readme():
    reached = set()
    waiting = {ROOT / "README.md"}
    while waiting:
        page = waiting.pop()
        reached.add(page)
        waiting |= linked(page) - reached
    assert sorted(set(PAGES) - reached) == []


def anchors(page: Path) -> set[str]:
    headings = re.findall(r"^#+ (.+)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def test_every_algorithm_of_the_language_can_be_trained_with():
    from deepbots_cli.learning.sb3.algorithms import ALGORITHMS
    from deepbots_cli.scenario.training import ALGORITHMS as DECLARED

    assert set(ALGORITHMS) == set(DECLARED)


@pytest.mark.parametrize("page", [*PAGES, ROOT / "docs" / "build_reference.py"], ids=lambda page: page.name)
def test_a_page_speaks_of_nothing_that_a_reader_cannot_see(page: Path):
    assert FORBIDDEN.findall(page.read_text(encoding="utf-8")) == []


@pytest.mark.parametrize("package", PACKAGES, ids=lambda package: package.name)
def test_the_map_of_a_package_names_its_modules_and_no_others(package: Path):
    docstring = ast.get_docstring(ast.parse((package / "__init__.py").read_text(encoding="utf-8"))) or ""
    modules = {path.name for path in package.glob("*.py")} - {"__init__.py", "__main__.py"}
    named = (
        {f"{function_name(name)[0]}.py" for name in COMMANDS if name != "webots"}
        if package.name == "commands"
        else set(re.findall(r"\b[a-z_]+\.py\b", docstring))
    )
    assert named == modules


def test_the_picture_is_small():
    assert (ROOT / "docs" / "images" / "cartpole.png").stat().st_size < 60_000


def test_the_readme_shows_a_finding_as_lint_prints_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    (scenario,) = (block.text for block in blocks("yaml") if block.page == "README.md")
    (example,) = (block.text for block in blocks("text") if block.page == "README.md")
    monkeypatch.chdir(tmp_path)
    Path("pole.yaml").write_text(scenario.replace("> 15 deg", "> 15"), encoding="utf-8")
    assert main(["lint", "pole.yaml"]) == 1
    assert capsys.readouterr().out.startswith(example)


def test_the_page_about_the_pipeline_quotes_the_code():
    page = (ROOT / "docs" / "pipeline.md").read_text(encoding="utf-8")
    files = [
        ROOT / "deepbots_cli" / name for name in re.findall(r"^\| `([\w/]+\.py)` \|", page, re.MULTILINE)
    ]
    assert len(files) == 5
    code = "\n".join(
        [path.read_text(encoding="utf-8") for path in (*files, ROOT / "scenarios" / "cartpole.yaml")]
    )
    code += api.compile("cartpole").code
    lines = [
        line
        for block in blocks("text")
        if block.page == "docs/pipeline.md"
        for line in block.text.splitlines()
    ]
    assert [line for line in lines if line not in ("", "...") and line not in code] == []
