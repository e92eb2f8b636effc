"""Contacts that slide in MuJoCo: the compiled callback and the functions in Python, and MuJoCo's layout."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from deepbots_cli.engines import mujoco as engine_package
from deepbots_cli.engines.mujoco import mujoco as mj
from deepbots_cli.engines.mujoco import sliding
from deepbots_cli.errors import EngineError

sliding_callback = pytest.importorskip("deepbots_cli.engines.mujoco.sliding_callback")

BODY = """<body pos="{x} {y} {z}"><freejoint/><geom {shape} mass="{mass}"/></body>"""
SHAPES = 'type="box" size=".1 .07 .05"', 'type="sphere" size=".05"', 'type="capsule" size=".03 .06"'


@st.composite
def worlds(draw) -> tuple[object, np.ndarray]:
    """A model with some bodies on a floor, and their velocities."""
    count = draw(st.integers(1, 4))
    bodies = [
        BODY.format(
            x=0.5 * index,
            y=draw(st.sampled_from((0.0, 0.02))),
            z=draw(st.sampled_from((0.049, 0.06))),
            shape=draw(st.sampled_from(SHAPES)),
            mass=draw(st.sampled_from((0.01, 1.0))),
        )
        for index in range(count)
    ]
    jacobian = draw(st.sampled_from(("dense", "sparse")))
    friction = draw(st.sampled_from((0.05, 0.4, 1.2)))
    dimension = draw(st.sampled_from((1, 3, 4, 6)))
    spec = mj.MjSpec.from_string(
        f"""<mujoco><option timestep="0.004" jacobian="{jacobian}"/>
        <default><geom friction="{friction} 0.01 0.001" condim="{dimension}"/></default>
        <worldbody><geom type="plane" size="9 9 1"/>{"".join(bodies)}</worldbody></mujoco>"""
    )
    sliding.prepare(spec)
    speeds = draw(st.lists(st.floats(-4.0, 4.0), min_size=6 * count, max_size=6 * count))
    return spec.compile(), np.array(speeds)


def play(model, speeds) -> np.ndarray:
    data = mj.MjData(model)
    data.qvel[:] = speeds
    states = []
    for _ in range(40):
        sliding.advance(model, data)
        states.append(np.concatenate([data.qpos, data.qvel]))
    return np.array(states)


@pytest.fixture
def in_python(monkeypatch):
    """Steps are taken in Python, until `install` is called."""
    callback = mj.get_mjcb_control()
    mj.set_mjcb_control(None)
    monkeypatch.setattr(sliding, "_python_steps", np.inf)
    monkeypatch.setattr(sliding, "_callback", None)
    yield
    mj.set_mjcb_control(callback)


@pytest.fixture
def crate():
    spec = mj.MjSpec.from_string(
        f"""<mujoco><worldbody><geom type="plane" size="9 9 1"/>
        {BODY.format(x=0, y=0, z=0.05, shape=SHAPES[0], mass=1)}</worldbody></mujoco>"""
    )
    sliding.prepare(spec)
    return spec.compile()


SPEEDS = np.array([2.0, 0.3, 0.0, 0.0, 0.0, 1.0])


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(worlds())
def test_the_callback_gives_the_same_bits_as_python(in_python, world):
    mj.set_mjcb_control(None)
    expected = play(*world)
    sliding.install()
    assert np.array_equal(play(*world), expected)


def test_worlds_go_on_in_python_where_numba_cannot_be_imported(in_python, crate, monkeypatch):
    expected = play(crate, SPEEDS)
    monkeypatch.setattr(sliding, "_python_steps", 10)
    monkeypatch.delattr(engine_package, "sliding_callback")
    monkeypatch.setitem(sys.modules, "deepbots_cli.engines.mujoco.sliding_callback", None)
    assert np.array_equal(play(crate, SPEEDS), expected)
    with pytest.raises(EngineError, match="batches in MuJoCo need Numba"):
        sliding.install()


@pytest.mark.slow
def test_the_callback_is_compiled_where_no_folder_can_be_written(in_python, crate, monkeypatch):
    def refuse(*args, **options):
        raise PermissionError("a read-only file system")

    expected = play(crate, SPEEDS)
    monkeypatch.setattr("tempfile.TemporaryFile", refuse)
    sliding.install()
    assert np.array_equal(play(crate, SPEEDS), expected)


def test_contacts_are_corrected_beside_a_control_callback_of_another_program(in_python, crate, monkeypatch):
    expected = play(crate, SPEEDS)
    sliding.install()
    calls = []
    mj.set_mjcb_control(lambda model, data: calls.append(data.time))
    assert np.array_equal(play(crate, SPEEDS), expected)
    monkeypatch.setattr(sliding, "_python_steps", 10)
    assert np.array_equal(play(crate, SPEEDS), expected)
    assert len(calls) == 80


def test_the_layout_of_mujocos_data_is_that_of_its_description():
    """The callback reads these fields at these places: another version of MuJoCo may move them."""
    model = mj.MjModel.from_xml_string(
        """<mujoco><option timestep="0.003" noslip_iterations="3" jacobian="sparse"/><size nuserdata="1"/>
        <worldbody><geom type="plane" size="9 9 1"/>
        <body pos="0 0 0.04"><freejoint/><geom size="0.05"/></body></worldbody></mujoco>"""
    )
    data = mj.MjData(model)
    mj.mj_step1(model, data)
    fields = sliding_callback.layout("mjData").from_address(data._address)
    for name in ("efc_aref", "efc_pos", "efc_vel", "efc_KBIP", "efc_R", "efc_J", "efc_AR", "qacc_warmstart"):
        assert getattr(fields, name) == getattr(data, name).ctypes.data, name
    assert (fields.ncon, fields.nefc) == (data.ncon, data.nefc)
    contact = sliding_callback.layout("mjContact").from_address(fields.contact)
    assert (contact.dim, contact.efc_address) == (data.contact[0].dim, data.contact[0].efc_address)
    assert contact.friction[0] == data.contact[0].friction[0]
    of_model = sliding_callback.layout("mjModel", last="opt").from_address(model._address)
    assert (of_model.nv, of_model.nuserdata) == (model.nv, model.nuserdata)
    options = of_model.opt
    assert (options.timestep, options.noslip_iterations, options.jacobian) == (0.003, 3, model.opt.jacobian)
