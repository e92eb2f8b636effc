"""The parts of the results page that are no scenario: costs, physics, channel, and what holds.

A table is measured again when anything has changed that it could depend on: the package, the scenarios and robots, the tests.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Benchmark:
    """A module of tests/benchmarks, which prints rows."""

    name: str

    @property
    def command(self) -> str:
        return f"python -m tests.benchmarks.{self.name}"


@dataclass(frozen=True)
class Holding:
    """Something that tests show; `expression` and `marker` choose them."""

    name: str
    folder: str
    expression: str = ""
    marker: str = ""

    @property
    def command(self) -> str:
        chosen = [f" {option} '{given}'" for option, given in (("-k", self.expression), ("-m", self.marker)) if given]
        return f"pytest {self.folder}{''.join(chosen)}"


@dataclass(frozen=True)
class Part:
    """A section of docs/reference/measurements.md with its tables; `figure` heads the column of what was measured."""

    name: str
    title: str
    prose: str
    tables: tuple[Benchmark | Holding, ...]
    figure: str = "measured"


COSTS = Part(
    name="costs",
    title="What it costs",
    prose="""\
Steps of the environment are compared with bare physics: the same engine, world, substeps and motion, without resets. "Layered by hand"
is an ordinary environment with a supervisor, a robot and messages, written directly upon PyBullet and numpy
(`tests/benchmarks/layered.py`). Its cost depends on its style: values clipped as one array, or joints read in one batch, make it
quicker; the file says by how much. "A plain environment by hand" is one class around PyBullet's functions with PyBullet's defaults
(`tests/benchmarks/plain_cost.py`); docs/engines.md says what makes the difference. Each sensor is timed by itself, on a rover that
drives in an arena, and has no bar. Answers of the language server are timed over its standard streams at random places, a quarter of
them right after a change of the text. Linting is timed as installed, with modules compiled before. Times depend on the machine: a busy
neighbor adds a tenth to a quarter. Beside such, the quadruped has come out at 1.12 to 1.23 and FindBallRandom at 1.28 to 1.36;
FindBallRandom works out what it remembers of the way in every step.""",
    tables=tuple(map(Benchmark, ("step_cost", "plain_cost", "sensor_cost", "compile_cost", "lint_cost", "lsp_cost"))),
)
PHYSICS = Part(
    name="physics",
    title="Physics against closed forms",
    prose="""\
Each experiment is a scenario, from its text to what the policy sees, on PyBullet (`tests/physics`). Errors above one percent
have these reasons. A tire of 2 cm grips anywhere across its width, so that in an arc the middle of the axle may be faster or
slower by 1 cm times the turning rate, which is 3.7 % here. A drum sinks into the ground by what the solver leaves of an overlap, and
rolls on less than its radius. A bounce begins after the surfaces met, and leaves a little more speed than stated. Smaller physics
steps mend both.""",
    tables=(Benchmark("physics"),),
    figure="error",
)
CHANNEL = Part(
    name="channel",
    title="Channels against what is declared",
    prose="Over 100 000 messages each. A chi-square p says how often chance alone differs as much from what was declared.",
    tables=(Benchmark("channel"),),
)
HOLDS = Part(
    name="holds",
    title="What holds",
    prose="Over every shipped scenario and those of the tests, on every engine that can hold them.",
    tables=(
        Holding(
            "same seed, same bytes: two environments, and after episodes of any length", "tests/contract", "same_seed or equals_a_fresh_one"
        ),
        Holding("same seed, same bytes: a fresh process", "tests/contract", "fresh_process"),
        Holding("same bytes in every exact message format, and without messages", "tests/contract", "every_message_format"),
        Holding("Gymnasium's and Stable-Baselines3's `check_env`, warnings as errors", "tests/contract", "checker_has_nothing_to_say"),
        Holding("10 000 random steps of every shipped scenario, all figures finite", "tests/world", "for_long_under_random_actions"),
        Holding("robots of PyBullet's data run with sensors on any link for 1000 steps", "tests/world", "robot_of_a_package_runs"),
        Holding(
            "queues are empty after every reset, and nothing leaks into the next episode", "tests", "queues_are_empty or nothing_leaks"
        ),
        Holding(
            "channels share no draw, and none changes another",
            "tests/channel",
            "never_share_a_draw or leaves_the_other_alone or share_no_draw",
        ),
        Holding("timing `paper` is one tick more either way", "tests/channel", "paper_timing"),
        Holding("the tests that take minutes", "tests", marker="slow"),
    ),
)
LINTING = Part(
    name="linting",
    title="What lint finds, and what it withstands",
    prose="""\
Mistakes put into scenarios (`tests/faults`): the one finding has to begin and end where the mistake does, to the character, with its code,
and nothing else may be told. Damaged files (`tests/fuzz`; `make fuzz` tries more): no exception, the same findings
when asked again, the right exit code, and what has no error compiles. Hostile files (`tests/hostile`): bombs, depth, size, meshes and
pictures that lie, paths that lead outside.""",
    tables=(Benchmark("injected_faults"), Benchmark("damaged_files"), Benchmark("hostile_files")),
)
RULES = Part(
    name="rules",
    title="What the rules of lint say, and where they are silent",
    prose="""\
Every finding has a mistake as its case, whose words and places are kept in `tests/golden/lint/err`, and a page, whose example has it and
what to write instead has not. Shipped scenarios, templates and the docs are silent with the rules in preview; what is kept in
`tests/golden/lint/ok`, unusual and right, is silent by default.""",
    tables=(
        Holding("every finding has a mistake as its case", "tests/golden/test_golden_lint.py", "every_rule_has_a_case"),
        Holding("a mistake is told in the words and at the places that are kept", "tests/golden/test_golden_lint.py", "in_these_words"),
        Holding("every finding has a page, and the examples of all pages were run", "tests/diagnostics/test_rule_pages.py"),
        Holding("unusual scenarios that are right: silent", "tests/golden/test_golden_lint.py", "without_mistake_is_silent"),
        Holding("shipped scenarios: silent", "tests/world/test_world_scenarios.py", "has_no_findings"),
        Holding("templates: silent, and they run", "tests/cli/test_cli_new.py", "what_a_template_makes"),
        Holding(
            "scenarios and examples in the docs: what the text says of them",
            "tests/docs",
            "in_the_docs_is or have_no_findings or lints_clean",
        ),
        Holding(
            "the original CartPole: clipped angle, score limit before the step limit, raw bounds, time limit as an ending",
            "tests/golden/test_golden_lint.py",
            "original",
        ),
    ),
)
PARTS = (COSTS, PHYSICS, CHANNEL, LINTING, RULES, HOLDS)
