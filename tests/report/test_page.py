"""The page shows what the files say, asks nobody, and is played by keyboard alone."""

import json
import random
import re
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from marl_clean import build
from marl_clean.commands import report
from marl_clean.commands.command_line import issued
from marl_clean.config.compose import compose_config
from marl_clean.errors import BadInput
from marl_clean.report.chart import Axis, Chart
from marl_clean.report.episode import first_held_out
from marl_clean.report.html import Part, render
from marl_clean.report.plots import Plot
from marl_clean.report.recorded import REPLAY
from marl_clean.report.recording import make_recording, record
from tests.commands.test_compare import write_run
from tests.report.pages import ask

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("unchecked")]  # browsers start

QUIET = Console(quiet=True)
SMALL = ["house=rooms", "house.rows=[7,7]", "house.cols=[9,9]", "env.n_agents=3"]
HACK = "window.hacked=1"
TAGS = ("script", "img", "svg", "iframe", "body", "style", "math", "details", "video", "a", "input")
ATTRIBUTES = (
    f"src=x onerror={HACK}",
    f"onload={HACK}",
    f"autofocus tabindex=0 onfocus={HACK}",
    f"href=javascript:{HACK}",
    f"open ontoggle={HACK}",
    f"style=animation:x onanimationstart={HACK}",
)
ENDS = ("", '">', "'>", "</script>", "--></style></title>", "]]></svg></text></table>")
PAYLOADS = (  # every tag after every end of what a name may stand in, with one of the attributes
    *(
        f"{end}<{tag} {ATTRIBUTES[(place + other) % len(ATTRIBUTES)]}>{HACK}</{tag}>"
        for place, tag in enumerate(TAGS)
        for other, end in enumerate(ENDS)
    ),
    *(f"'-{HACK}-'", f"javascript:{HACK}", f"<!--<script>{HACK}", "&lt;b&gt;&#60;i>", "\\u003cb>"),
)
COUNT = """
  return [document.querySelectorAll("*").length, window.hacked === undefined,
    document.body.textContent, document.title];
"""


def recordings() -> list[dict[str, Any]]:
    """Two episodes, of a planner on a shared map and of a policy that talks on private maps."""
    shared = compose_config([*SMALL, "env.max_steps=40"])
    private = compose_config([*SMALL, "env.memory=private", "env.max_steps=25"])
    agent = build.make_agent(private, build.make_env(private))
    policy = agent.policy()
    return [
        {
            "policy": "planner",
            **record(first_held_out(shared), lambda env: build.make_planner(shared, env)),
        },
        {"policy": "talks", **record(first_held_out(private), lambda env: policy)},
    ]


@pytest.fixture(scope="module")
def episodes() -> list[dict[str, Any]]:
    return recordings()


@pytest.fixture
def player(tmp_path: Path, episodes: list[dict[str, Any]]) -> Path:
    page = tmp_path / "page.html"
    page.write_text(render("replays", [], [], episodes), encoding="utf-8")
    return page


@pytest.mark.long
def test_robots_are_where_the_record_says_at_every_moment(
    player: Path, episodes: list[dict[str, Any]]
) -> None:
    moments = random.Random(0).sample(range(26), 20)
    script = f"""
      return {moments}.map((step) => {{
        window.player.go(step);
        return window.player.panels.map((side) => side.house.getAttribute("aria-label"));
      }});
    """
    found, said = ask(player, script)
    assert said == ""
    for step, labels in zip(moments, found, strict=True):
        for episode, label in zip(episodes, labels, strict=True):
            numbers = [int(number) for number in re.findall(r"(?:row|column) (\d+)", label)]
            at = min(step, len(episode["contacts"]))
            assert numbers == episode["positions"][at]


