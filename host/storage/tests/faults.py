"""A proxy in front of a server: it passes requests on, and what is asked of it goes wrong with some of them."""

import http.client
import random
import ssl
import threading
import time
from collections.abc import Callable
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

# Ways in which a request may end, in the order of its path.
PASSED = "passed"
LATE = "late"
DROPPED = "dropped"  # the server never hears of it
REFUSED = "refused"  # nor here, and it is answered
UNANSWERED = "unanswered"  # the server does it, and the answer is lost
CUT = "cut"  # half of the answer is lost
SILENT = "silent"  # nothing is ever answered

ALL = [LATE, DROPPED, REFUSED, UNANSWERED, CUT]

# Of a request's method, path and how many came before it, what becomes of it.
Rule = Callable[[str, str, int], str]


def at_random(seed: int, part: float = 0.25) -> Rule:
    """Something goes wrong with such a part of all requests, by a seed. But an upload that is begun and never heard of
    stays in the store, whatever anybody does."""
    chance = random.Random(seed)

    def rule(method: str, path: str, number: int) -> str:
        fate = chance.choice(ALL) if chance.random() < part else PASSED
        begins = method == "POST" and "uploadId=" not in path
        return DROPPED if begins and fate in (UNANSWERED, CUT) else fate

    return rule


class Proxy:
    """Is at `url` as long as it is entered. What it was asked for is in `requests`."""

    def __init__(self, port: int, rule: Rule, tls: ssl.SSLContext | None = None) -> None:
        self.port = port
        self.rule = rule
        self.requests: list[tuple[str, str, str]] = []
        self.lock = threading.Lock()
        self.over = threading.Event()
        proxy = self

        class Handler(BaseHTTPRequestHandler):
            protocol_version = "HTTP/1.1"

            def handle_request(self) -> None:
                proxy.handle(self)

            do_GET = do_HEAD = do_PUT = do_POST = do_DELETE = handle_request

            def log_message(self, format: str, *args: object) -> None:
                pass

        self.server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.server.daemon_threads = True
        # Connections that are dropped are its own doing.
        self.server.handle_error = lambda *_: None  # type: ignore[method-assign, assignment]
        if tls:
            self.server.socket = tls.wrap_socket(self.server.socket, server_side=True)
        scheme, host = ("https", "localhost") if tls else ("http", "127.0.0.1")
        self.url = f"{scheme}://{host}:{self.server.server_address[1]}"

    def __enter__(self) -> "Proxy":
        threading.Thread(target=self.server.serve_forever, daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        self.over.set()
        self.server.shutdown()
        self.server.server_close()

    def fates(self) -> set[str]:
        """What became of requests so far."""
        return {fate for _, _, fate in self.requests}

    def handle(self, to: BaseHTTPRequestHandler) -> None:
        body = to.rfile.read(int(to.headers.get("Content-Length", 0)))
        with self.lock:
            fate = self.rule(to.command, to.path, len(self.requests))
            self.requests.append((to.command, to.path, fate))
        if fate == LATE:
            time.sleep(0.2)
        if fate == SILENT:
            self.over.wait()
        if fate in (DROPPED, SILENT):
            to.close_connection = True
            return
        if fate == REFUSED:
            answer = b"<Error><Code>SlowDown</Code><Message>Reduce your request rate.</Message></Error>"
            to.send_response(503)
            to.send_header("Content-Length", str(len(answer)))
            to.end_headers()
            if to.command != "HEAD":
                to.wfile.write(answer)
            return
        server = http.client.HTTPConnection("127.0.0.1", self.port)
        server.request(to.command, to.path, body, dict(to.headers))
        came = server.getresponse()
        content = came.read()
        if fate == UNANSWERED:
            to.close_connection = True
            return
        to.send_response(came.status)
        length = came.headers.get("Content-Length", str(len(content)))
        for name, value in came.getheaders():
            if name.lower() not in ("connection", "transfer-encoding", "content-length", "date", "server"):
                to.send_header(name, value)
        to.send_header("Content-Length", length)
        to.end_headers()
        if fate == CUT and to.command != "HEAD":
            content = content[: len(content) // 2]
            to.close_connection = True
        to.wfile.write(content)
