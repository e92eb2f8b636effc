"""The open files of the studio: text from the editor, from the studio and from other programs is merged,
saved and kept."""

from __future__ import annotations

import json
import os
import random
import resource
from collections import Counter

import pytest
from hypothesis import given
from hypothesis import strategies as st

from deepbots_cli.document import Permissions
from deepbots_cli.document.files import MAX_BYTES
from deepbots_cli.document.layout import canonical_text
from deepbots_cli.errors import UsageError
from deepbots_cli.studio.files import Drafts, OpenFile, TextEdit, difference, edited, merged
from deepbots_cli.studio.language import Language

TEXTS = st.text(alphabet="ab \n:#é\U0001f600", max_size=40)
SCENARIO = """# A cart with a pole.
deepbots: 1
name: Mine  # the title
parameters:
  fall_angle: 15 deg  # the largest lean
  speed: 5 rad/s

  # of the cart
  cart_mass: 1 kg
world: {timestep: 32 ms,   substeps: 4}  # half of it is too fast
reward:
  alive: 1
  # a small cost
  effort: -0.1 * drive^2
truncation: {max_steps: 100}
"""


@given(TEXTS, TEXTS)
def test_an_edit_turns_one_text_into_another(before, after):
    assert edited(before, [difference(before, after)]) == after


@given(TEXTS, TEXTS, TEXTS, TEXTS, TEXTS)
def test_changes_of_different_lines_are_both_kept(head, middle, tail, one, other):
    def text(first, last):
        return f"{head}\n1{first}\n2{middle}\n3{last}\n{tail}"

    base = text("", "")
    merge = merged(base, text(one, ""), text("", other))
    assert merge == text(one, other)


@given(TEXTS, TEXTS, TEXTS)
def test_a_change_of_one_side_is_taken_as_it_is(base, one, other):
    assert merged(base, one, base) == one
    assert merged(base, base, other) == other
    assert merged(base, one, one) == one


@given(TEXTS, TEXTS, TEXTS)
def test_every_typed_character_survives_a_merge(base, typed, other):
    merge = merged(base, typed, other)
    inserted = Counter(typed) - Counter(base)
    assert not inserted - Counter(merge) - Counter("".join(difference(base, other)[2:]))


def test_the_typed_word_counts_where_both_changed_it():
    base = "a: 1\nspeed: 5 rad/s  # slow\nb: 2\n"
    typed = "a: 1\nspeed: 7 rad/s  # slow\nb: 2\n"
    on_disk = "a: 0\nspeed: 6 rad/s  # quick\nb: 3\n"
    assert merged(base, typed, on_disk) == "a: 0\nspeed: 7 rad/s  # quick\nb: 3\n"


def test_two_insertions_at_one_place_are_both_kept():
    assert merged("a\nb\n", "a\nmine\nb\n", "a\ntheirs\nb\n") == "a\nmine\ntheirs\nb\n"
    assert merged("a\n", "a\nmine", "a\nmine more") == "a\nmine more"  # sent twice


def test_a_browser_that_was_away_merges_with_what_it_has_missed(tmp_path):
    file = OpenFile(tmp_path / "mine.yaml", SCENARIO)
    first = file.revision
    for letter in "a long note by another browser, of more than fifty letters in one line":
        file.change(file.revision, file.text + letter)
    is_same = file.change(first, SCENARIO.replace("name: Mine", "name: Yours"))
    assert not is_same
    assert "name: Yours  # the title\n" in file.text
    assert file.text.endswith("in one line")


def test_a_text_can_be_sent_with_the_text_that_it_is_based_on(tmp_path):
    file = OpenFile(tmp_path / "mine.yaml", "a: 1\nb: 1\nc: 1\n")
    file.change(1, "a: 2\nb: 1\nc: 2\n")
    assert not file.change("a: 1\nb: 1\nc: 1\n", "a: 1\nb: 3\nc: 1\n")
    assert file.text == "a: 2\nb: 3\nc: 2\n"


class Person:
    """A browser: its text, and the revision that it is based on."""

    def __init__(self, file: OpenFile) -> None:
        self.file = file
        self.pull()

    def pull(self) -> None:
        self.base, self.text = self.file.revision, self.file.text

    def add_line(self, line: str, draw: random.Random) -> None:
        lines = self.text.splitlines(keepends=True)
        lines.insert(draw.randrange(len(lines) + 1), f"{line}\n")
        self.text = "".join(lines)

    def send(self) -> None:
        self.file.change(self.base, self.text)
        self.pull()


