"""Pictures and clips: PNG, MP4 and GIF drawn by the engine, and offline pages drawn by viser in the reader's
browser; the moving parts of an episode and their paths, for reports.

A free robot moves as its root link, a robot with a fixed base as the link that goes farthest.
"""

from __future__ import annotations

import errno
import html
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from importlib.util import find_spec
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from deepbots_cli import frames
from deepbots_cli.analysis import Analysis
from deepbots_cli.errors import MissingExtraError, UsageError
from deepbots_cli.expressions.scalar import EngineRead, Name, Scalar
from deepbots_cli.files import atomic_write, check_output
from deepbots_cli.frames import Triple
from deepbots_cli.port import View
from deepbots_cli.program import Program
from deepbots_cli.program.values import Expression
from deepbots_cli.program.world import WorldModel
from deepbots_cli.records import dataclass
from deepbots_cli.robots.kinematics import robot_bounds
from deepbots_cli.runtime.overview import overview, view_around
from deepbots_cli.view.episodes import Player
from deepbots_cli.view.frames import COLORS, FrameLayout, LinkName, WorldFrame

if TYPE_CHECKING:
    from PIL.Image import Image as Picture
    from PIL.ImageDraw import ImageDraw

# Pictures per second.
_GIF_FRAME_RATE = 12.5  # GIF has delays of 0.01 s, and this is 8 of them
_MP4_FRAME_RATE = 30.0
_PAGE_FRAME_RATE = 20.0
_GIF_COLORS = 96
_GIF_SHADE = 8  # of 256; shades that are closer are one color
_SUPERSAMPLING = 2  # the factor by which pictures are drawn larger before they are reduced
_FOLLOWED_ROOM = 1.2  # the factor on the reach of a robot from its origin, on each side
_MIN_CAMERA_DISTANCE_M = 1e-6
_LABEL_SPACING_PX = 18  # the distance of two labels

Point = tuple[float, float]


@dataclass(frozen=True)
class Viewpoint:
    """The viewpoint of a picture: `eye` and `target` (m) are None for a view that shows the whole scene.

    With `follow`, the name of a robot, the camera moves with this robot and shows its surroundings.
    """

    width: int = 640
    height: int = 480
    eye: Triple | None = None
    target: Triple | None = None
    follow: str | None = None
    samples: int = 2
    """The factor by which the pictures of a clip are drawn larger before they are reduced."""

    def view(self, usual: View) -> View:
        """Return the view, given the one without `eye` and `target`.

        Raises:
            UsageError: The camera is at the point that it looks at.
        """
        if self.eye is None and self.target is None:
            return usual
        target = self.target or usual.target
        eye = self.eye or frames.add(target, frames.subtract(usual.eye, usual.target))
        if math.dist(eye, target) < _MIN_CAMERA_DISTANCE_M:
            raise UsageError("the camera is at the point that it looks at; write another --from or --at")
        return replace(usual, eye=eye, target=target)

    def now(self, player: Player, usual: View) -> View:
        """Return the view of the newest frame, given the one of the whole scene. From an `eye` without a
        `target`, it looks at the first robot.

        Raises:
            UsageError: There is no robot to follow of this name, or the camera is at its target.
        """
        robots = {robot.name: robot for robot in player.env.world.robots}
        if self.follow is None:
            first = next(iter(robots.values()), None)
            if first is None or self.eye is None:
                return self.view(usual)
            return self.view(replace(usual, target=player.frame.links[first.name, first.model.root][0]))
        if self.follow not in robots:
            raise UsageError(f"--follow: there is no robot '{self.follow}'; there is {', '.join(robots)}")
        model = robots[self.follow].model
        middle = player.frame.links[self.follow, model.root][0]
        reach = _FOLLOWED_ROOM * max(abs(side) for corner in robot_bounds(model) for side in corner)
        around = tuple((side - reach, side + reach) for side in middle)
        low, high = zip(*around, strict=True)
        return view_around([(low, high)], self.width, self.height)


