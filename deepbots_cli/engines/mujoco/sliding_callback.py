"""`sliding.begin` and `improve`, compiled by Numba to a callback of MuJoCo. The only module that imports
Numba, and that depends on the layout of MuJoCo's structures."""

from __future__ import annotations

import ctypes
from pathlib import Path
from types import FunctionType
from typing import Any
from zlib import crc32

import mujoco
import numba
import numpy as np
from llvmlite import ir
from mujoco.introspect import ast_nodes, structs
from numba import types
from numba.extending import intrinsic

from deepbots_cli.engines.mujoco import sliding

_NUMBERS = {
    "int": ctypes.c_int,
    "mjtBool": ctypes.c_bool,
    "mjtByte": ctypes.c_ubyte,
    "mjtNum": ctypes.c_double,
    "mjtSize": ctypes.c_int64,
    "size_t": ctypes.c_size_t,
    "uintptr_t": ctypes.c_size_t,
    "uint64_t": ctypes.c_uint64,
    "float": ctypes.c_float,
}
SPARSE, AUTOMATIC = int(mujoco.mjtJacobian.mjJAC_SPARSE), int(mujoco.mjtJacobian.mjJAC_AUTO)
AUTOMATIC_SPARSE = 60  # degrees of freedom from which on MuJoCo chooses sparse matrices itself

_begin: Any = None
_improve: Any = None
"""The compiled functions; global variables, since Numba cannot cache a function with others in its
closure."""


def _c_type(kind: Any) -> Any:
    """Return the type of a field of a structure for ctypes."""
    if isinstance(kind, ast_nodes.PointerType):
        return ctypes.c_void_p
    if isinstance(kind, ast_nodes.ArrayType):
        inner = _c_type(kind.inner_type)
        for extent in kind.extents:
            inner = inner * extent
        return inner
    return _NUMBERS.get(kind.name) or layout(kind.name)


def layout(name: str, last: str | None = None) -> Any:
    """Return a structure of MuJoCo for ctypes, up to the field `last`."""
    fields = []
    for field in structs.STRUCTS[name].fields:
        fields.append((field.name, _c_type(field.type)))
        if field.name == last:
            break
    return type(name, (ctypes.Structure,), {"_fields_": fields})


