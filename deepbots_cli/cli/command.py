"""The program `deepbots`, and the arguments and options that several commands share."""

from __future__ import annotations

import inspect
import math
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import field, replace
from functools import cache, wraps
from importlib import import_module
from pathlib import Path, PurePosixPath
from typing import Annotated, Any, Literal

import typer
from typer.core import TyperCommand, TyperGroup

import deepbots_cli
from deepbots_cli.cli import terminal
from deepbots_cli.cli.commands import (
    COMMANDS,
    EXCLUDES,
    GONE,
    GROUPS,
    NEEDS,
    REPLACEMENTS,
    TAKES,
    function_name,
)
from deepbots_cli.cli.exits import FAILED
from deepbots_cli.diagnostics.nearest import nearest_word
from deepbots_cli.errors import MissingExtraError, ScenarioError, UsageError
from deepbots_cli.plugins import entry_points_of
from deepbots_cli.records import dataclass
from deepbots_cli.words import sentence_list

MAX_SEED = 2**63 - 1
"""The largest seed that a run can record."""
MAX_SEEDS = 1000
"""The largest number of seeds of a group."""

FAILED_EPISODES = "failed"
"""The value of `--episodes` for the failed episodes of the last evaluation."""

ADVANCED = "Advanced"
"""The group of options that are rarely needed or dangerous; it is the last in the help."""
EPISODES, SCENARIO, OUTPUT = "Episodes", "Scenario", "Output"
"""The groups of options: the episodes and their driver, changes of the scenario, and the output."""


def known_engine(name: str | None) -> str | None:
    """Refuse the name of an unknown engine, and an engine that is not installed if another one is."""
    from deepbots_cli.engine_kinds import ENGINES

    if name is None:
        return None
    if name not in ENGINES:
        from deepbots_cli.scenario.documentation import word_for

        suggestion = word_for(name, ENGINES) or nearest_word(name, ENGINES)
        hint = f"did you mean '{suggestion}'? The" if suggestion else "the"
        raise typer.BadParameter(f"there is no engine '{name}'; {hint} engines are: {', '.join(ENGINES)}")
    kind = ENGINES[name]
    if not kind.is_installed and any(candidate.is_installed for candidate in ENGINES.built_in.values()):
        raise typer.BadParameter(f"{kind.missing}; {kind.help}")
    return name


def whole_number(minimum: int = 1, maximum: int | None = None) -> Callable[[str | int], int]:
    """Return a parser of whole numbers: `100000`, `100_000`, `100k` or `1e5`."""

    def parse(text: str | int) -> int:
        value = _whole(str(text))
        if value is None:
            example = "0 or 42" if minimum == 0 else "100000, 100_000, 100k or 1e5"
            raise typer.BadParameter(f"'{text}' is not a whole number; write it like {example}")
        if value < minimum:
            raise typer.BadParameter(f"{text} is too small; the minimum is {minimum}")
        if maximum is not None and value > maximum:
            raise typer.BadParameter(f"{text} is too large; the maximum is {maximum}")
        return value

    return parse


def _workers(text: str | int) -> int:
    """Parse the value of `--workers`."""
    # Negative numbers pass here, so that they get the message below.
    number = whole_number(-(10**9), 1024)(text)
    if number < 1:
        raise UsageError(
            f"--workers {text} starts no process; write --workers 1 or more, or leave it out to work in this"
            " process"
        )
    return number


def option(usage: str, text: str, group: str | None = None, **settings: Any) -> Any:
    """Return an option for `Annotated`, from its usage such as `--output -o FILE`: its names, and the word
    for its value; a flag has none.

    `text` is its help, and `group` its section there, by default `Options`.
    """
    words = usage.split()
    metavar = None if words[-1].startswith("-") else words.pop()
    return typer.Option(*words, metavar=metavar, help=text, rich_help_panel=group, **settings)


def integer(
    usage: str, text: str, minimum: int = 1, maximum: int | None = None, group: str | None = None
) -> Any:
    """Return an option that takes a whole number."""
    return option(usage, text, group, parser=whole_number(minimum, maximum))