def check_target(path: Path, suffixes: Sequence[str], *, force: bool) -> None:
    """Check before an episode is run that `path` can be written, and that no file is overwritten unless
    `force`.

    Raises:
        UsageError: The name has another suffix, the file exists, or its directory cannot be written to.
            MissingExtraError: imageio is not installed for a video, or viser for an offline page.
    """
    kind = path.suffix.lower()
    if kind not in suffixes:
        raise UsageError(
            f"{path} must end in {', '.join(suffixes[:-1])}{' or ' if suffixes[1:] else ''}{suffixes[-1]}"
        )
    if kind == ".mp4" and (find_spec("imageio") is None or find_spec("imageio_ffmpeg") is None):
        raise MissingExtraError("train", "writing a video")
    if kind == ".html" and find_spec("viser") is None:
        raise MissingExtraError("view", "an offline page")
    check_output(path, force=force)


# Pictures


def render_picture(
    player: Player,
    shot: Viewpoint,
    *,
    labels: bool = False,
    rays: bool = False,
) -> Picture:
    """Draw a picture of the present world.

    Args:
        labels: Whether to name the links of robots, each with the joint that moves it. Without `eye`, the
            view is on the robots.
        rays: Whether to draw the rays of sensors, colored by their readings.
    """
    from PIL import Image, ImageDraw

    usual = _on_robots(player, shot) if labels else overview(player.program, shot.width, shot.height)
    view = replace(
        shot.now(player, usual),
        width=_SUPERSAMPLING * shot.width,
        height=_SUPERSAMPLING * shot.height,
        samples=1,
    )
    image = Image.fromarray(player.render(view))
    draw = ImageDraw.Draw(image, "RGBA")
    project = projection(view)
    if rays:
        for key, beams in player.reader.layout.sensor_rays.items():
            for start, end in beams.lines(player.frame, key).tolist():
                pixels = [pixel for pixel in (project(start[:3]), project(end[:3])) if pixel is not None]
                if len(pixels) == 2:
                    draw.line(pixels, fill=(*map(int, start[3:]), 230), width=2 * _SUPERSAMPLING)
    image = image.resize((shot.width, shot.height), Image.Resampling.LANCZOS)
    draw = ImageDraw.Draw(image, "RGBA")
    if labels:
        _paint_labels(draw, projection(replace(view, width=shot.width, height=shot.height)), player, shot)
    return image


def projection(view: View) -> Callable[[Triple], Point | None]:
    """Return a function from a point in the world to its pixel, from the upper left corner; None behind the
    camera."""
    ahead = np.subtract(view.target, view.eye) / math.dist(view.target, view.eye)
    left = np.cross((0.0, 0.0, 1.0), ahead)
    # In a view straight down, x is upwards.
    left = np.array((0.0, 1.0, 0.0)) if np.linalg.norm(left) < 1e-9 else left / np.linalg.norm(left)
    up = np.cross(ahead, left)
    scale = view.height / 2 / math.tan(view.fov / 2)

    def project(point: Triple) -> Point | None:
        way = np.subtract(point, view.eye)
        depth = float(way @ ahead)
        if depth < 1e-3:
            return None
        return view.width / 2 - scale * float(way @ left) / depth, view.height / 2 - scale * float(
            way @ up
        ) / depth

    return project


def _on_robots(player: Player, shot: Viewpoint) -> View:
    boxes = []
    for robot in player.env.world.robots[:1]:
        origin, _ = player.frame.links[robot.name, robot.model.root]
        low, high = robot_bounds(robot.model)
        boxes.append((frames.add(origin, low), frames.add(origin, high)))
    view = view_around(boxes, shot.width, shot.height)
    # Room for labels on both sides.
    return replace(
        view, eye=frames.add(view.target, frames.scaled(frames.subtract(view.eye, view.target), 1.5))
    )


