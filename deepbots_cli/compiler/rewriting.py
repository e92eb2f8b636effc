"""Scalar trees inside of compiled parts, changed wherever they stand."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, is_dataclass, replace
from typing import Any

from deepbots_cli.lang.scalar import Scalar


def rewritten(part: Any, change: Callable[[Scalar], Scalar | None]) -> Any:
    """The part (a tree, a dataclass, a tuple of these) with every node replaced for which `change` gives another.

    What `change` gives is not looked into again; a part in which nothing changes is given back as it is.
    """
    if isinstance(part, tuple):
        items = tuple(rewritten(item, change) for item in part)
        return items if any(new is not old for new, old in zip(items, part, strict=True)) else part
    if not is_dataclass(part) or isinstance(part, type):
        return part
    if isinstance(part, Scalar) and (instead := change(part)) is not None:
        return instead
    changed = {}
    for field in fields(part):
        old = getattr(part, field.name)
        new = rewritten(old, change)
        if new is not old:
            changed[field.name] = new
    return replace(part, **changed) if changed else part
