"""`deepbots webots`: projects with their controllers, as processes see them."""

from __future__ import annotations

import json
import re
import shutil
import sys
import textwrap
from typing import Any

import pytest

from deepbots_cli.engines.mujoco import cameras
from deepbots_cli.errors import UsageError
from deepbots_webots import supervisor
from deepbots_webots.command import check_world
from deepbots_webots.supervisor import Keyboard
from tests.webots.conftest import BOSS, CART, WORLD, Project
from tests.webots.exported_projects import HEADER, simulate

RESET = BOSS.replace(
    "        boss.step(32)\n",
    "        boss.step(32)\n        if number == 2:\n            boss.simulationReset()\n            boss.step(32)\n",
)


@pytest.mark.parametrize(
    ("cart", "boss", "lines"),
    [
        pytest.param(
            CART,
            BOSS,
            [
                "[boss] 0 []",
                "[boss] 1 ['0!']",
                "[boss] 2 ['1!']",
                "[boss] 3 ['2!']",
                "[cart] the end",
            ],
            id="messages are one step late in each direction",
        ),
        pytest.param(
            CART,
            RESET,
            ["[boss] 0 []", "[boss] 1 ['0!']", "[boss] 2 []", "[boss] 3 []", "[cart] the end"],
            id="a reset empties the queues",
        ),
        pytest.param(
            "from controller import Robot\nrobot = Robot()\nwhile robot.step(100) != -1: print(robot.getTime())",
            BOSS.replace("range(4)", "range(9)").replace("print(number, words)", "pass"),
            ["[cart] 0.128", "[cart] 0.256"],
            id="a controller with a longer period runs less often",
        ),
    ],
)
def test_controllers_take_turns(project: Project, cart: str, boss: str, lines: list[str]):
    project.controller("cart", cart)
    project.controller("boss", boss)
    assert project.run().out.splitlines() == lines


def test_a_controller_in_another_language_is_named_and_not_run(project: Project):
    (project.folder / "controllers" / "cart" / "cart.py").rename(
        project.folder / "controllers" / "cart" / "cart.cpp"
    )
    ran = project.run()
    assert "the controller 'cart' of 'cart' is written in C++; deepbots runs Python" in ran.err
    assert "[boss] 3 []" in ran.out
    assert "4 steps, 0.128 s of simulated time" in ran.err


EXTERN = WORLD.replace('controller "cart"', 'controller "<extern>"')


@pytest.mark.parametrize(
    ("files", "option", "found"),
    [
        pytest.param(["controllers/any/any.py"], "", "controllers/any/any.py", id="the only one"),
        pytest.param(["controllers/any/main.py"], "", "controllers/any/main.py", id="with another name"),
        pytest.param(
            ["controllers/a/a.py", "controllers/cart/cart.py"], "", "controllers/cart/cart.py", id="its name"
        ),
        pytest.param(["controllers/a/a.py", "b/c.py"], "cart=b/c.py", "c.py", id="chosen"),
        pytest.param(["controllers/a/a.py", "controllers/b/b.py"], "", "", id="one of several"),
    ],
)
def test_a_controller_that_is_started_by_hand_is_found(
    project: Project, monkeypatch: Any, files: list[str], option: str, found: str
):
    monkeypatch.chdir(project.folder)
    project.write("worlds/w.wbt", HEADER + EXTERN)
    shutil.rmtree(project.folder / "controllers" / "cart")
    for name in files:
        project.write(name, CART)
    ran = project.run(*(["--controller", option] if option else []), allow=False)
    row = next(line.split() for line in ran.out.splitlines() if line.split()[0] == "cart")
    assert row[2:4] == ([found.rpartition("/")[2], "yes"] if found else ["<extern>", "no"])
    words = f"'<extern>' of 'cart' is {found}" if found else "name it: --controller cart=FILE"
    assert option or words in ran.err


