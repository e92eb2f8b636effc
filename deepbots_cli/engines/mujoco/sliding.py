"""Coulomb's friction for contacts that slide.

MuJoCo solves friction as part of a convex problem, so a body that slides also moves away from the surface: by
the coefficient of friction times the acceleration that friction cannot give it. Without a correction, a box
that slides at 1 m/s hops 6 mm high (steps of 4 ms). De Saxcé's correction lowers the reference acceleration
along the normal by the same product (de Saxcé and Feng, The bipotential method, Mathematical and Computer
Modelling 28, 1998). It needs the acceleration that friction does give. `begin` takes that of the step before;
in the first step of a slide, it estimates it from the depth and the speed of the contact. `improve` corrects
it by a solution of the step on trial.

`advance` corrects the contacts of a world between the two halves of a step. Batches take both halves at once:
for them, `sliding_callback` compiles the functions to a callback of MuJoCo, for all models with `USER_DATA`.
"""

from __future__ import annotations

import ctypes
import re
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from math import sqrt
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np

from deepbots_cli.engines.mujoco import mujoco as mj
from deepbots_cli.errors import EngineError
from deepbots_cli.installation import install_hint

LEAST_LOAD = 9.81
"""The least normal force on a contact per mass, in m/s^2, that an estimate assumes."""
LEAST_REFERENCE = 1.0
"""The least reference acceleration of friction that is corrected, in m/s^2."""
LIGHT = 4.0
"""A part is light if its contact gives way this many times more along the surface than against it, as a foot
that bears a robot. For others, the estimate of the first step is that of `LEAST_LOAD`: if it is too low, the
contact sinks for a step, and if it is too high, the body hops."""
LARGEST_RATIO = 1.5
"""The largest ratio of the deceleration of the step before to an estimate; an impact lasts for a step or two,
and ends with a deceleration that is too large for the next one."""
RELAXATION = 0.5
"""By how much of its error a correction goes beyond the solution on trial, which leaves a half of the error
at a friction of 1. The trial costs 20 % of a step of a quadruped that slides on its feet. Without it, the
buggy of docs/own-robot.md rears up at 12 rad/s, lands, and drives at 0.72 of its speed."""
NO_SLIP_ITERATIONS, NO_SLIP_TOLERANCE = 5, 1e-6
"""The iterations that make friction at rest rigid. They cost 6 to 11 % of a step. Without them, a held box
creeps 14 mm in 10 s; a stack of five boxes still creeps 0.35 mm in 10 s."""
NOT_SLIDING = -1.0
USER_DATA = 1
"""The number of user data that marks a model whose contacts are corrected."""
PYTHON_STEPS = 20_000
"""The steps that worlds take in Python, about 0.2 s, before the callback takes over, which is loaded in
0.6 s."""

_LIBRARY = re.compile(r"\.(so\.[0-9.]+|dylib|dll)$")
_python_steps: float = PYTHON_STEPS
"""The steps that are left for Python; infinity if the callback cannot take over."""
_callback: Any = None
"""The callback, once MuJoCo has it."""
_lock = Lock()
"""Held by each step in Python, so that the callback does not take over in the middle of one."""


def prepare(spec: Any, *, by_callback: bool = True) -> None:
    """Set the options of a model whose contacts are corrected, by the callback once it is installed, or by
    `correct_contacts` alone."""
    # With elliptic cones, the first row of a contact is its normal force, and the next two are friction.
    spec.option.cone = mj.mjtCone.mjCONE_ELLIPTIC
    spec.option.noslip_iterations = NO_SLIP_ITERATIONS
    spec.option.noslip_tolerance = NO_SLIP_TOLERANCE
    if by_callback:
        spec.nuserdata = USER_DATA
        # An option without an effect (`mjENBL_OVERRIDE` is off), which the callback reads.
        spec.option.o_friction[:3] = solver_addresses()


@cache
def solver_addresses() -> tuple[int, int, int]:
    """Return the addresses of the functions of MuJoCo that solve the constraints of a step."""
    (path,) = (path for path in Path(mj.__file__).parent.glob("*mujoco*") if _LIBRARY.search(path.name))
    library = ctypes.CDLL(str(path))
    names = ("mj_fwdActuation", "mj_fwdAcceleration", "mj_fwdConstraint")
    one, two, three = (ctypes.cast(getattr(library, name), ctypes.c_void_p).value or 0 for name in names)
    return one, two, three


