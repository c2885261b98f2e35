"""Networks of one size: `parameter_budget` widens or narrows the features, whatever the scheme."""

from pathlib import Path

import pytest
import torch
from omegaconf import DictConfig

from marl_clean import build, cli
from marl_clean.config.compose import compose_config
from marl_clean.config.config_hash import config_hash
from marl_clean.config.levels import rooms
from marl_clean.errors import BadInput
from tests.families import family, world_for

SMALL = ["train_houses=4", "env.num_envs=2", "house.rows=[5,5]", "house.cols=[5,5]"]
BUDGET = 200_000


def learner(*settings: str):
    cfg = compose_config([*SMALL, *settings])
    torch.manual_seed(0)
    return build.make_agent(cfg, build.make_env(cfg))


def size(agent) -> int:
    return sum(weight.numel() for weight in agent.network.parameters())


@family("comm", rooms()["comm"], fast=["plan"], usual=6)
def test_every_scheme_fills_the_budget_and_does_not_exceed_it(comm: str) -> None:
    scheme = [f"comm={comm}", *world_for(comm)]
    agent = learner(*scheme, f"parameter_budget={BUDGET}")
    assert 0.99 * BUDGET < size(agent) <= BUDGET
    wider = agent.network.encoder.out_features + 1
    assert size(learner(*scheme, f"encoder.hidden=[{wider}]")) > BUDGET


@family("agent", rooms()["agent"], fast=["qmix"])
def test_every_learner_has_a_network_of_the_budget(agent: str) -> None:
    fits = ["comm=none", "reward=team"]
    loop = "on_policy" if agent in ("ippo", "mappo", "pqn") else "off_policy"
    built = learner(f"agent={agent}", f"trainer={loop}", *fits, f"parameter_budget={BUDGET}")
    assert 0.98 * BUDGET < size(built) <= BUDGET


@pytest.mark.slow
def test_layers_before_the_last_keep_their_width() -> None:
    network = learner("encoder.hidden=[48,8]", f"parameter_budget={BUDGET}").network
    widths = [layer.out_features for layer in network.encoder.connected[::2]]
    assert widths[0] == 48
    assert widths[1] != 8


@pytest.mark.slow
def test_weights_are_those_of_that_width_without_a_budget() -> None:
    sized = learner(f"parameter_budget={BUDGET}").network
    plain = learner(f"encoder.hidden=[{sized.encoder.out_features}]").network
    assert all(map(torch.equal, sized.parameters(), plain.parameters()))


@pytest.mark.slow
def test_what_a_channel_learns_is_not_counted() -> None:
    over = ["channel=delayed", f"parameter_budget={BUDGET}"]
    late, perfect = learner(*over), learner(over[1])
    assert late.network.encoder.out_features == perfect.network.encoder.out_features
    assert size(late) > size(perfect)


@pytest.mark.slow
def test_a_budget_that_allows_no_network_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(BadInput, match="parameter_budget=100: .* already; give more"):
        learner("parameter_budget=100")
    assert cli.main(["train", *SMALL, "parameter_budget=100", "name=small"]) == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_without_a_budget_runs_are_called_as_ever() -> None:
    plain = compose_config()
    before = DictConfig({key: plain[key] for key in plain if key != "parameter_budget"})
    assert config_hash(plain) == config_hash(before)
    assert config_hash(compose_config(["parameter_budget=7"])) != config_hash(plain)
