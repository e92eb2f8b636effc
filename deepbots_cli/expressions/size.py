"""How large an expression becomes when its vectors are written out as single numbers.

A vector function repeats its arguments for every component, so a few nested calls could grow to
millions of operations; a checked expression stays below `MAX_SIZE`.
"""

from __future__ import annotations

from deepbots_cli.expressions.typed import Constant, Invocation, Reference, Typed, Vector, children

MAX_SIZE = 10_000
# The arithmetic of the largest world function, per component of its result.
_WORLD_SIZE = 40
# `local` turns a vector: every component of the result reads all three of the argument.
_ROTATION_READS = 3


def size(node: Typed) -> int:
    """An upper bound of the number of operations over all components, itself cut off at twice `MAX_SIZE`."""
    own = len(node.type.components) if node.type.components else 1
    if isinstance(node, (Constant, Reference)):
        return min(own, 2 * MAX_SIZE)
    of_world = isinstance(node, Invocation) and bool(node.subjects)
    repeated = _ROTATION_READS if of_world else 1
    total = own * (_WORLD_SIZE if of_world else 1)
    for child in children(node):
        single = child.type.components is None and not isinstance(node, Vector)
        total += size(child) * (own if single else 1) * repeated
    return min(total, 2 * MAX_SIZE)
