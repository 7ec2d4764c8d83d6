"""Tables: arrays by the names of their columns."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import pandas
    import pyarrow

__all__ = ["Table"]


class Tabular:
    """Results that are also a table."""

    def columns(self) -> dict[str, Any]:
        """The columns of the table, as the command line's CSV names them."""
        raise NotImplementedError

    def to_arrow(self) -> pyarrow.Table:
        """The table as a :class:`pyarrow.Table`; needs pyarrow."""
        import pyarrow

        return pyarrow.table(self.columns())

    def to_pandas(self) -> pandas.DataFrame:
        """The table as a :class:`pandas.DataFrame`; needs pandas."""
        import pandas

        return pandas.DataFrame(self.columns())


class Table(Mapping[str, NDArray[Any]], Tabular):
    """Arrays by the names of their columns, in the order of the command line's CSV.

    A number that there is not is NaN, such a text is empty.
    """

    def __init__(self, columns: Mapping[str, Any]) -> None:
        def array(values: Any) -> NDArray[Any]:
            made: NDArray[Any] = np.array(values, dtype=np.str_) if isinstance(values, list) else np.asarray(values)
            made.flags.writeable = False
            return made

        self._arrays = MappingProxyType({name: array(values) for name, values in columns.items()})

    def __getitem__(self, name: str) -> NDArray[Any]:
        return self._arrays[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._arrays)

    def __len__(self) -> int:
        return len(self._arrays)

    def __repr__(self) -> str:
        rows = len(next(iter(self._arrays.values()), ()))
        return f"Table({rows} rows of {', '.join(self._arrays)})"

    def __reduce__(self) -> tuple[Any, ...]:
        return (Table, (dict(self._arrays),))

    __hash__ = object.__hash__

    def __eq__(self, other: object) -> bool:
        return self is other

    def columns(self) -> dict[str, Any]:
        return dict(self._arrays)
