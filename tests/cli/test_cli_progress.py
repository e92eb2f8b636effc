"""The bar that shows how many episodes a command has played."""

from __future__ import annotations

import io

import pytest

from deepbots_cli.cli import terminal
from deepbots_cli.cli.terminal import ProgressBar


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_on_a_terminal_one_line_is_rewritten_and_erased() -> None:
    screen = Terminal()
    bar = ProgressBar(40, "episodes", stream=screen)
    for number in range(1, 41):
        bar.update(number)
    bar.close()
    text = screen.getvalue()
    assert "1 of 40 episodes" in text
    assert "40 of 40 episodes" in text
    assert text.rpartition("40 of 40 episodes")[2].endswith("\x1b[2K")


def test_a_second_row_of_episodes_is_counted_from_its_own_first_one_on(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with terminal.progress() as show:
        for number in (*range(1, 11), *range(1, 11)):
            show(number, 10)
    assert [line.partition(" ")[0] for line in capsys.readouterr().err.splitlines()] == [
        *map(str, range(1, 11))
    ] * 2


def test_elsewhere_there_is_a_line_for_every_tenth() -> None:
    log = io.StringIO()
    bar = ProgressBar(40, "episodes", stream=log)
    for number in range(1, 41):
        bar.update(number)
    assert [line.partition(" ")[0] for line in log.getvalue().splitlines()] == [*map(str, range(4, 41, 4))]