def _paint_labels(
    draw: ImageDraw, project: Callable[[Triple], Point | None], player: Player, shot: Viewpoint
) -> None:
    """Paint links, each with the joint that moves it, in two columns with lines to their origins."""
    columns: tuple[list[tuple[Point, str]], list[tuple[Point, str]]] = ([], [])
    for robot in player.env.world.robots[:1]:
        joints = {joint.child: joint.name for joint in robot.model.joints if joint.type != "fixed"}
        for link in robot.model.links:
            pixel = project(player.frame.links[robot.name, link.name][0])
            if pixel is not None:
                moved = f" ({joints[link.name]})" if link.name in joints else ""
                columns[pixel[0] > shot.width / 2].append((pixel, f"{link.name}{moved}"))
    for side, column in enumerate(columns):
        column.sort(key=lambda entry: entry[0][1])
        line = min(_LABEL_SPACING_PX, (shot.height - 10) / max(1, len(column)))
        middle = float(np.mean([y for (_, y), _ in column] or [0.0]))
        top = min(max(5.0, middle - line * len(column) / 2), shot.height - 5 - line * len(column))
        for row, (pixel, text) in enumerate(column):
            y = top + row * line
            width = draw.textlength(text, font=_font())
            x = shot.width - 6 - width if side else 6.0
            draw.line(((x - 4 if side else x + width + 4, y + 7), pixel), fill=(40, 60, 90, 150), width=1)
            draw.ellipse((pixel[0] - 2, pixel[1] - 2, pixel[0] + 2, pixel[1] + 2), fill=COLORS[3])
            _write(draw, (x, y), text)


def _font() -> Any:
    from PIL import ImageFont

    return ImageFont.load_default(size=12)


def _write(draw: ImageDraw, at: Point, text: str) -> None:
    left, top, right, bottom = draw.textbbox(at, text, font=_font())
    draw.rounded_rectangle((left - 4, top - 3, right + 4, bottom + 3), radius=3, fill=(255, 255, 255, 190))
    draw.text(at, text, font=_font(), fill=(20, 25, 35, 255))


# Trajectories

Positions = Mapping[LinkName, NDArray[np.float64]]
"""The position of each link of each body, step by step: shape (n, 3) in m, nan while it was absent. The key
`("", agent)` is the goal of an agent."""
MAX_TRAJECTORIES = 8
_MIN_EXTENT_M = 1e-3  # m; a part that moves less stands still
_MIN_SHARE = 0.02  # share of the longest trajectory; a shorter one is a dot


class Moving(NamedTuple):
    """The drawn parts of an episode: the parts that move, robots first, and their goals."""

    parts: tuple[LinkName, ...]
    targets: tuple[LinkName, ...]


def read_positions(layout: FrameLayout, frames: Iterable[WorldFrame]) -> Positions:
    """Return the positions of all links and of the desired goals in the frames of an episode."""
    rows = []
    for frame in frames:
        goals = {("", name): layout.goal_point(agent, "desired") for name, agent in frame.agents.items()}
        rows.append(
            {part: pose[0] for part, pose in frame.links.items()}
            | {part: point for part, point in goals.items() if point}
        )
    absent = (np.nan,) * 3
    return {
        part: np.array([row.get(part, absent) for row in rows])
        for part in dict.fromkeys(part for row in rows for part in row)
    }


def find_moving(program: Program, world: WorldModel, episodes: Sequence[Positions]) -> Moving:
    """Return the parts that move in at least one of these episodes of a program. `world` is the world of the
    environment, with all copies of a robot."""
    parts = dict.fromkeys(part for positions in episodes for part in positions)
    extents = {
        part: max(_extent(positions[part]) for positions in episodes if part in positions) for part in parts
    }
    robots = [
        (
            robot.name,
            max((link.name for link in robot.model.links), key=lambda link: extents[robot.name, link]),
        )
        if robot.fixed_base
        else (robot.name, robot.model.root)
        for robot in world.robots
    ]
    objects = [(body.name, body.name) for body in world.objects]
    fixed = {(body.name, body.name) for body in world.objects if body.fixed}
    candidates = [part for part in (*robots, *objects) if part in extents.keys() - fixed]
    least = max(_MIN_EXTENT_M, _MIN_SHARE * max((extents[part] for part in candidates), default=0.0))
    moving = [part for part in candidates if extents[part] >= least] or candidates[:1]
    goals = [part for part in parts if not part[0]]
    aims = _aims(program)
    standing = [part for part in objects if part in extents and part[0].partition("#")[0] in aims]
    targets = [*goals, *(part for part in standing if part not in moving)]
    return Moving(tuple(moving[:MAX_TRAJECTORIES]), tuple(targets))


