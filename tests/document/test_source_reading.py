"""Files are read up to a limit, and memory is asked for by what they hold."""

from __future__ import annotations

import tracemalloc
from pathlib import Path

import pytest

from deepbots_cli.files import read_at_most


@pytest.mark.parametrize(
    ("size", "most"), [(0, 5), (4, 5), (5, 5), (6, 5), (70_000, 5), (70_000, 70_001), (70_000, 1 << 25)]
)
def test_a_file_is_read_to_its_end_or_to_the_limit(tmp_path, size, most):
    data = bytes(number % 251 for number in range(size))
    (tmp_path / "file").write_bytes(data)
    assert read_at_most(tmp_path / "file", most) == data[:most]


@pytest.mark.skipif(not Path("/proc/version").exists(), reason="no file here says less than it holds")
def test_a_file_that_says_that_it_is_empty_is_read_all_the_same():
    whole = Path("/proc/version").read_bytes()
    assert Path("/proc/version").stat().st_size == 0 < len(whole)
    assert read_at_most(Path("/proc/version"), 1000) == whole
    assert read_at_most(Path("/proc/version"), 3) == whole[:3]


def test_a_small_file_takes_no_memory_for_the_largest_that_might_be(tmp_path):
    (tmp_path / "file").write_text("deepbots: 1\n")
    tracemalloc.start()
    try:
        read_at_most(tmp_path / "file", 1 << 25)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 1 << 20
