"""Bundles of policies that have learned nothing, for all tests that only read them."""

from __future__ import annotations

from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A policy with two memories, that of a filter on board and the last action; not to be changed."""
    from tests.bundle.untrained import write_bundle  # needs onnx

    return write_bundle(tmp_path_factory.mktemp("bundle") / "balancer", "balancer")


@pytest.fixture(scope="session")
def choosing(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A policy that chooses; not to be changed."""
    from tests.bundle.untrained import write_bundle

    return write_bundle(tmp_path_factory.mktemp("bundle") / "cartpole", "cartpole")
