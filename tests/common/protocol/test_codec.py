"""The codec reads declarations however numpy writes its array types."""

from dataclasses import dataclass
from typing import Any, ClassVar, TypeVar

import numpy as np
import pytest
from typing_extensions import TypeAliasType

from eia_sec.common.errors import SchemaError
from eia_sec.common.protocol.codec import Message

Scalar = TypeVar("Scalar", bound=np.generic)
AnyShape = TypeAliasType("AnyShape", tuple[Any, ...])
NDArray = TypeAliasType("NDArray", np.ndarray[AnyShape, np.dtype[Scalar]], type_params=(Scalar,))
"""As numpy declares it from version 2.5 on, by a `type` statement; until then it is a plain alias."""
Float32 = NDArray[np.float32]
Named = TypeAliasType("Named", Float32)
Bits = TypeAliasType("Bits", NDArray[np.uint16])


@dataclass(frozen=True)
class Aliased(Message):
    """A message with arrays of aliased types."""

    KIND: ClassVar[int] = 250

    one: Float32
    many: tuple[Float32, ...]
    named: Named
    perhaps: Float32 | None = None


@dataclass(frozen=True)
class Either(Message):
    """A message with arrays of one type or another."""

    KIND: ClassVar[int] = 251

    plain: np.ndarray[Any, np.dtype[np.float32]] | np.ndarray[Any, np.dtype[np.uint16]]
    aliased: Named | Bits


def test_arrays_of_aliased_types_are_read():
    """An alias stands for the array type behind it, alone, in a tuple and where a field may be left out."""
    array = np.arange(3, dtype=np.float32)
    for perhaps in (None, array):
        found = Aliased.decode(Aliased(array, (array, array), array, perhaps).encode())
        for each in (found.one, *found.many, found.named):
            np.testing.assert_array_equal(each, array)
        assert len(found.many) == 2
        assert (found.perhaps is None) == (perhaps is None)


def test_arrays_of_aliased_types_are_checked():
    """An array of another type than the alias names is refused."""
    good, bad = np.zeros(3, np.float32), np.zeros(3, np.float64)
    with pytest.raises(SchemaError, match="array one is float64, not float32"):
        Aliased.decode(Aliased(bad, (good,), good).encode())


@pytest.mark.parametrize("kind", [np.float32, np.uint16])
def test_arrays_of_one_type_or_another_are_read(kind):
    """They come as they were sent, and an array of a third type is refused."""
    array = np.arange(3, dtype=kind)
    found = Either.decode(Either(array, array).encode())
    for each in (found.plain, found.aliased):
        np.testing.assert_array_equal(each, array)
        assert each.dtype == kind
    for strange in (Either(array.astype(np.int32), array), Either(array, array.astype(np.int32))):
        with pytest.raises(SchemaError, match="is int32, not float32 or uint16"):
            Either.decode(strange.encode())
