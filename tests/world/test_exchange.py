"""What robots tell each other of their maps; test_against_reference compares each step."""

import pytest
import torch
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st

from marl_clean import keys, make_env
from marl_clean.config.compose import compose_config
from marl_clean.config.fitting import check_fit
from marl_clean.env.for_schemes import exchange_of
from marl_clean.errors import BadInput
from marl_clean.evaluation.metrics import step_counts
from marl_clean.world.shared_map import is_known_blocked, is_unknown

HOUSES = ["house.rows=[5,9]", "house.cols=[5,9]", "train_houses=6", "topology.radius_cells=4"]
PRIVATE = ["env.memory=private", "topology=radius", *HOUSES]


def records_of(steps: int, *settings: str, n_agents: int = 3) -> torch.Tensor:
    env = make_env([*settings, f"env.n_agents={n_agents}", "env.num_envs=16", "seed=3"])
    draw = torch.Generator().manual_seed(0)
    td, history = env.reset(), []
    for _ in range(steps):
        td[keys.ACTION] = torch.randint(4, (16, n_agents), generator=draw)
        td = env.step_and_maybe_reset(td)[1]
        history.append(env.base_env.state.record.clone())
    return torch.stack(history)


@pytest.mark.long
@pytest.mark.parametrize("n_agents", [3])
def test_all_cells_at_once_unite_the_maps(n_agents: int) -> None:
    told = records_of(80, *PRIVATE, "comm=delta", "comm.cells=10000", n_agents=n_agents)
    merged = ["env.memory=merged", "topology=radius", *HOUSES]
    united = records_of(80, *merged, n_agents=n_agents)
    assert torch.equal(told, united)
    assert not torch.equal(told, records_of(80, *PRIVATE, n_agents=n_agents))


@pytest.mark.slow
def test_without_decay_what_is_known_is_the_same_whenever_it_was_cleaned() -> None:
    lasting = "env.decay_steps=null"
    told = records_of(80, *PRIVATE, "comm=delta", "comm.cells=10000", lasting)
    united = records_of(80, "env.memory=merged", "topology=radius", *HOUSES, lasting)
    assert torch.equal(is_unknown(told), is_unknown(united))
    assert torch.equal(is_known_blocked(told), is_known_blocked(united))


@pytest.mark.slow
@given(cells=st.sampled_from([1, 2, 5]))
@hypothesis_settings(max_examples=3, deadline=None)
def test_no_more_cells_than_allowed_are_learnt_of_one_other(cells: int) -> None:
    env = make_env([*PRIVATE, "comm=delta", f"comm.cells={cells}", "env.num_envs=16"])
    draw, td, most = torch.Generator().manual_seed(1), env.reset(), 0
    for _ in range(60):
        before = (~is_unknown(env.base_env.state.record)).sum((2, 3))
        td[keys.ACTION] = torch.randint(4, (16, 2), generator=draw)
        td = env.step(td)["next"]
        after = (~is_unknown(env.base_env.state.record)).sum((2, 3))
        most = max(most, int((after - before).max()))
    assert 1 < most <= cells + 1  # a robot enters or bumps one cell a step itself


@pytest.mark.slow
def test_bits_are_those_of_the_cells_and_of_their_number() -> None:
    settings = [*PRIVATE, "house=open", "house.rows=[4,4]", "house.cols=[4,4]", "topology=full"]
    settings = [s for s in settings if "radius" not in s]
    env = make_env([*settings, "comm=delta", "comm.cells=3", "env.num_envs=8", "env.max_steps=60"])
    env.reset()
    # Each tells its start: 2 bits for 0 to 3 cells; a place among 6 x 6 takes 6, a kind 2, and a
    # step of 60 takes 6.
    assert env.base_env.state.exchanged_bits.tolist() == [[2 + 6 + 2 + 6] * 2] * 8


