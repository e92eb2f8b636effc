"""The studio in a real browser: written, seen, trained."""

from __future__ import annotations

import shutil
import time

import pytest

pytest.importorskip("nicegui")
from tests.studio.served import BACKSPACE, ENTER, ESCAPE, Served, StudioTab, served
from tests.view.browser import CHROMIUM, browser

pytestmark = [pytest.mark.browser, pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium")]

SCENARIO = """deepbots: 1
name: Mine
parameters:
  fall_angle: 15 deg  # the largest lean
world: {timestep: 32 ms, substeps: 4}
robots:
  cart:
    urdf: cartpole
    sensors:
      pole_angle: {type: joint_position, joint: pole_hinge}
    actuators:
      wheels: {type: velocity_motor, joints: [wheel_*], max_torque: 10 N*m}
    apply: {wheels: drive * 5 rad/s}
action:
  drive: {choices: {forward: 1, backward: -1}}
observation:
  cart.pole_angle: -20 .. 20 deg
reward:
  alive: 1
termination:
  failure:
    fallen: abs(cart.pole_angle) > fall_angle
truncation: {max_steps: 100}
train:
  algorithm: PPO
  total_timesteps: 4096
  environments: 4
  n_steps: 128
"""


@pytest.fixture
def new_tab():
    # A browser of its own: tabs of earlier tests would draw on, and take the cores.
    with browser() as tab:
        yield tab


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "mine.yaml").write_text(SCENARIO, encoding="utf-8")
    return tmp_path


@pytest.fixture
def studio(folder):
    with served(folder, "mine.yaml") as running:
        yield running


def test_a_person_writes_sees_and_trains(studio: Served, folder, new_tab):
    page = StudioTab(new_tab(), studio.address)
    page.wait("document.querySelector('.studio-robot .studio-status').innerText == 'runs the saved file'", 60)

    # A mistake is underlined and explained; the finding goes with it.
    page.click_line("  fall_angle:")
    page.press(("Home", 36))
    page.click_line("  alive: 1")
    page.type("0 parsec")
    page.wait("document.querySelectorAll('.studio-error').length > 0")
    assert any("parsec" in finding for finding in page.findings())
    page.press(BACKSPACE, len("0 parsec"))
    page.wait("document.querySelectorAll('.studio-row-error').length == 0")

    # Keys and expressions are completed.
    page.click_line("  alive: 1")
    page.press(ENTER)
    page.type("upright: ab")
    page.wait(
        "[...document.querySelectorAll('.cm-tooltip-autocomplete li')].some(li => li.innerText.startsWith('abs'))"
    )
    page.press(ESCAPE)
    page.type("s(cart.pole_angle) / 1 rad")
    page.wait("document.querySelectorAll('.studio-row-error').length == 0")

    # Saving restarts the robot with the new text.
    page.save()
    page.wait("[...document.querySelectorAll('button')].some(b => b.innerText.trim() == 'Save')")
    assert "  upright: abs(cart.pole_angle) / 1 rad\n" in (folder / "mine.yaml").read_text("utf-8")

    # The curve follows the training, which ends with a result in the list of runs.
    page.click("Train")
    page.wait("document.querySelector('.studio-work').innerText.includes('deepbots train mine.yaml')")
    page.wait(
        "/mine-1: (training|finished), [0-9,]+/.test(document.querySelector('.studio-work').innerText)", 60
    )
    page.wait("/mine-1: finished/.test(document.querySelector('.studio-work').innerText)", 120)
    page.open_tab("Runs")
    page.wait("document.querySelector('table')?.innerText.includes('mine-1')")
    assert not page.tab.errors


def test_a_training_and_unsaved_text_outlive_the_server(folder, new_tab):
    with served(folder, "mine.yaml") as first:
        page = StudioTab(new_tab(), first.address)
        page.click_line("  alive: 1")
        page.type("  # unsaved words")
        page.click("Train")
        page.click_line("  alive: 1")
        page.type(", more words")
        page.wait("document.querySelector('.studio-work').innerText.includes('mine-1')")
        time.sleep(4)
        first.stop(9)
    with served(folder, "mine.yaml") as second:
        page = StudioTab(new_tab(), second.address)
        page.wait("document.body.innerText.includes('unsaved changes of an earlier session')")
        assert "  alive: 1  # unsaved words, more words" in page.text
        page.wait("/mine-1: finished/.test(document.querySelector('.studio-work').innerText)", 120)
    assert [path.name for path in (folder / "runs").glob("mine-*")] == ["mine-1"]


def test_both_tabs_show_what_one_of_them_writes(studio: Served, new_tab):
    first, second = StudioTab(new_tab(), studio.address), StudioTab(new_tab(), studio.address)
    first.click_line("name: Mine")
    first.type("craft")
    second.wait("document.querySelector('.cm-content').innerText.includes('name: Minecraft')")
    second.click_line("truncation")
    second.type("  # a note")
    first.wait("document.querySelector('.cm-content').innerText.includes('# a note')")
    assert "name: Minecraft" in first.text


def test_a_file_changed_outside_is_taken_or_compared(studio: Served, folder, new_tab):
    page = StudioTab(new_tab(), studio.address)
    (folder / "mine.yaml").write_text(SCENARIO.replace("name: Mine", "name: Theirs"), encoding="utf-8")
    page.wait("document.querySelector('.cm-content').innerText.includes('name: Theirs')")
    page.click_line("name: Theirs")
    page.type(" and mine")
    page.wait("[...document.querySelectorAll('button')].some(b => b.innerText.trim() == 'Save *')")
    (folder / "mine.yaml").write_text(SCENARIO.replace("name: Mine", "name: Others"), encoding="utf-8")
    page.click("Compare ...")
    page.wait("document.body.innerText.includes('+name: Theirs and mine')")
    page.click("Close")
    page.click("Keep this text")
    assert "name: Theirs and mine" in page.text


def test_names_are_shown_as_text(folder, new_tab):
    hostile = "<img src=x onerror=window.hacked=1>"
    text = SCENARIO.replace("name: Mine", f'name: "{hostile}"').replace("alive: 1", f"'{hostile}': 1")
    (folder / "mine.yaml").write_text(text, encoding="utf-8")
    shutil.copy(folder / "mine.yaml", folder / f"{hostile.replace(' ', '')}.yaml")
    with served(folder, "mine.yaml") as running:
        page = StudioTab(new_tab(), running.address)
        page.wait("document.querySelectorAll('.studio-row').length > 0")
        page.tab.run("document.querySelector('.studio-row summary').click()")
        time.sleep(2)
        assert page.tab.run("window.hacked ?? 0") == 0
