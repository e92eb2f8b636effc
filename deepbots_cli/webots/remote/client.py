"""The module `controller` in the process of a controller: each call goes to the server."""

from __future__ import annotations

import sys
import types
from multiprocessing.connection import Connection
from typing import Any
from weakref import WeakValueDictionary

from deepbots_cli.webots import devices, imaging, sensors, supervisor, tree
from deepbots_cli.webots.remote.server import (
    SUPERVISOR,
    Call,
    Create,
    Exit,
    Failed,
    Raised,
    Reference,
    replaced,
)
from deepbots_cli.webots.sensors import Device, missing_attribute, missing_name

_MODULES = (devices, imaging, sensors, supervisor, tree)


class Session:
    """The pipe to the server, and the objects here that stand for objects there."""

    def __init__(self, pipe: Connection) -> None:
        self._pipe = pipe
        self._unused: list[int] = []
        self._proxies: WeakValueDictionary[int, Proxy] = WeakValueDictionary()

    def create(self, proxy: Proxy, kind: str) -> None:
        """Create an object on the server for a new proxy."""
        reference = self._ask(Create(kind))
        proxy._number = reference.number
        self._proxies[reference.number] = proxy

    def call(self, number: int, method: str, arguments: tuple[Any, ...], options: dict[str, Any]) -> Any:
        """Call a method of an object of the server.

        Raises:
            Exception: The method raises it.
        """
        unused, self._unused = self._unused, []
        references = replaced(arguments, Proxy, lambda proxy: Reference(proxy._number, ""))
        value = self._ask(Call(number, method, references, options, unused))
        return replaced(value, Reference, self._proxy)

    def fail(self, description: str) -> None:
        """Say that the program failed."""
        self._pipe.send(Failed(description))

    def release(self, number: int) -> None:
        """Say with the next call that an object is not needed any more."""
        # Not sent at once: `__del__` may run within another request, and their answers would mix.
        self._unused.append(number)

    def _ask(self, request: Create | Call) -> Any:
        try:
            self._pipe.send(request)
            answer = self._pipe.recv()
        except (EOFError, OSError):
            raise SystemExit(0) from None  # the simulation has ended
        if isinstance(answer, Exit):
            raise SystemExit(answer.code)
        if isinstance(answer, Raised):
            raise answer.error
        return answer.value

    def _proxy(self, reference: Reference) -> Proxy:
        proxy = self._proxies.get(reference.number)
        if proxy is None:
            proxy = object.__new__(CLASSES[reference.kind])
            proxy._number = reference.number
            self._proxies[reference.number] = proxy
        if reference.number in self._unused:  # it was collected while this call ran
            self._unused.remove(reference.number)
        return proxy


_SESSION: list[Session] = []


def connect(pipe: Connection) -> Session:
    """Let the classes of this module ask the server at the other end of a pipe."""
    _SESSION[:] = [Session(pipe)]
    return _SESSION[0]


class Proxy:
    """Stands for an object of the server; `_real` is the class of that object."""

    _real: type = object
    _number = 0

    def __getattr__(self, name: str) -> Any:
        raise missing_attribute(self._real, name)

    def __del__(self) -> None:
        if self._number and _SESSION:
            _SESSION[0].release(self._number)


class _Root(Proxy):
    """A Robot, Supervisor or Keyboard, which programs create."""

    def __init__(self) -> None:
        _SESSION[0].create(self, next(base for base in type(self).__mro__ if base in _CREATED).__name__)
        if isinstance(self, CLASSES["Robot"]):
            self.keyboard = self.getKeyboard()

    def __getattr__(self, name: str) -> Any:
        if supervisor.is_device_getter(name) and isinstance(self, CLASSES["Robot"]):
            return self.getDevice
        return super().__getattr__(name)

    def getProjectPath(self) -> str:
        return sys.path[0]


def _method(name: str) -> Any:
    def forwarded(self: Proxy, *arguments: Any, **options: Any) -> Any:
        return _SESSION[0].call(self._number, name, arguments, options)

    forwarded.__name__ = name
    return forwarded


def _proxy_class(real: type, bases: tuple[type, ...]) -> type:
    """Return a class with the public names of a class: its constants and static functions, and methods that
    go to the server."""
    names: dict[str, Any] = {"_real": real}
    for name in (name for name in dir(real) if not name.startswith("_")):
        value = next(vars(base)[name] for base in real.__mro__ if name in vars(base))
        is_local = isinstance(value, staticmethod | int | float | str | tuple)
        if is_local or name not in vars(_Root):
            names[name] = value if is_local else _method(name)
    return type(real.__name__, bases, names)


def _classes() -> dict[str, type]:
    """Return a proxy class for each class of the module `controller` whose objects stay on the server."""
    kinds = (Device, tree.Node, tree.Field, supervisor.Robot, supervisor.Keyboard)
    proxies: dict[type, type] = {}

    def proxy_of(real: type) -> type:
        if real not in proxies:
            inner = [proxy_of(base) for base in real.__bases__ if issubclass(base, kinds)]
            root = _Root if issubclass(real, supervisor.Robot | supervisor.Keyboard) else Proxy
            proxies[real] = _proxy_class(real, tuple(inner) or (root,))
        return proxies[real]

    for module in _MODULES:
        for value in vars(module).values():
            if isinstance(value, type) and issubclass(value, kinds):
                proxy_of(value)
    return {real.__name__: proxy for real, proxy in proxies.items()}


CLASSES: dict[str, Any] = _classes()
_CREATED = [CLASSES[name] for name in ("Robot", SUPERVISOR, "Keyboard")]


def controller_module() -> types.ModuleType:
    """Return Webots' module `controller`, whose classes ask the server."""
    module = types.ModuleType("controller", "Webots' module `controller`, in the process of a controller.")
    local = (tree.ContactPoint, imaging.LidarPoint, imaging.RadarTarget)
    vars(module).update(CLASSES, __getattr__=missing_name, **{value.__name__: value for value in local})
    return module
