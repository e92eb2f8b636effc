"""A Ray of its own on this machine, or one that runs already.

A Ray of its own listens on the loopback interface only, asks for a token that it makes for this process, and ends with it. Its files lie in
a temporary folder. Ray replaces 127.0.0.1 by the address of the host, prints the messages of its nodes, and has no options against this,
so `_loopback_only` and `_quiet` replace private functions of Ray. Its version is pinned for this reason, and tests look at the ports and
at the terminal.
"""

from __future__ import annotations

import logging
import os
import secrets
import shutil
import signal
import socket
import subprocess
import tempfile
import threading
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Any, Self, Unpack

from deepbots_cli.api import build as api_build
from deepbots_cli.errors import DeepbotsError, MissingExtraError, UsageError
from deepbots_cli.learning.spread import Attempt, CallOptions, Item, Result
from deepbots_cli.processes import python_environment, python_script

if TYPE_CHECKING:  # what evaluates and trains imports torch; tests of scenarios do without
    from deepbots_cli.learning.environments import WorldFactory
    from deepbots_cli.learning.run import Run
    from deepbots_cli.program.task import Training
    from deepbots_cli.rollout.collector import ShardPool

MAX_WORKERS = 1024
_OBJECT_STORE_BYTES = 512 << 20
_ADDRESS_TIMEOUT_S = 5.0
_MAX_FOLDER_BYTES = 30
_SILENT: Mapping[str, Any] = {"log_to_driver": False, "logging_level": logging.CRITICAL}
_SETTINGS = {
    "RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0",  # workers see the GPU as before
    "RAY_ENABLE_UV_RUN_RUNTIME_ENV": "0",
    "RAY_OBJECT_STORE_ALLOW_SLOW_STORAGE": "1",  # in a container with a small /dev/shm
    "RAY_USAGE_STATS_ENABLED": "0",
    "RAY_worker_niceness": "0",  # workers have the priority of this process; by default they come after all others
}
_LOST = "error: the connection to Ray was lost, or this process was killed; to continue"
_WITNESS = """
import sys
last = sys.stdin.read().splitlines()[-1]
if last:
    print(last, file=sys.stderr)
"""


class Cluster:
    """Workers for the shards of a training, and for several trainings, evaluations or tests (`map`); a context manager.

    Args:
        workers: Start a Ray with this number of workers on this machine. It ends with the block.
        address: Join the Ray cluster at `HOST:PORT`, or the one of this machine (`auto`).
    """

    def __init__(self, *, workers: int | None = None, address: str | None = None) -> None:
        if (workers is None) == (address is None):
            raise UsageError("name either a number of workers or the address of a cluster")
        if workers is not None and not 1 <= workers <= MAX_WORKERS:
            raise UsageError(f"the number of workers must be from 1 to {MAX_WORKERS}, not {workers}")
        self._workers, self._address = workers, address
        self._stack = ExitStack()
        self._set_last_words: Callable[[str], None] = lambda text: None

    def __enter__(self) -> Self:
        try:
            import ray
        except ModuleNotFoundError:
            raise MissingExtraError("cluster", "--workers and --cluster") from None
        if self._address is not None:
            _check_address(self._address)
        if ray.is_initialized():
            raise UsageError("this process uses a Ray cluster already; end it with ray.shutdown()")
        with ExitStack() as stack:
            stack.enter_context(_environment(_SETTINGS))
            self._set_last_words = stack.enter_context(_last_words())
            self._set_last_words(f"{_LOST} a training, use `deepbots train --resume`")
            with _termination_handler_kept():
                if self._workers is not None:
                    self._start(stack)
                else:
                    self._join(stack)
            self._stack = stack.pop_all()
        return self

    def _start(self, stack: ExitStack) -> None:
        """Start a Ray of its own."""
        import ray

        folder = Path(tempfile.mkdtemp(prefix="deepbots-", dir=_folder_for_sockets()))
        stack.callback(shutil.rmtree, folder, ignore_errors=True)
        stack.enter_context(_environment({"RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN": secrets.token_hex(32)}))
        stack.callback(ray.shutdown)
        with _working_directory(folder), _environment(python_environment()), _loopback_only(), _quiet():
            ray.init(
                address="local",
                num_cpus=self._workers,
                num_gpus=0,
                object_store_memory=_OBJECT_STORE_BYTES,
                _node_ip_address="127.0.0.1",
                include_dashboard=False,
                _temp_dir=str(folder),
                **_SILENT,
            )

    def _join(self, stack: ExitStack) -> None:
        """Join a cluster that runs.

        Raises:
            UsageError: Nobody answers, or the cluster has another version of Ray or Python.
        """
        import ray

        address = str(self._address)
        stack.callback(ray.shutdown)
        try:
            with tempfile.TemporaryDirectory() as folder, _working_directory(Path(folder)), _quiet():
                ray.init(address=address, **_SILENT)
        except (ConnectionError, ValueError) as error:
            raise UsageError(f"there is no Ray cluster at {address}; start one with: ray start --head") from error
        except (RuntimeError, ray.exceptions.RayError) as error:
            raise UsageError(f"the cluster at {address} refuses this process: {' '.join(str(error).split())}") from error

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    @property
    def workers(self) -> int:
        """The number of workers: that which was asked for, or the CPUs of the cluster."""
        import ray

        return self._workers or max(1, int(ray.cluster_resources().get("CPU", 1)))

    def shards(self, stack: ExitStack, run: Run, training: Training, build: WorldFactory, note: Callable[[str], None]) -> ShardPool:
        """The shards of a training on the workers.

        Raises:
            UsageError: A worker does not see the run, or has another version of deepbots or of its libraries.
        """
        from deepbots_cli.cluster.shards import RemoteShards
        from deepbots_cli.learning.shards import world_numbers

        if not isinstance(build, partial) or build.func is not api_build:
            raise UsageError("the argument `build` makes worlds in this process only; leave out the workers")
        pool = RemoteShards(run, build.keywords["permissions"], world_numbers(training), self.workers, note)
        stack.callback(pool.close)
        self._set_last_words(f"{_LOST}: deepbots train --resume {quote(str(run.path))}")
        return pool

    @property
    def is_on_this_machine(self) -> bool:
        """Whether this process has started the workers."""
        return self._address is None

    is_here = False

    def map(
        self, function: Callable[[Item, Attempt], Result], items: Iterable[Item], **options: Unpack[CallOptions]
    ) -> Generator[Result | DeepbotsError | None]:
        """Call a function with each item on the workers, as many at a time as there are workers; see `Spread.map`."""
        from deepbots_cli.cluster.tasks import Tasks

        return Tasks(lambda: self.workers, options, is_joined=self._address is not None).run(function, items)


