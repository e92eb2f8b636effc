"""Pictures and clips: by their pixels, and read back."""

from __future__ import annotations

from contextlib import closing
from itertools import product

import numpy as np
import pytest
from PIL import Image

from deepbots_cli import frames
from deepbots_cli.cli import main
from deepbots_cli.errors import UsageError
from deepbots_cli.port import View
from deepbots_cli.robots.kinematics import bounds_of_shape
from deepbots_cli.view.episodes import Player, Showing
from deepbots_cli.view.pictures import (
    PaintedPath,
    Viewpoint,
    projection,
    render_picture,
    write_clip,
    write_gif,
)


def _yellow(image):
    red, green, blue = np.moveaxis(np.asarray(image.convert("RGB")).astype(int), -1, 0)
    return (
        (red > 60) & (green > 0.7 * red) & (blue < 0.6 * red)
    )  # also in the shade, which is darker in MuJoCo


def test_a_point_is_projected_to_where_the_engine_draws_it():
    with closing(Player(Showing("find_ball").open(), "around")) as player:
        player.begin(0, 0)
        view = View((0.9, -1.2, 1.0), (0.1, 0.1, 0.0), 640, 480)
        rows, columns = np.nonzero(
            _yellow(render_picture(player, Viewpoint(640, 480, view.eye, view.target)))
        )
        assert projection(view)(player.frame.links["ball", "ball"][0]) == pytest.approx(
            (columns.mean(), rows.mean()), abs=4
        )
        assert projection(view)((3.0, -6.0, 3.0)) is None


def test_a_path_is_painted_where_the_robot_went():
    with closing(Player(Showing("find_ball").open(), "around")) as player:
        path = list(player.episode(0, 0))
        bare = np.asarray(render_picture(player, Viewpoint(400, 400), path=path[-1:]).convert("RGB")).astype(
            int
        )
        painted = np.asarray(render_picture(player, Viewpoint(400, 400), path=path).convert("RGB")).astype(
            int
        )
    changed = np.abs(painted - bare).sum(axis=2) > 60
    assert 300 < changed[:370].sum() < 6000


def test_the_view_of_a_path_does_not_cut_off_the_robot_at_its_end():
    with closing(Player(Showing("balancer").open(), "lean")) as player:
        path = list(player.episode(0, 0, 60))
        shot = Viewpoint(300, 200)
        project = projection(PaintedPath.of(player, path).view(player.env.world, shot))
        (robot,) = player.env.world.robots
    for link in robot.model.links:
        for part in link.visuals:
            low, high = bounds_of_shape(
                part.shape, frames.compose(path[-1].links[robot.name, link.name], frames.frame(part.origin))
            )
            for corner in product(*zip(low, high, strict=True)):
                x, y = project(corner)
                assert 0 < x < 300
                assert 0 < y < 200


def test_a_path_that_climbs_is_seen_from_the_side():
    with closing(Player(Showing("quadrotor").open(), "zero")) as player:
        path = list(player.episode(0, 0, 40))
        view = PaintedPath.of(player, path).view(player.env.world, Viewpoint(300, 200))
    assert view.eye[:2] != view.target[:2]


def test_labels_and_rays_are_painted():
    with closing(Player(Showing("find_ball").open(), "around")) as player:
        player.begin(0, 0)
        shots = [
            render_picture(
                player, Viewpoint(400, 300, (-0.5, -0.8, 0.4), (-0.38, -0.38, 0.0)), **{what: True}
            )
            for what in ("labels", "rays")
        ]
        plain = render_picture(player, Viewpoint(400, 300, (-0.5, -0.8, 0.4), (-0.38, -0.38, 0.0)))
    for shot in shots:
        assert np.abs(np.asarray(shot).astype(int) - np.asarray(plain)).max() > 60


def test_a_followed_robot_stays_in_the_middle_and_large(tmp_path):
    shot = Viewpoint(160, 120, follow="epuck")
    with closing(Player(Showing("find_ball").open(), "around")) as player:
        eyes = []
        robot = player.env.world.robots[0]
        write_clip(
            player,
            tmp_path / "clip.gif",
            shot,
            seed=0,
            episode=0,
            seconds=3.0,
            on_frame=lambda frame: eyes.append(
                (frame.links[robot.name, robot.model.root][0], shot.now(player, player.view(160, 120)))
            ),
        )
        whole = player.view(160, 120)
    (first, viewpoint), (last, last_viewpoint) = eyes[0], eyes[-1]
    assert np.linalg.norm(np.subtract(first, last)) > 0.05
    assert np.subtract(last_viewpoint.eye, last) == pytest.approx(np.subtract(viewpoint.eye, first), abs=1e-3)
    assert np.linalg.norm(np.subtract(viewpoint.eye, first)) < 0.7 * np.linalg.norm(
        np.subtract(whole.eye, whole.target)
    )
    with pytest.raises(UsageError, match=r"--follow: there is no robot 'dog'; there is epuck"):
        Viewpoint(follow="dog").now(player, whole)


