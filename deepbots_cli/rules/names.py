"""Rules about names."""

from __future__ import annotations

from collections.abc import Iterator

from deepbots_cli.compile import Checked
from deepbots_cli.compile.namespace import Origin
from deepbots_cli.diagnostics import Finding

_COUNTED = (Origin.PARAMETER, Origin.ACTION, Origin.FIELD, Origin.AUGMENT, Origin.SIGNAL)


def unused_definition(checked: Checked) -> Iterator[Finding]:
    """DB205: a parameter, action variable, field or signal is defined and never used.

    Most often it is a misspelling elsewhere, or what remains of an earlier version.
    """
    if checked.namespace is None:
        return
    for name, definition in checked.namespace.definitions.items():
        if definition.origin in _COUNTED and definition.uses == 0:
            span = checked.namespace.values.key_span(definition.path)
            yield Finding("DB205", span, f"`{name}` is {definition.origin.value} that nothing uses", help="use it or take it out")
