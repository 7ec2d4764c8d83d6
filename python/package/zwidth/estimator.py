"""The control core's velocity estimators over recorded counts."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._native import Estimator as _Estimator
from ._native import velocity_table, with_estimator
from .scene import Scene

__all__ = ["Estimator"]


class Estimator:
    """A velocity estimator of the control core, with its state: what the firmware would say to these counts.

    Parameters
    ----------
    name : str
        One of :data:`zwidth.ESTIMATORS`.
    scene : Scene
        Gives sample rate, encoder and, where the estimator asks for them, mass and force.
    cutoff : float, optional
        Nominal cutoff, Hz; an estimator without one takes none.
    **parameters
        Other keys of a scene's ``[velocity]`` table; what is left out is the scene's own where it has this estimator,
        else the default (docs/estimators.md), and the device's mass.

    Raises
    ------
    ValueError
        There is no such estimator, or a parameter is out of range.

    Examples
    --------
    >>> import numpy as np
    >>> estimator = Estimator("butterworth", Scene.load("paper-1um"), cutoff=500)
    >>> velocity = estimator.process(np.arange(1000))  # a count a sample: 1 um * 10 kHz
    >>> round(float(velocity[-1]), 6)
    0.01
    """

    def __init__(self, name: str, scene: Scene, *, cutoff: float | None = None, **parameters: Any) -> None:
        table = velocity_table(name)
        device = scene.to_dict()["device"]
        table.update({key: device[key] for key in table if key in device})
        own = scene.to_dict()["velocity"]
        if {key for key in own} == {key for key in table} and own["estimator"] == table["estimator"]:
            chosen = ("prewarp", "order", "degree")
            table.update({key: value for key, value in own.items() if key not in chosen})
        self._scene = Scene._of(with_estimator(scene._native, table | parameters, cutoff))
        self._native = _Estimator(self._scene._native, cutoff)
        self._cutoff_hz = None if cutoff is None else float(cutoff)

    @property
    def scene(self) -> Scene:
        """The scene with this estimator in it, swept over this cutoff alone."""
        return self._scene

    @property
    def cutoff_hz(self) -> float | None:
        """Nominal cutoff, Hz; None for an estimator without one."""
        return self._cutoff_hz

    @property
    def needs(self) -> str | None:
        """What it needs beside the counts: "force", "acceleration", "edge times" or None."""
        return self._native.needs

    @property
    def lsb_m_per_s(self) -> float:
        """Velocity of one bit of the core's format, m/s."""
        return self._native.lsb_m_per_s

    def process(
        self,
        counts: ArrayLike,
        *,
        force: ArrayLike | None = None,
        acceleration: ArrayLike | None = None,
        edge_age: ArrayLike | None = None,
        edge_up: ArrayLike | None = None,
        bits: bool = False,
    ) -> NDArray[Any]:
        """Velocities at these counts; the next block goes on where this one ended.

        Parameters
        ----------
        counts : array of int
            The encoder's counter at each sample; wraps at 2^32 are undone.
        force, acceleration : array of int, optional
            Mean force and acceleration since the last sample in the core's format (docs/estimators.md).
        edge_age, edge_up : array, optional
            Time from the latest edge to the sample, in 2^-16 samples, below 0 before the first edge; whether the count
            went up with it.
        bits : bool
            Return the core's integers instead of m/s.

        Returns
        -------
        ndarray
            Velocity, m/s (float64), or bits (int32); 0 at the first count.

        Raises
        ------
        ValueError
            What the estimator needs is missing, or has another length.

        Notes
        -----
        After an exception, Ctrl-C too, the state is the one before the call.

        Examples
        --------
        >>> import numpy as np
        >>> estimator = Estimator("butterworth", Scene.load("paper-1um"), cutoff=500)
        >>> estimator.process(np.arange(4)).round(6).tolist()
        [0.0, 0.000198, 0.000903, 0.002077]
        >>> estimator.process(np.arange(4, 8)).round(6).tolist()  # it goes on
        [0.00346, 0.004868, 0.00618, 0.007328]
        """
        counts = np.asarray(counts)
        if counts.dtype.kind not in "iu":
            raise ValueError(f"counts are {counts.dtype}, allowed whole numbers")
        velocity = self._native.process(
            np.ascontiguousarray(counts, dtype=np.int64),
            None if force is None else np.ascontiguousarray(force, dtype=np.int32),
            None if acceleration is None else np.ascontiguousarray(acceleration, dtype=np.int32),
            None if edge_age is None else np.ascontiguousarray(edge_age, dtype=np.int64),
            None if edge_up is None else np.ascontiguousarray(edge_up, dtype=np.bool_),
        )
        return velocity if bits else velocity * self.lsb_m_per_s

    def reset(self) -> None:
        """Forget every count."""
        self._native.reset()