def _assign(language: Language, file: OpenFile, draw: random.Random) -> None:
    name, unit = draw.choice([("fall_angle", "deg"), ("speed", "rad/s"), ("cart_mass", "kg")])
    edit = language.assignment(file, f"parameters.{name}", f"{draw.randrange(1, 90)} {unit}")
    if edit is not None:
        file.edit([edit])


def _save_or_take_both(file: OpenFile) -> None:
    """Save; of two texts, the person takes that on disk, and what was typed since the file was saved."""
    if file.outside is not None:
        own, saved, outside = file.text, file.saved, file.outside
        file.take_outside()
        file.change(file.revision, merged(saved, own, outside))
    try:
        file.save()
    except UsageError:
        assert file.outside is not None  # and nothing was written


def _run_sequence(folder, seed: int, steps: int = 25) -> None:
    draw = random.Random(seed)
    path = folder / "mine.yaml"
    path.write_text(SCENARIO, encoding="utf-8")
    file = OpenFile.open(path)
    language = Language(Permissions(), lambda path: None, lambda sentence: None)
    people = [Person(file), Person(file)]
    added: list[str] = []
    for step in range(steps):
        person = draw.choice(people)
        act = draw.randrange(7)
        if act <= 1:
            added.append(f"# note {seed} {step}")
            person.add_line(added[-1], draw)
        elif act == 2:
            person.send()
        elif act == 3:
            _assign(language, file, draw)
        elif act == 4:
            file.edit([difference(file.text, canonical_text(file.text) or file.text)])
        elif act == 5:
            added.append(f"# outside {seed} {step}")
            present = path.read_text("utf-8")
            path.write_text(f"{present}{added[-1]}\n", encoding="utf-8")
            os.utime(path, ns=(step, step))
            file.read_outside()
        else:
            _save_or_take_both(file)
    for person in people:
        person.send()
    _save_or_take_both(file)
    written = path.read_text("utf-8")
    comments = [line.partition("#")[2] for line in SCENARIO.splitlines() if "#" in line]
    keys = [line.strip().partition(":")[0] for line in SCENARIO.splitlines() if ":" in line]
    for part in (*added, *comments, *keys):
        assert part in written, (seed, part, written)
    assert Counter(written.splitlines()).most_common(1)[0][1] <= 2, written


@pytest.mark.parametrize("first", [0, pytest.param(10, marks=pytest.mark.slow)])
def test_no_comment_and_no_line_is_lost(first, tmp_path):
    for seed in range(first, 10 if first == 0 else 500):
        _run_sequence(tmp_path, seed)


@pytest.mark.parametrize("mark", [b"", b"\xef\xbb\xbf"])
@pytest.mark.parametrize("newline", [b"\n", b"\r\n"])
def test_line_ends_and_the_byte_order_mark_are_kept(tmp_path, mark, newline):
    path = tmp_path / "mine.yaml"
    path.write_bytes(mark + newline.join([b"a: 1", b"b: 2", b""]))
    file = OpenFile.open(path)
    assert file.text == "a: 1\nb: 2\n"
    file.change(file.revision, "a: 1\r\nb: 3\nc: \ud83d\n")  # half of a character
    file.save()
    assert path.read_bytes() == mark + newline.join([b"a: 1", b"b: 3", "c: \ufffd".encode(), b""])
    assert OpenFile.open(path).text == file.text
    assert not OpenFile.open(path).is_modified


