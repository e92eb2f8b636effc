"""The page docs/benchmark.md of the site, from the records of the benchmark alone."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from statistics import fmean, median

from deepbots_cli.analysis import possible_returns
from deepbots_cli.learning.runs.statistics import UNBOUNDED, Interval, mean_interval, wilson
from deepbots_cli.words import number_text
from tools.results import measure
from tools.results.benchmark import CPU_LIMIT, SEEDS, Cell, Task
from tools.results.card import NOTE, measured_on, slug, table, wrapped
from tools.results.experiment import Evaluation
from tools.results.measure import Places
from tools.results.standing import Entry, Standing

HELD_OUT = Evaluation().name
ENGINE_NAMES = {"pybullet": "PyBullet", "mujoco": "MuJoCo"}
ABSENT = {"DQN": "continuous actions", "DDPG": "not compared"}
"""Why a task has no cell for an algorithm that others have."""

HEAD = f"""\
{NOTE}

# Benchmark

Several algorithms learn the same tasks. Each task runs on the engine that steps it fastest, or on PyBullet, the default, if MuJoCo is
not a tenth faster. Each algorithm is trained with {len(SEEDS)} seeds, {SEEDS[0]} to {SEEDS[-1]}, by which no value was chosen.
`make results PART=benchmark` measures what is missing, continues an interrupted measurement, and writes this page from the records in
`tools/results/records/benchmark`.