def test_a_robots_disc_is_drawn_where_it_stands(
    player: Path, episodes: list[dict[str, Any]]
) -> None:
    script = """
      window.player.go(12);
      const side = window.player.panels[0], canvas = side.house;
      const episode = window.player.episode(side), cell = canvas.width / episode.cols;
      return [0, 1, 2].map((robot) => {
        const [row, col] = episode.place(12, robot).map((at) => (at + 0.5) * cell);
        const pixel = canvas.getContext("2d").getImageData(col - cell * 0.3, row, 1, 1);
        return Array.from(pixel.data.slice(0, 3));
      });
    """
    found, _ = ask(player, script)
    colours = [[0, 114, 178], [213, 94, 0], [0, 140, 102]]
    places = [tuple(episodes[0]["positions"][12][2 * i : 2 * i + 2]) for i in range(3)]
    assert len(set(places)) == 3
    for colour, wanted in zip(found, colours, strict=True):
        assert all(abs(a - b) < 40 for a, b in zip(colour, wanted, strict=True)), (found, places)


def test_any_step_can_be_reached_in_any_order(player: Path) -> None:
    """A matrix at a step is the same whether the steps before it were shown or not."""
    script = """
      const side = window.player.panels[1], episode = window.player.episode(side);
      return episode.matrices.map((matrix) => {
        const codes = matrix.snapshots[0].slice();
        const same = [true];
        for (let step = 1; step <= episode.steps; step++) {
          const changed = matrix.changes[step - 1];
          for (let i = 0; i < changed.length; i += 2) codes[changed[i]] = changed[i + 1];
          same.push(String(codes) === String(matrix.at(step)));
        }
        return same.every((equal) => equal) && matrix.at(episode.steps).length;
      });
    """
    found, _ = ask(player, script)
    assert found == [63] * 4  # the house and three maps


def test_the_keyboard_alone_reaches_everything(
    player: Path, episodes: list[dict[str, Any]]
) -> None:
    script = """
      const root = document.querySelector(".player"), steps = [];
      const press = (key, shiftKey = false) => {
        root.dispatchEvent(new KeyboardEvent("keydown", {key, shiftKey, bubbles: true}));
        steps.push(window.player.step);
      };
      press("ArrowRight"); press("ArrowRight", true); press("ArrowLeft"); press("PageDown");
      press("End"); press("PageUp"); press("Home"); press(" ");
      const playing = window.player.timer !== null;
      press(" ");
      const reachable = [...root.querySelectorAll("button, input, select, a")];
      return {
        steps, playing, paused: window.player.timer === null,
        reachable: reachable.every((each) => each.tabIndex >= 0) && root.tabIndex === 0,
      };
    """
    found, said = ask(player, script)
    assert said == ""
    last = max(len(episode["contacts"]) for episode in episodes)
    assert found["steps"][:7] == [1, 11, 10, 20, last, last - 10, 0]
    assert found["playing"] and found["paused"] and found["reachable"]


def test_a_link_leads_to_a_moment(player: Path) -> None:
    script = """
      const link = document.querySelector("a.moment").getAttribute("href");
      return [link, window.player.step, window.player.panels.map((side) => side.policy.value)];
    """
    found, _ = ask(player, script, fragment="#replay=1,0&step=17")
    assert found == ["#replay=1,0&step=17", 17, ["1", "0"]]
    nonsense, said = ask(player, script, fragment="#replay=7,x&step=-3e")
    assert nonsense[1:] == [0, ["0", "1"]] and said == ""


def test_names_of_sixty_kinds_are_text_and_no_markup(
    tmp_path: Path, episodes: list[dict[str, Any]]
) -> None:
    """Every place of a page that shows a name from a file, with all payloads and with none."""
    assert len(set(PAYLOADS)) >= 60
    plain = [f"name {index}" for index in range(len(PAYLOADS))]
    found = {}
    for kind, names in (("payloads", list(PAYLOADS)), ("plain", plain)):
        chart = Chart(Axis(names[0]), Axis(names=names), names=dict(enumerate(names)))
        for row, name in enumerate(names):
            chart.line(row, [0, row], [row, row], title=name)
        plots = [Plot(names[0], chart, [[name] * 2 for name in names])]
        parts = [Part(name, name, [(name, [names[:2], [name] * 2])], plots) for name in names[:3]]
        parts += [Part(name, name, [(name, [[name] * 2] * 2)]) for name in names[3:]]
        named = [{**episodes[0], "policy": name} for name in names]
        page = tmp_path / f"{kind}.html"
        page.write_text(render(names[1], names, parts, named), encoding="utf-8")
        found[kind], said = ask(page, COUNT)
        assert said == "" and found[kind][1]
    assert found["payloads"][0] == found["plain"][0]
    assert found["payloads"][3] == PAYLOADS[1]
    assert all(payload in found["payloads"][2] for payload in PAYLOADS)