@pytest.mark.slow
def test_what_was_lent_is_not_kept() -> None:
    """Apart a robot knows what it alone has found; in contact it sees by the union."""
    lent = [*PRIVATE, "comm=lend", "env.num_envs=16", "seed=3"]
    env = make_env(lent)
    draw, td, apart, together = torch.Generator().manual_seed(1), env.reset(), 0, 0
    for _ in range(80):
        td[keys.ACTION] = torch.randint(4, (16, 2), generator=draw)
        td = env.step_and_maybe_reset(td)[1]
        state, contact = env.base_env.state, td[keys.ADJACENCY][:, 0, 1]
        own, shown = ~is_unknown(state.own_record), ~is_unknown(state.record)
        union = own.any(1, keepdim=True).expand_as(own)
        assert torch.equal(shown, torch.where(contact[:, None, None, None], union, own))
        apart += int((~contact & (union != own).any((1, 2, 3))).sum())
        together += int((contact & (union != own).any((1, 2, 3))).sum())
    assert apart > 0 and together > 0


@pytest.mark.slow
def test_bits_of_a_lent_map_are_those_of_house_and_ring() -> None:
    small = ["house=open", "house.rows=[4,4]", "house.cols=[4,4]", "env.num_envs=8"]
    rules = ["env.memory=private", "topology=full", "comm=lend", "env.max_steps=60"]
    env = make_env([*rules, *small])
    env.reset()  # two bits for what a cell is, and a step of 60 takes 6
    assert env.base_env.state.exchanged_bits.tolist() == [[36 * (2 + 6)] * 2] * 8


@pytest.mark.slow
def test_a_patch_costs_two_bits_a_cell_and_is_kept() -> None:
    """Two robots side by side hear each other's 7 x 7 cells with each step, and know them later."""
    env = make_env([*PRIVATE, "comm=patch", "env.num_envs=16", "seed=3"])
    draw, td, later = torch.Generator().manual_seed(1), env.reset(), 0
    for _ in range(80):
        contact = td[keys.ADJACENCY][:, 0, 1]
        td[keys.ACTION] = torch.randint(4, (16, 2), generator=draw)
        whole, td = env.step_and_maybe_reset(td)
        state = env.base_env.state
        bits = torch.where(contact, 98, 0)[:, None].expand(16, 2)
        running = ~whole["next", keys.DONE][:, 0]
        assert torch.equal(state.exchanged_bits[running], bits[running])
        messages = step_counts(state, whole)["messages"]
        assert torch.equal(messages[running], torch.where(contact, 2, 0)[running])
        apart = ~td[keys.ADJACENCY][:, 0, 1] & running
        heard = is_unknown(state.own_record) & ~is_unknown(state.record)
        later += int((heard & apart[:, None, None, None]).sum())
    assert later > 0


def test_a_form_of_exchange_that_is_none_is_refused() -> None:
    with pytest.raises(BadInput, match=r"^a.B.exchanges=cell: no such form; valid: cells, maps, "):
        exchange_of({"_target_": "a.B"}, "cell")
    assert exchange_of({"_target_": "a.B"}, None) is None


@pytest.mark.slow
def test_bad_input_is_one_line() -> None:
    delayed = ["comm=autoencoder", "channel=delayed"]
    with pytest.raises(BadInput, match=r"^channel=delayed: does not fit comm=autoencoder; valid: "):
        compose_fit([*PRIVATE, *delayed])
    with pytest.raises(BadInput, match=r"^env.memory=shared: comm=autoencoder .*; valid: private$"):
        compose_fit(["comm=autoencoder"])
    with pytest.raises(BadInput, match=r"^env.memory=shared: comm=delta .*; valid: private$"):
        compose_fit(["comm=delta"])
    with pytest.raises(BadInput, match=r"^channel=lossy: does not fit comm=delta; valid: perfect$"):
        compose_fit([*PRIVATE, "comm=delta", "channel=lossy"])
    with pytest.raises(BadInput, match=r"^comm.cells"):
        compose_fit([*PRIVATE, "comm=delta", "comm.cells=0"])


def compose_fit(settings: list[str]) -> None:
    check_fit(compose_config(settings))
