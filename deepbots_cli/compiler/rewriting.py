"""Scalar trees inside of compiled parts, changed wherever they stand."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from deepbots_cli.expressions.scalar import Scalar
from deepbots_cli.ir.records import members, with_members


def rewritten(part: Any, change: Callable[[Scalar], Scalar | None]) -> Any:
    """The part (a tree, a record, a tuple of these) with every node replaced for which `change` gives another.

    What `change` gives is not looked into again; a part in which nothing changes is given back as it is.
    """
    if isinstance(part, Scalar) and (instead := change(part)) is not None:
        return instead
    inside = members(part)
    if inside is not None:
        renewed = {name: rewritten(member, change) for name, member in inside.items()}
        return with_members(part, {name: new for name, new in renewed.items() if new is not inside[name]})
    if isinstance(part, tuple):
        items = tuple(rewritten(item, change) for item in part)
        return items if any(new is not old for new, old in zip(items, part, strict=True)) else part
    return part
