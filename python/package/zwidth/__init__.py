"""Z-width of one-degree-of-freedom haptic devices.

The simulator and the fixed-point control core that the zwidth firmware runs. All quantities are in SI units; every
result has the same bits as that of the command line. Bad input raises ``ValueError`` with the line that the command
line prints; Ctrl-C is an exception within 0.2 s.

Examples
--------
>>> import zwidth
>>> scene = zwidth.Scene.load("paper-2um")
>>> zwidth.hit(scene, stiffness=10e3, damping=30.0, cutoff=500).verdict
'stable'
"""

from . import _native
from ._answers import BoardHit, BoardSelfTest, BoardStatus, BoardWalk
from ._native import (
    Agreement,
    CoggingTerm,
    Comparison,
    EncoderTerm,
    Estimate,
    Estimator,
    Explanation,
    Grid,
    Hit,
    Identification,
    Linear,
    Outputs,
    Peers,
    Plan,
    Recommended,
    Replay,
    Residual,
    Samples,
    Scene,
    Study,
    Suspect,
    Sweep,
    Telemetry,
    TermTest,
    Trace,
    Usable,
    Walk,
    Winner,
    __version__,
    agree,
    compare,
    explain,
    grid,
    hit,
    identify,
    identify_plan,
    linear,
    peers,
    recommended,
    replay,
    study,
    sweep,
    usable,
    walk,
)
from .board import Board
from .folder import StudyFailed, StudyRun, run_study
from .recording import Recording
from .table import Table

#: Names of the built-in scenes, of the velocity estimators, and of the codes in ``Grid.verdict``.
SCENES, ESTIMATORS, _verdicts = _native.names()
VERDICTS = tuple(_verdicts)

__all__ = [
    "ESTIMATORS",
    "SCENES",
    "VERDICTS",
    "Agreement",
    "Board",
    "BoardHit",
    "BoardSelfTest",
    "BoardStatus",
    "BoardWalk",
    "CoggingTerm",
    "Comparison",
    "EncoderTerm",
    "Estimate",
    "Estimator",
    "Explanation",
    "Grid",
    "Hit",
    "Identification",
    "Linear",
    "Outputs",
    "Peers",
    "Plan",
    "Recording",
    "Recommended",
    "Replay",
    "Residual",
    "Samples",
    "Scene",
    "Study",
    "StudyFailed",
    "StudyRun",
    "Suspect",
    "Sweep",
    "Table",
    "Telemetry",
    "TermTest",
    "Trace",
    "Usable",
    "Walk",
    "Winner",
    "__version__",
    "agree",
    "compare",
    "explain",
    "grid",
    "hit",
    "identify",
    "identify_plan",
    "linear",
    "peers",
    "recommended",
    "replay",
    "run_study",
    "study",
    "sweep",
    "usable",
    "walk",
]
