"""Generated Python text to a module whose tracebacks show its lines."""

from __future__ import annotations

import linecache
from functools import lru_cache
from types import CodeType, ModuleType


def load_module(code: str, name: str, filename: str) -> ModuleType:
    """Run `code`, which the compiler printed from typed trees, as module `name`.

    `filename` appears in tracebacks (`<deepbots CartPole 1a2b3c4d>`); its lines are registered, so that
    tracebacks and debuggers show them.
    """
    linecache.cache[filename] = (len(code), None, code.splitlines(keepends=True), filename)
    module = ModuleType(name)
    module.__file__ = filename
    exec(_compiled(code, filename), module.__dict__)
    return module


@lru_cache(maxsize=16)
def _compiled(code: str, filename: str) -> CodeType:
    """Copies of one environment share the compiled text."""
    return compile(code, filename, "exec", dont_inherit=True)
