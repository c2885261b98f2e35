"""Where robots start: anywhere, or side by side."""

import pytest
import torch

from marl_clean import make_env
from marl_clean.errors import BadInput
from tests.reference import walking_distances

HOUSES = ["house.rows=[5,9]", "house.cols=[5,12]", "env.num_envs=40", "train_houses=40"]


@pytest.mark.parametrize("n_agents", [1, 2, 3, 6])
def test_together_the_others_stand_where_the_walk_to_the_first_is_shortest(n_agents: int) -> None:
    settings = [*HOUSES, f"env.n_agents={n_agents}", "seed=2"]
    together = make_env([*settings, "env.starts=together"])
    anywhere = make_env(settings)
    for env in (together, anywhere):
        env.reset()
    state, margin = together.base_env.state, together.base_env.rules.margin
    others = anywhere.base_env.state.position
    assert torch.equal(state.position[:, 0], others[:, 0])  # the first is drawn as ever
    for world in range(40):
        places = [tuple(place) for place in state.position[world].tolist()]
        free = {
            (row - margin, col - margin) for row, col in (~state.blocked[world]).nonzero().tolist()
        }
        distances = walking_distances(free, places[0])
        assert len(set(places)) == n_agents and set(places) <= free
        assert [distances[place] for place in places] == sorted(distances.values())[:n_agents]
    if n_agents == 2:  # drawn among the equally near
        sides = (state.position[:, 1] - state.position[:, 0]).unique(dim=0)
        assert len(sides) == 4


@pytest.mark.slow
def test_a_world_alone_starts_as_it_does_among_others() -> None:
    settings = [*HOUSES, "env.n_agents=4", "env.starts=together", "seed=5"]
    env = make_env(settings)
    env.reset()
    wider = make_env([*settings, "observation.view_size=21", "env.num_envs=3"])
    wider.reset()
    assert torch.equal(wider.base_env.state.position, env.base_env.state.position[:3])


@pytest.mark.slow
def test_places_of_a_plan_are_kept_and_the_others_stand_beside_the_first() -> None:
    plan = ["house=floorplan", "house.path=apartment", "env.n_agents=3", "env.num_envs=8"]
    drawn = make_env(plan)
    drawn.reset()
    first = drawn.base_env.state.position[0, 0]
    starts = f"house.starts=[{first.tolist()}]".replace(" ", "")
    env = make_env([*plan, starts, "env.starts=together"])
    env.reset()
    position = env.base_env.state.position
    assert (position[:, 0] == first).all()
    assert ((position[:, 1] - first).abs().sum(-1) == 1).all()


def test_bad_input_is_one_line() -> None:
    with pytest.raises(BadInput, match=r"^env.starts.*anywhere.*together"):
        make_env(["env.starts=near"])
