"""The page that lists the lessons, from their folders. Paths are relative to the root of the repository."""

from __future__ import annotations

from pathlib import Path

from deepbots_cli.course.lessons import Lesson, shipped_lessons

ROOT = Path(__file__).resolve().parents[1]
INDEX = "docs/course.md"
_WITHOUT_WORLD = "images/intervals.svg"
"""The picture of a lesson that has no world."""


def pages() -> dict[str, str]:
    """The text of the page by its path."""
    lessons = shipped_lessons()
    minutes = sum(lesson.content.minutes for lesson in lessons)
    lines = [
        "# The course",
        "",
        f"In {len(lessons)} lessons, {minutes / 60:g} hours, you go from a sensor to a policy for a robot of"
        " your own. You need to know neither Python nor reinforcement learning. `deepbots course start 1`"
        " writes the first lesson into a folder, with a text and three steps. `deepbots course check` marks"
        " what you have made.",
        "",
        "| | lesson | what you make in its last step | minutes |",
        "|---|---|---|---|",
        *map(_row, lessons),
        "",
        "[For teachers](teach.md) says how to set the lessons, mark a class, and write a lesson.",
    ]
    return {INDEX: "\n".join(lines) + "\n"}


def _row(lesson: Lesson) -> str:
    folder = f"../course/{lesson.folder.name}"
    picture = f"{folder}/world.png" if (lesson.folder / "world.png").is_file() else _WITHOUT_WORLD
    *_, last = lesson.steps.values()
    image = f'<img src="{picture}" alt="" width="160px">'
    title = f"[{lesson.content.title}]({folder}/text.md)"
    return f"| {lesson.number} | {image}<br>{title} | {last.goal} | {lesson.content.minutes} |"
