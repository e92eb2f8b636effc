"""`deepbots test`: the tests of scenarios."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from shlex import quote
from typing import Annotated, Any, NamedTuple

import typer

from deepbots_cli import api
from deepbots_cli.cli import processes, terminal
from deepbots_cli.cli.command import ClusterAddress, Engine, Force, Json, Overrides, Workers, option
from deepbots_cli.cli.exits import FAILED
from deepbots_cli.cli.sources import scenario_names
from deepbots_cli.cli.tables import Row, table
from deepbots_cli.diagnostics import Finding
from deepbots_cli.diagnostics.junit import Case, xml_report
from deepbots_cli.document import Permissions
from deepbots_cli.engine_kinds import with_engine
from deepbots_cli.errors import ScenarioError, UsageError
from deepbots_cli.files import atomic_write, check_output
from deepbots_cli.learning.executor import Attempt, results
from deepbots_cli.learning.scenario_tests import TestResult, UnmetExpectation, run_tests
from deepbots_cli.lint.settings import settings
from deepbots_cli.program.task import ScenarioTest
from deepbots_cli.runtime.streams import derive_seed
from deepbots_cli.words import counted


@dataclass(frozen=True)
class _ScenarioResults:
    """The results of one scenario with its `warnings`; with errors in its file there are `findings`
    instead."""

    scenario: str
    results: tuple[TestResult, ...] = ()
    findings: tuple[Finding, ...] = ()
    warnings: tuple[Finding, ...] = ()

    @property
    def passed(self) -> bool:
        return not self.findings and all(result.passed for result in self.results)


def command(
    scenarios: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="SCENARIO",
            help="Scenario files, names of shipped scenarios, or folders; by default this folder.",
        ),
    ] = None,
    only: Annotated[
        str | None, option("-k NAME", "Run only the tests whose names contain this text.")
    ] = None,
    overrides: Overrides = None,
    engine: Engine = None,
    junit: Annotated[Path | None, option("--junit FILE", "Write the results as JUnit XML.")] = None,
    force: Force = False,
    workers: Workers = None,
    address: ClusterAddress = None,
    as_json: Json = False,
    permissions: Permissions = Permissions(),
) -> None:
    """Run the tests of scenarios."""
    if junit is not None:
        check_output(junit, force=force)
    began = time.perf_counter()
    names = scenario_names(scenarios or ["."], settings())
    options: dict[str, Any] = {
        "overrides": with_engine(overrides, engine),
        "permissions": permissions,
        "tests": True,
    }
    added = [f"--engine {engine}"] if engine else []
    added += [f"--set {quote(text)}" for text in overrides or ()]
    processes.check_dividable(
        workers, address, len(names), "there is one scenario; name several, or a folder"
    )
    scenario_results = []
    calls = [_Scenario(name, only, engine, options) for name in names]
    files = [Path(name) for name in names if Path(name).is_file()]
    with processes.executor(workers, address, len(names)) as executor:
        for tested in results(executor.map(_tested, calls, files=files)):
            scenario_results.append(tested)
            terminal.note_warnings(tested.warnings, tested.scenario)
            if not as_json:
                _show(tested, added)
    if not any(tested.results or tested.findings for tested in scenario_results):
        missing = "under `tests`" if only is None else f"whose name contains '{only}'"
        raise UsageError(
            f"there is no test {missing} in {', '.join(names[:5])}{' ...' if len(names) > 5 else ''}"
        )
    if as_json:
        terminal.show_json(
            {
                "passed": all(tested.passed for tested in scenario_results),
                "scenarios": [_data(tested, added) for tested in scenario_results],
            }
        )
    else:
        _sum_up(scenario_results, time.perf_counter() - began)
    if junit is not None:
        suites = {
            tested.scenario: _junit(tested)
            for tested in scenario_results
            if tested.results or tested.findings
        }
        with atomic_write(junit) as draft:
            draft.write_bytes(xml_report(suites, prefix="deepbots test ").encode())
    if not all(tested.passed for tested in scenario_results):
        raise typer.Exit(FAILED)


class _Scenario(NamedTuple):
    """A scenario to be tested: its tests whose names contain `only`, and the options for loading it."""

    name: str
    only: str | None
    engine: str | None
    options: dict[str, Any]


def _tested(scenario: _Scenario, attempt: Attempt) -> _ScenarioResults:
    name, only, engine, options = scenario
    checked = api.load(name, **options)
    try:
        compiled = api.compile(checked)
    except ScenarioError as error:
        return _ScenarioResults(name, findings=tuple(error.findings))
    tests = [test for test in checked.tests if only is None or only in test.name]
    with terminal.progress(f"episodes of {name}", always=False) as show:
        test_results = run_tests(
            compiled.program, tests, engine=engine, permissions=compiled.permissions, on_episode=show
        )
        in_order = tuple(sorted(test_results, key=lambda result: tests.index(result.test)))
    return _ScenarioResults(name, in_order, warnings=tuple(compiled.findings) if tests else ())


def _show(tested: _ScenarioResults, options: Sequence[str]) -> None:
    if tested.findings:
        terminal.show_findings(tested.findings)
        terminal.print_result(f"{tested.scenario}: not tested, because the file has errors\n")
    elif tested.results:
        terminal.print_result(f"{tested.scenario}\n{table([_row(result) for result in tested.results])}")
        for result in tested.results:
            if not result.passed:
                terminal.print_result(f"\n  FAILED {result.test.name} ({result.test.span.location})")
            for unmet in result.unmet:
                terminal.print_result(
                    f"    expected  {unmet.expected} ({unmet.where})\n    measured  {unmet.measured}"
                )
                terminal.print_result(f"    show it   {_command(tested.scenario, result, unmet, options)}")
        terminal.print_result()


def _row(result: TestResult) -> Row:
    numbers = {"episodes": result.episodes, "steps": result.steps, "seconds": f"{result.seconds:.2f}"}
    return {"test": result.test.name, "result": "passed" if result.passed else "FAILED", **numbers}


def _command(scenario: str, result: TestResult, unmet: UnmetExpectation, options: Sequence[str]) -> str:
    """Return the command that shows the episode of an unmet expectation, with the options of this one."""
    test = result.test
    episode = unmet.episode
    settings = [f"--{word} {value}" for word, value in (("case", test.case), ("stage", test.stage)) if value]
    where = " ".join([quote(scenario), *settings, *options, *_acting_options(test)])
    if isinstance(test.driver, str):
        return f"deepbots view {where} --driver {test.driver} --seed {test.seed} --episode {episode}"
    actions = ",".join(action.text for action in test.driver)
    seed = derive_seed(test.seed, "evaluation", episode)
    # An action may begin with a minus, which without the equals sign would make it an option.
    return f"deepbots try {where} --driver={actions} --steps {len(test.driver)} --episodes 1 --seed {seed}"


def _acting_options(test: ScenarioTest) -> list[str]:
    """Return the options that let the other agents act as in a test of several agents."""
    if not test.drivers:
        return []
    options = [f"--against {name}={driver}" for name, driver in test.drivers.items() if name != test.agent]
    return [f"--agent {test.agent}", *options]


def _sum_up(scenario_results: Sequence[_ScenarioResults], seconds: float) -> None:
    test_results = [result for tested in scenario_results for result in tested.results]
    failed, broken = (
        sum(not result.passed for result in test_results),
        sum(bool(tested.findings) for tested in scenario_results),
    )
    untested = [tested.scenario for tested in scenario_results if not tested.results and not tested.findings]
    if untested:
        terminal.note(
            f"no tests in {', '.join(untested[:5])}"
            + (f" and {len(untested) - 5} more" if len(untested) > 5 else "")
        )
    words = [f"{len(test_results) - failed} passed"]
    if failed:
        words.append(f"{failed} failed")
    if broken:
        words.append(f"{counted(broken, 'scenario')} with errors")
    terminal.print_result(f"{', '.join(words)} in {seconds:.1f} s")


def _junit(tested: _ScenarioResults) -> Iterator[Case]:
    yield from (
        Case("the scenario has no errors", finding.headline, finding.headline)
        for finding in tested.findings[:1]
    )
    for result in tested.results:
        reason = "; ".join(f"{unmet.expected} ({unmet.where}): {unmet.measured}" for unmet in result.unmet)
        fault = "" if result.passed else f"not met: {result.test.name} ({reason})"
        yield Case(result.test.name, reason, fault, attributes={"time": f"{result.seconds:.3f}"})


def _data(tested: _ScenarioResults, options: Sequence[str]) -> dict[str, Any]:
    tests = [
        {
            "test": result.test.name,
            "where": result.test.span.location,
            **{key: getattr(result.test, key) for key in ("case", "stage", "seed")},
            **{key: getattr(result, key) for key in ("passed", "episodes", "steps", "seconds")},
            "misses": [
                asdict(unmet) | {"command": _command(tested.scenario, result, unmet, options)}
                for unmet in result.unmet
            ],
        }
        for result in tested.results
    ]
    errors = [
        {"code": finding.code, "where": finding.span.location, "headline": finding.headline}
        for finding in tested.findings
    ]
    return {"scenario": tested.scenario, "passed": tested.passed, "tests": tests, "findings": errors}
