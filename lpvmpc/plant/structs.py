"""Where the installed MuJoCo keeps the fields of its structs, and reading them in compiled code.

The byte offsets are computed from MuJoCo's own description (`mujoco.introspect`), so another
version of MuJoCo needs no change here; `check` compares them with the addresses that the Python
bindings show before anything is read through them.
"""

import ctypes
import math
from functools import cache

import mujoco
import numpy as np
from mujoco.introspect import ast_nodes, structs
from numba import njit, types
from numba.extending import intrinsic

from lpvmpc.errors import LPVMPCError


def offsets(name: str) -> dict[str, int]:
    """Byte offset of every field of a MuJoCo struct, as the installed version lays it out."""
    return {field: getattr(_structure(name), field).offset for field, _ in _fields(name)}


@cache
def _structure(name: str) -> type[ctypes.Structure]:
    """MuJoCo struct as a ctypes type."""
    return type(name, (ctypes.Structure,), {"_fields_": _fields(name)})


@cache
def _fields(name: str) -> list[tuple[str, type]]:
    return [(field.name, _c_type(field.type)) for field in structs.STRUCTS[name].fields]


_C_TYPES: dict[str, type] = {
    "int": ctypes.c_int, "unsigned int": ctypes.c_uint, "unsigned char": ctypes.c_ubyte,
    "float": ctypes.c_float, "double": ctypes.c_double, "char": ctypes.c_char,
    "size_t": ctypes.c_size_t, "uint64_t": ctypes.c_uint64, "uintptr_t": ctypes.c_size_t,
    "mjtNum": ctypes.c_double, "mjtByte": ctypes.c_ubyte, "mjtBool": ctypes.c_bool,
    "mjtSize": ctypes.c_int64,
}


def _c_type(kind: object) -> type:
    """Ctypes type of a declaration in mujoco.introspect."""
    if isinstance(kind, ast_nodes.PointerType):
        return ctypes.c_void_p
    if isinstance(kind, ast_nodes.ArrayType):
        count = math.prod(kind.extents)
        return _c_type(kind.inner_type) * count
    if isinstance(kind, ast_nodes.AnonymousStructDecl):
        fields = [(field.name, _c_type(field.type)) for field in kind.fields]
        return type("anonymous", (ctypes.Structure,), {"_fields_": fields})
    assert isinstance(kind, ast_nodes.ValueType), kind
    if kind.name in _C_TYPES:
        return _C_TYPES[kind.name]
    if kind.name in structs.STRUCTS:
        return _structure(kind.name)
    return ctypes.c_int  # an enumeration


@cache
def check() -> None:
    """Compare the address of every array that MuJoCo shows to Python with the computed layout.

    Raises:
        LPVMPCError: this MuJoCo lays out its structs otherwise than it describes.
    """
    model = mujoco.MjModel.from_xml_string(
        "<mujoco><size nuserdata='1'/><custom><numeric name='n' data='1'/></custom>"
        "<worldbody><body><freejoint/><geom size='1'/></body><body><joint name='j'/>"
        "<geom size='1'/></body></worldbody>"
        "<actuator><general joint='j' dyntype='integrator'/></actuator></mujoco>"
    )
    for struct in (model, mujoco.MjData(model)):
        kind = type(struct).__name__.replace("Mj", "mj")
        for name, c_type in _fields(kind):
            array = getattr(struct, name, None)
            if c_type is ctypes.c_void_p and isinstance(array, np.ndarray) and array.size:
                address = struct._address + offsets(kind)[name]
                found = ctypes.c_void_p.from_address(address).value
                if found not in (array.ctypes.data, None):  # None: not allocated
                    raise LPVMPCError(
                        f"MuJoCo {mujoco.__version__} lays out {name} otherwise than it describes; "
                        "install the version named in constraints.txt."
                    )


def _pointer_cast(element):  # type: ignore[no-untyped-def]
    """Make an intrinsic that turns an address into a pointer to `element`."""

    @intrinsic
    def cast(typing_context, address):  # type: ignore[no-untyped-def]
        def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
            return builder.inttoptr(args[0], context.get_value_type(signature.return_type))

        return types.CPointer(element)(types.int64), codegen

    return cast


doubles = _pointer_cast(types.float64)
longs = _pointer_cast(types.int64)
ints = _pointer_cast(types.int32)
chars = _pointer_cast(types.uint8)


@njit(cache=True)
def field(struct, offset):
    """Pointer to the doubles to which the field at `offset` of a struct points."""
    return doubles(longs(struct + offset)[0])
