"""Dataclasses that cost little at import.

`dataclasses.dataclass` compiles up to six methods of each class when its module is imported, 0.3 to 0.6 ms in
all: a quarter of the CPU time of `deepbots lint`, which makes instances of a third of its classes. Here
`__init__` is compiled for the first instance, and no other method is.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from operator import attrgetter
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from dataclasses import dataclass as dataclass
else:

    def dataclass(cls=None, /, *, frozen=False, eq=True, repr=True, kw_only=False):  # noqa: A002
        """Make a class a dataclass, as `dataclasses.dataclass` does with the same options."""
        if cls is None:
            return lambda cls: dataclass(cls, frozen=frozen, eq=eq, repr=repr, kw_only=kw_only)
        own = dict(vars(cls))
        if "__eq__" in own and own["__hash__"] is None:  # Python's own, beside `__eq__`
            del own["__hash__"]
        cls.__doc__ = cls.__doc__ or cls.__name__  # `dataclasses` would read a signature, for 0.5 ms
        dataclasses.dataclass(init=False, repr=False, eq=False, kw_only=kw_only)(cls)
        methods = {"__init__": _first_init(cls, frozen)}
        if repr:
            methods["__repr__"] = _repr
        if eq:
            methods |= _comparison(cls, frozen)
        if frozen:
            methods |= _refusals(cls)
        for name, method in methods.items():
            if name not in own:
                setattr(cls, name, method)
        return cls


def _first_init(cls: Any, frozen: bool) -> Callable[..., None]:
    """Return an `__init__` that puts a compiled one into its place."""

    def init(self: Any, *args: Any, **kwargs: Any) -> None:
        cls.__init__ = _compiled_init(cls, frozen)
        cls.__init__(self, *args, **kwargs)

    return init


def _compiled_init(cls: type, frozen: bool) -> Callable[..., None]:
    """Return the `__init__` that `dataclasses.dataclass` would write for a class."""
    names: dict[str, Any] = {"_set": object.__setattr__, "_missing": dataclasses.MISSING}
    positional, keywords, lines = ["self"], ["*"], ["pass"]
    for field in dataclasses.fields(cls):
        value, default = field.name, ""
        if field.default is not dataclasses.MISSING:
            names[f"_default_{field.name}"], default = field.default, f"=_default_{field.name}"
        elif field.default_factory is not dataclasses.MISSING:
            names[f"_make_{field.name}"], default = field.default_factory, "=_missing"
            value = f"_make_{field.name}() if {field.name} is _missing else {field.name}"
        if field.init:
            (keywords if field.kw_only else positional).append(field.name + default)
        elif default == "=_missing":
            value = f"_make_{field.name}()"
        else:
            continue  # without a value, or with that of the class
        lines.append(f"_set(self, {field.name!r}, {value})" if frozen else f"self.{field.name} = {value}")
    if hasattr(cls, "__post_init__"):
        lines.append("self.__post_init__()")
    parameters = positional if len(keywords) == 1 else positional + keywords
    exec(f"def __init__({', '.join(parameters)}):\n  " + "\n  ".join(lines), names)
    init: Callable[..., None] = names["__init__"]
    return init


def _repr(self: Any) -> str:
    shown = (field.name for field in dataclasses.fields(self) if field.repr)
    return f"{type(self).__qualname__}({', '.join(f'{name}={getattr(self, name)!r}' for name in shown)})"


def _comparison(cls: type, frozen: bool) -> dict[str, Any]:
    """Return `__eq__` and `__hash__` of a class, by the values of its fields."""
    fields = dataclasses.fields(cls)
    values = _values([field.name for field in fields if field.compare])
    hashed = _values([f.name for f in fields if (f.compare if f.hash is None else f.hash)])

    def equals(self: Any, other: object) -> bool:
        return values(self) == values(other) if type(other) is type(self) else NotImplemented

    def hash_of(self: Any) -> int:
        return hash(hashed(self))

    return {"__eq__": equals, "__hash__": hash_of if frozen else None}


def _values(names: list[str]) -> Callable[[Any], Any]:
    """Return a function for the values of attributes, which are a tuple unless there is one."""
    return attrgetter(*names) if names else lambda _: ()


def _refusals(cls: Any) -> dict[str, Any]:
    """Return the methods of a frozen class that would set or delete an attribute."""
    names = {field.name for field in dataclasses.fields(cls)}

    def set_attribute(self: Any, name: str, value: Any) -> None:
        if type(self) is cls or name in names:
            raise dataclasses.FrozenInstanceError(f"cannot assign to field {name!r}")
        super(cls, self).__setattr__(name, value)

    def delete_attribute(self: Any, name: str) -> None:
        if type(self) is cls or name in names:
            raise dataclasses.FrozenInstanceError(f"cannot delete field {name!r}")
        super(cls, self).__delattr__(name)

    return {"__setattr__": set_attribute, "__delattr__": delete_attribute}