def test_a_save_does_not_overwrite_what_another_program_wrote(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text("a: 1\n", encoding="utf-8")
    file = OpenFile.open(path)
    file.change(file.revision, "a: 2\n")
    path.write_text("a: 33\n", encoding="utf-8")  # since the studio last looked
    with pytest.raises(UsageError, match=r"another program has changed mine\.yaml"):
        file.save()
    assert (path.read_text("utf-8"), file.text, file.outside) == ("a: 33\n", "a: 2\n", "a: 33\n")
    file.keep_own()
    file.save()
    assert path.read_text("utf-8") == "a: 2\n"


def test_a_file_that_returns_to_its_text_is_no_change(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text("a: 1\n", encoding="utf-8")
    file = OpenFile.open(path)
    file.change(file.revision, "a: 2\n")
    for number, text in enumerate(("a: 33\n", "a: 1\n")):
        path.write_text(text, encoding="utf-8")
        os.utime(path, ns=(number, number))
        assert file.read_outside()
    assert file.outside is None
    assert file.text == "a: 2\n"


def test_a_file_that_was_removed_can_be_saved_again(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text("a: 1\n", encoding="utf-8")
    file = OpenFile.open(path)
    path.unlink()
    assert file.read_outside()
    assert not file.read_outside()
    assert file.is_modified
    file.save()
    assert path.read_text("utf-8") == "a: 1\n"
    assert file.is_modified is False
    path.unlink()
    file.read_outside()
    path.write_text("a: 1\n", encoding="utf-8")
    assert file.read_outside()
    assert not file.is_modified


def test_a_draft_survives_until_it_is_saved(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text("a: 1\n", encoding="utf-8")
    file = OpenFile.open(path)
    file.change(file.revision, "a: 2 # \N{GRINNING FACE}\n")
    Drafts(tmp_path / "drafts").keep(file)

    again = OpenFile.open(path)
    drafts = Drafts(tmp_path / "drafts")
    drafts.restore(again)
    assert again.text == file.text
    assert again.saved == "a: 1\n"
    assert again.is_restored is True
    assert again.outside is None
    again.save()
    drafts.keep(again)
    assert not list((tmp_path / "drafts").iterdir())


def test_a_draft_of_a_file_that_was_changed_since_offers_both(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text("a: 1\n", encoding="utf-8")
    file = OpenFile.open(path)
    file.change(file.revision, "a: 2\n")
    Drafts(tmp_path / "drafts").keep(file)
    path.write_text("a: 1\nb: 1\n", encoding="utf-8")

    again = OpenFile.open(path)
    Drafts(tmp_path / "drafts").restore(again)
    assert (again.text, again.outside) == ("a: 2\n", "a: 1\nb: 1\n")
    with pytest.raises(UsageError, match="another program"):
        again.save()


@pytest.mark.parametrize("content", [b"", b"[]", b"{", b"[" * 100_000, b'{"text": 1, "saved": 2}', b"\xff"])
def test_a_damaged_draft_is_ignored(tmp_path, content):
    path = tmp_path / "mine.yaml"
    path.write_text("a: 1\n", encoding="utf-8")
    file = OpenFile.open(path)
    file.change(file.revision, "a: 2\n")
    Drafts(tmp_path / "drafts").keep(file)
    (draft,) = (tmp_path / "drafts").iterdir()
    draft.write_bytes(content)
    again = OpenFile.open(path)
    Drafts(tmp_path / "drafts").restore(again)
    assert again.text == "a: 1\n"


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        (b"x" * (5 << 20), "mine.yaml has more than 1,048,576 bytes, which is too large for a scenario"),
        (bytes(range(256)), "mine.yaml is not text in UTF-8"),
    ],
)
def test_a_file_that_is_no_scenario_is_one_sentence(tmp_path, content, sentence):
    path = tmp_path / "mine.yaml"
    path.write_bytes(content)
    with pytest.raises(UsageError) as refusal:
        OpenFile.open(path)
    assert str(refusal.value) == sentence


def test_a_text_that_grows_too_large_is_refused(tmp_path):
    file = OpenFile(tmp_path / "mine.yaml", "a: 1\n")
    with pytest.raises(UsageError, match="more than 1,048,576 bytes"):
        file.change(file.revision, "é" * (MAX_BYTES // 2 + 1))
    assert file.text == "a: 1\n"


@pytest.mark.skipif(os.geteuid() == 0, reason="root writes everywhere")
def test_a_read_only_folder_is_one_sentence(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text("a: 1\n", encoding="utf-8")
    file = OpenFile.open(path)
    file.change(file.revision, "a: 2\n")
    tmp_path.chmod(0o500)
    try:
        with pytest.raises(UsageError, match="permission denied; choose a place that may be written to"):
            file.save()
    finally:
        tmp_path.chmod(0o700)
    assert file.is_modified


def test_a_full_disk_is_one_sentence_and_leaves_the_file(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text("a: 1\n", encoding="utf-8")
    file = OpenFile.open(path)
    file.change(file.revision, "a: 1\n" * 100)
    drafts = Drafts(tmp_path / "drafts")
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (10, before[1]))
    try:
        with pytest.raises(UsageError, match=r"mine\.yaml cannot be written: file too large"):
            file.save()
        with pytest.raises(OSError, match="File too large"):
            drafts.keep(file)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert path.read_text("utf-8") == "a: 1\n"
    assert file.is_modified is True
    drafts.keep(file)
    (draft,) = (tmp_path / "drafts").glob("*.json")
    assert json.loads(draft.read_text("utf-8"))["text"] == file.text
    file.save()
    assert path.read_text("utf-8") == "a: 1\n" * 100


def test_a_file_of_another_project_is_not_written(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text("a: 1\n", encoding="utf-8")
    file = OpenFile.open(path, read_only=True)
    file.edit([TextEdit(3, 4, "2")])
    with pytest.raises(UsageError, match="belongs to deepbots or another project"):
        file.save()
    assert path.read_text("utf-8") == "a: 1\n"