def written_options(ctx: typer.Context) -> dict[str, str]:
    """Return the names of the options that the user wrote, such as `--set`, by their parameters."""
    options = {
        parameter.name: parameter.opts[0]
        for parameter in ctx.command.params
        if parameter.name is not None and parameter.param_type_name == "option"
    }
    sources = {key: ctx.get_parameter_source(key) for key in options}
    # By name: releases of typer have this class from click, or a copy of their own.
    return {
        key: name
        for key, name in options.items()
        if (source := sources[key]) is not None and source.name == "COMMANDLINE"
    }


_ALWAYS = frozenset({"--json", "--quiet", "--force", "--allow-path", "--allow-code"})
"""Options that go with everything that a command is asked about."""


def check_options(ctx: typer.Context, subject: str) -> None:
    """Refuse the options that the user wrote and that do not go with what the command is asked about, by
    `TAKES`.

    Raises:
        UsageError: There is such an option.
    """
    names, _, reason = TAKES[ctx.command.name or ""][subject].partition("; ")
    taken = names.removeprefix("all but ").split()
    written = [name for name in written_options(ctx).values() if name not in _ALWAYS]
    if wrong := [name for name in written if (name in taken) == names.startswith("all but ")]:
        takes = f"it takes {sentence_list(taken)}" if taken else "its start and its actions are its own"
        verb = "does" if len(wrong) == 1 else "do"
        raise UsageError(f"{sentence_list(wrong)} {verb} not go with {subject}; {reason or takes}")


def start_values(texts: Sequence[str] | None) -> dict[str, Any]:
    """Return the `options` of `reset` from `--start`: a number, a word, or several numbers with commas
    between them.

    Raises:
        UsageError: A value is not of the form NAME=VALUE, a name is given twice, or numbers are in brackets
            or without commas.
    """
    values: dict[str, Any] = {}
    for text in texts or ():
        name, _, value = (part.strip() for part in text.partition("="))
        if not name or not value:
            raise UsageError(f"--start {text}: write NAME=VALUE, such as --start mark.x=0.5")
        if name in values:
            raise UsageError(f"--start sets {name} twice")
        try:
            numbers = [float(number) for number in value.split(",")]
        except ValueError:
            parts = value.strip("[]() ").replace(",", " ").split()
            if parts and all(map(_is_number, parts)):
                raise UsageError(
                    f"--start {text}: separate the numbers by commas, without spaces or brackets: --start"
                    f" {name}={','.join(parts)}"
                ) from None
            values[name] = value
        else:
            values[name] = numbers if len(numbers) > 1 else numbers[0]
    return values


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _whole(text: str) -> int | None:
    try:
        return int(text)
    except ValueError:
        from deepbots_cli.scenario.quantities import number_meant

        _, replacement = number_meant(text, whole=True) or ("", None)
    return int(replacement.text) if replacement else None


def seed_list(text: str) -> tuple[int, ...]:
    """Parse seeds: `0..4`, both ends included, or `0,3,7`.

    Raises:
        typer.BadParameter: The text is neither.
    """
    seeds: list[int] = []
    for part in text.split(","):
        first, dots, last = part.partition("..")
        try:
            low = whole_number(0, MAX_SEED)(first.strip())
            high = whole_number(0, MAX_SEED)(last.strip()) if dots else low
        except typer.BadParameter as error:
            raise typer.BadParameter(f"--seeds: {error.message}") from None
        if high < low:
            raise typer.BadParameter(f"--seeds: '{part}' ends before it begins; write {high}..{low}")
        if high - low >= MAX_SEEDS:
            raise typer.BadParameter(
                f"--seeds: '{part}' has {high - low + 1:,} seeds; the limit is {MAX_SEEDS:,}"
            )
        seeds += range(low, high + 1)
        if len(seeds) > MAX_SEEDS:
            raise typer.BadParameter(f"--seeds: a group has at most {MAX_SEEDS} seeds")
    if len(set(seeds)) < len(seeds):
        raise typer.BadParameter(f"--seeds: '{text[:80]}' has a seed twice")
    return tuple(seeds)


