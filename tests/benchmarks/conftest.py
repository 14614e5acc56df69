"""Ratios of one run: every round times the baseline right before the subject, so that both see the same machine.

With --short each figure comes from fewer rounds and smaller sizes: it shows that all still runs, and slips of an order.
"""

import statistics
import time

import pytest
from threadpoolctl import threadpool_limits

ROWS = pytest.StashKey[list]()


def pytest_addoption(parser):
    parser.addoption("--short", action="store_true", help="a few rounds of each benchmark, at its smaller sizes")


def pytest_configure(config):
    config.addinivalue_line("markers", "long: a size, or a figure, that --short leaves out")


def pytest_collection_modifyitems(config, items):
    left_out = [item for item in items if config.option.short and item.get_closest_marker("long")]
    config.hook.pytest_deselected(items=left_out)
    items[:] = [item for item in items if item not in left_out]


@pytest.fixture(scope="session")
def sized(request):
    """Return ``sized(full, short)``, the one of two numbers (of rounds, of jobs) that this run is to take."""
    return lambda full, short=3: short if request.config.option.short else full


@pytest.fixture(autouse=True, scope="session")
def one_thread():
    """The pipeline's own setting."""
    with threadpool_limits(1):
        yield


@pytest.fixture
def tell(request, benchmark):
    """Note a figure for the table at the end and for --benchmark-json."""
    rows = request.config.stash.setdefault(ROWS, [])

    def note(name, figure, unit="", limit=None, stretch=None):
        rows.append((name, figure, unit, limit, stretch))
        benchmark.extra_info[name] = figure

    return note


@pytest.fixture
def against(benchmark, sized):
    """Time a subject and a baseline in turn; return the ratio of their medians."""

    def ratio(subject, baseline, rounds, short=3):
        baseline()
        baselines, subjects = [], []

        def timed(function, seconds):
            start = time.perf_counter()
            function()
            seconds.append(time.perf_counter() - start)

        rounds = sized(rounds, short)
        benchmark.pedantic(
            lambda: timed(subject, subjects), setup=lambda: timed(baseline, baselines), rounds=rounds, warmup_rounds=1
        )
        subjects, baselines = subjects[1:], baselines[1:]
        benchmark.extra_info["baseline_median_s"] = statistics.median(baselines)
        return statistics.median(subjects) / statistics.median(baselines)

    return ratio


def pytest_terminal_summary(terminalreporter, config):
    rows = config.stash.get(ROWS, [])
    if not rows:
        return
    terminalreporter.section("figures")
    width = max(len(name) for name, *_ in rows)
    for name, figure, unit, limit, stretch in rows:
        verdict = "" if limit is None else "missed" if figure > limit else "met"
        verdict += ", and the stretch" if verdict == "met" and stretch is not None and figure <= stretch else ""
        at_most = "" if limit is None else f"at most {limit:g}"
        further = "" if stretch is None else f"stretch {stretch:g}"
        shown = f"{figure:.3g} {unit}".strip()
        terminalreporter.write_line(f"{name:<{width}}  {shown:>12}  {at_most:<14} {further:<12} {verdict}")
