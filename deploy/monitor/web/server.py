"""The web server of `eia-sec watch`: the page's files, and one WebSocket per browser.

By default only this machine reaches it. Its browsers also show other sites, so requests with a foreign Host and
WebSockets that another site's page opens are refused.
"""

import http
import socket
import threading
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Self

from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response
from websockets.sync.server import Server, ServerConnection, serve

from eia_sec.common.errors import EndpointError
from eia_sec.common.names import is_name
from eia_sec.deploy.monitor.web.address import own_hosts
from eia_sec.deploy.monitor.web.hub import Hub

PAGE: Final = Path(__file__).parent / "page"
FILES: Final = {
    "/": ("index.html", "text/html"),
    "/watch.css": ("watch.css", "text/css"),
    **{
        f"/{name}.js": (f"{name}.js", "text/javascript")
        for name in ("main", "stream", "past", "farm", "steps", "field", "conditions", "marks", "charts")
    },
}
"""The paths that are served, with file and content type."""
STREAM: Final = "/stream"
MAX_BROWSERS: Final = 16
MAX_CONNECTIONS: Final = 64
"""Most connections at a time, those included whose request has not come; more are closed at once."""
SECONDS: Final = 3.0
"""Time that a browser has to open or close a connection."""
SEND_SECONDS: Final = 10.0
"""Time that a browser has to take in one packet before it is disconnected."""
LOOK_SECONDS: Final = 0.5
"""Seconds between two checks whether an idle browser is still there."""
POLICY: Final = "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; img-src 'self' data:"


class WebServer:
    """Serves the page; use it as a context manager.

    Args:
        hub: the source of packets.
        host: address to listen on.
        port: port to listen on; 0 for any that is free.
        strangers: whether requests with other Host names than this machine's loopback are answered.

    Attributes:
        port: the port that it listens on.
        refused: requests that were refused, and connections beyond MAX_CONNECTIONS.

    Raises:
        EndpointError: the address is taken or does not belong to this machine.
    """

    def __init__(self, hub: Hub, host: str, port: int, *, strangers: bool = False) -> None:
        self._hub, self._host, self._strangers = hub, host, strangers
        address = host.strip("[]")
        self.refused = 0
        try:
            self._server: Server = serve(
                self._feed,
                address,
                port,
                family=socket.AF_INET6 if ":" in address else socket.AF_INET,
                create_connection=self._counted(),
                process_request=self._answer,
                compression=None,
                open_timeout=SECONDS,
                close_timeout=SECONDS,
                max_size=1024,
            )
        except OSError as error:
            raise EndpointError(
                f"cannot listen on {host}:{port}: the address is taken or not of this machine."
            ) from error
        self.port: int = self._server.socket.getsockname()[1]
        self._thread = threading.Thread(target=self._server.serve_forever, name="web")

    @property
    def failed(self) -> bool:
        """Whether the server has ended by itself."""
        return self._thread.ident is not None and not self._thread.is_alive()

    def _counted(self) -> type[ServerConnection]:
        """Return a kind of connection of which there are MAX_CONNECTIONS at most."""
        web = self

        class Counted(ServerConnection):
            def __init__(self, connected: socket.socket, protocol: Any, server: Server, **options: Any) -> None:
                if len(server.handler_threads) > MAX_CONNECTIONS:
                    web.refused += 1
                    raise ConnectionAbortedError
                super().__init__(connected, protocol, server, **options)

        return Counted

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._server.shutdown()
        self._thread.join()

    def _answer(self, connection: ServerConnection, request: Request) -> Response | None:
        """Return a file or a refusal, or None for the stream."""
        path = request.path.partition("?")[0]
        refusal = self._objection(path, request.headers.get_all("Host"), request.headers.get_all("Origin"))
        if refusal is not None:
            self.refused += 1
            status, sentence = refusal
            return _response(status, "text/plain", sentence.encode())
        if path == STREAM:
            return None
        name, kind = FILES[path]
        return _response(http.HTTPStatus.OK, kind, (PAGE / name).read_bytes())

    def _objection(self, path: str, hosts: list[str], origins: list[str]) -> tuple[http.HTTPStatus, str] | None:
        """Return why a request is refused, or None."""
        host, found = "".join(hosts), None
        if len(hosts) > 1 or len(origins) > 1:
            found = http.HTTPStatus.BAD_REQUEST, "A request has one Host and one Origin."
        elif not (self._strangers or host in own_hosts(self._host, self.port)):
            found = http.HTTPStatus.MISDIRECTED_REQUEST, "This server answers its own machine only."
        elif path != STREAM and path not in FILES:
            found = http.HTTPStatus.NOT_FOUND, "There is no such page."
        elif path == STREAM and origins != [f"http://{host}"]:
            found = http.HTTPStatus.FORBIDDEN, "The stream is for this server's own page."
        elif path == STREAM and self._hub.seats >= MAX_BROWSERS:
            found = http.HTTPStatus.SERVICE_UNAVAILABLE, f"{MAX_BROWSERS} browsers are watching already."
        return found

    def _feed(self, connection: ServerConnection) -> None:
        """Send packets to one browser until it disconnects."""
        seat = self._hub.enter(MAX_BROWSERS)
        if seat is None:
            return
        try:
            connection.socket.settimeout(SEND_SECONDS)
            reported = 0
            while connection.close_code is None:
                packet = seat.take(LOOK_SECONDS)
                if packet is not None:
                    connection.send(packet.data)
                self._listen(connection)
                if seat.dropped != reported:
                    reported = seat.dropped
                    connection.send(f'{{"dropped": {reported}}}')
        except (ConnectionClosed, OSError):  # a browser that hangs up may close the socket under any of these calls
            return
        finally:
            self._hub.leave(seat)

    def _listen(self, connection: ServerConnection) -> None:
        """Take the name of the worker that a browser wants to see, if it has sent one."""
        with suppress(TimeoutError):
            said = connection.recv(timeout=0)
            if isinstance(said, str) and is_name(said):
                self._hub.wanted = said
            else:
                self.refused += 1


def _response(status: http.HTTPStatus, kind: str, body: bytes) -> Response:
    headers = Headers()
    headers["Content-Type"] = f"{kind}; charset=utf-8"
    headers["Content-Length"] = str(len(body))
    headers["Content-Security-Policy"] = POLICY
    headers["X-Content-Type-Options"] = "nosniff"
    headers["Cache-Control"] = "no-store"
    headers["Connection"] = "close"
    return Response(status.value, status.phrase, headers, body)
