"""Compiled parts seen from outside: records with named members, whatever they are made of.

Most are dataclasses. Expressions (`lang.scalar`) are named tuples: to whoever goes through tuples, they are to be told from those first.
"""

from __future__ import annotations

from dataclasses import fields, is_dataclass, replace
from typing import Any

from deepbots_cli.expressions.scalar import Scalar


def members(part: object) -> dict[str, Any] | None:
    """The members of a record by their names, in their order; None for what is no record."""
    if isinstance(part, Scalar):
        return part._asdict()
    if is_dataclass(part) and not isinstance(part, type):
        return {field.name: getattr(part, field.name) for field in fields(part)}
    return None


def with_members(record: Any, changed: dict[str, Any]) -> Any:
    """The record with other members; itself where there are none."""
    if not changed:
        return record
    return record._replace(**changed) if isinstance(record, Scalar) else replace(record, **changed)
