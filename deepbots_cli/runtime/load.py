"""Generated Python text to a module whose tracebacks show its lines."""

from __future__ import annotations

import linecache
from types import CodeType, ModuleType

_CACHE: dict[str, CodeType] = {}  # compiled text by file name; the name holds the digest of the scenario


def load_module(code: str, name: str, filename: str) -> ModuleType:
    """Run `code`, which the compiler printed from typed trees, as module `name`.

    `filename` appears in tracebacks (`<deepbots CartPole 1a2b3c4d>`); its lines are registered, so that
    tracebacks and debuggers show them.
    """
    if filename not in _CACHE or linecache.getlines(filename) != code.splitlines(keepends=True):
        _CACHE[filename] = compile(code, filename, "exec", dont_inherit=True)
        linecache.cache[filename] = (len(code), None, code.splitlines(keepends=True), filename)
    module = ModuleType(name)
    module.__file__ = filename
    exec(_CACHE[filename], module.__dict__)
    return module