def test_a_handler_of_a_signal_warns_and_the_controller_goes_on(project: Project):
    handler = "import signal, sys\nsignal.signal(signal.SIGINT, lambda *_: sys.exit(0))\n"
    project.controller("boss", handler + textwrap.dedent(BOSS))
    ran = project.run()
    assert "[boss] Warning: signal.signal(SIGINT, ...) has no effect" in ran.err
    assert ran.out.splitlines()[-1] == "[cart] the end"


def test_the_controller_of_a_robot_comes_and_goes_with_it(project: Project):
    project.controller(
        "late", "from controller import Robot\nrobot = Robot()\nwhile robot.step(32) != -1: print('here')"
    )
    project.write(
        "controllers/boss/late.wbo", '#VRML_OBJ R2023b utf8\nDEF LATE Robot { name "late" controller "late" }'
    )
    project.controller(
        "boss",
        """
        from controller import Supervisor
        boss = Supervisor()
        boss.step(32)
        boss.getRoot().getField("children").importMFNode(-1, "late.wbo")
        for _ in range(3): boss.step(32)
        boss.getFromDef("LATE").remove()
        for _ in range(3): boss.step(32)
        """,
    )
    assert project.run().out.splitlines() == ["[late] here"] * 2 + ["[cart] the end"]


def test_a_supervisor_restarts_controllers_also_one_that_has_ended_and_its_own(project: Project):
    project.controller(
        "cart",
        """
        import shared
        from controller import Robot
        robot = Robot()
        shared.count += 1
        print("begins", shared.count, Robot().getDevice("receiver").getSamplingPeriod())
        robot.getDevice("receiver").enable(32)
        robot.step(32)
        if robot.getTime() < 0.05:
            while robot.step(1000) != -1: pass
        """,
    )
    project.write("controllers/cart/shared.py", "count = 0")
    project.controller(
        "boss",
        """
        from controller import Supervisor
        boss = Supervisor()
        boss.step(32)
        print("boss")
        cart = boss.getFromDef("CART")
        if boss.getTime() < 0.1:
            cart.restartController()
            boss.step(32)
            boss.step(128)
            cart.restartController()
            boss.step(32)
            boss.getSelf().restartController()
            boss.step(32)
        """,
    )
    begins = "[cart] begins 1 0"
    ran = project.run()
    assert ran.out.splitlines() == [begins, "[boss] boss", begins, begins, "[boss] boss"]
    assert ran.err.count("the controller of 'cart' ended; the others go on") == 2


def test_two_supervisors_run_until_both_end(project: Project):
    project.write(
        "worlds/w.wbt",
        HEADER + WORLD.replace('name "cart" controller', 'name "cart" supervisor TRUE controller'),
    )
    project.controller(
        "cart",
        "from controller import Supervisor\nit = Supervisor()\nfor _ in range(9): it.step(32)\nprint(it.getTime())",
    )
    assert project.run().out.splitlines()[-1] == "[cart] 0.288"


def test_no_code_runs_without_permission(project: Project):
    project.controller("cart", "open('ran', 'w')")
    project.controller("boss", "open('ran', 'w')")
    ran = project.run(allow=False)
    assert "--allow-code" in ran.out
    assert [line.split()[:3] for line in ran.out.splitlines()[2:4]] == [
        ["boss", "yes", "boss"],
        ["cart", "no", "cart"],
    ]
    assert not list(project.folder.rglob("ran"))


def test_the_devices_of_a_large_robot_fit_the_page(project: Project):
    project.write("worlds/w.wbt", f'{HEADER}WorldInfo {{ }} E-puck {{ controller "cart" }}')
    ran = project.run(allow=False)
    assert max(map(len, ran.out.splitlines())) <= 100
    assert "ps3, ls3, ps4" in " ".join(ran.out.split())