def episodes_or_failed(text: str, minimum: int = 1, maximum: int | None = None) -> int | str:
    """Parse a number, or `failed`."""
    return text if text == FAILED_EPISODES else whole_number(minimum, maximum)(text)


def names(texts: Sequence[str] | None) -> tuple[str, ...]:
    """Return the names of an option that may be repeated; `none` alone stands for no name."""
    return () if texts is None or list(texts) == ["none"] else tuple(texts)


def finite(value: float | None) -> float | None:
    """Check a number, which may be absent, to be neither infinite nor NaN."""
    if value is not None and not math.isfinite(value):
        raise typer.BadParameter(f"'{value}' is not a finite number")
    return value


def fraction(text: str) -> float:
    """Parse a number from 0 to 1, written as `0.8` or `80%`."""
    from deepbots_cli.scenario.quantities import read_fraction

    try:
        value = read_fraction(text)
    except ValueError:
        value = -1.0
    if not 0 <= value <= 1:
        hint = f"; write {text}% for a percentage" if 1 < value <= 100 and "%" not in text else ""
        raise typer.BadParameter(f"'{text}' is not a number from 0 to 1 or a percentage{hint}")
    return value


Scenario = Annotated[
    str,
    typer.Argument(
        metavar="SCENARIO", help="A scenario file, or the name of a scenario that comes with deepbots."
    ),
]
Overrides = Annotated[
    list[str] | None,
    option(
        "--set PATH=VALUE",
        "Override a value of the scenario, such as fall_angle=10deg; may be repeated.",
        SCENARIO,
    ),
]
XacroArguments = Annotated[
    list[str] | None,
    option(
        "--xacro-arg NAME:=VALUE",
        "Argument of a robot file in xacro, in place of its default; may be repeated.",
        SCENARIO,
    ),
]
AllowPaths = Annotated[
    list[Path] | None,
    option(
        "--allow-path DIR",
        "Allow reading files from this folder outside the project; may be repeated.",
        ADVANCED,
    ),
]
AllowCode = Annotated[
    bool,
    option(
        "--allow-code",
        "Allow reward terms and endings that are Python functions; use it only for packages that you trust.",
        ADVANCED,
    ),
]
Case = Annotated[
    str | None, option("--case NAME", "Apply the settings of this case of `evaluation.cases`.", SCENARIO)
]
Stage = Annotated[
    str | None, option("--stage NAME", "Apply the settings of this stage of the curriculum.", SCENARIO)
]
Force = Annotated[bool, option("--force", "Overwrite files that exist.", ADVANCED)]
Csv = Annotated[Path | None, option("--csv FILE", "Write the table as CSV.", ADVANCED)]
Latex = Annotated[Path | None, option("--latex FILE", "Write the table for LaTeX.", ADVANCED)]
Json = Annotated[bool, option("--json", "Print the result as JSON.", OUTPUT)]
Seed = Annotated[int, integer("--seed N", "Root seed of all random numbers.", 0, MAX_SEED, EPISODES)]
Driver = Annotated[
    str | None,
    option(
        "--driver NAME",
        "The driver of the episodes: `policy` (of a run), a script of the scenario, `random`, `zero` (the"
        " middle of each range, the first option of each choice), or actions to repeat, such as"
        " forward*5,backward. The default is the policy, else the first script, else `random`.",
        EPISODES,
    ),
]
Start = Annotated[
    list[str] | None,
    option(
        "--start NAME=VALUE",
        "Set a value that each episode otherwise draws at random, in SI units, such as mark.x=0.5; may be"
        " repeated. `deepbots try SCENARIO --json` lists the names under `drawn`.",
        SCENARIO,
    ),
]
Engine = Annotated[
    str | None,
    option(
        "--engine NAME",
        "Physics engine: pybullet, mujoco, or an engine that an installed package adds; by default"
        " `world.engine` of the scenario, else pybullet.",
        SCENARIO,
        callback=known_engine,
    ),
]
Workers = Annotated[
    int | None, option("--workers N", "Use N processes of this machine.", ADVANCED, parser=_workers)
]
ClusterAddress = Annotated[
    str | None,
    option(
        "--cluster ADDRESS",
        "Use the Ray cluster at HOST:PORT, or with `auto` the one of this machine.",
        ADVANCED,
    ),
]
Quiet = Annotated[bool, option("--quiet -q", "Print no progress.", OUTPUT)]
Page = Annotated[
    bool,
    option(
        "--view",
        "Show the newest policy in the browser while it is trained, as `deepbots view RUN` does.",
        OUTPUT,
    ),
]
Callbacks = Annotated[
    list[str] | None,
    option(
        "--callback NAME",
        "Call this callback of an installed package during the training; may be repeated. `none` drops those"
        " of a resumed training.",
        ADVANCED,
    ),
]
Loggers = Annotated[
    list[str] | None,
    option(
        "--logger NAME",
        "Write the scalars with this logger too: csv, or one that an installed package adds; may be repeated."
        " `none` drops those of a resumed training.",
        ADVANCED,
    ),
]
EngineOrRun = Annotated[
    str | None,
    option(
        "--engine NAME",
        "Physics engine; by default that of the run or scenario, else pybullet.",
        SCENARIO,
        callback=known_engine,
    ),
]

