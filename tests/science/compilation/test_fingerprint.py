"""A compiled function is kept until something that it calls changes, in whatever file."""

import importlib
import sys

import pytest
from numba.core import config

import stages  # noqa: F401 (tells numba where to keep functions)

LAWS = """
from numba import njit

SCALE, SHIFTS = 2.0, (1.0, 4.0)

@njit(cache=True)
def square(x):
    return x * x

@njit(cache=True)
def law(x):
    return SCALE * square(x) + SHIFTS[0]
"""
MACHINE = """
import numpy as np
from numba import njit

import laws_of_a_user as laws
from laws_of_a_user import law

TABLE = np.array([0.5, 0.25])

@njit(cache=True)
def simulate(x):
    return law(x) + laws.square(x) + finish(x)

@njit(cache=True)
def finish(x):
    return TABLE[0] * x
"""
EDITS = {
    "a function that is called by one that is called": ("laws", "return x * x", "return x * x * x"),
    "a function that is imported": ("laws", "SCALE * square(x) +", "SCALE * square(x) -"),
    "a number in another file": ("laws", "SCALE, SHIFTS = 2.0,", "SCALE, SHIFTS = 3.0,"),
    "a tuple in another file": ("laws", "(1.0, 4.0)", "(7.0, 4.0)"),
    "a function that stands further down": ("machine", "TABLE[0] * x", "TABLE[0] - x"),
    "an array": ("machine", "np.array([0.5,", "np.array([0.75,"),
    "how a function is compiled": ("laws", "@njit(cache=True)\ndef law", "@njit(cache=True, fastmath=True)\ndef law"),
}


@pytest.fixture
def run_machine(tmp_path, monkeypatch):
    """Return what runs the user's machine as a new process would find it: its result, and what of it was kept."""
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setattr(sys, "dont_write_bytecode", True)

    def run(laws, machine):
        (tmp_path / "laws_of_a_user.py").write_text(laws)
        (tmp_path / "machine_of_a_user.py").write_text(machine)
        importlib.invalidate_caches()
        forget()
        simulate = importlib.import_module("machine_of_a_user").simulate
        return simulate(3.0), sum(simulate.stats.cache_hits.values()), simulate.py_func

    def forget():
        for name in ("laws_of_a_user", "machine_of_a_user", "moved_laws"):
            sys.modules.pop(name, None)

    yield run
    forget()


def test_a_function_is_kept_until_something_it_calls_changes(run_machine):
    found, kept, _ = run_machine(LAWS, MACHINE)
    assert (found, kept) == (2.0 * 9.0 + 1.0 + 9.0 + 1.5, 0)
    assert run_machine(LAWS, MACHINE)[:2] == (found, 1)
    commented = LAWS.replace("return x * x", "return x * x  # a comment changes nothing")
    assert run_machine(commented, MACHINE)[:2] == (found, 1)
    for what, (file, old, new) in EDITS.items():
        texts = {"laws": LAWS, "machine": MACHINE}
        assert texts[file].count(old) == 1
        texts[file] = texts[file].replace(old, new)
        edited, kept, simulate = run_machine(**texts)
        assert (edited, kept) == (simulate(3.0), 0), what
        assert edited != found or "compiled" in what, what


def test_a_function_that_calls_one_that_has_moved_is_compiled_anew(run_machine, tmp_path):
    machine = MACHINE.replace("import laws_of_a_user as laws\n", "").replace("laws.square", "law")
    found, _, _ = run_machine(LAWS, machine)
    (tmp_path / "laws_of_a_user.py").rename(tmp_path / "moved_laws.py")
    assert run_machine("", machine.replace("laws_of_a_user", "moved_laws"))[:2] == (found, 0)


def test_functions_in_a_folder_of_its_own_serve_every_checkout(run_machine, tmp_path, monkeypatch):
    monkeypatch.setattr(config, "CACHE_DIR", str(tmp_path / "kept"))
    found, kept, _ = run_machine(LAWS, MACHINE)
    assert kept == 0
    assert not list(tmp_path.glob("__pycache__/*.nbi"))
    assert list((tmp_path / "kept" / "machine_of_a_user").glob("*simulate*.nbi"))
    assert run_machine(LAWS, MACHINE)[:2] == (found, 1)
