"""The report's page in a headless Chromium: frame times of a scrubbed replay, size and opening.

`python -m tests.benchmark.page [RUNS...]` plays 8 robots in a 40x40 house, a map each, in two
panels, and scrubs through the episode, another step in every frame of the screen. With runs it also
writes the pages of 1, of 10 and of all of them.
"""

import json
import re
import resource
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Sequence
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from statistics import quantiles
from typing import Any

from rich.table import Table

from marl_clean.evaluation.table import output
from tests.report.pages import BROWSERS

SCRUBBED = ["house=rooms", "house.rows=[40,40]", "house.cols=[40,40]", "env.n_agents=8"]
SCRUBBED += ["env.memory=private", "planner=nearest_unknown"]
FRAMES = 600  # drawn, forwards, backwards and at random
OPENINGS = 3
POLICY = re.compile(r'<meta http-equiv="Content-Security-Policy"[^>]*>')
SCRUB = f"""
  const player = window.player, last = Number(player.slider.max);
  player.panels.forEach((side, index) => {{ side.view.selectedIndex = index; }});
  const between = [], drawing = [];
  let frame = 0, before = null;
  const next = (now) => {{
    if (before !== null) between.push(now - before);
    before = now;
    if (frame === {FRAMES}) return answer({{between, drawing, last}});
    const part = Math.floor((3 * frame) / {FRAMES});
    const step = part === 2 ? Math.floor(Math.random() * last) : frame % last;
    const began = performance.now();
    player.go(part === 1 ? last - step : step);
    drawing.push(performance.now() - began);
    frame += 1;
    requestAnimationFrame(next);
  }};
  requestAnimationFrame(next);
"""
OPEN = """
  const [opened] = performance.getEntriesByType("navigation");
  requestAnimationFrame(() => answer([opened.loadEventStart, performance.now()]));
"""


def ask(page: Path, script: str) -> Any:
    """What a page answers in real time; `answer(value)` in the script ends it.

    The page is served without its content policy, which would forbid it to send the answer.
    """
    asking = f"""<script>window.addEventListener("load", () => setTimeout(() => {{
      const answer = (value) => fetch("/answer", {{method: "POST", body: JSON.stringify(value)}});
      {script} }}));</script></body>"""
    content = POLICY.sub("", page.read_text(encoding="utf-8")).replace("</body>", asking).encode()
    answers: list[bytes] = []
    answered = threading.Event()

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(200)
            self.send_header("Content-Type", "text/html; charset=utf-8")
            self.end_headers()
            self.wfile.write(content)

        def do_POST(self) -> None:
            answers.append(self.rfile.read(int(self.headers["Content-Length"])))
            self.send_response(204)
            self.end_headers()
            answered.set()

        def log_message(self, format: str, *args: Any) -> None:
            """Say nothing."""

    server = HTTPServer(("127.0.0.1", 0), Handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    name = next(path for path in map(shutil.which, BROWSERS) if path)
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        command = [name, "--headless", "--no-sandbox", "--disable-gpu", "--window-size=1200,900"]
        command += [f"--user-data-dir={profile}", f"http://127.0.0.1:{server.server_port}/"]
        command += ["--remote-debugging-port=0"]  # else it ends when the page has loaded
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            if not answered.wait(180):
                raise TimeoutError(f"{page}: no answer from the browser")
        finally:
            process.terminate()
            process.wait()
            server.shutdown()
    return json.loads(answers[0])


def scrubbed(folder: Path) -> Table:
    """Frame times of a replay in a large house, with two panels."""
    from marl_clean import build
    from marl_clean.config.compose import compose_config
    from marl_clean.report.episode import first_held_out
    from marl_clean.report.html import render
    from marl_clean.report.recording import record

    cfg = compose_config(SCRUBBED)
    episode = record(first_held_out(cfg), lambda env: build.make_planner(cfg, env))
    page = folder / "replay.html"
    named = [{**episode, "policy": name} for name in ("first", "second")]
    page.write_text(render("replay", [], [], named), encoding="utf-8")
    answer = ask(page, SCRUB)
    size = page.stat().st_size / 1e6
    table = Table(title=f"8 robots, 40x40, {answer['last']} steps, two panels, {size:.1f} MB")
    for title in ("ms", "median", "95 %", "99 %", "longest"):
        table.add_column(title, justify="right")
    for name, values in (("between frames", answer["between"]), ("drawing", answer["drawing"])):
        of_hundred = quantiles(values, n=100)
        cells = (of_hundred[49], of_hundred[94], of_hundred[98], max(values))
        table.add_row(name, *(f"{cell:.1f}" for cell in cells))
    return table


def sizes(runs: Sequence[str], folder: Path) -> Table:
    """What pages of 1, 10 and all runs weigh, take to write and to open."""
    table = Table(title="pages")
    titles = ("runs", "parts", "MB", "CPU s", "written in s", "loaded in s", "drawn in s")
    for title in titles:
        table.add_column(title, justify="right")
    for count in sorted({1, min(10, len(runs)), len(runs)}):
        page = folder / f"{count}.html"
        command = [sys.executable, "-m", "marl_clean", "report", *runs[:count], "--out", str(page)]
        began, spent = time.perf_counter(), _of_children()
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        seconds, spent = time.perf_counter() - began, _of_children() - spent
        opened = [ask(page, OPEN) for _ in range(OPENINGS)]
        loaded, drawn = (sorted(times)[OPENINGS // 2] / 1e3 for times in zip(*opened, strict=True))
        parts = page.read_text(encoding="utf-8").count("<section")
        numbers = (page.stat().st_size / 1e6, spent, seconds, loaded, drawn)
        table.add_row(str(count), str(parts), *(f"{number:.2f}" for number in numbers))
    return table


def _of_children() -> float:
    """Seconds of CPU that ended child processes took, in user and system mode."""
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def main(runs: Sequence[str]) -> None:
    console = output()
    with tempfile.TemporaryDirectory() as folder:
        console.print(scrubbed(Path(folder)))
        if runs:
            console.print(sizes(runs, Path(folder)))


if __name__ == "__main__":
    main(sys.argv[1:])
