"""``python -m tests.near FILE``: the tests that are nearest to a module, by folder, name and imports."""

import re
import sys
from functools import cache
from pathlib import Path

import grimp

SHOWN = 5
FAR = 6
"""Steps of imports from which on they say nothing."""
TYPED = 2
"""As many steps is the runner away from a test that types the command of the toy workflow."""
LATER = re.compile(r"^pytestmark = .*(slow|realtime)", re.MULTILINE)


def list_tests(root: Path) -> list[str]:
    """Return all test files, from the project's folder."""
    found = (each.relative_to(root).as_posix() for each in (root / "tests").rglob("test_*.py"))
    return sorted(each for each in found if not each.startswith("tests/benchmarks/"))


def rank_tests(root: Path, file: str, within: str = "") -> list[str]:
    """Return all test files, those nearest to a place in a module first; those outside the README's line last.

    `file` is from the project's folder, and `within` the dotted name of a function in it.
    """
    module = _name_module(file).removesuffix(".__init__")
    folder = "tests/" + Path(file).parent.as_posix().removeprefix("stages/") + "/"
    words = _words(file.rpartition("/")[2])
    names = {each for each in within.split(".") if len(each) > 3}

    def near(test: str) -> tuple[bool, int, int]:
        text, stem = (root / test).read_text(), Path(test).stem.removeprefix("test_")
        named_for = [each for each in _imports().modules if each.endswith(f".{stem}") and each != module]
        score = min([_count_steps(_name_module(test), module), *(_count_steps(each, module) for each in named_for)])
        score = min(score, TYPED) if file.startswith("pipeline/") and "toy" in text else score
        score -= 2 * test.startswith(folder) + 2 * bool(words & _words(stem)) + any(each in text for each in names)
        return bool(LATER.search(text)), score - FAR * (stem == Path(file).stem), len(text)

    return sorted(list_tests(root), key=near)


def _name_module(file: str) -> str:
    return file.removesuffix(".py").replace("/", ".")


@cache
def _count_steps(importer: str, imported: str) -> int:
    chain = _imports().find_shortest_chain(importer, imported)
    return min(len(chain) - 1, FAR) if chain else FAR


def _words(name: str) -> set[str]:
    """Return how the words of a file's name begin, by which ``runner`` and ``test_runs`` are akin."""
    return {each[:3] for each in re.findall("[a-z]+", name)} - {"py", "ini", "sta"}


@cache
def _imports() -> grimp.ImportGraph:
    return grimp.build_graph("tests", "pipeline", "stages", cache_dir=None)


if __name__ == "__main__":
    root = Path(__file__).resolve().parent.parent
    for path in sys.argv[1:]:
        file = Path(path).resolve().relative_to(root).as_posix()
        print(f"{file}: {' '.join(rank_tests(root, file)[:SHOWN])}")