def _folder_for_sockets() -> str:
    """The folder for temporary files, or another one if its path is too long: that of a socket has at most 107 bytes.

    Raises:
        UsageError: None is short enough.
    """
    for folder in (tempfile.gettempdir(), "/tmp", "/dev/shm"):
        if len(os.fsencode(folder)) <= _MAX_FOLDER_BYTES and os.access(folder, os.W_OK):
            return folder
    raise UsageError(f"{tempfile.gettempdir()} has a long path, and sockets need a short one; set TMPDIR to a folder such as /tmp")


def _check_address(address: str) -> None:
    """Raises: UsageError: It is no address, or nobody answers there."""
    if address == "auto":
        return
    host, _, port = address.rpartition(":")
    if not host or not port.isdecimal() or int(port) > 65535:
        raise UsageError(f"'{address}' is no address of a Ray cluster; write HOST:PORT, such as 10.0.0.5:6379, or auto")
    try:
        socket.create_connection((host.strip("[]"), int(port)), _ADDRESS_TIMEOUT_S).close()
    except OSError as error:
        raise UsageError(f"nobody answers at {address} ({error.strerror or error}); is the cluster running?") from error


@contextmanager
def _environment(settings: Mapping[str, str]) -> Iterator[None]:
    """Within, these variables of the environment are set. Ray reads those of its configuration again before and after."""
    from ray._raylet import AuthenticationTokenLoader, Config

    def read_again() -> None:
        Config.initialize("")
        AuthenticationTokenLoader.instance().reset_cache()

    before = {name: os.environ.get(name) for name in settings}
    os.environ.update(settings)
    read_again()
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
        read_again()


@contextmanager
def _last_words() -> Iterator[Callable[[str], None]]:
    """Yield a function that sets what another process prints if this one ends within the block.

    Ray ends this process without a message when its node or the head of the cluster is lost, as soon as it needs one of them.
    """
    witness = subprocess.Popen(python_script(_WITNESS), stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True, start_new_session=True)

    def set_last_words(text: str) -> None:
        with suppress(OSError):  # the witness was killed
            print(text, file=witness.stdin, flush=True)

    with witness:
        try:
            yield set_last_words
        finally:
            set_last_words("")


@contextmanager
def _termination_handler_kept() -> Iterator[None]:
    """The handler of SIGTERM stays as it is; Ray sets one that ends the process."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.getsignal(signal.SIGTERM)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


@contextmanager
def _working_directory(folder: Path) -> Iterator[None]:
    """Within, the working directory is `folder`: Ray puts it first on the import path of its workers."""
    before = Path.cwd()
    os.chdir(folder)
    try:
        yield
    finally:
        os.chdir(before)


@contextmanager
def _replaced(module: Any, name: str, function: Callable[..., Any]) -> Iterator[None]:
    """Within, a function of a module of Ray is another one."""
    before = getattr(module, name)
    setattr(module, name, function)
    try:
        yield
    finally:
        setattr(module, name, before)


@contextmanager
def _quiet() -> Iterator[None]:
    """Within, a Ray that is started or joined does not print the messages of its nodes. Lost workers are reported by deepbots."""
    from ray._private import worker

    with _replaced(worker, "listen_error_messages", lambda *_: None):
        yield


@contextmanager
def _loopback_only() -> Iterator[None]:
    """Within, a Ray that is started keeps the address 127.0.0.1."""
    from ray._private import services

    with _replaced(services, "resolve_ip_for_localhost", lambda host: host):
        yield
