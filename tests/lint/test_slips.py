"""The most frequent slips of a beginner: each message names the place, the reason and the line to write."""

from pathlib import Path

import pytest

from deepbots_cli.cli import main
from tests.lint.slips import SLIPS, Slip


@pytest.mark.parametrize("slip", SLIPS, ids=str)
def test_the_message_of_a_slip_names_the_place_the_reason_and_the_line_to_write(
    slip: Slip, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(slip.write(tmp_path))
    code = main(list(slip.command))
    said = "".join(capfd.readouterr())
    assert code != 0, said
    if slip.at:
        assert slip.at in said
    for part in slip.says:
        assert part in said


def test_a_slip_is_named_once() -> None:
    assert len({slip.name for slip in SLIPS}) == len(SLIPS) >= 40
