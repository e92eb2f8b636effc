"""Workers of a cluster, and what runs on them.

* What both kinds of workers do: processes of this machine, and the workers of a Ray cluster. What only the
  former do is below.
* Several trainings, evaluations and tests on workers: the same results as one after the other, also after
  workers were lost.
* The files for Slurm and Kubernetes; Ray has the private members that deepbots uses, and one module names them.
* Shards of a training: the same weights and logs in this process, on workers, and on one or two nodes of a
  cluster, also after workers or nodes were lost and others joined.
"""

from __future__ import annotations

import csv
import inspect
import io
import os
import pickle
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import cache
from itertools import takewhile
from pathlib import Path
from typing import Any, ClassVar

import pytest
import yaml

from deepbots_cli import api, processes
from deepbots_cli.api import Compiled
from deepbots_cli.cli import arguments, main
from deepbots_cli.cluster import Cluster
from deepbots_cli.cluster.ray_cluster import node_messages_silenced
from deepbots_cli.cluster.worker_pool import LocalProcesses, Owed, Worker, WorkerLost
from deepbots_cli.errors import DeepbotsError, RunError, UsageError
from deepbots_cli.learning import evaluate, evaluate_group, resume, resume_group, train, train_group
from deepbots_cli.learning.campaigns.group import GroupTraining
from deepbots_cli.learning.executor import SERIAL, Executor, Watcher, results
from deepbots_cli.learning.report import GroupProgressReporter, Reporter, TrainingProgress
from deepbots_cli.learning.runs.run import Run, TrainingResult
from tests.cluster.calls import Echo, imported, lose, priority, square
from tests.cluster.nodes import cluster_of_nodes
from tests.commands import Deepbots
from tests.files import written
from tests.learning.interruption import At


class Losses(Watcher):
    def __init__(self) -> None:
        self.items: list[int] = []

    def on_loss(self, item: int) -> None:
        self.items.append(item)


def test_results_and_errors_come_in_the_order_of_the_items(either: Cluster) -> None:
    assert list(results(either.map(square, range(3)))) == [0, 1, 4]
    *squares, error, last = either.map(square, range(5))
    assert (squares, str(error), last) == ([0, 1, 4], "there is no square of 3", 16)


def test_a_worker_with_another_version_or_without_a_file_is_refused(
    either: Cluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = written(tmp_path / "group.json", "{}")
    unseen = either.map(square, range(2), files=[file])
    file.write_text("{ }")
    with pytest.raises(UsageError, match=r"the worker on .* sees another .*group\.json, which has changed"):
        list(unseen)
    monkeypatch.setattr(
        "deepbots_cli.__version__", "99.0"
    )  # here, so this process believes in another version
    with pytest.raises(UsageError, match=r"the worker on .* has deepbots .*, but this process has 99\.0"):
        list(either.map(square, range(2)))


@pytest.mark.slow
def test_a_lost_call_is_repeated_up_to_three_times(either: Cluster) -> None:
    losses = Losses()
    first, failure, other = either.map(lose, range(3), watcher=losses)
    assert (first, other) == (2, 1)
    assert isinstance(failure, DeepbotsError)
    assert "it ended its worker 3 times" in str(failure)
    assert sorted(losses.items) == [0, 1, 1]


# Processes of this machine
SCRIPT = """
import os, signal
signal.signal(signal.SIGINT, signal.default_int_handler)  # a test in the background ignores it
from deepbots_cli.cluster import Cluster
from deepbots_cli.learning.executor import Watcher
from tests.cluster.calls import sleep

class Printer(Watcher):
    def on_report(self, item, value):
        print(value, flush=True)

with Cluster(workers=2) as cluster:
    list(cluster.map(sleep, [{seconds}, {seconds}], watcher=Printer()))
"""


def begun(seconds: int, folder: Path) -> tuple[subprocess.Popen[str], set[int]]:
    """A script without a guard of its main module, and its two workers once they work."""
    script = written(folder / "script.py", SCRIPT.format(seconds=seconds))
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])}
    process = subprocess.Popen([sys.executable, script], stdout=subprocess.PIPE, text=True, env=environment)
    assert process.stdout is not None
    return process, {int(process.stdout.readline()) for _ in range(2)}


