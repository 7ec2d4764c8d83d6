"""maturin, asked for the type stubs too: they are made from the extension module, and none are kept in the repository."""

import os

os.environ["MATURIN_PEP517_ARGS"] = f"--generate-stubs {os.environ.get('MATURIN_PEP517_ARGS', '')}"

from maturin import *  # noqa: E402, F403
