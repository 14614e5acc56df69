"""Where trials are attended: on pages in a browser, or in the terminal.

The configuration's ``operator_ui`` flows in; out flows the operator session to which rigs report, until it is closed.
"""

from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager

from pydantic import Field

from stages.science.operator_ui.operator_session import ROLES, OperatorSession, OperatorSettings
from stages.science.operator_ui.pages.server import PageServer
from stages.science.operator_ui.terminal import Terminal


class Pages(OperatorSettings):
    """Pages of the operator and of the participant, in browsers."""

    host: str = Field(min_length=1, description="address that pages are served on")
    port: int = Field(ge=0, le=65535, description="TCP port; 0 = any that is free")

    @contextmanager
    def open(self) -> Iterator[tuple[OperatorSession, Sequence[str]]]:
        """Serve the pages, or raise what `PageServer.open` does; yield the session and the pages' addresses."""
        server = PageServer(OperatorSession(self), self.host, self.port)
        server.open()
        with closing(server):
            yield server.session, [f"{role}'s page: {server.address(role)}" for role in reversed(ROLES)]


class TerminalUi(OperatorSettings):
    """Questions and keys in the terminal; nobody sees the trial drawn."""

    @contextmanager
    def open(self) -> Iterator[tuple[OperatorSession, Sequence[str]]]:
        """Begin to ask; yield the session and what to type."""
        terminal = Terminal(OperatorSession(self, drawn=False))
        terminal.open()
        with closing(terminal):
            yield terminal.session, ["trials are decided on here: type the letter, perhaps a note after it, and Enter"]
