"""What calls cost: processor seconds in turn with a baseline, and memory.

Processor seconds count every thread, and no other process that uses the same cores.
"""

import ctypes
import json
import re
import subprocess
import sys
import tracemalloc
from collections.abc import Callable, Sequence
from pathlib import Path
from time import process_time
from typing import Any, NamedTuple

import numpy as np

from tests.conftest import ROOT

Part = tuple[Callable[[], Any], float]
STATUS, FORGET = Path("/proc/self/status"), Path("/proc/self/clear_refs")
WATCH = """
import json, resource, subprocess, sys, time
begun_s = time.perf_counter()
code = subprocess.run(sys.argv[1:], stdout=subprocess.DEVNULL).returncode
seconds, used = time.perf_counter() - begun_s, resource.getrusage(resource.RUSAGE_CHILDREN)
print(json.dumps([code, seconds, used.ru_maxrss / 1024, used.ru_utime + used.ru_stime]))
"""
"""In a process of its own, as a fork of a large one counts the memory of that one."""


class Command(NamedTuple):
    """What a command cost: seconds on the clock, the most memory (MB), and processor seconds with its children's."""

    seconds: float
    memory_mb: float
    processor_s: float


def measure_command(line: Sequence[str]) -> Command:
    """Run a command, which has to succeed, and return what it cost."""
    watch = subprocess.run(
        [sys.executable, "-c", WATCH, *line], cwd=ROOT, stdout=subprocess.PIPE, text=True, check=True
    )
    code, *cost = json.loads(watch.stdout)
    assert code == 0, f"{' '.join(line)} ended with {code}"
    return Command(*cost)


def time_call(call: Callable[[], Any]) -> float:
    """Return the processor seconds of a call."""
    begun = process_time()
    call()
    return process_time() - begun


def add_parts(parts: Sequence[Part]) -> float:
    """Return the processor seconds of parts, each as often as it is needed."""
    return sum(times * time_call(call) for call, times in parts)


def take_turn(parts: Sequence[Part], baseline: Callable[[], Any]) -> tuple[float, float]:
    """Return the processor seconds of a subject's parts, and of the baseline directly before."""
    against_s = time_call(baseline)
    return add_parts(parts), against_s


def peak_allocated_mb(call: Callable[[], Any]) -> float:
    """Return what a call of Python and NumPy holds at most beyond what it found and what it returns (MB)."""
    call()
    tracemalloc.start()
    try:
        before = tracemalloc.get_traced_memory()[0]
        kept = call()
        after, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    returned = after - before
    del kept
    return (peak - before - returned) / 2**20


def peak_resident_mb(call: Callable[[], Any]) -> float:
    """Return the most resident memory of a call beyond what was there before (MB), of any allocator; nan off Linux."""
    if not FORGET.exists():
        call()
        return np.nan
    ctypes.CDLL(None).malloc_trim(0)
    FORGET.write_text("5")  # resets the peak
    before = read_status_mb("VmRSS")
    call()
    return read_status_mb("VmHWM") - before


def read_status_mb(name: str) -> float:
    """Return a figure of this process's memory (MB)."""
    (found,) = re.findall(rf"^{name}:\s+(\d+) kB", STATUS.read_text(), re.MULTILINE)
    return int(found) / 1024