def test_controllers_have_their_own_modules_folders_and_arguments(project: Project):
    project.write(
        "worlds/w.wbt",
        HEADER + WORLD.replace('controller "cart"', 'controller "cart" controllerArgs [ "a" "b c" ]'),
    )
    for name in ("boss", "cart"):
        project.write(f"controllers/{name}/shared_name.py", f"WHO = '{name}'\ncount = 0")
        project.write(f"controllers/{name}/package/__init__.py", "")
        project.write(f"controllers/{name}/package/inner.py", f"WHO = '{name} inside'")
        # Such a folder, in which a program wrote files, does not hide an installed package.
        project.write(f"controllers/{name}/gymnasium/log.txt", "")
        project.controller(
            name,
            f"""
            import os, sys
            from controller import Supervisor, Robot
            import gymnasium, shared_name
            robot = {"Supervisor" if name == "boss" else "Robot"}()
            for _ in range(3):
                robot.step(32)
                import shared_name as again
                from package import inner
                again.count += 1
            print(again.WHO, inner.WHO, gymnasium.__name__, gymnasium.Env.__name__, shared_name.count, os.path.basename(os.getcwd()), sys.argv[1:], __name__)
            import __main__
            print(__main__.__file__.endswith("{name}.py"))
            """,
        )
    lines = project.run().out.splitlines()
    assert sorted(lines) == [
        "[boss] True",
        "[boss] boss boss inside gymnasium Env 3 boss [] __main__",
        "[cart] True",
        "[cart] cart cart inside gymnasium Env 3 cart ['a', 'b c'] __main__",
    ]


ONE_STEP = "from controller import Robot\nRobot().step(32)\n"
QUITS = "from controller import Supervisor\nboss = Supervisor()\nboss.step(32)\nboss.simulationQuit(7)\nprint(boss.step(32))"


@pytest.mark.parametrize(
    ("cart", "boss", "code", "line", "error"),
    [
        pytest.param(CART, QUITS, 7, "[boss] -1", "", id="a supervisor quits"),
        pytest.param(
            CART.replace("emitter.send(", "emitter.sned("),
            BOSS,
            1,
            "",
            "error: the controller of 'cart' failed: AttributeError: 'Emitter' has no attribute 'sned'",
            id="a crash names its robot",
        ),
        pytest.param(
            CART,
            "from controller import Mouse\nprint('imported', flush=True)\nMouse()",
            1,
            "[boss] imported",
            "NotImplementedCallError: controller.Mouse is not implemented",
            id="a class that is missing",
        ),
        pytest.param(
            CART,
            "from vehicle import Driver",
            1,
            "",
            "ImportError: the module 'vehicle' of Webots, with Driver and Car, is not implemented",
            id="a module that is missing",
        ),
        pytest.param(
            CART,
            "import telepathy.waves",
            1,
            "",
            "No module named 'telepathy'; install the package of 'telepathy', or name an environment with it by"
            " --python",
            id="a package that is missing",
        ),
        pytest.param(f"{ONE_STEP}raise SystemExit(5)", BOSS, 5, "[boss] 3 []", "", id="an exit code is kept"),
        pytest.param(
            "print('done', end='')",
            BOSS,
            0,
            "[cart] done",
            "the controller of 'cart' ended; the others go on",
            id="an early end",
        ),
    ],
)
def test_the_end_of_a_controller_is_reported(
    project: Project, cart: str, boss: str, code: int, line: str, error: str
):
    project.controller("cart", cart)
    project.controller("boss", boss)
    ran = project.run(code=code)
    assert line in ran.out
    assert error in ran.err
    assert "deepbots_cli" not in ran.err


@pytest.mark.parametrize(
    ("release", "words"),
    [
        ("1.0.0", "the project is for deepbots before 1.0, such as the package deepbots==0.1.2"),
        ("0.1.2", "the project is for deepbots 1.0, the package deepbots==1.0.0"),
    ],
)
def test_a_project_for_another_release_of_deepbots_names_it(project: Project, release: str, words: str):
    metadata = f"Metadata-Version: 2.1\nName: deepbots\nVersion: {release}\n"
    project.write(f"controllers/boss/deepbots-{release}.dist-info/METADATA", metadata)
    project.write("controllers/boss/deepbots/__init__.py", "")
    project.controller("boss", "from deepbots.robots.controllers import Robot")
    assert words in project.run(code=1).err