@pytest.mark.parametrize("suffix", [".gif", ".mp4"])
def test_a_clip_can_be_read_and_moves(tmp_path, suffix):
    out = tmp_path / f"clip{suffix}"
    with closing(Player(Showing("find_ball").open(), "around")) as player:
        last = write_clip(player, out, Viewpoint(160, 120), seed=0, episode=0, seconds=2.0)
    assert last.time == pytest.approx(2.048, abs=0.13)
    if suffix == ".gif":
        with Image.open(out) as image:
            pictures = []
            for number in range(image.n_frames):
                image.seek(number)
                pictures.append(np.asarray(image.convert("RGB")))
    else:
        imageio = pytest.importorskip("imageio.v2")
        pictures = [np.asarray(image) for image in imageio.get_reader(out)]
    assert len(pictures) == last.step + 1
    assert pictures[0].shape == (120, 160, 3)
    assert np.abs(pictures[0].astype(int) - pictures[-1]).max() > 60
    assert out.stat().st_size < 100_000


def test_a_gif_keeps_the_color_of_a_small_robot(tmp_path):
    shades = np.random.default_rng(0).integers(0, 256, (1, 160, 1)) * np.array(
        [[[0.9, 0.95, 1.0]]]
    )  # a floor of many shades
    image = np.broadcast_to(shades, (120, 160, 3)).astype(np.uint8).copy()
    image[50:58, 60:68] = (30, 90, 200)
    write_gif(tmp_path / "clip.gif", iter([image, image[::-1]]), 10.0)
    with Image.open(tmp_path / "clip.gif") as clip:
        assert np.abs(np.asarray(clip.convert("RGB")).astype(int)[54, 64] - (30, 90, 200)).max() < 20


def test_an_offline_page_contains_the_episode(tmp_path):
    pytest.importorskip("viser")
    out = tmp_path / "clip.html"
    with closing(Player(Showing("cartpole").open(), "zero")) as player:
        write_clip(player, out, Viewpoint(), seed=0, episode=0, seconds=1.0)
    text = out.read_text()
    assert "__VISER_EMBED_DATA__" in text
    assert "<title>CartPole</title>" in text
    assert out.stat().st_size < 1_500_000


def test_the_commands_write_their_files_and_refuse_what_they_cannot(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["render", "cartpole", "--size", "120x90", "--output", "a.png"]) == 0
    with Image.open("a.png") as image:
        assert image.size == (120, 90)
    assert main(["render", "cartpole", "--size", "120x90", "--seconds", "0.3", "-o", "a.gif"]) == 0
    assert "a.gif" in capsys.readouterr().out
    assert (
        main(
            [
                "render",
                "cartpole",
                "--size",
                "120x90",
                "--seconds",
                "0.1",
                "--episodes",
                "2",
                "-o",
                "each.gif",
            ]
        )
        == 0
    )
    assert sorted(path.name for path in tmp_path.glob("each*")) == ["each-0.gif", "each-1.gif"]
    for words, message in (
        (["render", "cartpole", "--last"], "--last chooses a model of a run, but cartpole is not a run"),
        (
            ["render", "cartpole", "-o", "a.jpg"],
            "a.jpg must end in .png, .mp4, .gif, .html or .mcap; the suffix says what is made",
        ),
        (["render", "cartpole", "-o", "none/a.gif"], "no directory"),
        (["render", "cartpole", "--size", "9x9"], "is not a size"),
        (["render", "cartpole", "--from", "1,2"], "is not a point"),
        (
            ["render", "cartpole", "--from", "1,2,1", "--follow", "cart"],
            "--follow moves the camera; leave out --from and --at",
        ),
        (["render", "cartpole", "--from", "nan,0,0"], "not a number"),
        (["render", "find_ball", "--driver", "nobody", "-o", "b.gif"], "there is no driver 'nobody'"),
        (["render", "cartpole", "--driver", "policy", "-o", "b.gif"], "only a run has a policy"),
        (
            ["render", "cartpole", "--driver", "you", "-o", "b.gif"],
            "you can drive in the browser only; use `deepbots play`",
        ),
        (
            ["render", "cartpole", "--labels", "-o", "b.gif"],
            "b.gif: --labels is for .png; leave it out, or name another file",
        ),
        (
            ["render", "cartpole", "--rays", "--seconds", "1", "-o", "b.mcap"],
            "b.mcap: --rays is for .png; --seconds is for .mp4, .gif, .html; leave them out, or name another"
            " file",
        ),
        (
            ["render", "cartpole", "--episodes", "failed", "-o", "b.gif"],
            "--episodes failed repeats an evaluation of a run",
        ),
        (["render", "epuck", "-o", "b.gif"], "epuck is a robot file"),
        (["render", "epuck", "--seed", "0"], "epuck is a robot file"),
        (["render", "epuck", "--last"], "epuck is a robot file"),
        (["render", "cartpole", "--size", "9" * 5000 + "x100"], "is not a size"),
    ):
        assert main(words) == 2
        assert message in " ".join(capsys.readouterr().err.split())
