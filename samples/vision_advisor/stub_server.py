"""A stand-in for a vision-language model: answers chat completions on this machine, without one.

It checks that a request holds a text and a PNG, and calls everything jelly.

    python stub_server.py 8080
"""

from __future__ import annotations

import base64
import json
import re
import sys
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

PNG = b"\x89PNG\r\n\x1a\n"
PREFIX = "data:image/png;base64,"


def reply_to(request: dict[str, Any]) -> dict[str, Any]:
    """A chat completion.  Raises LookupError, TypeError or ValueError for a bad request."""
    text, picture = request["messages"][-1]["content"]
    url = picture["image_url"]["url"]
    if not url.startswith(PREFIX) or not base64.b64decode(url[len(PREFIX) :]).startswith(PNG):
        raise ValueError("the picture is no PNG")
    prims = re.findall(r"^- (/\S+) \(materials:", text["text"], re.MULTILINE)
    answer = {
        path: {"material": "jelly", "confidence": 0.9, "reason": "the stub calls all things jelly"}
        for path in prims
    }
    message = {"role": "assistant", "content": f"```json\n{json.dumps(answer)}\n```"}
    choice = {"index": 0, "message": message, "finish_reason": "stop"}
    return {"object": "chat.completion", "model": request["model"], "choices": [choice]}


class Handler(BaseHTTPRequestHandler):
    """One route: POST .../chat/completions."""

    def do_POST(self) -> None:
        body = self.rfile.read(int(self.headers.get("Content-Length", 0)))
        if not self.path.endswith("/chat/completions"):
            self._send(404, {"error": {"message": f"no route {self.path}"}})
            return
        try:
            reply = reply_to(json.loads(body))
        except (LookupError, TypeError, ValueError) as error:
            self._send(400, {"error": {"message": f"bad request: {error}"}})
            return
        self._send(200, reply)

    def _send(self, status: int, reply: dict[str, Any]) -> None:
        data = json.dumps(reply).encode("utf-8")
        self.send_response(status)
        self.send_header("Content-Type", "application/json")
        self.send_header("Content-Length", str(len(data)))
        self.end_headers()
        self.wfile.write(data)

    def log_message(self, format: str, *args: Any) -> None:
        """Quiet."""


def serve(port: int = 0) -> ThreadingHTTPServer:
    """A server on this machine alone, not yet running; port 0: any that is free."""
    return ThreadingHTTPServer(("127.0.0.1", port), Handler)


if __name__ == "__main__":
    serve(int(sys.argv[1])).serve_forever()
