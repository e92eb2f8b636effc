"""docs/results.md and its pictures, from the records alone; what is compiled anew is only compared by its digest."""

from __future__ import annotations

import re
import textwrap
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from statistics import fmean, median
from typing import Any, Literal

from deepbots_cli.learning.run import write_text
from deepbots_cli.learning.statistics import wilson
from tests.results import measure, picture
from tests.results.experiment import Bar, Experiment, Training, told
from tests.results.experiments.not_measured import REASONS
from tests.results.measure import Places
from tests.results.parts import PARTS, Holding, Part

Entry = Mapping[str, Any]
Experiments = Mapping[str, Experiment]
WIDTH = 150
BY_HAND = Path(__file__).parent / "by_hand.md"
"""The last section: bars that no command measures."""

HEAD = """\
# Results

What deepbots reaches, with the commands that produce each figure. `make results` measures what is missing or stale and writes this
page from the records in `docs/results`; no figure in a table is typed by hand, except in [the last section](#measured-by-hand).
[Contributing](../CONTRIBUTING.md) says how one gets here.

Simulated hours are the steps of all copies of the environment times the timestep. A seed is solved when the mean over so many
consecutive episodes, in order of completion, first reaches what the scenario asks for. CPU times are those of all processes of a
training, from the start to the end of the evaluation that `deepbots train` makes; they vary with the machine by a tenth or two, and by
more beside busy neighbors, while ratios and simulated hours do not. A training that was stopped and resumed, which its row says,
began new episodes then: its command in one go gives other figures, as another seed would. The seeds shown, 101 and above, were not used to
choose any figure of a scenario; where earlier ones missed a bar and led to a change, the section says what they had. Held-out
episodes start from seeds that no training uses. Intervals are of 95 %: Wilson's for a share,
Student's for a mean. They tell how well so many episodes show what the trained policies do, and not how another training would turn
out: a row for all seeds puts their episodes together, and the rows above it show how far the seeds are apart. Where a bar stands for
several seeds, the worst counts unless it says otherwise.

Figures of a scenario that has changed since they were measured are marked. A change of deepbots itself is not: what each section has is
of deepbots as it was on the date below it.
"""


# Tables


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> Iterator[str]:
    """The lines of a table in Markdown."""
    yield f"| {' | '.join(head)} |"
    yield "|" + "---|" * len(head)
    for row in rows:
        yield f"| {' | '.join(row)} |"


def wrapped(text: str) -> list[str]:
    """A paragraph in lines of the width of the other pages."""
    return textwrap.wrap(text, WIDTH, break_long_words=False, break_on_hyphens=False)


def number(value: float, digits: int = 4) -> str:
    """`0.2301`, `25 890`, `281 000`."""
    return f"{value:,.0f}".replace(",", " ") if abs(value) >= 10_000 else f"{value:.{digits}g}"


def count(value: int) -> str:
    return f"{value:,}".replace(",", " ") if value >= 10_000 else str(value)


def measured_on(entries: Iterable[Entry]) -> list[str]:
    """When, on what and with which versions; a line for each machine and set of versions."""
    dates: dict[str, list[str]] = {}
    for entry in entries:
        versions = ", ".join(f"{name} {version}" for name, version in entry["versions"].items())
        dates.setdefault(f"{entry['machine']}, {versions}", []).append(entry["date"])
    lines = []
    for circumstances, days in dates.items():
        span = min(days) if min(days) == max(days) else f"{min(days)} to {max(days)}"
        lines += wrapped(f"Measured {span} on {circumstances}.")
    return lines


# Verdicts


@dataclass(frozen=True)
class Verdict:
    """A bar beside what was measured, ready to be put in a table."""

    bar: Bar
    what: str
    asked: str
    measured: str
    status: Literal["met", "missed", "not measured"]

    @property
    def word(self) -> str:
        """Reached or missed; a stretch bar that is not reached is no failure."""
        if self.status == "not measured":
            return self.status
        if self.bar.stretch:
            return "reached" if self.status == "met" else "not reached"
        return "met" if self.status == "met" else "**missed**"