def alive(numbers: set[int]) -> set[int]:
    """The processes that have not ended."""
    living = set()
    for number in numbers:
        with suppress(ProcessLookupError):
            os.kill(number, 0)
            living.add(number)
    return living


@pytest.mark.parametrize("number", [signal.SIGKILL, pytest.param(signal.SIGINT, marks=pytest.mark.slow)])
def test_no_worker_outlives_its_parent(number: signal.Signals, tmp_path: Path) -> None:
    process, pids = begun(600, tmp_path)
    assert len(alive(pids)) == 2
    process.send_signal(number)
    process.communicate(timeout=60)
    deadline = time.monotonic() + 10
    while alive(pids) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not alive(pids)


def test_workers_run_without_ray(
    cluster: Cluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, deepbots: Deepbots
) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    monkeypatch.delitem(sys.modules, "deepbots_cli.cluster.ray_cluster")
    monkeypatch.chdir(tmp_path)
    assert main(["test", "cartpole", "find_ball", "--workers", "2"]) == 0
    assert list(cluster.map(imported, ["ray", "deepbots_cli"])) == [False, True]
    assert (
        "error: --cluster needs the 'cluster' extra"
        in deepbots("test", "cartpole", "find_ball", "--cluster", "auto", code=2).err
    )


def test_workers_have_our_priority(cluster: Cluster) -> None:
    assert list(cluster.map(priority, [0])) == [os.nice(0)]


@pytest.mark.parametrize(("text", "cores"), [("150000 100000\n", 2), ("max 100000\n", 8)])
def test_a_container_has_the_cores_of_its_cpu_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str, cores: int
) -> None:
    (tmp_path / "cpu.max").write_text(text)
    monkeypatch.setattr(processes, "CORES_OF_CONTAINER", tmp_path / "cpu.max")
    monkeypatch.setattr(os, "sched_getaffinity", lambda process: range(8), raising=False)
    assert processes.available_cores() == cores


