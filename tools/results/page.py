"""The page docs/results.md, and the pages of measurements that only the site has, from the records alone.

What is compiled anew is only compared by its digest.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence

from deepbots_cli.learning.runs.directories import write_text
from deepbots_cli.words import number_text
from tools.benchmarks import robot_files
from tools.results import benchmark, benchmark_page, measure, physics_page, picture
from tools.results.card import (
    NOTE,
    measured_on,
    outcome,
    table,
    wrapped,
)
from tools.results.experiment import Experiment, Held
from tools.results.experiments.not_measured import REASONS
from tools.results.measure import ROOT, Places
from tools.results.parts import PARTS, Holding, Part
from tools.results.standing import Entry, Headline, Standing, quartiles

Experiments = Mapping[str, Experiment]

HEAD = """\
# Results

Trained policies beside those of the [paper](https://doi.org/10.1007/978-3-030-49186-4_6). On the site, names link to
seeds, curves and commands.

## Beside the paper
"""
BESIDE = """\
Solved: [new starts confirm it](judging.md); in the paper, training episodes did."""
OTHERS = """\
## Other scenarios

Success, or mean return (without %), held out; median CPU of trainings.
"""
METHOD = """\
## Method

- **Seeds** that are reported, from 101 on, chose nothing.
- **Held-out episodes** have their own seeds.
- [**Intervals**](statistics.md) of 95 % are over episodes of all seeds, and leave out how trainings differ.
- **Simulated hours** count all environments.
- **CPU** covers training and evaluation on two cores, ± a fifth.\
"""


# All pages


def write(places: Places, experiments: Experiments) -> str:
    """Write the page, and the pictures whose data have changed; returns how many bars are met, in a
    sentence."""
    write_text(places.page, results(places, experiments))
    standings, tables = _measured(places, experiments)
    for standing in standings:
        picture.write(standing.experiment, standing.record, places.picture(standing.experiment.name))
    return _bars(standings, tables)


def built(places: Places, experiments: Experiments) -> dict[str, str]:
    """Return the pages that only the site has, by their path in the repository; nothing of them is
    committed."""
    _, tables = _measured(places, experiments)
    return {
        "docs/reference/measurements.md": _measurements(tables),
        "docs/benchmark.md": benchmark_page.page(places, benchmark.TASKS),
        **{page: fill((ROOT / page).read_text(encoding="utf-8")) for page, fill in _filled(tables)},
    }


def _filled(tables: Mapping[str, Entry]) -> Iterator[tuple[str, Callable[[str], str]]]:
    """Yield the pages whose tables only the site has."""
    yield "docs/engines.md", lambda text: physics_page.filled(text, tables["physics"])
    yield "docs/robots.md", robot_files.filled


def _measured(places: Places, experiments: Experiments) -> tuple[list[Standing], dict[str, Entry]]:
    standings = [
        Standing.of(experiment, measure.read(places.record(name))) for name, experiment in experiments.items()
    ]
    return standings, {part.name: measure.read(places.record(part.name)).get("tables", {}) for part in PARTS}


# The page of results


def results(places: Places, experiments: Experiments) -> str:
    """Return the text of docs/results.md."""
    standings, _ = _measured(places, experiments)
    lines = [
        HEAD,
        *table(("task", "figure", "paper", "median", "quartiles", "worst", "seeds"), _beside(standings)),
        "",
        BESIDE,
        "",
        OTHERS,
    ]
    lines += [
        *table(("scenario", "result", "random", "seeds", "CPU, s"), _others(standings)),
        "",
        *_unmeasured(standings),
        METHOD,
    ]
    return "\n".join(lines) + "\n"


def _beside(standings: Sequence[Standing]) -> Iterator[tuple[str, ...]]:
    for standing in standings:
        link = _link(standing.experiment)
        for row in standing.experiment.beside if standing.record["trainings"] else ():
            values = row.figure.values(standing.record)
            if not values:
                continue
            low, middle, high = quartiles(values)
            worst = min(values) if isinstance(row.figure, Held) else max(values)
            texts = [_figure(value, row.figure.what) for value in (middle, low, high, worst)]
            yield (
                link,
                row.words,
                row.paper,
                texts[0],
                f"{texts[1]} .. {texts[2]}",
                texts[3],
                str(len(values)),
            )
            link = ""


def _figure(value: float, what: str) -> str:
    if math.isinf(value):
        return "never"
    return f"{100 * value:.1f}".removesuffix(".0") + " %" if what == "success_rate" else number_text(value, 3)


def _others(standings: Sequence[Standing]) -> Iterator[tuple[str, ...]]:
    for standing in standings:
        experiment = standing.experiment
        link = _link(experiment) + (f", `{experiment.case}`" if experiment.case else "")
        headline = Headline.of(standing)
        if headline and not experiment.beside:
            random = outcome(headline.random).partition(" (")[0] if headline.random else ""
            yield (
                link,
                outcome(headline.held),
                random,
                str(headline.seeds),
                number_text(headline.cpu_seconds, 3),
            )


def _unmeasured(standings: Sequence[Standing]) -> Iterator[str]:
    names = [_link(standing.experiment) for standing in standings if Headline.of(standing) is None]
    by_matches = [f"[`{name}`](scenarios/{name}.md)" for name in REASONS]
    text = f"Match-ups: {', '.join(by_matches)}."
    if names:
        text = f"Not measured: {', '.join(names)}. {text}"
    yield from (*wrapped(text), "")


def _link(experiment: Experiment) -> str:
    return f"[{experiment.title}]({_page_of(experiment.scenario)})"


def _page_of(scenario: str) -> str:
    """Return the page about a scenario, or about the one that it extends: its results are there on the
    site."""
    path = ROOT / "scenarios" / f"{scenario}.yaml"
    text = path.read_text(encoding="utf-8") if path.is_file() else ""  # a test has a scenario of its own
    extended = re.search(r"^extends: (\w+)", text, re.MULTILINE)
    page = f"scenarios/{extended[1] if extended else scenario}.md"
    return page if (ROOT / "docs" / page).is_file() else "worlds.md"


def _bars(standings: Sequence[Standing], tables: Mapping[str, Entry]) -> str:
    """Return how many bars are met, and which scenarios and parts miss one."""
    words: Counter[str] = Counter()
    missed = []
    for standing in standings:
        verdicts = [verdict.word for verdict in standing.verdicts()]
        words.update(verdicts)
        missed += [standing.experiment.title] * ("**missed**" in verdicts)
    for part in PARTS:
        met = [
            row["met"]
            for entry in tables[part.name].values()
            for row in entry["rows"]
            if row["met"] is not None
        ]
        words.update("met" if one else "**missed**" for one in met)
        missed += [part.title] * (not all(met))
    where = f" ({', '.join(missed)})" if missed else ""
    text = f"{words['met']} met, {words['**missed**']} missed{where}, {words['not measured']} not measured; "
    text += f"of {words['reached'] + words['not reached']} further goals, {words['reached']} reached."
    old = sum(
        verdict.status != "not measured"
        for standing in standings
        if standing.outdated
        for verdict in standing.verdicts()
    )
    return (
        f"{text} {old} of these verdicts {'is' if old == 1 else 'are'} of an earlier version of a scenario."
        if old
        else text
    )


# The page of measurements


def _measurements(tables: Mapping[str, Entry]) -> str:
    intro = (
        "Costs, errors and findings of deepbots, measured by the commands below each table."
        " [Results](../results.md) has the trainings."
    )
    lines = [NOTE, "", "# Measurements", "", *wrapped(intro), ""]
    for part in PARTS:
        if not part.page:
            lines += _lines_of_part(part, tables[part.name])
    return "\n".join(lines).rstrip() + "\n"


def _lines_of_part(part: Part, measured: Entry) -> list[str]:
    lines = [f"## {part.title}", "", part.prose, ""]
    entries = [
        (entry, row) for name in part.tables if (entry := measured.get(name.name)) for row in entry["rows"]
    ]
    if all(isinstance(table, Holding) for table in part.tables):
        lines += table(
            ("what", "measured", "command"),
            [(row["what"], _passed(row), f"`{entry['command']}`") for entry, row in entries],
        )
    else:
        lines += table(
            ("what", "measured"),
            [(row["what"], f"{_value(row['measured'])} {row['unit']}".rstrip()) for _, row in entries],
        )
        lines += ["", *wrapped(", ".join(f"`{entry['command']}`" for entry in measured.values()))]
    if missing := [entry.command for entry in part.tables if entry.name not in measured]:
        lines += ["", *wrapped(f"Not measured: {', '.join(f'`{command}`' for command in missing)}.")]
    return [*lines, "", f"`make results PART={part.name}`", "", *measured_on(measured.values()), ""]


def _value(value: float) -> str:
    """Counts are exact, other figures have three digits."""
    return f"{int(value):,}" if value == int(value) else number_text(value, 3)


def _passed(row: Entry) -> str:
    failed = row["failed"] + row.get("error", 0)
    return f"{row['passed']} passed" + (f", **{failed} failed**" if failed else "")
