"""Plug-ins: entries that other installed packages add to the tables of deepbots, by entry points.

    deepbots.sensors      a class of `scenario.sensors`, under the word of its `type`
    deepbots.actuators    a class of `scenario.actuators`, under the word of its `type`
    deepbots.functions    one or several `expressions.functions.Function`
    deepbots.formats      a `message_formats.MessageFormat`, under its name
    deepbots.rules        one or several `diagnostics.Rule`, each with a `check`
    deepbots.algorithms   a subclass of a model of `scenario.training`, under its name
    deepbots.callbacks    makes a callback of the learner's library, under its name
    deepbots.loggers      makes a writer of its log, under its name
    deepbots.engines      a `port.EngineFactory`, under its name
    deepbots.scenarios    a package whose folder holds `scenarios/*.yaml` and `robots/urdf/*.urdf`

`deepbots.webots` has the commands of deepbots-webots (`cli/command.py`).

A group is loaded when a name is looked up that deepbots does not define itself, or when all names are listed.
An entry that cannot be loaded, has the wrong type or has a name that is taken is left out, with one warning
that gives the reason.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from functools import cache
from importlib import import_module
from importlib.metadata import EntryPoint, EntryPoints
from typing import Any, Generic, TypeVar, cast

from deepbots_cli.errors import UsageError

T = TypeVar("T")


def entry_points_of(group: str) -> tuple[EntryPoint, ...]:
    """Return the entry points of a group, in the order in which packages are found."""
    # The path is the key of the cache: a folder that is added to `sys.path` later is searched, too.
    return tuple(_entry_points_on_path(tuple(sys.path)).select(group=group))


@cache
def _entry_points_on_path(_path: tuple[str, ...]) -> EntryPoints:
    """Return the entry points of all packages on the path; each file is read once."""
    from importlib.metadata import entry_points

    return cast("EntryPoints", entry_points())


def warn_unavailable(entry: EntryPoint, reason: object) -> None:
    """Warn that the objects of an entry point are left out."""
    import logging

    logging.getLogger("deepbots").warning("warning: %s", unavailable_message(entry, reason))


def unavailable_message(entry: EntryPoint, reason: object) -> str:
    """Return the text of the warning."""
    message = f"{type(reason).__name__}: {reason}" if isinstance(reason, BaseException) else str(reason)
    noun = entry.group.rpartition(".")[2]
    return f"the {noun} '{entry.name}' ({entry.value}) are not available: {' '.join(message.split())[:300]}"


def packages_used(words: Collection[str]) -> dict[str, str]:
    """Return the packages of the plug-ins that have one of these names, with their versions. Only tables that
    are loaded are searched: no other one has had to look up a name of a plug-in."""
    entries = {entry for table in _TABLES for name, entry in table.origins.items() if name in words}
    return {entry.dist.name: entry.dist.version for entry in entries if entry.dist is not None}


_TABLES: list[PluginTable[Any]] = []


def import_attribute(place: str) -> Any:
    """Import and return the object at `module:attribute`.

    Raises:
        ImportError: There is no such module.
        UsageError: The module has no such attribute.
    """
    module, _, name = place.partition(":")
    imported = import_module(module)
    if not hasattr(imported, name):
        raise UsageError(f"a plug-in names '{place}', but {imported.__file__} has no '{name}'")
    return getattr(imported, name)


class PluginTable(Mapping[str, T], Generic[T]):
    """A table of entries by name: our own first, then those of plug-ins.

    `read` gets the name and the object of an entry point, yields named entries, and raises an exception for
    an object that cannot be used. Without `imports`, it gets the `module:attribute` instead, and nothing is
    imported.
    """

    def __init__(
        self,
        group: str,
        built_in: Mapping[str, T],
        read: Callable[[str, Any], Iterable[tuple[str, T]]],
        *,
        imports: bool = True,
    ) -> None:
        self.group = group
        self.built_in = built_in
        self._read = read
        self._imports = imports
        self._all: dict[str, T] | None = None
        self.origins: dict[str, EntryPoint] = {}
        """The entry points of the entries of plug-ins, once these are loaded."""
        _TABLES.append(self)

    __hash__ = object.__hash__  # a field type that has a table is a key of caches

    def __eq__(self, other: object) -> bool:
        return self is other

    def _loaded(self) -> Mapping[str, T]:
        if self._all is None:
            self._all = dict(self.built_in)  # set first: a plug-in may ask for the table while it is loaded
            for entry in entry_points_of(self.group):
                try:
                    for name, plugin in self._read(
                        entry.name, entry.load() if self._imports else entry.value
                    ):
                        if name in self._all:
                            raise ValueError(f"the name {name!r} is taken")
                        self._all[name] = plugin
                        self.origins[name] = entry
                except Exception as error:  # noqa: BLE001 - the code of a plug-in may raise anything
                    warn_unavailable(entry, error)
        return self._all

    @property
    def from_plugins(self) -> Mapping[str, T]:
        """The entries of plug-ins."""
        return {name: plugin for name, plugin in self._loaded().items() if name not in self.built_in}

    def __getitem__(self, name: str) -> T:
        return self.built_in[name] if name in self.built_in else self._loaded()[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._loaded())

    def __len__(self) -> int:
        return len(self._loaded())