def judge(experiment: Experiment, bar: Bar, record: Entry) -> Verdict:
    """Whether a bar is met: what is asked, and what was measured."""
    figure = bar.figure
    seeds = len(experiment.training(figure.training).seeds) if figure.training else 1
    values, what = figure.values(record), bar.words or figure.words
    limit = bar.at_most if bar.at_most is not None else bar.at_least or 0.0
    whose = "" if seeds == 1 else f", {seeds} of {seeds} seeds" if bar.over == "all" else f", {bar.over} of {seeds} seeds"
    asked = f"{'stretch: ' if bar.stretch else ''}at {'most' if bar.at_most is not None else 'least'} {told(limit, figure.what)}{whose}"
    good = sum(map(bar.holds, values))
    if len(values) < seeds and not (bar.over == "all" and good < len(values)):
        return Verdict(bar, what, asked, f"{len(values)} of {seeds} seeds" if values and seeds > 1 else "", "not measured")
    if bar.over == "all":  # one seed that fails is a miss, however many are still to come
        worst = max(values) if bar.at_most is not None else min(values)
        so_far = f", {len(values)} measured" if len(values) < seeds else ""
        measured = told(worst, figure.what) + (f", the worst; {good} of {seeds} seeds{so_far}" if seeds > 1 else "")
        return Verdict(bar, what, asked, measured, "met" if good == seeds else "missed")
    value = fmean(values) if bar.over == "mean" else median(values)
    return Verdict(bar, what, asked, told(value, figure.what), "met" if bar.holds(value) else "missed")


@dataclass(frozen=True)
class Standing:
    """How an experiment stands: what of its record is asked for, what of that is of another version, and which bars are met.

    `record` holds only what the experiment names: seeds and trainings that it had before may still be in the file.
    """

    experiment: Experiment
    record: Entry

    @classmethod
    def of(cls, experiment: Experiment, record: Entry) -> Standing:
        known = record.get("trainings", {})
        trainings = {
            training.name: {str(seed): known[training.name][str(seed)] for seed in training.seeds if str(seed) in known[training.name]}
            for training in experiment.trainings
            if training.name in known
        }
        names = [baseline.name for baseline in experiment.baselines]
        baselines = {name: entry for name, entry in record.get("baselines", {}).items() if name in names}
        return cls(experiment, {"trainings": trainings, "baselines": baselines})

    def seeds(self, training: Training) -> dict[int, Entry]:
        """What was measured of each seed."""
        known = self.record["trainings"].get(training.name, {})
        return {seed: known[str(seed)] for seed in training.seeds if str(seed) in known}

    def entries(self) -> Iterator[Entry]:
        """Whatever was measured: trainings, evaluations, baselines."""
        for training in self.experiment.trainings:
            for entry in self.seeds(training).values():
                yield entry
                yield from entry["evaluations"].values()
        yield from self.record["baselines"].values()

    def verdicts(self) -> list[Verdict]:
        return [judge(self.experiment, bar, self.record) for bar in self.experiment.bars]

    @cached_property
    def outdated(self) -> tuple[str, ...]:
        """What was measured of an earlier version of the scenario, or by another command than is asked for now."""
        return tuple(self._outdated())

    def _outdated(self) -> Iterator[str]:
        scenario = self.experiment.scenario
        for training in self.experiment.trainings:
            for seed, entry in self.seeds(training).items():
                place = f"seed {seed}" + ("" if training.name == "main" else f" ({training.name})")
                if not measure.asked_training(scenario, training, seed).is_of(entry):
                    yield place
                    continue
                held = [(e, entry["evaluations"][e.name]) for e in training.evaluations if e.name in entry["evaluations"]]
                yield from (f"{e.name} of {place}" for e, known in held if not measure.asked_evaluation(scenario, training, e).is_of(known))
        for baseline in self.experiment.baselines:
            tried = self.record["baselines"].get(baseline.name)
            if tried is not None and not measure.asked_baseline(scenario, baseline).is_of(tried):
                yield baseline.name


# The page


def write(places: Places, experiments: Experiments) -> str:
    """The page, and the pictures whose data have changed; returns how many bars are met, in a sentence."""
    standings, tables = _measured(places, experiments)
    write_text(places.page, page(places, experiments))
    for standing in standings:
        picture.write(standing.experiment, standing.record, places.picture(standing.experiment.name))
    return _headline(standings, tables)


def _measured(places: Places, experiments: Experiments) -> tuple[list[Standing], dict[str, Entry]]:
    standings = [Standing.of(experiment, measure.read(places.record(name))) for name, experiment in experiments.items()]
    return standings, {part.name: measure.read(places.record(part.name)).get("tables", {}) for part in PARTS}


def page(places: Places, experiments: Experiments) -> str:
    standings, tables = _measured(places, experiments)
    lines = [HEAD, "## Summary", "", *_summary(standings, tables), ""]
    for standing in standings:
        lines += _section(standing)
    lines += ["## Not measured", "", *table(("scenario", "why"), [(f"`{name}`", why) for name, why in REASONS.items()]), ""]
    for part in PARTS:
        lines += _lines_of_part(part, tables[part.name])
    lines.append(BY_HAND.read_text("utf-8"))
    return "\n".join(lines).rstrip() + "\n"