- **Values.** Where the scenario names the algorithm, its `train` section is used as it is (marked with *). All others have the
  values of the [chosen learner](training.md#the-chosen-learner): PPO has the values of its row, and SAC, TD3, TQC and DQN have the
  values of SAC, with hindsight where the scenario has a goal. They were not tuned for these tasks: other values may be better.
- **Limit.** A training ends when an evaluation confirms that the task is solved, or after the timesteps in the column "limit". With
  this limit, a training takes about {CPU_LIMIT // 60} minutes of CPU at most; the column "CPU of a training" shows what they took.
- **Held out.** The best policy of each training runs 100 episodes with starts that no training uses.
- [**Intervals**](statistics.md) are of 95 %, over seeds and episodes: the wider one of the interval over all episodes together and of
  Student's interval over the means of the seeds. Three seeds show little about rare failures of a training.
- **Until solved.** The median over the seeds, with the least and the largest. A seed that does not solve the task ranks last.
  The training episodes, which explore, must meet the criterion too: of an unsolved training, all held-out episodes may succeed.
  CPU time is that of the training with its evaluations, without the start of Python. "CPU of a training" is the mean over the seeds of
  the whole command. CPU times vary with the machine, and are up to a half longer beside other work. Steps and simulated hours do not
  vary.
"""


@dataclass(frozen=True)
class Row:
    """A cell with what was measured of it: an entry of the record for each seed that was trained and
    evaluated."""

    task: Task
    cell: Cell
    entries: list[Entry]
    outdated: bool = False

    @property
    def is_own(self) -> bool:
        """Whether the scenario names the algorithm."""
        return self.cell.algorithm == own_algorithm(self.task)

    @property
    def name(self) -> str:
        return f"{self.cell.algorithm}{' *' if self.is_own else ''}"

    @property
    def held(self) -> list[Entry]:
        return [entry["evaluations"][HELD_OUT] for entry in self.entries]

    @property
    def solved(self) -> int:
        return sum(entry["solved_at"] is not None for entry in self.entries)

    def until(self, what: str) -> list[float]:
        """`what` of each seed when the task was solved; infinite if it was not."""
        return [
            math.inf if entry["solved_at"] is None else float(entry["solved_at"][what])
            for entry in self.entries
        ]

    @property
    def rank(self) -> tuple[float, float]:
        """Lower is better: seeds that were not solved, then CPU time."""
        return len(SEEDS) - self.solved, median(self.until("cpu_seconds"))


def rows(task: Task, record: Entry) -> list[Row]:
    standing = Standing.of(task.experiment, record)
    result = []
    for cell in task.cells:
        seeds = standing.seeds(cell.training) if cell.training else {}
        evaluated = {seed: entry for seed, entry in seeds.items() if HELD_OUT in entry["evaluations"]}
        places = {f"seed {seed} ({cell.algorithm})" for seed in evaluated}
        places |= {f"{HELD_OUT} of {place}" for place in places}
        result.append(Row(task, cell, list(evaluated.values()), not places.isdisjoint(standing.outdated)))
    return result


def own_algorithm(task: Task) -> str:
    training = measure.compiled(task.scenario).agent.training
    assert training is not None
    return training.algorithm


# Intervals


def success_interval(held: Sequence[Entry]) -> Interval:
    """Of the share of successes, with each seed as often as it has episodes."""
    together = wilson(sum(entry["successes"] for entry in held), sum(entry["episodes"] for entry in held))
    return _wider(together, [entry["success_rate"] for entry in held], (0.0, 1.0))


def return_interval(held: Sequence[Entry], bounds: Interval = UNBOUNDED) -> Interval | None:
    """Of the mean return, within the possible returns; None if no spread is known."""
    intervals = [entry["return_interval"] for entry in held]
    if None in intervals:
        return mean_interval([entry["mean_return"] for entry in held], bounds)
    # The means of the seeds are independent: the squares of half the widths add up.
    mean = fmean(entry["mean_return"] for entry in held)
    low, high = (
        math.hypot(
            *(entry["mean_return"] - interval[side] for entry, interval in zip(held, intervals, strict=True))
        )
        for side in (0, 1)
    )
    low, high = max(bounds[0], mean - low / len(held)), min(bounds[1], mean + high / len(held))
    return _wider((low, high), [entry["mean_return"] for entry in held], bounds)


def _wider(together: Interval, means: Sequence[float], bounds: Interval = UNBOUNDED) -> Interval:
    over_seeds = mean_interval(means, bounds) if len(set(means)) > 1 else None
    return (
        together if over_seeds is None else (min(together[0], over_seeds[0]), max(together[1], over_seeds[1]))
    )


# The page


def state(places: Places, tasks: Sequence[Task]) -> str:
    """Return how many cells are measured, in a sentence."""
    return _headline(
        [row for task in tasks for row in rows(task, measure.read(places.record(task.experiment.name)))]
    )


def page(places: Places, tasks: Sequence[Task]) -> str:
    records = {task.scenario: measure.read(places.record(task.experiment.name)) for task in tasks}
    rows_of = {task.scenario: rows(task, records[task.scenario]) for task in tasks}
    lines = [
        HEAD,
        "## Summary",
        "",
        *wrapped(_headline([row for each in rows_of.values() for row in each])),
        "",
        *_summary(tasks, rows_of),
        "",
    ]
    for task in tasks:
        lines += _section(task, rows_of[task.scenario], records[task.scenario])
    return "\n".join(lines).rstrip() + "\n"


def _headline(rows: Sequence[Row]) -> str:
    pairs = [row for row in rows if row.cell.training]
    whole = sum(len(row.entries) == len(SEEDS) for row in pairs)
    part = sum(0 < len(row.entries) < len(SEEDS) for row in pairs)
    if whole == len(pairs):
        return f"All {whole} pairs of a task and an algorithm are measured with {len(SEEDS)} seeds."
    text = (
        f"Of {len(pairs)} pairs of a task and an algorithm, {whole} are measured with all {len(SEEDS)} seeds"
    )
    return f"{text}, {part} with fewer, and {len(pairs) - whole - part} are not measured yet."


def _summary(tasks: Sequence[Task], rows_of: Mapping[str, list[Row]]) -> Iterator[str]:
    """A row for each task: what is held out, and the CPU time until solved."""
    names = list(dict.fromkeys(cell.algorithm for task in tasks for cell in task.cells))
    text = (
        "Success held out, or the mean return in a task without successes, with its interval; then the"
        " CPU time until solved."
    )
    yield from wrapped(f"{text} DDPG is compared where a scenario recommends it.")
    yield ""
    body = []
    for task in tasks:
        cells = {row.cell.algorithm: _in_short(row) for row in rows_of[task.scenario]}
        body.append(
            (
                f"[{task.title}](#{slug(task.title)})",
                *(cells[name] if name in cells else ABSENT[name] for name in names),
            )
        )
    yield from table(("task", *names), body)


def _in_short(row: Row) -> str:
    if not row.entries:
        return row.cell.reason.partition(";")[0] or "not measured yet"
    value = _success(row.held) or _return(row)
    seeds = "" if len(row.entries) == len(SEEDS) else f", {_seeds(len(row.entries))}"
    seconds = median(row.until("cpu_seconds"))
    cost = f"{_number(seconds)} s" if math.isfinite(seconds) else "not solved"
    return f"{value}; {cost}{seeds}{' *' if row.is_own else ''}"


def _section(task: Task, rows: Sequence[Row], record: Entry) -> Iterator[str]:
    yield from (f"## {task.title}", "")
    speeds = record.get("engines", {})
    measured = [entry for row in rows for entry in (*row.entries, *row.held)]
    if speeds:
        rates = " and ".join(
            f"{round(1e6 / micro):,} steps/s in {ENGINE_NAMES[name]}"
            for name, micro in speeds["step_us"].items()
        )
        yield from wrapped(
            f"Engine: {ENGINE_NAMES[task.engine]}. One world makes {rates}, by CPU time"
            f" (`{speeds['command']}`)."
        )
    else:
        yield f"Engine: {ENGINE_NAMES[task.engine]}."
    yield ""
    yield from table(
        (
            "algorithm",
            "success (95 %)",
            "mean return (95 %)",
            "solved",
            "steps until solved",
            "simulated hours",
            "CPU until solved",
            "CPU of a training",
            "limit",
        ),
        [_cells(row) for row in rows],
    )
    yield ""
    yield from wrapped(_advice(task, rows))
    yield ""
    for row in rows:
        if row.cell.training:
            command = measure.training_request(task.scenario, row.cell.training, "N").command
            yield f"- {row.cell.algorithm}, {row.cell.learner}: `{command}`"
    missing = [row.cell.algorithm for row in rows if row.cell.training and len(row.entries) < len(SEEDS)]
    again = f"`python -m tools.results {task.experiment.name}`"
    yield ""
    yield from wrapped(
        f"{again} measures what is missing: {', '.join(missing)}."
        if missing
        else f"{again} made this section."
    )
    yield from ("", *measured_on(measured), "") if measured else ("",)


def _cells(row: Row) -> tuple[str, ...]:
    if not row.cell.training:
        return (row.name, row.cell.reason, *[""] * 7)
    limit = f"{limit_of(row.task, row.cell):,} steps"
    if not row.entries:
        return (row.name, "not measured yet", *[""] * 6, limit)
    seeds = f"{row.solved} of {len(row.entries)}{'' if len(row.entries) == len(SEEDS) else ' (seeds so far)'}"
    until = [_median(row.until(what)) for what in ("steps", "simulated_hours", "cpu_seconds")]
    spent = [entry["cpu_seconds"] for entry in row.entries]
    marked = f"{row.name}{', earlier version' if row.outdated else ''}"
    return (
        marked,
        _success(row.held) or "not defined",
        _return(row),
        seeds,
        *until,
        _number(fmean(spent)),
        limit,
    )


def limit_of(task: Task, cell: Cell) -> int:
    """Timesteps after which a training ends."""
    assert cell.training is not None
    training = measure.compiled(task.scenario, cell.training.sets).agent.training
    assert training is not None
    return training.total_timesteps


def _success(held: Sequence[Entry]) -> str:
    if not held[0]["success_defined"]:
        return ""
    low, high = success_interval(held)
    rate = sum(entry["successes"] for entry in held) / sum(entry["episodes"] for entry in held)
    return f"{_percent(rate)} % ({_percent(low)} .. {_percent(high)})"


def _return(row: Row) -> str:
    assert row.cell.training is not None
    interval = return_interval(
        row.held, possible_returns(measure.compiled(row.task.scenario, row.cell.training.sets))
    )
    spread = (
        "no interval" if interval is None else f"{number_text(interval[0])} .. {number_text(interval[1])}"
    )
    return f"{number_text(fmean(entry['mean_return'] for entry in row.held))} ({spread})"


def _percent(share: float) -> str:
    return f"{100 * share:.1f}".removesuffix(".0")


def _median(values: Sequence[float]) -> str:
    """The median, and the range of the seeds."""
    low, middle, high = (
        _number(value) if math.isfinite(value) else "never"
        for value in (min(values), median(values), max(values))
    )
    return middle if low == high else f"{middle} ({low} .. {high})"


def _number(value: float) -> str:
    """Three digits, and all of larger numbers."""
    return f"{round(value):,}" if value >= 100 else number_text(value, 3)


def _seeds(number_of_seeds: int) -> str:
    return f"{number_of_seeds} seed{'' if number_of_seeds == 1 else 's'}"


def first(rows: Sequence[Row]) -> Row | None:
    """The row that solved the task with most seeds, of several in the least CPU time; None if none did."""
    solved = [row for row in rows if row.solved]
    return min(solved, key=lambda row: row.rank) if solved else None


def _advice(task: Task, rows: Sequence[Row]) -> str:
    """What the `train` section of the scenario has to do with the table."""
    best, algorithm = first(rows), own_algorithm(task)
    measured = [row.cell.algorithm for row in rows if row.entries]
    missing = any(row.cell.training and len(row.entries) < len(SEEDS) for row in rows)
    if not measured:
        how = ". Nothing is measured yet"
    elif best is None:
        how = f". No algorithm has solved the task here{' so far' if missing else ''}"
    elif len(measured) == 1:
        how = (
            f". {best.cell.algorithm} solves the task with {best.solved} of {_seeds(len(best.entries))};"
            " no other algorithm is measured yet"
        )
    else:
        among = f" of those measured so far ({', '.join(measured)})" if missing else ""
        how = (
            f"{', which' if best.is_own else f', although {best.cell.algorithm}'} is first{among}: it"
            " solves the task"
        )
        how += f" with {best.solved} of {_seeds(len(best.entries))}, in the least CPU time"
    return f"The scenario recommends {algorithm}{how}. {task.advice}".rstrip()