def _aims(program: Program) -> set[str]:
    """Return the bodies that the goal or a success reads; without one, those that the reward reads and no
    failure, which often reads walls that must not be touched."""
    analysis, agent = Analysis(program).ideal, program.agent

    def read(values: Iterable[Expression]) -> set[str]:
        return {body for value in values for body in _read_by(analysis, value)}

    aims = read(ending for ending in program.endings if ending.name in agent.success)
    aims |= read([agent.goal.achieved]) if agent.goal else set()
    objects = {body.name.partition("#")[0] for body in program.world.objects}
    if aims & objects:
        return aims
    return read(agent.reward) - read(value for value in program.endings if value.name in program.failures)


def describe(world: WorldModel, part: LinkName) -> str:
    """Return the name of a part, such as `block`, `epuck`, `panda.panda_hand` or `goal`. A copy of a robot or
    an object has the name in the scenario."""
    body, link = (name.partition("#")[0] for name in part)
    robot = next((robot for robot in world.robots if robot.name.partition("#")[0] == body), None)
    return f"{body}.{link}" if robot is not None and robot.fixed_base else body or "goal"


def has_moved(points: NDArray[np.float64]) -> bool:
    """Return whether positions (n, 3) differ by more than 1 mm."""
    return _extent(points) >= _MIN_EXTENT_M


def _extent(points: NDArray[np.float64]) -> float:
    """Return the diagonal of the box around positions, m."""
    finite = points[~np.isnan(points[:, 0])]
    return float(np.linalg.norm(np.ptp(finite, axis=0))) if len(finite) else 0.0


def _read_by(analysis: Analysis, value: Expression) -> Iterator[str]:
    """Yield the bodies that an expression reads."""
    if not value.foreign:
        for tree in analysis.scalars(value):
            for node in analysis.walk_definitions(tree):
                for full_name in _full_names(analysis, node):
                    yield full_name.partition(".")[0].partition("#")[0]


def _full_names(analysis: Analysis, node: Scalar) -> Iterator[str]:
    match node:
        case EngineRead(_, subjects):
            yield from subjects
        case Name() if sensor := analysis.sensor(node):
            yield from (f"{sensor[0]}.{subject}" for subject in sensor[1].subjects)


# Clips


def write_clip(
    player: Player,
    path: Path,
    shot: Viewpoint,
    *,
    seed: int,
    episode: int,
    seconds: float | None = None,
    speed: float = 1.0,
    rate: float = _MP4_FRAME_RATE,
    on_frame: Callable[[WorldFrame], object] = lambda frame: None,
) -> WorldFrame:
    """Write an episode, or its first `seconds`, as MP4, GIF or an offline page, by the suffix of `path`.
    Returns the last frame.

    Args:
        speed: Seconds of the episode per second of the clip.
        rate: The largest number of pictures per second of an MP4.
        on_frame: Called before each picture of an MP4 or a GIF.

    Raises:
        EngineError: The engine cannot draw.
        UsageError: There is no robot to follow, or an MP4 would have an odd width or height.
    """
    if path.suffix.lower() == ".mp4" and (shot.width % 2 or shot.height % 2):
        raise UsageError(
            f"{path}: an MP4 has an even width and height; write --size"
            f" {shot.width + shot.width % 2}x{shot.height + shot.height % 2}, or name a .gif"
        )
    steps = None if seconds is None else max(1, round(seconds / player.program.period))
    world_frames = player.episode(seed, episode, steps)
    with atomic_write(path) as draft:
        if path.suffix.lower() == ".html":
            _write_page(player, draft, world_frames, speed)
        elif path.suffix.lower() == ".gif":
            write_gif(draft, *_pictures(player, shot, world_frames, speed, _GIF_FRAME_RATE, on_frame))
        else:
            write_mp4(draft, *_pictures(player, shot, world_frames, speed, rate, on_frame))
    return player.frame


def _pictures(
    player: Player,
    shot: Viewpoint,
    world_frames: Iterable[WorldFrame],
    speed: float,
    rate: float,
    on_frame: Callable[[WorldFrame], object],
) -> tuple[Iterator[Any], float]:
    """Return pictures at most `rate` times a second, and their number in a second. At most one picture is
    drawn per step."""
    # Without the margin, a ratio such as 1.0000000001 would leave out every second picture.
    every = max(1, math.ceil(speed / player.program.period / rate - 1e-9))

    def taken() -> Iterator[Any]:
        for frame in world_frames:
            if _is_drawn(frame, every):
                on_frame(frame)
                yield player.render(
                    replace(
                        shot.now(player, player.view(shot.width, shot.height)),
                        width=shot.width,
                        height=shot.height,
                        samples=shot.samples,
                    )
                )

    return taken(), speed / player.program.period / every