def install() -> None:
    """Let MuJoCo correct contacts by the compiled callback, in all threads, from now on.

    Raises:
        EngineError: Numba cannot be used, or MuJoCo has a callback of another program.
    """
    global _callback
    with _lock:
        if _is_installed():
            return
        if mj.get_mjcb_control() is not None:
            raise EngineError("MuJoCo has another control callback, which batches would replace")
        try:
            from deepbots_cli.engines.mujoco import sliding_callback
        except ImportError as error:
            raise EngineError(f"batches in MuJoCo need Numba: {error}; {install_hint('sim')}") from error
        _callback = sliding_callback.build()
        mj.set_mjcb_control(_callback)


def _is_installed() -> bool:
    """Return whether MuJoCo has the callback; another program may have replaced it."""
    return _callback is not None and mj.get_mjcb_control() is _callback


def advance(model: Any, data: Any, steps: int = 1) -> None:
    """Take steps of a model, with the same results in Python and by the callback."""
    stepper()(model, data, steps)


def stepper() -> Callable[..., None]:
    """Return the function that `advance` calls until other code runs."""
    return mj.mj_step if _is_installed() else _advance_in_python


def _advance_in_python(model: Any, data: Any, steps: int = 1) -> None:
    global _python_steps
    with _lock:
        for _ in range(steps):
            mj.mj_step1(model, data)
            correct_contacts(model, data)
            mj.mj_step2(model, data)
        _python_steps -= steps
    if _python_steps <= 0:
        _python_steps = np.inf
        with suppress(EngineError):
            install()


def correct_contacts(model: Any, data: Any) -> None:
    """Correct the contacts of a world between `mj_step1` and `mj_step2`, unless the callback has done so."""
    if not data.ncon or (_is_installed() and model.nuserdata == USER_DATA):
        return
    contacts = data.contact
    reference = data.efc_aref
    addresses = contacts.efc_address
    # What slides is rare, and the lists below take 20 us.
    rows = addresses[(addresses >= 0) & (contacts.dim >= 3)]
    wanted = np.hypot(reference[rows + 1], reference[rows + 2])
    if not len(rows) or wanted.max() < LEAST_REFERENCE / 2:
        return
    references, shifts = reference.tolist(), [NOT_SLIDING] * len(addresses)
    frictions = contacts.friction[:, 0].tolist()
    addresses = addresses.tolist()
    width = 0 if mj.mj_isSparse(model) else model.nv
    jacobian = _rows(data.efc_J, data.efc_J_rownnz, data.efc_J_rowadr, data.efc_J_colind)
    is_sliding = begin(
        references,
        shifts,
        addresses,
        contacts.dim.tolist(),
        frictions,
        model.opt.timestep,
        data.efc_pos.tolist(),
        data.efc_vel.tolist(),
        data.efc_KBIP.reshape(-1).tolist(),
        data.efc_R.tolist(),
        data.qacc_warmstart.tolist(),
        width,
        *jacobian,
        *_rows(data.efc_AR, data.efc_AR_rownnz, data.efc_AR_rowadr, data.efc_AR_colind),
    )
    if not is_sliding:
        return
    reference[:] = references
    mj.mj_fwdActuation(model, data)
    mj.mj_fwdAcceleration(model, data)
    mj.mj_fwdConstraint(model, data)
    improve(references, shifts, addresses, frictions, data.qacc.tolist(), width, *jacobian)
    reference[:] = references


def _rows(*arrays: Any) -> list[list[float]]:
    return [array.reshape(-1).tolist() for array in arrays]


# Numba compiles the functions below: they have numbers, loops, and lists or arrays.


def product(row: int, width: int, values: Any, sizes: Any, starts: Any, columns: Any, vector: Any) -> float:
    """Return the product of a row of a matrix and a vector. The matrix is dense with `width` columns, or
    sparse with a width of 0."""
    total = 0.0
    if width:
        for column in range(width):
            total += values[row * width + column] * vector[column]
    else:
        for place in range(starts[row], starts[row] + sizes[row]):
            total += values[place] * vector[columns[place]]
    return total


def diagonal(row: int, width: int, values: Any, sizes: Any, starts: Any, columns: Any) -> float:
    """Return an element of the diagonal of such a matrix."""
    if width:
        return values[row * width + row]  # type: ignore[no-any-return]
    for place in range(starts[row], starts[row] + sizes[row]):
        if columns[place] == row:
            return values[place]  # type: ignore[no-any-return]
    return 0.0


