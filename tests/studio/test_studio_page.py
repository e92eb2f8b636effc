"""The studio in a real browser: written, seen, trained."""

from __future__ import annotations

import shutil
import subprocess
import time

import pytest

pytest.importorskip("nicegui")
from deepbots_cli.processes import python_command, python_environment
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
    page.wait(
        "document.querySelector('.studio-robot .studio-status').innerText == 'driven by random actions'", 60
    )

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
    page.wait("[...document.querySelectorAll('button')].some(b => b.innerText.trim() == 'Saved')")
    assert "  upright: abs(cart.pole_angle) / 1 rad\n" in (folder / "mine.yaml").read_text("utf-8")

    # The curve follows the training, which ends with a result in the list of runs.
    page.click("Train")
    page.wait("document.querySelector('.studio-work').textContent.includes('deepbots train mine.yaml')")
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
        page.wait("document.querySelector('.cm-content').innerText.includes('# unsaved words, more words')")
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


def test_a_finding_is_corrected_by_a_click_and_explained_with_links(studio: Served, new_tab):
    page = StudioTab(new_tab(), studio.address)
    page.click_line("    fallen:")
    page.press(BACKSPACE, len("fall_angle"))
    page.type("fal_angle")
    page.click("Replace `fal_angle` with `fall_angle` (check it)")
    page.wait("document.querySelectorAll('.studio-row').length == 0")
    assert "> fall_angle" in page.text

    page.click("Explain ...")
    page.wait("document.activeElement.tagName == 'INPUT'")
    page.type("reward")
    page.press(ENTER)
    answer = "document.querySelector('.studio-dialog .studio-answer')"
    page.wait(f"{answer}.innerText.includes('a key of a scenario')")
    page.tab.run(f"[...{answer}.querySelectorAll('a')].find(one => one.innerText == 'return').click()")
    page.wait(f"{answer}.innerText.startsWith('return: a concept')")
    page.click("Back")
    page.wait(f"{answer}.innerText.startsWith('reward: a concept')")
    assert not page.tab.errors


def test_the_result_of_a_command_is_shown_where_it_was_started(studio: Served, new_tab):
    page = StudioTab(new_tab(), studio.address)
    page.click("Try")
    sentence = "document.querySelector('.studio-sentence')?.innerText"
    page.wait(f"/^Random actions: 3 episodes, mean return .*, all ended by /.test({sentence})", 60)
    # The output is behind the sentence.
    assert not page.tab.run("document.querySelector('.studio-details').open")
    page.tab.run("document.querySelector('.studio-details summary').click()")
    page.wait("document.querySelector('.studio-result').innerText.includes('summary of 3 episodes')")
    assert page.tab.run("document.querySelector('[role=tab][aria-selected=true]').innerText") == "Train"
    page.wait("document.body.innerText.includes('try: Random actions: 3 episodes, mean return')")
    page.click("Close")
    page.wait("!document.querySelector('.studio-result')?.offsetParent")


