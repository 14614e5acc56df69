"""Where trials are attended: on pages in a browser, or in the terminal.

The configuration's ``operator_ui`` flows in; out flows the operator session to which rigs report, until it is closed.
"""

from collections.abc import Sequence

from pydantic import Field, PrivateAttr

from stages.science.operator_ui.operator_session import OperatorSession, OperatorSettings
from stages.science.operator_ui.pages.server import PageServer
from stages.science.operator_ui.terminal import Terminal


class Pages(OperatorSettings):
    """Pages of the operator and of the participant, in browsers."""

    host: str = Field(min_length=1, description="address that pages are served on")
    port: int = Field(ge=0, le=65535, description="TCP port; 0 = any that is free")
    _server: PageServer | None = PrivateAttr(default=None)

    @property
    def greeting(self) -> Sequence[str]:
        """The pages' addresses."""
        return [f"{role}'s page: {self._server.address(role)}" for role in ("operator", "participant") if self._server]

    def open(self) -> OperatorSession:
        """Serve the pages, or raise what `PageServer.open` does."""
        self._server = PageServer(OperatorSession(self), self.host, self.port)
        self._server.open()
        return self._server.session

    def close(self) -> None:
        """Serve no more."""
        if self._server is not None:
            self._server.close()


class TerminalUi(OperatorSettings):
    """Questions and keys in the terminal; nobody sees the trial drawn."""

    _terminal: Terminal | None = PrivateAttr(default=None)

    @property
    def greeting(self) -> Sequence[str]:
        """What to type."""
        return ["trials are decided on here: type the letter, perhaps a note after it, and Enter"]

    def open(self) -> OperatorSession:
        """Begin to ask."""
        self._terminal = Terminal(OperatorSession(self, drawn=False))
        self._terminal.open()
        return self._terminal.session

    def close(self) -> None:
        """Ask no more."""
        if self._terminal is not None:
            self._terminal.close()
