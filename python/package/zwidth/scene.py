"""Scenes: a device, its controller and its experiments."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Any

from ._native import Scene as _Scene

__all__ = ["Scene"]


class Scene:
    """A device, its controller and its experiments, checked.

    Made by :meth:`load`, :meth:`parse` and :meth:`replace`; it does not change. Scenes can be compared and pickled.
    """

    __slots__ = ("_native",)
    _native: _Scene

    def __init__(self) -> None:
        raise TypeError("a Scene is made by Scene.load, Scene.parse or replace")

    @classmethod
    def _of(cls, native: _Scene) -> Scene:
        scene = object.__new__(cls)
        object.__setattr__(scene, "_native", native)
        return scene

    def __setattr__(self, name: str, value: object) -> None:
        raise AttributeError(f"a Scene does not change; scene.replace makes another one (tried to set {name})")

    @classmethod
    def load(cls, name_or_path: str | os.PathLike[str]) -> Scene:
        """Load a built-in scene or a scene file.

        Parameters
        ----------
        name_or_path : str or path
            One of :data:`zwidth.SCENES`, or the path of a TOML file.

        Raises
        ------
        ValueError
            There is no such scene, or the file says something that is not allowed: file, line, key, value and what is
            allowed.

        Examples
        --------
        >>> scene = Scene.load("paper-1um")
        >>> scene
        Scene('paper-1um')
        >>> scene.to_dict()["encoder"]["resolution_m"]
        1e-06
        """
        return cls._of(_Scene.load(os.fspath(name_or_path)))

    @classmethod
    def parse(cls, text: str, name: str = "scene") -> Scene:
        """Read a scene from the text of a scene file; `name` is what results and errors call it."""
        return cls._of(_Scene.parse(text, name))

    @property
    def name(self) -> str:
        """Built-in name, or the file's name without its ending."""
        return self._native.name

    @property
    def text(self) -> str:
        """The text that it was read from, comments included."""
        return self._native.text

    def to_toml(self) -> str:
        """The scene as the text of a scene file, with every default written out; a rotary one as it was read."""
        return self._native.to_toml()

    def to_dict(self) -> dict[str, Any]:
        """The scene as nested dictionaries, with every default."""
        return self._native.to_dict()

    def replace(self, changes: Mapping[str, Any] | None = None, /, **tables: Mapping[str, Any]) -> Scene:
        """Another scene with some values exchanged.

        Parameters
        ----------
        changes : mapping, optional
            Dotted keys to values, ``{"encoder.resolution_m": 2e-6}``. A value of None leaves the key out; a dictionary
            takes the place of a whole table.
        **tables : mapping
            Keys of a table to values, ``encoder={"resolution_m": 2e-6}``; its other keys stay.

        Raises
        ------
        ValueError
            The scene that comes out is not allowed: key, value and what is allowed.

        Examples
        --------
        >>> coarse = Scene.load("paper-1um").replace({"encoder.resolution_m": 4e-6})
        >>> coarse.to_dict()["encoder"]["resolution_m"]
        4e-06
        >>> coarse.replace(encoder={"resolution_m": 0})
        Traceback (most recent call last):
            ...
        ValueError: paper-1um: encoder.resolution_m is 0, allowed 0.00000001 to 0.001
        """
        flat = dict(changes or {})
        for table, keys in tables.items():
            flat.update({f"{table}.{key}": value for key, value in keys.items()})
        return self._of(self._native.replaced(flat))

    def __repr__(self) -> str:
        return f"Scene({self.name!r})"

    def __eq__(self, other: object) -> bool:
        return self._native == other._native if isinstance(other, Scene) else NotImplemented

    def __hash__(self) -> int:
        return hash(self.to_toml())

    def __reduce__(self) -> tuple[Any, ...]:
        return (Scene.parse, (self._native.portable_text(), self.name))
