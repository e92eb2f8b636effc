"""The page of the studio without a mouse."""

from __future__ import annotations

import time

import pytest

pytest.importorskip("nicegui")
from tests.studio.served import ESCAPE, TAB, StudioTab, served
from tests.studio.test_studio_page import SCENARIO
from tests.view.browser import CHROMIUM, browser

pytestmark = [pytest.mark.browser, pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium")]

FOCUS = """(() => { const one = document.activeElement;
    return one.tagName + ' ' + (one.getAttribute('aria-label') || one.innerText || one.title || ''); })()"""


def _tab_to(page: StudioTab, wanted: str, most: int = 60) -> list[str]:
    """Press Tab until an element is focused; returns what was passed."""
    passed = []
    for _ in range(most):
        page.press(TAB)
        passed.append(str(page.tab.run(FOCUS)))
        if wanted in passed[-1]:
            return passed
    raise AssertionError(passed)


def test_a_scenario_is_written_saved_and_trained_by_the_keyboard(tmp_path):
    (tmp_path / "mine.yaml").write_text(SCENARIO, encoding="utf-8")
    with served(tmp_path, "mine.yaml") as studio, browser() as new_tab:
        page = StudioTab(new_tab(), studio.address)
        page.wait(
            "document.querySelector('.studio-robot .studio-status').innerText == 'driven by random actions'",
            60,
        )
        passed = _tab_to(page, "text of the scenario")
        assert any("New ..." in each for each in passed)
        page.press(("End", 35), modifiers=2)
        page.type("# by the keyboard")
        page.save()
        end = time.monotonic() + 20
        while not (tmp_path / "mine.yaml").read_text("utf-8").endswith("n_steps: 128\n# by the keyboard"):
            assert time.monotonic() < end
            time.sleep(0.1)
        # Saving loads the page of the robot anew: it has nothing to focus before it shows its controls.
        page.wait(
            "document.querySelector('iframe').contentDocument.querySelector('button, input') != null", 60
        )
        # Tab leaves the text, and passes over the controls of the robot.
        _tab_to(page, "Keyboard into the page of the robot")
        page.press(("Enter", 13))
        page.wait("document.activeElement.tagName == 'IFRAME'")
        page.press(TAB)
        page.wait("document.querySelector('iframe').contentDocument.activeElement.tagName != 'BODY'")
        page.press(ESCAPE)
        page.wait("document.activeElement.className.includes('studio-enter')")
        passed = _tab_to(page, "Train")
        assert not any("IFRAME" in each for each in passed)
        _tab_to(page, "BUTTON Try")
        _tab_to(page, "BUTTON Train")
        page.press(("Enter", 13))
        page.wait("/mine-1: (training|finished)/.test(document.querySelector('.studio-work').innerText)", 90)
        assert not page.tab.errors


def test_the_keys_of_the_editor_work_after_a_click_on_a_button_and_in_the_robot(tmp_path):
    (tmp_path / "mine.yaml").write_text(SCENARIO, encoding="utf-8")

    def has_saved(begin: str) -> None:
        end = time.monotonic() + 20
        while not (tmp_path / "mine.yaml").read_text("utf-8").startswith(begin):
            assert time.monotonic() < end
            time.sleep(0.1)

    focus = "[...document.querySelectorAll('button')].find(one => one.innerText.trim() == '{}').focus()"
    with served(tmp_path, "mine.yaml") as studio, browser() as new_tab:
        page = StudioTab(new_tab(), studio.address)
        page.click_line("deepbots: 1")
        page.type("  # one")
        page.tab.run(focus.format("Try"))
        page.save()
        has_saved("deepbots: 1  # one\n")
        page.tab.run(focus.format("Try"))
        page.press(("z", 90), modifiers=2)
        page.wait("document.querySelector('.cm-line').innerText == 'deepbots: 1'")
        page.tab.run(focus.format("Try"))
        page.press(("y", 89), modifiers=2)
        page.wait("document.querySelector('.cm-line').innerText == 'deepbots: 1  # one'")

        # In another text field, the key is that of the field.
        page.tab.run("document.querySelector('[aria-label=Timesteps]').focus()")
        page.type("512")
        page.press(("z", 90), modifiers=2)
        time.sleep(0.5)
        assert page.tab.run("document.querySelector('.cm-line').innerText") == "deepbots: 1  # one"

        # Ctrl+Enter trains, and does not press the button that has the focus.
        page.wait(
            "document.querySelector('iframe').contentDocument?.querySelector('button, input') != null", 60
        )
        page.tab.run(focus.format("Try"))
        page.press(("Enter", 13), modifiers=2)
        page.wait("document.querySelector('.studio-work').textContent.includes('deepbots train mine.yaml')")
        assert not page.tab.run("document.body.innerText.includes('deepbots try')")
        page.click_line("deepbots: 1")
        page.type(", two")
        page.tab.run("document.querySelector('iframe').contentWindow.focus()")
        page.save()
        has_saved("deepbots: 1  # one, two\n")
        assert not page.tab.errors
