"""An OpenAI-compatible endpoint that a test answers for."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

import pytest

from tasks.calls import endpoint as endpoints
from tasks.calls.endpoint import Endpoint

Answer = Callable[[dict[str, Any]], tuple[int, Any, dict[str, str]]]


class Server:
    """An OpenAI-compatible endpoint whose answers a test gives, one after another; the last goes on."""

    def __init__(self) -> None:
        self.answers: list[Answer] = []
        self.requests: list[tuple[str, dict[str, str], dict[str, Any]]] = []
        outer = self

        class Handler(BaseHTTPRequestHandler):
            def do_POST(self) -> None:
                body = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
                outer.requests.append((self.path, dict(self.headers), body))
                answer = outer.answers.pop(0) if len(outer.answers) > 1 else outer.answers[0]
                status, content, headers = answer(body)
                data = content if isinstance(content, bytes) else json.dumps(content).encode()
                self.send_response(status)
                for name, value in {"Content-Length": str(len(data)), **headers}.items():
                    self.send_header(name, value)
                self.end_headers()
                self.wfile.write(data)

            def log_message(self, *arguments: object) -> None:
                pass

        self._server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.url = f"http://127.0.0.1:{self._server.server_address[1]}/v1"
        self._thread = threading.Thread(target=self._server.serve_forever, kwargs={"poll_interval": 0.01})
        self._thread.start()

    def close(self) -> None:
        self._server.shutdown()
        self._thread.join()
        self._server.server_close()


def says(text: str) -> Answer:
    return lambda body: (200, {"choices": [{"message": {"role": "assistant", "content": text}}]}, {})


def refuses(status: int, **headers: str) -> Answer:
    return lambda body: (status, {"error": {"message": "no"}}, headers)


@pytest.fixture
def server() -> Iterator[Server]:
    made = Server()
    endpoints._UNDERSTOOD.clear()
    yield made
    made.close()


def asking(server: Server, **more: Any) -> Endpoint:
    return Endpoint(server.url, "seer-1", pause_seconds=0.0, **more)
