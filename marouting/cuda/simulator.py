"""What :mod:`marouting.cuda.games` needs of numba's CUDA simulator, in which tests run it."""

from typing import Any

from numba.cuda.simulator.cudadrv.devicearray import FakeCUDAArray, FakeWithinKernelCUDAArray


class Inside(FakeWithinKernelCUDAArray):
    """An array, or a record, as simulated kernels see it.

    Numba's own lets methods of records hide fields of the same name, such as ``round``.
    """

    def __init__(self, item: Any) -> None:
        object.__setattr__(self, "_item", item)

    def __getattr__(self, name: str) -> Any:
        fields = self._item.dtype.fields or {}
        return _inside(self._item[name] if name in fields else getattr(self._item, name))

    def __getitem__(self, index: Any) -> Any:
        return _inside(self._item[index])


def _inside(value: Any) -> Any:
    return Inside(value) if isinstance(value, FakeCUDAArray) else value


def arguments(values: Any) -> Any:
    """A tuple of arrays as simulated kernels see it, which know no such tuples."""
    made: Any = type(values)
    return made._make(map(_inside, values)) if isinstance(values, tuple) else values
