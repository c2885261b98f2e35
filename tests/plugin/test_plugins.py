"""Plugins: what they bring, what is refused in a line, and that nothing of them is imported."""

import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from omegaconf import OmegaConf

from marl_clean import cli
from marl_clean.commands import listing, sweep
from marl_clean.config import compose, locate
from marl_clean.config.levels import rooms
from marl_clean.config.schema import instantiate
from marl_clean.config.stored import load_config
from marl_clean.errors import BadInput
from marl_clean.python.keywords import overrides_of

EXPLODES = "raise SystemExit('imported')\n"
SCHEME = '''"""A scheme."""
from marl_clean.comm.none import Silent


class Hush(Silent):
    """Says nothing at all."""

    def __init__(self, in_features, softly: bool) -> None:
        super().__init__(in_features)
'''
HUSH = "_target_: PACKAGE.schemes.Hush\nsoftly: true\n"
FILES = {
    "__init__.py": EXPLODES,
    "schemes.py": EXPLODES + SCHEME + "\n\nclass Other(Hush):\n    pass\n",
    "conf/comm/hush.yaml": HUSH,
}
Make = Callable[..., str]


@pytest.fixture
def make(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Make]:
    """Write a package that explodes when it is imported; return its name."""
    site = tmp_path / "site with a space"
    site.mkdir()
    monkeypatch.syspath_prepend(str(site))

    def write(name: str = "hushed", **files: str | None) -> str:
        for path, text in {**FILES, **files}.items():
            if text is not None:
                file = site.joinpath(*name.split("."), path)
                file.parent.mkdir(parents=True, exist_ok=True)
                file.write_text(text.replace("PACKAGE", name), encoding="utf-8")
        return name

    yield write
    for module in [module for module in sys.modules if module.split(".")[0] == "hushed"]:
        del sys.modules[module]


def run(capsys: pytest.CaptureFixture, *arguments: str) -> tuple[int, str, str]:
    code = cli.main(list(arguments))
    captured = capsys.readouterr()
    return code, captured.out, captured.err


@pytest.mark.slow
def test_its_levels_are_listed_helped_with_and_named_in_errors(make: Make, capsys) -> None:
    """And the package, which explodes, is not imported for it."""
    named = ("--plugin", make())
    code, out, _ = run(capsys, "list", *named)
    width = max(len(level) for level in (*rooms()["comm"], "hush"))
    assert code == 0 and f"  {'hush':<{width}}  Says nothing at all. (hushed)\n" in out
    with pytest.raises(SystemExit):
        cli.main(["train", *named, "--help"])
    assert "hush" in capsys.readouterr().out
    code, _, err = run(capsys, "train", *named, "comm=hussh")
    assert code == 2 and "did you mean hush?" in err
    code, _, err = run(capsys, "train", *named, "comm=hush", "comm.softly=3")
    assert code == 2 and err == "marl-clean: comm.softly: must be true or false, not 3\n"
    code, _, err = run(capsys, "train", *named, "comm=hush", "comm.loudly=true")
    assert code == 2 and "comm.loudly: no such key; " in err and "valid: softly" in err
    assert "hushed" not in sys.modules
    assert "hush" not in rooms()["comm"]  # out of the command it is not known


@pytest.mark.slow
def test_it_composes_without_import_and_no_other_hash_changes(make: Make) -> None:
    before = compose.compose_config().name
    with locate.plugins_in_use([make()]):
        assert compose.compose_config().name == before
        config = compose.compose_config(["comm=hush", "comm.softly=false"])
    assert config.comm == {"_target_": "hushed.schemes.Hush", "softly": False}
    assert config.name != before and "hushed" not in sys.modules


@pytest.mark.slow
def test_it_is_imported_when_a_level_is_made(make: Make) -> None:
    with locate.plugins_in_use([make()]):
        section = compose.compose_config(["comm=hush"]).comm
        with pytest.raises(SystemExit, match="imported"):
            instantiate(section, in_features=3)


@pytest.mark.slow
def test_it_lies_as_deep_as_it_likes(make: Make) -> None:
    name = make("hushed.of.others")
    with locate.plugins_in_use([name]):
        assert compose.compose_config(["comm=hush"]).comm._target_ == f"{name}.schemes.Hush"
    assert "hushed" not in sys.modules


@pytest.mark.slow
def test_presets_of_a_plugin_are_presets(make: Make) -> None:
    preset = "# @package _global_\ndefaults:\n  - override /comm: hush\nseed: 5\n"
    name = make(**{"conf/experiment/quiet.yaml": preset})
    with locate.plugins_in_use([name]):
        config = compose.compose_config(["+experiment=quiet"])
    assert config.comm.softly and config.seed == 5 and config.name.startswith("quiet-")


