"""Coulomb's friction for contacts that slide.

MuJoCo solves friction as part of a convex problem, so a body that slides also moves away from the surface: by
the coefficient of friction times the acceleration that friction cannot give it. Without a correction, a box
that slides at 1 m/s hops 6 mm high (steps of 4 ms). De Saxcé's correction lowers the reference acceleration
along the normal by the same product (de Saxcé and Feng, The bipotential method, Mathematical and Computer
Modelling 28, 1998). It needs the acceleration that friction does give. While a contact slides, that is the
one of the step before. In its first step, it is estimated from the depth and the speed of the contact.

`advance` corrects the contacts of a world between the two halves of a step. Batches take both halves at once:
for them, `sliding_callback` compiles `correct` to a callback of MuJoCo, for all models with `USER_DATA`.
"""

from __future__ import annotations

from importlib.util import find_spec
from math import sqrt
from typing import Any

import numpy as np

from deepbots_cli.engines.mujoco import mujoco as mj

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
NO_SLIP_ITERATIONS, NO_SLIP_TOLERANCE = 3, 1e-4
"""The iterations that make friction at rest rigid. They cost 6 to 11 % of a step; without them, a held box
creeps 14 mm in 10 s."""
USER_DATA = 1
"""The number of user data that marks a model whose contacts are corrected."""
PYTHON_STEPS = 20_000
"""The steps that worlds take in Python, about 0.2 s, before the callback takes over: it is loaded in 0.6 s."""

_python_steps = PYTHON_STEPS if find_spec("numba") else np.inf
"""The steps that are left for Python; less than 0 with the callback."""


def prepare(spec: Any) -> None:
    """Set the options of a model whose contacts are corrected."""
    # With elliptic cones, the first row of a contact is its normal force, and the next two are friction.
    spec.option.cone = mj.mjtCone.mjCONE_ELLIPTIC
    spec.option.noslip_iterations = NO_SLIP_ITERATIONS
    spec.option.noslip_tolerance = NO_SLIP_TOLERANCE
    spec.nuserdata = USER_DATA


def install() -> None:
    """Let MuJoCo correct contacts by the compiled callback, in all threads, from now on.

    Raises:
        ImportError: Numba is not installed.
    """
    global _python_steps
    if _python_steps >= 0:
        from deepbots_cli.engines.mujoco import sliding_callback

        mj.set_mjcb_control(sliding_callback.build())
        _python_steps = -1


def advance(model: Any, data: Any, steps: int = 1) -> None:
    """Take steps of a model, with the same results in Python and by the callback."""
    global _python_steps
    if _python_steps < 0:
        mj.mj_step(model, data, steps)
        return
    for _ in range(steps):
        mj.mj_step1(model, data)
        correct_contacts(model, data)
        mj.mj_step2(model, data)
    _python_steps -= steps
    if _python_steps <= 0:
        _python_steps = 0
        install()


def correct_contacts(model: Any, data: Any) -> None:
    """Correct the contacts of a world between `mj_step1` and `mj_step2`."""
    if not data.ncon or _python_steps < 0:
        return
    contacts = data.contact
    reference = data.efc_aref
    addresses = contacts.efc_address
    # What slides is rare, and the lists below take 20 us.
    rows = addresses[(addresses >= 0) & (contacts.dim >= 3)]
    wanted = np.hypot(reference[rows + 1], reference[rows + 2])
    if not len(rows) or wanted.max() < LEAST_REFERENCE / 2:
        return
    accelerations, mobility = [0.0] * data.nefc, [0.0] * data.nefc
    project(
        accelerations,
        mobility,
        data.qacc_warmstart.tolist(),
        0 if mj.mj_isSparse(model) else model.nv,
        *_rows(data.efc_J, data.efc_J_rownnz, data.efc_J_rowadr, data.efc_J_colind),
        *_rows(data.efc_AR, data.efc_AR_rownnz, data.efc_AR_rowadr, data.efc_AR_colind),
    )
    references = reference.tolist()
    correct(
        references,
        addresses.tolist(),
        contacts.dim.tolist(),
        contacts.friction[:, 0].tolist(),
        model.opt.timestep,
        data.efc_pos.tolist(),
        data.efc_vel.tolist(),
        data.efc_KBIP.reshape(-1).tolist(),
        data.efc_R.tolist(),
        accelerations,
        mobility,
    )
    reference[:] = references


def _rows(*arrays: Any) -> list[list[float]]:
    return [array.reshape(-1).tolist() for array in arrays]


# Numba compiles the functions below: they have numbers, loops, and lists or arrays.


def project(
    accelerations: Any,
    mobility: Any,
    joint_accelerations: Any,
    width: int,
    jacobian: Any,
    jacobian_sizes: Any,
    jacobian_starts: Any,
    jacobian_columns: Any,
    inverse_masses: Any,
    inverse_mass_sizes: Any,
    inverse_mass_starts: Any,
    inverse_mass_columns: Any,
) -> None:
    """Write the acceleration along each row of constraints, J a, and the diagonal of J M^-1 J^T + R.

    `width` is the number of columns of J, or 0 for sparse matrices: values, sizes, starts and columns of the
    rows of `efc_J` and of `efc_AR`.
    """
    total = len(accelerations)
    for row in range(total):
        moved = 0.0
        if width:
            for column in range(width):
                moved += jacobian[row * width + column] * joint_accelerations[column]
            mobility[row] = inverse_masses[row * total + row]
        else:
            start = jacobian_starts[row]
            for place in range(start, start + jacobian_sizes[row]):
                moved += jacobian[place] * joint_accelerations[jacobian_columns[place]]
            start = inverse_mass_starts[row]
            for place in range(start, start + inverse_mass_sizes[row]):
                if inverse_mass_columns[place] == row:
                    mobility[row] = inverse_masses[place]
        accelerations[row] = moved


def correct(
    references: Any,
    addresses: Any,
    dimensions: Any,
    frictions: Any,
    step: float,
    distances: Any,
    velocities: Any,
    springs: Any,
    softness: Any,
    accelerations: Any,
    mobility: Any,
) -> None:
    """Lower the references of the normals of contacts that slide.

    The arguments are `efc_aref`; the addresses, dimensions and coefficients of sliding friction of the
    contacts; the time step in s; `efc_pos`, `efc_vel`, `efc_KBIP`, `efc_R`; and what `project` writes, with
    the accelerations of the step before.
    """
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
        deceleration = x * accelerations[x_row] + y * accelerations[y_row]
        mobility_along = x * x * (mobility[x_row] - softness[x_row])
        mobility_along += y * y * (mobility[y_row] - softness[y_row])
        # The force of the spring of the contact at its depth, and of its damper against both bodies alone.
        impact = max(0.0, -springs[4 * normal + 1] * velocities[normal])
        load = max(0.0, references[normal] - impact) / softness[normal] + impact / mobility[normal]
        estimate = friction * load * max(0.0, mobility_along - LIGHT * mobility[normal])
        if distances[normal] - step * velocities[normal] >= 0.0:
            # A new contact: friction comes on top of what has moved the bodies so far.
            deceleration = min(0.0, deceleration) + estimate
        elif accelerations[normal] == 0.0:
            # No step before: the body was placed with a speed.
            deceleration = max(estimate, friction * LEAST_LOAD)
        elif slip + step * deceleration <= step * LEAST_REFERENCE:
            # It did not slide in the step before.
            deceleration = estimate
        else:
            largest = LARGEST_RATIO * friction * max(LEAST_LOAD, load * mobility_along)
            deceleration = min(deceleration, largest)
        references[normal] -= friction * max(0.0, wanted - deceleration)
