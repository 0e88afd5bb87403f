"""A server that answers without end, a few bytes at a time, and counts who asks."""

from __future__ import annotations

import contextlib
import socket
import threading
from collections.abc import Iterator

OK = b"HTTP/1.1 200 OK\r\n"
CHUNKED = OK + b"Transfer-Encoding: chunked\r\n\r\n"
CONTINUE = b"HTTP/1.1 100 Continue\r\n\r\n"
DRIPS: dict[str, tuple[bytes, bytes]] = {
    "nothing": (b"", b""),
    "status line": (b"HTTP/1.1 200 ", b"O"),
    "header": (OK + b"X-Slow: ", b"x"),
    "headers and silence": (OK + b"X: y\r\n", b""),
    "continue": (CONTINUE, CONTINUE),
    "continue with headers": (b"", b"HTTP/1.1 100 Continue\r\nX: y\r\n\r\n"),
    "header of a continue": (b"HTTP/1.1 100 Continue\r\nX: ", b"y"),
    "chunk length": (CHUNKED, b"0"),
    "chunk extension": (CHUNKED + b"1;", b"x"),
    "chunks": (CHUNKED, b"1\r\n \r\n"),
    "end of a chunk": (CHUNKED + b"2\r\n{}", b""),
    "trailer": (CHUNKED + b"2\r\n{}\r\n0\r\nX: ", b"x"),
    "trailers": (CHUNKED + b"2\r\n{}\r\n0\r\n", b"X: y\r\n"),
    "body": (OK + b"Content-Length: 100000\r\n\r\n", b" "),
    "body without a length": (OK + b"\r\n", b" "),
}
"""Answers that never end: their beginning, and the piece that is repeated."""

PACE_S = 0.02
"""Pause between two pieces [s]: short against the time that a test gives the answer."""


class DrippingServer:
    """Answers every connection in the same way, until the other side closes it."""

    def __init__(self, start: bytes, piece: bytes, is_reading: bool = True) -> None:
        self._start, self._piece, self._is_reading = start, piece, is_reading
        self._over = threading.Event()
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = self._listener.getsockname()[1]
        self.connections: list[threading.Thread] = []
        self._thread = threading.Thread(target=self._accept)
        self._thread.start()

    def _accept(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                line, _ = self._listener.accept()
                thread = threading.Thread(target=self._answer, args=(line,))
                self.connections.append(thread)
                thread.start()

    def _answer(self, line: socket.socket) -> None:
        with line, contextlib.suppress(OSError):
            if not self._is_reading:
                self._over.wait()
                return
            line.recv(1 << 16)
            line.sendall(self._start)
            while self._piece:
                line.sendall(self._piece)
                self._over.wait(PACE_S)
            while line.recv(1 << 16):
                pass

    def close(self) -> None:
        """Stop listening, and wait until the other side has closed every connection."""
        self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        self._thread.join()
        if not self._is_reading:
            self._over.set()
        for thread in self.connections:
            thread.join()


@contextlib.contextmanager
def dripping(start: bytes, piece: bytes, is_reading: bool = True) -> Iterator[DrippingServer]:
    """A dripping server, closed at the end."""
    server = DrippingServer(start, piece, is_reading)
    try:
        yield server
    finally:
        server.close()
