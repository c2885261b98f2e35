"""What every reward split must hold."""

from typing import Any

import torch
from torch import Tensor

from marl_clean import keys
from marl_clean.testing._broken import Clause, require, require_close, require_equal, verify
from marl_clean.testing._levels import Level, Maker, maker
from marl_clean.testing._worlds import drawn_actions, make_worlds


def check_reward(level: Level, **settings: Any) -> None:
    """A reward split pays from own rewards and contact, however robots are numbered.

        >>> check_reward("neighbours")

    Raises:
        ContractBroken: what does not hold, with the numbers.
        BadInput: no such level or setting.
    """
    made = maker("reward", level, settings)
    verify(made.label, CLAUSES, made)


def drawn(*batch: int, n_agents: int, seed: int = 0) -> tuple[Tensor, Tensor]:
    """Return own rewards and a random contact graph."""
    generator = torch.Generator().manual_seed(seed)
    own = torch.randn(*batch, n_agents, 1, generator=generator)
    live = (torch.rand(*batch, n_agents, n_agents, generator=generator) < 0.5).triu(1)
    return own, live | live.mT


def pay_is_one_finite_number_a_robot(make: Maker) -> None:
    """Pay has the own reward's shape and dtype, and its inputs are left unchanged."""
    split = make()
    for batch in ((), (1,), (4,), (2, 3)):
        for n_agents in (1, 2, 5):
            own, live = drawn(*batch, n_agents=n_agents)
            before = own.clone(), live.clone()
            paid = split.pay(own, live)
            kind, wanted = (f"{x.dtype} {list(x.shape)}" for x in (paid, own))
            require(kind == wanted, f"pay gives {kind} for own rewards of {wanted}")
            require(paid.isfinite(), f"pay of finite rewards is not finite: {paid.flatten()}")
            require_equal(own, before[0], "pay changes the own rewards in place")
            require_equal(live, before[1], "pay changes the adjacency in place")
            apart = paid.untyped_storage().data_ptr() != own.untyped_storage().data_ptr()
            require(apart or own.numel() == 0, "pay returns its input; return a copy of it")


def relabelling_the_robots_relabels_pay(make: Maker) -> None:
    """Pay does not depend on how robots are numbered."""
    own, live = drawn(6, n_agents=5)
    order = torch.tensor([2, 0, 4, 1, 3])
    permuted = make().pay(own, live)[:, order]
    renamed = make().pay(own[:, order], live[:, order][..., order])
    require_close(permuted, renamed, f"robots renumbered as {order.tolist()} are paid differently")


def a_batch_equals_each_world_alone(make: Maker) -> None:
    """A world's pay is what it is alone."""
    own, live = drawn(5, n_agents=3)
    together = make().pay(own, live)
    for world in range(5):
        alone = make().pay(own[world], live[world])
        require_close(together[world], alone, f"world {world} of 5 is paid differently alone")


def both_step_methods_pay_the_same(make: Maker) -> None:
    """The env's step and TorchRL's own method pay the same."""
    paid = []
    for torchrl in (False, True):
        env = make_worlds([make()], torchrl=torchrl)
        td, rewards = env.reset(), []
        for action in drawn_actions(12, 6):
            td[keys.ACTION] = action
            step, td = env.step_and_maybe_reset(td)
            rewards.append(step["next", keys.REWARD].clone())
        paid.append(torch.stack(rewards))
    require_equal(paid[0], paid[1], "the env's step and TorchRL's pay differently")


CLAUSES: tuple[Clause, ...] = (
    pay_is_one_finite_number_a_robot,
    relabelling_the_robots_relabels_pay,
    a_batch_equals_each_world_alone,
    both_step_methods_pay_the_same,
)
