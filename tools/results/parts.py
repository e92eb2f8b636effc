"""The parts of docs/reference/measurements.md: costs, channel, lint, and what holds; physics is in docs/engines.md.

A table is measured again when anything has changed that it could depend on: the package, the scenarios and
robots, the tests, the tools.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Benchmark:
    """A module of tools/benchmarks, which prints rows."""

    name: str

    @property
    def command(self) -> str:
        return f"python -m tools.benchmarks.{self.name}"


@dataclass(frozen=True)
class Holding:
    """Something that tests show; `expression` and `marker` choose them."""

    name: str
    folder: str
    expression: str = ""
    marker: str = ""

    @property
    def command(self) -> str:
        chosen = [
            f" {option} '{value}'"
            for option, value in (("-k", self.expression), ("-m", self.marker))
            if value
        ]
        return f"pytest {self.folder}{''.join(chosen)}"


@dataclass(frozen=True)
class Part:
    """A section of a page of docs with its tables; without `page`, of docs/reference/measurements.md."""

    name: str
    title: str
    prose: str
    tables: tuple[Benchmark | Holding, ...]
    page: str = ""


COSTS = Part(
    name="costs",
    title="What it costs",
    prose="""\
Steps of an environment are compared with bare physics: the same engine, world, substeps and motion, without
resets. "Layered by hand" is an environment with a supervisor, a robot and messages, written directly on
PyBullet and numpy (`tools/benchmarks/layered.py`, which says how its style changes the cost). "A plain
environment by hand" is one class around PyBullet's functions with PyBullet's defaults
(`tools/benchmarks/plain_cost.py`); [Physics engines](../engines.md) explains the difference. Answers of the
language server are timed over its standard streams at random places, a quarter of them directly after a
change of the text. Linting is timed as installed, with compiled modules. Other processes on the machine add
10 to 25 % to all times. Beside them, the quadruped had 1.12 to 1.23, and FindBallRandom, which computes its
memory in every step, 1.28 to 1.36.""",
    tables=(
        *map(Benchmark, ("step_cost", "plain_cost", "compile_cost", "lint_cost", "lsp_cost")),
        Benchmark("first_install"),
    ),
)
PEERS = Part(
    name="peers",
    title="Beside other projects",
    prose="""\
CPU times with random actions, in turn with an environment of another project for the same task, both as
their users make them. The rail has the motor, the start and the ending of Gymnasium's pendulum, and both are
integrated by Euler's method. Times of a batch are per world, and its actions are zero.""",
    tables=(Benchmark("peers"), Benchmark("agents_cost"), Benchmark("lint_start")),
)
PHYSICS = Part(
    name="physics",
    title="How true is the simulation?",
    prose="",
    tables=(Benchmark("physics"),),
    page="engines.md",
)
CHANNEL = Part(
    name="channel",
    title="Channels against what is declared",
    prose="Each row is of 100 000 messages or more. The p of a chi-square test is the probability that"
    " chance alone differs as much "
    "from the declared values.",
    tables=(Benchmark("channel"),),
)
HOLDS = Part(
    name="holds",
    title="What holds",
    prose="Tests of every shipped scenario and of those in the tests, on every engine that supports them.",
    tables=(
        Holding(
            "same seed, same bytes: two environments, and after episodes of any length",
            "tests/contract",
            "equals_a_fresh_one",
        ),
        Holding("same seed, same bytes: a fresh process", "tests/contract", "fresh_process"),
        Holding(
            "same bytes in every exact message format, and without messages",
            "tests/contract",
            "every_message_format",
        ),
        Holding(
            "Gymnasium's and Stable-Baselines3's `check_env`, warnings as errors",
            "tests/contract",
            "checker_has_nothing_to_say",
        ),
        Holding(
            "random steps of drawn scenarios raise nothing, and all figures are finite",
            "tests/laws",
            "nothing_raises",
        ),
        Holding(
            "robots of PyBullet's data run with sensors on any link for 1000 steps",
            "tests/world",
            "robot_of_a_package_runs",
        ),
        Holding(
            "nothing leaks into the next episode: a reset world equals a new one, in drawn scenarios",
            "tests/laws",
            "a_reset_world_is_a_fresh_one",
        ),
        Holding(
            "channels share no draw, and none changes another",
            "tests/channel",
            "never_share_a_draw or leaves_the_other_alone or share_no_draw",
        ),
        Holding("timing `paper` is one tick more either way", "tests/channel", "paper_timing"),
        Holding(
            "simulated trainings stop too early, or never, as rarely as the page on judging says",
            "tests/learning/test_confirmation.py",
            marker="slow",
        ),
    ),
)
LINTING = Part(
    name="linting",
    title="What lint finds, and what it withstands",
    prose="""\
Mistakes are put into scenarios (`tests/faults`): lint must give one finding, with its code, that begins and ends where the mistake does,
and no other. Damaged files (`tests/fuzz`; `make fuzz` tries more) must give no exception, the same findings twice and the right exit
code; a file without errors must compile. Hostile files (`tests/hostile`) are bombs, deep or large files, meshes and pictures with false
sizes, and paths that lead outside the project.""",
    tables=(Benchmark("injected_faults"), Benchmark("damaged_files"), Benchmark("hostile_files")),
)
RULES = Part(
    name="rules",
    title="What the rules of lint say, and where they are silent",
    prose="""\
Every finding has a case in `tests/golden/lint/err` with its words and places, and a page whose first example has the finding and whose
second one does not. Shipped scenarios, templates and the docs have no findings, also with preview rules; unusual but right scenarios in
`tests/golden/lint/ok` have none by default.""",
    tables=(
        Holding(
            "every finding has a mistake as its case",
            "tests/golden/test_golden_lint.py",
            "every_rule_has_a_case",
        ),
        Holding(
            "a mistake is told in the words and at the places that are kept",
            "tests/golden/test_golden_lint.py",
            "reported_once_in_short_plain_words",
        ),
        Holding(
            "every finding has a page, and the examples of all pages were run",
            "tests/diagnostics/test_rule_pages.py",
        ),
        Holding(
            "unusual scenarios that are right: silent",
            "tests/golden/test_golden_lint.py",
            "without_mistake_is_silent",
        ),
        Holding("shipped scenarios: silent", "tests/world/test_world_scenarios.py", "has_no_findings"),
        Holding("templates: silent, and they run", "tests/cli/test_cli_new.py", "what_a_template_makes"),
        Holding(
            "scenarios and examples in the docs: what the text says of them",
            "tests/docs",
            "in_the_docs_is or have_no_findings or lints_clean",
        ),
        Holding(
            "the original CartPole: clipped angle, score limit before the step limit, raw bounds, time limit"
            " as an ending",
            "tests/golden/test_golden_lint.py",
            "original",
        ),
    ),
)
PARTS = (COSTS, PEERS, PHYSICS, CHANNEL, LINTING, RULES, HOLDS)