@pytest.mark.slow
def test_more_workers_than_cores_are_noted(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(arguments, "available_cores", lambda: 1)
    with arguments.executor(2, None) as executor:
        assert executor.workers == 2
    assert capsys.readouterr().err == "2 workers share 1 core; more workers than cores are not faster\n"


SEEDS = (0, 1, 2)


@pytest.fixture(scope="module")
def scenario() -> Compiled:
    return api.compile("cartpole", overrides=["train.n_steps=64"])


def outcomes(group: Path) -> list[Any]:
    """The results of the trainings of a group, to the bit."""
    return [outcome(run) for run in sorted(group.glob("seed-*"))]


def test_every_error_passes_from_a_worker_to_this_process() -> None:
    def kinds(base: type[DeepbotsError]) -> Iterator[type[DeepbotsError]]:
        yield base
        for kind in base.__subclasses__():
            yield from kinds(kind)

    for kind in kinds(DeepbotsError):
        error = kind.__new__(kind, "what is wrong")
        error.add_note("what to do")
        received = pickle.loads(pickle.dumps(error))
        assert (type(received), received.full_message) == (kind, "what is wrong\nwhat to do")


def act_at(
    monkeypatch: pytest.MonkeyPatch, steps: int, times: int, act: Callable[[], object]
) -> list[object]:
    """Each time a training has come so many steps further, `act` is called; the list of what it returned."""
    done: list[object] = []
    reported = GroupProgressReporter.on_report

    def on_report(self: GroupProgressReporter, item: int, value: object) -> None:
        reported(self, item, value)
        if (
            isinstance(value, TrainingProgress)
            and value.steps > (1 + len(done)) * steps
            and len(done) < times
        ):
            done.append(act())

    monkeypatch.setattr(GroupProgressReporter, "on_report", on_report)
    return done


@pytest.fixture(scope="module")
def trained_here(scenario: Compiled, tmp_path_factory: pytest.TempPathFactory) -> GroupTraining:
    return train_group(scenario, SEEDS, runs=tmp_path_factory.mktemp("here"), total_timesteps=6_000)


@pytest.mark.slow
def test_ctrl_c_stops_all_trainings_after_their_rollouts(
    cluster: Cluster,
    scenario: Compiled,
    trained_here: GroupTraining,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    asked = act_at(monkeypatch, 1_000, 1, lambda: os.kill(os.getpid(), signal.SIGINT))
    stopped = train_group(
        scenario, SEEDS, group=tmp_path / "stopped", total_timesteps=6_000, progress=True, executor=cluster
    )
    assert (len(asked), {result.status for result in stopped.trained}) == (1, {"interrupted"})
    assert (stopped.waiting, capfd.readouterr().err.count("continue with: deepbots resume")) == (SEEDS, 1)
    assert resume_group(tmp_path / "stopped", executor=cluster).waiting == ()
    assert outcomes(tmp_path / "stopped") == outcomes(trained_here.group)


@pytest.mark.slow
def test_a_second_ctrl_c_ends_them_at_once(
    cluster: Cluster, scenario: Compiled, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def twice() -> None:
        os.kill(os.getpid(), signal.SIGINT)
        os.kill(os.getpid(), signal.SIGINT)

    act_at(monkeypatch, 200, 1, twice)
    stopped = train_group(
        scenario, SEEDS, group=tmp_path / "group", total_timesteps=600_000, progress=True, executor=cluster
    )
    assert (stopped.trained, stopped.waiting) == ((), SEEDS)
    deadline = time.monotonic() + 20
    while workers() and time.monotonic() < deadline:
        time.sleep(0.2)
    assert not workers()


@pytest.mark.slow
def test_evaluations_on_workers_are_the_same_and_stop_at_the_same_episode(
    cluster: Cluster, trained_here: GroupTraining
) -> None:
    for until, episodes in ((None, [6, 6, 6]), (lambda done: len(done) >= 8, [6, 2])):
        here, workers = (
            evaluate_group(trained_here.group, episodes=6, until=until, executor=executor).evaluations
            for executor in (SERIAL, cluster)
        )
        assert [result.episodes for result in workers] == episodes
        assert [each.model_dump(mode="json") for each in workers] == [
            each.model_dump(mode="json") for each in here
        ]


@pytest.mark.slow
@pytest.mark.parametrize("options", [{}, {"deterministic": False}, {"until": lambda done: len(done) >= 11}])
def test_the_episodes_of_an_evaluation_on_workers_are_the_same(
    cluster: Cluster, trained_here: GroupTraining, options: dict[str, Any]
) -> None:
    run = trained_here.group / "seed-0"
    progress = [0]
    here = evaluate(run, episodes=21, **options)
    workers = evaluate(
        run, episodes=21, executor=cluster, on_episode=lambda done, of: progress.append(done), **options
    )
    assert workers.model_dump(mode="json") == here.model_dump(mode="json")
    assert progress == sorted(set(progress))


@pytest.mark.slow
@pytest.mark.parametrize("command", ["eval", "eval run", "compare", "robustness", "test"])
def test_commands_print_the_same_with_workers(
    command: str,
    trained_here: GroupTraining,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    group = str(trained_here.group)
    arguments = {
        "eval": [group, "--episodes", "5"],
        "eval run": [f"{group}/seed-0", "--episodes", "9", "--json"],
        "compare": [group, "--episodes", "5", "--json"],
        "robustness": [f"{group}/seed-0", "--episodes", "2", "--min-return", "1", "--json"],
        "test": ["cartpole", "find_ball", "--json"],
    }[command]
    printed = []
    for more in ([], ["--workers", "2"]):
        code = main([command.split()[0], *arguments, *more])
        printed.append((code, re.sub(r'"seconds": [0-9.]+', "", capfd.readouterr().out)))
    assert (printed[1], printed[0][0]) == (printed[0], 0)


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (
            ["train", "cartpole", "--seeds", "3", "--workers", "2"],
            "--workers has nothing to divide, since there is one seed",
        ),
        (
            ["test", "cartpole", "--cluster", "auto"],
            "--cluster has nothing to divide, since there is one scenario",
        ),
        (["train", "cartpole", "--workers", "0"], "--workers 0 starts no process; write --workers 1 or more"),
        (
            ["test", "cartpole", "--workers", "-3"],
            "--workers -3 starts no process; write --workers 1 or more",
        ),
        (
            ["test", "cartpole", "find_ball", "--workers", "2", "--cluster", "auto"],
            "--workers and --cluster cannot be combined",
        ),
    ],
)
def test_workers_and_shards_that_make_no_sense_are_refused(
    arguments: list[str], reason: str, deepbots: Deepbots
) -> None:
    assert reason in deepbots(*arguments, code=2).err


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def finished(run: Path) -> TrainingResult:
    return TrainingResult(
        run=run,
        status="finished",
        steps=6_144,
        total_timesteps=6_000,
        episodes=146,
        mean_return=42.19,
        success_rate=None,
        simulated_hours=0.1,
        evaluation_steps=0,
        solved_at=None,
        cpu_seconds=1.0,
        wall_seconds=1.0,
        weights_digest="",
    )


def test_the_table_of_trainings_fits_80_columns(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setenv("LINES", "10")
    monkeypatch.setenv("TERM", "xterm")
    stream = Terminal()
    table = GroupProgressReporter(Path("runs/group"), range(20), stream)
    table.on_report(12, TrainingProgress(1_000_000, 40_000_000, 31_415, -1234.5, 0.125))
    table.on_done(0, finished(Path("runs/group/seed-0")))
    table.close()
    lines = re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", stream.getvalue()).splitlines()
    assert max(map(len, lines)) <= 80
    text = " ".join(" ".join(lines).split())
    assert "seed 12 training 1,000,000 of 40,000,000 steps" in text
    assert "episodes 31,415 return -1234.5 success 12%" in text
    assert "1 training, 1 finished, 18 waiting" in text


def test_without_a_terminal_each_training_has_a_line_at_its_end() -> None:
    stream = io.StringIO()
    lines = GroupProgressReporter(Path("runs/group"), (7, 8), stream)
    lines.on_loss(1)
    lines.on_done(0, finished(Path("runs/group/seed-7")))
    lines.stop()
    lines.stop()
    lines.close()
    assert stream.getvalue().splitlines() == [
        "note: the worker of seed 8 was lost; another one resumes the training",
        "seed 7  finished  6,144 of 6,000 steps  episodes 146  return 42.2",
        "stopping after these rollouts; continue with: deepbots resume runs/group",
    ]


def test_the_library_starts_the_function_that_is_replaced() -> None:
    worker = pytest.importorskip("ray._private.worker", exc_type=ImportError)

    assert "target=listen_error_messages" in inspect.getsource(worker.connect)
    original = worker.listen_error_messages
    with node_messages_silenced():
        assert worker.listen_error_messages is not original
    assert worker.listen_error_messages is original


EXAMPLES = Path(__file__).parents[2] / "docs" / "examples"


def test_the_file_for_slurm_has_no_mistakes_of_the_shell() -> None:
    shellcheck = shutil.which("shellcheck", path=str(Path(sys.executable).parent)) or shutil.which(
        "shellcheck"
    )
    if shellcheck is None:
        pytest.skip("shellcheck is not installed")
    done = subprocess.run(
        [shellcheck, EXAMPLES / "slurm.sbatch"], capture_output=True, text=True, check=False
    )
    assert done.stdout == ""


def test_the_pods_of_the_manifest_are_valid() -> None:
    kubernetes = pytest.importorskip("kubernetes_validate")
    job = yaml.safe_load((EXAMPLES / "rayjob.yaml").read_text())["spec"]["rayClusterSpec"]
    for group in (job["headGroupSpec"], *job["workerGroupSpecs"]):
        pod = {"apiVersion": "v1", "kind": "Pod", "metadata": {"name": "pod"}, **group["template"]}
        kubernetes.validate(pod, kubernetes.latest_version(), strict=True)


TIMES = ("cpu_seconds", "wall_seconds", "solved_at")
SOON = "solved=mean_return >= 1000 over 5 episodes"
SHORT = ("truncation.max_steps=5", SOON)


def train_section(algorithm: str, more: str = "") -> str:
    return (
        f"train={{algorithm: {algorithm}, total_timesteps: 1000, environments: 4, network: {{hidden: [16,"
        f" 16]}}, {more}}}"
    )


CASES = {
    "PPO": ("cartpole", [*SHORT, "train.environments=4"], 1_280),
    "PPO, normalized rewards": (
        "pit_escape",
        [SOON, "parameters.time_limit=1 s", "train.environments=4"],
        512,
    ),
    "PPO on a batch": (
        "cartpole",
        [*SHORT, "world.engine=mujoco", "train.environments=32", "train.n_steps=16"],
        1_536,
    ),
    "TD3, curriculum": (
        "find_ball_random",
        [
            *SHORT,
            "curriculum.0.until=120 steps",
            "train.environments=4",
            "train.learning_starts=100",
            "train.network.hidden=[16, 16]",
        ],
        240,
    ),
    "SAC": ("cartpole_continuous", [*SHORT, train_section("SAC", "learning_starts: 100")], 320),
    "A2C": ("cartpole", [*SHORT, train_section("A2C")], 320),
    "RecurrentPPO": (
        "cartpole",
        [*SHORT, train_section("RecurrentPPO", "n_steps: 32, batch_size: 32, lstm: 8")],
        384,
    ),
    "MaskablePPO": ("cartpole", [*SHORT, train_section("MaskablePPO", "n_steps: 32, batch_size: 32")], 384),
    "SAC, older weights": (
        "cartpole_continuous",
        [*SHORT, train_section("SAC", "learning_starts: 100, staleness: 1")],
        320,
    ),
    "PPO, older weights": ("cartpole", [*SHORT, "train.environments=4", "train.staleness=1"], 1_280),
    "DQN": ("cartpole", [*SHORT, train_section("DQN", "learning_starts: 100")], 320),
}
"""Short trainings, each with ended episodes and an evaluation: the scenario, what is changed in it, and the
number of steps."""


def outcome(folder: Path) -> tuple[Any, ...]:
    """The result of a training, to the bit; without times."""
    run = Run.open(folder)
    assert run.record.result is not None
    with run.monitor.open(newline="") as file:
        next(file)
        rows = [{name: value for name, value in row.items() if name != "t"} for row in csv.DictReader(file)]
    log = run.evaluations / "training.jsonl"
    result = {name: value for name, value in run.record.result if name not in TIMES}
    return result, rows, log.read_text() if log.exists() else ""


def trained(
    name: str, folder: Path, executor: Executor, shards: int = 2, progress: Reporter | bool = False
) -> tuple[Any, ...]:
    scenario, changes, steps = CASES[name]
    compiled = api.compile(scenario, overrides=[*changes, f"train.shards={shards}"])
    train(compiled, run=folder, total_timesteps=steps, executor=executor, progress=progress)
    return outcome(folder)


def workers() -> list[int]:
    """The processes of shards: children of this process, or of a raylet which is one."""
    return children("deepbots_cli.cluster.worker") or children("ray::ShardWorker")


def children(name: str) -> list[int]:
    processes = subprocess.run(
        ["ps", "-ww", "-eo", "pid=,ppid=,args="], capture_output=True, text=True, check=True
    ).stdout.splitlines()
    parents = {int(pid): int(parent) for pid, parent, *_ in map(str.split, processes)}
    matching = [int(line.split()[0]) for line in processes if name in line and "defunct" not in line]
    return sorted(pid for pid in matching if os.getpid() in (parents[pid], parents.get(parents[pid])))


class DeadlyProcesses(LocalProcesses):
    """Processes that die as soon as they get work."""

    is_deadly = False

    def ask(self, worker: Worker, method: str, *arguments: object) -> Owed:
        if self.is_deadly and method == "work":
            worker.process.end()
        return super().ask(worker, method, *arguments)


@pytest.mark.slow
def test_an_episode_that_always_kills_its_worker_ends_the_training(tmp_path: Path) -> None:
    processes = DeadlyProcesses(2)
    kill = At(400, lambda: setattr(processes, "is_deadly", True))
    with Cluster(workers=2) as cluster, processes:
        cluster._pool = processes
        with pytest.raises(RunError, match="ended its worker 3 times in the steps after"):
            trained("PPO", tmp_path / "run", cluster, progress=kill)
    resume(tmp_path / "run")
    assert outcome(tmp_path / "run") == trained("PPO", tmp_path / "here", SERIAL)


def test_a_worker_that_is_killed_between_two_calls_is_lost_in_the_next_one() -> None:
    with LocalProcesses(2) as processes:
        killed, survivor = processes.start(Echo), processes.start(Echo)
        processes.wait([processes.ask(worker, "work", 1) for worker in (killed, survivor)], count=2)
        killed.process.end()
        processes.wait([processes.ask(survivor, "work", 2)])  # meanwhile its end is noticed
        processes.wait([], timeout_s=0.0)
        deadline = time.monotonic() + 20.0
        while not killed.loss and time.monotonic() < deadline:
            processes.wait([processes.ask(survivor, "work", 3)])
        lost = processes.ask(killed, "work", 4)
        assert processes.wait([lost], timeout_s=20.0) == [lost]
        with pytest.raises(WorkerLost, match="ended by SIGKILL"):
            processes.answer(lost)


NODES = {"one node": (2,), "two nodes": (1, 1)}
"""The CPUs of each node."""


@pytest.fixture(scope="module", params=["workers", *NODES])
def executor(request: pytest.FixtureRequest) -> Iterator[Cluster]:
    """The workers for all cases of an executor."""
    if request.param == "workers":
        with Cluster(workers=2) as started:
            yield started
        return
    pytest.importorskip("ray")
    head, *others = NODES[request.param]
    with cluster_of_nodes(head) as nodes:
        for cpus in others:
            nodes.add_node(num_cpus=cpus, object_store_memory=100 << 20)
        with Cluster(address=nodes.address) as started:
            yield started


@pytest.fixture(scope="module")
def in_this_process(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str, int], Any]:
    """What a training makes in this process."""

    @cache
    def of(name: str, shards: int) -> Any:
        return trained(name, tmp_path_factory.mktemp("here") / "run", SERIAL, shards)

    return of


def check(
    executor: Cluster, in_this_process: Callable[[str, int], Any], folder: Path, name: str, shards: int
) -> None:
    whole = result, episodes, evaluations = trained(name, folder / "run", executor, shards)
    assert whole == in_this_process(name, shards)
    assert len(episodes) >= 20
    assert evaluations
    assert bool(result["stages"]) == ("curriculum" in name)


@pytest.mark.slow
@pytest.mark.parametrize("shards", [2, 4])
@pytest.mark.parametrize("name", list(CASES)[:5])
def test_a_training_is_the_same_on_workers_and_nodes(
    executor: Cluster, in_this_process: Callable[[str, int], Any], tmp_path: Path, name: str, shards: int
) -> None:
    check(executor, in_this_process, tmp_path, name, shards)


@pytest.mark.slow
@pytest.mark.parametrize("executor", ["workers"], indirect=True)
@pytest.mark.parametrize("name", list(CASES)[5:])
def test_so_is_that_of_other_algorithms(
    executor: Cluster, in_this_process: Callable[[str, int], Any], tmp_path: Path, name: str
) -> None:
    check(executor, in_this_process, tmp_path, name, 4)


@pytest.mark.parametrize("scenario", ["cartpole", "pit_escape"])
def test_one_shard_is_the_training_without_shards(scenario: str) -> None:
    assert api.compile(scenario, overrides=["train.shards=1"]).digest == api.compile(scenario).digest


@pytest.fixture
def nodes() -> Iterator[Any]:
    with cluster_of_nodes() as started:
        yield started


def add(nodes: Any) -> Any:
    return nodes.add_node(num_cpus=1, object_store_memory=100 << 20)


@pytest.mark.slow
def test_to_join_a_cluster_leaves_us_our_handler_of_sigterm(nodes: Any) -> None:
    before = signal.getsignal(signal.SIGTERM)
    with Cluster(address=nodes.address):
        assert signal.getsignal(signal.SIGTERM) == before


@pytest.mark.slow
def test_a_training_that_stops_on_a_cluster_goes_on_in_this_process(nodes: Any, tmp_path: Path) -> None:
    add(nodes)
    stop = At(300, lambda: os.kill(os.getpid(), signal.SIGINT))
    with Cluster(address=nodes.address) as cluster:
        trained("PPO", tmp_path / "run", cluster, progress=stop)
    resume(tmp_path / "run")
    assert outcome(tmp_path / "run") == trained("PPO", tmp_path / "here", SERIAL)


@pytest.mark.slow
def test_a_node_without_deepbots_that_joins_gets_no_work(nodes: Any, tmp_path: Path) -> None:
    class Notes(Watcher):
        texts: ClassVar[list[str]] = []

        def on_note(self, item: int, text: str) -> None:
            self.texts.append(text)

    (tmp_path / "deepbots_cli.py").write_text("raise ImportError")
    add(nodes)
    with Cluster(address=nodes.address) as cluster:

        def items() -> Iterator[int]:
            yield 0
            nodes.add_node(num_cpus=1, object_store_memory=100 << 20, env_vars={"PYTHONPATH": str(tmp_path)})
            yield from takewhile(lambda _: not Notes.texts, range(4, 5_000))
            yield from (1, 2)

        first, *_, last = cluster.map(square, items(), watcher=Notes())
    assert (first, last) == (0, 4)
    (note,) = Notes.texts
    assert re.fullmatch(
        r"a node that joined gets no work: the worker on .* cannot import deepbots; install the same version"
        r" there",
        note,
    )


@pytest.mark.slow
def test_a_node_without_deepbots_is_refused(
    nodes: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    package = tmp_path / "other" / "deepbots_cli"
    package.mkdir(parents=True)
    (package / "__init__.py").write_text("raise ImportError('it is not installed')")
    with monkeypatch.context() as patched:
        patched.setenv("PYTHONPATH", str(package.parent))
        add(nodes)
    with (
        Cluster(address=nodes.address) as cluster,
        pytest.raises(UsageError, match="a worker cannot import deepbots"),
    ):
        trained("PPO", tmp_path / "run", cluster)


def test_an_address_at_which_nobody_answers_is_refused() -> None:
    pytest.importorskip("ray")
    with pytest.raises(UsageError, match=r"nobody answers at 127\.0\.0\.1:9"), Cluster(address="127.0.0.1:9"):
        pass
    for text in ("nowhere", "10.0.0..5:6379", "ray://10.0.0.5:10001"):
        with pytest.raises(UsageError, match="is not an address of a Ray cluster"), Cluster(address=text):
            pass


def test_a_process_that_ends_before_it_joins_a_cluster_leaves_no_traceback() -> None:
    code = "import os; from deepbots_cli.cluster.ray_cluster import _message_if_lost as lost"
    code = f"{code}\nwith lost(): os._exit(0)"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, check=True).stderr == b""


@pytest.mark.slow
def test_a_worker_that_is_killed_is_named_and_leaves_its_log(either: Cluster, tmp_path: Path) -> None:
    kill = At(400, lambda: os.kill((workers() or children("ray::_perform"))[0], signal.SIGKILL))
    assert trained("PPO", tmp_path / "run", either, progress=kill) == trained(
        "PPO", tmp_path / "here", SERIAL
    )
    assert any("was lost; its shards continue" in note for note in kill.notes)
    assert (tmp_path / "run" / "workers" / "0.log").is_file()
    assert not workers()  # they end with the training