def _headline(standings: Sequence[Standing], tables: Mapping[str, Entry]) -> str:
    words = [verdict.word for standing in standings for verdict in standing.verdicts()]
    words += ["met" if met else "**missed**" for part in PARTS for met in _met(tables[part.name])]
    counted = ", ".join(f"{words.count(word)} {word.strip('*')}" for word in ("met", "**missed**", "not measured"))
    reached, measured = words.count("reached"), words.count("reached") + words.count("not reached")
    old = sum(verdict.status != "not measured" for standing in standings if standing.outdated for verdict in standing.verdicts())
    text = f"Of what is asked: {counted}. Of what would be more than that (stretch), {reached} of {measured} measured reached."
    return f"{text} {old} of these verdicts {'is' if old == 1 else 'are'} of an earlier version of a scenario." if old else text


def _met(tables: Entry) -> list[bool]:
    """Of the rows of a part that have bars."""
    return [row["met"] for entry in tables.values() for row in entry["rows"] if row["met"] is not None]


def _summary(standings: Sequence[Standing], tables: Mapping[str, Entry]) -> list[str]:
    rows = []
    for standing in standings:
        note = ", earlier version" if standing.outdated else ""
        for index, verdict in enumerate(standing.verdicts()):
            link = "" if index else _link(standing.experiment.title)
            rows.append((link, verdict.what, verdict.asked, verdict.measured, verdict.word + (note if verdict.measured else "")))
    for part in PARTS:
        met = _met(tables[part.name])
        word = "not measured" if not met else "met" if all(met) else f"**{met.count(False)} missed**"
        rows.append((_link(part.title), f"{len(met)} bars" if met else "", "", f"{sum(met)} of {len(met)}" if met else "", word))
    return [*wrapped(_headline(standings, tables)), "", *table(("scenario", "what", "asked", "measured", ""), rows)]


def _link(title: str) -> str:
    anchor = re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-")
    return f"[{title}](#{anchor})"


def _section(standing: Standing) -> list[str]:
    """The section of a scenario: picture, bars, seeds, held-out episodes, commands."""
    experiment = standing.experiment
    lines = [f"## {experiment.title}", "", *wrapped(experiment.prose), ""]
    if experiment.paper:
        lines += [*wrapped(experiment.paper), ""]
    measured = list(standing.entries())
    if not measured:
        return [*lines, "Not measured yet.", ""]
    if standing.outdated:
        lines += [*wrapped(f"**Measured on an earlier version of the scenario or of the experiment:** {', '.join(standing.outdated)}."), ""]
    if any(standing.record["trainings"].values()):
        lines += [f"![Learning curves of {experiment.title}](images/results/{experiment.name}.svg)", ""]
    rows = [(verdict.what, verdict.asked, verdict.measured, verdict.word) for verdict in standing.verdicts()]
    lines += [*table(("what", "asked", "measured", ""), rows), ""]
    for training in experiment.trainings:
        lines += _seeds(standing, training)
    lines += _episodes(standing)
    return [*lines, f"`make results SCENARIO={experiment.name}`", "", *measured_on(measured), ""]


def _seeds(standing: Standing, training: Training) -> list[str]:
    """A row for each seed, and for each stage of its curriculum."""
    command = measure.asked_training(standing.experiment.scenario, training, "N").command
    seeds = standing.seeds(training)
    head = ("seed", "solved after", "simulated hours", "trained for", "simulated hours", "CPU")
    rows = []
    for seed, entry in seeds.items():
        solved, resumed = entry["solved_at"], entry["times_resumed"]
        after = (_counts(solved["steps"], solved["episode"]), number(solved["simulated_hours"], 3)) if solved else ("not solved", "")
        cpu = f"{number(entry['cpu_seconds'], 3)} s" + (f", resumed {'once' if resumed == 1 else f'{resumed} times'}" if resumed else "")
        rows.append((str(seed), *after, _counts(entry["steps"], entry["episodes"]), number(entry["simulated_hours"], 3), cpu))
    lines = [*wrapped(f"`{command}`{training.words and f': {training.words}'}"), "", *table(head, rows), ""]
    stages = [
        (str(seed), f"`{end['name']}`", _counts(end["steps"], end["episodes"]), number(end["simulated_hours"], 3))
        for seed, entry in seeds.items()
        for end in entry["stages"]
    ]
    if stages:
        ends = ", ".join(f"seed {seed} in `{entry['stage']}`" for seed, entry in seeds.items())
        lines += [*table(("seed", "stage", "done after", "simulated hours"), stages), "", f"The training ended in the stage: {ends}.", ""]
    return lines


def _counts(steps: int, episodes: int) -> str:
    return f"{count(steps)} steps, {count(episodes)} episodes"