@pytest.mark.parametrize(
    ("files", "broken"),
    [
        ({"conf/kitchen/x.yaml": HUSH}, "plugin hushed: conf/kitchen is no room; valid: agent, "),
        ({"conf/comm/plan.yaml": HUSH}, "conf/comm/plan.yaml is a level of marl_clean already"),
        ({"conf/comm/hush.yaml": None}, "has no folder .*conf, so it brings no levels"),
    ],
)
def test_what_is_no_plugin_is_refused(make: Make, files: dict, broken: str) -> None:
    with pytest.raises(BadInput, match=broken), locate.plugins_in_use([make(**files)]):
        pass


def test_two_plugins_may_not_have_a_level_of_the_same_name(make: Make) -> None:
    names = [make(), make("hushed_too")]
    expected = "plugin hushed_too: conf/comm/hush.yaml is a level of hushed already"
    with pytest.raises(BadInput, match=expected), locate.plugins_in_use(names):
        pass
    assert locate.named_plugins() == []


@pytest.mark.parametrize(
    "name", ["", "../hushed", "hushed/", "marl_clean", "marl_clean.comm", "no"]
)
def test_names_of_no_plugin_are_refused(make: Make, name: str) -> None:
    make()
    with pytest.raises(BadInput, match="^plugin "), locate.plugins_in_use([name]):
        pass


def stored(folder: Path, config, **changes: str) -> Path:
    folder.mkdir()
    plain = OmegaConf.to_container(config)
    for room, target in changes.items():
        plain[room]["_target_"] = target
    OmegaConf.save(OmegaConf.create(plain), folder / "config.yaml")
    return folder


@pytest.mark.slow
def test_a_run_that_needs_a_plugin_names_it(make: Make, tmp_path: Path, capsys) -> None:
    with locate.plugins_in_use([make()]):
        folder = stored(tmp_path / "run", compose.compose_config(["comm=hush"]))
        assert load_config(folder)["comm"]["softly"] is True
    code, _, err = run(capsys, "evaluate", f"checkpoint={folder}")
    assert code == 2 and err.count("\n") == 1
    assert "comm._target_: " in err and "'hushed.schemes.Hush'" in err and "--plugin hushed" in err
    assert "hushed" not in sys.modules


@pytest.mark.slow
@pytest.mark.parametrize(
    ("room", "target"),
    [
        ("comm", "hushed.schemes.Other"),  # a class of the plugin that is no level
        ("comm", "hushed.Hush"),
        ("house", "hushed.schemes.Hush"),  # a level of another room
        ("comm", "os.system"),
        ("comm", "hushed_not.schemes.Hush"),
        ("comm", "hushed"),
    ],
)
def test_an_untrusted_config_imports_nothing_else(
    make: Make, tmp_path: Path, room: str, target: str
) -> None:
    with locate.plugins_in_use([make()]):
        folder = stored(tmp_path / "run", compose.compose_config(["comm=hush"]), **{room: target})
        with pytest.raises(
            BadInput, match=rf"{room}\._target_: must name the class of a level of "
        ):
            load_config(folder)
    assert "hushed" not in sys.modules and "hushed_not" not in sys.modules


@pytest.mark.slow
def test_jobs_of_a_sweep_know_the_plugins_in_whatever_process(make: Make, monkeypatch) -> None:
    tasks = []

    def launch(task: object, jobs: list, overrides: list) -> list[None]:
        tasks.append((task, jobs))
        return [None] * len(jobs)

    monkeypatch.setattr(sweep, "launch", launch)
    with locate.plugins_in_use([make()]):
        assert sweep.run(["comm=hush,none", "seed=0"]) == 1  # nothing was trained
    [(task, jobs)] = tasks
    assert task.keywords["plugins"] == ["hushed"] and len(jobs) == 2


def test_without_plugins_no_line_of_the_list_is_marked() -> None:
    assert not [line for line in listing.lines() if line.endswith("(hushed)")]


@pytest.mark.slow
def test_the_python_door_takes_plugins(make: Make) -> None:
    name = make()
    with locate.plugins_in_use([]):  # so that nothing stays known
        config = compose.compose_config(overrides_of(None, {"comm": "hush", "plugins": [name]}))
        assert config.comm._target_ == "hushed.schemes.Hush"
        assert locate.named_plugins() == [name]
        with pytest.raises(BadInput, match=r"plugins: give a list, such as \['hushed'\]"):
            overrides_of(None, {"plugins": name})
    assert locate.named_plugins() == []
