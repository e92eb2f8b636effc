"""Ray has the private members that deepbots uses, and one module names them."""

from __future__ import annotations

import inspect
from pathlib import Path

import pytest

pytest.importorskip("ray")
from deepbots_cli.cluster import ray_internals

MODULE = Path(ray_internals.__file__)


def test_the_library_starts_the_function_that_is_replaced() -> None:
    from ray._private import worker

    assert "target=listen_error_messages" in inspect.getsource(worker.connect)
    original = worker.listen_error_messages
    with ray_internals.node_messages_silenced():
        assert worker.listen_error_messages is not original
    assert worker.listen_error_messages is original