def test_a_controller_that_ignores_the_end_is_ended(project: Project):
    project.controller(
        "boss", "from controller import Supervisor\nboss = Supervisor()\nwhile True: boss.step(32)"
    )
    result = json.loads(project.run("--steps", "50", "--json").out)
    assert (result["steps"], result["simulated_s"]) == (50, 1.6)
    assert [(row["robot"], row["steps"]) for row in result["controllers"]] == [("boss", 50), ("cart", 50)]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--protos", "nowhere"], "--protos nowhere: there is no such folder"),
        (["--python", "nowhere"], "--python nowhere does not run"),
        (["--steps", "0"], "too small"),
        (["--controller", "cart=nowhere.py"], "--controller cart=nowhere.py: there is no such file"),
        (["--controller", "cart"], "--controller cart: write ROBOT=FILE"),
        (["--controller", f"car={__file__}"], "--controller car=...: the robots of the world are boss, cart"),
        (["--controller", f"c=1={__file__}"], "--controller c=1=...: the robots of the world are boss, cart"),
    ],
)
def test_wrong_options_are_refused(project: Project, options: list[str], words: str):
    ran = project.run(*options, code=2)
    assert ran.out == ""
    assert words in " ".join(ran.err.split())


def test_an_option_of_a_run_needs_permission(project: Project):
    ran = project.run("--steps", "3", allow=False, code=2)
    assert "--steps runs the programs of the project, which you should trust; add --allow-code" in ran.err


@pytest.mark.slow
def test_a_controller_that_never_steps_ends_the_run(project: Project):
    project.controller("cart", "while True: pass")
    process = project.start("--timeout", "1")
    assert "error: the controller of 'cart' made no step for 1 s" in process.communicate(timeout=60)[1]
    assert process.returncode == 1


def test_a_file_that_is_not_a_world_is_named_with_the_worlds_beside_it(project: Project):
    for path, words in (
        ("worlds/v.wbt", "does not exist; {} has the worlds w.wbt"),
        ("worlds", "is a folder; {} has the worlds w.wbt"),
        ("v.wbt", "does not exist; {} has the worlds worlds/w.wbt"),
    ):
        folder = (project.folder / path).parent if path.endswith("v.wbt") else project.folder / path
        with pytest.raises(UsageError, match=re.escape(words.format(folder))):
            check_world(project.folder / path)


def test_a_world_with_errors_runs_nothing(project: Project):
    project.write("worlds/w.wbt", HEADER + WORLD + "\nSolid { children [ Shape { geometry Robt { } } ] }")
    ran = project.run(code=1)
    assert (ran.err.count("error: PROTO Robt is not available"), ran.err.count("error:")) == (1, 1)
    assert "w.wbt:5:37" in ran.err


def test_a_world_without_robots_says_so(project: Project):
    project.write("worlds/w.wbt", HEADER + "Solid { }")
    assert "no robot of the world has a controller that can run" in project.run(code=2).err
    assert "the world has no robots" in project.run(allow=False).out
    ran = project.run("--controller", f"cart={__file__}", code=2)
    assert "--controller cart=...: the world has no robots" in ran.err


def test_the_packages_of_another_environment_are_found(project: Project):
    project.controller("boss", "from controller import Supervisor\nSupervisor()\nimport json\nprint('ok')")
    assert project.run("--python", sys.executable).out.splitlines()[0] == "[boss] ok"


