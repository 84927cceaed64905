"""Pages of a folder in one headless browser, at several widths: what a script finds on each, and every complaint."""

from __future__ import annotations

import json
import shutil
import subprocess
import threading
from collections.abc import Sequence
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
PROBE = """<script>
window.complaints = [];
window.addEventListener("error", e => complaints.push(String(e.message || e.target.outerHTML)), true);
window.addEventListener("unhandledrejection", e => complaints.push(String(e.reason)));
for (const kind of ["error", "warn"]) {
  const own = console[kind]; console[kind] = (...x) => { complaints.push(x.join(" ")); own(...x); };
}
</script>"""
HARNESS = """<!DOCTYPE html><html><body><script>
(async () => {
  const found = [];
  for (const width of WIDTHS) for (const page of PAGES) {
    const frame = document.createElement("iframe");
    const loaded = new Promise(done => { frame.onload = done; });
    frame.style = `width: ${width}px; height: 900px; border: 0`;
    frame.src = page;
    document.body.append(frame);
    await loaded;
    const inside = frame.contentWindow;
    const root = inside.document.documentElement;
    const look = await inside.eval(LOOK);
    const overflow = root.scrollWidth - root.clientWidth;
    found.push({page, width, overflow, complaints: inside.complaints, look});
    frame.remove();
  }
  await fetch("/report", {method: "POST", body: JSON.stringify(found)});
})().catch(e => fetch("/report", {method: "POST", body: JSON.stringify(String(e.stack))}));
</script></body></html>"""


class Handler(SimpleHTTPRequestHandler):
    """A folder whose pages carry the probe, the page that opens all others, and the place for the report."""

    def __init__(
        self, *arguments: Any, scripts: str, harness: str, report: list[Any], done: threading.Event, **options
    ):
        self.scripts, self.harness, self.report, self.done = scripts, harness, report, done
        super().__init__(*arguments, **options)

    def do_GET(self) -> None:
        file = Path(self.translate_path(self.path))
        if self.path == "/harness":
            self.answer(self.harness)
        elif self.path == "/favicon.ico":
            self.answer("")
        elif file.suffix == ".html" and file.is_file():
            self.answer(file.read_text(encoding="utf-8").replace("<head>", f"<head>{PROBE}{self.scripts}", 1))
        else:
            super().do_GET()

    def do_POST(self) -> None:
        self.report.append(json.loads(self.rfile.read(int(self.headers["Content-Length"]))))
        self.answer("")
        self.done.set()

    def answer(self, text: str) -> None:
        content = text.encode()
        self.send_response(200)
        self.send_header("Content-Type", "text/html; charset=utf-8")
        self.send_header("Content-Length", str(len(content)))
        self.end_headers()
        self.wfile.write(content)

    def log_message(self, format: str, *arguments: Any) -> None:
        pass


def browse(
    folder: Path, pages: Sequence[str], widths: Sequence[int], look: str, profile: Path, scripts: str = ""
) -> list[dict[str, Any]]:
    """Return page, width, overflow, complaints and what ``look`` is, a JavaScript expression, for each page and width.

    Skips the test where no browser is installed. Fails on every message in the browser's console.
    """
    browser = next(filter(None, map(shutil.which, BROWSERS)), None)
    if browser is None:
        pytest.skip(f"no browser is installed: none of {', '.join(BROWSERS)} is on the path")
    harness = HARNESS.replace("PAGES", json.dumps([f"/{page}" for page in pages])).replace("LOOK", json.dumps(look))
    harness = harness.replace("WIDTHS", json.dumps(list(widths)))
    report, done = [], threading.Event()
    handler = partial(Handler, directory=str(folder), scripts=scripts, harness=harness, report=report, done=done)
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        words = [
            browser, "--headless=new", "--no-sandbox", "--disable-gpu", "--enable-logging=stderr", "--hide-scrollbars",
            f"--user-data-dir={profile}", "--window-size=1600,1000", "--remote-debugging-port=0",
            f"http://127.0.0.1:{server.server_port}/harness",
        ]  # fmt: skip
        log = profile.with_suffix(".log")
        with log.open("w") as errors, subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=errors) as process:
            finished = done.wait(timeout=600.0)
            process.terminate()
        server.shutdown()
    text = log.read_text(encoding="utf-8", errors="replace")
    assert finished, text[-2000:]
    assert isinstance(report[0], list), report[0]
    said = [line for line in text.splitlines() if ":CONSOLE" in line and "[PST]" not in line]  # but the theme's log
    assert not said, "\n".join(said)
    return report[0]
