"""The Python API: from a scenario to an environment.

    import deepbots_cli

    env = deepbots_cli.make("cartpole", render_mode="rgb_array")   # a Gymnasium environment
    compiled = deepbots_cli.compile("my_scenario.yaml")            # .program, .code, .digest, .findings
    result = deepbots_cli.train(compiled, seed=0)

A scenario is named by the path of a file or by the name of a shipped one (`cartpole`), or is a `Scenario`
built in Python, whose relative paths start from the working directory. Training and evaluation are in
`deepbots_cli.learning`. Importing this module loads neither simulator nor learner, and not the back end of
the compiler either, which linting does without (15 ms of CPU).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from deepbots_cli import engine_kinds
from deepbots_cli.analysis.shown_units import ShownUnits
from deepbots_cli.compiler import CheckedScenario, check
from deepbots_cli.diagnostics import Finding, Findings
from deepbots_cli.document import Document, Permissions
from deepbots_cli.document.load import NO_DRAFTS, Drafts
from deepbots_cli.errors import BatchError, MissingExtraError, ScenarioError, UsageError
from deepbots_cli.lint import all_findings
from deepbots_cli.program import identity, world_of
from deepbots_cli.records import dataclass
from deepbots_cli.rollout.source import Source, SourceKind
from deepbots_cli.scenario import Scenario

if TYPE_CHECKING:
    from deepbots_cli.port import Engine
    from deepbots_cli.program import Others, Program
    from deepbots_cli.program.world import WorldModel
    from deepbots_cli.runtime import Supervisor
    from deepbots_cli.runtime.batch import BatchEnvironment, BatchSupervisor
    from deepbots_cli.runtime.parallel import ParallelEnvironment
    from deepbots_cli.runtime.spaces import Predictor

MAX_WORLDS = 4096
"""Worlds in a batch; each takes 0.1 to 1 MB of memory."""


@dataclass(frozen=True, eq=False)
class Compiled:
    """A compiled scenario, with everything that a run records of it. `code` and `digest` are computed on
    first use.

    Attributes:
        program: The compiled scenario.
        source: The path of the scenario.
        inputs: The content of every file that was read, by the relative path of its copy in a run; the
            scenario comes first.
        resolved: The merged scenario as YAML, which compiles to the same program next to a folder `inputs`
            with these copies.
        findings: The findings of `lint`: warnings, and internal errors of rules (DB903).
        permissions: The permissions with which it was read.
        fixed: The parameters that no episode draws.
        edited_code: The edited module of a project, which replaces the generated one.
        overrides: The assignments of `--set`.
        learner: The reasons for the learner that deepbots chose, where the scenario names no algorithm.
        document: The merged scenario and its sources.
    """

    program: Program
    source: Path
    inputs: Mapping[str, bytes]
    resolved: str
    findings: tuple[Finding, ...]
    permissions: Permissions = Permissions()
    fixed: tuple[str, ...] = ()
    edited_code: str | None = None
    overrides: tuple[str, ...] = ()
    learner: tuple[str, ...] = ()
    document: Document | None = None

    @cached_property
    def units(self) -> ShownUnits:
        """The units in which the quantities of the scenario are shown."""
        return ShownUnits(None if self.document is None else self.document.root)

    @property
    def code(self) -> str:
        """The Python module that runs."""
        from deepbots_cli.codegen import generate_module

        return generate_module(self.program) if self.edited_code is None else self.edited_code

    @property
    def digest(self) -> str:
        """SHA-256 of the program as canonical JSON, in hexadecimal."""
        return identity.digest(self.program)


def load(
    source: str | Path | Scenario | Source,
    *,
    overrides: Sequence[str] = (),
    permissions: Permissions = Permissions(),
    drafts: Drafts = NO_DRAFTS,
    tests: bool = False,
) -> CheckedScenario:
    """Read and check a scenario; problems are in `.findings`, and nothing is raised for them.

    Args:
        source: A path, the name of a shipped scenario, or a `Scenario`; or an open source, which has its own
            permissions.
        overrides: Assignments `path=value`, as for `--set`.
        permissions: Folders outside the project from which the scenario may read files, and whether it may
            name functions of installed Python packages. These functions run in environments, not in this
            call.
        drafts: Contents to read instead of files, by their absolute paths.
        tests: Whether to read `tests` even if there are `overrides`. By default `tests` are left out then,
            because an override may remove what they name.

    Raises:
        UsageError: The file does not exist.
    """
    opened = source if isinstance(source, Source) else Source.open(source, permissions, SourceKind.SCENARIO)
    return opened.checked(overrides=overrides, drafts=drafts, tests=tests)


def lint(
    source: str | Path | Scenario,
    *,
    overrides: Sequence[str] = (),
    permissions: Permissions = Permissions(),
    preview: bool = False,
) -> list[Finding]:
    """Return all findings of a scenario, sorted and without suppressed ones; findings of rules in preview
    only if `preview` is set.

    Raises:
        UsageError: The file does not exist.
    """
    checked = load(source, overrides=overrides, permissions=permissions)
    try:
        return all_findings(checked, preview=preview)
    finally:
        checked.release_names()


def compile(
    source: str | Path | Scenario | Source | CheckedScenario | Compiled,
    *,
    overrides: Sequence[str] = (),
    permissions: Permissions = Permissions(),
) -> Compiled:
    """Compile a scenario to a program, from which deepbots generates Python. A compiled scenario is returned
    unchanged.

    Raises:
        ScenarioError: The scenario has findings at error level.
        UsageError: The file does not exist.
    """
    if isinstance(source, Compiled):
        return source
    checked = (
        source
        if isinstance(source, CheckedScenario)
        else load(source, overrides=overrides, permissions=permissions)
    )
    findings = all_findings(checked)
    if checked.program is None or any(
        finding.severity == "error" and not finding.is_internal_error for finding in findings
    ):
        raise ScenarioError(findings)
    program = checked.program
    inputs = checked.inputs
    drawn = {entry.name for entry in program.parameters}
    return Compiled(
        program,
        checked.document.path,
        inputs.contents(),
        inputs.resolved(),
        tuple(findings),
        checked.document.permissions,
        tuple(name for name in checked.spec.parameters if name not in drawn) if checked.spec else (),
        overrides=checked.document.overrides,
        learner=checked.learner,
        document=checked.document,
    )


def with_learner(compiled: Compiled) -> Compiled:
    """Return the scenario with the learner that deepbots chooses, if it has no `train` section; otherwise
    unchanged.

    Raises:
        ScenarioError: No algorithm can act in the scenario.
    """
    if compiled.program.agent.training is not None or compiled.document is None:
        return compiled
    trainable = compile(check(replace(compiled.document, findings=Findings()), to_train=True))
    return replace(trainable, findings=compiled.findings, edited_code=compiled.edited_code)


def make(
    source: str | Path | Scenario | CheckedScenario | Compiled | Program,
    *,
    overrides: Sequence[str] = (),
    permissions: Permissions = Permissions(),
    engine: str | None = None,
    render_mode: str | None = None,
) -> Supervisor:
    """Return the Gymnasium environment of a scenario.

    Args:
        engine: `pybullet`, `mujoco`, or an engine of another package. By default the engine of the scenario;
            if it names none, `pybullet`, or the first installed engine with a warning.
        render_mode: None, or `rgb_array`.

    Raises:
        ScenarioError: The scenario has findings at error level.
        UsageError: The file, the engine or the render mode does not exist.
        MissingExtraError: The simulator is not installed.
        EngineError: The engine cannot build this world.
    """
    if isinstance(source, (str, Path, Scenario, CheckedScenario)):
        source = compile(source, overrides=overrides, permissions=permissions)
    if isinstance(source, Compiled):
        allowed = permissions if permissions.code else source.permissions
        return build(
            source.program, engine=engine, render_mode=render_mode, permissions=allowed, fixed=source.fixed
        )
    return build(source, engine=engine, render_mode=render_mode, permissions=permissions)


def parallel_env(
    source: str | Path | Scenario | CheckedScenario | Compiled,
    *,
    overrides: Sequence[str] = (),
    permissions: Permissions = Permissions(),
    engine: str | None = None,
    render_mode: str | None = None,
) -> ParallelEnvironment:
    """Return a scenario with several agents as a `pettingzoo.ParallelEnv`, which steps them together.

    Args:
        engine: As for `make`.
        render_mode: None, `rgb_array`, or `human`: a window shows each step.

    Raises:
        ScenarioError: The scenario has findings at error level.
        UsageError: The scenario has only one agent; use `make`.
        MissingExtraError: PettingZoo is not installed, or matplotlib, which shows the window.
    """
    compiled = compile(source, overrides=overrides, permissions=permissions)
    if not compiled.program.members:
        raise UsageError(f"{compiled.program.name} has only one agent; use deepbots_cli.make")
    try:
        from deepbots_cli.runtime.parallel import HUMAN, RGB_ARRAY, ParallelEnvironment
    except ModuleNotFoundError as error:
        raise MissingExtraError("agents", "an environment of PettingZoo") from error
    of_world = RGB_ARRAY if render_mode == HUMAN else render_mode
    world = make(compiled, permissions=permissions, engine=engine, render_mode=of_world)
    return ParallelEnvironment(world, render_mode)


def make_vec(
    source: str | Path | Scenario | CheckedScenario | Compiled | Program,
    num_envs: int = 256,
    *,
    overrides: Sequence[str] = (),
    permissions: Permissions = Permissions(),
    engine: str = "mujoco",
) -> BatchEnvironment:
    """Return many worlds of a scenario as one `gymnasium.vector.VectorEnv`, stepped together on all cores.

    World i runs the same episodes as an environment of `make` with the seed of world i. When an episode ends,
    the next one begins in the same step (`AutoresetMode.SAME_STEP`): `final_obs` and `final_info` contain its
    last observation and info.

    Call `torch.set_num_threads(1)` before your own loop that trains or acts with torch: networks of this size
    are many times slower on several threads. deepbots does not change the number of threads of your process.

    Args:
        num_envs: Number of worlds, from 1.
        engine: `mujoco` is the only engine with batches of worlds.

    Raises:
        ScenarioError: The scenario has findings at error level.
        BatchError: The scenario or the engine does not support batches; the message gives the reason.
        UsageError: The file does not exist.
        MissingExtraError: The simulator is not installed.
    """
    if isinstance(source, (str, Path, Scenario, CheckedScenario)):
        source = compile(source, overrides=overrides, permissions=permissions)
    program, fixed = (source.program, source.fixed) if isinstance(source, Compiled) else (source, ())
    batch = build_batch(program, num_envs, engine=engine, fixed=fixed)
    from deepbots_cli.runtime.batch import BatchEnvironment

    return BatchEnvironment(batch)


def build_batch(
    program: Program, count: int, *, engine: str = "mujoco", fixed: tuple[str, ...] = ()
) -> BatchSupervisor:
    """Return the supervisor of `count` worlds of a compiled scenario; see `make_vec`."""
    if program.others is None:
        return _build_batch(program, count, engine, fixed, scripts=program.scripted_rivals)
    from deepbots_cli.codegen import batch_obstacles

    if reasons := batch_obstacles(program):
        raise BatchError(f"{program.name} does not fit a batch: {'; '.join(reasons)}")
    world = _build_batch(
        world_of(program, program.others), count, engine, fixed, scripts=program.others.scripts
    )
    from deepbots_cli.runtime.agents import AgentBatch

    # It has the interface of a batch, for one agent.
    return cast("BatchSupervisor", AgentBatch(world, program, _policies_of(program.others)))


def _build_batch(
    program: Program,
    count: int,
    engine: str,
    fixed: tuple[str, ...],
    scripts: tuple[str, ...] = (),
) -> BatchSupervisor:
    """Return the supervisor of `count` worlds, which computes these scripts."""
    if not 1 <= count <= MAX_WORLDS:
        raise UsageError(f"a batch of {count} worlds cannot be made; from 1 to {MAX_WORLDS} are possible")
    try:
        from deepbots_cli import engines
    except ModuleNotFoundError as error:
        raise MissingExtraError("sim", "running a scenario") from error
    from deepbots_cli.codegen import generate_module, load_module
    from deepbots_cli.codegen.names import class_name
    from deepbots_cli.runtime.copies import make_batch

    name = class_name(program.name)
    # The file name is a key of `linecache`, so programs of the same name need different ones.
    mark = identity.digest(program)[:12]
    of_batch = load_module(
        generate_module(program, "batch", scripts),
        f"deepbots_batch_{name}",
        f"<deepbots {name} {mark} batch>",
    )
    of_one = load_module(generate_module(program), f"deepbots_generated_{name}", f"<deepbots {name} {mark}>")
    kinds = vars(of_one)[f"{name}Supervisor"], vars(of_batch)[f"{name}Batch"]
    batch = make_batch(*kinds, program, lambda world: engines.create_batch(engine, world, count))
    for single in batch.singles:
        single.fixed = fixed
    return batch


@dataclass(frozen=True, eq=False, repr=False)
class Builder:
    """A factory of environments of a compiled scenario: for the `spec` of an environment, and for copies in
    another process.

    Its `repr` is the scenario's name and digest; the `repr` of a compiled scenario has tens of thousands of
    characters.
    """

    program: Program
    permissions: Permissions
    fixed: tuple[str, ...]

    def __call__(self, **options: Any) -> Supervisor:
        """Return the environment; `options` are the engine and the render mode."""
        return build(self.program, permissions=self.permissions, fixed=self.fixed, **options)

    def __repr__(self) -> str:
        return f"<deepbots scenario {self.program.name} {identity.digest(self.program)[:12]}>"


def _policies_of(others: Others) -> dict[str, Predictor]:
    """Return the policies that act for agents beside the one that is trained."""
    if not others.models:
        return {}
    from deepbots_cli.plugins import import_attribute

    load = import_attribute("deepbots_cli.learning.policy:load_rival")
    return {name: load(others, name) for name in others.models}


def build(
    program: Program,
    *,
    engine: str | None = None,
    render_mode: str | None = None,
    permissions: Permissions = Permissions(),
    fixed: tuple[str, ...] = (),
    wrap: Callable[[Engine], Engine] | None = None,
) -> Supervisor:
    """Return the environment of a compiled scenario; see `make`.

    Args:
        fixed: The parameters that no episode draws.
        wrap: Replaces the engine of this environment. Copies of the environment in other processes keep the
            original one.
    """
    if program.python_functions and not permissions.code:
        names = ", ".join(map(str, program.python_functions))
        raise UsageError(
            f"{program.name} runs Python code ({names}); allow it with --allow-code"
            " (permissions=Permissions(code=True)) if you trust it"
        )
    try:
        from gymnasium.envs.registration import EnvSpec

        from deepbots_cli import engines
        from deepbots_cli.runtime import make_environment
    except ModuleNotFoundError as error:
        raise MissingExtraError("sim", "running a scenario") from error
    from deepbots_cli.codegen import generate_module, load_module
    from deepbots_cli.codegen.names import class_name

    if program.others is not None:
        from deepbots_cli.runtime.agents import AgentEnvironment

        world = build(
            world_of(program, program.others),
            engine=engine,
            render_mode=render_mode,
            permissions=permissions,
            fixed=fixed,
            wrap=wrap,
        )
        builder = Builder(program, permissions, fixed)
        rebuild = partial(builder, engine=engine, render_mode=render_mode)
        # It has the interface of a supervisor, for one agent.
        return cast("Supervisor", AgentEnvironment(world, program, rebuild, _policies_of(program.others)))
    engine = engine_kinds.chosen(engine or program.engine)
    name = class_name(program.name)
    module = load_module(
        generate_module(program),
        f"deepbots_generated_{name}",
        f"<deepbots {name} {identity.digest(program)[:12]}>",
    )

    def make_engine(world: WorldModel) -> Engine:
        created = engines.create(engine, world)
        return created if wrap is None else wrap(created)

    environment = make_environment(vars(module)[f"{name}Supervisor"], program, make_engine, render_mode)
    environment.fixed = fixed
    builder = Builder(program, permissions, fixed)
    environment.rebuild = partial(builder, engine=engine, render_mode=render_mode)
    environment.spec = EnvSpec(
        f"deepbots/{name}-v1", entry_point=builder, kwargs={"engine": engine, "render_mode": render_mode}
    )
    return environment