def test_files_with_sixty_kinds_of_names_make_no_markup(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The planners of a run, its set of houses and their paths, as a stranger's file names them."""
    monkeypatch.chdir(tmp_path)
    counts = []
    for kind in ("payloads", "plain"):
        names = [name if kind == "payloads" else "name" for name in PAYLOADS]
        run = Path(write_run(tmp_path / kind, [], [40, 60]))
        own, rival = json.loads((run / "evaluation.json").read_text())
        for entry in (own, rival):
            entry["house_set"] = names[0]
            for house, path in zip(entry["houses"], names, strict=False):
                house["path"] = path
        rivals = [{**rival, "policy": f"{name}{index}"} for index, name in enumerate(names)]
        (run / "evaluation.json").write_text(json.dumps([own, rival, *rivals]))
        page = report.main([str(run)], tmp_path / f"{kind}.html", QUIET)
        found, said = ask(page, COUNT)
        assert said == "" and found[1]
        assert all(f"{name}{index}" in found[2] for index, name in enumerate(names))
        counts.append(found[0])
    assert counts[0] == counts[1]


def test_two_settings_with_one_label_stay_apart(tmp_path: Path) -> None:
    """In worlds of their own both are called by what their runs' names share."""
    runs = [
        write_run(tmp_path / f"any-{index}", [f"env.decay_steps={steps}"], [40, 60], 10 * index)
        for index, steps in enumerate((200, 100))
    ]
    for index, run in enumerate(runs):
        entries = Path(run, "evaluation.json")
        text = entries.read_text().replace(f"any-{index}", "any")
        entries.write_text(text)
        config = Path(run, "config.yaml")
        config.write_text(config.read_text().replace(f"any-{index}", "any"))
    names, settings = report.names_of(report.gather(runs).values())
    assert names == [{"any": "A"}, {"any": "B"}]
    assert settings == [["policy", "env.decay_steps"], ["A", "200"], ["B", "100"]]


def test_it_fits_a_narrow_screen(player: Path) -> None:
    script = """
      return [document.documentElement.scrollWidth, window.innerWidth, document.body.scrollWidth];
    """
    (wide, window, body), said = ask(player, script, width=400)
    assert window == 400 and max(wide, body) <= 400 and said == ""


def test_a_report_of_runs_shows_their_numbers_and_asks_nobody(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("runs").mkdir()
    runs = [
        write_run(tmp_path / "runs" / "plan-s0", ["seed=0"], [40, 60]),
        write_run(tmp_path / "runs" / "plan-s1", ["seed=1"], [80, None]),
        write_run(tmp_path / "runs" / "none-s0", ["comm=none"], [50, 50]),
    ]
    metrics = "frames,validation/T_100,validation/finished\n100,90.5,0.5\n200,60,1\n"
    Path(runs[0], "metrics.csv").write_text(metrics)
    Path(runs[1], "metrics.csv").write_text("nothing")
    cfg = compose_config([*SMALL, "env.max_steps=9"])
    make_recording(cfg, lambda env: build.make_planner(cfg, env), Path(runs[0]) / REPLAY)
    Path(runs[1], REPLAY).write_text("{")
    Path("runs/empty").mkdir()
    page = report.main([*runs, "runs/empty"], console=QUIET)
    assert page == Path("runs/report.html")
    lines = [record.getMessage() for record in caplog.records]
    assert sum("runs/empty" in line for line in lines) == 1
    for damaged in ("plan-s1/metrics.csv", f"plan-s1/{REPLAY}"):
        assert sum(damaged in line for line in lines) == 1
    text = page.read_text(encoding="utf-8")
    outside = [url for url in re.findall(r"\w+://[^\s\"'<>)]+", text) if "w3.org" not in url]
    assert outside == []
    script = """
      const tables = [...document.querySelectorAll("table")].map((table) => ({
        caption: table.caption.textContent,
        rows: [...table.rows].map((row) => [...row.cells].map((cell) => cell.textContent)),
      }));
      const requests = performance.getEntriesByType("resource").map((entry) => entry.name);
      const ids = [...document.querySelectorAll("[id]")].map((each) => each.id);
      const replays = [...document.querySelector("select.policy").options].map((o) => o.text);
      return {tables, requests, replays, doubled: ids.filter((id, at) => ids.indexOf(id) !== at)};
    """
    found, said = ask(page.resolve(), script)
    assert said == "" and found["requests"] == [] and found["doubled"] == []
    assert found["replays"] == [f"comm=plan: {cfg.name}"]
    tables = {table["caption"]: table["rows"] for table in found["tables"]}
    measures = tables["Measures"]
    assert [row[0] for row in measures[1:]] == [
        "comm=plan (2 seeds)",
        "comm=none",
        "nearest_unknown",
    ]
    # The houses of both seeds, the unfinished one at its max_steps.
    assert measures[1][4].startswith(f"{(40 + 60 + 80 + 250) / 4:.1f} [")
    assert measures[1][1] == "75.0 %" and measures[3][4].startswith("50.0 [")
    assert tables["Settings"] == [["policy", "comm"], ["comm=plan", "plan"], ["comm=none", "none"]]
    assert "comm=plan" in [row[0] for row in tables["T_100 on validation houses while learning"]]
    # One run's cells are those of its file.
    own = json.loads(Path(runs[2], "evaluation.json").read_text())[0]["summary"]
    [silent] = [row for row in measures if row[0] == "comm=none"]
    for column, measure in ((2, "T_90"), (4, "T_100")):
        low, high = own[measure]["ci95"]
        assert silent[column] == f"{own[measure]['mean']:.1f} [{low:.1f}, {high:.1f}]"
    assert silent[6:8] == ["100.0 %", f"{own['redundancy']['mean']:.2f}"]
    # Wide tables scroll by themselves, and with the keyboard.
    narrow = """
      const wide = [...document.querySelectorAll(".wide")];
      return [document.documentElement.scrollWidth, window.innerWidth, document.body.scrollWidth,
        wide.every((each) => each.tabIndex === 0)];
    """
    (page_width, window, body, scrolls), _ = ask(page.resolve(), narrow, width=400)
    assert window == 400 and max(page_width, body) <= 400 and scrolls


def test_no_finished_run_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(BadInput, match="no finished run among nothing"):
        report.main(["nothing"], console=QUIET)
    assert not Path("runs").exists()


def test_numbers_in_a_script_element_cannot_end_it() -> None:
    page = render("x", [], [], [{"policy": "</script>&<b>", "house": "0"}])
    data = page.partition('id="recordings">')[2].partition("</script>")[0]
    assert json.loads(data) == [{"policy": "</script>&<b>", "house": "0"}]


def test_every_chart_of_a_page_names_the_command_and_the_configs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    run = write_run(tmp_path / "run", [], [40, 60])
    with issued(["report", "a<b>"]):
        page = report.main([run], tmp_path / "page.html", Console(quiet=True)).read_text()
    charts = page.count('<svg role="img"')
    assert charts > 2
    origin = "<metadata>marl-clean report &#x27;a&lt;b&gt;&#x27;\nconfig sha256 hash</metadata>"
    assert page.count(origin) == page.count("<metadata>") == charts
