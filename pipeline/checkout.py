"""The checkout that the code lies in: its commit, and what was changed since.

Out flow facts for the ledger and, where the checkout is not clean, a patch for the run's folder: with the commit it
gives back the code that ran. A clean checkout costs one look by git; outside of a checkout there is nothing to tell.
"""

import hashlib
import subprocess
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

from pipeline.files import write_atomically

ROOT = Path(__file__).resolve().parent.parent
FILE_NAME = "changes.patch"
LARGEST_PATCH = 1_000_000
"""Bytes of changes that are kept."""
MOST_UNTRACKED = 1000
"""Names of untracked files that are kept."""
PATIENCE_S = 10
STATUS = ("--no-optional-locks", "status", "--porcelain=v2", "--branch", "-z", "--untracked-files=normal")
DIFF = ("diff", "HEAD", "--no-ext-diff", "--no-textconv", "--no-color", "--src-prefix=a/", "--dst-prefix=b/")
UNTRACKED = ("ls-files", "--others", "--exclude-standard", "-z")


@cache
def look_at_checkout(root: Path = ROOT) -> tuple[dict[str, Any], bytes] | None:
    """Return facts of a checkout and a patch for ``git apply``, or None outside of one, or of one without a commit.

    The facts are ``commit``, ``clean`` and, where it is not clean, ``changes``: of the patch its ``file``, ``sha256``,
    ``bytes``, ``complete``, and the number of ``untracked`` files; None where git could not tell.
    """
    try:
        status = _ask_git(root, STATUS)
        entries = [each.decode(errors="replace") for each in status.split(b"\0") if each]
        commit = next(each.split()[-1] for each in entries if each.startswith("# branch.oid "))
    except (OSError, subprocess.SubprocessError, StopIteration):
        return None
    if commit == "(initial)":
        return None
    entries = [each for each in entries if not each.startswith("# ")]
    if not entries:
        return {"commit": commit, "clean": True}, b""
    facts: dict[str, Any] = {"commit": commit, "clean": False, "changes": None}
    try:
        diff, complete = _read_diff(root)
        untracked = _ask_git(root, UNTRACKED).split(b"\0")[:-1] if any(each[0] == "?" for each in entries) else []
    except (OSError, subprocess.SubprocessError):
        return facts, b""
    patch = _introduce(commit, complete, untracked) + diff
    digest = hashlib.sha256(patch).hexdigest()
    told = {"sha256": digest, "bytes": len(patch), "complete": complete, "untracked": len(untracked)}
    return {**facts, "changes": {"file": FILE_NAME, **told}}, patch


def git_state() -> dict[str, Any] | None:
    """Return the facts of the checkout that this code lies in, or None outside of one."""
    found = look_at_checkout()
    return None if found is None else dict(found[0])


def describe_commit(git: Mapping[str, Any] | None) -> str:
    """Return in words which code a run was made with, from the facts of its checkout."""
    if not git:
        return "unknown"
    if git["clean"]:
        return str(git["commit"][:10])
    changes = git.get("changes")
    return f"{git['commit'][:10]} with changes{' ' + changes['sha256'][:8] if changes else ''}"


def keep_changes(folder: Path, facts: dict[str, Any]) -> None:
    """Leave in a run's folder what was changed in the checkout since its commit.

    What a run was begun with stays; if it is continued with other code, facts of that are added to its ledger's.
    """
    found, patch = look_at_checkout() or (None, b"")
    kept = facts.get("git")
    if found and kept != found:
        later = facts.setdefault("git_when_continued", [])
        kept = later[-1] if later and _is_same(later[-1], found) else dict(found)
        if kept not in later:
            if patch:
                kept["changes"] = {**kept["changes"], "file": f"changes-{len(later) + 2}.patch"}
            later.append(kept)
    if found and patch and kept:
        path = folder / kept["changes"]["file"]
        write_atomically(path, lambda temporary: temporary.write_bytes(patch), final=True)
    elif kept is facts.get("git") and not (kept or {}).get("changes"):
        (folder / FILE_NAME).unlink(missing_ok=True)  # of another run that had this folder


def _is_same(facts: dict[str, Any], found: dict[str, Any]) -> bool:
    changes, others = facts.get("changes") or {}, found.get("changes") or {}
    return bool(facts["commit"] == found["commit"] and changes.get("sha256") == others.get("sha256"))


def _read_diff(root: Path) -> tuple[bytes, bool]:
    """Return what was changed in tracked files, as far as it is not too much, and whether that is all."""
    whole = _ask_git(root, (*DIFF, "--binary"))
    if len(whole) <= LARGEST_PATCH:
        return whole, True
    diff = _ask_git(root, DIFF)  # without what binary files hold
    if len(diff) > LARGEST_PATCH:
        diff = diff[: max(0, diff.rfind(b"\ndiff --git ", 0, LARGEST_PATCH) + 1)]
    return diff, False


def _introduce(commit: str, complete: bool, untracked: Sequence[bytes]) -> bytes:
    lines = [f"Changes to commit {commit}; to have them again, type: git checkout {commit} && git apply {FILE_NAME}"]
    if not complete:
        lines.append(f"Not all of them: what binary files hold, or files beyond {LARGEST_PATCH} bytes, are left out.")
    names = [each.decode(errors="replace") for each in untracked[:MOST_UNTRACKED]]
    lines += [f"Untracked: {name if name.isprintable() else ascii(name)}" for name in names]
    if len(untracked) > len(names):
        lines.append(f"Untracked: {len(untracked) - len(names)} more")
    return "".join(f"{line}\n" for line in [*lines, ""]).encode()


def _ask_git(root: Path, arguments: Sequence[str]) -> bytes:
    """Return what git answers; an OSError or SubprocessError says that it is absent, takes too long, or refuses."""
    return subprocess.run(["git", *arguments], cwd=root, capture_output=True, timeout=PATIENCE_S, check=True).stdout
