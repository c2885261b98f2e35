"""Pages in a headless Chromium: what a script finds there is read from the DOM that it leaves."""

import json
import re
import shutil
import subprocess
from html import unescape
from pathlib import Path
from typing import Any

import pytest

BROWSERS = ("chromium", "chromium-browser", "google-chrome")
NARROWEST = 500  # pixels of a window; a narrower page stands in a frame
RESULT = re.compile(r'<pre id="result">(.*?)</pre>', re.DOTALL)


def browser() -> str:
    """The browser, or the test is skipped."""
    for name in BROWSERS:
        if path := shutil.which(name):
            return path
    pytest.skip("needs chromium")


def ask(page: Path, script: str, width: int = 1000, fragment: str = "") -> tuple[Any, str]:
    """What a script finds in a page: the JSON of its value, and what the browser had to say.

    The script is a function's body. It runs when the page has loaded, in a copy beside the page.
    """
    asking = f"""
<script>
window.addEventListener("load", () => {{
  let found;
  try {{ found = (() => {{ {script} }})(); }} catch (error) {{ found = {{error: String(error)}}; }}
  const text = JSON.stringify(found);
  if (window.parent !== window) return window.parent.postMessage(text, "*");
  const result = document.createElement("pre");
  result.id = "result";
  result.textContent = text;
  document.body.append(result);
}});
</script>"""
    asked = page.with_name(f"asked-{page.name}")
    text = page.read_text(encoding="utf-8").replace("</body>", f"{asking}</body>")
    asked.write_text(text, encoding="utf-8")
    if width < NARROWEST:
        asked = _framed(asked, width)
    command = [
        *(browser(), "--headless", "--no-sandbox", "--disable-gpu", "--dump-dom"),
        *("--enable-logging=stderr", "--v=0", f"--window-size={max(width, NARROWEST)},900"),
        *("--virtual-time-budget=4000", f"--user-data-dir={page.parent / 'profile'}"),
        asked.as_uri() + fragment,
    ]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)
    match = RESULT.search(done.stdout)
    assert match is not None, done.stdout[-2000:]
    said = [line for line in done.stderr.splitlines() if "CONSOLE" in line]
    return json.loads(unescape(match[1])), "\n".join(said)


def _framed(page: Path, width: int) -> Path:
    """A page that shows another in a frame of this width, and writes down what it finds."""
    frame = page.with_name(f"framed-{page.name}")
    frame.write_text(
        f"""<!doctype html><body><script>
window.addEventListener("message", (event) => {{
  const result = document.createElement("pre");
  result.id = "result";
  result.textContent = event.data;
  document.body.append(result);
}});
</script><iframe src="{page.name}" style="border: 0; width: {width}px; height: 900px"></iframe>"""
    )
    return frame
