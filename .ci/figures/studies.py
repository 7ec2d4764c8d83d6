"""What hits by the million cost."""

import os
import resource
import subprocess
import tempfile
import time
from pathlib import Path

from .source import long, programs

# Of hits, by cutoffs, K and B. The walls are spread over the same ranges, so that as many of them are stable.
SIZES = {10**3: (10, 10, 10), 10**4: (10, 40, 25), 10**5: (10, 100, 100), 10**6: (10, 400, 250)}
ALLOWED_S = 180


def spread(n, low, high):
    return [low + (high - low) * i / (n - 1) for i in range(n)]


@long("hits")
def timed_hits():
    """Studies of single hits, each size in a folder of its own: what a user waits for, the folder written and flushed."""
    program, body = programs() / "host-sim", []
    for hits, (cutoffs, stiffnesses, dampings) in SIZES.items():
        with tempfile.TemporaryDirectory() as folder:
            (Path(folder) / "hits.toml").write_text(f"""measure = "hit"
scenes = ["paper-2um"]
cutoffs_hz = {spread(cutoffs, 300, 3000)}
stiffnesses = {spread(stiffnesses, 1e3, 100e3)}
dampings = {spread(dampings, 0, 300)}
""")
            begun, before = time.monotonic(), resource.getrusage(resource.RUSAGE_CHILDREN)
            subprocess.run([program, "study", "hits.toml", "--out", "hits"], cwd=folder, stdout=subprocess.PIPE, check=True)
            seconds, after = time.monotonic() - begun, resource.getrusage(resource.RUSAGE_CHILDREN)
            busy = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
            size = sum(path.stat().st_size for path in Path(folder, "hits").rglob("*") if path.is_file())
        body.append({"hits": hits, "cores": len(os.sched_getaffinity(0)), "seconds": f"{seconds:.3f}", "busy_s": f"{busy:.3f}",
                     "bytes": size})
        print(body[-1], flush=True)
    if seconds > ALLOWED_S:
        raise SystemExit(f"error: {hits} hits took {seconds:.0f} s, {ALLOWED_S} are allowed")
    return body