Shown = Annotated[
    str,
    typer.Argument(
        metavar="SCENARIO|RUN|MODEL|RECORDING",
        help="A scenario file, the name of a shipped scenario, a run directory, a model in it, a recording"
        " or the log of a robot.",
    ),
]
Host = Annotated[
    str,
    option(
        "--host ADDRESS",
        "Address to serve on. With an address that other machines can reach, such as 0.0.0.0, the page opens"
        " only with the token in the printed address.",
        ADVANCED,
    ),
]
Port = Annotated[
    int | None,
    integer(
        "--port N", "Port of the page; by default the first free port from 8787.", 0, 65535, group=ADVANCED
    ),
]
Open = Annotated[bool, option("--open", "Open the page in the browser.")]
Episode = Annotated[
    int,
    integer(
        "--episode K",
        "Begin with the start of held-out episode K of `deepbots eval`, counted from 0.",
        0,
        group=EPISODES,
    ),
]


# The command

_SETTINGS = {"help_option_names": ["-h", "--help"], "max_content_width": 100}
_HELP = Path(__file__).with_name("help")

_WITH_ROLES = frozenset(
    {
        "bench",
        "compile",
        "eval",
        "inspect",
        "lint",
        "play",
        "render",
        "robustness",
        "test",
        "train",
        "try",
        "view",
    }
)
"""The commands of a scenario, of which one of several agents may be named."""


def help_text(name: str) -> str:
    """Return the help of a command, or of `deepbots`: its line in `COMMANDS`, and the text of
    `help/NAME.txt`.

    In the file, blank lines separate paragraphs, which are wrapped, and indented blocks, which are shown as
    they are.
    """
    blocks = (_HELP / f"{name}.txt").read_text(encoding="utf-8").rstrip("\n").split("\n\n")
    # A line with `\b` alone keeps click from wrapping the paragraph below it.
    marked = [f"\b\n{block}" if block.startswith(" ") else block for block in blocks]
    return "\n\n".join([COMMANDS[name], *marked] if name in COMMANDS else marked)


