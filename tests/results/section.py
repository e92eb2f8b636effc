"""The section of a scenario: picture, seeds, held-out episodes, bars, commands."""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Mapping
from typing import Any

from deepbots_cli.learning.intervals import wilson
from tests.results import fingerprint
from tests.results.experiment import Experiment, Training
from tests.results.measure import evaluation_command
from tests.results.tables import count, measured_on, number, table, wrapped
from tests.results.verdicts import judge

Entry = Mapping[str, Any]


def lines_of_experiment(experiment: Experiment, record: Entry, *, has_picture: bool) -> list[str]:
    lines = [f"## {experiment.title}", "", *wrapped(experiment.prose), ""]
    if experiment.paper:
        lines += [*wrapped(experiment.paper), ""]
    if not record:
        return [*lines, "Not measured yet.", ""]
    if stale := list(_stale(experiment, record)):
        lines += [*wrapped(f"**Measured on an earlier version of the scenario:** {', '.join(stale)}."), ""]
    if has_picture:
        lines += [f"![Learning curves of {experiment.title}](images/results/{experiment.name}.svg)", ""]
    verdicts = [judge(experiment, bar, record) for bar in experiment.bars]
    rows = [(v.what, f"stretch: {v.asked}" if v.bar.stretch else v.asked, v.measured, v.word) for v in verdicts]
    lines += [*table(("what", "asked", "measured", ""), rows), ""]
    for training in experiment.trainings:
        lines += _trained(experiment, training, record)
    lines += _episodes(experiment, record)
    entries = [entry for _, _, entry in _trainings(experiment, record)]
    measured = [*entries, *(held for entry in entries for held in entry["evaluations"].values()), *record.get("baselines", {}).values()]
    return [*lines, f"`make results SCENARIO={experiment.name}`", "", *measured_on(measured), ""]


def _trainings(experiment: Experiment, record: Entry) -> Iterator[tuple[Training, int, Entry]]:
    """What was measured of what the experiment asks for; a record may hold more."""
    for training in experiment.trainings:
        for seed in training.seeds:
            entry = record.get("trainings", {}).get(training.name, {}).get(str(seed))
            if entry is not None:
                yield training, seed, entry


def _stale(experiment: Experiment, record: Entry) -> Iterator[str]:
    name = experiment.scenario
    for training, seed, entry in _trainings(experiment, record):
        place = f"seed {seed}" + ("" if training.name == "main" else f" ({training.name})")
        if entry["digest"] != fingerprint.of_training(name, training):
            yield place
            continue
        for evaluation in training.evaluations:
            held = entry["evaluations"].get(evaluation.name)
            if held is not None and held["digest"] != fingerprint.of_evaluation(name, training, evaluation):
                yield f"{evaluation.name} of {place}"
    for baseline in experiment.baselines:
        tried = record.get("baselines", {}).get(baseline.name)
        if tried is not None and tried["digest"] != fingerprint.of_baseline(name, baseline):
            yield baseline.name


def _trained(experiment: Experiment, training: Training, record: Entry) -> list[str]:
    """A row for each seed, and for each stage of its curriculum."""
    command = shlex.join(["deepbots", "train", experiment.scenario, "--seed", "N", *training.options])
    lines = [*wrapped(f"`{command}`{training.words and f': {training.words}'}"), ""]
    seeds = [(seed, entry) for found, seed, entry in _trainings(experiment, record) if found is training]
    head = ("seed", "solved after", "simulated hours", "trained for", "simulated hours", "CPU")
    lines += [*table(head, [_seed_row(seed, entry) for seed, entry in seeds]), ""]
    stages = [(str(seed), *_stage_row(end)) for seed, entry in seeds for end in entry["stages"]]
    if stages:
        lines += [*table(("seed", "stage", "done after", "simulated hours"), stages), ""]
        ends = [f"seed {seed} in `{entry['stage']}`" for seed, entry in seeds]
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
        f"{number(entry['cpu_seconds'], 3)} s" + (f", resumed {resumed} times" if resumed else ""),
    )


def _stage_row(end: Entry) -> tuple[str, ...]:
    return f"`{end['name']}`", f"{count(end['steps'])} steps, {count(end['episodes'])} episodes", number(end["simulated_hours"], 3)


def _episodes(experiment: Experiment, record: Entry) -> list[str]:
    """A row for each evaluation or case and seed, and for each baseline."""
    rows, commands = [], []
    for training in experiment.trainings:
        seeds = {seed: entry for found, seed, entry in _trainings(experiment, record) if found is training}
        for evaluation in training.evaluations:
            held = {seed: entry["evaluations"][evaluation.name] for seed, entry in seeds.items() if evaluation.name in entry["evaluations"]}
            if not held:
                continue
            commands.append(evaluation_command(evaluation))
            name = ("" if training.name == "main" else f"{training.name}: ") + (evaluation.words or evaluation.name.replace("_", " "))
            rows += _held_rows(name, held)
            for case in next(iter(held.values()))["cases"]:
                rows += _held_rows(
                    f"{name}, `{case}`", {seed: entry["cases"][case] for seed, entry in held.items() if case in entry["cases"]}
                )
    for baseline in experiment.baselines:
        tried = record.get("baselines", {}).get(baseline.name)
        if tried is not None:
            commands.append(tried["command"])
            rows.append((baseline.words or baseline.name.replace("_", " "), "", *_outcome(tried)))
    if not rows:
        return []
    head = ("episodes", "seed", "number", "succeed", "mean return", "worst, best")
    quoted = ", ".join(f"`{command}`" for command in dict.fromkeys(commands))
    return [*table(head, rows), "", *wrapped(f"{quoted}; RUN is the directory that the training made."), ""]


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
    return str(result["episodes"]), share, mean, f"{number(result['least_return'])}, {number(result['greatest_return'])}"
