"""What one step of a loop costs: seconds and working memory.

A function flows in; figures of this machine flow out, which no table may hold.
"""

import time
import tracemalloc
from collections.abc import Callable


def measure_cost(step: Callable[[], object]) -> dict[str, float]:
    """Return what a step takes that is called twice, timed, then watched.

    ``seconds``, and ``peak_memory_mb``: the most that was allocated beyond what was there before (MB).
    """
    began = time.perf_counter()
    step()
    seconds = time.perf_counter() - began
    tracemalloc.start()
    try:
        before = tracemalloc.get_traced_memory()[0]
        step()
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    return {"seconds": seconds, "peak_memory_mb": (peak - before) / 2**20}
