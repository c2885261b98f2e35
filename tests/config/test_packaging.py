"""The wheel and the editable install both find their configs."""

import os
import subprocess
import sys
import sysconfig
import zipfile
from pathlib import Path

import pytest
from hatchling.build import build_editable, build_wheel

ROOT = Path(__file__).parents[2]
WHERE = "from marl_clean.config.compose import compose_config; compose_config(); "
WHERE += "from marl_clean.config.levels import conf_folder; print(conf_folder())"


def where_conf_is(site: Path) -> Path:
    """The config folder that a program finds whose first site-packages is `site`."""
    sites = [str(site), sysconfig.get_path("purelib")]
    program = f"import site; [site.addsitedir(each) for each in {sites!r}]; {WHERE}"
    command = [sys.executable, "-S", "-c", program]
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    result = subprocess.run(
        command, capture_output=True, text=True, cwd=site, env=environment, check=False
    )
    assert result.returncode == 0, result.stderr
    return Path(result.stdout.strip())


@pytest.fixture
def built(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(ROOT)
    return tmp_path


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder in which the wheel is installed."""
    folder = tmp_path_factory.mktemp("wheel")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(ROOT)
        wheel = folder / build_wheel(str(folder))
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(folder / "some site")
    return folder / "some site"


@pytest.mark.slow
def test_the_wheel_carries_its_own_configs(site: Path) -> None:
    ours = {path.relative_to(ROOT) for path in (ROOT / "conf").rglob("*.yaml")}
    assert {path.relative_to(site / "marl_clean") for path in site.rglob("conf/**/*.yaml")} == ours
    data = {path.relative_to(ROOT) for path in (ROOT / "marl_clean/house/plans").iterdir()}
    assert data and all((site / path).is_file() for path in data)
    assert where_conf_is(site) == site / "marl_clean" / "conf"


@pytest.mark.long
def test_the_wheel_carries_the_trained_runs(site: Path, tmp_path: Path) -> None:
    """Nothing beside it: `marl-clean evaluate checkpoint=NAME` works from any folder."""
    ours = {path.relative_to(ROOT) for path in (ROOT / "weights").rglob("*") if path.is_file()}
    held = {
        path.relative_to(site / "marl_clean")
        for path in (site / "marl_clean" / "weights").rglob("*")
        if path.is_file()
    }
    assert held == ours and len({path.parts[1] for path in ours}) == 3
    arguments = [
        "evaluate",
        "checkpoint=approach_2_frontier",
        "evaluation.houses=1",
        "env.max_steps=30",
    ]
    program = f"import sys; sys.path.insert(0, {str(site)!r}); import marl_clean.cli as c; "
    program += f"assert c.__file__.startswith({str(site)!r}); sys.exit(c.main({arguments!r}))"
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    result = subprocess.run(
        [sys.executable, "-c", program],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env=environment,
        check=False,
    )
    assert result.returncode == 0, result.stderr
    assert (tmp_path / "runs" / "evaluate").is_dir()
    assert "approach_2_frontier" in result.stdout


@pytest.mark.slow
def test_the_editable_install_reads_the_checkout(built: Path) -> None:
    wheel = built / build_editable(str(built))
    with zipfile.ZipFile(wheel) as archive:
        assert not [name for name in archive.namelist() if name.endswith(".yaml")]
        archive.extractall(built / "site")
    assert where_conf_is(built / "site") == ROOT / "conf"