def _check_together(command: str, given: set[str]) -> None:
    """Refuse options that lack an option that they need, or that exclude each other.

    Raises:
        UsageError: There are such options.
    """
    for options, text in NEEDS.get(command, {}).items():
        needed, _, reason = text.partition("; ")
        lone = next((name for name in options.split() if name in given), None)
        if lone is not None and given.isdisjoint(needed.split()):
            alternatives = sentence_list(needed.split(), "or")
            raise UsageError(
                f"{lone} {reason}; add {alternatives}" if reason else f"{lone} needs {alternatives}"
            )
    for options, text in [*EXCLUDES[""].items(), *EXCLUDES.get(command, {}).items()]:
        excluded, _, reason = text.partition("; ")
        pairs = ((one, other) for one in options.split() for other in excluded.split() if one != other)
        for one, other in pairs:
            if {one, other} <= given:
                raise UsageError(
                    f"{one} {reason}; leave out {other}"
                    if reason
                    else f"{one} and {other} cannot be combined"
                )


class Command(TyperCommand):
    """A command whose help has its options in groups, and whose errors for an option of another name, or a
    value that is gone, say what to write."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        names = {name for parameter in self.params for name in parameter.opts}
        before = ""
        for word in args[: args.index("--")] if "--" in args else args:
            name = word.partition("=")[0]
            with_value = word.replace("=", " ", 1) if "=" in word else f"{before} {word}"
            before = word
            for gone in GONE.keys() & {name, with_value}:
                ctx.fail(f"{gone} is gone; {GONE[gone]}")
            replacement = REPLACEMENTS.get(name) if name.startswith("--") and name not in names else None
            instead = (replacement or "").partition(" ")[0]
            if instead.startswith("--") and instead not in names:  # this command has neither
                replacement = REPLACEMENTS.get(instead)
            if replacement is not None:
                ctx.fail(f"there is no option {name}; use `{replacement}`")
        left = super().parse_args(ctx, args)
        _check_together(self.name or "", {*written_options(ctx).values()})
        return left

    def format_options(self, ctx: Any, formatter: Any) -> None:
        groups: dict[str, list[tuple[str, str]]] = {"Arguments": [], "Options": []}
        for parameter in self.get_params(ctx):
            row = parameter.get_help_record(ctx)
            is_argument = parameter.param_type_name == "argument"
            group = "Arguments" if is_argument else getattr(parameter, "rich_help_panel", None) or "Options"
            groups.setdefault(group, []).extend([row] if row is not None else [])
        # False comes before True, and the sort is stable: this group comes last, and the others stay.
        for group in sorted(groups, key=ADVANCED.__eq__):
            if groups[group]:
                with formatter.section(group):
                    formatter.write_dl(groups[group])


def _function(name: str) -> Callable[..., None]:
    module, function = function_name(name)
    command: Callable[..., None] = getattr(import_module(f"deepbots_cli.cli.commands.{module}"), function)
    return command


@cache
def _command(name: str) -> Any:
    """Return the command of this name. It is cached for programs that call `main` several times, because
    typer takes 4 ms to read its annotations."""
    app = typer.Typer(add_completion=False, rich_markup_mode=None, context_settings=_SETTINGS)
    run = entry_of_webots("command") if name == "webots" else _function(name)
    app.command(name, cls=Command, help=help_text(name))(
        _with_permission_options(
            _with_role_options(run, ADVANCED if name == "eval" else SCENARIO) if name in _WITH_ROLES else run
        )
    )
    return typer.main.get_command(app)


def _role_kinds(group: str) -> dict[str, Any]:
    """Return the types of --agent and --against, which are in a group of the help."""
    return {
        "agent": Annotated[
            str | None,
            option(
                "--agent NAME",
                "With several agents, the one that is trained, evaluated or driven; by default all.",
                group,
            ),
        ],
        "against": Annotated[
            list[str] | None,
            option(
                "--against AGENT=DRIVER",
                "With --agent: who acts for another agent, a script of it, `random`, `zero`, or the policy of"
                " a run by its path; may be repeated. By default its first script, or its policy in RUN.",
                group,
            ),
        ],
    }


def _drivers_of_others(agent: str | None, against: Sequence[str]) -> dict[str, str]:
    """Return the driver that `--against` names for each other agent."""
    drivers: dict[str, str] = {}
    for word in against:
        name, _, driver = map(str.strip, word.partition("="))
        if not (agent and name and driver):
            raise typer.BadParameter(
                f"--against {word}: write --agent NAME --against AGENT=DRIVER, such as --against prey=flee"
            )
        if name in drivers:
            raise typer.BadParameter(f"--against names the agent {name} twice")
        drivers[name] = driver
    return drivers


def _policies_of_run(run: Path, agent: str) -> dict[str, str]:
    """Return the model of a run of all agents as the driver of each other agent; empty for any other run."""
    from deepbots_cli.learning.runs.run import ModelRef
    from deepbots_cli.rollout.source import SourceKind, folder_kind

    if folder_kind(run) is not SourceKind.RUN and run.suffix != ".zip":
        return {}
    ref = ModelRef.open(run)
    return {name: str(ref.path) for name in ref.run.program.members if name != agent}


def _role_setting(agent: str, drivers: Mapping[str, str]) -> tuple[str, list[Path]]:
    """Return the setting of `role`, with absolute paths of runs and models, and the folders of these."""
    from deepbots_cli.compiler.agents import is_model
    from deepbots_cli.document.layout import plain_or_quoted

    entries: list[str] = []
    folders: list[Path] = []
    for name, driver in drivers.items():
        if is_model(driver):
            driver = os.path.abspath(driver)
            folders.append(Path(driver if os.path.isdir(driver) else os.path.dirname(driver)))
        entries.append(f"{plain_or_quoted(name)}: {plain_or_quoted(driver)}")
    return f"role={{agent: {plain_or_quoted(agent)}, others: {{{', '.join(entries)}}}}}", folders


def _with_role_options(command: Callable[..., None], group: str) -> Callable[..., None]:
    """Return the command with the options --agent and --against, which set the `role` of the scenario.

    A command with a parameter `agent` gets the name too.
    """
    passed = {"agent"} & inspect.signature(command).parameters.keys()

    @wraps(command)
    def call(*, agent: str | None, against: list[str] | None, **values: Any) -> None:
        drivers = _drivers_of_others(agent, against or ())
        source = values.get("run") or values.get("shown")
        if agent is not None and source is not None:
            drivers = _policies_of_run(Path(source), agent) | drivers
        # in place of the role in the file
        role, folders = _role_setting(agent, drivers) if agent is not None else ("", [])
        if folders and "permissions" in values:
            allowed = values["permissions"]
            values["permissions"] = replace(allowed, folders=(*allowed.folders, *folders))
        values |= {"overrides": [*(values["overrides"] or ()), *([role] if role else [])] or None}
        command(**values, **({"agent": agent} if passed else {}))

    options = {name: (kind, None) for name, kind in _role_kinds(group).items()}
    return _declared(call, command, options, instead_of="agent", behind="overrides")


def _declared(
    call: Callable[..., None],
    command: Callable[..., None],
    options: Mapping[str, tuple[Any, object]],
    *,
    instead_of: str,
    behind: str = "",
) -> Callable[..., None]:
    """Return `call` with the parameters of a command, and with `options` (annotation and default) in place of
    one of them, behind another one or at the end."""
    added = [
        inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=kind)
        for name, (kind, default) in options.items()
    ]
    # The modules of commands postpone annotations (PEP 563), so that they are texts without `eval_str`.
    signature = inspect.signature(command, eval_str=True)
    listed = [
        parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY)
        for name, parameter in signature.parameters.items()
        if name != instead_of
    ]
    names = [parameter.name for parameter in listed]
    place = names.index(behind) + 1 if behind else len(listed)
    # typer takes the options of a command from this attribute, and passes them by name.
    vars(call)["__signature__"] = signature.replace(parameters=[*listed[:place], *added, *listed[place:]])
    return call


class Commands(TyperGroup):
    """The group of the commands. It imports the module of a command when the command is called."""

    def list_commands(self, ctx: Any) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        if cmd_name not in COMMANDS:
            old_names = [
                name for name, replacement in REPLACEMENTS.items() if replacement.startswith("deepbots ")
            ]
            suggestion = nearest_word(cmd_name, (*COMMANDS, *old_names)) or ""
            listing = f"the commands are: {', '.join(COMMANDS)}"
            if suggestion in REPLACEMENTS:
                hint = f"use `{REPLACEMENTS[suggestion]}`"
            elif suggestion:
                hint = f"did you mean '{suggestion}'?"
            else:
                hint = listing
            ctx.fail(f"there is no command '{cmd_name}'; {hint}")
        return _command(cmd_name)

    def shell_complete(self, ctx: Any, incomplete: str) -> list[Any]:
        from typer.core import CompletionItem  # type: ignore[attr-defined]  # typer exports none

        if incomplete.startswith("-"):
            return super().shell_complete(ctx, incomplete)
        return [
            CompletionItem(name, help=summary)
            for name, summary in COMMANDS.items()
            if name.startswith(incomplete)
        ]

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        width = max(map(len, COMMANDS))
        for group, commands in GROUPS.items():
            with formatter.section(group):
                formatter.write_dl([(name.ljust(width), line) for name, line in commands.items()])

    def invoke(self, ctx: Any) -> Any:
        try:
            return super().invoke(ctx)
        except typer.BadParameter as error:
            error.message = error.message.removeprefix("Value error, ")  # pydantic's name of the exception
            raise
        except KeyboardInterrupt:
            terminal.note("interrupted")
            # 128 plus the number of SIGINT, as shells report it.
            raise typer.Exit(130) from None


def _with_permission_options(command: Callable[..., None]) -> Callable[..., None]:
    """Return the command with the options --allow-path and --allow-code instead of its parameter
    `permissions`, if it has one."""
    if "permissions" not in inspect.signature(command).parameters:
        return command
    from deepbots_cli.document import Permissions

    @wraps(command)
    def call(*, allow_paths: AllowPaths, allow_code: AllowCode, **values: Any) -> None:
        permissions = Permissions(allow_paths or (), allow_code)
        try:
            command(**values, permissions=permissions)
        except ScenarioError as error:
            terminal.show_findings(error.findings, permissions)
            raise typer.Exit(FAILED) from None

    options = {"allow_paths": (AllowPaths, None), "allow_code": (AllowCode, False)}
    return _declared(call, command, options, instead_of="permissions")


def run_command(arguments: Sequence[str] | None) -> None:
    """Parse the arguments and run the command; ends with SystemExit, or with the exception of the command."""
    app = typer.Typer(
        cls=Commands,
        rich_markup_mode=None,
        no_args_is_help=True,
        subcommand_metavar="COMMAND ...",
        context_settings=_SETTINGS,
    )
    app.callback(help=help_text("deepbots"))(_deepbots)
    words = sys.argv[1:] if arguments is None else list(arguments)
    typer.main.get_command(app).main(args=words, prog_name="deepbots")


def _version(value: bool) -> None:
    if value:
        typer.echo(f"deepbots {deepbots_cli.__version__}")
        raise typer.Exit


def _deepbots(
    version: Annotated[
        bool, option("--version", "Show the version and exit.", callback=_version, is_eager=True)
    ] = False,
) -> None:
    """Handle the options of the program itself."""


# The commands of deepbots-webots, a distribution of its own, by its entry points


_WEBOTS_USES = {
    "command": "`deepbots webots`",
    "starter": "`deepbots new --webots`",
    "exporter": "`deepbots export --to webots`",
}


@dataclass
class Starter:
    """The files of a scenario for a world, the number of places that are left, and warnings about the
    world."""

    files: dict[PurePosixPath, bytes]
    todos: int
    warnings: list[str] = field(default_factory=list)


def entry_of_webots(name: Literal["command", "starter", "exporter"]) -> Callable[..., Any]:
    """Import and return the function of an entry point.

    Raises:
        MissingExtraError: deepbots-webots is not installed.
    """
    for entry in entry_points_of("deepbots.webots"):
        if entry.name == name:
            function: Callable[..., Any] = entry.load()
            return function
    raise MissingExtraError("webots", _WEBOTS_USES[name])