def begin(
    references: Any,
    shifts: Any,
    addresses: Any,
    dimensions: Any,
    frictions: Any,
    step: float,
    distances: Any,
    velocities: Any,
    springs: Any,
    softness: Any,
    accelerations: Any,
    width: int,
    jacobian: Any,
    jacobian_sizes: Any,
    jacobian_starts: Any,
    jacobian_columns: Any,
    mobility: Any,
    mobility_sizes: Any,
    mobility_starts: Any,
    mobility_columns: Any,
) -> bool:
    """Lower the references of the normals of contacts that slide, write by how much (m/s^2, divided by the
    friction), and return whether there are any.

    The arguments are `efc_aref`; the shifts, all `NOT_SLIDING`; the addresses, dimensions and coefficients of
    sliding friction of the contacts; the time step in s; `efc_pos`, `efc_vel`, `efc_KBIP`, `efc_R`; `qacc` of
    the step before; and the rows of J (`efc_J`) and of J M^-1 J^T + R (`efc_AR`), dense with `width` columns
    of J, or sparse.
    """
    size = len(references) if width else 0
    is_sliding = False
    for contact in range(len(addresses)):
        normal = addresses[contact]
        if normal < 0 or dimensions[contact] < 3:
            continue
        x_row, y_row = normal + 1, normal + 2
        friction = frictions[contact]
        x, y = references[x_row], references[y_row]
        wanted = sqrt(x * x + y * y)
        if wanted <= LEAST_REFERENCE:
            continue
        x, y = x / wanted, y / wanted
        slip = -(x * velocities[x_row] + y * velocities[y_row])
        # Friction may stop the slip within one step; `solref` alone would take some.
        wanted = slip / step
        references[x_row], references[y_row] = x * wanted, y * wanted
        normal_acceleration, x_acceleration, y_acceleration = (
            product(
                normal, width, jacobian, jacobian_sizes, jacobian_starts, jacobian_columns, accelerations
            ),
            product(x_row, width, jacobian, jacobian_sizes, jacobian_starts, jacobian_columns, accelerations),
            product(y_row, width, jacobian, jacobian_sizes, jacobian_starts, jacobian_columns, accelerations),
        )
        normal_mobility, x_mobility, y_mobility = (
            diagonal(normal, size, mobility, mobility_sizes, mobility_starts, mobility_columns),
            diagonal(x_row, size, mobility, mobility_sizes, mobility_starts, mobility_columns),
            diagonal(y_row, size, mobility, mobility_sizes, mobility_starts, mobility_columns),
        )
        deceleration = x * x_acceleration + y * y_acceleration
        mobility_along = x * x * (x_mobility - softness[x_row]) + y * y * (y_mobility - softness[y_row])
        # The force of the spring of the contact at its depth, and of its damper against both bodies alone.
        impact = max(0.0, -springs[4 * normal + 1] * velocities[normal])
        load = max(0.0, references[normal] - impact) / softness[normal] + impact / normal_mobility
        estimate = friction * load * max(0.0, mobility_along - LIGHT * normal_mobility)
        if distances[normal] - step * velocities[normal] >= 0.0:
            # A new contact: friction comes on top of what has moved the bodies so far.
            deceleration = min(0.0, deceleration) + estimate
        elif normal_acceleration == 0.0:
            # No step before: the body was placed with a speed.
            deceleration = max(estimate, friction * LEAST_LOAD)
        elif slip + step * deceleration <= step * LEAST_REFERENCE:
            # It did not slide in the step before.
            deceleration = estimate
        else:
            largest = LARGEST_RATIO * friction * max(LEAST_LOAD, load * mobility_along)
            deceleration = min(deceleration, largest)
        is_sliding = True
        shifts[contact] = max(0.0, wanted - deceleration)
        references[normal] -= friction * shifts[contact]
    return is_sliding


def improve(
    references: Any,
    shifts: Any,
    addresses: Any,
    frictions: Any,
    accelerations: Any,
    width: int,
    jacobian: Any,
    jacobian_sizes: Any,
    jacobian_starts: Any,
    jacobian_columns: Any,
) -> None:
    """Correct the references of contacts that slide by the `qacc` of a solution."""
    for contact in range(len(shifts)):
        if shifts[contact] == NOT_SLIDING:
            continue
        normal = addresses[contact]
        x, y = (
            product(
                normal + 1, width, jacobian, jacobian_sizes, jacobian_starts, jacobian_columns, accelerations
            )
            - references[normal + 1],
            product(
                normal + 2, width, jacobian, jacobian_sizes, jacobian_starts, jacobian_columns, accelerations
            )
            - references[normal + 2],
        )
        missing = sqrt(x * x + y * y)
        shift = max(0.0, missing + RELAXATION * (missing - shifts[contact]))
        references[normal] -= frictions[contact] * (shift - shifts[contact])