def _is_drawn(frame: WorldFrame, every: int) -> bool:
    """Return whether a clip shows a frame: each of so many steps, and the last one of an episode."""
    return frame.step % every == 0 or frame.ended_by is not None


def write_mp4(path: Path, pictures: Iterator[Any], rate: float) -> None:
    """Write an MP4 with `rate` pictures per second, each of the shape (height, width, 3)."""
    import imageio.v2 as imageio

    # Pictures of even height and width are all that the codec asks for; by default they would be scaled to
    # multiples of 16.
    writer: Any
    with imageio.get_writer(path, format="FFMPEG", fps=rate, macro_block_size=2, quality=7) as writer:
        for image in pictures:
            try:
                writer.append_data(image)
            except OSError as error:
                if error.errno is not None:
                    raise
                # Of imageio, at length: ffmpeg has ended, to which it writes through a pipe.
                raise OSError(errno.EPIPE, "ffmpeg has ended, as it does on a full disk") from error


def write_gif(path: Path, pictures: Iterator[Any], rate: float) -> None:
    """Write a GIF with one palette for all pictures and without dithering, so that unchanged pixels are not
    stored again."""
    from PIL import Image

    images = [Image.fromarray(image) for image in pictures]
    pixels = np.concatenate(
        [np.asarray(image)[::2, ::2].reshape(-1, 3) for image in images[:: max(1, len(images) // 8)]]
    )
    _, shades, counts = np.unique(pixels // _GIF_SHADE, axis=0, return_inverse=True, return_counts=True)
    means = np.stack([np.bincount(shades.ravel(), channel) / counts for channel in pixels.T], axis=1)
    # A robot is small: by counts of pixels, floor and sky would take its colors (a blue cart turned black).
    sample = Image.fromarray(
        np.repeat(np.rint(means).astype(np.uint8), np.sqrt(counts).astype(int), axis=0)[None]
    )
    palette = sample.quantize(_GIF_COLORS, method=Image.Quantize.MEDIANCUT, kmeans=2)
    small = [image.quantize(palette=palette, dither=Image.Dither.NONE) for image in images]
    # ms, in steps of 10, which add up to the time of the episode. Browsers show shorter delays than 20 ms as
    # 100 ms. The last picture stays for 1.2 s.
    ends = [10 * round(100 * number / rate) for number in range(len(small))]
    pause = [*(max(20, end - begin) for begin, end in pairwise(ends)), 1200]
    small[0].save(
        path,
        format="GIF",
        save_all=True,
        append_images=small[1:],
        duration=pause,
        loop=0,
        optimize=True,
        disposal=1,  # the picture before stays below the changed pixels
    )


def _write_page(player: Player, path: Path, world_frames: Iterator[WorldFrame], speed: float) -> None:
    """Write a page that turns and scrubs without a server: viser's recording of its scene."""
    from deepbots_cli.view import server
    from deepbots_cli.view.scene import WorldScene, aim_camera

    page, _ = server.serve(server.LOOPBACK, 0, "deepbots", lambda keys, axes: None)
    try:
        program = player.program
        first = next(world_frames)
        world = WorldScene(
            page.scene, player.env.world, player.reader.layout, size=aim_camera(page, overview(program))
        )
        world.set_frame(first, after_reset=True)
        world.draw(1.0)
        recording = page.get_scene_serializer()
        pause = program.period / speed
        parts = max(1, round(pause * _PAGE_FRAME_RATE))
        every = max(1, math.floor(1 / (pause * _PAGE_FRAME_RATE)))
        for frame in world_frames:
            world.set_frame(frame)
            for part in range(1, parts + 1):
                if _is_drawn(frame, every):
                    world.draw(part / parts)
                recording.insert_sleep(pause / parts)
        text = recording.as_html()
    finally:
        server.stop(page)
    title = f"<title>{html.escape(program.name)}</title>"
    path.write_text(text.replace("<title>Viser</title>", title, 1), encoding="utf-8")
