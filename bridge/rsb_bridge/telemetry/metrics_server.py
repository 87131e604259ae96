"""An HTTP server for a few readers, each of which gets little time: it may be open to a whole network."""

from __future__ import annotations

import contextlib
import io
import socket
from socketserver import TCPServer, ThreadingMixIn
from typing import TYPE_CHECKING, Any
from wsgiref.simple_server import WSGIRequestHandler, WSGIServer

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable
    from wsgiref.types import StartResponse, WSGIApplication, WSGIEnvironment

_CONNECTIONS = 8
"""At once; more are closed without an answer."""
_ANSWERED_WITHIN = 10.0
"""s that a connection may last."""
_LOOKS_EVERY = 1.0
_BACKLOG = 16


class MetricsServer(ThreadingMixIn, WSGIServer):
    """Serves a WSGI application: a thread for each connection, while somebody calls `turn`.

    Args:
        host: an address or a name.
        port: a TCP port.
        app: what is served.
        steady: the time (s) on a clock that nobody sets.
        failed: is told what the application raises.

    Raises:
        OSError: the address cannot be bound.
    """

    daemon_threads = False  # so that closing waits for them
    request_queue_size = _BACKLOG
    timeout = _LOOKS_EVERY

    def __init__(
        self,
        host: str,
        port: int,
        app: WSGIApplication,
        steady: Callable[[], float],
        failed: Callable[[Exception], None],
    ) -> None:
        found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
        self.address_family, _, _, _, address = found[0]
        self._steady = steady
        self._failed = failed
        self._open: dict[socket.socket, float] = {}
        super().__init__(address, _Handler)  # type: ignore[arg-type]  # an IPv6 address has four parts
        self._app = app
        self.set_app(self._answer)

    def _answer(self, environ: WSGIEnvironment, start_response: StartResponse) -> Iterable[bytes]:
        try:
            return self._app(environ, start_response)
        except Exception as error:  # noqa: BLE001 (the last resort: the server goes on, and an operator is told)
            self._failed(error)
            start_response("500 Internal Server Error", [("Content-Type", "text/plain")])
            return [b"internal error: see the bridge's log\n"]

    def server_bind(self) -> None:
        """Without the look-up of the host's name, which may take its time."""
        TCPServer.server_bind(self)
        self.server_name, self.server_port = str(self.server_address[0]), int(self.server_address[1])
        self.setup_environ()

    def turn(self) -> None:
        """Take a connection; returns after a second without one, or after `wake`."""
        self.handle_request()
        now = self._steady()
        for request, began in list(self._open.items()):
            if now - began >= _ANSWERED_WITHIN:
                _shut(request)

    def wake(self) -> None:
        """Have `turn` return at once, and take no connection any more; called on any thread."""
        _shut(self.socket)

    def server_close(self) -> None:
        """Close everything; returns once all threads have ended."""
        for request in list(self._open):
            _shut(request)
        super().server_close()

    def verify_request(self, request: Any, client_address: Any) -> bool:
        return len(self._open) < _CONNECTIONS

    def process_request(self, request: Any, client_address: Any) -> None:
        self._open[request] = self._steady()
        super().process_request(request, client_address)

    def shutdown_request(self, request: Any) -> None:
        self._open.pop(request, None)
        super().shutdown_request(request)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """A reader that goes, or is too slow, is no error of ours."""


class _Handler(WSGIRequestHandler):
    """One request on a connection. Nothing is printed: standard error may be the terminal of a console."""

    timeout = _ANSWERED_WITHIN

    def log_message(self, format: str, *args: object) -> None:  # noqa: A002 (so it is called there)
        """Log nothing."""

    def get_stderr(self) -> io.StringIO:
        return io.StringIO()


def _shut(sock: socket.socket) -> None:
    """Have whoever waits for a socket wait no longer."""
    with contextlib.suppress(OSError):
        sock.shutdown(socket.SHUT_RDWR)
