"""docs/results.md and its pictures, from the records alone; what is compiled anew is only compared by its digest."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

from deepbots_cli.learning.run import write_text
from tests.results import picture, records
from tests.results.catalogue import reasons
from tests.results.experiment import Experiment
from tests.results.parts import PARTS, Holding, Part
from tests.results.places import Places
from tests.results.section import lines_of
from tests.results.standing import Standing
from tests.results.tables import count, measured_on, number, table, wrapped

Experiments = Mapping[str, Experiment]
Tables = Mapping[str, Mapping[str, Any]]
"""What was measured of each part."""

HEAD = """\
# Results

What deepbots reaches, with the commands that produce each figure. `make results` measures what is missing or stale and writes this
page from the records in `docs/results`; no figure in a table is typed by hand. [Contributing](../CONTRIBUTING.md) says how one gets here.

Simulated hours are the steps of all copies of the environment times the timestep. A seed is solved when the mean over so many
consecutive episodes, in order of completion, first reaches what the scenario asks for. CPU times are those of all processes of a
training, from the start to the end of the evaluation that `deepbots train` makes; they vary with the machine by a tenth or two, and by
more beside busy neighbours, while ratios and simulated hours do not. A training that was stopped and resumed, which its row says,
began new episodes then: its command in one go gives other figures, as another seed would. The seeds shown, from 101, were not used to
choose any figure of a scenario; where earlier ones missed a bar and led to a change, the section says what they had. Held-out
episodes start from seeds that no training uses. Intervals are of 95 %: Wilson's for a share,
Student's for a mean. They tell how well so many episodes show what the trained policies do, and not how another training would turn
out: a row for all seeds puts their episodes together, and the rows above it show how far the seeds are apart. Where a bar stands for
several seeds, the worst counts unless it says otherwise.

Figures of a scenario that has changed since they were measured are marked. A change of deepbots itself is not: what each section has is
of deepbots as it was on the date below it.
"""


def write(places: Places, experiments: Experiments) -> str:
    """The page, and the pictures whose data have changed; returns how many bars are met, in a sentence."""
    standings, tables = _measured(places, experiments)
    write_text(places.page, page(places, experiments))
    for standing in standings:
        picture.write(standing, places.picture(standing.experiment.name))
    return _headline(standings, tables)


def _measured(places: Places, experiments: Experiments) -> tuple[list[Standing], Tables]:
    standings = [Standing.of(experiment, records.read(places.record(name))) for name, experiment in experiments.items()]
    return standings, {part.name: records.read(places.record(part.name)).get("tables", {}) for part in PARTS}


def page(places: Places, experiments: Experiments) -> str:
    standings, tables = _measured(places, experiments)
    lines = [HEAD, "## Summary", "", *_summary(standings, tables), ""]
    for standing in standings:
        lines += lines_of(standing)
    lines += ["## Not measured", "", *table(("scenario", "why"), [(f"`{name}`", why) for name, why in reasons().items()]), ""]
    for part in PARTS:
        lines += _lines_of_part(part, tables[part.name])
    return "\n".join(lines).rstrip() + "\n"


def _headline(standings: Sequence[Standing], tables: Tables) -> str:
    words = [verdict.word for standing in standings for verdict in standing.verdicts()]
    words += ["met" if met else "**missed**" for part in PARTS for met in _met(tables[part.name])]
    counted = ", ".join(f"{words.count(word)} {word.strip('*')}" for word in ("met", "**missed**", "not measured"))
    reached, measured = words.count("reached"), words.count("reached") + words.count("not reached")
    old = sum(verdict.status != "not measured" for standing in standings if any(standing.outdated()) for verdict in standing.verdicts())
    told = f"Of what is asked: {counted}. Of what would be more than that (stretch), {reached} of {measured} measured reached."
    return f"{told} {old} of these verdicts {'is' if old == 1 else 'are'} of an earlier version of a scenario." if old else told


def _met(tables: Mapping[str, Any]) -> list[bool]:
    """Of the rows of a part that have bars."""
    return [row["met"] for entry in tables.values() for row in entry["rows"] if row["met"] is not None]


def _summary(standings: Sequence[Standing], tables: Tables) -> list[str]:
    rows = []
    for standing in standings:
        note = ", earlier version" if any(standing.outdated()) else ""
        for index, verdict in enumerate(standing.verdicts()):
            link = "" if index else _link(standing.experiment.title)
            rows.append((link, verdict.what, verdict.asked, verdict.measured, verdict.word + (note if verdict.measured else "")))
    for part in PARTS:
        met = _met(tables[part.name])
        word = "not measured" if not met else "met" if all(met) else f"**{met.count(False)} missed**"
        rows.append((_link(part.title), f"{len(met)} bars" if met else "", "", f"{sum(met)} of {len(met)}" if met else "", word))
    head = wrapped(_headline(standings, tables))
    return [*head, "", *table(("scenario", "what", "asked", "measured", ""), rows)]


def _link(title: str) -> str:
    anchor = re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-")
    return f"[{title}](#{anchor})"


def _lines_of_part(part: Part, measured: Mapping[str, Any]) -> list[str]:
    lines = [f"## {part.title}", "", part.prose, ""]
    known = [(entry, row) for name in part.tables if (entry := measured.get(name.name)) for row in entry["rows"]]
    if all(isinstance(table, Holding) for table in part.tables):
        rows = [(row["what"], _counted(row), f"`{entry['command']}`") for entry, row in known]
        lines += table(("what", part.figure, "command"), rows)
    else:
        rows = [(row["what"], row["bar_words"].rstrip(), f"{_figure(row)} {row['unit']}".rstrip(), _verdict(row)) for _, row in known]
        lines += table(("what", "bar", part.figure, "met"), rows)
        lines += ["", *wrapped(", ".join(f"`{entry['command']}`" for entry in measured.values()))]
    if missing := [entry.command for entry in part.tables if entry.name not in measured]:
        lines += ["", *wrapped(f"Not measured: {', '.join(f'`{command}`' for command in missing)}.")]
    return [*lines, "", f"`make results PART={part.name}`", "", *measured_on(measured.values()), ""]


def _figure(row: Mapping[str, Any]) -> str:
    """Counts are exact, other figures have three digits."""
    value = row["measured"]
    return count(int(value)) if value == int(value) else number(value, 3)


def _verdict(row: Mapping[str, Any]) -> str:
    return {None: "", True: "yes", False: "**no**"}[row["met"]]


def _counted(row: Mapping[str, Any]) -> str:
    failed = row["failed"] + row.get("error", 0)
    return f"{row['passed']} passed" + (f", **{failed} failed**" if failed else "")
