"""The section of a scenario: picture, bars, seeds, held-out episodes, commands."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from typing import Any

from deepbots_cli.learning.statistics import wilson
from tests.results import asked
from tests.results.experiment import Training
from tests.results.standing import Standing
from tests.results.tables import count, measured_on, number, table, wrapped

Entry = Mapping[str, Any]


def lines_of(standing: Standing) -> list[str]:
    experiment = standing.experiment
    lines = [f"## {experiment.title}", "", *wrapped(experiment.prose), ""]
    if experiment.paper:
        lines += [*wrapped(experiment.paper), ""]
    measured = list(standing.entries())
    if not measured:
        return [*lines, "Not measured yet.", ""]
    if outdated := list(standing.outdated()):
        lines += [*wrapped(f"**Measured on an earlier version of the scenario or of the experiment:** {', '.join(outdated)}."), ""]
    if standing.has_curves:
        lines += [f"![Learning curves of {experiment.title}](images/results/{experiment.name}.svg)", ""]
    rows = [(verdict.what, verdict.asked, verdict.measured, verdict.word) for verdict in standing.verdicts()]
    lines += [*table(("what", "asked", "measured", ""), rows), ""]
    for training in experiment.trainings:
        lines += _trained(standing, training)
    lines += _episodes(standing)
    return [*lines, f"`make results SCENARIO={experiment.name}`", "", *measured_on(measured), ""]


def _trained(standing: Standing, training: Training) -> list[str]:
    """A row for each seed, and for each stage of its curriculum."""
    command = asked.training(standing.experiment, training, "N").command
    lines = [*wrapped(f"`{command}`{training.words and f': {training.words}'}"), ""]
    seeds = standing.seeds(training)
    head = ("seed", "solved after", "simulated hours", "trained for", "simulated hours", "CPU")
    lines += [*table(head, [_seed_row(seed, entry) for seed, entry in seeds.items()]), ""]
    stages = [(str(seed), *_stage_row(end)) for seed, entry in seeds.items() for end in entry["stages"]]
    if stages:
        lines += [*table(("seed", "stage", "done after", "simulated hours"), stages), ""]
        ends = [f"seed {seed} in `{entry['stage']}`" for seed, entry in seeds.items()]
        lines += [f"The training ended in the stage: {', '.join(ends)}.", ""]
    return lines


def _seed_row(seed: int, entry: Entry) -> tuple[str, ...]:
    solved = entry["solved_at"]
    resumed = entry["times_resumed"]
    return (
        str(seed),
        f"{count(solved['steps'])} steps, {count(solved['episode'])} episodes" if solved else "not solved",
        number(solved["simulated_hours"], 3) if solved else "",
        f"{count(entry['steps'])} steps, {count(entry['episodes'])} episodes",
        number(entry["simulated_hours"], 3),
        f"{number(entry['cpu_seconds'], 3)} s" + (f", resumed {'once' if resumed == 1 else f'{resumed} times'}" if resumed else ""),
    )


def _stage_row(end: Entry) -> tuple[str, ...]:
    return f"`{end['name']}`", f"{count(end['steps'])} steps, {count(end['episodes'])} episodes", number(end["simulated_hours"], 3)


def _episodes(standing: Standing) -> list[str]:
    """A row for each evaluation or case and seed, and for each baseline."""
    rows: list[tuple[str, ...]] = []
    for training in standing.experiment.trainings:
        for evaluation in training.evaluations:
            seeds = standing.seeds(training).items()
            held = {seed: entry["evaluations"][evaluation.name] for seed, entry in seeds if evaluation.name in entry["evaluations"]}
            name = ("" if training.name == "main" else f"{training.name}: ") + (evaluation.words or evaluation.name.replace("_", " "))
            rows += _held_rows(name, held)
            for case in dict.fromkeys(case for entry in held.values() for case in entry["cases"]):
                rows += _held_rows(
                    f"{name}, `{case}`", {seed: entry["cases"][case] for seed, entry in held.items() if case in entry["cases"]}
                )
    tried = standing.record["baselines"]
    for baseline in standing.experiment.baselines:
        if baseline.name in tried:
            rows.append((baseline.words or baseline.name.replace("_", " "), "", *_outcome(tried[baseline.name])))
    if not rows:
        return []
    head = ("episodes", "seed", "number", "succeed", "mean return", "worst, best", "ended by")
    return [*table(head, rows), "", *wrapped(f"{', '.join(_commands(standing))}; RUN is the directory that the training made."), ""]


def _commands(standing: Standing) -> Iterator[str]:
    """Those of what was evaluated and tried, each once."""
    held = [
        e
        for training in standing.experiment.trainings
        for entry in standing.seeds(training).values()
        for e in entry["evaluations"].values()
    ]
    for command in dict.fromkeys(entry["command"] for entry in [*held, *standing.record["baselines"].values()]):
        yield f"`{command}`"


def _held_rows(name: str, held: Mapping[int, Entry]) -> Iterator[tuple[str, ...]]:
    """A row for each seed; of several, one for all of their episodes together."""
    for seed, entry in held.items():
        yield (name, str(seed), *_outcome(entry))
    if len(held) > 1:
        entries = held.values()
        successes, episodes = sum(entry["successes"] for entry in entries), sum(entry["episodes"] for entry in entries)
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
