"""Records that kernels take, and pass on, by their place in memory.

Numba passes a record, a ``NamedTuple`` of arrays, by its parts: seven numbers an array. Of dozens of arrays each call
is hundreds of arguments, most of what is compiled for it, and each call by Python looks into all of them. What is in
memory once is read from there, each part where it is named.
"""

# ruff: noqa: ARG001 (numba calls code generators by position)

from __future__ import annotations

from typing import Any, final

import numba
import numpy as np
from numba import types
from numba.core import cgutils
from numba.core.datamodel.registry import default_manager
from numba.core.imputils import impl_ret_borrowed
from numba.core.typing.templates import AttributeTemplate, Signature, infer_getattr, signature
from numba.extending import (
    NativeValue,
    intrinsic,
    lower_getattr_generic,
    models,
    register_model,
    typeof_impl,
    unbox,
)

from modalshell.core.thread_safety import read_only

_RECORDS = types.NamedTuple | types.NamedUniTuple  # the latter where all parts are of one kind


class Referred(types.Type):
    """Numba type of a record's place in memory; its parts that are records are again such places."""

    def __init__(self, record: Any) -> None:
        self.record = record
        super().__init__(name=f"Referred({record})")

    @property
    def key(self) -> Any:
        """What makes two the same: the record itself, as names of classes may be alike."""
        return self.record


@register_model(Referred)
class _ReferredModel(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: Referred) -> None:
        place = manager.lookup(kind.record).get_value_type().as_pointer()
        super().__init__(manager, kind, place)  # type: ignore[no-untyped-call]


def record_of(kind: Any) -> type | None:
    """The class of a record, or of one that is referred to, by its numba type; None of all else."""
    record = kind.record if isinstance(kind, Referred) else kind
    return record.instance_class if isinstance(record, _RECORDS) else None


def _by_reference(context: Any, record: Any) -> tuple[Signature, Any]:
    """The record's place in memory, as long as the function that calls this runs; its arrays are not counted."""

    def generate(target: Any, builder: Any, sig: Signature, args: Any) -> Any:
        return cgutils.alloca_once_value(builder, args[0])  # type: ignore[no-untyped-call]

    return signature(Referred(record), record), generate  # type: ignore[no-untyped-call]


by_reference: Any = intrinsic(_by_reference)


@infer_getattr
class _Parts(AttributeTemplate):
    key = Referred

    def generic_resolve(self, kind: Referred, name: str) -> Any:  # type: ignore[override]
        if name not in kind.record.fields:
            return None
        part = kind.record[kind.record.fields.index(name)]
        return Referred(part) if isinstance(part, _RECORDS) else part


@lower_getattr_generic(Referred)  # type: ignore[no-untyped-call]
def _part(context: Any, builder: Any, kind: Referred, place: Any, name: str) -> Any:
    index = kind.record.fields.index(name)
    there, part = cgutils.gep_inbounds(builder, place, 0, index), kind.record[index]  # type: ignore[no-untyped-call]
    if isinstance(part, _RECORDS):
        return there
    return impl_ret_borrowed(context, builder, part, builder.load(there))  # type: ignore[no-untyped-call]


# ---- from Python


@final
class Placed:
    """A record of arrays, numbers and such records in memory: what kernels take as a :class:`Referred`.

    Copies and pickles have a place of their own.
    """

    def __init__(self, record: Any) -> None:
        self.record = record
        self.kind = Referred(numba.typeof(record))  # type: ignore[no-untyped-call]
        self._parts = _parts(record)
        self._words = np.array([word for part in self._parts for word in _words(part)])
        self.address = self._words.ctypes.data

    def copied(self) -> Placed:
        """The same with arrays of its own, but for those that are read-only."""
        return Placed(_copied(self.record))

    def take(self, record: Any, common: Placed) -> None:
        """Write the arrays of a record of the same sizes to own ones, but those that it shares with ``common``."""
        for own, part, shared in zip(self._parts, _parts(record), common._parts, strict=True):
            if part is not shared:
                own[...] = part

    def __reduce__(self) -> tuple[Any, ...]:
        return _placed, (self.record, [isinstance(p, np.ndarray) and not p.flags.writeable for p in self._parts])


def _placed(record: Any, closed: list[bool]) -> Placed:
    """A record that was copied or pickled: its read-only arrays stay so, or kernels would be compiled once more."""
    for part, is_closed in zip(_parts(record), closed, strict=True):
        if is_closed:
            read_only(part)
    return Placed(record)


def _parts(record: Any) -> list[Any]:
    """Arrays and numbers of a record, in order."""
    found: list[Any] = []
    for part in record:
        if isinstance(part, tuple):
            found += _parts(part)
        else:
            found.append(part)
    return found


def _copied(record: Any) -> Any:
    kept: list[Any] = []
    for part in record:
        own = isinstance(part, np.ndarray) and part.flags.writeable
        kept.append(_copied(part) if isinstance(part, tuple) else part.copy() if own else part)
    return type(record)(*kept)


_NUMBERS: dict[type, Any] = {float: np.float64, int: np.int64}
_ARRAY = "meminfo", "parent", "nitems", "itemsize", "data", "shape", "strides"
"""What numba keeps of an array, each number of these in eight bytes."""
if default_manager.lookup(types.float64[::1])._fields != _ARRAY:  # type: ignore[no-untyped-call]
    raise ImportError(f"numba {numba.__version__} keeps arrays otherwise than modalshell knows: install numba 0.68")


def _words(part: Any) -> tuple[int, ...]:
    """An array or a number as numba has it in memory, a number for eight bytes."""
    if not isinstance(part, np.ndarray):
        return (int(np.array(part, dtype=_NUMBERS[type(part)]).view(np.int64)),)
    # No owner: nothing counts the references to what the record holds.
    return 0, 0, part.size, part.itemsize, part.ctypes.data, *part.shape, *part.strides


@typeof_impl.register(Placed)
def _typeof(value: Placed, context: Any) -> Referred:
    return value.kind


@unbox(Referred)  # type: ignore[no-untyped-call]
def _unbox(kind: Referred, value: Any, c: Any) -> NativeValue:
    """The place of a record that Python has put there."""
    address = c.pyapi.object_getattr_string(value, "address")
    number = c.pyapi.long_as_longlong(address)
    c.pyapi.decref(address)
    place = c.builder.inttoptr(number, c.context.get_value_type(kind))
    return NativeValue(place, is_error=c.pyapi.c_api_error())  # type: ignore[no-untyped-call]
