"""The card of an experiment, as Markdown: its main result, curves, bars, seeds, held-out episodes and
commands."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterable, Iterator, Mapping, Sequence

from deepbots_cli.words import number_text
from tools.results import measure
from tools.results.experiment import Training
from tools.results.standing import Entry, Headline, Standing, together

WIDTH = 150
NOTE = "<!-- Written by `python -m tools.results --render`. -->"


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> Iterator[str]:
    """The lines of a table in Markdown."""
    yield f"| {' | '.join(head)} |"
    yield "|" + "---|" * len(head)
    for row in rows:
        yield f"| {' | '.join(row)} |"


def wrapped(text: str, indent: str = "") -> list[str]:
    """A paragraph in lines of the width of the other pages."""
    return textwrap.wrap(
        text, WIDTH, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False
    )


def slug(text: str) -> str:
    """The anchor of a heading."""
    return re.sub(r"[^\w\- ]", "", text.lower()).replace(" ", "-")


def share(entry: Entry) -> str:
    """`99.2 % (98.9 .. 99.4)`."""
    rate, low, high = (
        f"{100 * value:.1f}".removesuffix(".0")
        for value in (entry["success_rate"], *entry["success_interval"])
    )
    return f"{rate} % ({low} .. {high})"


def mean_return(entry: Entry) -> str:
    """`33.38 (31.5 .. 35.26)`; equal returns have no interval."""
    if entry["return_interval"] is None or entry["least_return"] == entry["greatest_return"]:
        return number_text(entry["mean_return"])
    low, high = entry["return_interval"]
    return f"{number_text(entry['mean_return'])} ({number_text(low)} .. {number_text(high)})"


def outcome(entry: Entry) -> str:
    """The share of successes, or the mean return where success is not defined."""
    return share(entry) if entry["success_defined"] else mean_return(entry)


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


# The card


def card(standing: Standing) -> str:
    experiment = standing.experiment
    title = [NOTE, "", f"# Results of {experiment.title}", ""]
    measured = list(standing.entries())
    prose = [line for text in (experiment.prose, experiment.paper) if text for line in (*wrapped(text), "")]
    if not measured:
        return "\n".join([*title, "Not measured yet.", "", *prose]).rstrip() + "\n"
    lines = [*title, *_headline(standing), *prose]
    if standing.outdated:
        lines += [
            *wrapped(
                "**Measured on an earlier version of the scenario or of the experiment:**"
                f" {', '.join(standing.outdated)}."
            ),
            "",
        ]
    if any(standing.record["trainings"].values()):
        lines += [f"![Learning curves of {experiment.title}](../images/results/{experiment.name}.svg)", ""]
    lines += [
        *table(("figure", "measured"), [(verdict.what, verdict.measured) for verdict in standing.verdicts()]),
        "",
    ]
    for training in experiment.trainings:
        lines += _seeds(standing, training)
    lines += _episodes(standing)
    lines += [
        "RUN is the directory that a training makes, and N a seed:",
        "",
        "```console",
        *(f"$ {command}" for command in (*_commands(standing), f"make results SCENARIO={experiment.name}")),
        "```",
        "",
    ]
    return (
        "\n".join(
            [
                *lines,
                *measured_on(measured),
                "",
                "[Method](../results.md#method), [all scenarios](../worlds.md).",
            ]
        )
        + "\n"
    )


def _headline(standing: Standing) -> Iterator[str]:
    """A table of a single row."""
    headline = Headline.of(standing)
    if headline:
        what = "success" if headline.held["success_defined"] else "mean return"
        case = f", case `{standing.experiment.case}`" if standing.experiment.case else ""
        head = [
            f"{what} in {headline.held['episodes']:,} held-out episodes{case}",
            "seeds",
            "simulated hours",
            "CPU of a training",
        ]
        row = [
            f"**{outcome(headline.held)}**",
            str(headline.seeds),
            number_text(headline.simulated_hours, 3),
            f"{number_text(headline.cpu_seconds, 3)} s",
        ]
        if headline.random:
            head[1:1], row[1:1] = ["random policy"], [outcome(headline.random)]
        yield from (*table(head, [row]), "")


def _seeds(standing: Standing, training: Training) -> list[str]:
    """A row for each seed, and for each stage of its curriculum."""
    seeds, main = standing.seeds(training), standing.experiment.trainings[0]
    title = (
        "The training of the scenario"
        if training is main
        else f"The training `{training.name}`, {training.words}"
    )
    if not seeds:
        return [f"{title}: not measured.", ""]
    has_criterion = measure.compiled(standing.experiment.scenario, training.sets).agent.solved is not None
    head = ["seed", "solved after", "simulated hours", "trained for", "simulated hours", "CPU"]
    rows: list[tuple[str, ...]] = []
    for seed, entry in seeds.items():
        solved, resumed = entry["solved_at"], entry["times_resumed"]
        after = (
            (_counts(solved["steps"], solved["episode"]), number_text(solved["simulated_hours"], 3))
            if solved
            else ("not solved", "")
        )
        cpu = f"{number_text(entry['cpu_seconds'], 3)} s" + (
            f", resumed {'once' if resumed == 1 else f'{resumed} times'}" if resumed else ""
        )
        rows.append(
            (
                str(seed),
                *after,
                _counts(entry["steps"], entry["episodes"]),
                number_text(entry["simulated_hours"], 3),
                cpu,
            )
        )
    if not has_criterion:
        head, rows = [head[0], *head[3:]], [(row[0], *row[3:]) for row in rows]
    lines = [*([f"{title}:", ""] if len(standing.experiment.trainings) > 1 else []), *table(head, rows), ""]
    stages = [
        (
            str(seed),
            f"`{end['name']}`",
            _counts(end["steps"], end["episodes"]),
            number_text(end["simulated_hours"], 3),
        )
        for seed, entry in seeds.items()
        for end in entry["stages"]
    ]
    if stages:
        ends = ", ".join(f"seed {seed} in `{entry['stage']}`" for seed, entry in seeds.items())
        lines += [
            *table(("seed", "stage", "done after", "simulated hours"), stages),
            "",
            f"The training ended in the stage: {ends}.",
            "",
        ]
    return lines


def _counts(steps: int, episodes: int) -> str:
    return f"{steps:,} steps, {episodes:,} episodes"


def _episodes(standing: Standing) -> list[str]:
    """A row for each evaluation or case and seed, and for each baseline."""
    rows: list[tuple[str, ...]] = []
    for training in standing.experiment.trainings:
        for evaluation in training.evaluations:
            seeds = standing.seeds(training).items()
            held = {
                seed: entry["evaluations"][evaluation.name]
                for seed, entry in seeds
                if evaluation.name in entry["evaluations"]
            }
            name = ("" if training.name == "main" else f"{training.name}: ") + (
                evaluation.words or evaluation.name.replace("_", " ")
            )
            rows += _held(name, held)
            for case in dict.fromkeys(case for entry in held.values() for case in entry["cases"]):
                by_seed = {
                    seed: entry["cases"][case] for seed, entry in held.items() if case in entry["cases"]
                }
                rows += _held(f"{name}, `{case}`", by_seed)
    tried = standing.record["baselines"]
    for baseline in standing.experiment.baselines:
        if baseline.name in tried:
            rows.append(
                (baseline.words or baseline.name.replace("_", " "), "", *_outcome(tried[baseline.name]))
            )
    if not rows:
        return []
    return [
        *table(("episodes", "seed", "number", "succeed", "mean return", "worst, best", "ended by"), rows),
        "",
    ]


def _held(name: str, held: Mapping[int, Entry]) -> Iterator[tuple[str, ...]]:
    """A row for each seed; of several, one for all of their episodes together."""
    for seed, entry in held.items():
        yield (name, str(seed), *_outcome(entry))
    if len(held) > 1:
        yield (name, "all", *_outcome(together(list(held.values()))))


def _outcome(result: Entry) -> tuple[str, ...]:
    endings = ", ".join(f"{name} {times}" for name, times in result["endings"].items())
    succeeded = share(result) if result["success_defined"] else ""
    extremes = f"{number_text(result['least_return'])}, {number_text(result['greatest_return'])}"
    return str(result["episodes"]), succeeded, mean_return(result), extremes, endings


def _commands(standing: Standing) -> list[str]:
    """Of trainings, evaluations and baselines, each once."""
    scenario = standing.experiment.scenario
    trained = [
        measure.training_request(scenario, training, "N").command
        for training in standing.experiment.trainings
    ]
    held = [
        entry["command"] for entry in standing.entries() if "episodes" in entry and "evaluations" not in entry
    ]
    return list(dict.fromkeys([*trained, *held]))
