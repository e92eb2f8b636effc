"""The site: every page is two clicks from the first one, its links lead somewhere, and Sphinx builds it
without a warning.

The loop of docs/agents.md runs, prints what the page shows, and fits the schema of outputs.
"""

from __future__ import annotations

import json
import posixpath
import re
import shlex
from collections.abc import Iterator
from html import unescape
from html.parser import HTMLParser
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any
from urllib.parse import unquote

import jsonschema
import pytest
from PIL import Image

from deepbots_cli.cli import main
from deepbots_cli.diagnostics.registry import RULES
from tests.view.browser import CHROMIUM, browser
from tools.results.card import card
from tools.results.experiment import experiments
from tools.results.experiments.not_measured import REASONS
from tools.results.measure import Places, read
from tools.results.standing import Standing

DOCS = Path(__file__).parents[2] / "docs"
SCENARIOS = sorted(path.stem for path in (DOCS.parent / "scenarios").glob("*.yaml"))


@pytest.fixture(scope="module")
def site() -> Iterator[ModuleType]:
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(DOCS))
        yield import_module("build_site")


@pytest.fixture(scope="module")
def sources(site: ModuleType, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder: Path = tmp_path_factory.mktemp("sources")
    site.write_sources(folder)
    return folder


@pytest.fixture(scope="module")
def pages(sources: Path) -> dict[str, str]:
    """The text of each page without its code, by its place in the site."""
    return {
        path.relative_to(sources).as_posix(): without_code(path.read_text(encoding="utf-8"))
        for path in sources.rglob("*.md")
    }


def without_code(text: str) -> str:
    return re.sub(r"^```\w.*?^```$", "", text, flags=re.MULTILINE | re.DOTALL)


def targets(place: str, text: str) -> list[tuple[str, str]]:
    """Where the links and pictures of a page lead: a place in the site, and an anchor."""
    matches = re.findall(r"\]\(([^)\s]+)\)|<img src=\"([^\"]+)\"", text)
    links = [(link or image).partition("#") for link, image in matches if "://" not in link]
    return [
        (posixpath.normpath(posixpath.join(posixpath.dirname(place), path)) if path else place, anchor)
        for path, _, anchor in links
    ]


def anchors(text: str) -> set[str]:
    headings = re.findall(r"^#+ (.+)$", text, re.MULTILINE)
    return {
        re.sub(r"[^\w\- ]", "", re.sub(r"\]\([^)]*\)", "", heading).lower()).replace(" ", "-")
        for heading in headings
    }


def test_every_link_of_the_site_leads_somewhere(sources: Path, pages: dict[str, str]) -> None:
    links = [(place, *target) for place, text in pages.items() for target in targets(place, text)]
    assert [(place, target) for place, target, _ in links if not (sources / target).is_file()] == []
    assert [link for link in links if link[2] and link[2] not in anchors(pages[link[1]])] == []


def test_every_page_is_within_two_clicks_of_the_first(site: ModuleType, pages: dict[str, str]) -> None:
    beside = {entry.place for entries in site.groups().values() for entry in entries}
    first = beside | {target for target, _ in targets("index.md", pages["index.md"])}
    second = {target for place in first & set(pages) for target, _ in targets(place, pages[place])}
    assert sorted(set(pages) - first - second - {"index.md"}) == []
    assert beside <= set(pages)


def test_every_page_on_disk_is_in_the_list_and_the_navigation(site: ModuleType) -> None:
    listed = {entry.place for entries in site.groups().values() for entry in entries}
    paths = [*DOCS.parent.glob("*.md"), *DOCS.rglob("*.md")]
    on_disk = {path.relative_to(DOCS.parent).as_posix() for path in paths} - {"README.md", "docs/README.md"}
    assert sorted({site.place_of(path) for path in on_disk} - listed) == []


@pytest.mark.parametrize("name", SCENARIOS)
def test_every_scenario_is_in_the_gallery_with_its_file(
    name: str, pages: dict[str, str], sources: Path
) -> None:
    texts = [path.read_text(encoding="utf-8") for path in (sources / "scenarios").glob("*.md")]
    whole = (DOCS.parent / "scenarios" / f"{name}.yaml").read_text(encoding="utf-8").rstrip()
    assert sum(whole in text for text in texts) == 1
    assert f"`{name}`" in pages["worlds.md"] or f"(scenarios/{name}.md)" in pages["worlds.md"]


def test_a_page_of_the_gallery_shows_names_ranges_and_units(pages: dict[str, str]) -> None:
    page = pages["scenarios/cartpole.md"]
    assert "| 0 | `x` | -0.4 .. 0.4 | `m` | -1 .. 1 |" in page
    assert "| `drive` | choice | forward (drive = 1), backward (drive = -1) | `1` |" in page
    assert "| `fallen` | failure | `abs(cart.pole_angle) > fall_angle` |" in page
    assert "| 5003 | 9,008 steps, 226 episodes | 0.0801 | 9,008 steps, 226 episodes | 0.0801 | " in page
    assert "| held out | all | 500 |  | 200 | 200, 200 | max_steps 500 |" in page
    assert "| random |  | 100 |  | 33.38 (31.5 .. 35.26) | 19, 62 | fallen 100 |" in page


@pytest.mark.parametrize("name", SCENARIOS)
def test_every_scenario_has_its_results_in_the_gallery_and_curves_where_it_was_trained(
    name: str, pages: dict[str, str]
) -> None:
    if name in REASONS:
        assert "\n## Results\n" in pages[f"scenarios/{name}.md"]
        return
    experiment = experiments()[name]
    record = read(Places().record(name))
    text = without_code(card(Standing.of(experiment, record))).partition("\n# ")[2].rstrip()
    assert sum(f"## {text}\n" in page or f"### {text}\n" in page for page in pages.values()) == 1
    assert bool(record.get("trainings")) == (f"images/results/{name}.svg)" in text)


def test_every_page_of_the_gallery_has_a_moving_picture_of_a_trained_policy(site: ModuleType) -> None:
    gallery = import_module("build_gallery")
    moving = {
        path.stem
        for path in (DOCS / "images" / "policies").glob("*.gif")
        if getattr(Image.open(path), "n_frames", 1) > 10
    }
    assert set(gallery.families()) == set(gallery.POLICIES) == moving


def test_every_picture_that_is_drawn_by_code_is_current_and_on_a_page(
    site: ModuleType, pages: dict[str, str]
) -> None:
    drawn: dict[str, str] = import_module("build_figures").figures()
    assert [
        name for name, text in drawn.items() if (site.ROOT / name).read_text(encoding="utf-8") != text
    ] == []
    places = [f"{site.place_of(name)})" for name in drawn]
    assert [place for place in places if not any(place in page for page in pages.values())] == []


def test_machines_find_pages_findings_and_the_schema(site: ModuleType, sources: Path, tmp_path: Path) -> None:
    site.write_for_machines(sources, tmp_path)
    links = re.findall(
        r"^- \[.+\]\((.+?)\): .+", (tmp_path / "llms.txt").read_text(encoding="utf-8"), re.MULTILINE
    )
    assert len(links) > 40
    assert [link for link in links if not (tmp_path / link).is_file()] == []
    assert [
        rule["code"] for rule in json.loads((tmp_path / "rules.json").read_text(encoding="utf-8"))["rules"]
    ] == list(RULES)
    assert (tmp_path / "schemas" / "deepbots-1.schema.json").is_file()


def test_a_key_in_an_example_shows_its_description_and_a_name_shows_none(site: ModuleType) -> None:
    spans = [
        '<span class="nt">world</span>',
        '<span class="nt">substeps</span>',
        '<span class="nt">robots</span>',
        '<span class="nt">cart</span>',
    ]
    block = f"{spans[0]}: {{{spans[1]}: 4}}\n{spans[2]}:\n  {spans[3]}: {{}}\n"
    page = '<div class="highlight-{}"><div class="highlight"><pre><span></span>{}</pre></div></div>'
    page_text = import_module("hover").with_hover_texts(page.format("yaml notranslate", block))
    titles = re.findall(r'<span class="nt"(?: title="([^"]*)")?>(\w+)</span>', page_text)
    assert [(bool(title), name) for title, name in titles] == [
        (True, "world"),
        (True, "substeps"),
        (True, "robots"),
        (False, "cart"),
    ]
    assert titles[1][0].startswith("Number of physics steps")
    assert re.sub(r' title="[^"]*"', "", page_text) == page.format("yaml notranslate", block)
    assert "title" not in import_module("hover").with_hover_texts(page.format("python notranslate", block))


class Page(HTMLParser):
    """The links and the anchors of a page."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.links: list[str] = []
        self.anchors = {""}
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        for name, value in attrs:
            if name == "id" and value:
                self.anchors.add(value)
            elif name in ("href", "src") and value and not re.match(r"[a-z]+:|#$", value):
                self.links.append(unquote(value))


@pytest.fixture(scope="module")
def built_site(site: ModuleType, tmp_path_factory: pytest.TempPathFactory) -> Path:
    for name in ("sphinx", "myst_parser", "furo"):
        pytest.importorskip(name)
    folder: Path = tmp_path_factory.mktemp("built")
    assert site.build(folder / "sources", folder / "site") == 0  # a warning is an error
    return folder / "site"


@pytest.mark.slow
def test_links_and_anchors_of_the_built_site_lead_somewhere(built_site: Path) -> None:
    built = {
        path.relative_to(built_site).as_posix(): Page(path.read_text(encoding="utf-8"))
        for path in built_site.rglob("*.html")
    }
    broken = []
    for place, page in built.items():
        for link in page.links:
            path, _, anchor = link.partition("#")
            target = (
                posixpath.normpath(posixpath.join(posixpath.dirname(place), path.partition("?")[0]))
                if path
                else place
            )
            there = (built_site / target).is_file() and (
                target not in built or anchor in built[target].anchors
            )
            broken += [] if there else [(place, link)]
    assert broken == []


@pytest.mark.slow
def test_a_line_of_a_page_that_begins_with_a_percent_sign_is_text(built_site: Path) -> None:
    for place in ("install", "scenarios/quadruped"):
        html = re.sub(r"<[^>]+>", "", (built_site / f"{place}.html").read_text(encoding="utf-8"))
        lines = re.findall(
            r"^%[^`\n]+", (built_site / f"{place}.md").read_text(encoding="utf-8"), re.MULTILINE
        )
        assert lines
        assert all(unescape(line) in unescape(html) for line in lines)


SEARCHES = {
    "own robot": "Your own robot",
    "own urdf": "Your own robot",
    "import urdf": "Your own robot",
    "custom robot": "Your own robot",
    "sensor noise": "Sensors",
    "noise on a sensor": "Sensors",
    "noisy sensor": "Sensors",
    "training does not learn": "A training that does not learn",
    "policy not improving": "A training that does not learn",
    "return does not rise": "A training that does not learn",
    "passive joint": "Robots",
    "door hinge": "Robots",
    "pendulum without motor": "Robots",
    "domain randomization": "Glossary",
    "install windows": "Install",
    "success rate interval": "Statistics of a result",
    "real robot": "To a real robot",
    "curriculum stages": "Train",
    "hindsight": "Train",
    "degrees radians": "Units and when a value is known",
}
"""What a reader types, and the title of a page that is among the first three results."""


@pytest.mark.browser
@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium")
def test_a_browser_filters_the_gallery_finds_words_and_fits_pages_to_a_phone(built_site: Path) -> None:
    with browser() as new_tab:
        tab = new_tab()
        tab.call("Page.navigate", url=(built_site / "worlds.html").as_uri())
        visible_cards = (
            "[...document.querySelectorAll('.card')].filter(card => card.offsetParent).map(card =>"
            " card.querySelector('strong').innerText)"
        )
        assert len(tab.wait(f"document.querySelector('.filters') && {visible_cards}")) == len(
            import_module("build_gallery").families()
        )
        choose = "(() => {{ const s = document.querySelectorAll('.filters select')[{}]; s.value = '{}';"
        choose += " s.dispatchEvent(new Event('change', {{bubbles: true}})); return true; }})()"
        tab.run(choose.format(1, "gyro"))
        with_gyro = ["Balancer", "BipedVelocity", "PitEscape", "Hover", "A1Velocity", "A1Rough"]
        assert tab.run(visible_cards) == with_gyro
        tab.run(choose.format(0, "quadrotor"))
        assert tab.run(visible_cards) == ["Hover"]
        tab.run(choose.format(2, "SAC"))
        assert tab.run(visible_cards) == []
        for index in range(3):
            tab.run(choose.format(index, ""))
        tab.run(choose.format(3, "CPU over 5 min"))
        assert tab.run(visible_cards) == [
            "BipedVelocity",
            "FindAndAvoid",
            "FindBallRandom",
            "PandaPush",
            "A1Velocity",
            "A1Rough",
            "TagScripted",
        ]
        tab.call(
            "Emulation.setDeviceMetricsOverride", width=380, height=800, deviceScaleFactor=1, mobile=False
        )
        for name in (
            "index",
            "worlds",
            "start",
            "results",
            "reference/keys",
            "reference/commands",
            "scenarios/quadruped",
            "agents",
        ):
            tab.call("Page.navigate", url=(built_site / f"{name}.html").as_uri())
            tab.wait(f"location.pathname.endsWith('/{name}.html') && document.readyState == 'complete'")
            assert tab.run("document.documentElement.scrollWidth") <= 380, name
        titles = (
            "[...document.querySelectorAll('#search-results ul.search > li > a')].map(link => link.innerText)"
        )
        for query, page in SEARCHES.items():
            tab.call(
                "Page.navigate", url=f"{(built_site / 'search.html').as_uri()}?q={query.replace(' ', '+')}"
            )
            tab.wait(
                "location.search && document.querySelector('#search-results"
                " p.search-summary')?.innerText.includes('found')"
            )
            assert any(title.startswith(page) for title in tab.run(titles)[:3]), (query, tab.run(titles)[:5])


@pytest.mark.slow
@pytest.mark.parametrize(
    "wrong", ["[lost](nowhere.md)", "[lost](index.md#nowhere)", "![lost](images/nowhere.png)"]
)
def test_a_broken_link_stops_the_build_with_its_file_and_line(
    wrong: str, site: ModuleType, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    for name in ("sphinx", "myst_parser", "furo"):
        pytest.importorskip(name)
    (tmp_path / "sources").mkdir()
    (tmp_path / "sources" / "index.md").write_text(f"# Title\n\n{wrong}\n", encoding="utf-8")
    assert site.write_html(tmp_path / "sources", tmp_path / "site") != 0
    assert "index.md:3: WARNING" in capfd.readouterr().err


PAGE = Path(__file__).parents[2] / "docs" / "agents.md"


def _schema(verb: str) -> dict[str, Any]:
    """The documented output of a command."""
    schema = json.loads(
        (PAGE.parents[1] / "schemas" / "deepbots-output-1.schema.json").read_text(encoding="utf-8")
    )
    jsonschema.Draft202012Validator.check_schema(schema)
    return {**schema, "$ref": f"#/$defs/{verb}"}


def steps() -> list[tuple[list[str], Any]]:
    """Each block of commands, and the output of its last command."""
    blocks = re.findall(
        r"```console\n(.*?)```\n\n```json\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL
    )
    return [
        ([line.removeprefix("$ ") for line in commands.splitlines()], json.loads(shown))
        for commands, shown in blocks
    ]


def missing_values(expected: Any, printed: Any, place: str = "") -> list[str]:
    """The values that the page shows and the command did not print. Keys may come in any order, and of a list
    the page may show the first items only."""
    if isinstance(expected, dict) and isinstance(printed, dict):
        return [
            text
            for key, value in expected.items()
            for text in missing_values(value, printed.get(key), f"{place}.{key}")
        ]
    if isinstance(expected, list) and isinstance(printed, list):
        pairs = zip(expected, [*printed, *[None] * len(expected)], strict=False)
        return [
            text
            for number, (expected_item, printed_item) in enumerate(pairs)
            for text in missing_values(expected_item, printed_item, f"{place}[{number}]")
        ]
    return [] if expected == printed else [f"{place}: {expected!r} is shown, {printed!r} was printed"]


@pytest.mark.slow
def test_the_loop_for_agents_prints_what_the_page_shows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    wrong = []
    for commands, shown in steps():
        for command in commands:
            main(shlex.split(command)[1:])
            printed = json.loads(capsys.readouterr().out)
            verb = shlex.split(command)[1]
            wrong += [
                f"{command}: {error.message}"
                for error in jsonschema.Draft202012Validator(_schema(verb)).iter_errors(printed)
            ]
        wrong += missing_values(shown, printed, commands[-1])
        if commands[0].startswith("deepbots new"):
            scenario = Path("mine.yaml")
            scenario.write_text(
                scenario.read_text(encoding="utf-8").replace("abs(cart.pole_angle)", "abs(cart.pole_angel)"),
                encoding="utf-8",
            )
    assert (wrong, len(steps())) == ([], 7)
    assert not jsonschema.Draft202012Validator(_schema("train")).is_valid(printed)


FAULTS = {
    "timestep: 32 ms": "timestap: 32",
    "wheel_speed: 5 rad/s": "wheel_speed: 5 radd/s",
    "joint: pole_hinge": "joint: pole_hing",
    "type: velocity_motor": "type: velocity_moter",
    "max_torque: 10 N*m": "max_torque: 10",
    "drive * wheel_speed": "drive * wheel_sped",
    "position(cart).x": "positon(cart).x",
    "velocity(cart.tip)": "velocity(cart.tipp)",
    "reward:": "rewards:",
    "abs(cart.pole_angle)": "abs(cart.pole_angel)",
    "uniform(-1": "unifrom(-1",
    "algorithm: PPO": "algorithm: PPPO",
}


def test_a_script_repairs_twelve_faults_by_the_edits_of_lint_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    main(["new", "mine", "--template", "cartpole", "--json"])
    capsys.readouterr()
    scenario = Path("mine.yaml")
    whole = text = scenario.read_text(encoding="utf-8")
    for right, wrong in FAULTS.items():
        assert right in whole
        text = text.replace(right, wrong, 1)
    for _ in range(len(FAULTS)):
        scenario.write_text(text, encoding="utf-8")
        main(["lint", "mine.yaml", "--json"])
        edits = [
            edit
            for finding in json.loads(capsys.readouterr().out)["findings"]
            for edit in (finding["fix"] or {"edits": []})["edits"]
        ]
        if not edits:
            break
        text = edited(text, edits)
    assert text == whole


def edited(text: str, edits: list[dict[str, Any]]) -> str:
    """The text after edits, the last ones first, so that places stay."""
    lines = text.splitlines(keepends=True)
    for edit in sorted(
        edits, key=lambda edit: (edit["start"]["line"], edit["start"]["column"]), reverse=True
    ):
        assert edit["start"]["line"] == edit["end"]["line"]
        row = edit["start"]["line"] - 1
        lines[row] = (
            lines[row][: edit["start"]["column"] - 1] + edit["text"] + lines[row][edit["end"]["column"] - 1 :]
        )
    return "".join(lines)