def test_a_controller_uses_the_whole_interface(project: Project):
    project.write(
        "worlds/w.wbt",
        HEADER
        + WORLD.replace(
            'controller "cart" children [', 'controller "cart" children [ GPS { } Lidar { numberOfLayers 1 } '
        ),
    )
    project.controller(
        "boss",
        """
        import os
        import controller
        from controller import AnsiCodes, Camera, Device, Emitter, Field, Keyboard, Motor, Node, Receiver, Supervisor

        class Boss(Supervisor):
            def step(self, period=32):
                return super().step(period)

        boss = Boss()
        cart = boss.getFromDef("CART")
        place = cart.getField("translation")
        place.value = [1, 2, 3]
        boss.step()
        print(cart.getPosition(), place.value, boss.getRoot().getField("children").value[0].getTypeName(), place.type_name, cart == boss.getFromDef("CART"), cart.getType() == Node.ROBOT)
        print(isinstance(boss.getEmitter("emitter"), Emitter), isinstance(boss.getDevice("emitter"), Device))
        print(Emitter("emitter") is boss.getDevice("emitter"), Receiver("receiver", 64).getSamplingPeriod(), Receiver("receiver").getSamplingPeriod())
        print(hasattr(controller, "Motion"), getattr(controller, "Motn", None), AnsiCodes.RED_FOREGROUND == chr(27) + "[31m")
        print([os.path.basename(path) for path in (boss.getWorldPath(), boss.getProjectPath())])
        print(cart.getPose(cart)[3], Field.SF_FLOAT, Motor.LINEAR, boss.getDevice("nothing"), boss.keyboard.getKey())
        print(Camera.imageGetRed(bytes([1, 2, 3, 4]), 1, 0, 0), Keyboard().getSamplingPeriod(), os.path.basename(os.getcwd()))
        for wrong in ("boss.setMode", "boss.getDevice('emitter').sned", "place.setSFFloat(1)"):
            try:
                eval(wrong)
            except Exception as error:
                print(type(error).__name__, error)
        """,
    )
    ran = project.run()
    assert [line.removeprefix("[boss] ") for line in ran.out.splitlines() if "boss" in line] == [
        "[1.0, 2.0, 3.0] [1.0, 2.0, 3.0] WorldInfo SFVec3f True True",
        "True True",
        "True 64 32",
        "True None True",
        f"['w.wbt', '{project.folder.name}']",
        "0.0 3 1 None -1",
        "3 0 boss",
        "NotImplementedCallError Robot.setMode is not implemented",
        "AttributeError 'Emitter' has no attribute 'sned' (did you mean send?)",
        "NotImplementedCallError Field.setSFFloat of Robot.translation is not implemented",
    ]


# Videos and keys


def test_a_keyboard_says_that_it_has_no_keys(capsys):
    supervisor.activate(simulate("Solid { }"))
    keyboard = Keyboard()
    supervisor.deactivate()
    keyboard.enable(32)
    keyboard.enable(64)
    assert (
        keyboard.getKey(),
        capsys.readouterr().err.count("no key of the Keyboard is ever pressed: there is no window"),
    ) == (-1, 1)


@pytest.mark.slow
@pytest.mark.skipif(not (cameras.is_available() and cameras.opens_context()), reason="there is no OpenGL")
def test_two_controllers_use_cameras(project: Project):
    box = """Solid { translation 2 0 0 children [ DEF BOX Shape { geometry Box { size 1 1 1 } } ]
      boundingObject USE BOX physics Physics { } }"""
    world = WORLD.replace("children [", "children [ Camera { width 8 height 8 } ")
    project.write("worlds/w.wbt", HEADER + world + box)
    for name, kind in (("boss", "Supervisor"), ("cart", "Robot")):
        project.controller(
            name,
            f"""
            from controller import {kind}
            robot = {kind}()
            camera = robot.getDevice("camera")
            camera.enable(32)
            for _ in range(8):
                robot.step(32)
            print(camera.getImageArray()[4][4][0] > 100, camera.getImageArray()[0][0])
            """,
        )
    printed = project.run().out.splitlines()
    assert sorted(printed) == ["[boss] True [0, 0, 0]", "[cart] True [0, 0, 0]"]
