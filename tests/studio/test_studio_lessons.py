"""Lessons 1 and 3 done on the page of the studio, in a real browser: written, trained, checked."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("nicegui")

from deepbots_cli.course.grading import start
from deepbots_cli.course.lessons import lesson_named
from tests.studio.served import BACKSPACE, ENTER, StudioTab, served
from tests.view.browser import CHROMIUM, browser

pytestmark = [
    pytest.mark.browser,
    pytest.mark.slow,
    pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium"),
]

RANGE = "range: 0 .. 1.5 m}"
RUN_ENDED = (
    "/complete-1: (finished|solved|not solved)/.test(document.querySelector('.studio-work').innerText)"
)


def choose_file(page: StudioTab, name: str) -> None:
    page.tab.run("document.querySelector('.studio-files').click()")
    page.click(name, ".q-item")
    page.wait(f"document.querySelector('.studio-files').innerText.includes('{name}')")


def go_to_end(page: StudioTab, begin: str) -> None:
    page.click_line(begin)
    page.press(("End", 35))  # of the whole line, which is wrapped


def erase(page: StudioTab, count: int) -> None:
    page.press(BACKSPACE, count)


def check(page: StudioTab) -> str:
    page.open_tab("Lesson")
    page.click("Check", then="document.querySelector('.studio-work').innerText.includes('checking ...')")
    points = "/^\\d+ of \\d+ points$/"
    script = f"[...document.querySelectorAll('.studio-work .studio-status')].map(one => one.innerText).find(text => {points}.test(text))"
    return str(page.wait(script, 120))


def test_lesson_1_is_done_on_the_page(tmp_path: Path) -> None:
    lesson = lesson_named("1")
    folder = tmp_path / "own"
    start(lesson, folder)
    with served(folder) as studio, browser() as new_tab:
        page = StudioTab(new_tab(), studio.address, 1280, 720)
        page.wait("document.querySelector('.studio-files').innerText.includes('mend.yaml')")
        page.wait("document.querySelector('.studio-lesson-text')?.innerText.includes('Units and sensors')")
        assert check(page) == "0 of 10 points"
        page.wait("document.querySelector('.studio-lesson-text').innerText.includes('# or press Check')")
        # A hint stays below its step, also after the next check.
        page.click(
            "Hint", then="document.querySelector('.studio-lesson-steps').innerText.includes('Hint 1: ')"
        )
        assert check(page) == "0 of 10 points"
        assert "Hint 1: " in page.tab.run("document.querySelector('.studio-lesson-steps').innerText")

        go_to_end(page, "      ahead: {type: sonar")
        erase(page, len(", yaw: 90 deg}, range: 0 .. 400 mm}"))
        page.type("}, " + RANGE)
        assert check(page) == "3 of 10 points"

        choose_file(page, "complete.yaml")
        go_to_end(page, "      ahead: {type: sonar")
        page.press(ENTER)
        page.type(
            "eyes: {type: reflectance, link: base_link, rays: {left: {x: 8 cm, y: 2 cm}, right: {x: 8 cm, y: -2 cm}}}"
        )
        assert check(page) == "6 of 10 points"

        choose_file(page, "invent.yaml")
        go_to_end(page, "      ahead: {type: sonar")
        erase(page, 1)
        page.type(", rays: 21, angle_range: 40 .. -40 deg, measure: nearest}")
        assert check(page) == "10 of 10 points"
        assert not page.tab.errors


def test_lesson_3_is_done_on_the_page_with_a_training(tmp_path: Path) -> None:
    lesson = lesson_named("3")
    folder = tmp_path / "own"
    start(lesson, folder)
    with served(folder, "mend.yaml") as studio, browser() as new_tab:
        page = StudioTab(new_tab(), studio.address, 1280, 720)
        go_to_end(page, "  closer: 10 * delta")
        erase(page, len("10 * delta(apart) / m"))
        page.type("-10 * delta(apart) / m")
        assert check(page) == "2 of 10 points"

        choose_file(page, "complete.yaml")
        go_to_end(page, "  found: 5 when found")
        page.press(ENTER)
        page.type("closer: -10 * delta(apart) / m")
        page.open_tab("Train")
        page.click("Train", then=RUN_ENDED, seconds=1200)
        assert check(page) == "7 of 10 points"
        assert not page.tab.errors