def _pointer(element: Any) -> Any:
    """Return a function for compiled code that returns a pointer to elements at an address."""

    def at(typing_context: Any, address: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            return builder.inttoptr(arguments[0], context.get_value_type(signature.return_type))

        return types.CPointer(element)(types.intp), generate

    return intrinsic(at)


@intrinsic  # type: ignore[untyped-decorator]
def _call(typing_context: Any, address: Any, model: Any, data: Any) -> Any:
    """Call a function of MuJoCo for a model and its data."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        word = context.get_value_type(types.intp)
        kind = ir.FunctionType(ir.VoidType(), [word, word])
        builder.call(builder.inttoptr(arguments[0], kind.as_pointer()), arguments[1:])
        return context.get_dummy_value()

    return types.void(types.intp, types.intp, types.intp), generate


_numbers_at, _integers_at, _words_at = map(_pointer, (types.float64, types.int32, types.int64))


def build() -> Any:
    """Return the callback, as a pointer that MuJoCo takes."""
    try:
        return _compile(cache=True)
    except (RuntimeError, OSError):  # no folder can be written
        return _compile(cache=False)


def _compile(*, cache: bool) -> Any:
    global _begin, _improve
    compiled = {name: numba.njit(cache=cache)(getattr(sliding, name)) for name in ("product", "diagonal")}
    _begin, _improve = (
        # The same code, which calls the compiled functions.
        numba.njit(cache=cache)(
            FunctionType(function.__code__, {**vars(sliding), **compiled}, function.__name__)
        )
        for function in (sliding.begin, sliding.improve)
    )
    data, contact, model = layout("mjData"), layout("mjContact"), layout("mjModel", last="opt")
    option = layout("mjOption")
    # Numba caches the machine code by the values of these variables. The text of the functions is one of
    # them, since Numba does not notice that it has changed.
    text = crc32(Path(sliding.__file__).read_bytes())
    user_data, degrees = model.nuserdata.offset, model.nv.offset
    no_slip = model.opt.offset + option.noslip_iterations.offset
    jacobian = model.opt.offset + option.jacobian.offset
    contact_count, row_count = data.ncon.offset, data.nefc.offset
    contacts, contact_size = data.contact.offset, ctypes.sizeof(contact)
    address, dimension, friction = contact.efc_address.offset, contact.dim.offset, contact.friction.offset
    functions = model.opt.offset + option.o_friction.offset
    time_step = model.opt.offset + option.timestep.offset
    reference, distance, velocity, springs, softness, last_acceleration, acceleration = (
        getattr(data, name).offset
        for name in ("efc_aref", "efc_pos", "efc_vel", "efc_KBIP", "efc_R", "qacc_warmstart", "qacc")
    )
    rows = [
        tuple(getattr(data, f"{name}{part}").offset for part in ("", "_rownnz", "_rowadr", "_colind"))
        for name in ("efc_J", "efc_AR")
    ]
    (j_values, j_sizes, j_starts, j_columns), (a_values, a_sizes, a_starts, a_columns) = rows

    @numba.cfunc(types.void(types.intp, types.intp), cache=cache)  # type: ignore[untyped-decorator]
    def callback(m: Any, d: Any) -> None:
        count = _integers_at(d + contact_count)[0]
        if (
            text < 0
            or count == 0
            or _words_at(m + user_data)[0] != sliding.USER_DATA
            or _integers_at(m + no_slip)[0] == 0
            or _numbers_at(m + functions)[0]
            < 4096.0  # a coefficient, not an address: the model of someone else
        ):
            return
        total, width = _integers_at(d + row_count)[0], _words_at(m + degrees)[0]
        references = numba.carray(_numbers_at(_words_at(d + reference)[0]), total)
        first = _words_at(d + contacts)[0]
        largest_wanted = 0.0
        for index in range(count):
            row = _integers_at(first + index * contact_size + address)[0]
            if row >= 0 and _integers_at(first + index * contact_size + dimension)[0] >= 3:
                x, y = references[row + 1], references[row + 2]
                largest_wanted = max(largest_wanted, x * x + y * y)
        if largest_wanted < (sliding.LEAST_REFERENCE / 2) ** 2:
            return
        addresses, dimensions = np.empty(count, np.int32), np.empty(count, np.int32)
        frictions = np.empty(count)
        for index in range(count):
            at = first + index * contact_size
            addresses[index] = _integers_at(at + address)[0]
            dimensions[index] = _integers_at(at + dimension)[0]
            frictions[index] = _numbers_at(at + friction)[0]
        kind = _integers_at(m + jacobian)[0]
        is_sparse = kind == SPARSE or (kind == AUTOMATIC and width >= AUTOMATIC_SPARSE)
        # No less than what the functions read; Numba checks no bounds.
        largest = total * max(width, total)
        columns = 0 if is_sparse else width
        shifts = np.full(count, sliding.NOT_SLIDING)
        jacobian_values = numba.carray(_numbers_at(_words_at(d + j_values)[0]), largest)
        jacobian_sizes = numba.carray(_integers_at(_words_at(d + j_sizes)[0]), total)
        jacobian_starts = numba.carray(_integers_at(_words_at(d + j_starts)[0]), total)
        jacobian_columns = numba.carray(_integers_at(_words_at(d + j_columns)[0]), largest)
        is_sliding = _begin(
            references,
            shifts,
            addresses,
            dimensions,
            frictions,
            _numbers_at(m + time_step)[0],
            numba.carray(_numbers_at(_words_at(d + distance)[0]), total),
            numba.carray(_numbers_at(_words_at(d + velocity)[0]), total),
            numba.carray(_numbers_at(_words_at(d + springs)[0]), 4 * total),
            numba.carray(_numbers_at(_words_at(d + softness)[0]), total),
            numba.carray(_numbers_at(_words_at(d + last_acceleration)[0]), width),
            columns,
            jacobian_values,
            jacobian_sizes,
            jacobian_starts,
            jacobian_columns,
            numba.carray(_numbers_at(_words_at(d + a_values)[0]), largest),
            numba.carray(_integers_at(_words_at(d + a_sizes)[0]), total),
            numba.carray(_integers_at(_words_at(d + a_starts)[0]), total),
            numba.carray(_integers_at(_words_at(d + a_columns)[0]), largest),
        )
        if not is_sliding:
            return
        solvers = _numbers_at(m + functions)
        _call(np.intp(solvers[0]), m, d)
        _call(np.intp(solvers[1]), m, d)
        _call(np.intp(solvers[2]), m, d)
        _improve(
            references,
            shifts,
            addresses,
            frictions,
            numba.carray(_numbers_at(_words_at(d + acceleration)[0]), width),
            columns,
            jacobian_values,
            jacobian_sizes,
            jacobian_starts,
            jacobian_columns,
        )

    return callback.ctypes
