"""The private members of Ray that deepbots uses. No other module names one.

Ray has no public switch for the messages of a cluster that is joined. A test looks for each member in the
library.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def node_messages_silenced() -> Iterator[None]:
    """Silence the messages of Ray's nodes within the block: deepbots reports lost workers itself."""
    from ray._private import worker

    before = worker.listen_error_messages
    worker.listen_error_messages = lambda *_: None
    try:
        yield
    finally:
        worker.listen_error_messages = before
