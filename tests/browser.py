"""Pages of a folder in one headless browser, at several widths: what a script finds on each, and every complaint."""

from __future__ import annotations

import json
import shutil
import subprocess
import threading
from collections.abc import Sequence
from contextlib import suppress
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from queue import Empty, Queue
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
    """The files of a folder, and the place for the report."""

    extensions_map = SimpleHTTPRequestHandler.extensions_map | {".html": "text/html; charset=utf-8"}

    def __init__(self, *arguments: Any, reports: Queue[Any], **options: Any):
        self.reports = reports
        super().__init__(*arguments, **options)

    def do_POST(self) -> None:
        self.reports.put(json.loads(self.rfile.read(int(self.headers["Content-Length"]))))
        self.send_response(204)
        self.end_headers()

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
    (folder / "harness.html").write_text(harness.replace("WIDTHS", json.dumps(list(widths))), encoding="utf-8")
    (folder / "favicon.ico").touch()
    for page in pages:  # each with the probe
        content = (folder / page).read_text(encoding="utf-8")
        (folder / page).write_text(content.replace("<head>", f"<head>{PROBE}{scripts}", 1), encoding="utf-8")
    reports, report, log = Queue[Any](), None, profile.with_suffix(".log")
    with ThreadingHTTPServer(("127.0.0.1", 0), partial(Handler, directory=str(folder), reports=reports)) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        words = [
            browser, "--headless=new", "--no-sandbox", "--disable-gpu", "--enable-logging=stderr", "--hide-scrollbars",
            f"--user-data-dir={profile}", "--window-size=1600,1000", "--remote-debugging-port=0",
            f"http://127.0.0.1:{server.server_port}/harness.html",
        ]  # fmt: skip
        with log.open("w") as errors, subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=errors) as process:
            with suppress(Empty):
                report = reports.get(timeout=600.0)
            process.terminate()
        server.shutdown()
    text = log.read_text(encoding="utf-8", errors="replace")
    assert isinstance(report, list), report or text[-2000:]
    said = [line for line in text.splitlines() if ":CONSOLE" in line and "[PST]" not in line]  # but the theme's log
    assert not said, "\n".join(said)
    return report
