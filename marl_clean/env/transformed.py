"""TorchRL's env under transforms, with a shorter path through a step: the same frames."""

from jaxtyping import Bool, Int
from tensordict import TensorDict, TensorDictBase, is_tensor_collection
from torch import Tensor
from torchrl.envs import (
    Compose,
    InitTracker,
    RewardSum,
    TensorDictPrimer,
    Transform,
    TransformedEnv,
)

from marl_clean import keys
from marl_clean.env.channel_seed import ChannelSeed
from marl_clean.env.shaping import Shaping
from marl_clean.env.transform import RewardTransform, WorldTransform
from marl_clean.world.step import Along, Entries

KNOWN = (
    WorldTransform,
    RewardTransform,
    Shaping,
    ChannelSeed,
    RewardSum,
    InitTracker,
    TensorDictPrimer,
)
"""Transforms that add entries and leave actions as they are."""


class TransformedWorlds(TransformedEnv):
    """A `CleaningEnv` under transforms: `step_and_maybe_reset` without detours.

    TorchRL's method serves every env: it looks for partial steps and inverse transforms, and of a
    reset it makes a whole batch of which it takes the rows that ended. Here a world ends as one,
    and only the rows that ended are made, and put into what is carried on. What comes out is what
    TorchRL's own method gives, to the bit; with other transforms it is that method that steps.
    """

    def step_and_maybe_reset(
        self, tensordict: TensorDictBase
    ) -> tuple[TensorDictBase, TensorDictBase]:
        worlds, transforms = self.base_env, self.transforms
        usual = tensordict.device == worlds.device and tensordict.batch_size == worlds.batch_size
        known = all(isinstance(transform, KNOWN) for transform in transforms)
        if not usual or not known or "_step" in tensordict:
            return super().step_and_maybe_reset(tensordict)
        adjacency = tensordict.get(keys.ADJACENCY, None)
        along = computed_along(transforms, adjacency)
        after = worlds.step_worlds(tensordict.get(keys.ACTION), along)
        carried_over = tensordict.get("next", None)  # what a policy remembers
        if carried_over is not None:
            after.update(carried_over.exclude(*after.keys(True, True)))
        for transform in transforms:
            if isinstance(transform, WorldTransform):
                is_computed = transform.along
            else:
                is_computed = isinstance(transform, RewardTransform) and along.pay is not None
            if not is_computed:
                after = transform._step(tensordict, after)
        tensordict.set("next", after)
        carried = self._step_mdp(tensordict)
        done = after.get(keys.DONE)
        rows = done.view(-1).nonzero()[:, 0]
        if len(rows):
            self.begin_anew(carried, done, rows)
        return tensordict, carried

    @property
    def transforms(self) -> list[Transform]:
        """The transforms, in their order."""
        whole = self.transform
        return list(whole.transforms) if isinstance(whole, Compose) else [whole]

    def set_gamma(self, gamma: float) -> None:
        """Shape rewards from now on by this discount of the learner's, where they are shaped."""
        for transform in self.transforms:
            if isinstance(transform, Shaping):
                transform.gamma = gamma

    def begin_anew(
        self, carried: TensorDictBase, done: Bool[Tensor, "env 1"], rows: Int[Tensor, " row"]
    ) -> None:
        """Put the first frames of new episodes into the rows that are `done`.

        What no first frame has, such as what a policy wrote, is 0 there.
        """
        worlds = [one for one in self.transforms if isinstance(one, WorldTransform)]
        fresh, entries = self.base_env.begin_rows(rows, [one.read for one in worlds])
        entries[keys.POSITION] = fresh.position
        for transform in self.transforms:
            if not isinstance(transform, WorldTransform | RewardTransform | RewardSum):
                asked = TensorDict({"_reset": done}, self.batch_size, device=self.device)
                begun = transform._reset(asked, asked.empty())
                entries |= {key: begun.get(key)[rows] for key in begun.keys(True, True)}
        put_rows(carried, rows, entries)


def put_rows(
    frame: TensorDictBase,
    rows: Int[Tensor, " row"],
    entries: Entries,
    above: tuple[str, ...] = (),
) -> None:
    """Put `entries` into the rows of a frame, 0 where there is none for a key; in new tensors.

    The old ones may be part of a recorded step.
    """
    for name, before in list(frame.items()):
        if is_tensor_collection(before):
            put_rows(before, rows, entries, (*above, name))
            continue
        fresh = entries.get((*above, name) if above else name)
        if fresh is None:
            after = before.index_fill(0, rows, 0)
        else:
            after = before.index_copy(0, rows, fresh)
        # Of the shape that was there: `set` would check it, for a fifth of this function's time.
        frame._set_str(name, after, validated=True, inplace=False)


def computed_along(
    transforms: list[Transform], adjacency: Bool[Tensor, "env agent agent"] | None
) -> Along:
    """Return what these transforms have computed along with a step, not after it."""
    worlds = (one for one in transforms if isinstance(one, WorldTransform))
    pays = [one.pay for one in transforms if isinstance(one, RewardTransform)]
    pay = pays[-1] if pays and adjacency is not None else None
    return Along([one.read for one in worlds if one.along], pay, adjacency)
