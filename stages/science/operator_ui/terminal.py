"""The operator at the terminal: a session's questions flow out as lines, typed letters flow back as decisions."""

import contextlib
import math
import sys
import threading
from typing import Any, TextIO

from stages.science.operator_ui.operator_session import OperatorSession, Refused
from stages.science.rig import clock

LETTERS = {"a": "accept", "s": "skip", "k": "keep", "r": "repeat", "x": "reject", "q": "pause"}
MEANT = {
    "skip": "skip, and see the next best",
    "reject": "reject: kept aside, not learned from",
    "pause": "stop for today",
}
POLL_S = 0.02


class Terminal:
    """Asks what a session asks and hears the answers, in this process's terminal unless lines come and go elsewhere."""

    def __init__(self, session: OperatorSession, source: TextIO | None = None, sink: TextIO | None = None):
        self.session = session
        self._source, self._sink = source or sys.stdin, sink or sys.stdout
        self._closed = threading.Event()
        self._told: tuple[Any, ...] = ()

    def open(self) -> None:
        """Begin to ask and to hear."""
        for work in (self._watch, self._hear):
            threading.Thread(target=work, name="terminal", daemon=True).start()

    def close(self) -> None:
        """Ask no more."""
        self._closed.set()

    def _watch(self) -> None:
        seen = -1
        while not self._closed.is_set():
            if self.session.number != seen:
                scene = self.session.see()
                seen = scene["number"]
                self._tell(scene)
            clock.sleep(POLL_S)

    def _tell(self, scene: dict[str, Any]) -> None:
        """Print what is new, once."""
        now = scene["phase"], scene["question"], scene["stop"], tuple(scene["choices"])
        if now == self._told:
            return
        self._told, phase = now, scene["phase"]
        if phase == "proposed" and scene["choices"]:
            trial = scene["trial"]
            reason = [f"  {trial['reason']}"] if trial["reason"] else []
            title = f"{trial['title']}, {trial['duration_s']:g} s ({trial['label']})"
            self._say(title, *reason, self._offer(scene))
        elif phase == "countdown":
            ahead_s = max((scene["starts_at_s"] or 0.0) - clock.now_s(), 0.0)
            self._say(f"begins{f' in {math.ceil(ahead_s)} s' if ahead_s > 0.0 else ''}; Enter stops it")
        elif phase == "running" and not scene["stop"]:
            self._say("running; Enter stops it")
        elif phase == "judging" and scene["choices"]:
            self._say(*_describe_outcome(scene), self._offer(scene))

    def _offer(self, scene: dict[str, Any]) -> str:
        choices = scene["choices"]
        letters = [f"{letter} = {MEANT.get(word, word)}" for letter, word in LETTERS.items() if word in choices]
        if scene["phase"] == "proposed":
            letters.append("g = let trials follow by themselves")
        return f"  {', '.join(letters)}; a note may follow the letter: "

    def _hear(self) -> None:
        while not self._closed.is_set():
            if line := self._source.readline():
                self._take(line)
            else:
                self._lose()

    def _take(self, line: str) -> None:
        scene = self.session.see()
        if scene["phase"] in ("countdown", "running") or scene["automatic"]:
            self.session.stop("the operator pressed Enter")
            return
        letter, _, note = line.strip().partition(" ")
        if letter.lower() == "g" and scene["phase"] == "proposed":
            self.session.go_on(True)
        elif not scene["choices"]:
            self._say("nothing is asked now")
        else:
            try:
                if letter.lower() not in LETTERS:
                    raise Refused(f"expected one of the letters, got {letter!r}")
                self.session.decide(LETTERS[letter.lower()], note, scene["question"])
            except Refused as error:
                self._say(f"{error}", self._offer(scene))

    def _lose(self) -> None:
        """Nobody can type any more: stop what runs, and the study at the next question."""
        self.session.stop("the terminal's input has ended")
        while not self._closed.is_set():
            scene = self.session.see()
            if scene["choices"]:
                word = "pause" if "pause" in scene["choices"] else "keep"
                with contextlib.suppress(Refused):
                    self.session.decide(word, "the terminal's input had ended", scene["question"])
            clock.sleep(POLL_S)

    def _say(self, *lines: str) -> None:
        self._sink.write("".join(f"{line}\n" for line in lines))
        self._sink.flush()


def _describe_outcome(scene: dict[str, Any]) -> list[str]:
    """Return lines that say how a trial went."""
    outcome = scene["outcome"]
    if "stopped" in outcome:
        return [f"  {outcome['stopped']}"]
    lines = []
    if outcome["not_ok"]:
        lines.append(f"  {outcome['not_ok']} of {outcome['samples']} samples are not ok")
    if "tracking_error_rad" in outcome:
        errors = zip(scene["machine"]["joints"], outcome["tracking_error_rad"], strict=True)
        degrees = ", ".join(f"{joint['name']} {math.degrees(error):.1f}" for joint, error in errors)
        lines.append(f"  tracking error (RMS, degrees): {degrees}")
    return lines
