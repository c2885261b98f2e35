"""The site builds without a warning, asks no other machine for anything, and stays true."""

import os
import re
import subprocess
import sys
from importlib import util
from pathlib import Path

import pytest

import marl_clean
from marl_clean.config.levels import groups, rooms

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = sorted(DOCS.glob("*.md"))
# What a browser fetches by itself when it shows a page; links that a reader clicks may lead out.
FETCHED = re.compile(
    r"""<(?:img|script|iframe|source|video)\b[^>]*\bsrc=["']?(?:https?:)?//"""
    r"""|<link\b(?![^>]*rel=["']?(?:canonical|prev|next))[^>]*\bhref=["']?(?:https?:)?//"""
    r"""|url\(["']?(?:https?:)?//|@import"""
)


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    if util.find_spec("mkdocs") is None or util.find_spec("mkdocstrings") is None:
        pytest.skip("needs the extra docs")
    folder = tmp_path_factory.mktemp("site")
    result = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--quiet", "--strict", "--site-dir", str(folder)],
        capture_output=True,
        text=True,
        cwd=ROOT,
        env={**os.environ, "NO_MKDOCS_2_WARNING": "1", "PYTHONPATH": str(ROOT)},
        check=False,
    )
    assert (result.returncode, result.stdout, result.stderr) == (0, "", "")
    return folder


@pytest.mark.long
def test_it_builds_without_a_warning(site: Path) -> None:
    assert {path.stem for path in PAGES} <= {path.stem for path in site.glob("*.html")}
    assert not list(site.rglob("*.py"))


@pytest.mark.slow
def test_its_pages_fetch_nothing_from_elsewhere(site: Path) -> None:
    sources = [*site.rglob("*.html"), *site.rglob("*.css")]
    assert [path.name for path in sources if FETCHED.search(path.read_text())] == []


@pytest.mark.slow
def test_every_level_and_preset_stands_on_the_configuration_page(site: Path) -> None:
    text = (site / "configuration.html").read_text()
    levels = {f"{room}={level}" for room, names in rooms().items() for level in names}
    presets = {f"+experiment={name}" for name in groups()["experiment"]}
    assert {name for name in levels | presets if f"<code>{name}</code>" not in text} == set()
    assert "<!--" not in text.partition("Every setting")[2].partition("</article>")[0]


@pytest.mark.parametrize(
    "fetches",
    [
        '<script src="https://cdn.example/x.js">',
        '<link rel="stylesheet" href="//fonts.example/x.css">',
        "src: url(https://fonts.example/x.woff2)",
    ],
)
def test_what_would_be_fetched_is_seen(fetches: str) -> None:
    assert FETCHED.search(fetches)
    assert not FETCHED.search('<a href="https://hydra.cc">Hydra</a>')


def test_the_glossary_is_short() -> None:
    assert len((DOCS / "glossary.md").read_text().splitlines()) <= 40


TEXTS = [*PAGES, ROOT / "README.md", ROOT / "CONTRIBUTING.md"]
OF_AN_EXAMPLE = ("mean", "my_package")


@pytest.mark.parametrize("page", TEXTS, ids=lambda page: page.name)
def test_files_and_modules_that_pages_name_exist(page: Path) -> None:
    text = page.read_text()
    paths = re.findall(r"`((?:marl_clean|conf|tests|weights|examples|docs)/[\w./-]*)`", text)
    modules = re.findall(r"`(marl_clean(?:\.[a-z_0-9]+)+)", text)
    paths += [module.replace(".", "/") for module in modules]
    paths = [path for path in paths if not any(name in path for name in OF_AN_EXAMPLE)]
    assert [path for path in paths if not is_there(path)] == []


@pytest.mark.parametrize("page", TEXTS, ids=lambda page: page.name)
def test_python_names_that_pages_call_exist(page: Path) -> None:
    blocks = "\n".join(re.findall(r"```python\n(.*?)```", page.read_text(), re.S))
    called = set(re.findall(r"\bmarl_clean\.(\w+)\(", blocks))
    assert called <= set(marl_clean.__all__)


def is_there(path: str) -> bool:
    """Whether it is a file or folder, a module, or a name that a module has."""
    parent, _, name = path.rpartition("/")
    if (ROOT / path).exists() or (ROOT / f"{path}.py").is_file():
        return True
    within = (ROOT / f"{parent}.py", ROOT / parent / "__init__.py")
    return any(file.is_file() and re.search(rf"\b{name}\b", file.read_text()) for file in within)


def test_a_file_that_is_not_there_is_seen() -> None:
    assert is_there("marl_clean/comm/base.py") and is_there("marl_clean/make_env")
    assert not is_there("marl_clean/comm/basis.py") and not is_there("marl_clean/pettingzoo/nope")


SETTING = re.compile(r"(?:^|[\s+])([a-z_]+)=([a-z_0-9]+(?:,[a-z_0-9]+)*)")


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_settings_that_pages_name_exist(page: Path) -> None:
    """Every `room=level` and `+experiment=NAME` in code."""
    known = {room: set(levels) for room, levels in groups().items()}
    for spans in re.findall(r"`([^`]+)`|^(marl-clean .*)$", page.read_text(), re.M):
        for room, levels in re.findall(SETTING, " ".join(spans)):
            if room in known:
                unknown = set(levels.split(",")) - known[room] - {*OF_AN_EXAMPLE}
                assert unknown == set(), f"{page.name}: {room}={levels}"