def test_two_runs_are_drawn_over_each_other_and_a_change_is_set_back(folder, new_tab):
    solved = f"{SCENARIO}solved: mean_return >= 40 over 20 episodes\n"
    missed = solved.replace("max_steps: 100", "max_steps: 30").replace(
        "urdf: cartpole\n", "urdf: cartpole\n    links: {pole: {scale: 1 1 2}}\n"
    )
    for name, text in (("mine-1", solved), ("mine-2", missed)):
        (folder / "mine.yaml").write_text(text, encoding="utf-8")
        words = ("train", "mine.yaml", "--run", f"runs/{name}", "--timesteps", "2048")
        subprocess.run(
            python_command("deepbots_cli", *words),
            cwd=folder,
            env=python_environment(),
            check=True,
            capture_output=True,
        )
    with served(folder, "mine.yaml") as studio:
        page = StudioTab(new_tab(), studio.address)
        cause = "document.querySelector('.studio-result')?.innerText.includes('Changed since runs/mine-1')"
        page.open_tab("Runs")
        select = "[...document.querySelectorAll('td')].find(cell => cell.innerText.trim() == '{}').click()"
        page.wait("document.querySelector('table')?.innerText.includes('mine-2')")
        page.tab.run(select.format("mine-2"))
        page.click("Evaluate")
        page.wait("!!document.querySelector('.studio-runs')?.offsetParent")
        page.click("Curve")
        page.wait("document.querySelector('.studio-unsolved')?.innerText.includes('not solved')")
        page.click("Why is it not solved?")
        page.wait(cause, 90)
        # The ring of the evaluation that was begun before does not turn beside the finished diagnosis.
        assert not page.tab.run("!!document.querySelector('.studio-runs')?.offsetParent")
        page.click("Set truncation.max_steps back to 100")
        page.click("Remove robots.cart.links.pole")
        page.wait("document.querySelector('.cm-content').innerText.includes('truncation: {max_steps: 100}')")
        page.wait("!document.querySelector('.cm-content').innerText.includes('scale')")
        # The diagnosis is of the other run.
        page.tab.run(select.format("mine-1"))
        page.wait("!document.querySelector('.studio-result').offsetParent")
        page.tab.run("document.querySelectorAll('tbody .q-checkbox')[0].click()")
        page.click("Compare")
        result = "document.querySelector('.studio-result').innerText"
        page.wait(f"/mine-1 is solved after .*; mine-2 is not solved after .*/.test({result})")
        assert page.tab.run(f"/mine-2 differs from mine-1 in .*100.→.30/.test({result})")
        page.wait("document.querySelector('.studio-compared canvas, .studio-compared svg') != null")
        page.wait(f"/On the same starts: mine-2: cannot be compared/.test({result})", 120)
        picture = "document.querySelector('.studio-compared canvas').toDataURL()"
        page.tab.run(f"window.light = {picture}; 1")
        page.click("Dark")
        page.wait(f"{picture} != window.light")
        page.click("Back to the runs")
        page.tab.run(select.format("mine-1"))
        page.click("Curve")
        page.wait(
            "document.querySelector('.studio-status.studio-solved')?.innerText.includes('solved after')"
        )
        assert not page.tab.errors
        page.click("Watch")
        page.wait(
            "document.querySelector('[aria-label=\"Robot of\"]').closest('.q-field').innerText.includes('mine-1')"
        )


def test_an_empty_folder_says_how_to_get_a_scenario(tmp_path, new_tab):
    with served(tmp_path) as studio:
        tab = new_tab()
        tab.call("Page.navigate", url=studio.address)
        status = "document.querySelector('.studio-robot .studio-status')?.innerText"
        tab.wait(f"({status} ?? '').includes('New ... at the top writes one')", 60)


def test_a_long_line_is_wrapped(studio: Served, new_tab):
    page = StudioTab(new_tab(), studio.address)
    page.click_line("  alive: 1")
    page.type("  # " + "a long comment " * 12)
    page.wait("[...document.querySelectorAll('.cm-line')].some(line => line.clientHeight > 40)")
    scroller = "document.querySelector('.cm-scroller')"
    assert page.tab.run(f"{scroller}.scrollWidth <= {scroller}.clientWidth")


def test_text_typed_without_a_server_is_kept_and_offered(folder, new_tab):
    tab = new_tab()
    with served(folder, "mine.yaml") as first:
        page, port = StudioTab(tab, first.address), first.port
        page.click_line("name: Mine")
        first.stop(9)
        page.wait(
            "document.querySelector('.studio-editor .studio-banner').innerText.includes('does not answer')"
        )
        page.type("craft")
        time.sleep(0.5)
    with served(folder, "mine.yaml", "--port", str(port)) as second:
        page = StudioTab(tab, second.address)
        assert "name: Minecraft" not in page.text
        page.click("Use it")
        page.wait("document.querySelector('.cm-content').innerText.includes('name: Minecraft')")
        page.save()
        page.wait("[...document.querySelectorAll('button')].some(b => b.innerText.trim() == 'Saved')")
    assert "name: Minecraft\n" in (folder / "mine.yaml").read_text("utf-8")


def test_a_removed_file_keeps_its_text(studio: Served, folder, new_tab):
    page = StudioTab(new_tab(), studio.address)
    page.click_line("name: Mine")
    page.type("craft")
    (folder / "mine.yaml").unlink()
    page.click("Write the file again")
    page.wait("!document.body.innerText.includes('has removed')")
    assert "name: Minecraft\n" in (folder / "mine.yaml").read_text("utf-8")


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