def _episodes(standing: Standing) -> list[str]:
    """A row for each evaluation or case and seed, and for each baseline; then the commands, each once."""
    rows: list[tuple[str, ...]] = []
    for training in standing.experiment.trainings:
        for evaluation in training.evaluations:
            seeds = standing.seeds(training).items()
            held = {seed: entry["evaluations"][evaluation.name] for seed, entry in seeds if evaluation.name in entry["evaluations"]}
            name = ("" if training.name == "main" else f"{training.name}: ") + (evaluation.words or evaluation.name.replace("_", " "))
            rows += _held(name, held)
            for case in dict.fromkeys(case for entry in held.values() for case in entry["cases"]):
                known = {seed: entry["cases"][case] for seed, entry in held.items() if case in entry["cases"]}
                rows += _held(f"{name}, `{case}`", known)
    tried = standing.record["baselines"]
    for baseline in standing.experiment.baselines:
        if baseline.name in tried:
            rows.append((baseline.words or baseline.name.replace("_", " "), "", *_outcome(tried[baseline.name])))
    if not rows:
        return []
    known = [entry for entry in standing.entries() if "episodes" in entry and "evaluations" not in entry]
    commands = ", ".join(dict.fromkeys(f"`{entry['command']}`" for entry in known))
    head = ("episodes", "seed", "number", "succeed", "mean return", "worst, best", "ended by")
    return [*table(head, rows), "", *wrapped(f"{commands}; RUN is the directory that the training made."), ""]


def _held(name: str, held: Mapping[int, Entry]) -> Iterator[tuple[str, ...]]:
    """A row for each seed; of several, one for all of their episodes together."""
    for seed, entry in held.items():
        yield (name, str(seed), *_outcome(entry))
    if len(held) > 1:
        entries = held.values()
        successes, episodes = sum(entry["successes"] or 0 for entry in entries), sum(entry["episodes"] for entry in entries)
        together = {
            "episodes": episodes,
            "success_defined": next(iter(entries))["success_defined"],
            "success_rate": successes / episodes,
            "success_interval": wilson(successes, episodes),
            "mean_return": sum(entry["mean_return"] * entry["episodes"] for entry in entries) / episodes,
            "return_interval": None,
            "least_return": min(entry["least_return"] for entry in entries),
            "greatest_return": max(entry["greatest_return"] for entry in entries),
            "endings": sum((Counter(entry["endings"]) for entry in entries), Counter()),
        }
        yield (name, "all", *_outcome(together))


def _outcome(result: Entry) -> tuple[str, ...]:
    mean = number(result["mean_return"])
    if result["return_interval"] is not None and result["least_return"] != result["greatest_return"]:
        low, high = result["return_interval"]
        mean += f" ({number(low)} .. {number(high)})"
    share = ""
    if result["success_defined"]:
        low, high = result["success_interval"]
        share = f"{result['success_rate']:.1%} ({low:.1%} .. {high:.1%})".replace("%", " %")
    endings = ", ".join(f"{name} {times}" for name, times in result["endings"].items())
    return str(result["episodes"]), share, mean, f"{number(result['least_return'])}, {number(result['greatest_return'])}", endings


def _lines_of_part(part: Part, measured: Entry) -> list[str]:
    lines = [f"## {part.title}", "", part.prose, ""]
    known = [(entry, row) for name in part.tables if (entry := measured.get(name.name)) for row in entry["rows"]]
    if all(isinstance(table, Holding) for table in part.tables):
        rows = [(row["what"], _passed(row), f"`{entry['command']}`") for entry, row in known]
        lines += table(("what", part.figure, "command"), rows)
    else:
        words = {None: "", True: "yes", False: "**no**"}
        rows_of_bars = [
            (row["what"], row["bar_words"].rstrip(), f"{_value(row['measured'])} {row['unit']}".rstrip(), words[row["met"]])
            for _, row in known
        ]
        lines += table(("what", "bar", part.figure, "met"), rows_of_bars)
        lines += ["", *wrapped(", ".join(f"`{entry['command']}`" for entry in measured.values()))]
    if missing := [entry.command for entry in part.tables if entry.name not in measured]:
        lines += ["", *wrapped(f"Not measured: {', '.join(f'`{command}`' for command in missing)}.")]
    return [*lines, "", f"`make results PART={part.name}`", "", *measured_on(measured.values()), ""]


def _value(value: float) -> str:
    """Counts are exact, other figures have three digits."""
    return count(int(value)) if value == int(value) else number(value, 3)


def _passed(row: Entry) -> str:
    failed = row["failed"] + row.get("error", 0)
    return f"{row['passed']} passed" + (f", **{failed} failed**" if failed else "")
