"""Contacts that slide in MuJoCo: the compiled callback and the functions in Python, and MuJoCo's layout."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deepbots_cli.engines.mujoco import mujoco as mj
from deepbots_cli.engines.mujoco import sliding

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


@settings(max_examples=40, deadline=None)
@given(worlds())
def test_the_callback_gives_the_same_bits_as_python(world):
    model, speeds = world
    callback = mj.get_mjcb_control()
    python_steps = sliding._python_steps
    try:
        mj.set_mjcb_control(None)
        sliding._python_steps = np.inf
        expected = play(model, speeds)
        sliding.install()
        assert np.array_equal(play(model, speeds), expected)
    finally:
        sliding._python_steps = python_steps
        mj.set_mjcb_control(callback)


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
